"""How a person walks and carries a phone, and the steps that come of it."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

HEEL_STRIKE = 0.1
"""Second harmonic of the bobbing, as a part of the first: four times as large in the acceleration.

Phones carried through a mall show 0.26 to 0.44 there.
"""

STAIRS = (0.12, 0.3)
"""Slopes of the floor at which walking begins to be climbing, and is climbing alone."""


@dataclass(frozen=True, slots=True)
class Gait:
    """How the camera is carried.

    Attributes:
        speed: metres a second on straight stretches.
        turn_slowdown: part of the speed that is lost in the sharpest turn.
        height: of the camera above the floor, metres.
        step_rate: steps a second at that speed.
        bob, sway, surge: amplitudes of the motion up and down (a step), sideways (a pair of steps) and
            along the way (a step), metres.
        pitch: mean, radians, positive looks up.
        shake: deviation of slow hand motion, radians.
        corner_radius: metres over which a corner of the waypoints is rounded.
        look_ahead: metres along the path to the point the camera is turned to.
        stair_rate: steps a second on stairs, each from one tread to the next.
        riser: height of a stair, metres.
        turn_rate: radians a second of turning on the spot, and the most that is turned while walking.
        start_acceleration: metres a second squared of setting off and of stopping.
    """

    speed: float = 1.1
    turn_slowdown: float = 0.4
    height: float = 1.5
    step_rate: float = 1.9
    bob: float = 0.022
    sway: float = 0.016
    surge: float = 0.006
    pitch: float = -0.05
    shake: float = 0.012
    corner_radius: float = 0.7
    look_ahead: float = 0.8
    stair_rate: float = 1.6
    riser: float = 0.17
    turn_rate: float = 1.3
    start_acceleration: float = 1.2

    def climbing(self, slope: Array) -> Array:
        """How far walking on a slope (rise over run) is climbing, (N,) from 0 to 1."""
        part = np.clip((np.abs(slope) - STAIRS[0]) / (STAIRS[1] - STAIRS[0]), 0.0, 1.0)
        return np.asarray(part * part * (3.0 - 2.0 * part))

    def pace(self, turning: Array, slope: Array, facing: Array | None = None) -> Array:
        """Horizontal speed (N,) where the path turns by so many radians a metre at a slope.

        Args:
            facing: radians a metre by which the camera turns there, if it looks ahead of the path.
        """
        level = self.speed * (1.0 - self.turn_slowdown * np.clip(turning / 1.2, 0.0, 1.0))
        if facing is not None:
            level = np.minimum(level, self.turn_rate / np.maximum(facing, 1e-6))
        stairs = self.stair_rate * self.riser / np.maximum(np.abs(slope), STAIRS[0])
        climbing = self.climbing(slope)
        return np.asarray((1.0 - climbing) * level + climbing * np.minimum(level, stairs))

    def cadence(self, pace: Array, slope: Array) -> Array:
        """Steps a second (N,) at a horizontal speed on a slope.

        On the level step rate and step length both grow with the root of the speed (Grieve and Gear,
        1966); on stairs a step is a tread.
        """
        level = self.step_rate * np.sqrt(pace / self.speed)
        climbing = self.climbing(slope)
        return np.asarray((1.0 - climbing) * level + climbing * pace * np.abs(slope) / self.riser)


class Foot(StrEnum):
    """The one that is put down."""

    LEFT = "left"
    RIGHT = "right"


@dataclass(frozen=True, slots=True)
class Step:
    """A foot is put down.

    Attributes:
        time: seconds.
        length: metres since the step before, on the floor.
    """

    time: float
    length: float
    foot: Foot


@dataclass(frozen=True, eq=False, slots=True)
class Swing:
    """What steps do to the camera; each (N,), metres, zero while standing."""

    up: Array
    left: Array
    ahead: Array


def swing(gait: Gait, phase: Array, pace: Array, slope: Array) -> Swing:
    """The camera's motion about the even path.

    Args:
        phase: steps taken; a foot is put down at each whole number, where the body is lowest.
        pace: horizontal speed.
    """
    step = 2.0 * np.pi * phase
    vigour = np.clip(pace / gait.speed, 0.0, 1.2)
    climbing = gait.climbing(slope)
    # A body climbs while the leg is stretched, and rests between: one riser in each step's second half.
    lift = (1.0 - climbing) * gait.bob * vigour + climbing * gait.riser / (2.0 * np.pi)
    moving = np.clip(pace / (0.3 * gait.speed), 0.0, 1.0)
    return Swing(
        up=-moving * lift * (np.cos(step) + HEEL_STRIKE * np.cos(2.0 * step)),
        left=gait.sway * vigour * np.sin(step / 2.0),
        ahead=gait.surge * vigour * np.sin(step),
    )


def find_steps(times: Array, phase: Array, walked: Array) -> tuple[Step, ...]:
    """The steps at whole numbers of the phase (N,), which never falls; even ones are left."""
    whole = np.arange(np.ceil(phase[0]), np.floor(phase[-1]) + 1.0)
    # Where standing still keeps the phase, interpolation needs it to grow all the same.
    growing = phase + 1e-9 * np.arange(len(phase))
    at = np.interp(whole, growing, times)
    length = np.diff(np.interp(at, times, walked), prepend=walked[0])
    feet = [Foot.LEFT if number % 2 == 0 else Foot.RIGHT for number in whole]
    return tuple(Step(float(t), float(d), foot) for t, d, foot in zip(at, length, feet, strict=True))
