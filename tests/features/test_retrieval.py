"""Place retrieval: the votes of a picture's features for keyframes, against counting by hand."""

from __future__ import annotations

import numpy as np
import pytest

from server.features.matching import hamming
from server.features.retrieval import PlaceIndex, RetrievalOptions

KEYFRAMES, EACH = 30, 60


def _walk(seed: int = 1) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Random descriptors; keyframe k sees landmarks 20 k to 20 k + 60: neighbours share most of theirs."""
    rng = np.random.default_rng(seed)
    seen = [np.arange(20 * k, 20 * k + EACH) for k in range(KEYFRAMES)]
    descriptors = rng.integers(0, 256, (20 * KEYFRAMES + EACH, 32), np.uint8)
    offsets = np.concatenate([[0], np.cumsum([len(s) for s in seen])]).astype(np.int64)
    return descriptors, offsets, np.concatenate(seen).astype(np.int32)


def _noisy(descriptors: np.ndarray, bits: int, seed: int = 2) -> np.ndarray:
    """The descriptors with so many bits flipped in each."""
    rng = np.random.default_rng(seed)
    flipped = np.unpackbits(descriptors, axis=1)
    for row in flipped:
        row[rng.permutation(256)[:bits]] ^= 1
    return np.packbits(flipped, axis=1)


@pytest.mark.parametrize("place", [0, 1, 7, 15, 28, 29])
def test_the_place_a_picture_was_taken_at_comes_first(place: int) -> None:
    descriptors, offsets, landmarks = _walk()
    index = PlaceIndex(descriptors, offsets, landmarks)
    picture = _noisy(descriptors[landmarks[offsets[place] : offsets[place + 1]]], 30)
    best = index.query(picture, 3)
    # Votes are pooled over two neighbours on either side: at an end the middle is that far off.
    assert abs(best[0].keyframe - place) <= (0 if 2 <= place < KEYFRAMES - 2 else 2)
    assert [c.votes for c in best] == sorted((c.votes for c in best), reverse=True)


def test_votes_are_what_counting_by_hand_gives() -> None:
    descriptors, offsets, landmarks = _walk(3)
    options = RetrievalOptions(queries=10_000, spread=1, max_distance=40)
    picture = _noisy(descriptors[100:300], 35)
    picture = np.concatenate([picture, _noisy(descriptors[400:420], 60)])
    votes = np.zeros(KEYFRAMES)
    for one in picture:
        rows = np.zeros(len(descriptors), np.intp)
        distance = hamming(one[None], descriptors, rows, np.arange(len(descriptors)))
        if distance.min() > options.max_distance:
            continue
        seen = np.flatnonzero(landmarks == distance.argmin())
        seen = np.searchsorted(offsets, seen, side="right") - 1
        votes[seen] += 1 / np.sqrt(len(seen))
    pooled = np.convolve(votes, np.ones(3), mode="same")
    found = PlaceIndex(descriptors, offsets, landmarks, options).query(picture, 4)
    assert found[0].keyframe == int(pooled.argmax())
    for candidate in found:
        assert candidate.votes == pytest.approx(pooled[candidate.keyframe])


def test_candidates_lie_apart() -> None:
    descriptors, offsets, landmarks = _walk()
    index = PlaceIndex(descriptors, offsets, landmarks, RetrievalOptions(spread=2))
    found = [c.keyframe for c in index.query(descriptors[::3], 6)]
    assert len(found) >= 4
    assert np.diff(np.sort(found)).min() > 4


def test_only_keyframes_before_the_limit_are_considered() -> None:
    descriptors, offsets, landmarks = _walk()
    index = PlaceIndex(descriptors, offsets, landmarks)
    picture = descriptors[landmarks[offsets[20] : offsets[21]]]
    assert index.query(picture, 1)[0].keyframe == 20
    # Pooling must not carry a vote over the limit.
    for limit in range(KEYFRAMES):
        for seen in (picture, descriptors, descriptors[200:500:2]):
            found = index.query(seen, 8, limit=limit)
            assert all(c.keyframe < limit for c in found), (limit, found)


def test_other_looks_get_no_votes() -> None:
    descriptors, offsets, landmarks = _walk()
    index = PlaceIndex(descriptors, offsets, landmarks)
    other = np.random.default_rng(9).integers(0, 256, (500, 32), np.uint8)
    assert index.query(other, 5) == []


def test_a_picture_without_features_and_a_map_without_keyframes_have_no_places() -> None:
    descriptors, offsets, landmarks = _walk()
    assert PlaceIndex(descriptors, offsets, landmarks).query(np.zeros((0, 32), np.uint8), 3) == []
    empty = PlaceIndex(np.zeros((0, 32), np.uint8), np.zeros(1, np.int64), np.zeros(0, np.int32))
    assert empty.query(descriptors[:10], 3) == []


def test_a_landmark_seen_from_everywhere_says_little() -> None:
    """A logo on every door outvotes the place itself if every vote counts the same."""
    rng = np.random.default_rng(4)
    descriptors = rng.integers(0, 256, (130, 32), np.uint8)
    everywhere, here = np.arange(100), np.arange(100, 130)
    seen = [everywhere if k != 20 else np.concatenate([everywhere[:60], here]) for k in range(40)]
    offsets = np.concatenate([[0], np.cumsum([len(s) for s in seen])]).astype(np.int64)
    index = PlaceIndex(
        descriptors, offsets, np.concatenate(seen).astype(np.int32), RetrievalOptions(spread=0)
    )
    assert index.query(descriptors, 1)[0].keyframe == 20


@pytest.mark.parametrize("keyframes", [1, 2, 3, 4])
def test_a_very_short_walk_has_no_places_beyond_its_end(keyframes: int) -> None:
    descriptors, offsets, landmarks = _walk()
    used = int(offsets[keyframes])
    index = PlaceIndex(descriptors, offsets[: keyframes + 1], landmarks[:used])
    found = index.query(descriptors[landmarks[:used]], 8)
    assert found
    assert all(0 <= c.keyframe < keyframes for c in found)
