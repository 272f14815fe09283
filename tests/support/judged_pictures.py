"""The quality report as far as pictures and features tell: no map is made, so it is quick."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from server.features.extraction import OrbExtractor
from server.features.tracking import FeatureTracker
from server.geometry.cameras import Camera, Rectifier
from server.mapping.front_end import follow_features
from server.mapping.quality import QualityReport, WalkOutcome, judge_quality
from server.mapping.video import VideoFrame, read_frames


def judge_pictures(pictures: Iterable[NDArray[np.uint8]], camera: Camera, fps: float = 10.0) -> QualityReport:
    """The report of a walk's pictures (H, W, 3), taken as if all of them could be followed."""
    grey = (np.asarray(cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY), np.uint8) for picture in pictures)
    return _judge((VideoFrame(row, row / fps, picture) for row, picture in enumerate(grey)), camera)


def judge_video(video: Path, camera: Camera) -> QualityReport:
    """The same of a video."""
    return _judge(read_frames(video), camera)


def read_pictures(video: Path) -> list[NDArray[np.uint8]]:
    """All pictures (H, W, 3) of a video."""
    reader = cv2.VideoCapture(str(video))
    pictures = []
    while True:
        done, picture = reader.read()
        if not done:
            return pictures
        pictures.append(np.asarray(picture, np.uint8))


def _judge(pictures: Iterator[VideoFrame], camera: Camera) -> QualityReport:
    rectifier = Rectifier(camera)
    upright = (VideoFrame(frame.index, frame.time, rectifier(frame.image)) for frame in pictures)
    frames = list(follow_features(upright, rectifier.target, FeatureTracker(OrbExtractor())))
    outcome = WalkOutcome(np.ones(len(frames), np.bool_), np.full(len(frames), 500))
    return judge_quality(frames, rectifier.target, outcome)
