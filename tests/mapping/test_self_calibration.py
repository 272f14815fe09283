"""The leader's lens: voted for on synthetic tracks, learnt in builds of rendered walks."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from clips import clip, write_pictures
from demo_route import DemoRoute, judged

from client_sim.synthetic.buildings import CORRIDOR_AND_ROOM, build_world
from client_sim.synthetic.cameras import LensCamera, level_rotation
from client_sim.synthetic.rendering import Light, Renderer
from client_sim.synthetic.small_walks import ROUTE
from client_sim.synthetic.trajectories import walk
from client_sim.synthetic.walk_folders import write_walk
from server.evaluation.walk import Walk, read_walk
from server.features.extraction import Features
from server.features.tracking import TrackedFeatures
from server.geometry.cameras import Camera, CameraModel, typical_camera
from server.mapping.build import build_route_map
from server.mapping.outcome import BuildResult, BuildStatus, CameraSource
from server.mapping.self_calibration import FocalVote, _epipolar_cost, fitted_camera, vote_focal

BENT = LensCamera("SIMPLE_RADIAL", 640, 480, (500.0, 320.0, 240.0, -0.15))
FRAMES = 100
"""Of the small walk, where its end is not needed: along the corridor, and round the first turn."""


def _tracks(focal: float, turn: float, rng: np.random.Generator) -> list[TrackedFeatures]:
    """Tracks of points all around a camera that walks 0.1 m a frame and turns by ``turn`` radians a frame."""
    camera = Camera.pinhole(640, 480, focal, focal, 320.0, 240.0)
    points = rng.uniform([-10, -10, 0], [20, 10, 3], (6000, 3))
    frames, position = [], np.array([0.0, 0.0, 1.5])
    for k in range(80):
        rotation = level_rotation(turn * k)
        position = position + 0.1 * rotation[:, 2]
        local = (points - position) @ rotation
        near = (local[:, 2] > 1.0) & (local[:, 2] < 9.0)
        pixels = np.zeros((len(points), 2))
        pixels[near] = camera.project(local[near]) + 0.3 * rng.normal(size=(int(near.sum()), 2))
        seen = np.flatnonzero(near & (pixels > 0).all(axis=1) & (pixels < (640, 480)).all(axis=1))
        features = Features(
            pixels[seen],
            np.zeros((len(seen), 32), np.uint8),
            np.zeros(len(seen), np.int8),
            np.zeros(len(seen), np.float32),
        )
        frames.append(TrackedFeatures(features, seen.astype(np.int64), np.zeros(len(seen), np.int64)))
    return frames


@pytest.mark.parametrize("focal", [380.0, 500.0, 700.0])
def test_a_walk_that_turns_tells_the_focal_length(focal: float) -> None:
    vote = vote_focal(_tracks(focal, 0.03, np.random.default_rng(1)), typical_camera(640, 480))
    assert vote.decided
    assert vote.focal == pytest.approx(focal, rel=0.03)
    assert vote.low <= focal * 1.05
    assert vote.high >= focal / 1.05
    assert vote.contradicts(2.0 * focal)
    assert not vote.contradicts(focal)


def test_a_walk_straight_ahead_tells_nothing() -> None:
    vote = vote_focal(_tracks(500.0, 0.0, np.random.default_rng(2)), typical_camera(640, 480))
    assert not vote.decided
    assert not vote.contradicts(2000.0)


def test_a_walk_without_motion_is_undecided() -> None:
    still = _tracks(500.0, 0.03, np.random.default_rng(3))[:1] * 30
    assert vote_focal(still, typical_camera(640, 480)) == FocalVote(512.0, 256.0, 1024.0, False)


def test_a_camera_is_fitted_to_its_own_rays() -> None:
    true = Camera(CameraModel.RADIAL, 640, 480, (510.0, 318.0, 243.0, -0.11, 0.02))
    u, v = np.meshgrid(np.linspace(0, 640, 9), np.linspace(0, 480, 7))
    pixels = np.stack([u, v], axis=-1).reshape(-1, 2)
    found = fitted_camera(pixels, true.normalize(pixels), true)
    np.testing.assert_allclose(found.params, true.params, rtol=1e-5, atol=1e-6)


@pytest.fixture(scope="module")
def bent(tmp_path_factory: pytest.TempPathFactory) -> Walk:
    """The small walk through a lens that bends straight lines."""
    folder = tmp_path_factory.mktemp("bent")
    world = build_world("synthetic", CORRIDOR_AND_ROOM, np.random.default_rng([7, 0]))
    rng = np.random.default_rng([7, 1])
    write_walk(folder, Renderer(world, BENT), walk(ROUTE, rng), rng, light=Light())
    return read_walk(folder)


def _is_mapped(walk: Walk, result: BuildResult, source: CameraSource, percent: float) -> Camera:
    """The camera of a build that gave a good map."""
    judgement = judged(walk, result)
    assert result.report.tracked_frames >= 0.98 * result.report.frames
    assert judgement.report.ate_percent_of_path is not None
    assert judgement.report.ate_percent_of_path < percent
    assert result.report.camera_source is source
    assert result.report.camera is not None
    return result.report.camera


def _bends_like(camera: Camera, true: Camera, tolerance: float) -> None:
    """Their pixels lie within a share of the picture's size where the same rays are seen."""
    pixels = np.array([(320.0, 240.0), (480.0, 240.0), (320.0, 40.0), (600.0, 440.0), (60.0, 60.0)])
    offset = camera.project_rays(true.normalize(pixels)) - pixels
    assert np.abs(offset).max() < tolerance * 640


def test_an_unknown_bent_lens_is_learnt_from_the_walk(bent: Walk) -> None:
    camera = _is_mapped(bent, build_route_map(bent.video, None), CameraSource.ESTIMATED, 0.8)
    assert camera.focal[0] == pytest.approx(500.0, rel=0.02)
    assert camera.distortion[0] == pytest.approx(-0.15, abs=0.03)
    assert bent.camera is not None
    _bends_like(camera, bent.camera, 0.012)


def test_a_bent_lens_that_was_described_is_kept(bent: Walk) -> None:
    camera = _is_mapped(bent, build_route_map(bent.video, bent.camera), CameraSource.GIVEN, 0.8)
    assert camera == bent.camera


@pytest.mark.parametrize("factor", [0.7, 1.3])
def test_a_camera_that_the_walk_contradicts_is_corrected(
    demo_route: DemoRoute, tmp_path: Path, factor: float
) -> None:
    """A map of an odometry that believed in it would be bent by metres, whatever is adjusted afterwards."""
    walk = clip(demo_route.leader, tmp_path / "walk", FRAMES)
    wrong = Camera.pinhole(640, 480, 500.0 * factor, 500.0 * factor, 320.0, 240.0)
    camera = _is_mapped(walk, build_route_map(walk.video, wrong), CameraSource.REFINED, 1.0)
    assert camera.focal[0] == pytest.approx(500.0, rel=0.02)


def test_a_walk_that_does_not_turn_is_mapped_with_a_typical_lens(
    demo_route: DemoRoute, tmp_path: Path
) -> None:
    walk = clip(demo_route.leader, tmp_path / "walk", 35)
    result = build_route_map(walk.video, None)
    assert result.status is BuildStatus.READY, result.detail
    assert result.report.camera_source is CameraSource.ASSUMED
    assert result.report.camera is not None
    assert result.report.camera.focal == pytest.approx((512.0, 512.0))
    assert result.report.camera.distortion == pytest.approx((0.0, 0.0), abs=1e-6)


def test_a_portrait_video_is_mapped(demo_route: DemoRoute, tmp_path: Path) -> None:
    """Taller than wide: the small walk's pictures turned on their side, and the camera with them."""
    source = clip(demo_route.leader, tmp_path / "walk", 35)
    reader, pictures = cv2.VideoCapture(str(source.video)), []
    while (read := reader.read())[0]:
        pictures.append(np.asarray(cv2.rotate(read[1], cv2.ROTATE_90_CLOCKWISE)))
    reader.release()
    video = write_pictures(tmp_path / "tall.mp4", pictures)
    result = build_route_map(video, Camera.pinhole(480, 640, 500.0, 500.0, 240.0, 320.0))
    assert result.route_map is not None, result.detail
    assert result.report.tracked_frames == result.report.frames == 35
    assert (result.route_map.camera.width, result.route_map.camera.height) == (480, 640)
    # A straight walk: in the map too, and it looks where it goes.
    path = result.route_map.path
    forward = path.position[-1] / np.linalg.norm(path.position[-1])
    sideways = path.position - np.outer(path.position @ forward, forward)
    assert np.linalg.norm(sideways, axis=1).max() < 0.03 * np.linalg.norm(path.position[-1])


def test_tracks_on_one_line_speak_for_no_focal_length() -> None:
    """There is no relative pose of them: none must not count as one that fits."""
    first, there = (
        np.column_stack([np.linspace(-300.0, 300.0, 80) + at, np.zeros(80)]) for at in (0.0, 20.0)
    )
    costs = [_epipolar_cost(first, there, focal, 1.5) for focal in (300.0, 500.0, 900.0)]
    assert costs == pytest.approx([80 * 4.0] * 3)
