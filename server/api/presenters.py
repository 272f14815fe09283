"""Domain values as documents and messages of the protocol."""

from __future__ import annotations

import math

import numpy as np

from server.navigation.updates import Fix, Guidance, Refusal, Update
from server.protocol.documents import (
    BuildDocument,
    FailureDocument,
    MapSummary,
    QualityReport,
    RouteDocument,
)
from server.protocol.messages import (
    Age,
    FixMessage,
    FrameCounts,
    GuidanceMessage,
    NextTurnMessage,
    RefusalMessage,
    RouteSummary,
    UpdateMessage,
)
from server.queues.jobs import JobProgress
from server.services.navigation import FrameTally
from server.storage.records import RouteRecord, RouteState


def route_document(route: RouteRecord, live: JobProgress | None = None) -> RouteDocument:
    """A route; ``live`` is fresher progress than the database's, if there is any."""
    build = None
    if route.build_stage is not None:
        fresh = live if route.state is RouteState.BUILDING else None
        build = BuildDocument(
            stage=fresh.stage if fresh else route.build_stage,
            fraction=fresh.fraction if fresh else route.build_fraction,
            attempt=route.build_attempt,
        )
    failure = None
    if route.state is RouteState.FAILED:
        failure = FailureDocument(
            reason=route.failure_reason or "unknown", detail=route.failure_detail or "no detail is known"
        )
    return RouteDocument(
        id=str(route.id),
        name=route.name,
        start_label=route.start_label,
        destination_label=route.destination_label,
        measured_length_m=route.measured_length_m,
        state=route.state.value,
        has_camera=route.camera is not None,
        video_bytes=route.video_bytes,
        build=build,
        failure=failure,
        report=None if route.report is None else QualityReport.model_validate(route.report),
        map=None if route.map_summary is None else MapSummary.model_validate(route.map_summary),
        created_at=route.created_at,
        updated_at=route.updated_at,
    )


def route_summary(route: RouteRecord) -> RouteSummary:
    """What a follower is told of a finished route."""
    summary = MapSummary.model_validate(route.map_summary)
    return RouteSummary(
        id=str(route.id),
        name=route.name,
        start_label=route.start_label,
        destination_label=route.destination_label,
        length_m=summary.length_m,
        duration_s=summary.duration_s,
        turns=summary.turns,
    )


def frame_counts(tally: FrameTally) -> FrameCounts:
    """The tally as the wire has it."""
    return FrameCounts(
        received=tally.received,
        answered=tally.answered,
        replaced=tally.replaced,
        stale=tally.stale,
        bad=tally.bad,
    )


def update_message(update: Update, capture_time_us: int, age: Age, tally: FrameTally) -> UpdateMessage:
    """The answer to a frame; its times are the frame's own, not rounded through seconds."""
    return UpdateMessage(
        sequence=update.sequence,
        capture_time_us=capture_time_us,
        age=age,
        state=str(update.state),
        fix=None if update.fix is None else _fix(update.fix),
        refusal=None if update.refusal is None else _refusal(update.refusal),
        guidance=None if update.guidance is None else _guidance(update.guidance),
        frames=frame_counts(tally),
    )


def _fix(fix: Fix) -> FixMessage:
    x, y, z = (round(float(v), 6) for v in fix.world_from_camera.translation)
    qx, qy, qz, qw = (round(float(v), 8) for v in fix.world_from_camera.quaternion)
    variances = np.diag(fix.covariance)
    return FixMessage(
        position=(x, y, z),
        orientation=(qx, qy, qz, qw),
        position_sigma=math.sqrt(max(0.0, float(variances[3:].sum()))),
        rotation_sigma=math.sqrt(max(0.0, float(variances[:3].sum()))),
        inliers=fix.inliers,
        matches=fix.matches,
        keyframe=fix.keyframe,
    )


def _refusal(refusal: Refusal) -> RefusalMessage:
    return RefusalMessage(reason=str(refusal.reason), inliers=refusal.inliers)


def _guidance(guidance: Guidance) -> GuidanceMessage:
    turn = guidance.next_turn
    return GuidanceMessage(
        progress=guidance.progress,
        walked_m=guidance.walked_m,
        remaining_m=guidance.remaining_m,
        remaining_s=guidance.remaining_seconds,
        instruction=str(guidance.instruction),
        bearing=guidance.bearing,
        next_turn=None
        if turn is None
        else NextTurnMessage(angle=turn.angle, distance_m=turn.distance_m, seconds=turn.seconds),
    )
