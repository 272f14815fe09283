"""What a picture alone says of its worth for mapping: light, texture, sharpness; a millisecond a frame."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.uint8]

_SHRINK = 4
"""Cells are looked at in the picture shrunk so many times: noise averages out, texture stays."""

_CELL = 8
"""Side of a cell in the shrunk picture, pixels."""

_AROUND = 17
"""Side of the square, in the shrunk picture, whose mean is taken off: light that falls off on a wall
is no texture."""

_FLAT = 2.0
"""RMS in a cell, grey levels, below which it shows nothing: five times what noise leaves there."""

_UNLIT = 40.0
"""Mean grey level of a cell that a finger or a sleeve may cover."""

_NEAR, _FAR = 1, 16
"""Distances in pixels over which differences are compared for sharpness."""

_GRAIN = 5.0
"""Differences up to so many grey levels are noise, rounding and compression, not sharpness."""

_DIAGONAL = 1.0 / np.sqrt(2.0)


@dataclass(frozen=True, slots=True)
class FrameStatistics:
    """One picture's figures.

    Attributes:
        bright: grey level that 95 % of the picture stay below, 0 to 255.
        clipped: share of the picture that is burnt out.
        textured: share of its cells of 32 pixels that show any structure.
        covered: share of its cells that show none and are dark.
        sharpness: RMS difference of neighbouring pixels over that of pixels 16 apart, in the
            direction where it is least; 0.1 is usual, a blur by as many pixels as it is wide makes it
            a third. It means nothing where nothing is textured.
    """

    bright: float
    clipped: float
    textured: float
    covered: float
    sharpness: float


def frame_statistics(image: Image) -> FrameStatistics:
    """Figures of a grey picture (H, W), which the thresholds expect at about 640 x 480."""
    height, width = image.shape
    small = cv2.resize(
        image, (max(width // _SHRINK, _CELL), max(height // _SHRINK, _CELL)), interpolation=cv2.INTER_AREA
    )
    below = np.bincount(small.ravel(), minlength=256).cumsum() / small.size
    quiet = cv2.GaussianBlur(small, (5, 5), 0).astype(np.float32)
    flat = _by_cell((quiet - cv2.blur(quiet, (_AROUND, _AROUND))) ** 2) < _FLAT**2
    return FrameStatistics(
        bright=float(np.searchsorted(below, 0.95)),
        clipped=float(1.0 - below[249]),
        textured=float(1.0 - flat.mean()),
        covered=float((flat & (_by_cell(quiet) < _UNLIT)).mean()),
        sharpness=_sharpness(image),
    )


def _by_cell(small: NDArray[np.float32]) -> NDArray[np.float32]:
    """Mean over every whole cell."""
    rows, columns = small.shape[0] // _CELL, small.shape[1] // _CELL
    cells = small[: rows * _CELL, : columns * _CELL].reshape(rows, _CELL, columns, _CELL)
    return np.asarray(cells.mean(axis=(1, 3)))


def _sharpness(image: Image) -> float:
    """Least ratio over four directions, since a moved or shaken camera blurs along one only.

    After the idea of Crete et al., "The blur effect" (2007): a picture that is blurred already
    differs little from pixel to pixel, whatever it shows.
    """
    ratios = []
    reach = min(_FAR, min(image.shape) // 2)
    for down, right in ((0, 1), (1, 0), (1, 1), (1, -1)):
        length = _DIAGONAL if down and right else 1.0
        near = _difference(image, down, right, max(1, round(_NEAR * length)))
        far = _difference(image, down, right, max(1, round(reach * length)))
        near = np.asarray(cv2.subtract(near, np.full_like(near, _GRAIN)))
        ratios.append(_rms(near) / max(_rms(far), 1e-3))
    return min(ratios)


def _difference(image: Image, down: int, right: int, step: int) -> Image:
    """Absolute difference to the pixel ``step`` further down and right (or left)."""
    above, below = (image[:-step], image[step:]) if down else (image, image)
    if right > 0:
        above, below = above[:, :-step], below[:, step:]
    elif right < 0:
        above, below = above[:, step:], below[:, :-step]
    return np.asarray(cv2.absdiff(above, below), dtype=np.uint8)


def _rms(image: Image) -> float:
    return float(np.sqrt(cv2.norm(image, cv2.NORM_L2SQR) / max(image.size, 1)))
