"""The front end of mapping: the video's frames with their feature tracks, one frame ahead of the rest."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from server.features.tracking import FeatureTracker, TrackedFeatures
from server.geometry.cameras import Camera
from server.geometry.two_view import rotation_between
from server.mapping.frame_statistics import FrameStatistics, frame_statistics
from server.mapping.video import VideoFrame

THUMBNAIL_EVERY_S = 0.3
"""Seconds between kept thumbnails: the shortest weak stretch has one."""

_THUMBNAIL_WIDTH = 256
_THUMBNAIL_QUALITY = 75

_NOTHING_SEEN = FrameStatistics(bright=0.0, clipped=0.0, textured=0.0, covered=0.0, sharpness=0.0)


@dataclass(frozen=True, eq=False, slots=True)
class WalkFrame:
    """A frame of the walk: its time on the video's clock, seconds, and its tracks.

    ``turn`` (3, 3) is the rotation from the frame before to this one as the tracks show it; it is
    coarse, but needs no map. ``thumbnail`` is a JPEG, kept of some frames only.
    """

    time: float
    features: TrackedFeatures
    turn: NDArray[np.float64]
    statistics: FrameStatistics = _NOTHING_SEEN
    thumbnail: bytes | None = None


def follow_features(
    frames: Iterator[VideoFrame], camera: Camera, tracker: FeatureTracker
) -> Iterator[WalkFrame]:
    """Feature tracks of rectified frames of a pinhole camera.

    Decoding and following run in a thread of their own while the caller works on the frame before:
    both are OpenCV's, which leaves Python's lock to others. What comes out does not depend on timing.
    """
    before = WalkFrame(0.0, TrackedFeatures.empty(), np.eye(3))
    due = 0.0

    def step() -> WalkFrame | None:
        nonlocal before, due
        frame = next(frames, None)
        if frame is None:
            return None
        features = tracker.follow(frame.image, _expected(before, camera))
        thumbnail = None
        if frame.time >= due:
            thumbnail, due = _thumbnail(frame.image), frame.time + THUMBNAIL_EVERY_S - 1e-3
        turn = _turn(before.features, features, camera)
        before = WalkFrame(frame.time, features, turn, frame_statistics(frame.image), thumbnail)
        return before

    with ThreadPoolExecutor(max_workers=1, thread_name_prefix="features") as pool:
        ahead = pool.submit(step)
        while (current := ahead.result()) is not None:
            ahead = pool.submit(step)
            yield current


def straightened(frame: WalkFrame, before: WalkFrame | None, lens: Camera, ideal: Camera) -> WalkFrame:
    """A frame taken through ``lens`` as the pinhole camera ``ideal`` would have seen it.

    Args:
        before: the frame before, straightened already; None at the start.
    """
    if lens == ideal:
        return frame
    features = frame.features
    if len(features):
        pixels = ideal.project_rays(lens.normalize(features.features.pixels))
        features = replace(features, features=replace(features.features, pixels=pixels))
    turn = frame.turn if before is None else _turn(before.features, features, ideal)
    return replace(frame, features=features, turn=turn)


def _thumbnail(image: NDArray[np.uint8]) -> bytes:
    height = max(1, round(image.shape[0] * _THUMBNAIL_WIDTH / image.shape[1]))
    small = cv2.resize(image, (_THUMBNAIL_WIDTH, height), interpolation=cv2.INTER_AREA)
    done, data = cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, _THUMBNAIL_QUALITY])
    return data.tobytes() if done else b""


def _expected(frame: WalkFrame, camera: Camera) -> NDArray[np.float64]:
    """Where the features should be next if the camera goes on turning: the bulk of their motion."""
    rays = np.column_stack([camera.normalize(frame.features.features.pixels), np.ones(len(frame.features))])
    turned = rays @ frame.turn.T
    turned[:, 2] = np.maximum(turned[:, 2], 0.1)
    return camera.project(turned)


def _turn(before: TrackedFeatures, after: TrackedFeatures, camera: Camera) -> NDArray[np.float64]:
    _, a, b = np.intersect1d(before.track, after.track, assume_unique=True, return_indices=True)
    return rotation_between(
        camera.normalize(before.features.pixels[a]), camera.normalize(after.features.pixels[b])
    )
