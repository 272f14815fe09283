"""Each detector of anchors on walks whose anchors are known."""

from __future__ import annotations

import math

import pytest

from server.pedestrian.anchors import (
    AnchorOptions,
    DoorDetector,
    EntranceDetector,
    Moment,
    RideDetector,
    StairsDetector,
    TurnDetector,
)
from server.pedestrian.confusion import CONFUSION, probability
from server.pedestrian.events import Activity, AnchorKind, AnchorSighting

OPTIONS = AnchorOptions()
WALK = (Activity.WALKING, True, 0.0, 0.0)
STAND = (Activity.STILL, False, 0.0, 0.0)


def shown(
    detector: StairsDetector | RideDetector | DoorDetector | EntranceDetector,
    *parts: tuple[int, tuple[Activity | None, bool, float, float | None]],
    field_change: float = 0.0,
) -> list[AnchorSighting]:
    """Parts: seconds, then (activity, stepping, push, climb)."""
    seconds = [moment for count, moment in parts for _ in range(count)]
    found = [detector.update(Moment(float(t), *moment, field_change)) for t, moment in enumerate(seconds)]
    return [sighting for sighting in found if sighting is not None]


@pytest.mark.parametrize(
    ("activity", "kind"),
    [
        (Activity.STAIRS_UP, AnchorKind.STAIRS_UP),
        (Activity.STAIRS_DOWN, AnchorKind.STAIRS_DOWN),
    ],
)
def test_stairs_by_the_legs(activity: Activity, kind: AnchorKind) -> None:
    level = (Activity.WALKING, True, 0.0, None)
    (sighting,) = shown(StairsDetector(OPTIONS), (10, level), (12, (activity, True, 0.0, None)), (5, level))
    assert sighting.kind is kind
    assert (sighting.t, sighting.until) == (pytest.approx(10, abs=1), pytest.approx(21, abs=1))
    assert math.copysign(1.0, sighting.amount) == (1.0 if kind is AnchorKind.STAIRS_UP else -1.0)
    assert sighting.amount_variance > 0.0


def test_a_second_of_stairs_is_an_error() -> None:
    level = (Activity.WALKING, True, 0.0, None)
    assert not shown(
        StairsDetector(OPTIONS), (10, level), (1, (Activity.STAIRS_UP, True, 0.0, None)), (9, level)
    )


def test_the_barometer_overrules_the_legs() -> None:
    assert not shown(StairsDetector(OPTIONS), (30, (Activity.STAIRS_UP, True, 0.0, 0.0)), (5, WALK))
    climbing = (Activity.WALKING, True, 0.0, 0.25)
    (sighting,) = shown(StairsDetector(OPTIONS), (5, WALK), (14, climbing), (5, WALK))
    assert sighting.kind is AnchorKind.STAIRS_UP
    assert sighting.amount == pytest.approx(14 * 0.25, abs=0.6)
    assert sighting.amount_variance < 1.0


@pytest.mark.parametrize("climb", [1.2, None])
def test_a_lift_pushes_at_both_ends(climb: float | None) -> None:
    still = (Activity.STILL, False, 0.0, None if climb is None else 0.0)
    start, stop = (Activity.STILL, False, 0.5, climb), (Activity.STILL, False, -0.5, climb)
    ride = (Activity.STILL, False, 0.0, climb)
    on_foot = (Activity.WALKING, True, 0.0, still[3])
    (sighting,) = shown(
        RideDetector(OPTIONS),
        (5, on_foot),
        (4, still),
        (2, start),
        (8, ride),
        (2, stop),
        (2, still),
        (3, on_foot),
    )
    assert sighting.kind is AnchorKind.LIFT
    if climb is not None:
        assert sighting.amount == pytest.approx(12 * climb)


def test_an_escalator_carries_without_a_push() -> None:
    ride = (Activity.STILL, False, 0.0, 0.25)
    (sighting,) = shown(RideDetector(OPTIONS), (5, WALK), (15, ride), (5, WALK))
    assert sighting.kind is AnchorKind.ESCALATOR
    assert sighting.amount == pytest.approx(15 * 0.25)


def test_who_stands_still_is_not_carried() -> None:
    assert not shown(RideDetector(OPTIONS), (5, WALK), (30, STAND), (5, WALK))
    unmeasured = (Activity.STILL, False, 0.0, None)
    assert not shown(RideDetector(OPTIONS), (5, WALK), (30, unmeasured), (5, WALK), field_change=0.3)


@pytest.mark.parametrize("degrees", [-170.0, -90.0, -45.0, 45.0, 90.0, 170.0])
def test_turns_are_measured(degrees: float) -> None:
    detector, found = TurnDetector(OPTIONS, 0.02), []
    for i in range(500):
        t = i * 0.02
        rate = math.radians(degrees) / 2.0 if 3.0 <= t < 5.0 else 0.0
        # Every step sways the phone, forth and back.
        found.append(detector.update(t, rate + 0.5 * math.sin(2.0 * math.pi * 1.8 * t)))
    (turn,) = [sighting for sighting in found if sighting is not None]
    assert turn.amount == pytest.approx(
        math.radians(degrees), abs=3.0 * math.sqrt(turn.amount_variance) + 0.1
    )
    assert turn.t == pytest.approx(4.0, abs=0.7)


def test_walking_straight_is_no_turn() -> None:
    detector = TurnDetector(OPTIONS, 0.02)
    assert not any(detector.update(i * 0.02, 0.6 * math.sin(0.2 * i) + 0.05) for i in range(2000))


def test_a_door_stops_for_a_moment() -> None:
    assert [s.kind for s in shown(DoorDetector(OPTIONS), (9, WALK), (3, STAND), (5, WALK))] == [
        AnchorKind.DOOR
    ]
    assert not shown(DoorDetector(OPTIONS), (9, WALK), (20, STAND), (5, WALK))
    assert not shown(DoorDetector(OPTIONS), (30, WALK))


def test_an_entrance_is_where_the_satellites_were_lost() -> None:
    detector = EntranceDetector(OPTIONS)
    for t in range(20):
        detector.fix(float(t), 5.0)
        assert detector.update(Moment(float(t), *WALK, 0.0)) is None
    found = [detector.update(Moment(float(t), *WALK, 0.0)) for t in range(20, 60)]
    (sighting,) = [s for s in found if s is not None]
    assert sighting.kind is AnchorKind.ENTRANCE
    assert sighting.t == 19.0
    assert sighting.position_variance >= 5.0**2


def test_bad_fixes_indoors_are_no_entrance() -> None:
    detector = EntranceDetector(OPTIONS)
    for t in range(60):
        detector.fix(float(t), 60.0)
        assert detector.update(Moment(float(t), *WALK, 0.0)) is None


def test_the_confusion_matrix_is_one_of_probabilities() -> None:
    assert set(CONFUSION) == set(AnchorKind)
    for true, row in CONFUSION.items():
        assert all(0.0 <= p <= 1.0 for p in row.detected.values())
        assert 0.0 <= row.missed < 1.0
        assert sum(row.detected.values()) <= 1.0
        assert probability(true, true) == max(row.detected.values())
    assert probability(AnchorKind.LIFT, AnchorKind.TURN) > 0.0
    assert CONFUSION[AnchorKind.STAIRS_UP].measured > 0
