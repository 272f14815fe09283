"""The office: its ways are free, its stairs have steps, its storeys differ, its days too."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray

from client_sim.synthetic.cameras import PinholeCamera, Pose, level_rotation
from client_sim.synthetic.office import HEIGHT, PLACES, RISE, STAIRS, build_office
from client_sim.synthetic.rendering import NOWHERE, Renderer
from client_sim.synthetic.venue import Building
from tests.synthetic.intersections import camera_rays, first_quads

SMALL = PinholeCamera(112, 84, 88.0, 88.0, 56.0, 42.0)
UP = np.array([0.0, 0.0, 1.0])
ROUTES = ("main", "stairs")


@pytest.fixture(scope="module")
def renderer(office: Building) -> Renderer:
    return Renderer(office.world, SMALL)


def _along(route: tuple[tuple[float, float, float], ...], step: float) -> NDArray[np.float64]:
    """Floor points (N, 3) every ``step`` metres."""
    points = np.array(route)
    at = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    even = np.arange(0.0, at[-1], step)
    return np.stack([np.interp(even, at, points[:, k]) for k in range(3)], axis=1)


def test_the_main_route_is_60_m_with_six_right_angles_on_one_storey(office: Building) -> None:
    route = np.array(office.routes["main"])
    legs = np.diff(route, axis=0)
    assert np.linalg.norm(legs, axis=1).sum() == pytest.approx(60.0, abs=1.5)
    heading = np.arctan2(legs[:, 1], legs[:, 0])
    turns = np.degrees((np.diff(heading) + np.pi) % (2 * np.pi) - np.pi)
    np.testing.assert_allclose(np.abs(turns), 90.0, atol=1e-9)
    assert len(turns) == 6
    assert np.ptp(route[:, 2]) == 0.0


@pytest.mark.parametrize("name", ROUTES)
def test_one_stands_on_something_all_along_a_route(office: Building, name: str) -> None:
    """From the eye down there is floor at the route's height, on stairs within half a riser of it."""
    points = _along(office.routes[name], 0.13)
    _, fall = first_quads(office.world, points + UP * 1.5, np.tile([1e-4, 1e-4, -1.0], (len(points), 1)))
    level = np.isin(points[:, 2], (0.0, RISE / 2, RISE))
    assert level.any()
    np.testing.assert_allclose(fall[level], 1.5, atol=1e-6)
    np.testing.assert_allclose(fall[~level], 1.5, atol=STAIRS.riser / 2 + 1e-3)


@pytest.mark.parametrize("change", [None, 1, 2, 3])
def test_nothing_stands_in_the_way(change: int | None) -> None:
    """A body 0.5 m wide gets along both routes, at the knee and at the eye, whatever has been moved."""
    building = build_office(change=change)
    solids = np.array([solid.centre for solid in building.world.solids])
    for name in ROUTES:
        for start, end in pairwise(np.array(building.routes[name])):
            way = end - start
            side = 0.25 * np.array([-way[1], way[0], 0.0]) / np.hypot(way[0], way[1])
            eyes = np.array([start + b * side + h * UP for h in (0.5, 1.5) for b in (-1, 0, 1)])
            _, distance = first_quads(building.world, eyes, np.tile(way, (len(eyes), 1)))
            assert distance.min() > 1.0, (name, start, end)
            beside = solids[np.abs(solids[:, 2] - start[2]) < 2.0][:, :2]
            along = np.clip((beside - start[:2]) @ way[:2] / (way[:2] @ way[:2]), 0, 1)
            assert np.linalg.norm(start[:2] + along[:, None] * way[:2] - beside, axis=1).min() > 0.4


def test_steps_rise_and_recede_evenly(office: Building) -> None:
    """Straight down onto the first flight: ten risers of 16 cm, treads of 28 cm."""
    x = np.arange(STAIRS.entry - 0.1, STAIRS.entry + STAIRS.run + 0.1, 0.01)
    eyes = np.array([STAIRS.world(at, 0.6, 2.9) for at in x])
    _, fall = first_quads(office.world, eyes, np.tile(-UP, (len(x), 1)))
    height = 2.9 - fall
    np.testing.assert_allclose(height, [STAIRS.floor_height(at, 0.6) for at in x], atol=1e-9)
    rises = np.diff(height)
    np.testing.assert_allclose(rises[rises > 1e-6], RISE / 20)
    assert (rises > 1e-6).sum() == 10
    np.testing.assert_allclose(np.diff(x[:-1][rises > 1e-6]), 0.28, atol=0.011)


def test_one_sees_out_of_the_building_nowhere(office: Building, renderer: Renderer) -> None:
    for name in ROUTES:
        for point in _along(office.routes[name], 3.1):
            for heading, pitch in ((0.3, -0.5), (1.9, 0.6), (3.4, 0.0), (5.0, -0.6)):
                shot = renderer.shoot([Pose(level_rotation(heading, pitch), point + 1.5 * UP)])
                assert np.isfinite(shot.depth).all(), (point, heading, pitch)


@pytest.mark.parametrize(
    ("place", "heading"), [("lobby", 0.1), ("office", 2.0), ("landing", 1.2), ("library", 3.0)]
)
def test_what_is_hidden_is_skipped_and_nothing_else(
    office: Building, renderer: Renderer, place: str, heading: float
) -> None:
    pose = Pose(level_rotation(heading, -0.1), PLACES[place] + 1.5 * UP)
    _, distance = first_quads(office.world, pose.position, camera_rays(SMALL, pose))
    shot = renderer.shoot([pose])
    plain = shot.surface.ravel() != NOWHERE
    assert plain.mean() > 0.8
    wrong = np.abs(shot.depth.ravel() / distance - 1)[plain] > 1e-3
    assert wrong.mean() < 2e-3


def test_the_storeys_look_alike_but_are_not_the_same(office: Building) -> None:
    renderer = Renderer(office.world, PinholeCamera(320, 240, 250.0, 250.0, 160.0, 120.0))
    for x, y, heading in ((7.0, 2.7, 0.0), (18.9, 5.0, 1.57)):
        below, above = (
            renderer.render(Pose(level_rotation(heading), np.array([x, y, z + 1.5]))).astype(float)
            for z in (0.0, RISE)
        )
        assert np.corrcoef(below.ravel(), above.ravel())[0, 1] > 0.6
        assert (np.abs(below - above).max(axis=2) > 25).mean() > 0.03


def test_another_day_moves_movable_things_and_light_but_no_wall(office: Building) -> None:
    later, again = build_office(change=4), build_office(change=4)

    def fixed(building: Building) -> list[tuple[float, ...]]:
        return [
            (*quad.corner, *quad.across, *quad.down) for quad in building.world.quads if quad.thing is None
        ]

    def moved(building: Building) -> set[tuple[str, tuple[float, ...]]]:
        parts = (*building.world.quads, *building.world.solids)
        return {
            (part.thing.category, tuple(np.round(part.corner if hasattr(part, "corner") else part.centre, 6)))
            for part in parts
            if part.thing is not None
        }

    assert set(fixed(later)) == set(fixed(office))
    assert moved(later) != moved(office)
    assert moved(later) == moved(again)
    assert len(moved(later) & moved(office)) > 20
    light = [building.world.quads[0].light for building in (office, later)]
    assert light[0] is not None
    assert light[1] is not None
    assert light[0].mean() != pytest.approx(light[1].mean(), rel=0.02)


def test_a_seed_is_a_building(office: Building) -> None:
    again, other = build_office(), build_office(8)
    pose = Pose(level_rotation(0.0), np.array([7.0, 2.7, 1.5]))
    pictures = [Renderer(b.world, SMALL).render(pose) for b in (office, again, other)]
    np.testing.assert_array_equal(pictures[0], pictures[1])
    assert (pictures[0] != pictures[2]).mean() > 0.2


def test_a_point_has_a_storey(office: Building) -> None:
    heights = (-0.1, 0.0, 1.6, RISE - 0.01, RISE, RISE + 1.5)
    assert [office.storey_of(z) for z in heights] == [0, 0, 0, 0, 1, 1]
    assert office.storeys[1].z == RISE


def test_walls_and_slabs_stand_between_rooms(office: Building) -> None:
    """Lobby to meeting room: through walls; straight up: through one slab."""
    a, b = (PLACES[name] + 1.2 * UP for name in ("lobby", "meeting room"))
    crossed = 0
    for x0, y0, x1, y1, bottom, top in office.obstacles.walls:
        edge, way = np.array([x1 - x0, y1 - y0]), (b - a)[:2]
        determinant = way[0] * edge[1] - way[1] * edge[0]
        if abs(determinant) < 1e-12:
            continue
        offset = np.array([x0, y0]) - a[:2]
        t = (offset[0] * edge[1] - offset[1] * edge[0]) / determinant
        u = (offset[0] * way[1] - offset[1] * way[0]) / determinant
        crossed += 0 <= t <= 1 and 0 <= u <= 1 and bottom <= 1.2 <= top
    assert 3 <= crossed <= 12
    x, y = PLACES["office"][:2]
    above = [z for x0, y0, x1, y1, z in office.obstacles.slabs if x0 <= x <= x1 and y0 <= y <= y1]
    assert any(HEIGHT <= z <= RISE for z in above)
