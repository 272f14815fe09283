"""What the camera's motion while the shutter is open does to a picture.

Each pixel is averaged along the way that the point it shows takes through the picture, known from its
depth and the poses at which the shutter opens and closes. What is hidden in the middle of the exposure
is not seen at its ends: for the blur of a walk, a few pixels, that is too little to matter.
"""

from __future__ import annotations

import cv2
import numpy as np

from client_sim.synthetic.cameras import Pose
from client_sim.synthetic.exposure import Floats, Image
from client_sim.synthetic.rasterising import RayGrid

LEAST_PIXELS = 0.4
"""A picture in which nothing moves farther is left as it is."""

SAMPLE_PIXELS = 1.25
"""Distance of the samples along the way, at most :data:`MOST_SAMPLES`."""

MOST_SAMPLES = 15

STRIDE = 4
"""The way is worked out for every fourth pixel of every fourth row, and interpolated."""


def motion(grid: RayGrid, inverse_depth: Floats, middle: Pose, first: Pose, last: Pose) -> Floats:
    """Pixels (H, W, 2) that each pixel's point moves from the pose ``first`` to ``last``."""
    height, width = grid.shape
    rows, columns = slice(STRIDE // 2, None, STRIDE), slice(STRIDE // 2, None, STRIDE)
    x = grid.x[:, columns] if grid.x.shape[0] == 1 else grid.x[rows, columns]
    y = grid.y[rows] if grid.y.shape[1] == 1 else grid.y[rows, columns]
    w = np.where(np.isfinite(inverse_depth[rows, columns]), inverse_depth[rows, columns], 0.0)
    ends = []
    for pose in (first, last):
        turn = (pose.rotation.T @ middle.rotation).astype(np.float32)
        shift = (pose.rotation.T @ (middle.position - pose.position)).astype(np.float32)
        a, b, c = (turn[k, 0] * x + turn[k, 1] * y + turn[k, 2] + shift[k] * w for k in range(3))
        ends.append((a / np.maximum(c, 1e-3), b / np.maximum(c, 1e-3)))
    pitch = [p if p.size == 1 else p[rows, columns] for p in grid.pitch]
    ways = [((ends[1][k] - ends[0][k]) / pitch[k]).astype(np.float32) for k in range(2)]
    return np.stack([cv2.resize(way, (width, height)) for way in ways], axis=-1)


def blurred(image: Image, way: Floats) -> Image:
    """The picture (H, W, 3) averaged along each pixel's ``way`` (H, W, 2), which it is the middle of."""
    length = float(np.quantile(np.hypot(way[::8, ::8, 0], way[::8, ::8, 1]), 0.98))
    if length < LEAST_PIXELS:
        return image
    samples = int(np.clip(np.ceil(length / SAMPLE_PIXELS) + 1, 2, MOST_SAMPLES))
    height, width = image.shape[:2]
    column = np.arange(width, dtype=np.float32)[None, :]
    row = np.arange(height, dtype=np.float32)[:, None]
    total = np.full(image.shape, samples // 2, dtype=np.uint16)
    for part in (np.arange(samples) + 0.5) / samples - 0.5:
        moved = cv2.remap(
            image,
            column + np.float32(part) * way[..., 0],
            row + np.float32(part) * way[..., 1],
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_REPLICATE,
        )
        total += np.asarray(moved, dtype=np.uint8)
    return np.asarray((total // samples).astype(np.uint8))
