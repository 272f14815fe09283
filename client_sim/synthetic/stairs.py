"""A staircase with two flights and a landing half-way, in a well of its own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from client_sim.synthetic.lamps import Lamp, lit
from client_sim.synthetic.worlds import Quad, Texture

Array = NDArray[np.float64]
Point3 = tuple[float, float, float]

PARAPET_M = 0.95
"""Height of the parapets above the line of the nosings and above landings."""

SLAB_M = 0.2
"""Thickness of landings and flights."""


@dataclass(frozen=True, eq=False, slots=True)
class StairMaterials:
    """Textures: steps, landings, what rises, parapets, undersides, handrails."""

    tread: Texture
    landing: Texture
    riser: Texture
    parapet: Texture
    under: Texture
    rail: Texture


@dataclass(frozen=True, slots=True)
class Staircase:
    """Two flights side by side: up in direction ``ahead`` to the landing, turn left, and back up.

    In the staircase's own coordinates, x ahead and y left, the entrance is x in 0 .. ``entry`` at
    height 0; the first flight is y in 0 .. ``flight``, the second the last ``flight`` metres of
    ``width``; the upper landing is above the entrance.

    Attributes:
        corner: world (x, y, z) of the own origin.
        ahead: world direction (x, y) of the own x axis, a unit vector along a world axis.
    """

    corner: Point3
    ahead: tuple[float, float]
    rise: float = 3.2
    steps: int = 20
    tread: float = 0.28
    entry: float = 1.4
    landing: float = 1.4
    flight: float = 1.2
    width: float = 2.6

    @property
    def riser(self) -> float:
        """Height of one step."""
        return self.rise / self.steps

    @property
    def run(self) -> float:
        """Length of one flight on the ground."""
        return self.tread * (self.steps // 2 - 1)

    @property
    def length(self) -> float:
        """Length of the well."""
        return self.entry + self.run + self.landing

    def world(self, x: float, y: float, z: float) -> Point3:
        """Own coordinates to world coordinates."""
        ax, ay = self.ahead
        return (
            self.corner[0] + ax * x - ay * y,
            self.corner[1] + ay * x + ax * y,
            self.corner[2] + z,
        )

    def route(self) -> tuple[Point3, ...]:
        """Floor points from the entrance to the upper landing.

        The feet go along the nosings: half a riser above the middles of the treads. On the landing
        they go round in half a circle.
        """
        up, down = self.flight / 2, self.width - self.flight / 2
        half = self.rise / 2
        near, far = self.entry - self.tread / 2, self.entry + self.run + self.tread / 2
        middle, radius = (up + down) / 2, (down - up) / 2
        angles = np.linspace(-np.pi / 2, np.pi / 2, 9)[1:-1]
        local = (
            (self.entry / 2, up, 0.0),
            (near, up, 0.0),
            (far, up, half),
            *((far + radius * float(np.cos(a)), middle + radius * float(np.sin(a)), half) for a in angles),
            (far, down, half),
            (near, down, self.rise),
            (self.entry / 2, down, self.rise),
        )
        return tuple(self.world(*point) for point in local)

    def floor_height(self, x: float, y: float, upper: bool = False) -> float:
        """Height above the entrance of what one stands on at own (x, y); ``upper`` chooses the landing."""
        if x < self.entry:
            return self.rise if upper else 0.0
        if x > self.entry + self.run:
            return self.rise / 2
        step = int((x - self.entry) / self.tread) + 1
        return step * self.riser if y < self.width / 2 else self.rise - step * self.riser

    def quads(self, materials: StairMaterials, lamps: Sequence[Lamp]) -> list[Quad]:
        """All surfaces but the walls of the well."""
        found: list[Quad] = []
        half, count = self.rise / 2, self.steps // 2
        x0, x1 = self.entry, self.entry + self.run
        a1, b0 = self.flight, self.width - self.flight

        def add(corner: Point3, across: Point3, down: Point3, texture: Texture, factor: float = 1.0) -> None:
            found.append(lit(self._quad(corner, across, down, texture), lamps, factor))

        for k in range(count):
            x, z = x0 + k * self.tread, k * self.riser
            add((x, a1, z + self.riser), (0, -a1, 0), (0, 0, -self.riser), materials.riser, 0.85)
            if k < count - 1:
                add((x + self.tread, a1, z + self.riser), (0, -a1, 0), (-self.tread, 0, 0), materials.tread)
            x, z = x1 - k * self.tread, half + k * self.riser
            add((x, b0, z + self.riser), (0, self.flight, 0), (0, 0, -self.riser), materials.riser, 0.85)
            if k < count - 1:
                add(
                    (x - self.tread, b0, z + self.riser),
                    (0, self.flight, 0),
                    (self.tread, 0, 0),
                    materials.tread,
                )
        wide, far = self.width, self.length
        add((far, wide, half), (0, -wide, 0), (x1 - far, 0, 0), materials.landing)
        add((x1, wide, half - SLAB_M), (0, -wide, 0), (far - x1, 0, 0), materials.under, 0.6)
        add((x1, wide, half), (0, -(wide - a1), 0), (0, 0, -SLAB_M), materials.under, 0.7)
        add((x0, wide, self.rise), (0, -wide, 0), (-x0, 0, 0), materials.landing)
        add((0, wide, self.rise - SLAB_M), (0, -wide, 0), (x0, 0, 0), materials.under, 0.6)
        found.extend(self._flight_under(materials, lamps))
        found.extend(self._parapets(materials, lamps))
        return found

    def _quad(self, corner: Point3, across: Point3, down: Point3, texture: Texture) -> Quad:
        origin = np.array(self.world(0, 0, 0))
        return Quad(
            np.array(self.world(*corner)),
            np.array(self.world(*across)) - origin,
            np.array(self.world(*down)) - origin,
            texture,
        )

    def _flight_under(self, materials: StairMaterials, lamps: Sequence[Lamp]) -> list[Quad]:
        """The slope below the second flight."""
        half = self.rise / 2
        x0, x1 = self.entry, self.entry + self.run
        corner = (x0, self.width, self.rise - SLAB_M)
        quad = self._quad(corner, (0, -self.flight, 0), (x1 - x0, 0, -half), materials.under)
        return [lit(quad, lamps, 0.6)]

    def _parapets(self, materials: StairMaterials, lamps: Sequence[Lamp]) -> list[Quad]:
        """Walls breast-high along both flights' inner sides and before the upper landing's edge."""
        half = self.rise / 2
        x0, x1 = self.entry, self.entry + self.run
        a1, b0 = self.flight, self.width - self.flight
        texture, rail, high = materials.parapet, materials.rail, PARAPET_M
        up, down = (x1 - x0, 0.0, half), (x0 - x1, 0.0, -half)
        fall, climb = (x1 - x0, 0.0, -half), (x0 - x1, 0.0, half)
        deep, edge = half + high + SLAB_M, SLAB_M + 0.1
        middle = (a1 + b0) / 2
        thick, top = middle - a1, self.rise + high
        lip, grip = x0 - 0.06, 0.06
        wall = self.width - grip
        pieces = [
            # Along the first flight, closed down to the ground: both faces, the top, the lower end.
            self._quad((x0, a1, high), up, (0, 0, -deep), texture),
            self._quad((x1, middle, half + high), down, (0, 0, -deep), texture),
            self._quad((x0, middle, high), up, (0, -thick, 0), rail),
            self._quad((x0, middle, high), (0, -thick, 0), (0, 0, -high), texture),
            # Along the second flight, down to its underside.
            self._quad((x0, middle, top), fall, (0, 0, -high - edge), texture),
            self._quad((x1, b0, half + high), climb, (0, 0, -high - edge), texture),
            self._quad((x0, b0, top), fall, (0, -thick, 0), rail),
            # Handrails on the walls of the well: front and top.
            self._quad((x1, grip, half + high), down, (0, 0, -0.06), rail),
            self._quad((x0, grip, high), up, (0, -grip, 0), rail),
            self._quad((x0, wall, top), fall, (0, 0, -0.06), rail),
            self._quad((x0, self.width, top), fall, (0, -grip, 0), rail),
            # Both ends on the landing.
            self._quad((x1, a1, half + high), (0, b0 - a1, 0), (0, 0, -high), texture),
            # Before the edge of the upper landing.
            self._quad((x0, 0, top), (0, b0, 0), (0, 0, -high - SLAB_M), texture),
            self._quad((lip, b0, top), (0, -b0, 0), (0, 0, -high), texture),
            self._quad((x0, b0, top), (0, -b0, 0), (lip - x0, 0, 0), rail),
            self._quad((x0, b0, top), (lip - x0, 0, 0), (0, 0, -high), texture),
        ]
        return [lit(piece, lamps) for piece in pieces]
