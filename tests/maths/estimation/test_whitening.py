"""Noise that gathers in readings: whitened, against dense covariances."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from massprop_drake.maths.estimation.whitening import Gathering, make_whitener
from massprop_drake.maths.linear_algebra import Array

TIMES_S = np.cumsum(np.array([0.0, 0.1, 0.1, 0.3, 0.1, 0.1, 2.0, 0.1, 0.1]))


def covariance(time_s: Array, noise: Gathering) -> Array:
    """Covariance of readings of variance one: integrals of a walk's and of a Gauss-Markov process's covariance."""
    first, last = np.minimum.outer(time_s, time_s), np.maximum.outer(time_s, time_s)
    x, y = (time / noise.time_constant_s for time in (first, last))
    integrals = 2.0 * x - 1.0 + np.exp(-x) + np.exp(-y) - np.exp(x - y)
    walked = noise.walk * first + noise.acting * noise.time_constant_s**2 * integrals
    return np.asarray(walked + np.eye(time_s.size))


@pytest.mark.parametrize(
    "noise",
    [
        Gathering(3.0, 0.0, 1.0),
        Gathering(0.0, 5.0, 0.7),
        Gathering(2.0, 40.0, 0.03),
        Gathering(1e-6, 1e-4, 50.0),
        Gathering(0.5, 100.0, 20.0),
    ],
    ids=["walk", "disturbance", "fast", "faint", "strong"],
)
@pytest.mark.parametrize("rows", [2, 3, 4, 9])
def test_normal_equations_are_those_of_the_dense_covariance(noise: Gathering, rows: int) -> None:
    time_s = TIMES_S[:rows]
    random = np.random.default_rng(rows)
    x, y = random.normal(size=(2, 2, rows)), random.normal(size=rows)
    weights = np.linalg.inv(covariance(time_s, noise))
    ones = weights.sum(axis=0)
    weights -= np.outer(ones, ones) / ones.sum()  # the initial value eliminated
    whiten = make_whitener(time_s, noise)
    flat, given, left = whiten(x).reshape(4, rows), x.reshape(4, rows), whiten(y)
    assert_allclose(flat @ flat.T, given @ weights @ given.T, rtol=1e-8, atol=1e-12)
    assert_allclose(flat @ left, given @ weights @ y, rtol=1e-8, atol=1e-12)
    assert_allclose(left @ left, y @ weights @ y, rtol=1e-8)
    assert (flat[:, 0] == 0.0).all()


def test_what_is_whitened_stays_as_it_was() -> None:
    given = np.arange(5.0)
    make_whitener(TIMES_S[:5], Gathering(1.0, 2.0, 3.0))(given)
    assert_array_equal(given, np.arange(5.0))
