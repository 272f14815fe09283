"""Small true walks and the maps a perfect builder would make of them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from server.evaluation.follower import AnsweredFrame
from server.evaluation.leader import BuildFigures
from server.evaluation.walk import Trajectory, Walk
from server.geometry.cameras import Camera
from server.geometry.poses import SE3, Sim3, quaternion_from_rotation
from server.mapping.outcome import BuildReport, BuildStatus
from server.mapping.route_map import Keyframes, Landmarks, Observations, RouteMap, RoutePath, Scale
from server.navigation.updates import (
    Fix,
    Guidance,
    Instruction,
    NavigationState,
    Refusal,
    RefusalReason,
    Update,
)

Array = NDArray[np.float64]
CAMERA = Camera.pinhole(640, 480, 500.0, 500.0, 320.0, 240.0)


def looking(forward: Array) -> Array:
    """World_from_camera rotations (N, 3, 3) of level cameras looking along forward (N, 3), z up."""
    z = forward / np.linalg.norm(forward, axis=1, keepdims=True)
    x = np.cross(z, [0.0, 0.0, 1.0])
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    return np.stack([x, np.cross(z, x), z], axis=2)


def l_shape(*, side: float = 0.0, seed: int = 1, step: float = 0.11) -> Trajectory:
    """10 m along x, then a left turn of 1 m radius, then 8 m along y; ``side`` metres to the left."""
    arc = np.arange(0.0, 10.0 + np.pi / 2 + 8.0, step)
    angle = np.clip(arc - 10.0, 0.0, np.pi / 2)
    x = np.minimum(arc, 10.0) + np.sin(angle)
    y = 1.0 - np.cos(angle) + np.maximum(arc - 10.0 - np.pi / 2, 0.0)
    forward = np.stack([np.cos(angle), np.sin(angle), np.zeros_like(arc)], axis=1)
    left = np.stack([-forward[:, 1], forward[:, 0], forward[:, 2]], axis=1)
    position = np.stack([x, y, np.full_like(arc, 1.5)], axis=1) + side * left
    # A camera in the hand pitches and sways; a truth without it hides errors of convention.
    sway = np.random.default_rng(seed).normal(scale=0.03, size=(len(arc), 3))
    return Trajectory(0.1 * np.arange(len(arc)), looking(forward + sway), position)


def walk_of(truth: Trajectory, name: str = "leader", **properties: object) -> Walk:
    """A walk without pictures."""
    return Walk(folder=Path(name), camera=CAMERA, truth=truth, world="lab", **properties)  # type: ignore[arg-type]


def map_of(path: Trajectory, *, every: int = 5, tracked: NDArray[np.bool_] | None = None) -> RouteMap:
    """A route map with this path, a keyframe every few frames and no landmarks."""
    rows = np.arange(0, len(path), every, dtype=np.int32)
    quaternion = quaternion_from_rotation(path.rotation)
    steps = np.linalg.norm(np.diff(path.position, axis=0), axis=1)
    return RouteMap(
        camera=CAMERA,
        keyframes=Keyframes(rows, quaternion[rows], path.position[rows]),
        landmarks=Landmarks(
            np.zeros((0, 3)),
            np.zeros((0, 32), np.uint8),
            np.zeros((0, 3), np.float32),
            np.zeros((0, 2), np.float32),
            np.zeros(0, np.int8),
        ),
        observations=Observations(
            np.zeros(len(rows) + 1, np.int64),
            np.zeros(0, np.int32),
            np.zeros((0, 2), np.float32),
            np.zeros(0, np.int8),
            np.zeros((0, 32), np.uint8),
        ),
        path=RoutePath(
            path.time,
            quaternion,
            path.position,
            np.ones(len(path), np.bool_) if tracked is None else tracked,
            np.concatenate([[0.0], np.cumsum(steps)]),
        ),
        turns=(),
        scale=Scale(),
    )


def figures(frames: int) -> BuildFigures:
    """A build that used all frames."""
    report = BuildReport(frames=frames, tracked_frames=frames, video_seconds=0.1 * frames)
    return BuildFigures(BuildStatus.READY, "", report, 1.0, 1, 1)


def into_map(truth: Trajectory, map_from_world: Sim3) -> Trajectory:
    """What a perfect estimator says in a map of another frame and unit."""
    return Trajectory(truth.time, map_from_world.rotation @ truth.rotation, map_from_world @ truth.position)


def guidance(instruction: Instruction, bearing: float = 0.0) -> Guidance:
    """A hint and nothing else."""
    return Guidance(0.5, None, None, 1.0, instruction, bearing, None)


def answers_of(
    poses: Trajectory, *, refused: Sequence[int] = (), hints: Sequence[Guidance | None] | None = None
) -> list[AnsweredFrame]:
    """One answer a pose of the map, refusals where wanted."""
    answers = []
    for row in range(len(poses)):
        fix = Fix(SE3(poses.rotation[row], poses.position[row]), np.eye(6), 50, 60, 0)
        refusal = Refusal(RefusalReason.TOO_FEW_INLIERS) if row in refused else None
        update = Update(
            row,
            float(poses.time[row]),
            NavigationState.ON_ROUTE,
            None if refusal else fix,
            refusal,
            None if hints is None else hints[row],
        )
        answers.append(AnsweredFrame(row, update, 10.0 + row % 3))
    return answers
