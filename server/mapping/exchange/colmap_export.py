"""A map as a COLMAP model: one camera, the keyframes as images, the landmarks as points with their tracks.

The layout is the one that COLMAP and what builds on it expect: ``sparse/0`` with the model, ``images`` with
the pictures where a video is given. Camera models, poses (camera_from_world) and pixels are COLMAP's own
conventions already; the world is the map's, z up, in metres where the scale is known.
"""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path

import cv2
import numpy as np
import pycolmap

from server.geometry.cameras import Camera, Rectifier
from server.mapping.exchange.colours import coloured_by_height
from server.mapping.exchange.image_names import image_name
from server.mapping.exchange.units import export_scale, unit_in_words
from server.mapping.route_map import RouteMap
from server.mapping.video import probe, read_frames


class ModelForm(StrEnum):
    """How a model's files are written; programs read either."""

    BINARY = "binary"
    TEXT = "text"


class OtherVideoError(ValueError):
    """The video or its camera is not the one that the map was made from; the message says why."""


MODEL_FOLDER = Path("sparse", "0")
IMAGE_FOLDER = Path("images")


def as_reconstruction(route_map: RouteMap) -> pycolmap.Reconstruction:
    """The map as pycolmap has it; image k + 1 is keyframe k, points are coloured by height."""
    camera, keyframes, observations = route_map.camera, route_map.keyframes, route_map.observations
    scale = export_scale(route_map)
    reconstruction = pycolmap.Reconstruction()
    reconstruction.add_camera_with_trivial_rig(
        pycolmap.Camera(
            model=str(camera.model),
            width=camera.width,
            height=camera.height,
            params=list(camera.params),
            camera_id=1,
        )
    )
    tracks = [pycolmap.Track() for _ in range(len(route_map.landmarks))]
    for k in range(len(keyframes)):
        rows = observations.of_keyframe(k)
        frame = int(keyframes.frame[k])
        image = pycolmap.Image(
            name=image_name(frame, float(route_map.path.time[frame])),
            keypoints=np.asarray(observations.pixel[rows], dtype=np.float64),
            camera_id=1,
            image_id=k + 1,
        )
        pose = keyframes.world_from_camera(k).inverse()
        reconstruction.add_image_with_trivial_frame(
            image, pycolmap.Rigid3d(pycolmap.Rotation3d(pose.quaternion), scale * pose.translation)
        )
        for row, landmark in enumerate(observations.landmark[rows].tolist()):
            tracks[landmark].add_element(k + 1, row)
    colours = coloured_by_height(route_map.landmarks.position)
    for position, track, colour in zip(scale * route_map.landmarks.position, tracks, colours, strict=True):
        reconstruction.add_point3D(position, track, colour)
    reconstruction.update_point_3d_errors()
    return reconstruction


def write_colmap(
    route_map: RouteMap,
    folder: Path,
    form: ModelForm = ModelForm.BINARY,
    *,
    video: Path | None = None,
    camera: Camera | None = None,
) -> None:
    """Write a model and a README into a folder, which is made.

    Args:
        video: the leader's; with it the keyframes' rectified pictures are written too, and the points
            take their grey from them.
        camera: the video's; not needed where it has no distortion.

    Raises:
        OtherVideoError: video or camera do not fit the map.
        server.mapping.video.UnreadableVideoError: it is no video.
        OSError: the folder cannot be written.
    """
    reconstruction = as_reconstruction(route_map)
    model = folder / MODEL_FOLDER
    model.mkdir(parents=True, exist_ok=True)
    if video is not None:
        write_keyframe_images(route_map, video, folder / IMAGE_FOLDER, camera)
        reconstruction.extract_colors_for_all_images(folder / IMAGE_FOLDER)
    for stale in model.glob("*.txt" if form is ModelForm.BINARY else "*.bin"):
        # Readers take what they find first, and would find an older model.
        stale.unlink()
    write = reconstruction.write_binary if form is ModelForm.BINARY else reconstruction.write_text
    write(model)
    (folder / "README.txt").write_text(_readme(route_map), encoding="utf-8")


def write_keyframe_images(
    route_map: RouteMap, video: Path, folder: Path, camera: Camera | None = None
) -> None:
    """Write the keyframes' pictures, rectified as the map's camera sees them, PNG, under their names.

    Args:
        camera: of the video; None takes it to be without distortion.

    Raises:
        OtherVideoError: video or camera do not fit the map.
        server.mapping.video.UnreadableVideoError: it is no video.
        OSError: the folder cannot be written.
    """
    rectifier = _rectifier(route_map.camera, video, camera)
    wanted = {
        round(1000.0 * float(route_map.path.time[frame])): image_name(
            int(frame), float(route_map.path.time[frame])
        )
        for frame in route_map.keyframes.frame
    }
    folder.mkdir(parents=True, exist_ok=True)
    for frame in read_frames(video):
        name = wanted.pop(round(1000.0 * frame.time), None)
        if name is not None and not cv2.imwrite(str(folder / name), rectifier(frame.image)):
            raise OSError(f"{folder / name} could not be written")
    if wanted:
        raise OtherVideoError(
            f"{len(wanted)} keyframes of the map are not in {video.name}, such as {min(wanted.values())}: "
            "give the video that the map was made from"
        )


def _rectifier(target: Camera, video: Path, camera: Camera | None) -> Rectifier:
    """The rectifier whose pictures are the map's."""
    properties = probe(video)
    width, height = properties.width, properties.height
    described = camera or target
    for candidate in (described, described.rotated(properties.quarter_turns)):
        rectifier = Rectifier(candidate.scaled(width, height))
        same_size = (rectifier.target.width, rectifier.target.height) == (target.width, target.height)
        # Mapping may have refined the camera that was given: only another one is refused.
        if same_size and np.allclose(rectifier.target.params, target.params, rtol=0.05):
            return rectifier
    raise OtherVideoError(
        f"a video of {width}x{height} with this camera does not give the map's {target.width}x"
        f"{target.height} pictures: give the video and the camera that the map was made from"
    )


def _readme(route_map: RouteMap) -> str:
    return f"""A route map as a COLMAP model.

sparse/0  one camera, {len(route_map.keyframes)} images (keyframes), {len(route_map.landmarks)} points
images    the pictures, if they were asked for

Camera: that of the rectified pictures, not the phone's own.
Pixels: the centre of the first one is (0.5, 0.5), as COLMAP has it.
World: z up, x the leader's first heading, origin at the leader's first position.
Lengths: {unit_in_words(route_map)}.
Names of images: the number of the frame (10 a second), then its time in the video in milliseconds.
Colours of points: by height, or the pictures' grey where these are there.
"""
