"""Bodies that have to be JSON."""

from __future__ import annotations

from email.message import Message

from fastapi import Request
from starlette.exceptions import HTTPException


def json_body(request: Request) -> None:
    """A dependency of endpoints that read JSON.

    Raises:
        HTTPException: 415, another content type or none. Browsers send some types to other sites unasked;
            JSON is none of them.
    """
    given = request.headers.get("content-type")
    message = Message()
    message["content-type"] = given or ""
    kind = message.get_content_type()
    if given is None or not (
        kind == "application/json" or (kind.startswith("application/") and kind.endswith("+json"))
    ):
        raise HTTPException(415, f"send application/json, not {kind if given else 'a body of no type'}")
