"""Routes drawn with a ruler: maps with a path and nothing to see, for guidance alone."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from client_sim.synthetic.cameras import level_rotation
from client_sim.synthetic.paths import smooth_path
from server.geometry.cameras import Camera
from server.geometry.poses import SE3, quaternion_from_rotation
from server.mapping.route_map import Keyframes, Landmarks, Observations, RouteMap, RoutePath, Scale
from server.mapping.trajectory import find_turns, smoothed, walked

Array = NDArray[np.float64]


def route_along(
    waypoints: Sequence[tuple[float, float]], *, scale: Scale | None = None, radius: float = 0.5
) -> RouteMap:
    """Walked at one unit a second, looking ahead; corners are rounded."""
    path = smooth_path(waypoints, radius)
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
    times = np.arange(0.0, arc[-1], 0.1)
    xy = np.stack([np.interp(times, arc, path[:, k]) for k in range(2)], axis=1)
    direction = np.unwrap(np.arctan2(*np.gradient(path, axis=0).T[::-1]))
    rotations = np.stack([level_rotation(h) for h in np.interp(times, arc, direction)])
    positions = np.column_stack([xy, np.zeros(len(times))])
    quaternions = quaternion_from_rotation(rotations)
    length = walked(positions, times)
    rows = np.arange(0, len(times), 5, dtype=np.int32)
    return RouteMap(
        camera=Camera.pinhole(640, 480, 500.0, 500.0, 320.0, 240.0),
        keyframes=Keyframes(rows, quaternions[rows], positions[rows]),
        landmarks=Landmarks(
            np.zeros((0, 3)),
            np.zeros((0, 32), np.uint8),
            np.zeros((0, 3), np.float32),
            np.zeros((0, 2), np.float32),
            np.zeros(0, np.int8),
        ),
        observations=Observations(
            np.zeros(len(rows) + 1, np.int64),
            np.zeros(0, np.int32),
            np.zeros((0, 2), np.float32),
            np.zeros(0, np.int8),
            np.zeros((0, 32), np.uint8),
        ),
        path=RoutePath(times, quaternions, positions, np.ones(len(times), np.bool_), length),
        turns=find_turns(smoothed(positions, times), length),
        scale=scale or Scale(),
    )


def at(x: float, y: float, heading_deg: float, *, pitch_deg: float = 0.0, height: float = 0.0) -> SE3:
    """A level camera there, looking along a heading counter-clockwise from x."""
    rotation = level_rotation(np.radians(heading_deg), np.radians(pitch_deg))
    return SE3(rotation, np.array([x, y, height]))
