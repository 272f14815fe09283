"""Matching against brute force."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from server.features.matching import (
    best_pairs,
    hamming,
    match_descriptors,
    match_predicted,
    nearest_descriptors,
    pairs_within,
)

replayable = settings(derandomize=True, deadline=None, max_examples=300)

# Quarters of a pixel: points fall on cell borders and distances on the radius itself.
coordinates = st.integers(-40, 200).map(lambda n: n / 4)


def _point_sets(count: st.SearchStrategy[int]) -> st.SearchStrategy[np.ndarray]:
    return count.flatmap(lambda n: arrays(np.float64, (n, 2), elements=coordinates))


def _descriptors(rng: np.random.Generator, count: int) -> np.ndarray:
    return rng.integers(0, 256, (count, 32), dtype=np.uint8)


def _flip(rng: np.random.Generator, descriptors: np.ndarray, bits: int) -> np.ndarray:
    """The same descriptors with ``bits`` different bits each."""
    unpacked = np.unpackbits(descriptors, axis=1)
    for row in unpacked:
        row[rng.choice(256, bits, replace=False)] ^= 1
    return np.packbits(unpacked, axis=1)


@replayable
@given(
    _point_sets(st.integers(0, 25)), _point_sets(st.integers(0, 25)), st.integers(2, 120).map(lambda n: n / 4)
)
def test_pairs_within_one_radius_are_all_pairs(a: np.ndarray, b: np.ndarray, radius: float) -> None:
    rows, columns = pairs_within(a, b, radius)
    offset = a[:, None] - b
    expected = np.argwhere((offset**2).sum(axis=-1) <= radius**2)
    assert sorted(zip(rows.tolist(), columns.tolist(), strict=True)) == [tuple(p) for p in expected.tolist()]


@replayable
@given(st.integers(0, 2**32 - 1), st.integers(1, 60), st.integers(1, 60))
def test_pairs_within_radii_of_their_own_are_all_pairs(seed: int, count_a: int, count_b: int) -> None:
    rng = np.random.default_rng(seed)
    a, b = rng.normal(0, 30, (count_a, 2)), rng.normal(0, 20, (count_b, 2))
    radius = rng.uniform(0.5, 25.0, count_a)
    rows, columns = pairs_within(a, b, radius)
    expected = np.argwhere(np.linalg.norm(a[:, None] - b, axis=-1) <= radius[:, None])
    assert sorted(zip(rows.tolist(), columns.tolist(), strict=True)) == [tuple(p) for p in expected.tolist()]


def test_hamming_counts_bits() -> None:
    rng = np.random.default_rng(1)
    a, b = _descriptors(rng, 5), _descriptors(rng, 7)
    rows, columns = np.divmod(np.arange(35), 7)
    expected = (np.unpackbits(a, axis=1)[:, None] != np.unpackbits(b, axis=1)).sum(axis=-1)
    np.testing.assert_array_equal(hamming(a, b, rows, columns), expected.ravel())


def _pairs(*triples: tuple[int, int, int]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rows, columns, distance = (np.array(x, np.int64) for x in zip(*triples, strict=True))
    return rows, columns, distance


def test_best_pairs_takes_the_nearest_of_a_row() -> None:
    found = best_pairs(*_pairs((0, 3, 30), (0, 1, 10), (1, 2, 20)), max_distance=64, ratio=0.8)
    assert (found.a.tolist(), found.b.tolist(), found.distance.tolist()) == ([0, 1], [1, 2], [10, 20])


@pytest.mark.parametrize(("second", "kept"), [(25, 0), (26, 1)])
def test_best_pairs_drops_rows_with_a_rival(second: int, kept: int) -> None:
    found = best_pairs(*_pairs((0, 0, 20), (0, 1, second)), max_distance=64, ratio=0.8)
    assert len(found) == kept


def test_a_rival_of_the_same_group_is_none() -> None:
    pairs = _pairs((0, 0, 20), (0, 1, 21))
    assert len(best_pairs(*pairs, max_distance=64, ratio=0.8, column_groups=np.array([4, 5]))) == 0
    found = best_pairs(*pairs, max_distance=64, ratio=0.8, column_groups=np.array([5, 5]))
    assert found.b.tolist() == [0]


@pytest.mark.parametrize(("distance", "kept"), [(64, 1), (65, 0)])
def test_best_pairs_has_a_greatest_distance(distance: int, kept: int) -> None:
    assert len(best_pairs(*_pairs((0, 0, distance)), max_distance=64, ratio=0.8)) == kept


def test_best_pairs_gives_a_column_to_its_nearest_row() -> None:
    found = best_pairs(*_pairs((0, 7, 12), (1, 7, 9), (2, 7, 30), (3, 1, 5)), max_distance=64, ratio=0.8)
    assert (found.a.tolist(), found.b.tolist()) == ([1, 3], [7, 1])


def test_best_pairs_of_nothing_is_nothing() -> None:
    none = np.zeros(0, np.int64)
    assert len(best_pairs(none, none, none, max_distance=64, ratio=0.8)) == 0


@replayable
@given(st.integers(0, 2**32 - 1))
def test_best_pairs_agree_with_their_definition(seed: int) -> None:
    rng = np.random.default_rng(seed)
    table = rng.permutation(200)[: 8 * 9].reshape(8, 9)
    tried = rng.random((8, 9)) < 0.5
    rows, columns = np.nonzero(tried)
    shuffled = rng.permutation(len(rows))
    rows, columns = rows[shuffled], columns[shuffled]
    found = best_pairs(rows, columns, table[rows, columns].astype(np.int64), max_distance=100, ratio=0.9)
    claims: dict[int, tuple[int, int]] = {}
    for row in range(8):
        candidates = sorted((int(table[row, c]), c) for c in np.flatnonzero(tried[row]).tolist())
        if not candidates or candidates[0][0] > 100:
            continue
        if len(candidates) > 1 and candidates[0][0] >= 0.9 * candidates[1][0]:
            continue
        distance, column = candidates[0]
        if column not in claims or distance < claims[column][0]:
            claims[column] = (distance, row)
    expected = sorted((row, column, distance) for column, (distance, row) in claims.items())
    assert list(zip(found.a.tolist(), found.b.tolist(), found.distance.tolist(), strict=True)) == expected


def test_descriptors_find_their_noisy_copies() -> None:
    rng = np.random.default_rng(2)
    b = _descriptors(rng, 300)
    order = rng.permutation(300)[:200]
    a = np.concatenate([_flip(rng, b[order], 25), _descriptors(rng, 50)])
    found = match_descriptors(a, b, max_distance=50, ratio=0.8)
    np.testing.assert_array_equal(found.a, np.arange(200))
    np.testing.assert_array_equal(found.b, order)
    np.testing.assert_array_equal(found.distance, 25)
    chosen = found.select(found.b < 100)
    assert (chosen.b < 100).all()
    assert len(chosen) == (order < 100).sum()


def test_each_descriptor_is_given_once_to_its_nearest() -> None:
    rng = np.random.default_rng(3)
    b = _descriptors(rng, 20)
    a = np.concatenate([_flip(rng, b[:1], 12), _flip(rng, b[:1], 5), _flip(rng, b[:1], 20)])
    found = match_descriptors(a, b)
    assert (found.a.tolist(), found.b.tolist(), found.distance.tolist()) == ([1], [0], [5])


def test_twins_are_ambiguous() -> None:
    rng = np.random.default_rng(4)
    b = _descriptors(rng, 20)
    b[7] = _flip(rng, b[3:4], 2)[0]
    assert len(match_descriptors(_flip(rng, b[3:4], 30), b)) == 0


@pytest.mark.parametrize(("a", "b"), [(0, 5), (5, 0), (5, 1), (0, 0)])
def test_too_few_descriptors_give_no_matches(a: int, b: int) -> None:
    rng = np.random.default_rng(5)
    assert len(match_descriptors(_descriptors(rng, a), _descriptors(rng, b))) == 0


def test_nearest_descriptors_are_sorted_by_distance() -> None:
    rng = np.random.default_rng(6)
    a, b = _descriptors(rng, 10), _descriptors(rng, 40)
    distance, index = nearest_descriptors(a, b, 5)
    every = (np.unpackbits(a, axis=1)[:, None] != np.unpackbits(b, axis=1)).sum(axis=-1)
    np.testing.assert_array_equal(distance, np.sort(every, axis=1)[:, :5])
    np.testing.assert_array_equal(np.take_along_axis(every, index.astype(np.intp), axis=1), distance)


def test_a_prediction_tells_twins_apart() -> None:
    rng = np.random.default_rng(7)
    one = _descriptors(rng, 1)
    look = np.concatenate([_flip(rng, one, 10), _flip(rng, one, 8)])
    pixels = np.array([[100.0, 100.0], [300.0, 100.0]])
    where = np.array([[103.0, 98.0]])

    def match(octave: int, radius: float) -> list[int]:
        return match_predicted(
            where,
            one,
            pixels,
            look,
            radius=radius,
            max_distance=60,
            ratio=0.8,
            predicted_octaves=np.array([octave]),
            octaves=np.array([2, 2], np.int8),
        ).b.tolist()

    assert match(2, 10.0) == [0]
    assert match(3, 10.0) == [0]
    assert match(4, 10.0) == []
    assert match(2, 3.5) == []
    assert match(2, 250.0) == []
