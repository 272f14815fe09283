"""JSON messages of the navigation socket, both ways, told apart by ``type``.

Lengths in ``*_m`` are metres and null unless the route's scale is known; angles are radians,
positive to the left; quaternions x, y, z, w; times ``*_us`` microseconds, ``*_ms`` milliseconds.
Clients ignore fields and enumeration values they do not know; the service refuses unknown fields.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter

from server.protocol.codes import InstructionCode, RefusalCode, StateCode, known
from server.protocol.documents import CameraDescription
from server.protocol.frames import MAX_CAPTURE_TIME_US, MAX_SEQUENCE

ClockMicroseconds = Annotated[int, Field(ge=0, le=MAX_CAPTURE_TIME_US)]
Sequence = Annotated[int, Field(ge=0, le=MAX_SEQUENCE)]
Vector3 = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]


class _FromClient(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class _FromServer(BaseModel):
    model_config = ConfigDict(extra="ignore", frozen=True)


class Hello(_FromClient):
    """The first message of a connection.

    Attributes:
        protocol: version the client speaks.
        camera: of the pictures as they are sent, before ``orientation`` turns them; null if unknown:
            then the first fixes tell it.
        orientation: degrees clockwise by which a picture has to be turned to stand upright.
        clock_us: the phone's clock now, the one capture times are of.
        capabilities: names of what the client can do; unknown ones are ignored.
        resume_token: of an earlier ``welcome``, to go on with its session.
    """

    type: Literal["hello"] = "hello"
    protocol: int
    camera: CameraDescription | None
    orientation: Literal[0, 90, 180, 270] = 0
    clock_us: ClockMicroseconds
    capabilities: Annotated[tuple[Annotated[str, Field(max_length=64)], ...], Field(max_length=32)] = ()
    resume_token: Annotated[str, Field(max_length=128)] | None = None


class Ping(_FromClient):
    """Keeps the connection alive and the clocks compared.

    Attributes:
        id: echoed.
        clock_us: the phone's clock now.
        round_trip_us: from the last ping to its pong as the client measured it, null before the first.
    """

    type: Literal["ping"] = "ping"
    id: Sequence
    clock_us: ClockMicroseconds
    round_trip_us: Annotated[int, Field(ge=0, le=60_000_000)] | None = None


class End(_FromClient):
    """The walk is over: the session is forgotten, its resume token with it."""

    type: Literal["end"] = "end"


ClientMessage = Annotated[Hello | Ping | End, Field(discriminator="type")]


class Limits(_FromServer):
    """What the service accepts on this connection.

    Attributes:
        max_frame_bytes: of a binary message without its header.
        max_message_bytes: of a text message, UTF-8.
        max_pixels: width times height of the camera's pictures.
        max_frames_per_second: sustained; bursts of four seconds' worth pass.
    """

    max_frame_bytes: int
    max_message_bytes: int
    max_pixels: int
    max_frames_per_second: float


class RouteSummary(_FromServer):
    """The route a client is guided on.

    Attributes:
        id: the route's.
        name: what the leader called it.
        start_label: name of the place where it begins.
        destination_label: name of the place where it ends.
        length_m: metres; null while the scale is unknown.
        duration_s: seconds that the leader took.
        turns: their number.
    """

    id: str
    name: str
    start_label: str
    destination_label: str
    length_m: float | None
    duration_s: float
    turns: int


class Welcome(_FromServer):
    """The answer to ``hello``.

    Attributes:
        protocol: version that the service speaks on this connection.
        session_id: names the session in the service's log; no secret.
        resume_token: secret; opens this session again within ``resume_within_s`` of a lost connection.
        resumed: whether an earlier session goes on.
        last_sequence: of a resumed session: the next frame's must be greater; null when none was taken.
        server_clock_us: the service's clock now, microseconds from an origin of its own.
        heartbeat_interval_s: seconds; send a ping this often.
        idle_timeout_s: seconds; the connection is closed after so long without a message.
        resume_within_s: seconds that the session outlives its connection.
        limits: what the service accepts on this connection.
        route: what the follower is guided on.
    """

    type: Literal["welcome"] = "welcome"
    protocol: int
    session_id: str
    resume_token: str
    resumed: bool
    last_sequence: int | None
    server_clock_us: int
    heartbeat_interval_s: float
    idle_timeout_s: float
    resume_within_s: float
    limits: Limits
    route: RouteSummary


class Age(_FromServer):
    """How old an update is when it is sent.

    Attributes:
        server_ms: milliseconds since the frame was received.
        capture_ms: milliseconds since the picture was taken, by the estimated offset of the clocks;
            null while there is none.
    """

    server_ms: float
    capture_ms: float | None


class FixMessage(_FromServer):
    """A pose in the route map's frame and unit, of the camera turned upright.

    Attributes:
        position: x, y, z of the camera's centre, map units, z up as far as it is known.
        orientation: world_from_camera as a quaternion x, y, z, w; camera axes x right, y down, z forward.
        position_sigma: radius of one standard deviation of the position, map units.
        rotation_sigma: the same of the orientation, radians.
        inliers: correspondences that agree with the pose.
        matches: correspondences that were tried.
        keyframe: index of the nearest keyframe of the map.
    """

    position: Vector3
    orientation: Quaternion
    position_sigma: float
    rotation_sigma: float
    inliers: int
    matches: int
    keyframe: int


class RefusalMessage(_FromServer):
    """Why the frame has no pose.

    Attributes:
        reason: a code; the sentence is the client's.
        inliers: correspondences that agreed with the best pose, too few of them.
    """

    reason: Annotated[str, known(RefusalCode)]
    inliers: int


class NextTurnMessage(_FromServer):
    """The next turn that has not begun.

    Attributes:
        angle: radians by which the route turns, positive to the left.
        distance_m: metres along the route to its beginning; null while the scale is unknown.
        seconds: what the leader took from here to its beginning.
    """

    angle: float
    distance_m: float | None
    seconds: float


class GuidanceMessage(_FromServer):
    """What to do: codes with numbers, sentences are the client's.

    Attributes:
        progress: fraction of the route walked, 0 to 1.
        walked_m: metres along the route; null while the scale is unknown.
        remaining_m: metres along the route; null while the scale is unknown.
        remaining_s: seconds that the leader took from here to the destination.
        instruction: what to do now.
        bearing: radians from where the camera looks to the temporary destination, about the vertical,
            positive to the left, -pi to pi.
        next_turn: null after the last one has begun.
    """

    progress: float
    walked_m: float | None
    remaining_m: float | None
    remaining_s: float
    instruction: Annotated[str, known(InstructionCode)]
    bearing: float
    next_turn: NextTurnMessage | None


class FrameCounts(_FromServer):
    """Frames of the session so far.

    Attributes:
        received: with a valid header.
        answered: with an update.
        replaced: dropped because a newer one came before they were looked at.
        stale: dropped because they came out of order or twice.
        bad: no JPEG, of the wrong size, or from the future.
    """

    received: int
    answered: int
    replaced: int
    stale: int
    bad: int


class UpdateMessage(_FromServer):
    """The answer to one frame; of ``fix`` and ``refusal`` exactly one is set.

    Attributes:
        sequence: of the frame.
        capture_time_us: of the frame, as it was sent.
        age: how old the frame is when this is sent.
        state: where the follower stands with regard to the route.
        fix: the pose; null if the frame was refused.
        refusal: why there is no pose; null if there is one.
        guidance: what to do; null until the route has been found, while it is in doubt which part of
            the route a fix belongs to, and 0.75 s after the last fix.
        frames: of the session so far.
    """

    type: Literal["update"] = "update"
    sequence: int
    capture_time_us: int
    age: Age
    state: Annotated[str, known(StateCode)]
    fix: FixMessage | None
    refusal: RefusalMessage | None
    guidance: GuidanceMessage | None
    frames: FrameCounts


class ErrorMessage(_FromServer):
    """Something the client sent was not accepted.

    Attributes:
        code: stable, documented.
        detail: a sentence for developers; it may change.
        sequence: of the frame concerned, if one is.
        fatal: the connection is closed after this message.
    """

    type: Literal["error"] = "error"
    code: str
    detail: str
    sequence: int | None = None
    fatal: bool = False


class Pong(_FromServer):
    """The answer to a ping.

    Attributes:
        id: the ping's.
        clock_us: the ping's: the phone's clock when it was sent.
        server_clock_us: the service's clock now, microseconds from an origin of its own.
    """

    type: Literal["pong"] = "pong"
    id: int
    clock_us: int
    server_clock_us: int


class Goodbye(_FromServer):
    """The last message before an orderly close.

    Attributes:
        reason: ``ended`` after the client's ``end``, else a code.
        may_resume: whether a new connection with the resume token is the right answer.
        frames: of the session so far.
    """

    type: Literal["goodbye"] = "goodbye"
    reason: str
    may_resume: bool
    frames: FrameCounts


ServerMessage = Annotated[
    Welcome | UpdateMessage | ErrorMessage | Pong | Goodbye, Field(discriminator="type")
]

_client_messages: TypeAdapter[Hello | Ping | End] = TypeAdapter(ClientMessage)
_server_messages: TypeAdapter[Welcome | UpdateMessage | ErrorMessage | Pong | Goodbye] = TypeAdapter(
    ServerMessage
)


def parse_client_message(text: str | bytes) -> Hello | Ping | End:
    """Parse what a client sent.

    Raises:
        pydantic.ValidationError: (a ValueError) not JSON, an unknown type, or a field that does not fit.
    """
    return _client_messages.validate_json(text)


def parse_server_message(text: str | bytes) -> Welcome | UpdateMessage | ErrorMessage | Pong | Goodbye:
    """Parse what the service sent.

    Raises:
        pydantic.ValidationError: (a ValueError) not JSON, an unknown type, or a field that does not fit.
    """
    return _server_messages.validate_json(text)
