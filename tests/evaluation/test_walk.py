"""Reading walk folders, good and bad."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from server.evaluation.walk import Trajectory, WalkError, arc_length, read_trajectory, read_walk
from tests.evaluation.worlds import CAMERA


def _folder(folder: Path, **meta: object) -> Path:
    (folder / "video.mp4").write_bytes(b"")
    (folder / "camera.json").write_text(json.dumps(CAMERA.to_json() | {"fps": 10}))
    (folder / "meta.json").write_text(json.dumps(meta))
    (folder / "groundtruth.txt").write_text(
        "# comment\n0 1 2 3 0 0 0 1\n\n0.1 1 2 4 0 0 0.7071068 0.7071068\n"
    )
    return folder


def test_a_walk_folder_is_read(tmp_path: Path) -> None:
    walk = read_walk(_folder(tmp_path, world="lab", off_route_frames=[1, 1]))
    assert walk.camera == CAMERA
    assert walk.world == "lab"
    assert not walk.real
    np.testing.assert_array_equal(walk.truth.position, [[1, 2, 3], [1, 2, 4]])
    np.testing.assert_allclose(walk.truth.rotation[1] @ [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], atol=1e-6)
    assert walk.on_route(np.array([0, 1])).tolist() == [True, False]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "no poses"),
        ("0 1 2 3 0 0 0\n", ":1: expected eight numbers"),
        ("0 1 2 3 0 0 0 1\n0.1 1 x 3 0 0 0 1\n", ":2: expected eight numbers"),
        ("0 1 2 nan 0 0 0 1\n", "expected eight numbers"),
        ("0 1 2 3 0 0 0 1\n0 1 2 3 0 0 0 1\n", "time does not increase"),
        ("0 1 2 3 0 0 0 0\n", "quaternion is zero"),
    ],
)
def test_a_bad_truth_is_named(tmp_path: Path, text: str, message: str) -> None:
    file = tmp_path / "groundtruth.txt"
    file.write_text(text)
    with pytest.raises(WalkError, match=message):
        read_trajectory(file)


def test_what_a_folder_lacks_is_named(tmp_path: Path) -> None:
    with pytest.raises(WalkError, match="no such folder"):
        read_walk(tmp_path / "nowhere")
    folder = _folder(tmp_path)
    (folder / "camera.json").write_text('{"model": "PINHOLE"}')
    with pytest.raises(WalkError, match=r"camera\.json: camera description lacks 'width'"):
        read_walk(folder)
    (folder / "video.mp4").unlink()
    with pytest.raises(WalkError, match=r"video\.mp4: missing"):
        read_walk(folder)


def test_nearest_in_time() -> None:
    time = np.arange(10) / 30
    truth = Trajectory(time, np.tile(np.eye(3), (10, 1, 1)), np.zeros((10, 3)))
    assert truth.nearest([0.0, 0.1, 0.2001, 0.018, 99.0]).tolist() == [0, 3, 6, 1, 9]


def test_arc_length_ignores_bobbing() -> None:
    x = np.linspace(0.0, 20.0, 182)
    bob = 0.03 * np.sin(2 * np.pi * 2.0 * np.arange(182) / 10)
    position = np.stack([x, np.zeros_like(x), bob], axis=1)
    assert arc_length(position)[-1] == pytest.approx(20.0, rel=0.015)
    assert np.linalg.norm(np.diff(position, axis=0), axis=1).sum() > 20.3


@pytest.mark.recorded
def test_recorded_walks_are_read(recorded_data: Path) -> None:
    kitchen = read_walk(recorded_data / "walks" / "kitchen" / "leader")
    assert kitchen.real
    assert len(kitchen.truth) == 500
    away = read_walk(recorded_data / "walks" / "house" / "follower_deviation")
    assert away.off_route == (234, 337)
    assert away.truth.time[-1] == pytest.approx(53.4)
