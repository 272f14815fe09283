"""Close codes of the navigation socket."""

from __future__ import annotations

from enum import IntEnum


class CloseCode(IntEnum):
    """Why the service closed the socket: ``NAME = code, may resume, meaning, what the client does``.

    Codes from 4400 on are the product's own (RFC 6455, section 7.4.2).

    Attributes:
        may_resume: a new connection with the resume token is the right answer.
        meaning: what happened, for a developer.
        advice: what the client does.
    """

    may_resume: bool
    meaning: str
    advice: str

    def __new__(cls, value: int, may_resume: bool = False, meaning: str = "", advice: str = "") -> CloseCode:
        """A member; see the class."""
        member = int.__new__(cls, value)
        member._value_ = value
        member.may_resume = may_resume
        member.meaning = meaning
        member.advice = advice
        return member

    NORMAL = 1000, False, "the client has sent `end`", "Nothing: the walk is over."
    BAD_MESSAGE = (
        4400,
        False,
        "a hello or another text message does not fit, or no hello came in time",
        "A fault of the client: log `detail`, do not retry.",
    )
    UNAUTHORIZED = 4401, False, "who is asking is not known (reserved)", "Sign in, then begin anew."
    FORBIDDEN_ORIGIN = (
        4403,
        False,
        "a browser's page of another site opened the socket",
        "Serve the page from the service's own address.",
    )
    UNKNOWN_ROUTE = 4404, False, "there is no such route", "Say that the link or code is not valid any more."
    UNSUPPORTED_VERSION = (
        4406,
        False,
        "the service does not speak this version of the protocol or of a frame's header",
        "Ask for an update of the app.",
    )
    IDLE_TIMEOUT = 4408, True, "nothing came for `idle_timeout_s`", "Resume when there are pictures again."
    ROUTE_NOT_READY = (
        4409,
        False,
        "the route has no map, or none yet",
        "Look at the route over HTTP until it is `ready`, or show its failure.",
    )
    ROUTE_DELETED = 4410, False, "the route was removed", "Say so and end."
    TOO_LARGE = (
        4413,
        False,
        "a message beyond the limits",
        "Send smaller pictures; `welcome.limits` says how large.",
    )
    BAD_FRAME_HEADER = (
        4415,
        False,
        "a binary message without a valid header",
        "A fault of the client: log `detail`, do not retry.",
    )
    BAD_CAMERA = (
        4422,
        False,
        "the camera is impossible, or its pictures are too large",
        "Correct the camera in `hello`; if it is not known, send null.",
    )
    MAP_UNUSABLE = 4424, False, "the stored map cannot be read", "Say that the route has to be made anew."
    RATE_EXCEEDED = 4429, False, "too many messages", "Begin anew with fewer pictures a second."
    SUPERSEDED = 4440, False, "the session goes on on another connection", "Nothing: the other one has it."
    SLOW_CLIENT = 4441, True, "a message could not be sent for too long", "Resume, and read all the time."
    INTERNAL_ERROR = 4500, True, "the service failed", "Resume after a pause."
    GOING_AWAY = 4503, True, "the service stops; another may be there soon", "Resume after a pause."
    BUSY = 4504, True, "all sessions are taken", "Try again after a pause; say that it is busy."
