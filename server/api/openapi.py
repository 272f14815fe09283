"""The HTTP interface as an OpenAPI 3.1 document, made from the endpoints and their models.

FastAPI derives it; here its words become those of the product: names that a generated client can use,
descriptions from docstrings, and problem documents as what every operation may answer.
"""

from __future__ import annotations

from typing import Any

from fastapi import FastAPI
from fastapi.openapi.utils import get_fields_from_routes, get_openapi
from fastapi.routing import APIRoute

from server.protocol.documents import Problem
from server.protocol.examples import DOCUMENT_EXAMPLES
from server.protocol.problem_codes import ProblemCode
from server.protocol.schemas import markdown, models_within, plain

PROBLEM_TYPE = "application/problem+json"

_ABOUT = """\
Routes: created by a leader, built from a video, followed over the navigation socket, which \
`docs/asyncapi.json` describes. `docs/protocol.md` says how to use both.

Every error is a problem document (RFC 9457), `application/problem+json`, with a stable `code`. Clients \
ignore fields and codes that they do not know: `x-extensible-enum` lists those of this version.

Lengths in metres (`*_m`) are null unless the route's scale is known; angles are radians, positive to the \
left."""

_TAGS = {
    "routes": "A leader's way: its names, its video, its map.",
    "service": "The service itself.",
}

_ALWAYS = (ProblemCode.HOST_NOT_ALLOWED, ProblemCode.INTERNAL_ERROR)
_WITH_INPUT = (ProblemCode.INVALID_REQUEST,)
_WITH_JSON = (
    ProblemCode.BAD_REQUEST,
    ProblemCode.REQUEST_TIMEOUT,
    ProblemCode.BODY_TOO_LARGE,
    ProblemCode.UNSUPPORTED_MEDIA_TYPE,
)

Json = dict[str, Any]


def operation_id(route: APIRoute) -> str:
    """A name for generated clients: ``create_route`` becomes ``createRoute``."""
    first, *others = route.name.split("_")
    return first + "".join(word.capitalize() for word in others)


def may_answer(*codes: ProblemCode) -> dict[int | str, Json]:
    """The ``responses`` of an endpoint with these problems, besides those that all may have."""
    responses: dict[int | str, Json] = {}
    for code in codes:
        _add(responses, code.status, code)
    return responses


def openapi_document(app: FastAPI) -> Json:
    """The document, in an order that does not change from run to run."""
    document = get_openapi(
        title=app.title,
        version=app.version,
        summary=app.summary,
        description=_ABOUT,
        routes=app.routes,
        tags=[{"name": name, "description": said} for name, said in _TAGS.items()],
        license_info={"name": "Apache-2.0", "identifier": "Apache-2.0"},
        servers=[{"url": "http://127.0.0.1:8000", "description": "As the service listens by default"}],
    )
    schemas = document["components"]["schemas"]
    for validation in ("HTTPValidationError", "ValidationError"):
        schemas.pop(validation, None)
    for path in document["paths"].values():
        for operation in path.values():
            _describe(operation)
    bodies = (field.field_info.annotation for field in get_fields_from_routes(app.routes))
    models = models_within([Problem, *bodies])
    schemas["Problem"] = Problem.model_json_schema(ref_template="#/components/schemas/{model}")
    document["components"]["schemas"] = {
        name: _with_example(name, plain(schemas[name], models.get(name))) for name in sorted(schemas)
    }
    return document


def install(app: FastAPI) -> None:
    """Serve this document at the app's ``openapi_url``."""

    def document() -> Json:
        if app.openapi_schema is None:
            app.openapi_schema = openapi_document(app)
        return app.openapi_schema

    app.openapi = document  # type: ignore[method-assign]


def _with_example(name: str, schema: Json) -> Json:
    example = DOCUMENT_EXAMPLES.get(name)
    return schema if example is None else {**schema, "examples": [example]}


def _describe(operation: Json) -> None:
    """Summary and description from the docstring; problems as what they are."""
    text = markdown(operation.get("description", "").partition("Raises:")[0].partition("Args:")[0])
    operation["summary"], _, rest = text.partition(". ")
    operation["summary"] = operation["summary"].rstrip(".")
    operation["description"] = rest or text
    for parameter in operation.get("parameters", []):
        parameter["schema"] = plain(parameter["schema"])
    responses = operation["responses"]
    for status, response in responses.items():
        if status.isdigit() and int(status) < 300 and response["description"] == "Successful Response":
            response["description"] = "Nothing to say" if status == "204" else "As asked for"
    for code in _codes(operation):
        _add(responses, str(code.status), code)
    for status, response in responses.items():
        if status == "default" or (int(status) >= 400 and "content" not in response):
            response["content"] = {PROBLEM_TYPE: {"schema": {"$ref": "#/components/schemas/Problem"}}}
    responses["default"] = {
        "description": "Any other error, as a problem document",
        "content": {PROBLEM_TYPE: {"schema": {"$ref": "#/components/schemas/Problem"}}},
    }
    operation["responses"] = {status: responses[status] for status in sorted(responses)}


def _codes(operation: Json) -> tuple[ProblemCode, ...]:
    codes: tuple[ProblemCode, ...] = _ALWAYS
    if "requestBody" in operation or "parameters" in operation:
        codes += _WITH_INPUT
    if "application/json" in operation.get("requestBody", {}).get("content", {}):
        codes += _WITH_JSON
    return codes


def _add(responses: dict[Any, Json], status: int | str, code: ProblemCode) -> None:
    said = f"`{code}`: {code.meaning}"
    present = responses.get(status)
    if present is None or "HTTPValidationError" in str(present.get("content")):
        responses[status] = {"description": said}
    elif said not in present["description"]:
        present["description"] += f"; {said}"
