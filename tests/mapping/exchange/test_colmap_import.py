from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pycolmap
import pytest
from demo_route import DemoRoute

from server.evaluation.follower import judge_follower
from server.evaluation.leader import BuildFigures, judge_leader
from server.evaluation.report import FollowerReport
from server.evaluation.runs import follow_route
from server.evaluation.walk import Walk
from server.geometry.cameras import CameraModel
from server.mapping.codec import save_route_map
from server.mapping.exchange.colmap_export import write_colmap
from server.mapping.exchange.colmap_files import ColmapModelError
from server.mapping.exchange.colmap_import import (
    ColmapWalk,
    PosedImage,
    image_times,
    import_colmap,
    read_colmap,
)
from server.mapping.outcome import BuildReport
from server.mapping.route_map import RouteMap, ScaleSource
from server.mapping.video import read_frames


def figures_of_follower(leader: Walk, follower: Walk, route_map: RouteMap, folder: Path) -> FollowerReport:
    frames = len(route_map.path)
    report = BuildReport(frames, frames, len(route_map.keyframes), len(route_map.landmarks))
    judged = judge_leader(leader, route_map, BuildFigures("ready", "", report, 0.0, 0, 0))
    save_route_map(route_map, folder / "imported.map")
    answers = follow_route(folder / "imported.map", follower.video, follower.camera, lambda index: None)
    return judge_follower(leader, judged, follower, answers).report


@pytest.fixture
def copied(demo_model: Path, tmp_path: Path) -> Path:
    """The demo's model and pictures, to be spoilt."""
    return shutil.copytree(demo_model, tmp_path / "copied")


def test_an_exported_map_mapped_anew_serves_its_follower(
    demo_route: DemoRoute, demo_model: Path, tmp_path: Path
) -> None:
    walk = read_colmap(demo_model)
    told: list[float] = []
    again = import_colmap(walk, demo_model / "images", image_times(walk, None), on_progress=told.append)
    assert told == sorted(told)
    assert told[-1] == 1.0
    original = demo_route.route_map
    assert again.scale.source is ScaleSource.UNKNOWN
    np.testing.assert_allclose(again.path.time, original.path.time[original.keyframes.frame], atol=1e-3)
    assert len(again.turns) == len(original.turns)
    report = figures_of_follower(demo_route.leader, demo_route.follower, again, tmp_path)
    assert report.relocalized_fraction >= 0.97
    assert report.false_fixes == 0
    assert report.position_error_m.median < 0.08


def test_true_poses_make_a_metric_map_without_any_point(demo_route: DemoRoute, tmp_path: Path) -> None:
    """A model as somebody writes it who knows where the camera was: no points, half the frames, metres."""
    truth, camera = demo_route.leader.truth, demo_route.leader.camera
    model = pycolmap.Reconstruction()
    described = pycolmap.Camera(
        model=str(camera.model), width=camera.width, height=camera.height, params=camera.params, camera_id=7
    )
    model.add_camera_with_trivial_rig(described)
    images = tmp_path / "images"
    images.mkdir()
    for number, frame in enumerate(read_frames(demo_route.leader.video)):
        if number % 3:
            continue
        name = f"{number:05d}.jpg"
        cv2.imwrite(str(images / name), frame.image, [cv2.IMWRITE_JPEG_QUALITY, 95])
        row = int(truth.nearest([frame.time])[0])
        camera_from_world = pycolmap.Rigid3d(
            pycolmap.Rotation3d(truth.rotation[row].T), -truth.rotation[row].T @ truth.position[row]
        )
        image = pycolmap.Image(name=name, keypoints=np.zeros((0, 2)), camera_id=7, image_id=number + 1)
        model.add_image_with_trivial_frame(image, camera_from_world)
    (tmp_path / "text").mkdir()
    model.write_text(tmp_path / "text")
    walk = read_colmap(tmp_path / "text")
    with pytest.raises(ColmapModelError, match="how many there are in a second"):
        image_times(walk, None)
    route_map = import_colmap(walk, images, image_times(walk, 10.0 / 3.0), metric=True)
    assert route_map.scale.metres(float(route_map.path.arc_length[-1])) == pytest.approx(
        np.linalg.norm(np.diff(truth.position[::10], axis=0), axis=1).sum(), rel=0.05
    )
    report = figures_of_follower(demo_route.leader, demo_route.follower, route_map, tmp_path)
    assert report.relocalized_fraction >= 0.97
    assert report.false_fixes == 0
    assert report.position_error_m.median < 0.05


@pytest.mark.parametrize("name", ["cameras.bin", "images.bin", "points3D.bin"])
@pytest.mark.parametrize("share", [0.0, 0.5, 0.999])
def test_a_file_that_was_cut_short_is_named(copied: Path, name: str, share: float) -> None:
    file = copied / "sparse" / "0" / name
    whole = file.read_bytes()
    file.write_bytes(whole[: int(share * len(whole))])
    with pytest.raises(ColmapModelError, match=rf"{name} is damaged or was cut short"):
        read_colmap(copied)


@pytest.mark.parametrize("name", ["rigs.bin", "frames.bin"])
def test_what_pycolmap_refuses_is_said(copied: Path, name: str) -> None:
    (copied / "sparse" / "0" / name).write_bytes(b"")
    with pytest.raises(ColmapModelError, match="cannot be read as a COLMAP model"):
        read_colmap(copied)


def test_a_folder_without_a_model_is_said(tmp_path: Path) -> None:
    for folder in (tmp_path, tmp_path / "nowhere"):
        with pytest.raises(ColmapModelError, match="holds no COLMAP model"):
            read_colmap(folder)


def spoilt(demo_model: Path, tmp_path: Path, spoil: Callable[[pycolmap.Reconstruction], None]) -> Path:
    model = pycolmap.Reconstruction(demo_model / "sparse" / "0")
    spoil(model)
    model.write_binary(tmp_path)
    return tmp_path


def second_camera(model: pycolmap.Reconstruction) -> None:
    camera = pycolmap.Camera(
        model="PINHOLE", width=640, height=480, params=[510.0, 510.0, 320.0, 240.0], camera_id=2
    )
    model.add_camera_with_trivial_rig(camera)
    pose = pycolmap.Rigid3d(pycolmap.Rotation3d([0.0, 0.0, 0.0, 1.0]), np.zeros(3))
    image = pycolmap.Image(name="x.png", keypoints=np.zeros((0, 2)), camera_id=2, image_id=10_000)
    model.add_image_with_trivial_frame(image, pose)


def fisheye(model: pycolmap.Reconstruction) -> None:
    camera = model.cameras[1]
    camera.model = pycolmap.CameraModelId.THIN_PRISM_FISHEYE
    camera.params = [500.0, 500.0, 320.0, 240.0] + 8 * [0.0]


def impossible_focal_length(model: pycolmap.Reconstruction) -> None:
    model.cameras[1].params = [5.0, 5.0, 320.0, 240.0]


def no_poses(model: pycolmap.Reconstruction) -> None:
    for frame_id in list(model.reg_frame_ids()):
        model.deregister_frame(frame_id)


@pytest.mark.parametrize(
    ("spoil", "complaint"),
    [
        (second_camera, "2 different cameras.*single_camera"),
        (fisheye, "THIN_PRISM_FISHEYE are not taken.*image_undistorter"),
        (impossible_focal_length, "no focal length"),
        (no_poses, "0 images with a pose"),
    ],
)
def test_what_no_walk_gives_is_refused(
    demo_model: Path, tmp_path: Path, spoil: Callable[[pycolmap.Reconstruction], None], complaint: str
) -> None:
    with pytest.raises(ColmapModelError, match=complaint):
        read_colmap(spoilt(demo_model, tmp_path, spoil))


def test_images_that_do_not_fit_are_named(copied: Path) -> None:
    walk, images = read_colmap(copied), copied / "images"
    names = [image.name for image in walk.images]
    first, second = images / names[0], images / names[1]
    (images / names[2]).unlink()
    with pytest.raises(ColmapModelError, match=f"1 of {len(names)} images.*{names[2]}"):
        import_colmap(walk, images, image_times(walk, None))
    shutil.copyfile(second, images / names[2])
    picture = cv2.imread(str(first), cv2.IMREAD_GRAYSCALE)
    cv2.imwrite(str(first), picture[:, :600])
    with pytest.raises(ColmapModelError, match="600x480 pixels, the model's camera 640x480"):
        import_colmap(walk, images, image_times(walk, None))
    first.write_bytes(b"no picture")
    with pytest.raises(ColmapModelError, match="is no image that can be read"):
        import_colmap(walk, images, image_times(walk, None))


def test_images_of_something_else_make_no_map(copied: Path) -> None:
    walk = read_colmap(copied)
    few = replace(walk, images=walk.images[:6])
    for number, image in enumerate(few.images):
        noise = np.random.default_rng(number).integers(0, 255, (480, 640), dtype=np.uint8)
        cv2.imwrite(str(copied / "images" / image.name), noise)
    with pytest.raises(ColmapModelError, match="are these the model's own images"):
        import_colmap(few, copied / "images", image_times(few, None))


def test_images_outside_their_folder_are_not_opened(demo_route: DemoRoute, tmp_path: Path) -> None:
    images = tuple(
        PosedImage(f"../{k}.png", demo_route.route_map.keyframes.world_from_camera(k)) for k in range(3)
    )
    walk = ColmapWalk(demo_route.leader.camera, images)
    with pytest.raises(ColmapModelError, match="outside the folder"):
        import_colmap(walk, tmp_path, image_times(walk, 3.0))


def test_times_in_names_must_increase(demo_route: DemoRoute) -> None:
    pose = demo_route.route_map.keyframes.world_from_camera(0)
    walk = ColmapWalk(
        demo_route.leader.camera,
        (PosedImage("000001_00000200ms.png", pose), PosedImage("000002_00000100ms.png", pose)),
    )
    with pytest.raises(ColmapModelError, match="do not increase"):
        image_times(walk, None)
    assert image_times(walk, 4.0) == [0.0, 0.25]


def test_cameras_are_those_that_this_program_knows() -> None:
    assert all(pycolmap.CameraModelId.__members__[str(model)] for model in CameraModel)


def test_a_distorted_camera_is_rectified(demo_route: DemoRoute, tmp_path: Path) -> None:
    write_colmap(demo_route.route_map, tmp_path)
    model = pycolmap.Reconstruction(tmp_path / "sparse" / "0")
    model.cameras[1].model = pycolmap.CameraModelId.SIMPLE_RADIAL
    model.cameras[1].params = [500.0, 320.0, 240.0, 0.01]
    model.write_binary(tmp_path / "sparse" / "0")
    assert read_colmap(tmp_path).camera.params == (500.0, 320.0, 240.0, 0.01)
