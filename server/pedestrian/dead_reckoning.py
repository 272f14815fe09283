"""Where a walker is by steps, gyroscope and compass, from a known start: one small Kalman filter.

The gyroscope carries the shape of the path, so an error of the compass turns the whole path about its
start. The filter keeps that covariance: what the compass, or a fix, tells later about the heading moves
the position that was reached with the wrong one, and a fix teaches the user's scale as well.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from server.pedestrian.orientation import wrapped
from server.pedestrian.stride import UserProfile

Array = NDArray[np.float64]

X, Y, TURN, MOUNT, SCALE, FIELD, BIAS = 0, 1, 2, 3, 4, 5, 6
SIZE = 9
"""The state: position (2); angle of the level frame in the world; of the walk against the phone;
log of the user's scale; level strength of the earth's field, microtesla; magnetometer's bias (3)."""

_UNKNOWN = (math.pi / math.sqrt(3.0)) ** 2
"""Variance of an angle of which nothing is known."""


@dataclass(frozen=True, slots=True)
class DeadReckoningOptions:
    """Standard deviations.

    Attributes:
        mount: radians between where the phone points and where its user walks.
        gyroscope_walk: radians by which the gyroscope's heading wanders in the root of a second.
        step_heading: radians of one step's direction about the mean of the walk's.
        disturbance: microtesla, of a building's own magnetic field, each axis.
        correlation: metres after which that field is another one.
        magnetometer_bias: microtesla that are left of it by the phone's own calibration, each axis.
        declination: radians of magnetic north from the world's y axis, positive to the east.
        start_spread: metres, how well a start is known of a walk that others learn from.
        step_spread: m^2 by which the steps' own noise spreads such a walk in a metre.
    """

    mount: float = math.radians(8.0)
    gyroscope_walk: float = math.radians(0.3)
    step_heading: float = math.radians(10.0)
    disturbance: float = 8.0
    correlation: float = 6.0
    magnetometer_bias: float = 6.0
    declination: float = 0.0
    start_spread: float = 0.5
    step_spread: float = 0.02


_TRAIL = 64
"""Steps whose positions are remembered, for fixes that are told late."""


class DeadReckoning:
    """Position with its covariance, one update a step; world axes x east, y north, metres."""

    def __init__(
        self,
        options: DeadReckoningOptions,
        start: tuple[float, float] = (0.0, 0.0),
        start_variance: float = 0.0,
        profile: UserProfile | None = None,
    ) -> None:
        profile = profile or UserProfile()
        self.options = options
        self.state: Array = np.zeros(SIZE)
        self.state[:2] = start
        self.state[SCALE] = profile.log_scale
        bias = options.magnetometer_bias**2
        self.covariance: Array = np.diag(
            [
                start_variance,
                start_variance,
                _UNKNOWN,
                options.mount**2,
                profile.variance,
                0.0,
                bias,
                bias,
                bias,
            ]
        )
        self._last_time: float | None = None
        self._compass_started = False
        self._level = (0.0, 0.0)
        self._trail: deque[tuple[float, float, float]] = deque(maxlen=_TRAIL)
        self.start = (float(start[0]), float(start[1]))
        self.unbroken = True
        self._start_from(start_variance)

    @property
    def position(self) -> tuple[float, float]:
        return float(self.state[X]), float(self.state[Y])

    @property
    def position_covariance(self) -> Array:
        """(2, 2), m^2."""
        return self.covariance[:2, :2].copy()

    @property
    def heading_variance(self) -> float:
        """Of the angle between the level frame and the direction of walking, rad^2."""
        c = self.covariance
        return float(c[TURN, TURN] + c[MOUNT, MOUNT] + 2.0 * c[TURN, MOUNT])

    @property
    def heading_known(self) -> bool:
        return self.heading_variance < 1.0

    @property
    def profile(self) -> UserProfile:
        """What this walk has taught about the user."""
        return UserProfile(float(self.state[SCALE]), float(self.covariance[SCALE, SCALE]))

    def heading(self, level_heading: float) -> float:
        """Direction of walking in the world for one in the level frame."""
        return wrapped(level_heading + float(self.state[TURN] + self.state[MOUNT]))

    def turned(self, move: tuple[float, float]) -> tuple[float, float]:
        """A move in the level frame, unscaled, as one in the world."""
        angle, scale = float(self.state[TURN] + self.state[MOUNT]), math.exp(float(self.state[SCALE]))
        c, s = scale * math.cos(angle), scale * math.sin(angle)
        return c * move[0] - s * move[1], s * move[0] + c * move[1]

    def step(self, t: float, level_heading: float, length: float, length_variance: float) -> None:
        """One step (DynamicSLAM Eq. 4-8): its direction in the level frame, its length unscaled."""
        options, state, covariance = self.options, self.state, self.covariance
        elapsed = 0.0 if self._last_time is None else max(0.0, t - self._last_time)
        self._last_time = t
        scale = math.exp(float(state[SCALE]))
        heading = level_heading + float(state[TURN] + state[MOUNT])
        along = np.array([math.cos(heading), math.sin(heading)])
        move = scale * length * along
        state[:2] += move
        level = (length * math.cos(level_heading), length * math.sin(level_heading))
        self._since_fix += level
        self._level = (self._level[0] + level[0], self._level[1] + level[1])
        self._trail.append((t, *self._level))
        across = np.array([-move[1], move[0]])
        jacobian = np.eye(SIZE)
        jacobian[:2, TURN] = jacobian[:2, MOUNT] = across
        jacobian[:2, SCALE] = move
        covariance = jacobian @ covariance @ jacobian.T
        covariance[:2, :2] += scale**2 * length_variance * np.outer(along, along)
        covariance[:2, :2] += options.step_heading**2 * np.outer(across, across)
        covariance[TURN, TURN] += options.gyroscope_walk**2 * elapsed
        self.covariance = covariance

    def compass(self, field: tuple[float, float], level_from_phone: Array, walked: float) -> None:
        """The mean level field (microtesla, level frame) over the last ``walked`` metres.

        Args:
            level_from_phone: (2, 3), the level rows of the mean rotation over the same stretch.
        """
        options, state = self.options, self.state
        measured = np.array(field) - level_from_phone @ state[BIAS:]
        strength = float(np.hypot(measured[0], measured[1]))
        if not self._compass_started:
            if strength < 1.0:
                return
            state[TURN] = math.atan2(measured[0], measured[1]) - options.declination
            state[FIELD] = strength
            self.covariance[FIELD, FIELD] = (3.0 * options.disturbance) ** 2
            self._compass_started = True
        angle = float(state[TURN]) + options.declination
        north = np.array([math.sin(angle), math.cos(angle)])
        jacobian = np.zeros((2, SIZE))
        jacobian[:, TURN] = state[FIELD] * np.array([north[1], -north[0]])
        jacobian[:, FIELD] = north
        jacobian[:, BIAS:] = level_from_phone
        noise = options.disturbance**2 * max(1.0, options.correlation / max(walked, 1e-3))
        self._update(measured - state[FIELD] * north, jacobian, noise * np.eye(2))

    def fix(self, t: float, position: tuple[float, float], covariance: Array) -> float:
        """Take a position from elsewhere, metres, with its (2, 2) covariance; from a picture, an anchor.

        Args:
            t: when it was true, a while ago perhaps: what was walked since is added.

        Returns:
            The squared Mahalanobis distance between the fix and what was expected.

        Raises:
            ValueError: a number that is not finite, or a covariance that is not positive.
        """
        if not np.isfinite([t, *position, *np.ravel(covariance)]).all():
            raise ValueError("a fix needs a time, a position and a covariance that are finite")
        if float(np.linalg.eigvalsh(covariance)[0]) <= 0.0:
            raise ValueError("a fix needs a covariance that is positive: how well is the position known?")
        place = np.array(position) + self.state[:2] - np.array(self.position_at(t))
        jacobian = np.zeros((2, SIZE))
        jacobian[0, X] = jacobian[1, Y] = 1.0
        distance = 0.0
        if not self._turned_by(place, covariance):
            distance = self._update(place - self.state[:2], jacobian, covariance)
        self._start_from(float(np.trace(self.covariance[:2, :2])) / 2.0)
        return distance

    def position_at(self, t: float) -> tuple[float, float]:
        """Where the walker was at ``t``, by what is known now; the oldest remembered step at the least."""
        then = self.level_at(t)
        x, y = self.turned((self._level[0] - then[0], self._level[1] - then[1]))
        return float(self.state[X]) - x, float(self.state[Y]) - y

    def level_at(self, t: float) -> tuple[float, float]:
        """What had been walked by then since the stream or its last pause began: level frame, unscaled."""
        after: tuple[float, float, float] | None = None
        for step in reversed(self._trail):
            if step[0] <= t:
                if after is None:
                    return step[1], step[2]
                part = (t - step[0]) / (after[0] - step[0])
                return step[1] + part * (after[1] - step[1]), step[2] + part * (after[2] - step[2])
            after = step
        return (0.0, 0.0) if after is None else (after[1], after[2])

    def placed(self, level: tuple[float, float]) -> tuple[tuple[float, float], float]:
        """Where a point of the path was that began at the start, and its variance, m^2 on each axis.

        Args:
            level: of :meth:`level_at`. Only of use while the path is ``unbroken`` and no fix has bent it.
        """
        x, y = self.turned(level)
        squared = x * x + y * y
        steps = math.sqrt(squared) * self.options.step_spread
        common = 0.5 * squared * (self.heading_variance + float(self.covariance[SCALE, SCALE]))
        return (self.start[0] + x, self.start[1] + y), common + steps + self.options.start_spread**2

    def _start_from(self, variance: float) -> None:
        self._origin = self.state[:2].copy()
        self._origin_variance = variance
        self._since_fix = np.zeros(2)
        self._fixed = variance < 10.0

    def pause(self, seconds: float, speed: float) -> None:
        """Nothing was heard for a while: the heading is forgotten, the position spreads at ``speed``."""
        c = self.covariance
        c[:2, :2] += (speed * seconds) ** 2 * np.eye(2)
        c[TURN, :] = 0.0
        c[:, TURN] = 0.0
        c[TURN, TURN] = _UNKNOWN
        self._compass_started = False
        self._last_time = None
        self._fixed = False
        self._level = (0.0, 0.0)
        self._trail.clear()
        self.unbroken = False

    def _turned_by(self, fix: Array, covariance: Array) -> bool:
        """With no compass the second fix tells the heading, which no linear update can."""
        walked, bearing = self._since_fix, fix - self._origin
        distance = float(np.hypot(*walked))
        spread = math.sqrt(self._origin_variance + float(np.trace(covariance)) / 2.0)
        if (
            self.heading_known
            or not self._fixed
            or min(distance, float(np.hypot(*bearing))) < 3.0 * spread + 1.0
        ):
            return False
        angle = math.atan2(bearing[1], bearing[0]) - math.atan2(walked[1], walked[0])
        self.state[TURN] = wrapped(angle - float(self.state[MOUNT]))
        self.state[:2] = fix
        c = self.covariance
        c[[X, Y, TURN], :] = 0.0
        c[:, [X, Y, TURN]] = 0.0
        c[:2, :2] = covariance
        c[TURN, TURN] = (spread / distance) ** 2
        return True

    def _update(self, residual: Array, jacobian: Array, noise: Array) -> float:
        """Joseph's form: symmetric and positive whatever the gain."""
        spread = jacobian @ self.covariance @ jacobian.T + noise
        gain = np.linalg.solve(spread, jacobian @ self.covariance).T
        self.state = self.state + gain @ residual
        keep = np.eye(SIZE) - gain @ jacobian
        self.covariance = keep @ self.covariance @ keep.T + gain @ noise @ gain.T
        self.state[TURN] = wrapped(float(self.state[TURN]))
        return float(residual @ np.linalg.solve(spread, residual))
