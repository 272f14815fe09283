"""Passers-by: where they are, how their legs go, and masks that fit them."""

from __future__ import annotations

import numpy as np
import pytest

from client_sim.synthetic.cameras import PinholeCamera, Pose, level_rotation
from client_sim.synthetic.people import Passerby, crowd_at
from client_sim.synthetic.rendering import Renderer
from client_sim.synthetic.worlds import World, floor, wall
from tests.synthetic.intersections import camera_rays, first_quads, solid_distance

CAMERA = PinholeCamera(160, 120, 125.0, 125.0, 80.0, 60.0)
GREY = np.full((8, 8, 3), 128, np.uint8)
PATH = ((2.0, -1.0, 0.0), (2.0, 5.0, 0.0))


def test_somebody_is_where_their_walk_takes_them_and_gone_outside_it() -> None:
    walker = Passerby(PATH, start_s=10.0, speed=1.5, look=3)
    assert walker.at(9.9) == ()
    assert walker.at(14.1) == ()
    for t in (10.5, 12.0, 13.9):
        middle = np.mean([solid.centre for solid in walker.at(t)], axis=0)
        np.testing.assert_allclose(middle[:2], [2.0, -1.0 + 1.5 * (t - 10.0)], atol=0.12)
    staying = Passerby(PATH, start_s=10.0, speed=1.5, look=3, stay=True)
    assert len(staying.at(0.0)) == len(staying.at(99.0)) == len(walker.at(12.0))


def test_a_person_stands_on_the_floor_and_is_as_tall_as_people() -> None:
    for look in range(12):
        solids = Passerby(PATH, speed=1.3, look=look).at(1.7)
        reach = [np.sqrt((solid.axes[2] ** 2).sum()) for solid in solids]
        top = max(solid.centre[2] + r for solid, r in zip(solids, reach, strict=True))
        bottom = min(solid.centre[2] - r for solid, r in zip(solids, reach, strict=True))
        assert 1.5 < top < 2.0
        assert -0.06 < bottom < 0.08


def test_legs_swing_once_in_two_steps() -> None:
    """The shoes change places in front of each other as the body goes on."""
    walker = Passerby(((0.0, 0.0, 0.0), (30.0, 0.0, 0.0)), speed=1.0, look=2)
    times = np.arange(1.0, 9.0, 0.02)
    ahead = []
    for t in times:
        low = sorted(walker.at(t), key=lambda solid: solid.centre[2])[:2]
        left, right = sorted(low, key=lambda solid: -solid.centre[1])
        ahead.append(left.centre[0] - right.centre[0])
    changes = np.flatnonzero(np.diff(np.sign(ahead)))
    step = np.diff(times[changes]).mean()
    assert 0.6 < step < 0.85, "metres a step at a metre a second"
    assert np.ptp(ahead) / 2 == pytest.approx(step, rel=0.2), "feet are a step apart"


@pytest.mark.parametrize("t", [0.8, 1.9, 2.6])
def test_masks_are_the_silhouettes(t: float) -> None:
    """A pixel is in the mask if and only if its ray meets a body before anything else."""
    pillar = wall((1.4, 0.4), (1.4, 0.0), 0.0, 2.4, GREY)
    world = World(
        "hall",
        (
            wall((6.0, -4.0), (6.0, 4.0), 0.0, 3.0, GREY),
            floor((-1.0, -4.0), (6.0, 4.0), 0.0, GREY),
            wall((1.4, 0.0), (1.4, 0.4), 0.0, 2.4, GREY),
            pillar,
        ),
    )
    people = (Passerby(PATH, speed=0.9, look=1), Passerby(((4.0, 2.0, 0.0), (1.0, 0.5, 0.0)), look=2))
    solids = crowd_at(people, t)
    pose = Pose(level_rotation(0.05, -0.1, 0.05), np.array([0.0, 0.2, 1.4]))
    shot = Renderer(world, CAMERA).shoot([pose], solids=solids)
    rays = camera_rays(CAMERA, pose)
    _, wall_distance = first_quads(world, pose.position, rays)
    nearest = np.min([solid_distance(solid, pose.position, rays) for solid in solids], axis=0)
    expected = (nearest < wall_distance).reshape(CAMERA.height, CAMERA.width)
    assert 0.01 < expected.mean() < 0.5
    assert (shot.mask("person") != expected).mean() < 1e-3
    np.testing.assert_allclose(shot.depth[expected], nearest.reshape(expected.shape)[expected], rtol=2e-3)
    assert len({int(label) for label in np.unique(shot.labels[expected])}) in (1, 2)
    assert set(np.unique(shot.labels[~shot.mask("person")])) == {-1}


def test_each_look_is_a_person_and_the_same_one_each_time() -> None:
    world = World("hall", (wall((6.0, -4.0), (6.0, 4.0), 0.0, 3.0, GREY),))
    renderer = Renderer(world, CAMERA)
    pose = Pose(level_rotation(0.0), np.array([0.0, 0.5, 1.4]))

    def picture(look: int) -> np.ndarray:
        return renderer.shoot([pose], solids=Passerby(PATH, look=look).at(1.2)).image

    np.testing.assert_array_equal(picture(4), picture(4))
    assert (picture(4) != picture(5)).mean() > 0.02
