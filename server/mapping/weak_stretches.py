"""Where a walk's video is too poor to map by, and why: each stretch has one reason.

Thresholds are physical or shares of the walk's own typical figure; docs/decisions/0013 says what clean walks
and planted faults measured.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


class WeakReason(StrEnum):
    """Why a stretch is weak, in words a leader can act on."""

    TOO_DARK = "too_dark"
    TOO_BRIGHT = "too_bright"
    LENS_COVERED = "lens_covered"
    BLANK_WALL = "blank_wall"
    BLURRED = "blurred"
    TOO_FAST = "too_fast"
    TOO_MUCH_MOTION = "too_much_motion"
    LOST = "lost"


@dataclass(frozen=True, eq=False, slots=True)
class FrameEvidence:
    """What is known of each of F frames; NaN where it is not.

    Attributes:
        time: (F,) seconds.
        bright, clipped, textured, covered, sharpness: (F,), as in
            :class:`server.mapping.frame_statistics.FrameStatistics`.
        followed: (F,) share of the features of the frame before that were found again.
        turning: (F,) radians a second.
        shift: (F,) median motion of the features since the frame before, pixels.
        strays: (F,) share of the features whose motion is not that of the camera.
        tracked: (F,) whether the camera's pose could be told.
        landmarks: (F,) landmarks the pose rests on.
    """

    time: Array
    bright: Array
    clipped: Array
    textured: Array
    covered: Array
    sharpness: Array
    followed: Array
    turning: Array
    shift: Array
    strays: Array
    tracked: Mask
    landmarks: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.time)


@dataclass(frozen=True, slots=True)
class WeaknessOptions:
    """When a frame is weak. Pairs are the figure that begins a stretch and the one that ends it.

    Attributes:
        dark: ``bright`` below, grey levels; dark_share: the same as a share of the walk's median, where
            tracking is lost.
        clipped, covered: shares of the picture above; textured: below.
        blur: ``sharpness`` below this share of the walk's median, over a whole stretch.
        blur_step: the same with sudden edges, at which it falls to ``step`` of what is just outside
            and ``followed`` below ``break_followed``.
        turning: radians a second above; turning_lost: the same where tracking is lost.
        strays: share of the features above, for at least ``strays_s``; strays_lost: where tracking is lost.
        followed_lost: of sharp pictures with texture fewer features are found again only if the
            camera moved too far between two of them.
        least_s: shortest stretch; least_lost_s: of those whose only sign is the lost track.
        gap_s: stretches of one reason this close are one; what is lost this close to a stretch is its doing.
        edge_s: of a blur or fast turn that leads into or out of a stretch of another reason and
            is no stretch of its own.
    """

    dark: tuple[float, float] = (48.0, 72.0)
    dark_share: float = 0.5
    clipped: tuple[float, float] = (0.5, 0.3)
    covered: tuple[float, float] = (0.3, 0.2)
    textured: tuple[float, float] = (0.15, 0.28)
    blur: float = 0.38
    blur_step: float = 0.62
    step: float = 0.6
    break_followed: float = 0.6
    turning: tuple[float, float] = (float(np.deg2rad(120.0)), float(np.deg2rad(90.0)))
    turning_lost: float = float(np.deg2rad(90.0))
    strays: tuple[float, float] = (0.65, 0.55)
    strays_s: float = 1.0
    strays_lost: float = 0.35
    followed_lost: float = 0.2
    least_s: float = 0.35
    least_lost_s: float = 0.45
    gap_s: float = 0.5
    edge_s: float = 0.8


@dataclass(frozen=True, slots=True)
class Run:
    """Frames ``begin`` up to but not ``end`` that are weak for one reason."""

    begin: int
    end: int
    reason: WeakReason


def find_weak_runs(evidence: FrameEvidence, options: WeaknessOptions | None = None) -> list[Run]:
    """The weak stretches of a walk in the order of time; they do not overlap."""
    options = options or WeaknessOptions()
    if len(evidence) == 0:
        return []
    seen = _visible(evidence, options)
    lost = _lost(evidence, seen, options)
    moving = _restless(evidence, [*seen, *lost], options)
    return sorted([*seen, *lost, *moving], key=lambda run: run.begin)


def frame_seconds(time: Array) -> float:
    """Seconds that a frame stands for."""
    return float(np.median(np.diff(time))) if len(time) > 1 else 0.1


def _visible(e: FrameEvidence, o: WeaknessOptions) -> list[Run]:
    """Runs whose pictures themselves are poor."""
    free = np.ones(len(e), np.bool_)
    found: list[Run] = []

    def take(reason: WeakReason, enter: Mask, hold: Mask) -> None:
        for begin, end in _held(enter & free, (hold | enter) & free, e.time, o.least_s, o.gap_s):
            found.append(Run(begin, end, reason))
            free[begin:end] = False

    take(WeakReason.TOO_DARK, e.bright < o.dark[0], e.bright < o.dark[1])
    take(WeakReason.BLANK_WALL, e.textured < o.textured[0], e.textured < o.textured[1])
    take(WeakReason.TOO_BRIGHT, e.clipped > o.clipped[0], e.clipped > o.clipped[1])
    take(WeakReason.LENS_COVERED, e.covered > o.covered[0], e.covered > o.covered[1])
    blurred = _blurred(e, free, o)
    for begin, end in blurred:
        turning = _middle(e.turning[begin:end])
        fast = turning > o.turning_lost
        found.append(Run(begin, end, WeakReason.TOO_FAST if fast else WeakReason.BLURRED))
        free[begin:end] = False
    take(WeakReason.TOO_FAST, e.turning > o.turning[0], e.turning > o.turning[1])
    return _without_edges(found, e.time, o)


def _without_edges(runs: list[Run], time: Array, o: WeaknessOptions) -> list[Run]:
    """Runs but the short blurs and turns that lead into or out of another."""
    passing = (WeakReason.BLURRED, WeakReason.TOO_FAST)

    def is_edge(run: Run) -> bool:
        return (
            run.reason in passing
            and _seconds(run.begin, run.end, time) <= o.edge_s
            and any(
                other.reason not in passing and _apart(run, other, time) <= o.gap_s
                for other in runs
                if other is not run
            )
        )

    return [run for run in runs if not is_edge(run)]


def _blurred(e: FrameEvidence, free: Mask, o: WeaknessOptions) -> list[tuple[int, int]]:
    """Spans less sharp than the walk, or than what is around them.

    A bland view is less sharp too, but comes and goes slowly and keeps more of it: see the record.
    """
    if not free.any():
        return []
    typical = float(np.median(e.sharpness[free]))
    level = np.log(np.maximum(e.sharpness, 1e-4) / max(typical, 1e-4))
    spans = []
    for a, b in _joined(_spans((level < np.log(o.blur_step)) & free), e.time, 0.25):
        # A bland view may join on to a blur: what is cut out is tried first, then the whole. What is left
        # over is bland, not blurred, only if it is well above the cut.
        cut = _edges(level, free, a, b)
        inside = float(np.median(level[slice(*cut)]))
        rest = np.concatenate([level[a : max(a, cut[0])], level[min(b, cut[1]) : b]])
        if len(rest) and np.median(rest) < max(np.log(o.blur), inside - np.log(o.step)):
            cut = (a, b)
        for begin, end in (cut, (a, b)):
            if _seconds(begin, end, e.time) >= o.least_s and _is_blur(e, level, free, begin, end, o):
                spans.append((begin, end))
                break
    return spans


def _is_blur(e: FrameEvidence, level: Array, free: Mask, begin: int, end: int, o: WeaknessOptions) -> bool:
    inside = float(np.median(level[begin:end]))
    if inside < np.log(o.blur):
        return True
    steps = _steps(level, free, begin, end)
    sudden = bool(steps) and max(steps) < np.log(o.step) and _breaks(e.followed, begin, end, o)
    return sudden and inside < np.log(o.blur_step)


def _edges(level: Array, free: Mask, a: int, b: int, reach: int = 10) -> tuple[int, int]:
    """The edges near (a, b) that cut ``level`` best into a low piece and what is around it.

    Least squares of three constant pieces.
    """
    low, high = a, b
    while low > max(0, a - reach) and free[low - 1]:
        low -= 1
    while high < min(len(level), b + reach) and free[high]:
        high += 1
    x = level[low:high]
    sums, squares = (np.concatenate([[0.0], np.cumsum(v)]) for v in (x, x * x))

    def cost(i: NDArray[np.intp], j: NDArray[np.intp]) -> Array:
        length = np.maximum(j - i, 1)
        return np.asarray((squares[j] - squares[i]) - (sums[j] - sums[i]) ** 2 / length)

    first = np.arange(0, min(a - low + reach, len(x) - 1) + 1)
    last = np.arange(max(b - low - reach, 1), len(x) + 1)
    i, j = (grid.ravel() for grid in np.meshgrid(first, last, indexing="ij"))
    inner = j - i >= min(3, b - a)
    i, j = i[inner], j[inner]
    start, end = np.zeros_like(i), np.full_like(j, len(x))
    piece = (sums[j] - sums[i]) / (j - i)
    around = [
        np.where(q > p, (sums[q] - sums[p]) / np.maximum(q - p, 1), np.inf) for p, q in ((start, i), (j, end))
    ]
    low_piece = (piece < around[0]) & (piece < around[1])
    if not low_piece.any():
        return a, b
    total = cost(start, i) + cost(i, j) + cost(j, end)
    best = int(np.argmin(np.where(low_piece, total, np.inf)))
    return low + int(i[best]), low + int(j[best])


def _steps(level: Array, free: Mask, begin: int, end: int, width: int = 2) -> list[float]:
    """How far ``level`` falls at the edges of a span; one outside of which nothing is known is left out."""
    steps = []
    for inner, outer in (
        (slice(begin, begin + width), slice(max(0, begin - width), begin)),
        (slice(max(begin, end - width), end), slice(end, end + width)),
    ):
        known = level[outer][free[outer]]
        if len(known):
            steps.append(float(np.median(level[inner]) - np.median(known)))
    return steps


def _breaks(followed: Array, begin: int, end: int, o: WeaknessOptions) -> bool:
    """Whether features are hard to find again at both edges of a span, as where a blur sets in."""
    edges = (followed[max(0, edge - 1) : edge + 2] for edge in (begin, end))
    return all(_least(edge) < o.break_followed for edge in edges if np.isfinite(edge).any())


def _lost(e: FrameEvidence, seen: list[Run], o: WeaknessOptions) -> list[Run]:
    """Runs without a pose that no poor picture explains, each with its likeliest reason."""
    runs = []
    for begin, end in _joined(_spans(~e.tracked), e.time, o.gap_s):
        span = Run(begin, end, WeakReason.LOST)
        if _seconds(begin, end, e.time) < o.least_lost_s:
            continue
        if any(_apart(span, run, e.time) <= o.gap_s for run in seen):
            continue
        runs.append(Run(begin, end, _why_lost(e, begin, end, o)))
    return runs


def _why_lost(e: FrameEvidence, begin: int, end: int, o: WeaknessOptions) -> WeakReason:
    near = slice(max(0, begin - 5), min(len(e), end + 3))
    around = slice(max(0, begin - 10), min(len(e), end + 10))
    inside = slice(begin, end)
    if _middle(e.bright[inside]) < o.dark_share * _middle(e.bright):
        return WeakReason.TOO_DARK
    if _middle(e.textured[inside]) < min(0.5, 0.6 * _middle(e.textured)):
        return WeakReason.BLANK_WALL
    if _most(e.turning[near]) > o.turning_lost:
        return WeakReason.TOO_FAST
    if _middle(e.sharpness[inside]) < o.blur_step * _middle(e.sharpness):
        return WeakReason.BLURRED
    if _most(e.strays[around]) > o.strays_lost:
        return WeakReason.TOO_MUCH_MOTION
    if (e.followed[inside] < o.followed_lost).sum() >= 3:
        return WeakReason.TOO_FAST
    return WeakReason.LOST


def _restless(e: FrameEvidence, others: list[Run], o: WeaknessOptions) -> list[Run]:
    """Runs in which most of what is seen moves by itself, though the camera could be followed."""
    free = np.ones(len(e), np.bool_)
    for run in others:
        free[run.begin : run.end] = False
    with np.errstate(invalid="ignore"):
        enter, hold = ((e.strays > limit) & free for limit in o.strays)
    spans = _held(enter, hold, e.time, o.strays_s, o.gap_s)
    return [
        run
        for run in (Run(begin, end, WeakReason.TOO_MUCH_MOTION) for begin, end in spans)
        if not any(_apart(run, other, e.time) <= o.gap_s for other in others)
    ]


def _held(enter: Mask, hold: Mask, time: Array, least_s: float, gap_s: float) -> list[tuple[int, int]]:
    """Spans of ``hold`` that contain some of ``enter``: hysteresis."""
    kept = [(a, b) for a, b in _spans(hold) if enter[a:b].any()]
    return [(a, b) for a, b in _joined(kept, time, gap_s) if _seconds(a, b, time) >= least_s]


def _spans(mask: Mask) -> list[tuple[int, int]]:
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8)))
    return [(int(a), int(b)) for a, b in edges.reshape(-1, 2)]


def _joined(spans: list[tuple[int, int]], time: Array, gap_s: float) -> list[tuple[int, int]]:
    joined: list[tuple[int, int]] = []
    for begin, end in spans:
        if joined and time[begin] - time[joined[-1][1] - 1] <= gap_s:
            joined[-1] = (joined[-1][0], end)
        else:
            joined.append((begin, end))
    return joined


def _seconds(begin: int, end: int, time: Array) -> float:
    return float(time[end - 1] - time[begin]) + frame_seconds(time)


def _apart(a: Run, b: Run, time: Array) -> float:
    """Seconds between two runs, 0 or less if they touch or overlap."""
    first, second = (a, b) if a.begin <= b.begin else (b, a)
    return float(time[second.begin] - time[first.end - 1]) - frame_seconds(time)


def _middle(values: Array) -> float:
    """Median of what is known; NaN, which no threshold is passed by, if nothing is."""
    known = values[np.isfinite(values)]
    return float(np.median(known)) if len(known) else float("nan")


def _least(values: Array) -> float:
    return float(np.nanmin(values))


def _most(values: Array) -> float:
    known = values[np.isfinite(values)]
    return float(np.percentile(known, 90)) if len(known) else float("nan")
