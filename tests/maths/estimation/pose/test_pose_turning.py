"""Rotations of many vectors at once, against scipy and the quaternions of `maths.attitude`."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from massprop_drake.maths import attitude
from massprop_drake.maths.estimation.pose.turning import (
    by_elements,
    rotation_vectors,
    rotations,
    skews,
    symmetric_matrices,
    times,
)

_RANDOM = np.random.default_rng(11)
_AXES = _RANDOM.standard_normal((200, 3))
_AXES /= np.linalg.norm(_AXES, axis=1, keepdims=True)
ANGLES = [0.0, 1e-12, 1e-7, 9.9e-5, 1.01e-4, 0.3, 1.0, 2.5, np.pi - 1e-3, np.pi - 1e-9]


@pytest.mark.parametrize("angle", ANGLES)
def test_rotations_are_those_of_scipy_and_come_back_up_to_half_a_turn(angle: float) -> None:
    vectors = angle * _AXES
    found = rotations(vectors)
    np.testing.assert_allclose(found, Rotation.from_rotvec(vectors).as_matrix(), atol=2e-15)
    np.testing.assert_allclose(rotation_vectors(found), vectors, atol=1e-13, rtol=1e-9)


def test_half_a_turn_about_every_axis_and_none() -> None:
    for axis in (*np.eye(3), *_AXES[:20]):
        back = rotation_vectors(2.0 * np.outer(axis, axis) - np.eye(3))
        assert np.linalg.norm(back) == pytest.approx(np.pi, abs=1e-12)
        assert abs(back @ axis) == pytest.approx(np.pi, abs=1e-12)
    np.testing.assert_array_equal(rotation_vectors(np.eye(3)), np.zeros(3))


def test_more_than_half_a_turn_comes_back_the_short_way() -> None:
    vector = np.array([0.0, 0.0, 4.0])
    np.testing.assert_allclose(rotation_vectors(rotations(vector)), [0.0, 0.0, 4.0 - 2.0 * np.pi], atol=1e-14)


def test_the_quaternions_of_attitude_turn_the_same_way() -> None:
    for vector in 1.7 * _AXES[:20]:
        matrix = attitude.rotation_matrix(attitude.from_rotation_vector(vector))
        np.testing.assert_allclose(rotations(vector), matrix, atol=1e-14)


def test_crosses_and_products_of_hand_values() -> None:
    first, second = _AXES[:5], _AXES[5:10]
    np.testing.assert_allclose(times(skews(first), second), np.cross(first, second), atol=1e-15)
    elements = _RANDOM.standard_normal((5, 6))
    matrix = symmetric_matrices(elements)
    hand = elements[0]
    by_hand = [[hand[0], hand[5], hand[4]], [hand[5], hand[1], hand[3]], [hand[4], hand[3], hand[2]]]
    np.testing.assert_array_equal(matrix[0], by_hand)
    np.testing.assert_allclose(times(by_elements(first), elements), times(matrix, first), atol=1e-15)
