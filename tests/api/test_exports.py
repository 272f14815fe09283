"""Exports of a route over HTTP: a real map, the real export process."""

from __future__ import annotations

import io
import tempfile
import zipfile
from collections.abc import AsyncIterator
from pathlib import Path
from typing import get_args
from uuid import uuid4

import demo_service
import numpy as np
import pycolmap
import pytest
import pytest_asyncio
import trimesh
from demo_route import DemoRoute
from demo_service import DemoService

from server.services.errors import TooManyExportsError
from server.services.exports import ExportName
from server.workers import exports
from server.workers.exports import ExportFailedError, ProcessExporter

pytestmark = pytest.mark.asyncio(loop_scope="module")


@pytest_asyncio.fixture(loop_scope="module", scope="module")
async def served(
    demo_route: DemoRoute, tmp_path_factory: pytest.TempPathFactory
) -> AsyncIterator[DemoService]:
    async with demo_service.serving(demo_route, tmp_path_factory.mktemp("data")) as running:
        yield running


@pytest.fixture
def temporary(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder of temporary files, for this test alone."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    return tmp_path


def left_in(folder: Path) -> list[Path]:
    return list(folder.iterdir())


async def test_a_route_is_exported_in_every_format(
    served: DemoService, demo_route: DemoRoute, tmp_path: Path, temporary: Path
) -> None:
    route_map, content = demo_route.route_map, {}
    for name in get_args(ExportName):
        answer = await served.service.http.get(f"/v1/routes/{served.route_id}/export/{name}", timeout=60)
        assert answer.status_code == 200, answer.text
        assert answer.headers["content-disposition"] == f'attachment; filename="{served.route_id}-{name}"'
        assert int(answer.headers["content-length"]) == len(answer.content)
        content[name] = answer.content
    assert left_in(temporary) == []

    zipfile.ZipFile(io.BytesIO(content["colmap.zip"])).extractall(tmp_path / "colmap")
    reconstruction = pycolmap.Reconstruction(tmp_path / "colmap" / "sparse" / "0")
    assert reconstruction.num_images() == len(route_map.keyframes)
    assert reconstruction.num_points3D() == len(route_map.landmarks)
    assert "map units" in (tmp_path / "colmap" / "README.txt").read_text(encoding="utf-8")
    trajectory = np.loadtxt(io.BytesIO(content["trajectory.tum"]))
    assert trajectory.shape == (int(route_map.path.tracked.sum()), 8)
    cloud = trimesh.load(io.BytesIO(content["map.ply"]), file_type="ply")
    assert len(cloud.vertices) == len(route_map.landmarks) + len(route_map.path)


async def test_what_cannot_be_exported_is_a_problem(served: DemoService) -> None:
    http = served.service.http
    unknown = await http.get(f"/v1/routes/{uuid4()}/export/map.ply")
    assert (unknown.status_code, unknown.json()["code"]) == (404, "route_not_found")
    other = await http.get(f"/v1/routes/{served.route_id}/export/map.obj")
    assert (other.status_code, other.json()["code"]) == (422, "invalid_request")
    created = await http.post("/v1/routes", json={"name": "x", "start_label": "a", "destination_label": "b"})
    early = await http.get(f"/v1/routes/{created.json()['id']}/export/map.ply")
    assert (early.status_code, early.json()["code"]) == (409, "route_not_ready")


async def test_a_damaged_map_is_unusable(served: DemoService, demo_route: DemoRoute, temporary: Path) -> None:
    route_id = await served.service.upload(str(demo_route.map_file).encode())
    await served.service.wait(route_id, "ready")
    store = served.service.parts.store
    key = next(key for key in await store.keys(f"routes/{route_id}") if "map" in key)
    (await store.local_path(key)).write_bytes(b"no map at all")
    refused = await served.service.http.get(f"/v1/routes/{route_id}/export/trajectory.tum", timeout=60)
    assert (refused.status_code, refused.json()["code"]) == (424, "map_unusable")
    assert "no route map" in refused.json()["detail"]
    assert left_in(temporary) == []


async def test_an_export_that_takes_too_long_is_given_up(demo_route: DemoRoute, temporary: Path) -> None:
    exporter = ProcessExporter(timeout_s=0.01)
    with pytest.raises(ExportFailedError, match="longer than"):
        await exporter.export(demo_route.map_file, "map.ply")
    await exporter.close()
    assert left_in(temporary) == []


async def test_a_process_that_dies_is_told(
    demo_route: DemoRoute, temporary: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(exports, "_CHILD", exports.ChildOptions(memory_bytes=1 << 20))
    exporter = ProcessExporter()
    with pytest.raises(ExportFailedError, match="is gone"):
        await exporter.export(demo_route.map_file, "map.ply")
    await exporter.close()


async def test_those_who_would_wait_too_long_are_turned_away(demo_route: DemoRoute) -> None:
    exporter = ProcessExporter(queue=0)
    with pytest.raises(TooManyExportsError):
        await exporter.export(demo_route.map_file, "map.ply")
    await exporter.close()
