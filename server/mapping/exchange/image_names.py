"""Names of keyframes as images: they say which frame of the video to look for, and when it was taken."""

from __future__ import annotations

import re

_NAME = re.compile(r"(?:.*/)?(?P<frame>\d{6,})_(?P<milliseconds>\d{8,})ms\.\w+")


def image_name(frame: int, time: float) -> str:
    """``000123_00012345ms.png``: frame 123 of the path (10 a second), 12.345 s into the video.

    Both numbers have a fixed width, so the order of the names is the order of the walk.
    """
    return f"{frame:06d}_{round(1000.0 * time):08d}ms.png"


def named_time(name: str) -> float | None:
    """The time in a name, seconds, or None if it is no name of :func:`image_name`."""
    match = _NAME.fullmatch(name)
    return None if match is None else int(match["milliseconds"]) / 1000.0
