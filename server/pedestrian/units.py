"""Units that are off by a known factor: found by what is physically possible, put right, reported."""

from __future__ import annotations

import statistics
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class PhysicalRange:
    """Between what a sensor's reading lies on Earth, and by what its unit may be off.

    Attributes:
        low, high: of the median reading, in our unit.
        limit: no single reading is beyond this, ...
        least: ... nor below this.
        factors: to our unit, the likeliest first.
    """

    low: float
    high: float
    limit: float
    factors: tuple[float, ...]
    least: float = 0.0


G = 9.81
ACCELERATION = PhysicalRange(7.0, 13.0, 250.0, (1.0, G, G / 1000.0, 1e-3, 1e3, G * 1e3, 1e6))
"""m/s^2; from g, mg, mm/s^2, km/s^2."""

MAGNETIC_FIELD = PhysicalRange(8.0, 250.0, 5000.0, (1.0, 1e-3, 1e3, 1e6, 100.0, 0.1))
"""Microtesla; from nT, mT, T, gauss, milligauss. Inside buildings the earth's 25 to 65 may be twice that."""

PRESSURE = PhysicalRange(300.0, 1100.0, 1200.0, (1.0, 0.01, 10.0, 1e3, 1e-3), least=150.0)
"""hPa; from Pa, kPa, bar."""


_PATIENCE = 4
"""So many times the first readings may be added to before no unit is said to explain them."""


class UnitGuard:
    """Decides by the median of the first readings' norms; decides anew when later ones leave the range."""

    def __init__(self, range_: PhysicalRange, count: int = 25) -> None:
        self.range = range_
        self.factor: float | None = None
        self._count = count
        self._norms: list[float] = []
        self._strays = 0

    def scale(self, norm: float) -> float | None:
        """What to multiply a reading by; ``None`` if it is of no use, or not yet."""
        bounds, factor = self.range, self.factor
        if factor is not None:
            return factor if bounds.least <= norm * factor <= bounds.limit else None
        likely = max(bounds.least, 0.35 * bounds.low) <= norm <= min(bounds.limit, 4.0 * bounds.high)
        return 1.0 if likely else None

    def observe(self, norm: float) -> bool:
        """Take a reading's norm, in its own unit.

        Returns:
            Whether a decision has just been taken: ``factor`` is new, or ``None`` if no unit explains it.
        """
        factor, bounds = self.factor, self.range
        if factor is not None:
            scaled = norm * factor
            stray = not max(bounds.least, 0.02 * bounds.low) <= scaled <= bounds.limit
            self._strays = self._strays + 1 if stray else max(0, self._strays - 1)
            if self._strays <= self._count:
                return False
            self.factor, self._strays = None, 0
        norms = self._norms
        norms.append(norm)
        if len(norms) % self._count:
            return False
        median = statistics.median(norms)
        self.factor = next((f for f in bounds.factors if bounds.low <= median * f <= bounds.high), None)
        # Half a second of a vigorous step is no fair sample; a few steps are.
        if self.factor is None and len(norms) < _PATIENCE * self._count:
            return False
        norms.clear()
        return True
