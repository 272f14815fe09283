"""The navigation socket as an AsyncAPI 3.0 document, made from the message models.

See https://www.asyncapi.com/docs/reference/specification/v3.0.0. The document is written from the
service's side, as the specification asks: what it receives, what it sends in reply.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from pydantic import BaseModel

from server.protocol.close_codes import CloseCode
from server.protocol.error_codes import ErrorCode
from server.protocol.examples import MESSAGE_EXAMPLES
from server.protocol.frame_layout import HEADER_FIELDS, header_offsets
from server.protocol.frames import FRAME_VERSION, HEADER
from server.protocol.messages import (
    End,
    ErrorMessage,
    Goodbye,
    Hello,
    Ping,
    Pong,
    UpdateMessage,
    Welcome,
)
from server.protocol.schemas import REFERENCE, docstring, message_schemas
from server.protocol.version import PROTOCOL_VERSION

CHANNEL = "navigation"
ADDRESS = "/v1/routes/{routeId}/navigate"
FRAME = "frame"

_RECEIVED = (Hello, Ping, End)
_SENT = (Welcome, UpdateMessage, ErrorMessage, Pong, Goodbye)

_ABOUT = """\
A walk along a route: pictures in, updates out. Text messages are JSON objects told apart by `type`; \
binary messages are pictures with a header. `docs/protocol.md` says how to use them.

Lengths in metres are null unless the route's scale is known. Angles are radians, positive to the left; \
quaternions x, y, z, w; times `*_us` microseconds, `*_ms` milliseconds, `*_s` seconds.

Clients ignore fields and codes that they do not know: `x-extensible-enum` lists those of this version. \
The service refuses fields that it does not know."""


@dataclass(frozen=True, slots=True)
class _Operation:
    """Something the service receives, and what it sends in reply."""

    name: str
    message: str
    replies: Sequence[type[BaseModel]]
    summary: str


_OPERATIONS = (
    _Operation("greet", "hello", (Welcome, ErrorMessage), "Open or resume a session: the first message"),
    _Operation(
        "look",
        FRAME,
        (UpdateMessage, ErrorMessage),
        "Find a picture on the route; of several that come meanwhile only the newest is answered",
    ),
    _Operation("keepAlive", "ping", (Pong,), "Keep the connection alive and the clocks compared"),
    _Operation("finish", "end", (Goodbye,), "End the walk; the connection is closed with 1000"),
)


def asyncapi_document() -> dict[str, Any]:
    """The document, in an order that does not change from run to run."""
    schemas = message_schemas(_RECEIVED, _SENT)
    for model in _RECEIVED:
        # A default in the model, but what tells messages apart has to be sent.
        schema = schemas[model.__name__]
        schema["properties"]["type"].pop("default")
        schema["required"] = ["type", *schema.get("required", [])]
    messages = {_type(model): _message(model) for model in (*_RECEIVED, *_SENT)}
    messages[FRAME] = _frame()
    return {
        "asyncapi": "3.0.0",
        "info": {
            "title": "pairnavi navigation",
            "version": str(PROTOCOL_VERSION),
            "description": _ABOUT,
            "license": {"name": "Apache-2.0", "url": "https://www.apache.org/licenses/LICENSE-2.0"},
        },
        "defaultContentType": "application/json",
        "servers": {
            "local": {
                "host": "127.0.0.1:8000",
                "protocol": "ws",
                "description": "As the service listens by default; `wss` behind a proxy that speaks TLS.",
            }
        },
        "channels": {
            CHANNEL: {
                "address": ADDRESS,
                "title": "A follower's connection",
                "description": "Closed with one of the codes in `x-close-codes`.",
                "parameters": {"routeId": {"description": "Id of a route that is `ready`, a UUID."}},
                "messages": {name: {"$ref": f"#/components/messages/{name}"} for name in messages},
                "bindings": {"ws": {"method": "GET", "bindingVersion": "0.1.0"}},
                "x-close-codes": [_close_code(code) for code in CloseCode],
                "x-error-codes": [_error_code(code) for code in ErrorCode],
            }
        },
        "operations": {
            **{operation.name: _receive(operation) for operation in _OPERATIONS},
            "sayGoodbye": {
                "action": "send",
                "channel": {"$ref": f"#/channels/{CHANNEL}"},
                "summary": "The service ends the connection: it stops, or the session is elsewhere or gone",
                "messages": [_in_channel("goodbye"), _in_channel("error")],
            },
        },
        "components": {"messages": messages, "schemas": schemas},
    }


def _type(model: type[BaseModel]) -> str:
    return str(model.model_fields["type"].default)


def _message(model: type[BaseModel]) -> dict[str, Any]:
    name = _type(model)
    description, _ = docstring(model)
    return {
        "name": name,
        "title": model.__name__.removesuffix("Message"),
        "summary": description.split("\n")[0],
        "contentType": "application/json",
        "payload": {"$ref": REFERENCE.format(model=model.__name__)},
        "examples": [{"name": name, "payload": MESSAGE_EXAMPLES[name]}],
    }


def _frame() -> dict[str, Any]:
    return {
        "name": FRAME,
        "title": "Frame",
        "summary": f"A picture: a binary message of a header of {HEADER.size} bytes and a JPEG.",
        "contentType": "application/octet-stream",
        "payload": {"type": "string", "format": "binary", "minLength": HEADER.size},
        "x-binary-layout": {
            "version": FRAME_VERSION,
            "byteOrder": "big-endian",
            "header": [
                {
                    "offset": offset,
                    "bytes": field.size,
                    "name": field.name,
                    "type": "ascii" if field.name == "magic" else f"uint{8 * field.size}",
                    "description": field.meaning,
                }
                for offset, field in zip(header_offsets(), HEADER_FIELDS, strict=True)
            ],
            "payload": {"offset": HEADER.size, "contentType": "image/jpeg"},
        },
    }


def _receive(operation: _Operation) -> dict[str, Any]:
    channel = {"$ref": f"#/channels/{CHANNEL}"}
    return {
        "action": "receive",
        "channel": channel,
        "summary": operation.summary,
        "messages": [_in_channel(operation.message)],
        "reply": {"channel": channel, "messages": [_in_channel(_type(model)) for model in operation.replies]},
    }


def _in_channel(message: str) -> dict[str, str]:
    return {"$ref": f"#/channels/{CHANNEL}/messages/{message}"}


def _close_code(code: CloseCode) -> dict[str, Any]:
    return {
        "code": int(code),
        "name": code.name.lower(),
        "mayResume": code.may_resume,
        "description": code.meaning,
        "client": code.advice,
    }


def _error_code(code: ErrorCode) -> dict[str, Any]:
    return {
        "code": str(code),
        "closes": None if code.close is None else int(code.close),
        "toldBy": "goodbye" if code.in_goodbye else "error",
        "description": code.meaning,
    }
