"""Local and global alignment against similarities that are known."""

from __future__ import annotations

import numpy as np
import pytest

from server.evaluation.alignment import align_route, mean_rotation, similarity_with_rotation
from server.geometry.poses import SE3, Sim3, rotation_angle, rotation_from_vector
from tests.evaluation.worlds import into_map, l_shape

SIMILARITY = Sim3(0.37, rotation_from_vector([0.4, -1.1, 2.0]), np.array([5.0, -2.0, 9.0]))


def test_mean_rotation_of_symmetric_spread_is_the_centre() -> None:
    centre = rotation_from_vector([0.3, 1.0, -0.4])
    spread = np.concatenate([0.5 * np.eye(3), -0.5 * np.eye(3)])
    mean = mean_rotation(centre @ rotation_from_vector(spread))
    assert rotation_angle(mean.T @ centre) < 1e-12
    assert np.linalg.det(mean) == pytest.approx(1.0)


def test_scale_and_translation_for_a_given_rotation_on_a_straight_line() -> None:
    line = np.linspace(0.0, 1.0, 7)[:, None] * np.array([[1.0, 2.0, 0.5]])
    found = similarity_with_rotation(SIMILARITY @ line, line, SIMILARITY.rotation)
    assert found.scale == pytest.approx(SIMILARITY.scale)
    np.testing.assert_allclose(found.translation, SIMILARITY.translation, atol=1e-12)


def test_a_turn_on_the_spot_takes_the_fallback_scale() -> None:
    spot = np.ones((4, 3))
    found = similarity_with_rotation(SIMILARITY @ spot, spot, SIMILARITY.rotation, fallback_scale=0.37)
    np.testing.assert_allclose(found @ spot, SIMILARITY @ spot, atol=1e-12)
    assert found.scale == 0.37


def test_every_local_alignment_undoes_a_known_similarity_even_on_straight_stretches() -> None:
    truth = l_shape()
    path = into_map(truth, SIMILARITY)
    aligned = align_route(path, truth, np.arange(0, len(truth), 5))
    inverse = SIMILARITY.inverse()
    for local in (aligned.whole, *aligned.local):
        assert local.scale == pytest.approx(inverse.scale, rel=1e-9)
        assert rotation_angle(local.rotation.T @ inverse.rotation) < 1e-7
        np.testing.assert_allclose(local.translation, inverse.translation, atol=1e-7)


def test_local_alignment_follows_a_map_that_bends_where_the_global_one_cannot() -> None:
    truth = l_shape()
    bend = rotation_from_vector(np.outer(0.02 * np.arange(len(truth)) / 10.0, [0.0, 0.0, 1.0]))
    path = into_map(truth, Sim3.identity())
    bent = np.cumsum(
        np.einsum("nij,nj->ni", bend, np.diff(truth.position, axis=0, prepend=truth.position[:1])), axis=0
    )
    path = type(path)(path.time, bend @ path.rotation, bent)
    aligned = align_route(path, truth, np.arange(0, len(truth), 5))
    middle = SE3(path.rotation[-3], path.position[-3])
    local = aligned.relative_to_route(middle).translation - truth.position[-3]
    whole = aligned.whole @ path.position - truth.position
    assert np.linalg.norm(local) < 0.1
    assert np.linalg.norm(whole, axis=1).max() > 0.2


def test_nearest_keyframe_tells_the_way_out_from_the_way_back() -> None:
    out = l_shape()
    turned = rotation_from_vector([0.0, 0.0, np.pi]) @ out.rotation[::-1]
    both = type(out)(
        0.1 * np.arange(2 * len(out)),
        np.concatenate([out.rotation, turned]),
        np.concatenate([out.position, out.position[::-1]]),
    )
    aligned = align_route(both, both, np.arange(0, len(both), 5))
    back = 2 * len(out) - 31
    pose = SE3(both.rotation[back], both.position[back])
    assert abs(aligned.nearest_keyframe(pose) * 5 - back) <= 5
