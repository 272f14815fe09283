"""Organic anchors in an imagined building, with signatures that its places draw at random."""

from __future__ import annotations

import numpy as np
import pytest

from server.pedestrian.organic import (
    MAGNETIC,
    WIFI,
    OrganicAnchors,
    cosine_distance,
    profile_distance,
)
from server.pedestrian.signatures import MagneticProfile, ProfileOptions, profile_vector, wifi_vector


def building(seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Places (20, 2) and their magnetic profiles (20, 32)."""
    random = np.random.default_rng(seed)
    places = np.stack(np.meshgrid(np.arange(5), np.arange(4)), axis=-1).reshape(-1, 2) * 4.0
    return places, 30.0 + random.normal(0.0, 8.0, (20, 32))


def learnt(error: float = 1.5, walks: int = 30) -> tuple[OrganicAnchors, np.ndarray, np.ndarray]:
    places, profiles = building()
    random = np.random.default_rng(1)
    anchors = OrganicAnchors(MAGNETIC, profile_distance, 32)
    for _ in range(walks):
        for place, profile in zip(places, profiles, strict=True):
            seen = profile + random.normal(0.0, 0.5, 32)
            at = place + random.normal(0.0, error, 2)
            anchors.learn(seen, (float(at[0]), float(at[1])), error**2)
    return anchors, places, profiles


def test_many_walks_make_one_cluster_of_a_place() -> None:
    anchors, places, _ = learnt()
    assert len(places) <= len(anchors) <= 2 * len(places)
    # The mean of many walks is better than each of them.
    nearest = [np.hypot(*(anchors.positions - place).T).min() for place in places]
    assert np.median(nearest) < 0.6


def test_a_place_is_recalled_within_its_covariance() -> None:
    anchors, places, profiles = learnt()
    random, inside = np.random.default_rng(2), 0
    for place, profile in zip(places, profiles, strict=True):
        near = place + random.normal(0.0, 2.0, 2)
        found = anchors.recall(profile + random.normal(0.0, 0.5, 32), (float(near[0]), float(near[1])))
        assert found is not None
        miss = np.array(found[0]) - place
        assert np.hypot(*miss) < 2.0
        inside += miss @ np.linalg.solve(found[1], miss) < 5.991
    assert inside >= 0.9 * len(places)


def test_a_profile_walked_backwards_is_the_same_place() -> None:
    anchors, places, profiles = learnt()
    back = profiles[7].reshape(2, -1)[:, ::-1].ravel()
    found = anchors.recall(back, (float(places[7, 0]), float(places[7, 1])))
    assert found is not None
    assert np.hypot(*(np.array(found[0]) - places[7])) < 2.0


def test_places_that_look_alike_are_told_as_doubt() -> None:
    """Two clusters as likely as each other: their spread, as many times as signatures err together."""
    anchors = OrganicAnchors(MAGNETIC, profile_distance, 4)
    for x in (-3.0, 0.0, 3.0):
        anchors.learn(np.full(4, 30.0) + 1.2 * x, (x, 0.0), 0.01)
    found = anchors.recall(np.full(4, 30.0), (0.0, 0.0))
    assert found is not None
    weights = np.exp(-np.array([12.96, 0.0, 12.96]) / MAGNETIC.scale)
    spread = float(weights @ np.array([9.0, 0.0, 9.0]) / weights.sum()) / 2.0 + 0.01
    expected = MAGNETIC.floor**2 + MAGNETIC.repetition * spread
    assert np.diag(found[1]) == pytest.approx([expected, expected], rel=0.02)


def test_what_was_never_seen_is_not_recalled() -> None:
    anchors, places, profiles = learnt()
    here = (float(places[7, 0]), float(places[7, 1]))
    assert anchors.recall(profiles[7] + 40.0, here) is None
    assert anchors.recall(profiles[7], (500.0, 500.0)) is None


def test_scans_are_compared_by_what_both_know() -> None:
    names = {"a": 0, "b": 1, "c": 2}
    here = wifi_vector((("a", -40.0), ("b", -70.0)), names)
    assert np.linalg.norm(here) == pytest.approx(1.0)
    again = wifi_vector((("a", -45.0), ("b", -72.0), ("new", -30.0)), names)
    elsewhere = wifi_vector((("c", -40.0),), names)
    known = np.stack([again, elsewhere])
    assert cosine_distance(known, here)[0] < WIFI.alike < cosine_distance(known, here)[1]
    assert not wifi_vector((("new", -30.0),), names).any()


def test_a_profile_is_told_every_few_metres_with_the_time_of_its_middle() -> None:
    options = ProfileOptions()
    collector, found = MagneticProfile(options), []
    for i in range(60):
        # The field changes by a microtesla a metre.
        walked = 0.7 * (i + 0.5)
        found.append(collector.add(0.5 * (i + 1), 0.7, (walked, 0.0), -walked))
    profiles = [entry for entry in found if entry is not None]
    assert len(profiles) == pytest.approx((42.0 - 7.5) / options.every, abs=1)
    middle, rows = profiles[0]
    level = np.array(rows)[:, 0]
    assert np.diff(level) == pytest.approx(options.spacing)
    assert level.mean() == pytest.approx(0.7 * middle / 0.5 - 0.35, abs=0.4)
    assert profile_vector(rows).shape == (2 * options.samples,)
