"""The thrust lag in closed form against its differential equation."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.integrate import quad, solve_ivp

from massprop_drake.maths.vehicle.thrust import decay_integral, lag_factors, level_after, level_at, mean_level

TIME_CONSTANTS = np.array([0.0, 0.004, 0.015, 0.08, 2.0])  # s
LEVEL = np.array([0.3, 1.0, 0.0, 0.7, 0.9])
TARGET = np.array([1.0, 0.0, 1.0, 0.5, 0.0])
PERIOD = 0.08  # s


def test_level_and_mean_solve_the_lags_differential_equation() -> None:
    lagged, times = TIME_CONSTANTS > 0.0, np.array([0.01, 0.05, PERIOD])
    factors = lag_factors(TIME_CONSTANTS, PERIOD)
    solution = solve_ivp(
        lambda _, level: (TARGET[lagged] - level) / TIME_CONSTANTS[lagged],
        (0.0, PERIOD), LEVEL[lagged], method="DOP853", t_eval=times, rtol=1e-12, atol=1e-14,
    )  # fmt: skip
    for time, expected in zip(times, solution.y.T, strict=True):
        level = level_at(LEVEL, TARGET, TIME_CONSTANTS, time)
        assert_allclose(level[lagged], expected, rtol=0.0, atol=1e-11)  # the integrator's tolerance
        assert level[0] == TARGET[0]
    assert_allclose(level_after(LEVEL, TARGET, factors.remaining), level, rtol=1e-14)
    mean = mean_level(LEVEL, TARGET, factors.mean)
    for jet in range(len(TIME_CONSTANTS)):
        integral, _ = quad(
            lambda time, jet=jet: level_at(LEVEL, TARGET, TIME_CONSTANTS, time)[jet], 0.0, PERIOD, epsabs=1e-13
        )
        assert mean[jet] * PERIOD == pytest.approx(integral, abs=1e-12)
    for elapsed in (0.0, -1e-12):
        assert_array_equal(level_at(LEVEL, TARGET, TIME_CONSTANTS, elapsed), [TARGET[0], *LEVEL[1:]])
    assert lag_factors(np.zeros(2), PERIOD).instantaneous
    assert not factors.instantaneous


def test_decay_integral_is_the_integral_of_the_decay() -> None:
    integral, _ = quad(lambda time: np.exp(-time / 0.3), 0.0, 0.05, epsabs=1e-14)
    assert decay_integral(0.3, 0.05) == pytest.approx(integral, rel=1e-12)
    # tau (x - x^2 / 2 + ...) with x = 1e-10: the next term is 2e-21 of the first
    assert decay_integral(2.0, 2e-10) == pytest.approx(2e-10 * (1.0 - 0.5e-10), rel=1e-15)
