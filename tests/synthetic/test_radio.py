"""What phones hear in a building, against the model it is drawn from."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest

from client_sim.synthetic.radio import (
    RadioOptions,
    bluetooth_scans,
    building_radio,
    path_loss,
    wifi_scans,
)
from client_sim.synthetic.scripts import Go, perform
from tests.synthetic.two_storeys import ROUND, two_storeys

OPTIONS = RadioOptions()
BUILDING = two_storeys()
RADIO = building_radio(BUILDING, np.random.default_rng(0))


def _loss(a: tuple[float, float, float], b: tuple[float, float, float]) -> float:
    return float(path_loss(np.array(a), np.array([b]), BUILDING.obstacles, OPTIONS)[0])


def test_ten_times_as_far_is_the_exponent_in_decibels_weaker() -> None:
    near, far = _loss((0.0, 0.0, 1.5), (1.0, 0.0, 1.5)), _loss((0.0, 0.0, 1.5), (10.0, 0.0, 1.5))
    assert near == pytest.approx(0.0)
    assert far - near == pytest.approx(10 * OPTIONS.exponent)


@pytest.mark.parametrize(
    ("a", "b", "extra"),
    [
        ((18.0, 0.0, 1.5), (22.0, 0.0, 1.5), 6.0),
        ((22.0, 1.0, 1.5), (18.0, -1.0, 1.4), 6.0),
        ((18.0, 12.0, 1.5), (22.0, 12.0, 1.5), 0.0),  # past the wall's end
        ((18.0, 0.0, 6.3), (22.0, 0.0, 6.6), 0.0),  # above it
        ((4.0, 0.0, 1.5), (4.0, 1.0, 4.5), 16.0),
        ((19.0, 0.0, 1.5), (21.5, 1.0, 4.5), 22.0),
        ((4.0, 0.0, 3.5), (4.0, 6.0, 3.5), 0.0),
    ],
)
def test_walls_and_floors_in_between_weaken(
    a: tuple[float, float, float], b: tuple[float, float, float], extra: float
) -> None:
    distance = float(np.linalg.norm(np.subtract(a, b)))
    assert _loss(a, b) == pytest.approx(24.0 * np.log10(distance) + extra)


def test_access_points_hang_apart_below_the_ceilings_of_both_storeys() -> None:
    heights = RADIO.places[:, 2]
    assert sorted(set(heights.round(2))) == [2.65, 5.71]
    assert min(np.linalg.norm(a - b) for a, b in combinations(RADIO.places, 2)) >= OPTIONS.spacing
    assert len(set(RADIO.names)) == len(RADIO.places) >= 8
    again = building_radio(BUILDING, np.random.default_rng(0))
    np.testing.assert_array_equal(again.places, RADIO.places)


def test_shadowing_belongs_to_the_place_and_fades_with_distance() -> None:
    rng = np.random.default_rng(1)
    points = rng.uniform((-8, -8, 1.5), (18, 8, 1.5), size=(600, 3))
    clear = np.stack([path_loss(p, points, RADIO.obstacles, OPTIONS) for p in RADIO.places], axis=1)
    shadow = RADIO.rssi(points) + clear - RADIO.power
    assert shadow.std() == pytest.approx(OPTIONS.shadowing, rel=0.15)

    def shifted(by: float) -> float:
        """Mean correlation of the shadowing at places so far apart."""
        moved = points + np.array([by, 0.0, 0.0])
        there = np.stack([path_loss(p, moved, RADIO.obstacles, OPTIONS) for p in RADIO.places], axis=1)
        return float(np.mean(shadow * (RADIO.rssi(moved) + there - RADIO.power)) / shadow.var())

    assert shifted(0.0) == pytest.approx(1.0, abs=0.05)
    assert shifted(OPTIONS.grain) == pytest.approx(np.exp(-0.5), abs=0.15)
    assert abs(shifted(4 * OPTIONS.grain)) < 0.2


def test_a_scan_every_two_seconds_tells_the_place() -> None:
    walks = [perform([Go(ROUND)], np.random.default_rng(seed)) for seed in (1, 2)]
    scans = [wifi_scans(motion, RADIO, np.random.default_rng(10 + k)) for k, motion in enumerate(walks)]
    times = np.array([scan.time for scan in scans[0]])
    np.testing.assert_allclose(np.diff(times), 2.0)
    heard = [len(scan.heard) for scan in scans[0]]
    assert min(heard) >= 4
    levels = [reading.rssi for scan in scans[0] for reading in scan.heard]
    assert -92 <= min(levels) < -75
    assert max(levels) < -25

    def vector(number: int, row: int) -> np.ndarray:
        received = {reading.source: reading.rssi for reading in scans[number][row].heard}
        return np.array([received.get(name, -95) for name in RADIO.names], dtype=float)

    rows = min(len(scans[0]), len(scans[1]))
    places = [m.positions(np.array([s.time for s in scans[k][:rows]])) for k, m in enumerate(walks)]
    apart = np.linalg.norm(places[0][:, None] - places[1][None], axis=2)
    other = np.stack([vector(1, row) for row in range(rows)])
    offset = np.median(np.stack([vector(0, row) for row in range(rows)]) - other)
    unlike = np.array(
        [[np.abs(vector(0, i) - other[j] - offset).mean() for j in range(rows)] for i in range(rows)]
    )
    assert np.median(unlike[apart < 1.5]) < 0.7 * np.median(unlike[apart > 8.0])


def test_noise_of_a_reading_and_the_phones_own_offset() -> None:
    motion = perform([Go(ROUND)], np.random.default_rng(1))
    quiet = RadioOptions(missed=0.0, floor=-200.0)
    radio = building_radio(BUILDING, np.random.default_rng(0), quiet)
    true = radio.rssi(motion.positions(np.arange(0.3, motion.duration, 2.0)))
    offsets, deviations = [], []
    for seed in range(60):
        scans = wifi_scans(motion, radio, np.random.default_rng(seed))
        error = np.array([[r.rssi for r in scan.heard] for scan in scans]) - true
        offsets.append(error.mean())
        deviations.append(error.std())
    assert np.std(offsets) == pytest.approx(quiet.phone_offset, rel=0.3)
    assert np.mean(deviations) == pytest.approx(quiet.noise, rel=0.05)


def test_other_users_are_heard_while_they_are_near() -> None:
    here = perform([Go(((0.0, 0.0), (30.0, 0.0)))], np.random.default_rng(1))
    there = perform([Go(((30.0, 1.0), (0.0, 1.0)))], np.random.default_rng(2))
    radio = building_radio(BUILDING, np.random.default_rng(0))
    scans = bluetooth_scans(here, {"walker 2": there}, radio, np.random.default_rng(3))
    levels = {scan.time: scan.heard[0].rssi for scan in scans}
    assert {reading.source for scan in scans for reading in scan.heard} == {"walker 2"}
    meeting = here.duration / 2
    near = [rssi for time, rssi in levels.items() if abs(time - meeting) < 2.0]
    far = [rssi for time, rssi in levels.items() if abs(time - meeting) > 8.0]
    assert len(near) >= 3
    assert np.mean(near) > -75
    assert not far or np.mean(far) < np.mean(near) - 12
