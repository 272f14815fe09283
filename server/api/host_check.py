"""Requests are taken under the service's own names only.

A page of another site may have its name resolved to this machine (DNS rebinding): to the browser the
service then is that site, and the page may do with it what it likes. Its requests still carry that name.
"""

from __future__ import annotations

import re
from collections.abc import Iterable

from starlette.requests import HTTPConnection
from starlette.types import ASGIApp, Receive, Scope, Send

from server.api.problems import problem

_HOST = re.compile(r"(\[[0-9a-f:.]+\]|[^\s:/?#@\[\]]+)(?::[0-9]{1,5})?")


class HostCheck:
    """Refuses requests and sockets whose ``Host`` is none of ``names``, whatever its port."""

    def __init__(self, app: ASGIApp, names: Iterable[str]) -> None:
        self._app = app
        self._names = frozenset(names)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on if it is for this service."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        connection = HTTPConnection(scope)
        given = connection.headers.getlist("host")
        match = _HOST.fullmatch(given[0].lower()) if len(given) == 1 else None
        if match is not None and match[1] in self._names:
            await self._app(scope, receive, send)
            return
        response = problem(
            connection,
            421,
            "host_not_allowed",
            "the service is not known by this name: see PAIRNAVI_ALLOWED_HOSTS",
        )
        await response(scope, receive, send)
