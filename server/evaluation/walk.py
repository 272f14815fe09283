"""Walk folders: a video, its camera, and the truth it is judged by.

A folder holds ``video.mp4``, ``camera.json``, ``groundtruth.txt`` (TUM: ``t tx ty tz qx qy qz qw``,
world_from_camera, one line a video frame) and ``meta.json``.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from server.geometry.cameras import Camera, InvalidCameraError
from server.geometry.poses import rotation_from_quaternion

Array = NDArray[np.float64]

SMOOTHING_FRAMES = 5
"""Frames over which positions are averaged before a path is measured: the steps' bobbing is no progress."""


class WalkError(ValueError):
    """A walk folder that cannot be judged; the message names the file and what is wrong with it."""


@dataclass(frozen=True, eq=False, slots=True)
class Trajectory:
    """Camera poses in time.

    Attributes:
        time: (N,) seconds, increasing.
        rotation: (N, 3, 3) world_from_camera.
        position: (N, 3) camera centres in the world, metres.
    """

    time: Array
    rotation: Array
    position: Array

    def __len__(self) -> int:
        return len(self.time)

    def __getitem__(self, rows: slice | NDArray[Any]) -> Trajectory:
        """The poses of some rows, in their order."""
        return Trajectory(self.time[rows], self.rotation[rows], self.position[rows])

    def nearest(self, times: ArrayLike) -> NDArray[np.int64]:
        """Rows nearest in time to ``times`` (M,)."""
        wanted = np.asarray(times, dtype=np.float64)
        after = np.clip(np.searchsorted(self.time, wanted), 1, max(1, len(self.time) - 1))
        if len(self.time) == 1:
            return np.zeros(wanted.shape, dtype=np.int64)
        before = after - 1
        earlier = wanted - self.time[before] <= self.time[after] - wanted
        return np.where(earlier, before, after).astype(np.int64)


def arc_length(positions: Array, *, smoothing: int = SMOOTHING_FRAMES) -> Array:
    """Length walked up to each of the positions (N, 3) -> (N,), after a moving average against bobbing."""
    half = min(smoothing // 2, (len(positions) - 1) // 2)
    # Mirrored through its ends, so that the average neither moves nor shortens them.
    padded = np.pad(positions, ((half, half), (0, 0)), mode="reflect", reflect_type="odd")
    kernel = np.full(2 * half + 1, 1.0 / (2 * half + 1))
    smooth = np.stack([np.convolve(padded[:, axis], kernel, mode="valid") for axis in range(3)], axis=1)
    steps = np.linalg.norm(np.diff(smooth, axis=0), axis=1)
    return np.concatenate([[0.0], np.cumsum(steps)])


@dataclass(frozen=True, eq=False)
class Walk:
    """A recorded walk.

    Attributes:
        folder: where it lies; its last component is the walk's name.
        camera: None if nobody knows it.
        truth: one row a frame of the video.
        world: the building's name; walks of another world share no place with it.
        real: recorded, not rendered; then the truth may be of another, rigidly mounted camera.
        off_route: first and last video frame (inclusive) away from the leader's route, or None.
        meta: the rest of ``meta.json``.
    """

    folder: Path
    camera: Camera | None
    truth: Trajectory
    world: str
    real: bool = False
    off_route: tuple[int, int] | None = None
    meta: dict[str, Any] = field(default_factory=dict, repr=False)

    @property
    def name(self) -> str:
        """The folder's own name."""
        return self.folder.name

    @property
    def video(self) -> Path:
        """The walk's video."""
        return self.folder / "video.mp4"

    def on_route(self, frames: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Which of the video frames (M,) lie on the leader's route by the recording's own account."""
        if self.off_route is None:
            return np.ones(len(frames), dtype=np.bool_)
        first, last = self.off_route
        return np.asarray((frames < first) | (frames > last), dtype=np.bool_)


def read_trajectory(path: Path) -> Trajectory:
    """Read a TUM trajectory; lines that start with ``#`` are comments.

    Raises:
        WalkError: the file is missing, a line has not eight numbers, or time does not increase.
    """
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except OSError as error:
        raise WalkError(f"{path}: {error.strerror}") from error
    rows: list[list[float]] = []
    for number, line in enumerate(lines, start=1):
        text = line.split("#", 1)[0].split()
        if not text:
            continue
        try:
            row = [float(value) for value in text]
        except ValueError:
            row = []
        if len(row) != 8 or not np.isfinite(row).all():
            raise WalkError(f"{path}:{number}: expected eight numbers: t tx ty tz qx qy qz qw")
        rows.append(row)
    if not rows:
        raise WalkError(f"{path}: no poses")
    table = np.asarray(rows)
    if (np.diff(table[:, 0]) <= 0).any():
        raise WalkError(f"{path}: time does not increase")
    if (np.linalg.norm(table[:, 4:], axis=1) < 1e-6).any():
        raise WalkError(f"{path}: a quaternion is zero")
    return Trajectory(table[:, 0], rotation_from_quaternion(table[:, 4:]), table[:, 1:4])


def _read_json(path: Path) -> dict[str, Any]:
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise WalkError(f"{path}: {error.strerror}") from error
    except ValueError as error:
        raise WalkError(f"{path}: not JSON: {error}") from error
    if not isinstance(document, dict):
        raise WalkError(f"{path}: expected a JSON object")
    return document


def read_walk(folder: Path) -> Walk:
    """Read a walk folder, all but its pictures.

    Raises:
        WalkError: a file is missing or not understood.
    """
    folder = folder.resolve()
    if not folder.is_dir():
        raise WalkError(f"{folder}: no such folder")
    if not (folder / "video.mp4").is_file():
        raise WalkError(f"{folder / 'video.mp4'}: missing")
    camera = None
    if (folder / "camera.json").exists():
        try:
            camera = Camera.from_json(_read_json(folder / "camera.json"))
        except InvalidCameraError as error:
            raise WalkError(f"{folder / 'camera.json'}: {error}") from error
    meta = _read_json(folder / "meta.json")
    interval = meta.get("off_route_frames")
    off_route = None
    if interval is not None:
        if not isinstance(interval, list) or len(interval) != 2:
            raise WalkError(f"{folder / 'meta.json'}: off_route_frames must be [first, last] or null")
        off_route = (int(interval[0]), int(interval[1]))
    return Walk(
        folder=folder,
        camera=camera,
        truth=read_trajectory(folder / "groundtruth.txt"),
        world=str(meta.get("world", folder.parent.name)),
        real=bool(meta.get("real", False)),
        off_route=off_route,
        meta=meta,
    )
