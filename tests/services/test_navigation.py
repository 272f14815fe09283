from __future__ import annotations

from collections.abc import Mapping
from typing import Any
from uuid import uuid4

from server.navigation.updates import Update
from server.services.navigation import EndReason, LiveSession, NavigationService

CAMERA = {"model": "PINHOLE", "width": 640, "height": 480, "params": [500.0, 500.0, 320.0, 240.0]}


class NoPool:
    """Sessions open and close; nothing is ever answered."""

    alive = 1

    async def open(
        self,
        session: str,
        map_file: str,
        camera: Mapping[str, Any] | None,
        orientation: int,
        snapshot: Any | None = None,
    ) -> None:
        """See ``Pool.open``."""

    async def process(self, session: str, sequence: int, capture_time: float, picture: bytes) -> Update:
        """See ``Pool.process``."""
        raise NotImplementedError

    def close_session(self, session: str) -> None:
        """See ``Pool.close_session``."""


class Connection:
    """Notes why it was ended."""

    def __init__(self) -> None:
        self.reasons: list[EndReason] = []

    def __call__(self, reason: EndReason) -> None:
        self.reasons.append(reason)


async def opened(service: NavigationService, connection: Connection) -> LiveSession:
    return await service.open("me", uuid4(), "map", CAMERA, 0, connection)


async def test_a_session_that_may_not_be_resumed_ends_with_its_connection() -> None:
    service, connection = NavigationService(NoPool(), 4, 60.0, 1_000_000), Connection()
    session = await opened(service, connection)
    service.detach(session, connection, may_resume=False)
    assert len(service) == 0


async def test_a_session_on_another_connection_outlives_the_fault_of_the_older_one() -> None:
    service, older, newer = NavigationService(NoPool(), 4, 60.0, 1_000_000), Connection(), Connection()
    session = await opened(service, older)
    again = service.resume(session.token, "me", session.route_id, CAMERA, 0, newer)
    assert again is session
    assert older.reasons == [EndReason.SUPERSEDED]
    service.detach(session, older, may_resume=False)
    assert len(service) == 1
    service.close()
