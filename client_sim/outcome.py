"""What a follower's replay comes to."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from server.protocol.messages import UpdateMessage


@dataclass(slots=True)
class FrameRecord:
    """One picture of the walk and what became of it.

    Attributes:
        frame_index: of the video's frame.
        video_time: seconds on the video's clock.
        taken: seconds on the replay's clock when the picture was taken.
        lost: why there is no update, if known: ``network``, ``network_down``, ``unconnected``, an error code.
        age_ms: from taking the picture to its update's arrival.
    """

    sequence: int
    frame_index: int
    video_time: float
    taken: float
    lost: str | None = None
    age_ms: float | None = None
    update: UpdateMessage | None = None

    def document(self) -> dict[str, Any]:
        """One line of a recording."""
        return {
            "sequence": self.sequence,
            "frame_index": self.frame_index,
            "video_time": self.video_time,
            "lost": self.lost,
            "age_ms": None if self.age_ms is None else round(self.age_ms, 3),
            "update": None if self.update is None else self.update.model_dump(mode="json"),
        }


@dataclass(frozen=True, slots=True)
class FollowSummary:
    """A replay in figures.

    Attributes:
        frames: pictures the walk has at the sampled rate.
        sent: of these, handed to the socket.
        answered: with an update that arrived.
        relocalized: with a fix of their own.
        refused: reasons and numbers of those without one.
        replaced: dropped by the service for newer ones.
        lost: reasons and numbers of those without an update.
        age_p50_ms, age_p95_ms: from taking a picture to its update's arrival; None without updates.
        progress: of the last guidance, 0 to 1; None if there never was any.
        arrived: the last update said so.
        reconnections: after lost connections.
    """

    frames: int
    sent: int
    answered: int
    relocalized: int
    refused: dict[str, int]
    replaced: int
    lost: dict[str, int]
    age_p50_ms: float | None
    age_p95_ms: float | None
    progress: float | None
    arrived: bool
    reconnections: int
    seconds: float

    @property
    def relocalized_fraction(self) -> float:
        """Of the walk's pictures."""
        return self.relocalized / self.frames if self.frames else 0.0


@dataclass(slots=True)
class FollowOutcome:
    """Everything a replay has seen, in the order of the walk."""

    route_id: str
    records: list[FrameRecord] = field(default_factory=list)
    reconnections: int = 0
    seconds: float = 0.0

    def summary(self) -> FollowSummary:
        """The figures."""
        answered = [r for r in self.records if r.update is not None]
        ages = [r.age_ms for r in answered if r.age_ms is not None]
        updates = [r.update for r in answered if r.update is not None]
        guided = [u.guidance for u in updates if u.guidance is not None]
        unsent = ("network", "unconnected")
        return FollowSummary(
            frames=len(self.records),
            sent=sum(r.lost not in unsent for r in self.records),
            answered=len(answered),
            relocalized=sum(u.fix is not None for u in updates),
            refused=dict(Counter(u.refusal.reason for u in updates if u.refusal is not None)),
            replaced=max((u.frames.replaced for u in updates), default=0),
            lost=dict(Counter(r.lost or "replaced" for r in self.records if r.update is None)),
            age_p50_ms=_percentile(ages, 50),
            age_p95_ms=_percentile(ages, 95),
            progress=guided[-1].progress if guided else None,
            arrived=bool(updates) and updates[-1].state == "arrived",
            reconnections=self.reconnections,
            seconds=self.seconds,
        )

    def write(self, path: Path) -> None:
        """One JSON object a line for every picture of the walk, answered or not."""
        lines = (json.dumps(record.document()) for record in self.records)
        path.write_text("".join(f"{line}\n" for line in lines), encoding="utf-8")


def _percentile(values: Sequence[float], percent: float) -> float | None:
    return float(np.percentile(values, percent)) if values else None
