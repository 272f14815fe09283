"""Whether the service works."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, version

from fastapi import APIRouter, Response

from server.api.components import Parts
from server.protocol.documents import HealthDocument
from server.protocol.version import PROTOCOL_VERSION

router = APIRouter(prefix="/v1", tags=["service"])


def product_version() -> str:
    """Of the installed distribution; ``unknown`` when run without installing."""
    try:
        return version("pairnavi")
    except PackageNotFoundError:
        return "unknown"


@router.get(
    "/health", responses={503: {"model": HealthDocument, "description": "Degraded: something is missing"}}
)
async def health(parts: Parts, response: Response) -> HealthDocument:
    """For load balancers and people; 503 when something is missing. Open to everybody."""
    database = await parts.database.is_alive()
    ok = database and parts.pool.alive > 0
    response.status_code = 200 if ok else 503
    return HealthDocument(
        status="ok" if ok else "degraded",
        version=product_version(),
        protocol=PROTOCOL_VERSION,
        database=database,
        navigation_workers=parts.pool.alive,
        navigation_sessions=len(parts.navigation),
        builds=parts.jobs.running,
    )
