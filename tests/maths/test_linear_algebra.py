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
    sparse_product,
    symmetrized,
    triangular_rows,
)

EPSILON = np.finfo(float).eps


def positive_definite(rng: np.random.Generator, size: int, condition: float) -> Array:
    axes = np.linalg.qr(rng.standard_normal((size, size)))[0]
    return symmetrized(axes * np.geomspace(1.0, condition, size) @ axes.T)


def test_skew_has_the_cross_product_of_its_vector() -> None:
    # (1, 2, 3) x (u, v, w) = (2w - 3v, 3u - w, v - 2u)
    np.testing.assert_array_equal(skew(np.array([1.0, 2.0, 3.0])), [[0, -3, 2], [3, 0, -1], [-2, 1, 0]])


def test_cross_of_hand_value() -> None:
    # (2*6 - 3*5, 3*4 - 1*6, 1*5 - 2*4)
    np.testing.assert_array_equal(cross(np.array([1.0, 2.0, 3.0]), np.array([4.0, 5.0, 6.0])), [-3, 6, -3])


def test_cross_and_skew_agree_with_numpy_on_random_vectors() -> None:
    rng = np.random.default_rng(1)
    for left, right in rng.standard_normal((50, 2, 3)):
        expected = np.cross(left, right)
        # three roundings of products of at most |left| |right|
        atol = 4.0 * EPSILON * np.linalg.norm(left) * np.linalg.norm(right)
        np.testing.assert_allclose(cross(left, right), expected, rtol=0.0, atol=atol)
        np.testing.assert_allclose(skew(left) @ right, expected, rtol=0.0, atol=atol)


@pytest.mark.parametrize("condition", [1.0, 1e3, 1e6])
@pytest.mark.parametrize("scale", [1e-13, 1.0, 1e13])
def test_inverse_agrees_with_numpy(condition: float, scale: float) -> None:
    rng = np.random.default_rng(2)
    for _ in range(30):
        matrix = scale * positive_definite(rng, 3, condition)
        expected = np.linalg.inv(matrix)
        # both inverses err by a small multiple of condition * epsilon, relative to the largest element
        error = np.abs(inverse_positive_definite(matrix) - expected).max() / np.abs(expected).max()
        assert error < 30.0 * condition * EPSILON


def test_inverse_of_hand_value() -> None:
    # L = [[2, 0, 0], [1, 3, 0], [-1, 2, 4]]; M = L L^T; M^-1 = L^-T L^-1 with
    # L^-1 = [[1/2, 0, 0], [-1/6, 1/3, 0], [5/24, -1/6, 1/4]]
    factor = np.array([[2.0, 0.0, 0.0], [1.0, 3.0, 0.0], [-1.0, 2.0, 4.0]])
    inverse_factor = np.array([[1 / 2, 0.0, 0.0], [-1 / 6, 1 / 3, 0.0], [5 / 24, -1 / 6, 1 / 4]])
    inverse = inverse_positive_definite(factor @ factor.T)
    np.testing.assert_allclose(inverse, inverse_factor.T @ inverse_factor, rtol=1e-14)


def test_inverse_is_exactly_symmetric_and_reads_only_the_lower_triangle() -> None:
    matrix = positive_definite(np.random.default_rng(3), 3, 10.0)
    inverse = inverse_positive_definite(matrix)
    np.testing.assert_array_equal(inverse, inverse.T)
    np.testing.assert_array_equal(inverse_positive_definite(np.tril(matrix)), inverse)


@pytest.mark.parametrize(
    "matrix",
    [
        np.diag([-1.0, 1.0, 1.0]),
        np.diag([1.0, -1.0, 1.0]),
        np.diag([1.0, 1.0, -1.0]),
        np.diag([0.0, 1.0, 1.0]),
        np.diag([1.0, 1.0, 0.0]),
        np.array([[1.0, 2.0, 0.0], [2.0, 1.0, 0.0], [0.0, 0.0, 1.0]]),  # second pivot 1 - 4
        np.array([[1.0, 0.0, 2.0], [0.0, 1.0, 0.0], [2.0, 0.0, 1.0]]),  # third pivot 1 - 4
        np.diag([np.nan, 1.0, 1.0]),
        np.diag([1.0, np.nan, 1.0]),
        np.diag([1.0, 1.0, np.nan]),
    ],
)
def test_inverse_refuses_what_is_not_positive_definite(matrix: Array) -> None:
    with pytest.raises(NotPositiveDefiniteError, match=r"^Y is not positive definite:\n"):
        inverse_positive_definite(matrix, "Y")
    assert not is_positive_definite(matrix)


def test_error_keeps_a_copy_of_the_matrix_and_gains_time_and_place() -> None:
    matrix = np.diag([1.0, -2.0, 3.0])
    with pytest.raises(NotPositiveDefiniteError) as caught:
        inverse_positive_definite(matrix, "innovation covariance")
    matrix[:] = 0.0
    np.testing.assert_array_equal(caught.value.matrix, np.diag([1.0, -2.0, 3.0]))
    assert caught.value.time_s is None

    located = caught.value.at(12.5, "rotation estimator")
    assert str(located).startswith("rotation estimator: innovation covariance is not positive definite at t = 12.5 s:")
    assert located.time_s == 12.5
    np.testing.assert_array_equal(located.matrix, np.diag([1.0, -2.0, 3.0]))


def test_definiteness_agrees_with_the_eigenvalues() -> None:
    rng = np.random.default_rng(4)
    verdicts = []
    for _ in range(400):
        # diagonal shifted so that about half of the matrices are positive definite
        matrix = symmetrized(rng.standard_normal((3, 3))) + 1.3 * np.eye(3)
        least = np.linalg.eigvalsh(matrix)[0]
        if abs(least) > 1e-12:  # nearer to singular, rounding may decide either way
            verdicts.append(is_positive_definite(matrix))
            assert verdicts[-1] == (least > 0.0)
    assert 100 < sum(verdicts) < 300


@pytest.mark.parametrize("diagonal", [(-1.0, -1.0, 1.0), (1.0, -1.0, -1.0), (-1.0, 1.0, -1.0), (1.0, 1.0, 0.0)])
def test_positive_or_zero_determinant_alone_is_not_definite(diagonal: tuple[float, ...]) -> None:
    assert not is_positive_definite(np.diag(diagonal))


def test_symmetrized_is_the_mean_with_the_transpose() -> None:
    np.testing.assert_array_equal(symmetrized(np.array([[1.0, 2.0], [4.0, 3.0]])), [[1, 3], [3, 3]])


def test_covariance_of_many_orders_of_magnitude_is_accepted() -> None:
    correlation = positive_definite(np.random.default_rng(5), 9, 50.0)
    scale = np.geomspace(1e-11, 1e2, 9)
    assert is_covariance(correlation * np.outer(scale, scale))


def test_covariance_may_have_exactly_known_elements() -> None:
    assert is_covariance(np.diag([1.0, 0.0, 2.0]))
    assert is_covariance(np.zeros((3, 3)))


@pytest.mark.parametrize(
    "matrix",
    [
        np.array([[1.0, 0.1], [0.1, 0.0]]),  # correlated with something exactly known
        np.array([[1.0, 1e-12], [0.0, 0.0]]),  # however little
        np.array([[1.0, 0.0], [1e-12, 0.0]]),
        np.diag([1.0, -1e-30]),
        np.diag([1.0, np.nan]),
        np.diag([1.0, np.inf]),
        np.array([[1.0, 1.001], [1.001, 1.0]]),  # correlation above one
        np.array([[1.0, 0.5], [0.4, 1.0]]),
        1e-24 * np.array([[1.0, 0.5], [0.4, 1.0]]),  # small elements are no excuse
    ],
)
def test_covariance_of_impossible_form_is_refused(matrix: Array) -> None:
    assert not is_covariance(matrix)


def test_covariance_tolerance_is_relative_to_a_unit_diagonal() -> None:
    # eigenvalues of [[1, c], [c, 1]]: 1 - c, 1 + c; of the scaled matrix whatever the units
    scale = np.outer([1e-7, 1e2], [1e-7, 1e2])
    slightly_above, clearly_above = (np.array([[1.0, c], [c, 1.0]]) * scale for c in (1.0 + 1e-12, 1.0 + 1e-6))
    assert is_covariance(slightly_above)
    assert not is_covariance(clearly_above)
    assert is_covariance(clearly_above, tolerance=1e-5)


def test_late_times_are_told_to_a_hundredth() -> None:
    for time_s, told in ((0.08, "0.08"), (1234.56, "1234.56"), (1000000.08, "1000000.08"), (1.0e6, "1000000")):
        assert str(NotPositiveDefiniteError(-np.eye(2), time_s=time_s)).count(f"t = {told} s") == 1


def test_rows_are_triangular_up_to_the_first_with_anything_beyond_the_diagonal() -> None:
    matrix = np.tril(np.ones((4, 6)))
    assert triangular_rows(matrix) == 4
    for row in range(4):
        for column in range(row + 1, 6):
            assert triangular_rows(matrix + 0.5 * np.outer(np.eye(4)[row], np.eye(6)[column])) == row


def test_a_product_leaves_out_columns_that_are_zero_alone() -> None:
    rng = np.random.default_rng(2)
    rows, matrix = rng.standard_normal((3, 8)), rng.standard_normal((8, 5))
    rows[:, [0, 5]] = 0.0
    rows[:, 2] = [1.0, -1.0, 0.0]  # no sum
    np.testing.assert_allclose(sparse_product(rows, matrix), rows @ matrix, rtol=1e-13)


def test_elements_of_any_sizes_are_inverted_in_their_own_units() -> None:
    """A covariance whose deviations lie twenty powers of ten apart, as those of inverse inertia and position do."""
    rng = np.random.default_rng(4)
    units = np.geomspace(1e-10, 1e10, 6)
    matrix = positive_definite(rng, 6, 100.0)
    mixed = matrix * np.outer(units, units)
    expected = np.linalg.inv(matrix) / np.outer(units, units)
    np.testing.assert_allclose(scaled_inverse(mixed), expected, rtol=1e-11)
    root, size = scaled_root(mixed)
    np.testing.assert_array_equal(root, np.tril(root))
    np.testing.assert_allclose(root @ root.T / np.outer(size, size), mixed, rtol=1e-12)
