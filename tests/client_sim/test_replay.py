from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator
from pathlib import Path
from uuid import uuid4

import cv2
import numpy as np
import pytest
import pytest_asyncio
import service
from recorded_video import write_walk
from service import Service
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol

from client_sim.errors import (
    NavigationRefusedError,
    RouteFailedError,
    ServiceRefusedError,
    ServiceUnreachableError,
    WalkError,
)
from client_sim.follower import FollowerOptions, follow
from client_sim.leader import LeaderOptions, lead
from client_sim.network import NetworkConditions
from client_sim.outcome import FrameRecord
from client_sim.picture import draw_tracks, plane_from_above
from client_sim.service import ServiceClient
from client_sim.walk import Walk
from server.protocol.messages import UpdateMessage

pytestmark = pytest.mark.asyncio(loop_scope="module")

FRAMES = 24
FAST = FollowerOptions(speed=4.0)


@pytest_asyncio.fixture(loop_scope="module", scope="module")
async def shared(tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[Service]:
    async with service.running(service.settings(tmp_path_factory.mktemp("data"))) as running:
        yield running


@pytest_asyncio.fixture(loop_scope="module", scope="module")
async def route(shared: Service) -> str:
    return await shared.ready_route()


@pytest.fixture
def walk(tmp_path: Path) -> Walk:
    return Walk.from_folder(write_walk(tmp_path / "walk", frames=FRAMES, fps=10))


async def test_a_leader_uploads_and_waits_for_its_map(shared: Service, walk: Walk) -> None:
    sent: list[tuple[int, int]] = []
    stages: list[tuple[str, float]] = []
    async with ServiceClient(shared.url) as client:
        ready = await lead(
            client,
            walk,
            LeaderOptions("To the lab", "Door", "Lab", measured_length_m=9.0, poll_s=0.02),
            lambda done, total: sent.append((done, total)),
            lambda stage, fraction: stages.append((stage, fraction)),
        )
        assert (ready.state, ready.name, ready.start_label) == ("ready", "To the lab", "Door")
        size = walk.video.stat().st_size
        assert sent[-1] == (size, size)
        assert stages[-1] == ("finished", 1.0)
        assert (await client.routes()).routes[0].id == ready.id
        path = await client.path(ready.id)
        assert path.position[-1] == (0.0, 1.0, 0.0)
        await client.delete(ready.id)
        with pytest.raises(ServiceRefusedError) as refused:
            await client.route(ready.id)
        assert refused.value.problem.code == "route_not_found"


async def test_a_leader_is_told_why_there_is_no_map(shared: Service, walk: Walk) -> None:
    walk.video.write_bytes(b"bad!")
    async with ServiceClient(shared.url) as client:
        with pytest.raises(RouteFailedError, match="the walls are bare") as failed:
            await lead(client, walk, LeaderOptions(poll_s=0.02))
    assert failed.value.route.failure is not None
    assert failed.value.route.failure.reason == "no_texture"


async def test_a_follower_sends_every_picture_and_gets_every_answer(
    shared: Service, route: str, walk: Walk, tmp_path: Path
) -> None:
    seen: list[int] = []

    def listen(record: FrameRecord, update: UpdateMessage) -> None:
        seen.append(update.sequence)

    outcome = await follow(shared.url, route, walk, FAST, listen)
    summary = outcome.summary()
    assert (summary.frames, summary.sent, summary.answered, summary.relocalized) == (FRAMES,) * 4
    assert (summary.lost, summary.reconnections, summary.replaced) == ({}, 0, 0)
    assert seen == list(range(FRAMES))
    assert summary.arrived
    assert summary.relocalized_fraction == 1.0
    assert summary.age_p50_ms is not None
    assert summary.age_p95_ms is not None
    assert 0 < summary.age_p50_ms <= summary.age_p95_ms < 1000
    # 24 pictures at four times ten a second take 0.6 s, and the replay does not hurry.
    assert 0.55 < summary.seconds < 5

    outcome.write(tmp_path / "record.jsonl")
    lines = [json.loads(line) for line in (tmp_path / "record.jsonl").read_text().splitlines()]
    assert [line["frame_index"] for line in lines] == list(range(FRAMES))
    assert lines[3]["update"]["sequence"] == lines[3]["sequence"] == 3
    assert lines[3]["video_time"] == pytest.approx(0.3, abs=1e-3)


async def test_the_clock_of_pictures_keeps_the_videos_pace(shared: Service, route: str, walk: Walk) -> None:
    outcome = await follow(shared.url, route, walk, FAST)
    answered = [(r.update.capture_time_us, r.video_time) for r in outcome.records if r.update is not None]
    stamps, times = np.array(answered).T
    assert len(answered) > FRAMES // 2
    assert stamps - stamps[0] == pytest.approx(1e6 * (times - times[0]), abs=2)


async def test_a_bad_network_loses_the_same_pictures_every_time(
    shared: Service, route: str, walk: Walk
) -> None:
    options = FollowerOptions(
        speed=4.0, seed=7, network=NetworkConditions(loss=0.25, delay_s=0.04, jitter_s=0.005)
    )
    first, second = [await follow(shared.url, route, walk, options) for _ in range(2)]
    lost = [r.frame_index for r in first.records if r.lost == "network"]
    assert lost == [r.frame_index for r in second.records if r.lost == "network"]
    assert 1 <= len(lost) <= 14
    summary = first.summary()
    assert summary.sent == FRAMES - len(lost)
    assert summary.age_p50_ms is not None
    assert summary.age_p50_ms > 80  # 40 ms each way


async def test_reordered_pictures_are_stale_and_do_not_disturb(
    shared: Service, route: str, walk: Walk
) -> None:
    network = NetworkConditions(reorder=0.3, holdup_s=0.1)
    outcome = await follow(shared.url, route, walk, FollowerOptions(speed=4.0, seed=3, network=network))
    summary = outcome.summary()
    assert summary.lost.get("stale_frame", 0) >= 2
    assert summary.answered + sum(summary.lost.values()) == FRAMES
    assert summary.answered >= FRAMES // 2


async def test_a_broken_connection_is_resumed(shared: Service, route: str, walk: Walk) -> None:
    broken = False

    def break_once(record: FrameRecord, update: UpdateMessage) -> None:
        nonlocal broken
        if record.sequence == 8 and not broken:
            broken = True
            for connection in list(shared.server.server_state.connections):
                if isinstance(connection, WebSocketsSansIOProtocol):
                    connection.transport.abort()

    outcome = await follow(shared.url, route, walk, FollowerOptions(speed=2.0), break_once)
    summary = outcome.summary()
    assert broken
    assert summary.reconnections == 1
    assert summary.lost.get("unconnected", 0) >= 1
    last = outcome.records[-1].update
    assert last is not None
    # One session all along: the engine has counted the pictures of both connections.
    assert last.fix is not None
    assert last.fix.position[0] == summary.answered


async def test_refusals_reach_the_caller(shared: Service, route: str, walk: Walk) -> None:
    with pytest.raises(NavigationRefusedError) as unknown:
        await follow(shared.url, str(uuid4()), walk, FAST)
    assert (unknown.value.code, unknown.value.close_code) == ("unknown_route", 4404)
    with pytest.raises(ServiceUnreachableError):
        await follow("http://127.0.0.1:9", route, walk, FAST)
    async with ServiceClient("http://127.0.0.1:9") as nobody:
        with pytest.raises(ServiceUnreachableError):
            await nobody.routes()
    walk.video.write_bytes(b"not a video")
    with pytest.raises(WalkError):
        await follow(shared.url, route, walk, FAST)


async def test_deleting_the_route_ends_the_follower(shared: Service, walk: Walk) -> None:
    doomed = await shared.ready_route()
    task = asyncio.create_task(follow(shared.url, doomed, walk, FollowerOptions(speed=1.0)))
    await asyncio.sleep(0.7)
    await shared.http.delete(f"/v1/routes/{doomed}")
    with pytest.raises(NavigationRefusedError) as ended:
        await task
    assert (ended.value.code, ended.value.close_code) == ("route_deleted", 4410)


async def test_the_picture_is_drawn(shared: Service, route: str, walk: Walk, tmp_path: Path) -> None:
    outcome = await follow(shared.url, route, walk, FAST)
    async with ServiceClient(shared.url) as client:
        document, path = await client.route(route), await client.path(route)
    bare, told = tmp_path / "new" / "bare.png", tmp_path / "told.png"
    draw_tracks(document, path, outcome, bare)
    draw_tracks(document, path, outcome, told, walk=walk)
    images = [cv2.imread(str(picture)) for picture in (bare, told)]
    for image in images:
        assert image is not None
        assert image.shape[1] == 1680
        assert len(np.unique(image.reshape(-1, 3), axis=0)) > 100
    # The strip of the follower's pictures comes below.
    assert images[1].shape[0] > images[0].shape[0] + 200


@pytest.mark.parametrize("tilt", [0.0, 0.4, -0.7])
async def test_seen_from_above_a_left_turn_stays_a_left_turn(tilt: float) -> None:
    straight = np.stack([np.linspace(0, 9, 50), np.zeros(50), np.zeros(50)], axis=1)
    left = np.stack([np.full(20, 9.0), np.linspace(0, 3, 20), np.zeros(20)], axis=1)
    turn = np.array([[1, 0, 0], [0, np.cos(tilt), -np.sin(tilt)], [0, np.sin(tilt), np.cos(tilt)]])
    walked = np.vstack([straight, left]) @ turn.T
    flat = walked @ plane_from_above(walked).T
    before, after = flat[40] - flat[0], flat[-1] - flat[52]
    assert before[0] * after[1] - before[1] * after[0] > 0
    # The plane is the path's own: seen from above no length is lost.
    assert np.linalg.norm(before) == pytest.approx(np.linalg.norm(walked[40] - walked[0]), rel=1e-9)
