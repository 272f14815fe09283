"""Collecting what the quality report judges by: a row for every frame of a walk."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from server.features.tracking import TrackedFeatures
from server.geometry.cameras import Camera
from server.geometry.poses import SE3
from server.mapping.front_end import WalkFrame
from server.mapping.visual_odometry import TrackedFrame, TrackingState, VisualOdometry
from server.mapping.weak_stretches import FrameEvidence, frame_seconds

Array = NDArray[np.float64]

STRAY_PIXELS = 3.0
"""Distance from its epipolar line at which a feature's motion is not the camera's."""

_STRIDE = 5
"""Frames between the two views that strays are judged by: half a second of walking."""

_BEFORE_START = 20
"""Frames that a first start may take, as long as its first view is waited with."""

_FEWEST = 20
"""Features below which nothing is said of how they move."""


def tracking_record(
    parts: Sequence[VisualOdometry], answers: Sequence[TrackedFrame]
) -> tuple[NDArray[np.bool_], NDArray[np.int64]]:
    """Which of F frames the odometry could follow, and how many landmarks each saw.

    Frames of a start count as followed, and so do those before the first start: they lie within its view.
    """
    states = [answer.state for answer in answers]
    tracked = np.array([state is TrackingState.TRACKED for state in states], dtype=np.bool_)
    starts = [part.map.keyframes[:2] for part in parts if part.map.keyframes]
    for number, (first, second) in enumerate(starts):
        begin = max(0, first.frame - _BEFORE_START) if number == 0 else first.frame
        tracked[begin : second.frame] = True
    seen = np.array([answer.inliers for answer in answers], dtype=np.float64)
    known = np.flatnonzero(seen > 0)
    if len(known):
        seen = np.interp(np.arange(len(seen)), known, seen[known])
    return tracked, np.round(seen).astype(np.int64)


def gather_evidence(
    frames: Sequence[WalkFrame],
    tracked: NDArray[np.bool_],
    landmarks: NDArray[np.int64],
    poses: Sequence[SE3 | None] | None,
    camera: Camera,
) -> FrameEvidence:
    """The evidence of F frames.

    Args:
        tracked, landmarks: (F,), as in :class:`FrameEvidence`.
        poses: camera_from_world of the frames if there is a map; without it strays are not known.
        camera: the pinhole camera of the frames.
    """
    count = len(frames)
    time = np.array([frame.time for frame in frames])
    seconds = frame_seconds(time)
    followed, turning, shift, strays = (np.full(count, np.nan) for _ in range(4))
    for row in range(1, count):
        before, after = frames[row - 1].features, frames[row].features
        a, b = _shared(before, after)
        followed[row] = len(a) / max(len(before), 1)
        if len(a) >= _FEWEST:
            moved = after.features.pixels[b] - before.features.pixels[a]
            shift[row] = float(np.median(np.linalg.norm(moved, axis=1)))
            angle = np.arccos(np.clip((np.trace(frames[row].turn) - 1.0) / 2.0, -1.0, 1.0))
            turning[row] = angle / seconds
        if poses is not None and row >= _STRIDE:
            strays[row] = _stray_share(
                frames[row - _STRIDE].features, after, poses[row - _STRIDE], poses[row], camera
            )
    looks = [frame.statistics for frame in frames]
    return FrameEvidence(
        time=time,
        bright=np.array([look.bright for look in looks]),
        clipped=np.array([look.clipped for look in looks]),
        textured=np.array([look.textured for look in looks]),
        covered=np.array([look.covered for look in looks]),
        sharpness=np.array([look.sharpness for look in looks]),
        followed=followed,
        turning=turning,
        shift=shift,
        strays=strays,
        tracked=tracked,
        landmarks=landmarks,
    )


def _shared(before: TrackedFeatures, after: TrackedFeatures) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Rows of the tracks that two frames share."""
    _, a, b = np.intersect1d(before.track, after.track, assume_unique=True, return_indices=True)
    return a, b


def _stray_share(
    before: TrackedFeatures, after: TrackedFeatures, pose: SE3 | None, later: SE3 | None, camera: Camera
) -> float:
    """Share of the common tracks that leave their epipolar line; NaN if it cannot be told.

    The distance is Sampson's (Hartley, Zisserman, "Multiple View Geometry", eq. 11.9).
    """
    if pose is None or later is None:
        return float("nan")
    a, b = _shared(before, after)
    if len(a) < _FEWEST:
        return float("nan")
    motion = later @ pose.inverse()
    x, y, z = motion.translation
    essential = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]) @ motion.rotation
    ones = np.ones((len(a), 1))
    first = np.hstack([camera.normalize(before.features.pixels[a]), ones])
    second = np.hstack([camera.normalize(after.features.pixels[b]), ones])
    line, back = first @ essential.T, second @ essential
    spread = np.sqrt((line[:, :2] ** 2).sum(axis=1) + (back[:, :2] ** 2).sum(axis=1))
    distance = np.abs((second * line).sum(axis=1)) / np.maximum(spread, 1e-12)
    return float((distance * camera.params[0] > STRAY_PIXELS).mean())
