"""The pose graph of similarities: drift of rotation, place and scale around a loop."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from client_sim.synthetic.cameras import level_rotation
from server.geometry.poses import Sim3, rotation_angle, rotation_from_vector
from server.mapping.pose_graph import Edge, optimise

NODES = 40


def _loop() -> list[Sim3]:
    """Once around a circle of 10 m circumference's worth of radius, looking ahead."""
    angle = np.linspace(0.0, 2 * np.pi, NODES, endpoint=False)
    return [
        Sim3(1.0, level_rotation(a + np.pi / 2), 4.0 * np.array([np.cos(a), np.sin(a), 0.0])) for a in angle
    ]


def _drifted(truth: list[Sim3], *, turn: float, shrink: float, noise: float, seed: int) -> list[Sim3]:
    """Dead reckoning of the loop: each step turns and shrinks a little too much."""
    rng = np.random.default_rng(seed)
    nodes = [truth[0]]
    for a, b in pairwise(truth):
        step = a.inverse().compose(b)
        error = rotation_from_vector(rng.normal([0.0, turn, 0.0], noise))
        nodes.append(nodes[-1].compose(Sim3(shrink, step.rotation @ error, step.translation)))
    return nodes


def _steps(nodes: list[Sim3]) -> list[Edge]:
    edges = []
    for step in (1, 2):
        for a in range(len(nodes) - step):
            measured = nodes[a].inverse().compose(nodes[a + step])
            edges.append(Edge(a, a + step, measured, max(float(np.linalg.norm(measured.translation)), 1e-6)))
    return edges


def _errors(nodes: list[Sim3], truth: list[Sim3]) -> np.ndarray:
    return np.array(
        [np.linalg.norm(n.translation - t.translation) for n, t in zip(nodes, truth, strict=True)]
    )


@pytest.mark.parametrize("seed", range(3))
def test_a_drifting_loop_is_closed(seed: int) -> None:
    truth = _loop()
    drifted = _drifted(truth, turn=0.008, shrink=0.985, noise=0.002, seed=seed)
    before = _errors(drifted, truth)
    assert before[-1] > 1.0
    closing = Edge(0, NODES - 1, truth[0].inverse().compose(truth[-1]), 4.0, weight=2.0)
    after = optimise(drifted, [*_steps(drifted), closing])
    error = _errors(after, truth)
    assert error.max() < 0.35 * before.max()
    assert error[-1] < 0.1
    scales = np.array([n.scale for n in after])
    assert abs(np.log(scales[-1])) < 0.1
    assert np.abs(np.log([n.scale for n in drifted])).max() > 0.5
    turned = rotation_angle(after[-1].rotation.T @ truth[-1].rotation)
    assert np.degrees(turned) < 2.0


def test_the_first_node_stays() -> None:
    truth = _loop()
    drifted = _drifted(truth, turn=0.01, shrink=0.99, noise=0.0, seed=0)
    closing = Edge(0, NODES - 1, truth[0].inverse().compose(truth[-1]), 4.0)
    first = optimise(drifted, [*_steps(drifted), closing])[0]
    np.testing.assert_array_equal(first.rotation, drifted[0].rotation)
    np.testing.assert_array_equal(first.translation, drifted[0].translation)
    assert first.scale == drifted[0].scale


def test_measurements_that_agree_change_nothing() -> None:
    truth = _loop()
    closing = Edge(3, NODES - 1, truth[3].inverse().compose(truth[-1]), 4.0)
    after = optimise(truth, [*_steps(truth), closing])
    assert _errors(after, truth).max() < 1e-9


def test_drift_is_spread_evenly() -> None:
    """The turn that is missing at the end is found in every step alike, not in one bend."""
    truth = _loop()
    drifted = _drifted(truth, turn=0.01, shrink=1.0, noise=0.0, seed=0)
    closing = Edge(0, NODES - 1, truth[0].inverse().compose(truth[-1]), 1.0, weight=10.0)
    after = optimise(drifted, [*_steps(drifted), closing])
    bend = [
        rotation_angle((a.rotation.T @ b.rotation).T @ (c.rotation.T @ d.rotation))
        for a, b, c, d in zip(drifted, drifted[1:], after, after[1:], strict=False)
    ]
    assert max(bend) < np.radians(1.5)
    assert sum(bend) > np.radians(0.6 * 39 * np.degrees(0.01))
    assert max(bend) < 4.0 * np.median(bend)


def test_the_strength_of_a_closure_decides_how_far_it_pulls() -> None:
    truth = _loop()
    drifted = _drifted(truth, turn=0.008, shrink=0.99, noise=0.0, seed=1)
    measured = truth[0].inverse().compose(truth[-1])
    ends = [
        _errors(optimise(drifted, [*_steps(drifted), Edge(0, NODES - 1, measured, 4.0, weight=w)]), truth)[-1]
        for w in (0.01, 0.3, 3.0)
    ]
    assert ends[0] > ends[1] > ends[2]
