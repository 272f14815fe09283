"""Absolute pose: derivatives by differences, estimates and their covariance by repetition."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from server.geometry.absolute_pose import (
    PoseEstimate,
    PosePrior,
    pose_jacobian,
    projection_jacobian,
    ransac_pose,
    refine_pose,
)
from server.geometry.cameras import Camera
from server.geometry.poses import SE3, vector_from_rotation

CAMERA = Camera.pinhole(640, 480, 500.0, 510.0, 318.0, 243.0)
TRUTH = SE3(Rotation.from_rotvec([0.3, -1.1, 0.4]).as_matrix(), np.array([0.4, -0.2, 1.5]))


def _scene(rng: np.random.Generator, count: int, near: float = 2.0, far: float = 9.0) -> np.ndarray:
    """World points all over the view of ``TRUTH``, between two depths."""
    pixels = rng.uniform([10, 10], [630, 470], (count, 2))
    local = np.column_stack([CAMERA.normalize(pixels), np.ones(count)]) * rng.uniform(near, far, (count, 1))
    return TRUTH.inverse() @ local


def _error(estimate: PoseEstimate | SE3) -> np.ndarray:
    """(6,): rotation vector in the camera frame and camera centre in the world, estimate minus truth."""
    pose = estimate.camera_from_world if isinstance(estimate, PoseEstimate) else estimate
    turn = vector_from_rotation(TRUTH.rotation @ pose.rotation.T)
    return np.concatenate([turn, pose.inverse().translation - TRUTH.inverse().translation])


def _near(rng: np.random.Generator, degrees: float = 2.0, units: float = 0.1) -> SE3:
    """The true pose, some way off."""
    off = np.concatenate([rng.normal(0, np.deg2rad(degrees), 3), rng.normal(0, units, 3)])
    return SE3.exp(off) @ TRUTH


def _differences(function: Callable[[np.ndarray], np.ndarray], size: int, step: float = 1e-6) -> np.ndarray:
    """Central differences of a function of ``size`` numbers at zero, on a new last axis."""
    columns = [(function(step * e) - function(-step * e)) / (2 * step) for e in np.eye(size)]
    return np.stack(columns, axis=-1)


def test_projection_jacobian_is_the_derivative() -> None:
    local = TRUTH @ _scene(np.random.default_rng(1), 50)
    pixels, jacobian = projection_jacobian(local, CAMERA)
    np.testing.assert_allclose(pixels, CAMERA.project(local), atol=1e-10)
    np.testing.assert_allclose(
        jacobian, _differences(lambda d: CAMERA.project(local + d), 3), atol=1e-5, rtol=1e-6
    )


def test_pose_jacobian_is_the_derivative_by_a_left_perturbation() -> None:
    world = _scene(np.random.default_rng(2), 50)
    local = TRUTH @ world
    _, jacobian = projection_jacobian(local, CAMERA)
    numeric = _differences(lambda d: CAMERA.project((SE3.exp(d) @ TRUTH) @ world), 6)
    np.testing.assert_allclose(pose_jacobian(local, jacobian), numeric, atol=1e-5, rtol=1e-6)


def test_exact_pixels_give_the_exact_pose() -> None:
    rng = np.random.default_rng(3)
    points = _scene(rng, 30)
    found = refine_pose(
        _near(rng), points, CAMERA.project(TRUTH @ points), np.ones(30), CAMERA, anneal=(20, 4, 1)
    )
    assert found is not None
    assert found.inliers.all()
    np.testing.assert_allclose(_error(found), 0.0, atol=1e-9)


def test_a_third_of_gross_outliers_does_not_pull_the_pose() -> None:
    rng = np.random.default_rng(4)
    for _ in range(20):
        points = _scene(rng, 120)
        pixels = CAMERA.project(TRUTH @ points) + rng.normal(0, 1.0, (120, 2))
        wrong = rng.permutation(120) < 36
        pixels[wrong] = rng.uniform([0, 0], [640, 480], (36, 2))
        start = _near(rng, degrees=0.7, units=0.05)
        found = refine_pose(start, points, pixels, np.ones(120), CAMERA, anneal=(6.0, 2.0, 1.0))
        assert found is not None
        good = refine_pose(TRUTH, points[~wrong], pixels[~wrong], np.ones(84), CAMERA)
        assert good is not None
        apart = _error(found) - _error(good)
        # Within two thirds of the noise of what the good ones alone say.
        assert apart @ np.linalg.solve(good.covariance, apart) < chi2.ppf(0.95, 6) * 0.44
        assert found.inliers[~wrong].mean() > 0.85
        assert found.inliers[wrong].mean() < 0.1


@pytest.mark.parametrize("blurred_points", [False, True])
def test_covariance_is_the_scatter_of_the_estimates(blurred_points: bool) -> None:
    """Standard deviations within 30 %, correlations by the mean squared normalised error."""
    rng = np.random.default_rng(5)
    count, runs = 60, 400
    points = _scene(rng, count)
    sigmas = rng.choice([0.7, 1.5], count)
    covariances = None
    shape = np.zeros((count, 3, 3))
    if blurred_points:
        # Uncertain along the rays of another camera, as triangulated landmarks are.
        away = points - [2.0, 1.0, 0.5]
        shape = 0.04 * np.einsum("ni,nj->nij", away, away) / np.linalg.norm(away, axis=1)[:, None, None] ** 2
        shape += 1e-4 * np.eye(3)
        covariances = shape
    root = np.linalg.cholesky(shape) if blurred_points else shape
    errors, normalised, told = [], [], []
    for _ in range(runs):
        true_points = points + np.einsum("nij,nj->ni", root, rng.normal(size=(count, 3)))
        pixels = CAMERA.project(TRUTH @ true_points) + sigmas[:, None] * rng.normal(size=(count, 2))
        found = refine_pose(TRUTH, points, pixels, sigmas, CAMERA, point_covariances=covariances)
        assert found is not None
        error = _error(found)
        errors.append(error)
        normalised.append(error @ np.linalg.solve(found.covariance, error))
        told.append(np.diag(found.covariance))
    ratio = np.std(errors, axis=0) / np.sqrt(np.mean(told, axis=0))
    assert ratio.min() > 0.77
    assert ratio.max() < 1.3
    assert 0.7 < np.mean(normalised) / 6 < 1.6
    # No bias: the mean of the errors is within its own noise.
    mean = np.mean(errors, axis=0)
    assert runs * mean @ np.linalg.solve(np.cov(np.array(errors).T), mean) < chi2.ppf(0.999, 6)


def test_a_point_of_unknown_depth_tells_its_direction_and_no_more() -> None:
    rng = np.random.default_rng(6)
    points = _scene(rng, 80)
    seen_from = SE3.exp([0.02, -0.05, 0.0, 0.3, 0.05, -0.2]) @ TRUTH
    # Every point is put at a wrong depth on the ray on which another camera saw it.
    rays = seen_from @ points
    wrong = seen_from.inverse() @ (rays * (5.0 / rays[:, 2:]))
    along = (rays / rays[:, 2:]) @ seen_from.rotation
    covariances = 50.0**2 * np.einsum("ni,nj->nij", along, along)
    pixels = CAMERA.project(TRUTH @ points)
    # The length of the way between the two is open, as ever with two views: the prior decides it.
    prior = PosePrior(TRUTH, 0.5, 0.02)
    found = refine_pose(
        _near(rng, 0.3, 0.02),
        wrong,
        pixels,
        np.full(80, 0.5),
        CAMERA,
        point_covariances=covariances,
        prior=prior,
        anneal=(6.0, 1.0),
    )
    assert found is not None
    error = _error(found)
    assert np.linalg.norm(error[:3]) < np.deg2rad(0.1)
    assert np.linalg.norm(error[3:]) < 0.02
    believed = refine_pose(_near(rng, 0.3, 0.02), wrong, pixels, np.full(80, 0.5), CAMERA, anneal=(6.0, 1.0))
    assert believed is None or np.linalg.norm(_error(believed)[3:]) > 0.05


def test_a_prior_measures_from_its_pose() -> None:
    prior = PosePrior(TRUTH, rotation_sigma=0.1, translation_sigma=0.5)
    np.testing.assert_allclose(prior.information(), [100.0] * 3 + [4.0] * 3)
    np.testing.assert_allclose(prior.offset(TRUTH.rotation, TRUTH.translation), 0.0, atol=1e-15)
    step = np.array([0.2, -0.1, 0.3, 0.4, 0.5, -0.6])
    moved = SE3.exp(step) @ TRUTH
    np.testing.assert_allclose(prior.offset(moved.rotation, moved.translation), step, atol=1e-14)


def test_a_prior_decides_what_the_pixels_leave_open() -> None:
    """Far points tell the orientation only; the position stays where it was expected."""
    rng = np.random.default_rng(7)
    points = _scene(rng, 60, near=4000.0, far=9000.0)
    pixels = CAMERA.project(TRUTH @ points) + rng.normal(0, 0.5, (60, 2))
    expected = SE3.exp([0.03, 0.0, 0.0, 0.0, 0.0, 0.0]) @ TRUTH
    prior = PosePrior(expected, np.deg2rad(5.0), 0.1)
    found = refine_pose(TRUTH, points, pixels, np.full(60, 0.5), CAMERA, prior=prior)
    assert found is not None
    assert np.linalg.norm(_error(found)[:3]) < np.deg2rad(0.1)
    centre_sigma = np.sqrt(np.diag(found.covariance)[3:])
    np.testing.assert_allclose(centre_sigma, 0.1, rtol=0.02)
    shift = prior.offset(found.camera_from_world.rotation, found.camera_from_world.translation)[3:]
    assert np.linalg.norm(shift) < 0.01


def test_a_weak_prior_leaves_plain_evidence_alone() -> None:
    rng = np.random.default_rng(8)
    points = _scene(rng, 100)
    pixels = CAMERA.project(TRUTH @ points) + rng.normal(0, 0.5, (100, 2))
    free = refine_pose(TRUTH, points, pixels, np.full(100, 0.5), CAMERA)
    prior = PosePrior(_near(rng, 3.0, 0.2), np.deg2rad(5.0), 0.3)
    held = refine_pose(TRUTH, points, pixels, np.full(100, 0.5), CAMERA, prior=prior)
    assert free is not None
    assert held is not None
    assert np.abs(_error(held) - _error(free)).max() < 0.3 * np.sqrt(np.diag(free.covariance)).min()


def test_no_pose_without_four_inliers() -> None:
    rng = np.random.default_rng(9)
    points = _scene(rng, 40)
    pixels = CAMERA.project(TRUTH @ points)
    behind = SE3(np.diag([-1.0, 1.0, -1.0]) @ TRUTH.rotation, -TRUTH.translation)
    assert refine_pose(behind, points, pixels, np.ones(40), CAMERA) is None
    scrambled = rng.uniform([0, 0], [640, 480], (40, 2))
    assert refine_pose(TRUTH, points, scrambled, np.full(40, 0.01), CAMERA) is None
    assert ransac_pose(points[:3], pixels[:3], CAMERA, max_error=2.0) is None


def test_ransac_finds_the_pose_among_outliers_and_repeats_itself() -> None:
    rng = np.random.default_rng(10)
    points = _scene(rng, 200)
    pixels = CAMERA.project(TRUTH @ points) + rng.normal(0, 0.5, (200, 2))
    wrong = rng.permutation(200) < 120
    pixels[wrong] = rng.uniform([0, 0], [640, 480], (120, 2))
    first = ransac_pose(points, pixels, CAMERA, max_error=2.5, seed=3)
    again = ransac_pose(points, pixels, CAMERA, max_error=2.5, seed=3)
    assert first is not None
    assert again is not None
    error = _error(first[0])
    assert np.linalg.norm(error[:3]) < np.deg2rad(0.3)
    assert np.linalg.norm(error[3:]) < 0.04
    assert first[1].dtype == bool
    assert first[1][~wrong].mean() > 0.95
    assert first[1][wrong].mean() < 0.05
    np.testing.assert_array_equal(first[0].matrix, again[0].matrix)
    np.testing.assert_array_equal(first[1], again[1])


def test_ransac_tries_the_expected_pose_first() -> None:
    """Seven good ones among a hundred are not found by a few samples, but checked when told."""
    rng = np.random.default_rng(11)
    points = _scene(rng, 150)
    pixels = CAMERA.project(TRUTH @ points)
    wrong = rng.permutation(150) >= 10
    pixels[wrong] = rng.uniform([0, 0], [640, 480], (140, 2))
    told = ransac_pose(points, pixels, CAMERA, max_error=2.0, max_iterations=50, initial=TRUTH)
    alone = ransac_pose(points, pixels, CAMERA, max_error=2.0, max_iterations=50)
    assert told is not None
    assert np.abs(_error(told[0])).max() < 0.02
    assert alone is None or np.abs(_error(alone[0])).max() > 0.1
