"""``evaluate route`` from walk folders to figures and pictures, on a short synthetic walk."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from client_sim.synthetic.buildings import CORRIDOR_AND_ROOM, build_world
from client_sim.synthetic.cameras import PinholeCamera
from client_sim.synthetic.gait import Gait
from client_sim.synthetic.rendering import Renderer
from client_sim.synthetic.trajectories import walk
from client_sim.synthetic.walk_folders import write_walk
from server.evaluation.commands import app

WAYPOINTS = ((0.8, 1.0), (6.0, 1.0))


@pytest.fixture(scope="module")
def walks(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with ``leader`` and ``follower``, five metres along a corridor; nobody knows their cameras."""
    folder = tmp_path_factory.mktemp("walks")
    world = build_world("synthetic", CORRIDOR_AND_ROOM, np.random.default_rng(7))
    for seed, name, focal, height in ((1, "leader", 500.0, 1.5), (2, "follower", 530.0, 1.6)):
        rng = np.random.default_rng(seed)
        camera = PinholeCamera(fx=focal, fy=focal)
        trajectory = walk(WAYPOINTS, rng, Gait(height=height), wander=0.0 if name == "leader" else 0.2)
        write_walk(folder / name, Renderer(world, camera), trajectory, rng)
        (folder / name / "camera.json").unlink()
    return folder


def test_figures_and_pictures_are_written(walks: Path, tmp_path: Path) -> None:
    figures, pictures = tmp_path / "figures.json", tmp_path / "pictures"
    arguments = ["route", str(walks / "leader"), str(walks / "follower")]
    result = CliRunner().invoke(app, [*arguments, "--json", str(figures), "--plots", str(pictures)])
    assert result.exit_code == 0, result.output
    document = json.loads(figures.read_text())
    leader, (follower,) = document["leader"], document["followers"]
    assert leader["tracked_fraction"] >= 0.98
    assert leader["ate_percent_of_path"] < 1.5
    assert leader["build_seconds"] > 0
    assert leader["map_bytes"] > 10_000
    assert leader["peak_rss_bytes"] > 10_000_000
    assert follower["relocalized_fraction"] >= 0.97
    assert follower["false_fixes"] == 0
    assert follower["position_error_m"]["median"] < 0.08
    assert follower["latency_ms"]["p50"] > 0
    assert {path.name for path in pictures.iterdir()} == {
        "leader.png",
        "follower_follower.png",
        "latency.png",
    }


def test_a_folder_that_is_no_walk_is_named(tmp_path: Path) -> None:
    result = CliRunner().invoke(app, ["route", str(tmp_path), str(tmp_path), "--json", str(tmp_path / "x")])
    assert result.exit_code == 2
    assert "video.mp4: missing" in " ".join(result.output.split())


def test_a_video_without_a_map_is_reported_with_its_reason(walks: Path, tmp_path: Path) -> None:
    broken = tmp_path / "broken"
    broken.mkdir()
    for name in ("groundtruth.txt", "meta.json"):
        (broken / name).write_text((walks / "leader" / name).read_text())
    (broken / "video.mp4").write_bytes(b"no video at all")
    figures = tmp_path / "figures.json"
    result = CliRunner().invoke(app, ["route", str(broken), str(walks / "follower"), "--json", str(figures)])
    assert result.exit_code == 1
    document = json.loads(figures.read_text())
    assert document["leader"]["status"] == "not_a_video"
    assert document["followers"] == []
