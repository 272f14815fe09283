"""The job queue: a port, so that builds can run in this process's children or on other machines."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol
from uuid import UUID


@dataclass(frozen=True, slots=True)
class BuildJob:
    """A build that is due; what it needs is in the database."""

    route_id: UUID


@dataclass(frozen=True, slots=True)
class JobProgress:
    """``fraction`` is of the whole build, 0 to 1."""

    stage: str
    fraction: float


@dataclass(frozen=True, slots=True)
class BuildOrder:
    """Everything a build process is told. Plain values: it crosses a process boundary.

    Attributes:
        video: local file.
        camera: JSON of the leader's camera.
        measured_length_m: of the walked path, None if nobody measured it.
        folder: where the build leaves its files.
    """

    route_id: UUID
    attempt: int
    video: Path
    camera: Mapping[str, Any] | None
    measured_length_m: float | None
    folder: Path


@dataclass(frozen=True, slots=True)
class BuildOutcome:
    """How a build ended.

    Attributes:
        failure: reason code, None when there is a map.
        detail: a sentence for the leader.
        map_file, path_file: in the order's folder; set exactly when there is no failure.
        report, map_summary: JSON, as :mod:`server.protocol.documents` has them; the report of a walk that
            was judged has a ``quality`` besides.
        quality_files: the quality report's pictures, in the order's folder.
    """

    failure: str | None
    detail: str = ""
    map_file: Path | None = None
    path_file: Path | None = None
    report: Mapping[str, Any] | None = None
    map_summary: Mapping[str, Any] = field(default_factory=dict)
    quality_files: tuple[Path, ...] = ()


class JobQueue(Protocol):
    """Runs builds in the background."""

    async def enqueue(self, job: BuildJob) -> None:
        """Run a build when there is room. Enqueued again while waiting or running, nothing happens."""
        ...

    async def cancel(self, route_id: UUID) -> None:
        """Stop a route's build, waiting or running; none is no error."""
        ...

    def progress(self, route_id: UUID) -> JobProgress | None:
        """Newest progress of a running build, None if it is not known here."""
        ...

    @property
    def running(self) -> int:
        """Number of builds that run now."""
        ...


class BuildLedger(Protocol):
    """What a queue's worker asks and reports; the database's side of a build."""

    async def begin(self, job: BuildJob) -> BuildOrder | None:
        """Mark the build as begun; None if none is due any more."""
        ...

    async def record_progress(self, order: BuildOrder, progress: JobProgress) -> None:
        """Keep the progress; called coarsely."""
        ...

    async def finish(self, order: BuildOrder, outcome: BuildOutcome) -> None:
        """Store what came of the build and remove its folder."""
        ...

    async def abandon(self, order: BuildOrder) -> None:
        """The build was stopped on purpose: it is owed again, and this attempt does not count."""
        ...
