"""The lamps' light on the surfaces: baked once on coarse grids, packed in one picture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from client_sim.synthetic.worlds import LightMap, Quad

Floats = NDArray[np.float32]

SHELF = 2048
"""Width of the picture in which the light maps are packed."""


@dataclass(frozen=True, eq=False, slots=True)
class LightAtlas:
    """All light maps in one picture.

    Attributes:
        image: (H, W, 3) float32.
        origin, scale: (Q, 2) float32: a quad's light at texture coordinate p, in repetitions of the
            texture, is at pixel ``origin`` + ``scale`` p.
    """

    image: LightMap
    origin: Floats
    scale: Floats

    @staticmethod
    def of(quads: Sequence[Quad], tiles: NDArray[np.float64], size: NDArray[np.float64]) -> LightAtlas | None:
        """Pack the quads' maps; None where no quad has one."""
        if all(quad.light is None for quad in quads):
            return None
        plain = np.ones((2, 2, 3), dtype=np.float32)
        maps = [plain if quad.light is None else quad.light for quad in quads]
        order = sorted(range(len(maps)), key=lambda q: -maps[q].shape[0])
        corners = np.zeros((len(maps), 2))
        x = y = shelf = 0
        for q in order:
            rows, columns = maps[q].shape[:2]
            if x + columns > SHELF:
                x, y, shelf = 0, y + shelf, 0
            corners[q] = x, y
            x, shelf = x + columns, max(shelf, rows)
        image = np.ones((y + shelf, SHELF, 3), dtype=np.float32)
        for q, (left, top) in enumerate(corners.astype(int)):
            rows, columns = maps[q].shape[:2]
            image[top : top + rows, left : left + columns] = maps[q]
        cells = np.array([(m.shape[1] - 1, m.shape[0] - 1) for m in maps])
        scale = cells * tiles / size
        shift = np.array([quad.shift for quad in quads])
        return LightAtlas(image, (corners - shift * scale).astype(np.float32), scale.astype(np.float32))
