"""The magnetic field inside a building: the earth's, bent by the steel in it.

Steel is a number of dipoles at fixed places, so that the same place disturbs every walk the same way;
a sum of dipoles is what a field outside its sources is (free of divergence and of curl).
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from client_sim.synthetic.venue import Building

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class SteelOptions:
    """How much the earth's field is disturbed.

    Attributes:
        earth: (x, y, z) of the undisturbed field in the world, microtesla: 48 at 64 degrees of inclination,
            as in the middle of Europe, and north away from the walls' direction.
        area: square metres of floor for each piece of steel.
        moment: median of the pieces' strengths, microtesla at 1 m beside one.
        spread: of the logarithm of the strengths.
        core: metres within which a piece's field no longer grows.
    """

    earth: tuple[float, float, float] = (18.2, 10.5, -43.1)
    area: float = 7.0
    moment: float = 14.0
    spread: float = 0.6
    core: float = 0.6


@dataclass(frozen=True, eq=False, slots=True)
class MagneticField:
    """A field in the world.

    Attributes:
        earth: (3,) microtesla.
        places: (D, 3) of the dipoles, metres.
        moments: (D, 3) microtesla metres cubed.
    """

    earth: Array
    places: Array = field(repr=False)
    moments: Array = field(repr=False)
    core: float = 0.6

    def at(self, points: Array) -> Array:
        """The field at points (N, 3), microtesla, (N, 3)."""
        away = points[:, None] - self.places[None]
        squared = (away**2).sum(axis=2) + self.core**2
        along = (away * self.moments).sum(axis=2)
        bent = 3.0 * away * (along / squared**2.5)[..., None] - self.moments / (squared**1.5)[..., None]
        return np.asarray(self.earth + bent.sum(axis=1))


def building_field(
    building: Building, rng: np.random.Generator, options: SteelOptions | None = None
) -> MagneticField:
    """Steel in the floors and walls of a building, drawn by the generator and by nothing of any walk."""
    options = options or SteelOptions()
    low, high = building_bounds(building)
    count = max(1, round(float(np.prod(high - low)) / options.area))
    places, moments = [], []
    for storey in building.storeys:
        ground = rng.uniform(low - 1.0, high + 1.0, size=(count, 2))
        # Reinforcement lies in the floor, pipes and beams hang below the ceiling, columns stand between.
        height = storey.z + rng.choice([-0.2, 0.3, 0.9, storey.height], size=count, p=[0.4, 0.2, 0.2, 0.2])
        direction = rng.normal(size=(count, 3))
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        strength = options.moment * np.exp(options.spread * rng.normal(size=count))
        places.append(np.column_stack([ground, height]))
        moments.append(direction * strength[:, None])
    return MagneticField(np.array(options.earth), np.vstack(places), np.vstack(moments), options.core)


def building_bounds(building: Building) -> tuple[Array, Array]:
    """Corners (2,) and (2,) of the ground that a building's places and ways take up, metres."""
    points = [*building.places.values(), *(point for way in building.routes.values() for point in way)]
    ground = np.asarray(points, dtype=np.float64)[:, :2]
    return ground.min(axis=0), ground.max(axis=0)
