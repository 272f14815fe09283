"""Working maps of imagined walks: points of a world, who sees them, and how the estimate drifts."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from client_sim.synthetic.cameras import Pose
from server.features.extraction import Features
from server.geometry.cameras import Camera
from server.geometry.poses import SE3, Sim3
from server.mapping.working_map import NO_LANDMARK, Keyframe, WorkingMap

Array = NDArray[np.float64]
CAMERA = Camera.pinhole(640, 480, 500.0, 500.0, 320.0, 240.0)
SCALE_FACTOR = 1.2
FRAMES_A_KEYFRAME = 5


def looks(count: int, rng: np.random.Generator) -> NDArray[np.uint8]:
    """Descriptors of so many different points, (count, 32)."""
    return rng.integers(0, 256, (count, 32), np.uint8)


def _seen_as(look: NDArray[np.uint8], rng: np.random.Generator) -> NDArray[np.uint8]:
    """A look with about 15 of its 256 bits wrong."""
    flips = np.packbits(rng.random((len(look), 256)) < 0.06, axis=1)
    return np.asarray(look ^ flips)


def walked_map(
    poses: Sequence[Pose],
    points: Array,
    descriptors: NDArray[np.uint8],
    drift: Callable[[int], Sim3],
    rng: np.random.Generator,
    *,
    most: int = 160,
    reach: float = 7.0,
    first_frame: int = 0,
    gone: int = 4,
) -> WorkingMap:
    """The map an odometry makes: a point not seen for ``gone`` keyframes gets a new landmark when it is back.

    Args:
        points: (N, 3) of the world; descriptors: (N, 32) their looks.
        drift: ``map_from_world`` around each keyframe; points lie where the keyframe that made them says.
    """
    working = WorkingMap(CAMERA, SCALE_FACTOR)
    views = [_view(pose, points, rng, most, reach) for pose in poses]
    for k, pose in enumerate(poses):
        visible, pixels, depth = views[k]
        octaves = np.clip(np.round(np.log(6.0 / depth) / np.log(SCALE_FACTOR)), 0, 7).astype(np.int8)
        features = Features(
            pixels,
            _seen_as(descriptors[visible], rng),
            octaves,
            np.zeros(len(visible), np.float32),
        )
        camera = drift(k).transform_pose(SE3(pose.rotation, pose.position))
        working.keyframes.append(
            Keyframe(
                first_frame + FRAMES_A_KEYFRAME * k,
                features,
                camera.inverse(),
                SCALE_FACTOR ** octaves.astype(np.float64),
                np.arange(len(visible)),
                np.full(len(visible), NO_LANDMARK),
            )
        )
    landmark = np.full(len(points), -1)
    last = np.full(len(points), -1000)
    for k, (visible, _, _) in enumerate(views):
        new = last[visible] < k - gone
        fresh = visible[new]
        landmark[fresh] = working.add_landmarks(drift(k) @ points[fresh], k, np.flatnonzero(new))
        working.observe(k, np.arange(len(visible)), landmark[visible])
        last[visible] = k
    working.recount()
    return working


def _view(
    pose: Pose, points: Array, rng: np.random.Generator, most: int, reach: float
) -> tuple[NDArray[np.intp], Array, Array]:
    local = pose.to_camera(points)
    near = np.flatnonzero((local[:, 2] > 0.5) & (local[:, 2] < reach))
    pixels = CAMERA.project(local[near])
    inside = ((pixels > 4) & (pixels < [636, 476])).all(axis=1)
    # The same points from frame to frame, as far as they are in sight.
    near, pixels = near[inside][:most], pixels[inside][:most]
    noisy = pixels + rng.normal(scale=0.5, size=pixels.shape)
    return near, noisy, np.linalg.norm(local[near], axis=1)


def no_drift(_: int) -> Sim3:
    """The estimate is the truth."""
    return Sim3.identity()
