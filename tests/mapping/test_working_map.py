"""The growing map: whatever is done to it, it knows who sees what."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from server.features.extraction import Features
from server.geometry.cameras import Camera
from server.geometry.poses import SE3, Sim3
from server.mapping.working_map import NO_LANDMARK, Keyframe, WorkingMap

CAMERA = Camera.pinhole(640, 480, 500.0, 500.0, 320.0, 240.0)
FEATURES = 40


def _keyframe(frame: int, rng: np.random.Generator) -> Keyframe:
    features = Features(
        rng.uniform([0, 0], [640, 480], (FEATURES, 2)),
        rng.integers(0, 256, (FEATURES, 32), np.uint8),
        rng.integers(0, 4, FEATURES, np.int8),
        np.zeros(FEATURES, np.float32),
    )
    pose = SE3(Rotation.random(rng=rng).as_matrix(), rng.normal(size=3))
    return Keyframe(
        frame, features, pose, np.ones(FEATURES), np.arange(FEATURES), np.full(FEATURES, NO_LANDMARK)
    )


def _grown(seed: int, keyframes: int = 6) -> WorkingMap:
    """Landmarks seen by two to all keyframes, some features of each free."""
    rng = np.random.default_rng(seed)
    working = WorkingMap(CAMERA, 1.2)
    working.keyframes = [_keyframe(10 * k, rng) for k in range(keyframes)]
    for _ in range(4):
        watchers = np.sort(rng.permutation(keyframes)[: rng.integers(2, keyframes + 1)])
        count = 6
        rows = {int(k): np.flatnonzero(working.keyframes[k].landmark < 0) for k in watchers}
        rows = {k: rng.permutation(free)[:count] for k, free in rows.items()}
        ids = working.add_landmarks(rng.normal(size=(count, 3)), int(watchers[0]), rows[int(watchers[0])])
        for k, features in rows.items():
            working.observe(k, features, ids)
    return working


def _check(working: WorkingMap, *, pairs: bool = True) -> None:
    """What must always hold of the books."""
    size = len(working)
    for name in ("descriptor", "distance", "octave", "observed", "born", "alive", "covariance"):
        assert len(getattr(working, name)) == size, name
    counted = np.zeros(size, np.int64)
    for kf in working.keyframes:
        ids = kf.landmark[kf.matched]
        assert (ids < size).all()
        assert working.alive[ids].all(), "a keyframe sees a landmark that is dead"
        assert len(np.unique(ids)) == len(ids), "a keyframe sees a landmark twice"
        counted[ids] += 1
    np.testing.assert_array_equal(working.observed, counted)
    if pairs:
        assert (counted[working.alive] >= 2).all(), "a landmark lives by one view"


OPERATIONS = st.lists(
    st.tuples(st.sampled_from(["forget", "kill", "merge", "absorb", "add"]), st.integers(0, 2**31)),
    min_size=1,
    max_size=8,
)


@settings(max_examples=60, deadline=None, derandomize=True)
@given(seed=st.integers(0, 10_000), operations=OPERATIONS)
def test_the_books_balance_after_any_operations(seed: int, operations: list[tuple[str, int]]) -> None:
    working = _grown(seed)
    _check(working)
    for name, draw in operations:
        rng = np.random.default_rng(draw)
        if name == "forget":
            k = int(rng.integers(len(working.keyframes)))
            working.forget(k, rng.permutation(FEATURES)[: rng.integers(0, 12)])
        elif name == "kill":
            working.kill(np.unique(rng.integers(0, len(working), 3)))
        elif name == "merge":
            count = int(rng.integers(1, 7))
            order = rng.permutation(len(working))
            working.merge(order[:count], order[count : 2 * count])
        elif name == "absorb":
            other = _grown(draw % 1000, keyframes=3)
            for kf in other.keyframes:
                kf.frame += working.keyframes[-1].frame + 10
            working.absorb(other, Sim3(0.5, Rotation.random(rng=rng).as_matrix(), rng.normal(size=3)))
        else:
            free = [np.flatnonzero(kf.landmark < 0)[:4] for kf in working.keyframes[:2]]
            count = min(len(rows) for rows in free)
            ids = working.add_landmarks(rng.normal(size=(count, 3)), 0, free[0][:count])
            for k, rows in enumerate(free):
                working.observe(k, rows[:count], ids)
        _check(working)


def test_merging_moves_observations_and_counts_them_once() -> None:
    rng = np.random.default_rng(1)
    working = WorkingMap(CAMERA, 1.2)
    working.keyframes = [_keyframe(k, rng) for k in range(4)]
    old, new = working.add_landmarks(rng.normal(size=(2, 3)), 0, np.array([0, 1]))
    # Keyframe 1 sees both; 0 and 1 see the new one, 1, 2 and 3 the old one.
    for k, feature, landmark in ((0, 1, new), (1, 2, new), (1, 3, old), (2, 5, old), (3, 6, old)):
        working.observe(k, np.array([feature]), np.array([landmark]))
    working.merge(np.array([old]), np.array([new]))
    assert working.alive.tolist() == [False, True]
    assert working.observed[new] == 4
    seen = [(k, int(f)) for k, kf in enumerate(working.keyframes) for f in kf.matched]
    assert seen == [(0, 1), (1, 2), (2, 5), (3, 6)]


def test_merging_with_the_dead_or_with_itself_changes_nothing() -> None:
    working = _grown(3)
    working.kill(np.array([2]))
    before = [kf.landmark.copy() for kf in working.keyframes]
    working.merge(np.array([2, 5, 7]), np.array([4, 2, 7]))
    for kf, landmark in zip(working.keyframes, before, strict=True):
        np.testing.assert_array_equal(kf.landmark, landmark)


def test_chains_of_merges_end_at_living_landmarks() -> None:
    """Revisits of neighbouring keyframes may say a is b and b is c in one go."""
    for seed in range(20):
        working = _grown(seed)
        working.merge(np.array([0, 1]), np.array([1, 2]))
        _check(working)


def test_two_landmarks_that_become_one_stay_one_a_keyframe() -> None:
    for seed in range(20):
        working = _grown(seed)
        working.merge(np.array([0, 1, 2, 3]), np.array([8, 8, 9, 9]))
        _check(working)


def test_forgetting_kills_what_one_view_is_left_of() -> None:
    rng = np.random.default_rng(2)
    working = WorkingMap(CAMERA, 1.2)
    working.keyframes = [_keyframe(k, rng) for k in range(3)]
    ids = working.add_landmarks(rng.normal(size=(2, 3)), 0, np.array([0, 1]))
    for k in range(2):
        working.observe(k, np.array([0, 1]), ids)
    working.observe(2, np.array([1]), ids[1:])
    working.forget(1, np.array([0, 1, 9]))
    assert working.alive.tolist() == [False, True]
    assert working.observed.tolist() == [0, 2]
    assert working.keyframes[0].landmark[0] == NO_LANDMARK
    _check(working)


def test_absorbing_maps_points_cameras_and_distances_by_the_similarity() -> None:
    first, later = _grown(1), _grown(2, keyframes=4)
    rng = np.random.default_rng(3)
    similarity = Sim3(1.7, Rotation.random(rng=rng).as_matrix(), rng.normal(size=3))
    position, distance = later.position.copy(), later.distance.copy()
    seen_from = [kf.camera_from_world @ position for kf in later.keyframes]
    size, keyframes, centres = len(first), len(first.keyframes), [kf.centre for kf in later.keyframes]
    offset = first.absorb(later, similarity)
    assert offset == size
    assert len(first) == size + len(position)
    np.testing.assert_allclose(first.position[offset:], similarity @ position)
    np.testing.assert_allclose(first.distance[offset:], 1.7 * distance)
    assert (first.born[offset:] >= keyframes).all()
    for k, kf in enumerate(first.keyframes[keyframes:]):
        np.testing.assert_allclose(kf.centre, similarity @ centres[k])
        # The camera sees the same picture: its view of the points grows with the scale, nothing else.
        np.testing.assert_allclose(kf.camera_from_world @ first.position[offset:], 1.7 * seen_from[k])
        source = later.keyframes[k].landmark
        np.testing.assert_array_equal(kf.landmark[source >= 0], source[source >= 0] + offset)
        assert (kf.landmark[source < 0] == NO_LANDMARK).all()
    _check(first)
    _check(later)


def test_the_absorbed_map_keeps_its_own_keyframes() -> None:
    first, later = _grown(1), _grown(2)
    before = [(kf.landmark.copy(), kf.centre) for kf in later.keyframes]
    first.absorb(later, Sim3(2.0, np.eye(3), np.ones(3)))
    first.kill(np.arange(len(first)))
    for kf, (landmark, centre) in zip(later.keyframes, before, strict=True):
        np.testing.assert_array_equal(kf.landmark, landmark)
        np.testing.assert_array_equal(kf.centre, centre)


def test_landmarks_look_as_they_were_seen_last() -> None:
    working = _grown(5)
    working.refresh(4)
    kf = working.keyframes[4]
    ids = kf.landmark[kf.matched]
    np.testing.assert_array_equal(working.descriptor[ids], kf.features.descriptors[kf.matched])
    np.testing.assert_allclose(
        working.distance[ids], np.linalg.norm(kf.camera_from_world @ working.position[ids], axis=1)
    )


def test_the_octave_falls_by_one_for_each_step_nearer() -> None:
    working = _grown(6)
    ids = np.arange(5)
    here = working.predicted_octave(ids, working.distance[ids])
    np.testing.assert_array_equal(here, working.octave[ids])
    # From further away a feature is found on a finer level.
    np.testing.assert_array_equal(working.predicted_octave(ids, 1.2 * working.distance[ids]), here - 1)
    np.testing.assert_array_equal(working.predicted_octave(ids, working.distance[ids] / 1.44), here + 2)


def test_covariances_say_how_far_a_triangulated_point_is_off() -> None:
    """Two views a baseline apart: many noisy triangulations scatter as the covariance says."""
    from server.geometry.triangulation import triangulate

    rng = np.random.default_rng(4)
    working = WorkingMap(CAMERA, 1.2)
    working.keyframes = [_keyframe(k, rng) for k in range(2)]
    working.keyframes[0].camera_from_world = SE3.identity()
    working.keyframes[1].camera_from_world = SE3(np.eye(3), np.array([-0.4, 0.0, 0.0]))
    point = np.array([0.3, -0.2, 4.0])
    ids = working.add_landmarks(point[None], 0, np.array([0]))
    for k in range(2):
        working.keyframes[k].sigma[:] = 0.8
        working.observe(k, np.array([0]), ids)
    working.update_covariances([0, 1])
    a, b = (kf.camera_from_world for kf in working.keyframes)
    pixels = [CAMERA.project(p @ point[None]) + rng.normal(scale=0.8, size=(4000, 2)) for p in (a, b)]
    found = triangulate(a, b, CAMERA.normalize(pixels[0]), CAMERA.normalize(pixels[1]))
    scatter = np.cov(found.T)
    expected = working.covariance[ids[0]]
    np.testing.assert_allclose(np.diag(expected), np.diag(scatter), rtol=0.15)
    assert expected[2, 2] > 20 * expected[1, 1]


@pytest.mark.parametrize("keyframes", [[], [0], [0, 3, 5]])
def test_only_the_living_are_seen(keyframes: list[int]) -> None:
    working = _grown(8)
    working.kill(np.array([0, 3, 11]))
    seen = working.seen_by(keyframes)
    expected = {int(i) for k in keyframes for i in working.keyframes[k].landmark if i >= 0}
    assert set(seen.tolist()) == expected
    assert working.alive[seen].all()
