"""Local features: the extractor protocol and ORB, spread evenly over the image."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.uint8]


@dataclass(frozen=True, eq=False, slots=True)
class Features:
    """N local features of one image.

    Attributes:
        pixels: (N, 2) float64, COLMAP's pixel convention.
        descriptors: (N, 32) uint8, compared by Hamming distance.
        octaves: (N,) int8 pyramid level of each feature.
        angles: (N,) float32 orientation in the image, radians.
    """

    pixels: NDArray[np.float64]
    descriptors: NDArray[np.uint8]
    octaves: NDArray[np.int8]
    angles: NDArray[np.float32]

    def __len__(self) -> int:
        return len(self.pixels)

    def select(self, keep: NDArray[np.bool_] | NDArray[np.intp]) -> Features:
        """The features at the given indices or where the mask is true."""
        return Features(self.pixels[keep], self.descriptors[keep], self.octaves[keep], self.angles[keep])

    @staticmethod
    def empty() -> Features:
        """No features at all, as a uniform image gives."""
        return Features(
            np.zeros((0, 2)), np.zeros((0, 32), np.uint8), np.zeros(0, np.int8), np.zeros(0, np.float32)
        )


class FeatureExtractor(Protocol):
    """Finds features in rectified grey images."""

    scale_factor: float
    """Ratio of neighbouring pyramid levels: octave o locates a feature to about scale_factor**o pixels."""

    levels: int
    """Number of pyramid levels."""

    def extract(self, image: Image, mask: NDArray[np.bool_] | None = None) -> Features:
        """Features of an image (H, W), none where ``mask`` (H, W) is true."""
        ...


@dataclass(frozen=True, slots=True)
class OrbOptions:
    """Settings of :class:`OrbExtractor`.

    Attributes:
        count: features kept an image.
        fast_threshold: contrast a corner needs, grey levels; low, so that bland walls still give some.
        cell: side of the square cells over which features are spread, pixels.
        candidates: corners detected before spreading.
    """

    count: int = 1500
    fast_threshold: int = 7
    cell: int = 32
    candidates: int = 12000


class OrbExtractor:
    """ORB (Rublee et al., "ORB: an efficient alternative to SIFT or SURF", 2011), evenly spread.

    OpenCV keeps the strongest corners wherever they are, which on a real walk is one poster; here
    the best corner of every cell comes before the second best of any.
    """

    scale_factor = 1.2
    levels = 8

    def __init__(self, options: OrbOptions | None = None) -> None:
        self.options = options or OrbOptions()
        self._orb = cv2.ORB.create(
            nfeatures=self.options.candidates,
            scaleFactor=self.scale_factor,
            nlevels=self.levels,
            fastThreshold=self.options.fast_threshold,
        )

    def extract(self, image: Image, mask: NDArray[np.bool_] | None = None) -> Features:
        """Features of a grey image (H, W), none where ``mask`` (H, W) is true."""
        keypoints = self._orb.detect(image, None)
        if not keypoints:
            return Features.empty()
        points = _points(keypoints)
        if mask is not None:
            columns, rows = np.round(points).astype(int).T
            keypoints = [k for k, out in zip(keypoints, mask[rows, columns], strict=True) if not out]
            if not keypoints:
                return Features.empty()
            points = _points(keypoints)
        responses = np.array([k.response for k in keypoints])
        chosen = spread(points, responses, self.options.count, self.options.cell)
        keypoints, descriptors = self._orb.compute(image, [keypoints[i] for i in chosen])
        if not keypoints:
            return Features.empty()
        octaves = np.array([k.octave for k in keypoints], dtype=np.int8)
        scale = self.scale_factor ** octaves.astype(np.float64)
        # OpenCV multiplies a level's integer-centre pixel by its scale; the level's pixel centres lie
        # half a LEVEL pixel in, so that is the offset that brings every octave to one convention.
        pixels = _points(keypoints).astype(np.float64) + 0.5 * scale[:, None]
        # It also takes the nominal scale where a level's size was rounded to whole pixels.
        size = np.array(image.shape[1::-1], dtype=np.float64)
        pixels *= size / np.round(size / scale[:, None]) / scale[:, None]
        angles = np.deg2rad(np.array([k.angle for k in keypoints], dtype=np.float32))
        return Features(pixels, np.asarray(descriptors, dtype=np.uint8), octaves, angles)


def _points(keypoints: Sequence[cv2.KeyPoint]) -> NDArray[np.float32]:
    """(N, 2) in OpenCV's convention: the centre of the first pixel is (0, 0)."""
    return np.asarray(cv2.KeyPoint.convert(keypoints), dtype=np.float32)


def spread(
    points: NDArray[np.float32], responses: NDArray[np.float64], count: int, cell: int
) -> NDArray[np.intp]:
    """Indices of at most ``count`` points (N, 2), taken cell by cell in order of strength.

    Points are ranked within their cell; all first ranks come before all second ranks, and within
    one rank the stronger come first.
    """
    if len(points) <= count:
        return np.arange(len(points))
    columns = (points[:, 0] // cell).astype(np.int64)
    rows = (points[:, 1] // cell).astype(np.int64)
    cells = rows * (int(columns.max()) + 1) + columns
    order = np.lexsort((-responses, cells))
    sorted_cells = cells[order]
    first = np.flatnonzero(np.r_[True, sorted_cells[1:] != sorted_cells[:-1]])
    sizes = np.diff(np.r_[first, len(order)])
    rank = np.empty(len(points), dtype=np.int64)
    rank[order] = np.arange(len(order)) - np.repeat(first, sizes)
    return np.lexsort((-responses, rank))[:count]
