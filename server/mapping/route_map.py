"""The route map: everything a follower needs of a leader's walk, immutable.

Frames: *world* is the map's own frame, z up as far as it is known. The unit of length is
arbitrary unless :attr:`RouteMap.scale` says how many metres it is.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from server.geometry.cameras import Camera
from server.geometry.poses import SE3, rotation_from_quaternion


class ScaleSource(StrEnum):
    """What fixed a map's unit of length. A length is told in metres only if something did."""

    UNKNOWN = "unknown"
    MEASURED_LENGTH = "measured_length"


@dataclass(frozen=True, slots=True)
class Scale:
    """Metres per map unit, or None while nothing metric has fixed it."""

    metres_per_unit: float | None = None
    source: ScaleSource = ScaleSource.UNKNOWN

    def metres(self, length: float) -> float | None:
        """A map length in metres, or None if the scale is unknown."""
        return None if self.metres_per_unit is None else length * self.metres_per_unit


@dataclass(frozen=True, eq=False, slots=True)
class Keyframes:
    """K keyframes in the order of the walk.

    Attributes:
        frame: (K,) int32, index into the path's frames.
        quaternion: (K, 4) world_from_camera, order x, y, z, w.
        position: (K, 3) camera centres in the world.
    """

    frame: NDArray[np.int32]
    quaternion: NDArray[np.float64]
    position: NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.frame)

    def world_from_camera(self, index: int) -> SE3:
        """Pose of one keyframe."""
        return SE3.from_quaternion(self.quaternion[index], self.position[index])


@dataclass(frozen=True, eq=False, slots=True)
class Landmarks:
    """P landmarks.

    Attributes:
        position: (P, 3) in the world.
        descriptor: (P, 32) uint8, the observed descriptor nearest to all others.
        normal: (P, 3) unit mean direction from the landmark to the cameras that saw it.
        distance: (P, 2) nearest and farthest distance at which the features' scale pyramid can see it.
        octave: (P,) int8, pyramid level at which the descriptor was taken.
    """

    position: NDArray[np.float64]
    descriptor: NDArray[np.uint8]
    normal: NDArray[np.float32]
    distance: NDArray[np.float32]
    octave: NDArray[np.int8]

    def __len__(self) -> int:
        return len(self.position)


@dataclass(frozen=True, eq=False, slots=True)
class Observations:
    """M observations of landmarks in keyframes, sorted by keyframe.

    Attributes:
        offsets: (K + 1,) int64; keyframe k owns rows ``offsets[k]:offsets[k + 1]``.
        landmark: (M,) int32.
        pixel: (M, 2) float32 in the rectified image.
        octave: (M,) int8 pyramid level.
        descriptor: (M, 32) uint8.
    """

    offsets: NDArray[np.int64]
    landmark: NDArray[np.int32]
    pixel: NDArray[np.float32]
    octave: NDArray[np.int8]
    descriptor: NDArray[np.uint8]

    def of_keyframe(self, index: int) -> slice:
        """Rows of one keyframe."""
        return slice(int(self.offsets[index]), int(self.offsets[index + 1]))


@dataclass(frozen=True, eq=False, slots=True)
class RoutePath:
    """The leader's walk, one entry a video frame at 10 fps.

    Attributes:
        time: (F,) seconds on the video's clock, increasing.
        quaternion: (F, 4) world_from_camera, order x, y, z, w.
        position: (F, 3).
        tracked: (F,) bool; False where the pose is interpolated between tracked neighbours.
        arc_length: (F,) length walked up to each frame along the path without the bobbing of the
            steps, map units, not decreasing.
    """

    time: NDArray[np.float64]
    quaternion: NDArray[np.float64]
    position: NDArray[np.float64]
    tracked: NDArray[np.bool_]
    arc_length: NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.time)


@dataclass(frozen=True, slots=True)
class Turn:
    """A turn of the walked path.

    Attributes:
        start, end: arc length along the path where it begins and ends, map units.
        angle: radians, positive to the left.
    """

    start: float
    end: float
    angle: float


@dataclass(frozen=True, eq=False)
class RouteMap:
    """An immutable route map; see the module's text for its frame and unit.

    Attributes:
        camera: the pinhole camera of the leader's rectified images.
        turns: in the order of the walk.
    """

    camera: Camera
    keyframes: Keyframes
    landmarks: Landmarks
    observations: Observations
    path: RoutePath
    turns: tuple[Turn, ...]
    scale: Scale

    @cached_property
    def keyframe_rotations(self) -> NDArray[np.float64]:
        """(K, 3, 3) world_from_camera rotations."""
        return rotation_from_quaternion(self.keyframes.quaternion)
