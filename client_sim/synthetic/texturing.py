"""The colour of each pixel, once it is known which surface it sees: filtered texture times lamps' light."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from client_sim.synthetic.atlas import LEVELS, build_atlas
from client_sim.synthetic.lightmaps import LightAtlas
from client_sim.synthetic.rasterising import Floats, Planes, RayGrid, Surfaces
from client_sim.synthetic.worlds import Quad

BAND = 24
"""Rows that are worked on at once: few enough that what is in between stays in the processor's cache."""


class Textures:
    """The quads' textures and light, looked up for pixels."""

    def __init__(self, quads: Sequence[Quad], surfaces: Surfaces) -> None:
        unique = {id(quad.texture): quad.texture for quad in quads}
        tiled = {id(quad.texture) for quad in quads if quad.tile is not None}
        self._atlas = build_atlas(list(unique.values()), [key in tiled for key in unique])
        self._light = LightAtlas.of(quads, surfaces.tiles, surfaces.size)
        rank = {key: LEVELS**2 * k for k, key in enumerate(unique)}
        rows = [
            np.array([quad.texture.shape[1] for quad in quads]),
            np.array([quad.texture.shape[0] for quad in quads]),
            np.array([rank[id(quad.texture)] for quad in quads]),
            np.array([quad.tile is not None for quad in quads]),
        ]
        if self._light is not None:
            rows += [*self._light.origin.T, *self._light.scale.T]
        self._constants = np.stack(rows).astype(np.float32)
        self._levels = np.concatenate(
            [table.reshape(-1, 2).T for table in (self._atlas.origin, self._atlas.scale)]
        )

    def look_up(
        self,
        surface: NDArray[np.int32],
        inverse_depth: Floats,
        planes: Sequence[Planes],
        grid: RayGrid,
        factor: float,
    ) -> NDArray[np.uint8]:
        """Colours (H, W, 3) times ``factor``; where ``surface`` is none of the quads they mean nothing.

        Args:
            surface: (H, W) quad q seen by way of ``planes[k]`` is surface k Q + q.
            inverse_depth: (H, W) 1 / z there.
        """
        each = [
            np.concatenate([p.inverse_depth.T[:2], p.across.T, p.down.T, self._constants]) for p in planes
        ]
        table = np.concatenate(each, axis=1)
        maps = np.empty((4, *grid.shape), dtype=np.float32)
        for top in range(0, grid.shape[0], BAND):
            rows = slice(top, min(top + BAND, grid.shape[0]))
            self._band(surface[rows], inverse_depth[rows], table, grid, rows, maps[:, rows])
        image = cv2.remap(self._atlas.image, maps[0], maps[1], cv2.INTER_LINEAR)
        if self._light is not None:
            light = cv2.remap(self._light.image, maps[2], maps[3], cv2.INTER_LINEAR)
            image = cv2.multiply(image, light, scale=factor, dtype=cv2.CV_8U)
        elif factor != 1.0:
            image = cv2.convertScaleAbs(image, alpha=factor)
        return np.asarray(image, dtype=np.uint8)

    def _band(
        self,
        surface: NDArray[np.int32],
        inverse_depth: Floats,
        table: Floats,
        grid: RayGrid,
        rows: slice,
        maps: Floats,
    ) -> None:
        """Where to look in the atlas and in the light's, maps (4, h, W), for some rows of the picture."""
        found = table.take(surface, axis=1, mode="clip")
        w_x, w_y = found[:2]
        with np.errstate(divide="ignore"):
            depth = np.where(inverse_depth > 0, np.float32(1.0) / inverse_depth, np.float32(1.0))
        x = grid.x if grid.x.shape[0] == 1 else grid.x[rows]
        y = grid.y[rows]
        pitch = [p if p.shape[0] == 1 else p[rows] for p in grid.pitch]
        places, level = [], found[10].astype(np.intp)
        for axis, stride in ((0, LEVELS), (1, 1)):
            f_x, f_y, f_1 = found[2 + 3 * axis : 5 + 3 * axis]
            place = (f_x * x + f_y * y + f_1) * depth
            # Texels of the finest level that a step of one pixel crosses.
            step_x, step_y = (f_x - place * w_x) * pitch[0], (f_y - place * w_y) * pitch[1]
            step = np.sqrt(step_x * step_x + step_y * step_y) * depth * found[8 + axis]
            # log2 by the float's exponent: rounds at 1.5 of each power of two.
            halvings = np.frexp(step * np.float32(4.0 / 3.0))[1] - 1
            level += stride * np.minimum(np.maximum(halvings, 0), LEVELS - 1)
            places.append(place)
        origin_x, origin_y, scale_x, scale_y = self._levels.take(level, axis=1, mode="clip")
        for axis, (origin, scale) in enumerate(((origin_x, scale_x), (origin_y, scale_y))):
            place = places[axis]
            if self._light is not None:
                np.add(found[12 + axis], found[14 + axis] * place, out=maps[2 + axis])
            place = place - np.floor(place) * found[11]
            np.add(origin, scale * np.minimum(np.maximum(place, 0), 1), out=maps[axis])
