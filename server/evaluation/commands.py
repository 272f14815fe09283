"""The command ``pairnavi evaluate``."""

from __future__ import annotations

import json
import tempfile
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn
from rich.progress import TimeElapsedColumn as Elapsed

from server.evaluation.follower import AnsweredFrame, FollowerJudgement, judge_follower
from server.evaluation.isolated import ONE_THREAD, run_isolated
from server.evaluation.leader import BuildFigures, LeaderJudgement, failed_leader, judge_leader
from server.evaluation.plots import write_plots
from server.evaluation.positioning.commands import app as positioning
from server.evaluation.report import RouteReport
from server.evaluation.runs import build_map, follow_route
from server.evaluation.tables import print_report
from server.evaluation.walk import Walk, WalkError, read_walk
from server.mapping.codec import load_route_map

app = typer.Typer(help="Judge routes and followers against recorded truth.", no_args_is_help=True)
app.add_typer(positioning, name="positioning")


@app.callback()
def _evaluate() -> None:
    """Judge routes and followers against recorded truth."""


def _build(walk: Walk, map_file: Path, progress: Progress) -> BuildFigures:
    task = progress.add_task(f"map of {walk.name}", total=1.0)
    figures = run_isolated(
        build_map,
        walk.video,
        walk.camera,
        map_file,
        on_progress=lambda fraction: progress.update(task, completed=fraction),
    )
    progress.update(task, completed=1.0)
    return figures


def _follow(walk: Walk, map_file: Path, progress: Progress) -> list[AnsweredFrame]:
    task = progress.add_task(f"follower {walk.name}", total=float(len(walk.truth)))
    answers = run_isolated(
        follow_route,
        map_file,
        walk.video,
        walk.camera,
        environment=ONE_THREAD,
        on_progress=lambda index: progress.update(task, completed=index + 1),
    )
    progress.update(task, completed=float(len(walk.truth)))
    return answers


def evaluate_route(
    leader_walk: Walk, follower_walks: list[Walk], progress: Progress
) -> tuple[RouteReport, LeaderJudgement | None, list[FollowerJudgement]]:
    """Build the leader's map, lead every follower on it, judge all of them; no network."""
    with tempfile.TemporaryDirectory(prefix="pairnavi-evaluate-") as folder:
        map_file = Path(folder) / "route.map"
        build = _build(leader_walk, map_file, progress)
        if build.map_bytes == 0:
            return RouteReport(failed_leader(leader_walk, build)), None, []
        leader = judge_leader(leader_walk, load_route_map(map_file), build)
        followers = [
            judge_follower(leader_walk, leader, walk, _follow(walk, map_file, progress))
            for walk in follower_walks
        ]
    report = RouteReport(leader.report, tuple(follower.report for follower in followers))
    return report, leader, followers


@app.command()
def route(
    leader: Annotated[Path, typer.Argument(metavar="LEADER_WALK", help="Walk folder of the leader.")],
    followers: Annotated[
        list[Path], typer.Argument(metavar="FOLLOWER_WALK...", help="Walk folders of followers.")
    ],
    json_file: Annotated[Path, typer.Option("--json", help="Where the figures are written.")],
    plots: Annotated[Path | None, typer.Option("--plots", help="Folder for pictures.")] = None,
) -> None:
    """Build a leader's map, lead followers on it, and judge all against the truth."""
    console = Console()
    try:
        leader_walk = read_walk(leader)
        follower_walks = [read_walk(folder) for folder in followers]
    except WalkError as error:
        console.print(f"[red]{error}")
        raise typer.Exit(2) from error
    columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), Elapsed())
    with Progress(*columns, console=console) as progress:
        report, judged_leader, judged_followers = evaluate_route(leader_walk, follower_walks, progress)
    json_file.parent.mkdir(parents=True, exist_ok=True)
    json_file.write_text(json.dumps(report.to_json(), indent=1) + "\n", encoding="utf-8")
    print_report(report, console)
    if judged_leader is None:
        console.print(f"[red]no map: {report.leader.status}: {report.leader.detail}")
        raise typer.Exit(1)
    if plots is not None:
        for picture in write_plots(plots, judged_leader, judged_followers):
            console.print(f"picture: {picture}")
