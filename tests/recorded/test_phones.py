"""Steps, dead reckoning and activities on real phones, held to their bars."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from server.evaluation.positioning.activities import judge_activities, read_windows
from server.evaluation.positioning.crowd import reckon_and_learn
from server.evaluation.positioning.folders import unpacked
from server.evaluation.positioning.mall import read_walk
from server.evaluation.positioning.step_counts import judge_steps

pytestmark = pytest.mark.recorded


@pytest.fixture
def phones(recorded_data: Path) -> Path:
    return recorded_data / "phones"


def test_steps(phones: Path) -> None:
    figures = judge_steps(phones / "steps-oxford").to_json()
    assert len(figures["traces"]) == 12
    assert figures["median_error_percent"] <= 1.0
    assert figures["worst_error_percent"] <= 4.0
    assert all(trace["matched"] >= 0.95 * trace["true_steps"] for trace in figures["traces"])
    assert figures["core_percent"] <= 1.0


def test_activities(phones: Path) -> None:
    report = judge_activities(read_windows(phones / "activities-har"))
    assert report.people == 8
    assert report.balanced_accuracy >= 0.85


def test_dead_reckoning_in_the_mall(phones: Path) -> None:
    """Every third walk of the floor that nothing was tuned on."""
    with unpacked(phones / "indoor-competition", "path_data_files/*.txt") as files:
        chosen = [file for file in files if file.parent.parent.name == "F2"][::3]
        walks = [read_walk(file, "F2") for file in chosen]
    tracks = [reckon_and_learn(walk)[0] for walk in walks]
    errors = np.concatenate([track.errors for track in tracks])
    assert np.median(errors) <= 2.9
    consistency = np.concatenate([track.consistency() for track in tracks])
    assert np.mean(consistency < 5.991) >= 0.85
    assert sum(t.seconds for t in tracks) <= 0.01 * sum(walk.duration for walk in walks)
