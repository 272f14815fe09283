"""Absolute pose from 2D-3D correspondences: robust estimation, refinement and covariance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import poselib
from numpy.typing import NDArray

from server.geometry.cameras import Camera
from server.geometry.poses import SE3, rotation_from_quaternion, rotation_from_vector, vector_from_rotation

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
    out = np.empty((len(points), 2, 6))
    # d(exp(w) x)/dw = -[x]_x, so a row j of the jacobian gives -(j [x]_x) = x cross j.
    out[:, :, :3] = np.cross(points[:, None, :], jacobian)
    out[:, :, 3:] = jacobian
    return out


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
    whitening = _whitening(camera_from_world, points, sigmas, camera, point_covariances)
    for stage in range(iterations * len(anneal)):
        width = gate * anneal[stage // iterations] ** 2
        local = points @ rotation.T + translation
        front = local[:, 2] > 1e-6
        if front.sum() < 4:
            return None
        if point_covariances is not None:
            # The direction in which a ray is free turns with the pose.
            whitening = _whitening(SE3(rotation, translation), points, sigmas, camera, point_covariances)
        predicted, jacobian = projection_jacobian(local[front], camera)
        residual = np.einsum("nij,nj->ni", whitening[front], predicted - pixels[front])
        squared = np.einsum("ij,ij->i", residual, residual)
        weights = (width / (width + squared)) ** 2
        j = whitening[front] @ pose_jacobian(local[front], jacobian)
        weighted = j * weights[:, None, None]
        information = np.einsum("nki,nkj->ij", weighted, j)
        gradient = np.einsum("nki,nk->i", weighted, residual)
        if prior is not None:
            information += np.diag(prior.information())
            gradient += prior.information() * prior.offset(rotation, translation)
        step = -np.linalg.solve(information + 1e-9 * np.diag(np.diag(information) + 1e-12), gradient)
        turn = rotation_from_vector(step[:3])
        rotation, translation = turn @ rotation, turn @ translation + step[3:]
        if np.abs(step).max() < 1e-7 and stage >= iterations * (len(anneal) - 1):
            break
    local = points @ rotation.T + translation
    front = local[:, 2] > 1e-6
    squared = np.full(len(points), np.inf)
    residual = np.einsum("nij,nj->ni", whitening[front], camera.project(local[front]) - pixels[front])
    squared[front] = (residual**2).sum(axis=1)
    inliers = squared <= gate
    if inliers.sum() < 4:
        return None
    _, jacobian = projection_jacobian(local[inliers], camera)
    j = whitening[inliers] @ pose_jacobian(local[inliers], jacobian)
    information = np.einsum("nki,nkj->ij", j, j)
    if prior is not None:
        information += np.diag(prior.information())
    covariance = np.linalg.pinv(information, hermitian=True)
    # A left perturbation (w, v) of camera_from_world turns the camera by -w in its own frame and
    # moves its centre by -R^T v in the world.
    change = np.zeros((6, 6))
    change[:3, :3] = -np.eye(3)
    change[3:, 3:] = -rotation.T
    return PoseEstimate(SE3(rotation, translation), inliers, change @ covariance @ change.T)


def _whitening(
    camera_from_world: SE3,
    points: Array,
    sigmas: Array,
    camera: Camera,
    point_covariances: Array | None,
) -> Array:
    """(N, 2, 2) matrices W with W^T W the information of a pixel, the point's own error included."""
    if point_covariances is None:
        return np.eye(2) / sigmas[:, None, None]
    local = camera_from_world @ points
    local[:, 2] = np.maximum(local[:, 2], 1e-6)
    _, jacobian = projection_jacobian(local, camera)
    jacobian = jacobian @ camera_from_world.rotation
    covariance = np.einsum("nik,nkl,njl->nij", jacobian, point_covariances, jacobian, optimize=True)
    covariance += (sigmas**2)[:, None, None] * np.eye(2)
    # Cholesky factor of the inverse of a 2 x 2 matrix [[a, b], [b, c]].
    a, b, c = covariance[:, 0, 0], covariance[:, 0, 1], covariance[:, 1, 1]
    out = np.zeros((len(points), 2, 2))
    out[:, 0, 0] = 1.0 / np.sqrt(a)
    out[:, 1, 1] = np.sqrt(a / np.maximum(a * c - b * b, 1e-12 * a * c))
    out[:, 1, 0] = -b / a * out[:, 1, 1]
    return out
