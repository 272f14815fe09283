"""The codes that answers carry, with what each means: phones show them, specifications list them.

The service takes most of them from its algorithms, which know nothing of the wire; tests hold the two
together. Clients meet codes they do not know as the protocol grows, and treat them by what is around them.
"""

from __future__ import annotations

from enum import StrEnum
from typing import Any

from pydantic import Field


class Code(StrEnum):
    """A code that carries its meaning: ``NAME = value, meaning, what to do``.

    Attributes:
        meaning: what happened, for a developer.
        advice: what the client does or shows; empty where nothing is to be done.
    """

    meaning: str
    advice: str

    def __new__(cls, value: str, meaning: str = "", advice: str = "") -> Code:
        """A member; see the class."""
        member = str.__new__(cls, value)
        member._value_ = value
        member.meaning = meaning
        member.advice = advice
        return member


class StateCode(Code):
    """``state`` of an update."""

    SEARCHING = (
        "searching",
        "no picture of this session has been found on the route yet",
        "Ask for the phone to be held upright, pointing forward, and turned slowly on the spot.",
    )
    ON_ROUTE = "on_route", "found; a single refused picture does not change it", "Show the guidance."
    LOST = (
        "lost",
        "no fix for more than 3 s",
        "Ask the person to stop, look around with the phone, and go back to where it last worked.",
    )
    ARRIVED = (
        "arrived",
        "the end of the route is reached",
        "Say so; send `end`, or go on if the person walks on.",
    )


class InstructionCode(Code):
    """``guidance.instruction`` of an update: what the follower does now."""

    STRAIGHT = "straight", "the bearing is within 20 degrees", "Go straight on."
    LEFT = "left", "the bearing is to the left (positive)", "Turn left until it says `straight`."
    RIGHT = "right", "the bearing is to the right (negative)", "Turn right until it says `straight`."
    TURN_AROUND = "turn_around", "the bearing is beyond 130 degrees on either side", "Turn around."
    ARRIVED = "arrived", "the end of the route is reached", "You have arrived."


class RefusalCode(Code):
    """``refusal.reason`` of an update: why a picture has no pose."""

    TOO_FEW_FEATURES = (
        "too_few_features",
        "the picture shows too little: a blank wall, the floor, darkness, motion blur, a covered lens",
        "“Hold the phone up, pointing forward.” In the dark: “It is too dark here.”",
    )
    NO_SIMILAR_PLACE = (
        "no_similar_place",
        "nothing on the route looks like this",
        "“Look along the way.” While `searching`: “Turn slowly.” While `lost`: “Go back a few steps.”",
    )
    TOO_FEW_INLIERS = (
        "too_few_inliers",
        "a place looked alike, but too little of it agrees with one camera position",
        "Nothing for a moment; after a second “Hold the phone still and point it forward.”",
    )
    AMBIGUOUS = (
        "ambiguous",
        "several places or poses explain the picture about equally well",
        "“Look around slowly”: another view tells them apart.",
    )


class WeakStretchCode(Code):
    """``reason`` of a weak stretch in a quality report."""

    TOO_DARK = "too_dark", "too little light", "Switch the light on, or film by day."
    TOO_BRIGHT = "too_bright", "large parts are blinded white", "Do not film against windows and lamps."
    LENS_COVERED = "lens_covered", "something was before the lens", "Keep fingers and straps away from it."
    BLANK_WALL = "blank_wall", "bare walls, or nothing with detail", "Let the camera look along the way."
    BLURRED = "blurred", "the pictures are blurred", "Hold the phone more still, walk more slowly."
    TOO_FAST = "too_fast", "the phone was turned too fast", "Walk round corners in an arc."
    TOO_MUCH_MOTION = "too_much_motion", "people or things passed by", "Film at a quiet hour."
    LOST = (
        "lost",
        "the camera could not be followed, for no reason that the pictures show",
        "Walk slowly there.",
    )


class ScaleSourceCode(Code):
    """``scale_source`` of a map: what told how long its unit is in metres."""

    UNKNOWN = "unknown", "nothing did: every length in metres is null", "Speak of time, never of metres."
    MEASURED_LENGTH = "measured_length", "the length that the leader gave with the route"


class BuildStageCode(Code):
    """``build.stage`` of a route."""

    QUEUED = "queued", "waiting for a build before it"
    STARTING = "starting", "its process starts"
    DECODING = "decoding", "the video is opened"
    CALIBRATING = "calibrating", "no camera was sent: its lens is found out from the first of the walk"
    TRACKING = "tracking", "the camera is followed through the video; most of the time goes here"
    CLOSING = "closing", "places seen twice are recognised"
    REFINING = "refining", "the whole walk is adjusted at once"
    FINISHING = "finishing", "the map is put together"
    FINISHED = "finished", "it has ended"


class FailureCode(Code):
    """``failure.reason`` of a route: why there is no map."""

    NOT_A_VIDEO = (
        "not_a_video",
        "the file is empty, damaged, no video, or larger than 8K",
        "Open the file on the phone: if it plays, upload it once more, as MP4.",
    )
    CAMERA_MISMATCH = (
        "camera_mismatch",
        "the camera is described for pictures of another shape than the video's",
        "Send the camera of this video; mind width and height, and zoom or stabilisation that crops.",
    )
    TOO_SHORT = (
        "too_short",
        "fewer usable frames than a walk needs",
        "Film the whole way.",
    )
    TOO_LONG = "too_long", "the video lasts longer than is taken", "Divide the way into two routes."
    NO_TEXTURE = (
        "no_texture",
        "the pictures show too little to go by: blank walls, darkness, a covered lens",
        "Switch the light on, keep shelves, doors, posters or furniture in view, wipe the lens.",
    )
    NO_MOTION = (
        "no_motion",
        "the camera hardly moved",
        "Walk while filming: turning on the spot is not enough.",
    )
    TRACKING_LOST = (
        "tracking_lost",
        "the camera could not be followed all the way; `detail` says from which second to which",
        "Walk more slowly there, turn in an arc rather than on the spot, keep the phone up.",
    )
    TIMED_OUT = (
        "timed_out",
        "the build took longer than allowed",
        "Tell the operator; try a shorter way.",
    )
    OUT_OF_MEMORY = (
        "out_of_memory",
        "the build needed more memory than it may take",
        "Film in a lower resolution, or divide the way into two routes.",
    )
    BUILD_PROCESS_DIED = (
        "build_process_died",
        "the build's process ended unexpectedly; the video may be damaged",
        "Upload once more; if it happens again, tell the operator.",
    )
    GAVE_UP = (
        "gave_up",
        "the build was begun again and again and never ended",
        "Tell the operator: the service was restarted in the middle, or cannot bear this video.",
    )
    VIDEO_MISSING = "video_missing", "the stored video is gone", "Upload it again."
    STORAGE_FAILED = (
        "storage_failed",
        "the finished map could not be stored",
        "Tell the operator: the disk may be full. Then upload again.",
    )


def known(codes: type[Code]) -> Any:
    """Annotation of a string field: its values are these, and later versions may add some."""
    return Field(json_schema_extra={"x-extensible-enum": [str(code) for code in codes]})
