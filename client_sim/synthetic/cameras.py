"""The cameras that film the synthetic building, and their poses.

Camera axes x right, y down, z forward; world z up; metres. The centre of the first pixel is
(0.5, 0.5), as in COLMAP; models and their parameters are COLMAP's too.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

MAX_SLOPE = 6.0
"""Beyond this tangent of the angle to the optical axis (80 degrees) a fisheye's picture is black."""


class Camera(Protocol):
    """What the renderer asks of a camera."""

    @property
    def width(self) -> int:
        """Pixels."""

    @property
    def height(self) -> int:
        """Pixels."""

    def slopes(self) -> tuple[Array, Array]:
        """x / z and y / z along each pixel centre's ray, each broadcastable to (height, width).

        NaN where the lens shows nothing.
        """

    def pixels(self, slopes: Array) -> Array:
        """(..., 2) slopes -> (..., 2) pixels."""

    def to_json(self, fps: float) -> dict[str, Any]:
        """The content of a walk folder's ``camera.json``."""


@dataclass(frozen=True, slots=True)
class PinholeCamera:
    """Intrinsics, all in pixels."""

    width: int = 640
    height: int = 480
    fx: float = 500.0
    fy: float = 500.0
    cx: float = 320.0
    cy: float = 240.0

    def slopes(self) -> tuple[Array, Array]:
        """x / z as (1, width) and y / z as (height, 1)."""
        u, v = np.arange(self.width) + 0.5, np.arange(self.height) + 0.5
        return np.asarray((u[None, :] - self.cx) / self.fx), np.asarray((v[:, None] - self.cy) / self.fy)

    def pixels(self, slopes: Array) -> Array:
        """(..., 2) slopes -> (..., 2) pixels."""
        return np.asarray(slopes * (self.fx, self.fy) + (self.cx, self.cy))

    def to_json(self, fps: float) -> dict[str, Any]:
        """The content of a walk folder's ``camera.json``."""
        return {
            "model": "PINHOLE",
            "width": self.width,
            "height": self.height,
            "params": [self.fx, self.fy, self.cx, self.cy],
            "fps": fps,
        }


PARAMETERS = {"SIMPLE_RADIAL": 4, "RADIAL": 5, "OPENCV": 8, "OPENCV_FISHEYE": 8}
"""How many parameters the models with distortion take.

``SIMPLE_RADIAL`` f, cx, cy, k; ``RADIAL`` f, cx, cy, k1, k2; ``OPENCV`` fx, fy, cx, cy, k1, k2, p1, p2;
``OPENCV_FISHEYE`` fx, fy, cx, cy, k1, k2, k3, k4.
"""


@dataclass(frozen=True, slots=True)
class LensCamera:
    """A camera whose lens bends straight lines.

    Raises:
        ValueError: the model is unknown or takes another number of parameters.
    """

    model: str
    width: int
    height: int
    params: tuple[float, ...]

    def __post_init__(self) -> None:
        if PARAMETERS.get(self.model) != len(self.params):
            raise ValueError(
                f"{self.model} with {len(self.params)} parameters; known models take: {PARAMETERS}"
            )

    @property
    def fisheye(self) -> bool:
        """Whether distances in the picture go by the angle, not by its tangent."""
        return self.model == "OPENCV_FISHEYE"

    def intrinsics(self) -> tuple[float, float, float, float]:
        """fx, fy, cx, cy."""
        if self.model in ("SIMPLE_RADIAL", "RADIAL"):
            f, cx, cy = self.params[:3]
            return f, f, cx, cy
        fx, fy, cx, cy = self.params[:4]
        return fx, fy, cx, cy

    def distortion(self) -> Array:
        """(4,) k1, k2, p1, p2, of a fisheye k1 to k4."""
        coefficients = self.params[3:] if self.model in ("SIMPLE_RADIAL", "RADIAL") else self.params[4:]
        return np.pad(np.asarray(coefficients, dtype=np.float64), (0, 4 - len(coefficients)))

    def pixels(self, slopes: Array) -> Array:
        """(..., 2) slopes -> (..., 2) pixels (COLMAP, ``sensor/models.h``)."""
        x, y = slopes[..., 0], slopes[..., 1]
        a, b, c, d = self.distortion()
        r2 = x * x + y * y
        if self.fisheye:
            r = np.sqrt(r2)
            angle = np.arctan(r)
            t2 = angle * angle
            bent = angle * (1 + t2 * (a + t2 * (b + t2 * (c + t2 * d))))
            factor = np.where(r > 1e-9, bent / np.maximum(r, 1e-9), 1.0)
            x, y = x * factor, y * factor
        else:
            radial = 1 + r2 * (a + r2 * b)
            x, y = (
                x * radial + 2 * c * x * y + d * (r2 + 2 * x * x),
                y * radial + 2 * d * x * y + c * (r2 + 2 * y * y),
            )
        fx, fy, cx, cy = self.intrinsics()
        return np.stack([fx * x + cx, fy * y + cy], axis=-1)

    def slopes(self) -> tuple[Array, Array]:
        """x / z and y / z of each pixel's ray, both (height, width): :meth:`pixels` inverted.

        OpenCV iterates to a fixed point, Newton steps with differences make it exact.
        """
        fx, fy, cx, cy = self.intrinsics()
        u, v = np.meshgrid(np.arange(self.width) + 0.5, np.arange(self.height) + 0.5)
        wanted = np.stack([u, v], axis=-1)
        seen = np.ones(u.shape, dtype=bool)
        if self.fisheye:
            x, y, seen = _fisheye_slopes((u - cx) / fx, (v - cy) / fy, self.distortion())
            return np.where(seen, x, np.nan), np.where(seen, y, np.nan)
        matrix = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
        start = cv2.undistortPoints(wanted.reshape(-1, 1, 2), matrix, self.distortion())
        slopes = np.asarray(start, dtype=np.float64).reshape(*u.shape, 2)
        step = 1e-5
        right, below = np.array([step, 0.0]), np.array([0.0, step])
        for _ in range(3):
            error = self.pixels(slopes) - wanted
            by_x = (self.pixels(slopes + right) - wanted - error) / step
            by_y = (self.pixels(slopes + below) - wanted - error) / step
            determinant = by_x[..., 0] * by_y[..., 1] - by_x[..., 1] * by_y[..., 0]
            dx = (error[..., 0] * by_y[..., 1] - error[..., 1] * by_y[..., 0]) / determinant
            dy = (error[..., 1] * by_x[..., 0] - error[..., 0] * by_x[..., 1]) / determinant
            slopes = slopes - np.stack([dx, dy], axis=-1)
        return slopes[..., 0], slopes[..., 1]

    def to_json(self, fps: float) -> dict[str, Any]:
        """The content of a walk folder's ``camera.json``."""
        return {
            "model": self.model,
            "width": self.width,
            "height": self.height,
            "params": list(self.params),
            "fps": fps,
        }


def _fisheye_slopes(x: Array, y: Array, k: Array) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Slopes of bent coordinates, and where the lens shows something."""
    bent = np.hypot(x, y)
    most = np.arctan(MAX_SLOPE)
    angle = np.minimum(bent, most)
    for _ in range(20):
        t2 = angle * angle
        value = angle * (1 + t2 * (k[0] + t2 * (k[1] + t2 * (k[2] + t2 * k[3]))))
        rate = 1 + t2 * (3 * k[0] + t2 * (5 * k[1] + t2 * (7 * k[2] + t2 * 9 * k[3])))
        angle = np.clip(angle - (value - bent) / np.maximum(rate, 1e-3), 0.0, most)
    factor = np.where(bent > 1e-9, np.tan(angle) / np.maximum(bent, 1e-9), 1.0)
    return x * factor, y * factor, angle < most


@dataclass(frozen=True, eq=False, slots=True)
class Pose:
    """``world_from_camera``: rotation (3, 3) and camera centre (3,)."""

    rotation: Array
    position: Array

    def to_camera(self, points: Array) -> Array:
        """World points (..., 3) -> camera frame."""
        return np.asarray((points - self.position) @ self.rotation)


def project(camera: Camera, pose: Pose, points: Array) -> Array:
    """World points (..., 3) in front of the camera -> pixels (..., 2)."""
    p = pose.to_camera(points)
    return camera.pixels(p[..., :2] / p[..., 2:])


def level_rotation(heading: float, pitch: float = 0.0, roll: float = 0.0) -> Array:
    """Rotation of a camera that looks along ``heading``.

    Args:
        heading: radians, from the world's x axis counter-clockwise seen from above.
        pitch: radians, positive looks up.
        roll: radians, positive tilts the camera clockwise as its holder sees it.
    """
    ch, sh, cp, sp = np.cos(heading), np.sin(heading), np.cos(pitch), np.sin(pitch)
    forward = np.array([ch * cp, sh * cp, sp])
    right = np.array([sh, -ch, 0.0])
    down = np.cross(forward, right)
    cr, sr = np.cos(roll), np.sin(roll)
    return np.stack([cr * right + sr * down, cr * down - sr * right, forward], axis=1)
