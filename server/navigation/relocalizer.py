"""Relocalization: the pose of one picture in a route map, or a refusal.

Pair-Navi, section III-A: retrieve the most similar keyframes, match, PnP; then guided matching around
the pose and refinement. A pose is given only on evidence that chance and look-alikes do not produce.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from server.features.extraction import Features
from server.features.matching import match_descriptors, match_predicted
from server.features.retrieval import PlaceIndex, RetrievalOptions
from server.geometry.absolute_pose import PoseEstimate, ransac_pose, refine_pose
from server.geometry.cameras import Camera, occupied_cells
from server.geometry.poses import SE3
from server.geometry.resection import LensPrior, View, resect
from server.mapping.route_map import RouteMap
from server.navigation.updates import Fix, Refusal, RefusalReason

Array = NDArray[np.float64]
Ids = NDArray[np.intp]


@dataclass(frozen=True, slots=True)
class EvidenceNeeded:
    """What a pose must rest on to be given.

    Attributes:
        inliers: matches that agree with it.
        cells: of 8 x 6 image cells, how many must hold one: a single poster is no place.
        precision: least share of the landmarks matched near their prediction that agree: at a wrong
            pose chance matches are as many as ever, and few of them agree.
        sigma: greatest standard deviation of the camera centre over the median depth.
        recall: least share of the landmarks that should be in the picture that agree: a door or a poster
            of the same make agrees alone, and nothing around it does.
        reach: share of a follower's possible motion since the last fix that is believed.
    """

    inliers: int
    cells: int
    precision: float
    sigma: float
    recall: float
    reach: float = 1.0


@dataclass(frozen=True, slots=True)
class RelocalizerOptions:
    """Settings of :class:`Relocalizer`.

    Attributes:
        retrieval: of the place index.
        candidates: keyframes tried when there is no prior, or what was expected is not seen.
        reach: keyframes on either side of a candidate whose landmarks are matched.
        max_distance, ratio: of a match without prediction, bits and Lowe's ratio.
        guided_distance, guided_ratio, guided_radius: of a match near its predicted pixel;
            remeasure: angle by which refinement may move the view before the search is repeated, radians.
        max_error: RANSAC's inlier threshold, pixels; pixel_sigma: standard deviation of a pixel coordinate
            at octave 0, the map's own errors and a phone's rough intrinsics included.
        min_features: features below which a picture shows too little.
        alone: evidence a picture needs by itself; expected: and where an expected pose agrees with it.
        speed, turn_rate: how fast a follower moves, map units and radians a second; slack_length,
            slack_angle: allowed besides.
    """

    retrieval: RetrievalOptions = field(default_factory=RetrievalOptions)
    candidates: int = 4
    reach: int = 6
    max_distance: int = 60
    ratio: float = 0.88
    guided_distance: int = 64
    guided_ratio: float = 0.92
    guided_radius: float = 8.0
    remeasure: float = 0.006
    max_error: float = 5.0
    pixel_sigma: float = 1.5
    min_features: int = 30
    alone: EvidenceNeeded = field(default_factory=lambda: EvidenceNeeded(30, 12, 0.5, 0.009, 0.03))
    expected: EvidenceNeeded = field(
        default_factory=lambda: EvidenceNeeded(20, 8, 0.45, 0.015, 0.02, reach=0.5)
    )
    speed: float = 3.0
    turn_rate: float = math.radians(150.0)
    slack_length: float = 0.6
    slack_angle: float = math.radians(12.0)


@dataclass(frozen=True, eq=False, slots=True)
class Evidence:
    """What speaks for a pose.

    Attributes:
        view: the matches that agree; camera: the pinhole camera they were found with.
        inliers: their number; matches: matches near their prediction; expected: landmarks that should be
            in the picture.
        cells: of 8 x 6 image cells, how many hold an inlier.
        sigma: standard deviation of the camera centre over the median depth of the inliers.
        depth: that depth, map units.
    """

    estimate: PoseEstimate
    view: View
    camera: Camera
    expected: int
    inliers: int
    matches: int
    cells: int
    sigma: float
    depth: float
    keyframe: int


@dataclass(frozen=True, eq=False, slots=True)
class Sighting:
    """A fix and what it rests on.

    Attributes:
        view: the landmarks seen and the pixels they were seen at.
        camera: the pinhole camera of these pixels.
    """

    fix: Fix
    view: View
    camera: Camera


class Relocalizer:
    """Finds pictures in one route map; holds no state of a session."""

    def __init__(
        self,
        route_map: RouteMap,
        scale_factor: float,
        levels: int,
        options: RelocalizerOptions | None = None,
    ) -> None:
        self.route_map = route_map
        self.scale_factor = scale_factor
        self.levels = levels
        self.options = options or RelocalizerOptions()
        observations = route_map.observations
        self._places = PlaceIndex(
            np.asarray(route_map.landmarks.descriptor),
            np.asarray(observations.offsets),
            np.asarray(observations.landmark),
            self.options.retrieval,
        )
        self._forward = route_map.keyframe_rotations[:, :, 2]
        self._position = np.asarray(route_map.landmarks.position)

    def locate(
        self,
        features: Features,
        camera: Camera,
        prior: SE3 | None = None,
        *,
        elapsed: float = 0.0,
        trusted: bool = False,
        focal_factors: tuple[float, ...] = (1.0,),
    ) -> Sighting | Refusal:
        """The pose of a picture with the given features of a rectified (pinhole) camera.

        Args:
            prior: world_from_camera of a recent fix: where to look first.
            elapsed: seconds since that fix.
            trusted: whether that fix may speak for a pose that the picture alone does not prove.
            focal_factors: focal lengths that are possible, as factors of the camera's; with more than
                one, the one that explains most is adjusted together with the pose.
        """
        options = self.options
        if len(features) < options.min_features:
            return Refusal(RefusalReason.TOO_FEW_FEATURES)
        best: Evidence | None = None
        if prior is not None:
            best = self._try(features, camera, self.nearest_keyframe(prior), focal_factors)
            if best is not None:
                for needed, strong in ((options.alone, True), (options.expected, False)):
                    admitted = strong or trusted
                    if (
                        admitted
                        and self._enough(best, needed)
                        and self._reachable(best, prior, elapsed, needed)
                    ):
                        return self._sighting(best, strong=strong)
        candidates = self._places.query(features.descriptors, options.candidates)
        for candidate in candidates:
            evidence = self._try(features, camera, candidate.keyframe, focal_factors)
            if evidence is not None and (best is None or evidence.inliers > best.inliers):
                best = evidence
            if best is not None and best.inliers >= 3 * options.alone.inliers:
                break
        if best is None:
            return Refusal(RefusalReason.NO_SIMILAR_PLACE)
        if not self._enough(best, options.alone):
            few = best.inliers < options.alone.inliers
            # Enough matches that agree but lie in one corner, or far away, leave the pose open.
            reason = RefusalReason.TOO_FEW_INLIERS if few else RefusalReason.AMBIGUOUS
            return Refusal(reason, best.inliers)
        return self._sighting(best, strong=True)

    def nearest_keyframe(self, world_from_camera: SE3) -> int:
        """The keyframe whose view is nearest to a pose: place and heading together.

        A quarter turn away counts as much as the distance walked in two seconds.
        """
        offset = self.route_map.keyframes.position - world_from_camera.translation
        distance = np.linalg.norm(offset, axis=1)
        cosine = self._forward @ world_from_camera.rotation[:, 2]
        return int(np.argmin(distance + 2.0 * (1.0 - cosine)))

    def _enough(self, evidence: Evidence, needed: EvidenceNeeded) -> bool:
        return (
            evidence.inliers >= needed.inliers
            and evidence.cells >= needed.cells
            and evidence.inliers >= needed.precision * evidence.matches
            and evidence.inliers >= needed.recall * evidence.expected
            and evidence.sigma <= needed.sigma
        )

    def _reachable(self, evidence: Evidence, prior: SE3, elapsed: float, needed: EvidenceNeeded) -> bool:
        """Whether a follower can have come from the last fix to this pose."""
        options = self.options
        pose = evidence.estimate.camera_from_world.inverse()
        moved = float(np.linalg.norm(pose.translation - prior.translation))
        # Where the leader crept, the unit is short: the depth of the scene bounds a step as well.
        length = max(options.slack_length, 0.3 * evidence.depth) + options.speed * elapsed
        angle = options.slack_angle + options.turn_rate * elapsed
        return moved <= needed.reach * length and pose.angle_to(prior) <= needed.reach * angle

    def _sighting(self, evidence: Evidence, *, strong: bool) -> Sighting:
        fix = Fix(
            world_from_camera=evidence.estimate.camera_from_world.inverse(),
            covariance=evidence.estimate.covariance,
            inliers=evidence.inliers,
            matches=evidence.matches,
            keyframe=evidence.keyframe,
            strong=strong,
        )
        return Sighting(fix, evidence.view, evidence.camera)

    def _local(self, keyframe: int) -> tuple[Ids, NDArray[np.uint8]]:
        """Landmarks that the keyframes around one see, each with its look in the nearest of them."""
        observations = self.route_map.observations
        low = max(0, keyframe - self.options.reach)
        high = min(len(observations.offsets) - 1, keyframe + self.options.reach + 1)
        order = sorted(range(low, high), key=lambda k: abs(k - keyframe))
        rows = np.concatenate([np.arange(*observations.offsets[k : k + 2]) for k in order])
        landmarks, first = np.unique(observations.landmark[rows], return_index=True)
        return landmarks.astype(np.intp), np.asarray(observations.descriptor[rows[first]])

    def _try(
        self, features: Features, camera: Camera, keyframe: int, focal_factors: tuple[float, ...]
    ) -> Evidence | None:
        """The best pose in the neighbourhood of a keyframe."""
        options = self.options
        local, look = self._local(keyframe)
        pairs = match_descriptors(
            features.descriptors,
            look,
            max_distance=options.max_distance,
            ratio=options.ratio,
        )
        if len(pairs) < 8:
            return None
        points, pixels = self._position[local[pairs.b]], features.pixels[pairs.a]
        start = self._start(points, pixels, camera, focal_factors)
        if start is None:
            return None
        pose, camera = start
        evidence = self._guided(features, camera, local, look, pose)
        if evidence is not None and self._moved(evidence.estimate.camera_from_world, pose, evidence.depth):
            # Predictions were off: some of the landmarks were looked for in the wrong place.
            pose = evidence.estimate.camera_from_world
            evidence = self._guided(features, camera, local, look, pose)
        return evidence

    def _start(
        self, points: Array, pixels: Array, camera: Camera, focal_factors: tuple[float, ...]
    ) -> tuple[SE3, Camera] | None:
        """A first pose from matches, and the focal length with which most of them agree."""
        options = self.options
        best: tuple[SE3, Camera, NDArray[np.bool_]] | None = None
        for factor in focal_factors:
            candidate = camera.with_focal(factor * camera.focal[0])
            found = ransac_pose(points, pixels, candidate, max_error=options.max_error)
            if found is not None and (best is None or found[1].sum() > best[2].sum()):
                best = (found[0], candidate, found[1])
        if best is None or best[2].sum() < 8:
            return None
        pose, camera, inliers = best
        if len(focal_factors) > 1:
            sigmas = np.full(int(inliers.sum()), 0.5 * options.max_error)
            view = View(pose, points[inliers], pixels[inliers], sigmas)
            found_lens = resect([view], LensPrior(camera, 0.15, 1e-3))
            if found_lens is not None:
                pose, camera = found_lens.poses[0], camera.with_focal(found_lens.camera.focal[0])
        return pose, camera

    def _moved(self, pose: SE3, before: SE3, depth: float) -> bool:
        """Whether two poses show the scene more than half a search radius apart."""
        shift = float(np.linalg.norm(pose.translation - before.translation)) / max(depth, 1e-9)
        return pose.angle_to(before) + shift > self.options.remeasure

    def _guided(
        self,
        features: Features,
        camera: Camera,
        local: Ids,
        look: NDArray[np.uint8],
        pose: SE3,
    ) -> Evidence | None:
        options, landmarks = self.options, self.route_map.landmarks
        points = pose @ self._position[local]
        front = points[:, 2] > 1e-3
        local, look, points = local[front], look[front], points[front]
        pixels = camera.project(points)
        to_camera = pose.inverse().translation - self._position[local]
        distance = np.linalg.norm(to_camera, axis=1)
        facing = np.einsum("ij,ij->i", to_camera, landmarks.normal[local].astype(np.float64))
        nearest, farthest = landmarks.distance[local].astype(np.float64).T
        visible = (
            (pixels[:, 0] > 0)
            & (pixels[:, 1] > 0)
            & (pixels[:, 0] < camera.width)
            & (pixels[:, 1] < camera.height)
            & (facing > 0.5 * distance)
            & (distance > 0.7 * nearest)
            & (distance < 1.4 * farthest)
        )
        local, look, pixels = local[visible], look[visible], pixels[visible]
        distance, farthest = distance[visible], farthest[visible]
        octave = np.log(farthest / distance) / np.log(self.scale_factor)
        octave = np.clip(np.round(octave), 0, self.levels - 1).astype(np.int64)
        matches = match_predicted(
            pixels,
            look,
            features.pixels,
            features.descriptors,
            radius=options.guided_radius * self.scale_factor ** np.clip(octave, 0, 4),
            max_distance=options.guided_distance,
            ratio=options.guided_ratio,
            predicted_octaves=octave,
            octaves=features.octaves,
            octave_slack=2,
        )
        if len(matches) < 8:
            return None
        octaves = features.octaves[matches.b].astype(np.float64)
        sigmas = options.pixel_sigma * self.scale_factor**octaves
        chosen = local[matches.a]
        estimate = refine_pose(
            pose, self._position[chosen], features.pixels[matches.b], sigmas, camera, anneal=(2.0, 1.0)
        )
        if estimate is None:
            return None
        depth = float(
            np.median((estimate.camera_from_world @ self._position[chosen[estimate.inliers]])[:, 2])
        )
        agree = estimate.inliers
        return Evidence(
            estimate=estimate,
            view=View(
                estimate.camera_from_world,
                self._position[chosen[agree]],
                features.pixels[matches.b[agree]],
                sigmas[agree],
            ),
            camera=camera,
            expected=len(local),
            inliers=int(estimate.inliers.sum()),
            matches=len(matches),
            cells=occupied_cells(features.pixels[matches.b[estimate.inliers]], camera),
            sigma=float(np.sqrt(np.trace(estimate.covariance[3:, 3:]))) / max(depth, 1e-9),
            depth=depth,
            keyframe=self.nearest_keyframe(estimate.camera_from_world.inverse()),
        )
