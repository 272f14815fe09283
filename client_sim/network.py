"""A bad network, the same every time: loss, delay and reordering from a seed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, slots=True)
class NetworkConditions:
    """What happens to a message on its way, each direction for itself.

    Attributes:
        loss: fraction that never arrives, 0 to 1.
        delay_s: that every message takes.
        jitter_s: standard deviation of what comes on top of it, never less than nothing.
        reorder: fraction held up by ``holdup_s`` so that later ones overtake them.
    """

    loss: float = 0.0
    delay_s: float = 0.0
    jitter_s: float = 0.0
    reorder: float = 0.0
    holdup_s: float = 0.25

    def __post_init__(self) -> None:
        if not (0 <= self.loss <= 1 and 0 <= self.reorder <= 1):
            raise ValueError("loss and reorder are fractions between 0 and 1")
        if min(self.delay_s, self.jitter_s, self.holdup_s) < 0:
            raise ValueError("delays are not negative")


class SimulatedLink:
    """One direction of the network.

    Args:
        generator: its only source of chance: the same generator state and the same sending times
            give the same arrivals.
    """

    def __init__(self, conditions: NetworkConditions, generator: np.random.Generator) -> None:
        self._conditions = conditions
        self._generator = generator
        self._latest = float("-inf")

    def arrival(self, sent: float) -> float | None:
        """When a message sent at ``sent`` (seconds) arrives, None if never.

        Messages that are not held up keep their order, as on one connection.
        """
        conditions = self._conditions
        # All are drawn every time, so that one setting does not shift another's draws.
        lost, held = self._generator.random(2)
        jitter = abs(self._generator.standard_normal()) * conditions.jitter_s
        if lost < conditions.loss:
            return None
        arrival = sent + conditions.delay_s + jitter
        if held < conditions.reorder:
            return arrival + conditions.holdup_s
        self._latest = max(self._latest, arrival)
        return self._latest


def links(conditions: NetworkConditions, seed: int) -> tuple[SimulatedLink, SimulatedLink]:
    """The way up and the way down, independent of each other."""
    up, down = np.random.default_rng(seed).spawn(2)
    return SimulatedLink(conditions, up), SimulatedLink(conditions, down)
