"""Codes of ``error`` messages on the navigation socket."""

from __future__ import annotations

from enum import StrEnum

from server.protocol.close_codes import CloseCode


class ErrorCode(StrEnum):
    """What was not accepted: ``NAME = value, close code or None, meaning``.

    Attributes:
        close: the close that follows, None where the connection goes on.
        meaning: what happened, for a developer.
        in_goodbye: told as the reason of a ``goodbye`` rather than by an ``error``.
    """

    close: CloseCode | None
    meaning: str
    in_goodbye: bool

    def __new__(
        cls, value: str, close: CloseCode | None = None, meaning: str = "", in_goodbye: bool = False
    ) -> ErrorCode:
        """A member; see the class."""
        member = str.__new__(cls, value)
        member._value_ = value
        member.close = close
        member.meaning = meaning
        member.in_goodbye = in_goodbye
        return member

    STALE_FRAME = "stale_frame", None, "a picture out of order or sent twice"
    BAD_FRAME = (
        "bad_frame",
        None,
        "no JPEG, or of another size than the camera's; a time over an hour ahead of the phone's clock",
    )
    FRAME_LOST = "frame_lost", None, "a picture that was taken but could not be answered"
    UNSUPPORTED_FRAME_TYPE = "unsupported_frame_type", None, "a type that this version does not know"
    UNSUPPORTED_FRAME_VERSION = (
        "unsupported_frame_version",
        CloseCode.UNSUPPORTED_VERSION,
        "the version in a binary header",
    )
    BAD_FRAME_HEADER = "bad_frame_header", CloseCode.BAD_FRAME_HEADER, "magic, length or capture time"
    BAD_HELLO = "bad_hello", CloseCode.BAD_MESSAGE, "none came, or it does not fit"
    BAD_MESSAGE = "bad_message", CloseCode.BAD_MESSAGE, "not JSON, an unknown type or field, a second hello"
    UNSUPPORTED_PROTOCOL = "unsupported_protocol", CloseCode.UNSUPPORTED_VERSION, "the hello's `protocol`"
    BAD_CAMERA = "bad_camera", CloseCode.BAD_CAMERA, "no real camera is so, or its pictures are too large"
    UNKNOWN_ROUTE = "unknown_route", CloseCode.UNKNOWN_ROUTE, "no such route of this caller"
    ROUTE_NOT_READY = "route_not_ready", CloseCode.ROUTE_NOT_READY, "the route has no map, or none yet"
    ROUTE_DELETED = "route_deleted", CloseCode.ROUTE_DELETED, "the route was removed", True
    MAP_UNUSABLE = (
        "map_unusable",
        CloseCode.MAP_UNUSABLE,
        "the stored map is gone, damaged or of another version, now or since the session began",
    )
    TOO_LARGE = "too_large", CloseCode.TOO_LARGE, "a message beyond the limits"
    RATE_EXCEEDED = (
        "rate_exceeded",
        CloseCode.RATE_EXCEEDED,
        "more messages than the limits; bursts of four seconds' worth pass",
    )
    SLOW_CLIENT = "slow_client", CloseCode.SLOW_CLIENT, "the client does not read; closed without a message"
    IDLE_TIMEOUT = "idle_timeout", CloseCode.IDLE_TIMEOUT, "nothing came for `idle_timeout_s`"
    SUPERSEDED = "superseded", CloseCode.SUPERSEDED, "the session was resumed elsewhere", True
    UNAUTHORIZED = "unauthorized", CloseCode.UNAUTHORIZED, "who is asking is not known (reserved)"
    FORBIDDEN_ORIGIN = "forbidden_origin", CloseCode.FORBIDDEN_ORIGIN, "a browser's page of another site"
    BUSY = "busy", CloseCode.BUSY, "all sessions are taken"
    GOING_AWAY = "going_away", CloseCode.GOING_AWAY, "the service stops", True
    INTERNAL_ERROR = "internal_error", CloseCode.INTERNAL_ERROR, "the service failed"
