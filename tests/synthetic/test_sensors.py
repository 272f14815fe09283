"""A phone's sensors on a synthetic walk against the walk they were read on."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import find_peaks
from scipy.spatial.transform import Rotation

from client_sim.synthetic.gait import Gait
from client_sim.synthetic.magnetics import MagneticField, building_field
from client_sim.synthetic.motion import Motion
from client_sim.synthetic.scripts import Aim, Go, Stand, perform
from client_sim.synthetic.sensors import GRAVITY, PHONE_FROM_CAMERA, SensorFaults, Series, measure, pressure
from tests.synthetic.two_storeys import ROUND, STAIRS, two_storeys

Array = NDArray[np.float64]
PERFECT = SensorFaults(*[0.0] * 9, jitter=0.0008)
FIELD = building_field(two_storeys(), np.random.default_rng(0))


@pytest.fixture(scope="module")
def motion() -> Motion:
    """A walk with corners, and a phone that is turned in its course."""
    return perform([Go(ROUND)], np.random.default_rng(4), held=[Aim(6.0, 9.0, left=0.5, clockwise=1.2)])


def _sensors(motion: Motion, faults: SensorFaults | None = None, seed: int = 5) -> dict[str, Series]:
    return {s.kind: s for s in measure(motion, FIELD, np.random.default_rng(seed), faults)}


def _between(times: Array, values: Array) -> Array:
    """Integrals between readings by the trapezoidal rule."""
    return 0.5 * (values[1:] + values[:-1]) * np.diff(times)[:, None]


# A bias of 0.004 rad/s an axis over ten seconds: 99 % of such phones turn away by less than 7.7 degrees.
@pytest.mark.parametrize(("faults", "degrees"), [(PERFECT, 0.15), (None, 7.7)])
def test_the_gyroscope_integrates_to_the_rotation(
    motion: Motion, faults: SensorFaults | None, degrees: float
) -> None:
    gyroscope = _sensors(motion, faults)["gyroscope"]
    span = slice(100, 600)
    turned = Rotation.identity()
    for step in _between(gyroscope.times[span], gyroscope.values[span]):
        turned = turned * Rotation.from_rotvec(step)
    first, last = motion.rotations(gyroscope.times[[100, 599]]) @ PHONE_FROM_CAMERA.T
    error = (turned.inv() * Rotation.from_matrix(first.T @ last)).magnitude()
    assert np.degrees(error) < degrees
    # The phone did turn: an integral of nothing would be far off.
    assert np.degrees(Rotation.from_matrix(first.T @ last).magnitude()) > 45


@pytest.mark.parametrize(("faults", "metres"), [(PERFECT, 0.003), (None, 0.08)])
def test_accelerations_without_gravity_integrate_to_the_way_of_a_second(
    motion: Motion, faults: SensorFaults | None, metres: float
) -> None:
    accelerometer = _sensors(motion, faults)["accelerometer"]
    world_from_phone = motion.rotations(accelerometer.times) @ PHONE_FROM_CAMERA.T
    world = np.einsum("nij,nj->ni", world_from_phone, accelerometer.values) - [0.0, 0.0, GRAVITY]
    for begin in range(50, 700, 50):
        span = slice(begin, begin + 51)
        times = accelerometer.times[span]
        speed = motion.velocities(times[:1]) + np.vstack(
            [np.zeros(3), np.cumsum(_between(times, world[span]), axis=0)]
        )
        way = _between(times, speed).sum(axis=0)
        true = motion.positions(times[-1:])[0] - motion.positions(times[:1])[0]
        np.testing.assert_allclose(way, true, atol=metres)
        assert np.linalg.norm(true) > 0.3


def test_a_phone_at_rest_feels_gravity_up() -> None:
    gait = Gait(pitch=0.0, shake=1e-6)
    motion = perform([Go(ROUND[:2]), Stand(4.0)], np.random.default_rng(1), gait)
    accelerometer = _sensors(motion, PERFECT)["accelerometer"]
    still = accelerometer.values[accelerometer.times > motion.duration - 2.5]
    np.testing.assert_allclose(still, np.tile([0.0, GRAVITY, 0.0], (len(still), 1)), atol=0.01)


def test_steps_are_peaks_of_the_acceleration(motion: Motion) -> None:
    accelerometer = _sensors(motion)["accelerometer"]
    size = np.linalg.norm(accelerometer.values, axis=1)
    peaks, _ = find_peaks(size, prominence=1.5, distance=15)
    times = accelerometer.times[peaks]
    steps = np.array([step.time for step in motion.steps])
    assert len(peaks) == pytest.approx(len(steps), abs=2)
    nearest = np.abs(times[:, None] - steps[None]).min(axis=1)
    assert np.median(nearest) < 0.04
    # As phones that are carried have it (a mall's: 2.7 to 4.5; the rendered house's: 2.1 to 2.6).
    assert 1.5 < size.std() < 4.5
    assert np.percentile(size, 98) < 20


def test_readings_come_fifty_times_a_second_not_quite_evenly(motion: Motion) -> None:
    for series in _sensors(motion).values():
        spacing = np.diff(series.times)
        assert spacing.mean() == pytest.approx(0.02, abs=1e-4)
        assert 0.0005 < spacing.std() < 0.002
        assert spacing.min() > 0.01
        assert series.times[0] >= 0.0


def test_the_barometer_tells_the_storey() -> None:
    motion = perform([Go(STAIRS)], np.random.default_rng(2))
    barometer = _sensors(motion)["barometer"]
    assert barometer.values.shape[1] == 1
    ground, first = barometer.values[:50].mean(), barometer.values[-50:].mean()
    assert ground - first == pytest.approx(3.06 / 8434 * 1013.25, abs=0.03)
    assert ground - first > 0.3
    assert pressure(np.array([0.0]))[0] == 1013.25
    assert pressure(np.array([500.0]))[0] == pytest.approx(954.6, abs=2.0)  # ISO 2533's table


def _lines(field: MagneticField, points: Array) -> Array:
    """The field's Jacobian (3, 3) at points, by differences."""
    h = 1e-4
    columns = [(field.at(points + h * e) - field.at(points - h * e)) / (2 * h) for e in np.eye(3)]
    return np.stack(columns, axis=2)


def test_steel_bends_the_field_at_its_places_and_as_fields_are_bent() -> None:
    again = building_field(two_storeys(), np.random.default_rng(0))
    points = np.random.default_rng(3).uniform((-8, -8, 1.3), (24, 8, 1.7), size=(400, 3))
    np.testing.assert_array_equal(FIELD.at(points), again.at(points))
    strength = np.linalg.norm(FIELD.at(points), axis=1)
    # A mall's phones saw deviations of 2 to 9.
    assert 2.0 < strength.std() < 9.0
    assert strength.mean() == pytest.approx(48.0, abs=3.0)
    bare = MagneticField(np.zeros(3), np.array([[0.0, 0.0, 0.0]]), np.array([[1.0, 2.0, -3.0]]), core=0.0)
    jacobian = _lines(bare, np.array([[1.0, 0.5, 0.7], [-0.4, 1.2, 0.3]]))
    np.testing.assert_allclose(np.trace(jacobian, axis1=1, axis2=2), 0.0, atol=1e-5)
    np.testing.assert_allclose(jacobian, np.swapaxes(jacobian, 1, 2), atol=1e-5)


def test_the_same_place_bends_every_walks_field_the_same_way() -> None:
    walks = [perform([Go(ROUND)], np.random.default_rng(seed), Gait(sway=0.0)) for seed in (1, 2)]
    strengths = []
    for number, motion in enumerate(walks):
        series = _sensors(motion, seed=10 + number)["magnetometer"]
        ground = motion.grounds(series.times)
        straight = (ground[:, 1] < 0.05) & (ground[:, 0] < 8.0)
        size = np.linalg.norm(series.values[straight], axis=1)
        strengths.append(np.interp(np.arange(0.5, 7.5, 0.1), ground[straight, 0], size))
    assert np.corrcoef(strengths)[0, 1] > 0.8
    assert np.std(strengths[0]) > 1.0


def test_another_seed_is_another_phone(motion: Motion) -> None:
    first, same, other = (_sensors(motion, seed=seed) for seed in (1, 1, 2))
    for kind, series in first.items():
        np.testing.assert_array_equal(series.values, same[kind].values)
        assert np.abs(series.values - other[kind].values).max() > 0.0
    assert all(a < b for a, b in pairwise(first["gyroscope"].times))
