"""Verified revisits: places of the walk that the leader saw before, and how the map drifted between.

A look-alike must never be merged: one would fold the route. So a revisit needs a pose with many
inliers all over the image, and several keyframes in a row that tell the same story.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from server.features.matching import match_descriptors, match_predicted
from server.features.retrieval import PlaceIndex
from server.geometry.absolute_pose import ransac_pose, refine_pose
from server.geometry.cameras import occupied_cells
from server.geometry.poses import SE3, Sim3, rotation_angle
from server.mapping.working_map import Keyframe, WorkingMap

Array = NDArray[np.float64]
Ids = NDArray[np.intp]


@dataclass(frozen=True, slots=True)
class RevisitOptions:
    """Settings of :func:`find_revisits`.

    Attributes:
        min_gap: keyframes closer than this many frames are neighbours, no revisit.
        candidates: places tried for a keyframe; reach: keyframes around one that are taken together.
        min_inliers, min_cells: what the pose of one keyframe must rest on, as in relocalization.
        min_run: keyframes in a row that must agree; max_step: how many may lie between them.
        max_turn: how far odometry can have turned by mistake since the place was left, radians; max_stray:
            how far it can have strayed, as a share of the path walked since, beside half the depth of the
            scene. A flight of stairs like the one below is beyond both.
        scale_agreement: natural logarithm; angle_agreement: radians; shift_agreement: as a share of
            the depth of the scene.
    """

    min_gap: int = 50
    candidates: int = 3
    reach: int = 4
    min_inliers: int = 45
    min_cells: int = 10
    min_run: int = 3
    max_step: int = 3
    max_turn: float = math.radians(40.0)
    max_stray: float = 0.35
    scale_agreement: float = math.log(1.25)
    angle_agreement: float = math.radians(6.0)
    shift_agreement: float = 0.25


@dataclass(frozen=True, eq=False, slots=True)
class Revisit:
    """A keyframe seen in an earlier part of the walk.

    Attributes:
        keyframe: of the later part; place: the keyframe of the earlier part it was found near.
        earlier_from_later: similarity between the two parts of the map.
        later, earlier: (N,) landmarks that are the same point of the world.
        depth: median distance of these points, in units of the earlier part.
    """

    keyframe: int
    place: int
    earlier_from_later: Sim3
    later: Ids
    earlier: Ids
    depth: float


def find_revisits(
    later: WorkingMap,
    keyframes: list[int],
    earlier: WorkingMap,
    options: RevisitOptions | None = None,
) -> list[Revisit]:
    """Revisits among ``keyframes`` of one map in another one, or in its own older part.

    Only runs of keyframes that agree with one another are returned.
    """
    options = options or RevisitOptions()
    index = _place_index(earlier)
    found: list[Revisit] = []
    for k in keyframes:
        limit = len(earlier.keyframes)
        if later is earlier:
            limit = sum(kf.frame <= later.keyframes[k].frame - options.min_gap for kf in earlier.keyframes)
        revisit = _revisit(later, k, earlier, index, limit, options)
        if revisit is not None and (later is not earlier or _possible(revisit, later, options)):
            found.append(revisit)
    return _agreeing(found, later, options)


def _possible(revisit: Revisit, working: WorkingMap, options: RevisitOptions) -> bool:
    """Whether odometry can have drifted as far as a revisit of its own map says."""
    centres = np.stack([kf.centre for kf in working.keyframes[revisit.place : revisit.keyframe + 1]])
    walked = float(np.linalg.norm(np.diff(centres, axis=0), axis=1).sum())
    stray = float(np.linalg.norm(revisit.earlier_from_later @ centres[-1] - centres[-1]))
    return (
        rotation_angle(revisit.earlier_from_later.rotation) <= options.max_turn
        and stray <= options.max_stray * walked + 0.5 * revisit.depth
    )


def _place_index(working: WorkingMap) -> PlaceIndex:
    seen = [kf.landmark[kf.matched] for kf in working.keyframes]
    offsets = np.concatenate([[0], np.cumsum([len(s) for s in seen])]).astype(np.int64)
    return PlaceIndex(working.descriptor, offsets, np.concatenate(seen).astype(np.int32))


def _revisit(
    later: WorkingMap, k: int, earlier: WorkingMap, index: PlaceIndex, limit: int, options: RevisitOptions
) -> Revisit | None:
    keyframe = later.keyframes[k]
    places = index.query(keyframe.features.descriptors, options.candidates, limit=limit)
    best: Revisit | None = None
    for place in places:
        revisit = _verify(later, k, earlier, place.keyframe, limit, options)
        if revisit is not None and (best is None or len(revisit.later) > len(best.later)):
            best = revisit
    return best


def _verify(
    later: WorkingMap, k: int, earlier: WorkingMap, place: int, limit: int, options: RevisitOptions
) -> Revisit | None:
    """Locate a keyframe among the landmarks around a place; None unless the evidence is strong."""
    keyframe = later.keyframes[k]
    around = range(max(0, place - options.reach), min(limit, place + options.reach + 1))
    local = earlier.seen_by(list(around))
    features = keyframe.features
    pairs = match_descriptors(features.descriptors, earlier.descriptor[local], max_distance=60, ratio=0.85)
    if len(pairs) < 15:
        return None
    hypothesis = ransac_pose(
        earlier.position[local[pairs.b]], features.pixels[pairs.a], earlier.camera, max_error=4.0
    )
    if hypothesis is None or hypothesis[1].sum() < 15:
        return None
    located = _guided(keyframe, earlier, local, hypothesis[0])
    if located is None:
        return None
    pose, landmark, feature = located
    cells = occupied_cells(features.pixels[feature], earlier.camera)
    if len(feature) < options.min_inliers or cells < options.min_cells:
        return None
    both = keyframe.landmark[feature] >= 0
    ids = keyframe.landmark[feature[both]]
    if len(ids) < 15:
        return None
    depth_there = np.linalg.norm((pose @ earlier.position[landmark[both]]), axis=1)
    depth_here = np.linalg.norm(keyframe.camera_from_world @ later.position[ids], axis=1)
    ratio = np.log(depth_there / depth_here)
    scale = float(np.exp(np.median(ratio)))
    same = np.abs(ratio - np.median(ratio)) < 0.15
    if same.sum() < 15:
        return None
    world_from_camera = pose.inverse()
    rotation = world_from_camera.rotation @ keyframe.camera_from_world.rotation
    similarity = Sim3(scale, rotation, world_from_camera.translation - scale * rotation @ keyframe.centre)
    return Revisit(
        keyframe=k,
        place=place,
        earlier_from_later=similarity,
        later=ids[same],
        earlier=landmark[both][same],
        depth=float(np.median(depth_there[same])),
    )


def _guided(keyframe: Keyframe, earlier: WorkingMap, local: Ids, pose: SE3) -> tuple[SE3, Ids, Ids] | None:
    """Pose, landmarks and features after matching all that the pose predicts."""
    features = keyframe.features
    found: tuple[SE3, Ids, Ids] | None = None
    for _ in range(2):
        points = pose @ earlier.position[local]
        front = points[:, 2] > 1e-3
        ids, points = local[front], points[front]
        octave = earlier.predicted_octave(ids, np.linalg.norm(points, axis=1))
        matches = match_predicted(
            earlier.camera.project(points),
            earlier.descriptor[ids],
            features.pixels,
            features.descriptors,
            radius=6.0 * earlier.scale_factor ** np.clip(octave, 0, 4).astype(np.float64),
            max_distance=60,
            ratio=0.9,
            predicted_octaves=octave,
            octaves=features.octaves,
            octave_slack=2,
        )
        if len(matches) < 15:
            return None
        landmark = ids[matches.a]
        estimate = refine_pose(
            pose,
            earlier.position[landmark],
            features.pixels[matches.b],
            earlier.scale_factor ** features.octaves[matches.b].astype(np.float64),
            earlier.camera,
            anneal=(2.0, 1.0),
        )
        if estimate is None:
            return None
        pose = estimate.camera_from_world
        found = pose, landmark[estimate.inliers], matches.b[estimate.inliers]
    return found


def _agreeing(found: list[Revisit], later: WorkingMap, options: RevisitOptions) -> list[Revisit]:
    """Members of runs of at least ``min_run`` revisits in which each agrees with the one before."""
    runs: list[list[Revisit]] = []
    for revisit in found:
        if runs and _agree(runs[-1][-1], revisit, later, options):
            runs[-1].append(revisit)
        else:
            runs.append([revisit])
    return [revisit for run in runs if len(run) >= options.min_run for revisit in run]


def _agree(a: Revisit, b: Revisit, later: WorkingMap, options: RevisitOptions) -> bool:
    if b.keyframe - a.keyframe > options.max_step:
        return False
    scale = abs(math.log(a.earlier_from_later.scale / b.earlier_from_later.scale))
    angle = rotation_angle(a.earlier_from_later.rotation.T @ b.earlier_from_later.rotation)
    centre = later.keyframes[b.keyframe].centre
    shift = np.linalg.norm(a.earlier_from_later @ centre - b.earlier_from_later @ centre)
    return bool(
        scale < options.scale_agreement
        and angle < options.angle_agreement
        and shift < options.shift_agreement * b.depth
    )
