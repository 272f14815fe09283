"""What rays meet, by plain intersection in double precision: the renderer is held against it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from client_sim.synthetic.cameras import Camera, Pose
from client_sim.synthetic.rendering import NOWHERE
from client_sim.synthetic.worlds import Solid, World

Array = NDArray[np.float64]


def camera_rays(camera: Camera, pose: Pose) -> Array:
    """World rays (N, 3) of the pixel centres, row by row, of length 1 along the optical axis."""
    x, y = np.broadcast_arrays(*camera.slopes())
    return np.stack([x, y, np.ones_like(x)], axis=-1).reshape(-1, 3) @ pose.rotation.T


def first_quads(world: World, starts: Array, rays: Array) -> tuple[NDArray[np.int64], Array]:
    """Nearest front-facing quad (N,) along rays (N, 3), and at which multiples of the rays.

    Args:
        starts: (3,) or (N, 3).
    """
    rays = np.atleast_2d(rays)
    starts = np.broadcast_to(starts, rays.shape)
    corner, across, down = (
        np.stack([getattr(quad, name) for quad in world.quads]) for name in ("corner", "across", "down")
    )
    normal = np.cross(down, across)
    inverse = np.linalg.inv(np.stack([across, down, normal], axis=2))
    hit, best = np.full(len(rays), NOWHERE), np.full(len(rays), np.inf)
    for rows in np.array_split(np.arange(len(rays)), max(1, len(rays) // 400)):
        towards = rays[rows] @ normal.T
        height = (corner * normal).sum(axis=1) - starts[rows] @ normal.T
        with np.errstate(divide="ignore", invalid="ignore"):
            distance = height / towards
        row, quad = np.nonzero((towards < 0) & (distance > 0))
        found = distance[row, quad]
        place = starts[rows][row] + found[:, None] * rays[rows][row] - corner[quad]
        sides = np.einsum("nij,nj->ni", inverse[quad, :2], place)
        inside = ((sides >= 0) & (sides <= 1)).all(axis=1)
        nearest = np.full(distance.shape, np.inf)
        nearest[row[inside], quad[inside]] = found[inside]
        hit[rows], best[rows] = nearest.argmin(axis=1), nearest.min(axis=1)
    hit[np.isinf(best)] = NOWHERE
    return hit, best


def solid_distance(solid: Solid, start: Array, rays: Array) -> Array:
    """Multiples (N,) of the rays (N, 3) at which they enter an ellipsoid, infinite where they miss."""
    inverse = np.linalg.inv(solid.axes)
    d, o = rays @ inverse.T, inverse @ (start - solid.centre)
    a, b, c = (d * d).sum(axis=1), d @ o, o @ o - 1
    discriminant = b * b - a * c
    with np.errstate(invalid="ignore"):
        distance = (-b - np.sqrt(discriminant)) / a
    return np.where((discriminant > 0) & (distance > 0), distance, np.inf)
