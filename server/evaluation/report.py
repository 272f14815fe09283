"""What ``evaluate route`` writes: figures as frozen dataclasses, and their JSON."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike


@dataclass(frozen=True, slots=True)
class Spread:
    """Median, 90th percentile and maximum of errors; None where there is nothing to judge."""

    median: float | None = None
    p90: float | None = None
    max: float | None = None

    @staticmethod
    def of(values: ArrayLike) -> Spread:
        """Of any number of values."""
        v = np.asarray(values, dtype=np.float64)
        if v.size == 0:
            return Spread()
        return Spread(float(np.median(v)), float(np.percentile(v, 90)), float(v.max()))


@dataclass(frozen=True, slots=True)
class Latency:
    """Milliseconds from JPEG bytes to update, and the fraction of frames answered within 100 ms."""

    mean: float | None = None
    p50: float | None = None
    p95: float | None = None
    p99: float | None = None
    under_100_fraction: float | None = None

    @staticmethod
    def of(milliseconds: ArrayLike) -> Latency:
        """Of any number of frames."""
        v = np.asarray(milliseconds, dtype=np.float64)
        if v.size == 0:
            return Latency()
        p50, p95, p99 = (float(p) for p in np.percentile(v, [50, 95, 99]))
        return Latency(float(v.mean()), p50, p95, p99, float((v < 100.0).mean()))


@dataclass(frozen=True, slots=True)
class LeaderReport:
    """Figures of a build.

    Attributes:
        frames: video frames used, 10 a second.
        tracked_fraction: of these, the ones whose pose rests on their own 2D-3D inliers.
        ate_rmse_m: absolute trajectory error after one Sim(3) alignment (Sturm et al., 2012),
            interpolated frames included; None without a map.
        ate_percent_of_path: the same as a percentage of the true path's length.
        build_seconds: wall time of the build alone, in a process of its own.
        peak_rss_bytes: of that process.
        status, detail: ``ready``, or why there is no map.
        camera_offset_deg, camera_offset_m: what was taken off the truth of a real recording (its
            camera is not the filming one); zero for rendered walks.
    """

    name: str
    frames: int
    tracked_fraction: float
    keyframes: int
    landmarks: int
    ate_rmse_m: float | None
    ate_percent_of_path: float | None
    path_length_m: float
    video_seconds: float
    build_seconds: float
    map_bytes: int
    peak_rss_bytes: int
    status: str = "ready"
    detail: str = ""
    camera_offset_deg: float = 0.0
    camera_offset_m: float = 0.0


@dataclass(frozen=True, slots=True)
class FollowerReport:
    """Figures of one follower.

    Attributes:
        frames: of the video at 10 a second, on the route and off it.
        relocalized_fraction: of the frames truly on the route, the ones with a fix of their own.
        relocalization_failure_rate: the rest (Pair-Navi, section V: frames that cannot be relocalized).
        position_error_m, rotation_error_deg: of fixes on the route, relative to the route.
        absolute_error_m: the same fixes after the one global alignment of the leader's walk.
        false_fixes: fixes, on the route or off it, more than 1 m or 15 degrees wrong relative to the
            route; in a wrong building, every fix.
        hint_agreement: balanced accuracy over left, straight, right; None where nothing is judged.
        hint_always_straight: what answering "straight" every time scores.
        hint_frames: true hints judged, by class.
        off_route_frames, off_route_fixes: frames away from the route, and how many of them got a fix.
        refusals: frames refused, by reason.
        states: frames by the session's state.
        arrived: the last frame's state is arrived.
        premature_arrivals: frames told they have arrived while more than 3 m of the route were left.
        wrong_building: the walk is in another world than the leader's.
    """

    name: str
    frames: int
    relocalized_fraction: float
    relocalization_failure_rate: float
    position_error_m: Spread
    rotation_error_deg: Spread
    absolute_error_m: Spread
    false_fixes: int
    hint_agreement: float | None
    hint_always_straight: float | None
    latency_ms: Latency
    hint_frames: Mapping[str, int] = field(default_factory=dict)
    off_route_frames: int = 0
    off_route_fixes: int = 0
    refusals: Mapping[str, int] = field(default_factory=dict)
    states: Mapping[str, int] = field(default_factory=dict)
    arrived: bool = False
    premature_arrivals: int = 0
    wrong_building: bool = False


@dataclass(frozen=True, slots=True)
class RouteReport:
    """A leader and its followers."""

    leader: LeaderReport
    followers: tuple[FollowerReport, ...] = ()

    def to_json(self) -> dict[str, Any]:
        """Nested dictionaries and lists of JSON types."""
        return {
            "leader": asdict(self.leader),
            "followers": [asdict(follower) for follower in self.followers],
        }
