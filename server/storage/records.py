"""Rows as the rest of the server sees them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
from enum import StrEnum
from typing import Any
from uuid import UUID


class RouteState(StrEnum):
    """Where a route stands.

    CREATED -> UPLOADED (the video is there, a build is due) -> BUILDING -> READY or FAILED.
    FAILED -> UPLOADED with another video or camera.
    """

    CREATED = "created"
    UPLOADED = "uploaded"
    BUILDING = "building"
    READY = "ready"
    FAILED = "failed"


ACCEPTS_UPLOADS = (RouteState.CREATED, RouteState.FAILED)
"""States in which a video or a camera may be (re)placed."""

UNFINISHED = (RouteState.UPLOADED, RouteState.BUILDING)
"""States a build is owed to."""


def quality_objects(report: Mapping[str, Any] | None) -> Mapping[str, str]:
    """Keys in the object store of a build report's pictures, by the names of their files."""
    return dict((report or {}).get("quality_objects") or {})


@dataclass(frozen=True, slots=True)
class RouteRecord:
    """A route.

    Attributes:
        owner: whom it belongs to; every read through a principal is filtered by it.
        camera: the leader's camera as JSON.
        video_key, map_key, path_key: in the object store.
        build_attempt: number of builds begun for what is uploaded now.
        report, map_summary: JSON of the finished build. The report holds the walk's ``quality`` where it
            was judged, and in ``quality_objects`` where its pictures lie.
    """

    id: UUID
    owner: str
    name: str
    start_label: str
    destination_label: str
    measured_length_m: float | None
    state: RouteState
    camera: Mapping[str, Any] | None
    video_key: str | None
    video_bytes: int | None
    map_key: str | None
    path_key: str | None
    build_stage: str | None
    build_fraction: float
    build_attempt: int
    failure_reason: str | None
    failure_detail: str | None
    report: Mapping[str, Any] | None
    map_summary: Mapping[str, Any] | None
    created_at: datetime
    updated_at: datetime
