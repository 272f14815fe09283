"""Walks of the indoor location competition: one text file a walk, a folder a floor.

Lines are ``milliseconds TAB TYPE TAB values``; ``floor_info.json`` has the floor's size, waypoints and the
map's picture share its metres, x to the right (east), y up (north), origin at the bottom left.
"""

from __future__ import annotations

import json
from collections import defaultdict
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from server.evaluation.positioning.folders import RecordingError
from server.pedestrian.samples import Accelerometer, Gyroscope, Magnetometer, Sample, WifiScan

Array = NDArray[np.float64]

STALE_S = 2.0
"""Phones repeat in a scan what earlier ones heard, up to half a minute ago: left out when so old."""

_VECTORS: dict[str, type[Accelerometer] | type[Gyroscope] | type[Magnetometer]] = {
    "TYPE_ACCELEROMETER": Accelerometer,
    "TYPE_GYROSCOPE": Gyroscope,
    "TYPE_MAGNETIC_FIELD": Magnetometer,
}


@dataclass(frozen=True, slots=True)
class MallWalk:
    """One walk.

    Args:
        floor: site and floor, as the folders are named.
        samples: in the order in which the phone handed them over; seconds since the file's start.
        delivered: (len(samples),) when that was; a WiFi scan is handed over after it was heard.
        waypoints: (W, 3) seconds and surveyed position, metres.
    """

    name: str
    floor: str
    samples: tuple[Sample, ...] = field(repr=False)
    delivered: tuple[float, ...] = field(repr=False)
    waypoints: Array = field(repr=False)

    @property
    def start(self) -> tuple[float, float]:
        return float(self.waypoints[0, 1]), float(self.waypoints[0, 2])

    @property
    def duration(self) -> float:
        return self.delivered[-1] - self.delivered[0] if self.delivered else 0.0


@dataclass(frozen=True, slots=True)
class Floor:
    """A floor's name, its walks, and its map: a picture and its width and height, metres."""

    name: str
    walks: tuple[MallWalk, ...]
    picture: bytes | None
    size: tuple[float, float]


def read_walk(file: Path, floor: str) -> MallWalk:
    """Raises: RecordingError: not such a file."""
    waypoints: list[tuple[float, float, float]] = []
    samples: list[tuple[float, int, Sample]] = []
    scans: dict[float, list[tuple[str, float, float]]] = defaultdict(list)
    start: float | None = None
    try:
        for line in file.read_text(encoding="utf-8", errors="replace").splitlines():
            if not line or line.startswith("#"):
                continue
            stamp, kind, *values = line.split("\t")
            milliseconds = float(stamp)
            start = milliseconds if start is None else start
            t = (milliseconds - start) / 1e3
            if kind in _VECTORS:
                x, y, z = (float(value) for value in values[:3])
                samples.append((t, len(samples), _VECTORS[kind](t, x, y, z)))
            elif kind == "TYPE_WAYPOINT":
                waypoints.append((t, float(values[0]), float(values[1])))
            elif kind == "TYPE_WIFI" and len(values) >= 5:
                heard = (float(values[4]) - start) / 1e3
                scans[t].append((values[1], float(values[2]), heard))
    except (ValueError, IndexError) as error:
        raise RecordingError(f"{file}: {error}") from error
    if not waypoints or not samples:
        raise RecordingError(f"{file} has no waypoints or no motion sensors")
    for t, readings in scans.items():
        fresh = [(name, strength, heard) for name, strength, heard in readings if 0.0 <= t - heard <= STALE_S]
        if fresh:
            heard = float(np.mean([heard for *_, heard in fresh]))
            scan = WifiScan(heard, tuple((name, strength) for name, strength, _ in fresh))
            samples.append((t, len(samples), scan))
    samples.sort(key=lambda entry: entry[:2])
    return MallWalk(
        file.stem,
        floor,
        tuple(sample for *_, sample in samples),
        tuple(t for t, *_ in samples),
        np.array(sorted(waypoints)),
    )


def read_floors(files: list[Path]) -> list[Floor]:
    """Floors of the walks' files, which lie in ``SITE/FLOOR/path_data_files``."""
    folders: dict[Path, list[Path]] = defaultdict(list)
    for file in files:
        folders[file.parent.parent].append(file)
    return [_read_floor(folder, walks) for folder, walks in sorted(folders.items())]


def _read_floor(folder: Path, files: list[Path]) -> Floor:
    name = f"{folder.parent.name}/{folder.name}"
    try:
        info = json.loads((folder / "floor_info.json").read_text(encoding="utf-8"))["map_info"]
        size = (float(info["width"]), float(info["height"]))
    except (OSError, KeyError, TypeError, ValueError) as error:
        raise RecordingError(f"{folder} has no floor_info.json with the map's size") from error
    picture = folder / "floor_image.png"
    walks = tuple(read_walk(file, name) for file in files)
    if all(len(walk.waypoints) < 2 for walk in walks):
        raise RecordingError(f"{folder} has no walk with a waypoint after its start: nothing to judge")
    return Floor(name, walks, picture.read_bytes() if picture.is_file() else None, size)
