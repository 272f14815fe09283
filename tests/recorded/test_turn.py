"""The hardest corner of the recorded house: a turn at a bare wall, where scale is easily lost."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from clips import clip
from demo_route import judged

from server.evaluation.walk import Trajectory, Walk, read_walk
from server.mapping.build import build_route_map

pytestmark = pytest.mark.recorded

FRAMES = 130


@pytest.fixture(scope="module")
def first_rooms(recorded_data: Path, tmp_path_factory: pytest.TempPathFactory) -> Walk:
    """The walk's first 13 seconds, compressed anew and almost without loss."""
    source = read_walk(recorded_data / "walks" / "house" / "leader")
    return clip(source, tmp_path_factory.mktemp("house") / "leader", FRAMES)


def _scale(path: Trajectory, truth: Trajectory, begin: int, end: int) -> float:
    """Metres per map unit over some frames, steps of half a second."""
    moved = [
        np.linalg.norm(t.position[begin + 5 : end] - t.position[begin : end - 5], axis=1).sum()
        for t in (truth, path)
    ]
    return float(moved[0] / moved[1])


def test_scale_stays_through_the_turn(first_rooms: Walk) -> None:
    result = build_route_map(first_rooms.video, first_rooms.camera)
    judgement = judged(first_rooms, result)
    assert judgement.report.tracked_fraction >= 0.98
    before = _scale(judgement.estimate, judgement.truth, 10, 45)
    after = _scale(judgement.estimate, judgement.truth, 65, 110)
    assert after / before == pytest.approx(1.0, abs=0.25)
    assert judgement.report.ate_percent_of_path is not None
    assert judgement.report.ate_percent_of_path < 2.0
