"""The quality report on recorded walks: three planted faults named with their seconds, and no fourth."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from clips import write_pictures
from judged_pictures import judge_video, read_pictures
from planted_faults import Fault, draw_faults, plant

from server.evaluation.walk import Walk, read_walk
from server.mapping.build import build_route_map
from server.mapping.quality import QualityReport
from server.mapping.video import probe

pytestmark = pytest.mark.recorded


def _planted(walk: Walk, folder: Path, seed: int, most_s: float) -> tuple[Path, list[Fault], float]:
    """The beginning of a walk with three faults of 2 s each."""
    fps = probe(walk.video).frame_rate
    pictures = read_pictures(walk.video)[: round(most_s * fps)]
    rng = np.random.default_rng(seed)
    faults = draw_faults(len(pictures), fps, 2.0, rng)
    return write_pictures(folder / "video.mp4", list(plant(pictures, faults, rng)), fps), faults, fps


def _assert_named(report: QualityReport, faults: list[Fault], fps: float) -> None:
    named = [(str(s.reason), s.start_s, s.end_s) for s in report.stretches]
    assert [reason for reason, _, _ in named] == [fault.reason for fault in faults], named
    for (_, start, end), fault in zip(named, faults, strict=True):
        assert start == pytest.approx(fault.begin / fps, abs=0.3), named
        assert end == pytest.approx(fault.end / fps, abs=0.3), named


@pytest.mark.parametrize(("name", "seed"), [("house", 2), ("kitchen", 3)])
def test_planted_faults_are_named(recorded_data: Path, tmp_path: Path, name: str, seed: int) -> None:
    walk = read_walk(recorded_data / "walks" / name / "leader")
    video, faults, fps = _planted(walk, tmp_path, seed, most_s=20.0)
    _assert_named(judge_video(video, walk.camera), faults, fps)


def test_a_whole_build_names_them_too(recorded_data: Path, tmp_path: Path) -> None:
    walk = read_walk(recorded_data / "walks" / "kitchen" / "leader")
    video, faults, fps = _planted(walk, tmp_path, seed=1, most_s=20.0)
    quality = build_route_map(video, walk.camera).quality
    assert quality is not None
    _assert_named(quality, faults, fps)
    assert quality.record_again


def test_the_house_as_it_is_has_no_weak_stretch(recorded_data: Path) -> None:
    """Its turns show bland walls, and can be followed all the same."""
    walk = read_walk(recorded_data / "walks" / "house" / "leader")
    assert judge_video(walk.video, walk.camera).stretches == ()
