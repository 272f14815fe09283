"""``pairnavi evaluate positioning`` from the command line."""

from __future__ import annotations

import json
import tarfile
from pathlib import Path

import pytest
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


MOTION = "0\tTYPE_ACCELEROMETER\t0\t0\t9.8\n0\tTYPE_WAYPOINT\t1\t2\n"
ONE_PERSON = "".join(f"{v}\n" for v in ("1 1 1 1 299", "1 1 4 1 20"))


@pytest.mark.parametrize(
    ("command", "files", "told"),
    [
        ("steps", {"a.tar.xz": "junk"}, "cannot be unpacked"),
        ("steps", {"a.csv": ""}, "is empty"),
        ("steps", {"a.csv": "1,2,3,4,5,9\n2,2,3,4,5,3\n"}, "its count of steps falls"),
        ("steps", {"a.csv": "1,2,3,4,5,0\n2,nan,3,4,5,1\n"}, "a number is missing"),
        ("activities", {"labels.txt": "a b c"}, "labels.txt"),
        ("activities", {"labels.txt": "1 2"}, "experiment, user, activity"),
        (
            "activities",
            {
                "labels.txt": ONE_PERSON,
                "acc_exp01_user01.txt": "0 0 9.8\n" * 300,
                "gyro_exp01_user01.txt": "0 0 0\n" * 300,
            },
            "one person",
        ),
        ("indoor-competition", {"s/F/path_data_files/a.txt": MOTION}, "floor_info.json"),
        (
            "indoor-competition",
            {"s/F/path_data_files/a.txt": MOTION, "s/F/floor_info.json": '{"map_info": 3}'},
            "floor_info.json",
        ),
        (
            "indoor-competition",
            {
                "s/F/path_data_files/a.txt": MOTION,
                "s/F/floor_info.json": '{"map_info": {"width": 1, "height": 1}}',
            },
            "nothing to judge",
        ),
    ],
)
def test_a_broken_recording_is_refused_in_one_line(
    tmp_path: Path, command: str, files: dict[str, str], told: str
) -> None:
    for name, text in files.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text, encoding="utf-8")
    done = RUN.invoke(app, ["positioning", command, str(tmp_path), "--json", str(tmp_path / "out.json")])
    assert done.exit_code == 2, done.exception
    assert told in done.output
    assert len(done.output.splitlines()) == 1


def test_an_archive_that_was_cut_off_is_refused(tmp_path: Path) -> None:
    text = "".join(f"{i},{i * i % 977},3,4,5,0\n" for i in range(20000))
    (tmp_path / "a.csv").write_text(text, encoding="utf-8")
    with tarfile.open(tmp_path / "a.tar.xz", "w:xz") as tar:
        tar.add(tmp_path / "a.csv", "a.csv")
    (tmp_path / "a.csv").unlink()
    whole = (tmp_path / "a.tar.xz").read_bytes()
    (tmp_path / "a.tar.xz").write_bytes(whole[: len(whole) // 2])
    done = RUN.invoke(app, ["positioning", "steps", str(tmp_path), "--json", str(tmp_path / "out.json")])
    assert done.exit_code == 2
    assert "cannot be unpacked" in done.output
