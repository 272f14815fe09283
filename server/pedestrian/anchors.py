"""Detectors of a building's anchors: finite state machines (DynamicSLAM, 4.1.1; UnLoc, MobiSys 2012).

All but the turn are shown the walk once a second, as a :class:`Moment`. A machine tells of an anchor when it
is left, because only then is it certain what it was.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum, auto

from server.pedestrian.events import Activity, AnchorKind, AnchorSighting


@dataclass(frozen=True, slots=True)
class Moment:
    """One second of a walk.

    Args:
        activity: what the legs do, or ``None`` while too little has been seen.
        stepping: whether steps are being made.
        push: mean vertical acceleration of the second, m/s^2: what a lift does to who stands in it.
        climb: metres a second by the barometer, or ``None`` without one.
        field_change: microtesla by which the field's strength has changed in this second.
    """

    t: float
    activity: Activity | None
    stepping: bool
    push: float
    climb: float | None
    field_change: float


@dataclass(frozen=True, slots=True)
class AnchorOptions:
    """Seconds and metres a second, radians.

    Attributes:
        stairs_confirmation: moments in a row that must agree; as many end it.
        shortest_stairs: seconds; less is a few steps, or an error.
        steady_climb: m/s by the barometer that is no longer level.
        push: m/s^2, mean over a second, that only a lift's start or stop gives to who stands still.
        longest_ride, shortest_ride: seconds in a lift or on an escalator.
        moving_field: microtesla a second: who stands still and sees the field change is carried.
        turn_rate, turn_end: rad/s at which a turn begins and below which it has ended.
        smallest_turn: radians.
        door_pause: seconds, shortest and longest, for which a door stops a walker.
        outdoors_accuracy: metres of a satellite fix that is only had outdoors.
        silence: seconds without one, after which the walker is indoors.
    """

    stairs_confirmation: int = 2
    shortest_stairs: float = 3.0
    steady_climb: float = 0.12
    push: float = 0.2
    longest_ride: float = 90.0
    shortest_ride: float = 4.0
    moving_field: float = 1.5
    turn_rate: float = math.radians(15.0)
    turn_end: float = math.radians(8.0)
    smallest_turn: float = math.radians(40.0)
    door_pause: tuple[float, float] = (1.5, 6.0)
    outdoors_accuracy: float = 15.0
    silence: float = 10.0


class StairsDetector:
    """LEVEL -> CLIMBING -> LEVEL, up and down: by the legs, and by the barometer where there is one."""

    def __init__(self, options: AnchorOptions) -> None:
        self.options = options
        self.climbing: AnchorKind | None = None
        self._candidate: AnchorKind | None = None
        self._agreeing = 0
        self._begin = self._last = 0.0
        self._height = 0.0
        self._moments = 0
        self._measured = 0

    def update(self, moment: Moment) -> AnchorSighting | None:
        said = self._said(moment)
        self._agreeing = self._agreeing + 1 if said is self._candidate else 1
        self._candidate = said
        if self.climbing is not None:
            self._moments += 1
            if moment.climb is not None:
                self._height += moment.climb
                self._measured += 1
        if said is self.climbing:
            self._last = moment.t
            return None
        if self._agreeing < self.options.stairs_confirmation:
            return None
        sighting = self._left()
        self.climbing = said
        self._begin, self._last = moment.t - self._agreeing + 1.0, moment.t
        self._height, self._moments, self._measured = 0.0, 0, 0
        return sighting

    def _said(self, moment: Moment) -> AnchorKind | None:
        if moment.climb is not None:
            if not moment.stepping or abs(moment.climb) < self.options.steady_climb:
                return None
            return AnchorKind.STAIRS_UP if moment.climb > 0.0 else AnchorKind.STAIRS_DOWN
        if moment.activity is Activity.STAIRS_UP:
            return AnchorKind.STAIRS_UP
        return AnchorKind.STAIRS_DOWN if moment.activity is Activity.STAIRS_DOWN else None

    def _left(self) -> AnchorSighting | None:
        if self.climbing is None or self._last - self._begin < self.options.shortest_stairs:
            return None
        sign = 1.0 if self.climbing is AnchorKind.STAIRS_UP else -1.0
        seconds = self._last - self._begin
        if self._measured > self._moments // 2:
            height, variance = self._height, 0.5**2
        else:
            # Some 0.3 m a second, as people climb; how many steps it takes they choose themselves.
            height, variance = sign * 0.3 * seconds, (0.1 * seconds) ** 2
        return AnchorSighting(self._begin, self.climbing, self._last, 1.5**2, height, variance)


class _Ride(Enum):
    ON_FOOT = auto()
    STANDING = auto()
    CARRIED = auto()


class RideDetector:
    """ON_FOOT -> STANDING -> CARRIED -> ON_FOOT: a lift if it pushed at start and stop, else an escalator."""

    def __init__(self, options: AnchorOptions) -> None:
        self.options = options
        self._state = _Ride.ON_FOOT
        self._begin = self._moved_until = 0.0
        self._pushes: set[bool] = set()
        self._height = 0.0
        self._measured = False

    def update(self, moment: Moment) -> AnchorSighting | None:
        options = self.options
        if moment.stepping:
            sighting = self._left() if self._state is _Ride.CARRIED else None
            self._state = _Ride.ON_FOOT
            return sighting
        if self._state is _Ride.ON_FOOT:
            self._state, self._begin, self._pushes = _Ride.STANDING, moment.t, set()
            self._height, self._measured = 0.0, False
        if abs(moment.push) > options.push:
            self._pushes.add(moment.push > 0.0)
        if moment.climb is None:
            carried = len(self._pushes) == 2 or moment.field_change > options.moving_field
        else:
            carried = abs(moment.climb) > options.steady_climb
            self._measured = True
            self._height += moment.climb
        if carried:
            if self._state is _Ride.STANDING:
                self._state = _Ride.CARRIED
                self._begin = max(self._begin, moment.t - 1.0) if not self._pushes else self._begin
            self._moved_until = moment.t
        return None

    def _left(self) -> AnchorSighting | None:
        options = self.options
        seconds = self._moved_until - self._begin
        if not options.shortest_ride <= seconds <= options.longest_ride:
            return None
        kind = AnchorKind.LIFT if len(self._pushes) == 2 else AnchorKind.ESCALATOR
        height, variance = (self._height, 0.5**2) if self._measured else (0.0, 10.0**2)
        return AnchorSighting(self._begin, kind, self._moved_until, 1.0, height, variance)


class TurnDetector:
    """STRAIGHT -> TURNING -> STRAIGHT, by the rate of turning about the vertical."""

    def __init__(self, options: AnchorOptions, period: float) -> None:
        self.options = options
        self._period = period
        self._rate = 0.0
        self._turning = False
        self._angle = 0.0
        self._begin = 0.0

    def update(self, t: float, rate: float) -> AnchorSighting | None:
        """One tick: rad/s, positive to the left."""
        options, period = self.options, self._period
        self._rate += (rate - self._rate) * min(1.0, 2.0 * period)
        # Steps sway a phone by more than slow turns turn it; half a second's mean does not sway.
        speed = abs(self._rate)
        if not self._turning:
            if speed > options.turn_rate:
                self._turning, self._begin, self._angle = True, t, self._rate * 0.5
            return None
        self._angle += rate * period
        if speed > options.turn_end:
            return None
        self._turning = False
        if abs(self._angle) < options.smallest_turn:
            return None
        seconds = t - self._begin
        variance = math.radians(3.0) ** 2 + math.radians(0.5) ** 2 * seconds
        middle = self._begin + 0.5 * (seconds - 0.5)
        return AnchorSighting(middle, AnchorKind.TURN, t, 1.0, self._angle, variance)


class DoorDetector:
    """WALKING -> STOPPED -> WALKING within the seconds that a door takes, and with no ride between."""

    def __init__(self, options: AnchorOptions) -> None:
        self.options = options
        self._stopped: float | None = None
        self._walked = 0

    def update(self, moment: Moment) -> AnchorSighting | None:
        if not moment.stepping:
            if self._stopped is None and self._walked >= 3:
                self._stopped = moment.t
            self._walked = 0
            return None
        self._walked += 1
        if self._stopped is None:
            return None
        begin, self._stopped = self._stopped, None
        shortest, longest = self.options.door_pause
        if not shortest <= moment.t - begin <= longest:
            return None
        return AnchorSighting(0.5 * (begin + moment.t), AnchorKind.DOOR, moment.t, 1.0, 0.0, 0.0)


class EntranceDetector:
    """UNKNOWN -> OUTDOORS -> INDOORS: good satellite fixes, and then none."""

    def __init__(self, options: AnchorOptions) -> None:
        self.options = options
        self._last_good: tuple[float, float] | None = None

    def fix(self, t: float, accuracy: float) -> None:
        """A satellite fix, 1 sigma in metres."""
        if accuracy <= self.options.outdoors_accuracy:
            self._last_good = (t, accuracy)

    def update(self, moment: Moment) -> AnchorSighting | None:
        if self._last_good is None or moment.t - self._last_good[0] < self.options.silence:
            return None
        (t, accuracy), self._last_good = self._last_good, None
        # A receiver holds on for some metres behind the door.
        return AnchorSighting(t, AnchorKind.ENTRANCE, moment.t, accuracy**2 + 5.0**2, 0.0, 0.0)
