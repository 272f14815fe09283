"""Resampling keeps integrals and pairs two sensors that have clocks of their own."""

from __future__ import annotations

import numpy as np
import pytest

from server.pedestrian.resampling import AreaResampler, MotionGrid


def resampled(times: np.ndarray, values: np.ndarray, period: float) -> np.ndarray:
    resampler, ticks = AreaResampler(period), []
    x, y, z = values[0].tolist()
    resampler.start(float(times[0]), (x, y, z))
    for t, value in zip(times[1:].tolist(), values[1:].tolist(), strict=True):
        x, y, z = value
        while (mean := resampler.advance(t, (x, y, z), times[0] + (len(ticks) + 1) * period)) is not None:
            ticks.append(mean)
    return np.array(ticks)


@pytest.mark.parametrize("rate", [20.0, 50.0, 97.0, 400.0])
def test_integrals_are_kept_whatever_the_rate(rate: float) -> None:
    random = np.random.default_rng(0)
    times = np.arange(0.0, 4.0, 1.0 / rate)
    times[1:-1] += random.uniform(-0.2, 0.2, len(times) - 2) / rate
    values = random.normal((1.0, 2.0, -3.0), 1.0, (len(times), 3))
    means = resampled(times, values, 0.02)
    end = 0.02 * len(means)
    for axis in range(3):
        fine = np.union1d(times, [end])
        whole = np.trapezoid(np.interp(fine, times, values[:, axis])[fine <= end], fine[fine <= end])
        assert means[:, axis].sum() * 0.02 == pytest.approx(whole, abs=1e-9)


def test_a_straight_line_stays_one() -> None:
    times = np.arange(0.0, 2.0, 0.013)
    values = np.outer(times, [1.0, -2.0, 3.0])
    means = resampled(times, values, 0.02)
    middles = 0.02 * (np.arange(len(means)) + 0.5)
    assert means == pytest.approx(np.outer(middles, [1.0, -2.0, 3.0]))


def test_two_sensors_meet_on_one_grid() -> None:
    grid, ticks = MotionGrid(0.02), []
    for i in range(200):
        ticks += grid.acceleration(i * 0.02, (0.0, 0.0, i * 0.02))
        ticks += grid.rotation(i * 0.02 + 0.007, (0.0, 0.0, i * 0.02 + 0.007))
    late = ticks[5:]
    assert [t for t, *_ in ticks] == pytest.approx(0.02 * np.arange(1, len(ticks) + 1))
    for t, force, turning in late:
        assert force[2] == pytest.approx(t - 0.01)
        assert turning[2] == pytest.approx(t - 0.01)


def test_a_gyroscope_that_falls_silent_reads_zero_and_is_heard_again() -> None:
    grid, ticks = MotionGrid(0.02), []
    for i in range(300):
        ticks += grid.acceleration(i * 0.02, (0.0, 0.0, 9.81))
        if not 100 <= i < 200:
            ticks += grid.rotation(i * 0.02, (0.0, 0.0, 1.0))
    turnings = np.array([turning[2] for *_, turning in ticks])
    assert len(ticks) >= 285
    assert turnings[10:90] == pytest.approx(1.0)
    assert turnings[250:] == pytest.approx(1.0)
