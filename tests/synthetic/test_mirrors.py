"""A mirror shows the scene where geometry puts its image."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from client_sim.synthetic.cameras import PinholeCamera, Pose, level_rotation, project
from client_sim.synthetic.mirrors import reflected, reflected_points
from client_sim.synthetic.rendering import Renderer
from client_sim.synthetic.worlds import Quad, Solid, Thing, World, floor, wall

CAMERA = PinholeCamera(320, 240, 250.0, 260.0, 161.3, 118.2)
DARK = np.zeros((8, 8, 3), np.uint8)
GLASS = np.full((4, 4, 3), 255, np.uint8)
ON, NORMAL = np.array([3.0, 0.0, 0.0]), np.array([-1.0, 0.0, 0.0])


def _spotted(start: tuple[float, float], end: tuple[float, float]) -> tuple[Quad, np.ndarray]:
    """A black wall with one white disc, and where that is."""
    texture = np.zeros((500, 500, 3), np.uint8)
    cv2.circle(texture, (330, 190), 10, (255, 255, 255), -1)
    quad = wall(start, end, 0.0, 2.5, texture)
    width, height = quad.size
    return quad, quad.point(330.5 / 500 * width, 190.5 / 500 * height)


def _room() -> tuple[World, np.ndarray]:
    """A mirror at x = 3 that looks to -x, a disc on the wall opposite, a white wall behind the mirror."""
    opposite, disc = _spotted((-2.0, 2.5), (-2.0, -2.5))
    glass = wall((3.0, -1.5), (3.0, 1.5), 0.2, 2.3, GLASS)
    mirror = Quad(glass.corner, glass.across, glass.down, GLASS, mirror=True)
    np.testing.assert_allclose(mirror.normal, NORMAL, atol=1e-12)
    behind = wall((3.4, -3.0), (3.4, 3.0), 0.0, 3.0, np.full((8, 8, 3), 255, np.uint8))
    # Seen from the mirror's back, this stands between the camera's image and the glass.
    blind = wall((3.2, 3.0), (3.2, -3.0), 0.0, 3.0, np.full((8, 8, 3), 255, np.uint8))
    # This goes through the glass's plane: what is of it behind must not show either.
    through = wall((4.0, 1.0), (2.99, 1.0), 0.0, 3.0, np.full((8, 8, 3), 255, np.uint8))
    ground = floor((-2.0, -2.5), (3.0, 2.5), 0.0, DARK)
    return World("mirror", (mirror, opposite, behind, blind, through, ground)), disc


def _inner(mask: np.ndarray) -> np.ndarray:
    """The mask without the pixels at its edge, where the lens mixes in what is beside it."""
    return cv2.erode(mask.astype(np.uint8), np.ones((7, 7), np.uint8)) > 0


@pytest.mark.parametrize("heading", [-0.2, 0.0, 0.15])
def test_a_point_is_seen_where_its_mirror_image_projects(heading: float) -> None:
    world, disc = _room()
    pose = Pose(level_rotation(heading, -0.05, 0.1), np.array([0.5, 0.2, 1.4]))
    shot = Renderer(world, CAMERA).shoot([pose])
    # Of the wall that goes through the glass a hair's breadth is really seen.
    plain = _inner(shot.mirror & (shot.surface != 4))
    image = np.where(plain, shot.image[..., 1], 0).astype(np.float64)
    image[image < 60] = 0.0
    v, u = np.indices(image.shape) + 0.5
    centroid = np.array([(u * image).sum(), (v * image).sum()]) / image.sum()
    virtual = reflected_points(disc, ON, NORMAL)
    np.testing.assert_allclose(virtual, disc * [-1, 1, 1] + [6, 0, 0])
    expected = project(CAMERA, pose, virtual)
    np.testing.assert_allclose(centroid, expected, atol=0.1)
    column, row = expected.astype(int)
    assert shot.depth[row, column] == pytest.approx(pose.to_camera(virtual)[2], rel=0.02)


def test_the_mirror_is_where_its_corners_project_and_hides_what_is_behind_it() -> None:
    world, _ = _room()
    pose = Pose(level_rotation(0.0), np.array([0.5, 0.0, 1.3]))
    shot = Renderer(world, CAMERA).shoot([pose])
    quad = world.quads[0]
    corners = [quad.corner + a * quad.across + b * quad.down for a in (0, 1) for b in (0, 1)]
    pixels = project(CAMERA, pose, np.array(corners))
    rows, columns = np.nonzero(shot.mirror)
    np.testing.assert_allclose([columns.min(), rows.min()], pixels.min(axis=0), atol=1.0)
    np.testing.assert_allclose([columns.max() + 1, rows.max() + 1], pixels.max(axis=0), atol=1.0)
    # White are only the disc's image and the walls behind the glass, which must not show in it.
    assert (shot.image[_inner(shot.mirror), 1] > 128).mean() < 0.01


def test_people_are_reflected_and_labelled() -> None:
    world, _ = _room()
    body = Solid(np.array([1.6, -0.3, 1.2]), np.diag([0.12, 0.12, 0.3]), GLASS, thing=Thing("person"))
    pose = Pose(level_rotation(0.0), np.array([0.5, 0.2, 1.3]))
    shot = Renderer(world, CAMERA).shoot([pose], solids=[body])
    mask = shot.mask("person")
    for centre, mirrored in ((body.centre, False), (reflected_points(body.centre, ON, NORMAL), True)):
        column, row = project(CAMERA, pose, centre).astype(int)
        assert mask[row, column]
        assert shot.mirror[row, column] == mirrored
    assert mask.any()
    assert not shot.mask("chair").any()


def test_reflecting_twice_is_doing_nothing() -> None:
    pose = Pose(level_rotation(0.4, 0.1, 0.2), np.array([1.0, 2.0, 1.5]))
    once = reflected(pose, ON, NORMAL)
    twice = reflected(once, ON, NORMAL)
    assert np.linalg.det(once.rotation) == pytest.approx(-1.0)
    np.testing.assert_allclose(twice.rotation, pose.rotation, atol=1e-12)
    np.testing.assert_allclose(twice.position, pose.position, atol=1e-12)
    point = np.array([0.3, -0.7, 1.1])
    np.testing.assert_allclose(
        once.to_camera(point), pose.to_camera(reflected_points(point, ON, NORMAL)), atol=1e-12
    )
