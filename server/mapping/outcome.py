"""What building a route map reports: progress while it runs, a map or a reason when it ends."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum

from server.geometry.cameras import Camera
from server.mapping.quality import QualityReport
from server.mapping.route_map import RouteMap


class BuildStage(StrEnum):
    """Stages of a build, in order."""

    DECODING = "decoding"
    CALIBRATING = "calibrating"
    TRACKING = "tracking"
    CLOSING = "closing"
    REFINING = "refining"
    FINISHING = "finishing"


@dataclass(frozen=True, slots=True)
class BuildProgress:
    """``fraction`` (0 to 1) is of the whole build and never decreases."""

    stage: BuildStage
    fraction: float


ProgressListener = Callable[[BuildProgress], None]


class BuildStatus(StrEnum):
    """How a build ended; all but READY are reasons a leader can act on."""

    READY = "ready"
    NOT_A_VIDEO = "not_a_video"
    CAMERA_MISMATCH = "camera_mismatch"
    TOO_SHORT = "too_short"
    TOO_LONG = "too_long"
    NO_TEXTURE = "no_texture"
    NO_MOTION = "no_motion"
    TRACKING_LOST = "tracking_lost"


class CameraSource(StrEnum):
    """Where the intrinsics that a map was built with come from."""

    GIVEN = "given"
    REFINED = "refined"
    ESTIMATED = "estimated"
    ASSUMED = "assumed"


@dataclass(frozen=True, slots=True)
class BuildReport:
    """Figures of a build.

    Attributes:
        frames: video frames used (10 a second).
        tracked_frames: of these, the ones whose pose rests on their own 2D-3D inliers.
        video_seconds: length of the video.
        lost: intervals (start, end) of the video in seconds without a tracked frame.
        camera: of the upright video's pictures, as the walk was mapped with; None where no walk was mapped.
        camera_source: whether it is as given, given and refined by the walk, estimated from the walk alone,
            or assumed because the walk does not tell it.
    """

    frames: int = 0
    tracked_frames: int = 0
    keyframes: int = 0
    landmarks: int = 0
    video_seconds: float = 0.0
    lost: tuple[tuple[float, float], ...] = ()
    camera: Camera | None = None
    camera_source: CameraSource = CameraSource.GIVEN


@dataclass(frozen=True, slots=True)
class BuildResult:
    """How a build ended.

    Attributes:
        route_map: set exactly when ``status`` is READY.
        detail: a sentence for the leader.
        quality: of every walk that was looked at to its end, with or without a map.
    """

    status: BuildStatus
    route_map: RouteMap | None
    report: BuildReport
    detail: str = ""
    quality: QualityReport | None = None
