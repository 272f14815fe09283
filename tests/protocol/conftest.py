from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
import pytest
from demo_route import DemoRoute
from numpy.typing import NDArray


def jpeg(image: NDArray[np.uint8]) -> bytes:
    """A picture (H, W) or (H, W, 3) as a phone sends it."""
    return cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 85])[1].tobytes()


@pytest.fixture(scope="session")
def follower_jpeg(demo_route: DemoRoute) -> Callable[[int | None], bytes]:
    """Frames of the demo's follower as JPEG, by their index; a grey one for None."""
    reader = cv2.VideoCapture(str(demo_route.follower.video))
    pictures: dict[int | None, bytes] = {None: jpeg(np.full((480, 640), 128, np.uint8))}
    while len(pictures) <= 40 and reader.grab():
        done, image = reader.retrieve()
        assert done
        pictures[len(pictures) - 1] = jpeg(image)
    reader.release()
    return pictures.__getitem__
