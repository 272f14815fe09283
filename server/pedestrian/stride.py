"""How long a step is."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

from server.pedestrian.filters import LowPass


@dataclass(frozen=True, slots=True)
class StrideOptions:
    """Speed = ``gain`` * sqrt(standard deviation of the vertical acceleration).

    A leg is an inverted pendulum: the body's acceleration towards the foot is speed^2 / leg, so speed goes
    with the root of the vertical acceleration, and ``gain`` with the root of the leg's length. It is
    the one number that is learnt for each user.

    Attributes:
        gain: sqrt(m), of an average walker.
        cutoff_hz: of the low pass before the vertical acceleration is judged.
        window: seconds over which it is judged: a step or so.
        shortest, longest: metres, of a step.
        noise: standard deviation of one step's length, relative to it, users' scale apart.
        stair: metres level that a step on stairs takes: a building's tread.
        stair_noise: its standard deviation, metres.
    """

    gain: float = 0.67
    cutoff_hz: float = 3.0
    window: float = 0.6
    shortest: float = 0.2
    longest: float = 1.3
    noise: float = 0.2
    stair: float = 0.29
    stair_noise: float = 0.06


class StrideModel:
    """Lengths of steps from the vertical acceleration; memory: one window of it."""

    def __init__(self, options: StrideOptions, rate_hz: float) -> None:
        self.options = options
        self._low_pass = LowPass(options.cutoff_hz, rate_hz)
        self._window: deque[float] = deque(maxlen=max(2, round(options.window * rate_hz)))
        self._sum = self._squares = 0.0

    def update(self, vertical: float) -> None:
        """One sample of the vertical acceleration, m/s^2, gravity taken off."""
        value, window = self._low_pass(vertical), self._window
        if len(window) == window.maxlen:
            old = window[0]
            self._sum -= old
            self._squares -= old * old
        window.append(value)
        self._sum += value
        self._squares += value * value

    def speed(self) -> float:
        """Metres a second, by the latest window."""
        count = max(1, len(self._window))
        mean = self._sum / count
        variance = max(0.0, self._squares / count - mean * mean)
        return self.options.gain * math.sqrt(math.sqrt(variance))

    def length(self, speed: float, interval: float, on_stairs: bool) -> tuple[float, float]:
        """Length of a step that took ``interval`` seconds, metres, and its variance."""
        options = self.options
        if on_stairs:
            return options.stair, options.stair_noise**2
        length = min(options.longest, max(options.shortest, speed * interval))
        return length, (options.noise * length) ** 2


@dataclass(frozen=True, slots=True)
class UserProfile:
    """What was learnt about a user, to start the next walk with.

    Args:
        log_scale: of the steps' lengths, against :class:`StrideOptions`; 0 for an average walker.
        variance: of it; by default the spread among walkers and ways of carrying.
    """

    log_scale: float = 0.0
    variance: float = 0.14**2

    @property
    def scale(self) -> float:
        return math.exp(self.log_scale)
