"""The growing map of a visual odometry: keyframes, landmarks and who sees what."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from server.features.extraction import Features
from server.features.tracking import TrackedFeatures
from server.geometry.absolute_pose import projection_jacobian
from server.geometry.cameras import Camera
from server.geometry.poses import SE3, Sim3
from server.mapping.bundle_adjustment import BundleProblem, adjust

Array = NDArray[np.float64]
Ids = NDArray[np.intp]

NO_LANDMARK = -1


@dataclass(eq=False, slots=True)
class Keyframe:
    """A frame kept in the map.

    Attributes:
        frame: index of the frame in the walk.
        camera_from_world: its pose.
        sigma: (N,) standard deviation of a pixel coordinate.
        track: (N,) identity of the track each feature belongs to.
        landmark: (N,) landmark seen by each feature, or NO_LANDMARK.
    """

    frame: int
    features: Features
    camera_from_world: SE3
    sigma: Array
    track: Ids
    landmark: Ids

    @staticmethod
    def of(frame: int, features: TrackedFeatures, camera_from_world: SE3, sigma: float) -> Keyframe:
        """A keyframe that sees no landmark yet, all its pixels equally exact."""
        count = len(features)
        return Keyframe(
            frame=frame,
            features=features.features,
            camera_from_world=camera_from_world,
            sigma=np.full(count, sigma),
            track=features.track,
            landmark=np.full(count, NO_LANDMARK),
        )

    @property
    def centre(self) -> Array:
        """(3,) camera centre in the world."""
        return self.camera_from_world.inverse().translation

    @property
    def matched(self) -> Ids:
        """Indices of the features that see a landmark."""
        return np.flatnonzero(self.landmark >= 0)


class WorkingMap:
    """A mutable map; one odometry owns it.

    Attributes:
        keyframes: in the order of the walk.
        position: (P, 3); descriptor: (P, 32); octave: (P,); observed: (P,) number of keyframes that
            see the landmark; born: (P,) index of the keyframe that made it; alive: (P,).
    """

    def __init__(self, camera: Camera, scale_factor: float) -> None:
        self.camera = camera
        self.scale_factor = scale_factor
        self.keyframes: list[Keyframe] = []
        self.position: Array = np.zeros((0, 3))
        self.descriptor: NDArray[np.uint8] = np.zeros((0, 32), np.uint8)
        self.distance: Array = np.zeros(0)
        self.octave: NDArray[np.int8] = np.zeros(0, np.int8)
        self.observed: NDArray[np.int64] = np.zeros(0, np.int64)
        self.born: NDArray[np.int64] = np.zeros(0, np.int64)
        self.alive: NDArray[np.bool_] = np.zeros(0, np.bool_)
        self.covariance: Array = np.zeros((0, 3, 3))

    def __len__(self) -> int:
        return len(self.position)

    def add_landmarks(self, positions: Array, keyframe: int, feature: Ids) -> Ids:
        """New landmarks (N, 3) that look as the given features of a keyframe; returns their ids."""
        ids = np.arange(len(self), len(self) + len(positions))
        source = self.keyframes[keyframe]
        self.position = np.concatenate([self.position, positions])
        self.descriptor = np.concatenate([self.descriptor, source.features.descriptors[feature]])
        self.octave = np.concatenate([self.octave, source.features.octaves[feature]])
        self.distance = np.concatenate([self.distance, np.linalg.norm(positions - source.centre, axis=1)])
        self.observed = np.concatenate([self.observed, np.zeros(len(ids), np.int64)])
        self.born = np.concatenate([self.born, np.full(len(ids), keyframe)])
        self.alive = np.concatenate([self.alive, np.ones(len(ids), np.bool_)])
        self.covariance = np.concatenate([self.covariance, np.zeros((len(ids), 3, 3))])
        return ids

    def observe(self, keyframe: int, feature: Ids, landmark: Ids) -> None:
        """Record that features of a keyframe see landmarks; the look of a landmark is the latest one."""
        kf = self.keyframes[keyframe]
        kf.landmark[feature] = landmark
        np.add.at(self.observed, landmark, 1)

    def refresh(self, keyframe: int) -> None:
        """Take the look (descriptor, level, distance) of all its landmarks from a keyframe."""
        kf = self.keyframes[keyframe]
        seen = kf.matched
        ids = kf.landmark[seen]
        self.descriptor[ids] = kf.features.descriptors[seen]
        self.octave[ids] = kf.features.octaves[seen]
        self.distance[ids] = np.linalg.norm(self.position[ids] - kf.centre, axis=1)

    def forget(self, keyframe: int, feature: Ids) -> None:
        """Take back observations; a landmark seen by fewer than two keyframes dies."""
        kf = self.keyframes[keyframe]
        feature = feature[kf.landmark[feature] >= 0]
        ids = kf.landmark[feature]
        kf.landmark[feature] = NO_LANDMARK
        np.subtract.at(self.observed, ids, 1)
        self.kill(ids[self.observed[ids] < 2])

    def kill(self, landmarks: Ids) -> None:
        """Remove landmarks and all their observations."""
        if len(landmarks) == 0:
            return
        self.alive[landmarks] = False
        self.observed[landmarks] = 0
        for kf in self.keyframes:
            seen = kf.matched
            kf.landmark[seen[~self.alive[kf.landmark[seen]]]] = NO_LANDMARK

    def straighten(self, ideal: Camera) -> None:
        """Turn all pixels into those of an ideal pinhole camera, which becomes the map's camera."""
        for kf in self.keyframes:
            pixels = ideal.project_rays(self.camera.normalize(kf.features.pixels))
            kf.features = replace(kf.features, pixels=pixels)
        self.camera = ideal

    def absorb(self, other: WorkingMap, self_from_other: Sim3) -> int:
        """Take all of another map, mapped by a similarity; returns the offset of its landmarks' ids.

        Its keyframes must be of later frames.
        """
        offset, keyframes = len(self), len(self.keyframes)
        self.position = np.concatenate([self.position, self_from_other @ other.position])
        self.descriptor = np.concatenate([self.descriptor, other.descriptor])
        self.distance = np.concatenate([self.distance, self_from_other.scale * other.distance])
        self.octave = np.concatenate([self.octave, other.octave])
        self.observed = np.concatenate([self.observed, other.observed])
        self.born = np.concatenate([self.born, other.born + keyframes])
        self.alive = np.concatenate([self.alive, other.alive])
        turned = self_from_other.rotation @ other.covariance @ self_from_other.rotation.T
        self.covariance = np.concatenate([self.covariance, self_from_other.scale**2 * turned])
        for kf in other.keyframes:
            pose = self_from_other.transform_pose(kf.camera_from_world.inverse()).inverse()
            landmark = np.where(kf.landmark >= 0, kf.landmark + offset, NO_LANDMARK)
            self.keyframes.append(replace(kf, camera_from_world=pose, landmark=landmark))
        return offset

    def merge(self, old: Ids, new: Ids) -> None:
        """Let landmarks ``new`` (N,) take over the observations of ``old`` (N,).

        Where a keyframe saw both, the observation of ``new`` stays.
        """
        fresh = (old != new) & self.alive[old] & self.alive[new]
        target = np.arange(len(self))
        target[old[fresh]] = new[fresh]
        for kf in self.keyframes:
            seen = kf.matched
            ids = kf.landmark[seen]
            change = target[ids] != ids
            taken = change & np.isin(target[ids], ids[~change])
            kf.landmark[seen[taken]] = NO_LANDMARK
            move = change & ~taken
            _, first = np.unique(target[ids[move]], return_index=True)
            rows = seen[move]
            kf.landmark[rows] = NO_LANDMARK
            kf.landmark[rows[first]] = target[ids[move]][first]
        self.recount()

    def recount(self) -> None:
        """Count observations anew; what fewer than two keyframes see dies."""
        self.observed = np.zeros(len(self), np.int64)
        for kf in self.keyframes:
            np.add.at(self.observed, kf.landmark[kf.matched], 1)
        self.kill(np.flatnonzero(self.alive & (self.observed < 2)))

    def seen_by(self, keyframes: list[int]) -> Ids:
        """Ids of the living landmarks that any of the keyframes sees."""
        if not keyframes:
            return np.zeros(0, np.intp)
        parts = [self.keyframes[k].landmark[self.keyframes[k].matched] for k in keyframes]
        ids = np.unique(np.concatenate(parts))
        return np.asarray(ids[self.alive[ids]])

    def predicted_octave(self, landmarks: Ids, depth: Array) -> NDArray[np.int64]:
        """Pyramid level at which landmarks (N,) should appear at distances (N,)."""
        shift = np.log(self.distance[landmarks] / np.maximum(depth, 1e-9)) / np.log(self.scale_factor)
        return np.asarray(np.round(self.octave[landmarks] + shift), dtype=np.int64)

    def update_covariances(self, keyframes: list[int]) -> None:
        """Covariances of all landmarks the keyframes see, from these observations, poses taken as known.

        The prior is a point anywhere along its ray beyond a hundredth of its distance.
        """
        landmarks = self.seen_by(keyframes)
        row_of = np.full(len(self), -1, np.intp)
        row_of[landmarks] = np.arange(len(landmarks))
        information = np.zeros((len(landmarks), 3, 3))
        for k in keyframes:
            kf = self.keyframes[k]
            seen = kf.matched
            rows = row_of[kf.landmark[seen]]
            seen, rows = seen[rows >= 0], rows[rows >= 0]
            local = kf.camera_from_world @ self.position[landmarks[rows]]
            local[:, 2] = np.maximum(local[:, 2], 1e-6)
            _, jacobian = projection_jacobian(local, self.camera)
            jacobian = jacobian @ kf.camera_from_world.rotation
            jacobian /= kf.sigma[seen][:, None, None]
            information[rows] += np.einsum("nki,nkj->nij", jacobian, jacobian)
        weakest = 1e-4 / np.maximum(self.distance[landmarks], 1e-9) ** 2
        self.covariance[landmarks] = np.linalg.inv(information + weakest[:, None, None] * np.eye(3))

    def adjust_window(self, free: list[int], *, max_fixed: int = 12, iterations: int = 6) -> None:
        """Bundle-adjust the given keyframes and all they see; drop what does not fit.

        Other keyframes that see the same landmarks take part but stay in place; without any, the
        first two of the window do, which fixes the frame and the scale. Of a window of two the first does.
        """
        landmarks = self.seen_by(free)
        if len(landmarks) < 10:
            return
        used = np.zeros(len(self), np.bool_)
        used[landmarks] = True
        free_set = set(free)
        shared = {
            k: int(used[kf.landmark[kf.matched]].sum())
            for k, kf in enumerate(self.keyframes)
            if k not in free_set
        }
        fixed = sorted((k for k, n in shared.items() if n >= 5), key=lambda k: -shared[k])[:max_fixed]
        window = sorted(free_set | set(fixed))
        held = set(fixed)
        if len(held) < 2:
            # Two views alone: one stays free, or nothing would move; damping keeps the scale.
            held |= set(window[: min(2, len(window) - 1)])
        row_of = np.full(len(self), -1, np.intp)
        row_of[landmarks] = np.arange(len(landmarks))
        cameras, rows, pixels, sigmas, features = [], [], [], [], []
        for c, k in enumerate(window):
            kf = self.keyframes[k]
            seen = kf.matched
            seen = seen[row_of[kf.landmark[seen]] >= 0]
            cameras.append(np.full(len(seen), c))
            features.append(seen)
            rows.append(row_of[kf.landmark[seen]])
            pixels.append(kf.features.pixels[seen])
            sigmas.append(kf.sigma[seen])
        problem = BundleProblem(
            rotations=np.stack([self.keyframes[k].camera_from_world.rotation for k in window]),
            translations=np.stack([self.keyframes[k].camera_from_world.translation for k in window]),
            free=np.array([k not in held for k in window]),
            points=self.position[landmarks],
            camera_index=np.concatenate(cameras),
            point_index=np.concatenate(rows),
            pixels=np.concatenate(pixels),
            sigmas=np.concatenate(sigmas),
            camera=self.camera,
        )
        solution = adjust(problem, iterations=iterations)
        self.position[landmarks] = solution.points
        bad = solution.squared_errors > 9.0
        for c, k in enumerate(window):
            if k not in held:
                self.keyframes[k].camera_from_world = SE3(solution.rotations[c], solution.translations[c])
            outliers = features[c][bad[problem.camera_index == c]]
            if len(outliers):
                self.forget(k, outliers)
