from __future__ import annotations

import asyncio
from datetime import UTC, datetime, timedelta, timezone
from pathlib import Path
from uuid import UUID, uuid4

import pytest
from sqlalchemy.exc import IntegrityError, StatementError

from server.storage.database import Database, UnitOfWork
from server.storage.records import ACCEPTS_UPLOADS, RouteRecord, RouteState

NOW = datetime(2026, 3, 1, 12, 30, 15, 250_000, tzinfo=UTC)


async def add(unit: UnitOfWork, owner: str = "ann", now: datetime = NOW) -> RouteRecord:
    return await unit.routes_of(owner).add(
        uuid4(),
        name="To the lab",
        start_label="Door",
        destination_label="Lab",
        measured_length_m=None,
        now=now,
    )


async def test_a_route_is_kept_as_it_was_given(database: Database) -> None:
    async with database.begin() as unit:
        added = await add(unit)
        camera = {"model": "PINHOLE", "params": [1.5, 2.0], "width": 3}
        await unit.routes_of("ann").change(
            added.id, ACCEPTS_UPLOADS, NOW, camera=camera, video_key="k", video_bytes=3 << 32
        )
    async with database.begin() as unit:
        route = await unit.routes_of("ann").get(added.id)
    assert route is not None
    assert (route.state, route.camera, route.video_bytes) == (RouteState.CREATED, camera, 3 << 32)
    assert (route.report, route.map_key, route.measured_length_m) == (None, None, None)
    assert route.created_at == NOW
    assert route.created_at.tzinfo is not None


async def test_nobody_sees_or_changes_anothers_routes(database: Database) -> None:
    async with database.begin() as unit:
        mine = await add(unit, "ann")
        others = unit.routes_of("bob")
        assert await others.get(mine.id) is None
        assert await others.page(10, None) == []
        assert await others.change(mine.id, list(RouteState), NOW, name="x") is None
        assert await others.remove(mine.id) is None
        assert await unit.routes_of("ann").get(mine.id) == mine


async def test_a_state_changes_only_from_the_states_it_may(database: Database) -> None:
    later = NOW + timedelta(seconds=5)
    async with database.begin() as unit:
        route = await add(unit)
        builds = unit.builds
        assert await builds.change(route.id, [RouteState.BUILDING], later, state=RouteState.READY) is None
        changed = await builds.change(
            route.id, [RouteState.CREATED], later, state=RouteState.UPLOADED, build_stage="queued"
        )
        assert changed is not None
        assert (changed.state, changed.build_stage) == (RouteState.UPLOADED, "queued")
        assert (changed.created_at, changed.updated_at) == (NOW, later)
        assert await builds.get(route.id) == changed


async def test_only_one_of_two_racing_changes_happens(database: Database) -> None:
    async with database.begin() as unit:
        route = await add(unit)

    async def race() -> bool:
        async with database.begin() as unit:
            done = await unit.builds.change(route.id, [RouteState.CREATED], NOW, state=RouteState.UPLOADED)
            await asyncio.sleep(0.05)
            return done is not None

    assert sorted(await asyncio.gather(race(), race(), race())) == [False, False, True]


async def test_unknown_states_are_refused_by_the_database(database: Database) -> None:
    async with database.begin() as unit:
        route = await add(unit)

    async def dance() -> None:
        async with database.begin() as unit:
            await unit.builds.change(route.id, [RouteState.CREATED], NOW, state="dancing")

    with pytest.raises(IntegrityError):
        await dance()


async def test_pages_follow_each_other_newest_first_even_at_the_same_instant(database: Database) -> None:
    async with database.begin() as unit:
        times = [NOW, NOW + timedelta(seconds=1), NOW + timedelta(seconds=1), NOW + timedelta(seconds=2)]
        made = [await add(unit, now=time) for time in times]
    expected = sorted(made, key=lambda route: (route.created_at, route.id), reverse=True)
    seen: list[UUID] = []
    before: tuple[datetime, UUID] | None = None
    async with database.begin() as unit:
        while page := await unit.routes_of("ann").page(1, before):
            seen += [route.id for route in page]
            before = (page[-1].created_at, page[-1].id)
    assert seen == [route.id for route in expected]


async def test_unfinished_builds_are_listed_longest_waiting_first(database: Database) -> None:
    async with database.begin() as unit:
        for minutes, state in enumerate((RouteState.READY, RouteState.BUILDING, RouteState.UPLOADED)):
            route = await add(unit, owner=f"owner {minutes}")
            await unit.builds.change(
                route.id, [RouteState.CREATED], NOW - timedelta(minutes=minutes), state=state
            )
        await add(unit)
        states = [route.state for route in await unit.builds.unfinished()]
    assert states == [RouteState.UPLOADED, RouteState.BUILDING]


async def test_actions_run_after_the_commit_and_only_then(database: Database) -> None:
    happened: list[str] = []

    async def look(route_id: UUID) -> None:
        async with database.begin() as unit:
            happened.append("there" if await unit.builds.get(route_id) else "missing")

    async with database.begin() as unit:
        route = await add(unit)
        unit.after_commit(lambda: look(route.id))
        assert happened == []
    assert happened == ["there"]

    async def fail() -> None:
        async with database.begin() as unit:
            doomed = await add(unit, "doomed")
            unit.after_commit(lambda: look(doomed.id))
            raise RuntimeError

    with pytest.raises(RuntimeError):
        await fail()
    assert happened == ["there"]
    async with database.begin() as unit:
        assert await unit.routes_of("doomed").page(10, None) == []


async def test_times_are_kept_in_utc_and_need_a_zone(database: Database) -> None:
    east = NOW.astimezone(timezone(timedelta(hours=9)))
    async with database.begin() as unit:
        route = await add(unit, now=east)
    async with database.begin() as unit:
        kept = await unit.builds.get(route.id)
    assert kept is not None
    assert (kept.created_at, kept.created_at.utcoffset()) == (NOW, timedelta(0))
    with pytest.raises(StatementError, match="zone"):
        async with database.begin() as unit:
            await add(unit, now=datetime(2026, 3, 1))


async def test_known_keys_are_those_of_all_routes(database: Database) -> None:
    async with database.begin() as unit:
        for owner, keys in (("ann", {"video_key": "a"}), ("bob", {"map_key": "b", "path_key": "c"})):
            route = await add(unit, owner)
            await unit.builds.change(route.id, [RouteState.CREATED], NOW, **keys)
        assert await unit.builds.known_keys() == {"a", "b", "c"}


async def test_sqlite_writes_ahead_and_checks_foreign_keys(tmp_path: Path) -> None:
    database = Database(f"sqlite+aiosqlite:///{tmp_path / 'test.db'}")
    async with database.engine.connect() as connection:
        assert (await connection.exec_driver_sql("PRAGMA journal_mode")).scalar() == "wal"
        assert (await connection.exec_driver_sql("PRAGMA foreign_keys")).scalar() == 1
    await database.close()
