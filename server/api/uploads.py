"""Upload of a route's video: streamed, never whole in memory."""

from __future__ import annotations

from collections.abc import AsyncIterator
from uuid import UUID

from fastapi import APIRouter, Request
from starlette.requests import ClientDisconnect

from server.api.auth import Caller
from server.api.components import Parts
from server.api.openapi import may_answer
from server.api.presenters import route_document
from server.api.routes import PROBLEMS
from server.protocol.documents import RouteDocument
from server.protocol.problem_codes import ProblemCode
from server.services.errors import UploadIncompleteError

router = APIRouter(prefix="/v1/routes", tags=["routes"], responses=PROBLEMS)


@router.put(
    "/{route_id}/video",
    responses=may_answer(
        ProblemCode.ROUTE_NOT_FOUND,
        ProblemCode.ROUTE_STATE,
        ProblemCode.UPLOAD_TOO_LARGE,
        ProblemCode.UPLOAD_INCOMPLETE,
        ProblemCode.REQUEST_TIMEOUT,
        ProblemCode.STORAGE_FULL,
    ),
    openapi_extra={
        "requestBody": {
            "required": True,
            "content": {"video/*": {"schema": {"type": "string", "format": "binary"}}},
        }
    },
)
async def put_video(route_id: UUID, request: Request, caller: Caller, parts: Parts) -> RouteDocument:
    """The leader's video, as the request's body.

    The map is built from it with the camera that was sent before; without one the walk tells it.
    """
    declared = request.headers.get("content-length", "")
    length = int(declared) if declared.isdigit() else None
    route = await parts.routes.receive_video(caller.owner, route_id, _chunks(request), length)
    return route_document(route)


async def _chunks(request: Request) -> AsyncIterator[bytes]:
    try:
        async for chunk in request.stream():
            yield chunk
    except ClientDisconnect:
        raise UploadIncompleteError("the connection ended before the video did") from None
