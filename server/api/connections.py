"""What the server's library leaves open on a connection: how long a request's head may take, unread pongs."""

from __future__ import annotations

import asyncio
from typing import Any

from uvicorn import Config
from uvicorn._types import ASGISendEvent
from uvicorn.protocols.http.h11_impl import H11Protocol
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol


class ImpatientHttpProtocol(H11Protocol):
    """HTTP/1.1 that closes a connection on which no request comes.

    A request is awaited from the connection or the end of the last answer on, until its last header has
    come. A body that goes on after its answer is no request either.

    Attributes:
        head_timeout_s: seconds; set by a subclass, as the library makes the instances.
    """

    head_timeout_s: float = 15.0

    def __init__(self, config: Config, *arguments: Any, **options: Any) -> None:
        super().__init__(config, *arguments, **options)
        self._head_timer: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """See :class:`asyncio.Protocol`."""
        super().connection_made(transport)
        self._watch()

    def data_received(self, data: bytes) -> None:
        """See :class:`asyncio.Protocol`."""
        super().data_received(data)
        self._watch()

    def on_response_complete(self) -> None:
        """Called by the request's task."""
        super().on_response_complete()
        self._watch()

    def connection_lost(self, exc: Exception | None) -> None:
        """See :class:`asyncio.Protocol`."""
        self._stop_timer()
        super().connection_lost(exc)

    def _watch(self) -> None:
        handed_over = self.transport.get_protocol() is not self
        answering = self.cycle is not None and not self.cycle.response_complete
        if handed_over or answering:
            self._stop_timer()
        elif self._head_timer is None and not self.transport.is_closing():
            self._head_timer = self.loop.call_later(self.head_timeout_s, self.transport.close)

    def _stop_timer(self) -> None:
        if self._head_timer is not None:
            self._head_timer.cancel()
            self._head_timer = None


class FrugalWebSocketProtocol(WebSocketsSansIOProtocol):
    """A WebSocket for clients that do not read.

    Their pings are not answered until they have read earlier answers: one and all, the pongs would fill the
    memory, and RFC 6455, section 5.5.3, lets an endpoint answer the latest ping only. A close is written at
    once, however much is unread before it: it is a few bytes, the last ones, and tells them why.
    """

    async def send(self, message: ASGISendEvent) -> None:
        """Called by the app."""
        if message["type"] == "websocket.close":
            self.writable.set()
        await super().send(message)

    def handle_ping(self) -> None:
        """Called for every ping, whose pong the library has prepared."""
        pong = self.conn.data_to_send()
        if self.writable.is_set():
            self.transport.write(b"".join(pong))
