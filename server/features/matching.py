"""Matching of binary descriptors, with and without a geometric prediction."""

from __future__ import annotations

from dataclasses import dataclass

import faiss
import numpy as np
from numpy.typing import NDArray

Descriptors = NDArray[np.uint8]


@dataclass(frozen=True, eq=False, slots=True)
class Matches:
    """Pairs between two sets of features a and b, each member of b used at most once.

    Attributes:
        a, b: (N,) indices into the two sets.
        distance: (N,) Hamming distance, bits.
    """

    a: NDArray[np.intp]
    b: NDArray[np.intp]
    distance: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.a)

    def select(self, keep: NDArray[np.bool_]) -> Matches:
        """The matches where ``keep`` (N,) is true."""
        return Matches(self.a[keep], self.b[keep], self.distance[keep])


def _words(descriptors: Descriptors) -> NDArray[np.uint64]:
    return np.ascontiguousarray(descriptors).view(np.uint64)


def hamming(
    a: Descriptors, b: Descriptors, rows: NDArray[np.intp], columns: NDArray[np.intp]
) -> NDArray[np.int64]:
    """Distances between ``a[rows]`` and ``b[columns]``, (len(rows),) bits."""
    difference = _words(a)[rows] ^ _words(b)[columns]
    return np.asarray(np.bitwise_count(difference).sum(axis=1, dtype=np.int64))


def best_pairs(
    rows: NDArray[np.intp],
    columns: NDArray[np.intp],
    distance: NDArray[np.int64],
    *,
    max_distance: int,
    ratio: float,
    column_groups: NDArray[np.int64] | None = None,
) -> Matches:
    """Choose one column for each row out of candidate pairs, and one row for each column.

    Args:
        rows, columns, distance: (C,) candidate pairs.
        max_distance: greatest distance of a match, bits.
        ratio: a match needs ``distance < ratio * second best distance`` of its row (Lowe's test).
        column_groups: a label for every column index; a second best of the same label is no rival.
    """
    order = np.lexsort((distance, rows))
    rows, columns, distance = rows[order], columns[order], distance[order]
    first = np.flatnonzero(np.r_[True, rows[1:] != rows[:-1]]) if len(rows) else np.zeros(0, np.intp)
    second = first + 1
    has_second = second < len(rows)
    has_second[has_second] &= rows[second[has_second]] == rows[first[has_second]]
    rival = np.full(len(first), np.iinfo(np.int64).max // 2)
    rival[has_second] = distance[second[has_second]]
    if column_groups is not None:
        same = has_second.copy()
        same[has_second] = (
            column_groups[columns[second[has_second]]] == column_groups[columns[first[has_second]]]
        )
        rival[same] = np.iinfo(np.int64).max // 2
    good = (distance[first] <= max_distance) & (distance[first] < ratio * rival)
    rows, columns, distance = rows[first[good]], columns[first[good]], distance[first[good]]
    return _one_row_a_column(rows, columns, distance)


def _one_row_a_column(
    rows: NDArray[np.intp], columns: NDArray[np.intp], distance: NDArray[np.int64]
) -> Matches:
    """Of the pairs that want one column, the nearest; the pairs stay in their order."""
    order = np.lexsort((distance, columns))
    unique = order[np.r_[True, columns[order][1:] != columns[order][:-1]]] if len(order) else order
    unique.sort()
    return Matches(rows[unique], columns[unique], distance[unique])


def match_descriptors(
    a: Descriptors, b: Descriptors, *, max_distance: int = 64, ratio: float = 0.8
) -> Matches:
    """Nearest neighbours that pass the ratio test, each b given to its nearest a; no prediction."""
    if len(a) == 0 or len(b) < 2:
        return Matches(np.zeros(0, np.intp), np.zeros(0, np.intp), np.zeros(0, np.int64))
    distance, neighbours = nearest_descriptors(a, b, 2)
    rows = np.arange(len(a))
    good = (distance[:, 0] <= max_distance) & (distance[:, 0] < ratio * distance[:, 1])
    rows, columns, best = rows[good], neighbours[good, 0], distance[good, 0].astype(np.int64)
    return _one_row_a_column(rows, columns, best)


def nearest_descriptors(
    a: Descriptors, b: Descriptors, count: int
) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
    """The ``count`` nearest of b for every a: distances and indices, both (len(a), count)."""
    index = faiss.IndexBinaryFlat(b.shape[1] * 8)
    index.add(np.ascontiguousarray(b))
    distance, neighbours = index.search(np.ascontiguousarray(a), count)
    return distance, neighbours


def match_predicted(
    predicted: NDArray[np.float64],
    descriptors: Descriptors,
    pixels: NDArray[np.float64],
    candidates: Descriptors,
    *,
    radius: float | NDArray[np.float64],
    max_distance: int,
    ratio: float,
    predicted_octaves: NDArray[np.int64] | None = None,
    octaves: NDArray[np.int8] | None = None,
    octave_slack: int = 1,
) -> Matches:
    """Match landmarks to the features near where they are predicted.

    Args:
        predicted: (A, 2) predicted pixels of the landmarks with ``descriptors`` (A, 32).
        pixels: (B, 2) pixels of the features with descriptors ``candidates`` (B, 32).
        radius: search radius in pixels, one or (A,).
        max_distance, ratio: as in :func:`best_pairs`.
        predicted_octaves, octaves: (A,), (B,) pyramid levels; pairs further apart than
            ``octave_slack`` levels are not considered.
    """
    rows, columns = pairs_within(predicted, pixels, radius)
    if predicted_octaves is not None and octaves is not None:
        near = np.abs(predicted_octaves[rows] - octaves[columns]) <= octave_slack
        rows, columns = rows[near], columns[near]
    distance = hamming(descriptors, candidates, rows, columns)
    return best_pairs(rows, columns, distance, max_distance=max_distance, ratio=ratio)


def pairs_within(
    a: NDArray[np.float64], b: NDArray[np.float64], radius: float | NDArray[np.float64]
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """All pairs (i, j) with ``|a[i] - b[j]| <= radius[i]``; a (A, 2), b (B, 2), in pixels.

    b is sorted into square cells, row by row: the cells that the square around a[i] touches are one
    contiguous run of the sorted order in each row of cells.
    """
    if len(a) == 0 or len(b) == 0:
        return np.zeros(0, np.intp), np.zeros(0, np.intp)
    reach = np.broadcast_to(np.asarray(radius, dtype=np.float64), (len(a),))
    origin = b.min(axis=0)
    extent = float((b.max(axis=0) - origin).max())
    cell = max(float(reach.mean()), extent / 256, 1e-9)
    cells_b = ((b - origin) / cell).astype(np.int64)
    width, height = cells_b.max(axis=0) + 1
    keys = cells_b[:, 1] * width + cells_b[:, 0]
    order = np.argsort(keys, kind="stable")
    starts = np.searchsorted(keys[order], np.arange(width * height + 1))

    low = np.floor((a - origin - reach[:, None]) / cell)
    high = np.floor((a - origin + reach[:, None]) / cell)
    outside = (high < 0).any(axis=1) | (low[:, 0] >= width) | (low[:, 1] >= height)
    low = np.clip(low, 0, (width - 1, height - 1)).astype(np.int64)
    high = np.clip(high, 0, (width - 1, height - 1)).astype(np.int64)
    touched = np.where(outside, 0, high[:, 1] - low[:, 1] + 1)
    of_run = np.repeat(np.arange(len(a)), touched)
    cell_row = low[of_run, 1] + _counting(touched)
    begin = starts[cell_row * width + low[of_run, 0]]
    count = starts[cell_row * width + high[of_run, 0] + 1] - begin
    rows = np.repeat(of_run, count)
    columns = order[np.repeat(begin, count) + _counting(count)]
    x = a[rows, 0] - b[columns, 0]
    y = a[rows, 1] - b[columns, 1]
    near = x * x + y * y <= (reach * reach)[rows]
    return rows[near], columns[near]


def _counting(counts: NDArray[np.int64]) -> NDArray[np.int64]:
    """0, 1, ... up to each count, one after the other: [2, 3] -> [0, 1, 0, 1, 2]."""
    ends = np.cumsum(counts)
    return np.arange(int(ends[-1]) if len(ends) else 0) - np.repeat(ends - counts, counts)
