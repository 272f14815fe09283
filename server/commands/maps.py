"""The commands ``pairnavi map``: make a map on this machine, look into it, write and read other formats."""

from __future__ import annotations

import json
import math
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from enum import StrEnum
from pathlib import Path
from typing import Annotated, NoReturn

import typer
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn
from rich.table import Table

from server.geometry.cameras import Camera, InvalidCameraError
from server.mapping.build import BuildOptions, build_route_map
from server.mapping.codec import RouteMapFileError, format_version, load_route_map, save_route_map
from server.mapping.exchange.colmap_export import ModelForm, OtherVideoError, write_colmap
from server.mapping.exchange.colmap_files import ColmapModelError
from server.mapping.exchange.colmap_import import image_times, import_colmap, read_colmap
from server.mapping.exchange.ply import ply_file
from server.mapping.exchange.tum import tum_trajectory
from server.mapping.quality_files import write_quality_report
from server.mapping.route_map import RouteMap
from server.mapping.video import UnreadableVideoError

app = typer.Typer(add_completion=False)


class ExportFormat(StrEnum):
    """Formats that a map is written in."""

    COLMAP = "colmap"
    TUM = "tum"
    PLY = "ply"


MapFile = Annotated[Path, typer.Argument(help="A route map's file.", metavar="MAP", show_default=False)]
CameraFile = Annotated[Path | None, typer.Option("--camera", help="JSON of the video's camera, if known.")]
Length = Annotated[
    float | None, typer.Option("--length", help="Length of the walk in metres: fixes the scale.", min=0.1)
]
Force = Annotated[bool, typer.Option("--force", help="Replace what is there already.")]


@app.command()
def build(
    video: Annotated[Path, typer.Argument(help="The leader's video.", show_default=False)],
    out: Annotated[Path, typer.Option(help="Where the map is written.", show_default=False)],
    camera: CameraFile = None,
    length: Length = None,
    report: Annotated[
        Path | None, typer.Option(help="Folder for the quality report: where the video is weak, and why.")
    ] = None,
    force: Force = False,
) -> None:
    """Build the route map of a leader's video."""
    with _said_in_one_line():
        _check_out(out, force)
        if report is not None:
            _check_out(report, force, folder=True)
        described = _camera(camera)
        with _progress(f"map of {video.name}") as progress:
            result = build_route_map(
                video,
                described,
                BuildOptions(measured_length=length),
                lambda state: progress(state.fraction),
            )
        if report is not None and result.quality is not None:
            write_quality_report(result.quality, report, video.name)
        if result.route_map is None:
            _fail(f"no map ({result.status}): {result.detail}")
        save_route_map(result.route_map, out)
        _print_summary(out, result.route_map)


@app.command()
def show(map_file: MapFile) -> None:
    """Say what is in a map."""
    with _said_in_one_line():
        _print_summary(map_file, load_route_map(map_file))


@app.command()
def export(
    map_file: MapFile,
    form: Annotated[ExportFormat, typer.Option("--format", help="What to write.", show_default=False)],
    out: Annotated[Path, typer.Option(help="The file; of colmap, the folder.", show_default=False)],
    keyframes: Annotated[bool, typer.Option("--keyframes", help="tum: only keyframes.")] = False,
    text: Annotated[bool, typer.Option("--text", help="colmap: text files in place of binary ones.")] = False,
    video: Annotated[
        Path | None, typer.Option(help="colmap: the leader's video, to write the keyframes' pictures too.")
    ] = None,
    camera: CameraFile = None,
    force: Force = False,
) -> None:
    """Write a map as a COLMAP model, a TUM trajectory or a PLY file."""
    with _said_in_one_line():
        route_map = load_route_map(map_file)
        _check_out(out, force, folder=form is ExportFormat.COLMAP)
        if form is ExportFormat.COLMAP:
            model_form = ModelForm.TEXT if text else ModelForm.BINARY
            write_colmap(route_map, out, model_form, video=video, camera=_camera(camera))
        elif form is ExportFormat.TUM:
            out.write_text(tum_trajectory(route_map, keyframes_only=keyframes), encoding="utf-8")
        else:
            out.write_bytes(ply_file(route_map))


@app.command("import-colmap")
def import_model(
    model: Annotated[Path, typer.Argument(help="Folder of a COLMAP model.", show_default=False)],
    images: Annotated[Path, typer.Option(help="Folder of its images.", show_default=False)],
    out: Annotated[Path, typer.Option(help="Where the map is written.", show_default=False)],
    fps: Annotated[
        float | None,
        typer.Option(help="Images a second of the walk, where their names do not say.", min=0.1, max=1000),
    ] = None,
    length: Length = None,
    metric: Annotated[bool, typer.Option("--metric", help="The model's unit is the metre.")] = False,
    force: Force = False,
) -> None:
    """Make a route map of a COLMAP model and its images, in the order of their names."""
    with _said_in_one_line():
        _check_out(out, force)
        if metric and length is not None:
            _fail("give --length or --metric, not both")
        walk = read_colmap(model)
        times = image_times(walk, fps)
        with _progress(f"map of {len(walk.images)} images") as progress:
            route_map = import_colmap(
                walk, images, times, measured_length=length, metric=metric, on_progress=progress
            )
        save_route_map(route_map, out)
        _print_summary(out, route_map)


def _camera(file: Path | None) -> Camera | None:
    if file is None:
        return None
    try:
        document = json.loads(file.read_text(encoding="utf-8"))
    except ValueError:
        _fail(f"{file}: not JSON")
    if not isinstance(document, dict):
        _fail(f"{file}: expected a JSON object with model, width, height and params")
    return Camera.from_json(document)


def _check_out(out: Path, force: bool, *, folder: bool = False) -> None:
    """Find out before the work is done whether its result can be written, and would overwrite nothing."""
    if out.is_dir() and not folder:
        _fail(f"{out} is a folder; name a file")
    if folder and out.exists() and not out.is_dir():
        _fail(f"{out} is a file; name a folder")
    occupied = any(out.iterdir()) if out.is_dir() else out.exists()
    if occupied and not force:
        _fail(f"{out} is there already: choose another name, or replace it with --force")
    home = out if out.is_dir() else out.parent
    if not home.is_dir():
        _fail(f"{home}: no such folder")
    if not os.access(home, os.W_OK | os.X_OK):
        _fail(f"{home}: nothing may be written there")


def _print_summary(file: Path, route_map: RouteMap) -> None:
    path, scale, camera = route_map.path, route_map.scale, route_map.camera
    length = float(path.arc_length[-1])
    metres = scale.metres(length)
    turns = ", ".join(f"{math.degrees(turn.angle):+.0f}°" for turn in route_map.turns)
    unknown = "unknown: lengths are in map units, the leader's mean second"
    known = f"{scale.metres_per_unit or 0:.4g} m a map unit ({scale.source})"
    rows = {
        "frames": f"{len(path)} in {path.time[-1] - path.time[0]:.1f} s, {int(path.tracked.sum())} tracked",
        "length": f"{length:.1f} map units" if metres is None else f"{metres:.2f} m",
        "scale": unknown if metres is None else known,
        "turns": f"{len(route_map.turns)}" + (f": {turns} (positive to the left)" if turns else ""),
        "keyframes": f"{len(route_map.keyframes)}",
        "landmarks": f"{len(route_map.landmarks)}, seen {len(route_map.observations.landmark)} times",
        "camera": f"{camera.model} {camera.width}x{camera.height}, rectified",
        "bytes": f"{file.stat().st_size:,}",
        "format": f"version {format_version(file)}",
    }
    table = Table(title=escape(file.name), show_header=False, title_justify="left")
    for name, value in rows.items():
        table.add_row(name, escape(value))
    Console().print(table)


@contextmanager
def _progress(what: str) -> Iterator[Callable[[float], None]]:
    """A bar on standard error, moved by what it yields."""
    columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TimeElapsedColumn())
    with Progress(*columns, console=Console(stderr=True)) as bar:
        task = bar.add_task(escape(what), total=1.0)
        yield lambda fraction: bar.update(task, completed=fraction)


@contextmanager
def _said_in_one_line() -> Iterator[None]:
    """What can be expected to fail becomes one line and exit code 1."""
    try:
        yield
    except (
        ColmapModelError,
        InvalidCameraError,
        OtherVideoError,
        RouteMapFileError,
        UnreadableVideoError,
    ) as error:
        _fail(str(error))
    except OSError as error:
        _fail(f"{error.filename}: {error.strerror}" if error.filename is not None else str(error))


def _fail(message: str) -> NoReturn:
    print(f"pairnavi: {message}", file=sys.stderr)
    raise typer.Exit(1)
