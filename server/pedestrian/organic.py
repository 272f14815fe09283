"""Organic anchors: places with a signature of their own, found by clustering and learnt over many walks.

DynamicSLAM, 4.1.1: areas that no sensor was built to name, but that look alike whenever somebody passes.
A signature joins the nearest cluster if both it and its position agree with that, or begins a new one
(leader clustering: one pass, in the order of the walks, memory bounded by the area). A later signature is
compared with the clusters near where the walker is thought to be.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Distance = Callable[[Array, Array], Array]
"""Of signatures (N, F) to one (F,): (N,), zero where they are the same."""


def cosine_distance(known: Array, signature: Array) -> Array:
    """One less the cosine; both are unit vectors."""
    return np.asarray(1.0 - known @ signature)


def profile_distance(known: Array, signature: Array) -> Array:
    """Mean squared difference, microtesla^2, of profiles walked in the same or in the other direction."""
    back = signature.reshape(2, -1)[:, ::-1].ravel()
    return np.asarray(np.minimum(((known - signature) ** 2).mean(axis=1), ((known - back) ** 2).mean(axis=1)))


@dataclass(frozen=True, slots=True)
class OrganicOptions:
    """How signatures of one kind are clustered and recalled.

    Attributes:
        alike: distance below which a signature may join a cluster.
        scale: distance at which one cluster is e times less likely than another.
        unlike: distance beyond which nothing is recalled.
        reach: metres from where the walker is thought to be.
        floor: metres, the standard deviation of the best recollection.
        repetition: neighbouring signatures of one walk err together: as if so many were one.
    """

    alike: float
    scale: float
    unlike: float
    reach: float
    floor: float
    repetition: float


WIFI = OrganicOptions(alike=0.04, scale=0.05, unlike=1.0, reach=15.0, floor=3.0, repetition=10.0)
MAGNETIC = OrganicOptions(alike=1.0, scale=2.7, unlike=16.0, reach=8.0, floor=1.0, repetition=8.0)

_NEAREST = 2.0
"""Metres: no cluster is known better than this when clusters are weighed against each other."""


class OrganicAnchors:
    """Clusters of signatures of one kind; positions in metres."""

    def __init__(self, options: OrganicOptions, distance: Distance, size: int) -> None:
        self.options = options
        self._distance = distance
        self._count = 0
        self._signatures: Array = np.zeros((64, size))
        self._positions: Array = np.zeros((64, 2))
        self._variances: Array = np.zeros(64)
        self._members: Array = np.zeros(64)

    def __len__(self) -> int:
        return self._count

    @property
    def positions(self) -> Array:
        """(N, 2)."""
        return self._positions[: self._count].copy()

    def learn(self, signature: Array, position: tuple[float, float], variance: float) -> None:
        """One sighting (F,) of a walk whose position was known with ``variance``, m^2 on each axis."""
        place = np.array(position)
        near = self._near(place, 3.0 * np.sqrt(variance + self._variances[: self._count]))
        if len(near):
            distances = self._distance(self._signatures[near], signature)
            best = int(np.argmin(distances))
            if distances[best] < self.options.alike:
                self._join(int(near[best]), signature, place, variance)
                return
        self._begin(signature, place, variance)

    def recall(self, signature: Array, near: tuple[float, float]) -> tuple[tuple[float, float], Array] | None:
        """Where this has been seen within reach of ``near``: position and (2, 2) covariance, or ``None``."""
        options = self.options
        candidates = self._near(np.array(near), options.reach)
        if len(candidates) < 3:
            return None
        distances = self._distance(self._signatures[candidates], signature)
        if distances.min() > options.unlike:
            return None
        variances, places = self._variances[candidates], self._positions[candidates]
        weights = np.exp(-(distances - distances.min()) / options.scale) / (variances + _NEAREST**2)
        weights /= weights.sum()
        mean = weights @ places
        spread = float(weights @ ((places - mean) ** 2).sum(axis=1)) / 2.0 + float(weights @ variances)
        covariance = (options.floor**2 + options.repetition * spread) * np.eye(2)
        return (float(mean[0]), float(mean[1])), covariance

    def _near(self, place: Array, reach: Array | float) -> NDArray[np.intp]:
        offsets = self._positions[: self._count] - place
        return np.flatnonzero((offsets**2).sum(axis=1) < np.square(reach))

    def _join(self, index: int, signature: Array, place: Array, variance: float) -> None:
        members = self._members[index] + 1.0
        self._signatures[index] += (signature - self._signatures[index]) / members
        gain = self._variances[index] / (self._variances[index] + variance)
        self._positions[index] += gain * (place - self._positions[index])
        self._variances[index] *= 1.0 - gain
        self._members[index] = members

    def _begin(self, signature: Array, place: Array, variance: float) -> None:
        if self._count == len(self._members):
            self._signatures = np.concatenate([self._signatures, np.zeros_like(self._signatures)])
            self._positions = np.concatenate([self._positions, np.zeros_like(self._positions)])
            self._variances = np.concatenate([self._variances, np.zeros_like(self._variances)])
            self._members = np.concatenate([self._members, np.zeros_like(self._members)])
        index = self._count
        self._signatures[index], self._positions[index] = signature, place
        self._variances[index], self._members[index] = variance, 1.0
        self._count += 1
