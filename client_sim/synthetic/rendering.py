"""Pictures of the synthetic building: depth-tested rectangles, filtered textures, light and noise."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from client_sim.synthetic.atlas import LEVELS, build_atlas
from client_sim.synthetic.cameras import PinholeCamera, Pose
from client_sim.synthetic.worlds import World

Image = NDArray[np.uint8]
Floats = NDArray[np.float32]

NEAR_M = 0.05
"""Surfaces nearer than this are not drawn."""

EDGE_M = 1e-4
"""Rectangles reach this far over their edges, so that neighbours leave no gap between them."""

NOWHERE = -1
"""Surface index of a pixel that looks out of the building."""


@dataclass(frozen=True, slots=True)
class Light:
    """How a walk's pictures are exposed.

    Attributes:
        gain: brightness factor.
        gamma: exponent of the tone curve, above 1 darkens the middle tones.
        warmth: factor of red against blue.
        vignette: loss of light in the corners, 0 to 1.
        noise: standard deviation of the sensor noise, grey levels.
    """

    gain: float = 1.0
    gamma: float = 1.0
    warmth: float = 1.0
    vignette: float = 0.15
    noise: float = 1.5


@dataclass(frozen=True, eq=False, slots=True)
class _Planes:
    """Per quad, coefficients (3,) of u, v, 1 of functions that are affine in the pixel (u, v).

    ``inverse_depth`` w is 1 / z; ``across`` and ``down`` are metres from the quad's corner times w.
    """

    inverse_depth: Floats
    across: Floats
    down: Floats


class Renderer:
    """Draws one world for one camera."""

    def __init__(self, world: World, camera: PinholeCamera) -> None:
        self.world = world
        self.camera = camera
        self._atlas = build_atlas([quad.texture for quad in world.quads])
        self._corner = np.stack([quad.corner for quad in world.quads])
        self._size = np.array([quad.size for quad in world.quads])
        self._across = np.stack([quad.across for quad in world.quads]) / self._size[:, :1]
        self._down = np.stack([quad.down for quad in world.quads]) / self._size[:, 1:]
        self._texels = (np.array([quad.texture.shape[1::-1] for quad in world.quads]) / self._size).astype(
            np.float32
        )
        self._u = (np.arange(camera.width, dtype=np.float32) + np.float32(0.5))[None, :]
        self._v = (np.arange(camera.height, dtype=np.float32) + np.float32(0.5))[:, None]
        x = (self._u - camera.cx) / camera.fx
        y = (self._v - camera.cy) / camera.fy
        radius = (x**2 + y**2) / float((x**2).max() + (y**2).max())
        self._corner_darkness = radius.astype(np.float32)

    def surfaces(self, pose: Pose) -> NDArray[np.int16]:
        """Index of the quad each pixel's centre sees, (H, W); :data:`NOWHERE` where it sees none."""
        return self._draw(pose)[0]

    def render(self, pose: Pose, light: Light | None = None, rng: np.random.Generator | None = None) -> Image:
        """The picture from a pose, (H, W, 3) uint8, BGR.

        Args:
            light: exposure; without it the bare textures.
            rng: draws the sensor noise; without it there is none.
        """
        surface, planes = self._draw(pose)
        colour = self._texture(surface, planes)
        # Without a lens's own blur the silhouettes would be saw-toothed.
        soft = np.asarray(cv2.GaussianBlur(colour, (3, 3), 0.6), dtype=np.uint8)
        return soft if light is None else self._expose(soft, light, rng)

    def _planes(self, pose: Pose) -> tuple[_Planes, NDArray[np.float64]]:
        """Affine functions of the pixel for each quad, and its four corners in the camera, (Q, 4, 3)."""
        corner = pose.to_camera(self._corner)
        across, down = self._across @ pose.rotation, self._down @ pose.rotation
        normal = np.cross(down, across)
        height = (normal * corner).sum(axis=1, keepdims=True)
        facing = height[:, 0] < -1e-9
        w = np.where(facing[:, None], normal / np.where(facing[:, None], height, 1.0), 0.0)
        a = across - (across * corner).sum(axis=1, keepdims=True) * w
        b = down - (down * corner).sum(axis=1, keepdims=True) * w
        camera = self.camera
        # A ray is (x, y, 1) with x = (u - cx) / fx: coefficients of x, y, 1 become those of u, v, 1.
        ray = np.array(
            [
                [1 / camera.fx, 0, 0],
                [0, 1 / camera.fy, 0],
                [-camera.cx / camera.fx, -camera.cy / camera.fy, 1],
            ]
        )
        planes = _Planes(*((ray @ f.T).T.astype(np.float32) for f in (w, a, b)))
        right, below = across * self._size[:, :1], down * self._size[:, 1:]
        return planes, np.stack([corner, corner + right, corner + right + below, corner + below], axis=1)

    def _window(self, corners: NDArray[np.float64]) -> tuple[slice, slice] | None:
        """Rows and columns that a quad (4, 3) in the camera frame can cover, None if out of sight."""
        kept = []
        for p, q in zip(corners, np.roll(corners, -1, axis=0), strict=True):
            if p[2] >= NEAR_M:
                kept.append(p)
            if (p[2] >= NEAR_M) != (q[2] >= NEAR_M):
                kept.append(p + (q - p) * ((NEAR_M - p[2]) / (q[2] - p[2])))
        if not kept:
            return None
        points = np.asarray(kept)
        camera = self.camera
        u = camera.fx * points[:, 0] / points[:, 2] + camera.cx
        v = camera.fy * points[:, 1] / points[:, 2] + camera.cy
        left, right = max(0, int(np.floor(u.min())) - 1), min(camera.width, int(np.ceil(u.max())) + 1)
        top, bottom = max(0, int(np.floor(v.min())) - 1), min(camera.height, int(np.ceil(v.max())) + 1)
        if left >= right or top >= bottom:
            return None
        return slice(top, bottom), slice(left, right)

    def _draw(self, pose: Pose) -> tuple[NDArray[np.int16], _Planes]:
        planes, corners = self._planes(pose)
        shape = (self.camera.height, self.camera.width)
        surface = np.full(shape, NOWHERE, dtype=np.int16)
        nearest = np.zeros(shape, dtype=np.float32)
        for q in range(len(corners)):
            if not planes.inverse_depth[q].any():
                continue
            window = self._window(corners[q])
            if window is None:
                continue
            u, v = self._u[:, window[1]], self._v[window[0]]
            w = _affine(planes.inverse_depth[q], u, v)
            width, height = self._size[q].astype(np.float32)
            covered = (w > nearest[window]) & (w < 1.0 / NEAR_M)
            for f, length in ((planes.across[q], width), (planes.down[q], height)):
                low, high = np.float32(-EDGE_M), np.float32(length + EDGE_M)
                covered &= _affine(f - low * planes.inverse_depth[q], u, v) >= 0
                covered &= _affine(f - high * planes.inverse_depth[q], u, v) <= 0
            np.copyto(nearest[window], w, where=covered)
            surface[window][covered] = q
        return surface, planes

    def _texture(self, surface: NDArray[np.int16], planes: _Planes) -> Image:
        index = np.maximum(surface, 0).astype(np.intp)
        w_u, w_v, w = self._at_pixels(planes.inverse_depth, index)
        depth = 1.0 / np.where(surface >= 0, w, 1.0)
        place, level = [], []
        for axis, f in enumerate((planes.across, planes.down)):
            f_u, f_v, metres = self._at_pixels(f, index)
            metres *= depth
            # Texels of the finest level that a step of one pixel crosses.
            step = np.hypot(f_u - metres * w_u, f_v - metres * w_v) * depth
            step *= self._texels[:, axis].take(index)
            # log2 by the float's exponent: rounds at 1.5 of each power of two.
            levels = np.frexp(step * np.float32(4.0 / 3.0))[1] - 1
            level.append(np.clip(levels, 0, LEVELS - 1))
            length = self._size[:, axis].astype(np.float32).take(index)
            place.append(np.clip(metres / length, 0.0, 1.0))
        flat = (index * LEVELS + level[0]) * LEVELS + level[1]
        maps = [
            self._atlas.origin[..., k].ravel().take(flat)
            + self._atlas.scale[..., k].ravel().take(flat) * place[k]
            for k in range(2)
        ]
        image = cv2.remap(self._atlas.image, maps[0], maps[1], cv2.INTER_LINEAR)
        outside = surface < 0
        if outside.any():
            image[outside] = 40
        return np.asarray(image, dtype=np.uint8)

    def _at_pixels(self, f: Floats, index: NDArray[np.intp]) -> tuple[Floats, Floats, Floats]:
        """Derivatives by u and v, and values, of each pixel's own affine function."""
        f_u, f_v = f[:, 0].take(index), f[:, 1].take(index)
        return f_u, f_v, f_u * self._u + f_v * self._v + f[:, 2].take(index)

    def _expose(self, colour: Image, light: Light, rng: np.random.Generator | None) -> Image:
        levels = np.arange(256) / 255.0
        tint = np.sqrt(light.warmth)
        curve = np.stack(
            [255.0 * light.gain * t * levels**light.gamma for t in (1.0 / tint, 1.0, tint)], axis=-1
        )
        table = curve.clip(0, 255).round().astype(np.uint8)[None]
        out = cv2.LUT(colour, table)
        if light.vignette > 0:
            factor = 1.0 - light.vignette * self._corner_darkness
            out = cv2.multiply(out, cv2.merge([factor] * 3), dtype=cv2.CV_8U)
        if rng is not None and light.noise > 0:
            out = _add_noise(np.asarray(out, dtype=np.uint8), light.noise, rng)
        return np.asarray(out, dtype=np.uint8)


def _affine(f: Floats, u: Floats, v: Floats) -> Floats:
    """``f0 u + f1 v + f2`` on a window of pixels."""
    return np.asarray((f[0] * u + f[2]) + f[1] * v)


def _add_noise(image: Image, sigma: float, rng: np.random.Generator) -> Image:
    """Grey noise, drawn as a tile four times smaller and shifted: fast, and new in every picture."""
    height, width = image.shape[:2]
    tile = rng.normal(scale=sigma, size=(height // 2 + 1, width // 2 + 1)).astype(np.float32)
    noise = np.roll(np.tile(tile, (2, 2)), rng.integers(0, 64, size=2), axis=(0, 1))[:height, :width]
    return np.asarray(cv2.add(image, cv2.merge([noise] * 3), dtype=cv2.CV_8U), dtype=np.uint8)
