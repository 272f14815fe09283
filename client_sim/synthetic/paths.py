"""Ways over the floors of a building: rounded corners, wandering, detours, turns."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import gaussian_filter1d
from scipy.spatial import cKDTree

Array = NDArray[np.float64]

SPACING_M = 0.02
"""Spacing of a sampled path."""

RISE_SMOOTHING_M = 0.25
"""Metres of path over which the body takes the first and the last stair."""

SHORT_LEG = 4.0
"""Legs shorter than so many corner radii have their corners rounded less, in proportion."""


def arc_of(path: Array) -> Array:
    """Metres of ground covered up to each point of a path (N, 2 or 3), seen from above."""
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path[:, :2], axis=0), axis=1))])


def smoothed(series: Array, sigma: float) -> Array:
    """A Gaussian average down (N, ...) with a deviation in samples; the ends stay where they are."""
    half = min(len(series) - 1, round(4 * sigma))
    margin = [(half, half)] + [(0, 0)] * (series.ndim - 1)
    padded = np.pad(series, margin, mode="reflect", reflect_type="odd")
    smooth = gaussian_filter1d(padded, sigma, axis=0)
    return np.asarray(smooth[half : half + len(series)])


def smooth_path(waypoints: Sequence[Sequence[float]] | Array, corner_radius: float) -> Array:
    """Points (N, 2 or 3) every :data:`SPACING_M` along the waypoints, with rounded corners.

    A leg is stretched to :data:`SHORT_LEG` radii while corners are rounded, so that the path stays
    near a short one, as between two flights of stairs.
    """
    corners = np.asarray(waypoints, dtype=np.float64)
    legs = np.linalg.norm(np.diff(corners[:, :2], axis=0), axis=1)
    corners, legs = corners[np.concatenate([[True], legs > 0])], legs[legs > 0]
    at = np.concatenate([[0.0], np.cumsum(np.maximum(legs, SHORT_LEG * corner_radius))])
    if len(legs) == 1:
        at[1] = legs[0]
    even = np.arange(0.0, at[-1], SPACING_M)
    line = np.stack([np.interp(even, at, column) for column in corners.T], axis=1)
    path = smoothed(line, corner_radius / SPACING_M)
    if path.shape[1] == 3:
        path[:, 2] = smoothed(line[:, 2], min(corner_radius, RISE_SMOOTHING_M) / SPACING_M)
    arc = arc_of(path)
    even = np.arange(0.0, arc[-1], SPACING_M)
    return np.stack([np.interp(even, arc, column) for column in path.T], axis=1)


def wandered(path: Array, most: float, rng: np.random.Generator) -> Array:
    """The path (N, 2 or 3) displaced smoothly to its sides by at most ``most`` metres."""
    slow: Array = gaussian_filter1d(rng.normal(size=len(path)), 1.5 / SPACING_M, mode="reflect")
    slow *= most / np.abs(slow).max()
    ahead = np.gradient(path[:, :2], axis=0)
    ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
    aside = path.copy()
    aside[:, :2] += np.stack([-ahead[:, 1], ahead[:, 0]], axis=1) * slow[:, None]
    return aside


def directions(path: Array) -> Array:
    """Heading of a path (N, 2 or 3), radians from the x axis, without jumps, (N,)."""
    ahead = np.gradient(path[:, :2], axis=0)
    return np.asarray(np.unwrap(np.arctan2(ahead[:, 1], ahead[:, 0])))


@dataclass(frozen=True, slots=True)
class PathTurn:
    """A stretch of a path on which its heading changes.

    Attributes:
        at: metres of ground covered at its middle.
        angle: radians, positive to the left.
    """

    at: float
    angle: float


def path_turns(path: Array, *, least: float = np.radians(30.0), straight: float = 0.12) -> list[PathTurn]:
    """Turns of a path (N, 2 or 3) by at least ``least`` radians.

    Args:
        straight: radians a metre up to which a path is straight.
    """
    arc, heading = arc_of(path), directions(path)
    rate = smoothed(np.gradient(heading, arc), 0.3 / SPACING_M)
    side = np.where(np.abs(rate) > straight, np.sign(rate), 0.0)
    borders = np.flatnonzero(np.diff(side)) + 1
    turns = []
    for rows in np.split(np.arange(len(path)), borders):
        if side[rows[0]] == 0.0:
            continue
        angle = float(heading[rows[-1]] - heading[rows[0]])
        if abs(angle) >= least:
            turns.append(PathTurn(float((arc[rows[0]] + arc[rows[-1]]) / 2), angle))
    return turns


def split(waypoints: ArrayLike, at: float) -> tuple[Array, Array]:
    """The waypoints (N, 2 or 3) up to ``at`` metres of ground, and those from there.

    Raises:
        ValueError: the path is not so long.
    """
    points = np.asarray(waypoints, dtype=np.float64)
    arc = arc_of(points)
    if not 0.0 < at < arc[-1]:
        raise ValueError(f"a way of {arc[-1]:.1f} m cannot be left at {at:.1f} m")
    place = np.array([np.interp(at, arc, column) for column in points.T])
    before, after = points[arc < at - 1e-9], points[arc > at + 1e-9]
    return np.vstack([before, place]), np.vstack([place, after])


def distance_to(path: Array, points: Array) -> Array:
    """Metres from each of the points (M, 3) to the nearest of a path (N, 3), (M,)."""
    return np.asarray(cKDTree(path).query(points)[0])
