"""From phone axes to level ones: VQF without its magnetometer, and the forward direction of a phone.

Laidig and Seel, VQF: Highly accurate IMU orientation estimation with bias estimation and magnetic
disturbance rejection, Information Fusion 91, 2023. It tracks the gyroscope's bias in motion and at rest.
"""

from __future__ import annotations

import math
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray
from vqf import VQF

Vector: TypeAlias = tuple[float, float, float]
Matrix: TypeAlias = tuple[Vector, Vector, Vector]


class Orientation:
    """``level_from_phone``: z up; x and y turned about it by an unknown angle, which drifts slowly."""

    def __init__(self, period: float) -> None:
        self._period = period
        self._filter = VQF(period)
        self._gyroscope: NDArray[np.float64] = np.zeros(3)
        self._accelerometer: NDArray[np.float64] = np.zeros(3)
        self.matrix: Matrix = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))

    def update(self, gyroscope: Vector, accelerometer: Vector) -> None:
        """One period on: angular velocity, rad/s, and specific force, m/s^2, in phone axes."""
        self._gyroscope[:] = gyroscope
        self._accelerometer[:] = accelerometer
        self._filter.update(self._gyroscope, self._accelerometer)
        w, x, y, z = self._filter.getQuat6D().tolist()
        self.matrix = (
            (1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)),
            (2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)),
            (2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)),
        )

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_filter": self._filter.state}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._filter = VQF(self._period)
        self._filter.state = state["_filter"]

    @property
    def bias(self) -> tuple[NDArray[np.float64], float]:
        """Of the gyroscope: (3,) rad/s in phone axes, and its standard deviation."""
        bias, sigma = self._filter.getBiasEstimate()
        return np.asarray(bias), float(sigma)

    def forward(self) -> tuple[float, float]:
        """Level direction, not of unit length, in which the phone points: its y axis lying, -z standing.

        Half way between the two, y - z, serves every tilt between flat on its back and leaning forward,
        with no switching from one to the other.
        """
        first, second, _ = self.matrix
        return first[1] - first[2], second[1] - second[2]

    def vertical(self, v: Vector) -> float:
        """Upward component of a vector in phone axes."""
        x, y, z = self.matrix[2]
        return x * v[0] + y * v[1] + z * v[2]

    def level(self, v: Vector) -> tuple[float, float]:
        """Level components of a vector in phone axes."""
        (a, b, c), (d, e, f), _ = self.matrix
        return a * v[0] + b * v[1] + c * v[2], d * v[0] + e * v[1] + f * v[2]


def wrapped(angle: float) -> float:
    """The same angle in (-pi, pi]."""
    return math.pi - (math.pi - angle) % (2.0 * math.pi)
