"""Where the map lies in the truth: one global similarity, and a local one around each keyframe.

A route guides by what is near, so a follower is judged by the map's neighbourhood, not by how far
the whole map has bent: each keyframe has its own ``truth_from_map``, fitted to the leader's keyframes
within some metres of path.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from server.evaluation.walk import Trajectory, arc_length
from server.geometry.poses import SE3, Sim3, align_similarity

Array = NDArray[np.float64]

LOCAL_PATH_M = 5.0
"""Keyframes within this length of the leader's true path take part in a local alignment."""

MIN_LOCAL_KEYFRAMES = 3
"""A local alignment reaches further where fewer keyframes than this lie within :data:`LOCAL_PATH_M`."""

SAME_HEADING_RADIANS = np.radians(30.0)
"""Difference in heading that weighs as much as one metre when the nearest keyframe is looked for."""


def mean_rotation(rotations: Array) -> Array:
    """Chordal L2 mean of rotations (N, 3, 3) -> (3, 3).

    Hartley, Trumpf, Dai, Li, "Rotation averaging" (2013), section 5.3.

    Raises:
        ValueError: there are none.
    """
    if len(rotations) == 0:
        raise ValueError("no rotations to average")
    u, _, vt = np.linalg.svd(rotations.mean(axis=0))
    return np.asarray(u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))]) @ vt)


def similarity_with_rotation(
    target: Array, source: Array, rotation: Array, *, fallback_scale: float = 1.0
) -> Sim3:
    """Least-squares scale and translation of ``target_from_source`` for a given rotation.

    Args:
        target, source: paired points (N, 3), N >= 1.
        rotation: (3, 3) target_from_source.
        fallback_scale: taken where the points do not determine one (all in one place).
    """
    mean_target, mean_source = target.mean(axis=0), source.mean(axis=0)
    turned = (source - mean_source) @ rotation.T
    spread = float((turned**2).sum())
    scale = float((turned * (target - mean_target)).sum()) / spread if spread > 1e-12 else 0.0
    if scale <= 0.0:
        scale = fallback_scale
    return Sim3(scale, rotation, mean_target - scale * rotation @ mean_source)


@dataclass(frozen=True, eq=False, slots=True)
class RouteAlignment:
    """The leader's map against the leader's truth.

    Attributes:
        whole: ``truth_from_map`` of the whole walk.
        keyframes: the map's keyframes, map frame and unit.
        keyframe_truth: their true poses, metres.
        local: ``truth_from_map`` around each keyframe.
    """

    whole: Sim3
    keyframes: Trajectory
    keyframe_truth: Trajectory
    local: tuple[Sim3, ...]

    def nearest_keyframe(self, world_from_camera: SE3) -> int:
        """Keyframe nearest to a pose in the map, by distance and heading, as it guides the follower.

        The heading tells a way out from the way back through the same place.
        """
        metres = self.whole.scale * np.linalg.norm(
            self.keyframes.position - world_from_camera.translation, axis=1
        )
        forward = self.keyframes.rotation[:, :, 2] @ world_from_camera.rotation[:, 2]
        angle = np.arccos(np.clip(forward, -1.0, 1.0))
        return int(np.argmin(metres**2 + (angle / SAME_HEADING_RADIANS) ** 2))

    def relative_to_route(self, world_from_camera: SE3) -> SE3:
        """A pose in the map -> where it says the camera is in the truth's world, by the route near it."""
        return self.local[self.nearest_keyframe(world_from_camera)].transform_pose(world_from_camera)


def align_route(
    path: Trajectory, path_truth: Trajectory, keyframe_rows: NDArray[np.integer]
) -> RouteAlignment:
    """Align a leader's estimated path (map frame) with its truth, row by row.

    Args:
        path, path_truth: the same frames, estimated and true.
        keyframe_rows: (K,) rows of the keyframes.

    Raises:
        ValueError: fewer than three frames, or all in one place.
    """
    whole = align_similarity(path_truth.position, path.position)
    rows = np.asarray(keyframe_rows, dtype=np.int64)
    keyframes, truth = path[rows], path_truth[rows]
    walked = arc_length(path_truth.position)[rows]
    turn = truth.rotation @ keyframes.rotation.transpose(0, 2, 1)
    local = []
    for k in range(len(rows)):
        away = np.abs(walked - walked[k])
        near = away <= LOCAL_PATH_M
        if near.sum() < MIN_LOCAL_KEYFRAMES:
            near = away <= np.sort(away)[min(MIN_LOCAL_KEYFRAMES, len(away)) - 1]
        local.append(
            similarity_with_rotation(
                truth.position[near],
                keyframes.position[near],
                mean_rotation(turn[near]),
                fallback_scale=whole.scale,
            )
        )
    return RouteAlignment(whole, keyframes, truth, tuple(local))
