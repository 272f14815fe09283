"""Leader and follower on a terminal: progress bars, hints as they come, a table at the end."""

from __future__ import annotations

from dataclasses import dataclass, field

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn
from rich.table import Table

from client_sim.follower import FollowerOptions, follow
from client_sim.hints import remaining, sentence
from client_sim.leader import LeaderOptions, lead
from client_sim.outcome import FollowOutcome, FollowSummary, FrameRecord
from client_sim.service import ServiceClient
from client_sim.walk import Walk
from server.protocol.documents import RouteDocument
from server.protocol.messages import UpdateMessage

_STYLES = {"on_route": "green", "arrived": "bold green", "lost": "yellow", "searching": "dim"}


async def lead_with_progress(
    console: Console, service: ServiceClient, walk: Walk, options: LeaderOptions
) -> RouteDocument:
    """:func:`client_sim.leader.lead` with a progress bar for the upload and one for the build."""
    with Progress(
        TextColumn("{task.description:<22}"),
        BarColumn(bar_width=40),
        TaskProgressColumn(),
        TimeElapsedColumn(),
        console=console,
    ) as progress:
        upload = progress.add_task("Uploading the walk", total=1.0)
        build = progress.add_task("Building the map", total=1.0, start=False)

        def on_bytes(sent: int, total: int) -> None:
            progress.update(upload, completed=sent / total)

        def on_build(stage: str, fraction: float) -> None:
            progress.start_task(build)
            progress.update(build, completed=fraction, description=f"Building: {stage}")

        route = await lead(service, walk, options, on_bytes, on_build)
        progress.update(build, completed=1.0, description="The map is built")
    if route.report is not None and route.map is not None:
        report = route.report
        length = "scale unknown" if route.map.length_m is None else f"{route.map.length_m:.1f} m"
        console.print(
            f"[dim]{report.tracked_frames} of {report.frames} pictures tracked, "
            f"{report.keyframes} keyframes, {report.landmarks} landmarks, {length}, {route.map.turns} turns, "
            f"{route.map.bytes / 1e6:.1f} MB[/dim]"
        )
    return route


@dataclass(slots=True)
class HintPrinter:
    """Prints an update's sentence when it is another than the last and has stood for a moment.

    A walker swaying at the edge of a turn would otherwise be told both, again and again. Arrival is
    told at once.
    """

    console: Console
    last: str = field(default="", init=False)
    _candidate: str = field(default="", init=False)
    _since: float = field(default=0.0, init=False)

    def __call__(self, record: FrameRecord, update: UpdateMessage) -> None:
        """Say it if it is new and steady."""
        hint = sentence(update)
        if hint != self._candidate:
            self._candidate, self._since = hint, record.video_time
        steady = record.video_time - self._since >= STEADY_S or not self.last or update.state == "arrived"
        if hint == self.last or not steady:
            return
        self.last = hint
        left = ""
        if update.guidance is not None and update.state != "arrived":
            left = f"  [dim]{remaining(update.guidance)}[/dim]"
        style = _STYLES.get(update.state, "")
        text = f"[{style}]{hint}[/{style}]" if style else hint
        self.console.print(f"[dim]{record.video_time:6.1f} s[/dim]  {text}{left}")


STEADY_S = 0.3
"""Seconds a new sentence must stand before it is said."""


async def follow_with_hints(
    console: Console, url: str, route_id: str, walk: Walk, options: FollowerOptions
) -> FollowOutcome:
    """:func:`client_sim.follower.follow`, its hints printed as they come."""
    outcome = await follow(url, route_id, walk, options, HintPrinter(console))
    console.print(summary_table(outcome.summary()))
    return outcome


def summary_table(summary: FollowSummary) -> Table:
    """The replay's figures."""
    table = Table(title="The follower's walk", title_justify="left", show_header=False, box=None)
    table.add_column(style="dim")
    table.add_column(justify="right")
    table.add_row("pictures of the walk", str(summary.frames))
    table.add_row("sent", str(summary.sent))
    table.add_row("answered", str(summary.answered))
    table.add_row("relocalized", f"{summary.relocalized} ({summary.relocalized_fraction:.1%})")
    for reason, number in sorted(summary.lost.items()):
        table.add_row(f"no update: {reason}", str(number))
    if summary.age_p50_ms is not None and summary.age_p95_ms is not None:
        table.add_row("age, median", f"{summary.age_p50_ms:.0f} ms")
        table.add_row("age, 95 %", f"{summary.age_p95_ms:.0f} ms")
    if summary.reconnections:
        table.add_row("reconnections", str(summary.reconnections))
    if summary.progress is not None:
        table.add_row("progress at the end", f"{summary.progress:.0%}")
    table.add_row("arrived", "yes" if summary.arrived else "no")
    return table
