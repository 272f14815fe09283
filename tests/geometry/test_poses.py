"""Rotations, rigid motions and similarities against scipy and their own definitions."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from server.geometry.poses import (
    SE3,
    Sim3,
    align_similarity,
    quaternion_from_rotation,
    rotation_angle,
    rotation_from_quaternion,
    rotation_from_vector,
    skew,
    vector_from_rotation,
)

replayable = settings(derandomize=True, deadline=None, max_examples=200)

components = st.floats(-1.0, 1.0)
axes = (
    st.tuples(components, components, components)
    .filter(lambda v: np.linalg.norm(v) > 0.05)
    .map(lambda v: np.array(v) / np.linalg.norm(v))
)
angles = st.one_of(
    st.floats(0.0, np.pi - 1e-7),
    st.floats(-14.0, -1.0).map(lambda e: 10.0**e),
    st.floats(-7.0, -1.0).map(lambda e: np.pi - 10.0**e),
)


def _random_se3(rng: np.random.Generator) -> SE3:
    return SE3(Rotation.random(rng=rng).as_matrix(), rng.normal(0, 3, 3))


@replayable
@given(axes, angles)
@example(np.array([0.0, 0.0, 1.0]), 0.0)
@example(np.array([0.6, 0.0, -0.8]), 9.9e-9)
@example(np.array([0.6, 0.0, -0.8]), 1.01e-8)
def test_exponential_agrees_with_scipy_and_the_logarithm_undoes_it(axis: np.ndarray, angle: float) -> None:
    vector = angle * axis
    rotation = rotation_from_vector(vector)
    np.testing.assert_allclose(rotation, Rotation.from_rotvec(vector).as_matrix(), atol=2e-15)
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=2e-15)
    # Near pi a rounding error of the matrix turns into one of the axis, but no more than that.
    np.testing.assert_allclose(vector_from_rotation(rotation), vector, atol=4e-15 + 4e-15 * angle)
    assert rotation_angle(rotation) == pytest.approx(angle, abs=4e-15)


@replayable
@given(axes)
@example(np.array([1.0, 0.0, 0.0]))
@example(np.array([0.0, -1.0, 0.0]))
@example(np.array([0.0, 0.0, 1.0]))
def test_half_a_turn_has_two_logarithms_and_gives_one(axis: np.ndarray) -> None:
    rotation = Rotation.from_rotvec(np.pi * axis).as_matrix()
    vector = vector_from_rotation(rotation)
    assert np.linalg.norm(vector) == pytest.approx(np.pi, abs=1e-12)
    assert abs(vector @ axis) == pytest.approx(np.pi, abs=1e-12)
    np.testing.assert_allclose(rotation_from_vector(vector), rotation, atol=1e-14)


def test_tiny_rotations_keep_their_digits() -> None:
    vector = np.array([3e-13, -4e-13, 1.2e-12])
    np.testing.assert_allclose(vector_from_rotation(rotation_from_vector(vector)), vector, rtol=1e-3)
    np.testing.assert_array_equal(vector_from_rotation(np.eye(3)), np.zeros(3))


def test_derivative_of_the_exponential_at_zero_is_the_cross_product() -> None:
    rng = np.random.default_rng(3)
    x, h = rng.normal(size=3), 1e-6
    numeric = np.stack(
        [(rotation_from_vector(h * e) @ x - rotation_from_vector(-h * e) @ x) / (2 * h) for e in np.eye(3)],
        axis=1,
    )
    np.testing.assert_allclose(numeric, -skew(x), atol=1e-9)
    v = rng.normal(size=3)
    np.testing.assert_allclose(skew(v) @ x, np.cross(v, x), atol=1e-15)


@replayable
@given(axes, angles, st.floats(0.1, 10.0), st.sampled_from([-1.0, 1.0]))
def test_quaternions_agree_with_scipy(axis: np.ndarray, angle: float, norm: float, sign: float) -> None:
    expected = Rotation.from_rotvec(angle * axis)
    found = quaternion_from_rotation(expected.as_matrix())
    assert np.linalg.norm(found) == pytest.approx(1.0, abs=1e-15)
    same = expected.as_quat()  # x, y, z, w
    np.testing.assert_allclose(found * np.sign(found @ same), same, atol=4e-15)
    np.testing.assert_allclose(rotation_from_quaternion(sign * norm * same), expected.as_matrix(), atol=4e-15)


def test_conversions_work_on_whole_arrays() -> None:
    rotations = Rotation.random(24, rng=np.random.default_rng(1))
    matrices = rotations.as_matrix().reshape(4, 6, 3, 3)
    quaternions = quaternion_from_rotation(matrices)
    assert quaternions.shape == (4, 6, 4)
    np.testing.assert_allclose(rotation_from_quaternion(quaternions), matrices, atol=1e-14)
    vectors = vector_from_rotation(matrices)
    np.testing.assert_allclose(vectors, rotations.as_rotvec().reshape(4, 6, 3), atol=1e-13)
    np.testing.assert_allclose(rotation_from_vector(vectors), matrices, atol=1e-13)


def test_motions_compose_and_invert() -> None:
    rng = np.random.default_rng(2)
    a_from_b, b_from_c = _random_se3(rng), _random_se3(rng)
    points = rng.normal(size=(5, 4, 3))
    np.testing.assert_allclose((a_from_b @ b_from_c) @ points, a_from_b @ (b_from_c @ points), atol=1e-13)
    np.testing.assert_allclose(a_from_b.inverse() @ (a_from_b @ points), points, atol=1e-13)
    np.testing.assert_allclose(
        a_from_b @ points[0, 0], a_from_b.matrix @ np.append(points[0, 0], 1.0), atol=1e-13
    )
    back = SE3.from_quaternion(a_from_b.quaternion, a_from_b.translation)
    np.testing.assert_allclose(back.matrix, a_from_b.matrix, atol=1e-14)
    turned = SE3.exp([0.0, 0.3, 0.0, 1.0, 2.0, 3.0])
    np.testing.assert_allclose(turned.translation, [1.0, 2.0, 3.0])
    assert turned.angle_to(SE3.identity()) == pytest.approx(0.3, abs=1e-14)
    assert (a_from_b @ turned).angle_to(a_from_b) == pytest.approx(0.3, abs=1e-13)


def test_similarities_compose_invert_and_carry_poses() -> None:
    rng = np.random.default_rng(4)
    a_from_b = Sim3(2.5, Rotation.random(rng=rng).as_matrix(), rng.normal(size=3))
    b_from_c = Sim3(0.3, Rotation.random(rng=rng).as_matrix(), rng.normal(size=3))
    points = rng.normal(size=(7, 3))
    np.testing.assert_allclose(
        a_from_b.compose(b_from_c) @ points, a_from_b @ (b_from_c @ points), atol=1e-13
    )
    np.testing.assert_allclose(a_from_b.inverse() @ (a_from_b @ points), points, atol=1e-13)
    np.testing.assert_allclose(Sim3.identity() @ points, points)
    # A camera sees the same picture of the same things in either frame, only larger or smaller.
    b_from_camera = _random_se3(rng)
    a_from_camera = a_from_b.transform_pose(b_from_camera)
    local_b = b_from_camera.inverse() @ points
    local_a = a_from_camera.inverse() @ (a_from_b @ points)
    np.testing.assert_allclose(local_a, 2.5 * local_b, atol=1e-12)


@replayable
@given(
    st.integers(0, 2**32 - 1),
    st.integers(3, 30),
    st.floats(-3.0, 3.0).map(lambda e: 10.0**e),
    st.sampled_from([0.0, 1e-9, 1.0]),
)
def test_alignment_recovers_a_similarity_exactly(seed: int, count: int, scale: float, depth: float) -> None:
    """Depth 0 is a plane, where a reflection fits as well as the rotation."""
    rng = np.random.default_rng(seed)
    truth = Sim3(scale, Rotation.random(rng=rng).as_matrix(), rng.normal(0, 10, 3))
    flat = rng.normal(size=(count, 3)) * [1.0, 1.0, depth]
    source = flat @ Rotation.random(rng=rng).as_matrix().T
    found = align_similarity(truth @ source, source)
    assert np.linalg.det(found.rotation) == pytest.approx(1.0, abs=1e-12)
    spread = np.sqrt(((source - source.mean(axis=0)) ** 2).sum(axis=1).mean())
    np.testing.assert_allclose(found @ source, truth @ source, atol=1e-11 * max(10.0, scale * spread))


@pytest.mark.parametrize("mirrored", [False, True])
@pytest.mark.parametrize("with_scale", [False, True])
def test_alignment_is_the_least_squares_one(mirrored: bool, with_scale: bool) -> None:
    """Mirrored points, whose best orthogonal fit is no rotation, included."""
    rng = np.random.default_rng(5)
    source = rng.normal(size=(20, 3)) * [3.0, 1.0, 0.5]
    target = 1.7 * source @ Rotation.random(rng=rng).as_matrix().T + rng.normal(0, 0.2, (20, 3))
    if mirrored:
        target[:, 0] *= -1.0
    found = align_similarity(target, source, with_scale=with_scale)
    assert np.linalg.det(found.rotation) == pytest.approx(1.0, abs=1e-12)
    expected, _ = Rotation.align_vectors(target - target.mean(axis=0), source - source.mean(axis=0))
    np.testing.assert_allclose(found.rotation, expected.as_matrix(), atol=1e-9)
    if not with_scale:
        assert found.scale == 1.0
    best = ((found @ source - target) ** 2).sum()
    for step in rng.normal(0, 0.02, (200, 7)):
        scale = found.scale * np.exp(step[6]) if with_scale else 1.0
        other = Sim3(scale, rotation_from_vector(step[:3]) @ found.rotation, found.translation + step[3:6])
        assert ((other @ source - target) ** 2).sum() > best


@pytest.mark.parametrize(
    ("target", "source", "complaint"),
    [
        (np.eye(3)[:2], np.eye(3)[:2], "at least three"),
        (np.eye(3), np.ones((4, 3)), "at least three"),
        (np.eye(3), np.ones((3, 3)), "coincide"),
    ],
)
def test_alignment_refuses_what_determines_nothing(
    target: np.ndarray, source: np.ndarray, complaint: str
) -> None:
    with pytest.raises(ValueError, match=complaint):
        align_similarity(target, source)
