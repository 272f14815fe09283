"""The service's HTTP interface, as a phone uses it."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from types import TracebackType
from typing import Self

import httpx
from pydantic import ValidationError

from client_sim.errors import ServiceRefusedError, ServiceUnreachableError
from client_sim.navigation_socket import is_local
from server.protocol.documents import (
    CameraDescription,
    CreateRoute,
    PathDocument,
    Problem,
    RouteDocument,
    RouteList,
)
from server.protocol.problem_codes import ProblemCode
from server.protocol.quality import QualityDocument

_CHUNK = 1 << 18

ByteListener = Callable[[int, int], None]
"""Called with the bytes sent so far and their total."""


class ServiceClient:
    """Requests to one service; an async context manager.

    Every method raises :class:`ServiceRefusedError` for a problem document and
    :class:`ServiceUnreachableError` if there is no answer.

    Args:
        url: as ``http://127.0.0.1:8000``.
    """

    def __init__(self, url: str, timeout_s: float = 30.0) -> None:
        self.url = url.rstrip("/")
        self._http = httpx.AsyncClient(base_url=self.url, timeout=timeout_s, trust_env=not is_local(self.url))

    async def __aenter__(self) -> Self:
        """Nothing to do."""
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close the connections."""
        await self._http.aclose()

    async def create(self, route: CreateRoute) -> RouteDocument:
        """A new route."""
        response = await self._send("POST", "/v1/routes", json=route.model_dump())
        return RouteDocument.model_validate_json(response.content)

    async def route(self, route_id: str) -> RouteDocument:
        """A route as it stands."""
        return RouteDocument.model_validate_json((await self._send("GET", f"/v1/routes/{route_id}")).content)

    async def routes(self) -> RouteList:
        """The newest routes."""
        return RouteList.model_validate_json((await self._send("GET", "/v1/routes")).content)

    async def delete(self, route_id: str) -> None:
        """Remove a route."""
        await self._send("DELETE", f"/v1/routes/{route_id}")

    async def put_camera(self, route_id: str, camera: CameraDescription) -> RouteDocument:
        """The leader's camera."""
        response = await self._send("PUT", f"/v1/routes/{route_id}/camera", json=camera.model_dump())
        return RouteDocument.model_validate_json(response.content)

    async def put_video(
        self, route_id: str, video: Path, on_bytes: ByteListener | None = None
    ) -> RouteDocument:
        """The leader's video, streamed from its file."""
        total = (await asyncio.to_thread(video.stat)).st_size

        async def chunks() -> AsyncIterator[bytes]:
            sent = 0
            with await asyncio.to_thread(video.open, "rb") as file:
                while chunk := await asyncio.to_thread(file.read, _CHUNK):
                    yield chunk
                    sent += len(chunk)
                    if on_bytes is not None:
                        on_bytes(sent, total)

        response = await self._send(
            "PUT",
            f"/v1/routes/{route_id}/video",
            content=chunks(),
            headers={"Content-Length": str(total), "Content-Type": "video/mp4"},
        )
        return RouteDocument.model_validate_json(response.content)

    async def path(self, route_id: str) -> PathDocument:
        """The walked path of a finished route."""
        response = await self._send("GET", f"/v1/routes/{route_id}/path")
        return PathDocument.model_validate_json(response.content)

    async def quality(self, route_id: str) -> QualityDocument | None:
        """The quality report of the leader's walk, None if it has not been judged."""
        try:
            response = await self._send("GET", f"/v1/routes/{route_id}/quality")
        except ServiceRefusedError as error:
            if error.problem.code == ProblemCode.ROUTE_NOT_READY:
                return None
            raise
        return QualityDocument.model_validate_json(response.content)

    async def _send(
        self,
        method: str,
        path: str,
        *,
        json: object = None,
        content: AsyncIterator[bytes] | None = None,
        headers: dict[str, str] | None = None,
    ) -> httpx.Response:
        try:
            response = await self._http.request(method, path, json=json, content=content, headers=headers)
        except httpx.TransportError as error:
            raise ServiceUnreachableError(f"{self.url}: {error or type(error).__name__}") from error
        if response.is_success:
            return response
        try:
            problem = Problem.model_validate_json(response.content)
        except ValidationError:
            code = f"http_{response.status_code}"
            problem = Problem(
                type="about:blank",
                title=response.reason_phrase,
                status=response.status_code,
                detail=f"{method} {path} was answered with {response.status_code}",
                code=code,
            )
        raise ServiceRefusedError(problem)
