"""Small matrices: inverses against numpy, and which matrices are refused."""

from __future__ import annotations

import numpy as np
import pytest

from massprop_drake.maths.linear_algebra import (
    Array,
    NotPositiveDefiniteError,
    cross,
    inverse_positive_definite,
    is_covariance,
    is_positive_definite,
    scaled_inverse,
    scaled_root,
    skew,
    symmetrized,
)

EPSILON = np.finfo(float).eps


def positive_definite(seed: int, size: int, condition: float) -> Array:
    axes = np.linalg.qr(np.random.default_rng(seed).standard_normal((size, size)))[0]
    return symmetrized(axes * np.geomspace(1.0, condition, size) @ axes.T)


def test_cross_and_skew_agree_with_numpy() -> None:
    np.testing.assert_array_equal(skew(np.array([1.0, 2.0, 3.0])), [[0, -3, 2], [3, 0, -1], [-2, 1, 0]])
    for left, right in np.random.default_rng(1).standard_normal((20, 2, 3)):
        atol = 4.0 * EPSILON * np.linalg.norm(left) * np.linalg.norm(right)  # three roundings of products
        for found in (cross(left, right), skew(left) @ right):
            np.testing.assert_allclose(found, np.cross(left, right), rtol=0.0, atol=atol)


@pytest.mark.parametrize("condition", [1.0, 1e6])
@pytest.mark.parametrize("scale", [1e-13, 1.0, 1e13])
def test_inverse_agrees_with_numpy_and_is_exactly_symmetric(condition: float, scale: float) -> None:
    for seed in range(10):
        matrix = scale * positive_definite(seed, 3, condition)
        found, expected = inverse_positive_definite(matrix), np.linalg.inv(matrix)
        # both err by a small multiple of condition * epsilon, relative to the largest element
        assert np.abs(found - expected).max() < 30.0 * condition * EPSILON * np.abs(expected).max()
        np.testing.assert_array_equal(found, found.T)
        np.testing.assert_array_equal(inverse_positive_definite(np.tril(matrix)), found)  # reads no more


@pytest.mark.parametrize(
    "matrix",
    [
        np.diag([-1.0, 1.0, 1.0]),
        np.diag([1.0, -1.0, 1.0]),
        np.diag([1.0, 1.0, -1.0]),
        np.diag([1.0, 1.0, 0.0]),
        np.array([[1.0, 2.0, 0.0], [2.0, 1.0, 0.0], [0.0, 0.0, 1.0]]),  # second pivot 1 - 4
        np.array([[1.0, 0.0, 2.0], [0.0, 1.0, 0.0], [2.0, 0.0, 1.0]]),  # third pivot 1 - 4
        np.diag([np.nan, 1.0, 1.0]),
        np.diag([1.0, 1.0, np.nan]),
    ],
)
def test_inverse_refuses_a_matrix_that_is_not_positive_definite(matrix: Array) -> None:
    with pytest.raises(NotPositiveDefiniteError, match=r"^Y is not positive definite:\n"):
        inverse_positive_definite(matrix, "Y")
    assert not is_positive_definite(matrix)


def test_an_error_keeps_a_copy_of_the_matrix_and_gains_time_and_place() -> None:
    matrix = np.diag([1.0, -2.0, 3.0])
    with pytest.raises(NotPositiveDefiniteError) as caught:
        inverse_positive_definite(matrix, "innovation covariance")
    matrix[:] = 0.0
    assert caught.value.time_s is None
    for time_s, told in ((12.5, "12.5"), (1000000.08, "1000000.08"), (1.0e6, "1000000")):
        located = caught.value.at(time_s, "rotation estimator")
        start = f"rotation estimator: innovation covariance is not positive definite at t = {told} s:"
        assert str(located).startswith(start)
        assert located.time_s == time_s
        np.testing.assert_array_equal(located.matrix, np.diag([1.0, -2.0, 3.0]))


SCALE = np.geomspace(1e-11, 1e2, 9)
CLOSE, ABOVE = (np.array([[1.0, c], [c, 1.0]]) * np.outer([1e-7, 1e2], [1e-7, 1e2]) for c in (1.0 + 1e-12, 1.0 + 1e-6))


@pytest.mark.parametrize(
    ("matrix", "possible"),
    [
        (positive_definite(5, 9, 50.0) * np.outer(SCALE, SCALE), True),  # of many orders of magnitude
        (np.diag([1.0, 0.0, 2.0]), True),  # exactly known elements
        (np.zeros((3, 3)), True),
        (CLOSE, True),  # eigenvalues 1 - c, 1 + c after scaling, whatever the units
        (ABOVE, False),
        (np.array([[1.0, 0.1], [0.1, 0.0]]), False),  # correlated with something exactly known
        (np.array([[1.0, 1e-12], [0.0, 0.0]]), False),  # however little
        (np.diag([1.0, -1e-30]), False),
        (np.diag([1.0, np.nan]), False),
        (np.diag([1.0, np.inf]), False),
        (np.array([[1.0, 0.5], [0.4, 1.0]]), False),
        (1e-24 * np.array([[1.0, 0.5], [0.4, 1.0]]), False),  # small elements are no excuse
    ],
)
def test_a_covariance_is_symmetric_and_semidefinite_in_its_own_units(matrix: Array, possible: bool) -> None:
    assert is_covariance(matrix) == possible
    if matrix is ABOVE:
        assert is_covariance(matrix, tolerance=1e-5)


def test_elements_of_any_sizes_are_inverted_in_their_own_units() -> None:
    """A covariance whose deviations lie twenty powers of ten apart, as those of inverse inertia and position do."""
    units, matrix = np.geomspace(1e-10, 1e10, 6), positive_definite(4, 6, 100.0)
    mixed = matrix * np.outer(units, units)
    np.testing.assert_allclose(scaled_inverse(mixed), np.linalg.inv(matrix) / np.outer(units, units), rtol=1e-11)
    root, size = scaled_root(mixed)
    np.testing.assert_array_equal(root, np.tril(root))
    np.testing.assert_allclose(root @ root.T / np.outer(size, size), mixed, rtol=1e-12)
