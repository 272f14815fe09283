"""JSON documents of a walk's quality."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

from server.protocol.codes import WeakStretchCode, known


class WeakStretch(BaseModel):
    """A stretch of the video that is too poor to map by.

    Attributes:
        start_s: seconds of the video.
        end_s: seconds of the video.
        reason: a stable code.
        severity: 0.5 where the camera could be followed all the same, up to 1 where it could not.
        detail: a sentence for the leader: what was seen, what came of it, and what to do.
        thumbnail: path of a picture in it, JPEG; null where none is kept.
    """

    model_config = ConfigDict(frozen=True)

    start_s: float
    end_s: float
    reason: Annotated[str, known(WeakStretchCode)]
    severity: Annotated[float, Field(ge=0, le=1)]
    detail: str
    thumbnail: str | None


class QualityDocument(BaseModel):
    """What a leader is told of a walk, whether or not it gave a map.

    Attributes:
        score: 0 to 100: 100 times the coverage, less 5 for each weak stretch; at most 40 without a map.
        record_again: whether the walk had better be recorded again.
        verdict: why, a sentence.
        coverage: share of the walk where followers can be found: of its length where there is a map, else
            of its time.
        video_s: seconds of video.
        stretches: the weak ones in the order of time.
        notes: what is no fault and worth knowing, sentences.
        landmarks: how many were in view, one number for each second of the video.
        picture: path of all this as a picture for a page, PNG; null where it could not be drawn.
    """

    model_config = ConfigDict(frozen=True)

    score: Annotated[int, Field(ge=0, le=100)]
    record_again: bool
    verdict: str
    coverage: Annotated[float, Field(ge=0, le=1)]
    video_s: float
    stretches: tuple[WeakStretch, ...]
    notes: tuple[str, ...]
    landmarks: tuple[int, ...]
    picture: str | None
