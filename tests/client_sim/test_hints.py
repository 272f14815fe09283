from __future__ import annotations

import pytest

from client_sim.hints import remaining, sentence
from server.protocol.messages import Age, FrameCounts, GuidanceMessage, NextTurnMessage, UpdateMessage

NONE_YET = FrameCounts(received=0, answered=0, replaced=0, stale=0, bad=0)


def update(state: str, guidance: GuidanceMessage | None) -> UpdateMessage:
    return UpdateMessage(
        sequence=0,
        capture_time_us=0,
        age=Age(server_ms=1, capture_ms=None),
        state=state,
        fix=None,
        refusal=None,
        guidance=guidance,
        frames=NONE_YET,
    )


def guidance(
    instruction: str, turn: NextTurnMessage | None = None, remaining_m: float | None = None
) -> GuidanceMessage:
    return GuidanceMessage(
        progress=0.5,
        walked_m=None,
        remaining_m=remaining_m,
        remaining_s=31.6,
        instruction=instruction,
        bearing=0.0,
        next_turn=turn,
    )


@pytest.mark.parametrize(
    ("state", "given", "said"),
    [
        ("searching", None, "Looking for the route: point the phone forward and turn slowly."),
        ("lost", None, "The route is out of sight: go back to where you last saw it."),
        ("on_route", guidance("left"), "Turn left."),
        ("on_route", guidance("right"), "Turn right."),
        ("on_route", guidance("turn_around"), "Turn around."),
        ("on_route", guidance("straight"), "Go straight on to the destination."),
        ("arrived", guidance("straight"), "You have arrived."),
        ("on_route", None, "Hold the phone up, pointing forward."),
        (
            "on_route",
            guidance("straight", NextTurnMessage(angle=1.5, distance_m=7.6, seconds=9)),
            "Go straight on. Then turn left in 8 m.",
        ),
        (
            "on_route",
            guidance("straight", NextTurnMessage(angle=-0.5, distance_m=None, seconds=9)),
            "Go straight on. Then turn slightly right in about 10 seconds.",
        ),
        (
            "on_route",
            guidance("straight", NextTurnMessage(angle=-2.5, distance_m=0.2, seconds=1)),
            "Go straight on. Then turn sharply right in 1 m.",
        ),
        ("on_route", guidance("a code of the future"), "Go straight on to the destination."),
    ],
)
def test_hints_are_sentences(state: str, given: GuidanceMessage | None, said: str) -> None:
    assert sentence(update(state, given)) == said


def test_metres_are_said_only_if_they_are_known() -> None:
    assert remaining(guidance("straight")) == "about 32 s to go"
    assert remaining(guidance("straight", remaining_m=12.4)) == "12 m to go"
