"""The start of a map from two views of a walk."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np

from server.features.tracking import TrackedFeatures
from server.geometry.poses import SE3
from server.geometry.two_view import TwoViewOptions, relative_pose
from server.mapping.working_map import Keyframe, WorkingMap


@dataclass(frozen=True, slots=True)
class StartOptions:
    """Settings of a start.

    Attributes:
        two_view: when a pair of views is good enough.
        patience: frames after which another first view is chosen.
        min_shift: median motion of the tracks between the views below which none is tried, pixels.
    """

    two_view: TwoViewOptions = field(default_factory=TwoViewOptions)
    patience: int = 20
    min_shift: float = 8.0


class StartOutcome(StrEnum):
    """What became of a pair of views."""

    STARTED = "started"
    NOT_YET = "not_yet"
    NOTHING_IN_COMMON = "nothing_in_common"


def start_map(
    working: WorkingMap,
    first: tuple[int, TrackedFeatures],
    second: tuple[int, TrackedFeatures],
    track_sigma: float,
    options: StartOptions,
) -> StartOutcome:
    """Make two views (index of the frame, its features) the first keyframes of an empty map.

    The frame of the map is the first camera's; its unit is the median depth of the first landmarks.

    Args:
        track_sigma: standard deviation of a followed feature's pixel coordinate.
    """
    features_a, features_b = first[1], second[1]
    _, a, b = np.intersect1d(features_a.track, features_b.track, assume_unique=True, return_indices=True)
    if len(a) < options.two_view.min_points:
        return StartOutcome.NOTHING_IN_COMMON
    pixels_a, pixels_b = features_a.features.pixels[a], features_b.features.pixels[b]
    if np.median(np.linalg.norm(pixels_b - pixels_a, axis=1)) < options.min_shift:
        return StartOutcome.NOT_YET
    view = relative_pose(pixels_a, pixels_b, working.camera, options.two_view)
    if view is None:
        return StartOutcome.NOT_YET
    good = view.valid
    unit = float(np.median(view.points[good, 2]))
    moved = SE3(view.b_from_a.rotation, view.b_from_a.translation / unit)
    for (frame, features), pose in ((first, SE3.identity()), (second, moved)):
        working.keyframes.append(Keyframe.of(frame, features, pose, track_sigma))
    ids = working.add_landmarks(view.points[good] / unit, 1, b[good])
    working.observe(0, a[good], ids)
    working.observe(1, b[good], ids)
    working.adjust_window([0, 1], iterations=10)
    working.update_covariances([0, 1])
    return StartOutcome.STARTED
