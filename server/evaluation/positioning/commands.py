"""The commands ``pairnavi evaluate positioning``."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import Progress

from server.evaluation.positioning.activities import (
    LabelledWindows,
    judge_activities,
    learn,
    read_windows,
    walking_windows,
    with_walking,
)
from server.evaluation.positioning.crowd import follow_with_anchors, reckon_and_learn
from server.evaluation.positioning.folders import RecordingError, unpacked
from server.evaluation.positioning.mall import Floor, read_floors
from server.evaluation.positioning.mall_report import MallReport
from server.evaluation.positioning.plots import draw_confusion, draw_errors, draw_floor, draw_step_errors
from server.evaluation.positioning.step_counts import judge_steps
from server.evaluation.positioning.tracks import Track
from server.pedestrian.activities import CLASSES
from server.pedestrian.events import Activity

Array = NDArray[np.float64]

app = typer.Typer(help="Judge a phone's own sensors against recorded truth.", no_args_is_help=True)

Folder = Annotated[Path, typer.Argument(metavar="DIR", help="Folder of recordings, or of their archives.")]
JsonFile = Annotated[Path, typer.Option("--json", dir_okay=False, help="Where the figures are written.")]
Plots = Annotated[Path | None, typer.Option("--plots", file_okay=False, help="Folder for pictures.")]


@contextmanager
def _judging(console: Console) -> Iterator[None]:
    try:
        yield
    except RecordingError as error:
        console.print(str(error), style="red", markup=False, soft_wrap=True)
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


@app.command()
def activities(
    folder: Folder,
    json_file: JsonFile,
    plots: Plots = None,
    model: Annotated[
        Path | None, typer.Option("--model", help="Write there the model learnt from everybody.")
    ] = None,
    walks: Annotated[
        Path | None,
        typer.Option(
            "--walking", help="Folder of the indoor competition: its floor F1 is learnt as walking."
        ),
    ] = None,
) -> None:
    """Tell walking, stairs up, stairs down and standing still apart, leaving one person out at a time."""
    console = Console()
    with _judging(console):
        windows = read_windows(folder)
        if walks is not None:
            windows = with_walking(windows, _hand_held(walks, windows))
    report = judge_activities(windows)
    _write(report.to_json(), json_file)
    console.print(
        f"{int(report.confusion.sum())} windows of {report.people} people: "
        f"balanced accuracy {100 * report.balanced_accuracy:.1f} %"
    )
    if model is not None:
        _write(learn(windows.values, windows.classes).to_json(), model)
    if plots is not None:
        labels = [activity.value for activity in CLASSES]
        file = plots / "activities.png"
        console.print(f"picture: {draw_confusion(report.confusion, labels, file, 'Activities')}")


def _hand_held(folder: Path, windows: LabelledWindows) -> Array:
    with unpacked(folder, "path_data_files/*.txt") as files:
        floors = read_floors([file for file in files if file.parent.parent.name == "F1"])
    count = int((windows.classes == CLASSES.index(Activity.WALKING)).sum())
    return walking_windows([walk for floor in floors for walk in floor.walks], count)


@app.command("indoor-competition")
def indoor_competition(folder: Folder, json_file: JsonFile, plots: Plots = None) -> None:
    """Follow recorded walks by the phone's own sensors, from the known start, causally."""
    console = Console()
    with _judging(console), unpacked(folder, "path_data_files/*.txt") as files:
        floors = read_floors(files)
    report = MallReport(*_follow_floors(floors, console))
    figures = report.to_json()
    _write(figures, json_file)
    for name in report.floors:
        console.print(_line(name, report.of([name])))
    console.print(_line("judged: " + ", ".join(report.judged), figures))
    if plots is not None:
        for picture in (picture for floor in floors for picture in _draw(floor, report, plots)):
            console.print(f"picture: {picture}")


def _follow_floors(floors: list[Floor], console: Console) -> tuple[tuple[Track, ...], tuple[Track, ...]]:
    plain, anchored = [], []
    with Progress(console=console, transient=True) as progress:
        task = progress.add_task("walks", total=2 * sum(len(floor.walks) for floor in floors))
        for floor in floors:
            contributions = []
            for walk in floor.walks:
                track, contribution = reckon_and_learn(walk)
                plain.append(track)
                contributions.append(contribution)
                progress.advance(task)
            for walk in floor.walks:
                anchored.append(follow_with_anchors(walk, contributions))
                progress.advance(task)
    return tuple(plain), tuple(anchored)


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
