"""A COLMAP model and the folder of its images as a route map.

Only cameras and poses are taken over. A model's points are usually SIFT features, which nobody looks for in a
follower's pictures, so the images are mapped anew with the features of relocalization, every pose held.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
import pycolmap
from threadpoolctl import threadpool_limits

from server.features.extraction import OrbExtractor
from server.features.tracking import TrackedFeatures
from server.geometry.cameras import Camera, CameraModel, InvalidCameraError, Rectifier
from server.geometry.poses import SE3
from server.mapping.assembly import assemble
from server.mapping.exchange.colmap_files import ColmapModelError, check_whole
from server.mapping.exchange.image_names import named_time
from server.mapping.front_end import WalkFrame
from server.mapping.posed_walk import PosedPicture, PosedWalkOptions, map_posed_pictures
from server.mapping.route_map import RouteMap
from server.mapping.trajectory import walked

MIN_IMAGES = 3
MIN_LANDMARKS = 100
"""Below these a map would recognise nothing."""

_MODEL_FILES = ("cameras", "images", "points3D")


@dataclass(frozen=True, slots=True)
class PosedImage:
    """An image of a model: its name and camera_from_world in the model's frame and unit."""

    name: str
    camera_from_world: SE3


@dataclass(frozen=True, eq=False, slots=True)
class ColmapWalk:
    """What a map is made of.

    Attributes:
        camera: of all images, as they are stored.
        images: in the order of their names, which is that of the walk.
    """

    camera: Camera
    images: tuple[PosedImage, ...]


def read_colmap(folder: Path) -> ColmapWalk:
    """Read a model, binary or text; a data set's folder with the model in ``sparse/0`` will do as well.

    Raises:
        ColmapModelError: no model, a damaged one, or one that no walk filmed with one camera gives.
        OSError: a file cannot be read.
    """
    model = _model_folder(folder)
    reconstruction = pycolmap.Reconstruction()
    try:
        reconstruction.read(model)
    except (ValueError, IndexError, RuntimeError, MemoryError) as error:
        reason = str(error).replace("\n", " ")[:200]
        raise ColmapModelError(f"{model} cannot be read as a COLMAP model: {reason}") from None
    posed = [image for image in reconstruction.images.values() if image.has_pose]
    if len(posed) < MIN_IMAGES:
        raise ColmapModelError(
            f"{model} has {len(posed)} images with a pose; a map needs at least {MIN_IMAGES}: "
            "give the reconstructed model, not only a camera list"
        )
    images = []
    for image in sorted(posed, key=lambda image: str(image.name)):
        pose = image.cam_from_world()
        found = SE3.from_quaternion(pose.rotation.quat, pose.translation)
        if not (np.isfinite(found.rotation).all() and np.isfinite(found.translation).all()):
            raise ColmapModelError(f"the pose of {image.name} is no pose: the model is damaged")
        images.append(PosedImage(str(image.name), found))
    used = {image.camera_id for image in posed}
    return ColmapWalk(_one_camera([reconstruction.camera(i) for i in sorted(used)]), tuple(images))


def _model_folder(folder: Path) -> Path:
    for candidate in (folder, folder / "sparse" / "0", folder / "sparse"):
        if all((candidate / f"{name}.bin").is_file() for name in _MODEL_FILES):
            check_whole(candidate)
            return candidate
        if all((candidate / f"{name}.txt").is_file() for name in _MODEL_FILES):
            return candidate
    raise ColmapModelError(
        f"{folder} holds no COLMAP model: cameras, images and points3D were looked for, .bin or .txt"
    )


def _one_camera(found: list[pycolmap.Camera]) -> Camera:
    """The camera that all images share; COLMAP may have listed it once for every image."""
    cameras = []
    for camera in found:
        name = str(camera.model_name)
        try:
            described = Camera(CameraModel(name), camera.width, camera.height, tuple(camera.params.tolist()))
            described.check()
        except InvalidCameraError as error:
            raise ColmapModelError(f"the model's camera {camera.camera_id}: {error}") from None
        except ValueError:
            raise ColmapModelError(
                f"cameras of the model {name} are not taken, only {', '.join(CameraModel)}: "
                "let COLMAP's image_undistorter make PINHOLE images of them"
            ) from None
        cameras.append(described)
    first = cameras[0]
    for other in cameras[1:]:
        same = (other.model, other.width, other.height) == (first.model, first.width, first.height)
        if not (same and np.allclose(other.params, first.params, rtol=1e-6)):
            raise ColmapModelError(
                f"the images have {len(cameras)} different cameras; a walk is filmed with one: "
                "reconstruct with --ImageReader.single_camera 1"
            )
    return first


def image_times(walk: ColmapWalk, images_per_second: float | None) -> list[float]:
    """When the images were taken, seconds: as their names say, or evenly in the order of the names.

    Raises:
        ColmapModelError: neither is known, or the names' times do not increase.
    """
    if images_per_second is not None:
        return [k / images_per_second for k in range(len(walk.images))]
    times = [named_time(image.name) for image in walk.images]
    known = [time for time in times if time is not None]
    if len(known) < len(times):
        raise ColmapModelError(
            "the images' names do not say when they were taken: say how many there are in a second"
        )
    if any(after <= before for before, after in pairwise(known)):
        raise ColmapModelError("the times in the images' names do not increase in the order of the names")
    return known


def import_colmap(
    walk: ColmapWalk,
    images: Path,
    times: list[float],
    *,
    measured_length: float | None = None,
    metric: bool = False,
    options: PosedWalkOptions | None = None,
    on_progress: Callable[[float], None] | None = None,
) -> RouteMap:
    """Map a model's images anew, each where the model has it.

    Args:
        images: the folder in which the images are, under their names.
        times: when they were taken, seconds, increasing.
        measured_length: length of the walk in metres; metric: the model's unit is the metre.
        on_progress: called with 0 to 1.

    Raises:
        ColmapModelError: an image is missing, is none or has another size; too little is seen in them.
    """
    # Before anything is worked out: a missing image is better known now than in a minute.
    missing = [image.name for image in walk.images if not _inside(images, image.name).is_file()]
    if missing:
        raise ColmapModelError(
            f"{len(missing)} of {len(walk.images)} images are not in {images}, such as {missing[0]}"
        )
    rectifier, extractor = Rectifier(walk.camera), OrbExtractor()
    # The matrices are small, and OpenMP's threads would spin where others want the cores.
    with threadpool_limits(limits=1):
        pictures = _pictures(walk, images, rectifier, on_progress or (lambda fraction: None))
        working = map_posed_pictures(pictures, rectifier.target, extractor, options)
        landmarks = int(working.alive.sum())
        if landmarks < MIN_LANDMARKS:
            raise ColmapModelError(
                f"only {landmarks} points are seen in several images: are these the model's own images, "
                "and do they overlap?"
            )
        # Every image is a frame of the path, and each has its pose.
        poses: list[SE3 | None] = [kf.camera_from_world for kf in working.keyframes]
        frames = [WalkFrame(time, TrackedFeatures.empty(), np.eye(3)) for time in times]
        return assemble(
            working,
            frames,
            poses,
            levels=extractor.levels,
            measured_length=_length(walk, times) if metric else measured_length,
        )


def _inside(folder: Path, name: str) -> Path:
    path = folder / name
    if not path.resolve().is_relative_to(folder.resolve()):
        raise ColmapModelError(f"the model names an image outside the folder: {name}")
    return path


def _pictures(
    walk: ColmapWalk, folder: Path, rectifier: Rectifier, on_progress: Callable[[float], None]
) -> Iterator[PosedPicture]:
    camera = walk.camera
    for number, image in enumerate(walk.images, start=1):
        # As they are stored: COLMAP does not turn images by their metadata either.
        picture = cv2.imread(
            str(_inside(folder, image.name)), cv2.IMREAD_GRAYSCALE | cv2.IMREAD_IGNORE_ORIENTATION
        )
        if picture is None:
            raise ColmapModelError(f"{folder / image.name} is no image that can be read")
        if picture.shape != (camera.height, camera.width):
            raise ColmapModelError(
                f"{folder / image.name} has {picture.shape[1]}x{picture.shape[0]} pixels, the model's camera "
                f"{camera.width}x{camera.height}: give the images that the model was made from"
            )
        yield PosedPicture(rectifier(np.asarray(picture, dtype=np.uint8)), image.camera_from_world)
        on_progress(number / len(walk.images))


def _length(walk: ColmapWalk, times: list[float]) -> float:
    """Length of the walk in the model's unit."""
    centres = np.stack([image.camera_from_world.inverse().translation for image in walk.images])
    return float(walked(centres, np.array(times))[-1])
