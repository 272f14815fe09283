"""A map as a PLY file: landmarks, and the walked path with edges along it.

Binary, little endian (Turk, "The PLY polygon file format", 1994): what MeshLab, CloudCompare, Blender and
Open3D open. Landmarks are coloured by height, the path from dark to bright by time.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from server.mapping.exchange.colours import coloured, coloured_by_height
from server.mapping.exchange.units import export_scale, unit_in_words
from server.mapping.route_map import RouteMap

_COLOUR = ("red", "green", "blue")
_VERTEX = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), *((name, "u1") for name in _COLOUR)])
_EDGE = np.dtype([("vertex1", "<i4"), ("vertex2", "<i4")])
_TYPE_NAMES = {"<f4": "float", "<i4": "int", "|u1": "uchar"}


def ply_file(route_map: RouteMap) -> bytes:
    """The bytes of the file: landmarks first, then the path's frames; lengths as its comment says."""
    path = route_map.path
    landmarks = len(route_map.landmarks)
    scale = export_scale(route_map)
    times = coloured(path.time, float(path.time[0]), float(path.time[-1]))
    vertices = np.zeros(landmarks + len(path), _VERTEX)
    positions = scale * np.concatenate([route_map.landmarks.position, path.position])
    colours = np.concatenate([coloured_by_height(route_map.landmarks.position), times])
    for column in range(3):
        vertices["xyz"[column]] = positions[:, column]
        vertices[_COLOUR[column]] = colours[:, column]
    edges = np.zeros(len(path) - 1, _EDGE)
    edges["vertex1"] = landmarks + np.arange(len(path) - 1)
    edges["vertex2"] = edges["vertex1"] + 1
    header = "\n".join(
        [
            "ply",
            "format binary_little_endian 1.0",
            f"comment route map: {landmarks} landmarks, then {len(path)} frames of the leader's path",
            f"comment z up; lengths in {unit_in_words(route_map)}",
            *_declared("vertex", vertices),
            *_declared("edge", edges),
            "end_header\n",
        ]
    )
    return header.encode("ascii") + vertices.tobytes() + edges.tobytes()


def _declared(name: str, rows: NDArray[np.void]) -> list[str]:
    fields = [(field, rows.dtype[field].str) for field in rows.dtype.names or ()]
    return [
        f"element {name} {len(rows)}",
        *(f"property {_TYPE_NAMES[kind]} {field}" for field, kind in fields),
    ]
