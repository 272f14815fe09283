"""Recordings of walks through the office: what is planned, and the folders that are written."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from typer.testing import CliRunner

from client_sim.synthetic.cameras import LensCamera, PinholeCamera, Pose
from client_sim.synthetic.office import build_office
from client_sim.synthetic.outlines import clearance, outlines
from client_sim.synthetic.recordings import (
    Recording,
    Role,
    Span,
    WalkPlan,
    checkpoints,
    off_route,
    plan_recording,
)
from client_sim.synthetic.rendering import Renderer
from client_sim.synthetic.trajectories import sample
from client_sim.synthetic.venue import Building
from client_sim.synthetic.walk_folders import write_recording
from client_sim.walk import Walk
from server.cli import app
from server.evaluation.walk import read_walk
from server.geometry.poses import rotation_angle

FOLLOWER = WalkPlan(Role.FOLLOWER, seed=3)


@pytest.fixture(scope="module")
def office() -> Building:
    return build_office()


def _plan(office: Building, route: str = "main", plan: WalkPlan = FOLLOWER) -> Recording:
    return plan_recording(office, route, plan)


def _times(recording: Recording) -> NDArray[np.float64]:
    return sample(recording.motion, recording.fps).times


def test_a_walk_is_its_plan_and_another_seed_another_walk(office: Building) -> None:
    first, again, other = (_plan(office, plan=WalkPlan(Role.FOLLOWER, seed)) for seed in (3, 3, 4))
    np.testing.assert_array_equal(first.motion.position, again.motion.position)
    assert first.meta == again.meta
    assert first.meta["camera_height_m"] != other.meta["camera_height_m"]
    assert first.meta["speed_m_s"] != other.meta["speed_m_s"]


@pytest.mark.parametrize(
    ("route", "turns", "rooms"),
    [
        ("main", [90, 90, 90, -90, -90, -90], ["lobby", "mirror", "office", "blank wall", "meeting room"]),
        ("stairs", [-90, 180, -90, 90, 90], ["lobby", "stairs below", "landing", "stairs above", "library"]),
    ],
)
def test_turns_and_rooms_are_written_down_where_they_are(
    office: Building, route: str, turns: list[int], rooms: list[str]
) -> None:
    recording = _plan(office, route, WalkPlan())
    found = checkpoints(recording, _times(recording))
    assert [round(c["angle_deg"] / 30) * 30 for c in found if c["kind"] == "turn"] == turns
    assert [c["room"] for c in found if c["kind"] == "enter_room"] == rooms
    for checkpoint in found:
        place = recording.motion.positions(_times(recording)[[checkpoint["frame"]]])[0]
        np.testing.assert_allclose(checkpoint["position"], place, atol=1e-3)
        if checkpoint["kind"] == "enter_room":
            assert np.linalg.norm(place - office.places[checkpoint["room"]] - [0, 0, 1.5]) < 1.7


@pytest.mark.parametrize("route", ["main", "stairs"])
def test_nobody_walks_through_walls_or_furniture(office: Building, route: str) -> None:
    plans = [WalkPlan(), *(WalkPlan(Role.FOLLOWER, seed) for seed in range(6))]
    for plan in plans:
        motion = _plan(office, route, plan).motion
        for above in (0.5, 1.0, 1.5):
            heights = motion.ground[::5, 2] + above
            for level in np.unique(heights.round(1)):
                here = motion.position[::5][np.abs(heights - level) < 0.051, :2]
                room = clearance(outlines(office.world, float(level)), here)
                assert room.min() > (0.3 if plan.role is Role.LEADER else 0.12)


def test_passers_by_meet_the_walker_and_keep_their_side(office: Building) -> None:
    recording = _plan(office, plan=replace(FOLLOWER, people=3))
    assert len(recording.people) == 3
    times = _times(recording)
    ground = recording.motion.grounds(times)
    for person in recording.people:
        places = [s[0].centre if (s := person.at(float(t))) else np.full(3, np.nan) for t in times]
        apart = np.linalg.norm(np.array(places)[:, :2] - ground[:, :2], axis=1)
        assert np.nanmin(apart) < 1.2
        assert np.nanmin(apart) > 0.2
        assert np.nanmax(apart) > 6.0


def test_leaving_the_route_is_known(office: Building) -> None:
    aside = ((18.9, 9.0, 0.0), (18.9, 15.5, 0.0))
    plan = replace(FOLLOWER, leave=28.2, aside=aside[1:])
    recording = _plan(office, plan=plan)
    apart, away = off_route(recording, _times(recording))
    assert apart.max() == pytest.approx(2.0, abs=0.5)
    assert away is not None
    first, last = away
    assert apart[first - 1] <= 1.0 < apart[first]
    assert apart[last + 1] <= 1.0 < apart[last]
    assert off_route(_plan(office), _times(_plan(office)))[1] is None


def test_phones_are_held_upright_across_and_rolled(office: Building) -> None:
    portrait = _plan(office, plan=replace(FOLLOWER, portrait=True))
    assert (portrait.camera.width, portrait.camera.height) == (480, 640)
    wide = _plan(office, plan=replace(FOLLOWER, phone="wide"))
    assert isinstance(wide.camera, LensCamera)
    rolled = _plan(office, plan=replace(FOLLOWER, rolled=4.0))
    right = rolled.motion.rotations(np.array([3.0, 8.0]))[:, :, 0]
    assert abs(right[0, 2]) < 0.1
    assert right[1, 2] > 0.99, "counter-clockwise: the picture's right is up"


@pytest.mark.parametrize(
    ("route", "plan", "complaint"),
    [
        ("cellar", WalkPlan(), "no route 'cellar'; there are: main, stairs"),
        ("main", WalkPlan(phone="none"), "no phone 'none'; there are: reference"),
        ("main", WalkPlan(leave=200.0, aside=((0.0, 0.0, 0.0),)), "cannot be left at 200"),
        ("main", WalkPlan(leave=20.0), "say where to"),
        ("main", WalkPlan(turn_back=20.0, pauses=((5.0, 2.0),)), "neither pauses nor leaves"),
    ],
)
def test_what_cannot_be_walked_is_said(office: Building, route: str, plan: WalkPlan, complaint: str) -> None:
    with pytest.raises(ValueError, match=complaint):
        plan_recording(office, route, plan)


@pytest.fixture(scope="module")
def recorded(
    office: Building, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Recording, Path, list[float]]:
    """Five seconds in a corridor past somebody, with a thumb on the lens for one of them."""
    short = replace(office, routes={"short": ((7.5, 2.7, 0.0), (13.5, 2.7, 0.0))})
    plan = WalkPlan(Role.FOLLOWER, seed=2, people=1, wander=0.1, covered=(Span(2.0, 3.0),))
    recording = plan_recording(short, "short", plan)
    recording = replace(recording, camera=PinholeCamera(320, 240, 260.0, 260.0, 160.0, 120.0))
    told: list[float] = []
    folder = tmp_path_factory.mktemp("walks") / "follower"
    write_recording(folder, recording, told.append, building_seed=7)
    return recording, folder, told


def _frames(folder: Path) -> list[NDArray[np.uint8]]:
    return [frame.image for frame in Walk.from_folder(folder).frames()]


def test_a_recording_is_a_walk_folder(recorded: tuple[Recording, Path, list[float]]) -> None:
    recording, folder, told = recorded
    walk = read_walk(folder)
    frames = _frames(folder)
    assert len(frames) == len(walk.truth) == walk.meta["frames"]
    assert told[-1] == 1.0
    assert walk.world == "office"
    assert not walk.real
    assert walk.meta["role"] == "follower"
    assert walk.meta["covered_s"] == [[2.0, 3.0]]
    assert len(walk.meta["distance_to_leader_route_m"]) == len(frames)
    assert len(walk.meta["steps"]) == len(recording.motion.steps)
    for row in (0, len(frames) // 2):
        pose = recording.motion.pose(row / 10)
        np.testing.assert_allclose(walk.truth.position[row], pose.position, atol=1e-6)
        assert rotation_angle(walk.truth.rotation[row].T @ pose.rotation) < 1e-6


def test_a_covered_lens_is_dark_and_only_then(recorded: tuple[Recording, Path, list[float]]) -> None:
    _, folder, _ = recorded
    levels = np.array([frame.mean() for frame in _frames(folder)])
    np.testing.assert_array_equal(np.flatnonzero(levels < 20), np.arange(20, 30))
    assert levels[:20].min() > 50


def test_masks_of_people_are_where_they_are(recorded: tuple[Recording, Path, list[float]]) -> None:
    recording, folder, _ = recorded
    masks = np.load(folder / "people_masks.npz")
    height, width = masks["shape"]
    keys = [key for key in masks.files if key != "shape"]
    assert keys
    (person,) = recording.people
    for key in keys:
        mask = np.unpackbits(masks[key])[: height * width].reshape(height, width).astype(bool)
        assert mask.any()
        time = int(key) / 10
        assert time not in Span(2.0, 3.0)
        pose = recording.motion.pose(time)
        x, y, z = pose.to_camera(np.mean([solid.centre for solid in person.at(time)], axis=0))
        column, row = 260 * x / z + 160, 260 * y / z + 120
        rows, columns = np.nonzero(mask)
        if 20 < column < 300 and 20 < row < 220:
            assert columns.min() - 3 <= column <= columns.max() + 3
            assert rows.min() - 3 <= row <= rows.max() + 3


def test_sensors_are_lines_in_the_order_of_time(recorded: tuple[Recording, Path, list[float]]) -> None:
    recording, folder, _ = recorded
    readings = list(Walk.from_folder(folder).readings())
    times = [reading["t"] for reading in readings]
    assert times == sorted(times)
    counts = {kind: sum(r["type"] == kind for r in readings) for kind in {r["type"] for r in readings}}
    inertial = round(recording.motion.duration * 50)
    for kind in ("accelerometer", "gyroscope", "magnetometer", "barometer"):
        assert counts[kind] == pytest.approx(inertial, abs=2)
    assert counts["wifi"] == pytest.approx(recording.motion.duration / 2, abs=1)
    scan = next(r for r in readings if r["type"] == "wifi")
    assert all(set(heard) == {"bssid", "rssi"} for heard in scan["readings"])
    assert all(len(r["v"]) == 3 for r in readings if r["type"] == "gyroscope")


def test_the_truth_moves_as_the_pictures_do(recorded: tuple[Recording, Path, list[float]]) -> None:
    """Where the truth says that a picture's points are in the next picture, there they are."""
    recording, folder, _ = recorded
    frames, truth = _frames(folder), read_walk(folder).truth
    renderer = Renderer(recording.building.world, recording.camera)
    people = set(np.load(folder / "people_masks.npz").files)
    errors = []
    for row in range(0, len(frames) - 1, 3):
        if {f"{row:06d}", f"{row + 1:06d}"} & people or min(frames[row].mean(), frames[row + 1].mean()) < 30:
            continue
        first, second = (Pose(truth.rotation[k], truth.position[k]) for k in (row, row + 1))
        a, b = (cv2.cvtColor(frames[k], cv2.COLOR_BGR2GRAY) for k in (row, row + 1))
        corners = cv2.goodFeaturesToTrack(a, 150, 0.02, 7).reshape(-1, 2)
        pixels = corners.round().astype(int)
        depth = renderer.shoot([first]).depth[pixels[:, 1], pixels[:, 0]]
        x, y = (corners[:, 0] - 159.5) / 260.0, (corners[:, 1] - 119.5) / 260.0
        points = np.stack([x, y, np.ones_like(x)], axis=1) * depth[:, None]
        there = second.to_camera(points @ first.rotation.T + first.position)
        expected = 260.0 * there[:, :2] / there[:, 2:] + [159.5, 119.5]
        way = np.linalg.norm(expected - corners, axis=1)
        if not 1.0 < np.median(way) < 8.0:
            continue
        moved, status, _ = cv2.calcOpticalFlowPyrLK(a, b, corners.reshape(-1, 1, 2), None)
        errors.append(np.linalg.norm(expected - moved.reshape(-1, 2), axis=1)[status.ravel() == 1])
    # Compressed pictures of a quarter of the size: flow is good to about half a pixel.
    assert len(np.concatenate(errors)) > 50
    assert np.median(np.concatenate(errors)) < 0.6


def test_the_command_says_what_it_cannot_record(tmp_path: Path) -> None:
    runner = CliRunner()
    for arguments, complaint in (
        (["--route", "cellar"], "there are: main, stairs"),
        (["--cover", "12-14"], "expected two numbers with a colon"),
        (["--leave", "20", "--aside", "4,5"], "expected a point as x,y,z"),
    ):
        done = runner.invoke(app, ["sim", "record", str(tmp_path / "walk"), *arguments])
        assert done.exit_code == 1
        assert complaint in done.stderr
        assert not (tmp_path / "walk").exists()
    done = runner.invoke(app, ["sim", "record", "--help"])
    assert done.exit_code == 0
    assert "--turn-back" in done.stdout


def test_camera_files_are_what_the_pictures_are(recorded: tuple[Recording, Path, list[float]]) -> None:
    _, folder, _ = recorded
    document = json.loads((folder / "camera.json").read_text())
    assert document == {
        "model": "PINHOLE",
        "width": 320,
        "height": 240,
        "params": [260.0, 260.0, 160.0, 120.0],
        "fps": 10.0,
    }
    assert _frames(folder)[0].shape == (240, 320, 3)
