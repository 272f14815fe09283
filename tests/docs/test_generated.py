"""The parts of the pages that the code writes."""

from __future__ import annotations

import importlib.util
import json
import re
import struct
from pathlib import Path
from types import ModuleType

import pytest

from server.protocol.close_codes import CloseCode
from server.protocol.error_codes import ErrorCode
from server.protocol.frames import HEADER, decode_frame
from server.protocol.messages import parse_client_message, parse_server_message
from server.settings import Settings

DOCS = Path(__file__).parents[2] / "docs"
PROTOCOL = (DOCS / "protocol.md").read_text(encoding="utf-8")


def load_generator() -> ModuleType:
    """``docs/generate.py``, which is no module of a package."""
    spec = importlib.util.spec_from_file_location("generate", DOCS / "generate.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


generate = load_generator()


@pytest.mark.parametrize("page", generate.pages(), ids=lambda page: str(page.relative_to(DOCS)))
def test_pages_say_what_the_code_says(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    # Not compared by pytest: its account of the difference would bury what to do.
    same = generate.filled(text) == text
    assert same, f"docs/{page.relative_to(DOCS)} is not what the code says: run make spec and commit it"


def test_a_page_that_differs_is_noticed_and_put_right() -> None:
    start = PROTOCOL.index("<!-- generated: closes -->")
    spoilt = PROTOCOL[:start] + PROTOCOL[start:].replace("4408", "4407", 1)
    assert generate.filled(spoilt) == PROTOCOL


def test_every_mark_is_closed_and_known() -> None:
    for page in generate.pages():
        text = page.read_text(encoding="utf-8")
        begun, ended = text.count("<!-- generated:"), text.count("<!-- end of generated -->")
        assert begun == ended == len(generate.MARK.findall(text)), page
        assert {match[2] for match in generate.MARK.finditer(text)} <= set(generate.PARTS)


def test_every_message_is_documented_by_an_example_that_is_valid() -> None:
    blocks = re.findall(r"```json\n(.*?)```", PROTOCOL, flags=re.DOTALL)
    messages = [
        document for document in map(json.loads, blocks) if document.get("type", "urn:")[:4] != "urn:"
    ]
    for message in messages:
        if message["type"] in ("hello", "ping", "end"):
            parse_client_message(json.dumps(message))
        else:
            parse_server_message(json.dumps(message))
    documented = {message["type"] for message in messages}
    assert documented == {"hello", "ping", "end", "welcome", "update", "error", "pong", "goodbye"}


def test_the_annotated_bytes_are_a_message() -> None:
    block = re.search(r"```text\n( 0  50 4e.*?)```", PROTOCOL, flags=re.DOTALL)
    assert block is not None
    message, expected = b"", 0
    for line in block[1].splitlines():
        offset, part = int(line[:2]), bytes.fromhex(line[4:28])
        assert offset == expected, line
        message += part
        expected += len(part)
    frame = decode_frame(message)
    assert (frame.sequence, frame.capture_time, frame.payload) == (7, 1.5, b"\xff\xd8\xff")


def test_the_header_is_as_the_struct_that_the_page_names() -> None:
    named = re.search(r"`struct` format `([^`]+)`", PROTOCOL.replace("\n", " "))
    assert named is not None
    assert struct.calcsize(named[1]) == HEADER.size
    assert named[1] == HEADER.format


@pytest.mark.parametrize("code", list(CloseCode))
def test_every_close_code_is_in_the_table_with_what_to_do(code: CloseCode) -> None:
    row = re.search(
        rf"^\| {int(code)} \| `(\w+)` \| .+ \| (yes|no) \| (.+) \|$", PROTOCOL, flags=re.MULTILINE
    )
    assert row is not None
    assert row.groups() == (code.name.lower(), "yes" if code.may_resume else "no", code.advice)


@pytest.mark.parametrize("code", list(ErrorCode))
def test_every_error_code_is_in_the_table_with_what_follows(code: ErrorCode) -> None:
    row = re.search(rf"^\| `{code}` \| .+ \| (.+) \|$", PROTOCOL, flags=re.MULTILINE)
    assert row is not None
    assert row[1].startswith("the connection goes on" if code.close is None else f"closed, {int(code.close)}")


def test_every_setting_is_documented_with_its_default() -> None:
    text = (DOCS / "tutorials" / "operator.md").read_text(encoding="utf-8")
    for name in Settings.model_fields:
        row = re.search(rf"^\| `PAIRNAVI_{name.upper()}` \| (.+) \| (.+) \|$", text, flags=re.MULTILINE)
        assert row is not None, f"say in the docstring of Settings what {name} is"
        assert row[2].strip()
