"""Queries on routes: one repository for what people ask, one for what builds report."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from datetime import UTC, datetime
from typing import Any
from uuid import UUID

from sqlalchemy import delete, select, tuple_, update
from sqlalchemy.ext.asyncio import AsyncSession

from server.storage.records import UNFINISHED, RouteRecord, RouteState, quality_objects
from server.storage.tables import RouteRow

_FIELDS = tuple(f.name for f in fields(RouteRecord))


def _record(row: RouteRow) -> RouteRecord:
    values = {name: getattr(row, name) for name in _FIELDS}
    values["state"] = RouteState(row.state)
    return RouteRecord(**values)


class OwnedRoutes:
    """The routes of one owner: no query of this class sees another's.

    Args:
        session: whose transaction the queries run in.
        owner: the principal's owner name.
    """

    def __init__(self, session: AsyncSession, owner: str) -> None:
        self._session = session
        self._owner = owner

    async def add(
        self,
        route_id: UUID,
        *,
        name: str,
        start_label: str,
        destination_label: str,
        measured_length_m: float | None,
        now: datetime,
    ) -> RouteRecord:
        """Insert a route in state CREATED."""
        row = RouteRow(
            id=route_id,
            owner=self._owner,
            name=name,
            start_label=start_label,
            destination_label=destination_label,
            measured_length_m=measured_length_m,
            state=RouteState.CREATED,
            build_fraction=0.0,
            build_attempt=0,
            created_at=now,
            updated_at=now,
        )
        self._session.add(row)
        await self._session.flush()
        return _record(row)

    async def get(self, route_id: UUID) -> RouteRecord | None:
        """One route, or None if there is none of this owner."""
        statement = select(RouteRow).where(RouteRow.id == route_id, RouteRow.owner == self._owner)
        row = (await self._session.scalars(statement)).one_or_none()
        return None if row is None else _record(row)

    async def page(self, limit: int, before: tuple[datetime, UUID] | None) -> Sequence[RouteRecord]:
        """At most ``limit`` routes, newest first, older than the (created_at, id) of ``before``."""
        statement = select(RouteRow).where(RouteRow.owner == self._owner)
        if before is not None:
            statement = statement.where(tuple_(RouteRow.created_at, RouteRow.id) < tuple_(*before))
        statement = statement.order_by(RouteRow.created_at.desc(), RouteRow.id.desc()).limit(limit)
        return [_record(row) for row in await self._session.scalars(statement)]

    async def change(
        self, route_id: UUID, among: Sequence[RouteState], now: datetime, **values: Any
    ) -> RouteRecord | None:
        """Set columns if the route is in one of the states, atomically; None if it is not."""
        return await _change(
            self._session,
            RouteRow.owner == self._owner,
            route_id=route_id,
            among=among,
            now=now,
            values=values,
        )

    async def remove(self, route_id: UUID) -> RouteRecord | None:
        """Delete a route; None if there is none of this owner."""
        statement = (
            delete(RouteRow)
            .where(RouteRow.id == route_id, RouteRow.owner == self._owner)
            .returning(RouteRow)
            .execution_options(synchronize_session=False)
        )
        row = (await self._session.scalars(statement)).one_or_none()
        return None if row is None else _record(row)


class BuildRecords:
    """What builds read and report. It sees every owner's routes: for jobs, never for a request."""

    def __init__(self, session: AsyncSession) -> None:
        self._session = session

    async def unfinished(self) -> Sequence[RouteRecord]:
        """Routes a build is owed to, the longest waiting first."""
        statement = (
            select(RouteRow)
            .where(RouteRow.state.in_([str(s) for s in UNFINISHED]))
            .order_by(RouteRow.updated_at, RouteRow.id)
        )
        return [_record(row) for row in await self._session.scalars(statement)]

    async def get(self, route_id: UUID) -> RouteRecord | None:
        """One route."""
        row = await self._session.get(RouteRow, route_id, populate_existing=True)
        return None if row is None else _record(row)

    async def known_keys(self) -> set[str]:
        """Keys of all objects that a route refers to."""
        columns = (RouteRow.video_key, RouteRow.map_key, RouteRow.path_key)
        rows = await self._session.execute(select(*columns))
        keys = {key for row in rows for key in row if key is not None}
        for report in await self._session.scalars(select(RouteRow.report)):
            keys.update(quality_objects(report).values())
        return keys

    async def change(
        self, route_id: UUID, among: Sequence[RouteState], now: datetime, **values: Any
    ) -> RouteRecord | None:
        """Set columns if the route is in one of the states, atomically; None if it is not."""
        return await _change(self._session, route_id=route_id, among=among, now=now, values=values)


async def _change(
    session: AsyncSession,
    *conditions: Any,
    route_id: UUID,
    among: Sequence[RouteState],
    now: datetime,
    values: dict[str, Any],
) -> RouteRecord | None:
    statement = (
        update(RouteRow)
        .where(RouteRow.id == route_id, RouteRow.state.in_([str(s) for s in among]), *conditions)
        .values(updated_at=now.astimezone(UTC), **values)
        .returning(RouteRow)
        .execution_options(synchronize_session=False, populate_existing=True)
    )
    row = (await session.scalars(statement)).one_or_none()
    return None if row is None else _record(row)
