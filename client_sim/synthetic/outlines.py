"""What stands upright in a world, cut at a height and seen from above."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from client_sim.synthetic.worlds import World

Array = NDArray[np.float64]


def outlines(world: World, z: float, *, movable: bool = True) -> Array:
    """Lines (W, 4), x0, y0, x1, y1, where upright surfaces meet the level ``z``, metres.

    Args:
        movable: whether things that may move count.
    """
    lines = []
    for quad in world.quads:
        upright = abs(quad.across[2]) < 1e-6 and np.linalg.norm(quad.down[:2]) < 1e-6
        below, above = sorted((quad.corner[2], quad.corner[2] + quad.down[2]))
        if upright and below <= z < above and (movable or quad.thing is None):
            lines.append([*quad.corner[:2], *(quad.corner + quad.across)[:2]])
    return np.array(lines, dtype=np.float64).reshape(-1, 4)


def clearance(lines: Array, points: Array) -> Array:
    """Metres from points (N, 2) to the nearest of the lines (W, 4), (N,)."""
    start, along = lines[:, :2], lines[:, 2:] - lines[:, :2]
    away = points[:, None] - start[None]
    part = (away * along).sum(axis=2) / np.maximum((along**2).sum(axis=1), 1e-12)
    apart = away - np.clip(part, 0.0, 1.0)[..., None] * along
    return np.asarray(np.linalg.norm(apart, axis=2).min(axis=1))
