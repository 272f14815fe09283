"""Resection: the lens of synthetic views, derivatives by differences, the error by repetition."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from server.geometry import resection
from server.geometry.cameras import Camera, CameraModel
from server.geometry.poses import SE3, rotation_angle
from server.geometry.resection import LensPrior, Resection, View, resect

TRUE = Camera(CameraModel.SIMPLE_RADIAL, 640, 480, (540.0, 320.0, 240.0, -0.08))
GUESS = Camera(CameraModel.SIMPLE_RADIAL, 640, 480, (500.0, 320.0, 240.0, 0.0))
OPEN = LensPrior(GUESS, 0.3, 0.2)


def _views(
    rng: np.random.Generator, count: int = 6, points: int = 80, noise: float = 0.0
) -> tuple[list[View], list[SE3]]:
    """Views of points at 2 to 9 m by a camera that walks and turns, of roughly known poses; and those."""
    views, truth = [], []
    for k in range(count):
        pose = SE3(
            Rotation.from_rotvec([0.02 * k, -0.15 * k, 0.03]).as_matrix(), np.array([0.2 * k, 0.1, -0.3 * k])
        )
        pixels = rng.uniform([5, 5], [635, 475], (points, 2))
        local = np.column_stack([TRUE.normalize(pixels), np.ones(points)]) * rng.uniform(2, 9, (points, 1))
        rough = SE3.exp(np.concatenate([rng.normal(0, 0.01, 3), rng.normal(0, 0.1, 3)])) @ pose
        seen = pixels + noise * rng.normal(size=pixels.shape)
        views.append(View(rough, pose.inverse() @ local, seen, np.full(points, max(noise, 1.0))))
        truth.append(pose)
    return views, truth


def _found(views: list[View], prior: LensPrior = OPEN) -> Resection:
    found = resect(views, prior)
    assert found is not None
    return found


def test_without_noise_lens_and_poses_are_exact() -> None:
    views, truth = _views(np.random.default_rng(1))
    found = _found(views, LensPrior(GUESS, 1e3, 1e3))
    np.testing.assert_allclose(found.camera.params, TRUE.params, rtol=1e-4, atol=1e-4)
    for pose, true in zip(found.poses, truth, strict=True):
        assert rotation_angle(pose.rotation @ true.rotation.T) < 1e-4
        np.testing.assert_allclose(pose.translation, true.translation, atol=1e-3)


def test_with_noise_the_error_is_what_the_sigma_says() -> None:
    errors = []
    for seed in range(40):
        found = _found(_views(np.random.default_rng([2, seed]), noise=1.0)[0])
        assert found.focal_sigma < 0.02
        errors.append((np.log(found.camera.focal[0] / 540.0)) / found.focal_sigma)
    # Root mean square of 40 standard normal numbers: 0.7 to 1.3 in all but one of a thousand cases. The
    # robust weights take some from far observations, and the sigma does not know that.
    assert 0.6 < np.sqrt(np.mean(np.square(errors))) < 1.5
    assert abs(np.mean(errors)) < 0.6


def test_mismatches_do_not_spoil_it() -> None:
    rng = np.random.default_rng(3)
    views, _ = _views(rng, noise=0.5)
    for view in views:
        view.pixels[:10] = rng.uniform([0, 0], [640, 480], (10, 2))
    assert _found(views).camera.focal[0] == pytest.approx(540.0, rel=0.01)


def test_a_prior_that_is_sure_is_kept_to() -> None:
    views, _ = _views(np.random.default_rng(4), noise=1.0)
    found = _found(views, LensPrior(GUESS, 1e-6, 1e-6))
    assert found.camera.focal[0] == pytest.approx(500.0, rel=1e-4)
    assert found.camera.distortion[0] == pytest.approx(0.0, abs=1e-4)


def test_a_wall_seen_from_straight_ahead_leaves_the_lens_open() -> None:
    """Its distance makes up for any focal length; the sigma says so."""
    rng = np.random.default_rng(5)
    pixels = rng.uniform([5, 5], [635, 475], (200, 2))
    points = 4.0 * np.column_stack([TRUE.normalize(pixels), np.ones(200)])
    found = _found([View(SE3.identity(), points, pixels, np.ones(200))])
    assert found.focal_sigma > 0.1


def test_points_behind_the_camera_are_no_view() -> None:
    views, _ = _views(np.random.default_rng(6), count=1)
    behind = SE3(np.diag([-1.0, 1.0, -1.0]), np.zeros(3)) @ views[0].camera_from_world
    assert resect([View(behind, views[0].points, views[0].pixels, views[0].sigmas)], OPEN) is None


def test_derivatives_are_those_of_differences() -> None:
    rng = np.random.default_rng(7)
    (view,), (pose,) = _views(rng, count=1, points=12, noise=2.0)
    lens, centre, step = np.array([np.log(530.0), -0.05]), (320.0, 240.0), 1e-6
    sure = 1e18  # A gate so wide that all weights are one: they are held while deriving.

    def residual(change: SE3, by: np.ndarray) -> np.ndarray:
        return resection._rows(change @ pose @ view.points, view, lens + by, centre, sure)[0]

    _, by_pose, by_lens = resection._rows(pose @ view.points, view, lens, centre, sure)
    still = SE3.identity()
    for k in range(6):
        ahead, back = (residual(SE3.exp(sign * step * np.eye(6)[k]), np.zeros(2)) for sign in (1, -1))
        np.testing.assert_allclose(by_pose[:, k], (ahead - back) / (2 * step), rtol=1e-4, atol=1e-3)
    for k in range(2):
        ahead, back = (residual(still, sign * step * np.eye(2)[k]) for sign in (1, -1))
        np.testing.assert_allclose(by_lens[:, k], (ahead - back) / (2 * step), rtol=1e-4, atol=1e-3)
