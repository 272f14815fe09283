"""Codes of ``error`` messages on the navigation socket."""

from __future__ import annotations

from enum import StrEnum


class ErrorCode(StrEnum):
    """What was not accepted. Those marked fatal in docs/protocol.md are followed by a close."""

    STALE_FRAME = "stale_frame"
    BAD_FRAME = "bad_frame"
    FRAME_LOST = "frame_lost"
    UNSUPPORTED_FRAME_TYPE = "unsupported_frame_type"
    UNSUPPORTED_FRAME_VERSION = "unsupported_frame_version"
    BAD_FRAME_HEADER = "bad_frame_header"
    BAD_HELLO = "bad_hello"
    BAD_MESSAGE = "bad_message"
    UNSUPPORTED_PROTOCOL = "unsupported_protocol"
    CAMERA_REQUIRED = "camera_required"
    BAD_CAMERA = "bad_camera"
    UNKNOWN_ROUTE = "unknown_route"
    ROUTE_NOT_READY = "route_not_ready"
    ROUTE_DELETED = "route_deleted"
    MAP_UNUSABLE = "map_unusable"
    TOO_LARGE = "too_large"
    RATE_EXCEEDED = "rate_exceeded"
    SLOW_CLIENT = "slow_client"
    IDLE_TIMEOUT = "idle_timeout"
    SUPERSEDED = "superseded"
    UNAUTHORIZED = "unauthorized"
    FORBIDDEN_ORIGIN = "forbidden_origin"
    BUSY = "busy"
    GOING_AWAY = "going_away"
    INTERNAL_ERROR = "internal_error"
