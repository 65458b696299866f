r"""A covariance kept as a root S, P = S S^T: linear maps of rows, noise as more columns, and the update.

Every change of P is one of three: rows of S are combined linearly, columns are appended (what they square to is
added), and `compress_root` makes S square again by Householder reflections. None of them subtracts, so P stays positive
semidefinite whatever happens, and half the digits carry it: what counts is the ratio of sigmas, not of variances.
S is lower triangular once the rows of what no interval changes, the parameters, are put before the others: their rows
are so still after most changes, and reflections are needed for the rest alone.

The update is Joseph's form in terms of the root. With Y = H P H^T + R and the reflections

    [ (H S)^T ; R^1/2 ] = [ Q1 ; Q2 ] U,    U^T U = Y,    K = S Q1 U^-T,

and the root after it is [ S - (S Q1) Q1^T, (S Q1) Q2^T ].
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from massprop_drake.maths.kernels import kernel
from massprop_drake.maths.linear_algebra import Array, lower_factor, triangular_rows


class Update(NamedTuple):
    """A root and a mean's correction after a measurement.

    Attributes:
        correction: K e, to be added to the mean, shape (n,).
        root: of the covariance after the measurement, shape (n, n).
        half_gain: G with the gain K = G U^-T, shape (n, m).
        upper: U, U^T U = Y, shape (m, m).
    """

    correction: Array
    root: Array
    half_gain: Array
    upper: Array


@kernel
def empty_update(root: Array) -> Update:
    """Returns the update without any measurement: zero correction, the covariance's root unchanged."""
    n = root.shape[0]
    return Update(np.zeros(n), root, np.zeros((n, 0)), np.zeros((0, 0)))


@kernel
def order_root_rows(columns: Array, first_row: int) -> Array:
    """Returns a covariance's root with the rows from `first_row` on moved first, the order of `compress_root`."""
    return np.vstack((columns[first_row:], columns[:first_row]))


@kernel
def compress_root(columns: Array, first_row: int) -> Array:
    """Returns a triangular root, shape (n, n), of the same covariance as a root of k >= n columns.

    Args:
        columns: any root, shape (n, k).
        first_row: row that comes first in the order in which it becomes triangular, with all after it; `Places.thrust`.
    """
    n, rows = columns.shape[0], order_root_rows(columns, first_row)
    done = triangular_rows(rows)
    root = np.zeros((n, n))
    root[:, :done] = rows[:, :done]
    if done < n:
        root[done:, done:] = lower_factor(np.ascontiguousarray(rows[done:, done:]))
    return np.vstack((root[n - first_row :], root[: n - first_row]))


@kernel
def semidefinite_root(matrix: Array) -> Array:
    """Computes a lower triangular root of a positive semidefinite matrix, also of a singular one."""
    n = matrix.shape[0]
    root = np.zeros((n, n))
    for j in range(n):
        pivot = matrix[j, j] - root[j, :j] @ root[j, :j]
        if pivot > 1e-14 * matrix[j, j]:
            root[j, j] = np.sqrt(pivot)
            root[j + 1 :, j] = (matrix[j + 1 :, j] - root[j + 1 :, :j] @ root[j, :j]) / root[j, j]
    return root


@kernel
def joseph_update(root: Array, projected_root: Array, variances: Array, innovation: Array, first_row: int) -> Update:
    """Updates a covariance's root S by a measurement with known H S, in Joseph's form; returns correction, root, gain.

    Args:
        root: before, shape (n, k), k >= n or not.
        projected_root: H times the root, shape (m, k).
        variances: of the measurement noise, positive, shape (m,).
        innovation: e, shape (m,).
        first_row: see `compress_root`.
    """
    wide = joseph_update_uncompressed(root, projected_root, variances, innovation)
    return Update(wide.correction, compress_root(wide.root, first_row), wide.half_gain, wide.upper)


@kernel
def joseph_update_uncompressed(root: Array, projected_root: Array, variances: Array, innovation: Array) -> Update:
    """Updates a root as `joseph_update` does, but returns it with the noise as more columns, shape (n, k + m)."""
    m, k = projected_root.shape
    stacked = np.zeros((k + m, m))
    stacked[:k] = projected_root.T
    stacked[k:] = np.diag(np.sqrt(variances))
    q, u = np.linalg.qr(stacked)
    q1, q2, u = np.ascontiguousarray(q[:k]), np.ascontiguousarray(q[k:]), np.ascontiguousarray(u)
    whitened = np.linalg.solve(u.T, innovation)
    gain = root @ q1
    after = np.hstack((root - gain @ q1.T, gain @ q2.T))
    return Update(gain @ whitened, after, gain, u)
