"""What a phone hands over: one dataclass a sensor, times in seconds on the phone's clock.

Axes are those of Android and of W3C's sensors: x right, y up along the screen, z out of it. An
accelerometer measures the specific force: lying on a table it reads +9.81 along z.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias


@dataclass(frozen=True, slots=True)
class Accelerometer:
    """Specific force, m/s^2, gravity included."""

    t: float
    x: float
    y: float
    z: float


@dataclass(frozen=True, slots=True)
class Gyroscope:
    """Angular velocity, rad/s, right-handed about the phone's axes."""

    t: float
    x: float
    y: float
    z: float


@dataclass(frozen=True, slots=True)
class Magnetometer:
    """Magnetic flux density, microtesla, with the phone's own calibration taken off or not."""

    t: float
    x: float
    y: float
    z: float


@dataclass(frozen=True, slots=True)
class Barometer:
    """Air pressure, hPa."""

    t: float
    pressure: float


@dataclass(frozen=True, slots=True)
class WifiScan:
    """One scan: (identifier of the access point, received strength in dBm) each."""

    t: float
    readings: tuple[tuple[str, float], ...]


@dataclass(frozen=True, slots=True)
class SatelliteFix:
    """A position from satellites; only its accuracy matters here (1 sigma, metres)."""

    t: float
    accuracy_m: float


VectorSample: TypeAlias = Accelerometer | Gyroscope | Magnetometer
Sample: TypeAlias = VectorSample | Barometer | WifiScan | SatelliteFix
