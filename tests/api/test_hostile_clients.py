"""Clients that stall, flood, do not read or send rubbish: each is shut out, nobody else notices."""

from __future__ import annotations

import asyncio
import contextlib
import json
import socket as socketlib
import struct
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest
import pytest_asyncio
import service
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pydantic import ValidationError
from service import CAMERA, HELLO, NEW_ROUTE, Service, closed_with, hello, receive, send_picture
from websockets.exceptions import ConnectionClosed

from server.protocol.close_codes import CloseCode
from server.protocol.frames import Frame, encode_frame
from server.protocol.messages import ErrorMessage, Pong, UpdateMessage, parse_client_message

pytestmark = pytest.mark.asyncio(loop_scope="module")

JSON = {"Content-Type": "application/json"}


@pytest_asyncio.fixture(loop_scope="module", scope="module")
async def impatient(tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[Service]:
    chosen = service.settings(tmp_path_factory.mktemp("data"), head_timeout_s=0.4, body_timeout_s=0.4)
    async with service.running(chosen) as running:
        yield running


@pytest_asyncio.fixture(loop_scope="module", scope="module")
async def route(impatient: Service) -> AsyncIterator[str]:
    yield await impatient.ready_route()


async def raw(running: Service) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
    return await asyncio.open_connection("127.0.0.1", int(running.url.rpartition(":")[2]))


def unfinished(running: Service) -> list[Path]:
    return list((running.parts.settings.data_dir / "store" / "unfinished").iterdir())


@pytest.mark.parametrize("sent", [b"", b"GET /v1/health HTTP/1.1\r\nHost: loc"])
async def test_a_request_whose_head_does_not_end_is_hung_up_on(impatient: Service, sent: bytes) -> None:
    reader, writer = await raw(impatient)
    writer.write(sent)

    async def dribble() -> None:
        # A byte now and then buys no time.
        while sent:
            writer.write(b"a")
            await asyncio.sleep(0.1)

    dribbling = asyncio.create_task(dribble())
    try:
        async with asyncio.timeout(5):
            assert await reader.read() == b""
    finally:
        dribbling.cancel()
    writer.close()


async def test_a_second_request_has_to_come_in_time_too(impatient: Service) -> None:
    reader, writer = await raw(impatient)
    writer.write(b"GET /v1/health HTTP/1.1\r\nHost: localhost\r\n\r\n")
    assert (await reader.readuntil(b"\r\n\r\n")).startswith(b"HTTP/1.1 200")
    # It would end the library's own wait for another request.
    writer.write(b"G")
    async with asyncio.timeout(5):
        assert b'"status"' in await reader.read()
    writer.close()


async def test_a_socket_outlives_the_time_for_a_request(impatient: Service, route: str) -> None:
    async with impatient.connect(route) as socket:
        await hello(socket)
        await asyncio.sleep(0.8)
        await send_picture(socket, 1)
        assert isinstance(await receive(socket), UpdateMessage)


@pytest.mark.parametrize("path", ["/v1/routes", "video"])
async def test_a_body_that_stops_coming_is_given_up(impatient: Service, path: str) -> None:
    route_id = (await impatient.http.post("/v1/routes", json=NEW_ROUTE)).json()["id"]
    method = "POST" if path.startswith("/") else "PUT"
    target = path if path.startswith("/") else f"/v1/routes/{route_id}/video"
    reader, writer = await raw(impatient)
    head = f"{method} {target} HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\n"
    writer.write(f"{head}Content-Length: 5000\r\n\r\n".encode() + b" " * 100)
    async with asyncio.timeout(5):
        answer = await reader.read()
    assert answer.startswith(b"HTTP/1.1 408")
    assert b"request_timeout" in answer
    writer.close()
    assert await impatient.parts.store.keys(f"routes/{route_id}") == []
    assert unfinished(impatient) == []


async def test_a_slow_body_is_taken_as_long_as_it_comes(impatient: Service) -> None:
    async def slowly() -> AsyncIterator[bytes]:
        for _ in range(6):
            await asyncio.sleep(0.15)
            yield b"x"

    route_id = (await impatient.http.post("/v1/routes", json=NEW_ROUTE)).json()["id"]
    answer = await impatient.http.put(f"/v1/routes/{route_id}/video", content=slowly())
    assert answer.json()["video_bytes"] == 6


async def test_of_two_uploads_at_once_one_is_kept(impatient: Service) -> None:
    route_id = (await impatient.http.post("/v1/routes", json=NEW_ROUTE)).json()["id"]
    url = f"/v1/routes/{route_id}/video"
    half = asyncio.Event()

    async def halting(video: bytes) -> AsyncIterator[bytes]:
        yield video[:2]
        await half.wait()
        yield video[2:]

    first = asyncio.create_task(impatient.http.put(url, content=halting(b"good first")))
    second = asyncio.create_task(impatient.http.put(url, content=halting(b"good second")))
    await asyncio.sleep(0.2)
    half.set()
    answers = await asyncio.gather(first, second)
    # The one that is there first starts the build, which takes no other video.
    assert sorted(answer.status_code for answer in answers) == [200, 409]
    (kept,) = await impatient.parts.store.keys(f"routes/{route_id}")
    size = (await impatient.http.get(f"/v1/routes/{route_id}")).json()["video_bytes"]
    assert await impatient.parts.store.size(kept) == size
    await impatient.wait(route_id, "ready")


async def test_a_route_deleted_during_its_upload_leaves_nothing(impatient: Service) -> None:
    route_id = (await impatient.http.post("/v1/routes", json=NEW_ROUTE)).json()["id"]
    gone = asyncio.Event()

    async def halting() -> AsyncIterator[bytes]:
        yield b"good"
        await gone.wait()
        yield b"bye"

    uploading = asyncio.create_task(impatient.http.put(f"/v1/routes/{route_id}/video", content=halting()))
    await asyncio.sleep(0.2)
    assert (await impatient.http.delete(f"/v1/routes/{route_id}")).status_code == 204
    gone.set()
    assert (await uploading).status_code == 404
    assert await impatient.parts.store.keys(f"routes/{route_id}") == []
    assert unfinished(impatient) == []


@pytest.mark.parametrize(
    "document",
    [
        b"[" * 60_000,
        b'{"name":' * 7_000,
        b'{"name": ' + b"9" * 50_000 + b"}",
        b'{"name": "\\ud800", "start_label": "a", "destination_label": "b"}',
        b'{"name": "a", "start_label": "b", "destination_label": "c", "measured_length_m": NaN}',
        b'{"name": "a", "start_label": "b", "destination_label": "c", "measured_length_m": 1e999}',
        b"\xff\xfe\x00",
        b"null",
        b"",
    ],
)
async def test_no_document_breaks_the_service(impatient: Service, document: bytes) -> None:
    answer = await impatient.http.post("/v1/routes", content=document, headers=JSON)
    assert answer.status_code in (400, 422), answer.text
    assert answer.headers["content-type"] == "application/problem+json"


ABSURD = {
    "not a number": {"params": [float("nan"), 500.0, 320.0, 240.0]},
    "infinite": {"params": [float("inf"), 500.0, 320.0, 240.0]},
    "negative": {"params": [-500.0, 500.0, 320.0, 240.0]},
    "zero": {"params": [0.0, 0.0, 320.0, 240.0]},
    "a telescope": {"params": [1e9, 1e9, 320.0, 240.0]},
    "beside the picture": {"params": [500.0, 500.0, -1.0, 240.0]},
    "far beside the picture": {"params": [500.0, 500.0, 1e12, 240.0]},
    "folding": {"model": "OPENCV", "params": [500.0, 500.0, 320.0, 240.0, -1.9, -1.9, 0.0, 0.0]},
    "distortion beyond sense": {"model": "OPENCV", "params": [500.0, 500.0, 320.0, 240.0, 99.0, 0, 0, 0]},
    "no size": {"width": 0, "height": 0},
    "negative size": {"width": -640},
    "enormous": {"width": 10**9, "height": 10**9},
    "beyond any number": {"width": 10**400},
    "too many numbers": {"params": [500.0] * 5000},
    "no numbers": {"params": []},
    "words": {"params": ["five hundred"] * 4},
    "nested": {"params": [[500.0], 500.0, 320.0, 240.0]},
    "unheard of": {"model": "../../etc/passwd"},
}


@pytest.mark.parametrize("change", ABSURD.values(), ids=ABSURD)
async def test_absurd_intrinsics_are_refused_on_both_ways(
    impatient: Service, route: str, change: dict[str, Any]
) -> None:
    camera = {**CAMERA, **change}
    bare = (await impatient.http.post("/v1/routes", json=NEW_ROUTE)).json()["id"]
    answer = await impatient.http.put(
        f"/v1/routes/{bare}/camera", content=json.dumps(camera).encode(), headers=JSON
    )
    assert answer.status_code in (400, 422), answer.text
    assert answer.json()["code"] in ("camera_invalid", "invalid_request", "bad_request")
    async with impatient.connect(route) as socket:
        await socket.send(json.dumps({**HELLO, "camera": camera}))
        refusal = await receive(socket)
        assert isinstance(refusal, ErrorMessage)
        assert refusal.code in ("bad_camera", "bad_hello")
        assert await closed_with(socket) in (CloseCode.BAD_CAMERA, CloseCode.BAD_MESSAGE)


@pytest.mark.parametrize(
    ("first", "code", "close"),
    [
        (encode_frame(Frame(1, 1, b"\xff\xd8")), "bad_hello", CloseCode.BAD_MESSAGE),
        (b"", "bad_hello", CloseCode.BAD_MESSAGE),
        ("", "bad_hello", CloseCode.BAD_MESSAGE),
        ("[" * 50_000, "bad_hello", CloseCode.BAD_MESSAGE),
        (json.dumps({**HELLO, "resume_token": "\ud800"}), "bad_hello", CloseCode.BAD_MESSAGE),
        (json.dumps({**HELLO, "resume_token": "x" * 129}), "bad_hello", CloseCode.BAD_MESSAGE),
        (json.dumps({**HELLO, "capabilities": ["x"] * 33}), "bad_hello", CloseCode.BAD_MESSAGE),
        ('{"type": "end"}', "bad_hello", CloseCode.BAD_MESSAGE),
        ("x" * 100_000, "too_large", CloseCode.TOO_LARGE),
        (bytes(3 << 20), "too_large", CloseCode.TOO_LARGE),
    ],
    ids=lambda value: value[:12] if isinstance(value, str | bytes) else None,
)
async def test_what_is_no_greeting_is_refused(
    impatient: Service, route: str, first: bytes | str, code: str, close: CloseCode
) -> None:
    async with impatient.connect(route) as socket:
        await socket.send(first)
        refusal = await receive(socket)
        assert isinstance(refusal, ErrorMessage)
        assert refusal.code == code
        assert await closed_with(socket) == close


@pytest.mark.parametrize("token", ["", "x", "x" * 43, "../../../etc/passwd", "' OR 1=1 --", "\0" * 43])
async def test_a_forged_token_begins_a_session_of_its_own(impatient: Service, route: str, token: str) -> None:
    async with impatient.connect(route) as socket:
        welcome = await hello(socket, resume_token=token)
        assert not welcome.resumed
        assert welcome.resume_token != token
        await socket.send('{"type": "end"}')
        assert await closed_with(socket) == CloseCode.NORMAL or await receive(socket)


async def test_a_flood_of_pictures_ends_the_connection(impatient: Service, route: str) -> None:
    async with impatient.connect(route, max_queue=None) as socket:
        await hello(socket)
        flood = [encode_frame(Frame(n, n * 1000, b"\xff\xd8" + bytes(10_000))) for n in range(1000)]
        answered = 0
        try:
            for message in flood:
                await socket.send(message)
            while True:
                answered += isinstance(await receive(socket), UpdateMessage)
        except ConnectionClosed:
            pass
        assert await closed_with(socket) == CloseCode.RATE_EXCEEDED
        assert answered < 200
    async with impatient.connect(route) as socket:
        await hello(socket)
        await send_picture(socket, 1)
        assert isinstance(await receive(socket), UpdateMessage)


async def test_a_message_of_many_pieces_is_bounded_too(impatient: Service, route: str) -> None:
    async with impatient.connect(route) as socket:
        await hello(socket)
        with contextlib.suppress(ConnectionClosed):
            await socket.send(bytes(64 << 10) for _ in range(200))
        assert await closed_with(socket) in (1009, CloseCode.TOO_LARGE)


async def test_a_client_that_reads_late_learns_why_it_was_left(data: Path) -> None:
    chosen = service.settings(data, max_messages_per_second=100_000.0)
    async with service.running(chosen) as running:
        route_id = await running.ready_route()
        small = socketlib.create_connection(("127.0.0.1", int(running.url.rpartition(":")[2])))
        small.setsockopt(socketlib.SOL_SOCKET, socketlib.SO_RCVBUF, 4096)
        async with running.connect(route_id, max_queue=1, sock=small) as socket:
            await hello(socket)
            (session,) = running.parts.navigation._sessions.values()

            async def flood() -> None:
                while session.attachment is not None:
                    await socket.send('{"type": "ping", "id": 1, "clock_us": 0}')

            flooding = asyncio.create_task(flood())
            async with asyncio.timeout(20):
                while session.attachment is not None:
                    await asyncio.sleep(0.02)
            flooding.cancel()
            await asyncio.gather(flooding, return_exceptions=True)
            small.setsockopt(socketlib.SOL_SOCKET, socketlib.SO_RCVBUF, 1 << 20)
            with contextlib.suppress(ConnectionClosed):
                while True:
                    assert '"pong"' in str(await socket.recv())
            assert socket.close_code == CloseCode.SLOW_CLIENT


async def test_pings_whose_answers_nobody_reads_fill_no_memory(impatient: Service, route: str) -> None:
    """They are the library's affair: no limit of the protocol counts them."""
    reader, writer = await raw(impatient)
    small = writer.get_extra_info("socket")
    small.setsockopt(socketlib.SOL_SOCKET, socketlib.SO_RCVBUF, 4096)
    head = (
        f"GET /v1/routes/{route}/navigate HTTP/1.1\r\nHost: localhost\r\nUpgrade: websocket\r\n"
        "Connection: Upgrade\r\nSec-WebSocket-Version: 13\r\nSec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n"
        "\r\n"
    )
    writer.write(head.encode())
    assert (await reader.readuntil(b"\r\n\r\n")).startswith(b"HTTP/1.1 101")
    greeting = json.dumps(HELLO).encode()
    writer.write(b"\x81\xfe" + struct.pack(">H", len(greeting)) + bytes(4) + greeting)
    await reader.readuntil(b"}}")
    writer.transport.pause_reading()  # type: ignore[attr-defined]
    pings = (b"\x89\xfd" + bytes(4) + b"x" * 125) * 200
    largest = 0
    for _ in range(150):
        writer.write(pings)
        await writer.drain()
        # The service runs on the same event loop.
        await asyncio.sleep(0.005)
        largest = max(
            [largest]
            + [c.transport.get_write_buffer_size() for c in impatient.server.server_state.connections]
        )
    writer.transport.abort()  # type: ignore[attr-defined]
    assert 0 < largest < 1 << 20


async def test_a_client_that_vanishes_leaves_a_session_to_resume_and_no_connection(
    impatient: Service, route: str
) -> None:
    connections = len(impatient.server.server_state.connections)
    socket = await impatient.connect(route)
    welcome = await hello(socket)
    await send_picture(socket, 1, b"slow")
    socket.transport.abort()
    async with asyncio.timeout(5):
        while len(impatient.server.server_state.connections) > connections:
            await asyncio.sleep(0.02)
    async with impatient.connect(route) as again:
        assert (await hello(again, resume_token=welcome.resume_token)).resumed
        await send_picture(again, 2)
        assert isinstance(await receive(again), UpdateMessage)


TEXTS = st.one_of(
    st.text(max_size=200),
    st.recursive(
        st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=20),
        lambda inner: st.lists(inner, max_size=5) | st.dictionaries(st.text(max_size=12), inner, max_size=5),
        max_leaves=20,
    ).map(json.dumps),
    st.fixed_dictionaries(
        {"type": st.sampled_from(["hello", "ping", "end", "welcome", ""])},
        optional={
            "protocol": st.integers() | st.floats(),
            "camera": st.none() | st.just(CAMERA) | st.dictionaries(st.text(max_size=8), st.integers()),
            "clock_us": st.integers() | st.floats(),
            "id": st.integers() | st.text(max_size=5),
            "orientation": st.integers(-360, 360),
            "resume_token": st.text(max_size=200),
            "round_trip_us": st.integers() | st.floats(),
        },
    ).map(json.dumps),
)


@settings(max_examples=300, derandomize=True, deadline=None)
@given(TEXTS | st.binary(max_size=200))
async def test_no_text_does_worse_than_a_validation_error(text: str | bytes) -> None:
    try:
        message = parse_client_message(text)
    except ValidationError:
        return
    assert message.type in ("hello", "ping", "end")


@settings(
    max_examples=40,
    derandomize=True,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
@given(st.lists(TEXTS | st.binary(max_size=60), min_size=1, max_size=6), st.booleans())
async def test_no_messages_do_worse_than_a_close_of_the_protocol(
    impatient: Service, route: str, messages: list[str | bytes], greeted: bool
) -> None:
    async with impatient.connect(route) as socket:
        try:
            if greeted:
                await hello(socket)
            for message in messages:
                await socket.send(message)
            if not greeted:
                await socket.send("no greeting")
            await socket.send('{"type": "ping", "id": 77, "clock_us": 0}')
            while True:
                answer = await receive(socket)
                if isinstance(answer, Pong) and answer.id == 77:
                    return
        except ConnectionClosed:
            pass
        assert socket.close_code in {int(code) for code in CloseCode} - {CloseCode.INTERNAL_ERROR}
