"""What a follower should have been told, from the truth alone, and how often it was.

The true hint is the bearing, in the follower's true camera, of the leader's true path 0.5 to 3 m
ahead: left or right beyond 20 degrees, straight within.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from server.evaluation.walk import Trajectory, arc_length
from server.navigation.updates import Guidance, Instruction

Array = NDArray[np.float64]

AHEAD_M = (0.5, 3.0)
"""Stretch of the leader's path, ahead of the follower, whose mean is the true temporary destination."""

TURN_LIMIT_DEG = 20.0
"""Beyond this bearing the true hint is left or right."""

UNCLEAR_DEG = 5.0
"""Frames whose true bearing is this close to the limit are not judged: either answer is right."""

SAMPLE_M = 0.05
"""Spacing of the resampled path."""

STEP_COST_M = 0.5
"""Cost of moving along the leader's path, square metres a metre: keeps the follower's place from jumping."""

FAR_M2 = 9.0
"""Ceiling of the squared distance to the route, so that a stretch away from it does not tear the rest."""


class Side(StrEnum):
    """A hint, as far as it is judged."""

    LEFT = "left"
    STRAIGHT = "straight"
    RIGHT = "right"


@dataclass(frozen=True, eq=False, slots=True)
class HintTruth:
    """True hints of a follower's frames.

    Attributes:
        progress: (N,) metres along the leader's true path.
        remaining: (N,) metres of it that are left.
        bearing: (N,) radians to the true temporary destination in the camera, positive to the left;
            NaN where less than 0.5 m of path is left.
    """

    progress: Array
    remaining: Array
    bearing: Array

    def side(self, row: int) -> Side | None:
        """The true hint of a frame, None where it is not judged."""
        degrees = float(np.degrees(self.bearing[row]))
        if np.isnan(degrees) or abs(abs(degrees) - TURN_LIMIT_DEG) < UNCLEAR_DEG:
            return None
        if abs(degrees) <= TURN_LIMIT_DEG:
            return Side.STRAIGHT
        return Side.LEFT if degrees > 0 else Side.RIGHT


def true_progress(leader: Trajectory, follower: Trajectory) -> Array:
    """Metres along the leader's true path at which each follower frame is, (N,).

    The most plausible walk along the path (Viterbi): near in place and heading, without jumps, so
    that a route that crosses itself or comes back the same way is not confused.
    """
    samples = STEP_COST_M * arc_length(leader.position)
    columns = np.arange(len(samples))
    best = np.zeros(len(samples))
    back = np.zeros((len(follower), len(samples)), dtype=np.int32)
    for frame in range(len(follower)):
        if frame:
            # The cheapest predecessor under a cost linear in the distance: one sweep each way.
            ahead, ahead_from = _running_minimum(best - samples)
            behind, behind_from = _running_minimum((best + samples)[::-1])
            behind, behind_from = behind[::-1] - samples, columns[-1] - behind_from[::-1]
            ahead = ahead + samples
            back[frame] = np.where(ahead <= behind, ahead_from, behind_from)
            best = np.minimum(ahead, behind)
        apart = ((leader.position - follower.position[frame]) ** 2).sum(axis=1)
        turned = 1.0 - leader.rotation[:, :, 2] @ follower.rotation[frame, :, 2]
        best = best + np.minimum(apart + turned, FAR_M2)
    row = int(best.argmin())
    rows = [row]
    for frame in range(len(follower) - 1, 0, -1):
        row = int(back[frame, row])
        rows.append(row)
    return np.asarray(samples[rows[::-1]] / STEP_COST_M)


def _running_minimum(values: Array) -> tuple[Array, NDArray[np.int64]]:
    """Minimum of the values up to each place, and where it is."""
    lowest = np.minimum.accumulate(values)
    fresh = np.concatenate([[True], values[1:] < lowest[:-1]])
    return lowest, np.maximum.accumulate(np.where(fresh, np.arange(len(values)), 0))


def hint_truth(leader: Trajectory, follower: Trajectory) -> HintTruth:
    """True hints of a follower, from both true trajectories (filming cameras, metres)."""
    walked = arc_length(leader.position)
    progress = true_progress(leader, follower)
    bearing = np.full(len(follower), np.nan)
    for i, start in enumerate(progress):
        stretch = np.arange(start + AHEAD_M[0], min(start + AHEAD_M[1], walked[-1]), SAMPLE_M)
        if len(stretch) == 0:
            continue
        points = np.stack([np.interp(stretch, walked, leader.position[:, k]) for k in range(3)], axis=1)
        x, _, z = follower.rotation[i].T @ (points.mean(axis=0) - follower.position[i])
        bearing[i] = np.arctan2(-x, z)
    return HintTruth(progress, walked[-1] - progress, bearing)


def answered_side(guidance: Guidance) -> Side | None:
    """The side a hint sends the follower to, None for arrival."""
    match guidance.instruction:
        case Instruction.LEFT:
            return Side.LEFT
        case Instruction.RIGHT:
            return Side.RIGHT
        case Instruction.STRAIGHT:
            return Side.STRAIGHT
        case Instruction.TURN_AROUND:
            return Side.LEFT if guidance.bearing > 0 else Side.RIGHT
        case Instruction.ARRIVED:
            return None


@dataclass(frozen=True, slots=True)
class HintScore:
    """Balanced accuracy of the hints and of the constant answer "straight"; None without true hints.

    Attributes:
        frames: true hints judged, by class.
    """

    agreement: float | None
    always_straight: float | None
    frames: dict[str, int]


def judge_hints(
    truth: HintTruth, guidance: Sequence[Guidance | None], on_route: NDArray[np.bool_]
) -> HintScore:
    """Balanced accuracy over the classes that occur.

    A frame without guidance is a wrong answer. Arrival is no side and is left out where the route
    truly ends within :data:`AHEAD_M`; announced earlier it is wrong.

    Args:
        truth: N frames.
        guidance: of each frame, None where there was none.
        on_route: (N,) frames that count.
    """
    right: dict[Side, int] = dict.fromkeys(Side, 0)
    total: dict[Side, int] = dict.fromkeys(Side, 0)
    for row, given in enumerate(guidance):
        wanted = truth.side(row)
        if wanted is None or not on_route[row]:
            continue
        answer = None if given is None else answered_side(given)
        if given is not None and answer is None and truth.remaining[row] <= AHEAD_M[1]:
            continue
        total[wanted] += 1
        right[wanted] += answer is wanted
    occurring = [side for side in Side if total[side]]
    counts = {str(side): total[side] for side in Side}
    if not occurring:
        return HintScore(None, None, counts)
    agreement = sum(right[side] / total[side] for side in occurring) / len(occurring)
    straight = (Side.STRAIGHT in occurring) / len(occurring)
    return HintScore(agreement, straight, counts)
