from __future__ import annotations

from pathlib import Path

import pytest
from demo_route import DemoRoute

from server.mapping.exchange.colmap_export import write_colmap


@pytest.fixture(scope="session")
def demo_model(demo_route: DemoRoute, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The demo's map as a COLMAP data set with its pictures. Not to be written to."""
    folder = tmp_path_factory.mktemp("colmap")
    write_colmap(demo_route.route_map, folder, video=demo_route.leader.video, camera=demo_route.leader.camera)
    return folder
