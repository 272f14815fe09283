"""Endpoints of routes."""

from __future__ import annotations

from collections.abc import AsyncIterator
from typing import Annotated, Any
from uuid import UUID

from fastapi import APIRouter, Depends, Query, Response
from fastapi.responses import StreamingResponse

from server.api.auth import Caller
from server.api.components import Parts
from server.api.json_body import json_body
from server.api.openapi import may_answer
from server.api.presenters import route_document
from server.api.transactions import Unit
from server.protocol.documents import (
    CameraDescription,
    CreateRoute,
    PathDocument,
    Problem,
    RouteDocument,
    RouteList,
)
from server.protocol.problem_codes import ProblemCode
from server.services.exports import ExportName
from server.services.routes import Download

PROBLEMS: dict[int | str, dict[str, Any]] = {
    "default": {"model": Problem, "description": "A problem document (RFC 9457)"}
}

_OF_A_MAP = may_answer(ProblemCode.ROUTE_NOT_FOUND, ProblemCode.ROUTE_NOT_READY, ProblemCode.MAP_UNUSABLE)

router = APIRouter(prefix="/v1/routes", tags=["routes"], responses=PROBLEMS)


@router.post("", status_code=201, dependencies=[Depends(json_body)])
async def create_route(
    body: CreateRoute, caller: Caller, unit: Unit, parts: Parts, response: Response
) -> RouteDocument:
    """A new route, without video as yet."""
    route = await parts.routes.create(
        unit,
        caller.owner,
        name=body.name,
        start_label=body.start_label,
        destination_label=body.destination_label,
        measured_length_m=body.measured_length_m,
    )
    response.headers["Location"] = f"/v1/routes/{route.id}"
    return route_document(route)


@router.get("", responses=may_answer(ProblemCode.CURSOR_INVALID))
async def list_routes(
    caller: Caller,
    unit: Unit,
    parts: Parts,
    limit: Annotated[int, Query(ge=1, le=200, description="Routes on a page.")] = 50,
    cursor: Annotated[
        str | None, Query(max_length=100, description="`next` of the page before; the first page without.")
    ] = None,
) -> RouteList:
    """The caller's routes, newest first."""
    routes, following = await parts.routes.page(unit, caller.owner, limit, cursor)
    documents = tuple(route_document(route, parts.jobs.progress(route.id)) for route in routes)
    return RouteList(routes=documents, next=following)


@router.get("/{route_id}", responses=may_answer(ProblemCode.ROUTE_NOT_FOUND))
async def read_route(route_id: UUID, caller: Caller, unit: Unit, parts: Parts) -> RouteDocument:
    """A route: its state, and how far its build is or what came of it."""
    route = await parts.routes.get(unit, caller.owner, route_id)
    return route_document(route, parts.jobs.progress(route_id))


@router.delete("/{route_id}", status_code=204, responses=may_answer(ProblemCode.ROUTE_NOT_FOUND))
async def delete_route(route_id: UUID, caller: Caller, unit: Unit, parts: Parts) -> None:
    """Remove a route with its files; its build is stopped and its followers are told."""
    await parts.routes.delete(unit, caller.owner, route_id)


@router.put(
    "/{route_id}/camera",
    dependencies=[Depends(json_body)],
    responses=may_answer(ProblemCode.ROUTE_NOT_FOUND, ProblemCode.ROUTE_STATE, ProblemCode.CAMERA_INVALID),
)
async def put_camera(
    route_id: UUID, body: CameraDescription, caller: Caller, unit: Unit, parts: Parts
) -> RouteDocument:
    """The leader's camera, if it is known: before the video.

    After a failed build it starts another with the video that is there.
    """
    route = await parts.routes.set_camera(unit, caller.owner, route_id, body.model_dump())
    return route_document(route)


@router.get("/{route_id}/path", response_model=PathDocument, responses=_OF_A_MAP)
async def read_path(route_id: UUID, caller: Caller, unit: Unit, parts: Parts) -> StreamingResponse:
    """The walked path and its turns, for drawing."""
    route = await parts.routes.get(unit, caller.owner, route_id)
    return await _sent(await parts.routes.path_file(route), "application/json")


@router.get(
    "/{route_id}/map",
    response_class=StreamingResponse,
    responses={200: {"content": {"application/octet-stream": {}}}, **_OF_A_MAP},
)
async def read_map(route_id: UUID, caller: Caller, unit: Unit, parts: Parts) -> StreamingResponse:
    """The route map's file."""
    route = await parts.routes.get(unit, caller.owner, route_id)
    return await _sent(
        await parts.routes.map_file(route),
        "application/octet-stream",
        {"Content-Disposition": f'attachment; filename="{route_id}.pairnavi-map"'},
    )


_EXPORT_TYPES: dict[ExportName, str] = {
    "colmap.zip": "application/zip",
    "trajectory.tum": "text/plain",
    "map.ply": "application/octet-stream",
}


@router.get(
    "/{route_id}/export/{name}",
    response_class=StreamingResponse,
    responses={200: {"content": {kind: {} for kind in _EXPORT_TYPES.values()}}, **_OF_A_MAP},
)
async def export_map(route_id: UUID, name: ExportName, caller: Caller, parts: Parts) -> StreamingResponse:
    """The route map in a format of others. A COLMAP model, a TUM trajectory or a PLY file; lengths are in
    metres where the route's scale is known, else in map units, and the files say which.
    """
    # A transaction of its own: an export takes seconds, in which others want to write.
    async with parts.database.begin() as unit:
        route = await parts.routes.get(unit, caller.owner, route_id)
    return await _sent(
        await parts.exports.export(route, name),
        _EXPORT_TYPES[name],
        {"Content-Disposition": f'attachment; filename="{route_id}-{name}"'},
    )


async def _sent(
    download: Download, media_type: str, headers: dict[str, str] | None = None
) -> StreamingResponse:
    async def body() -> AsyncIterator[bytes]:
        async for chunk in download.chunks:
            yield chunk

    return StreamingResponse(
        body(),
        media_type=media_type,
        headers={"Content-Length": str(download.length), **(headers or {})},
    )
