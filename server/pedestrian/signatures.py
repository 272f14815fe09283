"""What a place looks like to a phone: its magnetic profile along the way walked, its WiFi.

The strength of the level and of the vertical field do not depend on the compass, so a profile of them along
some metres can be compared between walks, phones and directions of walking.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class ProfileOptions:
    """Metres, by the walker's own unscaled steps.

    Attributes:
        spacing: between the samples of a profile.
        samples: of a profile.
        every: a profile is told after so many metres.
    """

    spacing: float = 0.5
    samples: int = 16
    every: float = 4.0


class MagneticProfile:
    """Collects the field step by step; memory: one profile's length of steps."""

    def __init__(self, options: ProfileOptions) -> None:
        self.options = options
        self._steps: deque[tuple[float, float, float, float]] = deque(maxlen=64)
        self._walked = 0.0
        self._told = 0.0

    def add(
        self, t: float, length: float, level: tuple[float, float], vertical: float
    ) -> tuple[float, tuple[tuple[float, float], ...]] | None:
        """The mean field over a step that ended at ``t``, microtesla.

        Returns:
            When one is due: the time at the profile's middle, and strengths of the level and the vertical
            field, oldest first.
        """
        options = self.options
        self._walked += length
        self._steps.append((self._walked - 0.5 * length, t, math.hypot(*level), vertical))
        span = (options.samples - 1) * options.spacing
        if self._walked - self._told < options.every or self._steps[-1][0] - self._steps[0][0] < span:
            return None
        self._told = self._walked
        at, times, level_field, vertical_field = np.array(self._steps).T
        grid = at[-1] - span + options.spacing * np.arange(options.samples)
        rows = zip(
            np.interp(grid, at, level_field).tolist(),
            np.interp(grid, at, vertical_field).tolist(),
            strict=True,
        )
        return float(np.interp(at[-1] - 0.5 * span, at, times)), tuple(rows)


def wifi_vector(readings: tuple[tuple[str, float], ...], names: dict[str, int]) -> Array:
    """Unit vector of a scan, (len(names),), over the access points that ``names`` numbers; zeros if none.

    A reading counts from -95 dBm, which is as good as nothing, to -35 dBm, which is beside it.
    """
    vector = np.zeros(len(names))
    for name, strength in readings:
        if name in names and math.isfinite(strength):
            vector[names[name]] = min(1.0, max(0.0, (strength + 95.0) / 60.0))
    size = float(np.linalg.norm(vector))
    return vector / size if size > 0.0 else vector


def profile_vector(profile: tuple[tuple[float, float], ...]) -> Array:
    """(2 N,), microtesla: the level field along the way, then the vertical one."""
    return np.array(profile).T.ravel()
