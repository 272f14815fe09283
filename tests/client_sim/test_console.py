"""What is said on a terminal, and what is not."""

from __future__ import annotations

from collections.abc import Sequence
from io import StringIO
from pathlib import Path

import pytest
from recorded_video import write_walk
from rich.console import Console

from client_sim.console import Bars, HintPrinter, lead_with_progress, summary_table, tell_quality
from client_sim.errors import ServiceUnreachableError
from client_sim.leader import LeaderOptions
from client_sim.outcome import FollowOutcome, FrameRecord
from client_sim.service import ServiceClient
from client_sim.walk import Walk
from server.protocol.messages import (
    Age,
    FixMessage,
    FrameCounts,
    GuidanceMessage,
    RefusalMessage,
    UpdateMessage,
)
from server.protocol.quality import QualityDocument, WeakStretch

COUNTS = FrameCounts(received=0, answered=0, replaced=0, stale=0, bad=0)
FIX = FixMessage(
    position=(0.0, 0.0, 0.0),
    orientation=(0.0, 0.0, 0.0, 1.0),
    position_sigma=0.1,
    rotation_sigma=0.1,
    inliers=40,
    matches=60,
    keyframe=1,
)


def _update(
    number: int, instruction: str | None, refused: str | None, state: str = "on_route"
) -> UpdateMessage:
    guidance = None
    if instruction is not None:
        guidance = GuidanceMessage(
            progress=0.5,
            walked_m=None,
            remaining_m=None,
            remaining_s=12.0,
            instruction=instruction,
            bearing=0.0,
            next_turn=None,
        )
    return UpdateMessage(
        sequence=number,
        capture_time_us=0,
        age=Age(server_ms=1, capture_ms=None),
        state=state,
        fix=None if refused else FIX,
        refusal=RefusalMessage(reason=refused, inliers=0) if refused else None,
        guidance=guidance,
        frames=COUNTS,
    )


def _told(story: Sequence[tuple[str | None, str | None, str]]) -> tuple[list[str], FollowOutcome]:
    """Lines that are printed for pictures ten a second: instruction, reason of a refusal, state."""
    console = Console(file=StringIO(), width=120)
    printer = HintPrinter(console)
    outcome = FollowOutcome("route")
    for number, (instruction, refused, state) in enumerate(story):
        update = _update(number, instruction, refused, state)
        record = FrameRecord(number, number, number / 10, number / 10, age_ms=20.0, update=update)
        outcome.records.append(record)
        printer(record, update)
    assert isinstance(console.file, StringIO)
    return console.file.getvalue().splitlines(), outcome


def test_a_darkness_and_its_end_are_told() -> None:
    seen, dark = ("straight", None, "on_route"), (None, "too_few_features", "on_route")
    lines, outcome = _told([seen] * 10 + [dark] * 20 + [seen] * 10)
    assert [line[10:] for line in lines] == [
        "Go straight on to the destination.  about 12 s to go",
        "Refused, not guessed (too_few_features). Nothing to see: hold the phone up, pointing forward.",
        "Found again, 2.1 s after the last fix.",
        "Go straight on to the destination.  about 12 s to go",
    ]
    assert lines[1].split()[0] == "1.3"
    summary = outcome.summary()
    assert summary.refused == {"too_few_features": 20}
    assert summary.relocalized == 20


def test_a_single_refused_picture_is_not_told() -> None:
    seen, dark = ("straight", None, "on_route"), ("straight", "too_few_inliers", "on_route")
    lines, _ = _told([seen] * 10 + [dark] + [seen] * 10)
    assert len(lines) == 1


def test_being_lost_is_told_in_the_dark_too() -> None:
    dark, lost = (None, "no_similar_place", "on_route"), (None, "no_similar_place", "lost")
    lines, _ = _told([("straight", None, "on_route")] * 5 + [dark] * 30 + [lost] * 10)
    assert "out of sight" in lines[-1]


def test_a_sentence_must_stand_for_a_moment_and_arrival_need_not() -> None:
    straight, left = ("straight", None, "on_route"), ("left", None, "on_route")
    lines, _ = _told([straight] * 5 + [left] * 2 + [straight] * 5 + [("arrived", None, "arrived")])
    assert [line[10:] for line in lines] == [
        "Go straight on to the destination.  about 12 s to go",
        "You have arrived.",
    ]


def test_the_table_says_why_pictures_were_refused() -> None:
    _, outcome = _told([("straight", None, "on_route")] * 5 + [(None, "ambiguous", "on_route")] * 2)
    console = Console(file=StringIO(), width=80)
    console.print(summary_table(outcome.summary()))
    assert isinstance(console.file, StringIO)
    text = " ".join(console.file.getvalue().split())
    assert "refused: ambiguous 2" in text
    assert "relocalized 5 (71.4%)" in text


async def test_nothing_is_drawn_for_a_service_that_does_not_answer(tmp_path: Path) -> None:
    walk = Walk.from_folder(write_walk(tmp_path / "walk", frames=2, fps=10))
    console = Console(file=StringIO(), width=100, force_terminal=True)
    async with ServiceClient("http://127.0.0.1:9") as nobody:
        with pytest.raises(ServiceUnreachableError):
            await lead_with_progress(console, nobody, walk, LeaderOptions())
    assert isinstance(console.file, StringIO)
    assert console.file.getvalue() == ""


def test_a_bar_appears_with_its_first_progress() -> None:
    console = Console(file=StringIO(), width=100, force_terminal=True)
    with Bars(console) as bars:
        bars.bar("never begun")
        report = bars.bar("begun")
        report(0.5, None)
        report(1.0, "done")
    assert isinstance(console.file, StringIO)
    text = console.file.getvalue()
    assert "never begun" not in text
    assert "done" in text
    assert "100%" in text


def test_a_leader_is_told_what_is_weak_and_what_to_do() -> None:
    out = StringIO()
    weak = WeakStretch(
        start_s=4.5,
        end_s=6.5,
        reason="too_dark",
        severity=1.0,
        detail="Too dark [very]: turn on the light.",
        thumbnail=None,
    )
    quality = QualityDocument(
        score=40,
        record_again=True,
        verdict="Record the walk again.",
        coverage=0.8,
        video_s=20.0,
        stretches=(weak,),
        notes=("The camera stood still.",),
        landmarks=(500,),
        picture=None,
    )
    tell_quality(Console(file=out, width=100), quality)
    said = out.getvalue()
    assert "40 of 100. Record the walk again." in said
    assert "4.5 - 6.5 s" in said
    assert "Too dark [very]: turn on the light." in said
    assert "stood still" in said
