from __future__ import annotations

import numpy as np
import pytest

from server.services.phone_clock import PhoneClock


def test_nothing_is_known_before_the_first_message() -> None:
    clock = PhoneClock()
    assert clock.offset_us is None
    assert clock.age_us(5, 10) is None


def test_one_message_bounds_the_offset_by_its_way() -> None:
    clock = PhoneClock()
    clock.observe(sent_us=1_000, received_us=501_000)
    assert clock.offset_us == 500_000
    assert clock.age_us(1_000, 601_000) == 100_000


def test_with_round_trips_the_offset_is_found_to_half_the_jitter() -> None:
    generator = np.random.default_rng(11)
    clock = PhoneClock()
    offset, way = 123_456_789, 20_000
    for step in range(40):
        up, down = way + generator.exponential(5_000, 2)
        sent = 100_000 * step
        clock.observe(sent, int(sent + offset + up), int(up + down))
    assert clock.offset_us == pytest.approx(offset, abs=5_000)
    assert clock.age_us(1_000_000, 1_000_000 + offset + 70_000) == pytest.approx(70_000, abs=5_000)


def test_a_drifting_clock_is_followed() -> None:
    clock = PhoneClock()
    for step in range(100):
        # The phone loses a millisecond a second.
        clock.observe(int(step * 999_000), step * 1_000_000)
    assert clock.offset_us == pytest.approx(99 * 1_000, abs=8_000)


def test_ages_are_never_negative() -> None:
    clock = PhoneClock()
    clock.observe(0, 0)
    assert clock.age_us(50, 10) == 0
