"""Decoding of a leader's video: upright grey frames, sampled by their time stamps."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

FRAME_RATE = 10.0
"""Frames a second that mapping and navigation use (Pair-Navi, section IV-A)."""

MAX_PIXELS = 7680 * 4320
"""Largest picture of a video that is decoded."""

MAX_FRAME_RATE = 300.0
"""Frames a second that a video may have: each of them has to be decoded, whether it is used or not."""

_BURST_S = 10.0
"""Of frames at the highest rate that may come at once: time stamps need not be even."""

_MP4_ATOMS = {b"ftyp", b"moov", b"mdat", b"wide", b"free", b"skip", b"pnot"}
_CONTAINER_MARKS = (b"\x1aE\xdf\xa3", b"RIFF", b"OggS", b"FLV")


class UnreadableVideoError(ValueError):
    """The file is no video that can be decoded, or holds no picture."""


@dataclass(frozen=True, eq=False, slots=True)
class VideoFrame:
    """A decoded frame.

    Attributes:
        index: position in the file, counted from 0 over all its frames.
        time: seconds on the video's clock, 0 at the first frame.
        image: (H, W) uint8 grey, upright: rotation metadata is applied.
    """

    index: int
    time: float
    image: NDArray[np.uint8]


@dataclass(frozen=True, slots=True)
class VideoProperties:
    """What the container says.

    Attributes:
        width, height: of the upright picture.
        frames: estimate from the container, 0 if it does not say.
        frame_rate: nominal frames a second.
        quarter_turns: clockwise turns of 90 degrees between the stored and the upright picture.
    """

    width: int
    height: int
    frames: int
    frame_rate: float
    quarter_turns: int

    @property
    def seconds(self) -> float:
        """Length by the container's own word, 0 if it does not say."""
        return self.frames / self.frame_rate if self.frame_rate > 0 else 0.0


def _open(path: Path) -> cv2.VideoCapture:
    if not path.is_file() or path.stat().st_size == 0:
        raise UnreadableVideoError("the file is empty or missing")
    with path.open("rb") as file:
        head = file.read(16)
    if not (head[4:8] in _MP4_ATOMS or head.startswith(_CONTAINER_MARKS)):
        # Only containers are opened: a playlist would make the decoder open whatever it names.
        raise UnreadableVideoError(
            "the file is no MP4, MOV, WebM, MKV or AVI video; a playlist is not followed"
        )
    capture = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG)
    if not capture.isOpened():
        capture.release()
        raise UnreadableVideoError("the file is not a video that can be decoded")
    return capture


def probe(path: Path) -> VideoProperties:
    """What the container says about the video.

    Raises:
        UnreadableVideoError: no video.
    """
    capture = _open(path)
    try:
        width, height = (int(capture.get(p)) for p in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT))
        turns = round(capture.get(cv2.CAP_PROP_ORIENTATION_META) / 90.0) % 4
        frames = max(0, int(capture.get(cv2.CAP_PROP_FRAME_COUNT)))
        rate = float(capture.get(cv2.CAP_PROP_FPS))
    finally:
        capture.release()
    if width < 16 or height < 16:
        raise UnreadableVideoError("the video has no pictures of a usable size")
    if width * height > MAX_PIXELS:
        raise UnreadableVideoError(f"a video of {width}x{height} is not taken; at most 8K (7680x4320) is")
    return VideoProperties(width, height, frames, rate if 0 < rate < 1000 else 0.0, turns)


def read_frames(path: Path, frame_rate: float = FRAME_RATE) -> Iterator[VideoFrame]:
    """Frames sampled to at most ``frame_rate`` a second, by their time stamps.

    A variable frame rate is thereby honoured: of a burst one frame is taken, a gap stays a gap.
    A file that breaks off in the middle ends the iteration where it breaks off.

    Raises:
        UnreadableVideoError: no video, not one picture in it, or far more than ``MAX_FRAME_RATE`` a second: a
            small file can name the same bytes as millions of frames.
    """
    capture = _open(path)
    try:
        due = 0.0
        index = -1
        start: float | None = None
        previous = -np.inf
        while capture.grab():
            index += 1
            stamp = float(capture.get(cv2.CAP_PROP_POS_MSEC)) / 1000.0
            start = stamp if start is None else start
            time = stamp - start
            if index > MAX_FRAME_RATE * (_BURST_S + max(previous, 0.0)):
                raise UnreadableVideoError(f"the video has over {MAX_FRAME_RATE:.0f} frames a second")
            if time <= previous:
                continue
            # A millisecond of grace: containers round their time stamps.
            if time + 1e-3 < due:
                continue
            ok, picture = capture.retrieve()
            if not ok:
                continue
            previous = time
            due = max(due + 1.0 / frame_rate, time + 0.5 / frame_rate)
            grey = cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY)
            yield VideoFrame(index, time, np.asarray(grey, dtype=np.uint8))
        if previous == -np.inf:
            raise UnreadableVideoError("not one picture of the video could be decoded")
    finally:
        capture.release()
