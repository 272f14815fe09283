"""Close codes of the navigation socket."""

from __future__ import annotations

from enum import IntEnum


class CloseCode(IntEnum):
    """Why the service closed the socket.

    Codes from 4400 on are the product's own (RFC 6455, section 7.4.2). :attr:`may_resume` says
    which of them a client should answer with a new connection and its resume token.
    """

    NORMAL = 1000
    BAD_MESSAGE = 4400
    UNAUTHORIZED = 4401
    FORBIDDEN_ORIGIN = 4403
    UNKNOWN_ROUTE = 4404
    UNSUPPORTED_VERSION = 4406
    IDLE_TIMEOUT = 4408
    ROUTE_NOT_READY = 4409
    ROUTE_DELETED = 4410
    TOO_LARGE = 4413
    BAD_FRAME_HEADER = 4415
    BAD_CAMERA = 4422
    MAP_UNUSABLE = 4424
    RATE_EXCEEDED = 4429
    SUPERSEDED = 4440
    SLOW_CLIENT = 4441
    INTERNAL_ERROR = 4500
    GOING_AWAY = 4503
    BUSY = 4504

    @property
    def may_resume(self) -> bool:
        """True when a new connection with the resume token is the right answer."""
        return self in (
            CloseCode.IDLE_TIMEOUT,
            CloseCode.SLOW_CLIENT,
            CloseCode.INTERNAL_ERROR,
            CloseCode.GOING_AWAY,
            CloseCode.BUSY,
        )
