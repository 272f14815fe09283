"""Monocular visual odometry: two-view start, 2D-3D tracking, keyframes, triangulation, window.

Pair-Navi, section III-A, with the structure of ORB-SLAM's tracking and local mapping
(Mur-Artal, Montiel, Tardós, 2015, sections V and VI). Turns are where monocular odometry dies: the
landmarks leave the image faster than new ones get a depth. Three things carry it through:

- features without a depth take part in the pose by the direction they were seen in (:class:`_Rays`);
- landmarks of uncertain depth are made at once and trusted as far as their covariance goes;
- a weak prior of a walker's motion decides what the pixels leave open, as a bare wall does.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from server.features.matching import match_descriptors, match_predicted
from server.features.tracking import TrackedFeatures
from server.geometry.absolute_pose import (
    PoseEstimate,
    PosePrior,
    ransac_pose,
    refine_pose,
)
from server.geometry.cameras import Camera
from server.geometry.poses import SE3
from server.geometry.triangulation import triangulate
from server.mapping.initialization import StartOptions, StartOutcome, start_map
from server.mapping.working_map import Keyframe, WorkingMap

Array = NDArray[np.float64]
Ids = NDArray[np.intp]


@dataclass(frozen=True, slots=True)
class OdometryOptions:
    """Settings of :class:`VisualOdometry`.

    Attributes:
        start: how a start is found.
        local_keyframes: keyframes whose landmarks are looked for in a frame.
        window: keyframes adjusted at a new keyframe.
        min_inliers: 2D-3D inliers below which a frame is not tracked; min_recovery: the same
            after a loss, where nothing else speaks for the pose.
        max_distance: greatest Hamming distance of a match, bits; ratio: Lowe's ratio.
        track_sigma: standard deviation of a followed feature's pixel coordinate.
        keyframe_overlap: a keyframe is made when a frame sees less than this share of the last one's
            landmarks; keyframe_shift: or when they moved further than this in the image, pixels;
            keyframe_gap: or when this many frames have passed.
        triangulate_with: earlier keyframes among which a new one looks for a baseline.
        min_baseline: shortest baseline for new landmarks, as a share of the median depth.
        far_depth: depth of landmarks that show no parallax, as a multiple of the median depth.
        max_rays: tracks without a depth that take part in a pose.
        new_landmark_gate: squared normalised error up to which a new landmark fits its views; wide,
            because where the poses are a little off it is the new landmarks that put them right.
        prior_rotation: how much a walker's turn changes from frame to frame, radians.
        prior_translation: how much a walker's step changes, as a share of its length.
    """

    start: StartOptions = field(default_factory=StartOptions)
    local_keyframes: int = 15
    window: int = 8
    min_inliers: int = 20
    min_recovery: int = 35
    max_distance: int = 60
    ratio: float = 0.85
    track_sigma: float = 0.8
    keyframe_overlap: float = 0.8
    keyframe_shift: float = 40.0
    keyframe_gap: int = 5
    triangulate_with: int = 10
    min_baseline: float = 0.01
    far_depth: float = 20.0
    max_rays: int = 300
    new_landmark_gate: float = 25.0
    prior_rotation: float = float(np.deg2rad(3.0))
    prior_translation: float = 0.5


class TrackingState(StrEnum):
    """What became of a frame."""

    STARTING = "starting"
    TRACKED = "tracked"
    LOST = "lost"


@dataclass(frozen=True, eq=False, slots=True)
class TrackedFrame:
    """A frame's result; the pose only if TRACKED.

    Attributes:
        inliers: 2D-3D inliers the pose rests on.
        keyframe: whether the frame became a keyframe.
    """

    state: TrackingState
    camera_from_world: SE3 | None = None
    inliers: int = 0
    keyframe: bool = False


@dataclass(frozen=True, eq=False, slots=True)
class _Correspondences:
    """2D-3D pairs: landmark ids and feature indices with their pixels' standard deviations."""

    landmark: Ids
    feature: Ids
    sigma: Array

    def select(self, keep: NDArray[np.bool_]) -> _Correspondences:
        return _Correspondences(self.landmark[keep], self.feature[keep], self.sigma[keep])

    def joined(self, other: _Correspondences) -> _Correspondences:
        return _Correspondences(
            np.concatenate([self.landmark, other.landmark]),
            np.concatenate([self.feature, other.feature]),
            np.concatenate([self.sigma, other.sigma]),
        )


@dataclass(frozen=True, eq=False, slots=True)
class _Rays:
    """Tracks whose depth is not known yet: points at a typical depth, all but free along their ray.

    To a pose they say what the epipolar constraint says.
    """

    points: Array
    covariances: Array
    feature: Ids


class VisualOdometry:
    """Tracks frame after frame and builds a map of them."""

    def __init__(self, camera: Camera, scale_factor: float, options: OdometryOptions | None = None) -> None:
        self.camera = camera
        self.options = options or OdometryOptions()
        self.map = WorkingMap(camera, scale_factor)
        self._first: tuple[int, TrackedFeatures] | None = None
        self._pose: SE3 | None = None
        self._velocity = SE3.identity()
        self._speed = 0.0
        self._gap = 1

    @property
    def started(self) -> bool:
        """Whether there is a map to track against."""
        return bool(self.map.keyframes)

    def process(self, frame: int, features: TrackedFeatures) -> TrackedFrame:
        """Take the next frame of the walk."""
        if not self.started:
            return self._start(frame, features)
        found = self._track(features)
        if found is None:
            self._gap += 1
            return TrackedFrame(TrackingState.LOST)
        pose, seen = found
        self._update_motion(pose)
        self._pose = pose
        made = self._needs_keyframe(frame, features, seen)
        if made:
            self._add_keyframe(frame, features, pose, seen)
            self._pose = self.map.keyframes[-1].camera_from_world
        return TrackedFrame(TrackingState.TRACKED, self._pose, len(seen.landmark), made)

    def _update_motion(self, pose: SE3) -> None:
        if self._pose is not None and self._gap == 1:
            motion = pose @ self._pose.inverse()
            length = float(np.linalg.norm(motion.translation))
            self._speed = length if self._speed == 0.0 else 0.7 * self._speed + 0.3 * length
            self._velocity = SE3(motion.rotation, 0.5 * (self._velocity.translation + motion.translation))
        self._gap = 1

    def _start(self, frame: int, features: TrackedFeatures) -> TrackedFrame:
        patience = self.options.start.patience
        if self._first is None or frame - self._first[0] > patience:
            self._first = (frame, features)
            return TrackedFrame(TrackingState.STARTING)
        outcome = start_map(
            self.map, self._first, (frame, features), self.options.track_sigma, self.options.start
        )
        if outcome is StartOutcome.NOTHING_IN_COMMON:
            self._first = (frame, features)
        if outcome is not StartOutcome.STARTED:
            return TrackedFrame(TrackingState.STARTING)
        self._pose = self.map.keyframes[1].camera_from_world
        self._gap = 1
        return TrackedFrame(TrackingState.TRACKED, self._pose, int(self.map.alive.sum()), True)

    def _track(self, features: TrackedFeatures) -> tuple[SE3, _Correspondences] | None:
        """The frame's pose and the 2D-3D inliers it rests on."""
        options = self.options
        if len(features) < options.min_inliers or self._pose is None:
            return None
        followed = self._followed(features)
        if self._gap > 1 and len(followed.landmark) < options.min_recovery:
            followed = self._recognised(features)
            if len(followed.landmark) < options.min_recovery:
                return None
        rays = self._rays(features)
        guess = self._velocity @ self._pose
        starts = [guess]
        if len(followed.landmark) >= 10:
            hypothesis = ransac_pose(
                self.map.position[followed.landmark],
                features.features.pixels[followed.feature],
                self.camera,
                max_error=4.0,
                initial=guess,
            )
            if hypothesis is not None:
                starts.append(hypothesis[0])
        best: PoseEstimate | None = None
        for start in starts:
            estimate = self._refine(features, followed, rays, start, anneal=(6.0, 2.0, 1.0))
            if estimate is not None and (best is None or estimate.inliers.sum() > best.inliers.sum()):
                best = estimate
        if best is None:
            return None
        followed = followed.select(best.inliers[: len(followed.landmark)])
        seen = followed.joined(self._found_again(features, followed, best.camera_from_world))
        final = self._refine(features, seen, rays, best.camera_from_world)
        if final is None:
            return None
        seen = seen.select(final.inliers[: len(seen.landmark)])
        if len(seen.landmark) < (options.min_inliers if self._gap == 1 else options.min_recovery):
            return None
        return final.camera_from_world, seen

    def _followed(self, features: TrackedFeatures) -> _Correspondences:
        """Landmarks whose track runs from the last keyframe into this frame."""
        last = self.map.keyframes[-1]
        known = last.matched
        _, a, b = np.intersect1d(last.track[known], features.track, assume_unique=True, return_indices=True)
        return _Correspondences(last.landmark[known][a], b, np.full(len(b), self.options.track_sigma))

    def _recognised(self, features: TrackedFeatures) -> _Correspondences:
        """After a loss, when no track has survived: landmarks of the last keyframes by their look."""
        options, m = self.options, self.map
        last = len(m.keyframes)
        local = m.seen_by(list(range(max(0, last - options.local_keyframes), last)))
        look = features.features
        matches = match_descriptors(
            look.descriptors, m.descriptor[local], max_distance=options.max_distance, ratio=options.ratio
        )
        sigma = options.track_sigma * m.scale_factor ** look.octaves[matches.a].astype(np.float64)
        return _Correspondences(local[matches.b], matches.a, sigma)

    def _rays(self, features: TrackedFeatures) -> _Rays:
        last = self.map.keyframes[-1]
        free = np.flatnonzero(last.landmark < 0)
        _, a, b = np.intersect1d(last.track[free], features.track, assume_unique=True, return_indices=True)
        step = max(1, len(a) // self.options.max_rays)
        a, b = a[::step], b[::step]
        rays = np.column_stack([self.camera.normalize(last.features.pixels[free[a]]), np.ones(len(a))])
        depth = self._median_depth(last)
        world_from_camera = last.camera_from_world.inverse()
        across = rays @ world_from_camera.rotation.T
        # Ten times the depth as its standard deviation: many rays together must not pull either.
        covariances = (10.0 * depth) ** 2 * np.einsum("ni,nj->nij", across, across)
        return _Rays(world_from_camera @ (depth * rays), covariances, b)

    def _refine(
        self,
        features: TrackedFeatures,
        seen: _Correspondences,
        rays: _Rays,
        pose: SE3,
        anneal: tuple[float, ...] = (1.0,),
    ) -> PoseEstimate | None:
        """Refine a pose by landmarks and rays; the estimate's inliers list the landmarks first."""
        feature = np.concatenate([seen.feature, rays.feature])
        if len(feature) < 6:
            return None
        return refine_pose(
            pose,
            np.concatenate([self.map.position[seen.landmark], rays.points]),
            features.features.pixels[feature],
            np.concatenate([seen.sigma, np.full(len(rays.feature), self.options.track_sigma)]),
            self.camera,
            point_covariances=np.concatenate([self.map.covariance[seen.landmark], rays.covariances]),
            prior=self._motion_prior(),
            anneal=anneal,
        )

    def _motion_prior(self) -> PosePrior | None:
        """A walker's next pose: about as far on as the last ones, in about the same direction."""
        if self._pose is None or self._speed <= 0.0:
            return None
        frames = min(self._gap, 10)
        return PosePrior(
            self._velocity @ self._pose,
            self.options.prior_rotation * frames,
            self.options.prior_translation * self._speed * frames,
        )

    def _found_again(self, features: TrackedFeatures, seen: _Correspondences, pose: SE3) -> _Correspondences:
        """Landmarks of the last keyframes that lost their track, matched where the pose predicts them."""
        options, m = self.options, self.map
        last = len(m.keyframes)
        local = m.seen_by(list(range(max(0, last - options.local_keyframes), last)))
        ids = np.setdiff1d(local, seen.landmark)
        free = np.setdiff1d(np.arange(len(features)), seen.feature)
        points = pose @ m.position[ids]
        front = points[:, 2] > 1e-3
        ids, points = ids[front], points[front]
        pixels = self.camera.project(points)
        inside = (
            (pixels[:, 0] > 0)
            & (pixels[:, 1] > 0)
            & (pixels[:, 0] < self.camera.width)
            & (pixels[:, 1] < self.camera.height)
        )
        ids, points, pixels = ids[inside], points[inside], pixels[inside]
        octave = m.predicted_octave(ids, np.linalg.norm(points, axis=1))
        look = features.features
        matches = match_predicted(
            pixels,
            m.descriptor[ids],
            look.pixels[free],
            look.descriptors[free],
            radius=4.0 * m.scale_factor ** np.clip(octave, 0, 4).astype(np.float64),
            max_distance=options.max_distance,
            ratio=options.ratio,
            predicted_octaves=octave,
            octaves=look.octaves[free],
        )
        feature = free[matches.b]
        # A detection of another octave's grid: as exact as that grid.
        sigma = options.track_sigma * m.scale_factor ** look.octaves[feature].astype(np.float64)
        return _Correspondences(ids[matches.a], feature, sigma)

    def _needs_keyframe(self, frame: int, features: TrackedFeatures, seen: _Correspondences) -> bool:
        options = self.options
        reference = self.map.keyframes[-1]
        if frame - reference.frame >= options.keyframe_gap:
            return True
        if len(seen.landmark) < options.keyframe_overlap * len(reference.matched):
            return True
        _, a, b = np.intersect1d(reference.track, features.track, assume_unique=True, return_indices=True)
        if len(a) < 20:
            return True
        shift = np.linalg.norm(features.features.pixels[b] - reference.features.pixels[a], axis=1)
        return bool(np.median(shift) > options.keyframe_shift)

    def _add_keyframe(self, frame: int, features: TrackedFeatures, pose: SE3, seen: _Correspondences) -> None:
        keyframe = Keyframe.of(frame, features, pose, self.options.track_sigma)
        keyframe.sigma[seen.feature] = seen.sigma
        self.map.keyframes.append(keyframe)
        new = len(self.map.keyframes) - 1
        self.map.observe(new, seen.feature, seen.landmark)
        self._triangulate(new)
        self.map.adjust_window(list(range(max(0, new - self.options.window + 1), new + 1)))
        self.map.refresh(new)
        self.map.update_covariances(list(range(max(0, new - self.options.local_keyframes), new + 1)))

    def _median_depth(self, keyframe: Keyframe) -> float:
        ids = keyframe.landmark[keyframe.matched]
        points = keyframe.camera_from_world @ self.map.position[ids]
        return float(np.median(points[:, 2])) if len(points) else 1.0

    def _triangulate(self, new: int) -> None:
        """New landmarks of tracks that the keyframe shares with earlier ones, widest baseline first."""
        options, m = self.options, self.map
        current = m.keyframes[new]
        depth = self._median_depth(current)
        earlier = range(max(0, new - options.triangulate_with), new)
        baseline = {k: float(np.linalg.norm(m.keyframes[k].centre - current.centre)) for k in earlier}
        wide = [k for k in earlier if baseline[k] > options.min_baseline * depth]
        for other in sorted(wide, key=lambda k: -baseline[k]):
            self._triangulate_pair(other, new, depth)

    def _triangulate_pair(self, other: int, new: int, depth: float) -> None:
        m = self.map
        a, b = m.keyframes[other], m.keyframes[new]
        free_a, free_b = np.flatnonzero(a.landmark < 0), np.flatnonzero(b.landmark < 0)
        _, i, j = np.intersect1d(a.track[free_a], b.track[free_b], assume_unique=True, return_indices=True)
        if len(i) == 0:
            return
        feature_a, feature_b = free_a[i], free_b[j]
        pixels_a, pixels_b = a.features.pixels[feature_a], b.features.pixels[feature_b]
        points = triangulate(
            a.camera_from_world,
            b.camera_from_world,
            self.camera.normalize(pixels_a),
            self.camera.normalize(pixels_b),
        )
        points = self._clamped(points, b, pixels_b, depth)
        good = self._fits(a, points, feature_a) & self._fits(b, points, feature_b)
        ids = m.add_landmarks(points[good], new, feature_b[good])
        m.observe(other, feature_a[good], ids)
        m.observe(new, feature_b[good], ids)
        self._observe_between(other, new, b.track[feature_b[good]], ids)

    def _observe_between(self, other: int, new: int, tracks: Ids, ids: Ids) -> None:
        """The keyframes that lie on the new landmarks' tracks see them too."""
        for k in range(max(0, new - self.options.triangulate_with), new):
            if k == other:
                continue
            kf = self.map.keyframes[k]
            free = np.flatnonzero(kf.landmark < 0)
            _, i, j = np.intersect1d(kf.track[free], tracks, assume_unique=True, return_indices=True)
            fits = self._fits(kf, self.map.position[ids[j]], free[i])
            self.map.observe(k, free[i][fits], ids[j][fits])

    def _fits(self, keyframe: Keyframe, points: Array, feature: Ids) -> NDArray[np.bool_]:
        """Which points (N, 3) project onto the given features of a keyframe."""
        local = keyframe.camera_from_world @ points
        front = local[:, 2] > 1e-3
        error = np.full(len(points), np.inf)
        offset = self.camera.project(local[front]) - keyframe.features.pixels[feature[front]]
        error[front] = ((offset / keyframe.sigma[feature[front], None]) ** 2).sum(axis=1)
        return error < self.options.new_landmark_gate

    def _clamped(self, points: Array, keyframe: Keyframe, pixels: Array, depth: float) -> Array:
        """Points behind the camera or too far away, put on their ray at the farthest depth.

        Noise makes the rays of a far point diverge as often as converge. Dropping those that diverge
        would keep the ones that look too near, and the scale would shrink in every turn.
        """
        far = self.options.far_depth * depth
        local = keyframe.camera_from_world @ points
        beyond = (local[:, 2] <= 1e-3) | (local[:, 2] > far)
        rays = np.column_stack([self.camera.normalize(pixels), np.ones(len(pixels))])
        local[beyond] = far * rays[beyond]
        return keyframe.camera_from_world.inverse() @ local
