"""Guidance along a route: where the follower is on it, and what to do next."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from server.geometry.poses import SE3, rotation_from_quaternion
from server.mapping.route_map import RouteMap
from server.mapping.trajectory import smoothed
from server.navigation.updates import Guidance, Instruction, NextTurn

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class GuidanceOptions:
    """Settings of :class:`Guide`. Lengths are in map units: what the leader walked in a second.

    Attributes:
        waypoints: whose average is the temporary destination; spacing: their distance on the route.
        straight: bearing up to which the instruction is straight, radians; around: from which it is to
            turn around; hysteresis: by how much less a turn that has been told goes on.
        arrival: length of route left at which the follower has arrived.
        reach: how far progress may move at once; pace: and besides, for every second since the last fix.
        jump_seconds: how long fixes must speak for a place out of reach before progress jumps there.
        as_good, slack: a place fits about as well as the best one up to ``as_good`` times its cost plus
            ``slack``, map units.
        heading: what facing the other way costs, map units.
    """

    waypoints: int = 10
    spacing: float = 0.3
    straight: float = math.radians(20.0)
    hysteresis: float = math.radians(5.0)
    around: float = math.radians(130.0)
    arrival: float = 1.0
    reach: float = 2.0
    pace: float = 3.0
    jump_seconds: float = 2.0
    as_good: float = 1.5
    slack: float = 0.5
    heading: float = 1.0


@dataclass(frozen=True, slots=True)
class Progress:
    """Where a follower is on the route.

    Attributes:
        length: arc length from the start, map units.
        time: of the fix it rests on, seconds.
        doubted: time of the first of the fixes since then that spoke for a place out of reach, or None.
    """

    length: float
    time: float
    doubted: float | None = None


class Guide:
    """Guides along one route; holds no state of a session."""

    def __init__(self, route_map: RouteMap, options: GuidanceOptions | None = None) -> None:
        self.options = options or GuidanceOptions()
        path = route_map.path
        self._scale = route_map.scale
        self._turns = route_map.turns
        self._time = np.asarray(path.time)
        self._arc = np.asarray(path.arc_length)
        self._position = smoothed(np.asarray(path.position), self._time)
        self._onward = self._last_direction()
        self._forward = rotation_from_quaternion(path.quaternion)[:, :, 2]

    @property
    def length(self) -> float:
        """Length of the route, map units."""
        return float(self._arc[-1])

    def locate(self, world_from_camera: SE3, time: float, before: Progress | None) -> Progress:
        """Progress of a follower with a pose, in the light of where they were before.

        A route may cross itself or end where it starts. The first fix is taken for the earliest stretch
        that fits about as well as the best: whoever begins is at the beginning. After that a place
        within reach is preferred, and one out of reach is believed only when fixes speak for it for a
        while: as long as :attr:`Progress.doubted` says so, the last progress is no guide to the pose.
        """
        options = self.options
        offset = self._position - world_from_camera.translation
        facing = self._forward @ world_from_camera.rotation[:, 2]
        cost = np.linalg.norm(offset, axis=1) + 0.5 * options.heading * (1.0 - facing)
        enough = options.as_good * cost.min() + options.slack
        if before is None:
            return Progress(self._earliest(cost, enough), time)
        reach = options.reach + options.pace * max(0.0, time - before.time)
        near = np.flatnonzero(np.abs(self._arc - before.length) <= reach)
        if len(near):
            here = int(near[np.argmin(cost[near])])
            if cost[here] <= enough:
                return Progress(float(self._arc[here]), time)
        doubted = time if before.doubted is None else before.doubted
        if time - doubted >= options.jump_seconds:
            return Progress(self._earliest(cost, enough), time)
        return Progress(before.length, before.time, doubted)

    def _earliest(self, cost: Array, enough: float) -> float:
        """Arc length of the best place in the first stretch of the route that costs at most ``enough``."""
        fits = np.flatnonzero(cost <= enough)
        breaks = np.flatnonzero(np.diff(fits) > 1)
        stretch = fits[: breaks[0] + 1] if len(breaks) else fits
        return float(self._arc[stretch[np.argmin(cost[stretch])]])

    def arrived(self, progress: Progress) -> bool:
        """Whether the route is walked to its end."""
        return self.length - progress.length <= self.options.arrival

    def guide(
        self, world_from_camera: SE3, progress: Progress, before: Instruction | None = None
    ) -> Guidance:
        """What to do at a pose (Pair-Navi, section IV-A: the average of the next poses is the aim).

        Args:
            before: the last instruction; it stays until the bearing is clearly another one.
        """
        remaining = max(0.0, self.length - progress.length)
        bearing = self._bearing(world_from_camera, progress.length)
        instruction = Instruction.ARRIVED if self.arrived(progress) else self._instruction(bearing, before)
        now = self._leader_time(progress.length)
        return Guidance(
            progress=progress.length / self.length if self.length > 0 else 1.0,
            walked_m=self._scale.metres(progress.length),
            remaining_m=self._scale.metres(remaining),
            remaining_seconds=max(0.0, float(self._time[-1]) - now),
            instruction=instruction,
            bearing=bearing,
            next_turn=self._next_turn(progress.length, now),
        )

    def _instruction(self, bearing: float, before: Instruction | None) -> Instruction:
        options = self.options
        straight, around = options.straight, options.around
        if before in (Instruction.LEFT, Instruction.RIGHT):
            straight -= options.hysteresis
        elif before is Instruction.TURN_AROUND:
            around -= options.hysteresis
        if abs(bearing) <= straight:
            return Instruction.STRAIGHT
        if abs(bearing) >= around:
            return Instruction.TURN_AROUND
        return Instruction.LEFT if bearing > 0 else Instruction.RIGHT

    def _last_direction(self) -> Array:
        """Unit direction (3,) in which the route ends, from its last unit of length."""
        begin = int(np.searchsorted(self._arc, self._arc[-1] - 1.0))
        step = self._position[-1] - self._position[min(begin, len(self._position) - 2)]
        return np.asarray(step / max(float(np.linalg.norm(step)), 1e-9))

    def _leader_time(self, length: float) -> float:
        return float(np.interp(length, self._arc, self._time))

    def _at(self, lengths: Array) -> Array:
        """Points (N, 3) of the route at arc lengths (N,); beyond its end it goes straight on.

        Without that the points would crowd at the destination, and a step beside it turn the aim around.
        """
        on_route = np.stack([np.interp(lengths, self._arc, self._position[:, i]) for i in range(3)], axis=1)
        return on_route + np.maximum(lengths - self.length, 0.0)[:, None] * self._onward

    def _bearing(self, world_from_camera: SE3, length: float) -> float:
        """Angle from the view to the temporary destination about the vertical, positive to the left."""
        options = self.options
        ahead = length + options.spacing * np.arange(1.0, options.waypoints + 1.0)
        aim = self._at(ahead).mean(axis=0) - world_from_camera.translation
        view = world_from_camera.rotation[:, 2]
        if np.hypot(view[0], view[1]) < 0.1:
            # The phone looks at the floor or the ceiling: its upper edge shows where it points.
            view = -world_from_camera.rotation[:, 1] * np.sign(-view[2])
        return float(np.arctan2(view[0] * aim[1] - view[1] * aim[0], view[0] * aim[0] + view[1] * aim[1]))

    def _next_turn(self, length: float, now: float) -> NextTurn | None:
        """The first turn still ahead; of one that has begun the instruction speaks."""
        for turn in self._turns:
            if turn.start > length:
                seconds = max(0.0, self._leader_time(turn.start) - now)
                return NextTurn(turn.angle, self._scale.metres(turn.start - length), seconds)
        return None
