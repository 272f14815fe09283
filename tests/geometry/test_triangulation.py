"""Triangulation: exact without noise, unbiased with it."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from server.geometry.poses import SE3
from server.geometry.triangulation import depths, parallax, triangulate

A = SE3(Rotation.from_rotvec([0.1, 0.7, -0.2]).as_matrix(), np.array([0.3, 0.1, -0.4]))


def _rays(pose: SE3, points: np.ndarray) -> np.ndarray:
    local = pose @ points
    return np.asarray(local[:, :2] / local[:, 2:])


def _points(rng: np.random.Generator, count: int, near: float, far: float) -> np.ndarray:
    rays = rng.uniform([-0.5, -0.4], [0.5, 0.4], (count, 2))
    return A.inverse() @ (np.column_stack([rays, np.ones(count)]) * rng.uniform(near, far, (count, 1)))


@pytest.mark.parametrize("baseline", [1.0, 0.1, 0.01])
def test_exact_rays_meet_in_the_point(baseline: float) -> None:
    points = _points(np.random.default_rng(1), 200, 2.0, 10.0)
    b = SE3.exp([0.02, -0.05, 0.1, baseline, 0.1 * baseline, -0.3 * baseline]) @ A
    found = triangulate(A, b, _rays(A, points), _rays(b, points))
    np.testing.assert_allclose(found, points, rtol=1e-6 / baseline, atol=1e-9 / baseline)


def test_noise_moves_points_as_far_as_it_must_and_no_farther() -> None:
    """Scatter of the depth against first-order propagation at 6 degrees of parallax."""
    rng = np.random.default_rng(2)
    depth, baseline, sigma, runs = 4.0, 0.4, 1.0 / 500, 4000
    b = SE3(np.eye(3), np.array([-baseline, 0.0, 0.0]))
    point = np.array([[0.2, 0.1, depth]])
    rays = [np.repeat(_rays(pose, point), runs, axis=0) for pose in (SE3.identity(), b)]
    noisy = [r + rng.normal(0, sigma, r.shape) for r in rays]
    found = triangulate(SE3.identity(), b, *noisy)
    expected = np.sqrt(2) * sigma * depth**2 / baseline
    assert found[:, 2].std() == pytest.approx(expected, rel=0.06)


def test_low_parallax_keeps_the_inverse_depth_unbiased() -> None:
    """At half a degree: the depth is a guess, but not one towards the cameras."""
    rng = np.random.default_rng(3)
    depth, sigma, runs = 5.0, 0.5 / 500, 20_000
    baseline = depth * np.deg2rad(0.5)
    b = SE3(np.eye(3), np.array([-baseline, 0.0, 0.0]))
    point = np.array([[0.4, -0.3, depth]])
    rays = [np.repeat(_rays(pose, point), runs, axis=0) for pose in (SE3.identity(), b)]
    noisy = [r + rng.normal(0, sigma, r.shape) for r in rays]
    inverse = 1.0 / triangulate(SE3.identity(), b, *noisy)[:, 2]
    scatter = np.sqrt(2) * sigma / baseline
    assert inverse.std() == pytest.approx(scatter, rel=0.05)
    assert abs(inverse.mean() - 1 / depth) < 4 * scatter / np.sqrt(runs)


def test_rays_that_diverge_meet_behind() -> None:
    b = SE3(np.eye(3), np.array([-1.0, 0.0, 0.0]))
    found = triangulate(SE3.identity(), b, np.array([[-0.1, 0.0]]), np.array([[0.1, 0.0]]))
    assert depths(SE3.identity(), found)[0] < 0


def test_parallel_rays_give_finite_numbers() -> None:
    b = SE3(np.eye(3), np.array([-0.1, 0.0, 0.0]))
    rays = np.array([[0.1, 0.2], [0.0, 0.0]])
    assert np.isfinite(triangulate(SE3.identity(), b, rays, rays)).all()


def test_depths_are_z_in_the_camera() -> None:
    points = _points(np.random.default_rng(4), 20, 1.0, 9.0)
    np.testing.assert_allclose(depths(A, points), (A @ points)[:, 2], atol=1e-14)


def test_parallax_is_the_angle_at_the_point() -> None:
    points = np.array([[0.0, 0.0, 1.0], [0.5, 0.0, 1e6], [0.5, 0.0, 0.5], [0.5, 0.0, 0.0], [3.0, 0.0, 0.0]])
    found = parallax(np.zeros(3), np.array([1.0, 0.0, 0.0]), points)
    np.testing.assert_allclose(found, [np.pi / 4, 1e-6, np.pi / 2, np.pi, 0.0], atol=1e-12)
