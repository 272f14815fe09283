"""Cameras as they come from outside."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from server.geometry.cameras import Camera, InvalidCameraError, Rectifier
from server.services.errors import CameraInvalidError


def usable_camera(description: Mapping[str, Any], orientation: int = 0) -> Camera:
    """The camera of a description, tried out as mapping and navigation will use it.

    Takes some 20 ms where there is distortion.

    Args:
        orientation: degrees clockwise by which its pictures have to be turned to stand upright.

    Raises:
        CameraInvalidError: no real camera fits the description, or its pictures cannot be rectified.
    """
    try:
        camera = Camera.from_json(description)
        Rectifier(camera.rotated(orientation // 90))
    except InvalidCameraError as error:
        raise CameraInvalidError(str(error)) from None
    return camera
