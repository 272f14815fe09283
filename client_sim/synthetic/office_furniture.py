"""What stands in the office: fixtures, furniture, and what comes and goes from day to day."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from client_sim.synthetic import catalogue
from client_sim.synthetic.catalogue import Piece, Place
from client_sim.synthetic.lamps import Lamp
from client_sim.synthetic.spaces import Space


@dataclass(frozen=True, slots=True)
class _Movable:
    """Something that may stand elsewhere on another day, within ``leeway`` metres.

    Attributes:
        place: on an ordinary day; its height is from the floor of the space.
    """

    make: Callable[[np.random.Generator, Place, Sequence[Lamp]], Piece]
    space: str
    place: Place
    leeway: float


def fixtures(spaces: dict[str, Space], seed: int) -> list[Piece]:
    """What is screwed to the building.

    Args:
        spaces: by name, with their lamps.
    """
    south, north, west, east = -np.pi / 2, np.pi / 2, np.pi, 0.0
    rng = np.random.default_rng([seed, 30])
    upstairs = spaces["library"].z
    a0, a1, b0 = spaces["A0"].lamps, spaces["A1"].lamps, spaces["B0"].lamps
    library, office, lobby = (spaces[name].lamps for name in ("library", "office", "lobby"))
    found = [
        catalogue.extinguisher(rng, Place(14.0, 1.6, 0.0, north), a0),
        catalogue.extinguisher(rng, Place(15.0, 1.6, upstairs, north), a1),
        catalogue.extinguisher(rng, Place(17.8, 10.0, 0.0, east), b0),
        catalogue.cupboard(rng, Place(17.38, 10.6, 0.0, west), office, (0.42, 1.6, 1.9)),
        catalogue.bookcase(rng, Place(10.2, 9.8, 0.0, north), office, (0.36, 1.4, 2.0)),
        catalogue.cupboard(rng, Place(0.5, 4.9, 0.0, south), lobby, (0.5, 0.9, 1.2)),
        catalogue.cupboard(rng, Place(3.6, 12.82, 0.0, north), spaces["meeting room"].lamps, (0.4, 1.0, 0.8)),
    ]
    for x in (10.2, 12.0, 13.8, 15.6):
        found.append(catalogue.bookcase(rng, Place(x, 9.8, upstairs, north), library, (0.36, 1.7, 2.1)))
    for x in (10.6, 12.6):
        found.append(catalogue.bookcase(rng, Place(x, 15.6, upstairs, south), library, (0.36, 1.7, 2.1)))
    return found


def _furniture() -> list[_Movable]:
    """The movable things of an ordinary day."""
    things: list[_Movable] = []
    south, north, west, east = -np.pi / 2, np.pi / 2, np.pi, 0.0

    def put(
        make: Callable[..., Piece],
        space: str,
        x: float,
        y: float,
        heading: float,
        leeway: float,
        z: float = 0.0,
        **options: object,
    ) -> None:
        things.append(
            _Movable(lambda r, p, lamps: make(r, p, lamps, **options), space, Place(x, y, z, heading), leeway)
        )

    blue, red = (130.0, 80.0, 50.0), (60.0, 60.0, 140.0)
    for x in (10.4, 13.6, 16.0):
        put(catalogue.desk, "office", x, 15.6, south, 0.0)
        put(catalogue.screen, "office", x + 0.1, 15.75, south, 0.15, 0.74)
        put(catalogue.chair, "office", x + 0.2, 16.35, south, 0.25, colour=blue)
    for x in (13.4, 15.4):
        put(catalogue.desk, "office", x, 11.3, north, 0.0)
        put(catalogue.screen, "office", x, 11.2, north, 0.15, 0.74)
        put(catalogue.chair, "office", x - 0.1, 10.45, north, 0.25, colour=blue)
    put(catalogue.plant, "office", 9.8, 16.6, 0.0, 0.1)
    put(catalogue.backpack, "office", 14.5, 10.7, 0.4, 0.5)
    put(catalogue.bin_, "office", 12.2, 16.6, 0.0, 0.3)
    put(catalogue.desk, "lobby", 4.9, 4.2, south, 0.0, size=(0.8, 1.8), height=1.05)
    put(catalogue.couch, "lobby", 3.9, 0.6, north, 0.2)
    put(catalogue.plant, "lobby", 5.6, 0.5, 0.0, 0.15, tall=1.5)
    put(catalogue.suitcase, "lobby", 2.6, 0.7, 0.6, 0.2)
    put(catalogue.plant, "A0", 19.6, 2.0, 0.0, 0.1)
    put(catalogue.bin_, "A0", 6.6, 3.5, 0.0, 0.15)
    put(catalogue.chair, "B0", 18.1, 16.3, 0.0, 0.2, colour=red)
    put(catalogue.bin_, "C0", 12.4, 9.1, 0.0, 0.1)
    put(catalogue.desk, "meeting room", 7.2, 15.0, west, 0.0, size=(1.2, 2.2))
    for y in (14.3, 15.0, 15.7):
        put(catalogue.chair, "meeting room", 8.3, y, west, 0.15, colour=red)
    put(catalogue.stand, "meeting room", 4.6, 16.5, south, 0.25)
    put(catalogue.plant, "A1", 19.6, 2.0, 0.0, 0.1)
    put(catalogue.bin_, "A1", 6.6, 3.5, 0.0, 0.15)
    put(catalogue.suitcase, "B1", 18.2, 16.2, 0.3, 0.2)
    put(catalogue.desk, "library", 15.6, 15.4, west, 0.0)
    put(catalogue.chair, "library", 16.5, 15.4, west, 0.3, colour=blue)
    put(catalogue.couch, "library", 10.4, 12.4, east, 0.2)
    return [replace(t, place=replace(t.place)) if t.space.endswith("1") else t for t in things]


NEWCOMERS: tuple[tuple[Callable[[np.random.Generator, Place, Sequence[Lamp]], Piece], str, Place], ...] = (
    (catalogue.wet_floor, "A0", Place(9.6, 1.95, 0.0, 0.3)),
    (catalogue.suitcase, "A0", Place(13.2, 3.5, 0.0, -1.4)),
    (catalogue.backpack, "B0", Place(18.1, 7.3, 0.0, 0.1)),
    (catalogue.stand, "office", Place(10.0, 11.5, 0.0, 0.4)),
    (catalogue.plant, "C0", Place(3.6, 9.1, 0.0, 0.0)),
    (catalogue.suitcase, "D0", Place(2.8, 12.2, 0.0, 2.8)),
    (catalogue.backpack, "lobby", Place(3.2, 1.3, 0.0, 1.3)),
    (catalogue.wet_floor, "A1", Place(15.4, 3.4, 0.0, -1.8)),
    (catalogue.plant, "B1", Place(19.6, 13.4, 0.0, 0.0)),
)
"""What may have come by another day, each clear of the routes; heights are from the floor."""


def movables(spaces: dict[str, Space], seed: int, day: np.random.Generator | None) -> list[Piece]:
    """What stands about; on another day some of it elsewhere or gone, and new things.

    Args:
        day: None for the ordinary day.
    """
    found = []
    for number, thing in enumerate(_furniture()):
        place = _upon_floor(thing.place, spaces[thing.space])
        if day is not None:
            fate = day.random()
            if fate < 0.2 and thing.leeway > 0:
                continue
            if fate < 0.75 and thing.leeway > 0:
                dx, dy = day.uniform(-1, 1, size=2) * thing.leeway
                place = replace(
                    place, x=place.x + dx, y=place.y + dy, heading=place.heading + day.normal(scale=0.5)
                )
        found.append(thing.make(np.random.default_rng([seed, 31, number]), place, spaces[thing.space].lamps))
    if day is not None:
        for number in sorted(day.choice(len(NEWCOMERS), size=6, replace=False)):
            make, space, place = NEWCOMERS[number]
            found.append(make(day, _upon_floor(place, spaces[space]), spaces[space].lamps))
    return found


def _upon_floor(place: Place, space: Space) -> Place:
    """A place whose height was told from a space's floor."""
    return replace(place, z=place.z + space.z)
