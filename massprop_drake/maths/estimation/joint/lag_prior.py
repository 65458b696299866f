"""Prior of each kind's lag: as the file states it, or, with a probability of 1 %, anything from zero to three times.

Equations: theory page of the joint filter, "Lag". The mixture's other component is exact for a filter that is linear
in p. Once the wide prior is the likelier one, the filter has it from then on.
"""

from __future__ import annotations

import math

import numpy as np

from massprop_drake.maths.estimation.joint.covariance import compress_root
from massprop_drake.maths.estimation.joint.layout import JointParams, JointState, widen_lag_prior
from massprop_drake.maths.kernels import kernel
from massprop_drake.maths.linear_algebra import Array

FAR = 0.01  # probability that a lag is not as stated
_ODDS = float(np.log(FAR / (1.0 - FAR)))
_MEAN, _VARIANCE = 0.5, 0.75  # of what is uniform from -1 to 2, the error of the lag over the stated one
_LEAST = 1e-12  # of the prior's information: less is rounding


@kernel
def _other_prior(state: JointState, kind: int, params: JointParams) -> tuple[float, float, float]:
    """Returns mean and variance of a kind's lag error by the prior not in use, and its log likelihood ratio, nats."""
    places = params.places
    row = places.lag + kind
    m, v = state.mean[row], float(np.sum(state.root[row] * state.root[row]))
    stated = params.prior_sigma[row - places.thrust] ** 2
    wide = max(_VARIANCE / params.lag_sigma**2, stated)
    off = _MEAN / params.lag_sigma
    if state.lag_open[kind] > 0.0:
        told = max(1.0 / v - 1.0 / wide, _LEAST / wide) + 1.0 / stated
        pulled = m / v - off / wide
        ratio = np.log(wide / stated) + off * off / wide
    else:
        told = max(1.0 / v - 1.0 / stated, 0.0) + 1.0 / wide
        pulled = m / v + off / wide
        ratio = np.log(stated / wide) - off * off / wide
    return pulled / told, 1.0 / told, 0.5 * (ratio - np.log(v * told) + pulled * pulled / told - m * m / v)


@kernel
def log_odds(state: JointState, params: JointParams) -> Array:
    """Returns log odds of the wide against the stated lag prior of each jet kind, shape (n_lag,); -inf: certain."""
    places = params.places
    result = np.full(places.n_lag, -np.inf)
    for kind in range(places.n_lag):
        if params.prior_sigma[places.lag - places.thrust + kind] > 0.0:
            _, _, ratio = _other_prior(state, kind, params)
            result[kind] = _ODDS + (-ratio if state.lag_open[kind] > 0.0 else ratio)
    return result


@kernel
def switch_lag_priors(state: JointState, params: JointParams, log_prior: float = _ODDS) -> tuple[JointState, float]:
    """Switches uncertain lags to the wide prior where likelier; returns state and log likelihood gained, nats.

    Args:
        log_prior: log odds of that prior before any reading; infinity: every lag is switched.
    """
    gain = 0.0
    for kind in range(params.places.n_lag):
        if state.lag_open[kind] == 0.0 and params.prior_sigma[params.places.lag - params.places.thrust + kind] > 0.0:
            mean, variance, ratio = _other_prior(state, kind, params)
            if log_prior + ratio > 0.0:
                state = _widen_lag(state, kind, mean, variance, params)
                gain += ratio
    return state, gain


@kernel
def _widen_lag(state: JointState, kind: int, mean: float, variance: float, params: JointParams) -> JointState:
    """Returns the state with a jet kind's lag given another mean and variance, correlated states corrected.

    With s the row of the error, its root S becomes S + alpha (S s) s^T.
    """
    row = state.root[params.places.lag + kind]
    v = float(np.sum(row * row))
    shares = state.root @ row / v
    root = state.root + np.outer(shares, (np.sqrt(variance / v) - 1.0) * row)
    after = state.mean + shares * (mean - state.mean[params.places.lag + kind])
    still_open = state.lag_open.copy()
    still_open[kind] = 1.0
    return widen_lag_prior(state, after, compress_root(root, params.places.thrust), still_open)


def choose_lag_priors(initial: JointState, final: JointState, params: JointParams) -> JointState:
    """Returns a smoother's initial state with the wide lag prior for jet kinds where the final state finds it likelier.

    Args:
        initial: with the stated priors.
        final: state after the earlier pass, or the filter's.
    """
    for kind in np.flatnonzero(log_odds(final, params) > 0.0).tolist():
        if initial.lag_open[kind] == 0.0:
            mean, variance, _ = _other_prior(initial, kind, params)
            initial = _widen_lag(initial, kind, mean, variance, params)
    return initial


def log_mixture(state: JointState, params: JointParams) -> float:
    """Returns the log likelihood ratio of the mixture of lag priors over those the filter uses, nats."""
    total = 0.0
    for odds, is_open in zip(log_odds(state, params).tolist(), state.lag_open.tolist(), strict=True):
        probability, alternative = (FAR, -odds) if is_open else (1.0 - FAR, odds)
        total += math.log(probability) + max(alternative, 0.0) + math.log1p(math.exp(-abs(alternative)))
    return total
