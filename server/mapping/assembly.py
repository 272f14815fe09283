"""From a refined working map and the frames' tracks to an immutable route map."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from server.features.matching import hamming
from server.geometry.absolute_pose import ransac_pose, refine_pose
from server.geometry.poses import SE3, Sim3, quaternion_from_rotation
from server.mapping.front_end import WalkFrame
from server.mapping.route_map import (
    Keyframes,
    Landmarks,
    Observations,
    RouteMap,
    RoutePath,
    Scale,
    ScaleSource,
)
from server.mapping.trajectory import find_turns, route_frame, smoothed, walked
from server.mapping.working_map import WorkingMap

Array = NDArray[np.float64]


def locate_frames(
    working: WorkingMap, frames: list[WalkFrame], *, sigma: float, min_inliers: int
) -> list[SE3 | None]:
    """camera_from_world of every frame by its own 2D-3D inliers, None where there are too few.

    Every frame shares tracks with the keyframes around it, also those from before the map's start.

    Args:
        sigma: standard deviation of a followed feature's pixel coordinate.
    """
    poses: list[SE3 | None] = [None] * len(frames)
    at = np.array([kf.frame for kf in working.keyframes])
    # Outwards from the keyframes: a neighbour's pose is the best start.
    order = sorted(range(len(frames)), key=lambda f: int(np.abs(at - f).min()))
    for f in order:
        near = np.argsort(np.abs(at - f))[:3]
        landmark_of: dict[int, int] = {}
        for k in near[::-1]:
            kf = working.keyframes[k]
            seen = kf.matched
            landmark_of.update(zip(kf.track[seen].tolist(), kf.landmark[seen].tolist(), strict=True))
        tracks = frames[f].features.track.tolist()
        rows = [i for i, track in enumerate(tracks) if track in landmark_of]
        if len(rows) < min_inliers:
            continue
        points = working.position[[landmark_of[tracks[i]] for i in rows]]
        pixels = frames[f].features.features.pixels[rows]
        start = next((p for p in _neighbours(poses, f) if p is not None), None)
        start = start or working.keyframes[near[0]].camera_from_world
        sigmas = np.full(len(rows), sigma)
        estimate = refine_pose(
            start, points, pixels, sigmas, working.camera, anneal=(8.0, 2.0, 1.0), gate=9.0
        )
        if estimate is None or estimate.inliers.sum() < max(min_inliers, 0.3 * len(rows)):
            found = ransac_pose(points, pixels, working.camera, max_error=4.0 * sigma, initial=start)
            if found is None:
                continue
            estimate = refine_pose(found[0], points, pixels, sigmas, working.camera, gate=9.0)
        if estimate is not None and estimate.inliers.sum() >= min_inliers:
            poses[f] = estimate.camera_from_world
    return poses


def _neighbours(poses: list[SE3 | None], f: int) -> list[SE3 | None]:
    return [poses[g] for g in (f - 1, f + 1) if 0 <= g < len(poses)]


def assemble(
    working: WorkingMap,
    frames: list[WalkFrame],
    located: list[SE3 | None],
    *,
    levels: int,
    measured_length: float | None = None,
) -> RouteMap:
    """The route map of a walk.

    Args:
        located: camera_from_world of the frames; at least two are known.
        levels: pyramid levels of the feature extractor.
        measured_length: length of the walk in metres, if somebody measured it.
    """
    times = np.array([frame.time for frame in frames])
    tracked = np.array([pose is not None for pose in located])
    known = [pose.inverse() for pose in located if pose is not None]
    route_from_map = route_frame(known, times[tracked])
    known = [route_from_map.transform_pose(pose) for pose in known]
    quaternions, positions = _interpolated(known, times, tracked)
    arc_length = walked(positions, times)
    scale = Scale()
    if measured_length is not None and arc_length[-1] > 0:
        scale = Scale(measured_length / float(arc_length[-1]), ScaleSource.MEASURED_LENGTH)
    keyframes, landmarks, observations = _landmarks(working, route_from_map, levels)
    return RouteMap(
        camera=working.camera,
        keyframes=keyframes,
        landmarks=landmarks,
        observations=observations,
        path=RoutePath(times, quaternions, positions, tracked, arc_length),
        turns=find_turns(smoothed(positions, times), arc_length),
        scale=scale,
    )


def _interpolated(known: list[SE3], times: Array, tracked: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Poses of all frames; those not tracked lie between their tracked neighbours."""
    at = times[tracked]
    inside = np.clip(times, at[0], at[-1])
    slerp = Slerp(at, Rotation.from_matrix(np.stack([p.rotation for p in known])))
    centres = np.stack([p.translation for p in known])
    positions = np.stack([np.interp(inside, at, centres[:, axis]) for axis in range(3)], axis=1)
    return quaternion_from_rotation(slerp(inside).as_matrix()), positions


def _landmarks(
    working: WorkingMap, route_from_map: Sim3, levels: int
) -> tuple[Keyframes, Landmarks, Observations]:
    new_id = np.full(len(working), -1)
    alive = np.flatnonzero(working.alive & (working.observed > 0))
    new_id[alive] = np.arange(len(alive))
    positions = route_from_map @ working.position[alive]
    poses = [route_from_map.transform_pose(kf.camera_from_world.inverse()) for kf in working.keyframes]
    centres = np.stack([p.translation for p in poses])

    rows = [kf.matched for kf in working.keyframes]
    counts = np.array([len(r) for r in rows])
    keyframe_of = np.repeat(np.arange(len(rows)), counts)
    parts = list(zip(working.keyframes, rows, strict=True))
    landmark = new_id[np.concatenate([kf.landmark[r] for kf, r in parts])]
    pixel = np.concatenate([kf.features.pixels[r] for kf, r in parts])
    octave = np.concatenate([kf.features.octaves[r] for kf, r in parts])
    descriptor = np.concatenate([kf.features.descriptors[r] for kf, r in parts])

    to_camera = centres[keyframe_of] - positions[landmark]
    distance = np.linalg.norm(to_camera, axis=1)
    normal = np.zeros((len(alive), 3))
    np.add.at(normal, landmark, to_camera / np.maximum(distance, 1e-12)[:, None])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    # Seen at octave o from distance d, a feature is one of octave 0 from d * s^o.
    factor = working.scale_factor ** octave.astype(np.float64)
    farthest = np.zeros(len(alive))
    np.maximum.at(farthest, landmark, distance * factor)
    nearest = farthest / working.scale_factor ** (levels - 1)
    chosen = _most_central(descriptor, landmark, len(alive))
    keyframes = Keyframes(
        frame=np.array([kf.frame for kf in working.keyframes], dtype=np.int32),
        quaternion=quaternion_from_rotation(np.stack([p.rotation for p in poses])),
        position=centres,
    )
    landmarks = Landmarks(
        position=positions,
        descriptor=descriptor[chosen],
        normal=normal.astype(np.float32),
        distance=np.stack([nearest, farthest], axis=1).astype(np.float32),
        octave=octave[chosen],
    )
    observations = Observations(
        offsets=np.concatenate([[0], np.cumsum(counts)]).astype(np.int64),
        landmark=landmark.astype(np.int32),
        pixel=pixel.astype(np.float32),
        octave=octave,
        descriptor=descriptor,
    )
    return keyframes, landmarks, observations


def _most_central(descriptor: NDArray[np.uint8], landmark: NDArray[np.int64], count: int) -> NDArray[np.intp]:
    """For each landmark the observation (M) whose descriptor is nearest to the bitwise majority."""
    bits = np.unpackbits(descriptor, axis=1).astype(np.int32)
    total = np.zeros((count, bits.shape[1]), np.int32)
    np.add.at(total, landmark, bits)
    seen = np.bincount(landmark, minlength=count)
    majority = np.packbits(2 * total > seen[:, None], axis=1)
    distance = hamming(descriptor, majority, np.arange(len(descriptor)), landmark.astype(np.intp))
    order = np.lexsort((distance, landmark))
    first = np.concatenate([[True], landmark[order][1:] != landmark[order][:-1]])
    return np.asarray(order[first], dtype=np.intp)
