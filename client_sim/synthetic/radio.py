"""Radio in a building: what a phone hears of access points and of other phones.

Log-distance path loss with the losses of the walls and floors in between (the multi-wall model, COST 231,
chapter 4.7), and shadowing that belongs to the place, so that it is met again on every walk.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from client_sim.synthetic.motion import Motion
from client_sim.synthetic.venue import Building, RadioObstacles

Array = NDArray[np.float64]

HARMONICS = 48
"""Waves that a shadowing field is the sum of."""


@dataclass(frozen=True, slots=True)
class RadioOptions:
    """Propagation, and how phones hear.

    Attributes:
        power: dBm at 1 m of an access point, and its standard deviation over them.
        exponent: of the path loss within sight.
        most_loss: dB that walls and floors take away at most: then the signal comes another way.
        shadowing: standard deviation of the fields, dB.
        grain: metres over which they change.
        noise: standard deviation of one reading, dB.
        phone_offset: standard deviation of a phone's constant, dB.
        floor: dBm below which nothing is heard.
        missed: fraction of what could be heard that a scan misses.
        spacing: metres between access points at least.
        bluetooth_power: dBm at 1 m.
        bluetooth_noise: dB; bodies turn, and the three advertising channels fade apart.
    """

    power: tuple[float, float] = (-38.0, 3.0)
    exponent: float = 2.4
    most_loss: float = 38.0
    shadowing: float = 3.5
    grain: float = 2.5
    noise: float = 3.0
    phone_offset: float = 3.0
    floor: float = -92.0
    missed: float = 0.04
    spacing: float = 7.0
    bluetooth_power: float = -62.0
    bluetooth_noise: float = 6.0


@dataclass(frozen=True, slots=True)
class Heard:
    """One line of a scan: who (``bssid``, of phones their name), and how loud, dBm."""

    source: str
    rssi: int


@dataclass(frozen=True, slots=True)
class Scan:
    """What a phone has heard at a time, seconds on the video's clock."""

    time: float
    heard: tuple[Heard, ...]


@dataclass(frozen=True, eq=False, slots=True)
class RadioMap:
    """The access points of a building and how far they reach.

    Attributes:
        names: of the access points, as ``bssid``.
        places: (A, 3) metres.
        power: (A,) dBm at 1 m.
        waves: (A, HARMONICS, 4) of the shadowing: wave vector and phase.
    """

    names: tuple[str, ...]
    places: Array = field(repr=False)
    power: Array = field(repr=False)
    waves: Array = field(repr=False)
    obstacles: RadioObstacles = field(repr=False)
    options: RadioOptions = field(default_factory=RadioOptions)

    def rssi(self, points: Array) -> Array:
        """What is received at points (N, 3) on average, dBm, (N, A)."""
        loss = np.stack([path_loss(place, points, self.obstacles, self.options) for place in self.places])
        phases = np.einsum("akd,nd->nak", self.waves[..., :3], points) + self.waves[..., 3]
        shadow = self.options.shadowing * np.sqrt(2.0 / HARMONICS) * np.cos(phases).sum(axis=2)
        return np.asarray(self.power - loss.T + shadow)


def path_loss(place: Array, points: Array, obstacles: RadioObstacles, options: RadioOptions) -> Array:
    """dB lost between a place (3,) and points (N, 3), beyond the first metre."""
    distance = np.linalg.norm(points - place, axis=1)
    blocked = _crossed(place, points, obstacles) @ np.concatenate([obstacles.wall_loss, obstacles.slab_loss])
    return np.asarray(
        10.0 * options.exponent * np.log10(np.maximum(distance, 0.5)) + np.minimum(blocked, options.most_loss)
    )


def _crossed(place: Array, points: Array, obstacles: RadioObstacles) -> Array:
    """(N, W + S): 1 where the line from the place to a point meets a wall or a slab."""
    ahead = points - place
    x0, y0, x1, y1, bottom, top = obstacles.walls.reshape(-1, 6).T
    along_x, along_y = x1 - x0, y1 - y0
    with np.errstate(divide="ignore", invalid="ignore"):
        across = ahead[:, :1] * along_y - ahead[:, 1:2] * along_x
        away_x, away_y = x0 - place[0], y0 - place[1]
        part = (away_x * along_y - away_y * along_x) / across
        beside = (away_x * ahead[:, 1:2] - away_y * ahead[:, :1]) / across
        height = place[2] + part * ahead[:, 2:]
        walls = (part > 0) & (part < 1) & (beside >= 0) & (beside < 1) & (height > bottom) & (height < top)
        left, front, right, back, level = obstacles.slabs.reshape(-1, 5).T
        part = (level - place[2]) / ahead[:, 2:]
        x, y = place[0] + part * ahead[:, :1], place[1] + part * ahead[:, 1:2]
        slabs = (part > 0) & (part < 1) & (x >= left) & (x < right) & (y >= front) & (y < back)
    return np.concatenate([walls, slabs], axis=1).astype(np.float64)


def building_radio(
    building: Building, rng: np.random.Generator, options: RadioOptions | None = None
) -> RadioMap:
    """Access points below the ceilings of a building, drawn by the generator and by nothing of any walk."""
    options = options or RadioOptions()
    known = [*building.places.values(), *(point for way in building.routes.values() for point in way)]
    places: list[Array] = []
    for point in rng.permutation(np.unique(np.asarray(known, dtype=np.float64).round(2), axis=0)):
        storey = building.storeys[building.storey_of(point[2])]
        # Half-way up the stairs there is no ceiling to hang anything from.
        if abs(point[2] - storey.z) > 0.05:
            continue
        place = point + np.append(rng.uniform(-0.8, 0.8, size=2), storey.height - 0.15)
        if all(np.linalg.norm(place - other) >= options.spacing for other in places):
            places.append(place)
    count = len(places)
    waves = np.concatenate(
        [
            rng.normal(scale=1.0 / options.grain, size=(count, HARMONICS, 3)),
            rng.uniform(0.0, 2.0 * np.pi, size=(count, HARMONICS, 1)),
        ],
        axis=2,
    )
    names = tuple(f"02:00:00:00:{number >> 8:02x}:{number & 255:02x}" for number in range(count))
    power = rng.normal(*options.power, size=count)
    return RadioMap(names, np.array(places).reshape(-1, 3), power, waves, building.obstacles, options)


def wifi_scans(
    motion: Motion, radio: RadioMap, rng: np.random.Generator, *, first: float = 0.3, every: float = 2.0
) -> list[Scan]:
    """What one phone hears of the access points, every two seconds."""
    options = radio.options
    times = np.arange(first, motion.duration, every)
    received = radio.rssi(motion.positions(times)) + rng.normal(scale=options.phone_offset)
    received += rng.normal(scale=options.noise, size=received.shape)
    taken = (received >= options.floor) & (rng.random(received.shape) >= options.missed)
    return [
        Scan(float(t), tuple(Heard(radio.names[k], round(float(row[k]))) for k in np.flatnonzero(kept)))
        for t, row, kept in zip(times, received, taken, strict=True)
    ]


def bluetooth_scans(
    motion: Motion,
    others: Mapping[str, Motion],
    radio: RadioMap,
    rng: np.random.Generator,
    *,
    every: float = 1.0,
) -> list[Scan]:
    """What one phone hears of other users' advertisements, of each until the end of its motion."""
    options = radio.options
    times = np.arange(every / 2, motion.duration, every)
    here = motion.positions(times)
    heard: list[list[Heard]] = [[] for _ in times]
    for name, other in others.items():
        there = other.positions(np.minimum(times, other.duration))
        offset = rng.normal(scale=options.phone_offset)
        for k, (a, b) in enumerate(zip(here, there, strict=True)):
            loss = float(path_loss(a, b[None], radio.obstacles, options)[0])
            rssi = options.bluetooth_power - loss + offset + rng.normal(scale=options.bluetooth_noise)
            if rssi >= options.floor and times[k] <= other.duration:
                heard[k].append(Heard(name, round(rssi)))
    return [Scan(float(t), tuple(readings)) for t, readings in zip(times, heard, strict=True) if readings]
