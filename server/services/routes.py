"""The life of a route as its owner sees it: create, upload, look, delete."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterable, AsyncIterator, Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any, Protocol
from uuid import UUID, uuid4

import structlog

from server.queues.jobs import BuildJob, JobQueue
from server.services.cameras import usable_camera
from server.services.errors import (
    CursorInvalidError,
    MapUnusableError,
    RouteNotFoundError,
    RouteNotReadyError,
    RouteStateError,
    StorageFullError,
    UploadIncompleteError,
    UploadTooLargeError,
)
from server.storage.database import Database, UnitOfWork
from server.storage.objects import NoRoomError, ObjectMissingError, ObjectStore, ObjectTooLargeError
from server.storage.records import ACCEPTS_UPLOADS, RouteRecord, RouteState, quality_objects

log = structlog.get_logger()

Clock = Callable[[], datetime]


class SessionCloser(Protocol):
    """Whoever must know that a route is gone."""

    def close_route(self, route_id: UUID) -> None:
        """End the route's navigation sessions."""
        ...


@dataclass(frozen=True, slots=True)
class Download:
    """An object to be sent: its length in bytes and its content."""

    length: int
    chunks: AsyncIterator[bytes]


class RouteService:
    """Use cases on routes. Each takes the owner first; the transaction is the caller's, the request's.

    Args:
        clock: aware UTC time.
        max_video_bytes: of one upload.
    """

    def __init__(
        self,
        database: Database,
        store: ObjectStore,
        jobs: JobQueue,
        sessions: SessionCloser,
        clock: Clock,
        max_video_bytes: int,
    ) -> None:
        self._database = database
        self._store = store
        self._jobs = jobs
        self._sessions = sessions
        self._clock = clock
        self._max_video_bytes = max_video_bytes

    async def create(
        self,
        unit: UnitOfWork,
        owner: str,
        *,
        name: str,
        start_label: str,
        destination_label: str,
        measured_length_m: float | None,
    ) -> RouteRecord:
        """A new route without video."""
        return await unit.routes_of(owner).add(
            uuid4(),
            name=name,
            start_label=start_label,
            destination_label=destination_label,
            measured_length_m=measured_length_m,
            now=self._clock(),
        )

    async def get(self, unit: UnitOfWork, owner: str, route_id: UUID) -> RouteRecord:
        """One route.

        Raises:
            RouteNotFoundError: none of this owner.
        """
        route = await unit.routes_of(owner).get(route_id)
        if route is None:
            raise RouteNotFoundError(f"there is no route {route_id}")
        return route

    async def page(
        self, unit: UnitOfWork, owner: str, limit: int, cursor: str | None
    ) -> tuple[Sequence[RouteRecord], str | None]:
        """Routes newest first, and the cursor of the next page or None.

        Raises:
            CursorInvalidError: the cursor is none that this method returned.
        """
        before = None if cursor is None else _parse_cursor(cursor)
        routes = await unit.routes_of(owner).page(limit + 1, before)
        if len(routes) <= limit:
            return routes, None
        last = routes[limit - 1]
        return routes[:limit], f"{last.created_at.isoformat()}_{last.id}"

    async def set_camera(
        self, unit: UnitOfWork, owner: str, route_id: UUID, camera: Mapping[str, Any]
    ) -> RouteRecord:
        """Place the leader's camera, for the video to come; if a build with a video failed, try again.

        Raises:
            CameraInvalidError: as :func:`server.services.cameras.usable_camera`.
            RouteNotFoundError, RouteStateError: as in :meth:`receive_video`.
        """
        usable = await asyncio.to_thread(usable_camera, camera)
        return await self._place(unit, owner, route_id, camera=usable.to_json())

    async def receive_video(
        self, owner: str, route_id: UUID, chunks: AsyncIterable[bytes], declared_length: int | None
    ) -> RouteRecord:
        """Stream a video into the store; the build is queued, with the camera that is there by now.

        Without one the walk itself has to tell its lens.

        Two transactions of its own, none of them open while the bytes come.

        Raises:
            RouteNotFoundError: none of this owner, or deleted meanwhile.
            RouteStateError: the route is being built or has its map.
            UploadTooLargeError: more bytes than allowed; nothing is kept.
            UploadIncompleteError: fewer bytes than declared, or none; nothing is kept.
            StorageFullError: there is no room for it; nothing is kept.
        """
        if declared_length is not None and declared_length > self._max_video_bytes:
            raise UploadTooLargeError(f"a video may have {self._max_video_bytes} bytes")
        async with self._database.begin() as unit:
            _check_accepts_uploads(await self.get(unit, owner, route_id))
        key = f"routes/{route_id}/video-{uuid4().hex}"
        try:
            length = await self._store.put(key, chunks, limit=self._max_video_bytes)
        except ObjectTooLargeError:
            raise UploadTooLargeError(f"a video may have {self._max_video_bytes} bytes") from None
        except NoRoomError:
            log.error("route.storage_full", route=str(route_id))
            raise StorageFullError("the service has no room left for the video: try again later") from None
        placed = False

        async def note_placed() -> None:
            nonlocal placed
            placed = True

        try:
            if length == 0 or (declared_length is not None and length != declared_length):
                raise UploadIncompleteError(f"{length} bytes came, {declared_length or 'some'} were expected")
            async with self._database.begin() as unit:
                unit.after_commit(note_placed)
                return await self._place(unit, owner, route_id, video_key=key, video_bytes=length)
        except Exception:
            # Cancelled in mid-commit, nobody knows whether the route has it: what is in doubt is kept.
            if not placed:
                await self._store.delete([key])
            raise

    async def _place(self, unit: UnitOfWork, owner: str, route_id: UUID, **values: Any) -> RouteRecord:
        routes = unit.routes_of(owner)
        before = await self.get(unit, owner, route_id)
        _check_accepts_uploads(before)
        now = self._clock()
        route = await routes.change(route_id, ACCEPTS_UPLOADS, now, **values)
        if route is not None and route.video_key is not None:
            route = await routes.change(
                route_id,
                ACCEPTS_UPLOADS,
                now,
                state=RouteState.UPLOADED,
                build_stage="queued",
                build_fraction=0.0,
                build_attempt=0,
                failure_reason=None,
                failure_detail=None,
                report=None,
            )
            unit.after_commit(lambda: self._jobs.enqueue(BuildJob(route_id)))
        if route is None:
            _check_accepts_uploads(await self.get(unit, owner, route_id))
            raise RouteStateError("the route changed meanwhile; look again")
        replaced = list(quality_objects(before.report).values()) if route.report is None else []
        if before.video_key is not None and before.video_key != route.video_key:
            replaced.append(before.video_key)
        if replaced:
            unit.after_commit(lambda: self._store.delete(replaced))
        log.info("route.uploaded", route=str(route_id), state=route.state, parts=sorted(values))
        return route

    async def delete(self, unit: UnitOfWork, owner: str, route_id: UUID) -> None:
        """Remove a route, its build, its sessions and its files.

        Raises:
            RouteNotFoundError: none of this owner.
        """
        route = await unit.routes_of(owner).remove(route_id)
        if route is None:
            raise RouteNotFoundError(f"there is no route {route_id}")

        async def clean_up() -> None:
            self._sessions.close_route(route_id)
            await self._jobs.cancel(route_id)
            await self._store.delete(await self._store.keys(f"routes/{route_id}"))
            log.info("route.deleted", route=str(route_id))

        unit.after_commit(clean_up)

    async def map_file(self, route: RouteRecord) -> Download:
        """The route's map file.

        Raises:
            RouteNotReadyError: there is none yet.
            MapUnusableError: it is gone from the store.
        """
        return await self._download(route, route.map_key)

    async def path_file(self, route: RouteRecord) -> Download:
        """The route's path document, JSON.

        Raises:
            RouteNotReadyError, MapUnusableError: as in :meth:`map_file`.
        """
        return await self._download(route, route.path_key)

    async def _download(self, route: RouteRecord, key: str | None) -> Download:
        key = require_ready(route, key)
        try:
            return Download(await self._store.size(key), self._store.read(key))
        except ObjectMissingError:
            log.error("route.file_missing", route=str(route.id), key=key)
            raise MapUnusableError("the route's map file is gone: create another route") from None


def require_ready(route: RouteRecord, key: str | None) -> str:
    """The key, if the route has its map.

    Raises:
        RouteNotReadyError: it has not, and why.
    """
    if route.state is RouteState.READY and key is not None:
        return key
    because = f": {route.failure_detail}" if route.state is RouteState.FAILED and route.failure_detail else ""
    raise RouteNotReadyError(f"the route is {route.state}{because}")


def _check_accepts_uploads(route: RouteRecord) -> None:
    if route.state not in ACCEPTS_UPLOADS:
        raise RouteStateError(
            f"the route is {route.state}: a video or camera is taken only while it is "
            f"{' or '.join(ACCEPTS_UPLOADS)}; create another route for another walk"
        )


def _parse_cursor(cursor: str) -> tuple[datetime, UUID]:
    created, _, route_id = cursor.partition("_")
    try:
        time, identity = datetime.fromisoformat(created), UUID(route_id)
    except ValueError:
        raise CursorInvalidError("not a cursor of this list") from None
    if time.tzinfo is None:
        raise CursorInvalidError("not a cursor of this list")
    return time, identity
