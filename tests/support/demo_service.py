"""A real service with the demo's route: nothing is a stand-in but that its map is built beforehand."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import service
from demo_route import DemoRoute

from server.api.components import Entries

ENTRIES = Entries(builder="prebuilt_map:build")


@dataclass(frozen=True, slots=True)
class DemoService:
    """A running service and the id of its route."""

    service: service.Service
    route_id: str


@asynccontextmanager
async def serving(demo: DemoRoute, data: Path, **settings: Any) -> AsyncIterator[DemoService]:
    """Start a service, give it the demo's route, stop it afterwards."""
    chosen = service.settings(data, **{"send_timeout_s": 5.0, **settings})
    async with service.running(chosen, ENTRIES) as running:
        route_id = await running.upload(str(demo.map_file).encode())
        await running.wait(route_id, "ready")
        yield DemoService(running, route_id)
