"""The quality report as files: JSON, a picture of the page, a thumbnail of every weak stretch."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from server.mapping.quality import QualityReport

REPORT_FILE = "report.json"
PICTURE_FILE = "report.png"


@dataclass(frozen=True, slots=True)
class QualityFiles:
    """What :func:`write_quality_report` wrote.

    Attributes:
        thumbnails: one a stretch, None where none was kept.
    """

    report: Path
    picture: Path
    thumbnails: tuple[Path | None, ...]


def write_quality_report(report: QualityReport, folder: Path, title: str = "The walk") -> QualityFiles:
    """Write ``report.json``, ``report.png`` and ``stretch-1.jpg`` … into a folder, made if missing.

    Raises:
        OSError: a file cannot be written.
    """
    # Loaded here: drawing takes a second to load, and most who judge a walk draw nothing.
    from server.mapping.quality_picture import draw_quality_report

    folder.mkdir(parents=True, exist_ok=True)
    thumbnails: list[Path | None] = []
    for number, stretch in enumerate(report.stretches, 1):
        path = folder / f"stretch-{number}.jpg"
        if stretch.thumbnail is not None:
            path.write_bytes(stretch.thumbnail)
        thumbnails.append(None if stretch.thumbnail is None else path)
    document = quality_document(report)
    for entry, thumbnail in zip(document["stretches"], thumbnails, strict=True):
        entry["thumbnail"] = None if thumbnail is None else thumbnail.name
    document["picture"] = PICTURE_FILE
    target, picture = folder / REPORT_FILE, folder / PICTURE_FILE
    draw_quality_report(report, picture, title)
    target.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
    return QualityFiles(target, picture, tuple(thumbnails))


def quality_document(report: QualityReport) -> dict[str, Any]:
    """JSON of a report; pictures are null until they lie somewhere.

    ``landmarks`` is their median in every second of the walk, for drawing.
    """
    timeline = report.timeline
    second = timeline.time.astype(np.int64)
    landmarks = [
        int(np.median(timeline.landmarks[second == k])) if (second == k).any() else 0
        for k in range(int(second[-1]) + 1)
    ]
    return {
        "score": report.score,
        "record_again": report.record_again,
        "verdict": report.verdict,
        "coverage": round(report.coverage, 4),
        "video_s": round(report.video_seconds, 3),
        "stretches": [
            {
                "start_s": round(stretch.start_s, 3),
                "end_s": round(stretch.end_s, 3),
                "reason": str(stretch.reason),
                "severity": round(stretch.severity, 3),
                "detail": stretch.detail,
                "thumbnail": None,
            }
            for stretch in report.stretches
        ],
        "notes": list(report.notes),
        "landmarks": landmarks,
        "picture": None,
    }
