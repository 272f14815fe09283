"""Drawing ellipsoids: people, plants, bags."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from client_sim.synthetic.cameras import Pose
from client_sim.synthetic.rasterising import NEAR_M, Canvas, Floats, RayGrid, visible_window
from client_sim.synthetic.worlds import Solid, Texture

_LIGHT = np.array([0.25, -0.15, 0.956])
"""Where most light comes from: the ceiling."""

_AMBIENT = 0.66
"""Part of the light that comes from all sides."""


def draw_solids(
    canvas: Canvas,
    painted: Texture,
    grid: RayGrid,
    pose: Pose,
    solids: Sequence[Solid],
    offset: int,
) -> None:
    """Draw ellipsoids; solid k becomes surface ``offset`` + k, its colour goes to ``painted`` (H, W, 3).

    The silhouette's bounds are those of the dual conic (Hartley and Zisserman, Multiple View Geometry,
    2nd ed., eq. 8.5).
    """
    if not solids:
        return
    centre = pose.to_camera(np.stack([solid.centre for solid in solids]))
    world_axes = np.stack([solid.axes for solid in solids])
    axes = np.swapaxes(pose.rotation[None], 1, 2) @ world_axes
    spread = axes @ np.swapaxes(axes, 1, 2)
    reach = np.sqrt(spread[:, 2, 2])
    front = centre[:, 2] - reach
    conic = spread - centre[:, :, None] * centre[:, None, :]
    low, high = np.full((len(solids), 2), -np.inf), np.full((len(solids), 2), np.inf)
    whole = front > 2 * NEAR_M
    for k in range(2):
        a, b, c = conic[whole, 2, 2], conic[whole, k, 2], conic[whole, k, k]
        root = np.sqrt(np.maximum(b * b - a * c, 0.0))
        low[whole, k], high[whole, k] = (b + root) / a, (b - root) / a
    windows = grid.windows(low, high)
    nearest = (1.0 / np.maximum(front, NEAR_M)).astype(np.float32)
    shown = (
        (centre[:, 2] + reach > NEAR_M) & (windows[:, 0] < windows[:, 1]) & (windows[:, 2] < windows[:, 3])
    )
    order = np.flatnonzero(shown)
    for k in order[np.argsort(-nearest[order], kind="stable")]:
        window = visible_window(canvas, windows[k], nearest[k])
        if window is not None:
            _draw_one(canvas, painted, grid, pose, solids[k], window, offset + int(k))


def _draw_one(
    canvas: Canvas,
    painted: Texture,
    grid: RayGrid,
    pose: Pose,
    solid: Solid,
    window: tuple[slice, slice],
    index: int,
) -> None:
    """Rays meet the unit sphere in the ellipsoid's own frame."""
    inverse = np.asarray(np.linalg.inv(solid.axes), dtype=np.float64)
    start = inverse @ (pose.position - solid.centre)
    if start @ start <= 1.0:
        return  # the camera is inside
    shape = (window[0].stop - window[0].start, window[1].stop - window[1].start)
    x = np.broadcast_to(grid.x[:, window[1]] if grid.x.shape[0] == 1 else grid.x[window], shape)
    y = np.broadcast_to(grid.y[window[0]] if grid.y.shape[1] == 1 else grid.y[window], shape)
    turn = inverse @ pose.rotation
    # |d|^2 t^2 + 2 (o . d) t + |o|^2 - 1 = 0 with d affine in the slopes: both are small polynomials.
    gram, mixed = (turn.T @ turn).astype(np.float32), (start @ turn).astype(np.float32)
    a = (gram[0, 0] * x + 2 * gram[0, 2]) * x + (gram[1, 1] * y + 2 * gram[1, 2]) * y + gram[2, 2]
    a += 2 * gram[0, 1] * (x * y)
    b = mixed[0] * x + mixed[1] * y + mixed[2]
    c = np.float32(start @ start - 1.0)
    discriminant = b * b - a * c
    depth = c / np.where(discriminant > 0, -b + np.sqrt(np.maximum(discriminant, 0)), np.float32(-1.0))
    near = canvas.inverse_depth[window]
    covered = depth > NEAR_M
    w = 1.0 / np.where(covered, depth, np.float32(1.0))
    covered &= w > near
    if canvas.farthest is not None:
        covered &= w < canvas.farthest[window]
    if not covered.any():
        return
    t = depth[covered]
    rays = np.stack([x[covered], y[covered], np.ones_like(t)], axis=1) * t[:, None]
    points = np.asarray(rays @ turn.T.astype(np.float32) + start.astype(np.float32), dtype=np.float32)
    np.copyto(near, w, where=covered)
    np.copyto(canvas.surface[window], np.int32(index), where=covered)
    painted[window][covered] = _colour(points, solid, inverse, float(np.sqrt(len(t))))


def _colour(points: Floats, solid: Solid, inverse: NDArray[np.float64], side: float) -> NDArray[np.uint8]:
    """Texture and shade at points (N, 3) of the unit sphere; ``side`` is the ellipsoid's size in pixels."""
    texture = solid.texture
    rows = max(4, min(texture.shape[0], int(2 * side)))
    if rows < texture.shape[0]:
        columns = max(4, round(texture.shape[1] * rows / texture.shape[0]))
        texture = np.asarray(cv2.resize(texture, (columns, rows), interpolation=cv2.INTER_AREA), np.uint8)
    column = (np.arctan2(points[:, 1], points[:, 0]) / (2 * np.pi) + 0.5) * texture.shape[1]
    row = np.arccos(np.clip(points[:, 2], -1, 1)) / np.pi * texture.shape[0]
    colour = texture[
        np.minimum(row.astype(np.intp), texture.shape[0] - 1),
        np.minimum(column.astype(np.intp), texture.shape[1] - 1),
    ]
    normal = points @ inverse.astype(np.float32)
    slope = (normal @ _LIGHT.astype(np.float32)) / np.linalg.norm(normal, axis=1)
    shade = np.float32(solid.light) * (_AMBIENT + (1 - _AMBIENT) * slope)
    return np.asarray((colour * shade[:, None]).clip(0, 255).astype(np.uint8))
