"""The lens of a follower's phone, learnt from views of known landmarks."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from server.geometry.cameras import Camera, CameraModel, typical_camera
from server.geometry.poses import SE3
from server.geometry.resection import View
from server.navigation.lens import LensBelief, LensEstimator, LensOptions
from server.navigation.updates import Fix

TRUE = Camera(CameraModel.SIMPLE_RADIAL, 640, 480, (540.0, 322.0, 238.0, -0.05))


def _walk(
    rng: np.random.Generator, count: int, *, camera: Camera = TRUE, believed: float = 512.0, first: int = 0
) -> list[View]:
    """Views of a walk; their poses are as a focal length of ``believed`` pixels would have them."""
    views = []
    for k in range(first, first + count):
        pose = SE3(Rotation.from_rotvec([0.03, -0.12 * k, 0.0]).as_matrix(), np.array([0.1, 0.0, -0.4 * k]))
        pixels = rng.uniform([5, 5], [camera.width - 5, camera.height - 5], (90, 2))
        rays = np.column_stack([camera.normalize(pixels), np.ones(90)])
        local = rays * rng.uniform(2, 8, (90, 1))
        ahead = SE3(np.eye(3), np.array([0.0, 0.0, 4.0 * (believed / camera.focal[0] - 1)]))
        seen = pixels + rng.normal(0, 0.8, pixels.shape)
        views.append(View(ahead @ pose, pose.inverse() @ local, seen, np.full(90, 0.8)))
    return views


def _learnt(estimator: LensEstimator, views: list[View]) -> LensBelief:
    for view in views:
        estimator.learn(view)
    return estimator.belief


def test_an_unknown_lens_settles_on_the_true_one() -> None:
    estimator = LensEstimator.start(typical_camera(640, 480), known=False)
    assert len(estimator.focal_factors) > 1
    sigmas = [estimator.belief.focal_sigma]
    for view in _walk(np.random.default_rng(1), 30):
        estimator.learn(view)
        sigmas.append(estimator.belief.focal_sigma)
    belief = estimator.belief
    assert belief.settled
    assert belief.camera.focal[0] == pytest.approx(540.0, rel=0.005)
    assert belief.camera.distortion[0] == pytest.approx(-0.05, abs=0.01)
    assert estimator.focal_factors == (1.0,)
    assert sigmas[-1] < 0.01 < sigmas[0]
    # Nothing more is learnt.
    estimator.learn(_walk(np.random.default_rng(2), 1, camera=TRUE.with_focal(700.0), first=40)[0])
    assert estimator.belief == belief


@pytest.mark.parametrize("factor", [0.95, 1.05])
def test_a_camera_that_was_described_wrongly_is_corrected(factor: float) -> None:
    told = Camera.pinhole(640, 480, 540.0 * factor, 540.0 * factor, 322.0, 238.0)
    estimator = LensEstimator.start(told, known=True)
    belief = _learnt(estimator, _walk(np.random.default_rng(3), 30, believed=540.0 * factor))
    assert belief.camera.focal[0] == pytest.approx(540.0, rel=0.01)


def test_standing_still_teaches_nothing_new() -> None:
    estimator = LensEstimator.start(typical_camera(640, 480), known=False)
    view = _walk(np.random.default_rng(4), 1)[0]
    first = _learnt(estimator, [view])
    assert _learnt(estimator, [view] * 20) == first
    few = View(view.camera_from_world, view.points[:39], view.pixels[:39], view.sigmas[:39])
    fresh = LensEstimator.start(typical_camera(640, 480), known=False)
    before = fresh.belief
    assert _learnt(fresh, [few]) == before


def test_a_snapshot_goes_on_where_it_was() -> None:
    rng = np.random.default_rng(5)
    estimator = LensEstimator.start(typical_camera(640, 480), False, LensOptions(settled=0.0005))
    belief = _learnt(estimator, _walk(rng, 1))
    assert not belief.settled
    assert belief.focal_sigma > 0.002
    again = LensBelief.from_json(json.loads(json.dumps(belief.to_json())))
    assert again == belief
    resumed = LensEstimator(again)
    assert resumed.focal_factors == estimator.focal_factors
    after = _learnt(resumed, _walk(rng, 10, believed=belief.camera.focal[0], first=1))
    assert after.focal_sigma < belief.focal_sigma
    assert after.camera.focal[0] == pytest.approx(540.0, rel=0.005)


def test_a_belief_is_of_turned_and_scaled_pictures_too() -> None:
    belief = LensBelief(TRUE, 0.01, 0.02)
    small = belief.resized(320, 240)
    assert small is not None
    assert small.camera.params == pytest.approx((270.0, 161.0, 119.0, -0.05))
    turned = belief.resized(480, 640)
    assert turned is not None
    assert (turned.camera.width, turned.camera.height) == (480, 640)
    assert turned.camera.params == pytest.approx((540.0, 242.0, 322.0, -0.05))
    assert (turned.focal_sigma, turned.settled) == (0.01, False)
    assert belief.resized(640, 360) is None


def test_what_the_lens_leaves_open_is_in_the_covariance() -> None:
    """Along the line of sight, as far as things are away."""
    view = _walk(np.random.default_rng(6), 1)[0]
    pose = view.camera_from_world.inverse()
    fix = Fix(pose, 1e-6 * np.eye(6), 60, 90, 0)
    estimator = LensEstimator(LensBelief(TRUE, 0.1, 0.02))
    covariance = estimator.widened(fix, view).covariance[3:, 3:]
    forward, right = pose.rotation[:, 2], pose.rotation[:, 0]
    depth = float(np.median((view.camera_from_world @ view.points)[:, 2]))
    assert np.sqrt(forward @ covariance @ forward) == pytest.approx(0.1 * depth, rel=1e-3)
    assert np.sqrt(right @ covariance @ right) == pytest.approx(1e-3)
    assert np.array_equal(fix.covariance, 1e-6 * np.eye(6))


def test_views_that_contradict_the_map_are_not_believed() -> None:
    estimator = LensEstimator.start(typical_camera(640, 480), known=False)
    view = _walk(np.random.default_rng(7), 1)[0]
    before = estimator.belief
    estimator.learn(replace(view, points=-view.points))
    assert estimator.belief == before


def test_a_lens_that_folds_the_picture_is_not_believed() -> None:
    """Views of the middle alone may ask for a coefficient that no lens with such corners has."""
    rng = np.random.default_rng(8)
    rays = rng.uniform([-0.8, -0.6], [0.8, 0.6], (90, 2))
    bend = 1.0 - 0.15 * (rays**2).sum(axis=1, keepdims=True)
    points = np.column_stack([rays, np.ones(90)]) * rng.uniform(2, 8, (90, 1))
    view = View(SE3.identity(), points, 330.0 * rays * bend + (320.0, 240.0), np.full(90, 0.8))
    estimator = LensEstimator.start(typical_camera(640, 480), known=False)
    belief = _learnt(estimator, [view])
    assert LensBelief.from_json(json.loads(json.dumps(belief.to_json()))) == belief
    assert len(estimator.focal_factors) > 1
