"""A follower's navigation session: a state machine from frames to updates, without I/O or clock."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from server.features.extraction import OrbExtractor, OrbOptions
from server.geometry.cameras import Camera, Rectifier, typical_camera
from server.geometry.poses import SE3
from server.mapping.route_map import RouteMap
from server.navigation.guidance import GuidanceOptions, Guide, Progress
from server.navigation.lens import LensBelief, LensEstimator, LensOptions
from server.navigation.relocalizer import Relocalizer, RelocalizerOptions
from server.navigation.updates import Fix, Guidance, Instruction, NavigationState, Refusal, Update


@dataclass(frozen=True, slots=True)
class NavigationOptions:
    """Settings of :class:`NavigationSession`.

    Attributes:
        extraction, relocalizer, lens, guidance: settings of the parts.
        prior_seconds: how long a fix tells where to look next; trust_seconds: how long a fix that the
            picture alone proved lets expected poses pass on less.
        guidance_seconds: how long guidance holds without a new fix: shorter than a turn takes.
        lost_seconds: how long without a fix until the follower counts as lost.
    """

    extraction: OrbOptions = field(default_factory=lambda: OrbOptions(count=1000))
    relocalizer: RelocalizerOptions = field(default_factory=RelocalizerOptions)
    lens: LensOptions = field(default_factory=LensOptions)
    guidance: GuidanceOptions = field(default_factory=GuidanceOptions)
    prior_seconds: float = 1.5
    trust_seconds: float = 3.0
    guidance_seconds: float = 0.75
    lost_seconds: float = 3.0


@dataclass(frozen=True, slots=True)
class SessionSnapshot:
    """All a session remembers: enough to go on in another process.

    Attributes:
        state: of the last update.
        quaternion, position: world_from_camera of the last fix; fix_time: its capture time, seconds.
        trusted_time: capture time of the last fix that the picture alone proved, seconds.
        progress: along the route.
        instruction: the last one given.
        lens: what was learnt of the phone's lens.
    """

    state: NavigationState = NavigationState.SEARCHING
    quaternion: tuple[float, float, float, float] | None = None
    position: tuple[float, float, float] | None = None
    fix_time: float = 0.0
    trusted_time: float = -1e9
    progress: Progress | None = None
    instruction: Instruction | None = None
    lens: LensBelief | None = None

    def to_json(self) -> dict[str, Any]:
        """As plain JSON values."""
        return {
            "state": str(self.state),
            "quaternion": self.quaternion,
            "position": self.position,
            "fix_time": self.fix_time,
            "trusted_time": self.trusted_time,
            "progress": None
            if self.progress is None
            else [self.progress.length, self.progress.time, self.progress.doubted],
            "instruction": None if self.instruction is None else str(self.instruction),
            "lens": None if self.lens is None else self.lens.to_json(),
        }

    @staticmethod
    def from_json(document: dict[str, Any]) -> SessionSnapshot:
        """The inverse of :meth:`to_json`.

        Raises:
            ValueError, KeyError, TypeError: not such a document.
        """
        q, p, progress = document["quaternion"], document["position"], document["progress"]
        instruction = document["instruction"]
        return SessionSnapshot(
            state=NavigationState(document["state"]),
            quaternion=None if q is None else (float(q[0]), float(q[1]), float(q[2]), float(q[3])),
            position=None if p is None else (float(p[0]), float(p[1]), float(p[2])),
            fix_time=float(document["fix_time"]),
            trusted_time=float(document["trusted_time"]),
            progress=None
            if progress is None
            else Progress(
                float(progress[0]), float(progress[1]), None if progress[2] is None else float(progress[2])
            ),
            instruction=None if instruction is None else Instruction(instruction),
            lens=None if document["lens"] is None else LensBelief.from_json(document["lens"]),
        )

    @property
    def world_from_camera(self) -> SE3 | None:
        """The last fix's pose."""
        if self.quaternion is None or self.position is None:
            return None
        return SE3.from_quaternion(self.quaternion, self.position)


class NavigationSession:
    """Guides one follower along one route.

    The same frames with the same times always give the same updates.

    Args:
        camera: of the phone; None if nobody knows: then the first fixes tell it.
    """

    def __init__(
        self,
        route_map: RouteMap,
        camera: Camera | None,
        options: NavigationOptions | None = None,
        snapshot: SessionSnapshot | None = None,
    ) -> None:
        self.options = options or NavigationOptions()
        self._extractor = OrbExtractor(self.options.extraction)
        self._relocalizer = Relocalizer(
            route_map, self._extractor.scale_factor, self._extractor.levels, self.options.relocalizer
        )
        self._guide = Guide(route_map, self.options.guidance)
        self._camera = camera
        self._rectifier: Rectifier | None = None
        self._lens: LensEstimator | None = None
        self._memory = snapshot or SessionSnapshot()
        self._guidance: Guidance | None = None

    def snapshot(self) -> SessionSnapshot:
        """What the session remembers."""
        return self._memory

    def process(self, image: NDArray[np.uint8], capture_time: float, sequence: int) -> Update:
        """The answer to one frame.

        Args:
            image: (H, W) grey picture of the phone's camera, of its size or scaled, upright or turned by
                a quarter with the phone.
            capture_time: seconds on the phone's clock.

        Raises:
            ValueError: the picture has another shape than the camera's.
        """
        memory = self._memory
        rectifier = self._rectifier_of(image)
        features = self._extractor.extract(rectifier(image))
        since_fix = self._since_fix(capture_time)
        prior = memory.world_from_camera if abs(since_fix) <= self.options.prior_seconds else None
        trusted = prior is not None and capture_time - memory.trusted_time <= self.options.trust_seconds
        lens = self._lens_of(rectifier.target)
        ideal = lens.belief.camera.pinhole_part()
        straight = replace(features, pixels=lens.belief.camera.straightened(features.pixels))
        answer = self._relocalizer.locate(
            straight,
            ideal,
            prior,
            elapsed=max(since_fix, 0.0),
            trusted=trusted,
            focal_factors=lens.focal_factors,
        )
        if isinstance(answer, Refusal):
            return self._refused(answer, capture_time, sequence)
        fix = lens.widened(answer.fix, answer.view)
        if fix.strong:
            raw = lens.belief.camera.project_rays(ideal.normalize(answer.view.pixels))
            lens.learn(replace(answer.view, pixels=raw))
        return self._fixed(fix, capture_time, sequence)

    def _lens_of(self, pictures: Camera) -> LensEstimator:
        """What estimates the lens of rectified pictures.

        Args:
            pictures: their camera as far as it was told, or a guess.
        """
        size = (pictures.width, pictures.height)
        known = self._memory.lens if self._lens is None else self._lens.belief
        if self._lens is not None and (self._lens.width, self._lens.height) == size:
            return self._lens
        same = None if known is None else known.resized(*size)
        if same is None:
            self._lens = LensEstimator.start(pictures, self._camera is not None, self.options.lens)
        else:
            self._lens = LensEstimator(same, self.options.lens)
        return self._lens

    def _rectifier_of(self, image: NDArray[np.uint8]) -> Rectifier:
        height, width = image.shape
        rectifier = self._rectifier
        if rectifier is None or (width, height) != (rectifier.source.width, rectifier.source.height):
            rectifier = self._rectifier = Rectifier(self._source(width, height))
        return rectifier

    def _source(self, width: int, height: int) -> Camera:
        """The camera of pictures of some size."""
        if self._camera is None:
            return typical_camera(width, height)
        # A phone that is turned on its side may turn its pictures with it.
        for camera in (self._camera, self._camera.rotated(1)):
            if abs(width / height - camera.width / camera.height) <= 0.01:
                return camera.scaled(width, height)
        raise ValueError(
            f"the frame is {width}x{height}, the camera was described as "
            f"{self._camera.width}x{self._camera.height}"
        )

    def _since_fix(self, time: float) -> float:
        """Seconds since the last fix; infinite on a clock that was set back, as that tells nothing of it."""
        since = time - self._memory.fix_time
        return since if since >= -self.options.prior_seconds else math.inf

    def _fixed(self, fix: Fix, time: float, sequence: int) -> Update:
        pose, memory = fix.world_from_camera, self._memory
        known = memory.progress if math.isfinite(self._since_fix(time)) else None
        progress = self._guide.locate(pose, time, known)
        doubtful = progress.doubted is not None
        state = NavigationState.ON_ROUTE
        if not doubtful and self._guide.arrived(progress):
            state = NavigationState.ARRIVED
        # In doubt about where on the route the pose is, nothing is said rather than something false.
        self._guidance = None if doubtful else self._guide.guide(pose, progress, memory.instruction)
        q, p = pose.quaternion, pose.translation
        self._memory = SessionSnapshot(
            state=state,
            quaternion=(float(q[0]), float(q[1]), float(q[2]), float(q[3])),
            position=(float(p[0]), float(p[1]), float(p[2])),
            fix_time=time,
            trusted_time=time if fix.strong else memory.trusted_time,
            progress=progress,
            instruction=memory.instruction if self._guidance is None else self._guidance.instruction,
            lens=None if self._lens is None else self._lens.belief,
        )
        return Update(sequence, time, state, fix, None, self._guidance)

    def _refused(self, refusal: Refusal, time: float, sequence: int) -> Update:
        memory = self._memory
        since_fix = self._since_fix(time)
        if memory.quaternion is None:
            state = NavigationState.SEARCHING
        elif since_fix > self.options.lost_seconds and memory.state is not NavigationState.ARRIVED:
            state = NavigationState.LOST
        else:
            state = memory.state
        self._memory = replace(memory, state=state)
        fresh = memory.quaternion is not None and since_fix <= self.options.guidance_seconds
        return Update(sequence, time, state, None, refusal, self._guidance if fresh else None)
