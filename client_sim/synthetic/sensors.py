"""What a phone's sensors read on a walk: the motion's own derivatives, with the faults of cheap sensors.

Phone axes are x right, y up, z out of the screen, of a phone held upright that films forward: the
camera's x, -y and -z.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from client_sim.synthetic.magnetics import MagneticField
from client_sim.synthetic.motion import Motion

Array = NDArray[np.float64]

RATE_HZ = 50.0
GRAVITY = 9.81
"""Metres a second squared."""

SEA_LEVEL_HPA = 1013.25
SCALE_HEIGHT_M = 8434.0
"""Pressure falls by e within so many metres: R T / (M g) of dry air at 15 degrees (ISO 2533)."""

PHONE_FROM_CAMERA = np.diag([1.0, -1.0, -1.0])


@dataclass(frozen=True, slots=True)
class SensorFaults:
    """Standard deviations: of noise for each reading, of biases for each phone and axis.

    Attributes:
        accelerometer_noise, accelerometer_bias: metres a second squared.
        gyroscope_noise, gyroscope_bias: radians a second.
        magnetometer_noise, magnetometer_bias: microtesla.
        barometer_noise, barometer_bias: hPa.
        weather: hPa that the pressure wanders in the root of a second.
        jitter: seconds by which readings are taken early or late.
    """

    accelerometer_noise: float = 0.06
    accelerometer_bias: float = 0.05
    gyroscope_noise: float = 0.006
    gyroscope_bias: float = 0.004
    magnetometer_noise: float = 0.45
    magnetometer_bias: float = 1.5
    barometer_noise: float = 0.02
    barometer_bias: float = 1.0
    weather: float = 0.0008
    jitter: float = 0.0008


@dataclass(frozen=True, eq=False, slots=True)
class Series:
    """One sensor's readings.

    Attributes:
        kind: as in ``sensors.jsonl``.
        times: (N,) seconds on the video's clock, increasing.
        values: (N, 3), of a barometer (N, 1).
    """

    kind: str
    times: Array
    values: Array = field(repr=False)


def measure(
    motion: Motion, magnetic: MagneticField, rng: np.random.Generator, faults: SensorFaults | None = None
) -> tuple[Series, ...]:
    """Accelerometer (gravity included), gyroscope, magnetometer and barometer of one phone on a walk.

    Args:
        rng: draws the phone's biases, the noise, and when the readings are taken.
    """
    faults = faults or SensorFaults()
    times = _reading_times(motion.duration, faults.jitter, rng)
    rotation = motion.rotations(times)
    positions = motion.positions(times)

    def in_phone(world: Array) -> Array:
        return np.asarray(np.einsum("nij,ni->nj", rotation, world) @ PHONE_FROM_CAMERA)

    def flawed(values: Array, noise: float, bias: float) -> Array:
        size = values.shape[1]
        return np.asarray(
            values + rng.normal(scale=bias, size=size) + rng.normal(scale=noise, size=values.shape)
        )

    force = in_phone(motion.accelerations(times) + np.array([0.0, 0.0, GRAVITY]))
    turning = motion.angular_velocities(times) @ PHONE_FROM_CAMERA
    return (
        Series("accelerometer", times, flawed(force, faults.accelerometer_noise, faults.accelerometer_bias)),
        Series("gyroscope", times, flawed(turning, faults.gyroscope_noise, faults.gyroscope_bias)),
        Series(
            "magnetometer",
            times,
            flawed(in_phone(magnetic.at(positions)), faults.magnetometer_noise, faults.magnetometer_bias),
        ),
        Series(
            "barometer",
            times,
            flawed(
                pressure(positions[:, 2])[:, None] + _weather(times, faults.weather, rng),
                faults.barometer_noise,
                faults.barometer_bias,
            ),
        ),
    )


def pressure(height: Array) -> Array:
    """Air pressure (N,) at heights (N,) above the world's origin, hPa."""
    return np.asarray(SEA_LEVEL_HPA * np.exp(-height / SCALE_HEIGHT_M))


def _reading_times(duration: float, jitter: float, rng: np.random.Generator) -> Array:
    due = np.arange(0.0, duration, 1.0 / RATE_HZ)
    late = rng.normal(scale=jitter, size=len(due)).clip(-3.0 * jitter, 3.0 * jitter)
    # Readings keep their order, and none is before the first picture.
    return np.asarray(np.maximum.accumulate(np.clip(due + late, 0.0, duration)))


def _weather(times: Array, per_root_second: float, rng: np.random.Generator) -> Array:
    steps = rng.normal(size=len(times)) * per_root_second * np.sqrt(np.diff(times, prepend=times[0]))
    return np.asarray(np.cumsum(steps)[:, None])
