"""The in-process job queue: a fresh process for each build.

One process a build rather than a pool: a build can be stopped by killing it, its death concerns
nothing else, and the memory it took goes back to the system.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Awaitable, Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from typing import TypeVar
from uuid import UUID

import structlog

from server.queues.jobs import BuildJob, BuildLedger, BuildOrder, BuildOutcome, JobProgress
from server.workers.child import ChildOptions, describe_exit, start_child, stop_child

T = TypeVar("T")

log = structlog.get_logger()

BUILDER = "server.workers.build_process:build"

_NICENESS = 10
"""A build may take all cores that nobody else wants: followers come first."""

_RECORD_EVERY_S = 2.0
"""Progress is written to the database at most so often, besides changes of stage."""

_EXIT_GRACE_S = 2.0
"""For a process that has closed its pipe to end, so that its own exit code is seen."""

_FIRST_PAUSE_S = 1.0
_LONGEST_PAUSE_S = 60.0
"""Between attempts to have the ledger record something. A full disk is put right in the end."""


@dataclass(slots=True)
class _Running:
    task: asyncio.Task[None] | None = None
    progress: JobProgress | None = None
    process: BaseProcess | None = None
    waiting: bool = True
    cancelled: bool = False
    again: bool = False
    ended: asyncio.Event = field(default_factory=asyncio.Event)


class ProcessJobQueue:
    """A :class:`server.queues.jobs.JobQueue` whose builds are children of this process.

    Args:
        processes: builds that run at once.
        timeout_s: after which a build is given up.
        memory_bytes: that one build may take; 0 sets no limit.
        builder: import path of the function that builds, see :mod:`server.workers.build_process`.
    """

    def __init__(
        self,
        ledger: BuildLedger,
        processes: int,
        timeout_s: float,
        memory_bytes: int = 0,
        builder: str = BUILDER,
    ) -> None:
        self._ledger = ledger
        self._child = ChildOptions(threads=0, niceness=_NICENESS, memory_bytes=memory_bytes)
        self._room = asyncio.Semaphore(processes)
        self._timeout_s = timeout_s
        self._builder = builder
        self._jobs: dict[UUID, _Running] = {}
        self._threads = ThreadPoolExecutor(processes, "build-receiver")

    async def enqueue(self, job: BuildJob) -> None:
        """See :meth:`server.queues.jobs.JobQueue.enqueue`."""
        earlier = self._jobs.get(job.route_id)
        if earlier is not None:
            # It may be ending just now: when it has, the ledger is asked once more.
            earlier.again = True
            return
        entry = _Running()
        self._jobs[job.route_id] = entry
        entry.task = asyncio.create_task(self._run(job, entry), name=f"build {job.route_id}")

    async def cancel(self, route_id: UUID) -> None:
        """See :meth:`server.queues.jobs.JobQueue.cancel`."""
        entry = self._jobs.get(route_id)
        if entry is not None:
            await self._stop(entry)

    def progress(self, route_id: UUID) -> JobProgress | None:
        """See :meth:`server.queues.jobs.JobQueue.progress`."""
        entry = self._jobs.get(route_id)
        return None if entry is None else entry.progress

    @property
    def running(self) -> int:
        """See :meth:`server.queues.jobs.JobQueue.running`."""
        return sum(entry.process is not None for entry in self._jobs.values())

    async def close(self) -> None:
        """Stop all builds; the database still says that they are owed."""
        entries = list(self._jobs.values())
        for entry in entries:
            # All of them first: the room one leaves must not go to the next.
            entry.cancelled = True
        for entry in entries:
            await self._stop(entry)
        self._threads.shutdown()

    async def _stop(self, entry: _Running) -> None:
        entry.cancelled = True
        if entry.process is not None:
            # Its pipe breaks, and the job's task ends by itself, tidying up on its way.
            entry.process.kill()
        elif entry.waiting and entry.task is not None:
            entry.task.cancel()
        await entry.ended.wait()

    async def _run(self, job: BuildJob, entry: _Running) -> None:
        try:
            untold = await self._until_done(entry, lambda: self._build(job, entry))
            if untold is not None:
                order, outcome = untold
                await self._until_done(entry, lambda: self._ledger.finish(order, outcome))
        except asyncio.CancelledError:
            if not entry.cancelled:
                raise
        finally:
            self._jobs.pop(job.route_id, None)
            entry.ended.set()
            if entry.again and not entry.cancelled:
                await self.enqueue(job)

    async def _until_done(self, entry: _Running, action: Callable[[], Awaitable[T]]) -> T | None:
        """Again and again: given up, the route would be called building until the service is restarted."""
        pause = _FIRST_PAUSE_S
        while not entry.cancelled:
            try:
                return await action()
            except Exception:
                log.exception("build.not_recorded", again_in_s=pause)
            entry.waiting = True
            await asyncio.sleep(pause)
            pause = min(_LONGEST_PAUSE_S, 2 * pause)
        return None

    async def _build(self, job: BuildJob, entry: _Running) -> tuple[BuildOrder, BuildOutcome] | None:
        """Build when there is room; returns the end that the ledger could not be told, None if it was."""
        async with self._room:
            entry.waiting = False
            if entry.cancelled:
                return None
            order = await self._ledger.begin(job)
            if order is None:
                return None
            outcome = None if entry.cancelled else await self._outcome(order, entry)
            if outcome is None or entry.cancelled:
                await self._ledger.abandon(order)
                return None
            try:
                await self._ledger.finish(order, outcome)
            except Exception as error:
                log.exception("build.not_stored", route=str(order.route_id))
                if outcome.failure is None:
                    reason = f"the finished map could not be stored: {type(error).__name__}"
                    outcome = BuildOutcome("storage_failed", reason, report=outcome.report)
                return order, outcome
        return None

    async def _outcome(self, order: BuildOrder, entry: _Running) -> BuildOutcome:
        process, connection = await asyncio.to_thread(
            start_child, "pairnavi-build", self._child, "server.workers.build_process:main", self._builder
        )
        entry.process = process
        loop = asyncio.get_running_loop()
        progressed = asyncio.Event()

        over = False

        def show(progress: JobProgress) -> None:
            entry.progress = progress
            progressed.set()

        recorder = asyncio.create_task(self._record(order, entry, progressed, lambda: over))
        outcome: BuildOutcome | None = None
        timed_out = False
        try:
            if entry.cancelled:
                process.kill()
            receiving = loop.run_in_executor(
                self._threads, _receive, connection, order, lambda p: loop.call_soon_threadsafe(show, p)
            )
            done, _ = await asyncio.wait({receiving}, timeout=self._timeout_s)
            if not done:
                timed_out = True
                process.kill()
            outcome = await receiving
        finally:
            over = True
            progressed.set()
            await recorder
            entry.process = None
            code = await asyncio.to_thread(stop_child, process, _EXIT_GRACE_S)
            connection.close()
        if outcome is not None:
            return outcome
        if timed_out:
            return BuildOutcome("timed_out", f"the build took longer than {self._timeout_s:g} s")
        return BuildOutcome("build_process_died", f"the build's process is gone: {describe_exit(code)}")

    async def _record(
        self, order: BuildOrder, entry: _Running, progressed: asyncio.Event, over: Callable[[], bool]
    ) -> None:
        stage, written = "", 0.0
        while True:
            await progressed.wait()
            progressed.clear()
            if over():
                return
            progress = entry.progress
            if progress is None:
                continue
            now = time.monotonic()
            if progress.stage != stage or now - written >= _RECORD_EVERY_S:
                stage, written = progress.stage, now
                try:
                    await self._ledger.record_progress(order, progress)
                except Exception:
                    log.exception("build.progress_not_recorded", route=str(order.route_id))


def _receive(
    connection: Connection, order: BuildOrder, on_progress: Callable[[JobProgress], object]
) -> BuildOutcome | None:
    """Talk to the build's process until it ends; None if it ended without an outcome."""
    try:
        connection.send(order)
        while True:
            message = connection.recv()
            if isinstance(message, BuildOutcome):
                return message
            on_progress(message)
    except (EOFError, OSError):
        return None
