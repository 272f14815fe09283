"""Who is asking. The only place that knows how; every endpoint depends on :func:`principal`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated
from urllib.parse import urlsplit

from fastapi import Depends
from starlette.requests import HTTPConnection

LOCAL_OWNER = "local"


@dataclass(frozen=True, slots=True)
class Principal:
    """An authenticated caller.

    Attributes:
        owner: whose routes it may see and change.
    """

    owner: str


def principal(connection: HTTPConnection) -> Principal:
    """The caller of a request or socket.

    There is one owner as yet: whoever reaches the service, which listens on loopback unless told otherwise.
    """
    return Principal(LOCAL_OWNER)


Caller = Annotated[Principal, Depends(principal)]


def is_same_origin(connection: HTTPConnection) -> bool:
    """False for a browser's page of another site.

    Browsers let any page open a WebSocket to any host, the local one included, but say where it came
    from; programs that are no browser send no origin. That the host is this service's own name has been
    seen to by :class:`server.api.host_check.HostCheck`.
    """
    origin = connection.headers.get("origin")
    if origin is None:
        return True
    return urlsplit(origin).netloc.lower() == connection.headers.get("host", "").lower()
