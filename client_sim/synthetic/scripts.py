"""What a walker does, one thing after another, and the motion that comes of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import inf

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import gaussian_filter1d, maximum_filter1d

from client_sim.synthetic.gait import Gait, find_steps, swing
from client_sim.synthetic.motion import Motion
from client_sim.synthetic.paths import (
    SPACING_M,
    arc_of,
    directions,
    smooth_path,
    smoothed,
    split,
    wandered,
)

Array = NDArray[np.float64]

TICK_S = 0.01
"""Spacing of a motion's samples."""

EASE_S = 0.1
"""Deviation of the average that takes the corners off starts and stops."""

EYES_S = 0.2
"""The same for the heading: a hand follows a body's turn with some delay."""

GLANCE_S = 0.5
"""How long a walker who looks around looks at a place."""

UNTURNED = np.radians(15.0)
"""Changes of direction below this are walked, larger ones between two ways are made on the spot."""


@dataclass(frozen=True, eq=False, slots=True)
class Go:
    """Walk along points of the floor, (N, 2), or (N, 3) where there are stairs, metres.

    A way that sets off in another direction than the walker faces begins with a turn on the spot.
    """

    points: ArrayLike


@dataclass(frozen=True, slots=True)
class Stand:
    """Stand still."""

    seconds: float


@dataclass(frozen=True, slots=True)
class LookAround:
    """Stand, and turn the camera to each of the angles (radians from ahead, positive left) and back."""

    angles: tuple[float, ...] = (1.0, -1.0)


Action = Go | Stand | LookAround


@dataclass(frozen=True, slots=True)
class Aim:
    """The camera is held another way for a while, whatever the walker does.

    Attributes:
        begin, end: seconds; without an end it stays so.
        left, up, clockwise: radians by which it is turned, tilted and rolled.
        ease: seconds that the change takes.
    """

    begin: float
    end: float = inf
    left: float = 0.0
    up: float = 0.0
    clockwise: float = 0.0
    ease: float = 0.7


@dataclass(frozen=True, slots=True)
class Shake:
    """The camera is shaken for a while: its pictures blur."""

    begin: float
    end: float
    amplitude: float = 0.05
    rate: float = 6.5


@dataclass(frozen=True, eq=False, slots=True)
class _Stretch:
    """Part of a motion at every tick: floor points (N, 3), direction (N,), pace (N,), slope (N,)."""

    ground: Array
    heading: Array
    pace: Array
    slope: Array

    @staticmethod
    def still(place: Array, heading: Array) -> _Stretch:
        zero = np.zeros(len(heading))
        return _Stretch(np.repeat(place[None], len(heading), axis=0), heading, zero, zero)


def perform(
    script: Sequence[Action],
    rng: np.random.Generator,
    gait: Gait | None = None,
    *,
    wander: float = 0.0,
    held: Sequence[Aim | Shake] = (),
) -> Motion:
    """Act out a script.

    Args:
        rng: draws the phase of the steps, the hand's motion and the wandering.
        wander: metres to the side that the walker strays at most from the smoothed ways.

    Raises:
        ValueError: the script does not begin with a way, or a way does not begin where the last ended.
    """
    gait = gait or Gait()
    stretches = _stretches(script, rng, gait, wander)
    ground = smoothed(np.vstack([s.ground for s in stretches]), EASE_S / TICK_S)
    heading = smoothed(np.concatenate([s.heading for s in stretches]), EYES_S / TICK_S)
    pace = smoothed(np.concatenate([s.pace for s in stretches]), EASE_S / TICK_S).clip(0.0)
    slope = smoothed(np.concatenate([s.slope for s in stretches]), EASE_S / TICK_S)
    times: Array = TICK_S * np.arange(len(ground), dtype=np.float64)
    cadence = gait.cadence(pace, slope)
    phase = rng.uniform(0.0, 2.0) + np.concatenate([[0.0], np.cumsum(TICK_S * cadence[:-1])])
    swung = swing(gait, phase, pace, slope)
    ahead = np.stack([np.cos(heading), np.sin(heading)], axis=1)
    position = ground.copy()
    position[:, :2] += ahead * swung.ahead[:, None]
    position[:, :2] += np.stack([-ahead[:, 1], ahead[:, 0]], axis=1) * swung.left[:, None]
    position[:, 2] += gait.height + swung.up
    angles = _held_angles(times, heading, phase, pace, gait, rng)
    for change in held:
        angles += _offsets(times, change)
    return Motion(times, position, angles, ground, find_steps(times, phase, arc_of(ground)))


def _stretches(
    script: Sequence[Action], rng: np.random.Generator, gait: Gait, wander: float
) -> list[_Stretch]:
    stretches: list[_Stretch] = []
    ways = _ways(script, rng, gait, wander)
    for number, action in enumerate(script):
        way = ways.get(number)
        if way is None:
            if not stretches:
                raise ValueError("a script begins with a way to go")
            place, heading = stretches[-1].ground[-1], float(stretches[-1].heading[-1])
            stretches.append(_Stretch.still(place, _looks(action, heading, gait)))
            continue
        from_rest = bool(stretches) and not isinstance(script[number - 1], Go)
        if stretches:
            place, heading = stretches[-1].ground[-1], float(stretches[-1].heading[-1])
            first = directions(way[:25])[0]
            turn = float((first - heading + np.pi) % (2.0 * np.pi) - np.pi)
            if abs(turn) > UNTURNED:
                stretches.append(_Stretch.still(place, _sweep(heading, heading + turn, gait)))
                from_rest = True
        to_rest = number + 1 < len(script) and _stops(script, ways, number)
        stretches.append(_walked(way, gait, from_rest, to_rest, stretches))
    return stretches


def _ways(script: Sequence[Action], rng: np.random.Generator, gait: Gait, wander: float) -> dict[int, Array]:
    """Smooth paths (N, 3) of the script's ways, by their number in it; each begins where the last ends."""
    ways: dict[int, Array] = {}
    end: Array | None = None
    for number, action in enumerate(script):
        if not isinstance(action, Go):
            continue
        points = np.asarray(action.points, dtype=np.float64)
        if points.shape[1] == 2:
            points = np.column_stack([points, np.zeros(len(points))])
        if end is not None:
            gap = float(np.linalg.norm(points[0] - end))
            if gap > 1.0:
                raise ValueError(f"a way begins {gap:.1f} m from where the last ended")
            points = np.vstack([end, points[1:]])
        path = smooth_path(points, gait.corner_radius)
        ways[number] = wandered(path, wander, rng) if wander > 0.0 else path
        end = ways[number][-1]
    return ways


def _stops(script: Sequence[Action], ways: dict[int, Array], number: int) -> bool:
    """Whether the walker comes to rest at the end of a way."""
    following = ways.get(number + 1)
    if following is None:
        return not isinstance(script[number + 1], Go)
    turn = directions(following[:25])[0] - directions(ways[number][-25:])[-1]
    return bool(abs((turn + np.pi) % (2.0 * np.pi) - np.pi) > UNTURNED)


def _walked(path: Array, gait: Gait, from_rest: bool, to_rest: bool, before: list[_Stretch]) -> _Stretch:
    arc, direction = arc_of(path), directions(path)
    slope = np.gradient(path[:, 2], arc)
    bend = np.abs(np.gradient(direction, arc))
    turning = gaussian_filter1d(bend, 0.3 / SPACING_M)
    # The sharpest within reach of the averages below, so that they do not carry speed into a turn.
    sharpest = maximum_filter1d(gaussian_filter1d(bend, 0.1 / SPACING_M), round(0.5 / SPACING_M))
    facing = np.interp(arc + gait.look_ahead / 2, arc, sharpest)
    speed = gaussian_filter1d(gait.pace(turning, slope, facing), 0.15 / SPACING_M, mode="nearest")
    # Speeds in the middle of each piece: at rest the ends have none, and time would not pass.
    middle = 0.5 * (speed[1:] + speed[:-1])
    at = 0.5 * (arc[1:] + arc[:-1])
    for rests, distance in ((from_rest, at), (to_rest, arc[-1] - at)):
        if rests:
            middle = np.minimum(middle, np.sqrt(2.0 * gait.start_acceleration * distance))
    clock = np.concatenate([[0.0], np.cumsum(np.diff(arc) / middle)])
    times = np.arange(0.0, clock[-1], TICK_S)
    walked = np.interp(times, clock, arc)
    heading = np.interp(walked + gait.look_ahead / 2, arc, direction)
    if before:
        heading += 2.0 * np.pi * np.round((before[-1].heading[-1] - heading[0]) / (2.0 * np.pi))
    ground = np.stack([np.interp(walked, arc, column) for column in path.T], axis=1)
    return _Stretch(ground, heading, np.gradient(walked, TICK_S), np.interp(walked, arc, slope))


def _sweep(start: float, end: float, gait: Gait) -> Array:
    """Headings of a turn on the spot."""
    part = np.linspace(0.0, 1.0, 2 + round(abs(end - start) / gait.turn_rate / TICK_S))
    return np.asarray(start + (end - start) * part)


def _looks(action: Action, heading: float, gait: Gait) -> Array:
    """Headings while the walker stands."""
    if isinstance(action, Stand):
        return np.full(round(action.seconds / TICK_S), heading)
    assert isinstance(action, LookAround)  # noqa: S101 - ways are walked
    bearings = [heading, *(heading + angle for angle in action.angles), heading]
    rest = round(GLANCE_S / TICK_S)
    return np.concatenate([np.append(_sweep(a, b, gait), np.full(rest, b)) for a, b in pairwise(bearings)])


def _held_angles(
    times: Array, heading: Array, phase: Array, pace: Array, gait: Gait, rng: np.random.Generator
) -> Array:
    hand: Array = gaussian_filter1d(rng.normal(size=(3, len(times))), 0.5 / TICK_S, axis=1)
    hand *= gait.shake / np.maximum(hand.std(axis=1, keepdims=True), 1e-9)
    vigour = np.clip(pace / gait.speed, 0.0, 1.2)
    step, lag = 2.0 * np.pi * phase, rng.uniform(0.0, 2.0 * np.pi)
    pitch = gait.pitch + hand[0] + 0.006 * vigour * np.sin(step + lag)
    roll = hand[1] + 0.010 * vigour * np.sin(step / 2)
    return np.stack([heading + hand[2], pitch, roll], axis=1)


def _offsets(times: Array, change: Aim | Shake) -> Array:
    """Heading, pitch and roll (N, 3) that a way of holding the camera adds."""
    if isinstance(change, Aim):
        sides = np.array([change.left, change.up, change.clockwise])
        return np.outer(_eased(times, change.begin, change.end, change.ease), sides)
    part = change.amplitude * _eased(times, change.begin, change.end, 0.2)
    swinging = 2.0 * np.pi * change.rate * times
    turned = (np.sin(swinging), np.sin(1.31 * swinging + 1.0), 0.4 * np.sin(0.83 * swinging + 2.0))
    return np.stack([part * offset for offset in turned], axis=1)


def _eased(times: Array, begin: float, end: float, ease: float) -> Array:
    """0 before ``begin``, 1 within, 0 after ``end``, with smooth flanks inside the interval (N,)."""
    part = np.clip(np.minimum(times - begin, end - times) / ease, 0.0, 1.0)
    return np.asarray(part * part * (3.0 - 2.0 * part))


def leave_route(route: ArrayLike, at: float, aside: ArrayLike) -> list[Action]:
    """Walk a route (N, 2 or 3), leave it after ``at`` metres along ``aside`` (M, 2 or 3), and come back."""
    before, after = split(route, at)
    detour = np.asarray(aside, dtype=np.float64)
    out = np.vstack([before[-1], detour])
    return [Go(np.vstack([before, detour])), Stand(0.6), Go(out[::-1]), Go(after)]


def turn_back(route: ArrayLike, at: float, by: float) -> list[Action]:
    """Walk a route, turn round after ``at`` metres, go back ``by`` metres, turn again and go on."""
    before, after = split(route, at)
    _, back = split(before, arc_of(before)[-1] - by)
    return [Go(before), Go(back[::-1]), Go(np.vstack([back, after[1:]]))]
