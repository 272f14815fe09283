"""The follower's phone: replays a walk's pictures over the navigation socket at their own pace."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Coroutine, Iterator
from dataclasses import dataclass, field
from typing import Any

from client_sim.errors import ServiceUnreachableError
from client_sim.navigation_socket import ConnectionLost, NavigationSocket
from client_sim.network import NetworkConditions, links
from client_sim.outcome import FollowOutcome, FrameRecord
from client_sim.walk import FRAME_RATE, VideoFrame, Walk, encode_jpeg
from server.protocol.frames import Frame
from server.protocol.messages import ErrorMessage, UpdateMessage

UpdateListener = Callable[[FrameRecord, UpdateMessage], None]

_READ_AHEAD = 20
"""Pictures decoded and compressed before they are due."""
_RECONNECT_ATTEMPTS = 8
_RECONNECT_PAUSE_S = 0.25
_SETTLE_S = 2.0
"""How long the last pictures' updates are waited for."""


@dataclass(frozen=True, slots=True)
class FollowerOptions:
    """How a walk is replayed.

    Attributes:
        speed: 1 is true speed.
        jpeg_quality: 1 to 100.
        rate: pictures a second of the video's clock.
        orientation: degrees clockwise by which pictures have to be turned to stand upright.
        seed: of the network's conditions.
    """

    speed: float = 1.0
    jpeg_quality: int = 85
    rate: float = FRAME_RATE
    orientation: int = 0
    network: NetworkConditions = field(default_factory=NetworkConditions)
    seed: int = 0


@dataclass(frozen=True, slots=True)
class _Picture:
    index: int
    time: float
    jpeg: bytes


class Follower:
    """One replay. Use :func:`follow`."""

    def __init__(
        self,
        url: str,
        route_id: str,
        walk: Walk,
        options: FollowerOptions,
        on_update: UpdateListener | None = None,
    ) -> None:
        self._walk = walk
        self._options = options
        self._on_update = on_update
        self._outcome = FollowOutcome(route_id)
        self._epoch = time.monotonic()
        self._up, self._down = links(options.network, options.seed)
        self._resolved = asyncio.Event()
        self._waiting: dict[int, FrameRecord] = {}
        self._deliveries: set[asyncio.Task[None]] = set()
        self._connected = asyncio.Event()
        self._socket = NavigationSocket(
            url, route_id, walk.camera, options.orientation, self._clock_us, self._on_message
        )

    async def run(self) -> FollowOutcome:
        """Replay the walk and return what came of it."""
        pictures: asyncio.Queue[_Picture | None] = asyncio.Queue(_READ_AHEAD)
        try:
            async with asyncio.TaskGroup() as tasks:
                tasks.create_task(self._read(pictures))
                connection = tasks.create_task(self._stay_connected())
                await self._connected.wait()
                await self._walk_on(pictures)
                await self._settle()
                await self._socket.end()
                connection.cancel()
        except ExceptionGroup as failures:
            raise failures.exceptions[0] from None
        finally:
            for delivery in self._deliveries:
                delivery.cancel()
            await asyncio.gather(*self._deliveries, return_exceptions=True)
        self._outcome.seconds = time.monotonic() - self._epoch
        return self._outcome

    def _clock_us(self) -> int:
        """The phone's clock: it runs with the replay, so that faster replays are consistent."""
        return int((time.monotonic() - self._epoch) * self._options.speed * 1e6)

    async def _read(self, pictures: asyncio.Queue[_Picture | None]) -> None:
        frames = self._walk.frames(self._options.rate)
        while (picture := await asyncio.to_thread(self._next, frames)) is not None:
            await pictures.put(picture)
        await pictures.put(None)

    def _next(self, frames: Iterator[VideoFrame]) -> _Picture | None:
        frame = next(frames, None)
        if frame is None:
            return None
        return _Picture(frame.index, frame.time, encode_jpeg(frame.image, self._options.jpeg_quality))

    async def _walk_on(self, pictures: asyncio.Queue[_Picture | None]) -> None:
        first: float | None = None
        start = time.monotonic()
        sequence = self._socket.next_sequence
        while (picture := await pictures.get()) is not None:
            first = picture.time if first is None else first
            due = start + (picture.time - first) / self._options.speed
            await asyncio.sleep(max(0.0, due - time.monotonic()))
            record = FrameRecord(sequence, picture.index, picture.time, due)
            self._outcome.records.append(record)
            capture_us = int((due - self._epoch) * self._options.speed * 1e6)
            self._hand_over(record, Frame(sequence, capture_us, picture.jpeg))
            sequence += 1

    def _hand_over(self, record: FrameRecord, frame: Frame) -> None:
        """The phone gives a picture to the network."""
        arrival = self._up.arrival(time.monotonic())
        if arrival is None:
            record.lost = "network"
            return
        self._waiting[record.sequence] = record
        self._deliver(self._send(record, frame, arrival))

    async def _send(self, record: FrameRecord, frame: Frame, arrival: float) -> None:
        await asyncio.sleep(max(0.0, arrival - time.monotonic()))
        try:
            await self._socket.send_frame(frame)
        except ConnectionLost:
            self._give_up(record, "unconnected")

    def _on_message(self, message: UpdateMessage | ErrorMessage) -> None:
        """A message has reached the phone's end of the socket; the simulated network is still to come."""
        arrival = self._down.arrival(time.monotonic())
        if arrival is not None:
            self._deliver(self._take(message, arrival))
        elif message.sequence is not None and message.sequence in self._waiting:
            self._give_up(self._waiting[message.sequence], "network_down")

    async def _take(self, message: UpdateMessage | ErrorMessage, arrival: float) -> None:
        await asyncio.sleep(max(0.0, arrival - time.monotonic()))
        record = None if message.sequence is None else self._waiting.get(message.sequence)
        if record is None:
            return
        if isinstance(message, ErrorMessage):
            self._give_up(record, message.code)
            return
        record.age_ms = (time.monotonic() - record.taken) * 1e3
        record.update = message
        self._resolve(record)
        if self._on_update is not None:
            self._on_update(record, message)

    def _give_up(self, record: FrameRecord, reason: str) -> None:
        record.lost = reason
        self._resolve(record)

    def _resolve(self, record: FrameRecord) -> None:
        self._waiting.pop(record.sequence, None)
        self._resolved.set()

    async def _settle(self) -> None:
        """Wait for the last picture: it replaces earlier ones, so what has not come by then will not come."""
        try:
            async with asyncio.timeout(_SETTLE_S + self._longest_way()):
                while self._outcome.records and self._outcome.records[-1].sequence in self._waiting:
                    self._resolved.clear()
                    await self._resolved.wait()
                if self._deliveries:
                    await asyncio.wait(self._deliveries)
        except TimeoutError:
            return

    def _longest_way(self) -> float:
        network = self._options.network
        return 2 * (network.delay_s + 4 * network.jitter_s + network.holdup_s)

    def _deliver(self, way: Coroutine[Any, Any, None]) -> None:
        task = asyncio.create_task(way)
        self._deliveries.add(task)
        task.add_done_callback(self._deliveries.discard)

    async def _stay_connected(self) -> None:
        """Connect, and connect again with the resume token whenever the connection is lost."""
        failures = 0
        while True:
            try:
                async with self._socket.connected():
                    failures = 0
                    self._connected.set()
                    await self._socket.serve()
                return
            except ServiceUnreachableError:
                failures += 1
                if failures > _RECONNECT_ATTEMPTS or not self._connected.is_set():
                    raise
                await asyncio.sleep(_RECONNECT_PAUSE_S * failures)
                self._outcome.reconnections += 1


async def follow(
    url: str,
    route_id: str,
    walk: Walk,
    options: FollowerOptions | None = None,
    on_update: UpdateListener | None = None,
) -> FollowOutcome:
    """Replay a walk on a route.

    Args:
        url: of the service, as ``http://127.0.0.1:8000``.
        on_update: called with every picture that is answered, when its update arrives.

    Raises:
        NavigationRefusedError: the service refused the connection for good.
        ServiceUnreachableError: nobody answers.
        WalkError: the video cannot be replayed.
    """
    return await Follower(url, route_id, walk, options or FollowerOptions(), on_update).run()
