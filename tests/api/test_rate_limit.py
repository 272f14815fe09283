from __future__ import annotations

import pytest

from server.api.rate_limit import TokenBucket


def passed(bucket: TokenBucket, start: float, seconds: float, per_second: int) -> int:
    times = [start + i / per_second for i in range(int(seconds * per_second))]
    return sum(bucket.take(time) for time in times)


def test_a_burst_passes_then_the_rate() -> None:
    bucket = TokenBucket(rate=10, burst=40, now=0.0)
    assert sum(bucket.take(0.0) for _ in range(100)) == 40
    assert passed(bucket, 0.0, 10.0, 100) == pytest.approx(100, abs=1)


def test_less_than_the_rate_always_passes() -> None:
    assert passed(TokenBucket(rate=30, burst=4, now=0.0), 0.0, 60.0, 25) == 1500
