"""Walls, floors and ceilings of the office, as textures that repeat without a seam showing."""

from __future__ import annotations

import cv2
import numpy as np

from client_sim.synthetic.spaces import Materials
from client_sim.synthetic.textures import Colour, cloud, plaster, tiles, wood
from client_sim.synthetic.worlds import Texture

WALL_PIXELS = 110.0
FLOOR_PIXELS = 100.0


def _doubled(texture: Texture) -> Texture:
    """With its mirror image beside it: it repeats without a seam."""
    return np.concatenate([texture, texture[:, ::-1]], axis=1)


def painted_wall(
    rng: np.random.Generator,
    colour: Colour,
    height: float,
    *,
    skirting: bool = True,
    dado: Colour | None = None,
) -> tuple[Texture, tuple[float, float]]:
    """Paint with faint stains, a skirting board, and below ``dado`` height another colour."""
    wide = 7.0
    picture = plaster(rng, round(height * WALL_PIXELS), round(wide * WALL_PIXELS), colour)
    if dado is not None:
        top = round((height - 1.05) * WALL_PIXELS)
        lower = plaster(rng, picture.shape[0] - top, picture.shape[1], dado)
        picture[top:] = lower
        picture[top - 3 : top + 2] = 165
    for _ in range(7):
        # Scuffs and filled holes.
        x, y = int(rng.integers(0, picture.shape[1])), int(rng.integers(0, picture.shape[0]))
        tone = float(rng.uniform(0.82, 1.06))
        spot = tuple(float(min(255.0, c * tone)) for c in colour)
        cv2.ellipse(
            picture, (x, y), (int(rng.integers(2, 16)), 2), float(rng.uniform(0, 180)), 0, 360, spot, -1
        )
    if skirting:
        tall = round(0.09 * WALL_PIXELS)
        picture[-tall:] = wood(rng, tall, picture.shape[1], (96.0, 100.0, 104.0))
        picture[-tall - 1] = 90
    return _doubled(picture), (2 * wide, height)


def carpet(rng: np.random.Generator, colour: Colour) -> tuple[Texture, tuple[float, float]]:
    """Squares of carpet, every second turned."""
    side, count = round(0.5 * FLOOR_PIXELS), 8
    size = side * count
    shade = 5.0 * rng.normal(size=(size, size)) + 3.0 * cloud(rng, size, size, 40)
    each = rng.normal(scale=3.0, size=(count, count))
    each += 4.0 * ((np.arange(count)[:, None] + np.arange(count)[None]) % 2)
    shade += each.repeat(side, axis=0).repeat(side, axis=1)
    shade[::side] -= 9
    shade[:, ::side] -= 9
    picture = (np.asarray(colour) + shade[..., None]).clip(0, 255).astype(np.uint8)
    return picture, (size / FLOOR_PIXELS, size / FLOOR_PIXELS)


def stone(rng: np.random.Generator, colour: Colour, side: float = 0.6) -> tuple[Texture, tuple[float, float]]:
    """Floor tiles."""
    size = round(8 * side * FLOOR_PIXELS)
    return tiles(rng, size, size, round(side * FLOOR_PIXELS), colour), (8 * side, 8 * side)


def terrazzo(rng: np.random.Generator, height: int, width: int, colour: Colour) -> Texture:
    """Chips of stone in cement, polished."""
    picture = (np.asarray(colour) + 3.0 * rng.normal(size=(height, width, 1))).clip(0, 255).astype(np.uint8)
    for _ in range(height * width // 90):
        middle = (int(rng.integers(0, width)), int(rng.integers(0, height)))
        tone = float(rng.choice([0.62, 0.75, 1.2, 1.35]) * rng.uniform(0.9, 1.1))
        chip = tuple(float(min(255.0, c * tone)) for c in colour)
        axes = (int(rng.integers(1, 4)), int(rng.integers(1, 3)))
        cv2.ellipse(picture, middle, axes, float(rng.uniform(0, 180)), 0, 360, chip, -1, cv2.LINE_AA)
    return picture


def acoustic(rng: np.random.Generator) -> tuple[Texture, tuple[float, float]]:
    """A suspended ceiling of perforated panels, with a grille or a smoke detector now and then."""
    side, count = round(0.6 * 90), 10
    size = side * count
    shade = 3.0 * cloud(rng, size, size, 50)
    dots = (rng.random((size, size)) < 0.02).astype(np.float32)
    shade -= 50.0 * np.asarray(cv2.GaussianBlur(dots, (3, 3), 0.7))
    picture = (np.array([206.0, 210.0, 212.0]) + shade[..., None]).clip(0, 255).astype(np.uint8)
    for row in range(count):
        for column in range(count):
            middle = (column * side + side // 2, row * side + side // 2)
            kind = rng.random()
            if kind < 0.04:
                cv2.circle(picture, middle, side // 7, (225, 228, 230), -1, cv2.LINE_AA)
                cv2.circle(picture, middle, side // 12, (90, 92, 96), 2, cv2.LINE_AA)
            elif kind < 0.07:
                for k in range(-3, 4):
                    y = middle[1] + k * side // 9
                    cv2.line(
                        picture, (middle[0] - side // 3, y), (middle[0] + side // 3, y), (120, 122, 125), 2
                    )
    picture[::side] = picture[:, ::side] = 140
    return picture, (count * 0.6, count * 0.6)


def materials(
    rng: np.random.Generator,
    wall: Colour,
    ground: tuple[Texture, tuple[float, float]],
    height: float,
    trim: Colour,
    *,
    dado: Colour | None = None,
    skirting: bool = True,
) -> Materials:
    """The finishes of one kind of space."""
    wall_texture, wall_tile = painted_wall(rng, wall, height, skirting=skirting, dado=dado)
    above, above_tile = acoustic(rng)
    frame = plaster(rng, 24, 24, trim)
    return Materials(wall_texture, ground[0], above, frame, wall_tile, ground[1], above_tile)
