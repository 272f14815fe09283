"""JSON documents of the HTTP interface."""

from __future__ import annotations

import unicodedata
from datetime import datetime
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, StringConstraints

from server.protocol.codes import BuildStageCode, FailureCode, ScaleSourceCode, known

_JOINERS = "\u200c\u200d"
"""Zero-width (non-)joiners: Persian and Indic spelling and joined emoji need them."""


def _without_controls(text: str) -> str:
    # They end, reorder or colour whatever shows the text after them.
    for character in text:
        if unicodedata.category(character) in ("Cc", "Cf") and character not in _JOINERS:
            raise ValueError(f"the control or format character U+{ord(character):04X} is not allowed")
    return text


Label = Annotated[
    str,
    StringConstraints(strip_whitespace=True, min_length=1, max_length=200),
    AfterValidator(_without_controls),
]
"""A name for people: one line, without control and format characters but the joiners that scripts need."""


class CameraDescription(BaseModel):
    """Intrinsics of a camera, models and parameter order as in COLMAP.

    Attributes:
        model: by its COLMAP name, one of those below.
        width: of the stored picture, pixels.
        height: of the stored picture, pixels.
        params: pixels; PINHOLE: fx, fy, cx, cy; SIMPLE_PINHOLE: f, cx, cy; SIMPLE_RADIAL: f, cx, cy, k;
            RADIAL: f, cx, cy, k1, k2; OPENCV: fx, fy, cx, cy, k1, k2, p1, p2; OPENCV_FISHEYE: fx, fy, cx, cy,
            k1, k2, k3, k4. The centre of the first pixel is (0.5, 0.5).
        fps: as recorded; not used.
    """

    model_config = ConfigDict(extra="ignore", frozen=True)

    model: Annotated[str, Field(max_length=32)]
    width: Annotated[int, Field(ge=1, le=16384)]
    height: Annotated[int, Field(ge=1, le=16384)]
    params: Annotated[tuple[Annotated[float, Field(allow_inf_nan=False)], ...], Field(max_length=16)]
    fps: Annotated[float, Field(gt=0, allow_inf_nan=False)] | None = None


class CreateRoute(BaseModel):
    """A new route.

    Attributes:
        name: of the route, one line for people.
        start_label: name of the place where it begins.
        destination_label: name of the place where it ends.
        measured_length_m: metres, length of the walked path if somebody measured it, 0.1 to
            100,000: fixes the map's scale.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    name: Label
    start_label: Label
    destination_label: Label
    measured_length_m: Annotated[float, Field(ge=0.1, le=100_000, allow_inf_nan=False)] | None = None


RouteStateName = Literal["created", "uploaded", "building", "ready", "failed"]


class BuildDocument(BaseModel):
    """How far the building of the map is.

    Attributes:
        stage: ``queued`` or a stage of the build.
        fraction: of the whole build, 0 to 1.
        attempt: 1 for the first.
    """

    model_config = ConfigDict(frozen=True)

    stage: Annotated[str, known(BuildStageCode)]
    fraction: float
    attempt: int


class FailureDocument(BaseModel):
    """Why there is no map.

    Attributes:
        reason: a stable code.
        detail: a sentence for the leader.
    """

    model_config = ConfigDict(frozen=True)

    reason: Annotated[str, known(FailureCode)]
    detail: str


class LostInterval(BaseModel):
    """A stretch of the video without a tracked frame.

    Attributes:
        start_s: seconds of the video.
        end_s: seconds of the video.
    """

    model_config = ConfigDict(frozen=True)

    start_s: float
    end_s: float


class QualityReport(BaseModel):
    """Figures of a build that ended, well or not.

    Attributes:
        frames: used, 10 for a second of video.
        tracked_frames: of these, the ones whose pose is their own.
        keyframes: kept in the map.
        landmarks: points in space.
        video_s: seconds of video.
        lost: where the camera could not be followed.
        build_s: seconds that the build took.
        camera: of the upright video's pictures, as the walk was mapped with; null where none was mapped.
        camera_source: ``given`` as it was sent, ``refined`` by the walk, ``estimated`` from the walk alone,
            ``assumed`` where nothing tells it.
    """

    model_config = ConfigDict(frozen=True)

    frames: int
    tracked_frames: int
    keyframes: int
    landmarks: int
    video_s: float
    lost: tuple[LostInterval, ...]
    build_s: float
    camera: CameraDescription | None = None
    camera_source: Literal["given", "refined", "estimated", "assumed"] = "given"


class MapSummary(BaseModel):
    """A finished map in numbers.

    Attributes:
        length: of the walked path in map units.
        length_m: of the walked path, metres; null while the scale is unknown.
        metres_per_unit: null while the scale is unknown.
        scale_source: what fixed the scale.
        duration_s: seconds that the leader took.
        turns: their number.
        bytes: of the map's file.
    """

    model_config = ConfigDict(frozen=True)

    length: float
    length_m: float | None
    metres_per_unit: float | None
    scale_source: Annotated[str, known(ScaleSourceCode)]
    duration_s: float
    turns: int
    bytes: int


class RouteDocument(BaseModel):
    """A route.

    Attributes:
        id: a UUID.
        name: of the route.
        start_label: name of the place where it begins.
        destination_label: name of the place where it ends.
        measured_length_m: metres, as the leader gave it.
        state: ``created``, then ``uploaded`` once everything is there, ``building``, ``ready`` or ``failed``.
        has_camera: whether the leader's camera is there.
        video_bytes: of the stored video; null before it is there.
        build: how far the building of the map is; null before it is due.
        failure: set exactly while the state is ``failed``.
        report: figures of the last build that ended.
        map: set exactly when the state is ``ready``.
        created_at: RFC 3339, UTC.
        updated_at: RFC 3339, UTC.
    """

    model_config = ConfigDict(frozen=True)

    id: str
    name: str
    start_label: str
    destination_label: str
    measured_length_m: float | None
    state: RouteStateName
    has_camera: bool
    video_bytes: int | None
    build: BuildDocument | None
    failure: FailureDocument | None
    report: QualityReport | None
    map: MapSummary | None
    created_at: datetime
    updated_at: datetime


class RouteList(BaseModel):
    """A page of routes, newest first.

    Attributes:
        routes: up to the limit that was asked for.
        next: the cursor of the following page; null on the last.
    """

    model_config = ConfigDict(frozen=True)

    routes: tuple[RouteDocument, ...]
    next: str | None


class TurnDocument(BaseModel):
    """A stretch of the path on which its heading changes.

    Attributes:
        start: arc length where it begins, map units.
        end: arc length where it ends, map units.
        angle: radians, positive to the left.
    """

    model_config = ConfigDict(frozen=True)

    start: float
    end: float
    angle: float


class PathDocument(BaseModel):
    """The walked path, for drawing.

    Attributes:
        metres_per_unit: null while the scale is unknown.
        scale_source: what fixed the scale.
        time_s: seconds of the video, one for each of F frames.
        position: x, y, z of each frame in the map's frame and unit, z up as far as it is known.
        arc_length: map units walked up to each frame.
        tracked: for each frame, false where its pose is interpolated.
        turns: in the order of the path.
    """

    model_config = ConfigDict(frozen=True)

    metres_per_unit: float | None
    scale_source: Annotated[str, known(ScaleSourceCode)]
    time_s: tuple[float, ...]
    position: tuple[tuple[float, float, float], ...]
    arc_length: tuple[float, ...]
    tracked: tuple[bool, ...]
    turns: tuple[TurnDocument, ...]


class HealthDocument(BaseModel):
    """Whether the service works.

    Attributes:
        status: ``ok``, or ``degraded`` when the database or every navigation process is missing.
        version: of the service.
        protocol: version of the navigation socket.
        database: whether it answers.
        navigation_workers: processes that live.
        navigation_sessions: connected or waiting to be resumed.
        builds: that run now.
    """

    model_config = ConfigDict(frozen=True)

    status: Literal["ok", "degraded"]
    version: str
    protocol: int
    database: bool
    navigation_workers: int
    navigation_sessions: int
    builds: int


class Problem(BaseModel):
    """An error, as RFC 9457 has it, ``application/problem+json``.

    Attributes:
        type: a stable URN, ``urn:pairnavi:problem:<code>``.
        title: the code in words.
        status: the HTTP status.
        detail: a sentence for whoever asked.
        code: the type without its prefix.
        instance: path of the request.
        errors: of a request that does not validate: where and what.
    """

    model_config = ConfigDict(extra="allow")

    type: str
    title: str
    status: int
    detail: str
    code: str
    instance: str | None = None
    errors: list[dict[str, Any]] | None = None
