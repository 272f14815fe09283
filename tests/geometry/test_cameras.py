"""Cameras against OpenCV, and the images that rectification gives."""

from __future__ import annotations

import json
import math

import cv2
import numpy as np
import pytest

from server.geometry.cameras import (
    Camera,
    CameraModel,
    InvalidCameraError,
    Rectifier,
    opencv_matrix,
    working_size,
)

PHONE = Camera(CameraModel.OPENCV, 640, 480, (520.0, 530.0, 310.5, 247.0, 0.11, -0.23, 0.004, -0.006))
PINHOLE = Camera.pinhole(640, 480, 520.0, 530.0, 310.5, 247.0)
CAMERAS = {
    "pinhole": PINHOLE,
    "simple_pinhole": Camera(CameraModel.SIMPLE_PINHOLE, 640, 480, (520.0, 310.5, 247.0)),
    "simple_radial": Camera(CameraModel.SIMPLE_RADIAL, 640, 480, (520.0, 310.5, 247.0, -0.13)),
    "radial": Camera(CameraModel.RADIAL, 640, 480, (520.0, 310.5, 247.0, -0.21, 0.07)),
    "opencv": PHONE,
    "fisheye": Camera(
        CameraModel.OPENCV_FISHEYE, 640, 480, (330.0, 335.0, 310.5, 247.0, 0.04, -0.02, 0.01, -0.003)
    ),
}
every_model = pytest.mark.parametrize("camera", list(CAMERAS.values()), ids=list(CAMERAS))


def _points(rng: np.random.Generator, count: int = 200) -> np.ndarray:
    """Camera-frame points all over the view."""
    depth = rng.uniform(0.5, 20.0, count)
    return (
        np.column_stack([rng.uniform(-0.55, 0.55, count), rng.uniform(-0.42, 0.42, count), np.ones(count)])
        * (depth[:, None])
    )


def _opencv_projection(camera: Camera, points: np.ndarray) -> np.ndarray:
    k = (*camera.distortion, 0.0, 0.0, 0.0, 0.0)[:4]
    project = cv2.fisheye.projectPoints if camera.model is CameraModel.OPENCV_FISHEYE else cv2.projectPoints
    if camera.model is CameraModel.OPENCV_FISHEYE:
        pixels, _ = project(points[:, None], np.zeros(3), np.zeros(3), opencv_matrix(camera), np.array(k))
        return np.asarray(pixels[:, 0])
    pixels, _ = project(points, np.zeros(3), np.zeros(3), opencv_matrix(camera), np.array(k))
    return np.asarray(pixels[:, 0])


@every_model
def test_projection_is_opencv_s_half_a_pixel_on(camera: Camera) -> None:
    points = _points(np.random.default_rng(1))
    np.testing.assert_allclose(camera.project(points), _opencv_projection(camera, points) + 0.5, atol=1e-9)
    assert camera.project(points.reshape(4, 50, 3)).shape == (4, 50, 2)


@every_model
def test_normalized_pixels_are_rays(camera: Camera) -> None:
    points = _points(np.random.default_rng(2))
    rays = points[:, :2] / points[:, 2:]
    np.testing.assert_allclose(camera.normalize(camera.project(points)), rays, atol=1e-7)
    np.testing.assert_allclose(camera.project_rays(rays), camera.project(points), atol=1e-9)
    straight = camera.straightened(camera.project(points).reshape(4, 50, 2)).reshape(-1, 2)
    np.testing.assert_allclose(straight, camera.pinhole_part().project(points), atol=1e-4)


@every_model
def test_every_model_passes_its_own_check_and_survives_json(camera: Camera) -> None:
    camera.check()
    assert Camera.from_json(json.loads(json.dumps(camera.to_json()))) == camera


@pytest.mark.parametrize(
    "camera",
    [
        Camera(CameraModel.SIMPLE_RADIAL, 640, 480, (400.0, 320.0, 240.0, -0.9)),
        Camera(CameraModel.RADIAL, 640, 480, (400.0, 320.0, 240.0, 0.2, -1.5)),
        Camera(CameraModel.OPENCV_FISHEYE, 640, 480, (200.0, 200.0, 320.0, 240.0, -0.5, 0.0, 0.0, 0.0)),
    ],
)
def test_a_lens_that_folds_the_image_over_is_refused(camera: Camera) -> None:
    with pytest.raises(InvalidCameraError, match="folds"):
        camera.check()


@every_model
def test_a_turned_camera_sees_the_turned_picture(camera: Camera) -> None:
    """Clockwise: what was up is right. In the turned camera x is the old -y, and y the old x."""
    points = _points(np.random.default_rng(3))
    u, v = camera.project(points).T
    turned = camera.rotated(1)
    assert (turned.width, turned.height) == (480, 640)
    seen = turned.project(points @ np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 1.0]]))
    np.testing.assert_allclose(seen, np.column_stack([camera.height - v, u]), atol=1e-10)

    picture = np.zeros((camera.height, camera.width), np.uint8)
    picture[100, 37] = 255
    row, column = np.argwhere(cv2.rotate(picture, cv2.ROTATE_90_CLOCKWISE))[0]
    assert (column + 0.5, row + 0.5) == (camera.height - 100.5, 37.5)


@every_model
def test_four_quarter_turns_are_none(camera: Camera) -> None:
    again = camera.rotated(4)
    assert again == camera
    step = camera
    for _ in range(4):
        step = step.rotated(1)
    np.testing.assert_allclose(step.params, camera.params, atol=1e-12)
    assert (step.model, step.width, step.height) == (camera.model, camera.width, camera.height)
    np.testing.assert_allclose(camera.rotated(-1).params, camera.rotated(3).params)
    np.testing.assert_allclose(camera.rotated(2).rotated(2).params, camera.params, atol=1e-12)


@every_model
def test_a_scaled_camera_sees_the_resized_picture(camera: Camera) -> None:
    points = _points(np.random.default_rng(4))
    resized = camera.scaled(1280, 720)
    np.testing.assert_allclose(resized.project(points), camera.project(points) * [2.0, 1.5], atol=1e-9)
    assert (resized.width, resized.height) == (1280, 720)


@pytest.mark.parametrize(
    ("size", "expected"),
    [
        ((640, 480), (640, 480)),
        ((1280, 960), (640, 480)),
        ((1920, 1080), (739, 416)),
        ((1080, 1920), (416, 739)),
        ((320, 240), (320, 240)),
        ((3000, 4000), (480, 640)),
    ],
)
def test_working_size_keeps_the_area_and_never_enlarges(
    size: tuple[int, int], expected: tuple[int, int]
) -> None:
    assert working_size(*size) == expected


def _lines(camera: Camera, slopes: np.ndarray, offsets: np.ndarray) -> np.ndarray:
    """What the camera sees of bright lines x = slope y + offset on the plane z = 1, six pixels wide."""
    u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    rays = camera.normalize(np.column_stack([u.ravel(), v.ravel()]) + 0.5)
    away = rays[:, :1] - slopes * rays[:, 1:] - offsets
    light = np.exp(-0.5 * (away * camera.focal[0] * 640 / camera.width / 3.0) ** 2).max(axis=1)
    return (
        np.asarray(20 + 200 * light, dtype=np.float64)
        .reshape(camera.height, camera.width)
        .round()
        .astype(np.uint8)
    )


def _line_error(image: np.ndarray, camera: Camera, slope: float, offset: float) -> np.ndarray:
    """For each row: how far the line's centre of light is from where the pinhole camera has it, pixels."""
    fx, fy = camera.focal
    cx, cy = camera.centre
    errors = []
    for row in range(10, camera.height - 10):
        expected = fx * (slope * (row + 0.5 - cy) / fy + offset) + cx
        if not 60 < expected < camera.width - 60:
            continue
        columns = np.arange(int(expected) - 20, int(expected) + 21)
        light = np.maximum(image[row, columns].astype(np.float64) - 30, 0)
        if light.sum() == 0:
            continue
        errors.append((light * (columns + 0.5)).sum() / light.sum() - expected)
    return np.array(errors)


WIDE = (500.0, 505.0, 325.0, 236.0)


@pytest.mark.parametrize("factor", [1, 2])
@pytest.mark.parametrize(
    "source",
    [
        Camera(CameraModel.OPENCV, 640, 480, (*WIDE, -0.28, 0.09, 0.002, -0.003)),
        Camera(CameraModel.RADIAL, 640, 480, (500.0, 325.0, 236.0, -0.25, 0.08)),
        Camera(CameraModel.OPENCV_FISHEYE, 640, 480, (*WIDE, 0.03, -0.01, 0.0, 0.0)),
    ],
    ids=lambda camera: str(camera.model),
)
def test_rectified_lines_are_straight_and_in_their_place(factor: int, source: Camera) -> None:
    source = source.scaled(640 * factor, 480 * factor)
    slopes, offsets = np.array([0.25, 0.0, -0.2, 0.1]), np.array([-0.42, -0.1, 0.15, 0.4])
    picture = _lines(source, slopes, offsets)
    rectifier = Rectifier(source)
    assert rectifier.target.is_pinhole
    assert (rectifier.target.width, rectifier.target.height) == (640, 480)
    straight = rectifier(picture)
    bent = cv2.resize(picture, (640, 480), interpolation=cv2.INTER_AREA)
    for slope, offset in zip(slopes, offsets, strict=True):
        error = _line_error(straight, rectifier.target, slope, offset)
        assert len(error) > 250
        assert np.abs(error).max() < 0.12
        assert abs(error.mean()) < 0.03
    before = np.abs(_line_error(bent, rectifier.target, slopes[0], offsets[0])).max()
    assert before > 4.0


def test_a_pinhole_picture_is_only_resized() -> None:
    rng = np.random.default_rng(5)
    small = Camera.pinhole(64, 48, 60.0, 60.0, 32.0, 24.0)
    picture = rng.integers(0, 255, (48, 64), dtype=np.uint8)
    np.testing.assert_array_equal(Rectifier(small)(picture), picture)
    large = Camera.pinhole(1280, 960, 1000.0, 1000.0, 640.0, 480.0)
    rectifier = Rectifier(large)
    assert rectifier(np.zeros((960, 1280, 3), np.uint8)).shape == (480, 640, 3)
    assert rectifier.target.params == (500.0, 500.0, 320.0, 240.0)
    with pytest.raises(ValueError, match="640x480, its camera 1280x960"):
        rectifier(np.zeros((480, 640), np.uint8))


GOOD = (500.0, 500.0, 320.0, 240.0)


@pytest.mark.parametrize(
    ("model", "size", "params", "complaint"),
    [
        (CameraModel.PINHOLE, (640, 480), GOOD[:3], r"takes 4 parameters \(fx, fy, cx, cy\), got 3"),
        (CameraModel.OPENCV, (640, 480), GOOD, "takes 8 parameters"),
        (CameraModel.PINHOLE, (640, 480), (math.nan, *GOOD[1:]), "finite"),
        (CameraModel.PINHOLE, (640, 480), (*GOOD[:3], math.inf), "finite"),
        (CameraModel.PINHOLE, (15, 480), GOOD, "image size 15x480"),
        (CameraModel.PINHOLE, (640, 16385), GOOD, "image size 640x16385"),
        (CameraModel.PINHOLE, (640, 480), (127.9, *GOOD[1:]), "fx = 127.9 is no focal length"),
        (CameraModel.PINHOLE, (640, 480), (GOOD[0], 6401.0, *GOOD[2:]), "fy = 6401 is no focal length"),
        (CameraModel.PINHOLE, (640, 480), (*GOOD[:2], -0.1, 240.0), "principal point"),
        (CameraModel.PINHOLE, (640, 480), (*GOOD[:3], 480.1), "principal point"),
        (CameraModel.OPENCV, (640, 480), (*GOOD, 0.0, -2.1, 0.0, 0.0), "distortion"),
    ],
)
def test_impossible_cameras_are_refused(
    model: CameraModel, size: tuple[int, int], params: tuple[float, ...], complaint: str
) -> None:
    with pytest.raises(InvalidCameraError, match=complaint):
        Camera(model, *size, params).check()


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ({"model": None}, "models: PINHOLE, .*OPENCV_FISHEYE"),
        (
            {"model": "FISHEYE"},
            "models: PINHOLE, .*OPENCV_FISHEYE",
        ),
        ({"width": "wide"}, "not understood"),
        ({"params": 500.0}, "not understood"),
        ({"params": ["a", 1, 2, 3]}, "not understood"),
        ({"params": [500.0, 500.0, 700.0, 240.0]}, "principal point"),
    ],
)
def test_descriptions_that_make_no_camera_are_refused(change: dict[str, object], complaint: str) -> None:
    with pytest.raises(InvalidCameraError, match=complaint):
        Camera.from_json(PINHOLE.to_json() | change)


@pytest.mark.parametrize("key", ["model", "width", "height", "params"])
def test_a_description_names_the_missing_key(key: str) -> None:
    document = PINHOLE.to_json()
    del document[key]
    with pytest.raises(InvalidCameraError, match=f"lacks '{key}'"):
        Camera.from_json(document)


def test_a_description_comes_back_from_json() -> None:
    for camera in (PINHOLE, PHONE):
        assert Camera.from_json(json.loads(json.dumps(camera.to_json() | {"fps": 30}))) == camera
