"""A follower's bytes: pictures are decoded, anything else is refused before it costs anything."""

from __future__ import annotations

import contextlib
import resource
import struct
import time

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from server.navigation.frames import MAX_PIXELS, BadFrameError, decode_frame, jpeg_size


def _jpeg(width: int, height: int, *flags: int, channels: int = 3) -> bytes:
    rng = np.random.default_rng(width * height)
    small = rng.integers(0, 256, (8, 8, channels), np.uint8)
    done, data = cv2.imencode(".jpg", cv2.resize(small, (width, height)), list(flags))
    assert done
    return data.tobytes()


def _exif(jpeg: bytes, orientation: int) -> bytes:
    """With an EXIF block that says how the picture is to be turned."""
    tiff = struct.pack(">2sHIHHHIHHI", b"MM", 42, 8, 1, 0x0112, 3, 1, orientation, 0, 0)
    block = b"Exif\0\0" + tiff
    return jpeg[:2] + b"\xff\xe1" + struct.pack(">H", len(block) + 2) + block + jpeg[2:]


def _claiming(jpeg: bytes, width: int, height: int) -> bytes:
    """With another size in its frame header."""
    at = jpeg.index(b"\xff\xc0")
    return jpeg[: at + 5] + struct.pack(">HH", height, width) + jpeg[at + 9 :]


@pytest.mark.parametrize("size", [(640, 480), (480, 640), (17, 33), (1920, 1080), (99, 16)])
@pytest.mark.parametrize(
    "flags",
    [
        (),
        (cv2.IMWRITE_JPEG_QUALITY, 10),
        (cv2.IMWRITE_JPEG_PROGRESSIVE, 1),
        (cv2.IMWRITE_JPEG_OPTIMIZE, 1, cv2.IMWRITE_JPEG_RST_INTERVAL, 4),
    ],
)
def test_the_size_is_what_opencv_reads(size: tuple[int, int], flags: tuple[int, ...]) -> None:
    data = _jpeg(*size, *flags)
    expected = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_GRAYSCALE)
    assert jpeg_size(data) == size == expected.shape[::-1]
    np.testing.assert_array_equal(decode_frame(data), expected)


def test_a_grey_jpeg_is_a_frame_too() -> None:
    done, data = cv2.imencode(".jpg", np.full((48, 64), 77, np.uint8))
    assert done
    image = decode_frame(data.tobytes())
    assert image.shape == (48, 64)
    assert abs(float(image.mean()) - 77) < 2


def test_metadata_before_the_picture_is_skipped() -> None:
    data = _jpeg(64, 48)
    thumbnail = _jpeg(160, 120)
    block = b"\xff\xe2" + struct.pack(">H", len(thumbnail) + 2) + thumbnail
    comment = b"\xff\xff\xff\xfe\x00\x06abcd"
    assert jpeg_size(data[:2] + block + comment + data[2:]) == (64, 48)


@pytest.mark.parametrize("orientation", [1, 3, 6, 8])
def test_an_exif_orientation_does_not_turn_the_picture(orientation: int) -> None:
    """The phone tells its orientation once; a picture that says so again must not be turned twice."""
    data = _jpeg(64, 48)
    np.testing.assert_array_equal(decode_frame(_exif(data, orientation)), decode_frame(data))


@pytest.mark.parametrize(
    "payload",
    [
        b"",
        b"\xff",
        b"\xff\xd8",
        b"\xff\xd8\xff",
        b"\xff\xd8" + b"\xff" * 1000,
        b"\xff\xd8\xff\xd9",
        b"\xff\xd8\xff\xe0\x00\x00" * 3,
        b"\xff\xd8" + b"\x00" * 100,
        b"\x89PNG\r\n\x1a\n" + b"\0" * 100,
        b"GIF89a" + b"\0" * 100,
        b"hello, this is no picture at all",
    ],
)
def test_what_is_no_jpeg_is_refused(payload: bytes) -> None:
    with pytest.raises(BadFrameError):
        jpeg_size(payload)
    with pytest.raises(BadFrameError):
        decode_frame(payload)


def test_a_png_in_place_of_a_jpeg_is_refused() -> None:
    _, data = cv2.imencode(".png", np.zeros((48, 64), np.uint8))
    with pytest.raises(BadFrameError, match="no JPEG"):
        decode_frame(data.tobytes())


def test_a_jpeg_cut_in_its_headers_is_refused() -> None:
    data = _jpeg(64, 48)
    for length in range(data.index(b"\xff\xda")):
        with pytest.raises(BadFrameError):
            decode_frame(data[:length])


def test_damage_anywhere_is_a_picture_or_a_refusal_never_another_error() -> None:
    data = _jpeg(64, 48)
    rng = np.random.default_rng(1)
    refused = 0
    for _ in range(400):
        damaged = bytearray(data)
        for at in rng.integers(2, len(data), 3):
            damaged[at] = int(rng.integers(256))
        try:
            image = decode_frame(bytes(damaged))
        except BadFrameError:
            refused += 1
            continue
        assert image.ndim == 2
        assert image.dtype == np.uint8
        assert image.size <= MAX_PIXELS
    assert 20 < refused < 400


def test_a_bomb_is_refused_before_it_is_decoded() -> None:
    """A few hundred bytes that claim 65,000 x 65,000 pixels: 4 GB if anybody believed them."""
    bomb = _claiming(_jpeg(64, 48), 65_000, 65_000)
    assert jpeg_size(bomb) == (65_000, 65_000)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(BadFrameError, match="65000x65000"):
        decode_frame(bomb)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 50_000


def test_the_limit_of_pixels_is_exact() -> None:
    data = _jpeg(64, 48)
    assert decode_frame(data, max_pixels=64 * 48).shape == (48, 64)
    with pytest.raises(BadFrameError):
        decode_frame(data, max_pixels=64 * 48 - 1)


def test_a_later_header_cannot_smuggle_a_larger_picture_in() -> None:
    """Two frame headers, the first one small: what is decoded may not be larger than was allowed."""
    data = _jpeg(64, 48)
    at = data.index(b"\xff\xc0")
    length = struct.unpack_from(">H", data, at + 2)[0]
    header = data[at : at + 2 + length]
    large = header[:5] + struct.pack(">HH", 30_000, 30_000) + header[9:]
    try:
        image = decode_frame(data[: at + 2 + length] + large + data[at + 2 + length :])
    except BadFrameError:
        return
    assert image.size <= MAX_PIXELS


@pytest.mark.parametrize("size", [(0, 48), (64, 0), (15, 48), (64, 15)])
def test_a_picture_without_a_usable_size_is_refused(size: tuple[int, int]) -> None:
    with pytest.raises(BadFrameError):
        decode_frame(_claiming(_jpeg(64, 48), *size))


@pytest.mark.parametrize("side", [64, 4000])
def test_a_picture_of_endless_scans_is_refused_before_it_is_decoded(side: int) -> None:
    """A progressive JPEG may repeat a scan of a few bytes that passes over every block of the picture."""
    grey = np.full((side, side), 128, np.uint8)
    done, encoded = cv2.imencode(".jpg", grey, [cv2.IMWRITE_JPEG_PROGRESSIVE, 1])
    assert done
    data = encoded.tobytes()
    assert decode_frame(data).shape == (side, side)
    last = data[data.rindex(b"\xff\xda") : -2]
    bomb = data[:-2] + last * 1_000 + b"\xff\xd9"
    before = time.process_time()
    with pytest.raises(BadFrameError, match="scans"):
        decode_frame(bomb)
    assert time.process_time() - before < 0.1


@pytest.mark.parametrize("extension", [".png", ".webp", ".bmp", ".tiff", ".jp2", ".gif"])
def test_pictures_of_other_formats_are_refused(extension: str) -> None:
    done, data = cv2.imencode(extension, np.full((48, 64, 3), 77, np.uint8))
    assert done
    with pytest.raises(BadFrameError, match="no JPEG"):
        decode_frame(data.tobytes())


def test_a_heic_is_refused() -> None:
    with pytest.raises(BadFrameError, match="no JPEG"):
        decode_frame(b"\0\0\0\x18ftypheic\0\0\0\0mif1heic" + bytes(500))


def test_four_colour_pictures_are_read_or_refused() -> None:
    """CMYK, as printers have it: three components become four by name only, so the data cannot fit."""
    data = _jpeg(64, 48)
    at = data.index(b"\xff\xc0")
    length = struct.unpack_from(">H", data, at + 2)[0]
    header = data[at : at + 2 + length]
    four = header[:2] + struct.pack(">H", length + 3) + header[4:9] + b"\x04" + header[10:] + b"\x04\x11\x00"
    with contextlib.suppress(BadFrameError):
        assert decode_frame(data[:at] + four + data[at + 2 + length :]).shape == (48, 64)


@pytest.mark.parametrize("size", [(65535, 65535), (65535, 16), (16, 65535), (16384, 16384)])
def test_the_largest_sizes_of_the_format_are_decided_by_their_pixels(size: tuple[int, int]) -> None:
    claimed = _claiming(_jpeg(64, 48), *size)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    if size[0] * size[1] > MAX_PIXELS:
        with pytest.raises(BadFrameError, match="at most"):
            decode_frame(claimed)
    else:
        with contextlib.suppress(BadFrameError):
            assert decode_frame(claimed).shape == size[::-1]
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 50_000


@settings(max_examples=150, derandomize=True, deadline=None)
@given(st.data())
def test_no_bytes_do_worse_than_a_refusal(data: st.DataObject) -> None:
    """Cut, spliced and overwritten pictures."""
    picture = bytearray(PICTURES[data.draw(st.integers(0, len(PICTURES) - 1))])
    for _ in range(data.draw(st.integers(0, 6))):
        at = data.draw(st.integers(0, len(picture)))
        picture[at : at + data.draw(st.integers(0, 40))] = data.draw(
            st.sampled_from([b"", b"\xff", b"\xff\xd8", b"\xff\xda", b"\xff\xc0", b"\xff\xc2", b"\0" * 9])
            | st.binary(max_size=20)
        )
    try:
        image = decode_frame(bytes(picture))
    except BadFrameError:
        return
    assert image.ndim == 2
    assert image.size <= MAX_PIXELS


PICTURES = (
    _jpeg(64, 48),
    _jpeg(33, 17, cv2.IMWRITE_JPEG_PROGRESSIVE, 1),
    _jpeg(64, 48, channels=1),
    b"",
    b"\xff\xd8",
)
