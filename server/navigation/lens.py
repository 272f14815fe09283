"""The lens of a follower's phone, learnt from the session's first fixes.

A browser tells no intrinsics, and those that phones tell are often some per cent off. The map's landmarks
are a calibration target: poses and lens of a few frames are adjusted together (resection).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from server.geometry.cameras import Camera, CameraModel, square_pixels
from server.geometry.resection import LensPrior, View, resect
from server.navigation.updates import Fix


@dataclass(frozen=True, slots=True)
class LensOptions:
    """Settings of :class:`LensEstimator`.

    Attributes:
        focal_sigma, distortion_sigma: of a camera whose description was sent, relative and absolute.
        unknown_focal_sigma, unknown_distortion_sigma: of a camera of which nothing is known.
        views: how many are adjusted together; no more are asked after that.
        min_points: that a view needs.
        turn, move: by which a view must differ from the one before, radians and map units.
        settled: relative standard deviation of the focal length below which no more views are asked.
        usable: and above which focal lengths are tried out frame by frame.
        search: focal lengths to be tried, as factors of the one believed in.
        optimism: by how much errors that views share make them tell less than they seem to.
    """

    focal_sigma: float = 0.05
    distortion_sigma: float = 0.02
    unknown_focal_sigma: float = 0.3
    unknown_distortion_sigma: float = 0.05
    views: int = 16
    min_points: int = 40
    turn: float = math.radians(6.0)
    move: float = 0.3
    settled: float = 0.003
    usable: float = 0.06
    search: tuple[float, ...] = (1.0, 0.88, 1.14, 0.77, 1.3, 0.67, 1.48)
    optimism: float = 2.0


@dataclass(frozen=True, slots=True)
class LensBelief:
    """What is believed of a lens.

    Attributes:
        camera: SIMPLE_RADIAL, of the rectified picture's pixels.
        focal_sigma: relative standard deviation of its focal length.
        distortion_sigma: of its coefficient.
        settled: nothing more is learnt.
    """

    camera: Camera
    focal_sigma: float
    distortion_sigma: float
    settled: bool = False

    def to_json(self) -> dict[str, Any]:
        """As plain JSON values."""
        return {
            "camera": self.camera.to_json(),
            "focal_sigma": self.focal_sigma,
            "distortion_sigma": self.distortion_sigma,
            "settled": self.settled,
        }

    @staticmethod
    def from_json(document: dict[str, Any]) -> LensBelief:
        """The inverse of :meth:`to_json`.

        Raises:
            ValueError, KeyError, TypeError: not such a document.
        """
        return LensBelief(
            Camera.from_json(document["camera"]),
            float(document["focal_sigma"]),
            float(document["distortion_sigma"]),
            bool(document["settled"]),
        )

    def resized(self, width: int, height: int) -> LensBelief | None:
        """Of pictures of another size or turned on their side; None if these are other pictures."""
        for camera in (self.camera, self.camera.rotated(1)):
            if abs(camera.width / camera.height - width / height) <= 0.01:
                return replace(self, camera=_simple_radial(camera.scaled(width, height)))
        return None


class LensEstimator:
    """Adjusts a lens to what a session's fixes saw.

    Args:
        belief: where to start.
    """

    def __init__(self, belief: LensBelief, options: LensOptions | None = None) -> None:
        self.options = options or LensOptions()
        self.belief = belief
        self._prior = belief
        self._views: list[View] = []

    @staticmethod
    def start(camera: Camera, known: bool, options: LensOptions | None = None) -> LensEstimator:
        """For a session that begins.

        Args:
            camera: the pinhole camera of the rectified picture, or the best guess at it.
            known: whether the phone described it.
        """
        options = options or LensOptions()
        sigmas = (
            (options.focal_sigma, options.distortion_sigma)
            if known
            else (options.unknown_focal_sigma, options.unknown_distortion_sigma)
        )
        return LensEstimator(LensBelief(_simple_radial(camera), *sigmas), options)

    @property
    def width(self) -> int:
        """Of the rectified picture, pixels."""
        return self.belief.camera.width

    @property
    def height(self) -> int:
        """Of the rectified picture, pixels."""
        return self.belief.camera.height

    @property
    def focal_factors(self) -> tuple[float, ...]:
        """Focal lengths to be tried for the next frame, as factors of the lens's."""
        return self.options.search if self.belief.focal_sigma > self.options.usable else (1.0,)

    def widened(self, fix: Fix, view: View) -> Fix:
        """A fix with what the lens leaves open: a longer lens is mistaken for a place nearer by."""
        depth = float(np.median((view.camera_from_world @ view.points)[:, 2]))
        forward = fix.world_from_camera.rotation[:, 2]
        covariance = fix.covariance.copy()
        covariance[3:, 3:] += (self.belief.focal_sigma * depth) ** 2 * np.outer(forward, forward)
        return replace(fix, covariance=covariance)

    def learn(self, view: View) -> None:
        """Take in what a frame with a pose showed; its pixels are the rectified picture's."""
        options = self.options
        if self.belief.settled or len(view.points) < options.min_points or not self._is_new(view):
            return
        views = [*self._views, view]
        prior = LensPrior(self._prior.camera, self._prior.focal_sigma, self._prior.distortion_sigma)
        found = resect(views, prior)
        if found is None or not self._is_possible(found.camera):
            return
        self._views = [
            View(pose, v.points, v.pixels, v.sigmas) for pose, v in zip(found.poses, views, strict=True)
        ]
        sigma = min(options.optimism * found.focal_sigma, self._prior.focal_sigma)
        self.belief = LensBelief(
            found.camera,
            sigma,
            self._prior.distortion_sigma,
            settled=len(views) >= options.views or sigma < options.settled,
        )

    def _is_possible(self, lens: Camera) -> bool:
        """Whether there are such lenses: few views can leave the picture's corners to a coefficient."""
        return lens.is_possible() and 0.4 < lens.focal[0] / self._prior.camera.focal[0] < 2.5

    def _is_new(self, view: View) -> bool:
        if not self._views:
            return True
        pose, last = view.camera_from_world.inverse(), self._views[-1].camera_from_world.inverse()
        moved = float(np.linalg.norm(pose.translation - last.translation))
        return moved > self.options.move or pose.angle_to(last) > self.options.turn


def _simple_radial(camera: Camera) -> Camera:
    """A camera with one focal length, as pixels of phones are square, and one coefficient."""
    coefficient = (camera.distortion or (0.0,))[0]
    params = (square_pixels(camera).focal[0], *camera.centre, coefficient)
    return Camera(CameraModel.SIMPLE_RADIAL, camera.width, camera.height, params)
