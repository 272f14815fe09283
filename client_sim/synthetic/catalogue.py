"""Things that stand in a building and may stand elsewhere tomorrow, and cupboards that do not."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from client_sim.synthetic.lamps import Lamp, illumination, lit
from client_sim.synthetic.prints import WHITE, lettering, whiteboard
from client_sim.synthetic.textures import Colour, cloud, shelf, wood
from client_sim.synthetic.worlds import Quad, Solid, Texture, Thing

Array = NDArray[np.float64]

PIXELS = 170.0
"""Pixels a metre of furniture."""


@dataclass(frozen=True, slots=True)
class Place:
    """Where something stands: a floor point, and the direction it faces (radians from the world's x)."""

    x: float
    y: float
    z: float
    heading: float = 0.0


class Piece:
    """Collects the parts of one thing; own axes are x ahead, y left, z up, metres."""

    def __init__(self, place: Place, lamps: Sequence[Lamp], category: str | None) -> None:
        c, s = np.cos(place.heading), np.sin(place.heading)
        self.turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        self.origin = np.array([place.x, place.y, place.z])
        self.lamps = lamps
        self.thing = None if category is None else Thing(category)
        self.quads: list[Quad] = []
        self.solids: list[Solid] = []

    def box(
        self,
        low: tuple[float, float, float],
        high: tuple[float, float, float],
        side: Texture,
        top: Texture | None = None,
        front: Texture | None = None,
    ) -> None:
        """An upright box; its front looks ahead."""
        (x0, y0, z0), (x1, y1, z1) = low, high
        down = (0.0, 0.0, z0 - z1)
        faces = (
            ((x1, y0, z1), (0.0, y1 - y0, 0.0), down, side if front is None else front),
            ((x0, y1, z1), (0.0, y0 - y1, 0.0), down, side),
            ((x0, y0, z1), (x1 - x0, 0.0, 0.0), down, side),
            ((x1, y1, z1), (x0 - x1, 0.0, 0.0), down, side),
            ((x0, y1, z1), (x1 - x0, 0.0, 0.0), (0.0, y0 - y1, 0.0), side if top is None else top),
            *([((x0, y0, z0), (x1 - x0, 0.0, 0.0), (0.0, y1 - y0, 0.0), side)] if z0 > 0.5 else []),
        )
        for corner, across, below, texture in faces:
            quad = Quad(
                self.origin + self.turn @ corner,
                self.turn @ across,
                self.turn @ below,
                texture,
                thing=self.thing,
            )
            self.quads.append(lit(quad, self.lamps, 0.95))

    def ball(
        self,
        middle: tuple[float, float, float],
        half: tuple[float, float, float],
        texture: Texture,
        tilt: Array | None = None,
    ) -> None:
        """An ellipsoid, its half axes along the own axes or turned by ``tilt`` (3, 3)."""
        axes = (np.eye(3) if tilt is None else tilt) * np.asarray(half)
        centre = self.origin + self.turn @ middle
        brightness = illumination(self.lamps, centre, np.array([0.0, 0.0, 1.0])).mean()
        self.solids.append(
            Solid(centre, self.turn @ axes, texture, float(np.clip(brightness, 0.4, 1.15)), self.thing)
        )


def _cloth(rng: np.random.Generator, height: int, width: int, colour: Colour) -> Texture:
    shade = 7 * cloud(rng, height, width, 9) + 4 * rng.normal(size=(height, width))
    return np.asarray((np.asarray(colour) + shade[..., None]).clip(0, 255).astype(np.uint8))


def _colour(rng: np.random.Generator, low: float = 30, high: float = 200) -> Colour:
    b, g, r = rng.uniform(low, high, size=3)
    return float(b), float(g), float(r)


def _metal(rng: np.random.Generator) -> Texture:
    return _cloth(rng, 32, 32, (120, 122, 124))


def chair(rng: np.random.Generator, place: Place, lamps: Sequence[Lamp], colour: Colour) -> Piece:
    """An office chair."""
    piece = Piece(place, lamps, "chair")
    cloth, metal = _cloth(rng, 64, 96, colour), _cloth(rng, 32, 32, (52, 52, 54))
    piece.ball((0, 0, 0.07), (0.3, 0.3, 0.05), metal)
    piece.ball((0, 0, 0.25), (0.035, 0.035, 0.24), metal)
    piece.box((-0.22, -0.23, 0.43), (0.24, 0.23, 0.5), cloth)
    piece.box((-0.27, -0.21, 0.55), (-0.2, 0.21, 1.0), cloth)
    return piece


def desk(
    rng: np.random.Generator,
    place: Place,
    lamps: Sequence[Lamp],
    size: tuple[float, float] = (0.8, 1.6),
    height: float = 0.74,
) -> Piece:
    """A table on two side panels, with papers on it; ``size`` ahead and across."""
    piece = Piece(place, lamps, "dining table")
    deep, wide = size
    tone = rng.uniform(0.85, 1.1)
    board = wood(rng, round(deep * PIXELS), round(wide * PIXELS), (120 * tone, 165 * tone, 200 * tone))
    for _ in range(int(rng.integers(1, 4))):
        row, column = (int(rng.uniform(0.1, 0.7) * side) for side in board.shape[:2])
        sheet = board[row : row + 50, column : column + 36]
        sheet[:] = 240
        sheet[6:-4:5, 5:-6] = 120
    leg = wood(rng, 120, 120, (96 * tone, 120 * tone, 140 * tone))
    edge = wood(rng, 8, 200, (110 * tone, 150 * tone, 185 * tone))
    half, side = deep / 2, wide / 2
    piece.box((-half, -side, height - 0.035), (half, side, height), edge, board)
    piece.box((-half + 0.05, -side + 0.04, 0), (half - 0.05, -side + 0.08, height - 0.035), leg)
    piece.box((-half + 0.05, side - 0.08, 0), (half - 0.05, side - 0.04, height - 0.035), leg)
    return piece


def screen(rng: np.random.Generator, place: Place, lamps: Sequence[Lamp]) -> Piece:
    """A monitor on a foot, on whatever is at ``place``."""
    piece = Piece(place, lamps, "tv")
    shown = np.full((100, 170, 3), 70, np.uint8)
    shown[:] = rng.uniform(40, 200, size=3).astype(np.uint8)
    for row in range(14, 90, 8):
        cv2.line(shown, (12, row), (int(rng.uniform(40, 155)), row), (225, 228, 230), 2)
    cv2.rectangle(shown, (0, 0), (169, 99), (30, 30, 30), 4)
    black = _cloth(rng, 32, 32, (38, 38, 40))
    piece.box((-0.02, -0.29, 0.12), (0.02, 0.29, 0.47), black, front=shown)
    piece.box((-0.06, -0.1, 0.0), (0.06, 0.1, 0.12), black)
    return piece


def plant(rng: np.random.Generator, place: Place, lamps: Sequence[Lamp], tall: float = 1.3) -> Piece:
    """A pot with large leaves."""
    piece = Piece(place, lamps, "potted plant")
    pot = _cloth(rng, 64, 64, _colour(rng, 90, 200))
    piece.ball((0, 0, 0.18), (0.19, 0.19, 0.26), pot)
    stem = _cloth(rng, 16, 16, (40, 70, 80))
    piece.ball((0, 0, 0.3 + 0.2 * tall), (0.02, 0.02, 0.25 * tall), stem)
    for _ in range(11):
        green = rng.uniform(70, 150)
        texture = _cloth(rng, 48, 48, (green * 0.45, green, green * rng.uniform(0.35, 0.7)))
        texture[:, 23:26] = (texture[:, 23:26] * 1.3).clip(0, 255).astype(np.uint8)
        around, up = rng.uniform(0, 2 * np.pi), rng.uniform(0.35, 1.25)
        way = np.array([np.cos(around) * np.cos(up), np.sin(around) * np.cos(up), np.sin(up)])
        side = np.array([-np.sin(around), np.cos(around), 0.0])
        tilt = np.stack([np.cross(side, way), side, way], axis=1)
        middle = np.array([0, 0, tall * rng.uniform(0.4, 0.85)]) + way * 0.24
        piece.ball(
            (float(middle[0]), float(middle[1]), float(middle[2])),
            (0.012, rng.uniform(0.06, 0.1), 0.27),
            texture,
            tilt,
        )
    return piece


def backpack(rng: np.random.Generator, place: Place, lamps: Sequence[Lamp]) -> Piece:
    """A bag somebody left."""
    piece = Piece(place, lamps, "backpack")
    colour = _colour(rng)
    cloth = _cloth(rng, 64, 96, colour)
    piece.ball((0, 0, 0.22), (0.13, 0.17, 0.24), cloth)
    piece.ball(
        (0.1, 0, 0.15), (0.07, 0.13, 0.12), _cloth(rng, 48, 64, (colour[0] * 0.7, colour[1] * 0.7, colour[2]))
    )
    return piece


def suitcase(rng: np.random.Generator, place: Place, lamps: Sequence[Lamp]) -> Piece:
    """A cabin trolley."""
    piece = Piece(place, lamps, "suitcase")
    colour = _colour(rng, 30, 190)
    shell = _cloth(rng, 110, 80, colour)
    shell[:, ::10] = (shell[:, ::10] * 0.7).astype(np.uint8)
    piece.box((-0.12, -0.19, 0.05), (0.12, 0.19, 0.6), shell)
    piece.box((-0.1, -0.1, 0.6), (-0.08, 0.1, 0.95), _metal(rng))
    return piece


def stand(rng: np.random.Generator, place: Place, lamps: Sequence[Lamp]) -> Piece:
    """A white board on a stand."""
    piece = Piece(place, lamps, "board")
    drawn = whiteboard(rng, 200, 240)
    piece.box((-0.015, -0.6, 0.85), (0.015, 0.6, 1.85), _metal(rng), front=drawn)
    for y in (-0.5, 0.5):
        piece.box((-0.02, y - 0.02, 0.04), (0.02, y + 0.02, 0.85), _metal(rng))
        piece.box((-0.25, y - 0.03, 0.0), (0.25, y + 0.03, 0.04), _metal(rng))
    return piece


def wet_floor(rng: np.random.Generator, place: Place, lamps: Sequence[Lamp]) -> Piece:
    """A yellow warning that stands in the way."""
    piece = Piece(place, lamps, "board")
    yellow = _cloth(rng, 90, 50, (40, 205, 235))
    lettering(yellow, "CAUTION", (0.08, 0.1, 0.92, 0.3), (20, 20, 20), 1)
    lettering(yellow, "WET FLOOR", (0.08, 0.65, 0.92, 0.82), (20, 20, 20), 1)
    piece.box((-0.1, -0.14, 0.0), (0.1, 0.14, 0.6), yellow, front=yellow)
    return piece


def couch(rng: np.random.Generator, place: Place, lamps: Sequence[Lamp], wide: float = 1.8) -> Piece:
    """A sofa."""
    piece = Piece(place, lamps, "couch")
    colour = _colour(rng, 50, 150)
    cloth = _cloth(rng, 90, 200, colour)
    cloth[:, 98:102] = (cloth[:, 98:102] * 0.6).astype(np.uint8)
    half = wide / 2
    piece.box((-0.42, -half, 0.0), (0.42, half, 0.42), cloth)
    piece.box((-0.45, -half, 0.42), (-0.22, half, 0.85), cloth)
    for side in (-1, 1):
        low, high = sorted((side * half, side * (half - 0.18)))
        piece.box((-0.22, low, 0.42), (0.42, high, 0.6), cloth)
    return piece


def bin_(rng: np.random.Generator, place: Place, lamps: Sequence[Lamp]) -> Piece:
    """A waste-paper bin."""
    piece = Piece(place, lamps, "bin")
    grey = _cloth(rng, 64, 64, (95, 96, 98))
    grey[8:12] = 190
    piece.box((-0.15, -0.15, 0), (0.15, 0.15, 0.45), grey, _cloth(rng, 32, 32, (45, 45, 45)))
    return piece


def extinguisher(rng: np.random.Generator, place: Place, lamps: Sequence[Lamp]) -> Piece:
    """A fire extinguisher on its hook."""
    piece = Piece(place, lamps, None)
    red = _cloth(rng, 64, 64, (35, 35, 190))
    red[26:40, 20:44] = WHITE
    red[28:38:3, 22:42] = 90
    piece.ball((0.1, 0, 0.6), (0.085, 0.085, 0.29), red)
    piece.ball((0.1, 0, 0.92), (0.04, 0.03, 0.06), _cloth(rng, 16, 16, (30, 30, 30)))
    return piece


def bookcase(
    rng: np.random.Generator, place: Place, lamps: Sequence[Lamp], size: tuple[float, float, float]
) -> Piece:
    """Shelves of books, screwed to the wall; size ahead, across, up."""
    piece = Piece(place, lamps, None)
    deep, wide, tall = size
    books = shelf(rng, round(tall * PIXELS), round(wide * PIXELS))
    side = wood(rng, round(tall * 80), round(deep * 120) + 8, (60.0, 88.0, 120.0))
    piece.box((-deep / 2, -wide / 2, 0), (deep / 2, wide / 2, tall), side, front=books)
    return piece


def cupboard(
    rng: np.random.Generator, place: Place, lamps: Sequence[Lamp], size: tuple[float, float, float]
) -> Piece:
    """A closed cupboard with two doors."""
    piece = Piece(place, lamps, None)
    deep, wide, tall = size
    tone = rng.uniform(0.8, 1.1)
    front = _cloth(rng, round(tall * PIXELS), round(wide * PIXELS), (176 * tone, 182 * tone, 186 * tone))
    middle = front.shape[1] // 2
    front[:, middle - 1 : middle + 2] = 70
    for column in (middle - 12, middle + 8):
        front[front.shape[0] // 2 - 14 : front.shape[0] // 2 + 14, column : column + 4] = 90
    cv2.rectangle(front, (0, 0), (front.shape[1] - 1, front.shape[0] - 1), (100, 104, 106), 3)
    side = _cloth(rng, 64, 64, (165 * tone, 170 * tone, 174 * tone))
    piece.box((-deep / 2, -wide / 2, 0), (deep / 2, wide / 2, tall), side, front=front)
    return piece
