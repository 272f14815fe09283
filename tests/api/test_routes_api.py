from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator
from datetime import UTC, datetime
from pathlib import Path
from uuid import UUID, uuid4

import httpx
import pytest
import service
from service import CAMERA, NEW_ROUTE, Service

from server.api import problems
from server.storage.database import Database
from server.storage.records import RouteState

pytestmark = pytest.mark.asyncio(loop_scope="module")


PROTOCOL = (Path(__file__).parents[2] / "docs" / "protocol.md").read_text(encoding="utf-8")

JSON = {"Content-Type": "application/json"}


def assert_problem(response: httpx.Response, status: int, code: str) -> dict[str, object]:
    assert response.status_code == status, response.text
    assert response.headers["content-type"] == "application/problem+json"
    document: dict[str, object] = response.json()
    assert document["type"] == f"urn:pairnavi:problem:{code}"
    assert document["code"] == code
    assert document["status"] == status
    assert document["detail"]
    return document


async def test_a_camera_and_a_video_become_a_ready_route(shared: Service) -> None:
    created = await shared.http.post("/v1/routes", json={**NEW_ROUTE, "measured_length_m": 12.5})
    assert created.status_code == 201
    route = created.json()
    assert created.headers["location"] == f"/v1/routes/{route['id']}"
    assert (route["state"], route["has_camera"], route["video_bytes"]) == ("created", False, None)

    url = f"/v1/routes/{route['id']}"
    described = (await shared.http.put(f"{url}/camera", json=CAMERA)).json()
    assert (described["state"], described["has_camera"]) == ("created", True)
    uploaded = (await shared.http.put(f"{url}/video", content=b"good" + b"x" * 50_000)).json()
    assert (uploaded["state"], uploaded["video_bytes"]) == ("uploaded", 50_004)

    ready = await shared.wait(route["id"], "ready", "failed")
    assert ready["state"] == "ready"
    assert ready["build"] == {"stage": "finished", "fraction": 1.0, "attempt": 1}
    assert ready["report"]["lost"] == [{"start_s": 0.1, "end_s": 0.2}]
    assert (ready["report"]["camera"]["params"], ready["report"]["camera_source"]) == (
        CAMERA["params"],
        "given",
    )
    assert ready["map"]["length_m"] == 12.5
    path = (await shared.http.get(f"{url}/path")).json()
    assert path["position"] == [[0, 0, 0], [0, 1, 0]]
    downloaded = await shared.http.get(f"{url}/map")
    assert downloaded.content == b"MAPgood" + b"x" * 60
    assert ready["map"]["bytes"] == len(downloaded.content) == int(downloaded.headers["content-length"])


async def test_a_video_without_a_camera_becomes_a_ready_route(shared: Service) -> None:
    route_id = (await shared.http.post("/v1/routes", json=NEW_ROUTE)).json()["id"]
    done = await shared.http.put(f"/v1/routes/{route_id}/video", content=b"good")
    assert done.json()["state"] == "uploaded"
    ready = await shared.wait(route_id, "ready", "failed")
    assert (ready["state"], ready["has_camera"]) == ("ready", False)
    assert (ready["report"]["camera"], ready["report"]["camera_source"]) == (None, "assumed")


async def test_a_camera_that_comes_after_the_video_is_refused(shared: Service) -> None:
    route_id = (await shared.http.post("/v1/routes", json=NEW_ROUTE)).json()["id"]
    url = f"/v1/routes/{route_id}"
    await shared.http.put(f"{url}/video", content=b"slow")
    assert_problem(await shared.http.put(f"{url}/camera", json=CAMERA), 409, "route_state")
    await shared.wait(route_id, "building")
    assert_problem(await shared.http.put(f"{url}/camera", json=CAMERA), 409, "route_state")
    assert (await shared.http.delete(url)).status_code == 204


async def test_a_failed_build_is_tried_again_with_another_camera(shared: Service) -> None:
    route_id = await shared.upload(b"cam!")
    url = f"/v1/routes/{route_id}"
    failed = await shared.wait(route_id, "failed", "ready")
    assert failed["failure"]["reason"] == "camera_mismatch"
    other = {**CAMERA, "width": 480, "height": 640, "params": [500.0, 500.0, 240.0, 320.0]}
    queued = (await shared.http.put(f"{url}/camera", json=other)).json()
    assert (queued["state"], queued["failure"], queued["video_bytes"]) == ("uploaded", None, 4)
    ready = await shared.wait(route_id, "ready", "failed")
    assert ready["report"]["camera"]["width"] == 480


async def test_a_failed_build_says_why_and_takes_another_video(shared: Service) -> None:
    route_id = await shared.upload(b"bad!")
    failed = await shared.wait(route_id, "failed", "ready")
    assert failed["failure"] == {"reason": "no_texture", "detail": "the walls are bare"}
    assert failed["report"]["frames"] == 3
    refused = await shared.http.get(f"/v1/routes/{route_id}/map")
    assert "the walls are bare" in str(assert_problem(refused, 409, "route_not_ready")["detail"])

    again = (await shared.http.put(f"/v1/routes/{route_id}/video", content=b"good")).json()
    assert (again["state"], again["failure"], again["report"]) == ("uploaded", None, None)
    await shared.wait(route_id, "ready")
    keys = await shared.parts.store.keys(f"routes/{route_id}")
    assert sorted(key.rpartition("/")[2].partition("-")[0] for key in keys) == ["map", "path", "video"]


@pytest.mark.parametrize(("video", "how"), [(b"die!", "code 7"), (b"raise", "code 1")])
async def test_a_build_process_that_dies_fails_its_route_only(
    shared: Service, video: bytes, how: str, capfd: pytest.CaptureFixture[str]
) -> None:
    dead = await shared.wait(await shared.upload(video), "failed", "ready")
    assert dead["failure"]["reason"] == "build_process_died"
    assert how in dead["failure"]["detail"]
    await shared.ready_route()


async def test_progress_is_seen_while_building_and_deletion_stops_it(shared: Service) -> None:
    route_id = await shared.upload(b"slow")
    building = await shared.wait(route_id, "building")
    async with asyncio.timeout(10):
        while building["build"]["stage"] != "tracking":
            building = (await shared.http.get(f"/v1/routes/{route_id}")).json()
    assert building["build"] == {"stage": "tracking", "fraction": 0.25, "attempt": 1}
    assert (await shared.http.get("/v1/health")).json()["builds"] == 1
    assert_problem(await shared.http.put(f"/v1/routes/{route_id}/video", content=b"x"), 409, "route_state")
    assert_problem(await shared.http.get(f"/v1/routes/{route_id}/map"), 409, "route_not_ready")

    assert (await shared.http.delete(f"/v1/routes/{route_id}")).status_code == 204
    assert shared.parts.jobs.running == 0
    assert await shared.parts.store.keys(f"routes/{route_id}") == []
    assert_problem(await shared.http.get(f"/v1/routes/{route_id}"), 404, "route_not_found")
    await shared.ready_route()


async def test_routes_are_listed_in_pages_newest_first(data: Path) -> None:
    async with service.running(service.settings(data)) as running:
        made = [(await running.http.post("/v1/routes", json=NEW_ROUTE)).json()["id"] for _ in range(5)]
        seen: list[str] = []
        cursor: str | None = None
        for _ in range(3):
            parameters = {"limit": "2"} | ({} if cursor is None else {"cursor": cursor})
            page = (await running.http.get("/v1/routes", params=parameters)).json()
            seen += [route["id"] for route in page["routes"]]
            cursor = page["next"]
        assert cursor is None
        assert seen == made[::-1]


async def test_a_map_whose_file_is_gone_is_unusable(shared: Service) -> None:
    route_id = await shared.ready_route()
    await shared.parts.store.delete(await shared.parts.store.keys(f"routes/{route_id}"))
    for document in ("map", "path"):
        response = await shared.http.get(f"/v1/routes/{route_id}/{document}")
        assert_problem(response, 424, "map_unusable")


async def test_every_refusal_is_a_problem_document(shared: Service) -> None:
    http = shared.http
    unknown = f"/v1/routes/{uuid4()}"
    assert_problem(await http.get(unknown), 404, "route_not_found")
    assert_problem(await http.delete(unknown), 404, "route_not_found")
    assert_problem(await http.put(f"{unknown}/video", content=b"x"), 404, "route_not_found")
    assert_problem(await http.put(f"{unknown}/camera", json=CAMERA), 404, "route_not_found")
    assert_problem(await http.get("/v1/nothing"), 404, "not_found")
    patched = await http.patch("/v1/routes")
    assert_problem(patched, 405, "method_not_allowed")
    assert patched.headers["allow"] == "GET, POST"
    posted = await http.post(unknown, json={})
    assert_problem(posted, 405, "method_not_allowed")
    assert posted.headers["allow"] == "DELETE, GET"
    assert_problem(await http.get("/v1/routes/"), 404, "not_found")
    assert_problem(await http.get("/v1/routes/not-an-id"), 422, "invalid_request")
    invalid = assert_problem(
        await http.post("/v1/routes", json={**NEW_ROUTE, "name": " "}), 422, "invalid_request"
    )
    assert invalid["errors"] == [
        {
            "location": ["body", "name"],
            "type": "string_too_short",
            "message": "String should have at least 1 character",
        }
    ]
    assert_problem(await http.post("/v1/routes", content=b"{", headers=JSON), 422, "invalid_request")
    assert_problem(await http.get("/v1/routes", params={"cursor": "x"}), 422, "cursor_invalid")
    assert_problem(await http.get("/v1/routes", params={"limit": "0"}), 422, "invalid_request")


@pytest.mark.parametrize(
    "content_type", [None, "", "text/plain", "application/x-www-form-urlencoded", "json", "image/svg+json"]
)
async def test_documents_have_to_be_sent_as_json(shared: Service, content_type: str | None) -> None:
    headers = {} if content_type is None else {"Content-Type": content_type}
    body = json.dumps(NEW_ROUTE).encode()
    refusal = await shared.http.post("/v1/routes", content=body, headers=headers)
    assert "application/json" in str(assert_problem(refusal, 415, "unsupported_media_type")["detail"])
    camera = f"/v1/routes/{uuid4()}/camera"
    refusal = await shared.http.put(camera, content=json.dumps(CAMERA).encode(), headers=headers)
    assert_problem(refusal, 415, "unsupported_media_type")


@pytest.mark.parametrize("content_type", ["application/json; charset=utf-8", "Application/JSON"])
async def test_json_has_more_than_one_spelling(shared: Service, content_type: str) -> None:
    body = json.dumps(NEW_ROUTE).encode()
    created = await shared.http.post("/v1/routes", content=body, headers={"Content-Type": content_type})
    assert created.status_code == 201


@pytest.mark.parametrize(
    "host", ["rebound.example", "rebound.example:80", "localhost.rebound.example", "127.0.0.1@x", "", "[::2]"]
)
async def test_other_names_are_refused(shared: Service, host: str) -> None:
    for path in ("/v1/health", "/v1/routes", "/v1/openapi.json", "/v1/nothing"):
        assert_problem(await shared.http.get(path, headers={"Host": host}), 421, "host_not_allowed")


@pytest.mark.parametrize("host", ["127.0.0.1", "LOCALHOST:1234", "[::1]:8000"])
async def test_own_names_are_answered(shared: Service, host: str) -> None:
    assert (await shared.http.get("/v1/health", headers={"Host": host})).status_code == 200


async def test_names_can_be_set(data: Path) -> None:
    async with service.running(service.settings(data, allowed_hosts="Way.example, [fe80::1]")) as running:
        for host, status in (("way.example", 200), ("[fe80::1]:80", 200), ("localhost", 421)):
            assert (await running.http.get("/v1/health", headers={"Host": host})).status_code == status


async def test_every_problem_is_documented() -> None:
    known = {code: int(status) for code, status in problems._DOMAIN_STATUS.items()}
    known |= {code: status for status, code in problems._HTTP_CODES.items()}
    for code, status in known.items():
        assert f"| {status} | `{code}` |" in PROTOCOL


async def test_sizes_are_limited(shared: Service) -> None:
    http = shared.http
    route_id = (await http.post("/v1/routes", json=NEW_ROUTE)).json()["id"]
    video = f"/v1/routes/{route_id}/video"

    async def endless() -> AsyncIterator[bytes]:
        for _ in range(40):
            yield b"x" * 10_000

    assert_problem(await http.put(video, content=b"x" * 100_001), 413, "upload_too_large")
    assert_problem(await http.put(video, content=endless()), 413, "upload_too_large")
    assert_problem(await http.put(video, content=b""), 400, "upload_incomplete")
    assert_problem(await http.post("/v1/routes", content=b" " * 100_000), 413, "body_too_large")
    assert_problem(await http.post("/v1/routes", content=endless()), 413, "body_too_large")
    assert await shared.parts.store.keys(f"routes/{route_id}") == []


@pytest.mark.parametrize(
    "change",
    [{"params": [1, 1, 1, 1]}, {"params": [500, 500, 320]}, {"model": "FISHEYE"}, {"width": 3}],
)
async def test_a_camera_that_cannot_be_is_refused(shared: Service, change: dict[str, object]) -> None:
    route_id = (await shared.http.post("/v1/routes", json=NEW_ROUTE)).json()["id"]
    response = await shared.http.put(f"/v1/routes/{route_id}/camera", json={**CAMERA, **change})
    assert_problem(response, 422, "camera_invalid")


async def test_an_upload_that_breaks_off_leaves_nothing(shared: Service) -> None:
    route_id = (await shared.http.post("/v1/routes", json=NEW_ROUTE)).json()["id"]
    host, _, port = shared.url.removeprefix("http://").partition(":")
    _, writer = await asyncio.open_connection(host, int(port))
    head = f"PUT /v1/routes/{route_id}/video HTTP/1.1\r\nHost: localhost\r\nContent-Length: 90000\r\n\r\n"
    writer.write(head.encode() + b"x" * 5000)
    await writer.drain()
    writer.close()
    await writer.wait_closed()
    await asyncio.sleep(0.3)
    assert await shared.parts.store.keys(f"routes/{route_id}") == []
    assert (await shared.http.get(f"/v1/routes/{route_id}")).json()["video_bytes"] is None
    assert list((shared.parts.settings.data_dir / "store" / "unfinished").iterdir()) == []


async def test_health_and_description(shared: Service) -> None:
    health = (await shared.http.get("/v1/health")).json()
    assert (health["status"], health["database"], health["navigation_workers"]) == ("ok", True, 1)
    paths = (await shared.http.get("/v1/openapi.json")).json()["paths"]
    assert "/v1/routes/{route_id}/video" in paths


async def test_a_restart_takes_up_unfinished_builds(data: Path) -> None:
    chosen = service.settings(data)
    async with service.running(chosen) as first:
        route_id = await first.upload(b"slow")
        await first.wait(route_id, "building")
        other = await first.upload(b"good")
        video = next(key for key in await first.parts.store.keys(f"routes/{route_id}"))
    # The service has gone while one build ran and one waited. The first video no longer is slow.
    (data / "store" / "objects" / video).write_bytes(b"good")
    async with service.running(chosen) as second:
        taken_up = await second.wait(route_id, "ready", "failed")
        assert (taken_up["state"], taken_up["build"]["attempt"]) == ("ready", 1)
        assert (await second.wait(other, "ready", "failed"))["build"]["attempt"] == 1


async def test_a_video_that_never_ends_is_given_up(data: Path) -> None:
    async with service.running(service.settings(data, build_timeout_s=1.0)) as running:
        failed = await running.wait(await running.upload(b"slow"), "failed")
        assert failed["failure"]["reason"] == "timed_out"


async def test_a_build_begun_too_often_is_given_up(data: Path) -> None:
    chosen = service.settings(data, max_build_attempts=1)
    async with service.running(chosen) as first:
        route_id = await first.upload(b"slow")
        await first.wait(route_id, "building")
    # As a service leaves it that was killed in the middle of the build.
    database = Database(chosen.resolved_database_url)
    async with database.begin() as unit:
        await unit.builds.change(
            UUID(route_id),
            [RouteState.UPLOADED],
            datetime.now(UTC),
            state=RouteState.BUILDING,
            build_attempt=1,
        )
    await database.close()
    async with service.running(chosen) as second:
        assert (await second.wait(route_id, "failed"))["failure"]["reason"] == "gave_up"
