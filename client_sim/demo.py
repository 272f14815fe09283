"""The whole way on one machine: a service, a leader, a follower, a picture."""

from __future__ import annotations

import asyncio
import signal
import sys
import threading
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from rich.console import Console

from client_sim.console import BarReport, Bars, follow_with_hints, lead_with_bars, tell_map
from client_sim.errors import ServiceUnreachableError
from client_sim.follower import FollowerOptions
from client_sim.leader import LeaderOptions
from client_sim.outcome import FollowSummary
from client_sim.picture import draw_tracks
from client_sim.plan import FloorPlan
from client_sim.service import ServiceClient
from client_sim.walk import Walk
from server.protocol.documents import RouteDocument

_START_TIMEOUT_S = 60.0
_STOP_TIMEOUT_S = 15.0
LISTENING = "listening on "
"""What the service's first line begins with; its URL follows."""


@dataclass(frozen=True, slots=True)
class DemoOptions:
    """What is shown.

    Attributes:
        leader, follower: walks; both None for walks through the synthetic office, filmed on the spot.
        picture: where the picture goes.
        record: where the updates go, one JSON object a line; None for nowhere.
        service_log: where the service's log goes.
        speed: of the follower's replay, 1 is true speed.
    """

    leader: Walk | None
    follower: Walk | None
    picture: Path
    record: Path | None
    service_log: Path
    speed: float = 1.0


@dataclass(frozen=True, slots=True)
class _Stage:
    """Where the walks come from, and what is known about them.

    Attributes:
        leader, follower: give a walk; called off the event loop, with what to tell the progress.
        names: of the route.
        plan: of the building, if one is known.
    """

    leader: Callable[[BarReport], Walk]
    follower: Callable[[BarReport], Walk]
    names: LeaderOptions
    plan: FloorPlan | None = None


async def run_demo(console: Console, options: DemoOptions) -> FollowSummary:
    """Show it.

    Raises:
        ServiceUnreachableError: the service did not start; its log says why.
        RouteFailedError, NavigationRefusedError, ServiceRefusedError, WalkError: as leader and follower.
    """
    with TemporaryDirectory(prefix="pairnavi-demo-") as temporary:
        folder = Path(temporary)
        console.rule("[bold]The service[/bold]")
        async with child_service(folder / "data", options.service_log) as url:
            console.print(f"A service with an empty data folder runs at {url}")
            stage = await asyncio.to_thread(_set_stage, options, folder / "walks")
            async with ServiceClient(url) as service:
                console.rule("[bold]The leader[/bold]")
                route, follower = await _lead(console, service, stage)
                console.rule("[bold]The follower[/bold]")
                outcome = await follow_with_hints(
                    console, url, route.id, follower, FollowerOptions(speed=options.speed)
                )
                path = await service.path(route.id)
        await asyncio.to_thread(
            draw_tracks, route, path, outcome, options.picture, walk=follower, plan=stage.plan
        )
        console.print(f"Both tracks are drawn in [bold]{options.picture}[/bold]")
        if options.record is not None:
            await asyncio.to_thread(outcome.write, options.record)
            console.print(f"The updates are in [bold]{options.record}[/bold]")
        return outcome.summary()


def _set_stage(options: DemoOptions, folder: Path) -> _Stage:
    leader, follower = options.leader, options.follower
    if leader is not None and follower is not None:
        names = LeaderOptions(name="The demo", start_label="Start", destination_label="Destination")
        return _Stage(lambda report: leader, lambda report: follower, names)
    from client_sim.synthetic.demo import DESTINATION, START, DemoWalks
    from client_sim.synthetic.recordings import Role

    walks = DemoWalks()
    names = LeaderOptions("The demo", START, DESTINATION, walks.measured_length())

    def filmed(role: Role) -> Callable[[BarReport], Walk]:
        return lambda report: Walk.from_folder(walks.film(role, folder, lambda done: report(done, None)))

    return _Stage(filmed(Role.LEADER), filmed(Role.FOLLOWER), names, walks.plan())


async def _lead(console: Console, service: ServiceClient, stage: _Stage) -> tuple[RouteDocument, Walk]:
    """The leader's route, and the follower's walk, which is filmed while the map is built."""
    over = threading.Event()

    def unless_over(report: BarReport) -> BarReport:
        def checked(fraction: float, now: str | None = None) -> None:
            # A thread cannot be cancelled: it ends at its next picture.
            if over.is_set():
                raise InterruptedError("the demo is over")
            report(fraction, now)

        return checked

    with Bars(console) as bars:
        filming = [unless_over(bars.bar(f"Filming the {who}'s walk")) for who in ("leader", "follower")]
        try:
            leader = await asyncio.to_thread(stage.leader, filming[0])
            async with asyncio.TaskGroup() as tasks:
                follower = tasks.create_task(asyncio.to_thread(stage.follower, filming[1]))
                route = tasks.create_task(lead_with_bars(bars, service, leader, stage.names))
        except ExceptionGroup as failures:
            raise failures.exceptions[0] from None
        finally:
            over.set()
    tell_map(console, route.result())
    return route.result(), follower.result()


@asynccontextmanager
async def child_service(data: Path, log: Path) -> AsyncIterator[str]:
    """A service in a process of its own, on a free loopback port; its URL.

    Raises:
        ServiceUnreachableError: it did not start.
    """
    log.parent.mkdir(parents=True, exist_ok=True)
    with log.open("wb") as errors:
        process = await asyncio.create_subprocess_exec(
            sys.executable,
            "-m",
            "server.cli",
            "serve",
            "--port",
            "0",
            "--data",
            str(data),
            stdout=asyncio.subprocess.PIPE,
            stderr=errors,
        )
        try:
            yield await _url(process, log)
        finally:
            await _stop(process)


async def _url(process: asyncio.subprocess.Process, log: Path) -> str:
    assert process.stdout is not None  # noqa: S101 - it was asked for
    try:
        line = await asyncio.wait_for(process.stdout.readline(), _START_TIMEOUT_S)
    except TimeoutError:
        line = b""
    text = line.decode().strip()
    if not text.startswith(LISTENING):
        raise ServiceUnreachableError(f"the service did not start; its log is {log}")
    return text.removeprefix(LISTENING)


async def _stop(process: asyncio.subprocess.Process) -> None:
    if process.returncode is None:
        process.send_signal(signal.SIGTERM)
    try:
        # Reads what is left of its output too, so that the pipe is closed when this returns.
        await asyncio.wait_for(process.communicate(), _STOP_TIMEOUT_S)
    except TimeoutError:
        process.kill()
        await process.communicate()
