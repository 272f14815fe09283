"""Pictures of the synthetic building: what each pixel sees, its filtered texture, light, blur, noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from client_sim.synthetic.cameras import Camera, Pose
from client_sim.synthetic.ellipsoids import draw_solids
from client_sim.synthetic.exposure import ExposureSettings, Light, add_noise, develop
from client_sim.synthetic.mirrors import reflected, reflection_canvas
from client_sim.synthetic.motion_blur import blurred, motion
from client_sim.synthetic.rasterising import NOWHERE, Planes, RayGrid, Surfaces, blank, draw
from client_sim.synthetic.texturing import Textures
from client_sim.synthetic.worlds import Quad, Solid, Thing, World

__all__ = ["NOWHERE", "Light", "Renderer", "Shot"]

Image = NDArray[np.uint8]
Floats = NDArray[np.float32]
Mask = NDArray[np.bool_]

OUTSIDE = 40
"""Grey level of what is no surface."""


@dataclass(frozen=True, eq=False, slots=True)
class Shot:
    """A picture with the truth about the middle of its exposure.

    Attributes:
        image: (H, W, 3) uint8, BGR.
        depth: (H, W) z of what each pixel's centre sees, in a mirror that of its image behind the glass;
            infinite where it sees nothing.
        surface: (H, W) index of the quad, :data:`NOWHERE` for others.
        labels: (H, W) index into ``things`` of the thing that is seen, -1 for the building.
        things: what ``labels`` counts.
        mirror: (H, W) True where it is seen in a mirror.
    """

    image: Image
    depth: Floats
    surface: NDArray[np.int32]
    labels: NDArray[np.int32]
    things: tuple[Thing, ...]
    mirror: Mask

    def mask(self, category: str) -> Mask:
        """(H, W) True where something of a category is seen, in a mirror too."""
        wanted = np.array([thing.category == category for thing in self.things] + [False])
        return np.asarray(wanted[self.labels])

    @property
    def brightness(self) -> float:
        """Mean grey level."""
        return float(self.image[::4, ::4].mean())


@dataclass(frozen=True, eq=False, slots=True)
class _View:
    """What the pixels see: surfaces count the quads, then those of each mirror, then the solids."""

    surface: NDArray[np.int32]
    inverse_depth: Floats
    mirror: NDArray[np.intp]
    planes: tuple[Planes, ...]
    painted: Image


class Renderer:
    """Draws one world for one camera."""

    def __init__(self, world: World, camera: Camera) -> None:
        self.world = world
        self.camera = camera
        self._grid = RayGrid(camera)
        self._surfaces = Surfaces(world.quads)
        self._textures = Textures(world.quads, self._surfaces)
        self._mirrors = [q for q, quad in enumerate(world.quads) if quad.mirror]
        parts: tuple[Quad | Solid, ...] = (*world.quads, *world.solids)
        self._things = _things(parts)
        self._quad_labels = self._labels(world.quads, self._things)
        column = np.linspace(-1, 1, camera.width, dtype=np.float32)[None, :] * (camera.width / 2)
        row = np.linspace(-1, 1, camera.height, dtype=np.float32)[:, None] * (camera.height / 2)
        radius = column**2 + row**2
        self._darkening = radius / radius.max()

    @staticmethod
    def _labels(parts: Sequence[Quad | Solid], things: Sequence[Thing]) -> NDArray[np.int32]:
        number = {id(thing): k for k, thing in enumerate(things)}
        return np.array([number.get(id(part.thing), -1) for part in parts], dtype=np.int32)

    def surfaces(self, pose: Pose) -> NDArray[np.int16]:
        """Index of the quad each pixel's centre sees, (H, W); :data:`NOWHERE` where it sees none."""
        view = self._view(pose, self.world.solids)
        return self._quad_index(view).astype(np.int16)

    def render(self, pose: Pose, light: Light | None = None, rng: np.random.Generator | None = None) -> Image:
        """The picture from a pose, (H, W, 3) uint8, BGR.

        Args:
            light: exposure; without it the bare textures.
            rng: draws the sensor noise; without it there is none.
        """
        return self._picture([pose], light, rng, (), None)[0]

    def shoot(
        self,
        poses: Sequence[Pose],
        light: Light | None = None,
        rng: np.random.Generator | None = None,
        solids: Sequence[Solid] = (),
        exposure: ExposureSettings | None = None,
    ) -> Shot:
        """One picture and the truth about it.

        Args:
            poses: the camera while the shutter is open, from its opening to its closing, evenly in time;
                the truth is of the middle one. A single pose gives a sharp picture.
            solids: what stands or walks in the world beside its own things.
            exposure: without it the reference, at which nominal light gives the textures' grey levels.
        """
        image, view = self._picture(poses, light, rng, solids, exposure)
        solids = (*self.world.solids, *solids)
        things = tuple(dict.fromkeys((*self._things, *_things(solids))))
        quad = self._quad_index(view)
        labels = np.append(self._quad_labels, np.int32(-1))[quad]
        solid = view.surface - len(self.world.quads) * len(view.planes)
        if solids:
            of_solids = self._labels(solids, things)
            labels = np.where(solid >= 0, of_solids[np.maximum(solid, 0) % len(solids)], labels)
        seen = (view.surface != NOWHERE) & (view.inverse_depth > 0)
        depth = 1.0 / np.where(seen, view.inverse_depth, np.float32(1.0))
        return Shot(
            image,
            np.where(seen, depth, np.float32(np.inf)),
            quad,
            labels,
            things,
            view.mirror > 0,
        )

    def _picture(
        self,
        poses: Sequence[Pose],
        light: Light | None,
        rng: np.random.Generator | None,
        solids: Sequence[Solid],
        exposure: ExposureSettings | None,
    ) -> tuple[Image, _View]:
        pose = poses[len(poses) // 2]
        exposure = exposure or ExposureSettings()
        view = self._view(pose, (*self.world.solids, *solids))
        colour = self._colour(view, exposure.factor)
        # Without a lens's own blur the silhouettes would be saw-toothed.
        image = np.asarray(cv2.GaussianBlur(colour, (3, 3), 0.6), dtype=np.uint8)
        if len(poses) > 1:
            image = blurred(image, motion(self._grid, view.inverse_depth, pose, poses[0], poses[-1]))
        if light is not None:
            image = develop(image, light, self._darkening)
            if rng is not None and light.noise > 0:
                image = add_noise(image, light.noise * float(np.sqrt(exposure.gain)), rng)
        if self._grid.blind is not None:
            image[self._grid.blind] = 0
        return image, view

    def _quad_index(self, view: _View) -> NDArray[np.int32]:
        count = len(self.world.quads)
        is_quad = (view.surface >= 0) & (view.surface < count * len(view.planes))
        return np.where(is_quad, view.surface % count, np.int32(NOWHERE))

    def _view(self, pose: Pose, solids: Sequence[Solid]) -> _View:
        grid, count = self._grid, len(self.world.quads)
        canvas = blank(grid)
        painted = np.zeros((*grid.shape, 3), dtype=np.uint8) if solids else np.zeros((0, 0, 3), np.uint8)
        planes = [self._surfaces.planes(pose, grid)]
        draw(canvas, grid, planes[0])
        # The solids' indices depend on how many mirrors are in sight: they are moved up at the end.
        first_solid = 1 << 24
        draw_solids(canvas, painted, grid, pose, solids, first_solid)
        mirror = np.zeros(grid.shape, dtype=np.intp)
        for q in self._mirrors:
            inside = canvas.surface == q
            if not inside.any():
                continue
            plane = self._surfaces.corner[q], self._surfaces.normal[q]
            behind = reflected(pose, *plane)
            second = reflection_canvas(grid, inside, planes[0].inverse_depth[q])
            planes.append(self._surfaces.planes(behind, grid, plane))
            draw(second, grid, planes[-1], count * (len(planes) - 1))
            draw_solids(second, painted, grid, behind, solids, first_solid)
            np.copyto(canvas.surface, second.surface, where=inside)
            np.copyto(canvas.inverse_depth, second.inverse_depth, where=inside)
            mirror[inside] = q + 1
        solid = canvas.surface >= first_solid
        canvas.surface[solid] += count * len(planes) - first_solid
        return _View(canvas.surface, canvas.inverse_depth, mirror, tuple(planes), painted)

    def _colour(self, view: _View, factor: float) -> Image:
        count, copies = len(self.world.quads), len(view.planes)
        image = self._textures.look_up(view.surface, view.inverse_depth, view.planes, self._grid, factor)
        solid = view.surface >= count * copies
        if solid.any():
            painted = view.painted[solid]
            image[solid] = painted if factor == 1.0 else cv2.convertScaleAbs(painted, alpha=factor)
        nothing = view.surface < 0
        if nothing.any():
            image[nothing] = OUTSIDE
        for q in self._mirrors:
            inside = view.mirror == q + 1
            if inside.any():
                tint = self.world.quads[q].texture.mean(axis=(0, 1)) / 255.0
                image[inside] = (image[inside] * tint).astype(np.uint8)
        return np.asarray(image, dtype=np.uint8)


def _things(parts: Sequence[Quad | Solid]) -> tuple[Thing, ...]:
    """What the parts belong to, each once."""
    return tuple(dict.fromkeys(part.thing for part in parts if part.thing is not None))
