"""Endpoints of a walk's quality report."""

from __future__ import annotations

from typing import Annotated
from uuid import UUID

from fastapi import APIRouter, HTTPException, Path
from fastapi.responses import StreamingResponse

from server.api.auth import Caller
from server.api.components import Components, Parts
from server.api.openapi import may_answer
from server.api.routes import PROBLEMS
from server.api.transactions import Unit
from server.protocol.problem_codes import ProblemCode
from server.protocol.quality import QualityDocument, WeakStretch
from server.services.quality import quality_file, quality_of
from server.storage.database import UnitOfWork
from server.storage.records import RouteRecord

router = APIRouter(prefix="/v1/routes", tags=["routes"], responses=PROBLEMS)

_OF_A_REPORT = may_answer(ProblemCode.ROUTE_NOT_FOUND, ProblemCode.ROUTE_NOT_READY)
_OF_A_PICTURE = may_answer(
    ProblemCode.ROUTE_NOT_FOUND, ProblemCode.ROUTE_NOT_READY, ProblemCode.NOT_FOUND, ProblemCode.MAP_UNUSABLE
)

_PICTURE = "report.png"


@router.get("/{route_id}/quality", responses=_OF_A_REPORT)
async def read_quality(route_id: UUID, caller: Caller, unit: Unit, parts: Parts) -> QualityDocument:
    """What is weak in the leader's video, where and why, and whether to record it again."""
    return _document(await parts.routes.get(unit, caller.owner, route_id))


@router.get("/{route_id}/quality.png", response_class=StreamingResponse, responses=_OF_A_PICTURE)
async def read_quality_picture(route_id: UUID, caller: Caller, unit: Unit, parts: Parts) -> StreamingResponse:
    """The quality report as a picture for a page."""
    return await _picture(parts, unit, caller.owner, route_id, _PICTURE, "image/png")


@router.get("/{route_id}/quality/{number}.jpg", response_class=StreamingResponse, responses=_OF_A_PICTURE)
async def read_stretch_picture(
    route_id: UUID,
    number: Annotated[int, Path(ge=1, le=10_000)],
    caller: Caller,
    unit: Unit,
    parts: Parts,
) -> StreamingResponse:
    """A picture in a weak stretch; they are numbered from 1 in the report's order."""
    return await _picture(parts, unit, caller.owner, route_id, f"stretch-{number}.jpg", "image/jpeg")


def _document(route: RouteRecord) -> QualityDocument:
    """The stored report with its pictures' paths in place of their files' names."""
    stored = quality_of(route)
    address = f"/v1/routes/{route.id}/quality"
    stretches = [
        WeakStretch.model_validate(
            {**stretch, "thumbnail": None if stretch["thumbnail"] is None else f"{address}/{number}.jpg"}
        )
        for number, stretch in enumerate(stored["stretches"], 1)
    ]
    picture = None if stored["picture"] is None else f"{address}.png"
    return QualityDocument.model_validate({**stored, "stretches": stretches, "picture": picture})


async def _picture(
    parts: Components, unit: UnitOfWork, owner: str, route_id: UUID, name: str, media_type: str
) -> StreamingResponse:
    download = await quality_file(parts.store, await parts.routes.get(unit, owner, route_id), name)
    if download is None:
        raise HTTPException(404, "no such picture was kept")
    headers = {"Content-Length": str(download.length)}
    return StreamingResponse(download.chunks, media_type=media_type, headers=headers)
