"""Three-dimensional linear algebra for the inner loops, and the error that names a bad matrix.

The functions work element by element on 3x3 matrices because numpy's general routines cost several
times more than the arithmetic itself at this size.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from massprop_drake.errors import moment
from massprop_drake.maths.kernels import idiom, kernel, numbers, rows3

Array = NDArray[np.float64]


class NotPositiveDefiniteError(ArithmeticError):
    """Error of a covariance that lost definiteness: internal numerical trouble, never patched over.

    Args:
        matrix: the matrix that failed.
        name: which matrix it is.
        time_s: when it happened, once a system that knows the time passes the error on.
    """

    def __init__(self, matrix: Array, name: str = "matrix", time_s: float | None = None):
        self.matrix = np.array(matrix)
        self.what = name
        self.time_s = time_s
        super().__init__(f"{self.headline}:\n{self.matrix}")

    @property
    def headline(self) -> str:
        """Name of the matrix, and the time where known, in one line."""
        when = "" if self.time_s is None else f" at t = {moment(self.time_s)} s"
        return f"{self.what} is not positive definite{when}"

    def at(self, time_s: float, system: str) -> NotPositiveDefiniteError:
        """Returns the same error with time and system added where these are unknown yet."""
        return (
            self if self.time_s is not None else NotPositiveDefiniteError(self.matrix, f"{system}: {self.what}", time_s)
        )


@kernel
def skew(vector: Array) -> Array:
    """Computes the cross product matrix [v x] of a vector, [v x] u = v x u, shape (3, 3)."""
    x, y, z = numbers(vector, 3)
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


@kernel
def cross(left: Array, right: Array) -> Array:
    """Computes the cross product of two vectors of shape (3,); several times faster than numpy's."""
    a, b, c = numbers(left, 3)
    x, y, z = numbers(right, 3)
    return np.array([b * z - c * y, c * x - a * z, a * y - b * x])


def cross_products(left: Array, right: Array) -> Array:
    """Computes cross products of stacks of vectors along their last axis; several times faster than numpy's."""
    result = np.empty(np.broadcast_shapes(left.shape, right.shape), dtype=np.result_type(left, right))
    a, b, c = left[..., 0], left[..., 1], left[..., 2]
    x, y, z = right[..., 0], right[..., 1], right[..., 2]
    result[..., 0], result[..., 1], result[..., 2] = b * z - c * y, c * x - a * z, a * y - b * x
    return result


def normals(directions: Array, preferred: Array | None = None) -> Array:
    """Computes two unit vectors normal to each direction, and to one another, shape (n, 2, 3).

    Args:
        directions: unit vectors, shape (n, 3).
        preferred: vectors to which the first is closest, shape (n, 3); None: the axis that is most across.
    """
    if preferred is None:
        preferred = np.eye(3)[np.argmin(np.abs(directions), axis=1)]
    first = preferred - np.sum(preferred * directions, axis=1, keepdims=True) * directions
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return np.stack((first, np.cross(directions, first)), axis=1)


@kernel
def congruence(matrix: Array, inner: Array) -> Array:
    """Computes M S M^T; for small matrices `dot` takes less time than numpy's operator."""
    result: Array = np.dot(np.dot(matrix, inner), matrix.T)
    return result


@kernel
def quadratic_form(vector: Array, matrix: Array) -> float:
    """Computes the scalar v^T M v of a vector and a matrix; see `congruence`."""
    return float(np.dot(np.dot(vector, matrix), vector))


def _has_nonzero(vector):  # type: ignore[no-untyped-def] # compiled alone
    """Tests whether any element differs from zero, in compiled code."""
    return np.any(vector != 0.0)


@idiom(_has_nonzero)
def has_nonzero(vector: NDArray[Any]) -> bool:
    """Tests whether any element of a vector differs from zero; for short ones several times faster than numpy's."""
    return any(vector.tolist())


def _deviations(covariance):  # type: ignore[no-untyped-def] # compiled alone
    """Computes 1-sigmas of a covariance, in compiled code."""
    return np.sqrt(np.diag(covariance))


@idiom(_deviations)
def deviations(covariance: Array) -> Array:
    """Computes 1-sigmas, the square roots of a covariance's diagonal, shape (n,)."""
    result: Array = np.sqrt(covariance.diagonal())
    return result


@kernel
def inverse_positive_definite(matrix: Array, name: str = "matrix") -> Array:
    """Computes the inverse of a symmetric positive definite 3x3 matrix, by its Cholesky factor.

    Args:
        matrix: shape (3, 3); only the lower triangle is read.
        name: the matrix's name, for the error.

    Raises:
        NotPositiveDefiniteError: when a pivot is not positive (or not a number).
    """
    (a, _, _), (b, c, _), (d, e, f) = rows3(matrix)
    # L: lower Cholesky factor with rows (l00), (l10, l11), (l20, l21, l22)
    if not a > 0.0:
        raise NotPositiveDefiniteError(matrix, name)
    l00 = math.sqrt(a)
    l10 = b / l00
    pivot = c - l10 * l10
    if not pivot > 0.0:
        raise NotPositiveDefiniteError(matrix, name)
    l11 = math.sqrt(pivot)
    l20 = d / l00
    l21 = (e - l20 * l10) / l11
    pivot = f - l20 * l20 - l21 * l21
    if not pivot > 0.0:
        raise NotPositiveDefiniteError(matrix, name)
    l22 = math.sqrt(pivot)
    # M: the inverse of L; the inverse of the matrix is then transpose(M) M
    m00, m11, m22 = 1.0 / l00, 1.0 / l11, 1.0 / l22
    m10 = -l10 * m00 * m11
    m21 = -l21 * m11 * m22
    m20 = -(l20 * m00 + l21 * m10) * m22
    xy = m10 * m11 + m20 * m21
    xz = m20 * m22
    yz = m21 * m22
    return np.array(
        [
            [m00 * m00 + m10 * m10 + m20 * m20, xy, xz],
            [xy, m11 * m11 + m21 * m21, yz],
            [xz, yz, m22 * m22],
        ]
    )


@kernel
def is_positive_definite(matrix: Array) -> bool:
    """Tests whether a symmetric 3x3 matrix is positive definite, by its leading minors."""
    (a, _, _), (b, c, _), (d, e, f) = rows3(matrix)
    minor = a * c - b * b
    determinant = f * minor - e * (a * e - b * d) + d * (b * e - c * d)
    return bool(a > 0.0 and minor > 0.0 and determinant > 0.0)


# ------------------------------------------------------- stacks of matrices: in numpy at once, compiled one by one


def _times_stack(matrix, stack):  # type: ignore[no-untyped-def] # compiled alone
    """Compiled `times_stack`: multiplies each matrix of a stack by one matrix from the left."""
    result = np.empty((stack.shape[0], matrix.shape[0], stack.shape[2]))
    for index in range(stack.shape[0]):
        result[index] = matrix @ stack[index]
    return result


@idiom(_times_stack)
def times_stack(matrix: Array, stack: Array) -> Array:
    """Multiplies each matrix of a stack by one matrix from the left."""
    return matrix @ stack


def _stack_times(stack, matrix):  # type: ignore[no-untyped-def] # compiled alone
    """Compiled `stack_times`: multiplies each matrix of a stack by one matrix from the right."""
    result = np.empty((stack.shape[0], stack.shape[1], matrix.shape[1]))
    for index in range(stack.shape[0]):
        result[index] = stack[index] @ matrix
    return result


@idiom(_stack_times)
def stack_times(stack: Array, matrix: Array) -> Array:
    """Multiplies each matrix of a stack by one matrix from the right."""
    return stack @ matrix


def _stack_times_stack(left, right):  # type: ignore[no-untyped-def] # compiled alone
    """Compiled `stack_times_stack`: multiplies the matrices of two stacks pair by pair."""
    result = np.empty((left.shape[0], left.shape[1], right.shape[2]))
    for index in range(left.shape[0]):
        result[index] = left[index] @ right[index]
    return result


@idiom(_stack_times_stack)
def stack_times_stack(left: Array, right: Array) -> Array:
    """Multiplies the matrices of two stacks pair by pair."""
    return left @ right


def _stack_times_vector(stack, vector):  # type: ignore[no-untyped-def] # compiled alone
    """Compiled `stack_times_vector`: multiplies each matrix of a stack by a vector."""
    result = np.empty((stack.shape[0], stack.shape[1]))
    for index in range(stack.shape[0]):
        result[index] = stack[index] @ vector
    return result


@idiom(_stack_times_vector)
def stack_times_vector(stack: Array, vector: Array) -> Array:
    """Multiplies each matrix of a stack by a vector."""
    return stack @ vector


def _stack_times_vectors(stack, vectors):  # type: ignore[no-untyped-def] # compiled alone
    """Compiled form of `stack_times_vectors`."""
    result = np.empty((stack.shape[0], stack.shape[1]))
    for index in range(stack.shape[0]):
        result[index] = stack[index] @ vectors[index]
    return result


@idiom(_stack_times_vectors)
def stack_times_vectors(stack: Array, vectors: Array) -> Array:
    """Multiplies matrices of a stack by vectors of another, pair by pair, shape (k, n)."""
    product: Array = np.einsum("ijk,ik->ij", stack, vectors)
    return product


def _inverses(stack):  # type: ignore[no-untyped-def] # compiled alone
    """Compiled `inverses`: computes the inverse of each matrix of a stack."""
    result = np.empty(stack.shape)
    for index in range(stack.shape[0]):
        result[index] = np.linalg.inv(stack[index])
    return result


@idiom(_inverses)
def inverses(stack: Array) -> Array:
    """Computes the inverse of each matrix of a stack."""
    return np.asarray(np.linalg.inv(stack), dtype=np.float64)


def _log_determinants(stack):  # type: ignore[no-untyped-def] # compiled alone
    """Compiled `log_determinants`: computes the log of the absolute determinant of each matrix of a stack."""
    result = np.empty(stack.shape[0])
    for index in range(stack.shape[0]):
        result[index] = np.linalg.slogdet(stack[index])[1]
    return result


@idiom(_log_determinants)
def log_determinants(stack: Array) -> Array:
    """Computes the log of the absolute determinant of each matrix of a stack."""
    return np.linalg.slogdet(stack)[1]


def _triangular_roots(stack):  # type: ignore[no-untyped-def] # compiled alone
    """Compiled form of `triangular_roots`."""
    result = np.empty(stack.shape)
    for index in range(stack.shape[0]):
        result[index] = np.linalg.cholesky(stack[index])
    return result


@idiom(_triangular_roots)
def triangular_roots(stack: Array) -> Array:
    """Computes the lower triangular Cholesky root of each positive definite matrix of a stack."""
    return np.asarray(np.linalg.cholesky(stack), dtype=np.float64)


def _lower_factor(columns):  # type: ignore[no-untyped-def] # compiled alone
    """Computes the lower triangular factor L of A = L Q, in compiled code."""
    _, upper = np.linalg.qr(columns.T)
    return np.ascontiguousarray(upper.T)


@idiom(_lower_factor)
def lower_factor(columns: Array) -> Array:
    """Computes lower triangular L with A = L Q, Q orthogonal; shape (n, min(n, k)) from A of (n, k)."""
    return np.ascontiguousarray(np.asarray(np.linalg.qr(columns.T, mode="r")).T)


@kernel
def sparse_product(rows: Array, matrix: Array) -> Array:
    """Multiplies two matrices, using only the nonzero columns of the first."""
    told = np.flatnonzero(np.abs(rows).sum(axis=0))
    result: Array = np.ascontiguousarray(rows[:, told]) @ matrix[told]
    return result


def _triangular_rows(matrix):  # type: ignore[no-untyped-def] # compiled alone
    """Compiled `triangular_rows`: counts the leading rows of a matrix that are lower triangular."""
    for row in range(matrix.shape[0]):
        for column in range(row + 1, matrix.shape[1]):
            if matrix[row, column] != 0.0:
                return row
    return matrix.shape[0]


@idiom(_triangular_rows)
def triangular_rows(matrix: Array) -> int:
    """Counts the leading rows of a matrix that are lower triangular."""
    beyond = np.triu(matrix, 1).any(axis=1)
    return int(beyond.argmax()) if beyond.any() else matrix.shape[0]


def inverse(matrix: Array) -> Array:
    """Inverts a square matrix, or a 3x3 one of AutoDiffXd or Expression; slow on the latter."""
    if matrix.dtype == object:
        first, second, third = matrix
        columns = cross(second, third), cross(third, first), cross(first, second)  # of the adjugate
        return np.column_stack(columns) / np.dot(first, columns[0])
    return np.asarray(np.linalg.inv(matrix), dtype=np.float64)


@kernel
def symmetrized(matrix: Array) -> Array:
    """Computes the symmetric part (A + A^T)/2 of a square matrix."""
    return 0.5 * (matrix + matrix.T)


def symmetrized_stack(stack: Array) -> Array:
    """Computes the symmetric part (A + A^T)/2 of each matrix of a stack."""
    result: Array = 0.5 * (stack + np.swapaxes(stack, -1, -2))
    return result


def is_covariance(matrix: Array, tolerance: float = 1e-9) -> bool:
    """Tests whether a matrix is symmetric and positive semidefinite, after scaling to a unit diagonal.

    The scaling matters: the elements of the rotation filter's covariance span more than twenty
    orders of magnitude in slug and feet. Rows whose variance is zero must be zero altogether.
    """
    variance = np.diag(matrix)
    if not np.all(np.isfinite(matrix)) or np.any(variance < 0.0):
        return False
    known = variance == 0.0
    if np.any(matrix[known]) or np.any(matrix[:, known]):
        return False
    scale = np.where(known, 1.0, np.sqrt(variance))
    scaled = matrix / np.outer(scale, scale)
    if not np.allclose(scaled, scaled.T, rtol=0.0, atol=tolerance):
        return False
    return bool(np.linalg.eigvalsh(symmetrized(scaled)).min() > -tolerance)


def scaled_root(matrix: Array) -> tuple[Array, Array]:
    """Computes the Cholesky root of a matrix scaled to unit diagonal, and the scale u, shape (n,).

    Args:
        matrix: symmetric, its elements of any sizes, shape (n, n); with L the root it is (L L^T)_ij / (u_i u_j).
    """
    size: Array = 1.0 / np.sqrt(np.diagonal(matrix))
    scaled: Array = matrix * np.outer(size, size)
    root: Array = np.linalg.cholesky(scaled).astype(np.float64, copy=False)
    return root, size


def scaled_inverse(matrix: Array) -> Array:
    """Inverts a positive definite matrix by scaling it to unit diagonal, whatever its elements' sizes."""
    size = np.sqrt(np.diagonal(matrix))
    result: Array = np.linalg.inv(matrix / np.outer(size, size)) / np.outer(size, size)
    return result
