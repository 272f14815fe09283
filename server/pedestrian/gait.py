"""From level motion to steps with a direction and a length: the motion model's input."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field

from server.pedestrian.steps import StepDetector, StepOptions
from server.pedestrian.stride import StrideModel, StrideOptions


@dataclass(frozen=True, slots=True)
class Pace:
    """One step in the level frame: when, how long before the next it began, direction, length, variance."""

    t: float
    interval: float
    level_heading: float
    length: float
    length_variance: float


@dataclass(frozen=True, slots=True)
class GaitOptions:
    """Of the parts, and seconds of motion that are remembered until its steps are confirmed."""

    steps: StepOptions = field(default_factory=StepOptions)
    stride: StrideOptions = field(default_factory=StrideOptions)
    usual_interval: float = 0.55


class Gait:
    """Steps are told a moment late, so a few seconds of headings and speeds are kept."""

    def __init__(self, options: GaitOptions, period: float) -> None:
        self.options = options
        self._period = period
        self._detector = StepDetector(options.steps, 1.0 / period)
        self._stride = StrideModel(options.stride, 1.0 / period)
        remembered = (options.steps.confirmation + 1) * options.steps.longest
        self._history: deque[tuple[float, float, float]] = deque(maxlen=math.ceil(remembered / period))
        self._east = self._north = 0.0
        self._newest = 0.0
        self._last_step = float("-inf")
        self.on_stairs = False

    def under_way(self) -> tuple[float, float]:
        """(x, y), level frame, unscaled metres: the step that is being made and those not yet certain."""
        since = self._newest - self._last_step
        if self._detector.walking:
            since = min(since, self.options.usual_interval)
        elif (first := self._detector.first_unconfirmed) is not None:
            since = self._newest - first + self.options.usual_interval
        else:
            return 0.0, 0.0
        now, before = self._history[-1], self._at(self._newest - since)
        heading = math.atan2(now[1] - before[1], now[0] - before[0])
        distance = now[2] * since
        return distance * math.cos(heading), distance * math.sin(heading)

    @property
    def walking(self) -> bool:
        return self._detector.walking

    @property
    def stepping(self) -> bool:
        """Whether a step was made just now, certain or not."""
        return self._newest - self._detector.last < self.options.steps.longest

    def update(self, t: float, norm: float, vertical: float, forward: tuple[float, float]) -> list[Pace]:
        """One tick: norm of acceleration, its vertical part without gravity, level direction of the phone."""
        self._stride.update(vertical)
        x, y = forward
        size = math.hypot(x, y) or 1.0
        self._east += x / size
        self._north += y / size
        self._newest = t
        self._history.append((self._east, self._north, self._stride.speed()))
        steps = self._detector.update(t, norm)
        return [self._pace(step) for step in steps] if steps else []

    def _pace(self, t: float) -> Pace:
        options = self.options
        interval = t - self._last_step
        if interval > options.steps.longest:
            interval = options.usual_interval
        self._last_step = t
        after, before = self._at(t), self._at(t - interval)
        heading = math.atan2(after[1] - before[1], after[0] - before[0])
        length, variance = self._stride.length(after[2], interval, self.on_stairs)
        return Pace(t, interval, heading, length, variance)

    def _at(self, t: float) -> tuple[float, float, float]:
        back = round((self._newest - t) / self._period)
        return self._history[min(len(self._history) - 1, max(0, len(self._history) - 1 - back))]
