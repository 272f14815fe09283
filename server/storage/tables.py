"""SQL tables. A change here needs a migration in alembic/versions."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Any
from uuid import UUID

from sqlalchemy import (
    JSON,
    BigInteger,
    CheckConstraint,
    DateTime,
    Dialect,
    Float,
    Index,
    Integer,
    MetaData,
    String,
    Text,
    Uuid,
)
from sqlalchemy.orm import DeclarativeBase, Mapped, mapped_column
from sqlalchemy.types import TypeDecorator

from server.storage.records import RouteState


class UtcDateTime(TypeDecorator[datetime]):
    """An aware UTC time on every engine; SQLite keeps no zone and gets it back here."""

    impl = DateTime(timezone=True)
    cache_ok = True

    def process_bind_param(self, value: datetime | None, dialect: Dialect) -> datetime | None:
        """To UTC; naive times are refused."""
        if value is None:
            return None
        if value.tzinfo is None:
            raise ValueError("a time without a zone cannot be stored")
        return value.astimezone(UTC)

    def process_result_value(self, value: datetime | None, dialect: Dialect) -> datetime | None:
        """An aware time in UTC."""
        if value is None:
            return None
        return value.replace(tzinfo=UTC) if value.tzinfo is None else value.astimezone(UTC)


class Base(DeclarativeBase):
    """Declarative base; constraints get stable names so that migrations can address them."""

    metadata = MetaData(
        naming_convention={
            "ix": "ix_%(table_name)s_%(column_0_N_name)s",
            "uq": "uq_%(table_name)s_%(column_0_N_name)s",
            "ck": "ck_%(table_name)s_%(constraint_name)s",
            "fk": "fk_%(table_name)s_%(column_0_N_name)s_%(referred_table_name)s",
            "pk": "pk_%(table_name)s",
        }
    )


class RouteRow(Base):
    """A route; columns as in :class:`server.storage.records.RouteRecord`."""

    __tablename__ = "routes"
    __table_args__ = (
        CheckConstraint(f"state IN ({', '.join(repr(str(s)) for s in RouteState)})", name="state"),
        Index(None, "owner", "created_at", "id"),
        Index(None, "state"),
    )

    id: Mapped[UUID] = mapped_column(Uuid, primary_key=True)
    owner: Mapped[str] = mapped_column(String(128))
    name: Mapped[str] = mapped_column(String(200))
    start_label: Mapped[str] = mapped_column(String(200))
    destination_label: Mapped[str] = mapped_column(String(200))
    measured_length_m: Mapped[float | None] = mapped_column(Float)
    state: Mapped[str] = mapped_column(String(16))
    camera: Mapped[dict[str, Any] | None] = mapped_column(JSON(none_as_null=True))
    video_key: Mapped[str | None] = mapped_column(String(256))
    video_bytes: Mapped[int | None] = mapped_column(BigInteger)
    map_key: Mapped[str | None] = mapped_column(String(256))
    path_key: Mapped[str | None] = mapped_column(String(256))
    build_stage: Mapped[str | None] = mapped_column(String(32))
    build_fraction: Mapped[float] = mapped_column(Float)
    build_attempt: Mapped[int] = mapped_column(Integer)
    failure_reason: Mapped[str | None] = mapped_column(String(64))
    failure_detail: Mapped[str | None] = mapped_column(Text)
    report: Mapped[dict[str, Any] | None] = mapped_column(JSON(none_as_null=True))
    map_summary: Mapped[dict[str, Any] | None] = mapped_column(JSON(none_as_null=True))
    created_at: Mapped[datetime] = mapped_column(UtcDateTime)
    updated_at: Mapped[datetime] = mapped_column(UtcDateTime)
