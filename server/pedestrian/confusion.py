"""p(detected | true) of the anchor detectors: DynamicSLAM's confusion matrix (Eq. 15-17)."""

from __future__ import annotations

from dataclasses import dataclass

from server.pedestrian.events import AnchorKind


@dataclass(frozen=True, slots=True)
class ConfusionRow:
    """What is detected where one kind of anchor is passed.

    Args:
        detected: probabilities; what is missing to one is "nothing".
        measured: on how many labelled passages it was estimated; 0: declared, by reasoning, not measured.
    """

    detected: dict[AnchorKind, float]
    measured: int

    @property
    def missed(self) -> float:
        return max(0.0, 1.0 - sum(self.detected.values()))


K = AnchorKind
CONFUSION: dict[AnchorKind, ConfusionRow] = {
    # By the legs alone, leaving one person out: 15 of 15 and 15 of 16 stretches in "pairnavi evaluate
    # positioning activities", each count raised by a half (Krichevsky and Trofimov's estimate).
    K.STAIRS_UP: ConfusionRow({K.STAIRS_UP: 0.94, K.STAIRS_DOWN: 0.03}, measured=15),
    K.STAIRS_DOWN: ConfusionRow({K.STAIRS_UP: 0.09, K.STAIRS_DOWN: 0.89}, measured=16),
    # No labelled recordings of these are at hand.
    K.LIFT: ConfusionRow({K.LIFT: 0.8, K.ESCALATOR: 0.1}, measured=0),
    K.ESCALATOR: ConfusionRow({K.ESCALATOR: 0.6, K.STAIRS_UP: 0.1, K.STAIRS_DOWN: 0.1}, measured=0),
    K.TURN: ConfusionRow({K.TURN: 0.9}, measured=0),
    K.DOOR: ConfusionRow({K.DOOR: 0.4, K.TURN: 0.1}, measured=0),
    K.ENTRANCE: ConfusionRow({K.ENTRANCE: 0.8}, measured=0),
}


def probability(detected: AnchorKind, true: AnchorKind) -> float:
    """p(detected | true), never quite zero: no sensor is that certain."""
    return max(0.01, CONFUSION[true].detected.get(detected, 0.0))
