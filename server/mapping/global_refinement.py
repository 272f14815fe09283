"""The final bundle adjustment over a whole walk (pycolmap, Ceres)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pycolmap
from numpy.typing import NDArray

from server.geometry.cameras import Camera, CameraModel
from server.geometry.poses import SE3
from server.mapping.working_map import WorkingMap

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class RefinementOptions:
    """Settings of :func:`refine_globally`.

    Attributes:
        rounds: adjustments; after each the observations that do not fit are dropped.
        max_error: reprojection error beyond which an observation is dropped, pixels.
        loss_scale: scale of the Cauchy loss, pixels.
        max_iterations: solver iterations a round.
        min_observations: keyframes that must see a landmark.
        min_parallax: widest angle at a landmark below which its depth is a guess, radians.
        threads: solver threads, -1 for all cores.
        free_lens: whether focal length and radial distortion are adjusted too.
        lens_tolerance: relative displacement of pixels, from the principal point to the corners, up to which
            the lens of before is believed rather than what the first adjustment makes of it.
    """

    rounds: int = 2
    max_error: float = 3.0
    loss_scale: float = 1.0
    max_iterations: int = 30
    min_observations: int = 3
    min_parallax: float = float(np.deg2rad(1.0))
    threads: int = -1
    free_lens: bool = False
    lens_tolerance: float = 0.0


def refine_globally(working: WorkingMap, options: RefinementOptions | None = None) -> None:
    """Adjust all keyframes and landmarks of a map together, and drop what does not fit.

    The frame and the scale stay those of the first two keyframes only up to the solver's gauge:
    nothing outside the map may rely on absolute values before this has run. With a free lens the
    map's camera is a RADIAL one afterwards, of the same pixels.
    """
    options = options or RefinementOptions()
    before = working.camera
    if options.free_lens:
        working.camera = _radial(before)
    for round_number in range(options.rounds):
        _drop_weak(working, options.min_observations if round_number else 2)
        _adjust(working, options)
        freed = options.free_lens and round_number == 0
        if freed and displacement(working.camera, before) <= options.lens_tolerance:
            working.camera = before
            options = replace(options, free_lens=False)
            # What the other lens has moved must find its way back before anything is judged by this one.
            _adjust(working, options)
        _drop_outliers(working, options.max_error)
    _drop_weak(working, options.min_observations)
    _drop_flat(working, options.min_parallax)


def _radial(camera: Camera) -> Camera:
    """The RADIAL camera without distortion that a camera of square pixels is."""
    return Camera(
        CameraModel.RADIAL, camera.width, camera.height, (camera.focal[0], *camera.centre, 0.0, 0.0)
    )


def displacement(lens: Camera, other: Camera) -> float:
    """How far two lenses see the same rays apart, at most, as a share of the distance from the centre."""
    reach = np.hypot(other.width, other.height) / 2
    across = other.centre[0] + reach * np.linspace(0.1, 1.0, 10)
    pixels = np.column_stack([across, np.full(10, other.centre[1])])
    moved = lens.project_rays(other.normalize(pixels)) - pixels
    return float((np.linalg.norm(moved, axis=1) / (reach * np.linspace(0.1, 1.0, 10))).max())


def _adjust(working: WorkingMap, options: RefinementOptions) -> None:
    reconstruction = pycolmap.Reconstruction()
    camera = working.camera
    reconstruction.add_camera_with_trivial_rig(
        pycolmap.Camera(
            model=str(camera.model),
            width=camera.width,
            height=camera.height,
            params=list(camera.params),
            camera_id=1,
        )
    )
    tracks: dict[int, pycolmap.Track] = {}
    for k, kf in enumerate(working.keyframes):
        seen = kf.matched
        image = pycolmap.Image(
            name=f"{kf.frame:06d}", keypoints=kf.features.pixels[seen], camera_id=1, image_id=k + 1
        )
        pose = pycolmap.Rigid3d(
            pycolmap.Rotation3d(kf.camera_from_world.quaternion), kf.camera_from_world.translation
        )
        reconstruction.add_image_with_trivial_frame(image, pose)
        for row, landmark in enumerate(kf.landmark[seen].tolist()):
            tracks.setdefault(landmark, pycolmap.Track()).add_element(k + 1, row)
    identity = {
        reconstruction.add_point3D(working.position[landmark], track): landmark
        for landmark, track in tracks.items()
    }
    adjustment = pycolmap.BundleAdjustmentOptions()
    adjustment.refine_focal_length = options.free_lens
    adjustment.refine_principal_point = False
    adjustment.refine_extra_params = options.free_lens
    adjustment.print_summary = False
    adjustment.ceres.loss_function_type = pycolmap.LossFunctionType.CAUCHY
    adjustment.ceres.loss_function_scale = options.loss_scale
    adjustment.ceres.solver_options.max_num_iterations = options.max_iterations
    adjustment.ceres.solver_options.function_tolerance = 1e-6
    adjustment.ceres.solver_options.num_threads = options.threads
    # Information and warnings of the solver are about its own steps; what counts is checked below.
    pycolmap.logging.minloglevel = pycolmap.logging.Level.ERROR.value
    pycolmap.bundle_adjustment(reconstruction, adjustment)
    if options.free_lens:
        lens = Camera(
            camera.model, camera.width, camera.height, tuple(map(float, reconstruction.camera(1).params))
        )
        working.camera = lens if lens.is_possible() else camera
    for k, kf in enumerate(working.keyframes):
        refined = reconstruction.image(k + 1).cam_from_world()
        kf.camera_from_world = SE3.from_quaternion(refined.rotation.quat, refined.translation)
    for point_id, landmark in identity.items():
        # Points behind their cameras are gone from the solver's model; they are dropped as outliers here.
        if reconstruction.exists_point3D(point_id):
            working.position[landmark] = reconstruction.point3D(point_id).xyz


def _drop_outliers(working: WorkingMap, max_error: float) -> None:
    for k, kf in enumerate(working.keyframes):
        seen = kf.matched
        local = kf.camera_from_world @ working.position[kf.landmark[seen]]
        error = np.full(len(seen), np.inf)
        front = local[:, 2] > 1e-4
        offset = working.camera.project(local[front]) - kf.features.pixels[seen[front]]
        error[front] = np.linalg.norm(offset, axis=1)
        working.forget(k, seen[error > max_error])


def _drop_weak(working: WorkingMap, min_observations: int) -> None:
    working.kill(np.flatnonzero(working.alive & (working.observed < min_observations)))


def _drop_flat(working: WorkingMap, min_parallax: float) -> None:
    """Landmarks whose depth is a guess: the angle between their first and farthest view is too small."""
    first = np.full(len(working), -1)
    widest = np.zeros(len(working))
    centres = [kf.centre for kf in working.keyframes]
    anchor = np.zeros((len(working), 3))
    for k, kf in enumerate(working.keyframes):
        ids = kf.landmark[kf.matched]
        fresh = ids[first[ids] < 0]
        first[fresh] = k
        anchor[fresh] = centres[k]
        to_first, to_here = anchor[ids] - working.position[ids], centres[k] - working.position[ids]
        cosine = np.einsum("ij,ij->i", to_first, to_here) / np.maximum(
            np.linalg.norm(to_first, axis=1) * np.linalg.norm(to_here, axis=1), 1e-12
        )
        widest[ids] = np.maximum(widest[ids], np.arccos(np.clip(cosine, -1.0, 1.0)))
    working.kill(np.flatnonzero(working.alive & (widest < min_parallax)))
