"""From a video to a map, or to a reason: every way a build can end."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from clips import clip, write_pictures
from demo_route import DemoRoute

from server.geometry.cameras import Camera
from server.mapping.build import BuildOptions, build_route_map
from server.mapping.outcome import BuildProgress, BuildResult, BuildStage, BuildStatus
from server.mapping.route_map import Scale, ScaleSource
from server.mapping.trajectory import walked

CAMERA = Camera.pinhole(640, 480, 500.0, 500.0, 320.0, 240.0)


def _texture(seed: int, width: int = 640, height: int = 480) -> np.ndarray:
    """A picture full of corners."""
    rng = np.random.default_rng(seed)
    coarse = rng.integers(0, 256, (height // 8, width // 8, 3), np.uint8)
    return np.asarray(cv2.resize(coarse, (width, height), interpolation=cv2.INTER_NEAREST))


def _ended(result: BuildResult, status: BuildStatus, *words: str) -> None:
    assert result.status is status, (result.status, result.detail)
    assert result.route_map is None
    for word in words:
        assert word in result.detail, result.detail


def test_a_walk_becomes_a_map_of_it(demo_route: DemoRoute) -> None:
    report = demo_route.result.report
    assert demo_route.result.status is BuildStatus.READY
    assert report.frames == len(demo_route.leader.truth)
    assert report.tracked_frames >= 0.98 * report.frames
    assert report.lost == ()
    assert report.video_seconds == pytest.approx(0.1 * report.frames)
    assert report.keyframes == len(demo_route.route_map.keyframes)
    assert report.landmarks >= len(demo_route.route_map.landmarks) > 2000
    judged = demo_route.judgement.report
    assert judged.ate_percent_of_path is not None
    assert judged.ate_percent_of_path < 0.6
    assert demo_route.judgement.errors.max() < 0.25


def test_scale_is_the_same_before_and_after_each_turn(demo_route: DemoRoute) -> None:
    """Metres per unit along the corridor, after the turn, and in the room."""
    estimate, truth = demo_route.judgement.estimate, demo_route.judgement.truth

    def scale(begin: int, end: int) -> float:
        lengths = [
            np.linalg.norm(p[begin + 5 : end] - p[begin : end - 5], axis=1).sum()
            for p in (truth.position, estimate.position)
        ]
        return float(lengths[0] / lengths[1])

    parts = [scale(5, 45), scale(70, 105), scale(130, 158)]
    assert max(parts) / min(parts) < 1.05


def test_the_map_is_upright_and_begins_at_the_start(demo_route: DemoRoute) -> None:
    path = demo_route.route_map.path
    judgement = demo_route.judgement
    up = judgement.alignment.whole.rotation @ np.array([0.0, 0.0, 1.0])
    assert np.degrees(np.arccos(up[2])) < 1.0
    np.testing.assert_allclose(path.position[0], 0.0, atol=1e-9)
    assert path.arc_length[-1] == pytest.approx(path.time[-1] - path.time[0], rel=1e-6)
    assert (np.diff(path.arc_length) >= 0).all()
    left, right = demo_route.route_map.turns
    assert np.degrees(left.angle) == pytest.approx(90.0, abs=25.0)
    assert np.degrees(right.angle) == pytest.approx(-75.0, abs=25.0)


def test_the_map_holds_together(demo_route: DemoRoute) -> None:
    """Every landmark is seen twice or more, in front of the camera, where its keyframes say."""
    route_map = demo_route.route_map
    observations, landmarks = route_map.observations, route_map.landmarks
    counts = np.bincount(observations.landmark, minlength=len(landmarks))
    assert counts.min() >= 2
    np.testing.assert_allclose(np.linalg.norm(landmarks.normal, axis=1), 1.0, atol=1e-5)
    assert (landmarks.distance[:, 0] < landmarks.distance[:, 1]).all()
    errors = []
    for k in range(len(route_map.keyframes)):
        rows = observations.of_keyframe(k)
        camera_from_world = route_map.keyframes.world_from_camera(k).inverse()
        points = camera_from_world @ landmarks.position[observations.landmark[rows]]
        assert (points[:, 2] > 0).all()
        errors.append(np.linalg.norm(route_map.camera.project(points) - observations.pixel[rows], axis=1))
    assert np.median(np.concatenate(errors)) < 0.8
    assert np.percentile(np.concatenate(errors), 99) < 5.0


def test_progress_never_decreases_and_ends_at_one(demo_route: DemoRoute) -> None:
    told = demo_route.progress
    fractions = np.array([progress.fraction for progress in told])
    assert fractions[0] == 0.0
    assert np.diff(fractions).min() >= 0.0
    assert fractions[-1] == 1.0
    assert np.diff(fractions).max() < 0.25
    order = [stage for stage in BuildStage if stage is not BuildStage.CALIBRATING]
    stages = [order.index(progress.stage) for progress in told]
    assert stages == sorted(stages)
    assert set(stages) == set(range(len(order)))


def test_a_measured_length_fixes_the_scale(demo_route: DemoRoute, tmp_path: Path) -> None:
    walk = clip(demo_route.leader, tmp_path / "walk", 45)
    length = float(walked(walk.truth.position[:45], 0.1 * np.arange(45))[-1])
    assert demo_route.route_map.scale == Scale(None, ScaleSource.UNKNOWN)
    result = build_route_map(walk.video, walk.camera, BuildOptions(measured_length=length))
    route_map = result.route_map
    assert route_map is not None, result.detail
    assert route_map.scale.source is ScaleSource.MEASURED_LENGTH
    assert route_map.scale.metres(float(route_map.path.arc_length[-1])) == pytest.approx(length)
    # Distances in the map are then metres: the straight line from start to end too.
    straight = np.linalg.norm(route_map.path.position[-1] - route_map.path.position[0])
    true = np.linalg.norm(walk.truth.position[44] - walk.truth.position[0])
    assert route_map.scale.metres(float(straight)) == pytest.approx(float(true), rel=0.02)


@pytest.mark.parametrize("content", [b"", b"no video at all", b"\0" * 4000])
def test_a_file_that_is_no_video(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "video.mp4"
    path.write_bytes(content)
    told: list[BuildProgress] = []
    result = build_route_map(path, CAMERA, on_progress=told.append)
    _ended(result, BuildStatus.NOT_A_VIDEO)
    assert result.detail
    assert all(progress.fraction < 1.0 for progress in told)


def test_a_camera_of_another_shape(demo_route: DemoRoute) -> None:
    camera = Camera.pinhole(1920, 1080, 1500, 1500, 960, 540)
    result = build_route_map(demo_route.leader.video, camera)
    _ended(result, BuildStatus.CAMERA_MISMATCH, "1920x1080", "640x480")


def test_a_walk_of_a_second(demo_route: DemoRoute, tmp_path: Path) -> None:
    walk = clip(demo_route.leader, tmp_path / "walk", 19)
    _ended(build_route_map(walk.video, walk.camera), BuildStatus.TOO_SHORT, "19", "20")


def test_a_walk_that_is_too_long_is_refused_before_it_is_decoded(demo_route: DemoRoute) -> None:
    told: list[BuildProgress] = []
    result = build_route_map(
        demo_route.leader.video, demo_route.leader.camera, BuildOptions(max_seconds=15.5), told.append
    )
    _ended(result, BuildStatus.TOO_LONG, "16 s")
    assert [progress.stage for progress in told] == [BuildStage.DECODING]


def test_a_container_that_lies_about_its_length_is_stopped_on_the_way(tmp_path: Path) -> None:
    """Many frames too short in the header's view: their time stamps tell."""
    path = write_pictures(tmp_path / "video.mp4", [_texture(1)] * 60)
    data = bytearray(path.read_bytes())
    # Frame counts in AVI's main and stream headers.
    for marker, offset in ((b"avih", 24), (b"strh", 40)):
        at = data.index(marker) + offset
        data[at : at + 4] = (5).to_bytes(4, "little")
    path.write_bytes(data)
    result = build_route_map(path, CAMERA, BuildOptions(max_seconds=2.0))
    _ended(result, BuildStatus.TOO_LONG)


@pytest.mark.parametrize("grey", [0, 128])
def test_bare_walls_or_a_covered_lens(tmp_path: Path, grey: int) -> None:
    path = write_pictures(tmp_path / "video.mp4", [np.full((480, 640, 3), grey, np.uint8)] * 30)
    _ended(build_route_map(path, CAMERA), BuildStatus.NO_TEXTURE, "blank walls")


def test_a_phone_that_lies_on_the_table(tmp_path: Path) -> None:
    path = write_pictures(tmp_path / "video.mp4", [_texture(2)] * 40)
    result = build_route_map(path, CAMERA)
    _ended(result, BuildStatus.NO_MOTION, "walk")
    assert result.report.frames == 40


def test_pictures_that_have_nothing_to_do_with_one_another(tmp_path: Path) -> None:
    path = write_pictures(tmp_path / "video.mp4", [_texture(k) for k in range(30)])
    _ended(build_route_map(path, CAMERA), BuildStatus.TRACKING_LOST, "followed")


def test_the_same_video_gives_the_same_map(demo_route: DemoRoute, tmp_path: Path) -> None:
    walk = clip(demo_route.leader, tmp_path / "walk", 30)
    first, second = (build_route_map(walk.video, walk.camera).route_map for _ in range(2))
    assert first is not None
    assert second is not None
    np.testing.assert_allclose(first.path.position, second.path.position, atol=1e-9)
    np.testing.assert_array_equal(first.observations.landmark, second.observations.landmark)
