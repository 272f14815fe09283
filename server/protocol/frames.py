"""Binary messages of the navigation socket: a fixed header and a payload.

The header has 24 bytes, big-endian (network order):

====== ==== ============== =================================================================
offset size field          meaning
====== ==== ============== =================================================================
0      2    magic          ASCII ``PN``
2      1    version        1
3      1    type           1 = a JPEG picture
4      2    flags          none defined: sent as 0, ignored when read
6      2    reserved       sent as 0, ignored when read
8      4    sequence       unsigned, increasing from frame to frame of a session
12     8    capture time   unsigned, microseconds of the phone's clock when the picture was taken
20     4    payload length unsigned, bytes that follow
====== ==== ============== =================================================================
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from enum import IntEnum

FRAME_VERSION = 1
HEADER = struct.Struct("!2sBBHHIQI")
MAGIC = b"PN"
MAX_SEQUENCE = 2**32 - 1
MAX_CAPTURE_TIME_US = 2**53
"""Microseconds; the largest a JSON number echoes exactly."""


class FrameType(IntEnum):
    """What the payload is."""

    JPEG = 1


class FrameHeaderError(ValueError):
    """A binary message without a valid header; what follows in the stream cannot be trusted."""


class FrameVersionError(FrameHeaderError):
    """The header is of a version this service does not speak."""


@dataclass(frozen=True, slots=True)
class Frame:
    """A binary message.

    Attributes:
        sequence: 0 to 2^32 - 1.
        capture_time_us: microseconds on the phone's clock, 0 to 2^53.
        payload: the picture.
        type: kept as a number: a type this version does not know is refused by its receiver, not here.
    """

    sequence: int
    capture_time_us: int
    payload: bytes
    type: int = FrameType.JPEG
    flags: int = 0

    @property
    def capture_time(self) -> float:
        """Seconds on the phone's clock."""
        return self.capture_time_us / 1e6


def encode_frame(frame: Frame) -> bytes:
    """The message's bytes.

    Raises:
        ValueError: a number does not fit its field.
    """
    if not 0 <= frame.capture_time_us <= MAX_CAPTURE_TIME_US:
        raise ValueError(f"capture time of {frame.capture_time_us} us does not fit")
    try:
        header = HEADER.pack(
            MAGIC,
            FRAME_VERSION,
            frame.type,
            frame.flags,
            0,
            frame.sequence,
            frame.capture_time_us,
            len(frame.payload),
        )
    except struct.error as error:
        raise ValueError(f"frame does not fit its header: {error}") from None
    return header + frame.payload


def decode_frame(message: bytes) -> Frame:
    """Parse a message.

    Raises:
        FrameVersionError: the magic is right and the version is not.
        FrameHeaderError: too short, no magic, or the length does not fit the message.
    """
    if len(message) < HEADER.size:
        raise FrameHeaderError(f"{len(message)} bytes; the header alone has {HEADER.size}")
    magic, version, kind, flags, _, sequence, capture_time_us, length = HEADER.unpack_from(message)
    if magic != MAGIC:
        raise FrameHeaderError("the message does not begin with 'PN'")
    if version != FRAME_VERSION:
        raise FrameVersionError(f"frame version {version}; this service speaks {FRAME_VERSION}")
    if length != len(message) - HEADER.size:
        raise FrameHeaderError(
            f"the header promises {length} bytes of payload, {len(message) - HEADER.size} follow"
        )
    if capture_time_us > MAX_CAPTURE_TIME_US:
        raise FrameHeaderError("the capture time is beyond 2^53 microseconds")
    return Frame(sequence, capture_time_us, message[HEADER.size :], kind, flags)
