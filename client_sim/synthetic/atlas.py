"""All textures of a world in one picture, prefiltered for every size they can appear in.

Each texture is stored as a ripmap: halved ``i`` times across and ``j`` times down for all i, j.
A wall seen at a grazing angle is then filtered along the direction in which it is squeezed, and only
there, so that its picture neither flickers nor blurs. One lookup a pixel suffices.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from client_sim.synthetic.worlds import Texture

LEVELS = 6
"""Times a texture is halved in each direction, the original included."""

GUTTER = 2
"""Border pixels around each level, repeated or, of a texture that tiles, those of the other side:
interpolation must not reach a neighbour's texture."""

MAX_SIDE = 32000
"""OpenCV's remap addresses pixels with 15 bits."""


@dataclass(frozen=True, eq=False, slots=True)
class Atlas:
    """The packed textures.

    Attributes:
        image: (H, W, 3) uint8.
        origin: (Q, LEVELS, LEVELS, 2) float32: x, y of the upper left edge of texture q at (i across,
            j down), in integer-centre pixels (the edge of pixel 0 is at -0.5).
        scale: (Q, LEVELS, LEVELS, 2) float32: pixels of that level for a whole texture.
    """

    image: Texture
    origin: NDArray[np.float32]
    scale: NDArray[np.float32]


def _halved(size: int, times: int) -> int:
    return max(1, size >> times)


def build_atlas(textures: Sequence[Texture], tiled: Sequence[bool] | None = None) -> Atlas:
    """Pack textures (h, w, 3), each with its ripmap; ``tiled`` says which are repeated.

    Raises:
        ValueError: a texture is too wide, or all together are too many.
    """
    sides = [
        [sum(_halved(t.shape[axis], k) + 2 * GUTTER for k in range(LEVELS)) for axis in (1, 0)]
        for t in textures
    ]
    width = max(8192, *(side[0] for side in sides))
    corners: dict[int, tuple[int, int]] = {}
    x = y = shelf = 0
    for q in sorted(range(len(textures)), key=lambda q: -sides[q][1]):
        if x + sides[q][0] > width:
            x, y, shelf = 0, y + shelf, 0
        corners[q] = (x, y)
        x, shelf = x + sides[q][0], max(shelf, sides[q][1])
    height = y + shelf
    if width > MAX_SIDE or height > MAX_SIDE:
        raise ValueError(
            f"textures need a picture of {width}x{height}, at most {MAX_SIDE} a side is possible"
        )
    image = np.zeros((height, width, 3), dtype=np.uint8)
    origin = np.zeros((len(textures), LEVELS, LEVELS, 2), dtype=np.float32)
    scale = np.zeros_like(origin)
    for q, texture in enumerate(textures):
        border = cv2.BORDER_WRAP if tiled is not None and tiled[q] else cv2.BORDER_REPLICATE
        x = corners[q][0]
        for i in range(LEVELS):
            y = corners[q][1]
            w = _halved(texture.shape[1], i)
            squeezed = cv2.resize(texture, (w, texture.shape[0]), interpolation=cv2.INTER_AREA)
            for j in range(LEVELS):
                h = _halved(texture.shape[0], j)
                level = cv2.resize(squeezed, (w, h), interpolation=cv2.INTER_AREA)
                image[y : y + h + 2 * GUTTER, x : x + w + 2 * GUTTER] = cv2.copyMakeBorder(
                    level, GUTTER, GUTTER, GUTTER, GUTTER, border
                )
                origin[q, i, j] = x + GUTTER - 0.5, y + GUTTER - 0.5
                scale[q, i, j] = w, h
                y += h + 2 * GUTTER
            x += w + 2 * GUTTER
    return Atlas(image, origin, scale)
