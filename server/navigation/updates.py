"""What a navigation session says about one frame: a fix or a refusal, and the guidance that follows."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from server.geometry.poses import SE3


class NavigationState(StrEnum):
    """Where the follower stands with regard to the route."""

    SEARCHING = "searching"
    ON_ROUTE = "on_route"
    LOST = "lost"
    ARRIVED = "arrived"


class RefusalReason(StrEnum):
    """Why a frame has no pose."""

    TOO_FEW_FEATURES = "too_few_features"
    NO_SIMILAR_PLACE = "no_similar_place"
    TOO_FEW_INLIERS = "too_few_inliers"
    AMBIGUOUS = "ambiguous"


class Instruction(StrEnum):
    """What to do now; the sentence is the client's."""

    STRAIGHT = "straight"
    LEFT = "left"
    RIGHT = "right"
    TURN_AROUND = "turn_around"
    ARRIVED = "arrived"


@dataclass(frozen=True, slots=True)
class Fix:
    """A relocalized frame.

    Attributes:
        world_from_camera: the pose in the map's frame and unit.
        covariance: (6, 6) of (rotation vector in the camera frame, radians; camera centre in the
            world, map units).
        inliers: 2D-3D correspondences that agree with the pose.
        matches: correspondences that were tried.
        keyframe: index of the nearest keyframe.
        strong: the picture alone was enough; False where the expected pose had to speak for it too.
    """

    world_from_camera: SE3
    covariance: NDArray[np.float64]
    inliers: int
    matches: int
    keyframe: int
    strong: bool = True


@dataclass(frozen=True, slots=True)
class Refusal:
    """A frame without a pose, and why."""

    reason: RefusalReason
    inliers: int = 0


@dataclass(frozen=True, slots=True)
class NextTurn:
    """The next turn of the route.

    Attributes:
        angle: radians, positive to the left.
        distance_m: metres to its beginning along the route, None while the map has no metric scale.
        seconds: what the leader took from here to its beginning.
    """

    angle: float
    distance_m: float | None
    seconds: float


@dataclass(frozen=True, slots=True)
class Guidance:
    """Progress on the route and what to do.

    Attributes:
        progress: fraction of the route walked, 0 to 1.
        walked_m, remaining_m: along the route; None while the map has no metric scale.
        remaining_seconds: what the leader took from here to the destination.
        instruction: what to do now.
        bearing: radians to the temporary destination in the follower's camera, positive to the left.
        next_turn: None after the last turn.
    """

    progress: float
    walked_m: float | None
    remaining_m: float | None
    remaining_seconds: float
    instruction: Instruction
    bearing: float
    next_turn: NextTurn | None


@dataclass(frozen=True, slots=True)
class Update:
    """The answer to one frame. Exactly one of ``fix`` and ``refusal`` is set.

    Attributes:
        sequence, capture_time: of the frame, echoed (time in seconds on the phone's clock).
        guidance: None until the route has been found once, and while it is in doubt which part of the
            route a fix belongs to; while frames are refused, the last one for as long as it may still
            be trusted.
    """

    sequence: int
    capture_time: float
    state: NavigationState
    fix: Fix | None
    refusal: Refusal | None
    guidance: Guidance | None
