"""Pictures: that they are drawn for every kind of follower, and what lies where."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from server.evaluation.follower import judge_follower
from server.evaluation.leader import judge_leader
from server.evaluation.plots import ground_plane, write_plots
from server.evaluation.walk import Trajectory, Walk
from server.geometry.poses import rotation_from_vector
from tests.evaluation.worlds import answers_of, figures, l_shape, map_of, walk_of


def test_pictures_of_right_false_refused_and_foreign_followers(tmp_path: Path) -> None:
    truth = l_shape()
    walk = walk_of(truth)
    tracked = np.ones(len(truth), np.bool_)
    tracked[5:9] = False
    leader = judge_leader(walk, map_of(truth, tracked=tracked), figures(len(truth)))
    moved = truth.position.copy()
    moved[30:33] += [2.0, 1.0, 0.0]
    answers = answers_of(Trajectory(truth.time, truth.rotation, moved), refused=range(60, 70))
    good = judge_follower(walk, leader, walk_of(truth, "good", off_route=(90, 99)), answers)
    lost = judge_follower(walk, leader, walk_of(truth, "lost"), answers_of(truth, refused=range(len(truth))))
    foreign = Walk(Path("foreign"), walk.camera, truth, world="elsewhere")
    wrong = judge_follower(walk, leader, foreign, answers)
    written = write_plots(tmp_path, leader, [good, lost, wrong])
    assert [path.name for path in written] == [
        "leader.png",
        "follower_good.png",
        "follower_lost.png",
        "follower_foreign.png",
        "latency.png",
    ]
    for path in written:
        picture = cv2.imread(str(path))
        assert picture is not None
        assert min(picture.shape[:2]) > 400
        assert (picture != 255).any(axis=2).mean() > 0.02
    red = cv2.imread(str(written[1])).astype(int) - [40, 39, 214]
    assert (np.abs(red).max(axis=2) < 12).sum() > 100, "false fixes are drawn in red"


def test_the_view_from_above_needs_no_upright_world() -> None:
    truth = l_shape()
    np.testing.assert_array_equal(ground_plane(truth), np.eye(3)[:2])
    tilt = rotation_from_vector([1.2, 0.3, 0.0])
    tilted = Trajectory(truth.time, tilt @ truth.rotation, truth.position @ tilt.T)
    plane = ground_plane(tilted)
    np.testing.assert_allclose(plane @ plane.T, np.eye(2), atol=1e-9)
    seen, upright = tilted.position @ plane.T, truth.position[:, :2]
    apart = np.linalg.norm(seen[:, None] - seen[None], axis=2)
    np.testing.assert_allclose(apart, np.linalg.norm(upright[:, None] - upright[None], axis=2), atol=0.02)
    first, last = seen[40] - seen[0], seen[-1] - seen[-40]
    assert first[0] * last[1] - first[1] * last[0] > 0, "a left turn looks like one"
