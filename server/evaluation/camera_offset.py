"""The constant offset between the camera that filmed and the camera the truth is of.

Some recordings have the poses of a depth camera mounted beside the colour camera. The offset is
estimated once, over the leader's walk, and applied to the truth of leader and follower alike.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from server.evaluation.alignment import mean_rotation
from server.evaluation.walk import Trajectory
from server.geometry.poses import SE3, Sim3, align_similarity, skew

Array = NDArray[np.float64]

MAX_TRANSLATION_M = 0.1
"""Two cameras of one device are not further apart; a larger estimate is drift in disguise."""

MAX_TRANSLATION_SIGMA_M = 0.01
"""An estimated translation is used only if it is known this well on every axis."""

CORRELATED_FRAMES = 10
"""Neighbouring frames share their error: so many of them count as one observation."""


def apply_offset(truth: Trajectory, truth_from_filming: SE3) -> Trajectory:
    """Poses of the truth's camera -> poses of the filming camera."""
    return Trajectory(
        truth.time,
        truth.rotation @ truth_from_filming.rotation,
        truth.position + truth.rotation @ truth_from_filming.translation,
    )


def estimate_offset(estimate: Trajectory, truth: Trajectory, *, rounds: int = 5) -> SE3:
    """Motion ``truth_camera_from_filming_camera`` that best explains a leader's walk.

    The rotation is the mean of ``truth^T R estimate`` under the similarity of the positions. The
    translation is a least-squares fit together with that similarity, and zero if the walk's
    rotations do not determine it (:data:`MAX_TRANSLATION_SIGMA_M`) or it is absurd.

    Args:
        estimate, truth: the same N >= 3 frames, in the map's frame and in the world.

    Raises:
        ValueError: too few frames or all in one place.
    """
    offset = SE3.identity()
    alignment = align_similarity(truth.position, estimate.position)
    for _ in range(rounds):
        rotation = mean_rotation(truth.rotation.transpose(0, 2, 1) @ (alignment.rotation @ estimate.rotation))
        translation = _translation(alignment, estimate, truth)
        offset = SE3(rotation, translation)
        alignment = align_similarity(apply_offset(truth, offset).position, estimate.position)
    return offset


def _translation(alignment: Sim3, estimate: Trajectory, truth: Trajectory) -> Array:
    """Translation of the offset, (3,) metres, zero where it is not determined.

    One Gauss-Newton step from the current similarity in (translation of the offset; rotation,
    log-scale and translation of the similarity): ``truth + R_truth t = s R x + t_s``.
    """
    turned = alignment.scale * estimate.position @ alignment.rotation.T
    residual = turned + alignment.translation - truth.position
    count = len(truth)
    jacobian = np.zeros((count, 3, 10))
    jacobian[:, :, 0:3] = truth.rotation
    jacobian[:, :, 3:6] = skew(turned)
    jacobian[:, :, 6] = -turned
    jacobian[:, :, 7:10] = -np.eye(3)
    flat = jacobian.reshape(-1, 10)
    solution, _, rank, _ = np.linalg.lstsq(flat, residual.reshape(-1), rcond=1e-9)
    if rank < 10:
        return np.zeros(3)
    left = flat @ solution - residual.reshape(-1)
    variance = float(left @ left) / max(1, 3 * count - 10)
    covariance = variance * np.linalg.inv(flat.T @ flat) * CORRELATED_FRAMES
    sigma = np.sqrt(np.diag(covariance)[:3])
    translation = np.asarray(solution[:3])
    if (sigma > MAX_TRANSLATION_SIGMA_M).any() or np.linalg.norm(translation) > MAX_TRANSLATION_M:
        return np.zeros(3)
    return translation
