"""Rigid motions SE(3) and similarities Sim(3), named by the frames they connect.

A variable ``world_from_camera`` maps camera coordinates to world coordinates. Reference for the
exponential maps: Solà, Deray, Atchuthan, "A micro Lie theory for state estimation in robotics" (2018).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


def skew(vectors: ArrayLike) -> Array:
    """Cross-product matrices of vectors, (..., 3) -> (..., 3, 3)."""
    v = np.asarray(vectors, dtype=np.float64)
    out = np.zeros((*v.shape[:-1], 3, 3))
    out[..., 0, 1], out[..., 0, 2] = -v[..., 2], v[..., 1]
    out[..., 1, 0], out[..., 1, 2] = v[..., 2], -v[..., 0]
    out[..., 2, 0], out[..., 2, 1] = -v[..., 1], v[..., 0]
    return out


def rotation_from_vector(vectors: ArrayLike) -> Array:
    """Rodrigues' formula: rotation vectors (..., 3), radians -> rotation matrices (..., 3, 3)."""
    v = np.asarray(vectors, dtype=np.float64)
    angle = np.linalg.norm(v, axis=-1)[..., None, None]
    small = angle < 1e-8
    safe = np.where(small, 1.0, angle)
    a = np.where(small, 1.0, np.sin(safe) / safe)
    b = np.where(small, 0.5, (1.0 - np.cos(safe)) / safe**2)
    k = skew(v)
    return np.eye(3) + a * k + b * (k @ k)


def vector_from_rotation(rotations: ArrayLike) -> Array:
    """Logarithm of rotation matrices (..., 3, 3) -> rotation vectors (..., 3), angle in [0, pi]."""
    q = quaternion_from_rotation(rotations)
    q = np.where(q[..., 3:] < 0, -q, q)
    sine = np.linalg.norm(q[..., :3], axis=-1, keepdims=True)
    angle = 2.0 * np.arctan2(sine, q[..., 3:])
    return np.asarray(q[..., :3] * np.where(sine < 1e-12, 2.0, angle / np.where(sine < 1e-12, 1.0, sine)))


def rotation_from_quaternion(quaternions: ArrayLike) -> Array:
    """Quaternions (..., 4) in the order x, y, z, w, of any non-zero norm -> rotations (..., 3, 3)."""
    q = np.asarray(quaternions, dtype=np.float64)
    q = q / np.linalg.norm(q, axis=-1, keepdims=True)
    k = skew(q[..., :3])
    return np.asarray(np.eye(3) + 2.0 * (q[..., 3, None, None] * k + k @ k))


def quaternion_from_rotation(rotations: ArrayLike) -> Array:
    """Rotation matrices (..., 3, 3) -> unit quaternions (..., 4), order x, y, z, w.

    Shepperd's method: of the four equivalent formulas the best conditioned one is taken.
    """
    r = np.asarray(rotations, dtype=np.float64)
    xx, yy, zz = r[..., 0, 0], r[..., 1, 1], r[..., 2, 2]
    squares = np.stack([xx - yy - zz, yy - xx - zz, zz - xx - yy, xx + yy + zz], axis=-1)
    yz, zx, xy = r[..., 2, 1] - r[..., 1, 2], r[..., 0, 2] - r[..., 2, 0], r[..., 1, 0] - r[..., 0, 1]
    sxy, sxz, syz = r[..., 0, 1] + r[..., 1, 0], r[..., 0, 2] + r[..., 2, 0], r[..., 1, 2] + r[..., 2, 1]
    candidates = np.stack(
        [
            np.stack([1 + squares[..., 0], sxy, sxz, yz], axis=-1),
            np.stack([sxy, 1 + squares[..., 1], syz, zx], axis=-1),
            np.stack([sxz, syz, 1 + squares[..., 2], xy], axis=-1),
            np.stack([yz, zx, xy, 1 + squares[..., 3]], axis=-1),
        ],
        axis=-2,
    )
    best = np.argmax(squares, axis=-1)
    q = np.take_along_axis(candidates, best[..., None, None], axis=-2)[..., 0, :]
    return np.asarray(q / np.linalg.norm(q, axis=-1, keepdims=True))


@dataclass(frozen=True, slots=True)
class SE3:
    """A rigid motion ``a_from_b``: ``x_a = rotation @ x_b + translation``.

    Attributes:
        rotation: (3, 3) rotation matrix.
        translation: (3,) in the unit of length of frame a.
    """

    rotation: Array
    translation: Array

    @staticmethod
    def identity() -> SE3:
        """The motion that moves nothing."""
        return SE3(np.eye(3), np.zeros(3))

    @staticmethod
    def from_quaternion(quaternion: ArrayLike, translation: ArrayLike) -> SE3:
        """From a quaternion (x, y, z, w) and a translation (3,)."""
        return SE3(rotation_from_quaternion(quaternion), np.asarray(translation, dtype=np.float64))

    @staticmethod
    def exp(tangent: ArrayLike) -> SE3:
        """From (rotation vector, translation), (6,): the product SO(3) x R^3, not the screw motion."""
        t = np.asarray(tangent, dtype=np.float64)
        return SE3(rotation_from_vector(t[:3]), t[3:].copy())

    @property
    def quaternion(self) -> Array:
        """(4,), order x, y, z, w."""
        return quaternion_from_rotation(self.rotation)

    @property
    def matrix(self) -> Array:
        """(3, 4), ``[R | t]``."""
        return np.hstack([self.rotation, self.translation[:, None]])

    def inverse(self) -> SE3:
        """``b_from_a``."""
        return SE3(self.rotation.T, -self.rotation.T @ self.translation)

    @overload
    def __matmul__(self, other: SE3) -> SE3: ...
    @overload
    def __matmul__(self, other: Array) -> Array: ...
    def __matmul__(self, other: SE3 | Array) -> SE3 | Array:
        """Compose with ``b_from_c``, or map points (..., 3) of frame b to frame a."""
        if isinstance(other, SE3):
            return SE3(self.rotation @ other.rotation, self.rotation @ other.translation + self.translation)
        return np.asarray(other @ self.rotation.T + self.translation)

    def angle_to(self, other: SE3) -> float:
        """Angle between the two orientations, radians."""
        return rotation_angle(self.rotation.T @ other.rotation)


@dataclass(frozen=True, slots=True)
class Sim3:
    """A similarity ``a_from_b``: ``x_a = scale * rotation @ x_b + translation``."""

    scale: float
    rotation: Array
    translation: Array

    @staticmethod
    def identity() -> Sim3:
        """The similarity that changes nothing."""
        return Sim3(1.0, np.eye(3), np.zeros(3))

    def inverse(self) -> Sim3:
        """``b_from_a``."""
        r = self.rotation.T
        return Sim3(1.0 / self.scale, r, -(r @ self.translation) / self.scale)

    def __matmul__(self, points: Array) -> Array:
        """Map points (..., 3) of frame b to frame a."""
        return np.asarray(self.scale * points @ self.rotation.T + self.translation)

    def compose(self, b_from_c: Sim3) -> Sim3:
        """``a_from_c``."""
        return Sim3(
            self.scale * b_from_c.scale,
            self.rotation @ b_from_c.rotation,
            self.scale * self.rotation @ b_from_c.translation + self.translation,
        )

    def transform_pose(self, b_from_camera: SE3) -> SE3:
        """The same camera seen in frame a: its orientation turned, its position mapped."""
        return SE3(self.rotation @ b_from_camera.rotation, self @ b_from_camera.translation)


def rotation_angle(rotation: ArrayLike) -> float:
    """Angle of one rotation matrix, radians in [0, pi]."""
    return float(np.linalg.norm(vector_from_rotation(rotation)))


def align_similarity(target: ArrayLike, source: ArrayLike, *, with_scale: bool = True) -> Sim3:
    """Least-squares similarity ``target_from_source`` between paired points (N, 3), N >= 3.

    Umeyama, "Least-squares estimation of transformation parameters between two point patterns" (1991),
    Eq. 40-42.

    Raises:
        ValueError: fewer than three pairs, or all source points in one place.
    """
    a = np.asarray(target, dtype=np.float64)
    b = np.asarray(source, dtype=np.float64)
    if a.shape != b.shape or a.ndim != 2 or a.shape[0] < 3:
        raise ValueError(f"need at least three paired points, got {a.shape} and {b.shape}")
    mean_a, mean_b = a.mean(axis=0), b.mean(axis=0)
    variance = float(((b - mean_b) ** 2).sum(axis=1).mean())
    if variance < 1e-24:
        raise ValueError("the source points all coincide: no similarity is determined")
    u, d, vt = np.linalg.svd((a - mean_a).T @ (b - mean_b) / len(a))
    sign = np.ones(3)
    if np.linalg.det(u) * np.linalg.det(vt) < 0:
        sign[2] = -1.0
    rotation = u @ np.diag(sign) @ vt
    scale = float((d * sign).sum() / variance) if with_scale else 1.0
    return Sim3(scale, rotation, mean_a - scale * rotation @ mean_b)
