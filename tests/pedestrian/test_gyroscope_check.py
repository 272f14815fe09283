"""Every signed permutation of axes is found, and a right gyroscope is left alone."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from server.pedestrian.gyroscope_check import _CANDIDATES, GyroscopeCheck


def tilting(check: GyroscopeCheck, axes: np.ndarray, unit: float = 1.0, noise: float = 0.3) -> list[bool]:
    """A phone in a restless hand for twenty seconds; whether the correction changed, at every sample."""
    random = np.random.default_rng(0)
    attitude, changed = Rotation.identity(), []
    for i in range(1000):
        t = i * 0.02
        turning = np.array([0.8 * np.sin(1.1 * t), 0.7 * np.cos(0.7 * t), 0.5 * np.sin(0.4 * t)])
        attitude = attitude * Rotation.from_rotvec(0.02 * turning)
        force = attitude.inv().apply([0.0, 0.0, 9.81]) + random.normal(0.0, noise, 3)
        x, y, z = (axes @ turning / unit).tolist()
        check.turn(t, (x, y, z))
        a, b, c = force.tolist()
        changed.append(check.force(t, (a, b, c)))
    return changed


def test_a_right_gyroscope_is_left_alone() -> None:
    check = GyroscopeCheck()
    assert not any(tilting(check, np.eye(3)))
    assert check.matrix is None


@pytest.mark.parametrize("index", [1, 5, 8, 17, 23, 31, 40, 47])
def test_axes_are_found(index: int) -> None:
    check = GyroscopeCheck()
    assert any(tilting(check, _CANDIDATES[index]))
    assert check.axes_changed
    assert check.matrix is not None
    assert np.array_equal(check.matrix @ _CANDIDATES[index], np.eye(3))


@pytest.mark.parametrize("unit", [np.pi / 180.0, 1e-3, 1e3])
def test_units_are_found(unit: float) -> None:
    check = GyroscopeCheck()
    tilting(check, np.eye(3), unit)
    assert check.matrix == pytest.approx(unit * np.eye(3))
    assert not check.axes_changed


def test_noise_alone_says_nothing() -> None:
    check, random = GyroscopeCheck(), np.random.default_rng(1)
    for i in range(5000):
        x, y, z = random.normal(0.0, 1.0, 3).tolist()
        check.turn(i * 0.02, (x, y, z))
        a, b, c = (np.array([0.0, 0.0, 9.81]) + random.normal(0.0, 3.0, 3)).tolist()
        assert not check.force(i * 0.02, (a, b, c))
