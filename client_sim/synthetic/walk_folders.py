"""Writing walk folders: what a phone has recorded on a synthetic walk, and the truth about it."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from client_sim.synthetic.cameras import Camera, Pose
from client_sim.synthetic.exposure import AutoExposure, Light, add_noise
from client_sim.synthetic.magnetics import building_field
from client_sim.synthetic.motion import Motion
from client_sim.synthetic.people import crowd_at
from client_sim.synthetic.radio import Scan, building_radio, wifi_scans
from client_sim.synthetic.recordings import Recording, checkpoints, off_route
from client_sim.synthetic.rendering import Renderer
from client_sim.synthetic.sensors import Series, measure
from client_sim.synthetic.trajectories import Trajectory, sample

Image = NDArray[np.uint8]
Progress = Callable[[float], None]

COVERED_GREY = 5.0
"""What a covered lens lets through, grey levels."""


@dataclass(frozen=True, eq=False, slots=True)
class Picture:
    """A frame of the video, and where people are in it, (H, W) bool, None without them."""

    image: Image
    people: NDArray[np.bool_] | None = None


def write_walk(
    folder: Path,
    renderer: Renderer,
    trajectory: Trajectory,
    rng: np.random.Generator,
    *,
    light: Light | None = None,
    meta: dict[str, Any] | None = None,
    on_progress: Progress | None = None,
) -> None:
    """Film a trajectory sharply: ``video.mp4``, ``camera.json``, ``groundtruth.txt``, ``meta.json``.

    Args:
        folder: created if it is not there.
        rng: draws the sensor noise.
        meta: keys added to ``meta.json``.
        on_progress: gets the fraction done, 0 to 1.

    Raises:
        OSError: a file cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    light = light or Light()
    pictures = (Picture(renderer.render(pose, light, rng)) for pose in trajectory.poses)
    _write_video(folder / "video.mp4", renderer.camera, trajectory, pictures, on_progress)
    _write_truth(folder, renderer.camera, trajectory)
    _write_meta(folder, trajectory, {"world": renderer.world.name, **(meta or {})})


def write_recording(
    folder: Path, recording: Recording, on_progress: Progress | None = None, *, building_seed: int = 0
) -> None:
    """Record a walk: the files of :func:`write_walk`, ``sensors.jsonl``, with people ``people_masks.npz``.

    Args:
        folder: created if it is not there.
        on_progress: gets the fraction done, 0 to 1.
        building_seed: of what belongs to the building and cannot be seen: steel and access points.

    Raises:
        OSError: a file cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    trajectory = sample(recording.motion, recording.fps)
    pictures = film(recording, trajectory)
    masks = _write_video(folder / "video.mp4", recording.camera, trajectory, pictures, on_progress)
    _write_truth(folder, recording.camera, trajectory)
    _write_sensors(folder / "sensors.jsonl", recording, building_seed)
    if recording.people:
        masks["shape"] = np.array([recording.camera.height, recording.camera.width])
        np.savez_compressed(folder / "people_masks.npz", allow_pickle=False, **masks)
    apart, away = off_route(recording, trajectory.times)
    _write_meta(
        folder,
        trajectory,
        {
            "world": recording.building.name,
            **recording.meta,
            "people": len(recording.people),
            "covered_s": [[span.begin, span.end] for span in recording.covered],
            "checkpoints": checkpoints(recording, trajectory.times),
            "off_route_frames": away,
            "distance_to_leader_route_m": apart.round(3).tolist(),
            "steps": [[round(s.time, 3), round(s.length, 3), s.foot.value] for s in recording.motion.steps],
        },
    )


def film(recording: Recording, trajectory: Trajectory) -> Iterator[Picture]:
    """The pictures of a recording, exposed and blurred as a phone's are."""
    renderer = Renderer(recording.building.world, recording.camera)
    exposure = AutoExposure()
    rng = np.random.default_rng([recording.seed, 31])
    for time in trajectory.times:
        settings = exposure.settings
        if any(time in span for span in recording.covered):
            grey = np.full((recording.camera.height, recording.camera.width, 3), COVERED_GREY, np.uint8)
            noise = recording.light.noise * float(np.sqrt(settings.gain))
            picture = Picture(add_noise(grey, noise, rng))
        else:
            poses = _while_open(recording.motion, float(time), settings.time_s)
            people = crowd_at(recording.people, float(time))
            shot = renderer.shoot(poses, recording.light, rng, people, settings)
            picture = Picture(shot.image, shot.mask("person") if people else None)
        exposure.measure(float(picture.image[::4, ::4].mean()), 1.0 / recording.fps)
        yield picture


def _while_open(motion: Motion, time: float, shutter_s: float) -> list[Pose]:
    """Poses at which the shutter opens, is half-way, and closes."""
    times = np.clip(time + shutter_s * np.array([-0.5, 0.0, 0.5]), 0.0, motion.duration)
    return [*map(Pose, motion.rotations(times), motion.positions(times))]


def _write_video(
    path: Path,
    camera: Camera,
    trajectory: Trajectory,
    pictures: Iterable[Picture],
    on_progress: Progress | None,
) -> dict[str, NDArray[Any]]:
    """Encode pictures as they come; returns the packed masks of those with people, by their numbers."""
    writer = cv2.VideoWriter(
        str(path), cv2.VideoWriter.fourcc(*"mp4v"), trajectory.fps, (camera.width, camera.height)
    )
    if not writer.isOpened():
        raise OSError(f"{path}: cannot be written as video")
    masks: dict[str, NDArray[Any]] = {}
    try:
        for row, picture in enumerate(pictures):
            writer.write(picture.image)
            if picture.people is not None and picture.people.any():
                masks[f"{row:06d}"] = np.packbits(picture.people)
            if on_progress is not None:
                on_progress((row + 1) / len(trajectory))
    finally:
        writer.release()
    return masks


def _write_truth(folder: Path, camera: Camera, trajectory: Trajectory) -> None:
    (folder / "camera.json").write_text(json.dumps(camera.to_json(trajectory.fps)) + "\n", encoding="utf-8")
    lines = ["# t tx ty tz qx qy qz qw (world_from_camera; x right, y down, z forward)"]
    for time, pose in zip(trajectory.times, trajectory.poses, strict=True):
        quaternion = Rotation.from_matrix(pose.rotation).as_quat()
        lines.append(f"{time:.4f} " + " ".join(f"{value:.7f}" for value in (*pose.position, *quaternion)))
    (folder / "groundtruth.txt").write_text("\n".join(lines) + "\n", encoding="utf-8")


def _write_meta(folder: Path, trajectory: Trajectory, meta: dict[str, Any]) -> None:
    document = {
        "sequence": folder.name,
        "real": False,
        "frames": len(trajectory),
        "fps": trajectory.fps,
        "duration_s": round(len(trajectory) / trajectory.fps, 3),
        "path_length_m": round(trajectory.length, 3),
        "off_route_frames": None,
        **meta,
    }
    (folder / "meta.json").write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")


def _write_sensors(path: Path, recording: Recording, building_seed: int) -> None:
    phone = np.random.default_rng([recording.seed, 32])
    steel, access_points = (np.random.default_rng([building_seed, k]) for k in (41, 42))
    field = building_field(recording.building, steel)
    radio = building_radio(recording.building, access_points)
    series = measure(recording.motion, field, phone)
    scans = wifi_scans(recording.motion, radio, phone)
    lines = sorted(sensor_lines(series, scans), key=lambda line: float(line["t"]))
    path.write_text("".join(json.dumps(line) + "\n" for line in lines), encoding="utf-8")


def sensor_lines(series: Iterable[Series], scans: Iterable[Scan]) -> Iterator[dict[str, Any]]:
    """Readings and scans as the objects of ``sensors.jsonl``."""
    for one in series:
        for time, value in zip(one.times, one.values, strict=True):
            yield {"t": round(float(time), 4), "type": one.kind, "v": value.round(5).tolist()}
    for scan in scans:
        readings = [{"bssid": heard.source, "rssi": heard.rssi} for heard in scan.heard]
        yield {"t": round(scan.time, 4), "type": "wifi", "readings": readings}
