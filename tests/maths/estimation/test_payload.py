"""The size of a jump: against the posterior of both estimates together, and against draws from it."""

from __future__ import annotations

import numpy as np
from joint_probe import small_params, some_state

from massprop_drake.maths.estimation.joint.layout import CENTER, MASS, JointState
from massprop_drake.maths.estimation.joint.payload import gained_payload
from massprop_drake.maths.linear_algebra import Array

PARAMS = small_params(thrust_sigma=0.01)
PLACES = PARAMS.places
SHARED = slice(PLACES.thrust, PLACES.force)
K = PLACES.force - PLACES.thrust


def state_of(properties: Array, shared: Array, covariance: Array) -> JointState:
    """A filter that knows the ten parameters and what a jump does not change, and nothing else."""
    start = some_state(PARAMS)
    mean, root = np.zeros(PLACES.size), np.zeros((PLACES.size, PLACES.size))
    mean[:10], mean[SHARED] = properties, shared
    chosen = np.r_[0:10, SHARED]
    root[np.ix_(chosen, np.arange(10 + K))] = np.linalg.cholesky(covariance)
    return start._replace(mean=mean, root=root)


def gain(before: Array, after: Array, scale: Array) -> Array:
    """Mass gained and its place, of as many draws; shape (4, n)."""
    factor = 1.0 - PARAMS.thrust_sigma * scale
    masses = [1.0 / (each[MASS] * factor) for each in (before, after)]
    mass = masses[1] - masses[0]
    return np.vstack((mass, (masses[1] * after[CENTER] - masses[0] * before[CENTER]) / mass))


def measured(mean: Array, covariance: Array, rows: Array, value: Array, noise: float) -> tuple[Array, Array]:
    """The posterior of a linear measurement with white noise."""
    inverse = np.linalg.inv(covariance)
    posterior = np.linalg.inv(inverse + rows.T @ rows / noise**2)
    return posterior @ (inverse @ mean + rows.T @ value / noise**2), posterior


def test_size_and_place_are_those_of_both_estimates_together() -> None:
    """The oracle holds x before, x after and p in one Gaussian; the two filters are its conditionals."""
    rng = np.random.default_rng(4)
    n = 20 + K
    before, after, p = np.arange(10), np.arange(10, 20), np.arange(20, n)
    mean = np.concatenate([PARAMS.start, PARAMS.start, np.zeros(K)])
    mean[16:20] = [0.3, -0.1, 0.2, 0.08]  # a quarter more mass
    size = np.concatenate([np.tile([*np.full(6, 0.1), *np.full(3, 0.1), 0.02], 2), np.ones(K)])
    covariance = np.diag(size**2)
    truth = mean + 0.05 * size * rng.standard_normal(n)
    states = []
    for seen in (before, after):
        rows = np.zeros((26, n))
        rows[:, seen] = rng.standard_normal((26, 10)) / size[seen]
        rows[:, p] = 0.4 * rng.standard_normal((26, K))
        value = rows @ truth + 0.01 * rng.standard_normal(26)
        mean, covariance = measured(mean, covariance, rows, value, 0.01)
        both = np.append(seen, p)
        states.append(state_of(mean[seen], mean[p], covariance[np.ix_(both, both)]))
    earlier, now = states
    found = gained_payload(earlier, now, PARAMS)

    scale = 20 + PLACES.scale - PLACES.thrust
    best = gain(mean[before][:, None], mean[after][:, None], mean[[scale]])[:, 0]
    np.testing.assert_allclose([found.mass, *found.position], best, rtol=1e-9)
    draws = mean[:, None] + np.linalg.cholesky(covariance) @ rng.standard_normal((n, 20_000))
    spread = gain(draws[before], draws[after], draws[scale]).std(axis=1)
    np.testing.assert_allclose([found.mass_sigma, *found.position_sigma], spread, rtol=0.03)  # 6 sigma of 20,000 draws
