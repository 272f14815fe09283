"""A real service for tests: the app on a free loopback port, its child processes started."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import httpx
from websockets.asyncio.client import ClientConnection, connect

from server.api.components import Components, Entries
from server.api.serving import NavigationServer, build_server, listen
from server.protocol.frames import Frame, encode_frame
from server.protocol.messages import ErrorMessage, Goodbye, Pong, UpdateMessage, Welcome, parse_server_message
from server.settings import Settings

STUBS = Entries(builder="stub_core:build", engine="stub_core:StubEngine")

CAMERA = {"model": "PINHOLE", "width": 640, "height": 480, "params": [500.0, 500.0, 320.0, 240.0]}

HELLO: dict[str, Any] = {"type": "hello", "protocol": 1, "camera": CAMERA, "clock_us": 0}

NEW_ROUTE = {"name": "To the lab", "start_label": "Door", "destination_label": "Lab"}


def settings(data: Path, **changes: Any) -> Settings:
    """Settings with quick time limits."""
    values: dict[str, Any] = {"data_dir": data, "port": 0, "max_video_bytes": 100_000, "send_timeout_s": 0.5}
    return Settings(**{**values, **changes})


class Service:
    """A running service and a client for it."""

    def __init__(
        self, url: str, server: NavigationServer, parts: Components, http: httpx.AsyncClient
    ) -> None:
        self.url = url
        self.server = server
        self.parts = parts
        self.http = http

    async def upload(self, video: bytes, **fields: Any) -> str:
        """Create a route and upload its camera and video; returns its id."""
        response = await self.http.post("/v1/routes", json={**NEW_ROUTE, **fields})
        route_id: str = response.raise_for_status().json()["id"]
        (await self.http.put(f"/v1/routes/{route_id}/camera", json=CAMERA)).raise_for_status()
        (await self.http.put(f"/v1/routes/{route_id}/video", content=video)).raise_for_status()
        return route_id

    async def wait(self, route_id: str, *states: str) -> dict[str, Any]:
        """Poll until the route is in one of the states."""
        async with asyncio.timeout(20):
            while True:
                document: dict[str, Any] = (await self.http.get(f"/v1/routes/{route_id}")).json()
                if document["state"] in states:
                    return document
                await asyncio.sleep(0.02)

    async def ready_route(self, **fields: Any) -> str:
        """A route that has its map."""
        route_id = await self.upload(b"good", **fields)
        await self.wait(route_id, "ready")
        return route_id

    def connect(self, route_id: str, **options: Any) -> connect:
        """A bare socket."""
        url = self.url.replace("http", "ws", 1)
        return connect(f"{url}/v1/routes/{route_id}/navigate", proxy=None, **options)


async def hello(socket: ClientConnection, **changes: Any) -> Welcome:
    """Greet and be welcomed."""
    import json

    await socket.send(json.dumps({**HELLO, **changes}))
    message = await receive(socket)
    assert isinstance(message, Welcome), message
    return message


async def receive(socket: ClientConnection) -> Welcome | UpdateMessage | ErrorMessage | Pong | Goodbye:
    """The next message."""
    async with asyncio.timeout(10):
        return parse_server_message(await socket.recv())


async def send_picture(socket: ClientConnection, sequence: int, command: bytes = b"") -> None:
    """Send a picture that tells the stub engine what to do."""
    await socket.send(encode_frame(Frame(sequence, sequence * 100_000, b"\xff\xd8" + command)))


async def closed_with(socket: ClientConnection) -> int:
    """The close code, once the service has closed."""
    async with asyncio.timeout(10):
        await socket.wait_closed()
    assert socket.close_code is not None
    return socket.close_code


@asynccontextmanager
async def running(chosen: Settings, entries: Entries = STUBS) -> AsyncIterator[Service]:
    """Start a service, stop it afterwards."""
    listener = listen(chosen.host, chosen.port)
    up: asyncio.Future[str] = asyncio.get_running_loop().create_future()
    server = build_server(chosen, entries, up.set_result)
    task = asyncio.create_task(server.serve(sockets=[listener]))
    try:
        async with asyncio.timeout(30):
            done, _ = await asyncio.wait({up, task}, return_when=asyncio.FIRST_COMPLETED)
            if task in done:
                raise RuntimeError("the service did not start")
        async with httpx.AsyncClient(base_url=up.result(), timeout=10, trust_env=False) as http:
            parts = server.config.app.state.components  # type: ignore[union-attr]
            yield Service(up.result(), server, parts, http)
    finally:
        server.should_exit = True
        await task
        listener.close()
