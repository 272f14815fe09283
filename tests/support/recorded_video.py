"""Small videos for tests, written on the spot."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np


def write_video(path: Path, frames: int, fps: int, size: tuple[int, int] = (64, 48)) -> None:
    """Flat grey frames, each 20 levels brighter than the one before, up to 240."""
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), fps, size)
    for index in range(frames):
        writer.write(np.full((size[1], size[0], 3), min(240, 20 * index), dtype=np.uint8))
    writer.release()


def write_walk(folder: Path, frames: int, fps: int) -> Path:
    """A walk folder of 64x48 pictures without truth or sensors."""
    folder.mkdir(parents=True)
    write_video(folder / "video.mp4", frames, fps)
    camera = {"model": "PINHOLE", "width": 64, "height": 48, "params": [60.0, 60.0, 32.0, 24.0], "fps": fps}
    (folder / "camera.json").write_text(json.dumps(camera))
    return folder
