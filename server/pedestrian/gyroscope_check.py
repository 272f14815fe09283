"""Whether a gyroscope turns with gravity: its unit and its axes, found while the phone is tilted.

A fixed direction seen from a turning phone moves as du/dt = -w x u, and gravity is one. What the
accelerometer saw of it is compared with what each signed permutation of the gyroscope's axes foretells; the
regression's slope is the unit. Turning about the vertical tells nothing, so a phone that is never tilted is
never judged.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import permutations, product

import numpy as np
from numpy.typing import NDArray

from server.pedestrian.orientation import Vector

Array = NDArray[np.float64]


def _signed_permutations() -> Array:
    """(48, 3, 3), the identity first."""
    matrices = []
    for order in permutations(range(3)):
        for signs in product((1.0, -1.0), repeat=3):
            matrix = np.zeros((3, 3))
            matrix[range(3), order] = signs
            matrices.append(matrix)
    return np.array(matrices)


_CANDIDATES = _signed_permutations()
_UNITS = (1.0, math.pi / 180.0, 1e-3, 1e3, 180.0 / math.pi, math.pi / 180.0 * 1e-3)
"""To rad/s: from deg/s, mrad/s, krad/s, and what else has been seen."""


@dataclass(frozen=True, slots=True)
class CheckOptions:
    """Attributes:
    window: seconds over which forces are averaged: a step.
    evidence: rad^2, the sum of squared tilts that must have been seen.
    explained: share of these that the right axes explain, ...
    margin: ... and by how much more than those taken so far.
    forgetting: of the evidence, in one window.
    """

    window: float = 0.5
    evidence: float = 0.5
    explained: float = 0.6
    margin: float = 0.3
    forgetting: float = 0.98


class GyroscopeCheck:
    """Compares what is read, before it is corrected; ``matrix`` is the correction, the identity at first."""

    def __init__(self, options: CheckOptions | None = None) -> None:
        self.options = options or CheckOptions()
        self.matrix: Array | None = None
        self.axes_changed = False
        self._chosen = 0
        self._unit = 1.0
        self._agreement = np.zeros(len(_CANDIDATES))
        self._predicted = np.zeros(len(_CANDIDATES))
        self._seen = 0.0
        self._last: float | None = None
        self._restart(0.0)
        self._before: tuple[Array, Array] | None = None

    def _restart(self, t: float) -> None:
        self._begin = t
        self._force = [0.0, 0.0, 0.0]
        self._angle = [0.0, 0.0, 0.0]

    def break_off(self) -> None:
        """Samples are missing: what comes next does not continue what was before."""
        self._last = self._before = None

    def turn(self, t: float, v: Vector) -> None:
        """A reading of the gyroscope, in its own unit and axes."""
        if self._last is None:
            self._restart(t)
        else:
            angle, seconds = self._angle, t - self._last
            for axis in range(3):
                angle[axis] += v[axis] * seconds
        self._last = t

    def force(self, t: float, v: Vector) -> bool:
        """A specific force.

        Returns:
            Whether the correction has just changed.
        """
        force = self._force
        for axis in range(3):
            force[axis] += v[axis]
        if self._last is None or t - self._begin < self.options.window:
            return False
        size = math.sqrt(force[0] ** 2 + force[1] ** 2 + force[2] ** 2)
        angle, before = np.array(self._angle), self._before
        direction = np.array(force) / max(size, 1e-9)
        self._before = (direction, angle)
        self._restart(t)
        return before is not None and self._compare(*before, direction, angle)

    def _compare(self, old: Array, old_angle: Array, new: Array, new_angle: Array) -> bool:
        options = self.options
        moved = new - old
        foretold = np.cross(0.5 * (old + new), _CANDIDATES @ (0.5 * (old_angle + new_angle)))
        keep = options.forgetting
        self._agreement = keep * self._agreement + foretold @ moved
        self._predicted = keep * self._predicted + (foretold**2).sum(axis=1)
        self._seen = keep * self._seen + float(moved @ moved)
        if self._seen < options.evidence:
            return False
        slopes = self._agreement / np.maximum(self._predicted, 1e-30)
        explained = np.where(slopes > 0.0, slopes * self._agreement / self._seen, 0.0)
        best = int(np.argmax(explained))
        if explained[best] < options.explained:
            return False
        if explained[best] < explained[self._chosen] + options.margin:
            best = self._chosen
        unit = min(_UNITS, key=lambda factor: abs(math.log(slopes[best] / factor)))
        if best == self._chosen and unit == self._unit:
            return False
        self.axes_changed = best != self._chosen
        self._chosen, self._unit = best, unit
        self.matrix = unit * _CANDIDATES[best]
        return True

    def describe(self) -> str:
        """The correction, in words."""
        rows = [
            f"{'-' if row.sum() < 0 else ''}{'xyz'[int(np.abs(row).argmax())]}"
            for row in _CANDIDATES[self._chosen]
        ]
        return f"axes taken as {', '.join(rows)}, times {self._unit:g}"
