"""Bringing a database to the newest schema."""

from __future__ import annotations

from pathlib import Path

from alembic import command
from alembic.config import Config
from sqlalchemy import Connection, text
from sqlalchemy.ext.asyncio import AsyncEngine

_ADVISORY_LOCK = 7_105_114_001
"""Any number, the same in every replica: only one of them migrates at a time on PostgreSQL."""


def migrations_folder() -> Path:
    """Where the migrations lie: inside an installed package, or at the top of a checkout.

    Raises:
        FileNotFoundError: neither is there.
    """
    packaged = Path(__file__).with_name("alembic")
    checkout = Path(__file__).parents[2] / "alembic"
    for folder in (packaged, checkout):
        if (folder / "env.py").is_file():
            return folder
    raise FileNotFoundError(f"no migrations in {packaged} or {checkout}")


def alembic_config(connection: Connection | None = None) -> Config:
    """Alembic's configuration; with a connection its commands run in that connection's transaction."""
    config = Config()
    config.set_main_option("script_location", str(migrations_folder()).replace("%", "%%"))
    config.set_main_option("path_separator", "os")
    config.attributes["connection"] = connection
    return config


async def migrate(engine: AsyncEngine, revision: str = "head") -> None:
    """Upgrade to a revision, in one transaction."""
    async with engine.begin() as connection:
        if connection.dialect.name == "postgresql":
            await connection.execute(text("SELECT pg_advisory_xact_lock(:key)"), {"key": _ADVISORY_LOCK})
        await connection.run_sync(lambda sync: command.upgrade(alembic_config(sync), revision))
