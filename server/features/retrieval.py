"""Place retrieval: which keyframes look most like a picture.

Every feature votes, through its nearest landmark descriptor, for the keyframes that saw the landmark
(exact Hamming search by faiss in place of the bag of words of Gálvez-López and Tardós 2012, which
Pair-Navi names: a route is small enough that nothing has to be quantised).
"""

from __future__ import annotations

from dataclasses import dataclass

import faiss
import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class RetrievalOptions:
    """Settings of :class:`PlaceIndex`.

    Attributes:
        queries: features that vote; max_distance: Hamming distance up to which a vote counts, bits.
        spread: neighbouring keyframes (in order of the walk) whose votes are pooled.
    """

    queries: int = 600
    max_distance: int = 52
    spread: int = 2


@dataclass(frozen=True, slots=True)
class PlaceCandidate:
    """A keyframe and the votes of its neighbourhood."""

    keyframe: int
    votes: float


class PlaceIndex:
    """Nearest-landmark voting over the keyframes of one map."""

    def __init__(
        self,
        descriptors: NDArray[np.uint8],
        offsets: NDArray[np.int64],
        landmarks: NDArray[np.int32],
        options: RetrievalOptions | None = None,
    ) -> None:
        """
        Args:
            descriptors: (P, 32) of the landmarks.
            offsets: (K + 1,), landmarks: (M,): keyframe k sees ``landmarks[offsets[k]:offsets[k + 1]]``.
        """
        self.options = options or RetrievalOptions()
        self.keyframes = len(offsets) - 1
        self._index = faiss.IndexBinaryFlat(descriptors.shape[1] * 8)
        self._index.add(np.ascontiguousarray(descriptors))
        keyframe_of = np.repeat(np.arange(self.keyframes), np.diff(offsets))
        order = np.argsort(landmarks, kind="stable")
        self._seen_by = keyframe_of[order]
        self._starts = np.searchsorted(landmarks[order], np.arange(len(descriptors) + 1))

    def query(
        self, descriptors: NDArray[np.uint8], count: int, *, limit: int | None = None
    ) -> list[PlaceCandidate]:
        """The ``count`` best keyframes for a picture's descriptors (N, 32), at least ``spread`` apart.

        Args:
            limit: only keyframes before this one are considered.
        """
        options = self.options
        if len(descriptors) == 0 or self.keyframes == 0:
            return []
        step = max(1, len(descriptors) // options.queries)
        distance, nearest = self._index.search(np.ascontiguousarray(descriptors[::step]), 1)
        good = distance[:, 0] <= options.max_distance
        landmark = nearest[good, 0]
        begin, end = self._starts[landmark], self._starts[landmark + 1]
        counts = end - begin
        rows = np.repeat(begin - np.cumsum(counts) + counts, counts) + np.arange(int(counts.sum()))
        # A landmark seen from everywhere says little about where one is.
        weights = np.repeat(1.0 / np.sqrt(np.maximum(counts, 1)), counts)
        votes = np.bincount(self._seen_by[rows], weights=weights, minlength=self.keyframes)
        limit = self.keyframes if limit is None else limit
        votes[limit:] = 0.0
        pooled = np.convolve(votes, np.ones(2 * options.spread + 1))[options.spread :][: self.keyframes]
        pooled[limit:] = 0.0
        candidates: list[PlaceCandidate] = []
        for _ in range(count):
            best = int(np.argmax(pooled))
            if pooled[best] <= 0:
                break
            candidates.append(PlaceCandidate(best, float(pooled[best])))
            pooled[max(0, best - 2 * options.spread) : best + 2 * options.spread + 1] = 0.0
        return candidates
