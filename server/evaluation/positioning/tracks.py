"""A phone's position by its own sensors, along recorded walks with surveyed waypoints."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from server.evaluation.positioning.mall import MallWalk
from server.pedestrian.events import Event
from server.pedestrian.stream import PhoneStream

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Track:
    """One walk as it was followed.

    Args:
        estimates: (W - 1, 2) at the waypoints after the start, by what had been handed over until then.
        covariances: (W - 1, 2, 2).
        path: (P, 2) positions as they were told, four a second.
        seconds: of processor time.
    """

    walk: MallWalk
    estimates: Array
    covariances: Array = field(repr=False)
    path: Array = field(repr=False)
    seconds: float = 0.0

    @property
    def errors(self) -> Array:
        """(W - 1,) metres."""
        return np.asarray(np.hypot(*(self.estimates - self.walk.waypoints[1:, 1:]).T))

    def consistency(self, survey: float = 0.5) -> Array:
        """(W - 1,) squared Mahalanobis distances: mean 2 where the covariances are honest.

        Args:
            survey: metres, how well a walker stands on a waypoint.
        """
        misses = self.estimates - self.walk.waypoints[1:, 1:]
        spread = self.covariances + survey**2 * np.eye(2)
        return np.asarray(np.einsum("ni,nij,nj->n", misses, np.linalg.inv(spread), misses))


def follow(walk: MallWalk, stream: PhoneStream, react: Callable[[list[Event]], None]) -> Track:
    """Replay a walk; the stream has been given its start and nothing else of the truth.

    Args:
        react: is handed the events of every sample before the next one is taken.
    """
    due = walk.waypoints[1:, 0].tolist()
    estimates: list[tuple[float, float]] = []
    covariances: list[Array] = []
    path: list[tuple[float, float]] = []
    told, begin = 0.0, time.process_time()

    def note() -> None:
        estimates.append(stream.position)
        covariances.append(stream.position_covariance)

    for t, sample in zip(walk.delivered, walk.samples, strict=True):
        while len(estimates) < len(due) and t > due[len(estimates)]:
            note()
        events = stream.push(sample)
        if events:
            react(events)
        if t >= told:
            path.append(stream.position)
            told = t + 0.25
    seconds = time.process_time() - begin
    while len(estimates) < len(due):
        note()
    return Track(
        walk,
        np.array(estimates).reshape(-1, 2),
        np.array(covariances).reshape(-1, 2, 2),
        np.array(path),
        seconds,
    )
