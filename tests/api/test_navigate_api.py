from __future__ import annotations

import asyncio
import json
import os
import signal
import socket as socketlib
from collections.abc import AsyncIterator
from pathlib import Path
from uuid import uuid4

import pytest
import pytest_asyncio
import service
from service import CAMERA, HELLO, Service, closed_with, hello, receive, send_picture
from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import InvalidStatus
from websockets.typing import Origin

from server.geometry.cameras import Camera, InvalidCameraError
from server.protocol.close_codes import CloseCode
from server.protocol.frames import Frame, encode_frame
from server.protocol.messages import ErrorMessage, Goodbye, Pong, UpdateMessage
from server.services import cameras

pytestmark = pytest.mark.asyncio(loop_scope="module")


@pytest_asyncio.fixture(loop_scope="module", scope="module")
async def route(shared: Service) -> AsyncIterator[str]:
    yield await shared.ready_route()


async def refused(socket: ClientConnection, code: str, close: CloseCode) -> ErrorMessage:
    """The last message says why, the close code too."""
    message = await receive(socket)
    assert isinstance(message, ErrorMessage)
    assert (message.code, message.fatal) == (code, True)
    assert await closed_with(socket) == close
    return message


async def update(socket: ClientConnection) -> UpdateMessage:
    message = await receive(socket)
    assert isinstance(message, UpdateMessage), message
    return message


async def error(socket: ClientConnection) -> ErrorMessage:
    message = await receive(socket)
    assert isinstance(message, ErrorMessage), message
    return message


async def test_a_picture_is_answered_with_its_own_sequence_and_age(shared: Service, route: str) -> None:
    async with shared.connect(route) as socket:
        welcome = await hello(socket)
        assert (welcome.protocol, welcome.resumed, welcome.last_sequence) == (1, False, None)
        assert (welcome.route.id, welcome.route.length_m) == (route, None)
        await socket.send(encode_frame(Frame(41, 5_000_000, b"\xff\xd8")))
        answer = await update(socket)
        assert (answer.sequence, answer.capture_time_us, answer.state) == (41, 5_000_000, "on_route")
        assert answer.fix is not None
        assert answer.fix.position == (1.0, 0.0, 0.0)
        assert answer.fix.orientation == (0.0, 0.0, 0.0, 1.0)
        assert answer.fix.position_sigma == pytest.approx(0.0173, abs=1e-4)
        assert answer.refusal is None
        assert answer.guidance is not None
        assert (answer.guidance.instruction, answer.guidance.remaining_m) == ("left", None)
        assert 0 <= answer.age.server_ms < 2000
        # The phone's clock said 0 at hello, the picture claims to be from five seconds later.
        assert answer.age.capture_ms == 0.0
        await send_picture(socket, 60, b"lost")
        lost = await update(socket)
        assert (lost.state, lost.fix, lost.guidance) == ("lost", None, None)
        assert lost.refusal is not None
        assert lost.refusal.reason == "no_similar_place"


async def test_the_age_since_capture_follows_the_phones_clock(shared: Service, route: str) -> None:
    async with shared.connect(route) as socket:
        await hello(socket, clock_us=10_000_000)
        await socket.send(encode_frame(Frame(1, 9_000_000, b"\xff\xd8")))
        age = (await update(socket)).age
        assert age.capture_ms is not None
        assert age.capture_ms == pytest.approx(1000 + age.server_ms, abs=100)
        await socket.send(json.dumps({"type": "ping", "id": 7, "clock_us": 20_000_000, "round_trip_us": 900}))
        pong = await receive(socket)
        assert isinstance(pong, Pong)
        assert (pong.id, pong.clock_us) == (7, 20_000_000)


async def test_a_picture_from_the_future_spoils_no_later_one(shared: Service, route: str) -> None:
    async with shared.connect(route) as socket:
        await hello(socket, clock_us=10_000_000)
        for sequence, capture_us in enumerate((2**53, 3_700_000_000)):
            await socket.send(encode_frame(Frame(sequence, capture_us, b"\xff\xd8")))
            refusal = await error(socket)
            assert (refusal.code, refusal.sequence, refusal.fatal) == ("bad_frame", sequence, False)
        await socket.send(encode_frame(Frame(0, 10_000_000, b"\xff\xd8")))
        answer = await update(socket)
        assert (answer.frames.received, answer.frames.bad, answer.frames.stale) == (3, 2, 0)


async def test_the_newest_picture_wins(shared: Service, route: str) -> None:
    async with shared.connect(route) as socket:
        await hello(socket)
        for sequence in range(1, 9):
            await send_picture(socket, sequence, b"slow")
        first, last = await update(socket), await update(socket)
        assert (first.sequence, last.sequence) == (1, 8)
        assert (last.frames.received, last.frames.replaced, last.frames.answered) == (8, 6, 2)


async def test_stale_and_bad_pictures_are_refused_and_the_session_goes_on(
    shared: Service, route: str
) -> None:
    async with shared.connect(route) as socket:
        await hello(socket)
        await send_picture(socket, 5)
        await update(socket)
        for sequence in (5, 4):
            await send_picture(socket, sequence)
            stale = await error(socket)
            assert (stale.code, stale.sequence, stale.fatal) == ("stale_frame", sequence, False)
        await socket.send(encode_frame(Frame(6, 0, b"\xff\xd8")))
        assert (await error(socket)).code == "stale_frame"
        await socket.send(encode_frame(Frame(7, 700_000, b"no picture")))
        bad = await error(socket)
        assert (bad.code, bad.sequence) == ("bad_frame", 7)
        await socket.send(encode_frame(Frame(8, 800_000, b"", type=9)))
        assert (await error(socket)).code == "unsupported_frame_type"
        await send_picture(socket, 9, b"rais")
        assert (await error(socket)).code == "frame_lost"
        await send_picture(socket, 10)
        final = await update(socket)
        assert (final.frames.stale, final.frames.bad, final.frames.answered) == (3, 1, 2)


@pytest.mark.parametrize(
    ("message", "code", "close"),
    [
        (b"PX" + bytes(22), "bad_frame_header", CloseCode.BAD_FRAME_HEADER),
        (b"PN", "bad_frame_header", CloseCode.BAD_FRAME_HEADER),
        (encode_frame(Frame(1, 1, b"abc"))[:-1], "bad_frame_header", CloseCode.BAD_FRAME_HEADER),
        (b"PN\x02" + bytes(21), "unsupported_frame_version", CloseCode.UNSUPPORTED_VERSION),
        (bytes(2_100_000), "too_large", CloseCode.TOO_LARGE),
        ("{", "bad_message", CloseCode.BAD_MESSAGE),
        (json.dumps(HELLO), "bad_message", CloseCode.BAD_MESSAGE),
        ('{"type": "dance"}', "bad_message", CloseCode.BAD_MESSAGE),
        (" " * 70_000, "too_large", CloseCode.TOO_LARGE),
    ],
)
async def test_what_is_not_the_protocol_ends_the_connection(
    shared: Service, route: str, message: bytes | str, code: str, close: CloseCode
) -> None:
    async with shared.connect(route) as socket:
        welcome = await hello(socket)
        await socket.send(message)
        await refused(socket, code, close)
    assert not close.may_resume
    async with shared.connect(route) as socket:
        assert not (await hello(socket, resume_token=welcome.resume_token)).resumed


@pytest.mark.parametrize(
    ("change", "code", "close"),
    [
        ({"protocol": 2}, "unsupported_protocol", CloseCode.UNSUPPORTED_VERSION),
        ({"camera": {**CAMERA, "params": [1, 1, 1, 1]}}, "bad_camera", CloseCode.BAD_CAMERA),
        (
            {
                "camera": {
                    "model": "PINHOLE",
                    "width": 9000,
                    "height": 9000,
                    "params": [9000, 9000, 1, 1],
                }
            },
            "bad_camera",
            CloseCode.BAD_CAMERA,
        ),
        ({"orientation": 45}, "bad_hello", CloseCode.BAD_MESSAGE),
        ({"type": "ping", "id": 1}, "bad_hello", CloseCode.BAD_MESSAGE),
        ({"clock_us": -1}, "bad_hello", CloseCode.BAD_MESSAGE),
    ],
)
async def test_a_bad_hello_is_refused(
    shared: Service, route: str, change: dict[str, object], code: str, close: CloseCode
) -> None:
    async with shared.connect(route) as socket:
        await socket.send(json.dumps({**HELLO, **change}))
        await refused(socket, code, close)


async def test_a_session_without_a_camera_is_answered(shared: Service, route: str) -> None:
    async with shared.connect(route) as socket:
        welcome = await hello(socket, camera=None)
        await send_picture(socket, 1)
        assert (await update(socket)).fix is not None
    async with shared.connect(route) as socket:
        again = await hello(socket, camera=None, resume_token=welcome.resume_token)
        assert (again.resumed, again.session_id) == (True, welcome.session_id)
    async with shared.connect(route) as socket:
        other = await hello(socket, resume_token=welcome.resume_token)
        assert not other.resumed, "a session whose camera is known is another one"


async def test_a_camera_that_cannot_be_rectified_is_refused_at_once(
    shared: Service, route: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def rectifier(camera: Camera) -> None:
        raise InvalidCameraError("scaled down, it is none")

    monkeypatch.setattr(cameras, "Rectifier", rectifier)
    async with shared.connect(route) as socket:
        await socket.send(json.dumps(HELLO))
        await refused(socket, "bad_camera", CloseCode.BAD_CAMERA)
    bare = (await shared.http.post("/v1/routes", json=service.NEW_ROUTE)).json()["id"]
    response = await shared.http.put(f"/v1/routes/{bare}/camera", json=CAMERA)
    assert (response.status_code, response.json()["code"]) == (422, "camera_invalid")


async def test_routes_without_a_map_are_refused(shared: Service, route: str) -> None:
    bare = (await shared.http.post("/v1/routes", json=service.NEW_ROUTE)).json()["id"]
    for route_id, code, close in (
        (str(uuid4()), "unknown_route", CloseCode.UNKNOWN_ROUTE),
        ("no-id", "unknown_route", CloseCode.UNKNOWN_ROUTE),
        (bare, "route_not_ready", CloseCode.ROUTE_NOT_READY),
    ):
        async with shared.connect(route_id) as socket:
            await socket.send(json.dumps(HELLO))
            await refused(socket, code, close)


async def test_a_damaged_map_is_refused(shared: Service) -> None:
    damaged = await shared.ready_route()
    key = next(k for k in await shared.parts.store.keys(f"routes/{damaged}") if "/map-" in k)
    (await shared.parts.store.local_path(key)).write_bytes(b"dust")
    async with shared.connect(damaged) as socket:
        await socket.send(json.dumps(HELLO))
        await refused(socket, "map_unusable", CloseCode.MAP_UNUSABLE)
    assert len(shared.parts.navigation) == len(
        [s for s in shared.parts.navigation._sessions.values() if str(s.route_id) != damaged]
    )


async def test_pages_of_other_sites_are_refused(shared: Service, route: str) -> None:
    async with shared.connect(route, origin="http://elsewhere.example") as socket:
        await refused(socket, "forbidden_origin", CloseCode.FORBIDDEN_ORIGIN)
    async with shared.connect(route, origin=shared.url) as socket:
        await hello(socket)


async def test_sockets_under_another_name_are_refused(shared: Service, route: str) -> None:
    """A page whose name was made to lead here has an origin that is its host."""
    port = int(shared.url.rpartition(":")[2])
    here = socketlib.create_connection(("127.0.0.1", port))
    url = f"ws://rebound.example:{port}/v1/routes/{route}/navigate"
    with pytest.raises(InvalidStatus) as refusal:
        async with connect(url, origin=Origin(f"http://rebound.example:{port}"), sock=here, proxy=None):
            pass
    assert refusal.value.response.status_code == 421
    assert refusal.value.response.headers["content-type"] == "application/problem+json"


async def test_end_is_answered_with_goodbye_and_forgets_the_session(shared: Service, route: str) -> None:
    async with shared.connect(route) as socket:
        token = (await hello(socket)).resume_token
        await send_picture(socket, 1)
        await update(socket)
        await socket.send('{"type": "end"}')
        goodbye = await receive(socket)
        assert isinstance(goodbye, Goodbye)
        assert (goodbye.reason, goodbye.may_resume, goodbye.frames.answered) == ("ended", False, 1)
        assert await closed_with(socket) == CloseCode.NORMAL
    async with shared.connect(route) as socket:
        assert not (await hello(socket, resume_token=token)).resumed


async def test_a_lost_connection_is_resumed_with_its_state(shared: Service, route: str) -> None:
    async with shared.connect(route) as socket:
        first = await hello(socket)
        for sequence in (1, 2):
            await send_picture(socket, sequence)
            await update(socket)
    async with shared.connect(route) as socket:
        again = await hello(socket, resume_token=first.resume_token)
        assert (again.resumed, again.session_id, again.last_sequence) == (True, first.session_id, 2)
        await send_picture(socket, 2)
        assert (await error(socket)).code == "stale_frame"
        await send_picture(socket, 3)
        answer = await update(socket)
        assert answer.fix is not None
        assert answer.fix.position[0] == 3.0  # the third picture of the session


async def test_a_token_opens_its_own_session_only(shared: Service, route: str) -> None:
    other = await shared.ready_route()
    async with shared.connect(route) as socket:
        welcome = await hello(socket)
        assert len(welcome.resume_token) >= 43
        for route_id, change in (
            (other, {}),
            (route, {"orientation": 90}),
            (route, {"resume_token": welcome.resume_token[:-1]}),
        ):
            async with shared.connect(route_id) as thief:
                greeting = await hello(thief, **{"resume_token": welcome.resume_token, **change})
                assert not greeting.resumed
                assert greeting.session_id != welcome.session_id
        await send_picture(socket, 1)
        await update(socket)


async def test_resuming_elsewhere_supersedes(shared: Service, route: str) -> None:
    async with shared.connect(route) as old:
        token = (await hello(old)).resume_token
        async with shared.connect(route) as new:
            assert (await hello(new, resume_token=token)).resumed
            goodbye = await receive(old)
            assert isinstance(goodbye, Goodbye)
            assert (goodbye.reason, goodbye.may_resume) == ("superseded", False)
            assert await closed_with(old) == CloseCode.SUPERSEDED
            await send_picture(new, 1)
            await update(new)


async def test_deleting_the_route_ends_its_sessions(shared: Service) -> None:
    doomed = await shared.ready_route()
    async with shared.connect(doomed) as socket:
        await hello(socket)
        await shared.http.delete(f"/v1/routes/{doomed}")
        goodbye = await receive(socket)
        assert isinstance(goodbye, Goodbye)
        assert await closed_with(socket) == CloseCode.ROUTE_DELETED


async def test_too_many_messages_end_the_connection(shared: Service, route: str) -> None:
    async with shared.connect(route, max_queue=None) as socket:
        await hello(socket)
        for number in range(60):
            await socket.send(json.dumps({"type": "ping", "id": number, "clock_us": 0}))
        for _ in range(40):
            assert isinstance(await receive(socket), Pong)
        while isinstance(message := await receive(socket), Pong):
            pass
        assert isinstance(message, ErrorMessage)
        assert message.code == "rate_exceeded"
        assert await closed_with(socket) == CloseCode.RATE_EXCEEDED


async def test_a_session_survives_the_death_of_its_process(shared: Service, route: str) -> None:
    async with shared.connect(route) as socket, shared.connect(route) as neighbour:
        await hello(socket)
        await hello(neighbour)
        for sequence in (1, 2):
            await send_picture(socket, sequence)
            await update(socket)
        os.kill(shared.parts.pool.pids[0], signal.SIGKILL)
        await asyncio.sleep(0.1)
        await send_picture(socket, 3)
        answer = await update(socket)
        assert answer.fix is not None
        assert answer.fix.position[0] == 3.0
        await send_picture(neighbour, 1)
        await update(neighbour)


async def test_pictures_that_kill_their_process_end_their_own_session_only(
    shared: Service, route: str
) -> None:
    async with shared.connect(route) as killer, shared.connect(route) as neighbour:
        await hello(killer)
        await hello(neighbour)
        for sequence in (1, 2, 3):
            await send_picture(killer, sequence, b"die!")
            assert (await error(killer)).code == "frame_lost"
        await send_picture(killer, 4)
        await refused(killer, "internal_error", CloseCode.INTERNAL_ERROR)
        await send_picture(neighbour, 1)
        await update(neighbour)


async def test_silence_ends_the_connection_and_pings_keep_it(data: Path) -> None:
    chosen = service.settings(data, idle_timeout_s=0.4, hello_timeout_s=0.3)
    async with service.running(chosen) as running:
        route_id = await running.ready_route()
        async with running.connect(route_id) as mute:
            await refused(mute, "bad_hello", CloseCode.BAD_MESSAGE)
        async with running.connect(route_id) as socket:
            welcome = await hello(socket)
            for number in range(4):
                await asyncio.sleep(0.2)
                await socket.send(json.dumps({"type": "ping", "id": number, "clock_us": 0}))
                assert isinstance(await receive(socket), Pong)
            await refused(socket, "idle_timeout", CloseCode.IDLE_TIMEOUT)
        async with running.connect(route_id) as socket:
            assert (await hello(socket, resume_token=welcome.resume_token)).resumed


async def test_sessions_expire_and_are_limited(data: Path) -> None:
    chosen = service.settings(data, resume_within_s=0.3, max_sessions=1)
    async with service.running(chosen) as running:
        route_id = await running.ready_route()
        async with running.connect(route_id) as socket:
            token = (await hello(socket)).resume_token
            async with running.connect(route_id) as late:
                await late.send(json.dumps(HELLO))
                await refused(late, "busy", CloseCode.BUSY)
        async with running.connect(route_id) as socket:
            assert (await hello(socket, resume_token=token)).resumed
        async with running.connect(route_id) as socket:
            # The waiting session makes room for one that is there.
            assert not (await hello(socket)).resumed
        async with asyncio.timeout(5):
            while len(running.parts.navigation):
                await asyncio.sleep(0.05)


async def test_a_client_that_never_reads_is_dropped(data: Path) -> None:
    chosen = service.settings(data, max_frames_per_second=100_000.0, max_messages_per_second=100_000.0)
    async with service.running(chosen) as running:
        route_id = await running.ready_route()
        # A queue of one message: the client's library stops reading from the network, whose buffer is small.
        small = socketlib.create_connection((chosen.host, int(running.url.rpartition(":")[2])))
        small.setsockopt(socketlib.SOL_SOCKET, socketlib.SO_RCVBUF, 4096)
        async with running.connect(route_id, max_queue=1, sock=small) as socket:
            await hello(socket)

            async def flood() -> None:
                while True:
                    await socket.send(json.dumps({"type": "ping", "id": 1, "clock_us": 0}))

            flooding = asyncio.create_task(flood())
            async with asyncio.timeout(10):
                while any(s.attachment for s in running.parts.navigation._sessions.values()):
                    await asyncio.sleep(0.05)
            flooding.cancel()
            socket.transport.abort()
            await asyncio.gather(flooding, return_exceptions=True)
        async with running.connect(route_id) as socket:
            await hello(socket)


async def test_the_service_says_goodbye_when_it_goes(data: Path) -> None:
    chosen = service.settings(data)
    async with service.running(chosen) as running:
        route_id = await running.ready_route()
        socket = await running.connect(route_id)
        await hello(socket)
    goodbye = await receive(socket)
    assert isinstance(goodbye, Goodbye)
    assert (goodbye.reason, goodbye.may_resume) == ("going_away", True)
    assert await closed_with(socket) == CloseCode.GOING_AWAY
