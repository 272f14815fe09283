"""The front door of a stream: what is wrong with a sample is found here, counted and reported."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass

from server.pedestrian.events import Sensor, Trouble, TroubleKind


@dataclass(frozen=True, slots=True)
class IntakeOptions:
    """Seconds.

    Attributes:
        longest_gap: between two samples of a motion sensor; what is longer is not interpolated.
        longest_jump: a stamp farther from the clock than this is doubted, ...
        jump_confirmations: ... until so many in a row agree with it: then the clock has jumped.
    """

    longest_gap: float = 0.25
    longest_jump: float = 2.0
    jump_confirmations: int = 5


class Reports:
    """Counts troubles, and tells of the first, tenth, hundredth ... of each kind."""

    def __init__(self) -> None:
        self.counts: Counter[tuple[Sensor, TroubleKind]] = Counter()
        self._fresh: list[Trouble] = []

    def add(self, t: float, sensor: Sensor, kind: TroubleKind, detail: str) -> None:
        self.counts[sensor, kind] += 1
        count = self.counts[sensor, kind]
        if count == 10 ** (len(str(count)) - 1):
            self._fresh.append(Trouble(t, sensor, kind, count, detail))

    def take(self) -> list[Trouble]:
        """Troubles to tell since the last call."""
        if not self._fresh:
            return []
        fresh, self._fresh = self._fresh, []
        return fresh


class Clock:
    """Time only goes forward; a clock that was set anew is followed after a few agreeing stamps.

    One clock serves all sensors of a phone. A single absurd stamp is dropped and changes nothing.
    """

    def __init__(self, options: IntakeOptions, reports: Reports) -> None:
        self._options = options
        self._reports = reports
        self.now: float | None = None
        self.jumps = 0
        self.jumped = 0.0
        self._last: dict[Sensor, float] = {}
        self._doubted: list[float] = []

    def admit(self, t: float, sensor: Sensor) -> bool:
        """Whether to use a sample with the stamp ``t``; ``jumps`` rises when the clock has ``jumped``."""
        reports = self._reports
        if not math.isfinite(t):
            reports.add(self.now or 0.0, sensor, TroubleKind.NOT_FINITE, "time stamp")
            return False
        now = self.now
        if now is not None and abs(t - now) > self._options.longest_jump:
            if not self._confirmed(t):
                kind = TroubleKind.CLOCK_JUMP if t > now else TroubleKind.OUT_OF_ORDER
                reports.add(now, sensor, kind, f"stamp {t - now:+.3f} s off the clock, dropped")
                return False
            self.jumps += 1
            self.jumped = t - now
            reports.add(t, sensor, TroubleKind.CLOCK_JUMP, f"the clock went {t - now:+.3f} s")
            self._last.clear()
            self.now = now = None
        self._doubted.clear()
        last = self._last.get(sensor)
        if last is not None and t <= last:
            kind = TroubleKind.DUPLICATE if t == last else TroubleKind.OUT_OF_ORDER
            reports.add(t, sensor, kind, f"{last - t:.3f} s before the one before")
            return False
        self._last[sensor] = t
        self.now = t if now is None or t > now else now
        return True

    def _confirmed(self, t: float) -> bool:
        doubted = self._doubted
        if doubted and not 0.0 <= t - doubted[-1] <= self._options.longest_jump:
            doubted.clear()
        doubted.append(t)
        return len(doubted) >= self._options.jump_confirmations
