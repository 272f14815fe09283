"""An office building on two storeys: its rooms, what hangs on their walls, and the ways through it.

The ground floor has a lobby, an open office, a meeting room and four corridors around them; one of them
has a bare wall of ten metres. A staircase leads up to corridors that look like those below at a
glance: the same doors in the same places, some of the same posters, other numbers. North is +y.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from client_sim.synthetic import prints
from client_sim.synthetic.finishes import carpet, materials, stone, terrazzo
from client_sim.synthetic.lamps import Lamp, lit
from client_sim.synthetic.office_furniture import fixtures, movables
from client_sim.synthetic.spaces import SIDES, Materials, Space, ceiling_lamps, closed_door, doorway
from client_sim.synthetic.stairs import Staircase, StairMaterials
from client_sim.synthetic.textures import plaster, poster
from client_sim.synthetic.venue import Building, Point3, RadioObstacles, Storey
from client_sim.synthetic.worlds import Quad, Solid, Texture, World, ceiling

RISE = 3.2
"""From floor to floor, metres."""

HEIGHT = 2.8
"""From floor to ceiling."""

STAIRS = Staircase(corner=(11.0, 1.4, 0.0), ahead=(0.0, -1.0), rise=RISE)

STOREYS = (Storey("ground floor", 0.0, HEIGHT), Storey("first floor", RISE, HEIGHT))

WALL_LOSS_DB = 5.0
SLAB_LOSS_DB = 16.0

MAIN_ROUTE: tuple[Point3, ...] = (
    (1.5, 2.7, 0.0),
    (18.9, 2.7, 0.0),
    (18.9, 13.5, 0.0),
    (11.5, 13.5, 0.0),
    (11.5, 8.3, 0.0),
    (2.0, 8.3, 0.0),
    (2.0, 14.9, 0.0),
    (6.0, 14.9, 0.0),
)
"""60 m with six turns: along two corridors, through the office, along two more into the meeting room."""

STAIRS_ROUTE: tuple[Point3, ...] = (
    (1.5, 2.7, 0.0),
    (11.6, 2.7, 0.0),
    *STAIRS.route(),
    (13.0, 2.7, RISE),
    (18.9, 2.7, RISE),
    (18.9, 13.5, RISE),
    (14.5, 13.5, RISE),
)
"""From the lobby up the stairs, along the corridors there, into the library."""

PLACES: dict[str, Point3] = {
    "lobby": (1.5, 2.7, 0.0),
    "office": (13.5, 13.5, 0.0),
    "meeting room": (6.0, 14.9, 0.0),
    "blank wall": (6.0, 8.3, 0.0),
    "mirror": (18.9, 10.2, 0.0),
    "stairs below": (11.6, 0.7, 0.0),
    "landing": STAIRS.route()[6],
    "stairs above": (13.0, 0.7, RISE),
    "library": (14.5, 13.5, RISE),
}


def build_office(seed: int = 7, *, change: int | None = None) -> Building:
    """The building as a seed furnishes it.

    Args:
        change: seed of another day: movable things moved, gone or new, lamps of other power and colour.
    """
    day = None if change is None else np.random.default_rng([seed, 991, change])
    spaces = _spaces(seed, day)
    _openings(spaces, seed)
    for level in range(2):
        _hang_corridors(spaces, seed, level)
    _hang_ground_floor(spaces, seed)
    _hang_stairs(spaces, seed)
    quads: list[Quad] = []
    for space in spaces.values():
        quads.extend(space.quads())
        quads.extend(_lamp_panels(space))
    quads.extend(STAIRS.quads(_stair_materials(seed), spaces["stairwell"].lamps))
    solids: list[Solid] = []
    for piece in (*fixtures(spaces, seed), *movables(spaces, seed, day)):
        quads.extend(piece.quads)
        solids.extend(piece.solids)
    return Building(
        "office",
        World("office", tuple(quads), tuple(solids)),
        STOREYS,
        PLACES,
        {"main": MAIN_ROUTE, "stairs": STAIRS_ROUTE},
        _obstacles(spaces),
    )


def _rng(seed: int, *parts: int) -> np.random.Generator:
    """A generator of its own for each part: changing one leaves the others as they were."""
    return np.random.default_rng([seed, *parts])


def _spaces(seed: int, day: np.random.Generator | None) -> dict[str, Space]:
    rng = _rng(seed, 1)
    corridor = materials(rng, (204, 211, 214), stone(rng, (148, 156, 160)), HEIGHT, (120, 128, 134))
    room = materials(rng, (196, 208, 212), carpet(rng, (112, 104, 96)), HEIGHT, (128, 134, 138))
    hall = materials(
        rng, (208, 214, 218), stone(rng, (128, 140, 150), 0.8), HEIGHT, (96, 104, 112), dado=(150, 158, 150)
    )
    well = materials(
        rng,
        (198, 204, 206),
        stone(rng, (120, 124, 126), 0.3),
        2 * RISE - 0.4,
        (110, 116, 120),
        skirting=False,
    )
    plans: tuple[tuple[str, tuple[float, float], tuple[float, float], float, float, Materials], ...] = (
        ("lobby", (0.0, 0.0), (6.0, 5.2), 0.0, HEIGHT, hall),
        ("A0", (6.2, 1.6), (20.0, 3.8), 0.0, HEIGHT, corridor),
        ("B0", (17.8, 3.8), (20.0, 17.0), 0.0, HEIGHT, corridor),
        ("office", (9.4, 9.6), (17.6, 17.0), 0.0, HEIGHT, room),
        ("C0", (0.9, 7.2), (14.0, 9.4), 0.0, HEIGHT, corridor),
        ("D0", (0.9, 9.4), (3.1, 17.0), 0.0, HEIGHT, corridor),
        ("meeting room", (3.3, 12.6), (9.2, 17.0), 0.0, HEIGHT, room),
        ("stairwell", (11.0, 1.4 - STAIRS.length), (13.6, 1.4), 0.0, 2 * RISE - 0.4, well),
        ("A1", (6.2, 1.6), (20.0, 3.8), RISE, HEIGHT, corridor),
        ("B1", (17.8, 3.8), (20.0, 17.0), RISE, HEIGHT, corridor),
        ("library", (9.4, 9.6), (17.6, 17.0), RISE, HEIGHT, room),
    )
    spaces = {}
    for name, low, high, z, height, finish in plans:
        if name == "stairwell":
            lamps: tuple[Lamp, ...] = (
                Lamp((12.3, 0.7, RISE - 0.25), 0.9),
                Lamp((12.3, -1.3, 2 * RISE - 0.45), 1.3),
                Lamp((12.3, -3.7, 4.0), 1.0),
            )
        else:
            lamps = ceiling_lamps(low, high, z + height - 0.02, apart=2.6, power=0.95)
        if day is not None:
            warmth = float(day.uniform(0.97, 1.12))
            colour = (1 / warmth, 1.0, warmth)
            lamps = tuple(
                replace(
                    lamp,
                    power=lamp.power * (0.12 if day.random() < 0.15 else day.uniform(0.75, 1.05)),
                    colour=colour,
                )
                for lamp in lamps
            )
        spaces[name] = Space(name, low, high, z, height, finish, lamps)
    return spaces


def _openings(spaces: dict[str, Space], seed: int) -> None:
    s = spaces
    doorway(s["lobby"], "east", s["A0"], 2.7, 1.5, 2.3)
    for level in range(2):
        a, b = s[f"A{level}"], s[f"B{level}"]
        doorway(a, "north", b, 18.9, 2.2, HEIGHT, framed=False)
    doorway(s["B0"], "west", s["office"], 13.5, 1.1)
    doorway(s["B1"], "west", s["library"], 13.5, 1.1)
    doorway(s["office"], "south", s["C0"], 11.5, 1.1)
    doorway(s["C0"], "north", s["D0"], 2.0, 2.2, HEIGHT, framed=False)
    doorway(s["D0"], "east", s["meeting room"], 14.9, 1.0)
    doorway(s["A0"], "south", s["stairwell"], 11.6, 1.0)
    doorway(s["A1"], "south", s["stairwell"], 13.0, 1.0, z=RISE)
    for level in range(2):
        doors = (
            ("A", "north", (8.0, 11.4, 14.8)),
            ("A", "south", (8.6, 16.0)),
            ("B", "west", (5.6, 8.4)),
        )
        number = 100 * level + 1
        for part, side, places in doors:
            for at in places:
                _numbered_door(spaces[f"{part}{level}"], side, at, seed, number, level)
                number += 1
    for part, side, at, number in (
        ("C0", "north", 13.2, 20),
        ("C0", "north", 8.2, 21),
        ("C0", "north", 5.2, 22),
        ("C0", "east", 8.3, 23),
        ("D0", "east", 11.2, 24),
        ("lobby", "north", 4.4, 30),
        ("lobby", "south", 1.6, 31),
        ("meeting room", "south", 8.2, 25),
    ):
        _numbered_door(spaces[part], side, at, seed, number, 0)


def _numbered_door(space: Space, side: str, at: float, seed: int, number: int, level: int) -> None:
    """A closed door with its number beside it: upstairs of the model below, but of other wood."""
    model = _rng(seed, 2, number % 100)
    tone, pane = float(model.uniform(0.85, 1.1)), bool(model.random() < 0.35)
    leaf = prints.leaf(_rng(seed, 2, number), 420, 190, tone, pane)
    closed_door(space, side, at, leaf)
    beside = at + (0.72 if number % 2 else -0.72)
    space.hang(side, beside, 1.55, (0.18, 0.14), prints.plate(f"{level}.{number % 100:02d}", 56, 72))


def _hang_corridors(spaces: dict[str, Space], seed: int, level: int) -> None:
    """What the corridors of both storeys have in common, and what not."""
    a, b = spaces[f"A{level}"], spaces[f"B{level}"]

    def print_(number: int, height: int, width: int) -> Texture:
        # Every second poster hangs on both storeys: whoever printed them printed two.
        rng = _rng(seed, 3, number) if number % 2 else _rng(seed, 3, number, level)
        return _poster(rng, number + (level if number % 2 == 0 else 0), height, width)

    board = prints.board(_rng(seed, 4, level), 230, 360)
    a.hang("north", 9.7, 1.5, (1.5, 0.95), board)
    a.hang("north", 13.1, 1.5, (0.6, 0.85), print_(1, 240, 170))
    a.hang("north", 16.7, 1.45, (0.84, 0.6), print_(2, 180, 250))
    a.hang("south", 14.4 if level else 10.1, 1.5, (0.6, 0.85), print_(3, 240, 170))
    a.hang("south", 18.3, 1.5, (0.6, 0.85), print_(4, 240, 170))
    a.hang(
        "south",
        10.75 if level == 0 else 12.2,
        1.5,
        (0.3, 0.3),
        prints.numeral(str(level), 90, 90, prints.WHITE, prints.BLUE),
    )
    rows = (("left", f"ROOMS {level}.06-{level}.10"), ("left", "LIBRARY" if level else "OFFICE"))
    a.hang("east", 2.7, 1.75, (1.1, 0.4), prints.direction_sign(rows, 120, 330))
    a.hang("east", 2.7, 1.1, (0.6, 0.42), print_(6, 130, 180))
    stairs = (("left" if level else "right", "STAIRS"),)
    a.hang("north", 12.4 if level else 12.35, 2.35, (0.5, 0.17), prints.direction_sign(stairs, 60, 180))
    for space, side, at in ((a, "south", 7.4), (b, "west", 4.6), (b, "west", 12.6)):
        space.hang(side, at, 1.1, (0.09, 0.09), prints.switch(30, 30))
    b.hang("west", 7.0, 1.5, (0.6, 0.85), print_(5, 240, 170))
    b.hang("west", 10.9, 1.5, (0.85, 1.2), print_(8, 330, 240))
    b.hang("west", 15.6, 1.5, (0.42, 0.6), print_(7, 180, 130))
    b.hang("north", 18.9, 1.55, (1.2, 0.9), print_(10, 260, 350))
    exit_ = prints.exit_sign("left" if level else "right", 70, 160)
    b.hang("west", 14.6, 2.4, (0.36, 0.16), exit_)
    for number, at in enumerate((5.4, 8.0, 15.0)):
        view = prints.window(_rng(seed, 5, number, level), 300, 300)
        b.hang("east", at, 1.65, (1.4, 1.4), view, light=1.25)
        b.hang("east", at, 0.45, (1.2, 0.55), prints.radiator(_rng(seed, 6), 90, 200), depth=0.06)
    if level == 0:
        _mirror(b, "east", 10.6, 1.3, (1.1, 1.9))
    else:
        b.hang("east", 11.2, 1.5, (1.7, 1.0), prints.whiteboard(_rng(seed, 7), 230, 390))


def _poster(rng: np.random.Generator, kind: int, height: int, width: int) -> Texture:
    make = (prints.landscape, poster, prints.notice)[kind % 3]
    return make(rng, height, width)


def _mirror(space: Space, side: str, at: float, middle: float, size: tuple[float, float]) -> None:
    """A mirror with a frame around it."""
    wide, tall = size
    frame = plaster(np.random.default_rng(0), 20, 20, (70, 90, 110))
    tint = np.full((4, 4, 3), (222, 228, 224), np.uint8)
    bottom, top = space.z + middle - tall / 2, space.z + middle + tall / 2
    left, right, edge = at - wide / 2, at + wide / 2, 0.05
    glass = space.strip(side, left, right, bottom, top, tint, 0.012)
    space.hung.append(replace(glass, mirror=True))
    for start, end, low, high in (
        (left - edge, left, bottom - edge, top + edge),
        (right, right + edge, bottom - edge, top + edge),
        (left, right, top, top + edge),
        (left, right, bottom - edge, bottom),
    ):
        space.hung.append(lit(space.strip(side, start, end, low, high, frame, 0.03), space.lamps))


def _hang_ground_floor(spaces: dict[str, Space], seed: int) -> None:
    lobby, office, meeting = spaces["lobby"], spaces["office"], spaces["meeting room"]
    c, d, library = spaces["C0"], spaces["D0"], spaces["library"]
    view = iter(range(100))

    def window(space: Space, side: str, at: float, size: tuple[float, float] = (1.5, 1.4)) -> None:
        texture = prints.window(_rng(seed, 8, next(view)), round(200 * size[1]), round(200 * size[0]))
        space.hang(side, at, 1.65, size, texture, light=1.25)

    def picture(
        space: Space, side: str, at: float, kind: int, size: tuple[float, float], middle: float = 1.5
    ) -> None:
        rng = _rng(seed, 9, next(view))
        space.hang(side, at, middle, size, _poster(rng, kind, round(260 * size[1]), round(260 * size[0])))

    window(lobby, "west", 2.6, (2.4, 1.9))
    window(lobby, "south", 4.0, (2.0, 1.5))
    picture(lobby, "north", 2.0, 0, (1.6, 1.0))
    picture(lobby, "east", 0.9, 1, (0.6, 0.85))
    picture(lobby, "south", 2.6, 2, (0.42, 0.6))
    rows = (("up", "OFFICE  STAIRS"), ("up", "MEETING ROOM"))
    lobby.hang("east", 4.4, 1.7, (1.2, 0.42), prints.direction_sign(rows, 126, 360))
    meeting_room = (("right", "MEETING ROOM"), ("left", "STORE"))
    for at in (11.0, 13.5, 16.0):
        window(office, "north", at)
    office.hang("west", 13.2, 1.5, (1.9, 1.1), prints.whiteboard(_rng(seed, 10), 240, 420))
    picture(office, "west", 15.6, 0, (0.9, 0.6))
    picture(office, "south", 15.2, 1, (0.6, 0.85))
    office.hang("south", 13.6, 1.5, (1.2, 0.9), prints.board(_rng(seed, 11), 230, 310))
    picture(office, "east", 15.4, 2, (0.42, 0.6))
    # Opposite the office's door: where to go, and where to flee. The rest of this wall, 10 m, stays bare.
    c.hang("south", 11.3, 1.8, (1.0, 0.34), prints.direction_sign(meeting_room, 100, 300))
    picture(c, "south", 11.6, 2, (0.42, 0.6), 1.25)
    picture(c, "north", 9.7, 1, (0.6, 0.85))
    picture(c, "north", 6.7, 2, (0.42, 0.6))
    c.hang("north", 10.5, 1.15, (0.09, 0.09), prints.switch(30, 30))
    c.hang("west", 8.3, 1.75, (1.1, 0.22), prints.direction_sign(meeting_room[:1], 70, 340))
    picture(c, "west", 8.3, 0, (0.9, 0.6), 1.2)
    for at in (10.4, 13.6):
        window(d, "west", at, (1.4, 1.4))
    d.hang("north", 2.0, 1.45, (1.2, 0.9), prints.board(_rng(seed, 12), 230, 310))
    picture(d, "east", 12.9, 1, (0.6, 0.85))
    for at in (4.8, 7.4):
        window(meeting, "north", at)
    meeting.hang("east", 14.9, 1.5, (2.0, 1.15), prints.whiteboard(_rng(seed, 13), 250, 440))
    picture(meeting, "south", 5.6, 0, (1.2, 0.8))
    for at in (11.0, 13.5, 16.0):
        window(library, "north", at)
    picture(library, "south", 13.0, 1, (0.6, 0.85))
    picture(library, "west", 12.0, 0, (1.2, 0.8))


def _hang_stairs(spaces: dict[str, Space], seed: int) -> None:
    well = spaces["stairwell"]
    view = prints.window(_rng(seed, 14), 300, 260)
    half = RISE / 2
    well.hang("south", 11.75, half + 1.8, (1.1, 1.2), view, light=1.2)
    well.hang("south", 11.75, half + 0.55, (1.0, 0.5), prints.radiator(_rng(seed, 6), 80, 160), depth=0.07)
    well.hang("south", 12.6, half + 1.45, (0.3, 0.42), _poster(_rng(seed, 21), 2, 130, 90))
    well.hang("south", 13.1, half + 1.5, (0.42, 0.6), _poster(_rng(seed, 15), 1, 180, 130))
    well.hang("east", -3.0, half + 1.0, (0.42, 0.3), _poster(_rng(seed, 22), 0, 90, 130))
    number = prints.numeral("0/1", 120, 180, prints.WHITE, (120, 90, 60))
    well.hang("east", -3.2, half + 1.6, (0.6, 0.4), number)
    well.hang("west", -1.2, 2.3, (0.85, 0.6), _poster(_rng(seed, 16), 0, 170, 240))
    well.hang("east", -1.3, 4.0, (0.6, 0.85), _poster(_rng(seed, 17), 1, 240, 170))
    well.hang("west", 0.6, 1.5, (0.3, 0.42), _poster(_rng(seed, 18), 2, 130, 90))
    well.hang("east", 0.3, RISE + 1.5, (0.3, 0.3), prints.numeral("1", 90, 90, prints.WHITE, prints.BLUE))
    well.hang("west", 0.2, RISE + 1.6, (0.6, 0.85), _poster(_rng(seed, 19), 0, 240, 170))


def _stair_materials(seed: int) -> StairMaterials:
    rng = _rng(seed, 20)
    tread = terrazzo(rng, 56, 240, (126, 132, 136))
    tread[-9:] = (52, 56, 60)  # the nosing's rubber strip
    tread[-7:-2:2] = 90
    riser = plaster(rng, 30, 210, (150, 156, 160))
    landing = terrazzo(rng, 240, 420, (126, 132, 136))
    return StairMaterials(
        tread,
        landing,
        riser,
        plaster(rng, 160, 400, (188, 194, 198)),
        plaster(rng, 100, 300, (170, 175, 178)),
        plaster(rng, 16, 200, (70, 95, 125)),
    )


def _lamp_panels(space: Space) -> list[Quad]:
    """The lamps themselves, where they hang at the ceiling."""
    shine = np.full((24, 24, 3), 255, np.uint8)
    shine[:2] = shine[-2:] = shine[:, :2] = shine[:, -2:] = 170
    found = []
    for lamp in space.lamps:
        x, y, z = lamp.place
        if z < space.top - 0.1:
            continue
        panel = ceiling((x - 0.29, y - 0.29), (x + 0.29, y + 0.29), space.top - 0.01, shine)
        bright = np.broadcast_to(np.float32(0.4 + 0.8 * min(1.0, lamp.power)), (2, 2, 3)) * np.array(
            lamp.colour
        )
        found.append(replace(panel, light=bright.astype(np.float32)))
    return found


def _obstacles(spaces: dict[str, Space]) -> RadioObstacles:
    walls, slabs = [], []
    for space in spaces.values():
        for side in SIDES:
            start, end = space.extent(side)
            across = space.line(side)
            ends = (
                (start, across, end, across) if side in ("south", "north") else (across, start, across, end)
            )
            holes = [hole for hole in space.holes[side] if hole.top - hole.bottom >= HEIGHT]
            if not holes:
                walls.append((*ends, space.z, space.top))
        if space.name != "stairwell":
            slabs.append((*space.low, *space.high, space.top + 0.2 if space.z == 0 else space.z - 0.2))
    return RadioObstacles(
        np.array(walls),
        np.full(len(walls), WALL_LOSS_DB / 2),
        np.array(slabs),
        np.full(len(slabs), SLAB_LOSS_DB),
    )
