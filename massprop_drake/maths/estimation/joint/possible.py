r"""Cost of a hypothesis whose jets give less than nothing or more than their thrust.

Forces have Gaussian priors, which allow any. Of one jet that its readings put below zero little is left; but of two the
sum may be known to a hundredth and the difference hardly at all, so that neither by itself is out of bounds where no
two possible forces come near. With the forces f and their covariance P, the possible ones cost at least

    min over 0 <= x <= most of 1/2 (f - x)^T P^-1 (f - x).
"""

from __future__ import annotations

import numpy as np

from massprop_drake.maths.linear_algebra import Array


def impossible_force_cost(force: Array, covariance: Array, largest_force: Array) -> Array:
    """Computes log likelihood lost by bounding jet forces to 0 and their maximum, nats, shape (number,).

    Args:
        force: of one or two jets each, lbf or N, shape (number, jets).
        covariance: of them, shape (number, jets, jets).
        largest_force: that each jet can give, lbf or N, shape (number, jets).
    """
    off = force - np.clip(force, 0.0, largest_force)
    variances = np.diagonal(covariance, axis1=1, axis2=2)
    if force.shape[1] == 1:
        result: Array = 0.5 * off[:, 0] ** 2 / variances[:, 0]
        return result
    # the least is on an edge: one force there at a bound, and the other the likeliest possible given that
    cost = np.full(force.shape[0], np.inf)
    for fixed, free in ((0, 1), (1, 0)):
        slope = covariance[:, fixed, free] / variances[:, fixed]
        free_variance = np.maximum(variances[:, free] - slope * covariance[:, fixed, free], np.finfo(np.float64).tiny)
        for bound in (np.zeros_like(largest_force[:, fixed]), largest_force[:, fixed]):
            shift = bound - force[:, fixed]
            likeliest = force[:, free] + slope * shift
            excess = likeliest - np.clip(likeliest, 0.0, largest_force[:, free])
            cost = np.minimum(cost, 0.5 * (shift**2 / variances[:, fixed] + excess**2 / free_variance))
    return np.where((off == 0.0).all(axis=1), 0.0, cost)
