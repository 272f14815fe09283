"""Organic anchors learnt from all walks of a floor but one, and that one followed with them.

What the others give is what their phones measured and where they started; their later waypoints are seen by
nothing here.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from server.evaluation.positioning.mall import MallWalk
from server.evaluation.positioning.tracks import Track, follow
from server.pedestrian.events import Event, MagneticSignature, WifiSignature
from server.pedestrian.organic import MAGNETIC, WIFI, OrganicAnchors, cosine_distance, profile_distance
from server.pedestrian.signatures import ProfileOptions, profile_vector, wifi_vector
from server.pedestrian.stream import PhoneStream, StreamOptions

Array = NDArray[np.float64]

Signature = MagneticSignature | WifiSignature


@dataclass(frozen=True, slots=True)
class Sighting:
    """A signature, where dead reckoning says it was met, and that position's variance."""

    signature: Signature
    position: tuple[float, float]
    variance: float


@dataclass(frozen=True, slots=True)
class Contribution:
    """What one walk gives to the others."""

    walk: str
    sightings: tuple[Sighting, ...] = field(repr=False)


class VenueAnchors:
    """A floor's organic anchors, of both kinds."""

    def __init__(self, contributions: Sequence[Contribution]) -> None:
        names: dict[str, int] = {}
        for contribution in contributions:
            for sighting in contribution.sightings:
                if isinstance(sighting.signature, WifiSignature):
                    for name, _ in sighting.signature.readings:
                        names.setdefault(name, len(names))
        self._names = names
        self._wifi = OrganicAnchors(WIFI, cosine_distance, len(names))
        self._magnetic = OrganicAnchors(MAGNETIC, profile_distance, 2 * ProfileOptions().samples)
        for contribution in contributions:
            for sighting in contribution.sightings:
                anchors, vector = self._vector(sighting.signature)
                anchors.learn(vector, sighting.position, sighting.variance)

    def recall(self, event: Signature, near: tuple[float, float]) -> tuple[tuple[float, float], Array] | None:
        anchors, vector = self._vector(event)
        return anchors.recall(vector, near)

    def _vector(self, event: Signature) -> tuple[OrganicAnchors, Array]:
        if isinstance(event, WifiSignature):
            return self._wifi, wifi_vector(event.readings, self._names)
        return self._magnetic, profile_vector(event.profile)


class Learner(PhoneStream):
    """A stream that notes where along its path it met its signatures."""

    def __init__(self, options: StreamOptions | None, start: tuple[float, float]) -> None:
        super().__init__(options, start)
        self._met: list[tuple[Signature, tuple[float, float]]] = []

    def react(self, events: list[Event]) -> None:
        if self.dead_reckoning.unbroken:
            for event in events:
                if isinstance(event, MagneticSignature | WifiSignature):
                    self._met.append((event, self.dead_reckoning.level_at(event.t)))

    def contribution(self, walk: str) -> Contribution:
        placed = [(event, *self.dead_reckoning.placed(level)) for event, level in self._met]
        return Contribution(walk, tuple(Sighting(*sighting) for sighting in placed))


class Anchored(PhoneStream):
    """A stream that takes a fix from a venue's anchors whenever it meets one."""

    def __init__(
        self, options: StreamOptions | None, start: tuple[float, float], venue: VenueAnchors
    ) -> None:
        super().__init__(options, start)
        self._venue = venue

    def react(self, events: list[Event]) -> None:
        for event in events:
            if isinstance(event, MagneticSignature | WifiSignature):
                recalled = self._venue.recall(event, self.dead_reckoning.position_at(event.t))
                if recalled is not None:
                    self.fix(event.t, *recalled)


def reckon_and_learn(walk: MallWalk, options: StreamOptions | None = None) -> tuple[Track, Contribution]:
    """Follow a walk from its start by its motion sensors, and note what it can give to others."""
    stream = Learner(options, walk.start)
    track = follow(walk, stream, stream.react)
    return track, stream.contribution(walk.name)


def follow_with_anchors(
    walk: MallWalk, contributions: Sequence[Contribution], options: StreamOptions | None = None
) -> Track:
    """Follow a walk with the anchors that all *other* walks have taught."""
    venue = VenueAnchors([c for c in contributions if c.walk != walk.name])
    stream = Anchored(options, walk.start, venue)
    return follow(walk, stream, stream.react)
