"""Route maps in the formats of others, for whoever may read the route."""

from __future__ import annotations

import asyncio
import os
from collections.abc import AsyncIterator
from pathlib import Path
from typing import IO, Literal, Protocol

import structlog

from server.services.errors import MapUnusableError
from server.services.routes import Download, require_ready
from server.storage.objects import ObjectMissingError, ObjectStore
from server.storage.records import RouteRecord

log = structlog.get_logger()

_CHUNK = 1 << 20


ExportName = Literal["colmap.zip", "trajectory.tum", "map.ply"]
"""What a map is exported as, and the end of the file's name."""


class MapExporter(Protocol):
    """Writes maps in other formats, away from the event loop."""

    async def export(self, map_file: Path, name: ExportName) -> IO[bytes]:
        """The export of a map's file, open for reading and without a name: closing it removes it.

        Raises:
            MapUnusableError: the file is no usable map.
            TooManyExportsError: too many are waiting.
        """
        ...


class ExportService:
    """Exports of routes; the route has been looked up, and may be read by who asks."""

    def __init__(self, store: ObjectStore, exporter: MapExporter) -> None:
        self._store = store
        self._exporter = exporter

    async def export(self, route: RouteRecord, name: ExportName) -> Download:
        """A route's map in another format.

        Raises:
            RouteNotReadyError: there is no map yet.
            MapUnusableError: it is gone from the store, or damaged.
            TooManyExportsError: too many are waiting.
        """
        key = require_ready(route, route.map_key)
        try:
            map_file = await self._store.local_path(key)
        except ObjectMissingError:
            log.error("route.file_missing", route=str(route.id), key=key)
            raise MapUnusableError("the route's map file is gone: create another route") from None
        file = await self._exporter.export(map_file, name)
        return Download(os.fstat(file.fileno()).st_size, _chunks(file))


async def _chunks(file: IO[bytes]) -> AsyncIterator[bytes]:
    with file:
        while chunk := await asyncio.to_thread(file.read, _CHUNK):
            yield chunk
