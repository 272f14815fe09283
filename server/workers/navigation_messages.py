"""What the service and a navigation process tell each other over their pipe."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from server.navigation.updates import Update


class PictureRefused(ValueError):  # noqa: N818 - the wire's word
    """The payload is no picture of the session's camera; the message says why."""


class MapRefused(ValueError):  # noqa: N818 - the wire's word
    """The route map cannot be read; the message says why."""


@dataclass(frozen=True, slots=True)
class OpenSession:
    """Begin a session, or go on from a snapshot. Answered with Opened or Refused."""

    request: int
    session: str
    map_file: str
    camera: Mapping[str, Any] | None
    orientation: int
    snapshot: Any | None


@dataclass(frozen=True, slots=True)
class ProcessPicture:
    """One picture; ``capture_time`` in seconds. Answered with Answered or Refused."""

    request: int
    session: str
    sequence: int
    capture_time: float
    picture: bytes


@dataclass(frozen=True, slots=True)
class CloseSession:
    """Forget a session. Not answered."""

    session: str


@dataclass(frozen=True, slots=True)
class Ready:
    """The process has loaded what it needs; sent once, before anything else."""


@dataclass(frozen=True, slots=True)
class Opened:
    """The session is there."""

    request: int


@dataclass(frozen=True, slots=True)
class Answered:
    """The update of a picture, and the state to go on from should this process die."""

    request: int
    update: Update
    snapshot: Any


@dataclass(frozen=True, slots=True)
class Refused:
    """The request was not granted: ``kind`` is ``picture``, ``map`` or ``internal``."""

    request: int
    kind: str
    detail: str


Request = OpenSession | ProcessPicture | CloseSession
Reply = Opened | Answered | Refused
