"""Parts of a walk, and walks whose camera was covered for a while."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from server.evaluation.walk import Walk, read_walk


def clip(walk: Walk, folder: Path, frames: int | None = None, *, black: range = range(0)) -> Walk:
    """The walk's first frames as a walk folder, black ones among them where wanted.

    Motion JPEG, so that no frame depends on another; the truth is that of the whole walk.
    """
    folder.mkdir(parents=True)
    for name in ("camera.json", "meta.json", "groundtruth.txt"):
        shutil.copyfile(walk.folder / name, folder / name)
    reader = cv2.VideoCapture(str(walk.video))
    pictures = []
    while (frames is None or len(pictures) < frames) and reader.grab():
        done, image = reader.retrieve()
        assert done
        pictures.append(np.zeros_like(image) if len(pictures) in black else image)
    reader.release()
    write_pictures(folder / "video.mp4", pictures)
    return read_walk(folder)


def write_pictures(path: Path, pictures: Sequence[NDArray[np.uint8]], fps: float = 10.0) -> Path:
    """A video of pictures (H, W, 3), nearly without loss."""
    film = path.with_suffix(".avi")
    size = (pictures[0].shape[1], pictures[0].shape[0])
    writer = cv2.VideoWriter(str(film), cv2.VideoWriter.fourcc(*"MJPG"), fps, size)
    writer.set(cv2.VIDEOWRITER_PROP_QUALITY, 98)
    for picture in pictures:
        writer.write(picture)
    writer.release()
    film.rename(path)
    return path
