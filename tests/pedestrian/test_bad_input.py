"""What phones send when they are not well: counted, told, survived."""

from __future__ import annotations

import math
import pickle
from dataclasses import replace

import numpy as np
import pytest

from server.pedestrian.events import Event, Height, Sensor, Step, Trouble, TroubleKind
from server.pedestrian.samples import (
    Accelerometer,
    Barometer,
    Gyroscope,
    Magnetometer,
    Sample,
    SatelliteFix,
    WifiScan,
)
from server.pedestrian.stream import PhoneStream
from tests.pedestrian.walkers import Walker

WALKER = Walker(noise=0.5)
END = (15.0, 20.0)


def walk(samples: list[Sample]) -> tuple[PhoneStream, list[Event]]:
    stream = PhoneStream()
    events = [event for sample in samples for event in stream.push(sample)]
    assert np.isfinite(stream.dead_reckoning.state).all()
    assert np.isfinite(stream.dead_reckoning.covariance).all()
    assert all(math.isfinite(value) for value in stream.position)
    return stream, events


def steps(events: list[Event]) -> int:
    return sum(isinstance(event, Step) for event in events)


def told(events: list[Event], sensor: Sensor, kind: TroubleKind) -> bool:
    return any(isinstance(e, Trouble) and e.sensor is sensor and e.kind is kind for e in events)


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("kind", [Accelerometer, Gyroscope, Magnetometer])
def test_numbers_that_are_none_are_dropped(kind: type, value: float) -> None:
    samples = WALKER.samples()
    bad = [replace(s, y=value) if isinstance(s, kind) and i % 97 == 0 else s for i, s in enumerate(samples)]
    stream, events = walk(bad)
    sensor = Sensor(kind.__name__.lower())
    assert stream.troubles[sensor, TroubleKind.NOT_FINITE] == sum(
        a != b for a, b in zip(bad, samples, strict=True)
    )
    assert told(events, sensor, TroubleKind.NOT_FINITE)
    assert steps(events) == WALKER.steps
    assert stream.position == pytest.approx(END, abs=1.5)


def test_a_stamp_that_is_no_number_is_dropped() -> None:
    samples = WALKER.samples()
    samples[300] = replace(samples[300], t=math.nan)
    stream, _ = walk(samples)
    assert sum(stream.troubles.values()) == 1


def test_duplicates_change_nothing() -> None:
    samples = WALKER.samples()
    stream, events = walk([sample for sample in samples for _ in range(2)])
    once, _ = walk(samples)
    assert stream.troubles[Sensor.GYROSCOPE, TroubleKind.DUPLICATE] == len(samples) // 3
    assert told(events, Sensor.GYROSCOPE, TroubleKind.DUPLICATE)
    assert stream.position == once.position


def test_samples_that_come_late_are_left_out() -> None:
    samples = WALKER.samples()
    for i in range(100, len(samples) - 30, 200):
        samples[i], samples[i + 6] = samples[i + 6], samples[i]
    stream, events = walk(samples)
    assert told(events, Sensor.ACCELEROMETER, TroubleKind.OUT_OF_ORDER) or told(
        events, Sensor.GYROSCOPE, TroubleKind.OUT_OF_ORDER
    )
    assert steps(events) == WALKER.steps
    assert stream.position == pytest.approx(END, abs=1.5)


def test_a_gap_is_not_bridged_and_widens_the_doubt() -> None:
    samples = [s for s in WALKER.samples() if not 8.0 < s.t < 9.5]
    stream, events = walk(samples)
    assert told(events, Sensor.ACCELEROMETER, TroubleKind.GAP)
    whole, _ = walk(WALKER.samples())
    assert np.trace(stream.position_covariance) > np.trace(whole.position_covariance) + 1.0
    assert not stream.dead_reckoning.unbroken
    # A second and a half of walking is missing, the rest is not.
    miss = np.hypot(*(np.array(stream.position) - END))
    assert miss < 1.5 * WALKER.speed + 3.0


@pytest.mark.parametrize("jump", [-1000.0, -3.0, 5.0, 1e6])
def test_a_clock_that_is_set_anew_is_followed(jump: float) -> None:
    samples = [replace(s, t=s.t + jump) if s.t > 9.0 else s for s in WALKER.samples()]
    stream, events = walk(samples)
    assert any(told(events, sensor, TroubleKind.CLOCK_JUMP) for sensor in Sensor)
    # Those that are lost were not certain yet, or made while the new time was doubted.
    assert WALKER.steps - 5 <= steps(events) <= WALKER.steps
    assert stream.position == pytest.approx(END, abs=5.0)


def test_one_absurd_stamp_does_no_harm() -> None:
    samples = WALKER.samples()
    samples[900] = replace(samples[900], t=1e9)
    stream, events = walk(samples)
    assert steps(events) == WALKER.steps
    assert stream.position == pytest.approx(END, abs=1.5)
    assert stream.dead_reckoning.unbroken


@pytest.mark.parametrize("factor", [1.0 / 9.81, 1000.0, 1e-3, 1000.0 / 9.81])
def test_acceleration_in_another_unit_is_put_right(factor: float) -> None:
    samples = [
        replace(s, x=s.x * factor, y=s.y * factor, z=s.z * factor) if isinstance(s, Accelerometer) else s
        for s in WALKER.samples()
    ]
    stream, events = walk(samples)
    assert told(events, Sensor.ACCELEROMETER, TroubleKind.UNITS)
    assert steps(events) == WALKER.steps
    assert stream.position == pytest.approx(END, abs=1.5)


@pytest.mark.parametrize("factor", [1000.0, 1e-3, 0.01])
def test_a_field_in_another_unit_is_put_right(factor: float) -> None:
    samples = [
        replace(s, x=s.x * factor, y=s.y * factor, z=s.z * factor) if isinstance(s, Magnetometer) else s
        for s in WALKER.samples()
    ]
    stream, events = walk(samples)
    assert told(events, Sensor.MAGNETOMETER, TroubleKind.UNITS)
    assert stream.position == pytest.approx(END, abs=1.5)


@pytest.mark.parametrize("factor", [180.0 / math.pi, 1000.0, 1e-3])
def test_turning_in_another_unit_is_told(factor: float) -> None:
    walker = replace(WALKER, sway=0.35)
    samples = [
        replace(s, x=s.x * factor, y=s.y * factor, z=s.z * factor) if isinstance(s, Gyroscope) else s
        for s in walker.samples()
    ]
    _, events = walk(samples)
    assert told(events, Sensor.GYROSCOPE, TroubleKind.UNITS)
    right, _ = walk(walker.samples())
    assert right.troubles[Sensor.GYROSCOPE, TroubleKind.UNITS] == 0


def test_axes_of_another_convention_are_told() -> None:
    """A gyroscope whose x and y are exchanged does not turn with what the accelerometer sees turning."""
    walker = replace(WALKER, sway=0.35)
    samples = [replace(s, x=s.y, y=s.x) if isinstance(s, Gyroscope) else s for s in walker.samples()]
    _, events = walk(samples)
    assert told(events, Sensor.GYROSCOPE, TroubleKind.AXES)
    right, _ = walk(walker.samples())
    assert right.troubles[Sensor.GYROSCOPE, TroubleKind.AXES] == 0


@pytest.mark.parametrize(
    "turn",
    [
        [[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]],
        [[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]],
    ],
)
def test_axes_that_are_turned_for_all_sensors_keep_the_steps_and_the_shape(turn: list[list[float]]) -> None:
    samples = replace(WALKER, phone_from_level=np.array(turn)).samples()
    stream, events = walk(samples)
    assert steps(events) == WALKER.steps
    assert math.hypot(*stream.position) == pytest.approx(25.0, abs=2.0)


def test_rubbish_of_every_kind_is_survived() -> None:
    random = np.random.default_rng(3)
    samples: list[Sample] = []
    for _ in range(5000):
        t = float(random.choice([math.nan, random.uniform(-1e3, 1e3), random.normal(10.0, 2.0)]))
        value = [float(v) for v in random.choice([0.0, math.nan, 1e30, -9.81, 5.0], 3)]
        samples.append(
            random.choice(
                np.array(
                    [
                        Accelerometer(t, *value),
                        Gyroscope(t, *value),
                        Magnetometer(t, *value),
                        Barometer(t, value[0]),
                        SatelliteFix(t, value[1]),
                        WifiScan(t, (("a", value[0]), ("b", -60.0))),
                    ],
                    dtype=object,
                )
            )
        )
    stream, _ = walk(samples)
    assert sum(stream.troubles.values()) > 1000


def test_troubles_are_told_ever_more_rarely() -> None:
    stream = PhoneStream()
    told_counts = [
        event.count
        for i in range(2000)
        for event in stream.push(Accelerometer(i * 0.02, math.nan, 0.0, 9.81))
        if isinstance(event, Trouble)
    ]
    assert told_counts == [1, 10, 100, 1000]


@pytest.mark.parametrize("pressure", [0.0, -0.0, 1e-300, 1e300])
def test_a_pressure_that_cannot_be_is_dropped(pressure: float) -> None:
    samples: list[Sample] = [Barometer(i * 0.2, 1000.0 if i != 20 else pressure) for i in range(60)]
    _, events = walk(samples)
    assert told(events, Sensor.BAROMETER, TroubleKind.IMPLAUSIBLE)
    heights = [event.height for event in events if isinstance(event, Height)]
    assert len(heights) >= 10
    assert heights == pytest.approx([0.0] * len(heights))


@pytest.mark.parametrize("jump", [-1e6, 1e6])
def test_heights_go_on_when_the_clock_is_set_anew(jump: float) -> None:
    samples: list[Sample] = [Barometer(i * 0.2 + jump * (i > 50), 1000.0) for i in range(150)]
    _, events = walk(samples)
    after = [event for event in events if isinstance(event, Height) and abs(event.t - jump) < 40.0]
    assert len(after) >= 17
    assert all(0.0 < event.variance < 1.0 for event in after)


@pytest.mark.parametrize("reading", [0.0, 3e5])
def test_a_stretch_of_impossible_readings_is_a_gap(reading: float) -> None:
    """It is not interpolated, however long it lasts."""
    samples: list[Sample] = [
        Accelerometer(i * 0.02, 0.0, 0.0, 9.81 if i < 200 or i > 3200 else reading) for i in range(3500)
    ]
    stream = PhoneStream()
    for sample in samples:
        events = stream.push(sample)
        assert sum(not isinstance(event, Trouble) for event in events) < 5
    assert stream.troubles[Sensor.ACCELEROMETER, TroubleKind.GAP] == 1
    assert np.trace(stream.position_covariance) > 1000.0


def test_a_phone_that_slept_may_be_elsewhere() -> None:
    samples = [replace(s, t=s.t + 10.0 * (s.t > 9.0)) for s in WALKER.samples()]
    stream, _ = walk(samples)
    assert np.trace(stream.position_covariance) > 2.0 * 10.0**2


def test_a_gyroscope_alone_is_not_hoarded() -> None:
    stream = PhoneStream()
    stream.push(Accelerometer(0.0, 0.0, 0.0, 9.81))
    sizes = []
    for i in range(1, 6001):
        stream.push(Gyroscope(i * 0.02, 0.0, 0.0, 0.1))
        if i % 3000 == 0:
            sizes.append(len(pickle.dumps(stream)))
    assert sizes[1] < 1.1 * sizes[0]


def test_a_gyroscope_that_comes_in_bursts_is_told_of() -> None:
    """All of a second's forces, then its angular velocities: too late to be used, and not in silence."""
    bursts = sorted(WALKER.samples(), key=lambda s: (int(s.t), type(s).__name__))
    _, events = walk(bursts)
    assert told(events, Sensor.GYROSCOPE, TroubleKind.GAP)
    late = [s for s in WALKER.samples() if s.t > 1.0 or not isinstance(s, Gyroscope)]
    stream, _ = walk(late)
    assert not stream.troubles


@pytest.mark.parametrize(
    ("t", "position", "covariance"),
    [
        (math.nan, (0.0, 0.0), np.eye(2)),
        (1.0, (math.nan, 0.0), np.eye(2)),
        (1.0, (0.0, 0.0), np.full((2, 2), math.inf)),
        (1.0, (0.0, 0.0), np.zeros((2, 2))),
    ],
)
def test_a_fix_without_sense_is_refused(
    t: float, position: tuple[float, float], covariance: np.ndarray
) -> None:
    stream = PhoneStream()
    with pytest.raises(ValueError, match="a fix needs"):
        stream.fix(t, position, covariance)
    assert stream.position == (0.0, 0.0)
