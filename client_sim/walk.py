"""A recorded walk: a video, its camera, and the phone's sensors."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from client_sim.errors import WalkError
from server.protocol.documents import CameraDescription

FRAME_RATE = 10.0
"""Pictures a second that a follower sends."""


@dataclass(frozen=True, eq=False, slots=True)
class VideoFrame:
    """A picture of the video.

    Attributes:
        index: of the frame in the video, from 0.
        time: seconds on the video's clock.
        image: (H, W, 3) uint8, BGR, as it is shown: rotation metadata applied.
    """

    index: int
    time: float
    image: NDArray[np.uint8]


@dataclass(frozen=True, slots=True)
class Walk:
    """A walk to be replayed.

    Attributes:
        camera: of the video's pictures; None if nobody knows it.
        sensors: ``sensors.jsonl``, None if nothing but the video was recorded.
    """

    name: str
    video: Path
    camera: CameraDescription | None
    sensors: Path | None = None

    @staticmethod
    def from_folder(folder: Path) -> Walk:
        """A walk folder: ``video.mp4`` and, where there are any, ``camera.json`` and ``sensors.jsonl``.

        Raises:
            WalkError: a file is missing or not understood.
        """
        if not folder.is_dir():
            raise WalkError(f"{folder}: no such folder")
        sensors = folder / "sensors.jsonl"
        camera = folder / "camera.json"
        walk = Walk.from_files(
            folder / "video.mp4", camera if camera.exists() else None, folder.resolve().name
        )
        return Walk(walk.name, walk.video, walk.camera, sensors if sensors.is_file() else None)

    @staticmethod
    def from_files(video: Path, camera: Path | None, name: str | None = None) -> Walk:
        """A video and, where there is one, the JSON file of its camera.

        Raises:
            WalkError: a file is missing or not understood.
        """
        if not video.is_file():
            raise WalkError(f"{video}: no such file")
        if camera is None:
            return Walk(name or video.stem, video, None)
        try:
            description = CameraDescription.model_validate_json(camera.read_text(encoding="utf-8"))
        except OSError as error:
            raise WalkError(f"{camera}: {error.strerror}") from error
        except ValidationError as error:
            first = error.errors(include_url=False, include_input=False)[0]
            where = ".".join(str(part) for part in first["loc"])
            raise WalkError(f"{camera}: {where}: {first['msg']}") from error
        return Walk(name or video.stem, video, description)

    def frames(self, rate: float = FRAME_RATE) -> Iterator[VideoFrame]:
        """Pictures at ``rate`` a second by their timestamps, which may be uneven.

        Raises:
            WalkError: the video cannot be opened, or it is shown in another size than its camera's.
        """
        capture = cv2.VideoCapture(str(self.video))
        try:
            if not capture.isOpened():
                raise WalkError(f"{self.video}: no video that can be read")
            yield from self._sampled(capture, rate)
        finally:
            capture.release()

    def _sampled(self, capture: cv2.VideoCapture, rate: float) -> Iterator[VideoFrame]:
        index = 0
        due: float | None = None
        # Half a frame of a 60 fps video: stamps are rounded, and a frame a hair early is the frame meant.
        slack = 1.0 / 120.0
        while capture.grab():
            time = capture.get(cv2.CAP_PROP_POS_MSEC) / 1e3
            if due is None or time >= due - slack:
                read, image = capture.retrieve()
                if read:
                    self._check_size(image.shape[1], image.shape[0])
                    yield VideoFrame(index, time, np.asarray(image, dtype=np.uint8))
                    due = time + 1.0 / rate if due is None else max(due, time - 1.0 / rate) + 1.0 / rate
            index += 1

    def _check_size(self, width: int, height: int) -> None:
        camera = self.camera
        if camera is not None and (width, height) != (camera.width, camera.height):
            raise WalkError(
                f"{self.video} shows {width}x{height}, its camera is {camera.width}x{camera.height}"
            )

    def readings(self) -> Iterator[dict[str, Any]]:
        """Sensor readings in the order of their times, as they are in ``sensors.jsonl``.

        Raises:
            WalkError: a line is not understood.
        """
        if self.sensors is None:
            return
        with self.sensors.open(encoding="utf-8") as lines:
            for number, line in enumerate(lines, start=1):
                try:
                    reading = json.loads(line)
                    float(reading["t"])
                except (ValueError, KeyError, TypeError):
                    raise WalkError(f"{self.sensors}:{number}: not a sensor reading") from None
                yield reading


def encode_jpeg(image: NDArray[np.uint8], quality: int) -> bytes:
    """A picture (H, W, 3) as JPEG; quality 1 to 100.

    Raises:
        ValueError: it cannot be encoded.
    """
    done, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])
    if not done:
        raise ValueError("the picture cannot be encoded as JPEG")
    return data.tobytes()
