"""Domain errors: expected refusals, apart from HTTP. The API maps them to problem documents."""

from __future__ import annotations


class DomainError(Exception):
    """A request that cannot be granted.

    Attributes:
        code: stable name.
        detail: a sentence for whoever asked.
    """

    code = "refused"

    def __init__(self, detail: str) -> None:
        super().__init__(detail)
        self.detail = detail


class RouteNotFoundError(DomainError):
    """There is no such route, or it is another owner's."""

    code = "route_not_found"


class RouteStateError(DomainError):
    """The route's state does not allow this."""

    code = "route_state"


class RouteNotReadyError(DomainError):
    """The route has no map (yet)."""

    code = "route_not_ready"


class CameraInvalidError(DomainError):
    """No real camera fits the description."""

    code = "camera_invalid"


class UploadTooLargeError(DomainError):
    """More bytes than allowed."""

    code = "upload_too_large"


class UploadIncompleteError(DomainError):
    """The connection ended, or nothing came."""

    code = "upload_incomplete"


class StorageFullError(DomainError):
    """There is no room left; nothing was stored."""

    code = "storage_full"


class CursorInvalidError(DomainError):
    """The list's cursor is none of ours."""

    code = "cursor_invalid"


class MapUnusableError(DomainError):
    """The stored map cannot be read: it is gone, damaged or of another version."""

    code = "map_unusable"


class TooManySessionsError(DomainError):
    """All navigation sessions are taken."""

    code = "busy"


class TooManyExportsError(DomainError):
    """Enough exports are waiting for their turn."""

    code = "busy"


class NavigationUnavailableError(DomainError):
    """The session's process failed again and again; the session cannot go on."""

    code = "navigation_unavailable"
