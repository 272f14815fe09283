"""True hints on an L-shaped path, and how answers to them are scored."""

from __future__ import annotations

import numpy as np
import pytest

from server.evaluation.hints import Side, hint_truth, judge_hints, true_progress
from server.evaluation.walk import Trajectory, arc_length
from server.geometry.poses import rotation_from_vector
from server.navigation.updates import Guidance, Instruction
from tests.evaluation.worlds import guidance, l_shape

EVERYWHERE = np.ones(1000, np.bool_)
INSTRUCTION = {
    Side.LEFT: Instruction.LEFT,
    Side.RIGHT: Instruction.RIGHT,
    Side.STRAIGHT: Instruction.STRAIGHT,
}


def _mirrored(trajectory: Trajectory) -> Trajectory:
    """The same walk with its turns the other way."""
    flip = np.diag([1.0, -1.0, 1.0])
    return Trajectory(
        trajectory.time, flip @ trajectory.rotation @ np.diag([-1.0, 1.0, 1.0]), trajectory.position @ flip
    )


def test_the_turn_of_an_l_is_left_and_its_legs_are_straight() -> None:
    leader = l_shape()
    truth = hint_truth(leader, leader)
    sides = [truth.side(row) for row in range(len(leader))]
    walked = arc_length(leader.position)
    assert set(sides[: np.searchsorted(walked, 8.0)]) == {Side.STRAIGHT}
    assert sides[np.searchsorted(walked, 10.2)] is Side.LEFT
    assert Side.RIGHT not in sides
    last = [side for side, at in zip(sides, walked, strict=True) if 12.0 < at < 18.5]
    assert set(last) == {Side.STRAIGHT}
    assert {truth.side(row) for row in np.flatnonzero(truth.remaining < 0.4)} == {None}


def test_a_mirrored_l_turns_right() -> None:
    leader = _mirrored(l_shape())
    truth = hint_truth(leader, leader)
    assert {truth.side(row) for row in range(len(leader))} == {Side.STRAIGHT, Side.RIGHT, None}


def test_bearing_is_positive_to_the_left_and_in_the_followers_camera() -> None:
    leader = l_shape()
    looking_right = Trajectory(
        leader.time,
        leader.rotation @ rotation_from_vector([0.0, np.radians(40.0), 0.0]),
        leader.position,
    )
    truth = hint_truth(leader, looking_right)
    assert np.degrees(truth.bearing[20]) == pytest.approx(40.0, abs=6.0)
    assert truth.side(20) is Side.LEFT


def test_bearings_near_the_limit_are_not_judged() -> None:
    leader = l_shape()
    straight = leader.rotation[:1].repeat(len(leader), axis=0)
    at = hint_truth(leader, Trajectory(leader.time, straight, leader.position)).bearing[10]
    for degrees, side in ((14.0, Side.STRAIGHT), (17.0, None), (23.0, None), (26.0, Side.LEFT)):
        turned = straight @ rotation_from_vector([0.0, np.radians(degrees) - at, 0.0])
        truth = hint_truth(leader, Trajectory(leader.time, turned, leader.position))
        assert np.degrees(truth.bearing[10]) == pytest.approx(degrees, abs=0.1)
        assert truth.side(10) is side


def test_progress_follows_a_path_that_crosses_and_repeats_itself() -> None:
    """Out, back the same way, and out again: place alone cannot tell the three apart."""
    out = l_shape()[:80]
    back = Trajectory(
        out.time, rotation_from_vector([0.0, 0.0, np.pi]) @ out.rotation[::-1], out.position[::-1]
    )
    whole = Trajectory(
        0.1 * np.arange(240),
        np.concatenate([out.rotation, back.rotation, out.rotation]),
        np.concatenate([out.position, back.position, out.position]),
    )
    beside = Trajectory(whole.time, whole.rotation, whole.position + np.array([0.0, 0.2, 0.0]))
    progress = true_progress(whole, beside)
    expected = arc_length(whole.position)
    assert np.abs(progress - expected)[5:-5].max() < 0.5


def test_progress_survives_an_excursion() -> None:
    leader = l_shape()
    away = leader.position.copy()
    away[60:90, 1] -= 6.0 * np.sin(np.linspace(0.0, np.pi, 30))
    progress = true_progress(leader, Trajectory(leader.time, leader.rotation, away))
    walked = arc_length(leader.position)
    assert np.abs(progress - walked)[:55].max() < 0.3
    assert np.abs(progress - walked)[95:].max() < 0.3


def _answers(leader: Trajectory) -> list[Guidance | None]:
    truth = hint_truth(leader, leader)
    return [guidance(INSTRUCTION[truth.side(row) or Side.STRAIGHT]) for row in range(len(leader))]


def test_right_answers_score_one_and_always_straight_half_of_two_classes() -> None:
    leader = l_shape()
    truth = hint_truth(leader, leader)
    score = judge_hints(truth, _answers(leader), EVERYWHERE)
    assert score.agreement == 1.0
    assert score.always_straight == 0.5
    assert score.frames["left"] > 5
    assert score.frames["right"] == 0
    straight = [guidance(Instruction.STRAIGHT)] * len(leader)
    assert judge_hints(truth, straight, EVERYWHERE).agreement == score.always_straight


def test_silence_is_wrong_and_balanced() -> None:
    leader = l_shape()
    truth = hint_truth(leader, leader)
    answers = _answers(leader)
    silent = [None if truth.side(row) is Side.LEFT else answers[row] for row in range(len(leader))]
    assert judge_hints(truth, silent, EVERYWHERE).agreement == 0.5


def test_turning_around_counts_as_its_side() -> None:
    leader = l_shape()
    truth = hint_truth(leader, leader)
    answers = _answers(leader)
    for bearing, score in ((2.5, 1.0), (-2.5, 0.5)):
        around = [
            guidance(Instruction.TURN_AROUND, bearing) if truth.side(row) is Side.LEFT else answers[row]
            for row in range(len(leader))
        ]
        assert judge_hints(truth, around, EVERYWHERE).agreement == score


def test_arrival_is_left_out_at_the_end_and_wrong_before() -> None:
    leader = l_shape()
    truth = hint_truth(leader, leader)
    answers = _answers(leader)
    late = [guidance(Instruction.ARRIVED) if truth.remaining[r] < 2.0 else a for r, a in enumerate(answers)]
    assert judge_hints(truth, late, EVERYWHERE).agreement == 1.0
    early = [guidance(Instruction.ARRIVED)] * len(leader)
    assert judge_hints(truth, early, EVERYWHERE).agreement == 0.0


def test_frames_off_the_route_are_not_judged() -> None:
    leader = l_shape()
    truth = hint_truth(leader, leader)
    on_route = np.array([truth.side(row) is not Side.LEFT for row in range(len(leader))])
    score = judge_hints(truth, [guidance(Instruction.STRAIGHT)] * len(leader), on_route)
    assert score.agreement == 1.0
    assert score.frames["left"] == 0
