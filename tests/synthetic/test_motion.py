"""Motion in continuous time: derivatives, steps, stairs, and what a script makes a walker do."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from client_sim.synthetic.cameras import level_rotation
from client_sim.synthetic.gait import Foot, Gait
from client_sim.synthetic.motion import Motion, level_rotations
from client_sim.synthetic.paths import arc_of, path_turns, smooth_path
from client_sim.synthetic.scripts import (
    Aim,
    Go,
    LookAround,
    Shake,
    Stand,
    leave_route,
    perform,
    turn_back,
)

L_SHAPE = ((0.0, 0.0), (8.0, 0.0), (8.0, 6.0))
RISE, RUN = 3.06, 5.04
TWO_FLIGHTS = (
    (0.0, 0.0, 0.0),
    (3.0, 0.0, 0.0),
    (3.0 + RUN / 2, 0.0, RISE / 2),
    (4.2 + RUN / 2, 0.0, RISE / 2),
    (4.2 + RUN / 2, 1.3, RISE / 2),
    (3.0 + RUN / 2, 1.3, RISE / 2),
    (3.0, 1.3, RISE),
    (0.0, 1.3, RISE),
)
"""Eighteen risers of 17 cm on treads of 28 cm, with a landing on which one turns back."""


def _walk(script: object = None, seed: int = 3, **options: object) -> Motion:
    return perform(script or [Go(L_SHAPE)], np.random.default_rng(seed), **options)  # type: ignore[arg-type]


def test_many_rotations_are_those_of_one_at_a_time() -> None:
    angles = np.random.default_rng(1).uniform(-1.4, 1.4, size=(20, 3))
    np.testing.assert_allclose(level_rotations(angles), [level_rotation(*row) for row in angles], atol=1e-14)


def test_velocity_acceleration_and_turning_are_derivatives_of_the_poses() -> None:
    motion = _walk(held=[Aim(2.0, 5.0, left=0.8, up=0.3, clockwise=1.5)])
    times = np.linspace(0.5, motion.duration - 0.5, 200)
    h = 1e-4
    before, at, after = (motion.positions(times + d) for d in (-h, 0.0, h))
    np.testing.assert_allclose(motion.velocities(times), (after - before) / (2 * h), atol=1e-4)
    np.testing.assert_allclose(motion.accelerations(times), (after - 2 * at + before) / h**2, atol=2e-2)
    turned = np.swapaxes(motion.rotations(times - h), 1, 2) @ motion.rotations(times + h) / (4 * h)
    skew = turned - np.swapaxes(turned, 1, 2)
    rates = np.stack([skew[:, 2, 1], skew[:, 0, 2], skew[:, 1, 0]], axis=1)
    np.testing.assert_allclose(motion.angular_velocities(times), rates, atol=1e-5)


def test_poses_do_not_depend_on_the_rate_at_which_they_are_taken() -> None:
    motion = _walk()
    pose = motion.pose(3.21)
    np.testing.assert_array_equal(pose.position, motion.positions(np.array([1.0, 3.21]))[1])
    np.testing.assert_array_equal(pose.rotation, motion.rotations(np.array([1.0, 3.21]))[1])


def test_a_foot_is_put_down_where_the_body_is_lowest() -> None:
    gait = Gait(shake=0.0)
    motion = _walk(gait=gait)
    assert len(motion.steps) == pytest.approx(motion.length / gait.speed * gait.step_rate, rel=0.15)
    assert all(a.foot is not b.foot for a, b in zip(motion.steps, motion.steps[1:], strict=False))
    assert {step.foot for step in motion.steps} == set(Foot)
    lengths = [step.length for step in motion.steps[1:]]
    assert np.median(lengths) == pytest.approx(gait.speed / gait.step_rate, rel=0.1)
    assert min(lengths) > 0.3
    for step in motion.steps[2:-2]:
        around = step.time + np.linspace(-0.2, 0.2, 81)
        lowest = around[motion.positions(around)[:, 2].argmin()]
        assert lowest == pytest.approx(step.time, abs=0.03)


def test_stairs_are_climbed_a_tread_a_step_more_slowly() -> None:
    gait = Gait(shake=0.0)
    motion = _walk([Go(TWO_FLIGHTS)], gait=gait)
    assert motion.ground[-1, 2] == pytest.approx(RISE, abs=0.01)
    ground = motion.grounds(np.array([step.time for step in motion.steps]))
    rises = np.diff(ground[:, 2])
    climbed = rises[rises > 0.12]
    assert len(climbed) == pytest.approx(18, abs=3)
    assert np.median(climbed) == pytest.approx(gait.riser, abs=0.01)
    above = motion.position[:, 2] - motion.ground[:, 2] - gait.height
    assert np.abs(above).max() < 0.06
    pace = np.linalg.norm(motion.velocities(motion.times)[:, :2], axis=1)
    slope = np.gradient(motion.ground[:, 2], arc_of(motion.ground) + 1e-9 * np.arange(len(motion.ground)))
    assert np.median(pace[slope > 0.4]) == pytest.approx(gait.stair_rate * 0.28, rel=0.15)
    # The rise comes in steps: the climbing speed swings between nothing and about twice its mean.
    upwards = motion.velocities(motion.times)[slope > 0.5, 2]
    assert upwards.min() < 0.3 * upwards.mean()
    assert upwards.max() > 1.5 * upwards.mean()


@pytest.mark.parametrize("turn_rate", [0.8, 1.3])
def test_nobody_turns_faster_than_they_do(turn_rate: float) -> None:
    motion = _walk([Go(TWO_FLIGHTS)], gait=Gait(shake=0.0, turn_rate=turn_rate))
    rate = np.abs(np.gradient(motion.angles[:, 0], motion.times))
    assert 0.7 * turn_rate < rate.max() < 1.25 * turn_rate


def test_a_path_stays_between_two_flights() -> None:
    path = smooth_path(TWO_FLIGHTS, 0.7)
    on_stairs = (path[:, 2] > 0.1) & (path[:, 2] < RISE - 0.1) & (path[:, 0] < 3.0 + RUN / 2)
    aside = np.minimum(np.abs(path[on_stairs, 1]), np.abs(path[on_stairs, 1] - 1.3))
    assert aside.max() < 0.3
    assert path[:, 0].max() > 3.0 + RUN / 2 + 1.15, "the landing is walked to its end"


def test_standing_still_is_still_but_for_the_hand() -> None:
    gait = Gait()
    motion = _walk([Go(L_SHAPE[:2]), Stand(3.0), Go(L_SHAPE[1:])], gait=gait)
    speed = np.linalg.norm(motion.velocities(motion.times), axis=1)
    assert (speed < 0.02).sum() * 0.01 > 2.5
    standing = motion.times[speed < 0.02]
    assert not any(standing[0] + 0.1 < step.time < standing[-1] - 0.1 for step in motion.steps)
    # Neither setting off nor stopping jerks.
    assert np.abs(np.gradient(arc_of(motion.ground), 0.01, edge_order=2)).max() < 1.2 * gait.speed
    level = np.linalg.norm(np.gradient(np.gradient(motion.ground, 0.01, axis=0), 0.01, axis=0), axis=1)
    assert level.max() < 3.0


def test_looking_around_turns_the_camera_and_not_the_way() -> None:
    motion = _walk([Go(L_SHAPE[:2]), LookAround((1.0, -0.8)), Go(((8.0, 0.0), (12.0, 0.0)))])
    heading = motion.angles[:, 0]
    assert heading.max() == pytest.approx(1.0, abs=0.12)
    assert heading.min() == pytest.approx(-0.8, abs=0.12)
    assert heading[-1] == pytest.approx(0.0, abs=0.05)
    assert motion.length == pytest.approx(12.0, abs=0.2)


def _apart(points: NDArray[np.float64], others: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(np.linalg.norm(points[:, None] - others[None], axis=2).min(axis=1))


def test_leaving_the_route_and_coming_back() -> None:
    motion = _walk(leave_route(L_SHAPE, 4.0, ((4.0, 3.0), (2.0, 3.0))))
    route = smooth_path(L_SHAPE, 0.7)
    away = _apart(motion.ground[::10, :2], route)
    assert away.max() == pytest.approx(3.0, abs=0.2)
    assert away[0] < 0.05
    assert away[-1] < 0.05
    np.testing.assert_allclose(motion.ground[-1, :2], L_SHAPE[-1], atol=0.1)
    assert motion.length == pytest.approx(14.0 + 2 * 5.0, abs=2.0), "corners are cut"


def test_turning_back_goes_the_other_way_for_a_while() -> None:
    motion = _walk(turn_back(L_SHAPE, 6.0, 3.0))
    x = motion.ground[:, 0]
    furthest = int(x[: len(x) // 2].argmax())
    assert x[furthest] == pytest.approx(6.0, abs=0.1)
    assert x[furthest:].min() == pytest.approx(3.0, abs=0.1)
    assert motion.length == pytest.approx(14.0 + 6.0, abs=0.8)
    turned = np.degrees(np.ptp(motion.angles[:, 0]))
    assert turned > 170


def test_the_phone_is_rolled_to_landscape_and_stays() -> None:
    motion = _walk(held=[Aim(3.0, clockwise=np.pi / 2)])
    right = motion.rotations(np.array([1.0, motion.duration - 1.0]))[:, :, 0]
    assert abs(right[0, 2]) < 0.1
    assert right[1, 2] == pytest.approx(-1.0, abs=0.01), "clockwise: the picture's right is down"


def test_a_shaken_stretch_turns_fast_and_nothing_else_does() -> None:
    motion = _walk(held=[Shake(3.0, 4.0)])
    rate = np.linalg.norm(motion.angular_velocities(motion.times), axis=1)
    shaken = (motion.times > 3.2) & (motion.times < 3.8)
    assert np.median(rate[shaken]) > 1.5
    assert rate[motion.times < 3.0].max() < 0.8


def test_a_way_must_begin_where_the_last_one_ended() -> None:
    with pytest.raises(ValueError, match=r"5\.0 m from where"):
        _walk([Go(L_SHAPE[:2]), Go(((8.0, 5.0), (9.0, 5.0)))])
    with pytest.raises(ValueError, match="begins with a way"):
        _walk([Stand(1.0)])
    with pytest.raises(ValueError, match="cannot be left at 20"):
        leave_route(L_SHAPE, 20.0, ((0.0, 1.0),))


def test_turns_of_a_path_are_found_with_their_sides() -> None:
    waypoints = ((0.0, 0.0), (8.0, 0.0), (8.0, 6.0), (14.0, 6.0), (20.0, 6.5))
    turns = path_turns(smooth_path(waypoints, 0.7))
    assert [round(np.degrees(turn.angle) / 10) * 10 for turn in turns] == [90, -90]
    assert turns[0].at == pytest.approx(7.6, abs=0.4)
    assert turns[1].at == pytest.approx(13.0, abs=0.6)
