"""The pinhole camera that films the synthetic building, and its poses.

Camera axes x right, y down, z forward; world z up; metres. The centre of the first pixel is
(0.5, 0.5), as in COLMAP.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class PinholeCamera:
    """Intrinsics, all in pixels."""

    width: int = 640
    height: int = 480
    fx: float = 500.0
    fy: float = 500.0
    cx: float = 320.0
    cy: float = 240.0

    def to_json(self, fps: float) -> dict[str, Any]:
        """The content of a walk folder's ``camera.json``."""
        return {
            "model": "PINHOLE",
            "width": self.width,
            "height": self.height,
            "params": [self.fx, self.fy, self.cx, self.cy],
            "fps": fps,
        }


@dataclass(frozen=True, eq=False, slots=True)
class Pose:
    """``world_from_camera``: rotation (3, 3) and camera centre (3,)."""

    rotation: Array
    position: Array

    def to_camera(self, points: Array) -> Array:
        """World points (..., 3) -> camera frame."""
        return np.asarray((points - self.position) @ self.rotation)


def project(camera: PinholeCamera, pose: Pose, points: Array) -> Array:
    """World points (..., 3) in front of the camera -> pixels (..., 2)."""
    p = pose.to_camera(points)
    return np.stack(
        [camera.fx * p[..., 0] / p[..., 2] + camera.cx, camera.fy * p[..., 1] / p[..., 2] + camera.cy],
        axis=-1,
    )


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
