"""Maps whose files go bad while they are served, through the real navigation process."""

from __future__ import annotations

import json
import shutil
from collections.abc import AsyncIterator, Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
import pytest_asyncio
import service
from demo_route import DemoRoute
from service import Service, closed_with, hello, receive
from websockets.asyncio.client import ClientConnection

from server.api.components import Entries
from server.mapping.video import read_frames
from server.protocol.close_codes import CloseCode
from server.protocol.frames import Frame, encode_frame
from server.protocol.messages import ErrorMessage, UpdateMessage

pytestmark = pytest.mark.asyncio(loop_scope="module")


@pytest_asyncio.fixture(loop_scope="module", scope="module")
async def real(tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[Service]:
    chosen = service.settings(tmp_path_factory.mktemp("data"))
    async with service.running(chosen, Entries(builder="prebuilt_map:build")) as running:
        yield running


@pytest.fixture(scope="module")
def pictures(demo_route: DemoRoute) -> list[bytes]:
    """Pictures of the leader's walk: they are found on its map."""
    taken = []
    for frame in read_frames(demo_route.leader.video):
        if frame.index % 10 == 5:
            taken.append(cv2.imencode(".jpg", frame.image)[1].tobytes())
    return taken


async def mapped(real: Service, demo_route: DemoRoute) -> tuple[str, Path]:
    """A ready route and the file of its map."""
    route = await real.upload(str(demo_route.map_file).encode())
    await real.wait(route, "ready")
    (key,) = [key for key in await real.parts.store.keys(f"routes/{route}") if "/map-" in key]
    return route, await real.parts.store.local_path(key)


async def answered(socket: ClientConnection, sequence: int, picture: bytes) -> UpdateMessage | ErrorMessage:
    await socket.send(encode_frame(Frame(sequence, sequence * 1_000_000, picture)))
    message = await receive(socket)
    assert isinstance(message, UpdateMessage | ErrorMessage), message
    return message


def truncate(path: Path) -> None:
    with path.open("r+b") as file:
        file.truncate(4096)


def overwrite(path: Path) -> None:
    size = path.stat().st_size
    with path.open("r+b") as file:
        file.seek(size // 10)
        file.write(np.random.default_rng(1).bytes(size - size // 10))


def later_version(path: Path) -> None:
    data = path.read_bytes()
    length = int.from_bytes(data[:8], "little")
    header = json.loads(data[8 : 8 + length])
    header["__metadata__"]["version"] = "2"
    text = json.dumps(header).encode()
    newer = path.with_suffix(".new")
    newer.write_bytes(len(text).to_bytes(8, "little") + text + data[8 + length :])
    newer.replace(path)


@pytest.mark.parametrize("damage", [truncate, overwrite, later_version, Path.unlink])
async def test_a_map_that_goes_bad_is_said_and_other_routes_go_on(
    real: Service,
    demo_route: DemoRoute,
    pictures: list[bytes],
    damage: Callable[[Path], None],
    tmp_path: Path,
    capfd: pytest.CaptureFixture[str],
) -> None:
    sound, _ = await mapped(real, demo_route)
    damaged, map_file = await mapped(real, demo_route)
    shutil.copy(map_file, tmp_path / "copy")
    async with real.connect(damaged) as socket, real.connect(sound) as neighbour:
        await hello(socket)
        await hello(neighbour)
        for sequence in (1, 2):
            for each in (socket, neighbour):
                first = await answered(each, sequence, pictures[sequence])
                assert isinstance(first, UpdateMessage)
                assert first.fix is not None
        damage(map_file)
        # Its follower goes on with what was read, is refused, or is told that the map is bad: no nonsense.
        for sequence in range(3, 3 + 8):
            reply = await answered(socket, sequence, pictures[sequence])
            if isinstance(reply, UpdateMessage):
                assert reply.fix is None or on_route(reply, demo_route)
            elif reply.fatal:
                assert reply.code == "map_unusable"
                assert await closed_with(socket) == CloseCode.MAP_UNUSABLE
                break
            else:
                assert reply.code == "frame_lost"
        async with real.connect(damaged) as late:
            await late.send(json.dumps(service.HELLO))
            refusal = await receive(late)
            assert isinstance(refusal, ErrorMessage)
            assert refusal.code == "map_unusable"
            assert str(tmp_path.parents[2]) not in refusal.detail
            assert await closed_with(late) == CloseCode.MAP_UNUSABLE
        # The neighbour may have lost a picture with the process, not its session.
        replies = [await answered(neighbour, sequence, pictures[sequence]) for sequence in (3, 4, 5)]
        assert isinstance(replies[-1], UpdateMessage)
        assert replies[-1].fix is not None
        assert replies[-1].state == "on_route"


def on_route(reply: UpdateMessage, demo_route: DemoRoute) -> bool:
    assert reply.fix is not None
    path = demo_route.route_map.path
    away = np.linalg.norm(path.position - np.array(reply.fix.position), axis=1).min()
    return bool(away < 0.2)
