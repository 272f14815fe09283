"""Resection: the lens of a camera from views of known points, poses and lens found together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from server.geometry.absolute_pose import pose_jacobian
from server.geometry.cameras import Camera, CameraModel
from server.geometry.poses import SE3, rotation_from_vector

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False, slots=True)
class View:
    """What one picture shows of known points.

    Attributes:
        camera_from_world: its pose, roughly.
        points: (N, 3) in the world.
        pixels: (N, 2); sigmas: (N,) standard deviation of a pixel's coordinate.
    """

    camera_from_world: SE3
    points: Array
    pixels: Array
    sigmas: Array


@dataclass(frozen=True, slots=True)
class LensPrior:
    """What is known of a lens before looking.

    Attributes:
        camera: a camera with one focal length and at most one coefficient of radial distortion.
        focal_sigma: relative, of the focal length; distortion_sigma: of the coefficient.
    """

    camera: Camera
    focal_sigma: float
    distortion_sigma: float


@dataclass(frozen=True, eq=False, slots=True)
class Resection:
    """An adjusted lens.

    Attributes:
        camera: SIMPLE_RADIAL.
        poses: camera_from_world of the views.
        focal_sigma: relative standard deviation of the focal length.
    """

    camera: Camera
    poses: tuple[SE3, ...]
    focal_sigma: float


def resect(
    views: Sequence[View], prior: LensPrior, *, iterations: int = 15, gate: float = 9.0
) -> Resection | None:
    """Adjust focal length, radial distortion and the views' poses to each other.

    Gauss-Newton with Geman-McClure weights; the poses are eliminated view by view (Schur complement).

    Args:
        gate: squared normalised error at which an observation has lost half its weight.

    Returns:
        None where the views leave the lens open or contradict one another.
    """
    cx, cy = prior.camera.centre
    focal = prior.camera.focal[0]
    coefficient = (prior.camera.distortion or (0.0,))[0]
    known = np.array([np.log(focal), coefficient])
    information = np.diag([prior.focal_sigma**-2.0, prior.distortion_sigma**-2.0])
    lens = known.copy()
    rotations = [view.camera_from_world.rotation for view in views]
    translations = [view.camera_from_world.translation for view in views]
    for _ in range(iterations):
        reduced, gradient = information.copy(), information @ (lens - known)
        eliminated = []
        for view, rotation, translation in zip(views, rotations, translations, strict=True):
            local = view.points @ rotation.T + translation
            if (local[:, 2] > 1e-6).sum() < 4:
                return None
            residual, by_pose, by_lens = _rows(local, view, lens, (cx, cy), gate)
            pose_block = by_pose.T @ by_pose + 1e-9 * np.eye(6)
            coupling = by_pose.T @ by_lens
            solved = np.linalg.solve(pose_block, np.column_stack([coupling, by_pose.T @ residual]))
            reduced += by_lens.T @ by_lens - coupling.T @ solved[:, :2]
            gradient += by_lens.T @ residual - coupling.T @ solved[:, 2]
            eliminated.append(solved)
        step = np.clip(-np.linalg.solve(reduced, gradient), -0.2, 0.2)
        lens = lens + step
        for k, solved in enumerate(eliminated):
            move = -solved[:, 2] - solved[:, :2] @ step
            turn = rotation_from_vector(move[:3])
            rotations[k], translations[k] = turn @ rotations[k], turn @ translations[k] + move[3:]
        if np.abs(step).max() < 1e-5:
            break
    if not np.isfinite(lens).all():
        return None
    params = (float(np.exp(lens[0])), cx, cy, float(lens[1]))
    camera = Camera(CameraModel.SIMPLE_RADIAL, prior.camera.width, prior.camera.height, params)
    poses = tuple(SE3(r, t) for r, t in zip(rotations, translations, strict=True))
    return Resection(camera, poses, float(np.sqrt(np.linalg.inv(reduced)[0, 0])))


def _rows(
    local: Array, view: View, lens: Array, centre: tuple[float, float], gate: float
) -> tuple[Array, Array, Array]:
    """Weighted residuals (2n,) of the points in front, their derivatives (2n, 6) and (2n, 2)."""
    front = local[:, 2] > 1e-6
    local, pixels, sigmas = local[front], view.pixels[front], view.sigmas[front]
    focal, k = np.exp(lens[0]), lens[1]
    x, y, inverse = local[:, 0] / local[:, 2], local[:, 1] / local[:, 2], 1.0 / local[:, 2]
    squared = x * x + y * y
    bend = 1.0 + k * squared
    ideal = focal * np.stack([x, y], axis=1)
    offset = ideal * bend[:, None]
    residual = offset + centre - pixels
    # By the coordinates on the plane z = 1, then by the camera-frame point.
    by_x = focal * np.stack([bend + 2 * k * x * x, 2 * k * x * y], axis=1)
    by_y = focal * np.stack([2 * k * x * y, bend + 2 * k * y * y], axis=1)
    by_point = np.stack(
        [
            by_x * inverse[:, None],
            by_y * inverse[:, None],
            -(by_x * x[:, None] + by_y * y[:, None]) * inverse[:, None],
        ],
        axis=2,
    )
    by_pose = pose_jacobian(local, by_point)
    by_lens = np.stack([offset, ideal * squared[:, None]], axis=2)
    error = (residual**2).sum(axis=1) / sigmas**2
    scale = gate / (gate + error) / sigmas
    return (
        (residual * scale[:, None]).ravel(),
        (by_pose * scale[:, None, None]).reshape(-1, 6),
        (by_lens * scale[:, None, None]).reshape(-1, 2),
    )
