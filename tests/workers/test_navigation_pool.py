from __future__ import annotations

import asyncio
import os
import signal
import threading
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

from server.services.errors import MapUnusableError, NavigationUnavailableError
from server.services.navigation import FrameLostError, FrameRefusedError
from server.workers import navigation_pool
from server.workers.navigation_channel import ChannelClosed
from server.workers.navigation_pool import NavigationPool

CAMERA: dict[str, Any] = {"model": "PINHOLE", "width": 64, "height": 48, "params": [60, 60, 32, 24]}
PICTURE = b"\xff\xd8"


@asynccontextmanager
async def pool(processes: int, **options: Any) -> AsyncIterator[NavigationPool]:
    running = NavigationPool(processes, 2, 1_000_000, engine="stub_core:StubEngine", **options)
    await running.start()
    try:
        yield running
    finally:
        await running.close()


@pytest.fixture
def map_file(tmp_path: Path) -> str:
    path = tmp_path / "map"
    path.write_bytes(b"MAP")
    return str(path)


async def count(running: NavigationPool, session: str, sequence: int) -> float:
    """How many pictures the session's engine has seen, by its own count."""
    update = await running.process(session, sequence, sequence / 10, PICTURE)
    assert update.fix is not None
    return float(update.fix.world_from_camera.translation[0])


async def test_sessions_are_spread_and_each_keeps_its_owner(map_file: str) -> None:
    async with pool(2) as running:
        for session in "abcd":
            await running.open(session, map_file, CAMERA, 0)
        first, second = running.pids
        os.kill(first, signal.SIGSTOP)
        try:
            # Half of the sessions live in the process that stands still, the others do not notice.
            done, waiting = await asyncio.wait(
                [asyncio.create_task(count(running, session, 1)) for session in "abcd"], timeout=1.5
            )
        finally:
            os.kill(first, signal.SIGCONT)
        assert (len(done), len(waiting)) == (2, 2)
        assert [await task for task in (*done, *waiting)] == [1.0] * 4
        assert running.pids == [first, second]


async def test_a_process_that_does_not_answer_is_replaced_and_its_sessions_go_on(map_file: str) -> None:
    async with pool(1, answer_timeout_s=0.5) as running:
        await running.open("a", map_file, CAMERA, 0)
        assert [await count(running, "a", n) for n in (1, 2)] == [1.0, 2.0]
        (pid,) = running.pids
        os.kill(pid, signal.SIGSTOP)
        with pytest.raises(FrameLostError):
            await count(running, "a", 3)
        assert await count(running, "a", 4) == 3.0
        assert running.pids != [pid]


async def test_a_new_session_can_go_on_from_a_snapshot(map_file: str) -> None:
    async with pool(1) as running:
        await running.open("a", map_file, CAMERA, 0, snapshot={"count": 41})
        assert await count(running, "a", 1) == 42.0


async def test_pictures_and_maps_are_refused_by_their_own_errors(map_file: str, tmp_path: Path) -> None:
    async with pool(1) as running:
        await running.open("a", map_file, CAMERA, 0)
        with pytest.raises(FrameRefusedError, match="not a JPEG"):
            await running.process("a", 1, 0.1, b"dust")
        (tmp_path / "dust").write_bytes(b"dust")
        with pytest.raises(MapUnusableError, match="not a map"):
            await running.open("b", str(tmp_path / "dust"), CAMERA, 0)
        with pytest.raises(NavigationUnavailableError):
            await running.open("c", str(tmp_path / "missing"), CAMERA, 0)
        for never_opened in ("b", "c", "d"):
            with pytest.raises(NavigationUnavailableError):
                await running.process(never_opened, 1, 0.1, PICTURE)
        running.close_session("a")
        with pytest.raises(NavigationUnavailableError):
            await running.process("a", 2, 0.2, PICTURE)


async def test_an_engine_that_cannot_be_loaded_stops_the_start() -> None:
    running = NavigationPool(1, 2, 1_000_000, engine="stub_core:NoSuchEngine")
    with pytest.raises(ChannelClosed):
        await running.start()
    assert running.alive == 0
    await running.close()


async def test_the_libraries_of_a_process_use_one_thread() -> None:
    running = NavigationPool(1, 2, 1_000_000, engine="stub_core:ThreadCountingEngine")
    await running.start()
    try:
        await running.open("a", "", CAMERA, 0)
        assert await count(running, "a", 1) == 1.0
    finally:
        await running.close()


async def test_a_busy_process_is_not_a_silent_one(map_file: str) -> None:
    """Ten pictures of 0.3 s wait in one queue: the last one waits longer than any process may be silent."""
    async with pool(1, answer_timeout_s=1.5) as running:
        for number in range(10):
            await running.open(f"s{number}", map_file, CAMERA, 0)
        (pid,) = running.pids
        asked = [running.process(f"s{number}", 1, 0.1, PICTURE + b"slow") for number in range(10)]
        assert all(update.fix is not None for update in await asyncio.gather(*asked))
        assert running.pids == [pid]


async def test_only_the_picture_that_silenced_a_process_is_blamed(map_file: str) -> None:
    async with pool(1, answer_timeout_s=0.5) as running:
        for session in "abc":
            await running.open(session, map_file, CAMERA, 0)
        (pid,) = running.pids
        os.kill(pid, signal.SIGSTOP)
        asked = []
        for session in "abc":
            asked.append(asyncio.create_task(running.process(session, 1, 0.1, PICTURE)))
            await asyncio.sleep(0.01)
        lost = await asyncio.gather(*asked, return_exceptions=True)
        assert all(isinstance(each, FrameLostError) for each in lost)
        assert [running._sessions[session].deaths for session in "abc"] == [1, 0, 0]


async def test_a_session_does_not_wait_for_ever_for_a_process(
    map_file: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(navigation_pool, "_NO_PROCESS_S", 0.3)
    async with pool(1) as running:
        monkeypatch.setattr(running, "_arguments", ("stub_core:NoSuchEngine", 2, 1))
        (pid,) = running.pids
        os.kill(pid, signal.SIGKILL)
        async with asyncio.timeout(5):
            while running.alive:
                await asyncio.sleep(0.01)
            with pytest.raises(NavigationUnavailableError, match="no process"):
                await running.open("a", map_file, CAMERA, 0)


async def test_processes_that_died_leave_no_trace(map_file: str) -> None:
    """Killed in the middle of a picture, five times over."""
    async with pool(1) as running:
        handles = open_files()
        threads = pipe_threads()
        for number in range(5):
            await running.open(f"s{number}", map_file, CAMERA, 0)
            (pid,) = running.pids
            asked = asyncio.create_task(running.process(f"s{number}", 1, 0.1, PICTURE + b"slow"))
            await asyncio.sleep(0.05)
            os.kill(pid, signal.SIGKILL)
            with pytest.raises(FrameLostError):
                await asked
            async with asyncio.timeout(30):
                while running.pids in ([], [pid]):
                    await asyncio.sleep(0.02)
            assert await count(running, f"s{number}", 2) == 1.0
            assert is_reaped(pid)
        assert open_files() <= handles
        assert pipe_threads() == threads == 2


def open_files() -> int:
    return len(list(Path("/dev/fd").iterdir()))


def pipe_threads() -> int:
    return sum(thread.name.startswith("navigation-") for thread in threading.enumerate())


def is_reaped(pid: int) -> bool:
    """A zombie could still be waited for."""
    try:
        os.waitpid(pid, os.WNOHANG)
    except ChildProcessError:
        return True
    return False
