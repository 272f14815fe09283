"""Bundle adjustment of a window of keyframes: Levenberg-Marquardt on the Schur complement.

Triggs, McLauchlan, Hartley, Fitzgibbon, "Bundle adjustment - a modern synthesis" (2000), section 6.
Small enough to run at every keyframe: cameras are a few dozen, so the reduced system and the
camera-point coupling are dense matrices.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from server.geometry.absolute_pose import CHI2_2DOF_95, pose_jacobian, projection_jacobian
from server.geometry.cameras import Camera
from server.geometry.poses import rotation_from_vector

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False, slots=True)
class BundleProblem:
    """C cameras, P points, M observations.

    Attributes:
        rotations: (C, 3, 3), translations: (C, 3): camera_from_world.
        free: (C,) bool; the others stay where they are and fix the frame and the scale.
        points: (P, 3) in the world.
        camera_index, point_index: (M,); a pair occurs at most once.
        pixels: (M, 2); sigmas: (M,) standard deviation of a pixel coordinate.
        camera: the pinhole camera of all images.
    """

    rotations: Array
    translations: Array
    free: NDArray[np.bool_]
    points: Array
    camera_index: NDArray[np.intp]
    point_index: NDArray[np.intp]
    pixels: Array
    sigmas: Array
    camera: Camera


@dataclass(frozen=True, eq=False, slots=True)
class BundleSolution:
    """Adjusted values and, for each observation, its squared normalised error (inf behind a camera)."""

    rotations: Array
    translations: Array
    points: Array
    squared_errors: Array


def squared_errors(problem: BundleProblem, rotations: Array, translations: Array, points: Array) -> Array:
    """(M,) squared reprojection errors in units of their variance; inf behind the camera."""
    local = _local(problem, rotations, translations, points)
    front = local[:, 2] > 1e-4
    out = np.full(len(local), np.inf)
    offset = problem.camera.project(local[front]) - problem.pixels[front]
    out[front] = (offset**2).sum(axis=1) / problem.sigmas[front] ** 2
    return out


def _local(problem: BundleProblem, rotations: Array, translations: Array, points: Array) -> Array:
    return np.asarray(
        np.einsum("mij,mj->mi", rotations[problem.camera_index], points[problem.point_index])
        + translations[problem.camera_index]
    )


def _huber(squared: Array) -> Array:
    """Huber cost of squared errors, quadratic up to the 95 % gate."""
    finite = np.minimum(squared, 1e6)
    edge = CHI2_2DOF_95
    return np.where(finite <= edge, finite, 2.0 * np.sqrt(edge * finite) - edge)


def adjust(problem: BundleProblem, *, iterations: int = 6, tolerance: float = 1e-4) -> BundleSolution:
    """Minimise the Huber cost over the free cameras and all points.

    Args:
        iterations: accepted steps at most.
        tolerance: ends when a step lowers the cost by less than this fraction.
    """
    rotations, translations, points = problem.rotations, problem.translations, problem.points
    free_index = np.cumsum(problem.free) - 1
    free_count = int(problem.free.sum())
    observations = len(problem.pixels)
    of_point = csr_array(
        (np.ones(observations), (problem.point_index, np.arange(observations))),
        shape=(len(points), observations),
    )
    moving = np.flatnonzero(problem.free[problem.camera_index])
    moving_camera = free_index[problem.camera_index[moving]]
    moving_point = problem.point_index[moving]
    of_camera = csr_array(
        (np.ones(len(moving)), (moving_camera, np.arange(len(moving)))), shape=(free_count, len(moving))
    )
    squared = squared_errors(problem, rotations, translations, points)
    cost = float(_huber(squared).sum())
    damping = 1e-4
    accepted = attempts = 0
    while accepted < iterations and attempts < 3 * iterations:
        local = _local(problem, rotations, translations, points)
        valid = local[:, 2] > 1e-4
        local[~valid] = (0.0, 0.0, 1.0)
        predicted, jacobian = projection_jacobian(local, problem.camera)
        weight = np.where(squared <= CHI2_2DOF_95, 1.0, np.sqrt(CHI2_2DOF_95 / np.maximum(squared, 1e-12)))
        root = np.where(valid, np.sqrt(weight), 0.0) / problem.sigmas
        residual = (predicted - problem.pixels) * root[:, None]
        jacobian = jacobian * root[:, None, None]
        by_point = jacobian @ rotations[problem.camera_index]
        by_camera = pose_jacobian(local[moving], jacobian[moving])

        h_point = _grouped(of_point, np.einsum("mki,mkj->mij", by_point, by_point))
        g_point = _grouped(of_point, np.einsum("mki,mk->mi", by_point, residual))
        h_camera = _grouped(of_camera, np.einsum("mki,mkj->mij", by_camera, by_camera))
        g_camera = _grouped(of_camera, np.einsum("mki,mk->mi", by_camera, residual[moving]))
        coupling = np.einsum("mki,mkj->mij", by_camera, by_point[moving])
        while attempts < 3 * iterations:
            attempts += 1
            step_camera, step_point = _schur_step(
                h_camera, g_camera, h_point, g_point, coupling, moving_camera, moving_point, damping
            )
            turn = rotation_from_vector(step_camera[:, :3])
            new_rotations, new_translations = rotations.copy(), translations.copy()
            new_rotations[problem.free] = turn @ rotations[problem.free]
            new_translations[problem.free] = (
                np.einsum("cij,cj->ci", turn, translations[problem.free]) + step_camera[:, 3:]
            )
            new_points = points + step_point
            new_squared = squared_errors(problem, new_rotations, new_translations, new_points)
            new_cost = float(_huber(new_squared).sum())
            if new_cost < cost:
                break
            damping = min(damping * 10.0, 1e6)
        else:
            break
        gain = (cost - new_cost) / max(cost, 1e-12)
        rotations, translations, points = new_rotations, new_translations, new_points
        squared, cost = new_squared, new_cost
        accepted += 1
        damping = max(damping / 10.0, 1e-8)
        if gain < tolerance:
            break
    return BundleSolution(rotations, translations, points, squared)


def _grouped(indicator: csr_array, values: Array) -> Array:
    """Sum (M, ...) values by group -> (groups, ...)."""
    flat = values.reshape(len(values), math.prod(values.shape[1:]))
    return np.asarray(indicator @ flat).reshape(-1, *values.shape[1:])


def _schur_step(
    h_camera: Array,
    g_camera: Array,
    h_point: Array,
    g_point: Array,
    coupling: Array,
    camera_of: NDArray[np.intp],
    point_of: NDArray[np.intp],
    damping: float,
) -> tuple[Array, Array]:
    """One damped step: the cameras from the reduced system, the points by back-substitution."""
    cameras, points = len(h_camera), len(h_point)
    diagonal = np.einsum("pii->pi", h_point)
    h_point = h_point + (damping * diagonal + 1e-9)[:, :, None] * np.eye(3)
    inverse = np.linalg.inv(h_point)
    product = coupling @ inverse[point_of]
    dense_w = np.zeros((cameras, points, 6, 3))
    dense_y = np.zeros((cameras, points, 6, 3))
    dense_w[camera_of, point_of] = coupling
    dense_y[camera_of, point_of] = product
    matrix_w = dense_w.transpose(0, 2, 1, 3).reshape(6 * cameras, 3 * points)
    matrix_y = dense_y.transpose(0, 2, 1, 3).reshape(6 * cameras, 3 * points)
    reduced = -matrix_y @ matrix_w.T
    blocks = reduced.reshape(cameras, 6, cameras, 6)
    index = np.arange(cameras)
    damped = h_camera + (damping * np.einsum("cii->ci", h_camera) + 1e-9)[:, :, None] * np.eye(6)
    blocks[index, :, index, :] += damped
    right = -(g_camera.ravel() - matrix_y @ g_point.ravel())
    step_camera = np.linalg.solve(reduced, right)
    back = g_point.ravel() + matrix_w.T @ step_camera
    step_point = -np.einsum("pij,pj->pi", inverse, back.reshape(points, 3))
    return np.asarray(step_camera, dtype=np.float64).reshape(cameras, 6), np.asarray(step_point)
