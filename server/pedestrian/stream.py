"""A phone's stream: one sample in, events out; all that is remembered is small and bounded."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from server.pedestrian.activities import ActivityModel
from server.pedestrian.anchors import AnchorOptions
from server.pedestrian.dead_reckoning import DeadReckoning, DeadReckoningOptions
from server.pedestrian.events import Event, MagneticSignature, Sensor, Step, TroubleKind, WifiSignature
from server.pedestrian.gait import Gait, GaitOptions, Pace
from server.pedestrian.gyroscope_check import GyroscopeCheck
from server.pedestrian.height import BarometerOptions, HeightTracker
from server.pedestrian.intake import Clock, IntakeOptions, Reports
from server.pedestrian.orientation import Orientation, Vector, wrapped
from server.pedestrian.resampling import MotionGrid
from server.pedestrian.samples import (
    Accelerometer,
    Barometer,
    Gyroscope,
    Magnetometer,
    Sample,
    SatelliteFix,
    VectorSample,
    WifiScan,
)
from server.pedestrian.signatures import MagneticProfile, ProfileOptions
from server.pedestrian.stride import UserProfile
from server.pedestrian.surroundings import Surroundings
from server.pedestrian.units import ACCELERATION, MAGNETIC_FIELD, PRESSURE, G, UnitGuard

Array = NDArray[np.float64]

FASTEST_TURN = 40.0
"""rad/s, beyond what gyroscopes of phones measure."""

ABSURD_TURN = 1e6
"""In any unit."""


@dataclass(frozen=True, slots=True)
class StreamOptions:
    """Options of all parts.

    Attributes:
        period: seconds of the grid to which motion sensors are resampled.
        pause_speed: metres a second at which a walker may go on while the phone says nothing.
        longest_pause: seconds of silence; what a clock skips beyond is no time that has passed.
    """

    period: float = 0.02
    pause_speed: float = 1.0
    longest_pause: float = 600.0
    intake: IntakeOptions = field(default_factory=IntakeOptions)
    gait: GaitOptions = field(default_factory=GaitOptions)
    dead_reckoning: DeadReckoningOptions = field(default_factory=DeadReckoningOptions)
    profile: ProfileOptions = field(default_factory=ProfileOptions)
    barometer: BarometerOptions = field(default_factory=BarometerOptions)
    anchors: AnchorOptions = field(default_factory=AnchorOptions)


class PhoneStream:
    """Turns one phone's samples into events; owned by one thread.

    Args:
        options: of all parts.
        start: where the walk begins, metres, x east, y north.
        start_variance: m^2, each axis.
        profile: what earlier walks have taught about the user.
        model: of activities; the one that comes with this package by default.
    """

    def __init__(
        self,
        options: StreamOptions | None = None,
        start: tuple[float, float] = (0.0, 0.0),
        start_variance: float = 0.0,
        profile: UserProfile | None = None,
        model: ActivityModel | None = None,
    ) -> None:
        self.options = options or StreamOptions()
        self.dead_reckoning = DeadReckoning(self.options.dead_reckoning, start, start_variance, profile)
        self._reports = Reports()
        self._clock = Clock(self.options.intake, self._reports)
        self._jumps = 0
        self._acceleration_unit = UnitGuard(ACCELERATION)
        self._field_unit = UnitGuard(MAGNETIC_FIELD)
        self._pressure_unit = UnitGuard(PRESSURE, count=5)
        self._gyroscope = GyroscopeCheck()
        self._height = HeightTracker(self.options.barometer)
        self._model = model
        self._restart()

    def _restart(self) -> None:
        """All that depends on an unbroken stretch of samples begins anew."""
        options = self.options
        self._grid = MotionGrid(options.period)
        self._orientation = Orientation(options.period)
        self._gait = Gait(options.gait, options.period)
        self._level_heading: float | None = None
        self._gyroscope.break_off()
        self._last_motion: dict[Sensor, float] = {}
        self._field = np.zeros(9)
        self._field_count = 0
        self._profile = MagneticProfile(options.profile)
        self._surroundings = Surroundings(options.anchors, options.period, self._model)

    @property
    def position(self) -> tuple[float, float]:
        """Metres, x east, y north, with the step that is being made."""
        x, y = self.dead_reckoning.position
        ahead = self.dead_reckoning.turned(self._gait.under_way())
        return x + ahead[0], y + ahead[1]

    @property
    def position_covariance(self) -> Array:
        """(2, 2), m^2."""
        return self.dead_reckoning.position_covariance

    @property
    def profile(self) -> UserProfile:
        """What has been learnt about the user so far."""
        return self.dead_reckoning.profile

    @property
    def troubles(self) -> Counter[tuple[Sensor, TroubleKind]]:
        """How often each sensor's input was bad, and how."""
        return self._reports.counts

    def fix(self, t: float, position: tuple[float, float], covariance: Array) -> float:
        """A position from elsewhere, metres, with its (2, 2) covariance.

        Returns:
            The squared Mahalanobis distance between the fix and what was expected.

        Raises:
            ValueError: a number that is not finite, or a covariance that is not positive.
        """
        return self.dead_reckoning.fix(t, position, covariance)

    def push(self, sample: Sample) -> list[Event]:
        """Take one sample; never raises for what a phone may send."""
        events: list[Event] = []
        if isinstance(sample, Accelerometer):
            self._push_acceleration(sample, events)
        elif isinstance(sample, Gyroscope):
            self._push_rotation(sample, events)
        elif isinstance(sample, Magnetometer):
            self._push_field(sample)
        elif isinstance(sample, WifiScan):
            self._push_scan(sample, events)
        elif isinstance(sample, Barometer):
            self._push_pressure(sample, events)
        else:
            self._push_satellite(sample)
        events.extend(self._reports.take())
        return events

    def _push_acceleration(self, sample: Accelerometer, events: list[Event]) -> None:
        if not self._admit(sample, Sensor.ACCELEROMETER):
            return
        norm = math.sqrt(sample.x * sample.x + sample.y * sample.y + sample.z * sample.z)
        factor = self._scale(sample.t, norm, self._acceleration_unit, Sensor.ACCELEROMETER)
        if factor is not None:
            self._continue(sample.t, Sensor.ACCELEROMETER)
            force = (sample.x * factor, sample.y * factor, sample.z * factor)
            if self._gyroscope.force(sample.t, force):
                kind = TroubleKind.AXES if self._gyroscope.axes_changed else TroubleKind.UNITS
                self._reports.add(sample.t, Sensor.GYROSCOPE, kind, self._gyroscope.describe())
            deaf = self._grid.deaf
            for tick in self._grid.acceleration(sample.t, force):
                self._move(*tick, events)
            if self._grid.deaf and not deaf:
                detail = "not heard when it was needed, taken as not turning"
                self._reports.add(sample.t, Sensor.GYROSCOPE, TroubleKind.GAP, detail)

    def _push_rotation(self, sample: Gyroscope, events: list[Event]) -> None:
        if not self._admit(sample, Sensor.GYROSCOPE):
            return
        turning = (sample.x, sample.y, sample.z)
        if max(abs(sample.x), abs(sample.y), abs(sample.z)) < ABSURD_TURN:
            self._gyroscope.turn(sample.t, turning)
        if self._gyroscope.matrix is not None:
            x, y, z = (self._gyroscope.matrix @ turning).tolist()
            turning = (x, y, z)
        if max(abs(turning[0]), abs(turning[1]), abs(turning[2])) > FASTEST_TURN:
            self._reports.add(sample.t, Sensor.GYROSCOPE, TroubleKind.IMPLAUSIBLE, "no phone turns so fast")
            return
        self._continue(sample.t, Sensor.GYROSCOPE)
        for tick in self._grid.rotation(sample.t, turning):
            self._move(*tick, events)

    def _push_field(self, sample: Magnetometer) -> None:
        if not self._admit(sample, Sensor.MAGNETOMETER):
            return
        norm = math.sqrt(sample.x * sample.x + sample.y * sample.y + sample.z * sample.z)
        factor = self._scale(sample.t, norm, self._field_unit, Sensor.MAGNETOMETER)
        if factor is None:
            return
        (a, b, c), (d, e, f), (g, h, i) = self._orientation.matrix
        x, y, z = sample.x * factor, sample.y * factor, sample.z * factor
        up = g * x + h * y + i * z
        self._surroundings.field(norm * factor)
        self._field += (a * x + b * y + c * z, d * x + e * y + f * z, a, b, c, d, e, f, up)
        self._field_count += 1

    def _push_scan(self, sample: WifiScan, events: list[Event]) -> None:
        if not self._admit_stamp(sample.t, Sensor.WIFI):
            return
        readings = tuple((name, strength) for name, strength in sample.readings if -130.0 < strength <= 0.0)
        if len(readings) < len(sample.readings):
            self._reports.add(sample.t, Sensor.WIFI, TroubleKind.IMPLAUSIBLE, "no strength in dBm")
        if readings:
            events.append(WifiSignature(sample.t, readings, self._position_variance()))

    def _push_pressure(self, sample: Barometer, events: list[Event]) -> None:
        if not self._admit_stamp(sample.t, Sensor.BAROMETER):
            return
        if not math.isfinite(sample.pressure):
            self._reports.add(sample.t, Sensor.BAROMETER, TroubleKind.NOT_FINITE, "reading")
            return
        factor = self._scale(sample.t, abs(sample.pressure), self._pressure_unit, Sensor.BAROMETER)
        if factor is not None and (height := self._height.update(sample.t, abs(sample.pressure) * factor)):
            events.append(height)

    def _push_satellite(self, sample: SatelliteFix) -> None:
        if not self._admit_stamp(sample.t, Sensor.SATELLITE):
            return
        if not sample.accuracy_m > 0.0:
            self._reports.add(
                sample.t, Sensor.SATELLITE, TroubleKind.IMPLAUSIBLE, "accuracy that is not positive"
            )
            return
        self._surroundings.entrance.fix(sample.t, sample.accuracy_m)

    def _admit_stamp(self, t: float, sensor: Sensor) -> bool:
        if not self._clock.admit(t, sensor):
            return False
        if self._clock.jumps != self._jumps:
            self._jumps = self._clock.jumps
            # Forwards it may have been the phone that slept, while its owner walked on.
            unheard = min(max(0.0, self._clock.jumped), self.options.longest_pause)
            self.dead_reckoning.pause(unheard, self.options.pause_speed)
            self._height.resume(t, unheard)
            self._restart()
        return True

    def _admit(self, sample: VectorSample, sensor: Sensor) -> bool:
        if not self._admit_stamp(sample.t, sensor):
            return False
        if not math.isfinite(sample.x + sample.y + sample.z):
            self._reports.add(sample.t, sensor, TroubleKind.NOT_FINITE, "reading")
            return False
        return True

    def _continue(self, t: float, sensor: Sensor) -> None:
        """A motion sensor's reading at ``t`` is good: does it go on from its last good one?"""
        last = self._last_motion.get(sensor, t)
        if t - last > self.options.intake.longest_gap:
            if not (sensor is Sensor.GYROSCOPE and self._grid.deaf):
                self._reports.add(t, sensor, TroubleKind.GAP, f"{t - last:.3f} s without a sample")
            self.dead_reckoning.pause(t - last, self.options.pause_speed)
            self._restart()
        self._last_motion[sensor] = t

    def _scale(self, t: float, norm: float, guard: UnitGuard, sensor: Sensor) -> float | None:
        if guard.observe(norm):
            if guard.factor is None:
                self._reports.add(t, sensor, TroubleKind.IMPLAUSIBLE, "no known unit explains the readings")
            elif guard.factor != 1.0:
                self._reports.add(t, sensor, TroubleKind.UNITS, f"taken times {guard.factor:g}")
        factor = guard.scale(norm)
        if factor is None:
            self._reports.add(t, sensor, TroubleKind.IMPLAUSIBLE, "beyond what can be")
        return factor

    def _move(self, t: float, force: Vector, turning: Vector, events: list[Event]) -> None:
        """One tick of the grid: force, m/s^2, and angular velocity, rad/s, in phone axes."""
        orientation = self._orientation
        orientation.update(turning, force)
        x, y, z = force
        norm = math.sqrt(x * x + y * y + z * z)
        vertical = orientation.vertical(force) - G
        surroundings = self._surroundings
        turn_rate = orientation.vertical(turning)
        events += surroundings.move(t, force, turning, vertical, turn_rate)
        if surroundings.due:
            climb = self._height.climb(t)
            events += surroundings.moment(t, self._gait.stepping, climb)
            # Legs alone are too often mistaken, in a hand above all: lengths are not left to them.
            self._gait.on_stairs = climb is not None and surroundings.on_stairs
        for pace in self._gait.update(t, norm, vertical, orientation.forward()):
            signature = self._compass(pace)
            events.append(self._step(pace))
            if signature is not None:
                events.append(MagneticSignature(*signature, self._position_variance()))

    def _compass(self, pace: Pace) -> tuple[float, tuple[tuple[float, float], ...]] | None:
        """The field since the last step; a profile of it, when one is due."""
        if not self._field_count:
            return None
        mean = self._field / self._field_count
        level = (float(mean[0]), float(mean[1]))
        self.dead_reckoning.compass(level, mean[2:8].reshape(2, 3), pace.length)
        self._field[:] = 0.0
        self._field_count = 0
        return self._profile.add(pace.t, pace.length, level, float(mean[8]))

    def _position_variance(self) -> float:
        return float(np.trace(self.dead_reckoning.covariance[:2, :2])) / 2.0

    def _step(self, pace: Pace) -> Step:
        reckoning = self.dead_reckoning
        before = self._level_heading
        change = 0.0 if before is None else wrapped(pace.level_heading - before)
        self._level_heading = pace.level_heading
        reckoning.step(pace.t, pace.level_heading, pace.length, pace.length_variance)
        scale, options = self.profile, self.options.dead_reckoning
        return Step(
            t=pace.t,
            length=pace.length * scale.scale,
            length_variance=pace.length_variance * scale.scale**2,
            scale_variance=scale.variance,
            heading_change=change,
            heading_change_variance=options.step_heading**2 + options.gyroscope_walk**2 * pace.interval,
            heading=reckoning.heading(pace.level_heading) if reckoning.heading_known else None,
            heading_variance=reckoning.heading_variance,
        )
