"""Relative pose of two views: depth, a plane, and the pairs that must be refused."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from server.geometry.cameras import Camera
from server.geometry.poses import SE3, rotation_angle
from server.geometry.two_view import (
    TwoView,
    TwoViewModel,
    TwoViewOptions,
    relative_pose,
    rotation_between,
)

CAMERA = Camera.pinhole(640, 480, 500.0, 500.0, 320.0, 240.0)
TURN = Rotation.from_rotvec([0.03, -0.08, 0.02]).as_matrix()
MOTION = SE3(TURN, np.array([-0.5, 0.05, -0.15]))


def _deep(rng: np.random.Generator, count: int) -> np.ndarray:
    pixels = rng.uniform([20, 20], [620, 460], (count, 2))
    return np.column_stack([CAMERA.normalize(pixels), np.ones(count)]) * rng.uniform(2.0, 8.0, (count, 1))


def _plane(rng: np.random.Generator, count: int) -> np.ndarray:
    """A wall seen at a slant."""
    rays = np.column_stack([CAMERA.normalize(rng.uniform([20, 20], [620, 460], (count, 2))), np.ones(count)])
    normal = np.array([0.5, 0.15, 1.0])
    return np.asarray(rays * (4.0 / (rays @ normal))[:, None])


def _seen(
    points: np.ndarray, motion: SE3, rng: np.random.Generator, noise: float = 0.5, outliers: float = 0.0
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pixels in both views, and which pairs are right."""
    pixels = [CAMERA.project(p) + rng.normal(0, noise, (len(points), 2)) for p in (points, motion @ points)]
    wrong = rng.permutation(len(points)) < outliers * len(points)
    pixels[1][wrong] = rng.uniform([0, 0], [640, 480], (wrong.sum(), 2))
    return pixels[0], pixels[1], ~wrong


def _check(view: TwoView, points: np.ndarray, right: np.ndarray, degrees: float) -> None:
    motion = view.b_from_a
    assert np.rad2deg(rotation_angle(motion.rotation @ TURN.T)) < 0.3 * degrees
    assert np.linalg.norm(motion.translation) == pytest.approx(1.0, abs=1e-12)
    direction = MOTION.translation / np.linalg.norm(MOTION.translation)
    assert np.rad2deg(np.arccos(motion.translation @ direction)) < degrees
    good = view.valid & right
    assert good.sum() > 0.8 * right.sum()
    ratio = view.points[good, 2] * np.linalg.norm(MOTION.translation) / points[good, 2]
    assert np.median(ratio) == pytest.approx(1.0, abs=0.03)
    assert np.percentile(np.abs(ratio - 1.0), 90) < 0.1


@pytest.mark.parametrize("seed", range(5))
def test_a_deep_scene_is_explained_by_an_essential_matrix(seed: int) -> None:
    rng = np.random.default_rng(seed)
    points = _deep(rng, 300)
    a, b, right = _seen(points, MOTION, rng, outliers=0.2)
    view = relative_pose(a, b, CAMERA, TwoViewOptions())
    assert view is not None
    assert view.model is TwoViewModel.ESSENTIAL
    _check(view, points, right, degrees=1.0)
    # Pairs that are wrong by chance alone: few of them lie on their epipolar line.
    assert view.valid[~right].mean() < 0.15
    angles = np.arctan2(0.525, points[right, 2])
    assert view.parallax == pytest.approx(np.median(angles), rel=0.2)


@pytest.mark.parametrize("seed", range(5))
def test_a_plane_is_explained_by_a_homography(seed: int) -> None:
    rng = np.random.default_rng(seed)
    points = _plane(rng, 300)
    a, b, right = _seen(points, MOTION, rng, noise=0.3, outliers=0.1)
    # An epipolar line takes up half of a pixel's noise, so on a plane the homography scores a little less.
    view = relative_pose(a, b, CAMERA, TwoViewOptions(homography_ratio=0.45))
    assert view is not None
    assert view.model is TwoViewModel.HOMOGRAPHY
    _check(view, points, right, degrees=3.0)


@pytest.mark.parametrize("seed", range(5))
def test_a_plane_gives_the_right_motion_whatever_explains_it(seed: int) -> None:
    rng = np.random.default_rng(100 + seed)
    points = _plane(rng, 300)
    a, b, right = _seen(points, MOTION, rng, outliers=0.1)
    view = relative_pose(a, b, CAMERA, TwoViewOptions())
    assert view is not None
    _check(view, points, right, degrees=4.0)


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("scene", [_deep, _plane])
def test_turning_on_the_spot_gives_no_motion(scene, seed: int) -> None:  # type: ignore[no-untyped-def]
    """Noise alone lets some translation fit a little better than none: there is still no depth."""
    rng = np.random.default_rng(seed)
    turn = SE3(Rotation.from_rotvec([0.01, 0.15, -0.02]).as_matrix(), np.zeros(3))
    a, b, _ = _seen(scene(rng, 300), turn, rng, outliers=0.1)
    assert relative_pose(a, b, CAMERA, TwoViewOptions()) is None


def test_standing_still_gives_no_motion() -> None:
    rng = np.random.default_rng(1)
    a, b, _ = _seen(_deep(rng, 300), SE3.identity(), rng)
    assert relative_pose(a, b, CAMERA, TwoViewOptions()) is None


def test_pairs_that_belong_together_by_chance_give_no_motion() -> None:
    rng = np.random.default_rng(2)
    a, b = rng.uniform([0, 0], [640, 480], (2, 300, 2))
    assert relative_pose(a, b, CAMERA, TwoViewOptions()) is None


def test_too_few_pairs_give_no_motion() -> None:
    rng = np.random.default_rng(3)
    a, b, _ = _seen(_deep(rng, 59), MOTION, rng)
    assert relative_pose(a, b, CAMERA, TwoViewOptions()) is None
    assert relative_pose(a, b, CAMERA, TwoViewOptions(min_points=40)) is not None


def _rays(points: np.ndarray) -> np.ndarray:
    return np.asarray(points[:, :2] / points[:, 2:])


@pytest.mark.parametrize("seed", range(5))
def test_a_turn_is_read_off_the_rays_alone(seed: int) -> None:
    rng = np.random.default_rng(seed)
    turn = Rotation.from_rotvec(rng.normal(scale=0.15, size=3)).as_matrix()
    points = _deep(rng, 200)
    a, b = _rays(points), _rays(points @ turn.T)
    np.testing.assert_allclose(rotation_between(a, b), turn, atol=1e-9)
    noisy = rotation_between(
        a + rng.normal(scale=0.5 / 500, size=a.shape), b + rng.normal(scale=0.5 / 500, size=b.shape)
    )
    assert np.degrees(rotation_angle(noisy.T @ turn)) < 0.05
    assert np.linalg.det(noisy) == pytest.approx(1.0)


@pytest.mark.parametrize("seed", range(5))
def test_what_does_not_turn_along_hardly_counts(seed: int) -> None:
    """A step while turning: far points turn, the near third shifts by several degrees; a tenth is wrong."""
    rng = np.random.default_rng(seed)
    turn = Rotation.from_rotvec([0.01, 0.12, 0.0]).as_matrix()
    points = _deep(rng, 300) * np.where(np.arange(300) % 3, 5.0, 0.5)[:, None]
    a, b = _rays(points), _rays(points @ turn.T + np.array([0.1, 0.0, 0.02]))
    b[::10] = rng.uniform(-0.6, 0.6, (30, 2))
    robust = np.degrees(rotation_angle(rotation_between(a, b).T @ turn))
    plain = np.degrees(rotation_angle(rotation_between(a, b, rounds=1).T @ turn))
    assert robust < 0.5
    assert robust < 0.6 * plain


def test_a_turn_of_too_few_rays_is_none() -> None:
    rays = np.random.default_rng(1).uniform(-0.5, 0.5, (4, 2))
    np.testing.assert_array_equal(rotation_between(rays, rays[::-1]), np.eye(3))
    np.testing.assert_array_equal(rotation_between(np.zeros((0, 2)), np.zeros((0, 2))), np.eye(3))
