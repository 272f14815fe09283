"""Builds in their real processes, and a ledger that cannot always write."""

from __future__ import annotations

import asyncio
import os
import signal
import subprocess
import sys
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from uuid import UUID, uuid4

import pytest

from server.queues.jobs import BuildJob, BuildOrder, BuildOutcome, JobProgress
from server.workers import build_jobs
from server.workers.build_jobs import ProcessJobQueue

CAMERA = {"model": "PINHOLE", "width": 640, "height": 480, "params": [500.0, 500.0, 320.0, 240.0]}


class Ledger:
    """A :class:`server.queues.jobs.BuildLedger` in memory, whose first writes may fail."""

    def __init__(self, folder: Path, failing: dict[str, int] | None = None) -> None:
        self._folder = folder
        self._failing = failing or {}
        self.videos: dict[UUID, str] = {}
        self.begun: list[UUID] = []
        self.outcomes: dict[UUID, BuildOutcome] = {}
        self.abandoned: list[UUID] = []
        self.told = asyncio.Event()

    def _may_fail(self, name: str) -> None:
        if self._failing.get(name, 0) > 0:
            self._failing[name] -= 1
            raise OSError("database or disk is full")

    async def begin(self, job: BuildJob) -> BuildOrder | None:
        """See ``BuildLedger.begin``."""
        self._may_fail("begin")
        self.begun.append(job.route_id)
        video = self._folder / str(job.route_id)
        video.write_text(self.videos[job.route_id], encoding="ascii")
        return BuildOrder(job.route_id, 1, video, CAMERA, None, self._folder)

    async def record_progress(self, order: BuildOrder, progress: JobProgress) -> None:
        """See ``BuildLedger.record_progress``."""
        self._may_fail("progress")

    async def finish(self, order: BuildOrder, outcome: BuildOutcome) -> None:
        """See ``BuildLedger.finish``."""
        self._may_fail("finish")
        self.outcomes[order.route_id] = outcome
        self.told.set()

    async def abandon(self, order: BuildOrder) -> None:
        """See ``BuildLedger.abandon``."""
        self.abandoned.append(order.route_id)


@asynccontextmanager
async def queue(
    ledger: Ledger, builder: str = "hostile_builds:build", memory_bytes: int = 0
) -> AsyncIterator[ProcessJobQueue]:
    running = ProcessJobQueue(ledger, 1, 60.0, memory_bytes, builder)
    try:
        yield running
    finally:
        await running.close()


async def build(ledger: Ledger, jobs: ProcessJobQueue, video: str) -> BuildOutcome:
    route = uuid4()
    ledger.videos[route] = video
    ledger.told.clear()
    await jobs.enqueue(BuildJob(route))
    async with asyncio.timeout(30):
        await ledger.told.wait()
    return ledger.outcomes[route]


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="only Linux holds a process to its memory")
@pytest.mark.parametrize("library", ["numpy", "opencv"])
async def test_a_build_that_takes_too_much_memory_fails_for_that_reason(tmp_path: Path, library: str) -> None:
    ledger = Ledger(tmp_path)
    async with queue(ledger, memory_bytes=1280 << 20) as jobs:
        outcome = await build(ledger, jobs, library)
    assert outcome.failure == "out_of_memory"


async def test_a_build_without_room_for_its_map_fails_for_that_reason(tmp_path: Path) -> None:
    ledger = Ledger(tmp_path)
    async with queue(ledger) as jobs:
        outcome = await build(ledger, jobs, "disk")
    assert (outcome.failure, outcome.detail) == ("storage_failed", "the service has no room left for the map")


@pytest.mark.parametrize("step", ["begin", "progress", "finish"])
async def test_what_could_not_be_recorded_is_recorded_later(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, step: str
) -> None:
    monkeypatch.setattr(build_jobs, "_FIRST_PAUSE_S", 0.05)
    ledger = Ledger(tmp_path, {step: 3 if step != "progress" else 1})
    async with queue(ledger) as jobs:
        outcome = await build(ledger, jobs, "disk")
        assert outcome.failure == "storage_failed"
        # Nothing of it is left: the next build has its turn.
        assert (await build(ledger, jobs, "disk")).failure == "storage_failed"
    assert jobs.running == 0


async def test_a_build_that_cannot_be_recorded_can_be_cancelled(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ledger = Ledger(tmp_path, {"finish": 1000})
    async with queue(ledger) as jobs:
        route = uuid4()
        ledger.videos[route] = "disk"
        await jobs.enqueue(BuildJob(route))
        async with asyncio.timeout(20):
            while not (ledger.begun and jobs.running == 0):
                await asyncio.sleep(0.02)
        async with asyncio.timeout(5):
            await jobs.cancel(route)
    assert ledger.outcomes == {}


SERVICE = """
import asyncio, sys
from pathlib import Path
from uuid import uuid4
from test_build_jobs import Ledger
from server.queues.jobs import BuildJob
from server.workers.build_jobs import ProcessJobQueue

async def main():
    ledger = Ledger(Path(sys.argv[1]))
    jobs = ProcessJobQueue(ledger, 1, 60.0, 0, "hostile_builds:build")
    route = uuid4()
    ledger.videos[route] = "sleep"
    await jobs.enqueue(BuildJob(route))
    while jobs.progress(route) is None:
        await asyncio.sleep(0.02)
    print(jobs._jobs[route].process.pid, flush=True)
    await asyncio.sleep(60)

if __name__ == "__main__":
    asyncio.run(main())
"""


def test_a_build_ends_with_the_service_even_if_that_is_killed(tmp_path: Path) -> None:
    """It says nothing for a minute, so no broken pipe tells it."""
    here = Path(__file__).parent
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(here), str(here.parent / "support")])}
    program = tmp_path / "service.py"
    program.write_text(SERVICE, encoding="utf-8")
    with subprocess.Popen(
        [sys.executable, str(program), str(tmp_path)],
        stdout=subprocess.PIPE,
        env=environment,
        cwd=here.parents[1],
        text=True,
    ) as service:
        assert service.stdout is not None
        child = int(service.stdout.readline())
        assert is_alive(child)
        service.send_signal(signal.SIGKILL)
    deadline = time.monotonic() + 5
    while is_alive(child) and time.monotonic() < deadline:
        time.sleep(0.05)
    left = is_alive(child)
    if left:
        os.kill(child, signal.SIGKILL)
    assert not left


def is_alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    # A zombie that nobody has waited for is dead.
    status = subprocess.run(
        ["ps", "-o", "stat=", "-p", str(pid)], capture_output=True, text=True, check=False
    )
    return bool(status.stdout.strip()) and not status.stdout.strip().startswith("Z")
