from __future__ import annotations

import asyncio
import os
from collections.abc import AsyncIterator, Iterator
from pathlib import Path
from uuid import uuid4

import asyncpg
import pytest
import pytest_asyncio
from sqlalchemy.engine import make_url

from server.storage.database import Database
from server.storage.migrations import migrate

POSTGRES = os.environ.get("PAIRNAVI_TEST_POSTGRES", "postgresql+asyncpg://postgres@127.0.0.1:5432/postgres")


async def _administer(statement: str) -> None:
    url = make_url(POSTGRES)
    connection = await asyncpg.connect(
        host=url.host,
        port=url.port,
        user=url.username,
        password=url.password,
        database=url.database,
        timeout=3,
    )
    try:
        await connection.execute(statement)
    finally:
        await connection.close()


@pytest.fixture(scope="session")
def scratch_postgres() -> Iterator[str]:
    """A database of its own on a PostgreSQL server, removed afterwards."""
    name = f"pairnavi_test_{uuid4().hex[:12]}"
    try:
        asyncio.run(_administer(f'CREATE DATABASE "{name}"'))
    except (OSError, TimeoutError, asyncpg.PostgresError) as error:
        pytest.skip(f"no PostgreSQL at {POSTGRES}: start one, or set PAIRNAVI_TEST_POSTGRES ({error})")
    try:
        yield make_url(POSTGRES).set(database=name).render_as_string(hide_password=False)
    finally:
        asyncio.run(_administer(f'DROP DATABASE "{name}" WITH (FORCE)'))


@pytest.fixture(params=["sqlite", "postgresql"])
def database_url(request: pytest.FixtureRequest, tmp_path: Path) -> str:
    """An empty database on either engine."""
    if request.param == "sqlite":
        return f"sqlite+aiosqlite:///{tmp_path / 'test.db'}"
    url: str = request.getfixturevalue("scratch_postgres")
    return url


@pytest_asyncio.fixture
async def database(database_url: str) -> AsyncIterator[Database]:
    """A migrated database, emptied afterwards."""
    database = Database(database_url)
    await migrate(database.engine)
    try:
        yield database
    finally:
        async with database.engine.begin() as connection:
            await connection.exec_driver_sql("DELETE FROM routes")
        await database.close()
