"""Judging a leader's map against the truth of the leader's walk."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from server.evaluation.alignment import RouteAlignment, align_route
from server.evaluation.camera_offset import apply_offset, estimate_offset
from server.evaluation.report import LeaderReport
from server.evaluation.walk import Trajectory, Walk, arc_length
from server.geometry.poses import SE3, rotation_angle, rotation_from_quaternion
from server.mapping.outcome import BuildReport, BuildStatus
from server.mapping.route_map import RouteMap


@dataclass(frozen=True, slots=True)
class BuildFigures:
    """What building a map took and reported, whether or not there is a map.

    Attributes:
        seconds: wall time of the build.
        peak_rss_bytes: of the building process.
        map_bytes: size of the map's file, 0 without a map.
    """

    status: BuildStatus
    detail: str
    report: BuildReport
    seconds: float
    peak_rss_bytes: int
    map_bytes: int


@dataclass(frozen=True, eq=False)
class LeaderJudgement:
    """The leader's figures, and what its followers are judged by.

    Attributes:
        estimate: the map's path, one row a frame at 10 fps, map frame and unit.
        truth: the same frames' true poses of the filming camera, metres.
        alignment: where the map lies in the truth.
        camera_offset: ``truth_camera_from_filming_camera``.
        errors: (N,) metres after the global alignment.
        tracked: (N,) frames whose pose is their own.
    """

    report: LeaderReport
    estimate: Trajectory
    truth: Trajectory
    alignment: RouteAlignment
    camera_offset: SE3
    errors: NDArray[np.float64] = field(repr=False)
    tracked: NDArray[np.bool_] = field(repr=False)


def failed_leader(walk: Walk, build: BuildFigures) -> LeaderReport:
    """The report of a leader's video that gave no map."""
    return LeaderReport(
        name=walk.name,
        frames=build.report.frames,
        tracked_fraction=build.report.tracked_frames / max(1, build.report.frames),
        keyframes=0,
        landmarks=0,
        ate_rmse_m=None,
        ate_percent_of_path=None,
        path_length_m=float(arc_length(walk.truth.position)[-1]),
        video_seconds=build.report.video_seconds,
        build_seconds=build.seconds,
        map_bytes=0,
        peak_rss_bytes=build.peak_rss_bytes,
        status=str(build.status),
        detail=build.detail,
    )


def judge_leader(walk: Walk, route_map: RouteMap, build: BuildFigures) -> LeaderJudgement:
    """Compare a map's path with the walk's truth.

    Raises:
        ValueError: the path has fewer than three frames or does not move.
    """
    path = route_map.path
    estimate = Trajectory(path.time, rotation_from_quaternion(path.quaternion), path.position)
    truth = walk.truth[walk.truth.nearest(path.time)]
    offset = estimate_offset(estimate, truth) if walk.real else SE3.identity()
    truth = apply_offset(truth, offset)
    alignment = align_route(estimate, truth, route_map.keyframes.frame)
    errors = np.linalg.norm(alignment.whole @ estimate.position - truth.position, axis=1)
    rmse = float(np.sqrt((errors**2).mean()))
    length = float(arc_length(truth.position)[-1])
    frames = max(build.report.frames, len(path))
    report = LeaderReport(
        name=walk.name,
        frames=frames,
        tracked_fraction=float(path.tracked.sum()) / frames,
        keyframes=len(route_map.keyframes),
        landmarks=len(route_map.landmarks),
        ate_rmse_m=rmse,
        ate_percent_of_path=100.0 * rmse / length if length > 0 else None,
        path_length_m=length,
        video_seconds=build.report.video_seconds,
        build_seconds=build.seconds,
        map_bytes=build.map_bytes,
        peak_rss_bytes=build.peak_rss_bytes,
        status=str(build.status),
        detail=build.detail,
        camera_offset_deg=float(np.degrees(rotation_angle(offset.rotation))),
        camera_offset_m=float(np.linalg.norm(offset.translation)),
    )
    return LeaderJudgement(report, estimate, truth, alignment, offset, errors, path.tracked.copy())
