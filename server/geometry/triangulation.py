"""Triangulation of points seen by two cameras."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from server.geometry.poses import SE3

Array = NDArray[np.float64]


def triangulate(
    a_from_world: SE3, b_from_world: SE3, rays_a: Array, rays_b: Array, *, iterations: int = 3
) -> Array:
    """Points (N, 3) in the world from normalised coordinates (N, 2) in two pinhole cameras.

    The midpoint of the two rays, then Gauss-Newton on the reprojection error, which is what makes
    low parallax usable: the midpoint alone is biased towards the cameras.
    Rays that do not meet give points behind a camera; check :func:`depths`.
    """
    c_a, c_b = a_from_world.inverse().translation, b_from_world.inverse().translation
    d_a = np.column_stack([rays_a, np.ones(len(rays_a))]) @ a_from_world.rotation
    d_b = np.column_stack([rays_b, np.ones(len(rays_b))]) @ b_from_world.rotation
    d_a /= np.linalg.norm(d_a, axis=1, keepdims=True)
    d_b /= np.linalg.norm(d_b, axis=1, keepdims=True)
    between = c_b - c_a
    cosine = np.einsum("ij,ij->i", d_a, d_b)
    along_a, along_b = d_a @ between, d_b @ between
    sine2 = np.maximum(1.0 - cosine**2, 1e-12)
    s = (along_a - cosine * along_b) / sine2
    t = (cosine * along_a - along_b) / sine2
    points = 0.5 * ((c_a + s[:, None] * d_a) + (c_b + t[:, None] * d_b))
    for _ in range(iterations):
        hessian = np.zeros((len(points), 3, 3))
        gradient = np.zeros((len(points), 3))
        for pose, rays in ((a_from_world, rays_a), (b_from_world, rays_b)):
            local = pose @ points
            depth = np.where(np.abs(local[:, 2]) < 1e-9, 1e-9, local[:, 2])
            residual = local[:, :2] / depth[:, None] - rays
            jacobian = np.zeros((len(points), 2, 3))
            jacobian[:, 0, 0] = jacobian[:, 1, 1] = 1.0 / depth
            jacobian[:, :, 2] = -local[:, :2] / depth[:, None] ** 2
            jacobian = jacobian @ pose.rotation
            hessian += np.einsum("nki,nkj->nij", jacobian, jacobian)
            gradient += np.einsum("nki,nk->ni", jacobian, residual)
        trace = np.trace(hessian, axis1=1, axis2=2)
        hessian += (1e-12 + 1e-9 * trace)[:, None, None] * np.eye(3)
        points = points - np.linalg.solve(hessian, gradient[:, :, None])[:, :, 0]
    return np.asarray(points)


def depths(camera_from_world: SE3, points: Array) -> Array:
    """(N,) z of world points (N, 3) in the camera frame."""
    return np.asarray(points @ camera_from_world.rotation[2] + camera_from_world.translation[2])


def parallax(centre_a: Array, centre_b: Array, points: Array) -> Array:
    """(N,) angle under which points (N, 3) see the two camera centres (3,), radians."""
    to_a, to_b = centre_a - points, centre_b - points
    cross = np.linalg.norm(np.cross(to_a, to_b), axis=1)
    return np.asarray(np.arctan2(cross, np.einsum("ij,ij->i", to_a, to_b)))
