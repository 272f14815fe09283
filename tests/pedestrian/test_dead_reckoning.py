"""The filter against what geometry and statistics say."""

from __future__ import annotations

import math

import numpy as np
import pytest

from server.pedestrian.dead_reckoning import DeadReckoning, DeadReckoningOptions
from server.pedestrian.stride import UserProfile

LEVEL = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])


def walked(reckoning: DeadReckoning, steps: int, heading: float = 0.0, start: float = 0.0) -> None:
    for i in range(steps):
        reckoning.step(start + 0.5 * (i + 1), heading, 0.7, 0.01)


def test_the_compass_turns_the_whole_path() -> None:
    """North is seen to the left of the level frame's y axis: the frame is turned to the right."""
    reckoning = DeadReckoning(DeadReckoningOptions())
    turned = math.radians(-30.0)
    field = (30.0 * math.sin(turned), 30.0 * math.cos(turned))
    for i in range(40):
        reckoning.compass(field, LEVEL, 0.7)
        reckoning.step(0.5 * i, 0.0, 0.7, 0.0)
    assert reckoning.position == pytest.approx((28.0 * math.cos(turned), 28.0 * math.sin(turned)), abs=0.3)


def test_a_late_compass_moves_a_position_that_was_reached_with_the_wrong_heading() -> None:
    reckoning = DeadReckoning(DeadReckoningOptions(correlation=1.0))
    reckoning.compass((0.0, 30.0), LEVEL, 0.7)
    walked(reckoning, 20)
    before = reckoning.position
    for _ in range(200):
        reckoning.compass((30.0 * math.sin(0.2), 30.0 * math.cos(0.2)), LEVEL, 5.0)
    after = reckoning.position
    assert math.atan2(after[1], after[0]) - math.atan2(before[1], before[0]) == pytest.approx(0.2, abs=0.06)


def test_fixes_teach_the_scale_and_narrow_it() -> None:
    reckoning = DeadReckoning(DeadReckoningOptions())
    reckoning.compass((0.0, 30.0), LEVEL, 0.7)
    before = reckoning.profile
    for leg in range(10):
        walked(reckoning, 10, start=5.0 * leg)
        # The user's steps are longer than the model's by a tenth.
        reckoning.fix(5.0 * (leg + 1), (7.7 * (leg + 1), 0.0), 0.01 * np.eye(2))
    assert reckoning.profile.scale == pytest.approx(1.1, abs=0.03)
    assert reckoning.profile.variance < before.variance / 10.0
    next_walk = DeadReckoning(DeadReckoningOptions(), profile=reckoning.profile)
    next_walk.compass((0.0, 30.0), LEVEL, 0.7)
    walked(next_walk, 10)
    assert next_walk.position[0] == pytest.approx(7.7, abs=0.3)


def test_without_a_compass_the_second_fix_tells_the_heading() -> None:
    reckoning = DeadReckoning(DeadReckoningOptions())
    walked(reckoning, 20)
    assert not reckoning.heading_known
    reckoning.fix(10.0, (0.0, 14.0), 0.1 * np.eye(2))
    assert reckoning.heading_known
    assert reckoning.heading(0.0) == pytest.approx(math.pi / 2, abs=0.05)
    walked(reckoning, 10, start=10.0)
    assert reckoning.position == pytest.approx((0.0, 21.0), abs=0.5)


def test_a_fix_of_the_past_counts_what_was_walked_since() -> None:
    reckoning = DeadReckoning(DeadReckoningOptions())
    reckoning.compass((0.0, 30.0), LEVEL, 0.7)
    walked(reckoning, 20)
    reckoning.fix(5.0, reckoning.position_at(5.0), 0.01 * np.eye(2))
    assert reckoning.position == pytest.approx((14.0, 0.0), abs=1e-6)


def test_the_covariance_is_that_of_many_walks() -> None:
    """Walks with errors drawn as the options say miss by as much as the covariance says."""
    options = DeadReckoningOptions(
        step_heading=0.1, mount=0.1, gyroscope_walk=0.001, disturbance=1e-3, magnetometer_bias=1e-3
    )
    random = np.random.default_rng(0)
    ends = []
    for _ in range(400):
        heading, scale, place = (
            random.normal(0.0, options.mount),
            math.exp(random.normal(0.0, 0.14)),
            np.zeros(2),
        )
        for _ in range(40):
            angle = heading + random.normal(0.0, options.step_heading)
            place += scale * (0.7 + random.normal(0.0, 0.1)) * np.array([math.cos(angle), math.sin(angle)])
        ends.append(place)
    reckoning = DeadReckoning(options, profile=UserProfile(0.0, 0.14**2))
    reckoning.compass((0.0, 30.0), LEVEL, 100.0)
    walked(reckoning, 40)
    drawn = np.cov(np.array(ends).T)
    told = reckoning.position_covariance
    assert np.sqrt(np.diag(told)) == pytest.approx(np.sqrt(np.diag(drawn)), rel=0.2)


def test_the_covariance_stays_symmetric_and_positive() -> None:
    reckoning, random = DeadReckoning(DeadReckoningOptions()), np.random.default_rng(1)
    for i in range(2000):
        reckoning.compass(tuple(random.normal(0.0, 30.0, 2)), random.normal(size=(2, 3)), 0.7)
        reckoning.step(0.5 * i, float(random.uniform(-3.0, 3.0)), 0.7, 0.02)
        if i % 50 == 0:
            reckoning.fix(0.5 * i, tuple(random.normal(0.0, 5.0, 2)), np.eye(2))
    covariance = reckoning.covariance
    assert np.allclose(covariance, covariance.T, rtol=1e-6, atol=1e-9)
    assert np.linalg.eigvalsh(covariance).min() > 0.0
