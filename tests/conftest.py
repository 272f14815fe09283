"""Fixtures of all tests."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from demo_route import DemoRoute, build_demo_route


@pytest.fixture(scope="session")
def recorded_data() -> Path:
    """Folder of the recorded data; where it is missing the test is skipped, in CI it fails."""
    default = Path(__file__).resolve().parents[2] / "shared" / "data"
    folder = Path(os.environ.get("PAIRNAVI_DATA", default))
    if not (folder / "walks").is_dir():
        reason = f"no recorded walks in {folder}: set PAIRNAVI_DATA to the folder that holds walks/"
        if os.environ.get("CI", "").lower() == "true":
            pytest.fail(reason)
        pytest.skip(reason)
    return folder


@pytest.fixture(scope="session")
def demo_route(tmp_path_factory: pytest.TempPathFactory) -> DemoRoute:
    """The demo's two walks, rendered once, and the map of the leader's, built once (about 30 s)."""
    return build_demo_route(tmp_path_factory.mktemp("demo"))
