"""Written files are read by others: numpy and scipy, trimesh."""

from __future__ import annotations

import io
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from demo_route import DemoRoute
from scipy.spatial.transform import Rotation

from server.geometry.poses import rotation_from_quaternion
from server.mapping.exchange.ply import ply_file
from server.mapping.exchange.tum import tum_trajectory
from server.mapping.route_map import RouteMap, Scale, ScaleSource

SCALES = [Scale(), Scale(1.7, ScaleSource.MEASURED_LENGTH)]


def in_metres(route_map: RouteMap) -> float:
    return route_map.scale.metres_per_unit or 1.0


@pytest.mark.parametrize("scale", SCALES, ids=["unknown", "known"])
@pytest.mark.parametrize("keyframes_only", [False, True])
def test_a_trajectory_says_where_the_camera_was(
    demo_route: DemoRoute, scale: Scale, keyframes_only: bool
) -> None:
    route_map = replace(demo_route.route_map, scale=scale)
    text = tum_trajectory(route_map, keyframes_only=keyframes_only)
    table = np.loadtxt(io.StringIO(text))
    path, keyframes = route_map.path, route_map.keyframes
    rows = keyframes.frame if keyframes_only else np.flatnonzero(path.tracked)
    position = keyframes.position if keyframes_only else path.position[rows]
    quaternion = keyframes.quaternion if keyframes_only else path.quaternion[rows]
    np.testing.assert_allclose(table[:, 0], path.time[rows], atol=1e-6)
    np.testing.assert_allclose(table[:, 1:4], in_metres(route_map) * position, atol=1e-6)
    read = Rotation.from_quat(table[:, 4:]).as_matrix()
    np.testing.assert_allclose(read, rotation_from_quaternion(quaternion), atol=1e-7)
    unit = text.splitlines()[2]
    assert ("in metres" in unit) == (scale.metres_per_unit is not None)
    assert ("map units" in unit) == (scale.metres_per_unit is None)


def test_poses_between_others_are_left_out(demo_route: DemoRoute) -> None:
    path = demo_route.route_map.path
    tracked = path.tracked.copy()
    tracked[10:15] = False
    text = tum_trajectory(replace(demo_route.route_map, path=replace(path, tracked=tracked)))
    times = np.loadtxt(io.StringIO(text))[:, 0]
    np.testing.assert_allclose(times, path.time[tracked], atol=1e-6)
    assert f"{tracked.sum()} tracked frames, of {len(path)}" in text


@pytest.mark.parametrize("scale", SCALES, ids=["unknown", "known"])
def test_a_point_cloud_shows_landmarks_and_path(demo_route: DemoRoute, scale: Scale) -> None:
    route_map = replace(demo_route.route_map, scale=scale)
    data = ply_file(route_map)
    read = trimesh.load(io.BytesIO(data), file_type="ply")
    landmarks, path = route_map.landmarks.position, route_map.path.position
    expected = in_metres(route_map) * np.concatenate([landmarks, path])
    np.testing.assert_allclose(read.vertices, expected, atol=1e-5 * np.abs(expected).max())
    (line,) = read.entities
    drawn = np.array(line.points)
    assert set(drawn.tolist()) == set(range(len(landmarks), len(landmarks) + len(path)))
    assert (np.abs(np.diff(drawn)) == 1).all()
    vertices = read.metadata["_ply_raw"]["vertex"]["data"]
    colours = np.stack([vertices[name].ravel() for name in ("red", "green", "blue")], axis=1)
    # From the darkest to the brightest: the lowest landmark to the highest, the walk's start to its end.
    for low, high in ((landmarks[:, 2].argmin(), landmarks[:, 2].argmax()), (-len(path), -1)):
        assert colours[low].tolist() == [68, 1, 84]
        assert colours[high].tolist() == [253, 231, 37]
    comment = data[:400].decode("ascii", "replace")
    assert ("in metres" in comment) == (scale.metres_per_unit is not None)
