"""Codes of the HTTP interface's problem documents."""

from __future__ import annotations

from enum import StrEnum


class ProblemCode(StrEnum):
    """Why a request was not granted: ``NAME = value, HTTP status, meaning``.

    Attributes:
        status: the HTTP status it comes with.
        meaning: what happened, for a developer.
    """

    status: int
    meaning: str

    def __new__(cls, value: str, status: int = 500, meaning: str = "") -> ProblemCode:
        """A member; see the class."""
        member = str.__new__(cls, value)
        member._value_ = value
        member.status = status
        member.meaning = meaning
        return member

    BAD_REQUEST = "bad_request", 400, "the body could not be read"
    UPLOAD_INCOMPLETE = "upload_incomplete", 400, "fewer bytes than announced, or none; nothing was kept"
    NOT_FOUND = "not_found", 404, "there is nothing at this path"
    ROUTE_NOT_FOUND = "route_not_found", 404, "no such route of this caller"
    METHOD_NOT_ALLOWED = "method_not_allowed", 405, "`Allow` lists the methods that are"
    REQUEST_TIMEOUT = "request_timeout", 408, "the body did not come; nothing was kept"
    ROUTE_STATE = (
        "route_state",
        409,
        "the route's state does not allow it; `detail` says which it is",
    )
    ROUTE_NOT_READY = "route_not_ready", 409, "the route has no map, or none yet"
    UPLOAD_TOO_LARGE = "upload_too_large", 413, "a video with more bytes than allowed; nothing was kept"
    BODY_TOO_LARGE = "body_too_large", 413, "a JSON document with more bytes than allowed"
    UNSUPPORTED_MEDIA_TYPE = (
        "unsupported_media_type",
        415,
        "a document not sent as `application/json`",
    )
    HOST_NOT_ALLOWED = "host_not_allowed", 421, "the service is not known by this name"
    CAMERA_INVALID = "camera_invalid", 422, "no real camera fits the description"
    CURSOR_INVALID = "cursor_invalid", 422, "the cursor is none of this list"
    INVALID_REQUEST = "invalid_request", 422, "the request does not validate; `errors` says where and why"
    MAP_UNUSABLE = "map_unusable", 424, "the route was ready, and its map's file is gone"
    INTERNAL_ERROR = "internal_error", 500, "the service failed; its log says how"
    BUSY = "busy", 503, "no room now; try later"
    STORAGE_FULL = "storage_full", 507, "no room is left to store the video; nothing was kept"
