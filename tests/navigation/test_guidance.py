"""Guidance on routes drawn with a ruler: progress, bearing, turns, arrival."""

from __future__ import annotations

import numpy as np
import pytest

from server.geometry.poses import SE3
from server.mapping.route_map import RouteMap, Scale, ScaleSource
from server.navigation.guidance import GuidanceOptions, Guide, Progress
from server.navigation.updates import Instruction
from tests.navigation.routes import at, route_along

LEFT_L = ((0.0, 0.0), (8.0, 0.0), (8.0, 6.0))
LOOP = ((0.0, 0.0), (8.0, 0.0), (8.0, 6.0), (0.0, 6.0), (0.0, 0.2))


def _pose(route: RouteMap, row: int, *, side: float = 0.0) -> SE3:
    """The leader's pose of a frame, so many units to its left."""
    world_from_camera = SE3.from_quaternion(route.path.quaternion[row], route.path.position[row])
    return SE3(world_from_camera.rotation, world_from_camera @ np.array([-side, 0.0, 0.0]))


def _follow(route: RouteMap, guide: Guide, *, side: float = 0.2) -> list[Progress]:
    progress: Progress | None = None
    made = []
    for row, time in enumerate(route.path.time):
        progress = guide.locate(_pose(route, row, side=side), float(time), progress)
        made.append(progress)
    return made


@pytest.mark.parametrize(
    "waypoints", [LEFT_L, LOOP, ((0.0, 0.0), (6.0, 0.0), (6.0, 5.0), (3.0, 5.0), (3.0, -4.0))]
)
def test_progress_is_the_leaders_own(waypoints: tuple[tuple[float, float], ...]) -> None:
    """An L, a loop that ends where it starts, a route that crosses itself."""
    route = route_along(waypoints)
    guide = Guide(route)
    lengths = np.array([p.length for p in _follow(route, guide)])
    assert np.abs(lengths - route.path.arc_length).max() < 0.4
    assert lengths[-1] > guide.length - 0.3


def test_the_start_of_a_loop_is_not_its_end() -> None:
    route = route_along(LOOP)
    guide = Guide(route)
    assert np.linalg.norm(route.path.position[0] - route.path.position[-1]) < 0.3
    made = _follow(route, guide)
    arrived = np.array([guide.arrived(p) for p in made])
    assert not arrived[: int(0.9 * len(made))].any()
    assert arrived[-1]
    first = guide.guide(_pose(route, 0), made[0])
    assert first.instruction is Instruction.STRAIGHT
    assert first.progress < 0.02


def test_a_first_fix_decides_between_start_and_end_by_heading() -> None:
    """Out and back along one corridor: only the direction of the view tells the two apart."""
    route = route_along(((0.0, 0.0), (10.0, 0.0), (10.0, 1.0), (0.0, 1.0)))
    guide = Guide(route)
    assert guide.locate(at(3.0, 0.5, 0.0), 0.0, None).length < 4.0
    assert guide.locate(at(3.0, 0.5, 180.0), 0.0, None).length > 16.0


def test_progress_jumps_only_when_fixes_agree_for_a_while() -> None:
    route = route_along(((0.0, 0.0), (30.0, 0.0)))
    guide = Guide(route)
    progress = guide.locate(at(2.0, 0.0, 0.0), 0.0, None)
    for k in range(1, 21):
        progress = guide.locate(at(20.0 + 0.1 * k, 0.0, 0.0), 0.1 * k, progress)
        assert progress.length == pytest.approx(2.0, abs=0.3)
        assert progress.doubted == pytest.approx(0.1)
    progress = guide.locate(at(22.2, 0.0, 0.0), 0.1 + guide.options.jump_seconds, progress)
    assert progress.length == pytest.approx(22.2, abs=0.3)
    assert progress.doubted is None


def test_one_stray_fix_does_not_count_towards_a_later_jump() -> None:
    route = route_along(((0.0, 0.0), (30.0, 0.0)))
    guide = Guide(route)
    progress = guide.locate(at(2.0, 0.0, 0.0), 0.0, None)
    progress = guide.locate(at(20.0, 0.0, 0.0), 0.1, progress)
    assert progress.doubted == pytest.approx(0.1)
    progress = guide.locate(at(2.3, 0.0, 0.0), 0.2, progress)
    assert progress.doubted is None
    assert progress.length == pytest.approx(2.3, abs=0.3)


@pytest.mark.parametrize("step", [0.3, 0.6, 0.9])
def test_who_begins_between_start_and_end_of_a_loop_is_at_its_beginning(step: float) -> None:
    """The loop ends 1.2 beyond its start, with the same heading: nearness would arrive at once."""
    route = route_along(((0.0, 0.0), (8.0, 0.0), (8.0, 6.0), (-4.0, 6.0), (-4.0, 0.0), (1.2, 0.0)))
    guide = Guide(route)
    progress = guide.locate(at(step, 0.2, 0.0), 0.0, None)
    assert progress.length == pytest.approx(step, abs=0.4)
    assert not guide.arrived(progress)
    for k in range(1, 40):
        progress = guide.locate(at(step + 0.1 * k, 0.2, 0.0), 0.1 * k, progress)
        assert not guide.arrived(progress)


def test_a_turn_is_told_at_its_limit_and_goes_on_until_it_is_done() -> None:
    route = route_along(((0.0, 0.0), (20.0, 0.0)))
    guide = Guide(route)

    def told(heading: float, before: Instruction) -> Instruction:
        return guide.guide(at(5.0, 0.0, heading), Progress(5.0, 0.0), before).instruction

    assert told(21.5, Instruction.STRAIGHT) is Instruction.RIGHT
    assert told(18.5, Instruction.STRAIGHT) is Instruction.STRAIGHT
    assert told(18.5, Instruction.RIGHT) is Instruction.RIGHT
    assert told(13.5, Instruction.RIGHT) is Instruction.STRAIGHT


def test_beside_the_destination_the_way_is_straight_on() -> None:
    route = route_along(((0.0, 0.0), (10.0, 0.0)))
    guide = Guide(route, GuidanceOptions(arrival=0.3))
    for x in (9.0, 9.3, 9.6):
        beside = guide.guide(at(x, 0.4, 0.0), Progress(x, 0.0))
        assert beside.instruction is Instruction.STRAIGHT


def test_far_progress_is_believed_at_once_after_a_long_walk_unseen() -> None:
    route = route_along(((0.0, 0.0), (30.0, 0.0)))
    guide = Guide(route)
    progress = guide.locate(at(2.0, 0.0, 0.0), 0.0, None)
    later = guide.locate(at(17.0, 0.0, 0.0), 12.0, progress)
    assert later.length == pytest.approx(17.0, abs=0.3)


def test_a_crossing_is_passed_straight_on() -> None:
    """At the crossing both branches are as near: progress stays on the one that is walked."""
    route = route_along(((0.0, 0.0), (8.0, 0.0), (8.0, 4.0), (4.0, 4.0), (4.0, -4.0)))
    guide = Guide(route)
    progress = guide.locate(at(1.0, 0.0, 0.0), 0.0, None)
    for step in range(1, 50):
        progress = guide.locate(at(1.0 + 0.1 * step, 0.0, 0.0), 0.1 * step, progress)
        assert progress.length == pytest.approx(1.0 + 0.1 * step, abs=0.3)


@pytest.mark.parametrize(
    ("heading", "instruction"),
    [
        (0.0, Instruction.STRAIGHT),
        (15.0, Instruction.STRAIGHT),
        (-15.0, Instruction.STRAIGHT),
        (60.0, Instruction.RIGHT),
        (-60.0, Instruction.LEFT),
        (110.0, Instruction.RIGHT),
        (150.0, Instruction.TURN_AROUND),
        (180.0, Instruction.TURN_AROUND),
        (-150.0, Instruction.TURN_AROUND),
    ],
)
def test_the_bearing_is_positive_to_the_left(heading: float, instruction: Instruction) -> None:
    """Looking to the left of the route, the route is on the right: a negative bearing."""
    route = route_along(((0.0, 0.0), (20.0, 0.0)))
    guide = Guide(route)
    guidance = guide.guide(at(5.0, 0.0, heading), Progress(5.0, 0.0))
    difference = (np.degrees(guidance.bearing) + heading + 180.0) % 360.0 - 180.0
    assert abs(difference) < 1.0
    assert guidance.instruction is instruction


def test_the_aim_is_the_mean_of_the_next_waypoints() -> None:
    route = route_along(((0.0, 0.0), (20.0, 0.0)))
    options = GuidanceOptions(waypoints=10, spacing=0.3)
    guide = Guide(route, options)
    # Their mean lies 0.3 * 5.5 = 1.65 ahead; from 1 unit to the right it is to the left.
    bearing = guide.guide(at(5.0, -1.0, 0.0), Progress(5.0, 0.0)).bearing
    assert bearing == pytest.approx(np.arctan2(1.0, 1.65), abs=0.01)


@pytest.mark.parametrize("pitch", [-90.0, -89.0, -60.0, 60.0, 89.0, 90.0])
def test_a_phone_held_level_points_with_its_upper_edge(pitch: float) -> None:
    route = route_along(((0.0, 0.0), (20.0, 0.0)))
    guidance = Guide(route).guide(at(5.0, 0.0, 40.0, pitch_deg=pitch), Progress(5.0, 0.0))
    assert np.degrees(guidance.bearing) == pytest.approx(-40.0, abs=1.0)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_next_turn_is_announced_with_its_side_and_time(sign: float) -> None:
    route = route_along(
        ((0.0, 0.0), (8.0, 0.0), (8.0, sign * 6.0)), scale=Scale(1.4, ScaleSource.MEASURED_LENGTH)
    )
    guide = Guide(route)
    before = guide.guide(at(2.0, 0.0, 0.0), Progress(2.0, 0.0)).next_turn
    assert before is not None
    assert np.degrees(before.angle) == pytest.approx(sign * 90.0, abs=15.0)
    assert before.distance_m is not None
    start = route.turns[0].start
    assert 6.8 < start < 8.0
    assert before.distance_m == pytest.approx(1.4 * (start - 2.0), abs=0.01)
    # The leader walked a unit a second.
    assert before.seconds == pytest.approx(start - 2.0, abs=0.15)
    inside = guide.guide(at(8.0, 0.1, 45.0), Progress(start + 0.1, 0.0)).next_turn
    assert inside is None
    assert guide.guide(at(8.0, sign * 4.0, sign * 90.0), Progress(11.5, 0.0)).next_turn is None


def test_turns_are_announced_in_order() -> None:
    route = route_along(((0.0, 0.0), (5.0, 0.0), (5.0, 5.0), (10.0, 5.0)))
    guide = Guide(route)
    signs = []
    for row in range(len(route.path)):
        turn = guide.guide(_pose(route, row), Progress(float(route.path.arc_length[row]), 0.0)).next_turn
        signs.append(0 if turn is None else int(np.sign(turn.angle)))
    changes = [s for k, s in enumerate(signs) if k == 0 or signs[k - 1] != s]
    assert changes == [1, -1, 0]


def test_arrival_is_by_route_left() -> None:
    route = route_along(LEFT_L)
    guide = Guide(route)
    for left, expected in ((1.05, False), (0.95, True), (0.0, True)):
        progress = Progress(guide.length - left, 0.0)
        assert guide.arrived(progress) is expected
        guidance = guide.guide(at(8.0, 6.0 - left, 90.0), progress)
        assert (guidance.instruction is Instruction.ARRIVED) is expected


def test_metres_are_told_only_where_they_are_known() -> None:
    pose, progress = at(2.0, 0.0, 0.0), Progress(2.0, 0.0)
    unknown = Guide(route_along(LEFT_L)).guide(pose, progress)
    assert unknown.walked_m is None
    assert unknown.remaining_m is None
    assert unknown.next_turn is not None
    assert unknown.next_turn.distance_m is None
    assert unknown.remaining_seconds > 5.0
    guide = Guide(route_along(LEFT_L, scale=Scale(0.7, ScaleSource.MEASURED_LENGTH)))
    known = guide.guide(pose, progress)
    assert known.walked_m == pytest.approx(1.4)
    assert known.remaining_m == pytest.approx(0.7 * (guide.length - 2.0))
    assert known.progress == pytest.approx(2.0 / guide.length)
    assert known.remaining_seconds == unknown.remaining_seconds


def test_times_are_the_leaders() -> None:
    route = route_along(LEFT_L)
    guide = Guide(route)
    guidance = guide.guide(at(2.0, 0.0, 0.0), Progress(2.0, 0.0))
    assert guidance.remaining_seconds == pytest.approx(float(route.path.time[-1]) - 2.0, abs=0.15)


def test_fixes_that_come_late_do_not_shrink_the_reach() -> None:
    """Frames may overtake one another: a fix older than the last one is located all the same."""
    route = route_along(((0.0, 0.0), (30.0, 0.0)))
    guide = Guide(route)
    progress = guide.locate(at(5.0, 0.0, 0.0), 10.0, None)
    older = guide.locate(at(4.5, 0.0, 0.0), 9.5, progress)
    assert older.length == pytest.approx(4.5, abs=0.2)
