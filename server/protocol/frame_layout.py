"""The bytes of a binary message, field by field, for specifications and their readers."""

from __future__ import annotations

from dataclasses import dataclass

from server.protocol.frames import FRAME_VERSION, HEADER, MAGIC, MAX_CAPTURE_TIME_US, FrameType


@dataclass(frozen=True, slots=True)
class HeaderField:
    """A field of the header.

    Attributes:
        size: bytes; all numbers are unsigned, big-endian.
        meaning: what to send, and what the service does with it.
    """

    name: str
    size: int
    meaning: str


HEADER_FIELDS = (
    HeaderField("magic", 2, f"ASCII `{MAGIC.decode()}`"),
    HeaderField("version", 1, f"{FRAME_VERSION}"),
    HeaderField(
        "type",
        1,
        f"{FrameType.JPEG.value} = a JPEG picture; others are answered with `unsupported_frame_type`",
    ),
    HeaderField("flags", 2, "none defined: send 0; ignored"),
    HeaderField("reserved", 2, "send 0; ignored"),
    HeaderField("sequence", 4, "increasing within a session"),
    HeaderField(
        "capture_time_us",
        8,
        f"microseconds of the phone's clock when the picture was taken, at most 2^"
        f"{MAX_CAPTURE_TIME_US.bit_length() - 1}; never less than the picture's before",
    ),
    HeaderField("payload_length", 4, "bytes; exactly what follows"),
)


def header_offsets() -> tuple[int, ...]:
    """Where each field begins, bytes.

    Raises:
        ValueError: the fields are not those of the header that is sent.
    """
    sizes = [field.size for field in HEADER_FIELDS]
    if sum(sizes) != HEADER.size:
        raise ValueError(f"the fields have {sum(sizes)} bytes, the header {HEADER.size}")
    return tuple(sum(sizes[:index]) for index in range(len(sizes)))
