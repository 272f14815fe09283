"""A map of pictures whose poses are known: features matched between them, landmarks triangulated.

What a visual odometry finds out is given here, so matching is guided by the poses throughout: landmarks are
looked for where they must appear, and a pair of features begins one only if its rays meet.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from server.features.extraction import FeatureExtractor, Features
from server.features.matching import best_pairs, hamming, match_predicted
from server.features.tracking import TrackedFeatures
from server.geometry.cameras import Camera
from server.geometry.poses import SE3, rotation_angle, skew
from server.geometry.triangulation import depths, parallax, triangulate
from server.mapping.bundle_adjustment import BundleProblem, adjust
from server.mapping.revisits import Revisit, RevisitOptions, find_revisits
from server.mapping.working_map import Keyframe, WorkingMap

Array = NDArray[np.float64]
Ids = NDArray[np.intp]


@dataclass(frozen=True, slots=True)
class PosedWalkOptions:
    """Settings of :func:`map_posed_pictures`.

    Attributes:
        reach: earlier pictures with which a new one is matched.
        radius: how far from its prediction a landmark is looked for, pixels at octave 0.
        max_distance, ratio: of a match, bits and Lowe's ratio.
        sigma: standard deviation of a feature's pixel coordinate at octave 0, the poses' own errors included.
        gate: squared normalised error up to which an observation fits.
        min_parallax: angle under which two pictures must see a new landmark, radians.
        min_observations: pictures that must see a landmark for it to stay.
        revisits: how places that the walk passes twice are recognised.
        revisit_angle, revisit_shift: how far a recognised place may be from where the poses say, radians
            and as a share of the depth of the scene; beyond, the poses have drifted and nothing is merged.
    """

    reach: int = 6
    radius: float = 4.0
    max_distance: int = 60
    ratio: float = 0.85
    sigma: float = 1.0
    gate: float = 9.0
    min_parallax: float = float(np.deg2rad(1.0))
    min_observations: int = 3
    revisits: RevisitOptions = field(default_factory=lambda: RevisitOptions(min_gap=15))
    revisit_angle: float = float(np.deg2rad(1.0))
    revisit_shift: float = 0.02


@dataclass(frozen=True, eq=False, slots=True)
class PosedPicture:
    """A rectified grey picture (H, W) uint8 and its pose."""

    image: NDArray[np.uint8]
    camera_from_world: SE3


def map_posed_pictures(
    pictures: Iterable[PosedPicture],
    camera: Camera,
    extractor: FeatureExtractor,
    options: PosedWalkOptions | None = None,
) -> WorkingMap:
    """A map of pictures in the order of the walk, each a keyframe that stays exactly where it is.

    Args:
        camera: the pinhole camera of all pictures.
    """
    options = options or PosedWalkOptions()
    working = WorkingMap(camera, extractor.scale_factor)
    tracks = 0
    for frame, picture in enumerate(pictures):
        features = extractor.extract(picture.image)
        _add(working, frame, features, picture.camera_from_world, tracks, options)
        tracks += len(features)
    _merge_revisits(working, options)
    settle_landmarks(working, options.gate)
    working.kill(np.flatnonzero(working.alive & (working.observed < options.min_observations)))
    return working


def _add(
    working: WorkingMap, frame: int, features: Features, pose: SE3, track: int, options: PosedWalkOptions
) -> None:
    identities = np.arange(track, track + len(features))
    tracked = TrackedFeatures(features, identities, np.zeros(len(features), np.int64))
    keyframe = Keyframe.of(frame, tracked, pose, options.sigma)
    keyframe.sigma[:] = options.sigma * working.scale_factor ** features.octaves.astype(np.float64)
    working.keyframes.append(keyframe)
    new = len(working.keyframes) - 1
    earlier = list(range(max(0, new - options.reach), new))
    _find_known(working, new, earlier, options)
    # Nearest first: what looks most alike is matched best, and the rest is left to wider baselines.
    for other in reversed(earlier):
        _begin_landmarks(working, other, new, options)


def _find_known(working: WorkingMap, new: int, earlier: list[int], options: PosedWalkOptions) -> None:
    """Let a picture see the landmarks of earlier ones, each where its pose predicts it."""
    keyframe, camera = working.keyframes[new], working.camera
    ids = working.seen_by(earlier)
    points = keyframe.camera_from_world @ working.position[ids]
    front = points[:, 2] > 1e-9
    ids, points = ids[front], points[front]
    pixels = camera.project(points)
    inside = ((pixels > 0) & (pixels < (camera.width, camera.height))).all(axis=1)
    ids, points, pixels = ids[inside], points[inside], pixels[inside]
    octave = working.predicted_octave(ids, np.linalg.norm(points, axis=1))
    matches = match_predicted(
        pixels,
        working.descriptor[ids],
        keyframe.features.pixels,
        keyframe.features.descriptors,
        radius=options.radius * working.scale_factor ** np.clip(octave, 0, 4).astype(np.float64),
        max_distance=options.max_distance,
        ratio=options.ratio,
        predicted_octaves=octave,
        octaves=keyframe.features.octaves,
    )
    working.observe(new, matches.b, ids[matches.a])
    working.refresh(new)


def _begin_landmarks(working: WorkingMap, other: int, new: int, options: PosedWalkOptions) -> None:
    """New landmarks of what two pictures see and no landmark explains."""
    a, b = working.keyframes[other], working.keyframes[new]
    free_a, free_b = np.flatnonzero(a.landmark < 0), np.flatnonzero(b.landmark < 0)
    rows, columns = _pairs_that_may_meet(working.camera, a, b, free_a, free_b, options)
    distance = hamming(a.features.descriptors[free_a], b.features.descriptors[free_b], rows, columns)
    pairs = best_pairs(rows, columns, distance, max_distance=options.max_distance, ratio=options.ratio)
    if len(pairs) == 0:
        return
    feature_a, feature_b = free_a[pairs.a], free_b[pairs.b]
    points = triangulate(
        a.camera_from_world,
        b.camera_from_world,
        working.camera.normalize(a.features.pixels[feature_a]),
        working.camera.normalize(b.features.pixels[feature_b]),
    )
    good = parallax(a.centre, b.centre, points) > options.min_parallax
    for keyframe, feature in ((a, feature_a), (b, feature_b)):
        good &= _errors(working.camera, keyframe, points, feature) < options.gate
    ids = working.add_landmarks(points[good], new, feature_b[good])
    working.observe(other, feature_a[good], ids)
    working.observe(new, feature_b[good], ids)


def _pairs_that_may_meet(
    camera: Camera, a: Keyframe, b: Keyframe, feature_a: Ids, feature_b: Ids, options: PosedWalkOptions
) -> tuple[Ids, Ids]:
    """Rows of ``feature_a`` and ``feature_b`` where b's lies on the epipolar line of a's, at a like size."""
    b_from_a = b.camera_from_world @ a.camera_from_world.inverse()
    rays_a, rays_b = (
        np.column_stack([camera.normalize(kf.features.pixels[rows]), np.ones(len(rows))])
        for kf, rows in ((a, feature_a), (b, feature_b))
    )
    lines = rays_a @ (skew(b_from_a.translation) @ b_from_a.rotation).T
    lines /= np.maximum(np.linalg.norm(lines[:, :2], axis=1, keepdims=True), 1e-12)
    off_line = camera.focal[0] * np.abs(lines @ rays_b.T)
    levels = np.abs(np.subtract.outer(a.features.octaves[feature_a], b.features.octaves[feature_b]))
    rows, columns = np.nonzero((off_line < np.sqrt(options.gate) * b.sigma[feature_b]) & (levels <= 2))
    return rows, columns


def _errors(camera: Camera, keyframe: Keyframe, points: Array, feature: Ids) -> Array:
    """(N,) squared normalised reprojection errors of points (N, 3) at features; inf behind the camera."""
    front = depths(keyframe.camera_from_world, points) > 1e-9
    error = np.full(len(points), np.inf)
    offset = (
        camera.project(keyframe.camera_from_world @ points[front]) - keyframe.features.pixels[feature[front]]
    )
    error[front] = ((offset / keyframe.sigma[feature[front], None]) ** 2).sum(axis=1)
    return error


def _merge_revisits(working: WorkingMap, options: PosedWalkOptions) -> None:
    """Let what the walk shows twice be one landmark, where the poses agree that it is."""
    for revisit in find_revisits(working, list(range(len(working.keyframes))), working, options.revisits):
        if _agrees(revisit, working, options):
            working.merge(revisit.later, revisit.earlier)


def _agrees(revisit: Revisit, working: WorkingMap, options: PosedWalkOptions) -> bool:
    centre = working.keyframes[revisit.keyframe].centre
    shift = float(np.linalg.norm(revisit.earlier_from_later @ centre - centre))
    angle = rotation_angle(revisit.earlier_from_later.rotation)
    return angle <= options.revisit_angle and shift <= options.revisit_shift * revisit.depth


def settle_landmarks(working: WorkingMap, gate: float, rounds: int = 2) -> None:
    """Adjust all landmarks to what sees them, the pictures staying in place, and drop what does not fit.

    Args:
        gate: squared normalised error beyond which an observation is dropped.
    """
    keyframes = working.keyframes
    for _ in range(rounds):
        landmarks = working.seen_by(list(range(len(keyframes))))
        if len(landmarks) == 0:
            return
        row_of = np.full(len(working), -1, np.intp)
        row_of[landmarks] = np.arange(len(landmarks))
        seen = [kf.matched for kf in keyframes]
        problem = BundleProblem(
            rotations=np.stack([kf.camera_from_world.rotation for kf in keyframes]),
            translations=np.stack([kf.camera_from_world.translation for kf in keyframes]),
            free=np.zeros(len(keyframes), np.bool_),
            points=working.position[landmarks],
            camera_index=np.repeat(np.arange(len(keyframes)), [len(s) for s in seen]),
            point_index=np.concatenate(
                [row_of[kf.landmark[s]] for kf, s in zip(keyframes, seen, strict=True)]
            ),
            pixels=np.concatenate([kf.features.pixels[s] for kf, s in zip(keyframes, seen, strict=True)]),
            sigmas=np.concatenate([kf.sigma[s] for kf, s in zip(keyframes, seen, strict=True)]),
            camera=working.camera,
        )
        solution = adjust(problem)
        working.position[landmarks] = solution.points
        for k, features in enumerate(seen):
            outliers = features[solution.squared_errors[problem.camera_index == k] > gate]
            working.forget(k, outliers)
