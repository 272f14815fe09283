"""A walk through a building that is to be recorded: who walks, how, with which phone, past whom."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from client_sim.synthetic.cameras import Camera, LensCamera, PinholeCamera
from client_sim.synthetic.exposure import Light
from client_sim.synthetic.gait import Gait
from client_sim.synthetic.motion import Motion
from client_sim.synthetic.paths import arc_of, distance_to, path_turns, smooth_path, split
from client_sim.synthetic.people import Passerby
from client_sim.synthetic.scripts import Action, Aim, Go, Shake, Stand, perform, turn_back
from client_sim.synthetic.venue import Building

Array = NDArray[np.float64]

OFF_ROUTE_M = 1.0
"""Beyond this distance from the route a follower has left it."""

ROOM_M = 1.5
"""Within this distance of a place one is there."""

BLANK_WALL = 1.45
"""Radians aside to which a phone is turned that is to see nothing but the wall."""


class Role(StrEnum):
    """Who records."""

    LEADER = "leader"
    FOLLOWER = "follower"


@dataclass(frozen=True, slots=True)
class Span:
    """From ``begin`` to ``end``, seconds of the video."""

    begin: float
    end: float

    def __contains__(self, time: float) -> bool:
        return self.begin <= time < self.end


@dataclass(frozen=True, slots=True)
class Phone:
    """What is filmed with: the camera of a phone held upright, and of one held across."""

    portrait: Camera
    landscape: Camera


PHONES: dict[str, Phone] = {
    "reference": Phone(PinholeCamera(480, 640, 500.0, 500.0, 240.0, 320.0), PinholeCamera()),
    "longer": Phone(PinholeCamera(480, 640, 540.0, 540.0, 240.0, 320.0), PinholeCamera(fx=540.0, fy=540.0)),
    "wide": Phone(
        LensCamera("OPENCV", 480, 640, (410.0, 410.0, 243.0, 317.0, -0.11, 0.02, 6e-4, -4e-4)),
        LensCamera("OPENCV", 640, 480, (410.0, 410.0, 317.0, 237.0, -0.11, 0.02, 4e-4, 6e-4)),
    ),
}
"""By name."""


@dataclass(frozen=True, slots=True)
class WalkPlan:
    """How a route is walked.

    Attributes:
        seed: of this walk alone; the building has its own.
        speed, height: of walking and of the phone above the floor; a leader's are those of :class:`Gait`,
            a follower's are drawn.
        wander: metres to the side that the walker strays at most; None is 0 for a leader, 0.3 for others.
        phone: one of :data:`PHONES`; None is the reference for a leader, the longer one for others.
        portrait: the phone is held upright, so that the pictures are.
        people: who pass by.
        pauses: standing still, metres of the route and seconds.
        leave: metres of the route after which it is left.
        aside: floor points walked to then, and back.
        turn_back: metres of the route after which the walker turns round.
        back: metres gone back then.
        covered: the lens is.
        shaken: the phone is, so that the pictures blur.
        walls: the phone looks at a wall beside.
        rolled: second at which the phone is rolled from upright to across, and held so.
    """

    role: Role = Role.LEADER
    seed: int = 1
    speed: float | None = None
    height: float | None = None
    wander: float | None = None
    phone: str | None = None
    portrait: bool = False
    people: int = 0
    pauses: tuple[tuple[float, float], ...] = ()
    leave: float | None = None
    aside: tuple[tuple[float, float, float], ...] = ()
    turn_back: float | None = None
    back: float = 3.0
    covered: tuple[Span, ...] = ()
    shaken: tuple[Span, ...] = ()
    walls: tuple[Span, ...] = ()
    rolled: float | None = None


@dataclass(frozen=True, eq=False, slots=True)
class Recording:
    """A walk, ready to be filmed.

    Attributes:
        route: (N, 3) the floor path that the route's leader walks.
        meta: what ``meta.json`` says beside what can be told from the rest.
    """

    building: Building
    route: Array = field(repr=False)
    motion: Motion = field(repr=False)
    camera: Camera
    light: Light
    seed: int
    fps: float = 10.0
    people: tuple[Passerby, ...] = ()
    covered: tuple[Span, ...] = ()
    meta: dict[str, Any] = field(default_factory=dict, repr=False)


def plan_recording(building: Building, route: str, plan: WalkPlan, *, fps: float = 10.0) -> Recording:
    """Work out a walk along one of a building's routes.

    Raises:
        ValueError: the building has no such route, there is no such phone, or the plan asks for
            something beyond the route's end; the message says what there is.
    """
    if route not in building.routes:
        raise ValueError(f"no route {route!r}; there are: {', '.join(sorted(building.routes))}")
    leads = plan.role is Role.LEADER
    name = plan.phone or ("reference" if leads else "longer")
    if name not in PHONES:
        raise ValueError(f"no phone {name!r}; there are: {', '.join(PHONES)}")
    moving, passing, drawn = (np.random.default_rng([plan.seed, k]) for k in (21, 22, 23))
    gait = _gait(plan, leads, drawn)
    points = np.asarray(building.routes[route], dtype=np.float64)
    wander = plan.wander if plan.wander is not None else 0.0 if leads else 0.3
    held = [*(Shake(s.begin, s.end) for s in plan.shaken)]
    aims = [Aim(s.begin, s.end, left=BLANK_WALL) for s in plan.walls]
    if plan.rolled is not None:
        aims.append(Aim(plan.rolled, clockwise=-np.pi / 2))
    motion = perform(_script(points, plan), moving, gait, wander=wander, held=[*held, *aims])
    path = smooth_path(points, Gait().corner_radius)
    light = Light() if leads else Light(gain=0.92, gamma=1.06, warmth=1.1)
    phone = PHONES[name]
    return Recording(
        building=building,
        route=path,
        motion=motion,
        camera=phone.portrait if plan.portrait else phone.landscape,
        light=light,
        seed=plan.seed,
        fps=fps,
        people=passers_by(path, motion, plan.people, passing),
        covered=plan.covered,
        meta={
            "role": plan.role.value,
            "route": route,
            "seed": plan.seed,
            "camera_height_m": round(gait.height, 3),
            "speed_m_s": round(gait.speed, 3),
            "wander_m": wander,
            "phone": name,
        },
    )


def _gait(plan: WalkPlan, leads: bool, rng: np.random.Generator) -> Gait:
    if leads:
        # Who films a way for others takes care in the turns.
        usual = Gait(turn_slowdown=0.55, turn_rate=0.9)
        return replace(usual, speed=plan.speed or usual.speed, height=plan.height or usual.height)
    speed, height = float(rng.uniform(1.0, 1.3)), float(rng.uniform(1.42, 1.66))
    return Gait(
        speed=plan.speed or speed,
        height=plan.height or height,
        step_rate=float(rng.uniform(1.75, 2.1)),
        bob=float(rng.uniform(0.018, 0.028)),
        pitch=float(rng.uniform(-0.1, 0.0)),
    )


def _script(points: Array, plan: WalkPlan) -> list[Action]:
    """The route with the plan's pauses and ways aside, in the order in which they are met."""
    if plan.turn_back is not None:
        if plan.pauses or plan.leave is not None:
            raise ValueError("a walk that turns back neither pauses nor leaves the route")
        return turn_back(points, plan.turn_back, plan.back)
    stops: list[tuple[float, list[Action]]] = [(at, [Stand(seconds)]) for at, seconds in plan.pauses]
    if plan.leave is not None:
        if not plan.aside:
            raise ValueError("to leave the route, say where to: points aside")
        before, _ = split(points, plan.leave)
        out = np.vstack([before[-1], np.asarray(plan.aside, dtype=np.float64)])
        stops.append((plan.leave, [Go(out), Stand(0.6), Go(out[::-1])]))
    script: list[Action] = []
    rest, passed = points, 0.0
    for at, actions in sorted(stops, key=lambda stop: stop[0]):
        before, rest = split(rest, at - passed)
        passed = at
        script += [Go(before), *actions]
    return [*script, Go(rest)]


def passers_by(route: Array, motion: Motion, count: int, rng: np.random.Generator) -> tuple[Passerby, ...]:
    """People who come towards the walker, each keeping to their right, spread over level ground.

    Args:
        route: (N, 3) floor path.
    """
    arc = arc_of(route)
    level = np.abs(np.gradient(route[:, 2], arc)) < 0.02
    people = []
    for number in range(count):
        # Where they meet, and the way there: 8 m of the route from ahead, 3 m past the walker.
        meeting = (number + rng.uniform(0.35, 0.65)) / count * arc[-1]
        stretch = (arc > meeting - 3.0) & (arc < meeting + 8.0)
        if stretch.sum() < 2 or not level[stretch].all():
            continue
        path = route[stretch][::-20]
        ahead = np.gradient(path[:, :2], axis=0)
        ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
        path = path.copy()
        path[:, :2] += 0.55 * np.stack([ahead[:, 1], -ahead[:, 0]], axis=1)
        speed = float(rng.uniform(0.9, 1.3))
        near = np.linalg.norm(motion.ground - route[np.searchsorted(arc, meeting)], axis=1)
        walked = arc_of(path)[np.linalg.norm(path - route[np.searchsorted(arc, meeting)], axis=1).argmin()]
        begin = float(motion.times[near.argmin()] - walked / speed)
        points = tuple((float(x), float(y), float(z)) for x, y, z in path)
        people.append(Passerby(points, begin, speed, look=int(rng.integers(1 << 30))))
    return tuple(people)


def checkpoints(recording: Recording, times: Array) -> list[dict[str, Any]]:
    """Turns of the walked path and places that are come to, with their pictures' numbers.

    Args:
        times: (F,) of the pictures.
    """
    motion = recording.motion
    position = motion.positions(times)
    ground = motion.grounds(times)
    found = []
    dense = motion.ground[::2]
    moved = np.concatenate([[True], np.linalg.norm(np.diff(dense[:, :2], axis=0), axis=1) > 1e-4])
    arc = arc_of(dense[moved])
    for turn in path_turns(dense[moved]):
        at = float(np.interp(turn.at, arc, motion.times[::2][moved]))
        frame = int(np.abs(times - at).argmin())
        found.append(
            {
                "kind": "turn",
                "frame": frame,
                "angle_deg": round(float(np.degrees(turn.angle)), 1),
                "position": position[frame].round(3).tolist(),
            }
        )
    rooms = _rooms(recording.building, ground)
    for frame, room in enumerate(rooms):
        if room is not None and (frame == 0 or room != rooms[frame - 1]):
            found.append(
                {
                    "kind": "enter_room",
                    "frame": frame,
                    "room": room,
                    "position": position[frame].round(3).tolist(),
                }
            )
    return sorted(found, key=lambda checkpoint: checkpoint["frame"])


def _rooms(building: Building, ground: Array) -> list[str | None]:
    """The place that each of the floor points (F, 3) belongs to: the last one that was come near to."""
    names = list(building.places)
    if not names:
        return [None] * len(ground)
    places = np.array([building.places[name] for name in names])
    apart = np.linalg.norm(ground[:, None] - places[None], axis=2)
    rooms: list[str | None] = []
    for row in apart:
        nearest = int(row.argmin())
        rooms.append(names[nearest] if row[nearest] <= ROOM_M else rooms[-1] if rooms else None)
    return rooms


def off_route(recording: Recording, times: Array) -> tuple[Array, list[int] | None]:
    """Metres (F,) to the route at the pictures' times, and the first and last picture away from it."""
    apart = distance_to(recording.route, recording.motion.grounds(times))
    away: Sequence[int] = np.flatnonzero(apart > OFF_ROUTE_M).tolist()
    return apart, [away[0], away[-1]] if away else None
