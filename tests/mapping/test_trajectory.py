"""The leader's path: upright, in its unit, without bobbing, with its turns."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from client_sim.synthetic.cameras import level_rotation
from client_sim.synthetic.gait import Gait
from client_sim.synthetic.trajectories import walk
from server.geometry.poses import SE3, rotation_angle
from server.mapping.trajectory import find_turns, route_frame, smoothed, upright, walked


def _legs(
    *legs: tuple[float, float], radius: float = 0.8, spacing: float = 0.05
) -> tuple[np.ndarray, np.ndarray]:
    """A path of (length, turn in degrees, positive to the left) legs with round corners: positions, arc."""
    heading, point = 0.0, np.zeros(2)
    points = [point]
    for length, turn in legs:
        for _ in range(round(length / spacing)):
            point = point + spacing * np.array([np.cos(heading), np.sin(heading)])
            points.append(point)
        steps = round(abs(np.radians(turn)) * radius / spacing)
        for _ in range(steps):
            heading += np.radians(turn) / steps
            point = point + spacing * np.array([np.cos(heading), np.sin(heading)])
            points.append(point)
    positions = np.column_stack([np.array(points), np.zeros(len(points))])
    return positions, spacing * np.arange(len(points))


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_an_l_has_one_turn_of_its_angle_at_its_place(sign: float) -> None:
    positions, arc = _legs((6.0, sign * 90.0), (5.0, 0.0))
    (turn,) = find_turns(positions, arc)
    assert np.degrees(turn.angle) == pytest.approx(sign * 90.0, abs=12.0)
    begin, end = 6.0, 6.0 + 0.8 * np.pi / 2
    assert (turn.start + turn.end) / 2 == pytest.approx((begin + end) / 2, abs=0.15)
    assert turn.start == pytest.approx(begin, abs=0.5)
    assert turn.end == pytest.approx(end, abs=0.5)
    # Left is counter-clockwise seen from above.
    assert np.sign(positions[-1, 1]) == sign


def test_a_u_of_two_corners_has_two_turns_the_same_way() -> None:
    positions, arc = _legs((5.0, -90.0), (4.0, -90.0), (5.0, 0.0))
    turns = find_turns(positions, arc)
    assert [round(float(np.degrees(t.angle)) / 15) for t in turns] == [-6, -6]
    assert turns[0].end < turns[1].start


def test_a_tight_u_is_one_turn_of_a_half_circle() -> None:
    positions, arc = _legs((5.0, 180.0), (5.0, 0.0))
    (turn,) = find_turns(positions, arc)
    assert np.degrees(turn.angle) == pytest.approx(180.0, abs=20.0)


def test_an_s_has_turns_in_the_order_of_the_walk() -> None:
    positions, arc = _legs((4.0, 90.0), (3.0, -90.0), (4.0, 60.0), (4.0, 0.0))
    turns = find_turns(positions, arc)
    assert [np.sign(t.angle) for t in turns] == [1.0, -1.0, 1.0]
    assert all(a.end <= b.start for a, b in pairwise(turns))


def test_what_is_no_turn_is_none() -> None:
    assert find_turns(*_legs((10.0, 0.0))) == ()
    # A bend of 25 degrees, and a wide curve of 90 that nobody would call a turn.
    assert find_turns(*_legs((5.0, 25.0), (5.0, 0.0))) == ()
    assert find_turns(*_legs((5.0, 90.0), (5.0, 0.0), radius=8.0)) == ()
    assert find_turns(*_legs((1.0, 0.0))) == ()


def test_standing_still_adds_no_turn() -> None:
    """A leader who stops to talk: the same place again and again, arc length at rest."""
    positions, arc = _legs((6.0, 90.0), (5.0, 0.0))
    stop = np.repeat(80, 50)
    rows = np.concatenate([np.arange(80), stop, np.arange(80, len(arc))])
    assert find_turns(positions[rows], arc[rows]) == find_turns(positions, arc)


def _steps(seconds: float, *, bob: float = 0.03, speed: float = 1.2) -> tuple[np.ndarray, np.ndarray]:
    times = np.arange(0.0, seconds, 0.1)
    positions = np.column_stack(
        [speed * times, 0.02 * np.sin(np.pi * 1.9 * times), bob * np.sin(2 * np.pi * 1.9 * times)]
    )
    return positions, times


def test_the_bobbing_of_steps_is_no_length() -> None:
    positions, times = _steps(30.0)
    length = walked(positions, times)
    true = positions[-1, 0]
    assert np.linalg.norm(np.diff(positions, axis=0), axis=1).sum() > 1.02 * true
    assert length[-1] == pytest.approx(true, rel=0.003)
    assert (np.diff(length) >= 0).all()
    assert length[0] == 0.0


def test_smoothing_leaves_the_ends_where_they_are() -> None:
    """The path's length, and with it the scale of a measured route, would else be short at both ends."""
    times = np.arange(0.0, 8.0, 0.1)
    positions = np.column_stack([1.2 * times, np.zeros((len(times), 2))])
    np.testing.assert_allclose(smoothed(positions, times), positions, atol=1e-9)
    assert walked(positions, times)[-1] == pytest.approx(positions[-1, 0])
    for count in (1, 2, 3, 5, 8):
        assert walked(positions[:count], times[:count])[-1] == pytest.approx(0.12 * (count - 1))


def test_smoothing_depends_on_seconds_not_on_frames() -> None:
    positions, times = _steps(20.0)
    half = smoothed(positions[::2], times[::2])
    full = smoothed(positions, times)[::2]
    assert np.abs(half - full)[5:-5].max() < 0.02
    assert np.ptp(full[10:-10, 2]) < 0.1 * np.ptp(positions[:, 2])


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("waypoints", [((0.0, 0.0), (6.0, 0.0), (6.0, 6.0)), ((0.0, 0.0), (12.0, 0.0))])
def test_up_is_found_from_how_the_phone_was_held(
    seed: int, waypoints: tuple[tuple[float, float], ...]
) -> None:
    rng = np.random.default_rng(seed)
    poses = walk(waypoints, rng, Gait(pitch=-0.35)).poses
    rotations = np.stack([pose.rotation for pose in poses])
    world = Rotation.random(rng=rng).as_matrix()
    up = upright(world @ rotations)
    assert np.linalg.norm(up) == pytest.approx(1.0)
    error = np.degrees(np.arccos(np.clip(up @ world[:, 2], -1, 1)))
    # The phone looked 20 degrees down: a straight walk cannot tell that from a slope, one with a turn can.
    assert error < (3.0 if len(waypoints) > 2 else 22.0)


def _rolled(rotations: np.ndarray, quarters: np.ndarray) -> np.ndarray:
    """Cameras turned about their optical axes by (F,) quarters, in 0.7 s wherever that changes."""
    angles = np.pi / 2 * np.convolve(np.pad(quarters, 3, mode="edge"), np.ones(7) / 7, mode="valid")
    return rotations @ Rotation.from_rotvec(np.outer(angles, [0, 0, 1])).as_matrix()


def _up_error(rotations: np.ndarray, seed: int) -> float:
    """Degrees between the true up and the one found, in a world that lies anyhow."""
    world = Rotation.random(rng=np.random.default_rng(seed)).as_matrix()
    return float(np.degrees(np.arccos(np.clip(upright(world @ rotations) @ world[:, 2], -1, 1))))


def _shaken(rotations: np.ndarray, degrees: float, seed: int) -> np.ndarray:
    noise = np.radians(degrees) * np.random.default_rng(seed).normal(size=(len(rotations), 3))
    return rotations @ Rotation.from_rotvec(noise).as_matrix()


@pytest.mark.parametrize("quarter", [1, 2, -1])
@pytest.mark.parametrize("pitch", [-0.5, -0.1, 0.2])
@pytest.mark.parametrize("share", [0.2, 0.5, 0.8])
def test_up_is_found_where_the_phone_was_rolled_onto_its_side(
    quarter: int, pitch: float, share: float
) -> None:
    """From some place on, before the turn or after it."""
    rng = np.random.default_rng(5)
    poses = walk(((0.0, 0.0), (6.0, 0.0), (6.0, 6.0), (12.0, 6.0)), rng, Gait(pitch=pitch)).poses
    rotations = _shaken(np.stack([pose.rotation for pose in poses]), 3.0, 6)
    quarters = np.where(np.arange(len(rotations)) >= (1 - share) * len(rotations), quarter, 0)
    assert _up_error(_rolled(rotations, quarters), 7) < 5.0


def test_up_is_found_where_the_phone_was_rolled_to_and_fro() -> None:
    rng = np.random.default_rng(8)
    poses = walk(((0.0, 0.0), (6.0, 0.0), (6.0, 6.0), (12.0, 6.0)), rng, Gait(pitch=-0.2)).poses
    rotations = _shaken(np.stack([pose.rotation for pose in poses]), 3.0, 9)
    quarters = np.repeat([0, 1, 0, -1, 0, 1], len(rotations) // 6 + 1)[: len(rotations)]
    assert _up_error(_rolled(rotations, quarters), 10) < 5.0


@pytest.mark.parametrize("quarter", [1, -1])
def test_a_phone_rolled_on_a_straight_way_was_upright_at_first(quarter: int) -> None:
    """Straight ahead, up and sideways look alike; who begins to film holds the phone upright."""
    rotations = _shaken(np.repeat(level_rotation(0.3, pitch=-0.1)[None], 200, axis=0), 3.0, 11)
    quarters = np.where(np.arange(200) >= 100, quarter, 0)
    assert _up_error(_rolled(rotations, quarters), 12) < 10.0


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("pitch", [-0.9, -0.4, 0.0, 0.3])
@pytest.mark.parametrize("shake", [1.0, 8.0])
@pytest.mark.parametrize("waypoints", [((0.0, 0.0), (6.0, 0.0), (6.0, 6.0)), ((0.0, 0.0), (12.0, 0.0))])
def test_a_phone_that_is_not_rolled_is_judged_by_its_x_axis_alone(
    seed: int, pitch: float, shake: float, waypoints: tuple[tuple[float, float], ...]
) -> None:
    poses = walk(waypoints, np.random.default_rng(seed), Gait(pitch=pitch)).poses
    rotations = _shaken(np.stack([pose.rotation for pose in poses]), shake, seed)
    rotations = Rotation.random(rng=np.random.default_rng(seed)).as_matrix() @ rotations
    right, up = rotations[:, :, 0], -rotations[:, :, 1]
    mean_up = up.mean(axis=0) / np.linalg.norm(up.mean(axis=0))
    level = np.einsum("fi,fj->ij", right, right) / len(right)
    vector = np.linalg.eigh(level + 0.05 * (np.eye(3) - np.outer(mean_up, mean_up)))[1][:, 0]
    np.testing.assert_array_equal(upright(rotations), vector * np.sign(vector @ mean_up))


def test_up_of_a_phone_turned_about_itself_is_its_axis() -> None:
    rotations = np.stack(
        [level_rotation(a, pitch=0.5) for a in np.linspace(0, 2 * np.pi, 36, endpoint=False)]
    )
    np.testing.assert_allclose(upright(rotations), [0, 0, 1], atol=1e-6)


def test_the_route_frame_is_upright_with_the_leaders_mean_second_as_its_unit() -> None:
    rng = np.random.default_rng(3)
    trajectory = walk(((0.0, 0.0), (6.0, 0.0), (6.0, 6.0)), rng, Gait(speed=1.3))
    world = SE3(Rotation.random(rng=rng).as_matrix(), np.array([5.0, -7.0, 2.0]))
    scale = 0.037
    poses = [SE3(world.rotation @ p.rotation, scale * (world @ p.position)) for p in trajectory.poses]
    times = np.asarray(trajectory.times)
    frame = route_frame(poses, times)
    moved = [frame.transform_pose(p) for p in poses]
    positions = np.stack([p.translation for p in moved])
    np.testing.assert_allclose(positions[0], 0.0, atol=1e-9)
    assert walked(positions, times)[-1] == pytest.approx(times[-1] - times[0], rel=1e-9)
    assert frame.scale * scale * trajectory.length == pytest.approx(times[-1], rel=0.03)
    assert rotation_angle(frame.rotation.T @ frame.rotation) < 1e-9
    assert np.linalg.det(frame.rotation) == pytest.approx(1.0)
    # First heading along x, then to the left along y; heights hardly change.
    forward = moved[0].rotation[:, 2]
    assert abs(forward[1]) < 1e-9
    assert forward[0] > 0.9
    assert positions[-1, 1] > 3.0
    assert np.ptp(positions[:, 2]) < 0.3


def test_a_route_frame_of_somebody_who_stood_still_is_finite() -> None:
    poses = [SE3(level_rotation(0.0), np.zeros(3))] * 20
    frame = route_frame(poses, 0.1 * np.arange(20))
    assert frame.scale == 1.0
    np.testing.assert_allclose(frame.rotation @ level_rotation(0.0)[:, 2], [1, 0, 0], atol=1e-9)


def test_a_phone_that_looks_at_the_floor_first_still_gives_a_frame() -> None:
    poses = [SE3(level_rotation(a, pitch=-np.pi / 2), np.zeros(3)) for a in (0.0, 0.0, 0.5)]
    rotation = route_frame(poses, 0.1 * np.arange(3)).rotation
    assert np.isfinite(rotation).all()
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-9)
