"""What the app is made of, wired together from the settings."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Annotated

import structlog
from fastapi import Depends
from starlette.requests import HTTPConnection

from server.services.builds import BuildService
from server.services.exports import ExportService
from server.services.navigation import NavigationService
from server.services.routes import RouteService
from server.settings import Settings
from server.storage.database import Database
from server.storage.migrations import migrate
from server.storage.objects import FolderObjectStore
from server.workers import build_jobs, navigation_pool
from server.workers.build_jobs import ProcessJobQueue
from server.workers.exports import ProcessExporter
from server.workers.navigation_pool import NavigationPool

log = structlog.get_logger()


@dataclass(frozen=True, slots=True)
class Entries:
    """Import paths of what the child processes run."""

    builder: str = build_jobs.BUILDER
    engine: str = navigation_pool.ENGINE


@dataclass(frozen=True, slots=True)
class Components:
    """The running parts of one service."""

    settings: Settings
    database: Database
    store: FolderObjectStore
    builds: BuildService
    jobs: ProcessJobQueue
    pool: NavigationPool
    navigation: NavigationService
    routes: RouteService
    exporter: ProcessExporter
    exports: ExportService

    async def start(self) -> None:
        """Migrate, start the processes, and take up what an earlier run left unfinished."""
        await migrate(self.database.engine)
        await self.store.sweep_unfinished()
        await self.pool.start()
        owed = await self.builds.recover(self.jobs)
        log.info("service.started", builds_requeued=owed)

    async def close(self) -> None:
        """Stop everything; unfinished builds stay owed."""
        self.navigation.close()
        await self.jobs.close()
        await self.pool.close()
        await self.exporter.close()
        await self.database.close()
        log.info("service.stopped")


def assemble(settings: Settings, entries: Entries) -> Components:
    """Wire the parts together; nothing runs yet but the folders are made."""
    settings.data_dir.mkdir(parents=True, exist_ok=True)

    def clock() -> datetime:
        return datetime.now(UTC)

    database = Database(settings.resolved_database_url)
    store = FolderObjectStore(settings.data_dir / "store")
    builds = BuildService(database, store, clock, settings.max_build_attempts)
    jobs = ProcessJobQueue(
        builds,
        settings.build_processes,
        settings.build_timeout_s,
        settings.build_memory_bytes,
        entries.builder,
    )
    pool = NavigationPool(
        settings.navigation_processes, settings.maps_per_process, settings.max_pixels, engine=entries.engine
    )
    navigation = NavigationService(pool, settings.max_sessions, settings.resume_within_s, settings.max_pixels)
    routes = RouteService(database, store, jobs, navigation, clock, settings.max_video_bytes)
    exporter = ProcessExporter()
    exports = ExportService(store, exporter)
    return Components(settings, database, store, builds, jobs, pool, navigation, routes, exporter, exports)


def components(connection: HTTPConnection) -> Components:
    """The parts of the app a request has reached."""
    found = connection.app.state.components
    assert isinstance(found, Components)  # noqa: S101 - narrows the app's untyped state
    return found


Parts = Annotated[Components, Depends(components)]
