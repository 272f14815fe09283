from __future__ import annotations

import subprocess
import sys

import pytest
from pydantic import ValidationError

from server.protocol.messages import (
    End,
    Hello,
    Ping,
    Pong,
    Welcome,
    parse_client_message,
    parse_server_message,
)


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
