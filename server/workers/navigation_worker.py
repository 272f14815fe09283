"""The navigation process: owns sessions and answers their pictures, one after the other."""

from __future__ import annotations

from multiprocessing.connection import Connection
from typing import TYPE_CHECKING

import structlog

from server.workers.child import load
from server.workers.navigation_messages import (
    Answered,
    CloseSession,
    MapRefused,
    Opened,
    OpenSession,
    PictureRefused,
    ProcessPicture,
    Ready,
    Refused,
    Reply,
    Request,
)

if TYPE_CHECKING:
    from server.workers.navigation_engine import Engine, EngineSession

log = structlog.get_logger()


def main(connection: Connection, engine: str, maps: int, max_pixels: int) -> None:
    """Serve requests until the pipe is closed.

    Args:
        engine: import path of an :class:`server.workers.navigation_engine.Engine` class, called with
            ``maps`` and ``max_pixels``.
    """
    owner = SessionOwner(load(engine)(maps, max_pixels))
    connection.send(Ready())
    while True:
        try:
            request: Request = connection.recv()
        except (EOFError, OSError):
            return
        reply = owner.handle(request)
        if reply is not None:
            try:
                connection.send(reply)
            except OSError:
                return


class SessionOwner:
    """The sessions of this process."""

    def __init__(self, engine: Engine) -> None:
        self._engine = engine
        self._sessions: dict[str, EngineSession] = {}

    def handle(self, request: Request) -> Reply | None:
        """Grant or refuse one request. A bug in one session must not take the others with it."""
        if isinstance(request, CloseSession):
            self._sessions.pop(request.session, None)
            return None
        try:
            if isinstance(request, OpenSession):
                self._sessions[request.session] = self._engine.open(
                    request.map_file, request.camera, request.orientation, request.snapshot
                )
                return Opened(request.request)
            return self._answer(request)
        except PictureRefused as error:
            return Refused(request.request, "picture", str(error))
        except MapRefused as error:
            return Refused(request.request, "map", str(error))
        except Exception as error:
            log.exception("navigation.failed", session=request.session)
            return Refused(request.request, "internal", type(error).__name__)

    def _answer(self, request: ProcessPicture) -> Answered:
        session = self._sessions[request.session]
        update = session.process(request.picture, request.capture_time, request.sequence)
        return Answered(request.request, update, session.snapshot())
