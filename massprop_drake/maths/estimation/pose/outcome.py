r"""Mass properties of a state: mu = m_0/m by conditioning, J = K mu/m_0, r.

The factors of the healthy jets, less what all share, are mu (1 + b_j), and K = m J. With y these and K, the prior has
cov (mu, g - c) = sigma_M^2 and cov (mu, K) = -K sigma_M^2, and C of y as `start` has it, so that

    mu = 1 + k (y - y_0),    k = cov (mu, y) C^-1,    var mu = sigma_M^2 - k cov (y, mu) + k P k^T

with P the covariance of y now, and mu goes with everything else as k y does: what is left of it is independent of the
whole state.
"""

from __future__ import annotations

import numpy as np

from massprop_drake.maths.estimation.pose.pose_layout import PoseParams
from massprop_drake.maths.linear_algebra import Array

_ROUNDING = 1e-12  # of the largest eigenvalue of a correlation: below it two things say the same


def estimated_properties(
    mean: Array, covariance: Array, healthy_jets: np.ndarray, params: PoseParams
) -> tuple[Array, Array]:
    """Computes the ten mass-property parameters, shape (10,), and covariance, (10, 10), zero where fixed.

    Args:
        mean: of the whole state, shape (size,).
        covariance: of what is free, shape (n, n).
        healthy_jets: which jets' factors say something of the mass, shape (n_jets,).
    """
    parts, size = params.parts, params.parts.size
    whole = np.zeros((size, size))
    whole[np.ix_(params.free, params.free)] = covariance
    weights, residual_variance = mass_regression(healthy_jets, params)
    scale = 1.0 + float(weights @ (mean - params.start))
    spin = mean[parts.spin]
    rows = np.zeros((10, size))
    rows[:6] = np.outer(spin, weights)
    rows[:6, parts.spin] += scale * np.eye(6)
    rows[:6] /= params.nominal_mass
    rows[6:9, parts.center] = np.eye(3)
    rows[9] = weights / params.nominal_mass
    by_mass_ratio = np.zeros(10)
    by_mass_ratio[:6], by_mass_ratio[9] = spin / params.nominal_mass, 1.0 / params.nominal_mass
    covariance_of_ten = rows @ whole @ rows.T + residual_variance * np.outer(by_mass_ratio, by_mass_ratio)
    covariance_of_ten[9, 9] += (params.unseen_std / params.nominal_mass) ** 2
    values = np.concatenate((spin * scale / params.nominal_mass, mean[parts.center], [scale / params.nominal_mass]))
    return values, covariance_of_ten


def mass_regression(healthy_jets: np.ndarray, params: PoseParams) -> tuple[Array, float]:
    """Computes the regression of m_0/m on the state by the prior: weights, shape (size,), and residual variance.

    Args:
        healthy_jets: which jets' factors say something of the mass, shape (n_jets,).
    """
    parts, variance = params.parts, params.mass_std**2
    jets = np.flatnonzero(healthy_jets)
    spin = np.intersect1d(params.free, np.arange(parts.spin.start, parts.spin.stop))
    observations = np.zeros((jets.size + spin.size, parts.size))
    observations[np.arange(jets.size), jets] = 1.0
    observations[: jets.size, parts.common] = -1.0
    observations[np.arange(jets.size, len(observations)), spin] = 1.0
    with_mass = variance * np.concatenate((np.ones(jets.size), -params.start[spin]))
    observed_covariance = observations[:, params.free] @ params.covariance @ observations[:, params.free].T
    deviation = np.sqrt(observed_covariance.diagonal())
    deviation[deviation == 0.0] = 1.0
    correlation = observed_covariance / np.outer(deviation, deviation)
    gain = np.linalg.pinv(correlation, _ROUNDING, hermitian=True) @ (with_mass / deviation) / deviation
    return gain @ observations, variance - float(gain @ with_mass)
