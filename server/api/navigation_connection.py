"""One connection of the navigation socket: the handshake, then pictures in and updates out."""

from __future__ import annotations

import asyncio
import time
from dataclasses import dataclass
from typing import Any
from uuid import UUID

import structlog
from pydantic import ValidationError
from starlette.websockets import WebSocket

from server.api.navigation_channel import ConnectionGone, EndConnection, PhoneChannel, error_message
from server.api.presenters import frame_counts, route_summary, update_message
from server.api.rate_limit import TokenBucket
from server.protocol.close_codes import CloseCode
from server.protocol.error_codes import ErrorCode
from server.protocol.frames import Frame, FrameHeaderError, FrameType, FrameVersionError, decode_frame
from server.protocol.messages import (
    Age,
    End,
    ErrorMessage,
    Goodbye,
    Hello,
    Limits,
    Ping,
    Pong,
    Welcome,
    parse_client_message,
)
from server.protocol.version import PROTOCOL_VERSION
from server.queues.mailbox import Mailbox
from server.services.builds import BuildService
from server.services.errors import (
    CameraInvalidError,
    MapUnusableError,
    NavigationUnavailableError,
    RouteNotFoundError,
    RouteNotReadyError,
    TooManySessionsError,
)
from server.services.navigation import (
    Attachment,
    EndReason,
    FrameLostError,
    FrameRefusedError,
    LiveSession,
    NavigationService,
)
from server.services.routes import RouteService, require_ready
from server.storage.database import Database
from server.storage.objects import ObjectMissingError
from server.storage.records import RouteRecord

log = structlog.get_logger()

_BURST_S = 4.0
"""Seconds' worth of messages that may come at once, after the network held them up."""

_END_CODES = {
    EndReason.SUPERSEDED: CloseCode.SUPERSEDED,
    EndReason.ROUTE_DELETED: CloseCode.ROUTE_DELETED,
    EndReason.GOING_AWAY: CloseCode.GOING_AWAY,
}


@dataclass(frozen=True, slots=True)
class ConnectionOptions:
    """Limits of a connection; bytes, pixels, seconds, as in :class:`server.settings.Settings`."""

    max_frame_bytes: int
    max_message_bytes: int
    max_pixels: int
    max_frames_per_second: float
    max_messages_per_second: float
    heartbeat_interval_s: float
    idle_timeout_s: float
    hello_timeout_s: float
    send_timeout_s: float
    resume_within_s: float


@dataclass(frozen=True, slots=True)
class _Letter:
    frame: Frame
    received_us: int


class _EndedByClient(Exception):  # noqa: N818 - the phone's wish
    pass


class NavigationConnection:
    """Serves one phone on one socket."""

    def __init__(
        self,
        websocket: WebSocket,
        navigation: NavigationService,
        routes: RouteService,
        builds: BuildService,
        database: Database,
        options: ConnectionOptions,
    ) -> None:
        self._websocket = websocket
        self._navigation = navigation
        self._routes = routes
        self._builds = builds
        self._database = database
        self._options = options
        self._channel = PhoneChannel(
            websocket, options.max_frame_bytes, options.max_message_bytes, options.send_timeout_s
        )
        self._mailbox: Mailbox[_Letter] = Mailbox()
        self._ended: asyncio.Future[EndReason] = asyncio.get_running_loop().create_future()

    async def run(self, owner: str, route_id: str, *, same_origin: bool) -> None:
        """Accept the socket and serve it until it ends, whoever ends it."""
        await self._websocket.accept()
        try:
            if not same_origin:
                raise EndConnection(
                    CloseCode.FORBIDDEN_ORIGIN, ErrorCode.FORBIDDEN_ORIGIN, "a page of another site"
                )
            await self._serve(owner, route_id)
        except ConnectionGone:
            return
        except EndConnection as end:
            log.info("connection.refused", code=end.code, close=end.close.name)
            await self._channel.close(end.close, error_message(end))
        except Exception:
            log.exception("connection.failed")
            await self._channel.close(
                CloseCode.INTERNAL_ERROR,
                ErrorMessage(code=ErrorCode.INTERNAL_ERROR, detail="the service failed", fatal=True),
            )

    def _attachment(self, reason: EndReason) -> None:
        if not self._ended.done():
            self._ended.set_result(reason)

    async def _serve(self, owner: str, route_id: str) -> None:
        hello = await self._hello()
        route = await self._route(owner, route_id)
        attachment = self._attachment
        session, resumed = await self._session(owner, route, hello, attachment)
        may_resume = True
        try:
            session.clock.observe(hello.clock_us, _now_us())
            try:
                await self._welcome(session, route, resumed)
            except (ConnectionGone, EndConnection):
                if not resumed:
                    # Nobody knows its token: it would wait in vain.
                    self._navigation.end(session)
                raise
            await self._navigate(session)
        except EndConnection as end:
            may_resume = end.close.may_resume
            raise
        finally:
            self._mailbox.close()
            self._navigation.detach(session, attachment, may_resume=may_resume)

    async def _hello(self) -> Hello:
        try:
            text = await self._channel.receive(self._options.hello_timeout_s)
        except TimeoutError:
            raise _bad_hello("no hello came") from None
        if isinstance(text, bytes):
            raise _bad_hello("the first message must be a hello, not a binary one")
        try:
            message = parse_client_message(text)
        except ValidationError as error:
            raise _bad_hello(_first_error(error)) from None
        if not isinstance(message, Hello):
            raise _bad_hello(f"the first message must be a hello, not a {message.type}")
        if message.protocol != PROTOCOL_VERSION:
            raise EndConnection(
                CloseCode.UNSUPPORTED_VERSION,
                ErrorCode.UNSUPPORTED_PROTOCOL,
                f"protocol {message.protocol}; this service speaks {PROTOCOL_VERSION}",
            )
        return message

    async def _route(self, owner: str, route_id: str) -> RouteRecord:
        try:
            async with self._database.begin() as unit:
                route = await self._routes.get(unit, owner, UUID(route_id))
            require_ready(route, route.map_key)
        except (ValueError, RouteNotFoundError):
            raise EndConnection(
                CloseCode.UNKNOWN_ROUTE, ErrorCode.UNKNOWN_ROUTE, "there is no such route"
            ) from None
        except RouteNotReadyError as error:
            raise EndConnection(CloseCode.ROUTE_NOT_READY, ErrorCode.ROUTE_NOT_READY, error.detail) from None
        return route

    async def _session(
        self, owner: str, route: RouteRecord, hello: Hello, attachment: Attachment
    ) -> tuple[LiveSession, bool]:
        described = None if hello.camera is None else hello.camera.model_dump()
        try:
            camera = await self._navigation.check_camera(described, hello.orientation)
            if hello.resume_token is not None:
                session = self._navigation.resume(
                    hello.resume_token, owner, route.id, camera, hello.orientation, attachment
                )
                if session is not None:
                    return session, True
            map_file = await self._builds.map_path(route.id, require_ready(route, route.map_key))
            session = await self._navigation.open(
                owner, route.id, map_file, camera, hello.orientation, attachment
            )
        except CameraInvalidError as error:
            raise EndConnection(CloseCode.BAD_CAMERA, ErrorCode.BAD_CAMERA, error.detail) from None
        except TooManySessionsError as error:
            raise EndConnection(CloseCode.BUSY, ErrorCode.BUSY, error.detail) from None
        except ObjectMissingError:
            raise _map_unusable("the route's map file is gone") from None
        except MapUnusableError as error:
            raise _map_unusable(error.detail) from None
        except NavigationUnavailableError as error:
            raise EndConnection(CloseCode.INTERNAL_ERROR, ErrorCode.INTERNAL_ERROR, error.detail) from None
        return session, False

    async def _welcome(self, session: LiveSession, route: RouteRecord, resumed: bool) -> None:
        options = self._options
        await self._channel.send(
            Welcome(
                protocol=PROTOCOL_VERSION,
                session_id=session.id,
                resume_token=session.token,
                resumed=resumed,
                last_sequence=session.last_sequence,
                server_clock_us=_now_us(),
                heartbeat_interval_s=options.heartbeat_interval_s,
                idle_timeout_s=options.idle_timeout_s,
                resume_within_s=options.resume_within_s,
                limits=Limits(
                    max_frame_bytes=options.max_frame_bytes,
                    max_message_bytes=options.max_message_bytes,
                    max_pixels=options.max_pixels,
                    max_frames_per_second=options.max_frames_per_second,
                ),
                route=route_summary(route),
            )
        )

    async def _navigate(self, session: LiveSession) -> None:
        """Read and answer until one side ends it."""
        reading = asyncio.create_task(self._read(session))
        answering = asyncio.create_task(self._answer(session))
        try:
            either: set[asyncio.Future[Any]] = {reading, answering, self._ended}
            await asyncio.wait(either, return_when=asyncio.FIRST_COMPLETED)
        finally:
            reading.cancel()
            answering.cancel()
            results = await asyncio.gather(reading, answering, return_exceptions=True)
        if self._ended.done():
            reason = self._ended.result()
            code = _END_CODES[reason]
            await self._channel.close(code, self._goodbye(session, str(reason), code))
            return
        for result in results:
            if isinstance(result, _EndedByClient):
                self._navigation.end(session)
                await self._channel.close(CloseCode.NORMAL, self._goodbye(session, "ended", CloseCode.NORMAL))
                return
            if isinstance(result, Exception):
                raise result

    def _goodbye(self, session: LiveSession, reason: str, code: CloseCode) -> Goodbye:
        return Goodbye(reason=reason, may_resume=code.may_resume, frames=frame_counts(session.frames))

    async def _read(self, session: LiveSession) -> None:
        now = time.monotonic()
        options = self._options
        frames = TokenBucket(options.max_frames_per_second, options.max_frames_per_second * _BURST_S, now)
        messages = TokenBucket(
            options.max_messages_per_second, options.max_messages_per_second * _BURST_S, now
        )
        while True:
            try:
                message = await self._channel.receive(options.idle_timeout_s)
            except TimeoutError:
                raise EndConnection(
                    CloseCode.IDLE_TIMEOUT,
                    ErrorCode.IDLE_TIMEOUT,
                    f"nothing came for {options.idle_timeout_s:g} s",
                ) from None
            bucket = frames if isinstance(message, bytes) else messages
            if not bucket.take(time.monotonic()):
                raise EndConnection(
                    CloseCode.RATE_EXCEEDED, ErrorCode.RATE_EXCEEDED, "more messages than the limits allow"
                )
            if isinstance(message, bytes):
                await self._take_frame(session, message)
            else:
                await self._take_message(session, message)

    async def _take_frame(self, session: LiveSession, message: bytes) -> None:
        received_us = _now_us()
        try:
            frame = decode_frame(message)
        except FrameVersionError as error:
            raise EndConnection(
                CloseCode.UNSUPPORTED_VERSION, ErrorCode.UNSUPPORTED_FRAME_VERSION, str(error)
            ) from None
        except FrameHeaderError as error:
            raise EndConnection(CloseCode.BAD_FRAME_HEADER, ErrorCode.BAD_FRAME_HEADER, str(error)) from None
        if frame.type != FrameType.JPEG:
            await self._complain(
                ErrorCode.UNSUPPORTED_FRAME_TYPE, f"frame type {frame.type} is not known", frame.sequence
            )
            return
        try:
            in_order = session.accepts(frame.sequence, frame.capture_time_us, received_us)
        except FrameRefusedError as error:
            await self._complain(ErrorCode.BAD_FRAME, error.detail, frame.sequence)
            return
        if not in_order:
            await self._complain(
                ErrorCode.STALE_FRAME,
                f"frame {frame.sequence} came after {session.last_sequence}, or its time went back",
                frame.sequence,
            )
        elif self._mailbox.put(_Letter(frame, received_us)) is not None:
            session.frames.replaced += 1

    async def _take_message(self, session: LiveSession, text: str | bytes) -> None:
        received_us = _now_us()
        try:
            message = parse_client_message(text)
        except ValidationError as error:
            raise EndConnection(CloseCode.BAD_MESSAGE, ErrorCode.BAD_MESSAGE, _first_error(error)) from None
        if isinstance(message, Ping):
            session.clock.observe(message.clock_us, received_us, message.round_trip_us)
            await self._channel.send(
                Pong(id=message.id, clock_us=message.clock_us, server_clock_us=_now_us())
            )
        elif isinstance(message, End):
            raise _EndedByClient
        else:
            raise EndConnection(CloseCode.BAD_MESSAGE, ErrorCode.BAD_MESSAGE, "a second hello")

    async def _answer(self, session: LiveSession) -> None:
        while True:
            letter = await self._mailbox.take()
            frame = letter.frame
            try:
                update = await self._navigation.answer(
                    session, frame.sequence, frame.capture_time_us, frame.payload
                )
            except FrameRefusedError as error:
                await self._complain(ErrorCode.BAD_FRAME, error.detail, frame.sequence)
                continue
            except FrameLostError as error:
                await self._complain(ErrorCode.FRAME_LOST, error.detail, frame.sequence)
                continue
            except MapUnusableError as error:
                self._navigation.end(session)
                raise _map_unusable(error.detail) from None
            except NavigationUnavailableError as error:
                self._navigation.end(session)
                raise EndConnection(
                    CloseCode.INTERNAL_ERROR, ErrorCode.INTERNAL_ERROR, error.detail, frame.sequence
                ) from None
            now_us = _now_us()
            since_capture = session.clock.age_us(frame.capture_time_us, now_us)
            age = Age(
                server_ms=round((now_us - letter.received_us) / 1e3, 3),
                capture_ms=None if since_capture is None else round(since_capture / 1e3, 3),
            )
            await self._channel.send(update_message(update, frame.capture_time_us, age, session.frames))

    async def _complain(self, code: ErrorCode, detail: str, sequence: int) -> None:
        await self._channel.send(ErrorMessage(code=code, detail=detail, sequence=sequence))


def _now_us() -> int:
    return time.monotonic_ns() // 1000


def _bad_hello(detail: str) -> EndConnection:
    return EndConnection(CloseCode.BAD_MESSAGE, ErrorCode.BAD_HELLO, detail)


def _map_unusable(detail: str) -> EndConnection:
    return EndConnection(CloseCode.MAP_UNUSABLE, ErrorCode.MAP_UNUSABLE, detail)


def _first_error(error: ValidationError) -> str:
    first = error.errors(include_url=False, include_input=False)[0]
    where = ".".join(str(part) for part in first["loc"])
    return f"{where}: {first['msg']}" if where else str(first["msg"])
