"""From a leader's video to a route map: the stages in order, with progress and reasons."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from itertools import chain
from pathlib import Path
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from server.features.extraction import OrbExtractor, OrbOptions
from server.features.tracking import FeatureTracker, TrackerOptions
from server.geometry.cameras import Camera, CameraModel, Rectifier, square_pixels, typical_camera
from server.geometry.poses import SE3
from server.mapping.assembly import assemble, locate_frames
from server.mapping.closing import close_map
from server.mapping.evidence import tracking_record
from server.mapping.front_end import WalkFrame, follow_features, straightened
from server.mapping.global_refinement import RefinementOptions, displacement, refine_globally
from server.mapping.joining import JoinOptions, Joint, join
from server.mapping.outcome import (
    BuildProgress,
    BuildReport,
    BuildResult,
    BuildStage,
    BuildStatus,
    CameraSource,
    ProgressListener,
)
from server.mapping.quality import QualityReport, WalkOutcome, judge_quality
from server.mapping.route_map import RouteMap
from server.mapping.self_calibration import (
    CalibrationOptions,
    FocalVote,
    fitted_camera,
    learn_lens,
    vote_focal,
)
from server.mapping.video import FRAME_RATE, UnreadableVideoError, VideoFrame, probe, read_frames
from server.mapping.visual_odometry import OdometryOptions, TrackedFrame, TrackingState, VisualOdometry
from server.mapping.working_map import WorkingMap

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class BuildOptions:
    """Settings of a build.

    Attributes:
        extraction, tracker, odometry, joining, refinement: settings of the stages.
        min_frames: frames (10 a second) a walk needs; max_seconds: the longest video taken.
        restart_after: blind frames after which a new part of the walk is begun; min_keyframes: that a
            part needs to count.
        calibration: how an unknown camera is found out.
        min_tracked: share of the frames that must be tracked for a map to be worth having.
        lens_doubt: relative difference between the focal length that was given and the one the walk votes
            for from which on the given camera is doubted; lens_tolerance: relative displacement of pixels up
            to which it is kept all the same: leader and follower are mostly described by the same phones.
        lens_bends: from which on a lens has bent the odometry, which then is done anew with the refined one;
            most_walks: how often it is done at most.
        measured_length: length of the walk in metres, if somebody measured it: fixes the scale.
    """

    extraction: OrbOptions = field(default_factory=OrbOptions)
    tracker: TrackerOptions = field(default_factory=TrackerOptions)
    odometry: OdometryOptions = field(default_factory=OdometryOptions)
    joining: JoinOptions = field(default_factory=JoinOptions)
    refinement: RefinementOptions = field(default_factory=RefinementOptions)
    calibration: CalibrationOptions = field(default_factory=CalibrationOptions)
    min_frames: int = 20
    restart_after: int = 8
    min_keyframes: int = 3
    max_seconds: float = 1800.0
    min_tracked: float = 0.7
    lens_doubt: float = 0.05
    lens_tolerance: float = 0.08
    lens_bends: float = 0.03
    most_walks: int = 3
    measured_length: float | None = None


class _Progress:
    """Weighs the stages so that the bar moves evenly."""

    _SPANS: ClassVar = {
        BuildStage.DECODING: (0.0, 0.01),
        BuildStage.CALIBRATING: (0.01, 0.25),
        BuildStage.TRACKING: (0.01, 0.75),
        BuildStage.CLOSING: (0.75, 0.8),
        BuildStage.REFINING: (0.8, 0.92),
        BuildStage.FINISHING: (0.92, 1.0),
    }

    def __init__(self, listener: ProgressListener | None) -> None:
        self._listener = listener
        self._reached = 0.0

    def __call__(self, stage: BuildStage, done: float) -> None:
        if self._listener is not None:
            low, high = self._SPANS[stage]
            self._reached = max(self._reached, low + (high - low) * min(max(done, 0.0), 1.0))
            self._listener(BuildProgress(stage, self._reached))


def build_route_map(
    video: Path,
    camera: Camera | None,
    options: BuildOptions | None = None,
    on_progress: ProgressListener | None = None,
) -> BuildResult:
    """Build the route map of a walk.

    Args:
        camera: of the upright picture, or of the picture as stored where the video carries a rotation;
            None if nobody knows: then the walk itself tells it.
        on_progress: called now and then from this thread.

    Returns:
        A map, or the reason why there is none.
    """
    # The matrices here are small: BLAS threads would only wait for one another.
    with threadpool_limits(limits=1, user_api="blas"):
        return _build(video, camera, options or BuildOptions(), _Progress(on_progress))


def _build(video: Path, camera: Camera | None, options: BuildOptions, progress: _Progress) -> BuildResult:
    progress(BuildStage.DECODING, 0.0)
    try:
        properties = probe(video)
        if properties.seconds > options.max_seconds:
            return _failed(
                BuildStatus.TOO_LONG,
                f"the video lasts {properties.seconds:.0f} s; at most {options.max_seconds:.0f} s are taken",
            )
        size = (properties.width, properties.height)
        source = typical_camera(*size)
        if camera is not None:
            upright = _upright(camera, *size, properties.quarter_turns)
            if upright is None:
                return _failed(
                    BuildStatus.CAMERA_MISMATCH,
                    f"the camera is described for {camera.width}x{camera.height} pixels, "
                    f"the video has {properties.width}x{properties.height}",
                )
            source = upright
        rectifier = Rectifier(source)
        expected = max(1.0, properties.seconds * FRAME_RATE)
        extractor = OrbExtractor(options.extraction)
        tracker = FeatureTracker(extractor, options.tracker)
        frames = follow_features(_rectified(video, rectifier), rectifier.target, tracker)
        lens, first = rectifier.target, list[WalkFrame]()
        origin = CameraSource.GIVEN
        if camera is None:
            first, found = learn_lens(
                frames,
                rectifier.target,
                extractor.scale_factor,
                options.calibration,
                lambda done: progress(BuildStage.CALIBRATING, done),
            )
            lens, origin = (found, CameraSource.ESTIMATED) if found else (lens, CameraSource.ASSUMED)
        walk = _Walk(rectifier, lens, origin, extractor, options)
        for count, frame in enumerate(chain(first, frames)):
            walk.take(frame)
            if frame.time > options.max_seconds:
                return _failed(BuildStatus.TOO_LONG, f"the video lasts over {options.max_seconds:.0f} s")
            progress(BuildStage.TRACKING, count / expected)
    except UnreadableVideoError as error:
        return _failed(BuildStatus.NOT_A_VIDEO, str(error))
    result = walk.finish(progress)
    return replace(result, quality=walk.quality(result.route_map))


def _failed(status: BuildStatus, detail: str, report: BuildReport | None = None) -> BuildResult:
    return BuildResult(status, None, report or BuildReport(), detail)


def _upright(camera: Camera, width: int, height: int, quarter_turns: int) -> Camera | None:
    """The camera of the upright picture, None if it does not fit the video."""
    if (camera.width, camera.height) == (width, height):
        return camera
    turned = camera.rotated(quarter_turns)
    if quarter_turns and (turned.width, turned.height) == (width, height):
        return turned
    for candidate in (camera, turned):
        if abs(candidate.width / candidate.height - width / height) < 0.01:
            return candidate.scaled(width, height)
    return None


def _rectified(video: Path, rectifier: Rectifier) -> Iterator[VideoFrame]:
    for frame in read_frames(video):
        yield VideoFrame(frame.index, frame.time, rectifier(frame.image))


class _Walk:
    """The state of one build while its frames come in."""

    def __init__(
        self,
        rectifier: Rectifier,
        lens: Camera,
        origin: CameraSource,
        extractor: OrbExtractor,
        options: BuildOptions,
    ) -> None:
        self.options = options
        self.extractor = extractor
        self.rectifier = rectifier
        self.origin = origin
        self._taken: list[WalkFrame] = []
        self._begin(lens)

    def _begin(self, lens: Camera) -> None:
        self.lenses = [lens]
        self.camera = square_pixels(lens)
        self.frames: list[WalkFrame] = []
        self.parts = [self._odometry()]
        self.answers: list[TrackedFrame] = []
        self._located: list[SE3 | None] | None = None
        self._bridges: list[tuple[int, int]] = []
        self._blind = 0

    def _odometry(self) -> VisualOdometry:
        return VisualOdometry(self.camera, self.extractor.scale_factor, self.options.odometry)

    def take(self, frame: WalkFrame) -> None:
        self._taken.append(frame)
        self._follow(frame)

    def _follow(self, frame: WalkFrame) -> None:
        before = self.frames[-1] if self.frames else None
        frame = straightened(frame, before, self.lenses[0], self.camera)
        self.frames.append(frame)
        answer = self.parts[-1].process(len(self.frames) - 1, frame.features)
        self.answers.append(answer)
        self._blind = self._blind + 1 if answer.state is TrackingState.LOST else 0
        if self._blind >= self.options.restart_after:
            self.parts.append(self._odometry())
            self._blind = 0

    def finish(self, progress: _Progress) -> BuildResult:
        options = self.options
        report = BuildReport(frames=len(self.frames), video_seconds=self.frames[-1].time + 1.0 / FRAME_RATE)
        if len(self.frames) < options.min_frames:
            return _failed(
                BuildStatus.TOO_SHORT,
                f"the video has {len(self.frames)} usable frames; a walk needs at least {options.min_frames}",
                report,
            )
        working = self._map(report, progress)
        if isinstance(working, BuildResult):
            return working
        progress(BuildStage.FINISHING, 0.0)
        located = locate_frames(
            working,
            self.frames,
            sigma=options.odometry.track_sigma,
            min_inliers=options.odometry.min_inliers,
        )
        self._located = located
        report = self._report(report, working, located)
        if report.tracked_frames < options.min_tracked * report.frames:
            return _failed(BuildStatus.TRACKING_LOST, _where_lost(report), report)
        progress(BuildStage.FINISHING, 0.7)
        route_map = assemble(
            working,
            self.frames,
            located,
            levels=self.extractor.levels,
            measured_length=options.measured_length,
        )
        progress(BuildStage.FINISHING, 1.0)
        return BuildResult(BuildStatus.READY, route_map, report)

    def _map(self, report: BuildReport, progress: _Progress) -> WorkingMap | BuildResult:
        """The adjusted map of the whole walk, or why there is none.

        A lens that is clearly another than what the odometry believed has bent the walk beyond what an
        adjustment mends: then the odometry is done again.
        """
        options = self.options
        vote = vote_focal([frame.features for frame in self.frames], self.camera, options.calibration.vote)
        bent = vote.contradicts(self.camera.focal[0])
        if bent:
            focal = (vote.focal, *self.camera.centre, 0.0, 0.0)
            self.lenses.append(Camera(CameraModel.RADIAL, self.camera.width, self.camera.height, focal))
        for _ in range(options.most_walks):
            if bent:
                self._walk_again(progress)
            working = self._put_together(report, progress)
            if isinstance(working, BuildResult):
                return working
            progress(BuildStage.REFINING, 0.0)
            bent = self._refine(working, self._tells_lens(vote)) > options.lens_bends
            if not bent:
                break
        return working

    def _tells_lens(self, vote: FocalVote) -> bool:
        """Whether the lens is to be adjusted: the walk tells it, and what was given does not agree."""
        if self.origin is not CameraSource.GIVEN:
            return vote.decided
        return vote.decided and abs(math.log(vote.focal / self.camera.focal[0])) > self.options.lens_doubt

    def _put_together(self, report: BuildReport, progress: _Progress) -> WorkingMap | BuildResult:
        """The walk's parts as one map, or why that cannot be."""
        options = self.options
        maps = [part.map for part in self.parts if len(part.map.keyframes) >= options.min_keyframes]
        if not maps:
            return self._no_start(report)
        progress(BuildStage.CLOSING, 0.0)
        working = maps[0]
        turns = [frame.turn for frame in self.frames]
        for part in maps[1:]:
            ends = working.keyframes[-1].frame, part.keyframes[0].frame
            joint = join(working, part, turns, options.joining)
            if joint is Joint.BRIDGED:
                self._bridges.append(ends)
            if joint is None:
                blind = tuple(self.frames[m.keyframes[k].frame].time for m, k in ((working, -1), (part, 0)))
                return self._torn(report, maps, (blind[0], blind[1]))
        close_map(working, options.joining.revisits)
        return working

    def _walk_again(self, progress: _Progress) -> None:
        """Do the odometry anew with what is known of the lens by now."""
        target = self.rectifier.target
        pixels = _grid(target)
        self._revise_origin()
        self._begin(fitted_camera(pixels, self._rays(pixels), target))
        for count, frame in enumerate(self._taken):
            self._follow(frame)
            progress(BuildStage.TRACKING, count / len(self._taken))

    def _revise_origin(self) -> None:
        given = self.origin in (CameraSource.GIVEN, CameraSource.REFINED)
        self.origin = CameraSource.REFINED if given else CameraSource.ESTIMATED

    def _refine(self, working: WorkingMap, free_lens: bool) -> float:
        """Adjust the whole walk, and its lens with it where the walk tells what that is.

        Returns:
            How far pixels came to lie from where the odometry had them, relative.
        """
        # Intrinsics that were given are only given up for ones that are clearly others.
        tolerance = self.options.lens_tolerance if self.origin is CameraSource.GIVEN else 0.0
        before = working.camera
        refine_globally(
            working,
            replace(self.options.refinement, free_lens=free_lens, lens_tolerance=tolerance),
        )
        if working.camera == before:
            return 0.0
        lens, ideal = working.camera, square_pixels(working.camera)
        straight: list[WalkFrame] = []
        for frame in self.frames:
            straight.append(straightened(frame, straight[-1] if straight else None, lens, ideal))
        self.frames = straight
        working.straighten(ideal)
        self.camera = ideal
        self.lenses.append(lens)
        self._revise_origin()
        return displacement(lens, before)

    def _source_camera(self) -> Camera:
        """The camera of the upright video's pictures as the walk was mapped with."""
        source, target = self.rectifier.source, self.rectifier.target
        if self.origin is CameraSource.GIVEN:
            return source
        pixels = _grid(target)
        return fitted_camera(source.project_rays(target.normalize(pixels)), self._rays(pixels), source)

    def _rays(self, pixels: Array) -> Array:
        """Rays (N, 2) on z = 1 of the rectified picture's pixels (N, 2), as far as the lens is known."""
        for lens in self.lenses:
            rays = lens.normalize(pixels)
            pixels = square_pixels(lens).project_rays(rays)
        return rays

    def quality(self, route_map: RouteMap | None) -> QualityReport:
        """The quality report of the finished walk."""
        tracked, landmarks = tracking_record(self.parts, self.answers)
        if self._located is not None:
            tracked = np.array([pose is not None for pose in self._located])
        return judge_quality(
            self.frames,
            self.camera,
            WalkOutcome(
                tracked=tracked,
                landmarks=landmarks,
                poses=self._located,
                position=None if route_map is None else route_map.path.position,
                bridges=tuple(self._bridges),
            ),
        )

    def _torn(self, report: BuildReport, maps: list[WorkingMap], blind: tuple[float, float]) -> BuildResult:
        followed = replace(
            report,
            tracked_frames=sum(answer.state is TrackingState.TRACKED for answer in self.answers),
            keyframes=sum(len(part.keyframes) for part in maps),
            landmarks=sum(int(part.alive.sum()) for part in maps),
            lost=(blind,),
        )
        return _failed(
            BuildStatus.TRACKING_LOST,
            f"from {blind[0]:.1f} s to {blind[1]:.1f} s the camera could not be followed, and what comes "
            "after shows nothing known: record the walk again, more slowly there, and keep detail in view",
            followed,
        )

    def _no_start(self, report: BuildReport) -> BuildResult:
        """Why the odometry never found two views to start from."""
        counts = np.array([len(f.features) for f in self.frames])
        if np.median(counts) < self.options.odometry.start.two_view.min_points:
            return _failed(
                BuildStatus.NO_TEXTURE,
                "the pictures show too little to go by: blank walls, darkness or a covered lens",
                report,
            )
        ages = np.array([float(np.median(f.features.age)) if len(f.features) else 0.0 for f in self.frames])
        if ages.max() > 0.5 * len(self.frames):
            return _failed(BuildStatus.NO_MOTION, "the camera hardly moved: walk the whole way", report)
        return _failed(BuildStatus.TRACKING_LOST, "the motion of the camera could not be followed", report)

    def _report(self, report: BuildReport, working: WorkingMap, located: list[SE3 | None]) -> BuildReport:
        tracked = np.array([pose is not None for pose in located])
        times = np.array([frame.time for frame in self.frames])
        edges = np.flatnonzero(np.diff(np.concatenate([[False], ~tracked, [False]]).astype(int)))
        lost = tuple(
            (float(times[begin]), float(times[end - 1]))
            for begin, end in zip(edges[::2], edges[1::2], strict=True)
        )
        return BuildReport(
            frames=report.frames,
            tracked_frames=int(tracked.sum()),
            keyframes=len(working.keyframes),
            landmarks=int(working.alive.sum()),
            video_seconds=report.video_seconds,
            lost=lost,
            camera=self._source_camera(),
            camera_source=self.origin,
        )


def _grid(camera: Camera) -> Array:
    """Pixels (169, 2) all over a picture."""
    u, v = (np.linspace(0.0, side, 13) for side in (camera.width, camera.height))
    return np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)


def _where_lost(report: BuildReport) -> str:
    longest = sorted(report.lost, key=lambda span: span[0] - span[1])[:3]
    spans = ", ".join(f"{begin:.1f}-{end:.1f} s" for begin, end in sorted(longest))
    return (
        f"only {report.tracked_frames} of {report.frames} frames could be followed; lost at {spans}: "
        "walk more slowly there, and keep something with detail in view"
    )
