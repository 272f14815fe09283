"""All detectors of anchors together, shown one walk."""

from __future__ import annotations

import numpy as np

from server.pedestrian.activities import CLASSES, ActivityModel, ActivityWatch, default_model
from server.pedestrian.anchors import (
    AnchorOptions,
    DoorDetector,
    EntranceDetector,
    Moment,
    RideDetector,
    StairsDetector,
    TurnDetector,
)
from server.pedestrian.events import Activity, ActivityChange, AnchorSighting
from server.pedestrian.orientation import Vector

Found = AnchorSighting | ActivityChange


class Surroundings:
    """Turns ticks into moments, and shows them to every detector."""

    def __init__(self, options: AnchorOptions, period: float, model: ActivityModel | None = None) -> None:
        self._watch = ActivityWatch(model or default_model())
        self._stairs = StairsDetector(options)
        self._ride = RideDetector(options)
        self._turn = TurnDetector(options, period)
        self._door = DoorDetector(options)
        self.entrance = EntranceDetector(options)
        self._ticks = 0
        self._per_moment = round(1.0 / period)
        self._push = 0.0
        self._activity: Activity | None = None
        self._field: float | None = None
        self._old_field: float | None = None

    @property
    def on_stairs(self) -> bool:
        return self._stairs.climbing is not None

    def field(self, strength: float) -> None:
        """Strength of the magnetic field, microtesla."""
        self._field = strength

    def move(
        self, t: float, force: Vector, turning: Vector, vertical: float, turn_rate: float
    ) -> list[Found]:
        """One tick: in phone axes; and upwards without gravity, m/s^2; about the vertical, rad/s."""
        found: list[Found] = []
        if (turn := self._turn.update(t, turn_rate)) is not None:
            found.append(turn)
        self._push += vertical
        self._ticks += 1
        probabilities = self._watch.update(force, turning)
        if probabilities is not None:
            activity = CLASSES[int(np.argmax(probabilities))]
            if activity is not self._activity:
                self._activity = activity
                found.append(ActivityChange(t, activity, tuple(probabilities.tolist())))
        return found

    @property
    def due(self) -> bool:
        """Whether a second has passed since the last moment."""
        return self._ticks >= self._per_moment

    def moment(self, t: float, stepping: bool, climb: float | None) -> list[Found]:
        """Once a second: whether steps are being made, and the barometer's climb."""
        before, self._old_field = self._old_field, self._field
        change = 0.0 if before is None or self._field is None else abs(self._field - before)
        moment = Moment(t, self._activity, stepping, self._push / self._ticks, climb, change)
        self._push, self._ticks = 0.0, 0
        found = (
            detector.update(moment) for detector in (self._stairs, self._ride, self._door, self.entrance)
        )
        return [sighting for sighting in found if sighting is not None]
