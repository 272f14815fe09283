"""A token bucket."""

from __future__ import annotations


class TokenBucket:
    """Lets ``rate`` things a second pass, and ``burst`` at once after a pause.

    Args:
        now: seconds, of any steady clock; the same clock as in :meth:`take`.
    """

    def __init__(self, rate: float, burst: float, now: float) -> None:
        self._rate = rate
        self._burst = burst
        self._tokens = burst
        self._then = now

    def take(self, now: float) -> bool:
        """True if one more may pass."""
        self._tokens = min(self._burst, self._tokens + (now - self._then) * self._rate)
        self._then = now
        if self._tokens < 1.0:
            return False
        self._tokens -= 1.0
        return True
