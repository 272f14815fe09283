"""Synthetic walks: how the walker moves, and the folders that are written."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from client_sim.synthetic.buildings import CORRIDOR_AND_ROOM, build_world
from client_sim.synthetic.cameras import PinholeCamera, project
from client_sim.synthetic.gait import Gait
from client_sim.synthetic.paths import smooth_path
from client_sim.synthetic.rendering import Light, Renderer
from client_sim.synthetic.small_walks import ROUTE, write_small_walks
from client_sim.synthetic.trajectories import walk
from client_sim.synthetic.walk_folders import write_walk
from server.evaluation.walk import arc_length, read_walk


def _turn_rates(rotations: np.ndarray) -> np.ndarray:
    """Degrees a second between successive frames at 10 fps."""
    relative = np.swapaxes(rotations[:-1], 1, 2) @ rotations[1:]
    cosine = (np.trace(relative, axis1=1, axis2=2) - 1) / 2
    return np.asarray(np.degrees(np.arccos(np.clip(cosine, -1, 1))) * 10)


def test_a_person_walks() -> None:
    gait = Gait()
    trajectory = walk(ROUTE, np.random.default_rng(1), gait)
    position = np.stack([pose.position for pose in trajectory.poses])
    rotation = np.stack([pose.rotation for pose in trajectory.poses])
    pace = np.linalg.norm(np.diff(position[:, :2], axis=0), axis=1) * 10
    assert pace.min() > 0.5
    assert pace.max() < 1.35
    assert np.median(pace) == pytest.approx(gait.speed, rel=0.12)
    assert position[:, 2].mean() == pytest.approx(gait.height, abs=0.01)
    assert 0.03 < np.ptp(position[:, 2]) < 0.06
    assert _turn_rates(rotation).max() < 75.0
    ahead = np.diff(position[:, :2], axis=0)
    ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
    facing = (rotation[:-1, :2, 2] * ahead).sum(axis=1)
    assert np.degrees(np.arccos(facing.clip(-1, 1))).max() < 45.0
    np.testing.assert_allclose(np.linalg.det(rotation), 1.0)


def test_steps_bob_at_the_step_rate() -> None:
    trajectory = walk(((0.0, 0.0), (20.0, 0.0)), np.random.default_rng(2), Gait(step_rate=2.0))
    height = np.array([pose.position[2] for pose in trajectory.poses])
    spectrum = np.abs(np.fft.rfft((height - height.mean()) * np.hanning(len(height))))
    frequency = np.fft.rfftfreq(len(height), 0.1)
    assert frequency[spectrum.argmax()] == pytest.approx(2.0, abs=0.1)


def test_corners_are_rounded_and_ends_stay() -> None:
    path = smooth_path(((0.0, 0.0), (5.0, 0.0), (5.0, 5.0)), 0.5)
    np.testing.assert_allclose(path[0], [0.0, 0.0], atol=1e-6)
    np.testing.assert_allclose(path[-1], [5.0, 5.0], atol=0.03)
    nearest = np.linalg.norm(path - [5.0, 0.0], axis=1).min()
    assert 0.15 < nearest < 0.5
    step = np.diff(path, axis=0)
    turn = np.abs(np.diff(np.unwrap(np.arctan2(step[:, 1], step[:, 0]))))
    assert turn.max() < 0.05


def test_wandering_stays_within_its_bound() -> None:
    straight = ((0.0, 0.0), (30.0, 0.0))
    still = Gait(sway=0.0)
    side = [p.position[1] for p in walk(straight, np.random.default_rng(3), still, wander=0.3).poses]
    assert 0.15 < np.abs(side).max() <= 0.3 + 1e-6
    assert np.abs([p.position[1] for p in walk(straight, np.random.default_rng(3), still).poses]).max() < 1e-9


def test_a_walk_is_its_seed() -> None:
    first, again, other = (walk(ROUTE, np.random.default_rng(seed)) for seed in (5, 5, 6))
    for a, b in zip(first.poses, again.poses, strict=True):
        np.testing.assert_array_equal(a.rotation, b.rotation)
        np.testing.assert_array_equal(a.position, b.position)
    assert np.abs(first.poses[9].position - other.poses[9].position).max() > 1e-3


@pytest.fixture(scope="module")
def demo(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path, list[float]]:
    """The demo's walks and the progress that was told."""
    told: list[float] = []
    leader, follower = write_small_walks(tmp_path_factory.mktemp("demo"), told.append)
    return leader, follower, told


def test_demo_walks_are_walk_folders(demo: tuple[Path, Path, list[float]]) -> None:
    leader, follower, told = demo
    walks = read_walk(leader), read_walk(follower)
    for recorded in walks:
        length = arc_length(recorded.truth.position)[-1]
        assert 15.0 < length < 20.0
        assert recorded.world == "synthetic"
        assert not recorded.real
        assert recorded.meta["path_length_m"] == pytest.approx(length, rel=0.02)
        video = cv2.VideoCapture(str(recorded.video))
        assert video.get(cv2.CAP_PROP_FPS) == pytest.approx(10.0)
        count = 0
        while video.read()[0]:
            count += 1
        video.release()
        assert count == len(recorded.truth) == recorded.meta["frames"]
    assert walks[0].camera.focal != walks[1].camera.focal
    apart = np.linalg.norm(
        walks[1].truth.position[:, None, :2] - walks[0].truth.position[None, :, :2], axis=2
    ).min(axis=1)
    assert 0.15 < apart.max() < 0.45
    assert np.diff(told).min() >= 0.0
    assert told[-1] == pytest.approx(1.0)


def test_demo_frames_carry_enough_to_track(demo: tuple[Path, Path, list[float]]) -> None:
    video = cv2.VideoCapture(str(demo[0] / "video.mp4"))
    orb = cv2.ORB_create(1000)
    counts = []
    while True:
        good, frame = video.read()
        if not good:
            break
        counts.append(len(orb.detect(cv2.cvtColor(frame, cv2.COLOR_BGR2GRAY))))
    video.release()
    assert min(counts) > 150
    assert np.median(counts) > 800


def test_the_written_truth_is_of_the_written_frames(tmp_path: Path) -> None:
    """What the file says of frame k projects a poster's corner to where frame k shows it."""
    rng = np.random.default_rng(8)
    world = build_world("synthetic", CORRIDOR_AND_ROOM, rng)
    camera = PinholeCamera(width=320, height=240, fx=260.0, fy=260.0, cx=160.0, cy=120.0)
    renderer = Renderer(world, camera)
    trajectory = walk(ROUTE[:2], rng)
    write_walk(tmp_path / "w", renderer, trajectory, rng, light=Light(), meta={"role": "leader"})
    recorded = read_walk(tmp_path / "w")
    assert json.loads((tmp_path / "w" / "camera.json").read_text())["fps"] == 10.0
    video = cv2.VideoCapture(str(recorded.video))
    for row in range(0, len(recorded.truth), 10):
        pose = trajectory.poses[row]
        np.testing.assert_allclose(recorded.truth.position[row], pose.position, atol=1e-6)
        np.testing.assert_allclose(recorded.truth.rotation[row], pose.rotation, atol=1e-6)
        point = pose.position + pose.rotation @ [0.3, 0.2, 2.0]
        seen = recorded.truth.rotation[row].T @ (point - recorded.truth.position[row])
        np.testing.assert_allclose(recorded.camera.project(seen), project(camera, pose, point), atol=1e-3)
        video.set(cv2.CAP_PROP_POS_FRAMES, row)
        good, frame = video.read()
        assert good
        error = frame.astype(float) - renderer.render(pose, Light(noise=0.0))
        assert 10 * np.log10(255**2 / (error**2).mean()) > 28.0
    video.release()
