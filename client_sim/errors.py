"""What can go wrong for a phone."""

from __future__ import annotations

from server.protocol.documents import Problem, RouteDocument


class WalkError(ValueError):
    """The walk cannot be replayed; the message names the file and what is wrong with it."""


class ServiceUnreachableError(ConnectionError):
    """Nobody answers at the service's address."""


class ServiceRefusedError(Exception):
    """The service answered a request with a problem document.

    Attributes:
        problem: the document.
    """

    def __init__(self, problem: Problem) -> None:
        super().__init__(f"{problem.title}: {problem.detail}")
        self.problem = problem


class RouteFailedError(Exception):
    """The service could not build the route's map.

    Attributes:
        route: the route, with its failure.
    """

    def __init__(self, route: RouteDocument) -> None:
        detail = "the build failed" if route.failure is None else route.failure.detail
        super().__init__(detail)
        self.route = route


class NavigationRefusedError(Exception):
    """The service closed the navigation socket for good.

    Attributes:
        code: of the last error message, or of the close.
        close_code: of the socket.
    """

    def __init__(self, code: str, detail: str, close_code: int | None) -> None:
        super().__init__(f"{code}: {detail}" if detail else code)
        self.code = code
        self.close_code = close_code
