from __future__ import annotations

import pytest

from server.geometry.cameras import Camera, InvalidCameraError
from server.services import cameras
from server.services.errors import CameraInvalidError

CAMERA = {"model": "PINHOLE", "width": 640, "height": 480, "params": [500.0, 501.0, 310.0, 250.0]}


def test_a_usable_camera_is_the_one_described() -> None:
    assert cameras.usable_camera(CAMERA, 90).to_json() == CAMERA


@pytest.mark.parametrize("orientation", [0, 90])
def test_a_camera_that_cannot_be_rectified_is_refused(
    monkeypatch: pytest.MonkeyPatch, orientation: int
) -> None:
    tried: list[tuple[int, int]] = []

    def rectifier(camera: Camera) -> None:
        tried.append((camera.width, camera.height))
        raise InvalidCameraError("scaled down, it is none")

    monkeypatch.setattr(cameras, "Rectifier", rectifier)
    with pytest.raises(CameraInvalidError, match="scaled down"):
        cameras.usable_camera(CAMERA, orientation)
    assert tried == [(640, 480) if orientation == 0 else (480, 640)]
