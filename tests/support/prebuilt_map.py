"""A builder for tests whose "video" is the path of a finished map: it is taken instead of being built."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

from server.mapping.codec import load_route_map
from server.mapping.outcome import BuildReport
from server.queues.jobs import BuildOrder, BuildOutcome, JobProgress
from server.workers.build_process import path_document, report_document, summary_document


def build(order: BuildOrder, on_progress: Callable[[JobProgress], None]) -> BuildOutcome:
    """Everything as :func:`server.workers.build_process.build` leaves it, but the work."""
    source = Path(order.video.read_text(encoding="utf-8"))
    route_map = load_route_map(source)
    map_file, path_file = order.folder / "map", order.folder / "path.json"
    shutil.copyfile(source, map_file)
    path_file.write_text(json.dumps(path_document(route_map)), encoding="utf-8")
    on_progress(JobProgress("finishing", 1.0))
    frames = len(route_map.path.time)
    report = BuildReport(frames, frames, len(route_map.keyframes), 0, float(route_map.path.time[-1]))
    quality = {
        "score": 100,
        "record_again": False,
        "verdict": "the walk has no weak stretch",
        "coverage": 1.0,
        "video_s": report.video_seconds,
        "stretches": [],
        "notes": [],
        "landmarks": [],
        "picture": None,
    }
    return BuildOutcome(
        None,
        map_file=map_file,
        path_file=path_file,
        report={**report_document(report, 0.0), "quality": quality},
        map_summary=summary_document(route_map),
    )
