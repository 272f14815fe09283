"""The command ``pairnavi``."""

from __future__ import annotations

import asyncio
import sys
from collections.abc import Coroutine
from pathlib import Path
from typing import Annotated, Any, Literal, NoReturn, TypeVar

import typer

from server.commands.lazy_group import lazy_group

T = TypeVar("T")

app = typer.Typer(
    help="Indoor navigation from one walked video: a leader walks the way once, anybody follows.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
)
sim = typer.Typer(
    help="The reference phone: record walks, replay them over the real protocol.", no_args_is_help=True
)
app.add_typer(sim, name="sim")
# These two need the whole of the algorithms.
app.add_typer(
    typer.Typer(
        cls=lazy_group("server.commands.maps:app"),
        help="Make a route map on this machine, look into it, write and read other formats.",
        no_args_is_help=True,
    ),
    name="map",
)
app.add_typer(
    typer.Typer(
        cls=lazy_group("server.evaluation.commands:app"),
        help="Judge routes and followers against recorded truth.",
        no_args_is_help=True,
    ),
    name="evaluate",
)

DEFAULT_SERVER = "http://127.0.0.1:8000"

WalkFolder = Annotated[
    Path,
    typer.Argument(
        help="Folder with video.mp4 and, if the camera is known, camera.json.",
        metavar="WALK",
        show_default=False,
    ),
]
Server = Annotated[str, typer.Option("--server", envvar="PAIRNAVI_SERVER", help="URL of the service.")]


@app.command()
def serve(
    host: Annotated[str | None, typer.Option(help="Address to listen on; loopback by default.")] = None,
    port: Annotated[int | None, typer.Option(help="Port; 0 takes a free one.", min=0, max=65535)] = None,
    data: Annotated[Path | None, typer.Option(help="Folder of the database and the files.")] = None,
) -> None:
    """Start the service. Everything else is set by PAIRNAVI_* variables."""
    from pydantic import ValidationError

    from server.api.serving import serve as serve_app
    from server.settings import Settings
    from server.workers.logs import configure_logs

    given: dict[str, Any] = {"host": host, "port": port, "data_dir": data}
    try:
        settings = Settings(**{name: value for name, value in given.items() if value is not None})
    except ValidationError as error:
        _fail(f"the settings are not valid: {error}")
    configure_logs(as_json=settings.log_json)
    try:
        started = serve_app(settings, lambda url: print(f"listening on {url}", flush=True))
    except OSError as error:
        _fail(f"cannot listen on {settings.host}:{settings.port}: {error.strerror or error}")
    except KeyboardInterrupt:
        return
    if not started:
        _fail("the service did not start; its log says why")


@sim.command("leader")
def sim_leader(
    walk: WalkFolder,
    server: Server = DEFAULT_SERVER,
    name: Annotated[str | None, typer.Option(help="Of the route; the folder's name by default.")] = None,
    start: Annotated[str, typer.Option(help="What the start is called.")] = "Start",
    destination: Annotated[str, typer.Option(help="What the destination is called.")] = "Destination",
    measured_length: Annotated[
        float | None, typer.Option(help="Length of the walked path in metres, if measured: fixes the scale.")
    ] = None,
) -> None:
    """Upload a walk, wait for its map, print the route's id."""
    from rich.console import Console

    from client_sim.console import lead_with_progress
    from client_sim.leader import LeaderOptions
    from client_sim.service import ServiceClient
    from client_sim.walk import Walk

    async def run() -> str:
        recorded = Walk.from_folder(walk)
        options = LeaderOptions(name or recorded.name, start, destination, measured_length)
        async with ServiceClient(server) as service:
            route = await lead_with_progress(Console(stderr=True), service, recorded, options)
        return route.id

    # Alone on standard output, so that a script can take it.
    print(_run(run()))


@sim.command("follower")
def sim_follower(
    walk: WalkFolder,
    route: Annotated[str, typer.Option("--route", help="Id of the route.", show_default=False)],
    server: Server = DEFAULT_SERVER,
    speed: Annotated[float, typer.Option(help="1 is true speed.", min=0.01)] = 1.0,
    jpeg_quality: Annotated[int, typer.Option(help="Of the pictures sent.", min=1, max=100)] = 85,
    loss: Annotated[float, typer.Option(help="Fraction lost on the way, each way.", min=0, max=1)] = 0.0,
    delay: Annotated[float, typer.Option(help="Milliseconds on the way, each way.", min=0)] = 0.0,
    jitter: Annotated[float, typer.Option(help="Standard deviation of the delay, ms.", min=0)] = 0.0,
    reorder: Annotated[float, typer.Option(help="Fraction overtaken by later ones.", min=0, max=1)] = 0.0,
    seed: Annotated[int, typer.Option(help="Of loss, delay and reordering.", min=0)] = 0,
    record: Annotated[
        Path | None, typer.Option(help="Write every picture's update there, one JSON object a line.")
    ] = None,
    picture: Annotated[Path | None, typer.Option(help="Draw both tracks there, PNG.")] = None,
) -> None:
    """Replay a walk on a route, print the hints and a summary."""
    from rich.console import Console

    from client_sim.console import follow_with_hints
    from client_sim.follower import FollowerOptions
    from client_sim.network import NetworkConditions
    from client_sim.picture import draw_tracks
    from client_sim.service import ServiceClient
    from client_sim.walk import Walk

    options = FollowerOptions(
        speed=speed,
        jpeg_quality=jpeg_quality,
        network=NetworkConditions(loss, delay / 1e3, jitter / 1e3, reorder),
        seed=seed,
    )

    async def run() -> None:
        outcome = await follow_with_hints(Console(), server, route, Walk.from_folder(walk), options)
        if record is not None:
            await asyncio.to_thread(outcome.write, record)
        if picture is not None:
            async with ServiceClient(server) as service:
                document, path = await service.route(route), await service.path(route)
            await asyncio.to_thread(draw_tracks, document, path, outcome, picture)

    _run(run())


@sim.command(
    "record",
    add_help_option=False,
    context_settings={"ignore_unknown_options": True, "allow_extra_args": True, "help_option_names": []},
)
def sim_record(context: typer.Context) -> None:
    """Record a walk through the synthetic building, as a walk folder with its truth."""
    from client_sim.synthetic.commands import app as recording

    recording(args=context.args, prog_name="pairnavi sim record")


@app.command()
def demo(
    leader: Annotated[Path | None, typer.Option(help="The leader's video.")] = None,
    leader_camera: Annotated[Path | None, typer.Option(help="JSON of its camera, if known.")] = None,
    follower: Annotated[Path | None, typer.Option(help="The follower's video.")] = None,
    follower_camera: Annotated[Path | None, typer.Option(help="JSON of its camera, if known.")] = None,
    out: Annotated[Path, typer.Option(help="Folder for the picture and the service's log.")] = Path("out"),
    record: Annotated[Path | None, typer.Option(help="Write the updates there, JSON lines.")] = None,
    speed: Annotated[float, typer.Option(help="Of the follower's walk, 1 is true speed.", min=0.01)] = 1.0,
) -> None:
    """Show the whole way: a service, a leader's walk, its map, a follower guided on it.

    Without videos both walks are filmed in the synthetic office; the follower's lens is covered once.
    """
    from rich.console import Console

    from client_sim.demo import DemoOptions, run_demo
    from client_sim.walk import Walk

    if (leader is None) is not (follower is None):
        _fail("give --leader and --follower together, or none of them")
    if leader is None and (leader_camera or follower_camera):
        _fail("a camera is that of a video: give --leader and --follower too")

    async def run() -> bool:
        lead_walk = follow_walk = None
        if leader is not None and follower is not None:
            lead_walk = Walk.from_files(leader, leader_camera)
            follow_walk = Walk.from_files(follower, follower_camera)
        options = DemoOptions(
            lead_walk, follow_walk, out / "demo.png", record, out / "demo-service.log", speed
        )
        return (await run_demo(Console(), options)).relocalized > 0

    if not _run(run()):
        _fail("the follower was never found on the route")


@app.command()
def spec(
    document: Annotated[Literal["openapi", "asyncapi"], typer.Argument(help="Of HTTP, or of the socket.")],
    out: Annotated[Path | None, typer.Option(help="Write there instead of to standard output.")] = None,
) -> None:
    """Write the contract for machines: OpenAPI 3.1 of HTTP, AsyncAPI 3.0 of the navigation socket."""
    from server.api.specification import specification

    text = specification(document)
    if out is None:
        sys.stdout.write(text)
    else:
        out.write_text(text, encoding="utf-8")


def _run(work: Coroutine[Any, Any, T]) -> T:
    """Run a phone's work; its expected failures become one line and exit code 1."""
    from client_sim.errors import (
        NavigationRefusedError,
        RouteFailedError,
        ServiceRefusedError,
        ServiceUnreachableError,
        WalkError,
    )

    try:
        return asyncio.run(work)
    except RouteFailedError as error:
        failure = error.route.failure
        _fail(f"the map could not be built ({failure.reason if failure else 'unknown'}): {error}")
    except (NavigationRefusedError, ServiceRefusedError, ServiceUnreachableError, WalkError) as error:
        _fail(str(error))
    except KeyboardInterrupt:
        raise typer.Exit(130) from None


def _fail(message: str) -> NoReturn:
    print(f"pairnavi: {message}", file=sys.stderr)
    raise typer.Exit(1)


def main() -> None:
    """Entry point."""
    app()


if __name__ == "__main__":
    main()
