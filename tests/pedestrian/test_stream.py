"""The whole stream on walkers whose truth is known."""

from __future__ import annotations

import pickle
from dataclasses import replace

import numpy as np
import pytest

from server.pedestrian.events import Event, Height, Step
from server.pedestrian.samples import Accelerometer, Barometer, Sample
from server.pedestrian.stream import PhoneStream
from tests.pedestrian.walkers import Walker


def walk(samples: list[Sample], stream: PhoneStream | None = None) -> tuple[PhoneStream, list[Event]]:
    stream = stream or PhoneStream()
    return stream, [event for sample in samples for event in stream.push(sample)]


def tilted(degrees: float) -> np.ndarray:
    """phone_from_level of a phone whose top edge is lifted."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.array([[1.0, 0.0, 0.0], [0.0, c, s], [0.0, -s, c]])


def test_a_walk_is_followed_from_its_start() -> None:
    walker = Walker()
    stream, events = walk(walker.samples())
    assert sum(isinstance(e, Step) for e in events) == walker.steps
    assert stream.position == pytest.approx((15.0, 20.0), abs=1.0)


@pytest.mark.parametrize("tilt", [0.0, 30.0, 60.0, 90.0])
def test_the_direction_is_that_of_the_phone_flat_or_upright(tilt: float) -> None:
    walker = Walker(phone_from_level=tilted(tilt))
    stream, _ = walk(walker.samples())
    assert stream.position == pytest.approx((15.0, 20.0), abs=1.0)


@pytest.mark.parametrize("rate", [25.0, 50.0, 100.0, 200.0])
def test_any_rate_gives_the_same_walk(rate: float) -> None:
    walker = Walker(rate=rate)
    stream, events = walk(walker.samples())
    assert sum(isinstance(e, Step) for e in events) == walker.steps
    assert stream.position == pytest.approx((15.0, 20.0), abs=1.0)


def test_the_state_at_a_moment_knows_nothing_of_what_comes_after() -> None:
    samples = Walker(noise=1.0).samples()
    other = Walker(noise=1.0, corners=((0.0, 0.0), (0.0, 20.0), (-15.0, 20.0)), seed=1).samples()
    half = len(samples) // 2
    whole, stream = PhoneStream(), PhoneStream()
    before = [event for s in samples[:half] for event in whole.push(s)]
    position, covariance = whole.position, whole.position_covariance
    walk(other[half:], whole)
    again = [event for s in samples[:half] for event in stream.push(s)]
    assert again == before
    assert stream.position == position
    assert np.array_equal(stream.position_covariance, covariance)


def test_a_biased_gyroscope_does_not_bend_the_path() -> None:
    """The bias is seen while standing and, across the vertical, while walking."""
    walker = replace(Walker(), rest=3.0, gyroscope_bias=(0.01, -0.01, 0.02))
    stream, _ = walk(walker.samples())
    assert stream.position == pytest.approx((15.0, 20.0), abs=1.2)


def test_headings_and_lengths_are_within_their_variances() -> None:
    walker = Walker(noise=1.0)
    _, events = walk(walker.samples())
    steps = [e for e in events if isinstance(e, Step)]
    first = [e for e in steps if e.heading is not None][:20]
    assert all(abs(e.heading - np.pi / 2) < 3.0 * np.sqrt(e.heading_variance) for e in first if e.heading)
    lengths = np.array([e.length for e in steps[2:-1]])
    assert lengths.mean() == pytest.approx(walker.speed * walker.interval, rel=0.1)
    assert all(e.length_variance > 0.0 and e.scale_variance > 0.0 for e in steps)


def test_a_stream_goes_on_from_its_snapshot() -> None:
    samples = Walker(noise=1.0).samples()
    half = len(samples) // 2
    stream, _ = walk(samples[:half])
    snapshot = pickle.dumps(stream)
    assert len(snapshot) < 100_000
    resumed = pickle.loads(snapshot)  # noqa: S301
    _, events = walk(samples[half:], stream)
    _, again = walk(samples[half:], resumed)
    assert again == events
    assert resumed.position == stream.position


def test_the_state_does_not_grow() -> None:
    samples = Walker(noise=1.0, corners=((0.0, 0.0), (0.0, 60.0), (40.0, 60.0), (40.0, 0.0))).samples()
    sizes = []
    stream = PhoneStream()
    for i, sample in enumerate(samples):
        stream.push(sample)
        if i % (len(samples) // 4) == len(samples) // 4 - 1:
            sizes.append(len(pickle.dumps(stream)))
    assert max(sizes) < 1.1 * sizes[0]


def test_heights_follow_the_pressure() -> None:
    """A floor of four metres is climbed in fourteen seconds."""
    stream, random = PhoneStream(), np.random.default_rng(0)
    heights = []
    for i in range(900):
        t = i / 25.0
        height = 4.0 * float(np.clip((t - 10.0) / 14.0, 0.0, 1.0))
        pressure = 1013.25 * np.exp(-height / 8434.0) + random.normal(0.0, 0.02)
        heights += [e for e in stream.push(Barometer(t, float(pressure))) if isinstance(e, Height)]
    assert abs(heights[-1].height - 4.0) < 3.0 * np.sqrt(heights[-1].variance)
    assert abs(heights[8].height) < 3.0 * np.sqrt(heights[8].variance)
    assert np.sqrt(heights[-1].variance) < 1.0


def test_the_doubt_of_a_height_grows_with_the_weather() -> None:
    stream = PhoneStream()
    heights = [
        e for i in range(3000) for e in stream.push(Barometer(i / 5.0, 1000.0)) if isinstance(e, Height)
    ]
    assert heights[-1].variance > heights[5].variance + 0.5 * 0.01**2 * 600.0


def test_turning_tells_the_magnetometers_bias() -> None:
    """What turns with the phone is the phone's, what stays is the earth's."""
    square = ((0.0, 0.0), (0.0, 12.0), (12.0, 12.0), (12.0, 0.0), (0.0, 0.0), (0.0, 12.0), (12.0, 12.0))
    stream, _ = walk(Walker(corners=square, field_bias=(7.0, -4.0, 0.0)).samples())
    bias = stream.dead_reckoning.state[6:8]
    spread = np.sqrt(np.diag(stream.dead_reckoning.covariance)[6:8])
    assert np.abs(bias - (7.0, -4.0)).max() < 2.5
    assert (spread < 4.0).all()


def test_metric_fixes_teach_the_user() -> None:
    """A walker whose legs are shorter than the model's is learnt from fixes, and known on the next walk."""
    short = Walker(gain=0.80, corners=((0.0, 0.0), (0.0, 40.0)))
    times, positions, _, _ = short.path()
    stream, fixes = PhoneStream(), iter(range(5, 30, 5))
    due = next(fixes)
    for sample in short.samples():
        stream.push(sample)
        if sample.t > due:
            at = positions[int(np.searchsorted(times, due))]
            stream.fix(due, (float(at[0]), float(at[1])), 0.05 * np.eye(2))
            due = next(fixes, 10**9)
    plain, _ = walk(short.samples())
    taught, _ = walk(short.samples(), PhoneStream(profile=stream.profile))
    assert abs(taught.position[1] - 40.0) < 0.4 * abs(plain.position[1] - 40.0)


def test_a_phone_without_a_gyroscope_still_counts() -> None:
    walker = Walker(noise=1.0)
    _, events = walk([s for s in walker.samples() if isinstance(s, Accelerometer)])
    steps = [e for e in events if isinstance(e, Step)]
    assert len(steps) == walker.steps
    assert all(step.heading is None for step in steps)
