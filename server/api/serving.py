"""Running the service on a socket."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Callable

import uvicorn
from fastapi import FastAPI

from server.api.app import create_app
from server.api.components import Components, Entries
from server.api.connections import FrugalWebSocketProtocol, ImpatientHttpProtocol
from server.settings import Settings

_DRAIN_S = 0.2
"""How long connections have to say goodbye before the server closes them."""
_UNREAD_TIMEOUT_MS = 20_000
"""A peer that acknowledges nothing for so long is gone, whatever is still to be sent to it."""

_SEND_BUFFER_BYTES = 128 << 10
"""Of a connection, in the kernel: updates that wait in megabytes of it would be old when they arrive."""


class NavigationServer(uvicorn.Server):
    """A server that tells its navigation sessions before it goes.

    Args:
        app: what the configuration serves.
        on_listening: called with the URL once requests are answered.
    """

    def __init__(
        self, app: FastAPI, config: uvicorn.Config, on_listening: Callable[[str], None] | None = None
    ) -> None:
        super().__init__(config)
        self._app = app
        self._on_listening = on_listening

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Start, then say where."""
        await super().startup(sockets)
        if self.started and self._on_listening is not None and sockets:
            host, port = sockets[0].getsockname()[:2]
            self._on_listening(f"http://{f'[{host}]' if ':' in host else host}:{port}")

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """Let sessions close with their own code, then stop."""
        parts: Components = self._app.state.components
        if len(parts.navigation):
            parts.navigation.go_away()
            await asyncio.sleep(_DRAIN_S)
        await super().shutdown(sockets)


def listen(host: str, port: int) -> socket.socket:
    """A listening socket; port 0 takes a free one.

    Raises:
        OSError: the address cannot be had.
    """
    family, _, _, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
    listener = socket.socket(family, socket.SOCK_STREAM)
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SEND_BUFFER_BYTES)
        if hasattr(socket, "TCP_USER_TIMEOUT"):
            listener.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, _UNREAD_TIMEOUT_MS)
        listener.bind(address)
        listener.listen(2048)
        listener.setblocking(False)
    except BaseException:
        listener.close()
        raise
    return listener


def build_server(
    settings: Settings,
    entries: Entries | None = None,
    on_listening: Callable[[str], None] | None = None,
) -> NavigationServer:
    """A server of the service; run it with ``server.serve(sockets=[listen(host, port)])``."""
    app = create_app(settings, entries)
    http = type(
        ImpatientHttpProtocol.__name__, (ImpatientHttpProtocol,), {"head_timeout_s": settings.head_timeout_s}
    )
    config = uvicorn.Config(
        app,
        http=http,
        ws=FrugalWebSocketProtocol,
        log_config=None,
        access_log=False,
        # Larger messages never reach the app: the library closes with 1009.
        ws_max_size=2 * max(settings.max_frame_bytes, settings.max_message_bytes) + 1024,
        # JPEG does not compress, and a compressed message could unpack to anything.
        ws_per_message_deflate=False,
        timeout_graceful_shutdown=5,
        server_header=False,
    )
    return NavigationServer(app, config, on_listening)


def serve(settings: Settings, on_listening: Callable[[str], None] | None = None) -> bool:
    """Serve until interrupted; False if the service could not start.

    Raises:
        OSError: the address cannot be had.
    """
    listener = listen(settings.host, settings.port)
    try:
        server = build_server(settings, on_listening=on_listening)
        server.run(sockets=[listener])
        return server.started
    finally:
        listener.close()
