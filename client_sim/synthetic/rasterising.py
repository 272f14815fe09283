"""Which surface each pixel sees: a z-buffer of parallelograms and ellipsoids, for any lens.

A pixel's ray in the camera frame is (x, y, 1). On it, 1 / z of a plane is affine in (x, y), and so are
that plane's texture coordinates times 1 / z: everything about a parallelogram is three coefficients a
function, whatever the lens. Surfaces are drawn from near to far, and what lies behind everything
already drawn in its window is skipped: so a building costs what is in sight of it, not what there is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from client_sim.synthetic.cameras import Camera, Pose
from client_sim.synthetic.worlds import Quad

Floats = NDArray[np.float32]
Doubles = NDArray[np.float64]
Indices = NDArray[np.int32]

NEAR_M = 0.05
"""Surfaces nearer than this are not drawn."""

EDGE_M = 1e-4
"""Parallelograms reach this far over their edges, so that neighbours leave no gap between them."""

NOWHERE = -1
"""Surface index of a pixel that looks out of the building."""

SHRINK_PIXELS = 4000
"""Windows larger than this are first shrunk to where anything of the surface can still be seen."""


class RayGrid:
    """The rays of a camera's pixels and which pixels a range of rays covers.

    Attributes:
        x, y: float32, broadcastable to (height, width); 0 where the lens shows nothing.
        blind: (height, width) True where the lens shows nothing, None where it shows something everywhere.
        pitch: how much x changes from column to column, and y from row to row, broadcastable.
    """

    def __init__(self, camera: Camera) -> None:
        x, y = camera.slopes()
        unseen = np.isnan(x + y)
        self.shape = (camera.height, camera.width)
        self.blind = unseen if unseen.any() else None
        filled = (np.nan_to_num(x), np.nan_to_num(y))
        self.x, self.y = (f.astype(np.float32) for f in filled)
        self.pitch = tuple(
            np.full((1, 1), np.abs(np.diff(f, axis=axis)).mean(), dtype=np.float32)
            if 1 in f.shape
            else np.maximum(np.abs(np.gradient(f, axis=axis)), 1e-6).astype(np.float32)
            for f, axis in ((filled[0], 1), (filled[1], 0))
        )
        # The least and the greatest slope of each column and row, made monotone so as to be searched.
        with np.errstate(invalid="ignore"):
            low, high = np.where(np.isnan(x), np.inf, x), np.where(np.isnan(x), -np.inf, x)
            self._columns = _monotone(low.min(axis=0), high.max(axis=0))
            low, high = np.where(np.isnan(y), np.inf, y), np.where(np.isnan(y), -np.inf, y)
            self._rows = _monotone(low.min(axis=1), high.max(axis=1))

    def windows(self, low: Doubles, high: Doubles) -> Indices:
        """Pixels that see slopes between ``low`` and ``high``, (N, 2) each.

        Returns:
            (N, 4): first row, end row, first column, end column; empty where first >= end.
        """
        edges = []
        for axis, (least, most) in ((1, self._rows), (0, self._columns)):
            edges.append(np.searchsorted(most, low[:, axis], side="left"))
            edges.append(np.searchsorted(least, high[:, axis], side="right"))
        return np.stack(edges, axis=1).astype(np.int32)


def _monotone(low: Doubles, high: Doubles) -> tuple[Doubles, Doubles]:
    return np.minimum.accumulate(low[::-1])[::-1], np.maximum.accumulate(high)


@dataclass(frozen=True, eq=False, slots=True)
class Planes:
    """Per quad, coefficients (Q, 3) of x, y, 1 of functions that are affine along the rays.

    Attributes:
        inverse_depth: 1 / z; zero for what turns its back.
        across, down: texture coordinates, in repetitions of the texture, times 1 / z.
        edges: (Q, 4, 3) functions that are not negative inside the four edges.
        windows: (Q, 4) of :meth:`RayGrid.windows`.
        nearest: (Q,) no point in sight has a greater 1 / z.
        order: quads in sight, those with the nearest points first.
    """

    inverse_depth: Floats
    across: Floats
    down: Floats
    edges: Floats
    windows: Indices
    nearest: Floats
    order: NDArray[np.intp]


class Surfaces:
    """The quads of a world as arrays."""

    def __init__(self, quads: Sequence[Quad]) -> None:
        self.corner = np.stack([quad.corner for quad in quads])
        across, down = (np.stack([getattr(quad, side) for quad in quads]) for side in ("across", "down"))
        self.size = np.stack([np.linalg.norm(across, axis=1), np.linalg.norm(down, axis=1)], axis=1)
        normal = np.cross(down, across)
        self.normal = normal / np.linalg.norm(normal, axis=1, keepdims=True)
        frames = np.stack([across / self.size[:, :1], down / self.size[:, 1:], self.normal], axis=2)
        # Rows of the inverse: the metres along either side are their products with a point.
        self._duals = np.linalg.inv(frames)[:, :2]
        self._corners = np.stack(
            [self.corner, self.corner + across, self.corner + across + down, self.corner + down], axis=1
        )
        tiles = np.array(
            [quad.tile or tuple(size) for quad, size in zip(quads, self.size, strict=True)], dtype=np.float64
        )
        self.tiles = tiles
        self.shift = np.array([quad.shift for quad in quads])

    def planes(self, pose: Pose, grid: RayGrid, behind: tuple[Doubles, Doubles] | None = None) -> Planes:
        """The quads from a pose.

        Args:
            behind: a point and a normal; what lies wholly on the normal's other side is left out.
        """
        corner = pose.to_camera(self.corner)
        normal = self.normal @ pose.rotation
        height = (normal * corner).sum(axis=1, keepdims=True)
        corners = pose.to_camera(self._corners)
        shown = (height[:, 0] < -1e-9) & (corners[..., 2].max(axis=1) > NEAR_M)
        if behind is not None:
            shown &= ((self._corners - behind[0]) @ behind[1]).max(axis=1) > 1e-6
        w = np.where(shown[:, None], normal / np.where(shown[:, None], height, 1.0), 0.0)
        duals = self._duals @ pose.rotation
        metres = duals - np.einsum("qki,qi->qk", duals, corner)[..., None] * w[:, None]
        low = metres + EDGE_M * w[:, None]
        high = (self.size + EDGE_M)[..., None] * w[:, None] - metres
        places = metres / self.tiles[..., None] + self.shift[..., None] * w[:, None]
        windows, nearest = self._windows(corners, grid)
        shown &= (windows[:, 0] < windows[:, 1]) & (windows[:, 2] < windows[:, 3])
        order = np.flatnonzero(shown)
        order = order[np.argsort(-nearest[order], kind="stable")]
        return Planes(
            w.astype(np.float32),
            places[:, 0].astype(np.float32),
            places[:, 1].astype(np.float32),
            np.concatenate([low, high], axis=1).astype(np.float32),
            windows,
            nearest.astype(np.float32),
            order,
        )

    @staticmethod
    def _windows(corners: Doubles, grid: RayGrid) -> tuple[Indices, Doubles]:
        """Windows (Q, 4) and greatest inverse depths (Q,) of corners (Q, 4, 3) in the camera frame."""
        follow = np.roll(corners, -1, axis=1)
        z, next_z = corners[..., 2], follow[..., 2]
        crossing = (z >= NEAR_M) != (next_z >= NEAR_M)
        part = (NEAR_M - z) / np.where(crossing, next_z - z, 1.0)
        cut = corners + part[..., None] * (follow - corners)
        points = np.concatenate([corners, cut], axis=1)
        valid = np.concatenate([z >= NEAR_M, crossing], axis=1)
        inverse = 1.0 / np.where(valid, np.maximum(points[..., 2], NEAR_M), 1.0)
        slopes = points[..., :2] * inverse[..., None]
        low = np.where(valid[..., None], slopes, np.inf).min(axis=1)
        high = np.where(valid[..., None], slopes, -np.inf).max(axis=1)
        return grid.windows(low, high), np.where(valid, inverse, 0.0).max(axis=1) * (1 + 1e-6)


@dataclass(frozen=True, eq=False, slots=True)
class Canvas:
    """What has been drawn.

    Attributes:
        surface: (H, W) index of the surface a pixel sees, :data:`NOWHERE` at first.
        inverse_depth: (H, W) 1 / z of it; infinite where nothing may be drawn.
        farthest: (H, W) functions' window: 1 / z that what is drawn must stay below, None for any.
    """

    surface: Indices
    inverse_depth: Floats
    farthest: Floats | None = None


def blank(grid: RayGrid) -> Canvas:
    """A canvas on which nothing is drawn yet."""
    canvas = Canvas(np.full(grid.shape, NOWHERE, dtype=np.int32), np.zeros(grid.shape, dtype=np.float32))
    if grid.blind is not None:
        canvas.inverse_depth[grid.blind] = np.inf
    return canvas


def draw(canvas: Canvas, grid: RayGrid, planes: Planes, offset: int = 0) -> None:
    """Draw quads; quad q becomes surface ``offset`` + q."""
    for q in planes.order:
        window = visible_window(canvas, planes.windows[q], planes.nearest[q])
        if window is None:
            continue
        x = grid.x[:, window[1]] if grid.x.shape[0] == 1 else grid.x[window]
        y = grid.y[window[0]] if grid.y.shape[1] == 1 else grid.y[window]
        near = canvas.inverse_depth[window]
        w = affine(planes.inverse_depth[q], x, y)
        covered = w > near
        covered &= w < np.float32(1.0 / NEAR_M)
        if canvas.farthest is not None:
            covered &= w < canvas.farthest[window]
        for edge in planes.edges[q]:
            covered &= affine(edge, x, y) >= 0
        np.copyto(near, w, where=covered)
        np.copyto(canvas.surface[window], np.int32(offset + q), where=covered)


def visible_window(canvas: Canvas, window: Indices, nearest: float) -> tuple[slice, slice] | None:
    """The part of a window in which something at inverse depth ``nearest`` can be seen, None if none."""
    top, bottom, left, right = window.tolist()
    near = canvas.inverse_depth[top:bottom, left:right]
    if near.size == 0 or near.min() >= nearest:
        return None
    if near.size > SHRINK_PIXELS:
        open_ = near < nearest
        rows, columns = np.flatnonzero(open_.any(axis=1)), np.flatnonzero(open_.any(axis=0))
        top, bottom = top + int(rows[0]), top + int(rows[-1]) + 1
        left, right = left + int(columns[0]), left + int(columns[-1]) + 1
    return slice(top, bottom), slice(left, right)


def affine(f: Floats, x: Floats, y: Floats) -> Floats:
    """``f0 x + f1 y + f2`` on a window of rays."""
    return np.asarray((f[0] * x + f[2]) + f[1] * y)
