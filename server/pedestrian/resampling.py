"""Samples of any rate onto an even grid."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field

Vector = tuple[float, float, float]

_LONGEST_WAIT = 10.0
"""Seconds for which an angular velocity waits for the force of its time."""


@dataclass(slots=True)
class AreaResampler:
    """Means of a vector signal over the intervals of an even grid.

    The signal is the line between its samples; what is put out for a tick is its exact mean over the
    interval that ends there. So a gyroscope's angles are kept whatever its rate, and a fast sensor's
    noise is averaged instead of folded.

    Memory: one sample and the samples' integral.
    """

    period: float
    t: float = 0.0
    value: Vector = (0.0, 0.0, 0.0)
    empty: bool = True
    _sum: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])

    def start(self, t: float, value: Vector) -> None:
        """Forget all before ``t``."""
        self.t, self.value, self.empty = t, value, False
        self._sum = [0.0, 0.0, 0.0]

    def advance(self, t: float, value: Vector, tick: float) -> Vector | None:
        """Take the sample at ``t``; where it reaches the ``tick``, the mean over the period before that.

        Call again with the same sample and the next tick until ``None`` comes back.
        """
        before, old = self.t, self.value
        if t < tick:
            half = 0.5 * (t - before)
            total = self._sum
            total[0] += half * (old[0] + value[0])
            total[1] += half * (old[1] + value[1])
            total[2] += half * (old[2] + value[2])
            self.t, self.value = t, value
            return None
        part = (tick - before) / (t - before) if t > before else 1.0
        x = old[0] + part * (value[0] - old[0])
        y = old[1] + part * (value[1] - old[1])
        z = old[2] + part * (value[2] - old[2])
        half, rate = 0.5 * (tick - before), 1.0 / self.period
        total = self._sum
        mean = (
            (total[0] + half * (old[0] + x)) * rate,
            (total[1] + half * (old[1] + y)) * rate,
            (total[2] + half * (old[2] + z)) * rate,
        )
        total[0] = total[1] = total[2] = 0.0
        self.t, self.value = tick, (x, y, z)
        return mean


class MotionGrid:
    """Accelerometer and gyroscope, each with stamps of its own, on one even grid.

    A gyroscope that is missing, or is silent for ``patience`` seconds, counts as one that reads zero;
    ``deaf`` says that this is so of one that was heard before. Memory: ten seconds of it at the most.

    Args:
        period: seconds of the grid.
    """

    def __init__(self, period: float, patience: float = 0.2) -> None:
        self._period = period
        self._patience = round(patience / period)
        self._force = AreaResampler(period)
        self._turning = AreaResampler(period)
        self._origin = 0.0
        self._force_ticks = 0
        self._turning_ticks = self._first_turning = 0
        self._forces: deque[Vector] = deque()
        self._turnings: deque[Vector] = deque(maxlen=round(_LONGEST_WAIT / period))
        self._ready = 0
        self.deaf = False

    def acceleration(self, t: float, value: Vector) -> list[tuple[float, Vector, Vector]]:
        """Take a specific force; what is complete: (time, force, angular velocity) for each tick."""
        if self._force.empty:
            self._force.start(t, value)
            self._origin = t
            return []
        tick = self._origin + (self._force_ticks + 1) * self._period
        while (mean := self._force.advance(t, value, tick)) is not None:
            self._forces.append(mean)
            self._force_ticks += 1
            tick += self._period
        return self._complete()

    def rotation(self, t: float, value: Vector) -> list[tuple[float, Vector, Vector]]:
        """Take an angular velocity; returns as :meth:`acceleration`."""
        turning = self._turning
        if self._force.empty:
            return []
        if turning.empty:
            # Its first tick is the one whose whole interval it has seen.
            self._turning_ticks = max(self._ready, math.ceil((t - self._origin) / self._period))
            self._first_turning = self._turning_ticks
            turning.start(max(t, self._origin + self._turning_ticks * self._period), value)
            return []
        tick = self._origin + (self._turning_ticks + 1) * self._period
        while (mean := turning.advance(t, value, tick)) is not None:
            self._turnings.append(mean)
            self._turning_ticks += 1
            tick += self._period
        return self._complete()

    def _complete(self) -> list[tuple[float, Vector, Vector]]:
        complete = []
        while self._forces:
            turning: Vector = (0.0, 0.0, 0.0)
            ahead = self._turning_ticks - len(self._turnings) - self._ready
            while self._turnings and ahead < 0:
                self._turnings.popleft()
                ahead += 1
            if self._turnings and ahead == 0:
                turning = self._turnings.popleft()
                self.deaf = False
            elif not self._turnings and len(self._forces) <= self._patience:
                break
            else:
                self.deaf = not self._turning.empty and self._ready >= self._first_turning
            self._ready += 1
            complete.append((self._origin + self._ready * self._period, self._forces.popleft(), turning))
        return complete
