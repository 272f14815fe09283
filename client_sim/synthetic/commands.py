"""The command ``pairnavi sim record``."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from client_sim.console import Bars
from client_sim.synthetic.office import build_office
from client_sim.synthetic.recordings import PHONES, Role, Span, WalkPlan, plan_recording
from client_sim.synthetic.walk_folders import write_recording

app = typer.Typer(add_completion=False, rich_markup_mode=None)


@app.command()
def record(
    out: Annotated[Path, typer.Argument(metavar="OUT", help="Walk folder to write.", show_default=False)],
    route: Annotated[str, typer.Option(help="Of the building: main (60 m, six turns) or stairs.")] = "main",
    role: Annotated[
        Role, typer.Option(help="A follower strays, and has another phone and gait.")
    ] = Role.LEADER,
    seed: Annotated[int, typer.Option(help="Of this walk: steps, hand, noise, who passes.", min=0)] = 1,
    building: Annotated[int, typer.Option(help="Seed of the building.", min=0)] = 7,
    day: Annotated[
        int | None, typer.Option(help="Seed of another day: things moved, other light.", min=0)
    ] = None,
    phone: Annotated[str | None, typer.Option(help=f"One of {', '.join(PHONES)}.")] = None,
    portrait: Annotated[bool, typer.Option("--portrait", help="The phone is held upright.")] = False,
    speed: Annotated[float | None, typer.Option(help="Of walking, m/s.", min=0.3, max=2.5)] = None,
    height: Annotated[float | None, typer.Option(help="Of the phone, m.", min=0.3, max=2.4)] = None,
    wander: Annotated[
        float | None, typer.Option(help="Straying to the sides, m; 0.3 for a follower.", min=0.0, max=1.0)
    ] = None,
    people: Annotated[int, typer.Option(help="Who come towards the walker.", min=0, max=20)] = 0,
    pause: Annotated[
        list[str] | None, typer.Option(metavar="METRES:SECONDS", help="Stand still there so long.")
    ] = None,
    leave: Annotated[
        float | None, typer.Option(metavar="METRES", help="Leave the route there, by --aside.", min=0.1)
    ] = None,
    aside: Annotated[
        list[str] | None, typer.Option(metavar="X,Y,Z", help="A floor point walked to and back from.")
    ] = None,
    turn_back: Annotated[
        float | None, typer.Option(metavar="METRES", help="Turn round there, go back a little.", min=3.1)
    ] = None,
    cover: Annotated[
        list[str] | None, typer.Option(metavar="BEGIN:END", help="Seconds with the lens covered.")
    ] = None,
    shake: Annotated[
        list[str] | None, typer.Option(metavar="BEGIN:END", help="Seconds of shaking: blurred pictures.")
    ] = None,
    wall: Annotated[
        list[str] | None, typer.Option(metavar="BEGIN:END", help="Seconds turned to the wall on the left.")
    ] = None,
    roll: Annotated[
        float | None, typer.Option(metavar="SECONDS", help="Roll the phone on its side then.", min=0.0)
    ] = None,
    fps: Annotated[float, typer.Option(help="Pictures a second.", min=1.0, max=60.0)] = 10.0,
) -> None:
    """Record a walk through the synthetic building: video, camera, truth, sensors, masks of people.

    OUT is a walk folder as `pairnavi evaluate` and `pairnavi sim leader` or `follower` read it. The same
    options always give the same walk; walks of one building seed share its rooms, steel and access points.
    Options given as BEGIN:END and the like may be repeated.
    """
    try:
        plan = WalkPlan(
            role=role,
            seed=seed,
            speed=speed,
            height=height,
            wander=wander,
            phone=phone,
            portrait=portrait,
            people=people,
            pauses=tuple(_pair(text) for text in pause or ()),
            leave=leave,
            aside=tuple(_point(text) for text in aside or ()),
            turn_back=turn_back,
            covered=tuple(Span(*_pair(text)) for text in cover or ()),
            shaken=tuple(Span(*_pair(text)) for text in shake or ()),
            walls=tuple(Span(*_pair(text)) for text in wall or ()),
            rolled=roll,
        )
        recording = plan_recording(build_office(building, change=day), route, plan, fps=fps)
    except ValueError as error:
        print(f"pairnavi: {error}", file=sys.stderr)
        raise typer.Exit(1) from None
    console = Console(stderr=True)
    with Bars(console) as bars:
        filmed = bars.bar(f"Recording {out.name}")
        write_recording(out, recording, lambda done: filmed(done, None), building_seed=building)
    motion = recording.motion
    console.print(f"{motion.length:.1f} m, {motion.duration:.1f} s, {len(motion.steps)} steps in {out}")


def _pair(text: str) -> tuple[float, float]:
    """Two numbers with a colon between them.

    Raises:
        ValueError: it is something else.
    """
    first, _, second = text.partition(":")
    try:
        return float(first), float(second)
    except ValueError:
        raise ValueError(f"{text!r}: expected two numbers with a colon between them, as 12:14.5") from None


def _point(text: str) -> tuple[float, float, float]:
    """Three numbers with commas between them.

    Raises:
        ValueError: it is something else.
    """
    try:
        x, y, z = (float(part) for part in text.split(","))
    except ValueError:
        raise ValueError(f"{text!r}: expected a point as x,y,z in metres, as 12,3.5,0") from None
    return x, y, z
