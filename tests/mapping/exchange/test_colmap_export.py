from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pycolmap
import pytest
from demo_route import DemoRoute

from server.geometry.cameras import Camera, CameraModel, Rectifier
from server.mapping.exchange.colmap_export import (
    ModelForm,
    OtherVideoError,
    write_colmap,
    write_keyframe_images,
)
from server.mapping.exchange.image_names import image_name, named_time
from server.mapping.route_map import RouteMap, Scale, ScaleSource
from server.mapping.video import read_frames


def reprojection_errors(route_map: RouteMap) -> np.ndarray:
    """(M,) pixels, by this program's own projection."""
    errors = []
    for k in range(len(route_map.keyframes)):
        rows = route_map.observations.of_keyframe(k)
        points = route_map.landmarks.position[route_map.observations.landmark[rows]]
        local = route_map.keyframes.world_from_camera(k).inverse() @ points
        errors.append(
            np.linalg.norm(route_map.camera.project(local) - route_map.observations.pixel[rows], axis=1)
        )
    return np.concatenate(errors)


@pytest.mark.parametrize("form", ModelForm)
def test_pycolmap_sees_the_same_map(demo_route: DemoRoute, tmp_path: Path, form: ModelForm) -> None:
    route_map = demo_route.route_map
    write_colmap(route_map, tmp_path, form)
    model = pycolmap.Reconstruction(tmp_path / "sparse" / "0")
    assert model.is_valid()
    assert model.num_images() == len(route_map.keyframes)
    assert model.num_points3D() == len(route_map.landmarks)
    assert model.compute_num_observations() == len(route_map.observations.landmark)
    # COLMAP averages over points, each the mean of its track.
    errors = reprojection_errors(route_map)
    landmark = route_map.observations.landmark
    by_point = np.bincount(landmark, errors) / np.bincount(landmark)
    model.update_point_3d_errors()
    assert model.compute_mean_reprojection_error() == pytest.approx(by_point.mean(), rel=1e-4)
    for k, frame in enumerate(route_map.keyframes.frame):
        image = model.find_image_with_name(image_name(int(frame), float(route_map.path.time[frame])))
        np.testing.assert_allclose(
            image.projection_center(), route_map.keyframes.position[k], rtol=0, atol=1e-6
        )
    camera = model.cameras[1]
    assert (camera.model_name, camera.width, camera.height) == ("PINHOLE", 640, 480)
    np.testing.assert_allclose(camera.params, route_map.camera.params)


def test_lengths_are_metres_where_the_scale_is_known(demo_route: DemoRoute, tmp_path: Path) -> None:
    measured = replace(demo_route.route_map, scale=Scale(2.5, ScaleSource.MEASURED_LENGTH))
    write_colmap(measured, tmp_path)
    model = pycolmap.Reconstruction(tmp_path / "sparse" / "0")
    last = model.image(len(measured.keyframes))
    np.testing.assert_allclose(last.projection_center(), 2.5 * measured.keyframes.position[-1], atol=1e-6)
    model.update_point_3d_errors()
    unscaled = reprojection_errors(demo_route.route_map)
    assert model.compute_mean_reprojection_error() == pytest.approx(unscaled.mean(), rel=0.2)
    assert "metres" in (tmp_path / "README.txt").read_text(encoding="utf-8")


def test_pictures_are_the_frames_that_the_names_say(demo_route: DemoRoute, demo_model: Path) -> None:
    frames = {round(1000 * f.time): f.image for f in read_frames(demo_route.leader.video)}
    pictures = sorted((demo_model / "images").iterdir())
    assert len(pictures) == len(demo_route.route_map.keyframes)
    rectifier = Rectifier(demo_route.leader.camera)
    for picture in pictures[::10]:
        time = named_time(picture.name)
        assert time is not None
        np.testing.assert_array_equal(
            cv2.imread(str(picture), cv2.IMREAD_UNCHANGED), rectifier(frames[round(1000 * time)])
        )


def test_points_have_the_colours_of_the_pictures(demo_model: Path) -> None:
    model = pycolmap.Reconstruction(demo_model / "sparse" / "0")
    colours = np.stack([point.color for point in model.points3D.values()])
    assert (colours == colours[:, :1]).all()
    assert colours.std() > 10


def test_another_form_leaves_no_older_model_beside_it(demo_route: DemoRoute, tmp_path: Path) -> None:
    write_colmap(demo_route.route_map, tmp_path, ModelForm.BINARY)
    write_colmap(demo_route.route_map, tmp_path, ModelForm.TEXT)
    assert {file.suffix for file in (tmp_path / "sparse" / "0").iterdir()} == {".txt"}


def test_another_video_or_camera_is_noticed(demo_route: DemoRoute, tmp_path: Path) -> None:
    route_map, leader = demo_route.route_map, demo_route.leader
    late = replace(route_map, path=replace(route_map.path, time=route_map.path.time + 0.03))
    with pytest.raises(OtherVideoError, match=r"keyframes of the map are not in video\.mp4"):
        write_keyframe_images(late, leader.video, tmp_path)
    other = Camera.pinhole(640, 480, 700.0, 700.0, 320.0, 240.0)
    with pytest.raises(OtherVideoError, match="640x480"):
        write_keyframe_images(route_map, leader.video, tmp_path, other)
    barrel = Camera(CameraModel.OPENCV, 640, 480, (*route_map.camera.params, -0.1, 0.0, 0.0, 0.0))
    write_keyframe_images(route_map, leader.video, tmp_path, barrel)
    plain = Rectifier(route_map.camera)
    first = next(iter(read_frames(leader.video)))
    written = cv2.imread(str(min(tmp_path.iterdir())), cv2.IMREAD_UNCHANGED)
    assert np.abs(written.astype(int) - plain(first.image)).max() > 20


def test_names_say_frame_and_time_and_sort_as_the_walk() -> None:
    names = [image_name(frame, frame / 10.0) for frame in (0, 9, 123, 17_999)]
    assert names[2] == "000123_00012300ms.png"
    assert names == sorted(names)
    assert [named_time(f"walk/{name}") for name in names] == [0.0, 0.9, 12.3, 1799.9]
    assert named_time("IMG_0123.jpg") is None
