"""Plane mirrors: what they show is the scene from the camera's mirror image, behind the glass."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from client_sim.synthetic.cameras import Pose
from client_sim.synthetic.rasterising import NOWHERE, Canvas, Floats, RayGrid, affine

Array = NDArray[np.float64]


def reflected_points(points: Array, on: Array, normal: Array) -> Array:
    """Points (..., 3) mirrored in the plane through ``on`` with unit ``normal``."""
    return np.asarray(points - 2.0 * ((points - on) @ normal)[..., None] * normal)


def reflected(pose: Pose, on: Array, normal: Array) -> Pose:
    """The camera behind the glass; its "rotation" is improper (determinant -1).

    A point has the same coordinates in it as the point's mirror image has in the real camera.
    """
    flip = np.eye(3) - 2.0 * np.outer(normal, normal)
    return Pose(flip @ pose.rotation, reflected_points(pose.position, on, normal))


def reflection_canvas(grid: RayGrid, inside: NDArray[np.bool_], plane: Floats) -> Canvas:
    """A canvas open only ``inside`` (H, W) a mirror, and only beyond its plane.

    Args:
        plane: (3,) coefficients of the glass's own 1 / z.
    """
    closed = np.where(inside, np.float32(0.0), np.float32(np.inf))
    surface = np.full(grid.shape, NOWHERE, dtype=np.int32)
    return Canvas(surface, closed, affine(plane, grid.x, grid.y) * np.float32(1 - 1e-5))
