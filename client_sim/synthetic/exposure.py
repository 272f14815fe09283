"""From the light of a scene to a picture's grey levels: exposure, tone, lens, noise."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.uint8]
Floats = NDArray[np.float32]

REFERENCE_S = 1.0 / 60.0
"""Shutter time at which, with gain 1, a surface in nominal light has its texture's grey levels."""


@dataclass(frozen=True, slots=True)
class Light:
    """How a walk's pictures are lit and developed.

    Attributes:
        gain: brightness factor of the scene.
        gamma: exponent of the tone curve, above 1 darkens the middle tones.
        warmth: factor of red against blue.
        vignette: loss of light in the corners, 0 to 1.
        noise: standard deviation of the sensor noise at gain 1, grey levels.
    """

    gain: float = 1.0
    gamma: float = 1.0
    warmth: float = 1.0
    vignette: float = 0.15
    noise: float = 1.5


@dataclass(frozen=True, slots=True)
class ExposureSettings:
    """How long the shutter is open, and how much the sensor's signal is amplified."""

    time_s: float = REFERENCE_S
    gain: float = 1.0

    @property
    def factor(self) -> float:
        """What grey levels are multiplied with."""
        return self.time_s / REFERENCE_S * self.gain


@dataclass(frozen=True, slots=True)
class AutoExposureOptions:
    """How a phone exposes.

    Attributes:
        target: mean grey level it aims at.
        shortest_s, longest_s: shutter times.
        greatest_gain: amplification, used once the shutter is at its longest.
        settling_s: time constant of the way to a new exposure.
        latency: frames between a measurement and the first frame that knows of it.
    """

    target: float = 118.0
    shortest_s: float = 1.0 / 2000.0
    longest_s: float = 1.0 / 50.0
    greatest_gain: float = 6.0
    settling_s: float = 0.35
    latency: int = 2


class AutoExposure:
    """Follows the brightness of the pictures, late and within limits.

    Ask for :attr:`settings` before a frame, tell its brightness with :meth:`measure` after it.
    """

    def __init__(self, options: AutoExposureOptions | None = None) -> None:
        self.options = options or AutoExposureOptions()
        self._stops = 0.0
        self._pending: deque[float] = deque([0.0] * self.options.latency)

    @property
    def settings(self) -> ExposureSettings:
        """For the next frame."""
        options = self.options
        factor = float(np.exp(self._pending[0] if self._pending else self._stops))
        time = float(np.clip(factor * REFERENCE_S, options.shortest_s, options.longest_s))
        return ExposureSettings(time, float(np.clip(factor * REFERENCE_S / time, 1.0, options.greatest_gain)))

    def measure(self, brightness: float, dt: float) -> None:
        """Take in the mean grey level, 0 to 255, of a frame that lasted ``dt`` seconds."""
        options = self.options
        wrong = np.log(np.clip(options.target / max(brightness, 1.0), 0.25, 4.0))
        least = np.log(options.shortest_s / REFERENCE_S)
        most = np.log(options.longest_s / REFERENCE_S * options.greatest_gain)
        step = wrong * (1.0 - np.exp(-dt / options.settling_s))
        self._stops = float(np.clip(self._stops + step, least, most))
        self._pending.append(self._stops)
        self._pending.popleft()


def develop(colour: Image, light: Light, darkening: Floats) -> Image:
    """Tone, tint and vignette; ``darkening`` (H, W) is 0 in the middle and 1 in the corners."""
    levels = np.arange(256) / 255.0
    tint = np.sqrt(light.warmth)
    curve = np.stack([255.0 * light.gain * t * levels**light.gamma for t in (1.0 / tint, 1.0, tint)], axis=-1)
    table = curve.clip(0, 255).round().astype(np.uint8)[None]
    out = cv2.LUT(colour, table)
    if light.vignette > 0:
        factor = 1.0 - light.vignette * darkening
        out = cv2.multiply(out, cv2.merge([factor] * 3), dtype=cv2.CV_8U)
    return np.asarray(out, dtype=np.uint8)


def add_noise(image: Image, sigma: float, rng: np.random.Generator) -> Image:
    """Grey noise, drawn as a tile four times smaller and shifted: fast, and new in every picture."""
    height, width = image.shape[:2]
    tile = rng.normal(scale=sigma, size=(height // 2 + 1, width // 2 + 1)).astype(np.float32)
    noise = np.roll(np.tile(tile, (2, 2)), rng.integers(0, 64, size=2), axis=(0, 1))[:height, :width]
    return np.asarray(cv2.add(image, cv2.merge([noise] * 3), dtype=cv2.CV_8U), dtype=np.uint8)
