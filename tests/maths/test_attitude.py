"""Unit quaternions against scipy's rotations, and the kinematic equation."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation

from massprop_drake.maths.attitude import (
    conjugate,
    from_rotation_vector,
    multiply,
    propagate_attitude,
    rotation_matrix,
    to_rotation_vector,
)

ANY = np.random.default_rng(1).standard_normal((30, 4))
ANY /= np.linalg.norm(ANY, axis=1, keepdims=True)
AXIS = np.array([2.0, -3.0, 6.0]) / 7.0


def test_products_and_inverses_are_those_of_rotations() -> None:
    for left, right in zip(ANY, ANY[::-1], strict=True):
        one, other = (Rotation.from_quat(each, scalar_first=True).as_matrix() for each in (left, right))
        # sums of products of a few factors of size one; each rounding is 1.1e-16
        assert_allclose(rotation_matrix(left), one, rtol=0.0, atol=2e-15)
        assert_allclose(rotation_matrix(multiply(left, right)), one @ other, rtol=0.0, atol=2e-15)
        assert_allclose(multiply(left, conjugate(left)), [1, 0, 0, 0], rtol=0.0, atol=2e-15)
    one, i, j, k = np.eye(4)
    for product, expected in (((i, j), k), ((j, k), i), ((k, i), j), ((j, i), -k), ((i, i), -one)):
        assert_array_equal(multiply(*product), expected)


# either side of the angle 1e-4 where the series takes over, of 1e-8, and large turns
@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-9, 1e-8, 3e-8, 9.99e-5, 1.01e-4, 1e-2, 1.0, 3.1, 5.0])
def test_quaternion_of_a_rotation_vector_agrees_with_its_definition(angle: float) -> None:
    quaternion = from_rotation_vector(angle * AXIS)
    # the series' first neglected term is angle^4 / 1920 < 1e-19 of the leading one; a rounding of the
    # angle 3 counts 1.5 tan(1.5) = 21-fold in its cosine
    assert_allclose(
        quaternion, [np.cos(0.5 * angle), *np.sin(0.5 * angle) * AXIS], rtol=1e-14, atol=3e-15 * (angle > 2)
    )
    shorter = angle if angle < np.pi else angle - 2.0 * np.pi  # the shorter way; the sign does not matter
    assert_allclose(to_rotation_vector(quaternion), shorter * AXIS, rtol=1e-14)
    assert_allclose(to_rotation_vector(-quaternion), shorter * AXIS, rtol=1e-14)


def test_propagation_obeys_the_kinematic_equation() -> None:
    # dq/dt = 1/2 q (0, w) with w in body axes; central difference over h errs by (|w| h)^2 / 24 = 2e-11
    quaternion, rate, step = ANY[0], np.array([0.1, -0.2, 0.05]), 1e-4
    difference = (propagate_attitude(quaternion, rate, step) - propagate_attitude(quaternion, rate, -step)) / (
        2.0 * step
    )
    assert_allclose(difference, 0.5 * multiply(quaternion, np.array([0.0, *rate])), rtol=0.0, atol=1e-11)
    attitude = quaternion
    for _ in range(100):
        attitude = propagate_attitude(attitude, rate, 0.05)
    # a hundred roundings of a few epsilon
    assert_allclose(attitude, multiply(quaternion, from_rotation_vector(5.0 * rate)), rtol=0.0, atol=1e-13)
    off = propagate_attitude(np.array([1.0, 0.0, 0.0, 1e-3]), rate, 0.08)
    assert np.linalg.norm(off) == pytest.approx(1.0, abs=4e-16)
