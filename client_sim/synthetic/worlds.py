"""The synthetic building as the renderer sees it: textured parallelograms, ellipsoids, things.

A thing is what a person would name and count: a chair, a bag, somebody who passes. What has no thing
is the building itself.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Texture = NDArray[np.uint8]
LightMap = NDArray[np.float32]


@dataclass(frozen=True, eq=False, slots=True)
class Thing:
    """One instance of something that may move.

    Attributes:
        category: its COCO class name where COCO has one.
    """

    category: str


@dataclass(frozen=True, eq=False, slots=True)
class Quad:
    """A textured parallelogram, seen from its front only.

    Attributes:
        corner: (3,) the upper left corner as seen from the front, metres.
        across: (3,) from there to the upper right corner.
        down: (3,) from there to the lower left corner.
        texture: (h, w, 3) uint8, BGR; rows run down, columns across.
        tile: metres across and down after which the texture repeats; None where it spans the quad.
        shift: parts of a tile by which the texture is moved.
        light: (h, w, 3) factors of blue, green and red, at least 2 x 2, its ends at the quad's edges; None
            for 1 everywhere.
        mirror: True where the front shows the scene before it; the texture is then the glass's tint.
        thing: what it is part of.
    """

    corner: Array
    across: Array
    down: Array
    texture: Texture
    tile: tuple[float, float] | None = None
    shift: tuple[float, float] = (0.0, 0.0)
    light: LightMap | None = None
    mirror: bool = False
    thing: Thing | None = None

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
class Solid:
    """A textured ellipsoid.

    Attributes:
        centre: (3,) metres.
        axes: (3, 3) its half axes in the world as columns, perpendicular to each other.
        texture: (h, w, 3) uint8, BGR: columns run around the third axis from the first one's negative end,
            rows from the third axis' positive end to its negative one.
        light: factor of its brightness.
        thing: what it is part of.
    """

    centre: Array
    axes: Array
    texture: Texture
    light: float = 1.0
    thing: Thing | None = None


@dataclass(frozen=True, eq=False, slots=True)
class World:
    """A building.

    Attributes:
        name: the world's name in ``meta.json``.
        quads: all surfaces.
        solids: round parts of what stands in it.
    """

    name: str
    quads: tuple[Quad, ...]
    solids: tuple[Solid, ...] = ()


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
