"""Errors as RFC 9457 problem documents."""

from __future__ import annotations

from http import HTTPStatus
from typing import Any

import structlog
from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from starlette.exceptions import HTTPException
from starlette.requests import HTTPConnection
from starlette.routing import Match

from server.protocol.documents import Problem
from server.services.errors import DomainError

log = structlog.get_logger()

MEDIA_TYPE = "application/problem+json"

_DOMAIN_STATUS = {
    "route_not_found": HTTPStatus.NOT_FOUND,
    "route_state": HTTPStatus.CONFLICT,
    "route_not_ready": HTTPStatus.CONFLICT,
    "camera_invalid": HTTPStatus.UNPROCESSABLE_ENTITY,
    "cursor_invalid": HTTPStatus.UNPROCESSABLE_ENTITY,
    "upload_too_large": HTTPStatus.REQUEST_ENTITY_TOO_LARGE,
    "upload_incomplete": HTTPStatus.BAD_REQUEST,
    "map_unusable": HTTPStatus.FAILED_DEPENDENCY,
    "busy": HTTPStatus.SERVICE_UNAVAILABLE,
    "storage_full": HTTPStatus.INSUFFICIENT_STORAGE,
}

_HTTP_CODES = {
    400: "bad_request",
    404: "not_found",
    405: "method_not_allowed",
    408: "request_timeout",
    413: "body_too_large",
    415: "unsupported_media_type",
}


_METHODS = ("DELETE", "GET", "HEAD", "OPTIONS", "PATCH", "POST", "PUT")


def problem(
    request: HTTPConnection,
    status: int,
    code: str,
    detail: str,
    *,
    errors: list[dict[str, Any]] | None = None,
    headers: dict[str, str] | None = None,
) -> JSONResponse:
    """A problem response."""
    document = Problem(
        type=f"urn:pairnavi:problem:{code}",
        title=code.replace("_", " ").capitalize(),
        status=status,
        detail=detail,
        code=code,
        instance=request.url.path,
        errors=errors,
    )
    return JSONResponse(
        document.model_dump(exclude_none=True), status_code=status, headers=headers, media_type=MEDIA_TYPE
    )


def install(app: FastAPI) -> None:
    """Every error of the app becomes a problem document."""

    @app.exception_handler(DomainError)
    async def _domain(request: Request, error: DomainError) -> JSONResponse:
        status = _DOMAIN_STATUS.get(error.code, HTTPStatus.INTERNAL_SERVER_ERROR)
        return problem(request, status, error.code, error.detail)

    @app.exception_handler(RequestValidationError)
    async def _invalid(request: Request, error: RequestValidationError) -> JSONResponse:
        # The offending input is left out: it may be large, or a secret.
        errors = [
            {"location": list(e["loc"]), "type": e["type"], "message": e["msg"]} for e in error.errors()
        ]
        first = errors[0]
        where = ".".join(str(part) for part in first["location"])
        return problem(
            request,
            HTTPStatus.UNPROCESSABLE_ENTITY,
            "invalid_request",
            f"{where}: {first['message']}",
            errors=errors,
        )

    @app.exception_handler(HTTPException)
    async def _http(request: Request, error: HTTPException) -> JSONResponse:
        code = _HTTP_CODES.get(error.status_code, f"http_{error.status_code}")
        headers = dict(error.headers) if error.headers else {}
        if error.status_code == HTTPStatus.METHOD_NOT_ALLOWED:
            headers["Allow"] = ", ".join(_allowed_methods(app, request))
        return problem(request, error.status_code, code, str(error.detail), headers=headers)

    @app.exception_handler(Exception)
    async def _bug(request: Request, error: Exception) -> JSONResponse:
        log.error("request.failed", path=request.url.path, error=type(error).__name__)
        return problem(
            request,
            HTTPStatus.INTERNAL_SERVER_ERROR,
            "internal_error",
            "the service failed; the failure is in its log",
        )


def _allowed_methods(app: FastAPI, request: Request) -> list[str]:
    # A route knows its own methods only; others with the same path have more.
    def answers(method: str) -> bool:
        scope = {**request.scope, "method": method}
        return any(route.matches(scope)[0] is Match.FULL for route in app.routes)

    return [method for method in _METHODS if answers(method)]
