"""A synthetic building as those who walk, measure and judge need it: storeys, places, routes, radio.

Points are (x, y, z) in metres, world z up. A route's points lie on the floor, under the walker's feet;
between two of them floor and feet go straight, so a stretch whose z changes is a flight of stairs.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from client_sim.synthetic.worlds import World

Array = NDArray[np.float64]
Point3 = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Storey:
    """One level: its floor's height, and its ceiling's height above that floor."""

    name: str
    z: float
    height: float


@dataclass(frozen=True, eq=False, slots=True)
class RadioObstacles:
    """What weakens radio.

    Attributes:
        walls: (W, 6) upright rectangles: x0, y0, x1, y1, bottom, top. A wall between two rooms has two
            faces and is here twice, with half its loss each.
        wall_loss: (W,) dB lost in crossing one.
        slabs: (S, 5) level rectangles between storeys: x0, y0, x1, y1, z.
        slab_loss: (S,) dB.
    """

    walls: Array
    wall_loss: Array
    slabs: Array
    slab_loss: Array


@dataclass(frozen=True, eq=False, slots=True)
class Building:
    """A building with what is known about it.

    Attributes:
        world: its surfaces, for the renderer.
        storeys: from the lowest up.
        places: floor points of rooms and other destinations by name.
        routes: floor points of ways through it by name; corners are not rounded.
    """

    name: str
    world: World
    storeys: tuple[Storey, ...]
    places: Mapping[str, Point3]
    routes: Mapping[str, tuple[Point3, ...]]
    obstacles: RadioObstacles

    def storey_of(self, z: float) -> int:
        """The storey of a point at height ``z``: the highest whose floor is not above it, at least 0.

        Half-way up a flight of stairs this is the lower storey.
        """
        return max((k for k, storey in enumerate(self.storeys) if storey.z <= z + 1e-6), default=0)
