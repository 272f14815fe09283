"""Camera models and rectification.

Models, parameter order and pixel convention are COLMAP's: the centre of the first pixel is
(0.5, 0.5). OpenCV puts it at (0, 0); :func:`opencv_matrix` is the one place where the half pixel
is taken off.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Image = NDArray[np.uint8]


class CameraModel(StrEnum):
    """Camera models by their COLMAP names."""

    PINHOLE = "PINHOLE"
    OPENCV = "OPENCV"


PARAMETER_NAMES: dict[CameraModel, tuple[str, ...]] = {
    CameraModel.PINHOLE: ("fx", "fy", "cx", "cy"),
    CameraModel.OPENCV: ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2"),
}


class InvalidCameraError(ValueError):
    """A camera description that no real camera fits; the message says what to correct."""


@dataclass(frozen=True, slots=True)
class Camera:
    """Intrinsics of a camera.

    Attributes:
        model: the camera model.
        width, height: image size in pixels.
        params: as :data:`PARAMETER_NAMES` lists them, pixels for focal lengths and centre.

    Raises:
        InvalidCameraError: wrong number of parameters, or one that is no finite number.
    """

    model: CameraModel
    width: int
    height: int
    params: tuple[float, ...]

    def __post_init__(self) -> None:
        names = PARAMETER_NAMES[self.model]
        if len(self.params) != len(names):
            raise InvalidCameraError(
                f"{self.model} takes {len(names)} parameters ({', '.join(names)}), got {len(self.params)}"
            )
        if not all(math.isfinite(p) for p in self.params):
            raise InvalidCameraError("camera parameters must be finite numbers")

    def check(self) -> None:
        """Refuse values that no real camera has: for descriptions that come from outside.

        Raises:
            InvalidCameraError: what is wrong, and what was expected.
        """
        if not (16 <= self.width <= 16384 and 16 <= self.height <= 16384):
            raise InvalidCameraError(f"image size {self.width}x{self.height} is outside 16..16384")
        size = max(self.width, self.height)
        for name, focal in zip(("fx", "fy"), self.params[:2], strict=True):
            if not 0.2 * size <= focal <= 10.0 * size:
                raise InvalidCameraError(
                    f"{name} = {focal:g} is no focal length of a {self.width}x{self.height} image: "
                    f"expected {0.2 * size:g} to {10 * size:g} pixels"
                )
        cx, cy = self.params[2:4]
        if not (0 <= cx <= self.width and 0 <= cy <= self.height):
            raise InvalidCameraError(f"principal point ({cx:g}, {cy:g}) lies outside the image")
        if any(abs(p) > 2.0 for p in self.params[4:]):
            raise InvalidCameraError("distortion coefficients beyond 2 describe no phone camera")

    @staticmethod
    def pinhole(width: int, height: int, fx: float, fy: float, cx: float, cy: float) -> Camera:
        """A camera without distortion."""
        return Camera(CameraModel.PINHOLE, width, height, (fx, fy, cx, cy))

    @staticmethod
    def from_json(document: Mapping[str, Any]) -> Camera:
        """From ``{"model", "width", "height", "params"}``; other keys are ignored.

        Raises:
            InvalidCameraError: a key is missing or a value is impossible.
        """
        try:
            model = CameraModel(str(document["model"]))
            width, height = int(document["width"]), int(document["height"])
            params = tuple(float(p) for p in document["params"])
        except KeyError as error:
            raise InvalidCameraError(f"camera description lacks {error}") from None
        except (TypeError, ValueError) as error:
            raise InvalidCameraError(
                f"camera description not understood: {error}; models: {', '.join(CameraModel)}"
            ) from None
        camera = Camera(model, width, height, params)
        camera.check()
        return camera

    def to_json(self) -> dict[str, Any]:
        """The inverse of :meth:`from_json`."""
        return {
            "model": str(self.model),
            "width": self.width,
            "height": self.height,
            "params": list(self.params),
        }

    @property
    def focal(self) -> tuple[float, float]:
        """(fx, fy), pixels."""
        return self.params[0], self.params[1]

    @property
    def centre(self) -> tuple[float, float]:
        """(cx, cy), pixels."""
        return self.params[2], self.params[3]

    @property
    def is_pinhole(self) -> bool:
        """True when a point projects without distortion."""
        return self.model is CameraModel.PINHOLE

    def scaled(self, width: int, height: int) -> Camera:
        """The same camera with its image resized to width x height."""
        sx, sy = width / self.width, height / self.height
        fx, fy, cx, cy = self.params[:4]
        return Camera(self.model, width, height, (fx * sx, fy * sy, cx * sx, cy * sy, *self.params[4:]))

    def rotated(self, quarter_turns: int) -> Camera:
        """The camera of the image turned clockwise by ``quarter_turns`` x 90 degrees."""
        camera = self
        for _ in range(quarter_turns % 4):
            fx, fy, cx, cy = camera.params[:4]
            rest = camera.params[4:]
            if rest:
                # Turning the axes by (x, y) -> (-y, x) carries the tangential pair (p1, p2) to (p2, -p1).
                k1, k2, p1, p2 = rest
                rest = (k1, k2, p2, -p1)
            camera = Camera(
                camera.model, camera.height, camera.width, (fy, fx, camera.height - cy, cx, *rest)
            )
        return camera

    def project(self, points: ArrayLike) -> Array:
        """Camera-frame points (..., 3) with positive z -> pixels (..., 2)."""
        p = np.asarray(points, dtype=np.float64)
        x, y = p[..., 0] / p[..., 2], p[..., 1] / p[..., 2]
        if self.model is CameraModel.OPENCV:
            k1, k2, p1, p2 = self.params[4:]
            r2 = x * x + y * y
            radial = 1.0 + r2 * (k1 + r2 * k2)
            x, y = (
                x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
                y * radial + 2 * p2 * x * y + p1 * (r2 + 2 * y * y),
            )
        fx, fy, cx, cy = self.params[:4]
        return np.stack([fx * x + cx, fy * y + cy], axis=-1)

    def normalize(self, pixels: ArrayLike) -> Array:
        """Pixels (..., 2) -> coordinates on the plane z = 1 (..., 2), for a pinhole camera.

        Raises:
            ValueError: the camera has distortion; rectify the image first.
        """
        if not self.is_pinhole:
            raise ValueError("only rectified (PINHOLE) pixels can be normalised")
        return (np.asarray(pixels, dtype=np.float64) - self.centre) / self.focal


def opencv_matrix(camera: Camera) -> Array:
    """OpenCV's 3x3 camera matrix: the principal point in integer-centre pixels."""
    fx, fy, cx, cy = camera.params[:4]
    return np.array([[fx, 0.0, cx - 0.5], [0.0, fy, cy - 0.5], [0.0, 0.0, 1.0]])


CELLS = (8, 6)
"""Columns and rows into which an image is cut to say how much of it something covers."""


def occupied_cells(pixels: ArrayLike, camera: Camera) -> int:
    """In how many of the image's 8 x 6 cells pixels (N, 2) lie."""
    size = np.array([camera.width, camera.height]) / CELLS
    return len(np.unique((np.asarray(pixels) / size).astype(int) @ [1, CELLS[0]]))


WORKING_PIXELS = 640 * 480
"""Pixels of a working image: the papers' frame size; other aspect ratios keep the same area."""


def working_size(width: int, height: int) -> tuple[int, int]:
    """Size of the rectified working image: the aspect ratio kept, at most 640 x 480 pixels of area."""
    scale = min(1.0, math.sqrt(WORKING_PIXELS / (width * height)))
    return max(16, round(width * scale)), max(16, round(height * scale))


@dataclass(frozen=True, eq=False)
class Rectifier:
    """Turns images of a camera into images of an ideal pinhole camera of the working size.

    Attributes:
        source: the phone's camera.
        target: the pinhole camera of the images that come out.
    """

    source: Camera
    target: Camera = field(init=False)
    _maps: tuple[NDArray[np.int16], NDArray[np.uint16]] | None = field(init=False, repr=False)

    def __post_init__(self) -> None:
        resized = self.source.scaled(*working_size(self.source.width, self.source.height))
        target = Camera(CameraModel.PINHOLE, resized.width, resized.height, resized.params[:4])
        object.__setattr__(self, "target", target)
        maps = None
        if not resized.is_pinhole:
            fx, fy, cx, cy = target.params
            u, v = np.meshgrid(np.arange(target.width) + 0.5, np.arange(target.height) + 0.5)
            rays = np.stack([(u - cx) / fx, (v - cy) / fy, np.ones_like(u)], axis=-1)
            pixels = (resized.project(rays) - 0.5).astype(np.float32)
            maps = cv2.convertMaps(pixels[..., 0], pixels[..., 1], cv2.CV_16SC2)
        object.__setattr__(self, "_maps", maps)

    def __call__(self, image: Image) -> Image:
        """Rectify an image (H, W) or (H, W, 3) of the source camera.

        Raises:
            ValueError: the image has not the source camera's size.
        """
        if image.shape[:2] != (self.source.height, self.source.width):
            raise ValueError(
                f"image is {image.shape[1]}x{image.shape[0]}, "
                f"its camera {self.source.width}x{self.source.height}"
            )
        size = (self.target.width, self.target.height)
        if image.shape[1::-1] != size:
            # Shrunk by area first: remapping a large picture straight away would alias.
            image = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
        if self._maps is None:
            return image
        return np.asarray(cv2.remap(image, *self._maps, cv2.INTER_LINEAR), dtype=np.uint8)
