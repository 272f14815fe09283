"""Judging a follower's answers against the truth, relative to the route that guided."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from server.evaluation.camera_offset import apply_offset
from server.evaluation.hints import AHEAD_M, hint_truth, judge_hints
from server.evaluation.leader import LeaderJudgement
from server.evaluation.report import FollowerReport, Latency, Spread
from server.evaluation.walk import Trajectory, Walk
from server.geometry.poses import SE3
from server.navigation.updates import NavigationState, Update

FALSE_POSITION_M = 1.0
FALSE_ROTATION_DEG = 15.0
"""A fix further off than either, relative to the route, is a false one."""


@dataclass(frozen=True, slots=True)
class AnsweredFrame:
    """One follower frame and its answer.

    Attributes:
        index: of the frame in its video.
        latency_ms: from JPEG bytes to the update.
    """

    index: int
    update: Update
    latency_ms: float


@dataclass(frozen=True, eq=False)
class FollowerJudgement:
    """A follower's figures, and the curves behind them; NaN where a frame has no fix.

    Attributes:
        truth: true poses of the filming camera, one row a judged frame; in a wrong building the
            rows lie in that building's own world.
        on_route: (N,) frames truly on the route.
        position: (N, 3) fixes in the truth's world, by the route near them.
        position_error_m, rotation_error_deg: (N,) relative to the route.
        absolute_error_m: (N,) after the global alignment.
        false: (N,) false fixes.
        latency_ms: (N,).
    """

    report: FollowerReport
    truth: Trajectory
    on_route: NDArray[np.bool_]
    position: NDArray[np.float64] = field(repr=False)
    position_error_m: NDArray[np.float64] = field(repr=False)
    rotation_error_deg: NDArray[np.float64] = field(repr=False)
    absolute_error_m: NDArray[np.float64] = field(repr=False)
    false: NDArray[np.bool_] = field(repr=False)
    latency_ms: NDArray[np.float64] = field(repr=False)

    @property
    def fixed(self) -> NDArray[np.bool_]:
        """(N,) frames with a fix."""
        return np.isfinite(self.position[:, 0])


def judge_follower(
    leader_walk: Walk, leader: LeaderJudgement, walk: Walk, answers: Sequence[AnsweredFrame]
) -> FollowerJudgement:
    """Compare a follower's answers with the truth of its walk.

    Args:
        answers: one a frame at 10 fps, in order; the truth's row of a frame is its video index.

    Raises:
        ValueError: there are no answers, or the truth has no line for a frame.
    """
    if not answers:
        raise ValueError(f"{walk.name}: no frames to judge")
    frames = np.array([answer.index for answer in answers], dtype=np.int64)
    if frames.max() >= len(walk.truth):
        raise ValueError(
            f"{walk.name}: video frame {frames.max()} has no line in a truth of {len(walk.truth)}"
        )
    wrong_building = walk.world != leader_walk.world
    truth = walk.truth[frames]
    if walk.real and not wrong_building:
        truth = apply_offset(truth, leader.camera_offset)
    on_route = walk.on_route(frames)
    count = len(frames)
    position = np.full((count, 3), np.nan)
    error = np.full(count, np.nan)
    turned = np.full(count, np.nan)
    absolute = np.full(count, np.nan)
    false = np.zeros(count, dtype=np.bool_)
    for row, answer in enumerate(answers):
        fix = answer.update.fix
        if fix is None:
            continue
        near = leader.alignment.relative_to_route(fix.world_from_camera)
        position[row] = near.translation
        if wrong_building:
            false[row] = True
            continue
        true = SE3(truth.rotation[row], truth.position[row])
        error[row] = np.linalg.norm(near.translation - true.translation)
        turned[row] = np.degrees(near.angle_to(true))
        whole = leader.alignment.whole.transform_pose(fix.world_from_camera)
        absolute[row] = np.linalg.norm(whole.translation - true.translation)
        # Written so that a pose that is not finite counts as false.
        false[row] = not (error[row] <= FALSE_POSITION_M and turned[row] <= FALSE_ROTATION_DEG)
    fixed = np.array([answer.update.fix is not None for answer in answers])
    counted = np.isfinite(error) & on_route
    relocalized = float(fixed[on_route].mean()) if on_route.any() else 0.0
    latency = np.array([answer.latency_ms for answer in answers])
    arrived_at = np.array([answer.update.state is NavigationState.ARRIVED for answer in answers])
    agreement, straight, hint_frames = None, None, {}
    premature = int(arrived_at.sum()) if wrong_building else 0
    if not wrong_building:
        true_hints = hint_truth(leader.truth, truth)
        premature = int((arrived_at & (true_hints.remaining > AHEAD_M[1])).sum())
        hints = judge_hints(true_hints, [answer.update.guidance for answer in answers], on_route)
        agreement, straight, hint_frames = hints.agreement, hints.always_straight, hints.frames
    states = Counter(str(answer.update.state) for answer in answers)
    refusals = Counter(str(a.update.refusal.reason) for a in answers if a.update.refusal is not None)
    report = FollowerReport(
        name=walk.name,
        frames=count,
        relocalized_fraction=relocalized,
        relocalization_failure_rate=1.0 - relocalized,
        position_error_m=Spread.of(error[counted]),
        rotation_error_deg=Spread.of(turned[counted]),
        absolute_error_m=Spread.of(absolute[counted]),
        false_fixes=int(false.sum()),
        hint_agreement=agreement,
        hint_always_straight=straight,
        hint_frames=hint_frames,
        latency_ms=Latency.of(latency),
        off_route_frames=int((~on_route).sum()),
        off_route_fixes=int((fixed & ~on_route).sum()),
        refusals=dict(sorted(refusals.items())),
        states=dict(sorted(states.items())),
        arrived=bool(arrived_at[-1]) if count else False,
        premature_arrivals=premature,
        wrong_building=wrong_building,
    )
    return FollowerJudgement(report, truth, on_route, position, error, turned, absolute, false, latency)
