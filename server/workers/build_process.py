"""The build process: from a video to a map file and a path document."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import structlog

from server.geometry.cameras import Camera
from server.mapping.outcome import BuildProgress, BuildReport, BuildResult
from server.mapping.quality import QualityReport
from server.mapping.route_map import RouteMap
from server.queues.jobs import BuildOrder, BuildOutcome, JobProgress
from server.storage.objects import STORAGE_FULL

Builder = Callable[[BuildOrder, Callable[[JobProgress], None]], BuildOutcome]


def main(connection: Connection, builder: str) -> None:
    """Receive one order, send progress, then the outcome.

    Args:
        builder: import path of a :data:`Builder`.
    """
    from server.workers.child import load

    order: BuildOrder = connection.recv()
    build: Builder = load(builder)
    connection.send(_outcome(build, order, connection.send))
    connection.close()


def _outcome(build: Builder, order: BuildOrder, on_progress: Callable[[JobProgress], None]) -> BuildOutcome:
    """What came of the build, or what the machine lacked for it. A bug ends the process."""
    try:
        return build(order, on_progress)
    except Exception as error:
        if _is_out_of_memory(error):
            return BuildOutcome("out_of_memory", "the build needed more memory than it may take")
        if isinstance(error, OSError) and error.errno in STORAGE_FULL:
            return BuildOutcome("storage_failed", "the service has no room left for the map")
        raise


def _is_out_of_memory(error: Exception) -> bool:
    if isinstance(error, MemoryError):
        return True
    import cv2

    return isinstance(error, cv2.error) and error.code == cv2.Error.StsNoMem


def build(order: BuildOrder, on_progress: Callable[[JobProgress], None]) -> BuildOutcome:
    """Build the route map of an order and leave its files in the order's folder."""
    from server.mapping.build import BuildOptions, build_route_map
    from server.mapping.codec import save_route_map

    def report_progress(progress: BuildProgress) -> None:
        on_progress(JobProgress(str(progress.stage), progress.fraction))

    begun = time.monotonic()
    result: BuildResult = build_route_map(
        order.video,
        None if order.camera is None else Camera.from_json(order.camera),
        BuildOptions(measured_length=order.measured_length_m),
        report_progress,
    )
    report = report_document(result.report, time.monotonic() - begun)
    files: tuple[Path, ...] = ()
    if result.quality is not None:
        report["quality"], files = _quality(result.quality, order.folder / "quality")
    if result.route_map is None:
        return BuildOutcome(str(result.status), result.detail, report=report, quality_files=files)
    route_map = result.route_map
    map_file, path_file = order.folder / "map", order.folder / "path.json"
    save_route_map(route_map, map_file)
    path_file.write_text(json.dumps(path_document(route_map)), encoding="utf-8")
    return BuildOutcome(
        None,
        result.detail,
        map_file=map_file,
        path_file=path_file,
        report=report,
        map_summary=summary_document(route_map),
        quality_files=files,
    )


def _quality(quality: QualityReport, folder: Path) -> tuple[dict[str, Any], tuple[Path, ...]]:
    """The report's JSON and the files of its pictures."""
    from server.mapping.quality_files import quality_document, write_quality_report

    try:
        written = write_quality_report(quality, folder)
    except OSError:
        # The words are what counts; a disk that is full must not cost them.
        structlog.get_logger().exception("build.pictures_not_written")
        return quality_document(quality), ()
    thumbnails = [path for path in written.thumbnails if path is not None]
    document: dict[str, Any] = json.loads(written.report.read_text(encoding="utf-8"))
    return document, (written.picture, *thumbnails)


def report_document(report: BuildReport, build_seconds: float) -> dict[str, Any]:
    """JSON of :class:`server.protocol.documents.QualityReport`."""
    return {
        "frames": report.frames,
        "tracked_frames": report.tracked_frames,
        "keyframes": report.keyframes,
        "landmarks": report.landmarks,
        "video_s": round(report.video_seconds, 3),
        "lost": [{"start_s": round(a, 3), "end_s": round(b, 3)} for a, b in report.lost],
        "build_s": round(build_seconds, 3),
        "camera": None if report.camera is None else report.camera.to_json(),
        "camera_source": str(report.camera_source),
    }


def summary_document(route_map: RouteMap) -> dict[str, Any]:
    """JSON of :class:`server.protocol.documents.MapSummary` but its size in bytes."""
    path, scale = route_map.path, route_map.scale
    length = float(path.arc_length[-1])
    return {
        "length": length,
        "length_m": scale.metres(length),
        "metres_per_unit": scale.metres_per_unit,
        "scale_source": str(scale.source),
        "duration_s": float(path.time[-1] - path.time[0]),
        "turns": len(route_map.turns),
    }


def path_document(route_map: RouteMap) -> dict[str, Any]:
    """JSON of :class:`server.protocol.documents.PathDocument`."""
    path = route_map.path
    return {
        "metres_per_unit": route_map.scale.metres_per_unit,
        "scale_source": str(route_map.scale.source),
        "time_s": path.time.round(3).tolist(),
        "position": path.position.round(5).tolist(),
        "arc_length": path.arc_length.round(5).tolist(),
        "tracked": path.tracked.tolist(),
        "turns": [{"start": t.start, "end": t.end, "angle": t.angle} for t in route_map.turns],
    }
