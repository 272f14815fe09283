"""The final adjustment: a disturbed map is put right, and what cannot be is dropped."""

from __future__ import annotations

import numpy as np

from client_sim.synthetic.cameras import Pose, level_rotation
from server.geometry.poses import SE3, align_similarity
from server.mapping.global_refinement import refine_globally
from server.mapping.working_map import WorkingMap
from tests.mapping.drifting_maps import looks, no_drift, walked_map


def _map(seed: int) -> tuple[WorkingMap, list[Pose]]:
    """Three metres sideways along a wall of points."""
    rng = np.random.default_rng(seed)
    poses = [Pose(level_rotation(np.pi / 2), np.array([x, 0.0, 0.0])) for x in np.arange(0.0, 3.0, 0.25)]
    points = np.column_stack(
        [rng.uniform(-2, 5, 500), rng.uniform(2.5, 5.0, 500), rng.uniform(-1.5, 1.5, 500)]
    )
    return walked_map(poses, points, looks(500, rng), no_drift, rng), poses


def _disturb(working: WorkingMap, rng: np.random.Generator) -> None:
    for kf in working.keyframes:
        kf.camera_from_world = SE3.exp(rng.normal(scale=0.01, size=6)) @ kf.camera_from_world
    working.position += rng.normal(scale=0.05, size=working.position.shape)


def _error(working: WorkingMap, poses: list[Pose]) -> float:
    truth = np.stack([pose.position for pose in poses])
    centres = np.stack([kf.centre for kf in working.keyframes])
    return float(np.linalg.norm(align_similarity(truth, centres) @ centres - truth, axis=1).max())


def test_a_disturbed_map_is_put_right() -> None:
    working, poses = _map(1)
    _disturb(working, np.random.default_rng(2))
    before, landmarks = _error(working, poses), int(working.alive.sum())
    refine_globally(working)
    assert before > 0.02
    assert _error(working, poses) < 0.01
    assert working.alive.sum() > 0.7 * landmarks


def test_landmarks_behind_their_cameras_are_dropped() -> None:
    """A part of a walk that was joined by dead reckoning alone has some."""
    working, poses = _map(3)
    behind = np.flatnonzero(working.alive)[::10]
    working.position[behind, 1] *= -1.0
    refine_globally(working)
    assert not working.alive[behind].any()
    assert _error(working, poses) < 0.01
    for kf in working.keyframes:
        assert working.alive[kf.landmark[kf.matched]].all()
        local = kf.camera_from_world @ working.position[kf.landmark[kf.matched]]
        assert (local[:, 2] > 0).all()
