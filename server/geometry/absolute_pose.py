"""Absolute pose from 2D-3D correspondences: robust estimation, refinement and covariance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import poselib
from numpy.typing import NDArray

from server.geometry.cameras import Camera
from server.geometry.poses import (
    SE3,
    quaternion_from_rotation,
    rotation_from_quaternion,
    rotation_from_vector,
    vector_from_rotation,
)

Array = NDArray[np.float64]

CHI2_2DOF_95 = 5.991
"""95 % quantile of the squared length of a standard normal 2-vector."""


@dataclass(frozen=True, eq=False, slots=True)
class PoseEstimate:
    """A camera pose and what it rests on.

    Attributes:
        camera_from_world: the pose.
        inliers: (N,) bool, correspondences that agree with it.
        covariance: (6, 6) of (rotation vector in the camera frame, camera centre in the world).
    """

    camera_from_world: SE3
    inliers: NDArray[np.bool_]
    covariance: Array


def ransac_pose(
    points: Array,
    pixels: Array,
    camera: Camera,
    *,
    max_error: float,
    seed: int = 0,
    max_iterations: int = 1000,
    initial: SE3 | None = None,
) -> tuple[SE3, NDArray[np.bool_]] | None:
    """LO-RANSAC PnP (poselib) -> camera_from_world and the inlier mask (N,), or None.

    Args:
        points: (N, 3) in the world.
        pixels: (N, 2) in the image of ``camera``.
        max_error: greatest reprojection error of an inlier, pixels.
        initial: a pose to be tried first.
    """
    if len(points) < 4:
        return None
    prior = None
    if initial is not None:
        q = initial.quaternion
        prior = poselib.CameraPose()
        prior.q = np.r_[q[3], q[:3]]
        prior.t = initial.translation
    description = {
        "model": str(camera.model),
        "width": camera.width,
        "height": camera.height,
        "params": list(camera.params),
    }
    options = {
        "max_reproj_error": max_error,
        "max_error": max_error,
        "max_iterations": max_iterations,
        "min_iterations": 50,
        "seed": seed,
    }
    pose, info = poselib.estimate_absolute_pose(
        np.ascontiguousarray(pixels), np.ascontiguousarray(points), description, options, {}, prior
    )
    inliers = np.asarray(info["inliers"], dtype=bool)
    if inliers.sum() < 4 or not np.isfinite(pose.t).all():
        return None
    w, x, y, z = pose.q
    return SE3(rotation_from_quaternion([x, y, z, w]), np.asarray(pose.t, dtype=np.float64)), inliers


def projection_jacobian(points: Array, camera: Camera) -> tuple[Array, Array]:
    """Pixels (N, 2) of camera-frame points (N, 3) and their derivative (N, 2, 3), pinhole camera."""
    fx, fy = camera.focal
    cx, cy = camera.centre
    inverse = 1.0 / points[:, 2]
    x, y = points[:, 0] * inverse, points[:, 1] * inverse
    pixels = np.stack([fx * x + cx, fy * y + cy], axis=1)
    jacobian = np.zeros((len(points), 2, 3))
    jacobian[:, 0, 0] = fx * inverse
    jacobian[:, 0, 2] = -fx * x * inverse
    jacobian[:, 1, 1] = fy * inverse
    jacobian[:, 1, 2] = -fy * y * inverse
    return pixels, jacobian


def pose_jacobian(points: Array, jacobian: Array) -> Array:
    """Derivative (N, 2, 6) of the pixels by a left perturbation (rotation, translation) of the pose.

    Args:
        points: (N, 3) in the camera frame.
        jacobian: (N, 2, 3) derivative of the pixels by the camera-frame points.
    """
    x, y, z = points[:, 0, None], points[:, 1, None], points[:, 2, None]
    a, b, c = jacobian[:, :, 0], jacobian[:, :, 1], jacobian[:, :, 2]
    # d(exp(w) x)/dw = -[x]_x, so a row j of the jacobian gives -(j [x]_x) = x cross j.
    return np.stack([y * c - z * b, z * a - x * c, x * b - y * a, a, b, c], axis=2)


@dataclass(frozen=True, eq=False, slots=True)
class PosePrior:
    """What is known of a pose before looking.

    Attributes:
        camera_from_world: the expected pose.
        rotation_sigma: radians; translation_sigma: units of the world; both in the camera frame.
    """

    camera_from_world: SE3
    rotation_sigma: float
    translation_sigma: float

    def information(self) -> Array:
        """(6,) inverse variances of a left perturbation."""
        return np.repeat([self.rotation_sigma, self.translation_sigma], 3) ** -2.0

    def offset(self, rotation: Array, translation: Array) -> Array:
        """(6,) left perturbation that leads from the expected pose to the given one."""
        turn = rotation @ self.camera_from_world.rotation.T
        shift = translation - turn @ self.camera_from_world.translation
        return np.concatenate([vector_from_rotation(turn), shift])


def refine_pose(
    camera_from_world: SE3,
    points: Array,
    pixels: Array,
    sigmas: Array,
    camera: Camera,
    *,
    point_covariances: Array | None = None,
    prior: PosePrior | None = None,
    anneal: tuple[float, ...] = (1.0,),
    iterations: int = 8,
    gate: float = CHI2_2DOF_95,
) -> PoseEstimate | None:
    """Robust Gauss-Newton on the reprojection error; None if fewer than four inliers remain.

    Correspondences are weighted by Geman-McClure, whose influence dies out beyond the gate, so a
    wrong match that looks right to RANSAC does not pull the pose.

    Args:
        points: (N, 3) in the world; pixels: (N, 2).
        sigmas: (N,) standard deviation of a pixel coordinate.
        point_covariances: (N, 3, 3) of the points. A point whose depth is hardly known still tells
            the direction it was seen in; with its covariance it is trusted for that and no more.
        prior: decides where the pixels leave the pose open, as a plane seen twice does.
        anneal: factors by which the gate is widened, stage after stage, for a start that is some way off.
        gate: squared normalised error up to which a correspondence is an inlier.
    """
    rotation, translation = camera_from_world.rotation, camera_from_world.translation
    for stage, factor in enumerate(anneal):
        close_enough = 1e-5 if stage == len(anneal) - 1 else 1e-3
        for _ in range(iterations):
            local = points @ rotation.T + translation
            front = local[:, 2] > 1e-6
            if front.sum() < 4:
                return None
            residual, jacobian = _whitened(local, rotation, pixels, sigmas, camera, point_covariances, front)
            squared = np.einsum("ij,ij->i", residual, residual)
            width = gate * factor**2
            weights = np.repeat((width / (width + squared)) ** 2, 2)
            rows = jacobian.reshape(-1, 6)
            weighted = rows * weights[:, None]
            information, gradient = weighted.T @ rows, weighted.T @ residual.ravel()
            if prior is not None:
                information += np.diag(prior.information())
                gradient += prior.information() * prior.offset(rotation, translation)
            step = -np.linalg.solve(information + 1e-9 * np.diag(np.diag(information) + 1e-12), gradient)
            turn = rotation_from_vector(step[:3])
            rotation, translation = turn @ rotation, turn @ translation + step[3:]
            if np.abs(step).max() < close_enough:
                break
    # Rounding is amplified by whoever extrapolates a pose from the last ones: what goes out is a rotation.
    rotation = rotation_from_quaternion(quaternion_from_rotation(rotation))
    local = points @ rotation.T + translation
    front = local[:, 2] > 1e-6
    residual, jacobian = _whitened(local, rotation, pixels, sigmas, camera, point_covariances, front)
    squared = np.full(len(points), np.inf)
    squared[front] = (residual**2).sum(axis=1)
    inliers = squared <= gate
    if inliers.sum() < 4:
        return None
    rows = jacobian[inliers[front]].reshape(-1, 6)
    information = rows.T @ rows
    if prior is not None:
        information += np.diag(prior.information())
    covariance = np.linalg.pinv(information, hermitian=True)
    # A left perturbation (w, v) of camera_from_world turns the camera by -w in its own frame and
    # moves its centre by -R^T v in the world.
    change = np.zeros((6, 6))
    change[:3, :3] = -np.eye(3)
    change[3:, 3:] = -rotation.T
    return PoseEstimate(SE3(rotation, translation), inliers, change @ covariance @ change.T)


def _whitened(
    local: Array,
    rotation: Array,
    pixels: Array,
    sigmas: Array,
    camera: Camera,
    point_covariances: Array | None,
    front: NDArray[np.bool_],
) -> tuple[Array, Array]:
    """Residuals (n, 2) of the n points in front and their derivative (n, 2, 6) by the pose, whitened.

    A point's own error is part of its pixel's; the direction in which a ray is free turns with the
    pose, so this is done anew for every pose.
    """
    predicted, by_point = projection_jacobian(local[front], camera)
    residual, by_pose = predicted - pixels[front], pose_jacobian(local[front], by_point)
    if point_covariances is None:
        weight = 1.0 / sigmas[front]
        return residual * weight[:, None], by_pose * weight[:, None, None]
    by_world = by_point @ rotation
    covariance = by_world @ point_covariances[front] @ by_world.transpose(0, 2, 1)
    # Cholesky factor of the inverse of a 2 x 2 matrix [[a, b], [b, c]].
    variance = sigmas[front] ** 2
    a, b, c = covariance[:, 0, 0] + variance, covariance[:, 0, 1], covariance[:, 1, 1] + variance
    first = 1.0 / np.sqrt(a)
    second = np.sqrt(a / np.maximum(a * c - b * b, 1e-12 * a * c))
    mixed = -b / a * second
    residual = np.stack([first * residual[:, 0], mixed * residual[:, 0] + second * residual[:, 1]], axis=1)
    upper, lower = by_pose[:, 0], by_pose[:, 1]
    by_pose = np.stack([first[:, None] * upper, mixed[:, None] * upper + second[:, None] * lower], axis=1)
    return residual, by_pose
