"""Cameras with lenses: their projection against OpenCV's, their pictures against their projection."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from client_sim.synthetic.cameras import LensCamera, Pose, level_rotation, project
from client_sim.synthetic.rendering import Renderer
from client_sim.synthetic.worlds import World, wall
from tests.synthetic.intersections import camera_rays, first_quads

LENSES = [
    LensCamera("SIMPLE_RADIAL", 320, 240, (240.0, 158.0, 121.0, -0.12)),
    LensCamera("RADIAL", 320, 240, (240.0, 158.0, 121.0, -0.2, 0.05)),
    LensCamera("OPENCV", 320, 240, (240.0, 245.0, 158.0, 121.0, 0.12, -0.2, 0.004, -0.003)),
    LensCamera("OPENCV", 240, 320, (240.0, 245.0, 121.0, 158.0, -0.25, 0.08, -0.002, 0.003)),
    LensCamera("OPENCV_FISHEYE", 320, 240, (130.0, 131.0, 158.0, 121.0, 0.03, -0.01, 0.002, 0.0)),
]


def _matrix(camera: LensCamera) -> np.ndarray:
    fx, fy, cx, cy = camera.intrinsics()
    return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])


@pytest.mark.parametrize("camera", LENSES)
def test_projection_is_opencv_s(camera: LensCamera) -> None:
    points = np.random.default_rng(1).uniform([-1, -0.8, 1.8], [1, 0.8, 4.0], size=(200, 3))
    zero = np.zeros(3)
    coefficients = camera.params[3 if "RADIAL" in camera.model else 4 :]
    lens = (_matrix(camera), np.pad(coefficients, (0, 4 - len(coefficients))))
    if camera.fisheye:
        expected = cv2.fisheye.projectPoints(points[:, None], zero, zero, *lens)[0]
    else:
        expected = cv2.projectPoints(points, zero, zero, *lens)[0]
    np.testing.assert_allclose(
        camera.pixels(points[:, :2] / points[:, 2:]), np.asarray(expected).reshape(-1, 2), atol=1e-6
    )


@pytest.mark.parametrize("camera", LENSES)
def test_each_pixel_s_ray_projects_to_its_centre(camera: LensCamera) -> None:
    slopes = np.stack(camera.slopes(), axis=-1)
    seen = np.isfinite(slopes).all(axis=-1)
    assert seen.mean() > 0.75
    centres = np.stack(np.meshgrid(np.arange(camera.width), np.arange(camera.height)), axis=-1) + 0.5
    np.testing.assert_allclose(camera.pixels(slopes[seen]), centres[seen], atol=1e-6)


@pytest.mark.parametrize("camera", LENSES)
def test_a_disc_lands_where_its_centre_projects(camera: LensCamera) -> None:
    texture = np.zeros((500, 500, 3), np.uint8)
    cv2.circle(texture, (341, 187), 7, (255, 255, 255), -1)
    quad = wall((3.0, -2.5), (3.0, 2.5), 0.0, 2.5, texture)
    point = quad.point(*(np.array([341.5, 187.5]) / 500 * quad.size))
    pose = Pose(level_rotation(-0.3, 0.05, 0.2), np.array([0.0, 0.1, 1.4]))
    image = Renderer(World("dot", (quad,)), camera).render(pose)[..., 1].astype(np.float64)
    assert image.shape == (camera.height, camera.width)
    image[image < 60] = 0.0
    v, u = np.indices(image.shape) + 0.5
    centroid = np.array([(u * image).sum(), (v * image).sum()]) / image.sum()
    np.testing.assert_allclose(centroid, project(camera, pose, point), atol=0.12)


@pytest.mark.parametrize("camera", LENSES[2:])
def test_bent_edges_are_drawn_to_the_pixel(camera: LensCamera) -> None:
    grey = np.full((8, 8, 3), 128, np.uint8)
    sizes = ((2.0, -1.0, -0.1, 1.8), (3.0, -1.2, 0.5, 2.2), (5.0, -2.0, 1.5, 2.9))
    quads = tuple(wall((x, low), (x, high), 0.3, top, grey) for x, low, high, top in sizes)
    pose = Pose(level_rotation(0.1, 0.1, 0.2), np.array([0.0, 0.1, 1.4]))
    world = World("walls", quads)
    seen = Renderer(world, camera).surfaces(pose).ravel()
    rays = camera_rays(camera, pose)
    lit = np.isfinite(rays).all(axis=1)
    expected, _ = first_quads(world, pose.position, rays[lit])
    assert (seen[lit] != expected).mean() < 1e-3
    assert set(np.unique(expected)) == {-1, 0, 1, 2}


def test_a_camera_file_names_the_model() -> None:
    document = LENSES[2].to_json(30.0)
    assert document["model"] == "OPENCV"
    assert document["params"] == list(LENSES[2].params)
    with pytest.raises(ValueError, match="RADIAL"):
        LensCamera("RADIAL", 10, 10, (1.0,))
