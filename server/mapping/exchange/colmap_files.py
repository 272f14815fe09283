"""Whether the files of a binary COLMAP model are whole.

COLMAP reads on past the end of a file that was cut short and takes what it finds in memory for cameras and
points, so lengths are checked first. Format: https://colmap.github.io/format.html, all numbers little-endian.
"""

from __future__ import annotations

import struct
from pathlib import Path

import pycolmap


class ColmapModelError(ValueError):
    """No COLMAP model that a map can be made of; the message says what is wrong and what to do."""


def check_whole(folder: Path) -> None:
    """Walk through the cameras, images and points of a binary model.

    Raises:
        ColmapModelError: one of the files ends too early or too late.
        OSError: a file cannot be read.
    """
    for name, walk in (("cameras.bin", _cameras), ("images.bin", _images), ("points3D.bin", _points)):
        data = (folder / name).read_bytes()
        try:
            end = walk(data)
        except (struct.error, ValueError):
            end = -1
        if end != len(data):
            raise ColmapModelError(f"{folder / name} is damaged or was cut short: copy or export it anew")


def _count(data: bytes, at: int) -> int:
    number: int = struct.unpack_from("<Q", data, at)[0]
    return number


def _cameras(data: bytes) -> int:
    at = 8
    for _ in range(_count(data, 0)):
        model = struct.unpack_from("<IiQQ", data, at)[1]
        camera = pycolmap.Camera.create_from_model_id(0, pycolmap.CameraModelId(model), 1.0, 1, 1)
        at += 24 + 8 * len(camera.params)
    return at


def _images(data: bytes) -> int:
    at = 8
    for _ in range(_count(data, 0)):
        name_end = data.index(b"\0", at + 64)
        at = name_end + 9 + 24 * _count(data, name_end + 1)
    return at


def _points(data: bytes) -> int:
    at = 8
    for _ in range(_count(data, 0)):
        at += 51 + 8 * _count(data, at + 43)
    return at
