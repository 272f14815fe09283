"""The database: engine, and units of work whose after-commit actions run only if the commit did."""

from __future__ import annotations

import sqlite3
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager, suppress
from typing import Any

from sqlalchemy import event, text
from sqlalchemy.engine import make_url
from sqlalchemy.ext.asyncio import AsyncEngine, AsyncSession, async_sessionmaker, create_async_engine

from server.storage.repositories import BuildRecords, OwnedRoutes

AfterCommit = Callable[[], Awaitable[None]]

SQLITE_BUSY_TIMEOUT_MS = 10_000


class UnitOfWork:
    """One transaction, and what is to be done once it is committed."""

    def __init__(self, session: AsyncSession) -> None:
        self._session = session
        self._after_commit: list[AfterCommit] = []

    def routes_of(self, owner: str) -> OwnedRoutes:
        """The routes of one owner."""
        return OwnedRoutes(self._session, owner)

    @property
    def builds(self) -> BuildRecords:
        """What builds read and report."""
        return BuildRecords(self._session)

    def after_commit(self, action: AfterCommit) -> None:
        """Run ``action`` after the commit; if the transaction fails it never runs."""
        self._after_commit.append(action)

    async def run_after_commit(self) -> None:
        """Run the actions in order. Called once, by :meth:`Database.begin`."""
        actions, self._after_commit = self._after_commit, []
        for action in actions:
            await action()


class Database:
    """An engine and the units of work on it.

    Args:
        url: SQLAlchemy URL with an async driver, ``sqlite+aiosqlite`` or ``postgresql+asyncpg``.
    """

    def __init__(self, url: str) -> None:
        self.engine = create_engine(url)
        self._sessions = async_sessionmaker(self.engine, expire_on_commit=False)

    @asynccontextmanager
    async def begin(self) -> AsyncIterator[UnitOfWork]:
        """A transaction: committed when the block ends, rolled back when it raises."""
        async with self._sessions() as session:
            unit = UnitOfWork(session)
            async with session.begin():
                yield unit
        await unit.run_after_commit()

    async def is_alive(self) -> bool:
        """Whether a trivial query is answered."""
        try:
            async with self.engine.connect() as connection:
                await connection.execute(text("SELECT 1"))
        except Exception:
            return False
        return True

    async def close(self) -> None:
        """Close all connections."""
        await self.engine.dispose()


def create_engine(url: str) -> AsyncEngine:
    """An async engine; SQLite gets write-ahead logging, foreign keys and a busy timeout.

    SQLite transactions begin with ``BEGIN IMMEDIATE``: a transaction that reads and then writes
    would otherwise fail at once, instead of waiting, when another one wrote in between.
    """
    engine = create_async_engine(url, pool_pre_ping=make_url(url).get_backend_name() != "sqlite")
    if make_url(url).get_backend_name() == "sqlite":

        @event.listens_for(engine.sync_engine, "connect")
        def _configure(connection: Any, _record: Any) -> None:
            connection.isolation_level = None
            cursor = connection.cursor()
            cursor.execute(f"PRAGMA busy_timeout = {SQLITE_BUSY_TIMEOUT_MS}")
            # The mode is the file's. SQLite does not wait for another connection that is just setting it.
            with suppress(sqlite3.OperationalError):
                cursor.execute("PRAGMA journal_mode = WAL")
            cursor.execute("PRAGMA synchronous = NORMAL")
            cursor.execute("PRAGMA foreign_keys = ON")
            cursor.close()

        @event.listens_for(engine.sync_engine, "begin")
        def _begin(connection: Any) -> None:
            connection.exec_driver_sql("BEGIN IMMEDIATE")

    return engine
