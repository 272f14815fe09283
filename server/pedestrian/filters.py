"""Second-order low-pass filters that take a number and give a number."""

from __future__ import annotations

from scipy.signal import butter


class LowPass:
    """A Butterworth filter of second order, transposed direct form II; starts settled on its first value."""

    __slots__ = ("_a", "_b", "_started", "_z1", "_z2")

    def __init__(self, cutoff_hz: float, rate_hz: float) -> None:
        b, a = butter(2, cutoff_hz, fs=rate_hz)
        self._b = (float(b[0]), float(b[1]), float(b[2]))
        self._a = (float(a[1]), float(a[2]))
        self._z1 = self._z2 = 0.0
        self._started = False

    def __call__(self, x: float) -> float:
        b0, b1, b2 = self._b
        a1, a2 = self._a
        if not self._started:
            self._z1, self._z2 = x * (1.0 - b0), x * (b2 - a2)
            self._started = True
        y = b0 * x + self._z1
        self._z1 = b1 * x - a1 * y + self._z2
        self._z2 = b2 * x - a2 * y
        return y
