"""Leader and follower on a terminal: progress bars, hints as they come, a table at the end."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from types import TracebackType
from typing import Self

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, Progress, TaskID, TaskProgressColumn, TextColumn, TimeElapsedColumn
from rich.table import Table

from client_sim.errors import RouteFailedError
from client_sim.follower import FollowerOptions, follow
from client_sim.hints import refusal_sentence, remaining, sentence
from client_sim.leader import LeaderOptions, lead
from client_sim.outcome import FollowOutcome, FollowSummary, FrameRecord
from client_sim.service import ServiceClient
from client_sim.walk import Walk
from server.protocol.documents import RouteDocument
from server.protocol.messages import UpdateMessage
from server.protocol.quality import QualityDocument

_STYLES = {"on_route": "green", "arrived": "bold green", "lost": "yellow", "searching": "dim"}

STEADY_S = 0.3
"""Seconds a new sentence must stand before it is said, and refusals must last before they are told."""


BarReport = Callable[[float, str | None], None]
"""Called with the fraction done, 0 to 1, and with another description where there is one."""


class Bars:
    """Progress bars, each drawn from its first progress on: what never begins leaves nothing behind."""

    def __init__(self, console: Console) -> None:
        self._progress = Progress(
            TextColumn("{task.description:<34}"),
            BarColumn(bar_width=40),
            TaskProgressColumn(),
            TimeElapsedColumn(),
            console=console,
        )

    def __enter__(self) -> Self:
        """Nothing is drawn yet."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Leave the bars as they stand."""
        if self._progress.tasks:
            self._progress.stop()

    def bar(self, description: str) -> BarReport:
        """A bar that is still to begin."""
        task: TaskID | None = None

        def report(fraction: float, now: str | None = None) -> None:
            nonlocal task
            if task is None:
                self._progress.start()
                task = self._progress.add_task(description, total=1.0)
            self._progress.update(task, completed=fraction, description=now or description)

        return report


async def lead_with_progress(
    console: Console, service: ServiceClient, walk: Walk, options: LeaderOptions
) -> RouteDocument:
    """:func:`client_sim.leader.lead` with a progress bar for the upload and one for the build."""
    try:
        with Bars(console) as bars:
            route = await lead_with_bars(bars, service, walk, options)
    except RouteFailedError as error:
        await _tell_quality(console, service, error.route.id)
        raise
    tell_map(console, route)
    await _tell_quality(console, service, route.id)
    return route


async def lead_with_bars(
    bars: Bars, service: ServiceClient, walk: Walk, options: LeaderOptions
) -> RouteDocument:
    """The same in bars that others share."""
    upload, build = bars.bar("Uploading the leader's video"), bars.bar("Mapping")
    route = await lead(
        service,
        walk,
        options,
        lambda sent, total: upload(sent / total, None),
        lambda stage, fraction: build(fraction, f"Mapping: {stage}"),
    )
    build(1.0, "The map is built")
    return route


def tell_map(console: Console, route: RouteDocument) -> None:
    """A line about a finished map."""
    if route.report is None or route.map is None:
        return
    report = route.report
    length = "scale unknown" if route.map.length_m is None else f"{route.map.length_m:.1f} m"
    console.print(
        f"[dim]{report.tracked_frames} of {report.frames} pictures tracked, "
        f"{report.keyframes} keyframes, {report.landmarks} landmarks, {length}, {route.map.turns} turns, "
        f"{route.map.bytes / 1e6:.1f} MB[/dim]"
    )


async def _tell_quality(console: Console, service: ServiceClient, route_id: str) -> None:
    quality = await service.quality(route_id)
    if quality is not None:
        tell_quality(console, quality)


def tell_quality(console: Console, quality: QualityDocument) -> None:
    """The verdict on a leader's walk, and a line about every weak stretch."""
    style = "yellow" if quality.record_again else "green"
    console.print(f"[{style}]{quality.score} of 100. {escape(quality.verdict)}[/{style}]")
    for stretch in quality.stretches:
        console.print(
            f"  [bold]{stretch.start_s:6.1f} - {stretch.end_s:.1f} s[/bold]  {escape(stretch.detail)}"
        )
    for note in quality.notes:
        console.print(f"  [dim]{escape(note)}[/dim]")


@dataclass(slots=True)
class HintPrinter:
    """Prints an update's sentence when it is another than the last and has stood for a moment.

    A walker swaying at the edge of a turn would otherwise be told both, again and again. Arrival is
    told at once. Refusals are told when they last, with their reason, and so is their end.
    """

    console: Console
    last: str = field(default="", init=False)
    _candidate: str = field(default="", init=False)
    _since: float = field(default=0.0, init=False)
    _fixed: float | None = field(default=None, init=False)
    _refused_for: str | None = field(default=None, init=False)

    def __call__(self, record: FrameRecord, update: UpdateMessage) -> None:
        """Say it if it is new and steady."""
        self._tell_refusals(record, update)
        hint = sentence(update)
        if hint != self._candidate:
            self._candidate, self._since = hint, record.video_time
        steady = record.video_time - self._since >= STEADY_S or not self.last or update.state == "arrived"
        told = self._refused_for is not None and update.state != "lost"
        if hint == self.last or not steady or told:
            return
        self.last = hint
        left = ""
        if update.guidance is not None and update.state != "arrived":
            left = f"  [dim]{remaining(update.guidance)}[/dim]"
        style = _STYLES.get(update.state, "")
        self._say(record, f"[{style}]{hint}[/{style}]{left}" if style else f"{hint}{left}")

    def _tell_refusals(self, record: FrameRecord, update: UpdateMessage) -> None:
        if update.fix is not None:
            if self._refused_for is not None and self._fixed is not None:
                blind = record.video_time - self._fixed
                self._say(record, f"[bold green]Found again, {blind:.1f} s after the last fix.[/bold green]")
                # Whatever was said before the darkness is worth saying again.
                self.last = self._candidate = ""
            self._fixed, self._refused_for = record.video_time, None
            return
        if update.refusal is None or self._fixed is None:
            return
        lasting = record.video_time - self._fixed > STEADY_S
        if lasting and self._refused_for is None:
            self._refused_for = update.refusal.reason
            why = refusal_sentence(update.refusal.reason)
            self._say(record, f"[red]Refused, not guessed ({update.refusal.reason}).[/red] {why}")

    def _say(self, record: FrameRecord, text: str) -> None:
        self.console.print(f"[dim]{record.video_time:6.1f} s[/dim]  {text}")


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
    for reason, number in sorted(summary.refused.items()):
        table.add_row(f"refused: {reason}", str(number))
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
