"""Exports in processes of their own: what reads maps and writes models stays out of the front door."""

from __future__ import annotations

import asyncio
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import IO

from server.services.errors import MapUnusableError, TooManyExportsError
from server.services.exports import ExportName
from server.workers.child import ChildOptions, describe_exit, start_child, stop_child
from server.workers.export_process import ExportDone, ExportOrder, ExportRefused

_CHILD = ChildOptions(threads=1, niceness=10, memory_bytes=4 << 30)
"""Followers come first. A map of an hour's walk takes a few hundred megabytes."""

_EXIT_GRACE_S = 2.0


class ExportFailedError(RuntimeError):
    """The export's process died or took too long: a bug, or the machine failed."""


class ProcessExporter:
    """A :class:`server.services.exports.MapExporter` with a fresh process for each export.

    Args:
        processes: exports that run at once; others wait.
        queue: how many may run or wait.
        timeout_s: after which one is given up.
    """

    def __init__(self, processes: int = 1, queue: int = 8, timeout_s: float = 120.0) -> None:
        self._timeout_s = timeout_s
        self._queue = queue
        self._asked = 0
        self._threads = ThreadPoolExecutor(processes, "export")

    async def export(self, map_file: Path, name: ExportName) -> IO[bytes]:
        """See :meth:`server.services.exports.MapExporter.export`."""
        if self._asked >= self._queue:
            raise TooManyExportsError("too many maps are being exported: try again in a minute")
        self._asked += 1
        try:
            loop = asyncio.get_running_loop()
            return await loop.run_in_executor(self._threads, self._export, map_file, name)
        finally:
            self._asked -= 1

    async def close(self) -> None:
        """Wait for what runs; nothing else is begun."""
        await asyncio.to_thread(self._threads.shutdown, cancel_futures=True)

    def _export(self, map_file: Path, name: ExportName) -> IO[bytes]:
        with tempfile.TemporaryDirectory(prefix="pairnavi-export-") as folder:
            outcome = self._outcome(ExportOrder(map_file, name, Path(folder)))
            if isinstance(outcome, ExportRefused):
                raise MapUnusableError(f"the route's map cannot be used: {outcome.reason}")
            # Opened before its folder goes: whatever becomes of the answer, no file is left behind.
            return outcome.file.open("rb")

    def _outcome(self, order: ExportOrder) -> ExportDone | ExportRefused:
        process, connection = start_child("pairnavi-export", _CHILD, "server.workers.export_process:main")
        outcome: ExportDone | ExportRefused | None = None
        in_time = False
        try:
            connection.send(order)
            in_time = connection.poll(self._timeout_s)
            if in_time:
                outcome = connection.recv()
        except (EOFError, OSError):
            # Its exit code below says what happened.
            in_time = True
        finally:
            code = stop_child(process, _EXIT_GRACE_S if in_time else 0.0)
            connection.close()
        if outcome is None:
            died = f"the export's process is gone: {describe_exit(code)}"
            raise ExportFailedError(died if in_time else f"an export took longer than {self._timeout_s:g} s")
        return outcome
