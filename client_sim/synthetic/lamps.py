"""Lamps, and the soft light they leave on surfaces."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from client_sim.synthetic.worlds import LightMap, Quad

Array = NDArray[np.float64]

GRID_M = 0.5
"""Distance of the points at which light is worked out."""

SIZE_M = 0.7
"""Lamps are this large: the light beside them stays finite."""

BOUNCED = 0.52
"""Light from all sides, from walls that other light falls on, in rooms with lamps of power 1."""


@dataclass(frozen=True, slots=True)
class Lamp:
    """One lamp: a place (x, y, z), the light it gives, and its colour as factors of blue, green, red."""

    place: tuple[float, float, float]
    power: float = 1.0
    colour: tuple[float, float, float] = (1.0, 1.0, 1.0)


def illumination(lamps: Sequence[Lamp], points: Array, normals: Array) -> Array:
    """Light (..., 3) at points (..., 3) of surfaces with unit ``normals`` (..., 3): Lambert's law."""
    if not lamps:
        return np.full(points.shape, 0.5)
    colours = np.array([np.array(lamp.colour) * lamp.power for lamp in lamps])
    total = np.broadcast_to(BOUNCED * colours.mean(axis=0), points.shape).copy()
    for lamp, colour in zip(lamps, colours, strict=True):
        way = np.asarray(lamp.place) - points
        squared = (way * way).sum(axis=-1) + SIZE_M**2
        # A panel sends its light down, least along the ceiling.
        down = np.maximum(way[..., 2], 0.0) / np.sqrt(squared)
        facing = np.maximum((way * normals).sum(axis=-1), 0.0) / np.sqrt(squared)
        beside = 0.25 / (1.0 + squared)
        total += (2.4 * facing * (0.25 + 0.75 * down) / squared + beside)[..., None] * colour
    return total


def lit(quad: Quad, lamps: Sequence[Lamp], factor: float = 1.0) -> Quad:
    """The quad with the light of the lamps on it."""
    width, height = quad.size
    columns, rows = (max(2, int(np.ceil(side / GRID_M)) + 1) for side in (width, height))
    across = np.linspace(0, 1, columns)[None, :, None] * quad.across
    down = np.linspace(0, 1, rows)[:, None, None] * quad.down
    points = quad.corner + across + down
    light: LightMap = (factor * illumination(lamps, points, quad.normal)).astype(np.float32)
    return replace(quad, light=light)
