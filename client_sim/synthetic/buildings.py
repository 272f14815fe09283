"""Synthetic buildings from floor plans: walls hung with doors and posters, floors, ceilings, furniture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from client_sim.synthetic.textures import (
    Colour,
    Picture,
    door,
    hang,
    panels,
    plaster,
    poster,
    shelf,
    tiles,
    wood,
)
from client_sim.synthetic.worlds import Quad, Texture, World, ceiling, floor, wall

WALL_PIXELS = 200.0
"""Pixels a metre of walls and furniture."""

GROUND_PIXELS = 120.0
"""Pixels a metre of floors and ceilings."""

Point = tuple[float, float]


@dataclass(frozen=True, slots=True)
class Rectangle:
    """A part of the ground, metres."""

    low: Point
    high: Point


@dataclass(frozen=True, slots=True)
class Furniture:
    """A box that stands on the floor or on other boxes."""

    ground: Rectangle
    bottom: float
    top: float
    kind: str = "wood"


@dataclass(frozen=True, slots=True)
class FloorPlan:
    """One level of a building.

    Attributes:
        outline: corners of the walls, counter-clockwise seen from above: the inside is on the left.
        ground: rectangles that together cover the inside.
        height: of the ceiling above the floor.
    """

    outline: tuple[Point, ...]
    ground: tuple[Rectangle, ...]
    furniture: tuple[Furniture, ...] = ()
    height: float = 2.6


def build_world(name: str, plan: FloorPlan, rng: np.random.Generator) -> World:
    """Clothe a floor plan; the same plan and generator state give the same building."""
    quads: list[Quad] = []
    tint: Colour = (205.0, 212.0, 216.0)
    for start, end in zip(plan.outline, (*plan.outline[1:], plan.outline[0]), strict=True):
        length = float(np.hypot(end[0] - start[0], end[1] - start[1]))
        tone = float(rng.uniform(0.9, 1.04))
        colour = (tint[0] * tone, tint[1] * tone, tint[2] * tone)
        quads.append(wall(start, end, 0.0, plan.height, _wall_texture(rng, length, plan.height, colour)))
    for part in plan.ground:
        width, depth = (
            round((high - low) * GROUND_PIXELS) for low, high in zip(part.low, part.high, strict=True)
        )
        ground = tiles(rng, depth, width, round(0.6 * GROUND_PIXELS), (150.0, 158.0, 163.0))
        quads.append(floor(part.low, part.high, 0.0, ground))
        above = panels(rng, depth, width, round(0.6 * GROUND_PIXELS))
        quads.append(ceiling(part.low, part.high, plan.height, above))
    for piece in plan.furniture:
        quads.extend(_furniture(rng, piece))
    return World(name, tuple(quads))


def _wall_texture(rng: np.random.Generator, length: float, height: float, colour: Colour) -> Texture:
    """Plaster, a skirting board, and doors and posters at irregular places."""
    scale = WALL_PIXELS
    picture = plaster(rng, round(height * scale), round(length * scale), colour)
    skirting = round(0.09 * scale)
    picture[-skirting:] = wood(rng, skirting, picture.shape[1], (70.0, 82.0, 96.0))
    at = float(rng.uniform(0.15, 0.4))
    while at < length - 0.45:
        room = length - at - 0.1
        if rng.random() < 0.25 and room > 1.1:
            wide = 0.95
            leaf = door(rng, round(2.1 * scale), round(wide * scale))
            hang(picture, Picture(at, height - 2.1, leaf), scale)
        else:
            wide = min(room, float(rng.uniform(0.4, 1.15)))
            tall = float(rng.uniform(0.45, 1.1))
            top = float(rng.uniform(0.45, 1.35))
            print_ = poster(rng, round(min(tall, height - top - 0.3) * scale), round(wide * scale))
            hang(picture, Picture(at, top, print_), scale)
        at += wide + float(rng.uniform(0.15, 0.7))
    return picture


def _furniture(rng: np.random.Generator, piece: Furniture) -> Sequence[Quad]:
    (x0, y0), (x1, y1) = piece.ground.low, piece.ground.high
    around = ((x0, y0), (x0, y1), (x1, y1), (x1, y0))
    tall = max(2, round((piece.top - piece.bottom) * WALL_PIXELS))
    tone = float(rng.uniform(0.6, 1.2))
    quads = []
    for start, end in zip(around, (*around[1:], around[0]), strict=True):
        wide = max(2, round(float(np.hypot(end[0] - start[0], end[1] - start[1])) * WALL_PIXELS))
        if piece.kind == "shelf":
            texture = shelf(rng, tall, wide)
        elif piece.kind == "pillar":
            texture = plaster(rng, tall, wide, (178.0, 186.0, 192.0))
            if wide > 60:
                notice = poster(rng, round(0.3 * tall), round(0.7 * wide))
                hang(
                    texture,
                    Picture(0.15 * wide / WALL_PIXELS, 0.36 * tall / WALL_PIXELS, notice),
                    WALL_PIXELS,
                )
        else:
            texture = wood(rng, tall, wide, (75 * tone, 110 * tone, 150 * tone))
            inset = max(2, min(tall, wide) // 9)
            dark = (40 * tone, 62 * tone, 90 * tone)
            _outline(texture, inset, dark)
        quads.append(wall(start, end, piece.bottom, piece.top, texture))
    deep, wide = round((y1 - y0) * WALL_PIXELS), round((x1 - x0) * WALL_PIXELS)
    top = wood(rng, deep, wide, (80 * tone, 118 * tone, 160 * tone))
    if piece.kind == "wood" and min(deep, wide) > 80:
        paper = poster(rng, round(0.5 * deep), round(0.4 * wide))
        hang(top, Picture(0.3 * wide / WALL_PIXELS, 0.2 * deep / WALL_PIXELS, paper), WALL_PIXELS)
    quads.append(floor(piece.ground.low, piece.ground.high, piece.top, top))
    return quads


def _outline(texture: Texture, inset: int, colour: Colour) -> None:
    """A dark line around the inside of a panel."""
    inner = texture[inset:-inset, inset:-inset]
    if min(inner.shape[:2]) < 6:
        return
    inner[:3] = inner[-3:] = colour
    inner[:, :3] = inner[:, -3:] = colour


CORRIDOR_AND_ROOM = FloorPlan(
    outline=((0, 0), (8, 0), (8, 6), (13, 6), (13, 11), (6, 11), (6, 2), (0, 2)),
    ground=(
        Rectangle((0, 0), (8, 2)),
        Rectangle((6, 2), (8, 6)),
        Rectangle((6, 6), (13, 11)),
    ),
    furniture=(
        Furniture(Rectangle((3.2, 1.55), (4.4, 2.0)), 0.0, 0.85),
        Furniture(Rectangle((6.0, 3.6), (6.35, 4.0)), 0.0, 2.6, "pillar"),
        Furniture(Rectangle((7.55, 4.6), (8.0, 5.7)), 0.0, 1.5, "shelf"),
        Furniture(Rectangle((8.6, 9.9), (10.8, 11.0)), 0.0, 0.76),
        Furniture(Rectangle((9.2, 10.3), (9.9, 10.8)), 0.76, 1.25, "pillar"),
        Furniture(Rectangle((12.5, 7.2), (13.0, 9.0)), 0.0, 2.0, "shelf"),
        Furniture(Rectangle((10.2, 6.0), (11.4, 6.5)), 0.0, 1.0),
    ),
)
"""Two corridors and a room: 17 m of route with two turns."""
