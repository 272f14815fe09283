"""The app factory."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

from fastapi import FastAPI

from server.api import health, navigate, openapi, problems, quality, routes, uploads
from server.api.body_limit import BodyLimit
from server.api.components import Entries, assemble
from server.api.host_check import HostCheck
from server.settings import Settings


def create_app(settings: Settings | None = None, entries: Entries | None = None) -> FastAPI:
    """The service as an ASGI application; its parts start and stop with the lifespan.

    Args:
        settings: from the environment by default.
        entries: what the child processes run.
    """
    chosen = Settings() if settings is None else settings

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        parts = assemble(chosen, entries or Entries())
        app.state.components = parts
        try:
            await parts.start()
            yield
        finally:
            await parts.close()

    app = FastAPI(
        title="pairnavi",
        version=health.product_version(),
        summary="Indoor navigation from one walked video.",
        lifespan=lifespan,
        docs_url=None,
        redoc_url=None,
        openapi_url="/v1/openapi.json",
        redirect_slashes=False,
        generate_unique_id_function=openapi.operation_id,
    )
    app.add_middleware(BodyLimit, limit=chosen.max_message_bytes, patience_s=chosen.body_timeout_s)
    # Added last, asked first.
    app.add_middleware(HostCheck, names=chosen.host_names)
    problems.install(app)
    for module in (health, routes, quality, uploads, navigate):
        app.include_router(module.router)
    openapi.install(app)
    return app
