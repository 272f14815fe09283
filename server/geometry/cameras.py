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
import pycolmap
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Image = NDArray[np.uint8]


class CameraModel(StrEnum):
    """Camera models by their COLMAP names."""

    PINHOLE = "PINHOLE"
    SIMPLE_PINHOLE = "SIMPLE_PINHOLE"
    SIMPLE_RADIAL = "SIMPLE_RADIAL"
    RADIAL = "RADIAL"
    OPENCV = "OPENCV"
    OPENCV_FISHEYE = "OPENCV_FISHEYE"


PARAMETER_NAMES: dict[CameraModel, tuple[str, ...]] = {
    CameraModel.PINHOLE: ("fx", "fy", "cx", "cy"),
    CameraModel.SIMPLE_PINHOLE: ("f", "cx", "cy"),
    CameraModel.SIMPLE_RADIAL: ("f", "cx", "cy", "k"),
    CameraModel.RADIAL: ("f", "cx", "cy", "k1", "k2"),
    CameraModel.OPENCV: ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2"),
    CameraModel.OPENCV_FISHEYE: ("fx", "fy", "cx", "cy", "k1", "k2", "k3", "k4"),
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
        for name, focal in zip(("fx", "fy"), self.focal, strict=True):
            if not 0.2 * size <= focal <= 10.0 * size:
                raise InvalidCameraError(
                    f"{name} = {focal:g} is no focal length of a {self.width}x{self.height} image: "
                    f"expected {0.2 * size:g} to {10 * size:g} pixels"
                )
        cx, cy = self.centre
        if not (0 <= cx <= self.width and 0 <= cy <= self.height):
            raise InvalidCameraError(f"principal point ({cx:g}, {cy:g}) lies outside the image")
        if any(abs(p) > 2.0 for p in self.distortion):
            raise InvalidCameraError("distortion coefficients beyond 2 describe no phone camera")
        if not self._is_one_to_one():
            raise InvalidCameraError(
                f"the distortion {self.distortion} folds the image over before its corners: no lens does that"
            )

    def is_possible(self) -> bool:
        """Whether :meth:`check` finds nothing to refuse."""
        try:
            self.check()
        except InvalidCameraError:
            return False
        return True

    def _is_one_to_one(self) -> bool:
        """Whether every pixel has a ray of its own."""
        if self.is_pinhole:
            return True
        u, v = (np.linspace(0.0, side, 17) for side in (self.width, self.height))
        pixels = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)
        rays = self.normalize(pixels)
        again = self.project(np.column_stack([rays, np.ones(len(rays))]))
        if not np.all(np.abs(again - pixels) < 0.1):
            return False
        # From the centre to each corner, rays must go outwards as pixels do.
        corners = np.array([(0, 0), (self.width, 0), (0, self.height), (self.width, self.height)], float)
        spokes = self.centre + np.linspace(0.0, 1.0, 33)[:, None, None] * (corners - self.centre)
        radius = np.linalg.norm(self.normalize(spokes.reshape(-1, 2)), axis=1).reshape(33, 4)
        return bool(np.all(np.diff(radius, axis=0) > 0.0))

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
        return self.params[0], self.params[0 if self._has_one_focal else 1]

    @property
    def centre(self) -> tuple[float, float]:
        """(cx, cy), pixels."""
        first = 1 if self._has_one_focal else 2
        return self.params[first], self.params[first + 1]

    @property
    def distortion(self) -> tuple[float, ...]:
        """The model's distortion coefficients, in its order."""
        return self.params[3 if self._has_one_focal else 4 :]

    @property
    def _has_one_focal(self) -> bool:
        return PARAMETER_NAMES[self.model][0] == "f"

    @property
    def is_pinhole(self) -> bool:
        """True when a point projects without distortion."""
        return self.model in (CameraModel.PINHOLE, CameraModel.SIMPLE_PINHOLE)

    def _with(
        self,
        size: tuple[int, int],
        focal: tuple[float, float],
        centre: tuple[float, float],
        distortion: tuple[float, ...],
    ) -> Camera:
        """A camera of the same model, or of one with two focal lengths where they came to differ."""
        model = self.model
        if self._has_one_focal and abs(focal[0] - focal[1]) > 1e-9 * focal[0]:
            if self.is_pinhole:
                model = CameraModel.PINHOLE
            else:
                model = CameraModel.OPENCV
                distortion = (*distortion, 0.0, 0.0, 0.0)[:4]
        one = PARAMETER_NAMES[model][0] == "f"
        return Camera(model, *size, (*(focal[:1] if one else focal), *centre, *distortion))

    def with_focal(self, focal: float) -> Camera:
        """The same camera with another focal length, pixels, the same in x and y."""
        return self._with((self.width, self.height), (focal, focal), self.centre, self.distortion)

    def scaled(self, width: int, height: int) -> Camera:
        """The same camera with its image resized to width x height."""
        sx, sy = width / self.width, height / self.height
        (fx, fy), (cx, cy) = self.focal, self.centre
        return self._with((width, height), (fx * sx, fy * sy), (cx * sx, cy * sy), self.distortion)

    def rotated(self, quarter_turns: int) -> Camera:
        """The camera of the image turned clockwise by ``quarter_turns`` x 90 degrees."""
        camera = self
        for _ in range(quarter_turns % 4):
            (fx, fy), (cx, cy), rest = camera.focal, camera.centre, camera.distortion
            if camera.model is CameraModel.OPENCV:
                # Turning the axes by (x, y) -> (-y, x) carries the tangential pair (p1, p2) to (p2, -p1).
                k1, k2, p1, p2 = rest
                rest = (k1, k2, p2, -p1)
            camera = camera._with((camera.height, camera.width), (fy, fx), (camera.height - cy, cx), rest)
        return camera

    def pinhole_part(self) -> Camera:
        """The ideal pinhole camera with the same focal lengths, centre and size."""
        return Camera.pinhole(self.width, self.height, *self.focal, *self.centre)

    def project(self, points: ArrayLike) -> Array:
        """Camera-frame points (..., 3) with positive z -> pixels (..., 2)."""
        p = np.asarray(points, dtype=np.float64)
        if self.is_pinhole:
            return p[..., :2] / p[..., 2:] * self.focal + self.centre
        pixels = self._colmap().img_from_cam(p.reshape(-1, 3))
        return np.asarray(pixels, dtype=np.float64).reshape(*p.shape[:-1], 2)

    def normalize(self, pixels: ArrayLike) -> Array:
        """Pixels (..., 2) -> coordinates of their rays on the plane z = 1 (..., 2)."""
        p = np.asarray(pixels, dtype=np.float64)
        if self.is_pinhole:
            return (p - self.centre) / self.focal
        rays = self._colmap().cam_from_img(p.reshape(-1, 2))
        return np.asarray(rays, dtype=np.float64).reshape(p.shape)

    def straightened(self, pixels: ArrayLike) -> Array:
        """Where pixels (..., 2) of this camera lie in the image of its :meth:`pinhole_part`."""
        p = np.asarray(pixels, dtype=np.float64)
        return p if self.is_pinhole else self.pinhole_part().project_rays(self.normalize(p))

    def project_rays(self, rays: ArrayLike) -> Array:
        """Coordinates on the plane z = 1 (..., 2) -> pixels (..., 2)."""
        r = np.asarray(rays, dtype=np.float64)
        return self.project(np.concatenate([r, np.ones((*r.shape[:-1], 1))], axis=-1))

    def _colmap(self) -> pycolmap.Camera:
        return pycolmap.Camera(
            model=str(self.model), width=self.width, height=self.height, params=list(self.params)
        )


TYPICAL_FOCAL = 0.8
"""Focal length of a phone's main camera while it films, in lengths of the longer side."""


def typical_camera(width: int, height: int) -> Camera:
    """What most phones film with: where to start when nothing is known."""
    focal = TYPICAL_FOCAL * max(width, height)
    return Camera.pinhole(width, height, focal, focal, width / 2, height / 2)


def square_pixels(camera: Camera) -> Camera:
    """The pinhole camera with the geometric mean of a camera's focal lengths, its centre and size."""
    focal = math.sqrt(camera.focal[0] * camera.focal[1])
    return Camera.pinhole(camera.width, camera.height, focal, focal, *camera.centre)


def opencv_matrix(camera: Camera) -> Array:
    """OpenCV's 3x3 camera matrix: the principal point in integer-centre pixels."""
    (fx, fy), (cx, cy) = camera.focal, camera.centre
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
        target = resized.pinhole_part()
        object.__setattr__(self, "target", target)
        maps = None
        if not resized.is_pinhole:
            u, v = np.meshgrid(np.arange(target.width) + 0.5, np.arange(target.height) + 0.5)
            rays = target.normalize(np.stack([u, v], axis=-1))
            pixels = (resized.project_rays(rays) - 0.5).astype(np.float32)
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
