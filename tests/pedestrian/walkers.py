"""Walkers whose truth is known: what their phones would read, written from the motion itself."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from server.pedestrian.samples import Accelerometer, Gyroscope, Magnetometer, Sample

Array = NDArray[np.float64]

EARTH = np.array([0.0, 30.0, -35.0])
"""The earth's field, microtesla, x east, y north, z up."""


@dataclass(frozen=True)
class Sway:
    """level_from_swaying (N, 3, 3), and the angular velocity of it in the swaying axes, (N, 3)."""

    matrices: Array
    rates: Array


@dataclass(frozen=True)
class Walker:
    """A phone held flat, pointing forward, whose carrier walks a polygon at an even pace.

    The body rises and falls as an inverted pendulum does: vertical acceleration sqrt(2) * deviation *
    cos(2 pi t / interval), with deviation = (speed / gain)^2.
    """

    corners: tuple[tuple[float, float], ...] = ((0.0, 0.0), (0.0, 20.0), (15.0, 20.0))
    speed: float = 1.2
    interval: float = 0.55
    rest: float = 1.0
    turning: float = 1.0
    gain: float = 0.67
    rate: float = 50.0
    gyroscope_bias: tuple[float, float, float] = (0.0, 0.0, 0.0)
    noise: float = 0.0
    field_bias: tuple[float, float, float] = (0.0, 0.0, 0.0)
    seed: int = 0
    sway: float = 0.0
    phone_from_level: Array = field(default_factory=lambda: np.eye(3))

    def path(self) -> tuple[Array, Array, Array, Array]:
        """Times (N,), positions (N, 2), headings (N,), whether walking (N,)."""
        corners = np.array(self.corners)
        step = 1.0 / self.rate
        positions, headings, walking = [], [], []
        legs = np.diff(corners, axis=0)
        angles = np.unwrap(np.arctan2(legs[:, 1], legs[:, 0]))

        def stand(where: Array, start: float, end: float, seconds: float) -> None:
            count = round(seconds * self.rate)
            positions.extend([where] * count)
            headings.extend(np.linspace(start, end, count))
            walking.extend([False] * count)

        stand(corners[0], angles[0], angles[0], self.rest)
        for leg, (corner, move) in enumerate(zip(corners[:-1], legs, strict=True)):
            if leg:
                stand(corner, angles[leg - 1], angles[leg], self.turning)
            paces = round(float(np.hypot(*move)) / (self.speed * self.interval))
            count = round(paces * self.interval * self.rate)
            positions.extend(corner + np.linspace(0.0, 1.0, count)[:, None] * move)
            headings.extend([angles[leg]] * count)
            walking.extend([True] * count)
        stand(corners[-1], angles[-1], angles[-1], self.rest)
        times = np.arange(len(positions)) * step
        return times, np.array(positions), np.array(headings), np.array(walking)

    def _sway(self, times: Array) -> Sway:
        """The hand tilts about x, then about y, a few seconds each way."""
        pitch, roll = self.sway * np.sin(1.3 * times), self.sway * np.sin(0.9 * times)
        pitch_rate = self.sway * 1.3 * np.cos(1.3 * times)
        roll_rate = self.sway * 0.9 * np.cos(0.9 * times)
        first, second = (
            Rotation.from_rotvec(np.outer(pitch, [1.0, 0.0, 0.0])),
            Rotation.from_rotvec(np.outer(roll, [0.0, 1.0, 0.0])),
        )
        rates = second.inv().apply(np.outer(pitch_rate, [1.0, 0.0, 0.0]))
        rates[:, 1] += roll_rate
        return Sway((first * second).as_matrix(), rates)

    @property
    def steps(self) -> int:
        legs = np.hypot(*np.diff(np.array(self.corners), axis=0).T)
        return sum(round(float(leg) / (self.speed * self.interval)) for leg in legs)

    def samples(self) -> list[Sample]:
        """Of accelerometer, gyroscope and magnetometer, in the order in which they are taken."""
        times, _, headings, walking = self.path()
        random = np.random.default_rng(self.seed)
        deviation = (self.speed / self.gain) ** 2
        bounce = np.where(
            walking, np.sqrt(2.0) * deviation * np.cos(2.0 * np.pi * times / self.interval), 0.0
        )
        force = np.zeros((len(times), 3))
        force[:, 2] = 9.81 + bounce
        turning = np.zeros((len(times), 3))
        turning[:, 2] = np.gradient(headings, times)
        # The phone's y axis points where its carrier goes.
        c, s = np.cos(headings - np.pi / 2), np.sin(headings - np.pi / 2)
        magnetic = np.stack(
            [c * EARTH[0] + s * EARTH[1], -s * EARTH[0] + c * EARTH[1], np.full(len(times), EARTH[2])], axis=1
        )
        turn = self.phone_from_level
        swing = self._sway(times)
        force = np.einsum("nji,nj->ni", swing.matrices, force)
        magnetic = np.einsum("nji,nj->ni", swing.matrices, magnetic)
        turning = np.einsum("nji,nj->ni", swing.matrices, turning) + swing.rates

        def read(values: Array, scale: float) -> Array:
            return np.asarray(values @ turn.T + random.normal(scale=self.noise * scale, size=values.shape))

        forces, turnings = read(force, 0.1), read(turning, 0.01) + np.array(self.gyroscope_bias)
        fields = read(magnetic, 0.5) + np.array(self.field_bias)
        samples: list[Sample] = []
        for t, a, w, m in zip(
            times.tolist(), forces.tolist(), turnings.tolist(), fields.tolist(), strict=True
        ):
            samples += [Accelerometer(t, *a), Gyroscope(t, *w), Magnetometer(t, *m)]
        return samples
