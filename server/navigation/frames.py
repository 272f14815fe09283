"""Decoding of a follower's frame: untrusted bytes to a grey image."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

MAX_PIXELS = 16_000_000
"""Largest picture taken unless told otherwise. A phone sends far less; a bomb claims far more."""

MAX_SCANS = 32
"""Scans of one picture. Encoders write up to about a dozen; each costs a pass over all the picture's blocks,
however few its bytes."""

_START_OF_SCAN = b"\xff\xda"


class BadFrameError(ValueError):
    """The bytes are no JPEG picture that can be used."""


def jpeg_size(payload: bytes) -> tuple[int, int]:
    """Width and height that a JPEG's frame header claims (ITU-T T.81, B.2.2).

    Raises:
        BadFrameError: no JPEG, or no frame header in it.
    """
    if payload[:2] != b"\xff\xd8":
        raise BadFrameError("the frame is no JPEG")
    at = 2
    while at + 9 <= len(payload):
        if payload[at] != 0xFF:
            raise BadFrameError("the frame is a damaged JPEG")
        marker = payload[at + 1]
        if marker == 0xFF:
            at += 1
            continue
        if 0xC0 <= marker <= 0xCF and marker not in (0xC4, 0xC8, 0xCC):
            height = int.from_bytes(payload[at + 5 : at + 7])
            width = int.from_bytes(payload[at + 7 : at + 9])
            return width, height
        if marker == 0x01 or 0xD0 <= marker <= 0xD7:
            at += 2
            continue
        at += 2 + int.from_bytes(payload[at + 2 : at + 4])
    raise BadFrameError("the frame is a JPEG without a picture")


def decode_frame(payload: bytes, *, max_pixels: int = MAX_PIXELS) -> NDArray[np.uint8]:
    """Grey image (H, W) of a JPEG as its pixels lie: an EXIF orientation is not looked at.

    Size and scans are looked at before anything is decoded, so that few bytes can take neither much memory
    nor much time.

    Raises:
        BadFrameError: no JPEG, damaged, larger than ``max_pixels``, or of more than ``MAX_SCANS`` scans.
    """
    width, height = jpeg_size(payload)
    if not (width >= 16 and height >= 16 and width * height <= max_pixels):
        raise BadFrameError(f"a frame of {width}x{height} pixels is not taken; at most {max_pixels} pixels")
    # Within a scan's data a 0xFF is followed by a zero (T.81, B.1.1.5): no scan begins without these bytes.
    if payload.count(_START_OF_SCAN) > MAX_SCANS:
        raise BadFrameError(f"a JPEG of more than {MAX_SCANS} scans is not taken; send a baseline one")
    try:
        image = cv2.imdecode(
            np.frombuffer(payload, np.uint8), cv2.IMREAD_GRAYSCALE | cv2.IMREAD_IGNORE_ORIENTATION
        )
    except cv2.error:
        image = None
    if image is None:
        raise BadFrameError("the JPEG cannot be decoded")
    return np.asarray(image, dtype=np.uint8)
