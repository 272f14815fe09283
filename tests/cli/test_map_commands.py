"""``pairnavi map``: what works, and what cannot work in one line."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pycolmap
import pytest
import trimesh
from clips import clip
from demo_route import DemoRoute
from recorded_video import write_walk
from typer.testing import CliRunner

from server.cli import app
from server.mapping.codec import load_route_map

runner = CliRunner()


def run(*arguments: str | Path) -> str:
    done = runner.invoke(app, ["map", *map(str, arguments)])
    assert done.exit_code == 0, done.output
    return " ".join(done.output.split())


def refused(*arguments: str | Path) -> str:
    done = runner.invoke(app, ["map", *map(str, arguments)])
    assert done.exit_code == 1, done.output
    assert "Traceback" not in done.output
    (line,) = [line for line in done.stderr.splitlines() if line.startswith("pairnavi: ")]
    return line.removeprefix("pairnavi: ")


@pytest.mark.parametrize(
    ("group", "commands"),
    [("map", ("build", "show", "export", "import-colmap")), ("evaluate", ("route",))],
)
def test_groups_say_what_is_in_them_and_nothing_else(group: str, commands: tuple[str, ...]) -> None:
    done = runner.invoke(app, [group, "--help"])
    assert done.exit_code == 0
    assert all(command in done.output for command in commands)
    assert "completion" not in done.output
    assert "No such command" in runner.invoke(app, [group, "nonsense"]).output


def test_the_commands_are_listed_without_being_loaded() -> None:
    done = subprocess.run(
        [sys.executable, "-X", "importtime", "-m", "server.cli", "--help"],
        capture_output=True,
        text=True,
        check=True,
    )
    assert "map " in done.stdout
    for heavy in ("server.commands.maps", "server.evaluation.commands", "pycolmap", "numpy"):
        assert f"| {heavy}\n" not in done.stderr


def test_a_map_is_shown(demo_route: DemoRoute) -> None:
    said = run("show", demo_route.map_file)
    route_map = demo_route.route_map
    for expected in (
        f"{len(route_map.path)} in",
        f"{len(route_map.landmarks)}, seen {len(route_map.observations.landmark)} times",
        f"{demo_route.map_file.stat().st_size:,}",
        "version 1",
        "unknown: lengths are in map units",
        "PINHOLE 640x480",
    ):
        assert expected in said


def test_maps_are_exported_and_imported(demo_route: DemoRoute, tmp_path: Path) -> None:
    map_file, route_map = demo_route.map_file, demo_route.route_map
    run("export", map_file, "--format", "tum", "--out", tmp_path / "all.tum")
    run("export", map_file, "--format", "tum", "--keyframes", "--out", tmp_path / "keyframes.tum")
    assert len(np.loadtxt(tmp_path / "all.tum")) == int(route_map.path.tracked.sum())
    assert len(np.loadtxt(tmp_path / "keyframes.tum")) == len(route_map.keyframes)
    run("export", map_file, "--format", "ply", "--out", tmp_path / "map.ply")
    assert len(trimesh.load(tmp_path / "map.ply").vertices) == len(route_map.landmarks) + len(route_map.path)
    colmap = ("export", map_file, "--format", "colmap", "--out", tmp_path / "colmap")
    run(*colmap, "--text")
    assert "is there already" in refused(*colmap)
    run(*colmap, "--force", "--video", demo_route.leader.video)
    assert pycolmap.Reconstruction(tmp_path / "colmap" / "sparse" / "0").num_images() == len(
        route_map.keyframes
    )
    imported = ("import-colmap", tmp_path / "colmap", "--images", tmp_path / "colmap" / "images")
    said = run(*imported, "--out", tmp_path / "again.map", "--length", "10")
    assert "10.00 m" in said
    again = load_route_map(tmp_path / "again.map")
    assert len(again.keyframes) == len(route_map.keyframes)
    assert again.scale.metres_per_unit == pytest.approx(10.0 / again.path.arc_length[-1])
    both = refused(*imported, "--out", tmp_path / "x.map", "--length", "10", "--metric")
    assert "not both" in both


def test_what_cannot_be_exported_is_said(demo_route: DemoRoute, tmp_path: Path) -> None:
    map_file, out = demo_route.map_file, tmp_path / "out.ply"
    damaged = tmp_path / "damaged.map"
    damaged.write_bytes(map_file.read_bytes()[:-1000])
    ply = ("--format", "ply", "--out")
    assert "cut short" in refused("export", damaged, *ply, out)
    assert "damaged.map" not in [path.name for path in tmp_path.glob("*.ply")]
    assert "No such file" in refused("export", tmp_path / "none.map", *ply, out)
    assert "no such folder" in refused("export", map_file, *ply, tmp_path / "nowhere" / "out.ply")
    assert "is a folder" in refused("export", map_file, *ply, tmp_path)
    out.write_text("precious")
    assert "is there already" in refused("export", map_file, *ply, out)
    assert out.read_text() == "precious"
    assert "is a file" in refused("export", map_file, "--format", "colmap", "--out", out, "--force")
    run("export", map_file, *ply, out, "--force")
    assert out.read_bytes().startswith(b"ply\n")


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere: run the tests as somebody else")
def test_a_folder_that_may_not_be_written_is_said(demo_route: DemoRoute, tmp_path: Path) -> None:
    tmp_path.chmod(0o500)
    arguments = ("export", demo_route.map_file, "--format", "ply", "--out", tmp_path / "out.ply")
    assert "nothing may be written there" in refused(*arguments)


def test_what_cannot_be_imported_is_said(tmp_path: Path) -> None:
    out = tmp_path / "out.map"
    arguments = ("import-colmap", tmp_path, "--images", tmp_path, "--out", out)
    assert "holds no COLMAP model" in refused(*arguments)
    assert not out.exists()


def test_a_map_is_built_with_its_report_without_a_camera(demo_route: DemoRoute, tmp_path: Path) -> None:
    walk = clip(demo_route.leader, tmp_path / "walk", 60)
    arguments = ("build", walk.video, "--length", "5")
    said = run(*arguments, "--out", tmp_path / "out.map", "--report", tmp_path / "report")
    assert "5.00 m" in said
    assert len(load_route_map(tmp_path / "out.map").path) == 60
    assert {"report.json", "report.png"} <= {file.name for file in (tmp_path / "report").iterdir()}
    assert "is there already" in refused(*arguments, "--out", tmp_path / "out.map")


def test_what_cannot_be_built_is_said(tmp_path: Path) -> None:
    walk = write_walk(tmp_path / "walk", frames=3, fps=10)
    video, camera, out = walk / "video.mp4", walk / "camera.json", tmp_path / "out.map"
    assert "too_short" in refused("build", video, "--camera", camera, "--out", out)
    none = refused("build", tmp_path / "none.mp4", "--camera", camera, "--out", out)
    assert "not_a_video" in none
    camera.write_text("[]")
    assert "JSON object" in refused("build", video, "--camera", camera, "--out", out)
    camera.write_text("{")
    assert "not JSON" in refused("build", video, "--camera", camera, "--out", out)
    camera.write_text(json.dumps({"model": "PINHOLE", "width": 64, "height": 48}))
    assert "lacks 'params'" in refused("build", video, "--camera", camera, "--out", out)
    assert not out.exists()
