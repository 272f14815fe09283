"""The navigation pool: processes that own sessions, replaced when they die."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Coroutine, Mapping
from dataclasses import dataclass
from typing import Any

import structlog

from server.navigation.updates import Update
from server.services.errors import MapUnusableError, NavigationUnavailableError
from server.services.navigation import FrameLostError, FrameRefusedError
from server.workers.child import describe_exit
from server.workers.navigation_channel import ChannelClosed, NavigationChannel
from server.workers.navigation_messages import Answered, Opened, Refused, Reply

log = structlog.get_logger()

ENGINE = "server.workers.navigation_engine:MapEngine"

MAX_DEATHS = 3
"""A session whose pictures killed its process so often is not tried again."""
FORGIVEN_AFTER = 100
"""Answered pictures after which a session's earlier deaths no longer count."""
_NO_PROCESS_S = 30.0
"""For a process to be there again, when all have died."""
_SHORT_LIFE_S = 5.0
_LONGEST_PAUSE_S = 5.0


@dataclass(slots=True)
class _Slot:
    number: int
    channel: NavigationChannel | None = None
    started: float = 0.0
    short_lives: int = 0


@dataclass(slots=True)
class _Session:
    map_file: str
    camera: Mapping[str, Any] | None
    orientation: int
    snapshot: Any | None
    lock: asyncio.Lock
    channel: NavigationChannel | None = None
    deaths: int = 0
    answered: int = 0


class NavigationPool:
    """A :class:`server.services.navigation.Pool` of child processes.

    Args:
        processes: how many.
        maps: route maps kept open in each.
        max_pixels: of a picture.
        answer_timeout_s: a process that was asked and is silent for so long is killed and replaced.
        engine: import path, see :mod:`server.workers.navigation_worker`.
    """

    def __init__(
        self,
        processes: int,
        maps: int,
        max_pixels: int,
        answer_timeout_s: float = 30.0,
        engine: str = ENGINE,
    ) -> None:
        self._arguments = (engine, maps, max_pixels)
        self._answer_timeout_s = answer_timeout_s
        self._slots = [_Slot(number) for number in range(processes)]
        self._sessions: dict[str, _Session] = {}
        self._tasks: set[asyncio.Task[None]] = set()
        self._alive = asyncio.Condition()
        self._closing = False

    async def start(self) -> None:
        """Start the processes and wait until they are ready.

        Raises:
            ChannelClosed: one did not become ready; the log says why.
        """
        await asyncio.gather(*(self._start(slot) for slot in self._slots))

    async def close(self) -> None:
        """Kill the processes."""
        self._closing = True
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        channels = [slot.channel for slot in self._slots if slot.channel is not None]
        await asyncio.gather(*(channel.stop() for channel in channels))

    @property
    def alive(self) -> int:
        """Processes that live."""
        return sum(slot.channel is not None for slot in self._slots)

    @property
    def pids(self) -> list[int]:
        """Of the processes that live."""
        return [s.channel.pid for s in self._slots if s.channel is not None and s.channel.pid is not None]

    async def open(
        self,
        session: str,
        map_file: str,
        camera: Mapping[str, Any] | None,
        orientation: int,
        snapshot: Any | None = None,
    ) -> None:
        """See :meth:`server.services.navigation.Pool.open`."""
        entry = _Session(map_file, camera, orientation, snapshot, asyncio.Lock())
        self._sessions[session] = entry
        try:
            async with entry.lock:
                await self._place(session, entry)
        except BaseException:
            self.close_session(session)
            raise

    async def process(self, session: str, sequence: int, capture_time: float, picture: bytes) -> Update:
        """See :meth:`server.services.navigation.Pool.process`."""
        entry = self._sessions.get(session)
        if entry is None:
            raise NavigationUnavailableError("the session has ended")
        async with entry.lock:
            channel = await self._place(session, entry)
            try:
                reply = await self._in_time(
                    channel, channel.process(session, sequence, capture_time, picture)
                )
            except ChannelClosed as error:
                self._note_death(entry, error)
                raise FrameLostError("the session's process died; the session goes on") from None
            if isinstance(reply, Answered):
                entry.snapshot = reply.snapshot
                entry.answered += 1
                if entry.answered % FORGIVEN_AFTER == 0:
                    entry.deaths = 0
                return reply.update
        if isinstance(reply, Refused) and reply.kind == "picture":
            raise FrameRefusedError(reply.detail)
        if isinstance(reply, Refused) and reply.kind == "map":
            raise MapUnusableError(f"the route's map can no longer be read: {reply.detail}")
        raise FrameLostError("the picture could not be answered because of an internal error")

    def close_session(self, session: str) -> None:
        """See :meth:`server.services.navigation.Pool.close_session`."""
        entry = self._sessions.pop(session, None)
        if entry is not None and entry.channel is not None:
            entry.channel.forget(session)

    async def _place(self, session: str, entry: _Session) -> NavigationChannel:
        """The session's process; when it has none, one is found and the session opened there."""
        while entry.channel is None:
            if entry.deaths >= MAX_DEATHS:
                raise NavigationUnavailableError(
                    f"the session's process died {entry.deaths} times over its pictures"
                )
            channel = await self._least_loaded()
            try:
                reply = await self._in_time(
                    channel,
                    channel.open(session, entry.map_file, entry.camera, entry.orientation, entry.snapshot),
                )
            except ChannelClosed as error:
                self._note_death(entry, error)
                continue
            if isinstance(reply, Opened):
                entry.channel = channel
            elif isinstance(reply, Refused) and reply.kind == "map":
                raise MapUnusableError(f"the route's map cannot be read: {reply.detail}")
            else:
                raise NavigationUnavailableError("the session could not be opened: internal error")
        return entry.channel

    async def _in_time(self, channel: NavigationChannel, asking: Coroutine[Any, Any, Reply]) -> Reply:
        """The reply, waited for as long as the process answers anybody: its queue is everybody's."""
        asked = asyncio.ensure_future(asking)
        patience = self._answer_timeout_s
        try:
            while patience > 0:
                done, _ = await asyncio.wait({asked}, timeout=patience)
                if done:
                    return asked.result()
                patience = self._answer_timeout_s - channel.silent_s
            log.error("navigation.process_silent", seconds=self._answer_timeout_s, pid=channel.pid)
            channel.kill()
            # Ends with the process, and with the knowledge whose picture it was.
            return await asked
        finally:
            asked.cancel()

    def _note_death(self, entry: _Session, error: ChannelClosed) -> None:
        entry.channel = None
        if error.was_next:
            entry.deaths += 1

    async def _least_loaded(self) -> NavigationChannel:
        try:
            async with asyncio.timeout(_NO_PROCESS_S), self._alive:
                await self._alive.wait_for(lambda: self.alive > 0)
        except TimeoutError:
            raise NavigationUnavailableError("no process could be started for the session") from None
        load = {slot.channel: 0 for slot in self._slots if slot.channel is not None}
        for entry in self._sessions.values():
            if entry.channel in load:
                load[entry.channel] += 1
        return min(load, key=lambda channel: load[channel])

    async def _start(self, slot: _Slot) -> None:
        channel = await NavigationChannel.start(lambda ended: self._ended(slot, ended), *self._arguments)
        slot.started = time.monotonic()
        # Before anything is awaited: should it die now, the slot must know it.
        slot.channel = channel
        async with self._alive:
            self._alive.notify_all()
        log.info("navigation.process_started", slot=slot.number, pid=channel.pid)

    def _ended(self, slot: _Slot, channel: NavigationChannel) -> None:
        """On the event loop, when a process has died."""
        if slot.channel is channel:
            slot.channel = None
        orphans = [entry for entry in self._sessions.values() if entry.channel is channel]
        for entry in orphans:
            entry.channel = None
        if self._closing:
            return
        task = asyncio.create_task(self._replace(slot, channel, len(orphans)))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _replace(self, slot: _Slot, dead: NavigationChannel, sessions: int) -> None:
        code = await dead.stop()
        log.error(
            "navigation.process_died", slot=slot.number, how=describe_exit(code), sessions_moved=sessions
        )
        short = time.monotonic() - slot.started < _SHORT_LIFE_S
        slot.short_lives = slot.short_lives + 1 if short else 0
        while True:
            if slot.short_lives > 1:
                await asyncio.sleep(min(_LONGEST_PAUSE_S, 0.1 * 2.0 ** min(slot.short_lives, 10)))
            try:
                await self._start(slot)
            except ChannelClosed:
                slot.short_lives += 1
            else:
                return
