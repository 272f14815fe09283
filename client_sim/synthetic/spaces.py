"""Rooms and corridors as rectangles, with doorways between them, closed doors, and what hangs on walls.

A space is closed by its own four walls, so that walls have a thickness: the gap to the space next door.
Sides are named by the compass, north being +y; places along a side are the coordinate along it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np

from client_sim.synthetic.lamps import Lamp, lit
from client_sim.synthetic.worlds import Quad, Texture, ceiling, floor, wall

SIDES = ("south", "east", "north", "west")
OPPOSITE = {"south": "north", "north": "south", "east": "west", "west": "east"}

RECESS_M = 0.1
"""How deep a closed door stands in its wall."""

TRIM_M = 0.07
"""Width of a door's frame on the wall."""


@dataclass(frozen=True, eq=False, slots=True)
class Materials:
    """Textures of a space; each repeats after so many metres across and down.

    Wall textures are as tall as the walls, so that their skirting is at the floor.
    """

    wall: Texture
    floor: Texture
    ceiling: Texture
    trim: Texture
    wall_tile: tuple[float, float]
    floor_tile: tuple[float, float]
    ceiling_tile: tuple[float, float]


@dataclass(frozen=True, slots=True)
class Hole:
    """A rectangle without wall: from and to along the side, bottom and top above the world's zero."""

    start: float
    end: float
    bottom: float
    top: float


@dataclass(frozen=True, eq=False)
class Space:
    """One room or corridor.

    Attributes:
        low, high: corners (x, y).
        z, height: of its floor, and of its ceiling above it.
        lamps: that light it.
        holes: by side; filled by :func:`doorway` and :func:`closed_door`.
        hung: rectangles on its walls and in its doorways.
        covered: whether it has a floor and a ceiling of its own.
    """

    name: str
    low: tuple[float, float]
    high: tuple[float, float]
    z: float
    height: float
    materials: Materials
    lamps: Sequence[Lamp] = ()
    covered: bool = True
    holes: dict[str, list[Hole]] = field(default_factory=lambda: {side: [] for side in SIDES})
    hung: list[Quad] = field(default_factory=list)

    @property
    def top(self) -> float:
        """Height of the ceiling above the world's zero."""
        return self.z + self.height

    def extent(self, side: str) -> tuple[float, float]:
        """Where a side begins and ends, in the coordinate along it."""
        axis = 0 if side in ("south", "north") else 1
        return self.low[axis], self.high[axis]

    def line(self, side: str, inset: float = 0.0) -> float:
        """The coordinate across a side, ``inset`` metres into the space."""
        return {
            "south": self.low[1] + inset,
            "north": self.high[1] - inset,
            "west": self.low[0] + inset,
            "east": self.high[0] - inset,
        }[side]

    def strip(
        self,
        side: str,
        start: float,
        end: float,
        bottom: float,
        top: float,
        texture: Texture,
        inset: float = 0.0,
    ) -> Quad:
        """An upright rectangle parallel to a side, seen from inside."""
        across = self.line(side, inset)
        if side in ("south", "north"):
            a, b = (start, across), (end, across)
        else:
            a, b = (across, start), (across, end)
        # The inside is on the left of the line south -> east -> north -> west.
        first, second = (a, b) if side in ("south", "east") else (b, a)
        return wall(first, second, bottom, top, texture)

    def hang(
        self,
        side: str,
        at: float,
        middle: float,
        size: tuple[float, float],
        texture: Texture,
        *,
        depth: float = 0.012,
        light: float = 1.0,
    ) -> None:
        """Hang a picture, its middle ``at`` along a side and ``middle`` above the floor; width, height."""
        quad = self.strip(
            side,
            at - size[0] / 2,
            at + size[0] / 2,
            self.z + middle - size[1] / 2,
            self.z + middle + size[1] / 2,
            texture,
            depth,
        )
        self.hung.append(lit(quad, self.lamps, light))

    def quads(self) -> list[Quad]:
        """All its surfaces."""
        found = []
        tile = self.materials.wall_tile
        # Each space has cut its finishes from another part of the roll.
        cut = np.random.default_rng([ord(letter) for letter in self.name]).random((len(SIDES) + 2, 2))
        for number, side in enumerate(SIDES):
            start, end = self.extent(side)
            for hole in _around(self.holes[side], start, end, self.z, self.top):
                quad = self.strip(side, hole.start, hole.end, hole.bottom, hole.top, self.materials.wall)
                left = hole.end if side in ("south", "east") else hole.start
                sign = -1.0 if side in ("south", "east") else 1.0
                shift = (float(cut[number, 0]) + sign * left / tile[0], (self.top - hole.top) / tile[1])
                found.append(lit(replace(quad, tile=tile, shift=shift), self.lamps))
        if self.covered:
            x, y = self.low
            materials = self.materials
            for make, z, texture, size, part in (
                (floor, self.z, materials.floor, materials.floor_tile, cut[-2]),
                (ceiling, self.top, materials.ceiling, materials.ceiling_tile, cut[-1]),
            ):
                quad = make(self.low, self.high, z, texture)
                shift = (x / size[0] + float(part[0]), y / size[1] + float(part[1]))
                found.append(lit(replace(quad, tile=size, shift=shift), self.lamps))
        return found + self.hung


def _around(holes: Sequence[Hole], start: float, end: float, bottom: float, top: float) -> list[Hole]:
    """A wall without its holes, as few rectangles."""
    cuts = sorted({start, end, *(min(max(c, start), end) for h in holes for c in (h.start, h.end))})
    pieces = []
    for left, right in pairwise(cuts):
        if right - left < 1e-6:
            continue
        inside = sorted((h.bottom, h.top) for h in holes if h.start < right - 1e-6 and h.end > left + 1e-6)
        at = bottom
        for low, high in [*inside, (top, top)]:
            if low - at > 1e-6:
                pieces.append(Hole(left, right, at, low))
            at = max(at, high)
    return pieces


def _frame(space: Space, side: str, hole: Hole) -> None:
    """Trim around a hole, on the wall."""
    trim, size = space.materials.trim, TRIM_M
    for start, end, bottom, top in (
        (hole.start - size, hole.start, hole.bottom, hole.top + size),
        (hole.end, hole.end + size, hole.bottom, hole.top + size),
        (hole.start, hole.end, hole.top, hole.top + size),
    ):
        space.hung.append(lit(space.strip(side, start, end, bottom, top, trim, 0.018), space.lamps))


def _jambs(space: Space, side: str, hole: Hole, depth: float, ground: Texture | None) -> None:
    """The inside of a hole: both jambs, the lintel, and the threshold."""
    trim = space.materials.trim
    edge, back = space.line(side), space.line(side, -depth)
    low, high = min(edge, back), max(edge, back)
    along_x = side in ("south", "north")

    def point(along: float, across: float) -> tuple[float, float]:
        return (along, across) if along_x else (across, along)

    pieces = [
        wall(point(hole.start, a), point(hole.start, b), hole.bottom, hole.top, trim)
        for a, b in (((high, low) if along_x else (low, high)),)
    ] + [
        wall(point(hole.end, a), point(hole.end, b), hole.bottom, hole.top, trim)
        for a, b in (((low, high) if along_x else (high, low)),)
    ]
    corners = point(hole.start, low), point(hole.end, high)
    pieces.append(ceiling(*corners, hole.top, trim))
    if ground is not None:
        pieces.append(floor(*corners, hole.bottom, ground))
    space.hung.extend(lit(piece, space.lamps, 0.9) for piece in pieces)


def doorway(
    first: Space,
    side: str,
    second: Space,
    at: float,
    width: float,
    height: float = 2.1,
    *,
    z: float | None = None,
    framed: bool = True,
) -> None:
    """Open the wall between two spaces, on ``side`` of the first, around ``at``.

    Raises:
        ValueError: they are not side by side.
    """
    gap = abs(first.line(side) - second.line(OPPOSITE[side]))
    bottom = first.z if z is None else z
    if gap > 0.5:
        raise ValueError(f"{first.name} and {second.name} are {gap:.2f} m apart: no wall between them")
    hole = Hole(at - width / 2, at + width / 2, bottom, bottom + height)
    for space, where in ((first, side), (second, OPPOSITE[side])):
        space.holes[where].append(hole)
        if framed:
            _frame(space, where, hole)
    if gap > 1e-6:
        _jambs(first, side, hole, gap, first.materials.trim)


def closed_door(
    space: Space, side: str, at: float, leaf: Texture, width: float = 0.95, height: float = 2.1
) -> None:
    """A door nobody goes through, set back in the wall, with its frame."""
    hole = Hole(at - width / 2, at + width / 2, space.z, space.z + height)
    space.holes[side].append(hole)
    _frame(space, side, hole)
    _jambs(space, side, hole, RECESS_M, space.materials.trim)
    back = space.strip(side, hole.start, hole.end, hole.bottom, hole.top, leaf, -RECESS_M)
    space.hung.append(lit(back, space.lamps, 0.92))


def ceiling_lamps(
    low: tuple[float, float],
    high: tuple[float, float],
    top: float,
    *,
    apart: float = 2.6,
    power: float = 1.0,
    colour: tuple[float, float, float] = (1.0, 1.0, 1.0),
) -> tuple[Lamp, ...]:
    """Panels evenly over a rectangle."""
    counts = [max(1, round((b - a) / apart)) for a, b in zip(low, high, strict=True)]
    axes = [a + (np.arange(n) + 0.5) * (b - a) / n for a, b, n in zip(low, high, counts, strict=True)]
    return tuple(Lamp((float(x), float(y), top), power, colour) for x in axes[0] for y in axes[1])
