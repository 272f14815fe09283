"""Self-calibration: the lens a walk was filmed through, from the walk itself.

First a focal length is voted for: calibrated epipolar geometry fits the tracks of a walk that turns only
with about the right one (Kruppa's constraint, tried out focal length by focal length). The bundle
adjustment of a stretch of the walk then finds focal length and distortion together.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import islice

import numpy as np
import poselib
from numpy.typing import NDArray
from scipy.optimize import least_squares

from server.features.tracking import TrackedFeatures
from server.geometry.cameras import TYPICAL_FOCAL, Camera, CameraModel
from server.mapping.front_end import WalkFrame
from server.mapping.global_refinement import RefinementOptions, refine_globally
from server.mapping.visual_odometry import OdometryOptions, VisualOdometry

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class FocalVoteOptions:
    """Settings of :func:`vote_focal`.

    Attributes:
        span: candidates lie between the typical focal length divided and multiplied by this.
        candidates: how many are tried.
        pairs: pairs of frames asked.
        max_gap: frames between the two of a pair.
        min_shared, min_share: tracks a pair must have in common, and their share of the first frame's.
        min_shift: median motion of these tracks, in lengths of the longer side.
        max_error: epipolar error of an inlier, pixels.
        prior_weight: what a focal length ``span`` times the typical one costs, as a share of the least cost.
        tolerance: candidates that cost this share more than the best one are still possible;
        decided: ratio of the greatest and the least possible focal length up to which the vote counts.
    """

    span: float = 2.0
    candidates: int = 17
    pairs: int = 40
    max_gap: int = 25
    min_shared: int = 60
    min_share: float = 0.3
    min_shift: float = 0.03
    max_error: float = 1.5
    prior_weight: float = 0.02
    tolerance: float = 0.01
    decided: float = 1.5


@dataclass(frozen=True, slots=True)
class CalibrationOptions:
    """Settings of :func:`learn_lens`.

    Attributes:
        vote: of the first guess.
        frames: length of the stretch on which the lens is found; most_frames: how far into the walk such a
            stretch is looked for.
        min_keyframes: that its map needs.
        odometry, refinement: how the stretch is mapped.
    """

    vote: FocalVoteOptions = field(default_factory=FocalVoteOptions)
    frames: int = 200
    most_frames: int = 1200
    min_keyframes: int = 8
    odometry: OdometryOptions = field(default_factory=OdometryOptions)
    refinement: RefinementOptions = field(
        default_factory=lambda: RefinementOptions(free_lens=True, rounds=3, max_iterations=60)
    )


@dataclass(frozen=True, slots=True)
class FocalVote:
    """The outcome of a vote.

    Attributes:
        focal: pixels.
        low, high: the least and the greatest that fit about as well.
        decided: whether the walk tells the focal length at all.
    """

    focal: float
    low: float
    high: float
    decided: bool

    def contradicts(self, focal: float, slack: float = 1.2) -> bool:
        """Whether a focal length lies clearly outside of what fits: by more than the factor ``slack``."""
        return self.decided and not self.low / slack < focal < self.high * slack


def vote_focal(
    frames: Sequence[TrackedFeatures], camera: Camera, options: FocalVoteOptions | None = None
) -> FocalVote:
    """The focal length with which epipolar geometry fits the tracks of a walk best.

    Args:
        camera: gives size and principal point; its focal length is not looked at.
    """
    options = options or FocalVoteOptions()
    side = max(camera.width, camera.height)
    ratios = np.exp(np.linspace(-math.log(options.span), math.log(options.span), options.candidates))
    focals = TYPICAL_FOCAL * side * ratios
    cost = np.zeros(options.candidates)
    for first, second in _pairs(frames, options, options.min_shift * side):
        cost += [
            _epipolar_cost(first - camera.centre, second - camera.centre, focal, options.max_error)
            for focal in focals
        ]
    if cost.min() <= 0.0:
        return FocalVote(TYPICAL_FOCAL * side, float(focals[0]), float(focals[-1]), False)
    cost = cost / cost.min() + options.prior_weight * (np.log(ratios) / math.log(options.span)) ** 2
    best = int(np.argmin(cost))
    possible = focals[cost <= cost[best] * (1.0 + options.tolerance)]
    low, high = float(possible.min()), float(possible.max())
    inside = 0 < best < options.candidates - 1
    focal = float(focals[best])
    if inside:
        # The vertex of the parabola through the best candidate and its neighbours, in log focal length.
        before, at, after = cost[best - 1 : best + 2]
        focal *= float((ratios[1] / ratios[0]) ** (0.5 * (before - after) / (before - 2 * at + after)))
    return FocalVote(focal, low, high, inside and high <= options.decided * low)


def _pairs(
    frames: Sequence[TrackedFeatures], options: FocalVoteOptions, min_shift: float
) -> list[tuple[Array, Array]]:
    """Pixels (N, 2) of the same tracks in frames far apart, spread over the walk."""
    found = []
    stride = max(1, len(frames) // options.pairs)
    for begin in range(0, len(frames) - 1, stride):
        pair = _farthest(frames, begin, options)
        if pair is None:
            continue
        if np.median(np.linalg.norm(pair[1] - pair[0], axis=1)) >= min_shift:
            found.append(pair)
    return found


def _farthest(
    frames: Sequence[TrackedFeatures], begin: int, options: FocalVoteOptions
) -> tuple[Array, Array] | None:
    """What a frame shares with the last one that still shows enough of it."""
    here = frames[begin]
    needed = max(options.min_shared, options.min_share * len(here))
    for end in range(min(begin + options.max_gap, len(frames) - 1), begin, -2):
        there = frames[end]
        _, a, b = np.intersect1d(here.track, there.track, assume_unique=True, return_indices=True)
        if len(a) >= needed:
            return here.features.pixels[a].astype(np.float64), there.features.pixels[b].astype(np.float64)
    return None


def _epipolar_cost(first: Array, second: Array, focal: float, max_error: float) -> float:
    """Truncated squared Sampson errors of the best relative pose, pixels from the principal point."""
    camera = {"model": "SIMPLE_PINHOLE", "width": 1, "height": 1, "params": [focal, 0.0, 0.0]}
    options = {"max_epipolar_error": max_error, "max_iterations": 100, "min_iterations": 50, "seed": 0}
    pose, _ = poselib.estimate_relative_pose(first, second, camera, camera, options, {})
    x, y, z = pose.t
    essential = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]) @ pose.R
    a = np.column_stack([first / focal, np.ones(len(first))])
    b = np.column_stack([second / focal, np.ones(len(second))])
    line_b, line_a = a @ essential.T, b @ essential
    product = np.einsum("ij,ij->i", b, line_b)
    slope = (line_a[:, :2] ** 2).sum(axis=1) + (line_b[:, :2] ** 2).sum(axis=1)
    # Without a line there is no distance to it: an estimate that failed (t = 0) fits nothing.
    squared = np.full(len(first), np.inf)
    np.divide(focal**2 * product**2, slope, out=squared, where=slope > 1e-12)
    return float(np.minimum(squared, (4.0 / 3.0 * max_error) ** 2).sum())


def learn_lens(
    frames: Iterator[WalkFrame],
    camera: Camera,
    scale_factor: float,
    options: CalibrationOptions | None = None,
    on_progress: Callable[[float], None] | None = None,
) -> tuple[list[WalkFrame], Camera | None]:
    """The lens of an unknown camera from the first stretch of a walk that tells it.

    Args:
        frames: of the walk; as many are taken as are needed.
        camera: a pinhole camera of their size; its focal length is not looked at.
        scale_factor: of the feature extractor.
        on_progress: gets 0 to 1.

    Returns:
        The frames that were taken, and the lens: of their pixels, None if they do not tell it.
    """
    options = options or CalibrationOptions()
    report = on_progress or (lambda fraction: None)
    taken: list[WalkFrame] = []
    while len(taken) < options.most_frames:
        before = len(taken)
        for frame in islice(frames, options.frames):
            taken.append(frame)
            report(0.3 * (len(taken) - before) / options.frames)
        if len(taken) == before:
            break
        stretch = [frame.features for frame in taken[-options.frames :]]
        vote = vote_focal(stretch, camera, options.vote)
        if vote.decided:
            start = Camera.pinhole(camera.width, camera.height, vote.focal, vote.focal, *camera.centre)
            odometry = VisualOdometry(start, scale_factor, options.odometry)
            for index, features in enumerate(stretch):
                odometry.process(index, features)
                report(0.3 + 0.6 * index / len(stretch))
            if len(odometry.map.keyframes) >= options.min_keyframes:
                refine_globally(odometry.map, options.refinement)
                report(1.0)
                lens = odometry.map.camera
                # An adjustment that leaves what the votes allow has been led astray.
                return taken, start if vote.contradicts(lens.focal[0]) else lens
    return taken, None


def fitted_camera(pixels: Array, rays: Array, like: Camera) -> Camera:
    """The RADIAL camera of rays (N, 2) on z = 1 and their pixels (N, 2), with size and centre of ``like``."""
    centre = np.array(like.centre)
    squared = (rays**2).sum(axis=1, keepdims=True)

    def residual(parameters: Array) -> Array:
        focal, k1, k2 = parameters
        offset = focal * rays * (1.0 + squared * (k1 + squared * k2)) + centre - pixels
        return np.asarray(offset.ravel())

    start = [float(np.abs(pixels - centre).sum() / np.abs(rays).sum()), 0.0, 0.0]
    focal, k1, k2 = least_squares(residual, start, x_scale=[start[0], 0.1, 0.1]).x
    params = (float(focal), *like.centre, float(k1), float(k2))
    return Camera(CameraModel.RADIAL, like.width, like.height, params)
