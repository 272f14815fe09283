"""Joining the parts of a walk that were tracked apart, because the leader's camera was blind between."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from server.geometry.poses import Sim3
from server.mapping.revisits import RevisitOptions, find_revisits
from server.mapping.working_map import WorkingMap

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class JoinOptions:
    """Settings of :func:`join`.

    Attributes:
        revisits: how a part is recognised in what was seen before.
        max_bridge: longest blind stretch that a walker's motion may bridge, frames.
    """

    revisits: RevisitOptions = field(default_factory=RevisitOptions)
    max_bridge: int = 20


class Joint(StrEnum):
    """How two parts were put together."""

    RECOGNISED = "recognised"
    BRIDGED = "bridged"


def join(
    first: WorkingMap, later: WorkingMap, turns: list[Array], options: JoinOptions | None = None
) -> Joint | None:
    """Take ``later`` into ``first``; None, and nothing changed, if nothing says how they lie.

    A part that shows a known place is put where that place is. Else a short blind stretch is bridged:
    the walker went on at the same pace, and turned as the tracks of these frames say.

    Args:
        turns: (3, 3) rotation into every frame of the walk from the one before.
    """
    options = options or JoinOptions()
    revisits = find_revisits(later, list(range(len(later.keyframes))), first, options.revisits)
    if revisits:
        best = max(revisits, key=lambda r: len(r.later))
        offset = first.absorb(later, best.earlier_from_later)
        for revisit in revisits:
            first.merge(revisit.later + offset, revisit.earlier)
        return Joint.RECOGNISED
    gap = later.keyframes[0].frame - first.keyframes[-1].frame
    if gap > options.max_bridge:
        return None
    first.absorb(later, _bridge(first, later, turns))
    return Joint.BRIDGED


def _pace(working: WorkingMap, keyframes: slice) -> float:
    """Mean length of a frame's step over some keyframes, map units."""
    chosen = working.keyframes[keyframes]
    centres = np.stack([kf.centre for kf in chosen])
    frames = chosen[-1].frame - chosen[0].frame
    return float(np.linalg.norm(np.diff(centres, axis=0), axis=1).sum()) / max(frames, 1)


def _bridge(first: WorkingMap, later: WorkingMap, turns: list[Array]) -> Sim3:
    """``first_from_later`` by dead reckoning over the blind stretch."""
    last, begin = first.keyframes[-1], later.keyframes[0]
    turn = np.eye(3)
    for frame in range(last.frame + 1, begin.frame + 1):
        turn = turns[frame] @ turn
    pace = _pace(first, slice(-8, None))
    scale = pace / max(_pace(later, slice(0, 8)), 1e-12)
    before = first.keyframes[max(0, len(first.keyframes) - 4)]
    heading = last.centre - before.centre
    heading /= max(float(np.linalg.norm(heading)), 1e-12)
    # Half the turn has been made on average while the stretch was walked.
    world_from_last = last.camera_from_world.inverse().rotation
    after = world_from_last @ turn.T @ world_from_last.T @ heading
    step = heading + after
    step /= max(float(np.linalg.norm(step)), 1e-12)
    centre = last.centre + pace * (begin.frame - last.frame) * step
    rotation = world_from_last @ turn.T @ begin.camera_from_world.rotation
    return Sim3(scale, rotation, centre - scale * rotation @ begin.centre)
