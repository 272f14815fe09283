"""Starting child processes: threads and memory limited, priority set, no signals of the terminal.

Nothing heavy is imported here: thread pools read the environment when their library is loaded.
"""

from __future__ import annotations

import multiprocessing
import os
import resource
import signal
import threading
from dataclasses import dataclass
from importlib import import_module
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from typing import Any

from server.workers.logs import configure_logs, logs_are_json

_THREAD_VARIABLES = (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "NUMEXPR_NUM_THREADS",
    "VECLIB_MAXIMUM_THREADS",
    "OPENCV_FOR_THREADS_NUM",
)


def load(path: str) -> Any:
    """The object at ``package.module:name``."""
    module, _, name = path.partition(":")
    return getattr(import_module(module), name)


@dataclass(frozen=True, slots=True)
class ChildOptions:
    """How a child shares the machine.

    Attributes:
        threads: of every library's pool; 0 leaves them to the library, which takes all cores.
        niceness: by how much its priority is lowered, 0 to 19.
        memory_bytes: that it may take for its data; 0 sets no limit. Held to by Linux only.
    """

    threads: int = 1
    niceness: int = 0
    memory_bytes: int = 0


def start_child(
    name: str, options: ChildOptions, entry: str, *arguments: str | int | float
) -> tuple[BaseProcess, Connection]:
    """Start a process that calls ``entry(connection, *arguments)``; returns it and the other end.

    Args:
        entry: ``package.module:function``, imported in the child only.
        arguments: plain values, so that the child imports nothing to receive them.
    """
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe(duplex=True)
    process = context.Process(
        target=_run, args=(options, entry, theirs, logs_are_json(), *arguments), name=name, daemon=True
    )
    try:
        process.start()
    except BaseException:
        ours.close()
        raise
    finally:
        theirs.close()
    return process, ours


def _run(
    options: ChildOptions, entry: str, connection: Connection, log_json: bool, *arguments: str | int | float
) -> None:
    # The terminal sends its interrupt to the whole group; the parent decides when children end.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    _end_with_parent()
    if options.niceness:
        os.nice(options.niceness)
    if options.memory_bytes:
        _limit_memory(options.memory_bytes)
    if options.threads:
        for variable in _THREAD_VARIABLES:
            os.environ[variable] = str(options.threads)
    configure_logs(as_json=log_json)
    load(entry)(connection, *arguments)


def _end_with_parent() -> None:
    """A parent that is killed stops nothing; a child that works on would do so beside its successor."""
    parent = multiprocessing.parent_process()

    def watch() -> None:
        if parent is not None:
            parent.join()
            os._exit(1)

    threading.Thread(target=watch, name="parent-watch", daemon=True).start()


def _limit_memory(allowed: int) -> None:
    # RLIMIT_AS would count the address space that thread stacks, allocators and mapped files reserve but
    # do not use: several times what is taken.
    _, hard = resource.getrlimit(resource.RLIMIT_DATA)
    soft = allowed if hard == resource.RLIM_INFINITY else min(allowed, hard)
    resource.setrlimit(resource.RLIMIT_DATA, (soft, hard))


def stop_child(process: BaseProcess, grace_s: float) -> int | None:
    """Kill a child that has not ended by itself within ``grace_s``; returns its exit code. Blocks."""
    process.join(timeout=grace_s)
    if process.is_alive():
        process.kill()
    process.join(timeout=10)
    code = process.exitcode
    if code is not None:
        process.close()
    return code


def describe_exit(code: int | None) -> str:
    """An exit code in words."""
    if code is None:
        return "it did not end"
    if code < 0:
        try:
            return f"it was killed by {signal.Signals(-code).name}"
        except ValueError:
            return f"it was killed by signal {-code}"
    return f"it ended with code {code}"
