r"""Nearest estimate that a rigid body can have.

A body's second moments of mass E = (tr I / 2) 1 - I are positive semidefinite, and every such E is some body's; an
estimated inverse inertia need not have them. The nearest that does, in the metric of the estimate's covariance,

    min (x - x^)^T P^-1 (x - x^)    over E >= 0,    x the six elements of I^-1,    I = tr(E) 1 - E,

is sought in E, where the set is convex (it is not in I^-1). By Gauss and Newton x is linearized, dx = -I^-1 dI I^-1;
each step then is a least-squares problem over E >= 0, solved by the barrier -ln |E| / t with t up to 1e9: its objective
is off by at most 3/t, in halves of squared sigmas, and its E is positive definite. Center of mass and 1/m follow with
their correlations to x, P_rx P_xx^-1 (x - x^).
"""

from __future__ import annotations

import numpy as np

from massprop_drake.maths.linear_algebra import Array, inverse, is_positive_definite, symmetrized
from massprop_drake.maths.mass_properties import is_possible_inertia, six_elements, symmetric_matrix

_BASIS = np.array([symmetric_matrix(row) for row in np.eye(6)])  # of symmetric matrices
_OF_MOMENTS = np.array([six_elements(np.trace(one) * np.eye(3) - one) for one in _BASIS]).T  # I of E
_INSIDE = 1e-3  # of the trace: least second moment to begin with
_BARRIER = 10.0 ** np.arange(0, 10)  # t
_STEPS, _NEWTON = 60, 60  # at most
_SETTLED, _DECREMENT = 1e-7, 1e-6  # largest change of an inertia, of its trace; Newton's decrement, beside the 3 of 3/t
_HALVED = 1e-10  # share of a step that is not taken any more
_ROUNDING = 4.0 * np.finfo(float).eps  # of a sum of squares, each of a difference, relative
_ENOUGH = 1e-4  # of the decrease that a step promises
_EXACT = 1e-12  # of a variance, added to it: what is exactly known is nearly so


def nearest_possible(estimate: Array, covariance: Array) -> Array | None:
    """Computes the likeliest physically possible estimate, shape (10,); a possible one is returned as it is.

    To first order: the metric is the covariance of the estimate as it is, which knows nothing of the bound.

    Args:
        estimate: the ten parameters, see `mass_properties`; NaN: 1/m is not observed, shape (10,).
        covariance: of their errors, shape (10, 10).

    Returns:
        The ten parameters, shape (10,); None where the inverse inertia is not positive definite, so that the nearest
        would be of infinite inertia or none, or where the search does not settle.

    Raises:
        ValueError: when inverse inertia or its covariance is not finite.
    """
    six, metric = estimate[:6], covariance[:6, :6]
    if not (np.isfinite(six).all() and np.isfinite(metric).all()):
        raise ValueError("inverse inertia and its covariance must be finite")
    scale = float(np.abs(six).max())
    if not is_positive_definite(symmetric_matrix(six)):
        return None
    if is_possible_inertia(symmetrized(inverse(symmetric_matrix(six)))):
        return estimate.copy()
    of_rest = covariance[6:, :6]
    metric = metric + _EXACT * np.diag(np.diag(metric)) + _EXACT**2 * scale**2 * np.eye(6)
    try:
        whitener = np.linalg.inv(np.linalg.cholesky(metric / scale**2))
        nearest = _nearest(six / scale, whitener)
    except np.linalg.LinAlgError:  # moments or sigmas that differ by more than rounding can bear
        return None
    if nearest is None:
        return None
    change = scale * nearest - six
    follows = of_rest @ np.linalg.solve(metric, change)
    return np.concatenate((six + change, estimate[6:] + follows))


def _nearest(elements: Array, whitener: Array) -> Array | None:
    """Computes six elements of the nearest possible inverse inertia; None: the search does not converge."""
    inertia = symmetrized(inverse(symmetric_matrix(elements)))
    moments, axes = np.linalg.eigh(0.5 * np.trace(inertia) * np.eye(3) - inertia)
    inside = np.maximum(moments, _INSIDE * np.trace(inertia))
    second = six_elements(symmetrized((axes * inside) @ axes.T))

    def residual(moments: Array) -> Array:
        """Computes the whitened difference of the inverse inertia of second moments from the estimate, (6,)."""
        result: Array = whitener @ (_inverse_from_moments(moments) - elements)
        return result

    for _ in range(_STEPS):
        now = symmetric_matrix(_inverse_from_moments(second))
        by_inertia = np.array([-six_elements(now @ one @ now) for one in _BASIS]).T
        jacobian, misfit = whitener @ by_inertia @ _OF_MOMENTS, residual(second)
        step = _least_squares(jacobian, jacobian @ second - misfit, second) - second
        promised = float(misfit @ (jacobian @ step))
        share = 1.0
        while _half_square(residual(second + share * step)) > _half_square(misfit) + _ENOUGH * share * promised:
            share *= 0.5
            if share < _SETTLED:  # rounding: nothing is nearer
                return _inverse_from_moments(second)
        second = second + share * step
        if np.abs(share * step).max() < _SETTLED * second[:3].sum():
            return _inverse_from_moments(second)
    return None


def _inverse_from_moments(moments: Array) -> Array:
    """Computes the inverse inertia's six elements from six second moments of mass."""
    return six_elements(symmetrized(inverse(symmetric_matrix(_OF_MOMENTS @ moments))))


def _half_square(values: Array) -> float:
    """Computes half the sum of squares of a vector."""
    return 0.5 * float(values @ values)


def _least_squares(matrix: Array, target: Array, start: Array) -> Array:
    """Minimizes |matrix E - target| over positive definite second moments E, shape (6,), by a barrier method.

    Args:
        matrix, target: shapes (6, 6) and (6,).
        start: positive definite, shape (6,).
    """

    def cost(moments: Array, t: float) -> float:
        """Computes the barrier cost of second moments at weight t; infinity where not positive definite."""
        sign, logarithm = np.linalg.slogdet(symmetric_matrix(moments))
        inside = sign > 0.0 and is_positive_definite(symmetric_matrix(moments))
        return t * _half_square(matrix @ moments - target) - float(logarithm) if inside else np.inf

    found = start
    for t in _BARRIER.tolist():
        for _ in range(_NEWTON):
            weighed = np.einsum("ij,kjl->kil", inverse(symmetric_matrix(found)), _BASIS)
            gradient = t * matrix.T @ (matrix @ found - target) - np.trace(weighed, axis1=1, axis2=2)
            hessian = t * matrix.T @ matrix + np.einsum("kij,lji->kl", weighed, weighed)
            step = -np.linalg.solve(hessian, gradient)
            decrement = -float(gradient @ step)
            left, size = matrix @ found - target, np.abs(matrix) @ np.abs(found) + np.abs(target)
            unseen = _ROUNDING * t * float(np.abs(left) @ size)  # in the cost
            if decrement < max(_DECREMENT, unseen):
                break
            share, had = 1.0, cost(found, t)
            while share > _HALVED and cost(found + share * step, t) > had - _ENOUGH * share * decrement:
                share *= 0.5
            if share <= _HALVED:  # rounding: nothing is better
                break
            found = found + share * step
    return found
