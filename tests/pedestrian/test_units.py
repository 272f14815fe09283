"""Units are decided by what is possible, and not by a step."""

from __future__ import annotations

import math

import numpy as np
import pytest

from server.pedestrian.units import ACCELERATION, MAGNETIC_FIELD, PRESSURE, UnitGuard


@pytest.mark.parametrize("phase", np.linspace(0.0, 2.0 * math.pi, 8, endpoint=False))
def test_a_vigorous_start_is_metres_a_second_squared(phase: float) -> None:
    guard = UnitGuard(ACCELERATION)
    used = []
    for i in range(200):
        norm = abs(9.81 + 7.0 * math.sin(2.0 * math.pi * 1.8 * i / 50.0 + phase))
        decided = guard.observe(norm)
        assert not decided or guard.factor == 1.0
        used.append(guard.scale(norm))
    assert guard.factor == 1.0
    assert sum(factor == 1.0 for factor in used) > 0.95 * len(used)


@pytest.mark.parametrize(
    ("range_", "usual"), [(ACCELERATION, 9.81), (MAGNETIC_FIELD, 45.0), (PRESSURE, 1000.0)]
)
def test_every_known_unit_is_found(range_, usual: float) -> None:
    for factor in range_.factors:
        guard = UnitGuard(range_)
        for _ in range(30):
            guard.observe(usual / factor)
        assert guard.factor == pytest.approx(factor)


def test_what_no_unit_explains_is_not_used() -> None:
    guard = UnitGuard(ACCELERATION)
    decisions = [guard.observe(0.0) for _ in range(200)]
    assert any(decisions)
    assert guard.factor is None
    assert guard.scale(0.0) is None


def test_a_unit_that_changes_is_decided_anew() -> None:
    guard = UnitGuard(ACCELERATION)
    for _ in range(100):
        guard.observe(9.81)
    for _ in range(100):
        guard.observe(9810.0)
    assert guard.factor == pytest.approx(1e-3)
