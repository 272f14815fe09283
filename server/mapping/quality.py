"""The quality report of a walk: where its video is weak, why, what to do, and whether to record it again."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from server.geometry.cameras import Camera
from server.geometry.poses import SE3
from server.mapping.evidence import gather_evidence
from server.mapping.front_end import WalkFrame
from server.mapping.weak_stretches import (
    FrameEvidence,
    Run,
    WeaknessOptions,
    WeakReason,
    find_weak_runs,
    frame_seconds,
)

Array = NDArray[np.float64]

ENOUGH_LANDMARKS = 40
"""Landmarks a frame must see for its place to count as covered: twice what a pose needs at least."""

STRETCH_COST = 5
"""Points of the score that every weak stretch costs besides what it takes from the coverage."""

NO_MAP_CAP = 40
"""The score of a walk that gave no map is no higher."""

GOOD_SCORE = 70
"""Below this score a walk had better be recorded again."""

HOLE_S = 1.0
"""A stretch without a pose that lasts longer is a hole in the map: the walk had better be recorded again."""

_STILL_PIXELS = 0.5
_STILL_S = 3.0

ADVICE: dict[WeakReason, tuple[str, str]] = {
    WeakReason.TOO_DARK: (
        "too dark to see anything",
        "turn on the light, and keep fingers and sleeves off the lens",
    ),
    WeakReason.TOO_BRIGHT: (
        "washed out by bright light",
        "do not film towards lamps or windows, and give the camera a moment to adjust",
    ),
    WeakReason.LENS_COVERED: (
        "part of the lens was covered",
        "hold the phone by its edges and keep fingers and sleeves off the lens",
    ),
    WeakReason.BLANK_WALL: (
        "a blank wall filled the picture",
        "keep doors, pictures or furniture in view, and turn with some distance to bare walls",
    ),
    WeakReason.BLURRED: (
        "the pictures are blurred",
        "wipe the lens, hold the phone steady in both hands and let it focus",
    ),
    WeakReason.TOO_FAST: (
        "the phone moved too fast",
        "walk on calmly and take about three seconds for a right-angled turn",
    ),
    WeakReason.TOO_MUCH_MOTION: (
        "too much else was moving in view",
        "let people pass first, keep your distance, or record at a quieter time",
    ),
    WeakReason.LOST: (
        "the way could not be followed here",
        "walk more slowly and keep something with detail in view",
    ),
}
"""For each reason what was seen, and what to do about it."""


@dataclass(frozen=True, slots=True)
class WeakStretch:
    """A stretch of the video that is too poor to map by.

    Attributes:
        start_s, end_s: on the video's clock.
        reason: the one cause; what follows from it is no stretch of its own.
        severity: 0.5 where the camera could be followed all the same, up to 1 where it could not.
        detail: a sentence for the leader: what was seen, what came of it, what to do.
        thumbnail: JPEG of a picture in it, None where none is kept.
    """

    start_s: float
    end_s: float
    reason: WeakReason
    severity: float
    detail: str
    thumbnail: bytes | None = None


@dataclass(frozen=True, eq=False, slots=True)
class Timeline:
    """The walk frame by frame, for drawing.

    Attributes:
        time: (F,) seconds; landmarks: (F,) that each frame sees, 0 where it has no pose.
        covered: (F,) whether its place can be found again.
        position: (F, 3) in the map's frame if there is a map.
    """

    time: Array
    landmarks: NDArray[np.int64]
    covered: NDArray[np.bool_]
    position: Array | None = None


@dataclass(frozen=True, eq=False, slots=True)
class QualityReport:
    """What a leader is told of a walk.

    Attributes:
        video_seconds: length of the walk.
        coverage: share of the walk in whose every part a follower can be found: of its length where
            there is a map, else of its time.
        score: 0 to 100: 100 times the coverage, less :data:`STRETCH_COST` a stretch, at most
            :data:`NO_MAP_CAP` without a map.
        record_again: whether the walk had better be recorded again; verdict: why, in a sentence.
        stretches: in the order of time, apart from each other.
        notes: what is no fault and worth knowing, sentences.
    """

    video_seconds: float
    coverage: float
    score: int
    record_again: bool
    verdict: str
    stretches: tuple[WeakStretch, ...]
    notes: tuple[str, ...]
    timeline: Timeline


@dataclass(frozen=True, eq=False, slots=True)
class WalkOutcome:
    """What became of F frames in a build.

    Attributes:
        tracked: (F,) whether the frame's pose is known; landmarks: (F,) that it rests on.
        poses: camera_from_world of every frame, None for unknown ones; None if there is no map.
        position: (F, 3) of the finished map's path, None if there is no map.
        bridges: (first, last) frames of blind stretches over which the map goes on by the walker's pace.
    """

    tracked: NDArray[np.bool_]
    landmarks: NDArray[np.int64]
    poses: Sequence[SE3 | None] | None = None
    position: Array | None = None
    bridges: tuple[tuple[int, int], ...] = ()


def judge_quality(
    frames: Sequence[WalkFrame],
    camera: Camera,
    outcome: WalkOutcome,
    options: WeaknessOptions | None = None,
) -> QualityReport:
    """The quality report of a walk of at least one frame, whether or not it gave a map."""
    evidence = gather_evidence(frames, outcome.tracked, outcome.landmarks, outcome.poses, camera)
    runs = find_weak_runs(evidence, options)
    thumbnails = [(row, frame.thumbnail) for row, frame in enumerate(frames) if frame.thumbnail]
    stretches = tuple(_stretch(run, evidence, outcome, thumbnails) for run in runs)
    covered = outcome.tracked & (outcome.landmarks >= ENOUGH_LANDMARKS)
    for run in runs:
        covered[run.begin : run.end] = False
    coverage = _share(covered, outcome.position)
    mapped = outcome.position is not None
    score = max(0, round(100 * coverage) - STRETCH_COST * len(stretches))
    score = score if mapped else min(score, NO_MAP_CAP)
    holes = [
        run
        for run in runs
        if (~outcome.tracked[run.begin : run.end]).sum() * frame_seconds(evidence.time) > HOLE_S
    ]
    again = not mapped or score < GOOD_SCORE or bool(holes)
    return QualityReport(
        video_seconds=float(evidence.time[-1]) + frame_seconds(evidence.time),
        coverage=coverage,
        score=score,
        record_again=again,
        verdict=_verdict(mapped, again, stretches),
        stretches=stretches,
        notes=_notes(evidence, runs),
        timeline=Timeline(
            evidence.time,
            np.where(outcome.tracked, outcome.landmarks, 0),
            covered,
            outcome.position,
        ),
    )


def _stretch(
    run: Run, evidence: FrameEvidence, outcome: WalkOutcome, thumbnails: list[tuple[int, bytes]]
) -> WeakStretch:
    lost = float((~outcome.tracked[run.begin : run.end]).mean())
    seen, advice = ADVICE[run.reason]
    if any(first < run.end and last >= run.begin for first, last in outcome.bridges):
        came = "the map goes on by your pace alone"
    elif lost > 0.5:
        came = "nothing could be followed"
    elif lost > 0.0:
        came = "the way was lost for a moment"
    else:
        came = "the way could just be followed"
    if run.reason is WeakReason.LOST and came == "nothing could be followed":
        came = "without a cause to be seen"
    end = float(evidence.time[run.end - 1]) + frame_seconds(evidence.time)
    middle = (run.begin + run.end - 1) / 2
    inside = [item for item in thumbnails if run.begin <= item[0] < run.end]
    return WeakStretch(
        start_s=float(evidence.time[run.begin]),
        end_s=end,
        reason=run.reason,
        severity=0.5 + 0.5 * lost,
        detail=f"{_capital(seen)}, {came}: {advice}.",
        thumbnail=min(inside, key=lambda item: abs(item[0] - middle))[1] if inside else None,
    )


def _share(covered: NDArray[np.bool_], position: Array | None) -> float:
    """Share of the walk that is covered: of its length where it has one."""
    if position is not None and len(covered) > 1:
        steps = np.linalg.norm(np.diff(position, axis=0), axis=1)
        if steps.sum() > 0.0:
            both = 0.5 * (covered[1:].astype(np.float64) + covered[:-1])
            return float((steps * both).sum() / steps.sum())
    return float(covered.mean())


def _verdict(mapped: bool, again: bool, stretches: tuple[WeakStretch, ...]) -> str:
    if not again:
        if not stretches:
            return "A good recording: followers can be found everywhere along it."
        return f"Good enough to follow, weaker {_when(stretches)}."
    why = "no map could be made of it" if not mapped else "followers would not be found everywhere along it"
    if not stretches:
        return f"Record the walk again: {why}."
    return f"Record the walk again with more care {_when(stretches)}: {why}."


def _when(stretches: tuple[WeakStretch, ...]) -> str:
    worst = sorted(stretches, key=lambda s: -s.severity * (s.end_s - s.start_s))[:4]
    spans = [f"{s.start_s:.1f}-{s.end_s:.1f} s" for s in sorted(worst, key=lambda s: s.start_s)]
    listed = spans[0] if len(spans) == 1 else f"{', '.join(spans[:-1])} and {spans[-1]}"
    return f"at {listed}"


def _notes(evidence: FrameEvidence, runs: list[Run]) -> tuple[str, ...]:
    """Where the camera stood still: no fault, but a walk that is only that gives no map."""
    with np.errstate(invalid="ignore"):
        still = evidence.shift < _STILL_PIXELS
    for run in runs:
        still[run.begin : run.end] = False
    notes = []
    edges = np.flatnonzero(np.diff(np.concatenate([[False], still, [False]]).astype(np.int8)))
    for begin, end in edges.reshape(-1, 2):
        start, stop = float(evidence.time[begin]), float(evidence.time[end - 1])
        if stop - start >= _STILL_S:
            notes.append(f"The camera stood still from {start:.1f} s to {stop:.1f} s. That does no harm.")
    return tuple(notes)


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]
