"""A route's quality report over HTTP, of ready and of failed routes; its pictures go with the route."""

from __future__ import annotations

from collections.abc import AsyncIterator
from pathlib import Path
from uuid import uuid4

import cv2
import numpy as np
import pytest
import service
from clips import write_pictures
from service import NEW_ROUTE, Service

from server.api.components import Entries
from server.protocol.quality import QualityDocument

pytestmark = pytest.mark.asyncio(loop_scope="module")


async def _judged(running: Service, video: bytes, state: str) -> tuple[str, QualityDocument]:
    route_id = await running.upload(video)
    await running.wait(route_id, state)
    response = await running.http.get(f"/v1/routes/{route_id}/quality")
    assert response.status_code == 200, response.text
    return route_id, QualityDocument.model_validate(response.json())


@pytest.mark.parametrize(("video", "state"), [(b"weak", "ready"), (b"blur", "failed")])
async def test_a_report_and_its_pictures_are_served(shared: Service, video: bytes, state: str) -> None:
    route_id, quality = await _judged(shared, video, state)
    assert [stretch.reason for stretch in quality.stretches] == ["blurred", "too_dark"]
    assert quality.picture == f"/v1/routes/{route_id}/quality.png"
    page = await shared.http.get(quality.picture)
    assert (page.headers["content-type"], page.content) == ("image/png", b"report.png")
    bare, pictured = (stretch.thumbnail for stretch in quality.stretches)
    assert bare is None
    assert pictured == f"/v1/routes/{route_id}/quality/2.jpg"
    thumbnail = await shared.http.get(pictured)
    assert (thumbnail.headers["content-type"], thumbnail.content) == ("image/jpeg", b"stretch-2.jpg")
    missing = await shared.http.get(f"/v1/routes/{route_id}/quality/1.jpg")
    assert (missing.status_code, missing.json()["code"]) == (404, "not_found")


async def test_pictures_are_known_objects_and_go_with_the_route(shared: Service) -> None:
    route_id, _ = await _judged(shared, b"weak", "ready")
    keys = set(await shared.parts.store.keys(f"routes/{route_id}"))
    assert len(keys) == 5
    async with shared.parts.database.begin() as unit:
        # What no route knows is swept away at the next start.
        assert keys <= await unit.builds.known_keys()
    await shared.http.delete(f"/v1/routes/{route_id}")
    assert await shared.parts.store.keys(f"routes/{route_id}") == []


async def test_another_video_takes_the_place_of_the_report(shared: Service) -> None:
    route_id, _ = await _judged(shared, b"blur", "failed")
    await shared.http.put(f"/v1/routes/{route_id}/video", content=b"good")
    await shared.wait(route_id, "ready")
    # The stub judges no good walk: what was said of the one before must not be said of it.
    refused = await shared.http.get(f"/v1/routes/{route_id}/quality")
    assert (refused.status_code, refused.json()["code"]) == (409, "route_not_ready")
    keys = await shared.parts.store.keys(f"routes/{route_id}")
    assert sorted(key.rpartition("/")[2].partition("-")[0] for key in keys) == ["map", "path", "video"]


async def test_a_picture_that_is_gone_is_said_to_be(shared: Service) -> None:
    route_id, quality = await _judged(shared, b"weak", "ready")
    await shared.parts.store.delete(await shared.parts.store.keys(f"routes/{route_id}"))
    response = await shared.http.get(str(quality.picture))
    assert (response.status_code, response.json()["code"]) == (424, "map_unusable")


async def test_routes_that_were_not_judged_have_no_report(shared: Service) -> None:
    route_id = (await shared.http.post("/v1/routes", json=NEW_ROUTE)).json()["id"]
    for document in ("quality", "quality.png", "quality/1.jpg"):
        response = await shared.http.get(f"/v1/routes/{route_id}/{document}")
        assert (response.status_code, response.json()["code"]) == (409, "route_not_ready")
        unknown = await shared.http.get(f"/v1/routes/{uuid4()}/{document}")
        assert (unknown.status_code, unknown.json()["code"]) == (404, "route_not_found")


@pytest.fixture
def dark_video(tmp_path: Path) -> bytes:
    """Three seconds with the lens covered."""
    pictures = [np.full((240, 320, 3), 4, np.uint8)] * 30
    return write_pictures(tmp_path / "dark.mp4", pictures).read_bytes()


@pytest.fixture
async def real(tmp_path: Path) -> AsyncIterator[Service]:
    """A service that builds in earnest."""
    chosen = service.settings(tmp_path / "data", max_video_bytes=5_000_000)
    async with service.running(chosen, Entries(engine="stub_core:StubEngine")) as running:
        yield running


@pytest.mark.asyncio(loop_scope="function")
async def test_a_real_build_that_fails_says_what_to_walk_again(real: Service, dark_video: bytes) -> None:
    route_id = (await real.http.post("/v1/routes", json=NEW_ROUTE)).json()["id"]
    camera = {"model": "PINHOLE", "width": 320, "height": 240, "params": [250.0, 250.0, 160.0, 120.0]}
    await real.http.put(f"/v1/routes/{route_id}/camera", json=camera)
    await real.http.put(f"/v1/routes/{route_id}/video", content=dark_video)
    failed = await real.wait(route_id, "failed", "ready")
    assert failed["failure"]["reason"] == "no_texture"
    response = await real.http.get(f"/v1/routes/{route_id}/quality")
    quality = QualityDocument.model_validate(response.json())
    (stretch,) = quality.stretches
    assert (stretch.reason, stretch.start_s) == ("too_dark", 0.0)
    assert stretch.end_s == pytest.approx(3.0, abs=0.11)
    assert "light" in stretch.detail
    assert quality.record_again
    page = await real.http.get(str(quality.picture))
    picture = cv2.imdecode(np.frombuffer(page.content, np.uint8), cv2.IMREAD_COLOR)
    assert picture is not None
    assert picture.shape[1] == 1430
    thumbnail = await real.http.get(str(stretch.thumbnail))
    small = cv2.imdecode(np.frombuffer(thumbnail.content, np.uint8), cv2.IMREAD_GRAYSCALE)
    assert small is not None
    assert small.shape == (192, 256)
    assert small.mean() < 20
