"""The committed specifications: made from the code, valid, and saying what the models do."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, get_args

import pytest
from jsonschema import Draft7Validator, ValidationError
from openapi_spec_validator import validate
from pydantic import ValidationError as ModelError

from server.api.specification import Specification, specification
from server.protocol.close_codes import CloseCode
from server.protocol.documents import CameraDescription, CreateRoute, Problem
from server.protocol.error_codes import ErrorCode
from server.protocol.examples import DOCUMENT_EXAMPLES, MESSAGE_EXAMPLES
from server.protocol.frames import HEADER
from server.protocol.messages import (
    ClientMessage,
    ServerMessage,
    parse_client_message,
    parse_server_message,
)
from server.protocol.schemas import docstring, plain

DOCS = Path(__file__).parents[2] / "docs"
KINDS: tuple[Specification, ...] = get_args(Specification)
PYTHONISMS = re.compile(r"``|:[a-z]+:`|\bNone\b|\bTrue\b|\bFalse\b|\bArgs:|\bRaises:|\bAttributes:|\bdict\b")


@pytest.fixture(scope="module", params=KINDS)
def document(request: pytest.FixtureRequest) -> dict[str, Any]:
    return json.loads(specification(request.param))


@pytest.fixture(scope="module")
def asyncapi() -> dict[str, Any]:
    return json.loads(specification("asyncapi"))


@pytest.fixture(scope="module")
def openapi() -> dict[str, Any]:
    return json.loads(specification("openapi"))


def everything(node: Any, path: str = "") -> Iterator[tuple[str, str, Any]]:
    """Every key of a document with its path and value."""
    if isinstance(node, dict):
        for key, value in node.items():
            yield path, key, value
            yield from everything(value, f"{path}/{key}")
    elif isinstance(node, list):
        for index, value in enumerate(node):
            yield from everything(value, f"{path}/{index}")


@pytest.mark.parametrize("kind", KINDS)
def test_the_committed_specification_is_what_the_code_says(kind: Specification) -> None:
    committed = (DOCS / f"{kind}.json").read_text(encoding="utf-8")
    # Not compared by pytest: its account of the difference would bury what to do.
    same = committed == specification(kind)
    assert same, f"docs/{kind}.json is not what the code says: run make spec and commit it"


def test_references_lead_somewhere(document: dict[str, Any]) -> None:
    references = [value for _, key, value in everything(document) if key == "$ref"]
    assert references
    for reference in references:
        node: Any = document
        for part in reference.removeprefix("#/").split("/"):
            assert part in node, reference
            node = node[part]


def test_words_need_no_python(document: dict[str, Any]) -> None:
    for path, key, value in everything(document):
        if key in ("description", "summary", "title") and isinstance(value, str):
            assert not PYTHONISMS.search(value), f"{path}/{key}: {value}"


def test_every_field_is_described_but_the_one_that_tells_messages_apart(document: dict[str, Any]) -> None:
    for name, schema in document["components"]["schemas"].items():
        assert schema.get("description"), name
        for field, property_ in schema["properties"].items():
            told_apart = property_.get("const") is not None
            said = property_.get("description")
            assert said or told_apart, f"say in the docstring of {name} what {field} is"


def test_openapi_is_valid(openapi: dict[str, Any]) -> None:
    assert openapi["openapi"].startswith("3.1")
    validate(openapi)


def test_every_operation_has_a_name_and_answers_errors_with_problems(openapi: dict[str, Any]) -> None:
    operations = [operation for path in openapi["paths"].values() for operation in path.values()]
    names = [operation["operationId"] for operation in operations]
    assert len(set(names)) == len(names)
    assert {
        "createRoute",
        "listRoutes",
        "readRoute",
        "deleteRoute",
        "putCamera",
        "putVideo",
        "health",
    } <= set(names)
    for operation in operations:
        assert operation["summary"]
        assert len(operation["tags"]) == 1
        errors = {status: r for status, r in operation["responses"].items() if not status.startswith("2")}
        assert {"default", "421", "500"} <= errors.keys()
        for status, response in errors.items():
            # A service that is not well says in its own document what is missing.
            expected = "application/json" if status == "503" else "application/problem+json"
            assert list(response["content"]) == [expected], (operation["operationId"], status)


def test_asyncapi_tells_all_messages_and_codes(asyncapi: dict[str, Any]) -> None:
    assert asyncapi["asyncapi"].startswith("3.")
    channel = asyncapi["channels"]["navigation"]
    models = [*get_args(get_args(ClientMessage)[0]), *get_args(get_args(ServerMessage)[0])]
    types = {model.model_fields["type"].default for model in models}
    assert set(channel["messages"]) == types | {"frame"}
    assert {code["code"] for code in channel["x-close-codes"]} == {int(code) for code in CloseCode}
    assert {code["code"] for code in channel["x-error-codes"]} == {str(code) for code in ErrorCode}
    received = {
        message["$ref"].rpartition("/")[2]
        for operation in asyncapi["operations"].values()
        if operation["action"] == "receive"
        for message in operation["messages"]
    }
    assert received == {"hello", "ping", "end", "frame"}
    layout = asyncapi["components"]["messages"]["frame"]["x-binary-layout"]
    assert [field["offset"] for field in layout["header"]] == [0, 2, 3, 4, 6, 8, 12, 20]
    assert layout["payload"]["offset"] == HEADER.size


def schema_of(asyncapi: dict[str, Any], kind: str) -> Draft7Validator:
    """A validator of one message, in the dialect that AsyncAPI reads."""
    reference = asyncapi["components"]["messages"][kind]["payload"]["$ref"]
    schema = {"$ref": reference, "components": asyncapi["components"]}
    Draft7Validator.check_schema(schema)
    return Draft7Validator(schema)


@pytest.mark.parametrize("kind", MESSAGE_EXAMPLES)
def test_examples_of_messages_fit_schema_and_model(asyncapi: dict[str, Any], kind: str) -> None:
    example = MESSAGE_EXAMPLES[kind]
    schema_of(asyncapi, kind).validate(example)
    client = kind in ("hello", "ping", "end")
    message = (parse_client_message if client else parse_server_message)(json.dumps(example))
    assert json.loads(message.model_dump_json()) == example


@pytest.mark.parametrize(
    "change",
    [
        {"protocol": "one"},
        {"orientation": 45},
        {"clock_us": -1},
        {"clock_us": 2**53 + 1},
        {"capabilities": ["x"] * 33},
        {"resume_token": "x" * 129},
        {"more": 1},
        {"camera": {"model": "PINHOLE"}},
        {"camera": {**MESSAGE_EXAMPLES["hello"]["camera"], "width": 0}},
    ],
)
def test_what_the_model_of_hello_refuses_its_schema_refuses(
    asyncapi: dict[str, Any], change: dict[str, Any]
) -> None:
    hello = {**MESSAGE_EXAMPLES["hello"], **change}
    with pytest.raises(ModelError):
        parse_client_message(json.dumps(hello))
    with pytest.raises(ValidationError):
        schema_of(asyncapi, "hello").validate(hello)


@pytest.mark.parametrize("kind", ["hello", "ping", "end"])
def test_what_a_message_must_have_is_the_same_for_model_and_schema(
    asyncapi: dict[str, Any], kind: str
) -> None:
    schema = schema_of(asyncapi, kind)
    needed = 0
    for left_out in MESSAGE_EXAMPLES[kind]:
        message = {name: value for name, value in MESSAGE_EXAMPLES[kind].items() if name != left_out}
        try:
            parse_client_message(json.dumps(message))
        except ModelError:
            assert not schema.is_valid(message), f"{kind} without {left_out}"
            needed += 1
        else:
            assert schema.is_valid(message), f"{kind} without {left_out}"
    assert needed >= 1


@pytest.mark.parametrize("model", [CameraDescription, CreateRoute, Problem])
def test_examples_of_documents_fit_their_models(model: Any) -> None:
    model.model_validate(DOCUMENT_EXAMPLES[model.__name__])


def test_docstrings_become_markdown_field_by_field() -> None:
    class Sample:
        """A thing of :class:`server.x.Other`, ``quoted``.

        Attributes:
            first, second: two of
                them.
            third: see :meth:`Other.do`.
        """

    whole, fields = docstring(Sample)
    assert whole == "A thing of `Other`, `quoted`."
    assert fields == {"first": "two of them.", "second": "two of them.", "third": "see `do`."}


def test_tuples_of_different_types_are_not_told_wrongly() -> None:
    with pytest.raises(ValueError, match="different types"):
        plain({"type": "array", "prefixItems": [{"type": "string"}, {"type": "number"}]})
