"""Builders and engines for tests of the service: they obey the video's or picture's first bytes.

They run in the real child processes, in the place of mapping and navigation.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from server.geometry.poses import SE3
from server.navigation.updates import (
    Fix,
    Guidance,
    Instruction,
    NavigationState,
    NextTurn,
    Refusal,
    RefusalReason,
    Update,
)
from server.queues.jobs import BuildOrder, BuildOutcome, JobProgress
from server.workers.navigation_messages import MapRefused, PictureRefused

JPEG = b"\xff\xd8"


def build(order: BuildOrder, on_progress: Callable[[JobProgress], None]) -> BuildOutcome:
    """``good``, ``bad``, ``weak``, ``blur``, ``cam``, ``die``, ``raise``, or ``slow`` until it is given up.

    A ``weak`` walk gives a map and a ``blur`` none, both with a quality report. A ``cam`` is of an upright
    camera.
    """
    command = order.video.read_bytes()[:4]
    on_progress(JobProgress("tracking", 0.25))
    report = {
        "frames": 3,
        "tracked_frames": 2,
        "keyframes": 2,
        "landmarks": 9,
        "video_s": 0.3,
        "lost": [{"start_s": 0.1, "end_s": 0.2}],
        "build_s": 0.1,
        "camera": order.camera,
        "camera_source": "assumed" if order.camera is None else "given",
    }
    if command == b"die!":
        os._exit(7)
    if command == b"rais":
        raise RuntimeError("a bug in mapping")
    if command == b"slow":
        for _ in range(600):
            time.sleep(0.05)
    if command == b"bad!":
        return BuildOutcome("no_texture", "the walls are bare", report=report)
    if command == b"cam!" and order.camera is not None and order.camera["width"] > order.camera["height"]:
        return BuildOutcome("camera_mismatch", "the video is taller than wide", report=report)
    pictures: tuple[Path, ...] = ()
    if command in (b"weak", b"blur"):
        pictures = _quality(order, report)
    if command == b"blur":
        return BuildOutcome("tracking_lost", "nothing is sharp", report=report, quality_files=pictures)
    map_file, path_file = order.folder / "map", order.folder / "path.json"
    map_file.write_bytes(b"MAP" + order.video.read_bytes()[:64])
    path_file.write_text(
        json.dumps(
            {
                "metres_per_unit": None,
                "scale_source": "unknown",
                "time_s": [0.0, 0.1],
                "position": [[0, 0, 0], [0, 1, 0]],
                "arc_length": [0.0, 1.0],
                "tracked": [True, True],
                "turns": [],
            }
        )
    )
    summary = {
        "length": 1.0,
        "length_m": order.measured_length_m,
        "metres_per_unit": order.measured_length_m,
        "scale_source": "unknown" if order.measured_length_m is None else "measured_length",
        "duration_s": 0.1,
        "turns": 0,
    }
    on_progress(JobProgress("finishing", 1.0))
    return BuildOutcome(
        None,
        map_file=map_file,
        path_file=path_file,
        report=report,
        map_summary=summary,
        quality_files=pictures,
    )


def _quality(order: BuildOrder, report: dict[str, Any]) -> tuple[Path, ...]:
    """Add a quality report of two weak stretches, one with a thumbnail; returns its pictures' files."""
    stretches = [
        {
            "start_s": 0.1 * k,
            "end_s": 0.1 * k + 0.1,
            "reason": reason,
            "severity": 1.0,
            "detail": "It is so: do otherwise.",
            "thumbnail": thumbnail,
        }
        for k, (reason, thumbnail) in enumerate([("blurred", None), ("too_dark", "stretch-2.jpg")])
    ]
    report["quality"] = {
        "score": 30,
        "record_again": True,
        "verdict": "Record the walk again.",
        "coverage": 0.4,
        "video_s": 0.3,
        "stretches": stretches,
        "notes": [],
        "landmarks": [9],
        "picture": "report.png",
    }
    files = order.folder / "report.png", order.folder / "stretch-2.jpg"
    for path in files:
        path.write_bytes(path.name.encode())
    return files


class StubSession:
    """Counts its pictures in its snapshot. ``die`` ends the process, ``slow`` takes a while."""

    def __init__(self, count: int) -> None:
        self.count = count

    def process(self, picture: bytes, capture_time: float, sequence: int) -> Update:
        """See ``EngineSession.process``."""
        if not picture.startswith(JPEG):
            raise PictureRefused("not a JPEG")
        command = picture[2:6]
        if command == b"die!":
            os._exit(9)
        if command == b"rais":
            raise RuntimeError("a bug in navigation")
        if command == b"slow":
            time.sleep(0.3)
        self.count += 1
        if command == b"lost":
            return Update(
                sequence,
                capture_time,
                NavigationState.LOST,
                None,
                Refusal(RefusalReason.NO_SIMILAR_PLACE),
                None,
            )
        fix = Fix(SE3(np.eye(3), np.array([float(self.count), 0.0, 0.0])), np.eye(6) * 1e-4, 40, 60, 1)
        guidance = Guidance(
            min(1.0, self.count / 20), None, None, 12.0, Instruction.LEFT, 0.5, NextTurn(1.5, None, 3.0)
        )
        state = NavigationState.ON_ROUTE if self.count < 20 else NavigationState.ARRIVED
        return Update(sequence, capture_time, state, fix, None, guidance)

    def snapshot(self) -> Any:
        """See ``EngineSession.snapshot``."""
        return {"count": self.count}


class StubEngine:
    """Opens stub sessions; a map that does not begin with ``MAP`` is refused."""

    def __init__(self, maps: int, max_pixels: int) -> None:
        self.maps = maps

    def open(
        self, map_file: str, camera: Mapping[str, Any] | None, orientation: int, snapshot: Any | None
    ) -> StubSession:
        """See ``Engine.open``."""
        if not Path(map_file).read_bytes().startswith(b"MAP"):
            raise MapRefused("not a map")
        return StubSession(0 if snapshot is None else snapshot["count"])


class ThreadCountingEngine(StubEngine):
    """Its sessions begin at a count of the most threads that any library would use, less one."""

    def open(
        self, map_file: str, camera: Mapping[str, Any] | None, orientation: int, snapshot: Any | None
    ) -> StubSession:
        """See ``Engine.open``."""
        import cv2
        import faiss

        names = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
        counts = [cv2.getNumThreads(), faiss.omp_get_max_threads(), *(int(os.environ[n]) for n in names)]
        return StubSession(max(counts) - 1)
