"""Poses of a walk's pictures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from client_sim.synthetic.cameras import Pose
from client_sim.synthetic.gait import Gait
from client_sim.synthetic.motion import Motion
from client_sim.synthetic.scripts import Go, perform

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Trajectory:
    """A walked path, sampled at a fixed rate.

    Attributes:
        fps: poses a second; the first is at time 0.
        poses: one a frame.
        length: metres of path without the bobbing.
    """

    fps: float
    poses: tuple[Pose, ...]
    length: float
    times: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "times", np.arange(len(self.poses)) / self.fps)

    def __len__(self) -> int:
        return len(self.poses)


def sample(motion: Motion, fps: float = 10.0) -> Trajectory:
    """The poses of a motion at a camera's rate."""
    times = np.arange(0.0, motion.duration, 1.0 / fps)
    poses = map(Pose, motion.rotations(times), motion.positions(times))
    return Trajectory(fps, tuple(poses), motion.length)


def walk(
    waypoints: Sequence[Sequence[float]],
    rng: np.random.Generator,
    gait: Gait | None = None,
    *,
    fps: float = 10.0,
    wander: float = 0.0,
) -> Trajectory:
    """Walk along waypoints of the floor, (x, y) at z = 0 or (x, y, z); see :func:`perform`."""
    return sample(perform([Go(waypoints)], rng, gait, wander=wander), fps)
