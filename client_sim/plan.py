"""What is known beforehand about a building that a route was mapped in: for drawing only."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False, slots=True)
class FloorPlan:
    """Walls from above, and where the leader truly walked.

    Attributes:
        walls: (W, 4) x0, y0, x1, y1, metres.
        times: (N,) seconds of the leader's video.
        positions: (N, 3) of the leader's camera then, metres.
        labels: names of places and where they are.
    """

    walls: Array = field(repr=False)
    times: Array = field(repr=False)
    positions: Array = field(repr=False)
    labels: tuple[tuple[str, float, float], ...] = ()


@dataclass(frozen=True, eq=False, slots=True)
class Similarity:
    """``target = scale * rotation @ source + shift``."""

    scale: float
    rotation: Array
    shift: Array

    def __call__(self, points: Array) -> Array:
        """Points (N, 3) of the source -> the target."""
        return np.asarray(self.scale * points @ self.rotation.T + self.shift)


def similarity(source: Array, target: Array) -> Similarity:
    """The least-squares similarity from points (N, 3) to points (N, 3) (Umeyama, 1991)."""
    a, b = source - source.mean(axis=0), target - target.mean(axis=0)
    rotation, _ = Rotation.align_vectors(b, a)
    matrix = rotation.as_matrix()
    scale = float((b * (a @ matrix.T)).sum() / (a * a).sum())
    return Similarity(scale, matrix, target.mean(axis=0) - scale * source.mean(axis=0) @ matrix.T)


def in_plan(plan: FloorPlan, times: Array, positions: Array) -> Similarity:
    """Where a map lies in the plan, by its path (N, 3) at times (N,) of the leader's video."""
    true = np.stack([np.interp(times, plan.times, column) for column in plan.positions.T], axis=1)
    return similarity(positions, true)
