"""Writing walk folders: video, camera, truth and description of a synthetic walk."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from client_sim.synthetic.rendering import Light, Renderer
from client_sim.synthetic.trajectories import Trajectory


def write_walk(
    folder: Path,
    renderer: Renderer,
    trajectory: Trajectory,
    rng: np.random.Generator,
    *,
    light: Light | None = None,
    meta: dict[str, Any] | None = None,
    on_progress: Callable[[float], None] | None = None,
) -> None:
    """Film a trajectory and write ``video.mp4``, ``camera.json``, ``groundtruth.txt``, ``meta.json``.

    Args:
        folder: created if it is not there.
        rng: draws the sensor noise.
        meta: keys added to ``meta.json``.
        on_progress: gets the fraction done, 0 to 1.

    Raises:
        OSError: the video cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    camera = renderer.camera
    _write_video(folder / "video.mp4", renderer, trajectory, rng, light or Light(), on_progress)
    (folder / "camera.json").write_text(json.dumps(camera.to_json(trajectory.fps)) + "\n", encoding="utf-8")
    lines = ["# t tx ty tz qx qy qz qw (world_from_camera; x right, y down, z forward)"]
    for time, pose in zip(trajectory.times, trajectory.poses, strict=True):
        quaternion = Rotation.from_matrix(pose.rotation).as_quat()
        lines.append(f"{time:.4f} " + " ".join(f"{value:.7f}" for value in (*pose.position, *quaternion)))
    (folder / "groundtruth.txt").write_text("\n".join(lines) + "\n", encoding="utf-8")
    document = {
        "world": renderer.world.name,
        "sequence": folder.name,
        "real": False,
        "frames": len(trajectory),
        "fps": trajectory.fps,
        "duration_s": round(len(trajectory) / trajectory.fps, 3),
        "path_length_m": round(trajectory.length, 3),
        "off_route_frames": None,
        **(meta or {}),
    }
    (folder / "meta.json").write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")


def _write_video(
    path: Path,
    renderer: Renderer,
    trajectory: Trajectory,
    rng: np.random.Generator,
    light: Light,
    on_progress: Callable[[float], None] | None,
) -> None:
    camera = renderer.camera
    writer = cv2.VideoWriter(
        str(path), cv2.VideoWriter.fourcc(*"mp4v"), trajectory.fps, (camera.width, camera.height)
    )
    if not writer.isOpened():
        raise OSError(f"{path}: cannot be written as video")
    try:
        for row, pose in enumerate(trajectory.poses):
            writer.write(renderer.render(pose, light, rng))
            if on_progress is not None:
                on_progress((row + 1) / len(trajectory))
    finally:
        writer.release()
