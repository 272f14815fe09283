from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest
from pydantic import ValidationError

from server.protocol.close_codes import CloseCode
from server.protocol.error_codes import ErrorCode
from server.protocol.messages import (
    End,
    Hello,
    Ping,
    Pong,
    Welcome,
    parse_client_message,
    parse_server_message,
)

DOCUMENT = (Path(__file__).parents[2] / "docs" / "protocol.md").read_text(encoding="utf-8")


def examples() -> list[dict[str, object]]:
    """All JSON messages of the documentation."""
    blocks = re.findall(r"```json\n(.*?)```", DOCUMENT, flags=re.DOTALL)
    return [document for document in map(json.loads, blocks) if "type" in document]


@pytest.mark.parametrize("example", examples(), ids=lambda e: str(e["type"]))
def test_the_documented_examples_are_valid_and_complete(example: dict[str, object]) -> None:
    text = json.dumps(example)
    client = example["type"] in ("hello", "ping", "end")
    message = parse_client_message(text) if client else parse_server_message(text)
    assert json.loads(message.model_dump_json()).keys() == example.keys()


def test_every_message_is_documented_by_an_example() -> None:
    documented = {example["type"] for example in examples()}
    assert documented == {"hello", "ping", "end", "welcome", "update", "error", "pong", "goodbye"}


@pytest.mark.parametrize("code", [c for c in CloseCode if c >= 4400])
def test_every_close_code_is_documented(code: CloseCode) -> None:
    row = re.search(rf"^\| {int(code)} \| `(\w+)` \|.*\| (yes|no) \|$", DOCUMENT, flags=re.MULTILINE)
    assert row is not None
    assert row.group(1) == code.name.lower()
    assert row.group(2) == ("yes" if code.may_resume else "no")


@pytest.mark.parametrize("code", list(ErrorCode))
def test_every_error_code_is_documented(code: ErrorCode) -> None:
    assert f"| `{code}` |" in DOCUMENT


@pytest.mark.parametrize(
    ("text", "kind"),
    [
        ('{"type": "ping", "id": 3, "clock_us": 5}', Ping),
        ('{"type": "end"}', End),
        ('{"type": "hello", "protocol": 1, "camera": null, "clock_us": 0}', Hello),
    ],
)
def test_client_messages_are_told_apart_by_type(text: str, kind: type) -> None:
    assert isinstance(parse_client_message(text), kind)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "null",
        "[]",
        "{}",
        '{"type": "welcome"}',
        '{"type": "ping", "id": 3}',
        '{"type": "ping", "id": -1, "clock_us": 5}',
        '{"type": "ping", "id": 1, "clock_us": 9007199254740993}',
        '{"type": "ping", "id": 1, "clock_us": 5, "more": 1}',
        '{"type": "hello", "protocol": 1, "camera": {"model": "PINHOLE"}, "clock_us": 0}',
        '{"type": "hello", "protocol": 1, "camera": null, "clock_us": 0, "orientation": 45}',
        '{"type": "hello", "protocol": 1, "camera": {"model": "PINHOLE", "width": 4, "height": 4, '
        '"params": [NaN]}, "clock_us": 0}',
    ],
)
def test_what_is_no_client_message_is_refused(text: str) -> None:
    with pytest.raises(ValidationError):
        parse_client_message(text)


def test_clients_ignore_what_a_later_service_adds() -> None:
    pong = parse_server_message('{"type": "pong", "id": 1, "clock_us": 2, "server_clock_us": 3, "more": 1}')
    assert isinstance(pong, Pong)
    assert not isinstance(pong, Welcome)


def test_the_protocol_needs_nothing_of_the_server() -> None:
    program = (
        "import sys, server.protocol.messages, server.protocol.frames, server.protocol.close_codes\n"
        "print(sorted(m for m in sys.modules if m.startswith('server.') and 'protocol' not in m))\n"
        "print([m for m in ('cv2', 'numpy', 'fastapi', 'sqlalchemy') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n[]\n"
