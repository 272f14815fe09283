"""The synthetic building as textured rectangles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Texture = NDArray[np.uint8]


@dataclass(frozen=True, eq=False, slots=True)
class Quad:
    """A textured rectangle, seen from its front only.

    Attributes:
        corner: (3,) the upper left corner as seen from the front, metres.
        across: (3,) from there to the upper right corner.
        down: (3,) from there to the lower left corner, perpendicular to ``across``.
        texture: (h, w, 3) uint8, BGR; rows run down, columns across.
    """

    corner: Array
    across: Array
    down: Array
    texture: Texture

    @property
    def normal(self) -> Array:
        """(3,) unit vector towards those who see the front."""
        n = np.cross(self.down, self.across)
        return np.asarray(n / np.linalg.norm(n))

    @property
    def size(self) -> tuple[float, float]:
        """Width and height in metres."""
        return float(np.linalg.norm(self.across)), float(np.linalg.norm(self.down))

    def point(self, across: float, down: float) -> Array:
        """The world point at so many metres from the upper left corner, (3,)."""
        width, height = self.size
        return np.asarray(self.corner + self.across * (across / width) + self.down * (down / height))


@dataclass(frozen=True, eq=False, slots=True)
class World:
    """A building.

    Attributes:
        name: the world's name in ``meta.json``.
        quads: all surfaces.
    """

    name: str
    quads: tuple[Quad, ...]


def wall(start: ArrayLike, end: ArrayLike, bottom: float, top: float, texture: Texture) -> Quad:
    """An upright rectangle over the ground line start -> end (2,), seen from the left of that line."""
    a, b = np.asarray(start, dtype=np.float64), np.asarray(end, dtype=np.float64)
    across = np.append(a - b, 0.0)
    return Quad(np.append(b, top), across, np.array([0.0, 0.0, bottom - top]), texture)


def floor(low: ArrayLike, high: ArrayLike, z: float, texture: Texture) -> Quad:
    """A level rectangle between two corners (2,), seen from above."""
    (x0, y0), (x1, y1) = np.asarray(low, dtype=np.float64), np.asarray(high, dtype=np.float64)
    return Quad(np.array([x0, y1, z]), np.array([x1 - x0, 0, 0]), np.array([0, y0 - y1, 0]), texture)


def ceiling(low: ArrayLike, high: ArrayLike, z: float, texture: Texture) -> Quad:
    """A level rectangle between two corners (2,), seen from below."""
    (x0, y0), (x1, y1) = np.asarray(low, dtype=np.float64), np.asarray(high, dtype=np.float64)
    return Quad(np.array([x0, y0, z]), np.array([x1 - x0, 0, 0]), np.array([0, y1 - y0, 0]), texture)
