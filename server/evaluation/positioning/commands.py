"""The commands ``pairnavi evaluate positioning``."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from rich.console import Console

from server.evaluation.positioning.folders import RecordingError, unpacked
from server.evaluation.positioning.mall import Floor, read_floors
from server.evaluation.positioning.mall_report import MallReport
from server.evaluation.positioning.plots import draw_errors, draw_floor, draw_step_errors
from server.evaluation.positioning.step_counts import judge_steps
from server.evaluation.positioning.tracks import dead_reckoned

app = typer.Typer(help="Judge a phone's own sensors against recorded truth.", no_args_is_help=True)

Folder = Annotated[Path, typer.Argument(metavar="DIR", help="Folder of recordings, or of their archives.")]
JsonFile = Annotated[Path, typer.Option("--json", help="Where the figures are written.")]
Plots = Annotated[Path | None, typer.Option("--plots", help="Folder for pictures.")]


@contextmanager
def _judging(console: Console) -> Iterator[None]:
    try:
        yield
    except RecordingError as error:
        console.print(f"[red]{error}")
        raise typer.Exit(2) from error


def _write(figures: dict[str, Any], file: Path) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(json.dumps(figures, indent=1) + "\n", encoding="utf-8")


@app.command()
def steps(folder: Folder, json_file: JsonFile, plots: Plots = None) -> None:
    """Count the steps of recorded accelerations."""
    console = Console()
    with _judging(console):
        report = judge_steps(folder)
    figures = report.to_json()
    _write(figures, json_file)
    for trace in report.traces:
        console.print(
            f"{trace.name}: {trace.counted} of {trace.true_steps} ({trace.error_percent:+.1f} %), "
            f"{trace.matched} at the right moment"
        )
    console.print(
        f"{len(report.traces)} traces: median error {figures['median_error_percent']:.2f} %, "
        f"worst {figures['worst_error_percent']:.2f} %; {report.core_percent:.2f} % of a core"
    )
    if plots is not None:
        errors = [trace.error_percent for trace in report.traces]
        picture = draw_step_errors([trace.name for trace in report.traces], errors, plots / "steps.png")
        console.print(f"picture: {picture}")


@app.command("indoor-competition")
def indoor_competition(folder: Folder, json_file: JsonFile, plots: Plots = None) -> None:
    """Follow recorded walks by the phone's own sensors, from the known start, causally."""
    console = Console()
    with _judging(console), unpacked(folder, "path_data_files/*.txt") as files:
        floors = read_floors(files)
    tracks = [dead_reckoned(walk) for floor in floors for walk in floor.walks]
    report = MallReport(tuple(tracks), ())
    figures = report.to_json()
    _write(figures, json_file)
    for name in report.floors:
        console.print(_line(name, report.of([name])))
    console.print(_line("judged: " + ", ".join(report.judged), figures))
    if plots is not None:
        for picture in (picture for floor in floors for picture in _draw(floor, report, plots)):
            console.print(f"picture: {picture}")


def _draw(floor: Floor, report: MallReport, plots: Path) -> list[Path]:
    name = floor.name.replace("/", "-")
    plain, anchored = report.tracks([floor.name], False), report.tracks([floor.name], True)
    errors = {"dead reckoning": np.concatenate([track.errors for track in plain])}
    if anchored:
        errors["with anchors"] = np.concatenate([track.errors for track in anchored])
    return [
        draw_floor(floor, plain, anchored, plots / f"{name}.png"),
        draw_errors(errors, plots / f"{name}-errors.png", floor.name),
    ]


def _line(name: str, figures: dict[str, Any]) -> str:
    anchors = figures["anchors_median_m"]
    told = "" if anchors is None else f", with anchors {anchors:.2f} m"
    return (
        f"{name}: {figures['waypoints']} waypoints of {figures['walks']} walks: "
        f"dead reckoning {figures['dead_reckoning_median_m']:.2f} m{told} (medians); "
        f"{figures['core_percent']:.2f} % of a core"
    )
