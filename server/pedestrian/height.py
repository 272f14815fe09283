"""Height from air pressure."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np

from server.pedestrian.events import Height


@dataclass(frozen=True, slots=True)
class BarometerOptions:
    """Of the sensor and of the weather.

    Attributes:
        scale_height: metres within which pressure falls by e: R T / (M g) at 15 degrees (ISO 2533).
        noise: metres, standard deviation of one reading.
        weather: metres by which the weather moves the height in the root of a second.
        window: seconds over which the climb is measured; between two told heights passes ``every``.
        every: seconds.
    """

    scale_height: float = 8434.0
    noise: float = 0.25
    weather: float = 0.01
    window: float = 4.0
    every: float = 1.0


class HeightTracker:
    """Heights above the first reading and the rate of climb; memory: the readings of one window."""

    def __init__(self, options: BarometerOptions) -> None:
        self.options = options
        self._readings: deque[tuple[float, float]] = deque(maxlen=1024)
        self._reference: float | None = None
        self._begin = self._told = 0.0

    def update(self, t: float, pressure: float) -> Height | None:
        """One reading, hPa; a height when one is due."""
        options = self.options
        if self._reference is None:
            self._reference, self._begin, self._told = pressure, t, t
        height = -options.scale_height * math.log(pressure / self._reference)
        readings = self._readings
        readings.append((t, height))
        while t - readings[0][0] > options.window:
            readings.popleft()
        if t - self._told < options.every:
            return None
        self._told = t
        recent = [h for s, h in readings if t - s <= options.every]
        variance = options.noise**2 * (1.0 + 1.0 / len(recent)) + options.weather**2 * (t - self._begin)
        return Height(t, sum(recent) / len(recent), variance)

    def resume(self, t: float, unheard: float) -> None:
        """The clock was set anew, to ``t``, after ``unheard`` seconds: heights go on, the climb does not."""
        self._readings.clear()
        self._begin = t - unheard - (self._told - self._begin)
        self._told = t - self.options.every

    def climb(self, t: float) -> float | None:
        """Metres a second over the latest window, by least squares; ``None`` without readings enough."""
        readings = np.array(self._readings)
        if (
            len(readings) < 5
            or t - readings[-1, 0] > 1.0
            or np.ptp(readings[:, 0]) < 0.5 * self.options.window
        ):
            return None
        times = readings[:, 0] - readings[:, 0].mean()
        return float(times @ readings[:, 1] / (times @ times))
