"""What a phone's stream says: one frozen dataclass an event, each with its variance.

``t`` is when it happened; an event may be told a moment later, when it has become certain.
Angles are positive to the left. Headings are directions of walking, in radians counter-clockwise from
east, where north is magnetic north turned by the options' declination.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import TypeAlias


class Sensor(StrEnum):
    ACCELEROMETER = "accelerometer"
    GYROSCOPE = "gyroscope"
    MAGNETOMETER = "magnetometer"
    BAROMETER = "barometer"
    WIFI = "wifi"
    SATELLITE = "satellite"


class Activity(StrEnum):
    """What the legs do."""

    WALKING = "walking"
    STAIRS_UP = "stairs_up"
    STAIRS_DOWN = "stairs_down"
    STILL = "still"


class AnchorKind(StrEnum):
    """Places that a building gives and sensors recognise (DynamicSLAM, 4.1.1)."""

    STAIRS_UP = "stairs_up"
    STAIRS_DOWN = "stairs_down"
    LIFT = "lift"
    ESCALATOR = "escalator"
    TURN = "turn"
    DOOR = "door"
    ENTRANCE = "entrance"


class TroubleKind(StrEnum):
    """What was wrong with the input."""

    NOT_FINITE = "not_finite"
    DUPLICATE = "duplicate"
    OUT_OF_ORDER = "out_of_order"
    GAP = "gap"
    CLOCK_JUMP = "clock_jump"
    UNITS = "units"
    IMPLAUSIBLE = "implausible"
    AXES = "axes"


@dataclass(frozen=True, slots=True)
class Step:
    """One step: the control input of DynamicSLAM's motion model (Eq. 4-8).

    ``heading_change`` is since the step before, by the gyroscope; ``heading`` is absolute, or ``None``
    while nothing has told it (no magnetometer and no fixes). The variances of length and heading change are
    this step's own noise, independent from step to step; the common errors (the user's scale, how the
    phone is held, the compass) are in ``heading_variance`` and ``scale_variance``, that of the length's log.
    """

    t: float
    length: float
    length_variance: float
    scale_variance: float
    heading_change: float
    heading_change_variance: float
    heading: float | None
    heading_variance: float


@dataclass(frozen=True, slots=True)
class AnchorSighting:
    """A building's anchor was passed.

    Args:
        t: when it was entered, for stairs, lifts and escalators; its middle for turns and doors.
        kind: what the detector says; ``confusion`` has p(detected | true).
        until: when it was left, or what is known of it when this is told.
        position_variance: m^2, how far from the anchor's own point the walker may be at ``t``.
        amount: turns: the angle, rad; stairs, lifts, escalators: the climb in metres, where a barometer
            or the count of steps tells it; else 0. ``amount_variance``: its variance.
    """

    t: float
    kind: AnchorKind
    until: float
    position_variance: float
    amount: float
    amount_variance: float


@dataclass(frozen=True, slots=True)
class MagneticSignature:
    """Level and vertical strength of the field, microtesla, along metres whose middle was at ``t``."""

    t: float
    profile: tuple[tuple[float, float], ...]
    position_variance: float


@dataclass(frozen=True, slots=True)
class WifiSignature:
    """A scan that can be compared; ``position_variance`` as everywhere of where the walker is, m^2."""

    t: float
    readings: tuple[tuple[str, float], ...]
    position_variance: float


@dataclass(frozen=True, slots=True)
class Height:
    """Height above where the stream began, metres, by the barometer; one every second."""

    t: float
    height: float
    variance: float


@dataclass(frozen=True, slots=True)
class ActivityChange:
    """What the legs do from now on, with the probability of every class when it was decided."""

    t: float
    activity: Activity
    probabilities: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Trouble:
    """Bad input of one sensor; told at its first, tenth, hundredth ... time, counted always."""

    t: float
    sensor: Sensor
    kind: TroubleKind
    count: int
    detail: str


Event: TypeAlias = (
    Step | AnchorSighting | MagneticSignature | WifiSignature | Height | ActivityChange | Trouble
)
