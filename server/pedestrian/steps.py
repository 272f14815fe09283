"""Steps, wherever the phone is carried: swings of the accelerometer's norm."""

from __future__ import annotations

from dataclasses import dataclass

from server.pedestrian.filters import LowPass


@dataclass(frozen=True, slots=True)
class StepOptions:
    """What a step is.

    Attributes:
        cutoff_hz: of the low pass; nobody makes more steps a second for long.
        smallest_swing: from valley to peak of the filtered norm, m/s^2; less is no step.
        relative_swing: the same, as a fraction of the latest swings: tells the other leg's step from
            the bounce of a pocket.
        shortest, longest: seconds from step to step.
        confirmation: steps in a row before any is told; handling a phone makes fewer.
        memory: steps over which the swing is averaged.
    """

    cutoff_hz: float = 2.5
    smallest_swing: float = 1.0
    relative_swing: float = 0.4
    shortest: float = 0.3
    longest: float = 1.2
    confirmation: int = 4
    memory: float = 5.0


class StepDetector:
    """Peaks of the low-passed norm of acceleration, told apart by hysteresis; a state of a few numbers."""

    def __init__(self, options: StepOptions, rate_hz: float) -> None:
        self.options = options
        self._low_pass = LowPass(options.cutoff_hz, rate_hz)
        self._rising = True
        self._peak = self._valley = 9.81
        self._peak_time: float | None = None
        self._swing = 0.0
        self._last = float("-inf")
        self._unconfirmed: list[float] = []
        self.walking = False

    @property
    def first_unconfirmed(self) -> float | None:
        """When the first step was made of those that are not certain yet."""
        return self._unconfirmed[0] if self._unconfirmed else None

    @property
    def last(self) -> float:
        """When the latest step was made, certain or not."""
        return self._last

    def update(self, t: float, norm: float) -> list[float]:
        """Times of the steps that have become certain with the norm (m/s^2) at ``t``, oldest first."""
        y = self._low_pass(norm)
        if self.walking and t - self._last > self.options.longest:
            self.walking = False
        if self._peak_time is None:
            self._peak_time = t
        if self._rising:
            if y > self._peak:
                self._peak, self._peak_time = y, t
            elif self._peak - y > self._hysteresis():
                self._rising = False
                swing, self._valley = self._peak - self._valley, y
                return self._step(self._peak_time, swing)
        elif y < self._valley:
            self._valley = y
        elif y - self._valley > self._hysteresis():
            self._rising = True
            self._peak, self._peak_time = y, t
        return []

    def _hysteresis(self) -> float:
        return max(self.options.smallest_swing, self.options.relative_swing * self._swing)

    def _step(self, t: float, swing: float) -> list[float]:
        options = self.options
        interval = t - self._last
        if interval < options.shortest:
            return []
        if interval > options.longest:
            self._unconfirmed.clear()
            self._swing = 0.0
            self.walking = False
        self._swing = swing if self._swing == 0.0 else self._swing + (swing - self._swing) / options.memory
        self._last = t
        if self.walking:
            return [t]
        self._unconfirmed.append(t)
        if len(self._unconfirmed) < options.confirmation:
            return []
        steps, self._unconfirmed = self._unconfirmed, []
        self.walking = True
        return steps
