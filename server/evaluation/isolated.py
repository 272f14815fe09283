"""Work in a fresh process: its own environment, its own memory to measure, progress as it goes."""

from __future__ import annotations

import multiprocessing
import os
import resource
import sys
import traceback
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, Literal, TypeVar

T = TypeVar("T")

_POOL_VARIABLES = (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "BLIS_NUM_THREADS",
    "VECLIB_MAXIMUM_THREADS",
    "NUMEXPR_NUM_THREADS",
    "OPENCV_FOR_THREADS_NUM",
)

ONE_THREAD: Mapping[str, str] = dict.fromkeys(_POOL_VARIABLES, "1")
"""Environment in which numeric libraries start with pools of one thread; read when they are loaded."""


class IsolatedError(RuntimeError):
    """The process failed; the message ends with its traceback."""


@contextmanager
def _environment(changes: Mapping[str, str]) -> Iterator[None]:
    before = {name: os.environ.get(name) for name in changes}
    os.environ.update(changes)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


def _child(connection: Connection, function: Callable[..., Any], arguments: tuple[Any, ...]) -> None:
    message: tuple[Literal["done", "error"], Any]
    try:
        message = ("done", function(*arguments, lambda value: connection.send(("progress", value))))
    except Exception:
        message = ("error", traceback.format_exc())
    connection.send(message)
    connection.close()


def run_isolated(
    function: Callable[..., T],
    *arguments: Any,
    environment: Mapping[str, str] | None = None,
    on_progress: Callable[[Any], None] | None = None,
) -> T:
    """Call ``function(*arguments, report)`` in a spawned process and return what it returns.

    Args:
        function: a module-level function; its last argument is a callable that sends one
            picklable value to ``on_progress`` here.
        environment: variables set before the process loads anything.

    Raises:
        IsolatedError: the function raised, or the process died.
    """
    context = multiprocessing.get_context("spawn")
    here, there = context.Pipe(duplex=False)
    process = context.Process(target=_child, args=(there, function, arguments), daemon=False)
    with _environment(environment or {}):
        process.start()
    there.close()
    try:
        while True:
            kind, value = here.recv()
            if kind == "progress":
                if on_progress is not None:
                    on_progress(value)
            elif kind == "error":
                raise IsolatedError(f"{function.__name__} failed\n{value}")
            else:
                result: T = value
                return result
    except EOFError:
        process.join()
        raise IsolatedError(f"{function.__name__}: its process ended with code {process.exitcode}") from None
    except BaseException:
        process.terminate()
        raise
    finally:
        here.close()
        process.join()


def peak_rss_bytes() -> int:
    """Peak resident memory of this process.

    Linux carries the parent's peak into ``getrusage`` of a child, so its own book is read first.
    """
    status = Path("/proc/self/status")
    if status.exists():
        for line in status.read_text(encoding="ascii", errors="replace").splitlines():
            if line.startswith("VmHWM:"):
                return int(line.split()[1]) * 1024
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else peak * 1024
