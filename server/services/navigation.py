"""Navigation sessions: opened, attached to a connection, resumed on another, forgotten."""

from __future__ import annotations

import asyncio
import hashlib
import secrets
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any, Protocol
from uuid import UUID, uuid4

import structlog

from server.navigation.updates import Update
from server.services.cameras import usable_camera
from server.services.errors import CameraInvalidError, DomainError, TooManySessionsError
from server.services.phone_clock import PhoneClock

log = structlog.get_logger()


class FrameRefusedError(DomainError):
    """The payload is no picture of the session's camera. The session goes on."""

    code = "bad_frame"


_MAX_AHEAD_US = 3_600_000_000
"""How far a capture time may be ahead of the phone's clock: more is a wrong time, no wrong estimate."""


class FrameLostError(DomainError):
    """The picture was taken but not answered. The session goes on."""

    code = "frame_lost"


class Pool(Protocol):
    """Processes that own sessions."""

    async def open(
        self,
        session: str,
        map_file: str,
        camera: Mapping[str, Any] | None,
        orientation: int,
        snapshot: Any | None = None,
    ) -> None:
        """Open a session somewhere.

        Raises:
            MapUnusableError: the map cannot be read.
            NavigationUnavailableError: no process could open it.
        """
        ...

    async def process(self, session: str, sequence: int, capture_time: float, picture: bytes) -> Update:
        """Answer a picture, one at a time for a session.

        Raises:
            FrameRefusedError, FrameLostError: about this picture only.
            MapUnusableError, NavigationUnavailableError: the session cannot go on.
        """
        ...

    def close_session(self, session: str) -> None:
        """Forget a session; none is no error."""
        ...

    @property
    def alive(self) -> int:
        """Processes that live."""
        ...


class EndReason(StrEnum):
    """Why a session leaves its connection."""

    SUPERSEDED = "superseded"
    ROUTE_DELETED = "route_deleted"
    GOING_AWAY = "going_away"


Attachment = Callable[[EndReason], None]
"""A connection, as its session sees it: called at most once, when it has to end."""


@dataclass(slots=True)
class FrameTally:
    """Frames of a session so far; see :class:`server.protocol.messages.FrameCounts`."""

    received: int = 0
    answered: int = 0
    replaced: int = 0
    stale: int = 0
    bad: int = 0


@dataclass(eq=False, slots=True)
class LiveSession:
    """A follower's session.

    Attributes:
        token: secret of whoever may resume it.
        last_sequence, last_capture_us: of the newest frame taken.
    """

    id: str
    token: str
    owner: str
    route_id: UUID
    camera: Mapping[str, Any] | None
    orientation: int
    clock: PhoneClock = field(default_factory=PhoneClock)
    frames: FrameTally = field(default_factory=FrameTally)
    last_sequence: int | None = None
    last_capture_us: int = 0
    attachment: Attachment | None = None
    expiry: asyncio.TimerHandle | None = None

    def accepts(self, sequence: int, capture_time_us: int, now_us: int) -> bool:
        """Take note of a frame that comes at ``now_us`` of the service's clock.

        Returns:
            False if it is out of order or came before.

        Raises:
            FrameRefusedError: its time is far ahead of the phone's clock. Noted, it would make every later
                frame stale.
        """
        self.frames.received += 1
        phone_us = self.clock.time_us(now_us)
        if phone_us is not None and capture_time_us > phone_us + _MAX_AHEAD_US:
            self.frames.bad += 1
            raise FrameRefusedError("the capture time is more than an hour ahead of the phone's clock")
        in_order = self.last_sequence is None or sequence > self.last_sequence
        if not in_order or capture_time_us < self.last_capture_us:
            self.frames.stale += 1
            return False
        self.last_sequence, self.last_capture_us = sequence, capture_time_us
        return True


class NavigationService:
    """All sessions of this process. On one event loop.

    Args:
        max_sessions: attached or waiting to be resumed.
        resume_within_s: how long a session outlives its connection.
        max_pixels: of a follower's camera.
    """

    def __init__(self, pool: Pool, max_sessions: int, resume_within_s: float, max_pixels: int) -> None:
        self._pool = pool
        self._max_sessions = max_sessions
        self._resume_within_s = resume_within_s
        self._max_pixels = max_pixels
        self._sessions: dict[str, LiveSession] = {}
        self._by_token: dict[bytes, LiveSession] = {}

    def __len__(self) -> int:
        return len(self._sessions)

    async def check_camera(
        self, camera: Mapping[str, Any] | None, orientation: int
    ) -> Mapping[str, Any] | None:
        """The camera in its normal form; None for one that nobody knows.

        Raises:
            CameraInvalidError: as :func:`server.services.cameras.usable_camera`, or its pictures are too
                large.
        """
        if camera is None:
            return None
        usable = await asyncio.to_thread(usable_camera, camera, orientation)
        if usable.width * usable.height > self._max_pixels:
            raise CameraInvalidError(f"pictures may have {self._max_pixels} pixels; send smaller ones")
        return usable.to_json()

    async def open(
        self,
        owner: str,
        route_id: UUID,
        map_file: str,
        camera: Mapping[str, Any] | None,
        orientation: int,
        attachment: Attachment,
    ) -> LiveSession:
        """A new session, attached.

        Args:
            camera: as :meth:`check_camera` returned it.
            orientation: degrees clockwise by which pictures have to be turned to stand upright.

        Raises:
            TooManySessionsError: there is no room.
            MapUnusableError, NavigationUnavailableError: as :meth:`Pool.open`.
        """
        self._make_room()
        session = LiveSession(
            uuid4().hex,
            secrets.token_urlsafe(32),
            owner,
            route_id,
            camera,
            orientation,
            attachment=attachment,
        )
        # Registered before it is opened: the room it takes must be seen by whoever comes meanwhile.
        self._sessions[session.id] = session
        self._by_token[_digest(session.token)] = session
        try:
            await self._pool.open(session.id, map_file, camera, orientation)
        except BaseException:
            self.end(session)
            raise
        log.info("session.opened", session=session.id, route=str(route_id))
        return session

    def resume(
        self,
        token: str,
        owner: str,
        route_id: UUID,
        camera: Mapping[str, Any] | None,
        orientation: int,
        attachment: Attachment,
    ) -> LiveSession | None:
        """The session of a token, attached to a new connection; an older one is superseded.

        None if the token is unknown or expired, or of another owner, route, camera or orientation.
        """
        session = self._by_token.get(_digest(token))
        if session is None or (session.owner, session.route_id) != (owner, route_id):
            return None
        if (session.camera, session.orientation) != (camera, orientation):
            return None
        if session.expiry is not None:
            session.expiry.cancel()
            session.expiry = None
        older, session.attachment = session.attachment, attachment
        if older is not None:
            older(EndReason.SUPERSEDED)
        session.clock = PhoneClock()
        log.info("session.resumed", session=session.id, route=str(route_id))
        return session

    def detach(self, session: LiveSession, attachment: Attachment, *, may_resume: bool = True) -> None:
        """The connection is gone: the session waits for a while, or ends if it may not be resumed.

        Nothing if another connection has it.
        """
        if session.attachment is not attachment or session.id not in self._sessions:
            return
        if not may_resume:
            self.end(session)
            return
        session.attachment = None
        loop = asyncio.get_running_loop()
        session.expiry = loop.call_later(self._resume_within_s, self.end, session)

    def end(self, session: LiveSession) -> None:
        """Forget a session and its token."""
        if self._sessions.pop(session.id, None) is None:
            return
        self._by_token.pop(_digest(session.token), None)
        if session.expiry is not None:
            session.expiry.cancel()
            session.expiry = None
        self._pool.close_session(session.id)
        log.info("session.ended", session=session.id, answered=session.frames.answered)

    async def answer(
        self, session: LiveSession, sequence: int, capture_time_us: int, picture: bytes
    ) -> Update:
        """The update of one picture.

        Raises:
            FrameRefusedError, FrameLostError: about this picture only.
            MapUnusableError, NavigationUnavailableError: the session cannot go on.
        """
        try:
            update = await self._pool.process(session.id, sequence, capture_time_us / 1e6, picture)
        except FrameRefusedError:
            session.frames.bad += 1
            raise
        session.frames.answered += 1
        return update

    def close_route(self, route_id: UUID) -> None:
        """End all sessions of a route that is gone."""
        for session in [s for s in self._sessions.values() if s.route_id == route_id]:
            attachment = session.attachment
            self.end(session)
            if attachment is not None:
                attachment(EndReason.ROUTE_DELETED)

    def go_away(self) -> None:
        """Tell every connection that the service is going."""
        for session in list(self._sessions.values()):
            if session.attachment is not None:
                session.attachment(EndReason.GOING_AWAY)

    def close(self) -> None:
        """Forget everything."""
        for session in list(self._sessions.values()):
            self.end(session)

    def _make_room(self) -> None:
        if len(self._sessions) < self._max_sessions:
            return
        waiting = [s for s in self._sessions.values() if s.attachment is None]
        if not waiting:
            raise TooManySessionsError(f"all {self._max_sessions} navigation sessions are taken")
        # Dictionaries keep their order: the session opened first goes first.
        self.end(waiting[0])


def _digest(token: str) -> bytes:
    # Looked up by digest, so that the time a lookup takes says nothing about a token.
    return hashlib.sha256(token.encode()).digest()
