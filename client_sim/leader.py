"""The leader's phone: uploads a walk and waits for its map."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import dataclass

from client_sim.errors import RouteFailedError
from client_sim.service import ByteListener, ServiceClient
from client_sim.walk import Walk
from server.protocol.documents import CreateRoute, RouteDocument

BuildListener = Callable[[str, float], None]
"""Called with the stage and the fraction of the whole build, 0 to 1."""


@dataclass(frozen=True, slots=True)
class LeaderOptions:
    """How the route is called, and how often the service is asked.

    Attributes:
        measured_length_m: of the walked path, if somebody measured it.
    """

    name: str = "A walk"
    start_label: str = "Start"
    destination_label: str = "Destination"
    measured_length_m: float | None = None
    poll_s: float = 0.5


async def lead(
    service: ServiceClient,
    walk: Walk,
    options: LeaderOptions,
    on_bytes: ByteListener | None = None,
    on_build: BuildListener | None = None,
) -> RouteDocument:
    """Create a route, upload the walk, wait until its map is ready.

    Raises:
        RouteFailedError: the map could not be built.
        ServiceRefusedError, ServiceUnreachableError: as :class:`ServiceClient`.
    """
    route = await service.create(
        CreateRoute(
            name=options.name,
            start_label=options.start_label,
            destination_label=options.destination_label,
            measured_length_m=options.measured_length_m,
        )
    )
    if walk.camera is not None:
        await service.put_camera(route.id, walk.camera)
    await service.put_video(route.id, walk.video, on_bytes)
    return await wait_until_ready(service, route.id, options.poll_s, on_build)


async def wait_until_ready(
    service: ServiceClient, route_id: str, poll_s: float, on_build: BuildListener | None = None
) -> RouteDocument:
    """Poll a route until its build has ended.

    Raises:
        RouteFailedError: the map could not be built.
    """
    while True:
        route = await service.route(route_id)
        if on_build is not None and route.build is not None:
            on_build(route.build.stage, route.build.fraction)
        if route.state == "ready":
            return route
        if route.state == "failed":
            raise RouteFailedError(route)
        await asyncio.sleep(poll_s)
