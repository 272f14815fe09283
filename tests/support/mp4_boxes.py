"""Changes to MP4 files that no encoder at hand can author: rotation, uneven frame times.

Box layout after ISO/IEC 14496-12: 4 bytes size, 4 bytes type, content.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from pathlib import Path

_QUARTER_TURNS = {
    0: (1, 0, 0, 1),
    1: (0, 1, -1, 0),
    2: (-1, 0, 0, -1),
    3: (0, -1, 1, 0),
}
"""Coefficients a, b, c, d of a track's matrix, by clockwise quarter turns from stored to shown."""


def rotate(video: Path, quarter_turns: int) -> None:
    """Say in the video's track header that it is to be shown turned clockwise."""
    data = bytearray(video.read_bytes())
    at = data.index(b"tkhd") + 4
    version = data[at]
    # Version and flags, times, track, reserved, duration, reserved, layer, group, volume, reserved.
    matrix = at + (4 + 32 if version == 1 else 4 + 20) + 8 + 8
    a, b, c, d = (value << 16 for value in _QUARTER_TURNS[quarter_turns])
    struct.pack_into(">9i", data, matrix, a, b, 0, c, d, 0, 0, 0, 1 << 30)
    video.write_bytes(data)


def retime(video: Path, milliseconds: Sequence[int]) -> None:
    """Give every frame of a video its own duration, the last one included.

    The movie's header must come after its frames, as OpenCV writes it.
    """
    data = video.read_bytes()
    timescale = _timescale(data)
    entries = b"".join(struct.pack(">2I", 1, round(ms * timescale / 1000)) for ms in milliseconds)
    content = struct.pack(">2I", 0, len(milliseconds)) + entries
    total = sum(round(ms * timescale / 1000) for ms in milliseconds)
    video.write_bytes(_replaced(data, {b"stts": content}, total, timescale))


_CONTAINERS = (b"moov", b"trak", b"mdia", b"minf", b"stbl")


def _timescale(data: bytes) -> int:
    """Ticks a second of the (only) track's media."""
    at = data.index(b"mdhd") + 4
    return int(struct.unpack_from(">I", data, at + (20 if data[at] == 1 else 12))[0])


def _replaced(data: bytes, leaves: dict[bytes, bytes], duration: int, timescale: int) -> bytes:
    out, at = b"", 0
    while at < len(data):
        size = struct.unpack_from(">I", data, at)[0] or len(data) - at
        kind, content = data[at + 4 : at + 8], data[at + 8 : at + size]
        if kind in _CONTAINERS:
            content = _replaced(content, leaves, duration, timescale)
        elif kind == b"mdhd":
            assert content[0] == 0, "written by a muxer that uses 64-bit times"
            content = content[:16] + struct.pack(">I", duration) + content[20:]
        content = leaves.get(kind, content)
        # An edit list would cut the movie at its old length.
        if kind != b"edts":
            out += struct.pack(">I", len(content) + 8) + kind + content
        at += size
    return out
