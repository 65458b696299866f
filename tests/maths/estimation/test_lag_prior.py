"""The prior of lags: a filter that changes to the wide one is as if it had had it from the beginning."""

from __future__ import annotations

import math

import numpy as np
import pytest
from joint_probe import small_params, some_state
from scipy.stats import norm

from massprop_drake.maths.estimation.joint.covariance import compress_root
from massprop_drake.maths.estimation.joint.lag_prior import choose_lag_priors, log_mixture, log_odds, switch_lag_priors
from massprop_drake.maths.estimation.joint.layout import JointState

PARAMS = small_params()
ROW = PARAMS.places.lag
OFF, WIDE = 0.5 / PARAMS.lag_sigma, math.sqrt(0.75) / PARAMS.lag_sigma  # of what is uniform from no lag to three times


def start(wide: bool) -> JointState:
    """A state with the lag of the first kind as stated, or anything, and both lags told of by all else."""
    state = some_state(PARAMS, 1)
    root, mean = state.root.copy(), state.mean.copy()
    lags = slice(ROW, ROW + PARAMS.places.n_lag)
    root[lags] = 0.0
    root = np.hstack((root, np.zeros((root.shape[0], 2))))
    root[lags, -2:] = np.diag([WIDE if wide else 1.0, 1.0])
    mean[lags] = [OFF if wide else 0.0, 0.0]
    lag_open = np.array([float(wide), 0.0])
    return state._replace(mean=mean, root=compress_root(root, PARAMS.places.thrust), lag_open=lag_open)


def told(state: JointState, value: float, sigma: float) -> tuple[JointState, float]:
    """The state after a measurement of the lag's error and of all that counts beside it, and its log likelihood."""
    n = PARAMS.places.size
    row = np.zeros(n)
    row[ROW], row[0] = 1.0, 0.3
    value = value + 0.3 * state.mean[0]
    covariance = state.root @ state.root.T
    variance = float(row @ covariance @ row) + sigma**2
    gain, off = covariance @ row / variance, value - float(row @ state.mean)
    after = covariance - np.outer(gain, gain) * variance
    root = np.linalg.cholesky(after + 1e-13 * np.eye(n) * np.diag(after))
    likelihood = float(norm.logpdf(off, scale=math.sqrt(variance)))
    return state._replace(mean=state.mean + gain * off, root=compress_root(root, PARAMS.places.thrust)), likelihood


@pytest.mark.parametrize("value", [-5.0, 10.0])
def test_the_filter_goes_on_as_if_the_wide_prior_had_been_its_own(value: float) -> None:
    narrow, wide = (told(start(one), value, 0.2) for one in (False, True))
    found, more = switch_lag_priors(narrow[0], PARAMS)
    assert found.lag_open.tolist() == [1.0, 0.0]
    np.testing.assert_allclose(found.mean, wide[0].mean, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(found.root @ found.root.T, wide[0].root @ wide[0].root.T, rtol=1e-5, atol=1e-9)
    assert narrow[1] + more == pytest.approx(wide[1], abs=1e-6)
    assert log_mixture(narrow[0], PARAMS) + narrow[1] == pytest.approx(log_mixture(found, PARAMS) + wide[1], abs=1e-6)
    assert log_odds(found, PARAMS) == pytest.approx(log_odds(narrow[0], PARAMS), abs=1e-6)


def test_a_pass_begins_with_the_prior_that_the_one_before_has_ended_with() -> None:
    entry = start(False)
    end, _ = switch_lag_priors(told(entry, 10.0, 0.2)[0], PARAMS)
    again = choose_lag_priors(entry, end, PARAMS)
    np.testing.assert_allclose(again.mean, start(True).mean, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(again.root @ again.root.T, start(True).root @ start(True).root.T, rtol=1e-9, atol=1e-12)
    assert choose_lag_priors(entry, entry, PARAMS) is entry
