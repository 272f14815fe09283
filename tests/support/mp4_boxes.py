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


def repeat(video: Path, frames: int, ticks: int) -> None:
    """Name the first frame's bytes ``frames`` times, each shown for ``ticks`` of the media's clock."""
    data = video.read_bytes()
    start = data.index(b"mdat") + 4
    size = struct.unpack_from(">I", data, start - 8)[0] - 8
    chunks = struct.pack(">2I", 0, frames) + struct.pack(">I", start) * frames
    leaves = {
        b"stts": struct.pack(">4I", 0, 1, frames, ticks),
        b"stsc": struct.pack(">5I", 0, 1, 1, 1, 1),
        b"stsz": struct.pack(">3I", 0, size, frames),
        b"stco": chunks,
        b"stss": struct.pack(">2I", 0, 0),
    }
    video.write_bytes(_replaced(data, leaves, min(frames * ticks, 2**32 - 1), _timescale(data)))


def declare_size(video: Path, width: int, height: int) -> None:
    """Claim another picture size in the sample description and the track header."""
    data = bytearray(video.read_bytes())
    entry = data.index(b"mp4v", data.index(b"stsd")) + 4
    struct.pack_into(">2H", data, entry + 24, width, height)
    header = data.index(b"tkhd") - 4
    end = header + struct.unpack_from(">I", data, header)[0]
    struct.pack_into(">2I", data, end - 8, width << 16 & 0xFFFFFFFF, height << 16 & 0xFFFFFFFF)
    video.write_bytes(data)


def add_tracks(video: Path, copies: int) -> None:
    """Repeat the (only) track. The movie's header must come after its frames."""
    data = video.read_bytes()
    moov = data.index(b"moov") - 4
    size = struct.unpack_from(">I", data, moov)[0]
    trak = data.index(b"trak", moov) - 4
    end = trak + struct.unpack_from(">I", data, trak)[0]
    track = data[trak:end]
    larger = struct.pack(">I", size + copies * len(track))
    video.write_bytes(data[:moov] + larger + data[moov + 4 : end] + track * copies + data[end:])


def as_audio(video: Path) -> None:
    """Call the (only) track a sound track."""
    data = bytearray(video.read_bytes())
    at = data.index(b"vide", data.index(b"hdlr"))
    data[at : at + 4] = b"soun"
    video.write_bytes(data)


def edit_list(video: Path, entries: Sequence[tuple[int, int]]) -> None:
    """Have the movie shown as (duration, begin in the media) pairs say, ticks of their clocks."""
    data = video.read_bytes()
    at = data.index(b"elst") - 4
    size = struct.unpack_from(">I", data, at)[0]
    edts = data.rindex(b"edts", 0, at + 4) - 4
    content = struct.pack(">2I", 0, len(entries)) + b"".join(
        struct.pack(">IiI", duration, begin, 1 << 16) for duration, begin in entries
    )
    box = struct.pack(">I", len(content) + 8) + b"elst" + content
    grown = len(box) - size
    edited = bytearray(data[:at] + box + data[at + size :])
    for outer in (edts, data.rindex(b"trak", 0, edts) - 4, data.rindex(b"moov", 0, edts) - 4):
        struct.pack_into(">I", edited, outer, struct.unpack_from(">I", edited, outer)[0] + grown)
    video.write_bytes(edited)


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
