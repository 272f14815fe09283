"""Example sessions of the protocol: reading them, and playing the phone's part against a service.

A file of JSON lines. The first says what it shows, and which settings the service needs; each other is
one thing that happens, told ``from`` the ``phone`` or the ``service``, with a ``kind``:

======== ============================================================================================
phone    ``open``, ``text`` (``payload``, or ``raw`` text), ``binary`` (``base64``), ``picture`` (of the
         demo's follower: ``sequence``, ``capture_time_us``, and ``frame`` of the video, or null for an
         evenly grey picture, a covered lens), ``lose`` the connection, ``wait`` ``s`` seconds, ``flood``
         with a ``payload``, ``count`` of them; ``count`` repeats what is sent
service  ``text`` (``pattern``), ``close`` (``code``)
======== ============================================================================================

A pattern names the fields that matter. ``$string``, ``$number`` and ``$integer`` stand for any, ``$route``
for the route's id; ``$token`` is what the last welcome gave.
"""

from __future__ import annotations

import asyncio
import base64
import json
import re
import socket as socketlib
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import ConnectionClosed

from server.protocol.frames import Frame, encode_frame
from server.protocol.messages import parse_server_message

FOLDER = Path(__file__).parents[1] / "protocol" / "sessions"

_PATIENCE_S = 60.0
_CLOSE_TIMEOUT_S = 1.0
"""After a close frame the other side has this long to end the connection."""
_CAMERA = re.compile(r'"camera": \{[^}]*\}')
_VECTOR = re.compile(r'\["\$number"(?:, "\$number")*\]')
_KINDS: dict[str, type | tuple[type, ...]] = {"$string": str, "$integer": int, "$number": (int, float)}


@dataclass(frozen=True, slots=True)
class SessionScript:
    """A session as its file tells it."""

    name: str
    title: str
    about: str
    settings: dict[str, Any]
    steps: tuple[dict[str, Any], ...]


def read_script(path: Path) -> SessionScript:
    """Read a file."""
    head, *steps = (json.loads(line) for line in path.read_text(encoding="utf-8").splitlines())
    return SessionScript(path.stem, head["session"], head["about"], head.get("settings", {}), tuple(steps))


def scripts() -> list[SessionScript]:
    """All sessions, by name."""
    return [read_script(path) for path in sorted(FOLDER.glob("*.jsonl"))]


@dataclass
class Phone:
    """Plays the phone's part.

    Args:
        picture: gives a frame of a walk as JPEG, by its index; a grey one for None.
    """

    url: str
    route_id: str
    picture: Callable[[int | None], bytes]
    token: str = ""
    socket: ClientConnection | None = field(default=None, init=False)
    lost: bool = field(default=False, init=False)

    async def play(self, script: SessionScript) -> None:
        """Go through a session.

        Raises:
            AssertionError: the service does not keep to it; the message names the line.
        """
        try:
            for number, step in enumerate(script.steps, start=2):
                try:
                    async with asyncio.timeout(_PATIENCE_S):
                        await self._do(step)
                except (AssertionError, TimeoutError, ConnectionClosed) as error:
                    raise AssertionError(f"{script.name}.jsonl:{number}: {step}: {error!r}") from error
        finally:
            if self.socket is not None:
                self.socket.transport.abort()

    async def _do(self, step: dict[str, Any]) -> None:
        if step["from"] == "service":
            await (self._expect_close(step["code"]) if step["kind"] == "close" else self._expect(step))
            return
        match step["kind"]:
            case "open":
                await self._open(step.get("receive_buffer"))
            case "lose":
                self._connected.transport.abort()
            case "wait":
                await asyncio.sleep(step["s"])
            case "flood":
                await self._flood(self._filled(step["payload"]), step["count"])
            case _:
                await self._connected.send(self._message(step))

    @property
    def _connected(self) -> ClientConnection:
        assert self.socket is not None, "nothing is open"
        return self.socket

    def _message(self, step: dict[str, Any]) -> str | bytes:
        times = step.get("count", 1)
        if step["kind"] == "binary":
            return base64.b64decode(step["base64"]) * times
        if step["kind"] == "picture":
            jpeg = self.picture(step["frame"])
            return encode_frame(Frame(step["sequence"], step["capture_time_us"], jpeg))
        return str(step["raw"]) * times if "raw" in step else json.dumps(self._filled(step["payload"]))

    def _filled(self, payload: dict[str, Any]) -> dict[str, Any]:
        return {name: self.token if value == "$token" else value for name, value in payload.items()}

    async def _open(self, receive_buffer: int | None) -> None:
        parts = urlsplit(self.url)
        if self.socket is not None:
            await self.socket.close()
        options: dict[str, Any] = {}
        if receive_buffer is not None:
            small = socketlib.create_connection((parts.hostname, parts.port))
            small.setsockopt(socketlib.SOL_SOCKET, socketlib.SO_RCVBUF, receive_buffer)
            # A queue of one message: the library stops reading from the network, whose buffer is small.
            options = {"sock": small, "max_queue": 1}
        self.socket = await connect(
            f"ws://{parts.netloc}/v1/routes/{self.route_id}/navigate",
            proxy=None,
            compression=None,
            close_timeout=_CLOSE_TIMEOUT_S,
            **options,
        )

    async def _flood(self, payload: dict[str, Any], times: int) -> None:
        text = json.dumps(payload)
        for _ in range(times):
            await self._connected.send(text)

    async def _expect(self, step: dict[str, Any]) -> None:
        while True:
            text = await self._connected.recv()
            message = json.loads(text)
            # Fits its model, whatever the pattern leaves out.
            parse_server_message(text)
            wrong = self.difference(message, step["pattern"])
            if wrong is None:
                self.token = message.get("resume_token", self.token)
                return
            skipped = step.get("skip_updates", False) and message["type"] == "update"
            assert skipped, f"{wrong} in {text!r}"

    async def _expect_close(self, code: int) -> None:
        # What waits has to come through the buffer that was made small.
        network = self._connected.transport.get_extra_info("socket")
        network.setsockopt(socketlib.SOL_SOCKET, socketlib.SO_RCVBUF, 1 << 20)
        with suppress(ConnectionClosed):
            while True:
                # Only what a phone that did not read has missed may still come.
                kind = json.loads(await self._connected.recv())["type"]
                assert kind == "pong", f"{kind} instead of a close"
        assert self._connected.close_code == code, f"closed with {self._connected.close_code}"

    def difference(self, value: Any, pattern: Any, path: str = "") -> str | None:
        """Where a value does not fit a pattern, None if it does."""
        if isinstance(pattern, dict) and isinstance(value, dict):
            missing = [f"{path}.{name} is missing" for name in pattern if name not in value]
            return next(
                iter(missing),
                _first(
                    self.difference(value[name], inner, f"{path}.{name}")
                    for name, inner in pattern.items()
                    if name in value
                ),
            )
        if isinstance(pattern, list) and isinstance(value, list) and len(pattern) == len(value):
            return _first(
                self.difference(v, p, f"{path}[{i}]")
                for i, (v, p) in enumerate(zip(value, pattern, strict=True))
            )
        if pattern == "$route":
            pattern = self.route_id
        if pattern == "$token":
            return None if isinstance(value, str) and len(value) >= 16 else f"{path} is no token"
        if isinstance(pattern, str) and pattern in _KINDS:
            fits = isinstance(value, _KINDS[pattern]) and not isinstance(value, bool)
            return None if fits else f"{path} is {value!r}, not {pattern}"
        return None if value == pattern else f"{path} is {value!r}, not {pattern!r}"


def _first(found: Any) -> str | None:
    return next((one for one in found if one is not None), None)


def shown(script: SessionScript) -> Sequence[str]:
    """The session as lines for people: who says what, and why."""
    return [_shown(step) for step in script.steps]


def _shown(step: dict[str, Any]) -> str:
    arrow = "→" if step["from"] == "phone" else "←"
    match step["kind"]:
        case "open":
            said = "(opens the socket)"
        case "lose":
            said = "(is cut off)"
        case "wait":
            said = f"(waits {step['s']} s)"
        case "flood":
            said = f"{_json(step['payload'])} × {step['count']}"
        case "close":
            said = f"close {step['code']}"
        case "picture":
            what = "grey picture" if step["frame"] is None else "picture"
            said = f"{what} {step['sequence']}, taken at {step['capture_time_us']} µs"
        case "binary":
            said = _binary(base64.b64decode(step["base64"]), step.get("count", 1))
        case _:
            said = (
                f"text {step['raw']!r}" + (f" × {step['count']}" if "count" in step else "")
                if "raw" in step
                else _json(step.get("payload", step.get("pattern")))
            )
    comment = step.get("comment")
    return (f"# {comment}\n" if comment else "") + f"{arrow} {said}"


def _binary(message: bytes, times: int) -> str:
    if times > 1:
        return f"{len(message) * times} bytes"
    return f"{message[:24].hex(' ')} + {len(message) - 24} bytes"


def _json(payload: Any) -> str:
    text = json.dumps(payload, ensure_ascii=False)
    # A camera and a vector say nothing here that is not said elsewhere.
    return _VECTOR.sub("[…]", _CAMERA.sub('"camera": {…}', text))
