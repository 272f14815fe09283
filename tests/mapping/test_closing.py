"""Revisits: a drifting loop is closed, a look-alike never is."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from threadpoolctl import threadpool_limits

from client_sim.synthetic.cameras import Pose, level_rotation
from server.geometry.poses import Sim3, align_similarity, rotation_angle, rotation_from_vector
from server.mapping.closing import close_map
from server.mapping.joining import Joint, join
from server.mapping.revisits import RevisitOptions, find_revisits
from server.mapping.working_map import WorkingMap
from tests.mapping.drifting_maps import looks, no_drift, walked_map

PER_ROUND = 48


@pytest.fixture(autouse=True)
def _one_blas_thread() -> Iterator[None]:
    """As in a build: threads would only wait for one another."""
    with threadpool_limits(limits=1, user_api="blas"):
        yield


def _around(rounds: float) -> list[Pose]:
    """Along a circle of 2.5 m, looking ahead."""
    angles = np.arange(0.0, 2 * np.pi * rounds, 2 * np.pi / PER_ROUND)
    return [Pose(level_rotation(a + np.pi / 2), 2.5 * np.array([np.cos(a), np.sin(a), 0.0])) for a in angles]


def _room(rng: np.random.Generator, count: int = 2500) -> np.ndarray:
    """Points on and before the walls of a round room of 5 m radius."""
    angle, radius = rng.uniform(0, 2 * np.pi, count), rng.uniform(3.6, 5.0, count)
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle), rng.uniform(-1.3, 1.3, count)])


def _drift(k: int) -> Sim3:
    """Half a degree and a percent of scale lost every four keyframes."""
    rotation = rotation_from_vector([0.0003 * k, 0.0, 0.0022 * k])
    return Sim3(0.9975**k, rotation, 0.002 * k * np.array([1.0, -0.5, 0.3]))


def _errors(working: WorkingMap, poses: list[Pose]) -> np.ndarray:
    truth = np.stack([pose.position for pose in poses])
    centres = np.stack([kf.centre for kf in working.keyframes])
    return np.linalg.norm(align_similarity(truth, centres) @ centres - truth, axis=1)


@pytest.mark.parametrize("seed", range(2))
def test_a_drifting_loop_is_closed(seed: int) -> None:
    rng = np.random.default_rng(seed)
    poses, points = _around(1.3), _room(rng)
    working = walked_map(poses, points, looks(len(points), rng), _drift, rng)
    before, landmarks = _errors(working, poses), int(working.alive.sum())
    revisits = close_map(working)
    after = _errors(working, poses)
    assert len(revisits) >= 8
    assert before.max() > 0.15
    assert after.max() < 0.4 * before.max()
    # Where the walk meets itself, the same place is in the same place again.
    ends = [
        np.linalg.norm(working.keyframes[k].centre - working.keyframes[k - PER_ROUND].centre)
        for k in range(PER_ROUND + 2, len(poses))
    ]
    assert np.median(ends) < 0.1
    assert working.alive.sum() < landmarks - 200
    for kf in working.keyframes:
        ids = kf.landmark[kf.matched]
        assert working.alive[ids].all()
        assert len(np.unique(ids)) == len(ids)


def test_what_a_revisit_says_is_the_drift_between() -> None:
    rng = np.random.default_rng(3)
    poses, points = _around(1.3), _room(rng)
    working = walked_map(poses, points, looks(len(points), rng), _drift, rng)
    for revisit in find_revisits(working, list(range(len(poses))), working):
        assert working.keyframes[revisit.keyframe].frame - working.keyframes[revisit.place].frame >= 50
        expected = _drift(revisit.place).compose(_drift(revisit.keyframe).inverse())
        assert revisit.earlier_from_later.scale == pytest.approx(expected.scale, rel=0.03)
        turned = rotation_angle(revisit.earlier_from_later.rotation.T @ expected.rotation)
        assert np.degrees(turned) < 2.0
        # The pairs of landmarks are the same points of the world, seen in both rounds.
        back = revisit.earlier_from_later @ working.position[revisit.later]
        assert np.median(np.linalg.norm(back - working.position[revisit.earlier], axis=1)) < 0.25


def test_a_walk_that_never_comes_back_is_left_as_it_was() -> None:
    rng = np.random.default_rng(4)
    poses, points = _around(0.7), _room(rng)
    working = walked_map(poses, points, looks(len(points), rng), _drift, rng)
    centres = np.stack([kf.centre for kf in working.keyframes])
    position, alive = working.position.copy(), working.alive.copy()
    assert close_map(working) == []
    np.testing.assert_array_equal(np.stack([kf.centre for kf in working.keyframes]), centres)
    np.testing.assert_array_equal(working.position, position)
    np.testing.assert_array_equal(working.alive, alive)


def _corridor_with_posters(
    rng: np.random.Generator, size: float, distance: float
) -> tuple[list[Pose], np.ndarray, np.ndarray]:
    """Along a wall, looking at it: one print hangs at x = 3 and at x = 15, everything else is different."""
    poster = np.column_stack(
        [
            rng.uniform(-size / 2, size / 2, 90),
            np.full(90, distance),
            rng.uniform(-0.4 * size, 0.4 * size, 90),
        ]
    )
    other = np.column_stack(
        [rng.uniform(-3, 21, 1400), rng.uniform(distance, distance + 1.0, 1400), rng.uniform(-2, 2, 1400)]
    )
    beside = (np.abs(other[:, 0] - 3.0) > size / 2) & (np.abs(other[:, 0] - 15.0) > size / 2)
    other = other[beside]
    points = np.concatenate([poster + np.array([x, 0.0, 0.0]) for x in (3.0, 15.0)] + [other])
    print_ = looks(len(poster), rng)
    descriptors = np.concatenate([print_, print_, looks(len(other), rng)])
    poses = [Pose(level_rotation(np.pi / 2), np.array([x, 0.0, 0.0])) for x in np.arange(0.0, 18.0, 0.25)]
    return poses, points, descriptors


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize(("size", "distance"), [(0.8, 3.0), (1.0, 2.5)])
def test_the_same_poster_in_two_places_is_no_revisit(seed: int, size: float, distance: float) -> None:
    rng = np.random.default_rng(seed)
    poses, points, descriptors = _corridor_with_posters(rng, size, distance)
    working = walked_map(poses, points, descriptors, no_drift, rng, most=400)
    x = np.array([pose.position[0] for pose in poses])
    # It is the demand for evidence all over the image that refuses it: the print itself matches.
    lax = RevisitOptions(min_inliers=20, min_cells=1, min_run=1, max_stray=np.inf)
    seen = find_revisits(working, list(range(len(poses))), working, lax)
    assert any(x[r.keyframe] - x[r.place] > 8.0 for r in seen)
    # So does that odometry would have had to stray by as much as was walked.
    seen = find_revisits(working, list(range(len(poses))), working, replace(lax, max_stray=0.35))
    assert not any(x[r.keyframe] - x[r.place] > 8.0 for r in seen)
    revisits = close_map(working)
    # A wall that is still in sight a second later may be taken for one, the other print may not.
    assert all(x[r.keyframe] - x[r.place] < 4.0 for r in revisits)
    assert _errors(working, poses).max() < 0.05
    for revisit in revisits:
        apart = working.position[revisit.later] - working.position[revisit.earlier]
        assert np.linalg.norm(apart, axis=1).max() < 1.0


def test_a_part_that_shows_a_known_place_is_put_there() -> None:
    rng = np.random.default_rng(6)
    poses, points = _around(1.2), _room(rng)
    descriptors = looks(len(points), rng)
    first = walked_map(poses[:30], points, descriptors, no_drift, rng)
    # Its own frame and unit; it begins on new ground after a blind stretch and comes back to the start.
    lost = Sim3(0.4, rotation_from_vector([0.3, -0.2, 1.0]), np.array([5.0, 1.0, 2.0]))
    later = walked_map(poses[36:], points, descriptors, lambda _: lost, rng, first_frame=180)
    turns = [np.eye(3)] * 1000
    assert join(first, later, turns) is Joint.RECOGNISED
    assert len(first.keyframes) == len(poses) - 6
    walked = [*poses[:30], *poses[36:]]
    assert _errors(first, walked).max() < 0.05
    counted = np.zeros(len(first), np.int64)
    for kf in first.keyframes:
        counted[kf.landmark[kf.matched]] += 1
    np.testing.assert_array_equal(first.observed, counted)


def _straight(begin: float, end: float) -> list[Pose]:
    return [Pose(level_rotation(0.0), np.array([x, 0.0, 0.0])) for x in np.arange(begin, end, 0.25)]


def _hall(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    count = 3000
    side = rng.choice([-1.5, 1.5], count)
    points = np.column_stack([rng.uniform(0, 30, count), side, rng.uniform(-1.2, 1.2, count)])
    return points, looks(count, rng)


@pytest.mark.parametrize(("blind", "joined"), [(10, True), (20, True), (25, False), (60, False)])
def test_a_short_blind_stretch_is_bridged_and_a_long_one_is_not(blind: int, joined: bool) -> None:
    """Straight on at half a decimetre a frame; what comes after shows nothing that was seen before."""
    rng = np.random.default_rng(7)
    points, descriptors = _hall(rng)
    ahead = 0.05 * blind
    first = walked_map(_straight(0.0, 5.0), points, descriptors, no_drift, rng)
    lost = Sim3(2.5, rotation_from_vector([0.0, 0.4, -0.7]), np.array([1.0, 2.0, 3.0]))
    # Other descriptors: a corridor whose doors all look new.
    later = walked_map(
        _straight(4.75 + ahead, 10.0),
        points,
        looks(len(points), rng),
        lambda _: lost,
        rng,
        first_frame=first.keyframes[-1].frame + blind,
    )
    before = [kf.centre for kf in first.keyframes]
    assert join(first, later, [np.eye(3)] * 1000) is (Joint.BRIDGED if joined else None)
    if not joined:
        assert len(first.keyframes) == len(before)
        return
    walked = [*_straight(0.0, 5.0), *_straight(4.75 + ahead, 10.0)]
    truth = np.stack([pose.position for pose in walked])
    found = np.stack([kf.centre for kf in first.keyframes])
    # Bridged by pace and heading alone, on a walk that keeps both: a tenth of the stretch at most.
    assert np.linalg.norm(found - truth, axis=1).max() < 0.1 * ahead + 0.02


def test_a_turn_made_while_blind_is_bridged_with_it() -> None:
    """A right angle in ten frames: the tracks told how far it turned."""
    rng = np.random.default_rng(8)
    points, descriptors = _hall(rng)
    first = walked_map(_straight(0.0, 5.0), points, descriptors, no_drift, rng)
    begin = first.keyframes[-1].frame + 10
    # The part begins facing along its own x; truly it goes on along y.
    later = walked_map(_straight(0.0, 4.0), points, looks(len(points), rng), no_drift, rng, first_frame=begin)
    left = level_rotation(0.0).T @ level_rotation(np.radians(9.0))
    turns = [np.eye(3)] * 1000
    for frame in range(first.keyframes[-1].frame + 1, begin + 1):
        turns[frame] = left.T
    assert join(first, later, turns) is Joint.BRIDGED
    joined = first.keyframes[20:]
    heading = joined[-1].centre - joined[0].centre
    assert np.degrees(np.arctan2(heading[1], heading[0])) == pytest.approx(90.0, abs=1.0)
    step = joined[0].centre - first.keyframes[19].centre
    assert np.degrees(np.arctan2(step[1], step[0])) == pytest.approx(45.0, abs=2.0)
    assert np.linalg.norm(step) == pytest.approx(0.5, rel=0.1)
