from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from server.protocol.frames import (
    HEADER,
    MAX_CAPTURE_TIME_US,
    MAX_SEQUENCE,
    Frame,
    FrameHeaderError,
    FrameVersionError,
    decode_frame,
    encode_frame,
)

frames = st.builds(
    Frame,
    sequence=st.integers(0, MAX_SEQUENCE),
    capture_time_us=st.integers(0, MAX_CAPTURE_TIME_US),
    payload=st.binary(max_size=64),
    type=st.integers(0, 255),
    flags=st.integers(0, 65535),
)


def test_the_header_is_laid_out_as_documented() -> None:
    frame = Frame(sequence=0x01020304, capture_time_us=0x05060708090A, payload=b"\xff\xd8\xff")
    assert encode_frame(frame) == bytes.fromhex(
        "504e"  # magic
        "01"  # version
        "01"  # type
        "0000"  # flags
        "0000"  # reserved
        "01020304"  # sequence
        "000005060708090a"  # capture time
        "00000003"  # payload length
        "ffd8ff"
    )
    assert HEADER.size == 24


@given(frames)
def test_what_is_encoded_is_decoded(frame: Frame) -> None:
    assert decode_frame(encode_frame(frame)) == frame


@given(st.binary(max_size=80))
def test_no_bytes_do_worse_than_a_header_error(message: bytes) -> None:
    try:
        frame = decode_frame(message)
    except FrameHeaderError:
        return
    assert len(frame.payload) == len(message) - HEADER.size


@given(frames, st.integers(0, 23))
def test_a_truncated_header_is_refused(frame: Frame, length: int) -> None:
    with pytest.raises(FrameHeaderError):
        decode_frame(encode_frame(frame)[:length])


def test_other_versions_lengths_and_magics_are_refused() -> None:
    message = encode_frame(Frame(1, 2, b"abc"))
    with pytest.raises(FrameVersionError, match="version 2"):
        decode_frame(message[:2] + b"\x02" + message[3:])
    with pytest.raises(FrameHeaderError, match="promises 3 bytes of payload, 2 follow"):
        decode_frame(message[:-1])
    with pytest.raises(FrameHeaderError, match="promises 3"):
        decode_frame(message + b"x")
    with pytest.raises(FrameHeaderError, match="PN"):
        decode_frame(b"XX" + message[2:])


@pytest.mark.parametrize(
    "frame",
    [Frame(-1, 0, b""), Frame(MAX_SEQUENCE + 1, 0, b""), Frame(0, -1, b""), Frame(0, 2**53 + 1, b"")],
)
def test_numbers_that_do_not_fit_are_not_sent(frame: Frame) -> None:
    with pytest.raises(ValueError, match="fit"):
        encode_frame(frame)


def test_reserved_bytes_and_flags_are_ignored() -> None:
    message = bytearray(encode_frame(Frame(1, 2, b"abc")))
    message[4:8] = b"\xff\xff\xff\xff"
    assert decode_frame(bytes(message)).payload == b"abc"
