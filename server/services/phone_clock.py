"""The phone's clock against the service's, from the times in its messages."""

from __future__ import annotations

from collections import deque

_WINDOW = 8
"""Messages looked back on: short enough to follow a drifting clock."""


class PhoneClock:
    """Estimates what to add to the phone's clock to get the service's.

    Of received minus sent, the smallest is nearest to the offset: it is too large by the way the
    message took, which is half the shortest round trip if the client has measured one (as in RFC 5905,
    section 8, without the assumption that every exchange is symmetric).
    """

    def __init__(self) -> None:
        self._differences: deque[int] = deque(maxlen=_WINDOW)
        self._round_trips: deque[int] = deque(maxlen=_WINDOW)

    def observe(self, sent_us: int, received_us: int, round_trip_us: int | None = None) -> None:
        """A message sent at ``sent_us`` of the phone's clock came at ``received_us`` of the service's."""
        self._differences.append(received_us - sent_us)
        if round_trip_us is not None:
            self._round_trips.append(round_trip_us)

    @property
    def offset_us(self) -> float | None:
        """Service clock minus phone clock, microseconds; None before the first message."""
        if not self._differences:
            return None
        return min(self._differences) - min(self._round_trips, default=0) / 2

    def time_us(self, now_us: int) -> float | None:
        """The phone's clock when the service's says ``now_us``; None if not known."""
        offset = self.offset_us
        return None if offset is None else now_us - offset

    def age_us(self, phone_time_us: int, now_us: int) -> float | None:
        """How long ago a moment of the phone's clock was; never negative; None if not known."""
        offset = self.offset_us
        return None if offset is None else max(0.0, now_us - phone_time_us - offset)
