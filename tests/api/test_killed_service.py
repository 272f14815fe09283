"""A service that is killed at the worst moment, and one whose disk is full: nothing stored is lost."""

from __future__ import annotations

import http.client
import json
import os
import signal
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import httpx
import pytest
from served import Served, served
from service import CAMERA, HELLO, NEW_ROUTE
from websockets.sync.client import connect

from server.protocol.frames import Frame, encode_frame

STUBS = ("stub_core:build", "stub_core:StubEngine")


@contextmanager
def running(data: Path, **settings: object) -> Iterator[tuple[Served, httpx.Client]]:
    with (
        served(data, *STUBS, **settings) as service,
        httpx.Client(base_url=service.url, trust_env=False, timeout=20) as client,
    ):
        yield service, client


def create(client: httpx.Client) -> str:
    route: str = client.post("/v1/routes", json=NEW_ROUTE).raise_for_status().json()["id"]
    return route


def upload(client: httpx.Client, video: bytes) -> str:
    route = create(client)
    client.put(f"/v1/routes/{route}/camera", json=CAMERA).raise_for_status()
    client.put(f"/v1/routes/{route}/video", content=video).raise_for_status()
    return route


def wait(client: httpx.Client, route: str, state: str) -> dict[str, Any]:
    deadline = time.monotonic() + 30
    while True:
        document: dict[str, Any] = client.get(f"/v1/routes/{route}").json()
        if document["state"] == state:
            return document
        assert time.monotonic() < deadline, document
        time.sleep(0.05)


def half_an_upload(service: Served, route: str) -> http.client.HTTPConnection:
    """Half of a video is sent and has arrived; the connection stays open."""
    host, _, port = service.url.removeprefix("http://").partition(":")
    connection = http.client.HTTPConnection(host, int(port))
    connection.putrequest("PUT", f"/v1/routes/{route}/video")
    connection.putheader("Content-Length", "200000")
    connection.endheaders(b"good" + bytes(100_000))
    return connection


def files(data: Path, folder: str) -> list[str]:
    return sorted(path.name for path in (data / "store" / folder).rglob("*") if path.is_file())


def until(condition: Any) -> None:
    deadline = time.monotonic() + 15
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.05)


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGTERM])
def test_an_upload_that_a_restart_cuts_off_leaves_nothing(tmp_path: Path, how: signal.Signals) -> None:
    with running(tmp_path) as (service, client):
        ready = upload(client, b"good")
        wait(client, ready, "ready")
        stored = files(tmp_path, "objects")
        route = create(client)
        connection = half_an_upload(service, route)
        until(lambda: files(tmp_path, "unfinished"))
        service.process.send_signal(how)
        service.process.wait(15)
        connection.close()
    with running(tmp_path) as (_, client):
        assert files(tmp_path, "unfinished") == []
        assert files(tmp_path, "objects") == stored
        assert client.get(f"/v1/routes/{route}").json()["video_bytes"] is None
        assert client.get(f"/v1/routes/{ready}/map").content == b"MAPgood"
        client.put(f"/v1/routes/{route}/video", content=b"good").raise_for_status()
        wait(client, route, "ready")


def test_a_build_that_was_killed_with_the_service_is_built_again(tmp_path: Path) -> None:
    with running(tmp_path) as (service, client):
        route = upload(client, b"slow")
        wait(client, route, "building")
        until(lambda: client.get(f"/v1/routes/{route}").json()["build"]["stage"] == "tracking")
        service.process.kill()
        service.process.wait(15)
    (video,) = (tmp_path / "store" / "objects" / "routes" / route).glob("video-*")
    video.write_bytes(b"good")
    with running(tmp_path) as (_, client):
        assert wait(client, route, "ready")["build"]["attempt"] == 2
        assert files(tmp_path, "unfinished") == []


def test_a_follower_goes_on_with_the_next_service(tmp_path: Path) -> None:
    """Its session died with the process: it is greeted as a new one, on the same route."""
    token = None
    route = ""
    for _ in range(2):
        with running(tmp_path) as (service, client):
            if not route:
                route = upload(client, b"good")
                wait(client, route, "ready")
            url = f"{service.url.replace('http', 'ws', 1)}/v1/routes/{route}/navigate"
            with connect(url, proxy=None) as socket:
                socket.send(json.dumps({**HELLO, "resume_token": token}))
                welcome = json.loads(socket.recv(10))
                assert (welcome["type"], welcome["resumed"]) == ("welcome", False)
                token = welcome["resume_token"]
                socket.send(encode_frame(Frame(1, 1000, b"\xff\xd8")))
                assert json.loads(socket.recv(10))["type"] == "update"
                service.process.kill()
                service.process.wait(15)


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="only Linux limits another process")
def test_a_full_disk_is_said_and_nothing_is_half_stored(tmp_path: Path) -> None:
    import resource

    with running(tmp_path) as (service, client):
        ready = upload(client, b"good")
        wait(client, ready, "ready")
        stored = files(tmp_path, "objects")
        route = create(client)
        # No file may grow beyond this: what a full disk does, without one.
        before = resource.prlimit(
            service.process.pid, resource.RLIMIT_FSIZE, (150_000, resource.RLIM_INFINITY)
        )
        refused = client.put(f"/v1/routes/{route}/video", content=bytes(400_000))
        assert (refused.status_code, refused.json()["code"]) == (507, "storage_full")
        assert files(tmp_path, "unfinished") == []
        assert files(tmp_path, "objects") == stored
        assert client.get("/v1/health").json()["status"] == "ok"
        assert client.get(f"/v1/routes/{ready}/map").content == b"MAPgood"
        resource.prlimit(service.process.pid, resource.RLIMIT_FSIZE, before)
        client.put(f"/v1/routes/{route}/video", content=b"good" + bytes(400_000)).raise_for_status()
        wait(client, route, "ready")


def test_a_service_that_is_stopped_leaves_no_process(tmp_path: Path) -> None:
    with running(tmp_path) as (service, client):
        wait(client, upload(client, b"slow"), "building")
        children = [
            int(child)
            for task in Path(f"/proc/{service.process.pid}/task").iterdir()
            for child in (task / "children").read_text().split()
        ]
        assert len(children) >= 2
        service.process.terminate()
        assert service.process.wait(20) in (0, -signal.SIGTERM)
        until(lambda: not any(map(is_running, children)))


def is_running(pid: int) -> bool:
    try:
        os.kill(pid, 0)
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except (ProcessLookupError, FileNotFoundError):
        return False
