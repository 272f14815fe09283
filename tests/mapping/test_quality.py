"""The quality report: planted faults are named with their seconds, clean walks are left in peace."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from clips import clip
from demo_route import DemoRoute
from judged_pictures import judge_pictures, read_pictures
from planted_faults import KINDS, Fault, draw_faults, plant

from client_sim.synthetic.buildings import CORRIDOR_AND_ROOM, build_world
from client_sim.synthetic.cameras import PinholeCamera, Pose, level_rotation
from client_sim.synthetic.rendering import Light, Renderer
from client_sim.synthetic.worlds import World
from server.geometry.cameras import Camera
from server.mapping.build import build_route_map
from server.mapping.frame_statistics import frame_statistics
from server.mapping.outcome import BuildStatus
from server.mapping.quality import NO_MAP_CAP, QualityReport, Timeline, WeakStretch
from server.mapping.quality_files import write_quality_report
from server.mapping.weak_stretches import FrameEvidence, Run, WeakReason, find_weak_runs


def _named(report: QualityReport) -> list[tuple[str, float, float]]:
    return [(str(s.reason), s.start_s, s.end_s) for s in report.stretches]


def _assert_named(report: QualityReport, faults: list[Fault], within_s: float = 0.3) -> None:
    """Every fault and nothing else, each at its time."""
    named = _named(report)
    assert [reason for reason, _, _ in named] == [fault.reason for fault in faults], named
    for (_, start, end), fault in zip(named, faults, strict=True):
        assert start == pytest.approx(fault.begin / 10, abs=within_s + 1e-6), (fault, named)
        assert end == pytest.approx(fault.end / 10, abs=within_s + 1e-6), (fault, named)


@pytest.mark.parametrize(("seed", "seconds", "adjacent"), [(1, 2.0, False), (3, 1.0, True)])
def test_planted_faults_are_named(demo_route: DemoRoute, seed: int, seconds: float, adjacent: bool) -> None:
    pictures = read_pictures(demo_route.leader.video)
    rng = np.random.default_rng([seed, 5])
    faults = draw_faults(len(pictures), 10.0, seconds, rng, adjacent=adjacent)
    _assert_named(judge_pictures(plant(pictures, faults, rng), demo_route.leader.camera), faults)


@pytest.mark.parametrize("kind", list(KINDS))
def test_every_kind_of_fault_is_named(demo_route: DemoRoute, kind: str) -> None:
    pictures = read_pictures(demo_route.leader.video)[40:75]
    fault = Fault(10, 24, KINDS[kind][0], kind)
    rng = np.random.default_rng(6)
    _assert_named(judge_pictures(plant(pictures, [fault], rng), demo_route.leader.camera), [fault])


def test_a_clean_walk_is_left_in_peace(demo_route: DemoRoute) -> None:
    quality = demo_route.result.quality
    assert quality is not None
    assert quality.stretches == ()
    assert quality.score >= 95
    assert not quality.record_again
    assert quality.coverage > 0.95
    assert quality.timeline.position is not None
    assert quality.timeline.landmarks.min() > 0


def test_a_walk_that_tears_is_judged_too(demo_route: DemoRoute, tmp_path: Path) -> None:
    """Four seconds of darkness: no map, and the report says which stretch to walk again."""
    walk = clip(demo_route.leader, tmp_path / "walk", 100, black=range(45, 85))
    result = build_route_map(walk.video, walk.camera)
    assert result.status is BuildStatus.TRACKING_LOST
    assert result.quality is not None
    _assert_named(result.quality, [Fault(45, 85, "too_dark", "black")], within_s=0.11)
    (stretch,) = result.quality.stretches
    assert stretch.severity == 1.0
    assert "light" in stretch.detail
    assert stretch.thumbnail is not None
    assert result.quality.record_again
    assert result.quality.score <= NO_MAP_CAP
    assert "4.5-8.5 s" in result.quality.verdict
    assert result.quality.timeline.position is None


def _bare_corridor() -> World:
    """The corridor whose right-hand wall is bare; light falls off along it."""
    world = build_world("bare", CORRIDOR_AND_ROOM, np.random.default_rng(7))
    wall = world.quads[0]
    across = np.linspace(215.0, 190.0, wall.texture.shape[1])[None, :, None]
    noise = np.random.default_rng(8).normal(0.0, 1.5, wall.texture.shape)
    return replace(world, quads=(replace(wall, texture=(across + noise).astype(np.uint8)), *world.quads[1:]))


def test_a_turn_to_a_bare_wall_and_back_is_one_fault() -> None:
    """Walking, a quick turn to the wall, two seconds of it, back, and on: the turns are its doing."""
    turn = np.radians(15.0) * np.arange(1, 7)
    heading = np.concatenate([np.zeros(15), -turn, np.full(20, -turn[-1]), -turn[::-1], np.zeros(15)])
    x = 1.5 + np.cumsum(np.where(heading == 0.0, 0.1, 0.01))
    renderer = Renderer(_bare_corridor(), PinholeCamera())
    rng = np.random.default_rng(9)
    pictures = [
        renderer.render(Pose(level_rotation(h), np.array([at, 1.0, 1.5])), Light(), rng)
        for h, at in zip(heading, x, strict=True)
    ]
    report = judge_pictures(pictures, Camera.pinhole(640, 480, 500.0, 500.0, 320.0, 240.0))
    ((reason, start, end),) = _named(report)
    assert reason == "blank_wall"
    # In the middle of the turns the wall comes into view and leaves it.
    assert 1.5 <= start <= 2.2
    assert 4.0 <= end <= 4.7


def test_sharpness_falls_with_blur_in_any_direction_and_not_with_noise() -> None:
    rng = np.random.default_rng(10)
    coarse = rng.integers(40, 220, (60, 80)).astype(np.uint8)
    sharp = np.asarray(cv2.resize(coarse, (640, 480), interpolation=cv2.INTER_NEAREST), np.uint8)
    noisy = np.clip(sharp + rng.normal(0.0, 3.0, sharp.shape), 0, 255).astype(np.uint8)
    clear = frame_statistics(sharp).sharpness
    assert frame_statistics(noisy).sharpness == pytest.approx(clear, rel=0.1)
    for kind in ("Gaussian 5", "along 21, 0°", "along 31, 30°", "along 25, 90°"):
        blurred = KINDS[kind][1](sharp[:, :, None].repeat(3, axis=2), rng)[:, :, 0]
        assert frame_statistics(np.ascontiguousarray(blurred)).sharpness < 0.5 * clear, kind


@pytest.mark.parametrize("shape", [(16, 16), (17, 300), (480, 640), (640, 360)])
def test_pictures_of_any_shape_have_statistics(shape: tuple[int, int]) -> None:
    statistics = frame_statistics(np.zeros(shape, np.uint8))
    assert (statistics.bright, statistics.textured, statistics.sharpness) == (0.0, 0.0, 0.0)
    assert statistics.covered == 1.0


def _evidence(frames: int = 100) -> FrameEvidence:
    """A walk without any fault."""

    def level(value: float) -> np.ndarray:
        return np.full(frames, value)

    return FrameEvidence(
        time=0.1 * np.arange(frames),
        bright=level(180.0),
        clipped=level(0.0),
        textured=level(0.9),
        covered=level(0.0),
        sharpness=level(0.12),
        followed=level(0.9),
        turning=level(0.2),
        shift=level(10.0),
        strays=level(0.02),
        tracked=np.ones(frames, np.bool_),
        landmarks=np.full(frames, 500),
    )


def _changed(**values: float) -> list[Run]:
    """The weak runs of a walk whose frames 40 to 59 have other figures."""
    evidence = _evidence()
    for name, value in values.items():
        getattr(evidence, name)[40:60] = value
    return find_weak_runs(evidence)


@pytest.mark.parametrize(
    ("values", "reason"),
    [
        ({"tracked": False}, WeakReason.LOST),
        ({"tracked": False, "turning": 2.0}, WeakReason.TOO_FAST),
        ({"tracked": False, "followed": 0.05}, WeakReason.TOO_FAST),
        ({"tracked": False, "strays": 0.5}, WeakReason.TOO_MUCH_MOTION),
        ({"tracked": False, "bright": 80.0}, WeakReason.TOO_DARK),
        ({"tracked": False, "textured": 0.4}, WeakReason.BLANK_WALL),
        ({"tracked": False, "sharpness": 0.07}, WeakReason.BLURRED),
        ({"turning": 2.5}, WeakReason.TOO_FAST),
        ({"strays": 0.7}, WeakReason.TOO_MUCH_MOTION),
        ({"clipped": 0.8}, WeakReason.TOO_BRIGHT),
        ({"covered": 0.45}, WeakReason.LENS_COVERED),
        ({"bright": 10.0, "textured": 0.0, "sharpness": 0.0, "tracked": False}, WeakReason.TOO_DARK),
        ({"textured": 0.05, "sharpness": 0.0, "tracked": False}, WeakReason.BLANK_WALL),
        ({"sharpness": 0.03, "turning": 2.0}, WeakReason.TOO_FAST),
    ],
)
def test_a_stretch_has_its_one_reason(values: dict[str, float], reason: WeakReason) -> None:
    assert _changed(**values) == [Run(40, 60, reason)]


@pytest.mark.parametrize(
    "values",
    [
        {},
        # Bland, dim, turning, with people about: all of it was followed.
        {"textured": 0.4, "sharpness": 0.08, "bright": 90.0},
        {"turning": 1.3, "strays": 0.5},
    ],
)
def test_what_can_be_followed_is_no_fault(values: dict[str, float]) -> None:
    assert _changed(**values) == []


def test_what_follows_from_a_fault_is_no_fault_of_its_own() -> None:
    evidence = _evidence()
    evidence.bright[40:60] = 5.0
    evidence.tracked[40:80] = False
    evidence.turning[33:40] = 2.5
    assert find_weak_runs(evidence) == [Run(40, 60, WeakReason.TOO_DARK)]


def _report(stretches: int, *, mapped: bool) -> QualityReport:
    time = 0.1 * np.arange(300)
    picture = np.random.default_rng(11).integers(0, 255, (192, 256)).astype(np.uint8)
    thumbnail = cv2.imencode(".jpg", picture)[1].tobytes()
    reasons = list(WeakReason)
    angle = np.linspace(0.0, 5.0, len(time))
    return QualityReport(
        video_seconds=30.0,
        coverage=0.8,
        score=55,
        record_again=True,
        verdict="Record the walk again with more care at 3.0-4.0 s: it would not be found.",
        stretches=tuple(
            WeakStretch(
                2.0 * k, 2.0 * k + 1.0, reasons[k % 8], 1.0, "So it is: do it.", thumbnail if k % 2 else None
            )
            for k in range(stretches)
        ),
        notes=("The camera stood still from 1.0 s to 4.0 s. That does no harm.",),
        timeline=Timeline(
            time,
            np.full(300, 400),
            np.ones(300, np.bool_),
            np.column_stack([np.cos(angle), np.sin(angle), 0 * angle]) if mapped else None,
        ),
    )


@pytest.mark.parametrize(("stretches", "mapped"), [(0, True), (3, True), (3, False), (11, True), (0, False)])
def test_a_report_is_written_with_its_pictures(tmp_path: Path, stretches: int, mapped: bool) -> None:
    report = _report(stretches, mapped=mapped)
    written = write_quality_report(report, tmp_path / "deep" / "report")
    picture = cv2.imread(str(written.picture))
    assert picture is not None
    assert picture.shape[1] == 1430
    assert 500 < picture.shape[0] < 2200
    assert 0.02 < (picture.min(axis=2) < 200).mean() < 0.6
    document = json.loads(written.report.read_text(encoding="utf-8"))
    assert document["score"] == 55
    assert len(document["landmarks"]) == 30
    names = [stretch["thumbnail"] for stretch in document["stretches"]]
    assert names == [f"stretch-{k + 1}.jpg" if k % 2 else None for k in range(stretches)]
    for name, path in zip(names, written.thumbnails, strict=True):
        assert path == (None if name is None else tmp_path / "deep" / "report" / name)
        assert path is None or path.stat().st_size > 1000
