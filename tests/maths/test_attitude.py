"""Unit quaternions against rotation matrices and scipy's rotations."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from massprop_drake.maths.attitude import (
    conjugate,
    from_rotation_vector,
    multiply,
    propagated,
    rotation_matrix,
    to_rotation_vector,
)
from massprop_drake.maths.linear_algebra import Array


def assert_equal_but_for_rounding(actual: Array, expected: ArrayLike) -> None:
    # sums of products of a few factors of size one; each rounding is 1.1e-16
    np.testing.assert_allclose(actual, expected, rtol=0.0, atol=2e-15)


def random_quaternions(seed: int, count: int) -> Array:
    quaternions = np.random.default_rng(seed).standard_normal((count, 4))
    return quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)


def test_quarter_turn_about_z_takes_body_x_to_inertial_y() -> None:
    matrix = rotation_matrix(np.array([np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)]))
    assert_equal_but_for_rounding(matrix, [[0, -1, 0], [1, 0, 0], [0, 0, 1]])


def test_rotation_matrix_agrees_with_scipy() -> None:
    for quaternion in random_quaternions(1, 50):
        expected = Rotation.from_quat(quaternion, scalar_first=True).as_matrix()
        assert_equal_but_for_rounding(rotation_matrix(quaternion), expected)


def test_product_of_the_units_is_hamiltons() -> None:
    one, i, j, k = np.eye(4)
    np.testing.assert_array_equal(multiply(i, j), k)
    np.testing.assert_array_equal(multiply(j, k), i)
    np.testing.assert_array_equal(multiply(k, i), j)
    np.testing.assert_array_equal(multiply(j, i), -k)
    np.testing.assert_array_equal(multiply(i, i), -one)


def test_product_composes_rotations_from_the_right() -> None:
    for left, right in random_quaternions(2, 40).reshape(20, 2, 4):
        expected = rotation_matrix(left) @ rotation_matrix(right)
        assert_equal_but_for_rounding(rotation_matrix(multiply(left, right)), expected)


def test_conjugate_undoes_a_rotation() -> None:
    for quaternion in random_quaternions(3, 20):
        assert_equal_but_for_rounding(multiply(quaternion, conjugate(quaternion)), [1, 0, 0, 0])
        assert_equal_but_for_rounding(rotation_matrix(conjugate(quaternion)), rotation_matrix(quaternion).T)


# either side of the angle 1e-4 where the series takes over, and large turns
@pytest.mark.parametrize("angle", [1e-9, 1e-6, 9.99e-5, 1.01e-4, 1e-2, 1.0, 3.0, 5.0])
def test_quaternion_of_a_rotation_vector_agrees_with_its_definition(angle: float) -> None:
    axis = np.array([2.0, -3.0, 6.0]) / 7.0
    quaternion = from_rotation_vector(angle * axis)
    expected = np.array([np.cos(0.5 * angle), *np.sin(0.5 * angle) * axis])
    # the series' first neglected term is angle^4 / 1920 < 1e-19 of the leading one; a rounding of the
    # angle 3 counts 1.5 tan(1.5) = 21-fold in its cosine
    np.testing.assert_allclose(quaternion, expected, rtol=1e-14)


def test_no_rotation_is_the_unit_quaternion() -> None:
    np.testing.assert_array_equal(from_rotation_vector(np.zeros(3)), [1, 0, 0, 0])
    np.testing.assert_array_equal(to_rotation_vector(np.array([1.0, 0.0, 0.0, 0.0])), [0, 0, 0])


@pytest.mark.parametrize("angle", [1e-12, 1e-8, 3e-8, 1e-4, 1.0, 3.1])
def test_rotation_vector_survives_the_round_trip(angle: float) -> None:
    vector = angle * np.array([-1.0, 2.0, 2.0]) / 3.0
    np.testing.assert_allclose(to_rotation_vector(from_rotation_vector(vector)), vector, rtol=1e-14)


def test_rotation_vector_takes_the_shorter_way() -> None:
    # 4 rad about an axis is 2 pi - 4 rad the other way; the sign of a quaternion does not matter
    axis = np.array([2.0, -3.0, 6.0]) / 7.0
    quaternion = from_rotation_vector(4.0 * axis)
    shorter = (4.0 - 2.0 * np.pi) * axis
    np.testing.assert_allclose(to_rotation_vector(quaternion), shorter, rtol=1e-14)
    np.testing.assert_allclose(to_rotation_vector(-quaternion), shorter, rtol=1e-14)


def test_propagation_obeys_the_kinematic_equation() -> None:
    # dq/dt = 1/2 q (0, w) with w in body axes; central difference over h errs by (|w| h)^2 / 24 = 2e-11
    quaternion = random_quaternions(4, 1)[0]
    rate = np.array([0.1, -0.2, 0.05])
    step = 1e-4
    difference = (propagated(quaternion, rate, step) - propagated(quaternion, rate, -step)) / (2.0 * step)
    expected = 0.5 * multiply(quaternion, np.array([0.0, *rate]))
    np.testing.assert_allclose(difference, expected, rtol=0.0, atol=1e-11)


def test_constant_body_rate_adds_up_to_one_turn() -> None:
    rate = np.array([0.3, -0.6, 0.2])
    start = random_quaternions(5, 1)[0]
    attitude = start
    for _ in range(100):
        attitude = propagated(attitude, rate, 0.05)
    # a hundred roundings of a few epsilon
    np.testing.assert_allclose(attitude, multiply(start, from_rotation_vector(5.0 * rate)), rtol=0.0, atol=1e-13)


def test_propagation_renormalizes() -> None:
    attitude = propagated(np.array([1.0, 0.0, 0.0, 1e-3]), np.array([0.1, 0.2, 0.3]), 0.08)
    assert np.linalg.norm(attitude) == pytest.approx(1.0, abs=4e-16)
