"""Limits on request bodies: their size, before anything reads them into memory, and the pauses in them."""

from __future__ import annotations

import asyncio
import re

from fastapi import Request
from starlette.exceptions import HTTPException
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from server.api.problems import problem

STREAMED = re.compile(r"/v1/routes/[^/]+/video")
"""Paths whose endpoints stream the body and have a limit of their own on its size."""


class BodyLimit:
    """Refuses bodies that are too long, declared or not, or stop coming, with a problem document.

    Args:
        limit: bytes.
        patience_s: for the next piece of a body, whatever its size.
    """

    def __init__(self, app: ASGIApp, limit: int, patience_s: float) -> None:
        self._app = app
        self._limit = limit
        self._patience_s = patience_s

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, counting what comes."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        streamed = STREAMED.fullmatch(scope["path"]) is not None
        request = Request(scope)
        declared = request.headers.get("content-length", "0")
        if not streamed and (not declared.isdigit() or int(declared) > self._limit):
            response = problem(request, 413, "body_too_large", self._detail)
            await response(scope, receive, send)
            return
        total = 0
        complete = False

        async def counted() -> Message:
            nonlocal total, complete
            if complete:
                # What comes after the body is the end of the connection: that may take its time.
                return await receive()
            try:
                message = await asyncio.wait_for(receive(), self._patience_s)
            except TimeoutError:
                raise HTTPException(
                    408, f"nothing of the body came for {self._patience_s:g} s: send it again"
                ) from None
            complete = not message.get("more_body", False)
            total += len(message.get("body", b""))
            if total > self._limit and not streamed:
                raise HTTPException(413, self._detail)
            return message

        await self._app(scope, counted, send)

    @property
    def _detail(self) -> str:
        return f"a document may have {self._limit} bytes"
