"""A walk in continuous time: where the camera is and how it turns, and both derivatives.

Pictures, sub-pictures of a blurred one and the readings of the phone's sensors all come from the same
two splines, so that whatever is integrated agrees with the truth.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from client_sim.synthetic.cameras import Pose
from client_sim.synthetic.gait import Step

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False, slots=True)
class Motion:
    """Splines through densely sampled positions and angles; twice continuously differentiable.

    Attributes:
        times: (N,) seconds from 0.
        position: (N, 3) camera centres, world, metres.
        angles: (N, 3) heading, pitch and roll, radians without jumps, as ``level_rotation`` takes them.
        ground: (N, 3) points of the floor below the walker.
        steps: in the order of their times.
    """

    times: Array
    position: Array = field(repr=False)
    angles: Array = field(repr=False)
    ground: Array = field(repr=False)
    steps: tuple[Step, ...] = field(repr=False, default=())
    _position: CubicSpline = field(init=False, repr=False)
    _angles: CubicSpline = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_position", CubicSpline(self.times, self.position))
        object.__setattr__(self, "_angles", CubicSpline(self.times, self.angles))

    @property
    def duration(self) -> float:
        """Seconds."""
        return float(self.times[-1])

    @property
    def length(self) -> float:
        """Metres of floor that are walked over, without the bobbing."""
        return float(np.linalg.norm(np.diff(self.ground, axis=0), axis=1).sum())

    def pose(self, time: float) -> Pose:
        """The camera's pose at a time."""
        at = np.array([time])
        return Pose(self.rotations(at)[0], self.positions(at)[0])

    def positions(self, times: Array) -> Array:
        """Camera centres (M, 3), world."""
        return np.asarray(self._position(times))

    def velocities(self, times: Array) -> Array:
        """Of the camera's centre (M, 3), world, metres a second."""
        return np.asarray(self._position(times, 1))

    def accelerations(self, times: Array) -> Array:
        """Of the camera's centre (M, 3), world, metres a second squared."""
        return np.asarray(self._position(times, 2))

    def rotations(self, times: Array) -> Array:
        """``world_from_camera`` (M, 3, 3)."""
        return level_rotations(np.asarray(self._angles(times)))

    def angular_velocities(self, times: Array) -> Array:
        """Of the camera (M, 3), in its own axes, radians a second."""
        angles = np.asarray(self._angles(times))
        rates = np.asarray(self._angles(times, 1))
        rotation = level_rotations(angles)
        heading = angles[:, 0]
        level_right = np.stack([np.sin(heading), -np.cos(heading), np.zeros(len(angles))], axis=1)
        # Heading turns about the vertical, pitch about what is level and right, roll about the view.
        world = rates[:, 1:2] * level_right + rates[:, 2:3] * rotation[:, :, 2]
        world[:, 2] += rates[:, 0]
        return np.asarray(np.einsum("nij,ni->nj", rotation, world))

    def grounds(self, times: Array) -> Array:
        """Points of the floor below the walker (M, 3)."""
        return np.stack([np.interp(times, self.times, column) for column in self.ground.T], axis=1)


def level_rotations(angles: Array) -> Array:
    """Many rotations as of :func:`client_sim.synthetic.cameras.level_rotation`: (N, 3) -> (N, 3, 3)."""
    (ch, cp, cr), (sh, sp, sr) = np.cos(angles).T, np.sin(angles).T
    forward = np.stack([ch * cp, sh * cp, sp], axis=-1)
    right = np.stack([sh, -ch, np.zeros_like(ch)], axis=-1)
    down = np.cross(forward, right)
    cr, sr = cr[:, None], sr[:, None]
    return np.stack([cr * right + sr * down, cr * down - sr * right, forward], axis=-1)
