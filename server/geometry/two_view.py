"""Relative pose of two views, by an essential matrix or a homography, whichever explains them.

Model selection after Mur-Artal, Montiel, Tardós, "ORB-SLAM: a versatile and accurate monocular
SLAM system" (2015), section IV: a plane is better explained by a homography, whose decomposition
is then tried; a scene of depth by an essential matrix.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
import poselib
from numpy.typing import NDArray

from server.geometry.cameras import Camera
from server.geometry.poses import SE3, rotation_from_quaternion, skew
from server.geometry.triangulation import parallax, triangulate

Array = NDArray[np.float64]


class TwoViewModel(StrEnum):
    """Which model explained the pair."""

    ESSENTIAL = "essential"
    HOMOGRAPHY = "homography"


@dataclass(frozen=True, slots=True)
class TwoViewOptions:
    """Settings of :func:`relative_pose`.

    Attributes:
        max_error: inlier threshold, pixels.
        homography_ratio: share of the summed scores from which the homography is taken.
        min_parallax: median angle at the points below which there is no depth, radians.
        min_points: points that must be triangulated well.
        ambiguity: the second best motion may support at most this share of the best one's points.
    """

    max_error: float = 2.0
    homography_ratio: float = 0.45
    min_parallax: float = float(np.deg2rad(1.2))
    min_points: int = 60
    ambiguity: float = 0.75


@dataclass(frozen=True, eq=False, slots=True)
class TwoView:
    """A resolved pair.

    Attributes:
        b_from_a: the motion; its translation has length one.
        points: (N, 3) in frame a; valid: (N,) bool, which of the input pairs were triangulated well.
        parallax: median angle at the valid points, radians.
    """

    model: TwoViewModel
    b_from_a: SE3
    points: Array
    valid: NDArray[np.bool_]
    parallax: float


def relative_pose(
    pixels_a: Array, pixels_b: Array, camera: Camera, options: TwoViewOptions, *, seed: int = 0
) -> TwoView | None:
    """Relative pose from matched pixels (N, 2) of a pinhole camera, or None if it is not determined."""
    if len(pixels_a) < options.min_points:
        return None
    fx, fy = camera.focal
    max_error = options.max_error / np.sqrt(fx * fy)
    rays_a, rays_b = camera.normalize(pixels_a), camera.normalize(pixels_b)
    unit = {"model": "PINHOLE", "width": 2, "height": 2, "params": [1.0, 1.0, 0.0, 0.0]}
    ransac = {
        "max_epipolar_error": max_error,
        "max_reproj_error": max_error,
        "max_error": max_error,
        "seed": seed,
    }
    pose, _ = poselib.estimate_relative_pose(rays_a, rays_b, unit, unit, ransac, {})
    homography, _ = poselib.estimate_homography(rays_a, rays_b, ransac, {})
    w, x, y, z = pose.q
    essential_motion = SE3(rotation_from_quaternion([x, y, z, w]), np.asarray(pose.t, dtype=np.float64))
    score_e = _essential_score(essential_motion, rays_a, rays_b, max_error)
    score_h = _homography_score(homography, rays_a, rays_b, max_error)
    if score_e + score_h <= 0:
        return None
    if score_h / (score_e + score_h) > options.homography_ratio:
        model = TwoViewModel.HOMOGRAPHY
        candidates = [
            SE3(np.asarray(p.R, dtype=np.float64), np.asarray(p.t, dtype=np.float64))
            for p in poselib.motion_from_homography(homography)[0]
        ]
        candidates.append(essential_motion)
    else:
        model, candidates = TwoViewModel.ESSENTIAL, [essential_motion]
    best: TwoView | None = None
    counts = []
    for motion in candidates:
        norm = float(np.linalg.norm(motion.translation))
        if norm < 1e-9:
            continue
        scaled = SE3(motion.rotation, motion.translation / norm)
        view = _triangulated(model, scaled, rays_a, rays_b, max_error)
        counts.append((int(view.valid.sum()), scaled))
        if best is None or view.valid.sum() > best.valid.sum():
            best = view
    if best is None or best.valid.sum() < options.min_points or best.parallax < options.min_parallax:
        return None
    for count, motion in counts:
        apart = motion.angle_to(best.b_from_a) > 0.02 or (
            float(motion.translation @ best.b_from_a.translation) < 0.98
        )
        if apart and count > options.ambiguity * best.valid.sum():
            return None
    return best


def rotation_between(rays_a: Array, rays_b: Array, *, rounds: int = 3) -> Array:
    """The rotation (3, 3) that best turns rays (N, 2) of view a into those of view b, as if all were far.

    Wahba's problem by Kabsch's solution, with the weight of what does not turn along (near things,
    wrong pairs) falling off from round to round. The identity for fewer than five pairs.
    """
    if len(rays_a) < 5:
        return np.eye(3)
    a = np.column_stack([rays_a, np.ones(len(rays_a))])
    b = np.column_stack([rays_b, np.ones(len(rays_b))])
    a /= np.linalg.norm(a, axis=1, keepdims=True)
    b /= np.linalg.norm(b, axis=1, keepdims=True)
    weights = np.ones(len(a))
    rotation = np.eye(3)
    for _ in range(rounds):
        u, _, vt = np.linalg.svd((b * weights[:, None]).T @ a)
        rotation = u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))]) @ vt
        error = np.linalg.norm(b - a @ rotation.T, axis=1)
        scale = max(float(np.median(error)), 1e-6)
        weights = 1.0 / (1.0 + (error / scale) ** 2)
    return np.asarray(rotation)


def _triangulated(
    model: TwoViewModel, b_from_a: SE3, rays_a: Array, rays_b: Array, max_error: float
) -> TwoView:
    points = triangulate(SE3.identity(), b_from_a, rays_a, rays_b)
    local = b_from_a @ points
    front = (points[:, 2] > 1e-3) & (local[:, 2] > 1e-3) & (points[:, 2] < 1e3)
    error = np.full(len(points), np.inf)
    error[front] = np.maximum(
        np.linalg.norm(points[front, :2] / points[front, 2:] - rays_a[front], axis=1),
        np.linalg.norm(local[front, :2] / local[front, 2:] - rays_b[front], axis=1),
    )
    valid = error < max_error
    angles = parallax(np.zeros(3), b_from_a.inverse().translation, points[valid])
    median = float(np.median(angles)) if len(angles) else 0.0
    return TwoView(model, b_from_a, points, valid, median)


def _essential_score(b_from_a: SE3, rays_a: Array, rays_b: Array, max_error: float) -> float:
    """Truncated symmetric epipolar score; a line has one degree of freedom."""
    essential = skew(b_from_a.translation) @ b_from_a.rotation
    homogeneous_a = np.column_stack([rays_a, np.ones(len(rays_a))])
    homogeneous_b = np.column_stack([rays_b, np.ones(len(rays_b))])
    lines_b, lines_a = homogeneous_a @ essential.T, homogeneous_b @ essential
    product = np.einsum("ij,ij->i", homogeneous_b, lines_b) ** 2
    score = 0.0
    for lines in (lines_a, lines_b):
        squared = product / np.maximum((lines[:, :2] ** 2).sum(axis=1), 1e-18) / max_error**2
        score += float(np.where(squared < 3.84 / 4, 5.99 / 4 - squared, 0.0).sum())
    return score


def _homography_score(homography: Array, rays_a: Array, rays_b: Array, max_error: float) -> float:
    """Truncated symmetric transfer score; a point has two degrees of freedom."""
    score = 0.0
    if abs(np.linalg.det(homography)) < 1e-12:
        return 0.0
    for matrix, source, target in (
        (homography, rays_a, rays_b),
        (np.linalg.inv(homography), rays_b, rays_a),
    ):
        mapped = np.column_stack([source, np.ones(len(source))]) @ matrix.T
        squared = ((mapped[:, :2] / mapped[:, 2:] - target) ** 2).sum(axis=1) / max_error**2
        score += float(np.where(squared < 5.99 / 4, 5.99 / 4 - squared, 0.0).sum())
    return score
