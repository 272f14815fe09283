"""Builds as the database sees them: begun, progressing, finished, owed after a restart."""

from __future__ import annotations

import asyncio
import shutil
from collections.abc import Callable, Mapping
from datetime import datetime
from typing import Any
from uuid import UUID, uuid4

import structlog

from server.queues.jobs import BuildJob, BuildOrder, BuildOutcome, JobProgress, JobQueue
from server.storage.database import Database
from server.storage.objects import NoRoomError, ObjectMissingError, ObjectStore
from server.storage.records import UNFINISHED, RouteState, quality_objects

log = structlog.get_logger()

ORPHAN_AGE_S = 3600.0
"""Objects that no route refers to are removed at start when they are older: younger ones may be uploads."""


class BuildService:
    """The ledger of builds; a :class:`server.queues.jobs.BuildLedger`.

    Args:
        clock: aware UTC time.
        max_attempts: builds begun for one upload before it is given up: a video that takes the
            whole service down must not do so at every restart.
    """

    def __init__(
        self, database: Database, store: ObjectStore, clock: Callable[[], datetime], max_attempts: int
    ) -> None:
        self._database = database
        self._store = store
        self._clock = clock
        self._max_attempts = max_attempts

    async def begin(self, job: BuildJob) -> BuildOrder | None:
        """See :meth:`server.queues.jobs.BuildLedger.begin`."""
        async with self._database.begin() as unit:
            route = await unit.builds.get(job.route_id)
            if route is None or route.state not in UNFINISHED:
                return None
            if route.video_key is None:
                raise RuntimeError(f"route {route.id} is {route.state} without a video")
            if route.build_attempt >= self._max_attempts:
                await unit.builds.change(
                    route.id,
                    UNFINISHED,
                    self._clock(),
                    state=RouteState.FAILED,
                    failure_reason="gave_up",
                    failure_detail=f"the build was begun {route.build_attempt} times and never ended",
                )
                return None
            attempt = route.build_attempt + 1
            await unit.builds.change(
                route.id,
                UNFINISHED,
                self._clock(),
                state=RouteState.BUILDING,
                build_stage="starting",
                build_fraction=0.0,
                build_attempt=attempt,
            )
        order_folder = await self._store.scratch()
        try:
            video = await self._store.local_path(route.video_key)
        except ObjectMissingError:
            order = BuildOrder(
                route.id, attempt, order_folder, route.camera, route.measured_length_m, order_folder
            )
            await self.finish(
                order, BuildOutcome("video_missing", "the stored video is gone; upload it again")
            )
            return None
        log.info("build.begun", route=str(route.id), attempt=attempt)
        return BuildOrder(route.id, attempt, video, route.camera, route.measured_length_m, order_folder)

    async def record_progress(self, order: BuildOrder, progress: JobProgress) -> None:
        """See :meth:`server.queues.jobs.BuildLedger.record_progress`."""
        async with self._database.begin() as unit:
            await unit.builds.change(
                order.route_id,
                (RouteState.BUILDING,),
                self._clock(),
                build_stage=progress.stage,
                build_fraction=progress.fraction,
            )

    async def finish(self, order: BuildOrder, outcome: BuildOutcome) -> None:
        """See :meth:`server.queues.jobs.BuildLedger.finish`."""
        try:
            if outcome.failure is None:
                await self._finish_ready(order, outcome)
            else:
                await self._finish_failed(order, outcome)
        finally:
            await _remove(order)

    async def _finish_ready(self, order: BuildOrder, outcome: BuildOutcome) -> None:
        if outcome.map_file is None or outcome.path_file is None:
            raise RuntimeError("a build without failure must leave a map and a path")
        prefix = f"routes/{order.route_id}"
        map_key, path_key = f"{prefix}/map-{order.attempt}", f"{prefix}/path-{order.attempt}.json"
        map_bytes = await self._store.put_file(map_key, outcome.map_file)
        await self._store.put_file(path_key, outcome.path_file)
        report = await self._with_pictures(order, outcome)
        async with self._database.begin() as unit:
            route = await unit.builds.change(
                order.route_id,
                (RouteState.BUILDING,),
                self._clock(),
                state=RouteState.READY,
                build_stage="finished",
                build_fraction=1.0,
                map_key=map_key,
                path_key=path_key,
                report=report,
                map_summary={**outcome.map_summary, "bytes": map_bytes},
            )
        if route is None:
            await self._store.delete([map_key, path_key, *quality_objects(report).values()])
        log.info("build.ready", route=str(order.route_id), kept=route is not None, map_bytes=map_bytes)

    async def _finish_failed(self, order: BuildOrder, outcome: BuildOutcome) -> None:
        report = await self._with_pictures(order, outcome)
        async with self._database.begin() as unit:
            route = await unit.builds.change(
                order.route_id,
                (RouteState.BUILDING,),
                self._clock(),
                state=RouteState.FAILED,
                failure_reason=outcome.failure,
                failure_detail=outcome.detail,
                report=report,
            )
        if route is None:
            await self._store.delete(list(quality_objects(report).values()))
        log.warning("build.failed", route=str(order.route_id), reason=outcome.failure, detail=outcome.detail)

    async def _with_pictures(self, order: BuildOrder, outcome: BuildOutcome) -> Mapping[str, Any] | None:
        """The outcome's report with the keys of its pictures, which are put into the store."""
        if outcome.report is None or not outcome.quality_files:
            return outcome.report
        objects: dict[str, str] = {}
        # Attempts are counted anew for every upload: a key must never be one that is being deleted.
        prefix = f"routes/{order.route_id}/quality-{uuid4().hex}"
        try:
            for path in outcome.quality_files:
                await self._store.put_file(f"{prefix}-{path.name}", path)
                objects[path.name] = f"{prefix}-{path.name}"
        except (OSError, NoRoomError):
            # A report without some of its pictures is better than a route without its map or its reason.
            log.exception("build.pictures_not_stored", route=str(order.route_id))
        return {**outcome.report, "quality_objects": objects}

    async def abandon(self, order: BuildOrder) -> None:
        """See :meth:`server.queues.jobs.BuildLedger.abandon`."""
        async with self._database.begin() as unit:
            await unit.builds.change(
                order.route_id,
                (RouteState.BUILDING,),
                self._clock(),
                state=RouteState.UPLOADED,
                build_stage="queued",
                build_fraction=0.0,
                build_attempt=order.attempt - 1,
            )
        await _remove(order)

    async def recover(self, jobs: JobQueue) -> int:
        """At start: queue what is owed, remove what belongs to no route. Returns the number queued."""
        async with self._database.begin() as unit:
            owed = await unit.builds.unfinished()
        for route in owed:
            await jobs.enqueue(BuildJob(route.id))
        await self._remove_orphans()
        return len(owed)

    async def _remove_orphans(self) -> None:
        # Listed before the database is asked: an object recorded in between is then no orphan.
        keys = await self._store.keys("routes", older_than_s=ORPHAN_AGE_S)
        async with self._database.begin() as unit:
            known = await unit.builds.known_keys()
        orphans = [key for key in keys if key not in known]
        if orphans:
            await self._store.delete(orphans)
            log.info("objects.orphans_removed", count=len(orphans))

    async def map_path(self, route_id: UUID, map_key: str) -> str:
        """Local path of a route's map, for a process that opens it.

        Raises:
            ObjectMissingError: the object is gone.
        """
        log.debug("map.located", route=str(route_id))
        return str(await self._store.local_path(map_key))


async def _remove(order: BuildOrder) -> None:
    await asyncio.to_thread(shutil.rmtree, order.folder, ignore_errors=True)
