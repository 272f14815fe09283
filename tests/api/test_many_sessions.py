"""A thousand followers come and go: nothing is left behind."""

from __future__ import annotations

import asyncio
import importlib.util
import sys
import time
from pathlib import Path
from types import ModuleType

import cv2
import httpx
import numpy as np
import pytest
from demo_route import DemoRoute
from numpy.typing import NDArray
from served import served
from service import NEW_ROUTE

from server.mapping.video import read_frames


@pytest.fixture(scope="module")
def soak() -> ModuleType:
    path = Path(__file__).parents[2] / "benchmarks" / "soak.py"
    spec = importlib.util.spec_from_file_location("soak", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["soak"] = module
    spec.loader.exec_module(module)
    return module


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="memory and handles are read from /proc")
def test_a_thousand_sessions_leak_nothing(
    soak: ModuleType, demo_route: DemoRoute, tmp_path: Path, record_property: pytest.RecordProperty
) -> None:
    grey = encoded(np.full((demo_route.leader.camera.height, demo_route.leader.camera.width), 128, np.uint8))
    pictures = []
    for frame in read_frames(demo_route.leader.video):
        if frame.index % 8 == 3:
            # Every other session begins with a picture of the way; looking at nothing takes less time.
            pictures += [grey, encoded(frame.image), grey, grey]
    with (
        served(tmp_path, "prebuilt_map:build", "server.workers.navigation_engine:MapEngine") as service,
        httpx.Client(base_url=service.url, trust_env=False, timeout=30) as http,
    ):
        route = http.post("/v1/routes", json=NEW_ROUTE).json()["id"]
        http.put(f"/v1/routes/{route}/camera", json=demo_route.leader.camera.to_json()).raise_for_status()
        http.put(f"/v1/routes/{route}/video", content=str(demo_route.map_file).encode()).raise_for_status()
        deadline = time.monotonic() + 30
        while http.get(f"/v1/routes/{route}").json()["state"] != "ready" and time.monotonic() < deadline:
            time.sleep(0.1)
        visit = soak.Visit(service.url, route, demo_route.leader.camera.to_json(), pictures)
        located = asyncio.run(soak.crowd(visit, 100, at_once=16))
        before = soak.footprint(service.process.pid)
        located += asyncio.run(soak.crowd(visit, 900, at_once=16))
        after = soak.footprint(service.process.pid)
        record_property("cpu_s", after.cpu_s)
        health = http.get("/v1/health").json()
    assert located > 400
    assert after.processes == before.processes
    # Pools of threads and of database connections may not have been full yet; a leak would leave hundreds.
    assert after.files <= before.files + 4
    assert after.threads <= before.threads + 8
    assert after.rss_mb - before.rss_mb < 30.0
    assert health["status"] == "ok"


def encoded(image: NDArray[np.uint8]) -> bytes:
    return cv2.imencode(".jpg", image)[1].tobytes()
