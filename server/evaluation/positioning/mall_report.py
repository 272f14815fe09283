"""Figures of the indoor competition's walks, floor by floor."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from server.evaluation.positioning.tracks import Track

Array = NDArray[np.float64]

TUNED_ON = "site1/F1"
"""The floor on which numbers were chosen; the figures that count are those of the others."""


def _figures(tracks: list[Track]) -> dict[str, float]:
    errors = np.concatenate([track.errors for track in tracks])
    consistency = np.concatenate([track.consistency() for track in tracks])
    return {
        "median_m": float(np.median(errors)),
        "mean_m": float(np.mean(errors)),
        "p90_m": float(np.percentile(errors, 90)),
        "within_95_percent_ellipse": float(np.mean(consistency < 5.991)),
        "mean_squared_mahalanobis": float(np.mean(consistency)),
    }


@dataclass(frozen=True, slots=True)
class MallReport:
    """Of all walks, by dead reckoning and, where it was asked for, with organic anchors."""

    dead_reckoned: tuple[Track, ...]
    anchored: tuple[Track, ...]

    @property
    def floors(self) -> list[str]:
        return sorted({track.walk.floor for track in self.dead_reckoned})

    @property
    def judged(self) -> list[str]:
        """The floors whose figures count."""
        return [floor for floor in self.floors if floor != TUNED_ON] or self.floors

    def tracks(self, floors: list[str], anchored: bool) -> list[Track]:
        tracks = self.anchored if anchored else self.dead_reckoned
        return [t for t in tracks if t.walk.floor in floors and len(t.estimates)]

    def of(self, floors: list[str]) -> dict[str, Any]:
        plain, anchored = self.tracks(floors, False), self.tracks(floors, True)
        figures = _figures(plain)
        result: dict[str, Any] = {
            "dead_reckoning_median_m": figures["median_m"],
            "anchors_median_m": None,
            "waypoints": sum(len(t.estimates) for t in plain),
            "walks": len(plain),
            "dead_reckoning": figures,
            "core_percent": 100.0 * sum(t.seconds for t in plain) / sum(t.walk.duration for t in plain),
        }
        if anchored:
            result["anchors"] = _figures(anchored)
            result["anchors_median_m"] = result["anchors"]["median_m"]
        return result

    def to_json(self) -> dict[str, Any]:
        return {
            **self.of(self.judged),
            "judged": self.judged,
            "tuned_on": TUNED_ON,
            "floors": {floor: self.of([floor]) for floor in self.floors},
            "all": self.of(self.floors),
        }
