"""``pairnavi evaluate positioning`` from the command line."""

from __future__ import annotations

import json
from pathlib import Path

from typer.testing import CliRunner

from server.evaluation.commands import app
from tests.evaluation.positioning.test_recordings import write_mall_walk
from tests.pedestrian.walkers import Walker

RUN = CliRunner()


def test_a_floor_is_judged_with_figures_and_pictures(tmp_path: Path) -> None:
    folder = tmp_path / "data" / "site2" / "F3"
    for seed in range(2):
        write_mall_walk(folder / "path_data_files" / f"{seed}.txt", Walker(noise=0.5, seed=seed))
    info = {"map_info": {"width": 30.0, "height": 30.0}}
    (folder / "floor_info.json").write_text(json.dumps(info), encoding="utf-8")
    figures, plots = tmp_path / "mall.json", tmp_path / "plots"
    arguments = ["positioning", "indoor-competition", str(tmp_path / "data"), "--json", str(figures)]
    done = RUN.invoke(app, [*arguments, "--plots", str(plots)])
    assert done.exit_code == 0, done.output
    told = json.loads(figures.read_text(encoding="utf-8"))
    assert told["waypoints"] == 4
    assert told["judged"] == ["site2/F3"]
    assert 0.0 <= told["dead_reckoning_median_m"] < 1.5
    assert told["anchors_median_m"] is not None
    assert {file.name for file in plots.iterdir()} == {"site2-F3.png", "site2-F3-errors.png"}


def test_an_empty_folder_is_refused_in_words(tmp_path: Path) -> None:
    for command in ("steps", "activities", "indoor-competition"):
        done = RUN.invoke(app, ["positioning", command, str(tmp_path), "--json", str(tmp_path / "out.json")])
        assert done.exit_code == 2
        assert "has no" in " ".join(done.output.split())
        assert not (tmp_path / "out.json").exists()
