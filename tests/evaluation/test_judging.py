"""The judge against answers whose errors are planted."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from server.evaluation.camera_offset import apply_offset, estimate_offset
from server.evaluation.follower import FollowerJudgement, judge_follower
from server.evaluation.leader import LeaderJudgement, judge_leader
from server.evaluation.report import FollowerReport, Latency, RouteReport, Spread
from server.evaluation.walk import Trajectory
from server.geometry.poses import SE3, Sim3, rotation_angle, rotation_from_vector
from server.navigation.updates import NavigationState
from tests.evaluation.worlds import answers_of, figures, into_map, l_shape, map_of, walk_of

MAP_FROM_WORLD = Sim3(0.21, rotation_from_vector([1.0, 0.2, -0.7]), np.array([3.0, 1.0, -4.0]))


def _leader(truth: Trajectory, **properties: object) -> LeaderJudgement:
    return judge_leader(
        walk_of(truth, **properties), map_of(into_map(truth, MAP_FROM_WORLD)), figures(len(truth))
    )


def _follower(truth: Trajectory, said: Trajectory, **more: object) -> FollowerJudgement:
    leader_truth = l_shape()
    answers = answers_of(into_map(said, MAP_FROM_WORLD))
    return judge_follower(
        walk_of(leader_truth), _leader(leader_truth), walk_of(truth, "follower", **more), answers
    )


def test_a_perfect_map_in_another_frame_and_unit_has_no_error() -> None:
    report = _leader(l_shape()).report
    assert report.ate_rmse_m == pytest.approx(0.0, abs=1e-9)
    assert report.tracked_fraction == 1.0
    assert report.path_length_m == pytest.approx(10 + np.pi / 2 + 8, abs=0.12)


def test_untracked_and_missing_frames_lower_the_tracked_fraction() -> None:
    truth = l_shape()
    tracked = np.ones(len(truth), np.bool_)
    tracked[20:30] = False
    judged = judge_leader(walk_of(truth), map_of(truth, tracked=tracked), figures(len(truth) + 10))
    assert judged.report.tracked_fraction == pytest.approx((len(truth) - 10) / (len(truth) + 10))


def test_ate_is_the_rms_of_white_noise_in_metres_whatever_the_map_unit() -> None:
    truth = l_shape(step=0.02)
    noise = np.random.default_rng(5).normal(scale=0.1, size=truth.position.shape)
    path = into_map(Trajectory(truth.time, truth.rotation, truth.position + noise), MAP_FROM_WORLD)
    judged = judge_leader(walk_of(truth), map_of(path), figures(len(truth)))
    assert judged.report.ate_rmse_m == pytest.approx(0.1 * np.sqrt(3), rel=0.03)


def test_perfect_answers_have_no_error_and_all_count() -> None:
    truth = l_shape(side=0.3, seed=2)
    report = _follower(truth, truth).report
    assert report.relocalized_fraction == 1.0
    assert report.relocalization_failure_rate == 0.0
    assert report.false_fixes == 0
    assert report.position_error_m.max == pytest.approx(0.0, abs=1e-7)
    assert report.rotation_error_deg.max == pytest.approx(0.0, abs=1e-4)
    assert report.absolute_error_m.max == pytest.approx(0.0, abs=1e-7)
    assert report.latency_ms.under_100_fraction == 1.0


@pytest.mark.parametrize(("offset", "false"), [(2.0, 1), (1.01, 1), (0.99, 0)])
def test_one_planted_position_error(offset: float, false: int) -> None:
    truth = l_shape(side=-0.2)
    moved = truth.position.copy()
    moved[40] += offset * np.array([0.6, 0.0, 0.8])
    judged = _follower(truth, Trajectory(truth.time, truth.rotation, moved))
    assert judged.report.false_fixes == false
    assert judged.report.position_error_m.max == pytest.approx(offset, rel=1e-6)
    assert judged.report.position_error_m.median == pytest.approx(0.0, abs=1e-7)
    assert np.flatnonzero(judged.false).tolist() == [40] * false


@pytest.mark.parametrize(("degrees", "false"), [(15.1, 1), (14.9, 0)])
def test_one_planted_rotation_error(degrees: float, false: int) -> None:
    truth = l_shape()
    turned = truth.rotation.copy()
    turned[7] = turned[7] @ rotation_from_vector([0.0, np.radians(degrees), 0.0])
    report = _follower(truth, Trajectory(truth.time, turned, truth.position)).report
    assert report.false_fixes == false
    assert report.rotation_error_deg.max == pytest.approx(degrees, rel=1e-6)


def test_frames_off_the_route_do_not_count_but_their_false_fixes_do() -> None:
    truth = l_shape()
    leader = _leader(truth)
    said = truth.position.copy()
    said[55] += [3.0, 0.0, 0.0]
    poses = into_map(Trajectory(truth.time, truth.rotation, said), MAP_FROM_WORLD)
    answers = answers_of(poses, refused=[*range(50, 55), 80])
    report = judge_follower(
        walk_of(truth), leader, walk_of(truth, "away", off_route=(50, 59)), answers
    ).report
    assert report.off_route_frames == 10
    assert report.off_route_fixes == 5
    assert report.false_fixes == 1
    assert report.relocalized_fraction == pytest.approx((len(truth) - 11) / (len(truth) - 10))
    assert report.position_error_m.max == pytest.approx(0.0, abs=1e-7)
    assert report.refusals == {"too_few_inliers": 6}


def test_an_arrival_before_the_end_is_counted_and_only_the_last_state_arrives() -> None:
    truth = l_shape()
    poses = into_map(truth, MAP_FROM_WORLD)

    def judged(*arrived: int) -> FollowerReport:
        answers = [
            replace(answer, update=replace(answer.update, state=NavigationState.ARRIVED))
            if row in arrived
            else answer
            for row, answer in enumerate(answers_of(poses))
        ]
        return judge_follower(walk_of(truth), _leader(truth), walk_of(truth, "follower"), answers).report

    last = len(truth) - 1
    early = judged(3, 4, 5)
    assert (early.arrived, early.premature_arrivals) == (False, 3)
    proper = judged(last - 2, last - 1, last)
    assert (proper.arrived, proper.premature_arrivals) == (True, 0)


def test_every_fix_in_a_wrong_building_is_false() -> None:
    truth = l_shape()
    elsewhere = walk_of(truth, "follower")
    elsewhere = type(elsewhere)(elsewhere.folder, elsewhere.camera, truth, world="another")
    answers = answers_of(into_map(truth, MAP_FROM_WORLD), refused=range(3, len(truth)))
    report = judge_follower(walk_of(truth), _leader(truth), elsewhere, answers).report
    assert report.wrong_building
    assert report.false_fixes == 3
    assert report.relocalized_fraction == pytest.approx(3 / len(truth))
    assert report.position_error_m == Spread()
    assert report.hint_agreement is None


def test_truth_rows_are_video_frames_not_answers() -> None:
    truth = l_shape(step=0.11 / 3)
    leader_truth = l_shape()
    answers = answers_of(into_map(truth[::3], MAP_FROM_WORLD))
    thirds = [type(a)(3 * a.index, a.update, a.latency_ms) for a in answers]
    report = judge_follower(walk_of(leader_truth), _leader(leader_truth), walk_of(truth), thirds).report
    assert report.position_error_m.max == pytest.approx(0.0, abs=1e-7)
    with pytest.raises(ValueError, match="has no line"):
        judge_follower(walk_of(leader_truth), _leader(leader_truth), walk_of(truth[:10]), thirds)


def _hand_held() -> Trajectory:
    """A walk with the rotations of a hand-held camera: the offset's translation is determined."""
    truth = l_shape()
    phase = np.linspace(0.0, 12.0, len(truth))
    wobble = np.stack([0.5 * np.sin(phase), 0.7 * np.cos(1.3 * phase), 0.4 * np.sin(2.1 * phase)], axis=1)
    return Trajectory(truth.time, truth.rotation @ rotation_from_vector(wobble), truth.position)


def test_the_constant_offset_of_the_truths_camera_is_found_and_removed() -> None:
    filming = _hand_held()
    offset = SE3(rotation_from_vector(np.radians([3.0, -1.5, 1.0])), np.array([0.025, 0.004, -0.01]))
    truth = apply_offset(filming, offset.inverse())
    rng = np.random.default_rng(9)
    noisy = filming.position + rng.normal(scale=0.01, size=filming.position.shape)
    estimate = into_map(Trajectory(filming.time, filming.rotation, noisy), MAP_FROM_WORLD)
    found = estimate_offset(estimate, truth)
    assert np.degrees(rotation_angle(found.rotation.T @ offset.rotation)) < 0.1
    np.testing.assert_allclose(found.translation, offset.translation, atol=0.005)
    judged = judge_leader(walk_of(truth, real=True), map_of(estimate), figures(len(truth)))
    assert judged.report.camera_offset_deg == pytest.approx(
        np.degrees(rotation_angle(offset.rotation)), abs=0.1
    )
    answers = answers_of(into_map(filming, MAP_FROM_WORLD))
    report = judge_follower(
        walk_of(truth, real=True), judged, walk_of(truth, "follower", real=True), answers
    ).report
    assert report.rotation_error_deg.max < 0.3
    assert report.position_error_m.max < 0.03


def test_an_offset_is_not_taken_off_a_rendered_truth() -> None:
    filming = _hand_held()
    truth = apply_offset(filming, SE3(rotation_from_vector([0.1, 0.0, 0.0]), np.zeros(3)))
    judged = judge_leader(walk_of(truth), map_of(into_map(filming, MAP_FROM_WORLD)), figures(len(truth)))
    assert judged.report.camera_offset_deg == 0.0
    assert rotation_angle(judged.camera_offset.rotation) == 0.0


def test_a_translation_that_the_walk_does_not_determine_is_not_invented() -> None:
    ahead = np.tile([[1.0, 0.0, 0.0]], (60, 1))
    straight = l_shape()[:60]
    level = l_shape(seed=3).rotation[:1].repeat(60, axis=0)
    sway = 0.2 * np.sin(np.linspace(0, 9, 60))[:, None] * np.array([[0.0, 1.0, 0.5]])
    truth = Trajectory(straight.time, level, straight.position + sway)
    found = estimate_offset(into_map(truth, MAP_FROM_WORLD), truth)
    assert len(ahead) == 60
    np.testing.assert_array_equal(found.translation, np.zeros(3))


def test_report_is_json_with_the_names_of_the_contract() -> None:
    truth = l_shape()
    leader = _leader(truth)
    follower = _follower(truth, truth)
    document = json.loads(
        json.dumps(RouteReport(leader.report, (follower.report,)).to_json(), allow_nan=False)
    )
    assert document["leader"].keys() >= {
        "frames",
        "tracked_fraction",
        "keyframes",
        "landmarks",
        "ate_rmse_m",
        "ate_percent_of_path",
        "video_seconds",
        "build_seconds",
        "map_bytes",
        "peak_rss_bytes",
    }
    assert document["followers"][0].keys() >= {
        "name",
        "frames",
        "relocalized_fraction",
        "relocalization_failure_rate",
        "position_error_m",
        "rotation_error_deg",
        "absolute_error_m",
        "false_fixes",
        "hint_agreement",
        "hint_always_straight",
        "latency_ms",
    }
    assert document["followers"][0]["position_error_m"].keys() == {"median", "p90", "max"}
    assert document["followers"][0]["latency_ms"].keys() == {
        "mean",
        "p50",
        "p95",
        "p99",
        "under_100_fraction",
    }


def test_latency_figures() -> None:
    latency = Latency.of(np.arange(1.0, 201.0))
    assert latency.mean == pytest.approx(100.5)
    assert latency.p50 == pytest.approx(100.5)
    assert latency.p95 == pytest.approx(190.05)
    assert latency.under_100_fraction == pytest.approx(99 / 200)
    assert Latency.of([]) == Latency()
