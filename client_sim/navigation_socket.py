"""The phone's end of the navigation socket: greets, keeps alive, resumes."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from typing import Literal, cast
from urllib.parse import urlsplit

from pydantic import ValidationError
from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import ConnectionClosed, InvalidHandshake

from client_sim.errors import NavigationRefusedError, ServiceUnreachableError
from server.protocol.close_codes import CloseCode
from server.protocol.documents import CameraDescription
from server.protocol.frames import Frame, encode_frame
from server.protocol.messages import (
    End,
    ErrorMessage,
    Goodbye,
    Hello,
    Ping,
    Pong,
    UpdateMessage,
    Welcome,
    parse_server_message,
)
from server.protocol.version import PROTOCOL_VERSION

_OPEN_TIMEOUT_S = 20.0
_CAPABILITIES = ("jpeg",)


class ConnectionLost(ServiceUnreachableError):  # noqa: N818 - what happened, as websockets has it
    """The connection is gone; a new one with the resume token may go on."""


class NavigationSocket:
    """A session that may outlive its connections.

    Args:
        url: of the service, ``http`` or ``https``.
        clock_us: the phone's clock, microseconds.
        on_message: called with every update, and every error that is about a picture.
    """

    def __init__(
        self,
        url: str,
        route_id: str,
        camera: CameraDescription | None,
        orientation: int,
        clock_us: Callable[[], int],
        on_message: Callable[[UpdateMessage | ErrorMessage], None],
    ) -> None:
        self._url = f"{url.rstrip('/').replace('http', 'ws', 1)}/v1/routes/{route_id}/navigate"
        self._camera = camera
        self._orientation = orientation
        self._clock_us = clock_us
        self._on_message = on_message
        self._socket: ClientConnection | None = None
        self._welcome: Welcome | None = None
        self._round_trip_us: int | None = None
        self._closing = asyncio.Event()
        self._last_error: ErrorMessage | None = None

    @asynccontextmanager
    async def connected(self) -> AsyncIterator[Welcome]:
        """A connection, greeted and welcomed; with an earlier welcome's token its session goes on.

        Raises:
            NavigationRefusedError: the service does not want this session.
            ConnectionLost: the connection ended in between.
            ServiceUnreachableError: nobody answers.
        """
        try:
            socket = await connect(
                self._url,
                open_timeout=_OPEN_TIMEOUT_S,
                compression=None,
                proxy=None if is_local(self._url) else True,
            )
        except (OSError, InvalidHandshake, TimeoutError) as error:
            raise ServiceUnreachableError(f"{self._url}: {error or type(error).__name__}") from error
        try:
            self._welcome = await self._greet(socket)
            self._socket = socket
            yield self._welcome
        finally:
            self._socket = None
            await socket.close()

    async def _greet(self, socket: ClientConnection) -> Welcome:
        hello = Hello(
            protocol=PROTOCOL_VERSION,
            camera=self._camera,
            orientation=cast(Literal[0, 90, 180, 270], self._orientation),
            clock_us=self._clock_us(),
            capabilities=_CAPABILITIES,
            resume_token=None if self._welcome is None else self._welcome.resume_token,
        )
        try:
            await socket.send(hello.model_dump_json())
            async with asyncio.timeout(_OPEN_TIMEOUT_S):
                message = parse_server_message(await socket.recv())
        except TimeoutError:
            raise ServiceUnreachableError(f"{self._url}: no welcome came") from None
        except ConnectionClosed:
            raise self._ending(socket) from None
        except ValidationError as error:
            raise NavigationRefusedError("not_understood", str(error), None) from None
        if isinstance(message, Welcome):
            return message
        if isinstance(message, ErrorMessage):
            self._last_error = message
        await socket.wait_closed()
        raise self._ending(socket)

    async def serve(self) -> None:
        """Receive until the session is ended by :meth:`end`.

        Raises:
            ConnectionLost: a new connection may resume the session.
            NavigationRefusedError: the service has ended the session.
        """
        socket = self._socket
        if socket is None or self._welcome is None:
            raise ConnectionLost("not connected")
        heartbeat = asyncio.create_task(self._beat(socket, self._welcome.heartbeat_interval_s))
        try:
            async for text in socket:
                self._receive(text)
        except ConnectionClosed:
            raise self._ending(socket) from None
        finally:
            heartbeat.cancel()
            await asyncio.gather(heartbeat, return_exceptions=True)
        if not self._closing.is_set():
            raise self._ending(socket)

    def _receive(self, text: str | bytes) -> None:
        message = parse_server_message(text)
        if isinstance(message, UpdateMessage):
            self._on_message(message)
        elif isinstance(message, ErrorMessage):
            self._last_error = message if message.fatal else None
            if message.sequence is not None:
                self._on_message(message)
        elif isinstance(message, Pong):
            self._round_trip_us = max(0, self._clock_us() - message.clock_us)
        elif isinstance(message, Goodbye):
            self._last_error = ErrorMessage(code=message.reason, detail="", fatal=True)

    async def _beat(self, socket: ClientConnection, interval_s: float) -> None:
        number = 0
        while True:
            ping = Ping(id=number, clock_us=self._clock_us(), round_trip_us=self._round_trip_us)
            try:
                await socket.send(ping.model_dump_json())
            except ConnectionClosed:
                return
            number += 1
            # The first few quickly: until one has come back, the service cannot tell clocks from ways.
            await asyncio.sleep(min(interval_s, 0.2) if number < 4 else interval_s)

    def _ending(self, socket: ClientConnection) -> Exception:
        """What a closed socket means."""
        code = socket.close_code
        error = self._last_error
        try:
            known = None if code is None else CloseCode(code)
        except ValueError:
            known = None
        if known is None or known.may_resume:
            return ConnectionLost(f"the connection was lost ({code})")
        if error is not None:
            return NavigationRefusedError(error.code, error.detail, code)
        return NavigationRefusedError(known.name.lower(), "", code)

    @property
    def next_sequence(self) -> int:
        """The first sequence number the session still takes."""
        last = None if self._welcome is None else self._welcome.last_sequence
        return 0 if last is None else last + 1

    async def send_frame(self, frame: Frame) -> None:
        """Send a picture.

        Raises:
            ConnectionLost: there is no connection now.
        """
        if self._socket is None:
            raise ConnectionLost("not connected")
        try:
            await self._socket.send(encode_frame(frame))
        except ConnectionClosed:
            raise ConnectionLost("the connection was lost") from None

    async def end(self) -> None:
        """Tell the service that the walk is over and wait for its goodbye; nothing without a connection."""
        self._closing.set()
        socket = self._socket
        if socket is None:
            return
        try:
            await socket.send(End().model_dump_json())
            async with asyncio.timeout(2.0):
                await socket.wait_closed()
        except (ConnectionClosed, TimeoutError):
            return


def is_local(url: str) -> bool:
    """Whether a URL is of this machine: then no proxy is asked."""
    return urlsplit(url).hostname in ("localhost", "127.0.0.1", "::1")
