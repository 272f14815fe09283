"""Pictures of the synthetic building against geometry worked out another way."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from client_sim.synthetic.buildings import CORRIDOR_AND_ROOM, build_world
from client_sim.synthetic.cameras import PinholeCamera, Pose, level_rotation, project
from client_sim.synthetic.rendering import NOWHERE, Light, Renderer
from client_sim.synthetic.worlds import Quad, Texture, World, floor, wall

CAMERA = PinholeCamera(width=320, height=240, fx=250.0, fy=260.0, cx=161.3, cy=118.2)
GREY = np.full((8, 8, 3), 128, np.uint8)


def _box_room() -> World:
    """A 4 x 3 m room without ceiling, with a box in it."""
    corners = [(0.0, 0.0), (4.0, 0.0), (4.0, 3.0), (0.0, 3.0)]
    box = [(1.8, 1.0), (1.8, 1.9), (2.6, 1.9), (2.6, 1.0)]
    quads = [wall(a, b, 0.0, 2.5, GREY) for a, b in zip(corners, corners[1:] + corners[:1], strict=True)]
    quads += [wall(a, b, 0.0, 0.8, GREY) for a, b in zip(box, box[1:] + box[:1], strict=True)]
    quads += [floor((0.0, 0.0), (4.0, 3.0), 0.0, GREY), floor(box[0], box[2], 0.8, GREY)]
    return World("room", tuple(quads))


def _pose(x: float, y: float, z: float, *angles: float) -> Pose:
    return Pose(level_rotation(*angles), np.array([x, y, z]))


POSES = [
    _pose(0.7, 0.6, 1.5, 0.6, -0.2, 0.1),
    _pose(3.6, 2.5, 1.9, -2.4, -0.6, -0.3),
    _pose(1.1, 1.4, 0.4, 0.05, 0.1, 0.0),
]


def _first_hit(world: World, pose: Pose, rays: NDArray[np.float64]) -> NDArray[np.int64]:
    """Nearest front-facing quad along world rays (N, 3), by plain intersection in double precision."""
    best = np.full(len(rays), np.inf)
    hit = np.full(len(rays), NOWHERE)
    for q, quad in enumerate(world.quads):
        towards = rays @ quad.normal
        with np.errstate(divide="ignore", invalid="ignore"):
            distance = (quad.corner - pose.position) @ quad.normal / towards
            inside = (towards < 0) & (distance > 0) & (distance < best)
            place = pose.position + distance[:, None] * rays - quad.corner
            for edge in (quad.across, quad.down):
                along = place @ edge / (edge @ edge)
                inside &= (along >= 0) & (along <= 1)
        best[inside], hit[inside] = distance[inside], q
    return hit


@pytest.mark.parametrize("pose", POSES)
def test_each_pixel_centre_sees_the_nearest_surface(pose: Pose) -> None:
    world = _box_room()
    u, v = np.meshgrid(np.arange(CAMERA.width) + 0.5, np.arange(CAMERA.height) + 0.5)
    x, y = (u - CAMERA.cx) / CAMERA.fx, (v - CAMERA.cy) / CAMERA.fy
    rays = np.stack([x, y, np.ones_like(x)], axis=-1).reshape(-1, 3) @ pose.rotation.T
    seen = Renderer(world, CAMERA).surfaces(pose)
    wrong = seen.ravel() != _first_hit(world, pose, rays)
    assert wrong.mean() < 5e-4
    assert len(np.unique(seen)) >= 4


def _dot_on_a_wall(radius: float) -> tuple[World, NDArray[np.float64]]:
    """A black wall with one white disc, and where its centre is in the world."""
    texture = np.zeros((500, 500, 3), np.uint8)
    centre = np.array([341, 187])
    cv2.circle(texture, (int(centre[0]), int(centre[1])), int(radius), (255, 255, 255), -1)
    quad = wall((3.0, -2.5), (3.0, 2.5), 0.0, 2.5, texture)
    assert quad.normal @ [-1.0, 0.0, 0.0] > 0.99
    across, down = (centre + 0.5) / 500 * quad.size
    return World("dot", (quad,)), quad.point(across, down)


@pytest.mark.parametrize("heading", [-0.35, 0.0, 0.2])
def test_a_known_point_lands_on_its_pixel_with_centres_at_half(heading: float) -> None:
    world, point = _dot_on_a_wall(8.0)
    pose = _pose(0.0, 0.1, 1.4, heading, 0.05, 0.3)
    image = Renderer(world, CAMERA).render(pose)[..., 1].astype(np.float64)
    image = np.maximum(image - 45.0, 0.0)  # beside the wall the picture is dark grey
    v, u = np.indices(image.shape) + 0.5
    centroid = np.array([(u * image).sum(), (v * image).sum()]) / image.sum()
    np.testing.assert_allclose(centroid, project(CAMERA, pose, point), atol=0.06)


def test_axes_x_right_y_down_z_forward() -> None:
    pose = _pose(0.0, 0.0, 1.5, 0.0)
    pixels = project(CAMERA, pose, np.array([[2.0, 0.0, 1.5], [2.0, -0.5, 1.5], [2.0, 0.0, 1.0]]))
    np.testing.assert_allclose(pixels[0], [CAMERA.cx, CAMERA.cy])
    assert pixels[1, 0] > pixels[0, 0]
    assert pixels[2, 1] > pixels[0, 1]
    assert np.linalg.det(level_rotation(1.0, 0.2, -0.3)) == pytest.approx(1.0)
    rolled = project(CAMERA, _pose(0.0, 0.0, 1.5, 0.0, 0.0, 0.2), np.array([2.0, 0.0, 2.0]))
    assert rolled[0] < CAMERA.cx, "a camera tilted clockwise sees what is above it on its left"


def _noise(side: int) -> Texture:
    noise = np.random.default_rng(3).integers(0, 256, size=(side, side, 1), dtype=np.uint8)
    return np.asarray(noise.repeat(3, axis=2), dtype=np.uint8)


@pytest.mark.parametrize("heading", [0.0, 1.2])
def test_far_and_slanted_textures_are_averaged_not_sampled(heading: float) -> None:
    """Squeezed by k texels a pixel, white noise must lose its contrast, about as 1 / k."""
    quad = wall((4.0, -2.0), (4.0, 2.0), 0.0, 4.0, _noise(1600))
    eye = np.array([4.0, 0.0, 2.0]) - 4.0 * np.array([np.cos(heading), np.sin(heading), 0.0])
    renderer = Renderer(World("noise", (quad,)), CAMERA)
    pose = Pose(level_rotation(heading), eye)
    patch = renderer.render(pose)[100:140, 150:170, 1]
    squeezed = 1600 / 4.0 * 4.0 / CAMERA.fx
    assert patch.std() < 1.2 * 74.0 / squeezed
    assert patch.mean() == pytest.approx(127.5, abs=8.0)


def test_two_views_of_a_wall_agree_by_the_homography_of_the_truth() -> None:
    world = build_world("demo", CORRIDOR_AND_ROOM, np.random.default_rng(11))
    renderer = Renderer(world, CAMERA)
    first, second = _pose(4.5, 1.2, 1.5, 0.1, -0.05), _pose(5.0, 0.9, 1.45, -0.08, 0.02, 0.04)
    index = 1
    quad = world.quads[index]

    def shown(pose: Pose, of: Quad) -> NDArray[np.float32]:
        corners = [of.point(a, b) for a in (0.5, 1.5) for b in (1.0, 2.0)]
        # OpenCV counts pixels from the centre of the first.
        return (project(CAMERA, pose, np.array(corners)) - 0.5).astype(np.float32)

    a, b = renderer.render(first), renderer.render(second)
    seen = (renderer.surfaces(second) == index).astype(np.uint8)
    size = (CAMERA.width, CAMERA.height)

    def difference(claimed: Pose) -> float:
        homography = cv2.getPerspectiveTransform(shown(claimed, quad), shown(second, quad))
        warped = cv2.warpPerspective(a, homography, size)
        source = (renderer.surfaces(first) == index).astype(np.uint8)
        both = cv2.erode(seen & cv2.warpPerspective(source, homography, size), np.ones((9, 9), np.uint8))
        assert both.mean() > 0.05
        return float(np.abs(warped.astype(float) - b)[both > 0].mean())

    true = difference(first)
    moved = difference(Pose(first.rotation, first.position + np.array([0.0, 0.03, 0.0])))
    turned = difference(Pose(first.rotation @ level_rotation(0.01) @ level_rotation(0.0).T, first.position))
    assert true < 4.0
    assert moved > 1.5 * true
    assert turned > 1.5 * true


def test_the_same_seed_gives_the_same_building_and_another_seed_another() -> None:
    pose = _pose(1.0, 1.0, 1.5, 0.0)

    def image(seed: int) -> NDArray[np.uint8]:
        world = build_world("demo", CORRIDOR_AND_ROOM, np.random.default_rng(seed))
        return Renderer(world, CAMERA).render(pose, Light(), np.random.default_rng(seed))

    first = image(4)
    np.testing.assert_array_equal(first, image(4))
    assert (first != image(5)).mean() > 0.3


def test_no_pixel_looks_out_of_the_demo_building() -> None:
    world = build_world("demo", CORRIDOR_AND_ROOM, np.random.default_rng(0))
    renderer = Renderer(world, CAMERA)
    for x, y in ((1.0, 1.0), (7.0, 3.0), (9.5, 8.5)):
        for heading in np.linspace(0.0, 6.0, 7):
            assert (renderer.surfaces(_pose(x, y, 1.5, float(heading), 0.1)) != NOWHERE).all()


def test_light_darkens_warms_and_adds_noise_of_its_size() -> None:
    renderer = Renderer(_box_room(), CAMERA)
    pose = POSES[0]
    plain = renderer.render(pose).astype(float)
    dark = renderer.render(pose, Light(gain=0.5, warmth=1.2, vignette=0.0, noise=0.0)).astype(float)
    walls = plain[..., 1] == 128
    assert dark[walls][:, 1].mean() == pytest.approx(64.0, abs=1.0)
    assert dark[walls][:, 2].mean() == pytest.approx(64.0 * np.sqrt(1.2), abs=1.0)
    light = Light(vignette=0.0, noise=3.0)
    noisy = renderer.render(pose, light, np.random.default_rng(1)).astype(float)
    assert (noisy - plain)[walls].std() == pytest.approx(3.0, rel=0.1)
    again = renderer.render(pose, light, np.random.default_rng(2)).astype(float)
    assert (noisy - again)[walls].std() == pytest.approx(3.0 * np.sqrt(2), rel=0.1)
