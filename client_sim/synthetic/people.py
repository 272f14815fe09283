"""People who pass: figures of ellipsoids that walk along paths, legs and arms swinging."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from client_sim.synthetic.textures import Colour, cloud
from client_sim.synthetic.worlds import Solid, Texture, Thing

Array = NDArray[np.float64]
Point3 = tuple[float, float, float]

STEP_M = 0.36
"""Length of a step as a part of the figure's height is :data:`STEP_M` / 0.85."""


@dataclass(frozen=True, eq=False, slots=True)
class _Clothes:
    """Textures of one person."""

    shirt: Texture
    sleeve: Texture
    trousers: Texture
    shoe: Texture
    skin: Texture
    face: Texture
    hair: Texture


def _cloth(rng: np.random.Generator, colour: Colour, pattern: int) -> Texture:
    """Plain, striped, checked or printed cloth, with folds."""
    height, width = 96, 128
    picture = np.broadcast_to(np.asarray(colour), (height, width, 3)).astype(np.float64).copy()
    other = np.asarray(rng.uniform(20, 230, size=3))
    rows, columns = np.arange(height)[:, None], np.arange(width)[None, :]
    pitch = int(rng.integers(7, 14))
    if pattern == 1:
        picture[np.broadcast_to(rows // pitch % 2 == 0, (height, width))] = other
    elif pattern == 2:
        lines = (rows % pitch < 2) | (columns % pitch < 2)
        picture[lines] = 0.5 * picture[lines] + 0.5 * other
    elif pattern == 3:
        print_ = (np.abs(rows - 40) < 13) & (np.abs(columns % 64 - 32) < 11)
        picture[print_] = other
        picture[print_ & (rows // 4 % 2 == 0)] = 255 - other
    picture += (9.0 * cloud(rng, height, width, 11) + 3.0 * rng.normal(size=(height, width)))[..., None]
    return np.asarray(picture.clip(0, 255).astype(np.uint8))


def _face(rng: np.random.Generator, skin: Colour) -> Texture:
    """A head: skin, eyes, brows and a mouth in front, which is the middle column."""
    picture = _cloth(rng, skin, 0)
    for column in (57, 71):
        picture[44:48, column - 2 : column + 3] = 235
        picture[44:48, column - 1 : column + 2] = (60, 45, 40)
        picture[39:41, column - 4 : column + 5] = (40, 45, 60)
    picture[48:58, 63:66] = (picture[48:58, 63:66] * 0.82).astype(np.uint8)
    picture[64:67, 57:72] = (95, 90, 160)
    return picture


@dataclass(frozen=True)
class Passerby:
    """Somebody who walks along a path and is gone at its end.

    Attributes:
        path: floor points, metres.
        start_s: when they are at its first point.
        speed: metres a second.
        look: seed of height, build and clothes.
        stay: whether they stand at the path's ends before and after, rather than being gone.
    """

    path: tuple[Point3, ...]
    start_s: float = 0.0
    speed: float = 1.2
    look: int = 0
    stay: bool = False
    thing: Thing = field(default_factory=lambda: Thing("person"), repr=False, compare=False)

    @cached_property
    def _clothes(self) -> _Clothes:
        rng = np.random.default_rng([self.look, 5])
        tone = rng.uniform(0.45, 1.0)
        skin = (150 * tone, 178 * tone, 222 * tone)
        pattern = int(rng.integers(0, 4))
        colour = tuple(float(c) for c in rng.uniform(30, 225, size=3))
        dark = tuple(float(c) for c in rng.uniform(25, 95, size=3))
        shirt = _cloth(rng, (colour[0], colour[1], colour[2]), pattern)
        return _Clothes(
            shirt=shirt,
            sleeve=_cloth(rng, (colour[0], colour[1], colour[2]), 0 if pattern == 3 else pattern),
            trousers=_cloth(rng, (dark[0], dark[1], dark[2]), 0),
            shoe=_cloth(rng, (38, 36, 40), 0),
            skin=_cloth(rng, skin, 0),
            face=_face(rng, skin),
            hair=_cloth(rng, (28 + 50 * rng.random(), 34 + 60 * rng.random(), 40 + 80 * rng.random()), 0),
        )

    def at(self, t: float) -> tuple[Solid, ...]:
        """The figure at time ``t``; nothing before and after the walk unless it stays."""
        points = np.asarray(self.path, dtype=np.float64)
        along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
        walked = (t - self.start_s) * self.speed
        if not self.stay and not 0.0 <= walked <= along[-1]:
            return ()
        going = 0.0 < walked < along[-1]
        walked = float(np.clip(walked, 0.0, along[-1]))
        place, ahead = (
            np.array([np.interp(s, along, points[:, k]) for k in range(3)])
            for s in (walked, min(walked + 0.4, along[-1]))
        )
        behind = np.array([np.interp(max(walked - 0.4, 0.0), along, points[:, k]) for k in range(3)])
        way = (ahead - behind)[:2]
        heading = float(np.arctan2(way[1], way[0])) if np.hypot(*way) > 1e-6 else 0.0
        return figure(place, heading, walked if going else 0.0, going, self._clothes, self.look, self.thing)


def crowd_at(people: Sequence[Passerby], t: float) -> tuple[Solid, ...]:
    """All who are there at time ``t``."""
    return tuple(solid for person in people for solid in person.at(t))


def figure(
    place: Array, heading: float, walked: float, going: bool, clothes: _Clothes, look: int, thing: Thing
) -> tuple[Solid, ...]:
    """A person standing at ``place``, the floor point, who has ``walked`` so many metres.

    Own axes are x ahead, y left, z up. One cycle of the legs is two steps.
    """
    rng = np.random.default_rng([look, 6])
    tall = float(rng.uniform(1.56, 1.9))
    broad = float(rng.uniform(0.9, 1.12))
    cycle = 2 * np.pi * walked / (2 * STEP_M / 0.85 * tall)
    swing = 0.42 * np.sin(cycle) if going else 0.0
    unit = tall / 1.75
    c, s = np.cos(heading), np.sin(heading)
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    bounce = 0.015 * unit * np.cos(2 * cycle) if going else 0.0
    origin = place + np.array([0.0, 0.0, bounce])
    found: list[Solid] = []

    def add(middle: Array, half: tuple[float, float, float], axis: Array | None, texture: Texture) -> None:
        up = np.array([0.0, 0.0, 1.0]) if axis is None else axis / np.linalg.norm(axis)
        side = np.array([0.0, 1.0, 0.0])
        axes = np.stack([np.cross(side, up) * half[0], side * half[1], up * half[2]], axis=1) * unit
        found.append(Solid(origin + turn @ (middle * unit), turn @ axes, texture, 1.0, thing))

    def limb(
        joint: Array,
        angle: float,
        bend: float,
        lengths: tuple[float, float],
        thick: tuple[float, float],
        textures: tuple[Texture, Texture],
    ) -> tuple[Array, Array]:
        """Two parts from a joint down, swung forward by ``angle``; the knee or elbow bends by ``bend``."""
        end = joint
        for length, size, texture, at in zip(lengths, thick, textures, (angle, angle - bend), strict=True):
            along = np.array([np.sin(at), 0.0, -np.cos(at)])
            middle = end + along * length / 2
            add(middle, (size, size, length * 0.6), -along, texture)
            end = end + along * length
        return end, along

    for sign in (1.0, -1.0):
        leg = sign * swing
        knee = (0.12 + 0.75 * max(0.0, -np.cos(cycle + (0.0 if sign > 0 else np.pi)))) if going else 0.04
        hip = np.array([0.0, sign * 0.095 * broad, 0.86])
        ankle, along = limb(
            hip,
            leg,
            knee,
            (0.42, 0.41),
            (0.088 * broad, 0.062),
            (clothes.trousers, clothes.trousers),
        )
        toe = np.array([-along[2], 0.0, along[0]])
        add(ankle + 0.06 * toe + [0, 0, 0.02], (0.045, 0.048, 0.135), toe, clothes.shoe)
        shoulder = np.array([0.0, sign * 0.205 * broad, 1.41])
        hand, along = limb(
            shoulder,
            -0.85 * leg,
            -0.35,
            (0.29, 0.26),
            (0.054 * broad, 0.043),
            (clothes.sleeve, clothes.sleeve if look % 2 else clothes.skin),
        )
        add(hand + 0.05 * along, (0.03, 0.042, 0.085), -along, clothes.skin)
    add(np.array([0.0, 0.0, 0.93]), (0.125, 0.175 * broad, 0.15), None, clothes.trousers)
    add(np.array([0.0, 0.0, 1.2]), (0.135 * broad, 0.195 * broad, 0.31), None, clothes.shirt)
    add(np.array([0.0, 0.0, 1.37]), (0.1, 0.215 * broad, 0.115), None, clothes.sleeve)
    add(np.array([0.01, 0.0, 1.5]), (0.052, 0.052, 0.1), None, clothes.skin)
    add(np.array([0.025, 0.0, 1.63]), (0.098, 0.078, 0.122), None, clothes.face)
    add(np.array([-0.012, 0.0, 1.665]), (0.098, 0.088, 0.1), None, clothes.hair)
    return tuple(found)
