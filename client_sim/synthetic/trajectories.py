"""How a person with a phone walks: smooth turns, bobbing steps, swaying hands."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from client_sim.synthetic.cameras import Pose, level_rotation

Array = NDArray[np.float64]

SPACING_M = 0.02
"""Spacing of the sampled path."""


@dataclass(frozen=True, slots=True)
class Gait:
    """How the camera is carried.

    Attributes:
        speed: metres a second on straight stretches.
        turn_slowdown: part of the speed that is lost in the sharpest turn.
        height: of the camera above the floor, metres.
        step_rate: steps a second.
        bob, sway: amplitudes of the motion up and down (a step) and sideways (a pair of steps), metres.
        pitch: mean, radians, positive looks up.
        shake: deviation of slow hand motion, radians.
        corner_radius: metres over which a corner of the waypoints is rounded.
        look_ahead: metres along the path to the point the camera is turned to.
    """

    speed: float = 1.1
    turn_slowdown: float = 0.4
    height: float = 1.5
    step_rate: float = 1.9
    bob: float = 0.022
    sway: float = 0.016
    pitch: float = -0.05
    shake: float = 0.012
    corner_radius: float = 0.7
    look_ahead: float = 0.8


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


def smooth_path(waypoints: Sequence[tuple[float, float]], corner_radius: float) -> Array:
    """Points (N, 2) every :data:`SPACING_M` along the waypoints, with rounded corners."""
    corners = np.asarray(waypoints, dtype=np.float64)
    at = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(corners, axis=0), axis=1))])
    even = np.arange(0.0, at[-1], SPACING_M)
    line = np.stack([np.interp(even, at, corners[:, k]) for k in range(2)], axis=1)
    # Mirrored through its ends, so that they stay where they are.
    half = min(len(line) - 1, round(4 * corner_radius / SPACING_M))
    padded = np.pad(line, ((half, half), (0, 0)), mode="reflect", reflect_type="odd")
    smooth = gaussian_filter1d(padded, corner_radius / SPACING_M, axis=0)
    return np.asarray(smooth[half : half + len(line)])


def walk(
    waypoints: Sequence[tuple[float, float]],
    rng: np.random.Generator,
    gait: Gait | None = None,
    *,
    fps: float = 10.0,
    wander: float = 0.0,
) -> Trajectory:
    """Walk along waypoints (x, y) on a level floor at z = 0.

    Args:
        rng: draws the phases of the steps, the hand's motion and the wandering.
        wander: metres to the side that the walker strays at most from the smoothed waypoints.
    """
    gait = gait or Gait()
    path = smooth_path(waypoints, gait.corner_radius)
    if wander > 0.0:
        path = path + _wander(path, wander, rng)
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
    direction = np.unwrap(np.arctan2(*np.gradient(path, axis=0).T[::-1]))
    turning = gaussian_filter1d(np.abs(np.gradient(direction, arc)), 0.3 / SPACING_M)
    speed = gait.speed * (1.0 - gait.turn_slowdown * np.clip(turning / 1.2, 0.0, 1.0))
    clock = np.concatenate([[0.0], np.cumsum(np.diff(arc) / (0.5 * (speed[1:] + speed[:-1])))])
    times = np.arange(0.0, clock[-1], 1.0 / fps)
    walked = np.interp(times, clock, arc)
    centre = np.stack([np.interp(walked, arc, path[:, k]) for k in range(2)], axis=1)
    heading = gaussian_filter1d(np.interp(walked + gait.look_ahead / 2, arc, direction), 0.2 * fps)
    course = np.interp(walked, arc, direction)
    left = np.stack([-np.sin(course), np.cos(course)], axis=1)
    phase = rng.uniform(0.0, 2.0 * np.pi, size=3)
    step = 2.0 * np.pi * gait.step_rate * times
    centre = centre + left * (gait.sway * np.sin(step / 2 + phase[0]))[:, None]
    height = gait.height + gait.bob * np.sin(step + phase[1])
    hand: Array = gaussian_filter1d(rng.normal(size=(3, len(times))), 0.5 * fps, axis=1)
    hand *= gait.shake / np.maximum(hand.std(axis=1, keepdims=True), 1e-9)
    pitch = gait.pitch + hand[0] + 0.006 * np.sin(step + phase[2])
    roll = hand[1] + 0.010 * np.sin(step / 2 + phase[0])
    poses = tuple(
        Pose(level_rotation(heading[i] + hand[2, i], pitch[i], roll[i]), np.append(centre[i], height[i]))
        for i in range(len(times))
    )
    return Trajectory(fps, poses, float(walked[-1] - walked[0]))


def _wander(path: Array, most: float, rng: np.random.Generator) -> Array:
    """A smooth sideways displacement (N, 2) of at most ``most`` metres."""
    slow: Array = gaussian_filter1d(rng.normal(size=len(path)), 1.5 / SPACING_M, mode="reflect")
    slow *= most / np.abs(slow).max()
    ahead = np.gradient(path, axis=0)
    ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
    return np.asarray(np.stack([-ahead[:, 1], ahead[:, 0]], axis=1) * slow[:, None])
