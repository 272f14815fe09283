"""A building of bare facts, for what is measured in it: two storeys, one wall, one slab, stairs."""

from __future__ import annotations

import numpy as np

from client_sim.synthetic.venue import Building, RadioObstacles, Storey
from client_sim.synthetic.worlds import World

STAIRS = ((0.0, 0.0, 0.0), (3.0, 0.0, 0.0), (8.4, 0.0, 3.06), (12.0, 0.0, 3.06))
ROUND = ((0.0, 0.0, 0.0), (10.0, 0.0, 0.0), (10.0, 8.0, 0.0), (2.0, 8.0, 0.0), (2.0, 1.0, 0.0))


def two_storeys() -> Building:
    """The wall stands at x = 20, the slab lies at z = 2.9."""
    places = {
        f"room {x} {y} {z}": (float(x), float(y), z)
        for z in (0.0, 3.06)
        for x in (-8, 0, 8, 16, 24)
        for y in (-8, 0, 8)
    }
    return Building(
        name="two storeys",
        world=World("two storeys", ()),
        storeys=(Storey("ground", 0.0, 2.8), Storey("first", 3.06, 2.8)),
        places=places,
        routes={"stairs": STAIRS, "round": ROUND},
        obstacles=RadioObstacles(
            np.array([[20.0, -10.0, 20.0, 10.0, 0.0, 6.0]]),
            np.array([6.0]),
            np.array([[-10.0, -10.0, 26.0, 10.0, 2.9]]),
            np.array([16.0]),
        ),
    )
