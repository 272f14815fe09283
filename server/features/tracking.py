"""Feature tracks through a video: optical flow carries every feature from frame to frame.

Descriptors alone lose a third of the features between two frames and take one door panel for the
next. Flow follows the very patch (Lucas, Kanade 1981, in Bouguet's pyramid), survives motion blur and is
exact to a tenth of a pixel; descriptors stay with the tracks, for finding a place again later.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from server.features.extraction import FeatureExtractor, Features
from server.features.matching import best_pairs, hamming, pairs_within

Array = NDArray[np.float64]
Image = NDArray[np.uint8]
Ids = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class TrackerOptions:
    """Settings of :class:`FeatureTracker`.

    Attributes:
        count: tracks followed at a time.
        window: side of the patch that is followed, pixels.
        levels: pyramid levels above the image.
        max_round_trip: a track ends if following it back misses its start by more, pixels.
        max_difference: or if the patch looks different by more on average, grey levels.
        spacing: new tracks begin at least this far from others, pixels.
        border: tracks end this close to the image's edge, pixels.
    """

    count: int = 1200
    window: int = 15
    levels: int = 4
    max_round_trip: float = 0.7
    max_difference: float = 20.0
    spacing: float = 5.0
    border: float = 4.0


@dataclass(frozen=True, eq=False, slots=True)
class TrackedFeatures:
    """Features of one frame and the track each belongs to.

    Attributes:
        features: N features.
        track: (N,) identity of the track, increasing in the order of birth, all different.
        age: (N,) frames since the track began.
    """

    features: Features
    track: Ids
    age: Ids

    def __len__(self) -> int:
        return len(self.track)

    @staticmethod
    def empty() -> TrackedFeatures:
        """No features, as before the first frame."""
        return TrackedFeatures(Features.empty(), np.zeros(0, np.int64), np.zeros(0, np.int64))


class FeatureTracker:
    """Follows features through the frames of one video."""

    def __init__(self, extractor: FeatureExtractor, options: TrackerOptions | None = None) -> None:
        self.extractor = extractor
        self.options = options or TrackerOptions()
        self._image: Image | None = None
        self._current = TrackedFeatures.empty()
        self._next = 0

    def follow(
        self, image: Image, predicted: Array | None = None, mask: NDArray[np.bool_] | None = None
    ) -> TrackedFeatures:
        """Features of the next frame (H, W): the followed ones first, then new ones.

        Args:
            predicted: (N, 2) where the features of the frame before are expected, pixels.
            mask: (H, W), true where no feature may be.
        """
        followed = self._follow(image, predicted, mask)
        detected = self.extractor.extract(image, mask)
        self._current = self._join(followed, detected)
        self._image = image
        return self._current

    def _follow(
        self,
        image: Image,
        predicted: Array | None,
        mask: NDArray[np.bool_] | None,
    ) -> TrackedFeatures:
        before, options = self._current, self.options
        if self._image is None or len(before) == 0:
            return TrackedFeatures.empty()
        start = (before.features.pixels - 0.5).astype(np.float32)[:, None]
        guess = start if predicted is None else (predicted - 0.5).astype(np.float32)[:, None]
        settings: dict[str, Any] = {
            "winSize": (options.window, options.window),
            "maxLevel": options.levels,
            "criteria": (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 20, 0.02),
            "flags": cv2.OPTFLOW_USE_INITIAL_FLOW,
            "minEigThreshold": 1e-4,
        }
        there, found, error = cv2.calcOpticalFlowPyrLK(self._image, image, start, guess.copy(), **settings)
        # The way back starts at its expected end: a coarse search would only repeat the way there.
        back, returned, _ = cv2.calcOpticalFlowPyrLK(
            image, self._image, there, start.copy(), **(settings | {"maxLevel": 1})
        )
        miss = np.linalg.norm((back - start)[:, 0], axis=1)
        pixels = there[:, 0].astype(np.float64) + 0.5
        height, width = image.shape
        keep = (
            (found[:, 0] == 1)
            & (returned[:, 0] == 1)
            & (miss < options.max_round_trip)
            & (error[:, 0] < options.max_difference)
            & (pixels > options.border).all(axis=1)
            & (pixels[:, 0] < width - options.border)
            & (pixels[:, 1] < height - options.border)
        )
        if mask is not None:
            columns, rows = pixels[keep].astype(int).T
            keep[keep] = ~mask[rows, columns]
        old = before.features.select(keep)
        return TrackedFeatures(
            Features(pixels[keep], old.descriptors, old.octaves, old.angles),
            before.track[keep],
            before.age[keep] + 1,
        )

    def _join(self, followed: TrackedFeatures, detected: Features) -> TrackedFeatures:
        """Give followed features the fresh look of the detection they fell on; begin tracks elsewhere."""
        options = self.options
        old = followed.features
        rows, columns = pairs_within(old.pixels, detected.pixels, options.spacing)
        descriptors, octaves, angles = old.descriptors.copy(), old.octaves.copy(), old.angles.copy()
        crowded = np.zeros(len(detected), np.bool_)
        crowded[columns] = True
        if len(rows):
            offset = old.pixels[rows] - detected.pixels[columns]
            same = ((offset**2).sum(axis=1) < 2.5**2) & (
                np.abs(old.octaves[rows].astype(np.int64) - detected.octaves[columns]) <= 1
            )
            rows, columns = rows[same], columns[same]
            distance = hamming(old.descriptors, detected.descriptors, rows, columns)
            fresh = best_pairs(rows, columns, distance, max_distance=64, ratio=1.01)
            descriptors[fresh.a] = detected.descriptors[fresh.b]
            octaves[fresh.a] = detected.octaves[fresh.b]
            angles[fresh.a] = detected.angles[fresh.b]
        room = max(0, options.count - len(followed))
        new = np.flatnonzero(~crowded)[:room]
        added = detected.select(new)
        identities = np.arange(self._next, self._next + len(new))
        self._next += len(new)
        return TrackedFeatures(
            Features(
                np.concatenate([old.pixels, added.pixels]),
                np.concatenate([descriptors, added.descriptors]),
                np.concatenate([octaves, added.octaves]),
                np.concatenate([angles, added.angles]),
            ),
            np.concatenate([followed.track, identities]),
            np.concatenate([followed.age, np.zeros(len(new), np.int64)]),
        )
