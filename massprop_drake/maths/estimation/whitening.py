r"""Whitening of readings whose noise accumulates: walks, and disturbances that change slowly.

Of one component y_k = r_k + v_k is read, v_k of variance one, and what nobody commands has added to r

    r_{k+1} = r_k + theta_k a_k + e_k,    a_{k+1} = k_k a_k + n_k,

a a Gauss-Markov process of unit variance times s, see `joint.disturbance`, and e its part that comes in the interval,
and a walk of variance q a second. The combinations

    u_0 = (y_1 - y_0)/theta_0,    u_k = (y_{k+1} - y_k)/theta_k - k_{k-1} (y_k - y_{k-1})/theta_{k-1}

have neither the initial value nor a in them but for a_0, and a covariance of bandwidth two, whose Cholesky factor
whitens them. Without a they are the differences, of bandwidth one. What is linear in the readings, such as derivatives
of what is expected, is whitened alike; one row fewer is left, for the initial value.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from massprop_drake.maths.estimation.joint.disturbance_states import integral_variance
from massprop_drake.maths.linear_algebra import Array


class Gathering(NamedTuple):
    """Noise that accumulates in a component, in units of a reading's variance.

    Attributes:
        walk: q, 1/s.
        acting: s^2, 1/s^2.
        time_constant_s: of a.
    """

    walk: float
    acting: float
    time_constant_s: float


class Whitener(NamedTuple):
    """Whitener of the noise of a component's readings.

    Attributes:
        factor: lower Cholesky factor of the combinations' covariance, by its diagonals, shape (3, r - 1).
        scale: of each difference, 1/theta_k, or one, shape (r - 1,).
        kept: k_k of all intervals but the last, shape (r - 2,); zero without a.
    """

    factor: Array
    scale: Array
    kept: Array

    def __call__(self, x: Array) -> Array:
        """Whitens quantities linear in the readings, shape (..., r); the first of each comes out as zero."""
        differences = np.diff(x, axis=-1) * self.scale
        differences[..., 1:] -= self.kept * differences[..., :-1]
        rows = np.ascontiguousarray(np.moveaxis(differences, -1, 0)).reshape(differences.shape[-1], -1)
        _substitute_forward(self.factor, rows)
        result = np.zeros_like(x)
        result[..., 1:] = np.moveaxis(rows.reshape(-1, *x.shape[:-1]), 0, -1)
        return result


def _substitute_forward(factor: Array, rows: Array) -> None:
    """Solves L y = u in place, by forward substitution; L by its diagonals, shape (3, n), and u of shape (n, c)."""
    own, first, second = factor.tolist()
    for k in range(rows.shape[0]):
        if k > 0:
            rows[k] -= first[k - 1] * rows[k - 1]
        if k > 1:
            rows[k] -= second[k - 2] * rows[k - 2]
        rows[k] /= own[k]


def _factor_banded(bands: Array) -> Array:
    """Computes the lower Cholesky factor of a matrix of bandwidth two, both by their diagonals, shape (3, n)."""
    factor = []
    before = earlier = (1.0, 0.0, 0.0)  # of the row before, and of that before it
    for own, first, second in bands.T.tolist():
        root = math.sqrt(own - before[1] ** 2 - earlier[2] ** 2)
        earlier, before = before, (root, (first - before[2] * before[1]) / root, second / root)
        factor.append(before)
    return np.array(factor).T.copy()


def make_whitener(time_s: Array, noise: Gathering) -> Whitener:
    """Makes the whitener of the noise of one component's readings at given times.

    Args:
        time_s: increasing, shape (r,), r > 1.
    """
    length_s, n = np.diff(time_s), time_s.size - 1
    own = noise.walk * length_s  # variance of e
    if noise.acting == 0.0:
        bands = np.zeros((3, n))
        bands[0], bands[1, :-1] = own + 2.0, -1.0
        return Whitener(_factor_banded(bands), np.ones(n), np.zeros(n - 1))
    constant_s = noise.time_constant_s
    x = length_s / constant_s
    lost = -np.expm1(-x)
    kept, theta = 1.0 - lost, constant_s * lost
    each, place = np.unique(x, return_inverse=True)
    integral = np.array([integral_variance(one) for one in each.tolist()])[place]
    own = (own + noise.acting * constant_s**2 * integral) / theta**2
    shared = noise.acting * constant_s * lost**2 / theta  # of e_k/theta_k and n_k
    drawn = noise.acting * lost * (2.0 - lost)  # of n_k
    # u = A v + B (e/theta) + n, rows of the readings' noise v_k-1, v_k, v_k+1
    ahead, behind = 1.0 / theta[1:], kept[:-1] / theta[:-1]
    middle = -(ahead + behind)
    bands = np.zeros((3, n))
    bands[0, 0] = noise.acting + own[0] + 2.0 / theta[0] ** 2
    bands[0, 1:] = ahead**2 + middle**2 + behind**2 + own[1:] + drawn[:-1]
    bands[0, 1:] += kept[:-1] * (kept[:-1] * own[:-1] - 2.0 * shared[:-1])
    first = -1.0 / theta[0], 1.0 / theta[0]
    if n > 1:
        bands[1, 0] = first[0] * behind[0] + first[1] * middle[0] - kept[0] * own[0] + shared[0]
        bands[1, 1:-1] = middle[:-1] * behind[1:] + ahead[:-1] * middle[1:] - kept[1:-1] * own[1:-1] + shared[1:-1]
    if n > 2:
        bands[2, 0] = first[1] * behind[1]
        bands[2, 1:-2] = ahead[:-2] * behind[2:]
    return Whitener(_factor_banded(bands), 1.0 / theta, kept[:-1])
