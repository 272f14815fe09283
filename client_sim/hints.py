"""Hints as sentences: the service sends codes with numbers, words are the client's."""

from __future__ import annotations

import math

from server.protocol.messages import GuidanceMessage, NextTurnMessage, UpdateMessage

_SHARP = math.radians(120)
_SLIGHT = math.radians(40)
_NOW = 2.5
"""Seconds to a turn from which it is just ahead."""


def sentence(update: UpdateMessage) -> str:
    """What a person is told; the same sentence as before need not be said again."""
    if update.state == "arrived":
        return "You have arrived."
    if update.guidance is not None:
        return _instruction(update.guidance)
    match update.state:
        case "searching":
            return "Looking for the route: point the phone forward and turn slowly."
        case "lost":
            return "The route is out of sight: go back to where you last saw it."
        case _:
            return "Hold the phone up, pointing forward."


def refusal_sentence(reason: str) -> str:
    """Why a picture has no pose, for a person; codes of the future get a sentence too."""
    match reason:
        case "too_few_features":
            return "Nothing to see: hold the phone up, pointing forward."
        case "no_similar_place":
            return "Nothing on the route looks like this."
        case "ambiguous":
            return "Several places look like this."
        case _:
            return "Not sure where this is."


def _instruction(guidance: GuidanceMessage) -> str:
    match guidance.instruction:
        case "left" | "right":
            return f"Turn {guidance.instruction}."
        case "turn_around":
            return "Turn around."
        case "arrived":
            return "You have arrived."
        case _:
            if guidance.next_turn is None:
                return "Go straight on to the destination."
            return f"Go straight on. {_turn(guidance.next_turn)}"


def _turn(turn: NextTurnMessage) -> str:
    side = "left" if turn.angle > 0 else "right"
    sharpness = abs(turn.angle)
    adverb = "sharply " if sharpness >= _SHARP else "slightly " if sharpness < _SLIGHT else ""
    if turn.distance_m is not None:
        distance = max(1, round(turn.distance_m))
        return f"Then turn {adverb}{side} in {distance} m."
    if turn.seconds < _NOW:
        return f"Turn {adverb}{side} just ahead."
    seconds = 5 * max(1, round(turn.seconds / 5))
    return f"Then turn {adverb}{side} in about {seconds} seconds."


def remaining(guidance: GuidanceMessage) -> str:
    """How much is left: metres if the route knows them, else time."""
    if guidance.remaining_m is not None:
        return f"{guidance.remaining_m:.0f} m to go"
    return f"about {guidance.remaining_s:.0f} s to go"
