"""A navigation process as the event loop sees it: requests out, replies in, and its end."""

from __future__ import annotations

import asyncio
import queue
import threading
from collections.abc import Callable
from itertools import count
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from typing import Any

import structlog

from server.workers.child import ChildOptions, describe_exit, start_child, stop_child
from server.workers.navigation_messages import (
    CloseSession,
    OpenSession,
    ProcessPicture,
    Ready,
    Reply,
    Request,
)

log = structlog.get_logger()

_request_ids = count(1)

_START_TIMEOUT_S = 60.0


class ChannelClosed(Exception):  # noqa: N818 - an event, as MailboxClosed
    """The process has died or was stopped; whatever it was asked is not answered.

    Attributes:
        was_next: this request was the one the process was at, or about to begin.
    """

    def __init__(self, was_next: bool = False) -> None:
        super().__init__()
        self.was_next = was_next


class NavigationChannel:
    """One navigation process. All methods are called on the event loop and never block it.

    Args:
        on_end: called on the event loop, once, when the process is gone unasked.
        arguments: of :func:`server.workers.navigation_worker.main`.
    """

    def __init__(
        self,
        process: BaseProcess,
        connection: Connection,
        on_end: Callable[[NavigationChannel], None],
        loop: asyncio.AbstractEventLoop,
    ) -> None:
        self._process = process
        self._connection = connection
        self._on_end = on_end
        self._loop = loop
        self._outbox: queue.SimpleQueue[Request | None] = queue.SimpleQueue()
        self._pending: dict[int, asyncio.Future[Reply]] = {}
        self._ready: asyncio.Future[None] = loop.create_future()
        self._ended = False
        self._handed_over = False
        self._heard = loop.time()
        # A pipe's write blocks when the process is busy, its read always does: a thread for each.
        self._writer = threading.Thread(target=self._write, name="navigation-writer", daemon=True)
        self._reader = threading.Thread(target=self._read, name="navigation-reader", daemon=True)
        self._writer.start()
        self._reader.start()

    @classmethod
    async def start(
        cls, on_end: Callable[[NavigationChannel], None], *arguments: str | int | float
    ) -> NavigationChannel:
        """Start a process and wait until it is ready.

        Raises:
            ChannelClosed: it ended before it was; ``on_end`` is not called.
        """
        process, connection = await asyncio.to_thread(
            start_child,
            "pairnavi-navigation",
            ChildOptions(threads=1),
            "server.workers.navigation_worker:main",
            *arguments,
        )
        channel = cls(process, connection, on_end, asyncio.get_running_loop())
        try:
            await asyncio.wait_for(channel._ready, _START_TIMEOUT_S)
            if channel._ended:
                raise ChannelClosed
        except BaseException as error:
            code = await asyncio.shield(channel.stop())
            if isinstance(error, TimeoutError | ChannelClosed):
                log.error("navigation.process_not_ready", how=describe_exit(code))
                raise ChannelClosed from None
            raise
        channel._handed_over = True
        return channel

    @property
    def pid(self) -> int | None:
        """Process id."""
        return self._process.pid if not self._ended else None

    @property
    def silent_s(self) -> float:
        """Seconds since the process last answered anything."""
        return self._loop.time() - self._heard

    async def open(
        self, session: str, map_file: str, camera: Any, orientation: int, snapshot: Any | None
    ) -> Reply:
        """See :class:`OpenSession`.

        Raises:
            ChannelClosed: the process ended before it answered.
        """
        request = OpenSession(next(_request_ids), session, map_file, camera, orientation, snapshot)
        return await self._ask(request, request.request)

    async def process(self, session: str, sequence: int, capture_time: float, picture: bytes) -> Reply:
        """See :class:`ProcessPicture`.

        Raises:
            ChannelClosed: the process ended before it answered.
        """
        request = ProcessPicture(next(_request_ids), session, sequence, capture_time, picture)
        return await self._ask(request, request.request)

    def kill(self) -> None:
        """End a process that no longer answers; ``on_end`` follows."""
        if not self._ended:
            self._process.kill()

    def forget(self, session: str) -> None:
        """See :class:`CloseSession`."""
        if not self._ended:
            self._outbox.put(CloseSession(session))

    async def _ask(self, request: Request, number: int) -> Reply:
        if self._ended:
            raise ChannelClosed
        future: asyncio.Future[Reply] = self._loop.create_future()
        self._pending[number] = future
        self._outbox.put(request)
        try:
            return await future
        finally:
            self._pending.pop(number, None)

    def _write(self) -> None:
        while (request := self._outbox.get()) is not None:
            try:
                self._connection.send(request)
            except OSError:
                return

    def _read(self) -> None:
        try:
            while True:
                message: Reply | Ready = self._connection.recv()
                self._loop.call_soon_threadsafe(self._resolve, message)
        except (EOFError, OSError):
            pass
        except Exception:
            log.exception("navigation.reply_not_understood")
        try:
            self._loop.call_soon_threadsafe(self._end)
        except RuntimeError:
            return  # The loop is closed: nobody waits any more.

    def _resolve(self, reply: Reply | Ready) -> None:
        self._heard = self._loop.time()
        if isinstance(reply, Ready):
            if not self._ready.done():
                self._ready.set_result(None)
            return
        future = self._pending.get(reply.request)
        if future is not None and not future.done():
            future.set_result(reply)

    def _end(self) -> None:
        if self._ended:
            return
        self._fail_pending()
        if self._handed_over:
            self._on_end(self)

    def _fail_pending(self) -> None:
        self._ended = True
        self._outbox.put(None)
        if not self._ready.done():
            self._ready.set_exception(ChannelClosed())
        # Requests are answered in their order: the oldest one is what the process was busy with.
        for position, future in enumerate(self._pending.values()):
            if not future.done():
                future.set_exception(ChannelClosed(was_next=position == 0))

    async def stop(self) -> int | None:
        """Kill the process if it lives, and clean up after it; returns its exit code."""
        grace_s = 1.0 if self._ended else 0.0
        if not self._ended:
            self._fail_pending()
        return await asyncio.to_thread(self._clean_up, grace_s)

    def _clean_up(self, grace_s: float) -> int | None:
        code = stop_child(self._process, grace_s)
        self._writer.join(timeout=10)
        self._reader.join(timeout=10)
        self._connection.close()
        return code
