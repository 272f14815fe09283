"""Route maps as files: safetensors, read through a memory map.

Layout: an 8-byte little-endian length, a JSON header that lists the arrays and carries the map's
metadata (format version, camera, scale, turns, checksum), then the arrays. No code is ever read from
a file.
"""

from __future__ import annotations

import json
import math
import os
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from safetensors.numpy import save

from server.geometry.cameras import Camera, InvalidCameraError
from server.mapping.route_map import (
    Keyframes,
    Landmarks,
    Observations,
    RouteMap,
    RoutePath,
    Scale,
    ScaleSource,
    Turn,
)

FORMAT_VERSION = 1
MAX_HEADER_BYTES = 4 << 20

_DTYPES: dict[str, np.dtype[Any]] = {
    "F64": np.dtype("<f8"),
    "F32": np.dtype("<f4"),
    "I64": np.dtype("<i8"),
    "I32": np.dtype("<i4"),
    "I8": np.dtype("i1"),
    "U8": np.dtype("u1"),
    "BOOL": np.dtype("?"),
}

_FIELDS: dict[str, tuple[str, tuple[int | str, ...]]] = {
    "keyframes.frame": ("I32", ("K",)),
    "keyframes.quaternion": ("F64", ("K", 4)),
    "keyframes.position": ("F64", ("K", 3)),
    "landmarks.position": ("F64", ("P", 3)),
    "landmarks.descriptor": ("U8", ("P", 32)),
    "landmarks.normal": ("F32", ("P", 3)),
    "landmarks.distance": ("F32", ("P", 2)),
    "landmarks.octave": ("I8", ("P",)),
    "observations.offsets": ("I64", ("K+1",)),
    "observations.landmark": ("I32", ("M",)),
    "observations.pixel": ("F32", ("M", 2)),
    "observations.octave": ("I8", ("M",)),
    "observations.descriptor": ("U8", ("M", 32)),
    "path.time": ("F64", ("F",)),
    "path.quaternion": ("F64", ("F", 4)),
    "path.position": ("F64", ("F", 3)),
    "path.tracked": ("BOOL", ("F",)),
    "path.arc_length": ("F64", ("F",)),
}


class RouteMapFileError(ValueError):
    """A file that is no usable route map."""


class CorruptRouteMapError(RouteMapFileError):
    """The file is damaged, cut short, or something else altogether."""


class UnsupportedVersionError(RouteMapFileError):
    """The file was written by a later version of this program."""


def save_route_map(route_map: RouteMap, path: Path) -> None:
    """Write a map so that a reader sees either the whole file or none.

    Raises:
        OSError: the file cannot be written.
    """
    arrays = {name: _little_endian(_array(route_map, name)) for name in _FIELDS}
    metadata = {
        "format": "pairnavi-route-map",
        "version": str(FORMAT_VERSION),
        "camera": json.dumps(route_map.camera.to_json()),
        "scale": json.dumps(
            {"metres_per_unit": route_map.scale.metres_per_unit, "source": str(route_map.scale.source)}
        ),
        "turns": json.dumps([[t.start, t.end, t.angle] for t in route_map.turns]),
    }
    metadata["checksum"] = str(_checksum(arrays, metadata))
    data = save(arrays, metadata)
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        with temporary.open("wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


def load_route_map(path: Path, *, verify: bool = True) -> RouteMap:
    """Open a map; its arrays stay on disk until they are used.

    Args:
        verify: also read everything once and compare the checksum.

    Raises:
        FileNotFoundError: no such file.
        CorruptRouteMapError: damaged or no route map.
        UnsupportedVersionError: of a later version.
    """
    header, metadata, start = _read_header(path)
    try:
        arrays = _map_arrays(path, header, start, path.stat().st_size)
        if verify and _checksum(arrays, metadata) != int(metadata["checksum"]):
            raise CorruptRouteMapError("the checksum of the map does not fit: the file is damaged")
        return _route_map(arrays, metadata)
    except (KeyError, TypeError, ValueError, OverflowError, InvalidCameraError) as error:
        if isinstance(error, RouteMapFileError):
            raise
        raise CorruptRouteMapError(f"the map is damaged: {error}") from None


def format_version(path: Path) -> int:
    """The format version in which a map's file was written.

    Raises:
        FileNotFoundError, CorruptRouteMapError, UnsupportedVersionError: as :func:`load_route_map`.
    """
    return int(_read_header(path)[1]["version"])


def _read_header(path: Path) -> tuple[dict[str, Any], dict[str, str], int]:
    """What the header says of the arrays, the map's metadata, and where in the file the arrays begin."""
    size = path.stat().st_size
    with path.open("rb") as file:
        prefix = file.read(8)
        length = int.from_bytes(prefix, "little")
        if len(prefix) < 8 or length > min(size - 8, MAX_HEADER_BYTES):
            raise CorruptRouteMapError("the file is no route map, or was cut short")
        header_bytes = file.read(length)
    try:
        header = json.loads(header_bytes)
        metadata = header.pop("__metadata__")
        kind, version = metadata["format"], int(metadata["version"])
    except (ValueError, KeyError, AttributeError, TypeError, RecursionError):
        raise CorruptRouteMapError("the header of the file cannot be read") from None
    if kind != "pairnavi-route-map":
        raise CorruptRouteMapError("the file is no route map")
    if version > FORMAT_VERSION:
        raise UnsupportedVersionError(
            f"the map has format version {version}, this program reads up to {FORMAT_VERSION}: update it"
        )
    return header, metadata, 8 + length


def _array(route_map: RouteMap, name: str) -> NDArray[Any]:
    part, attribute = name.split(".")
    return np.asarray(getattr(getattr(route_map, part), attribute))


def _little_endian(array: NDArray[Any]) -> NDArray[Any]:
    return np.ascontiguousarray(array, dtype=array.dtype.newbyteorder("<"))


def _checksum(arrays: dict[str, NDArray[Any]], metadata: dict[str, str]) -> int:
    described = {name: text for name, text in metadata.items() if name != "checksum"}
    value = zlib.crc32(json.dumps(described, sort_keys=True).encode())
    for name in sorted(arrays):
        value = zlib.crc32(name.encode(), value)
        value = zlib.crc32(np.ascontiguousarray(arrays[name]).reshape(-1).view(np.uint8).data, value)
    return value


def _map_arrays(path: Path, header: dict[str, Any], start: int, size: int) -> dict[str, NDArray[Any]]:
    memory = np.memmap(path, dtype=np.uint8, mode="r")
    counts: dict[str, int] = {}
    arrays: dict[str, NDArray[Any]] = {}
    for name, (dtype_name, shape) in _FIELDS.items():
        entry = header[name]
        begin, end = (int(v) for v in entry["data_offsets"])
        found = tuple(int(n) for n in entry["shape"])
        dtype = _DTYPES[dtype_name]
        if entry["dtype"] != dtype_name or len(found) != len(shape) or min(found, default=0) < 0:
            raise CorruptRouteMapError(f"{name} has an unexpected type or shape")
        if end - begin != math.prod(found) * dtype.itemsize or begin < 0 or start + end > size:
            raise CorruptRouteMapError(f"{name} lies outside the file: it was cut short")
        for expected, count in zip(shape, found, strict=True):
            if isinstance(expected, str):
                symbol, extra = expected[0], 1 if expected.endswith("+1") else 0
                expected = counts.setdefault(symbol, count - extra) + extra
            if expected != count:
                raise CorruptRouteMapError(f"{name} has {count} rows, expected {expected}")
        arrays[name] = memory[start + begin : start + end].view(dtype).reshape(found)
    return arrays


def _route_map(arrays: dict[str, NDArray[Any]], metadata: dict[str, str]) -> RouteMap:
    parts: dict[str, dict[str, NDArray[Any]]] = {}
    for name, array in arrays.items():
        part, attribute = name.split(".")
        parts.setdefault(part, {})[attribute] = array
    observations = Observations(**parts["observations"])
    landmarks = len(parts["landmarks"]["position"])
    offsets = observations.offsets
    if offsets[0] != 0 or offsets[-1] != len(observations.landmark) or (np.diff(offsets) < 0).any():
        raise CorruptRouteMapError("the observations are not sorted by keyframe")
    if len(observations.landmark) and not (
        observations.landmark.min() >= 0 and observations.landmark.max() < landmarks
    ):
        raise CorruptRouteMapError("an observation names a landmark that does not exist")
    scale = json.loads(metadata["scale"])
    return RouteMap(
        camera=Camera.from_json(json.loads(metadata["camera"])),
        keyframes=Keyframes(**parts["keyframes"]),
        landmarks=Landmarks(**parts["landmarks"]),
        observations=observations,
        path=RoutePath(**parts["path"]),
        turns=tuple(Turn(*values) for values in json.loads(metadata["turns"])),
        scale=Scale(scale["metres_per_unit"], ScaleSource(scale["source"])),
    )
