"""Readers and judges of positioning, on small recordings written here."""

from __future__ import annotations

import json
import tarfile
from pathlib import Path

import numpy as np
import pytest

from server.evaluation.positioning.activities import LabelledWindows, judge_activities, learn
from server.evaluation.positioning.crowd import VenueAnchors, follow_with_anchors, reckon_and_learn
from server.evaluation.positioning.folders import RecordingError, unpacked
from server.evaluation.positioning.mall import MallWalk, read_floors, read_walk
from server.evaluation.positioning.mall_report import MallReport
from server.evaluation.positioning.plots import draw_confusion, draw_errors, draw_floor, draw_step_errors
from server.evaluation.positioning.step_counts import judge_steps
from server.pedestrian.activities import CLASSES
from server.pedestrian.samples import Accelerometer, Gyroscope, Magnetometer, WifiScan
from tests.pedestrian.walkers import Walker

KINDS = {
    Accelerometer: "TYPE_ACCELEROMETER",
    Gyroscope: "TYPE_GYROSCOPE",
    Magnetometer: "TYPE_MAGNETIC_FIELD",
}


def write_mall_walk(file: Path, walker: Walker) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    begin = 1_574_559_495_255
    times, positions, _, _ = walker.path()
    lines = [(0.0, "#\tstartTime")]
    for sample in walker.samples():
        lines.append((sample.t, f"{KINDS[type(sample)]}\t{sample.x}\t{sample.y}\t{sample.z}\t3"))
    for t in (0.0, float(times[len(times) // 2]), float(times[-1])):
        x, y = positions[int(np.searchsorted(times, t))]
        lines.append((t, f"TYPE_WAYPOINT\t{x}\t{y}"))
    for t in np.arange(2.0, times[-1], 2.0):
        for age, name in ((0.5, "fresh"), (20.0, "stale")):
            lines.append((float(t), f"TYPE_WIFI\tnet\t{name}\t-50\t2412\t{begin + round(1e3 * (t - age))}"))
    lines.sort(key=lambda line: line[0])
    text = "\n".join(line if line[0] == "#" else f"{begin + round(1e3 * t)}\t{line}" for t, line in lines)
    file.write_text(text, encoding="utf-8")


@pytest.fixture
def floor(tmp_path: Path) -> Path:
    folder = tmp_path / "site1" / "F2"
    for seed in range(3):
        write_mall_walk(folder / "path_data_files" / f"{seed}.txt", Walker(noise=0.5, seed=seed))
    info = {"map_info": {"width": 30.0, "height": 30.0}}
    (folder / "floor_info.json").write_text(json.dumps(info), encoding="utf-8")
    return folder


def walks(floor: Path) -> tuple[MallWalk, ...]:
    (read,) = read_floors(sorted(floor.rglob("path_data_files/*.txt")))
    assert read.name == "site1/F2"
    return read.walks


def test_stale_readings_are_left_out_and_scans_carry_the_time_they_were_heard(floor: Path) -> None:
    walk = walks(floor)[0]
    scans = [(t, s) for t, s in zip(walk.delivered, walk.samples, strict=True) if isinstance(s, WifiScan)]
    assert scans
    assert all(scan.readings == (("fresh", -50.0),) for _, scan in scans)
    assert all(t - scan.t == pytest.approx(0.5, abs=0.01) for t, scan in scans)
    assert list(walk.delivered) == sorted(walk.delivered)


def test_a_walk_is_judged_at_its_waypoints(floor: Path) -> None:
    tracks = [reckon_and_learn(walk)[0] for walk in walks(floor)]
    report = MallReport(tuple(tracks), ()).to_json()
    assert report["waypoints"] == 6
    assert report["dead_reckoning_median_m"] < 1.0
    assert report["anchors_median_m"] is None
    assert report["judged"] == ["site1/F2"]


def test_nothing_of_a_walk_is_in_the_anchors_it_is_followed_with(
    floor: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And of the others, nothing but sensors and starts: moved later waypoints change nothing."""
    read = walks(floor)
    contributions = [reckon_and_learn(walk)[1] for walk in read]
    taught: list[list[str]] = []
    begin = VenueAnchors.__init__

    def watched(self: VenueAnchors, given: list) -> None:
        taught.append([contribution.walk for contribution in given])
        begin(self, given)

    monkeypatch.setattr(VenueAnchors, "__init__", watched)
    track = follow_with_anchors(read[0], contributions)
    assert taught == [["1", "2"]]
    for walk in read[1:]:
        walk.waypoints[1:, 1:] += 100.0
    again = follow_with_anchors(read[0], [reckon_and_learn(walk)[1] for walk in read])
    assert np.array_equal(again.estimates, track.estimates)


def test_an_estimate_knows_nothing_of_what_is_handed_over_later(floor: Path) -> None:
    walk = walks(floor)[0]
    whole = reckon_and_learn(walk)[0]
    middle = walk.waypoints[1, 0]
    count = sum(t <= middle for t in walk.delivered)
    cut = MallWalk(walk.name, walk.floor, walk.samples[:count], walk.delivered[:count], walk.waypoints[:2])
    assert np.array_equal(reckon_and_learn(cut)[0].estimates[0], whole.estimates[0])


def test_a_file_that_is_no_walk_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "walk.txt"
    file.write_text("1\tTYPE_ACCELEROMETER\tx\ty\tz\n", encoding="utf-8")
    with pytest.raises(RecordingError, match=r"walk\.txt"):
        read_walk(file, "floor")


def test_archives_are_unpacked_and_emptiness_is_told(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"\*\.csv"), unpacked(tmp_path, "*.csv"):
        pass
    (tmp_path / "a.csv").write_text("1,2", encoding="utf-8")
    with tarfile.open(tmp_path / "data.tar.xz", "w:xz") as tar:
        tar.add(tmp_path / "a.csv", "inside/a.csv")
    (tmp_path / "a.csv").unlink()
    with unpacked(tmp_path, "*.csv") as files:
        assert [file.name for file in files] == ["a.csv"]


def test_steps_are_counted_against_the_foot(tmp_path: Path) -> None:
    walker = Walker(noise=0.5, rate=100.0)
    _, _, _, walking = walker.path()
    true = np.floor(np.cumsum(walking) / (walker.interval * walker.rate))
    forces = [s for s in walker.samples() if isinstance(s, Accelerometer)]
    rows = [
        f"{1e9 * (s.t + 1000.0):.0f},{s.x},{s.y},{s.z},0,{count:.0f},0"
        for s, count in zip(forces, true, strict=True)
    ]
    (tmp_path / "user1_hand_1.csv").write_text("\n".join(rows), encoding="utf-8")
    figures = judge_steps(tmp_path).to_json()
    assert figures["median_error_percent"] < 3.0
    assert figures["worst_error_percent"] == figures["median_error_percent"]
    assert figures["traces"][0]["matched"] >= 0.95 * figures["traces"][0]["true_steps"]


def test_people_are_judged_by_models_of_the_others() -> None:
    """Classes that each person shows in a way of their own are not learnt from that person."""
    random = np.random.default_rng(0)
    classes = np.tile(np.arange(4), 60)
    people = np.repeat(np.arange(4), 60)
    shared = np.eye(4)[classes] * 4.0
    own = np.eye(4)[(classes + people) % 4] * 40.0
    noise = random.normal(0.0, 1.0, (240, 22))
    noise[:, :4] += shared
    known = judge_activities(LabelledWindows(noise, classes, people))
    assert known.balanced_accuracy > 0.9
    assert known.people == 4
    private = random.normal(0.0, 1.0, (240, 22))
    private[:, :4] += own
    assert judge_activities(LabelledWindows(private, classes, people)).balanced_accuracy < 0.5
    assert (learn(private, classes).probabilities(private).argmax(axis=1) == classes).mean() < 1.0


def test_pictures_are_drawn(floor: Path, tmp_path: Path) -> None:
    (read,) = read_floors(sorted(floor.rglob("path_data_files/*.txt")))
    tracks = [reckon_and_learn(walk)[0] for walk in read.walks]
    pictures = [
        draw_floor(read, tracks, tracks, tmp_path / "floor.png"),
        draw_errors({"a": tracks[0].errors}, tmp_path / "errors.png", "Errors"),
        draw_step_errors(["a"], [1.0], tmp_path / "steps.png"),
        draw_confusion(np.eye(4), [c.value for c in CLASSES], tmp_path / "confusion.png", "Activities"),
    ]
    assert all(picture.stat().st_size > 5000 for picture in pictures)
