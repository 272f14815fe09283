from __future__ import annotations

import asyncio

from alembic import command
from alembic.autogenerate import compare_metadata
from alembic.migration import MigrationContext
from sqlalchemy import Connection, inspect

from server.storage.database import Database
from server.storage.migrations import alembic_config, migrate, migrations_folder
from server.storage.tables import Base


def differences(connection: Connection) -> list[object]:
    context = MigrationContext.configure(connection, opts={"compare_type": True})
    return list(compare_metadata(context, Base.metadata))


async def test_the_migrations_make_the_tables_that_the_code_knows(database: Database) -> None:
    async with database.engine.connect() as connection:
        assert await connection.run_sync(differences) == []


async def test_migrating_twice_changes_nothing_and_down_undoes_up(database_url: str) -> None:
    database = Database(database_url)
    try:
        await migrate(database.engine)
        await migrate(database.engine)
        async with database.engine.begin() as connection:
            await connection.run_sync(lambda sync: command.downgrade(alembic_config(sync), "base"))
            tables = await connection.run_sync(lambda sync: inspect(sync).get_table_names())
            assert tables == ["alembic_version"]
        await migrate(database.engine)
        async with database.engine.connect() as connection:
            assert await connection.run_sync(differences) == []
    finally:
        await database.close()


async def test_replicas_that_start_together_do_not_disturb_each_other(database_url: str) -> None:
    databases = [Database(database_url) for _ in range(3)]
    try:
        await asyncio.gather(*(migrate(database.engine) for database in databases))
        async with databases[0].engine.connect() as connection:
            assert await connection.run_sync(differences) == []
    finally:
        for database in databases:
            await database.close()


def test_the_migrations_are_found() -> None:
    assert (migrations_folder() / "versions" / "0001_routes.py").is_file()
