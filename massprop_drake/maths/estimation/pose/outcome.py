r"""Mass properties of a state: mu = m_0/m by conditioning, J = K mu/m_0, r.

The factors of the healthy jets, less what all share, are mu (1 + b_j): beforehand mu - 1 and the factors have the
covariances sigma_M^2 and sigma_M^2 1 1^T + sigma_T^2, so that

    mu = 1 + k (g - c - 1),    k = sigma_M^2 1^T (sigma_M^2 1 1^T + sigma_T^2)^-1,
    var mu = sigma_M^2 - k 1 sigma_M^2 + k P k^T

with P the covariance of g - c now, and mu goes with everything else as k (g - c) does.
"""

from __future__ import annotations

import numpy as np

from massprop_drake.maths.estimation.pose.layout import PoseParams
from massprop_drake.maths.linear_algebra import Array


def outcome(mean: Array, covariance: Array, healthy: np.ndarray, params: PoseParams) -> tuple[Array, Array]:
    """The ten parameters and their covariance, zero where they are fixed, shapes (10,) and (10, 10).

    Args:
        mean: of the whole state, shape (size,).
        covariance: of what is free, shape (n, n).
        healthy: which jets' factors say something of the mass, shape (n_jets,).
        params: see `PoseParams`.
    """
    parts, size = params.parts, params.parts.size
    whole = np.zeros((size, size))
    whole[np.ix_(params.free, params.free)] = covariance
    weights, of_mass = np.zeros(size), params.mass_std**2
    jets = np.flatnonzero(healthy)
    gain = np.zeros(0)
    if jets.size and of_mass > 0.0:
        beforehand = of_mass + np.diag(params.thrust_std[jets] ** 2)
        gain = np.linalg.pinv(beforehand, hermitian=True) @ np.full(jets.size, of_mass)  # thrusts may be known
        weights[jets] = gain
        weights[parts.common] = -gain.sum()
    scale = 1.0 + float(gain @ (mean[jets] - mean[parts.common] - 1.0)) if gain.size else 1.0
    left = of_mass * (1.0 - float(gain.sum()))
    spin = mean[parts.spin]
    rows = np.zeros((10, size))
    rows[:6] = np.outer(spin, weights)
    rows[:6, parts.spin] += scale * np.eye(6)
    rows[:6] /= params.nominal_mass
    rows[6:9, parts.center] = np.eye(3)
    rows[9] = weights / params.nominal_mass
    own = np.zeros(10)
    own[:6], own[9] = spin / params.nominal_mass, 1.0 / params.nominal_mass
    found = rows @ whole @ rows.T + left * np.outer(own, own)
    values = np.concatenate((spin * scale / params.nominal_mass, mean[parts.center], [scale / params.nominal_mass]))
    return values, found
