"""What is judged, run as in production: a video becomes a map file, a follower's JPEGs become updates.

These functions see videos and cameras, never the truth. Each runs in a process of its own.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import cv2
import faiss

from server.evaluation.follower import AnsweredFrame
from server.evaluation.isolated import peak_rss_bytes
from server.evaluation.leader import BuildFigures
from server.geometry.cameras import Camera
from server.mapping.build import build_route_map
from server.mapping.codec import load_route_map, save_route_map
from server.mapping.video import read_frames
from server.navigation.frames import decode_frame
from server.navigation.session import NavigationSession

JPEG_QUALITY = 90


def build_map(
    video: Path, camera: Camera | None, map_file: Path, report: Callable[[float], None]
) -> BuildFigures:
    """Build a route map from a leader's video and write it to ``map_file``; ``report`` gets 0 to 1."""
    started = time.perf_counter()
    result = build_route_map(video, camera, on_progress=lambda progress: report(progress.fraction))
    seconds = time.perf_counter() - started
    if result.route_map is not None:
        save_route_map(result.route_map, map_file)
    return BuildFigures(
        status=result.status,
        detail=result.detail,
        report=result.report,
        seconds=seconds,
        peak_rss_bytes=peak_rss_bytes(),
        map_bytes=map_file.stat().st_size if result.route_map is not None else 0,
    )


def follow_route(
    map_file: Path, video: Path, camera: Camera | None, report: Callable[[int], None]
) -> list[AnsweredFrame]:
    """Send a follower's frames at 10 fps through one session, in order, on one thread.

    ``report`` gets the video index of each answered frame. The clock runs from JPEG bytes to update;
    it neither counts making the JPEG nor the first loading of the map.
    """
    cv2.setNumThreads(1)
    faiss.omp_set_num_threads(1)
    session = NavigationSession(load_route_map(map_file), camera)
    answers: list[AnsweredFrame] = []
    for sequence, frame in enumerate(read_frames(video)):
        # Three channels, as a phone sends them: their decoding is part of the latency.
        colour = cv2.cvtColor(frame.image, cv2.COLOR_GRAY2BGR)
        _, encoded = cv2.imencode(".jpg", colour, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
        jpeg = encoded.tobytes()
        started = time.perf_counter()
        update = session.process(decode_frame(jpeg), frame.time, sequence)
        milliseconds = 1000.0 * (time.perf_counter() - started)
        answers.append(AnsweredFrame(frame.index, update, milliseconds))
        report(frame.index)
    return answers
