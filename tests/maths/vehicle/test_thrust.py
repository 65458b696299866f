"""The thrust lag in closed form against its differential equation."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import quad, solve_ivp

from massprop_drake.maths.vehicle.thrust import decay_integral, lag_factors, level_after, level_at, mean_level

TIME_CONSTANTS = np.array([0.0, 0.004, 0.015, 0.08, 2.0])  # s
LEVEL = np.array([0.3, 1.0, 0.0, 0.7, 0.9])
TARGET = np.array([1.0, 0.0, 1.0, 0.5, 0.0])
PERIOD = 0.08  # s


def test_factors_of_hand_value() -> None:
    # tau = T / 4: exp(-4), and 1/4 (1 - exp(-4)); no lag: nothing of a difference is left
    factors = lag_factors(np.array([0.02, 0.0]), 0.08)
    np.testing.assert_allclose(factors.remaining, [np.exp(-4.0), 0.0], rtol=1e-14)
    np.testing.assert_allclose(factors.mean, [0.25 * (1.0 - np.exp(-4.0)), 0.0], rtol=1e-14)


def test_level_solves_the_lags_differential_equation() -> None:
    lagged = TIME_CONSTANTS > 0.0
    times = np.array([0.01, 0.05, PERIOD])
    solution = solve_ivp(
        lambda _, level: (TARGET[lagged] - level) / TIME_CONSTANTS[lagged],
        (0.0, PERIOD),
        LEVEL[lagged],
        method="DOP853",
        t_eval=times,
        rtol=1e-12,
        atol=1e-14,
    )
    for time, expected in zip(times, solution.y.T, strict=True):
        level = level_at(LEVEL, TARGET, TIME_CONSTANTS, time)
        np.testing.assert_allclose(level[lagged], expected, rtol=0.0, atol=1e-11)  # the integrator's tolerance
    after = level_after(LEVEL, TARGET, lag_factors(TIME_CONSTANTS, PERIOD).remaining)
    np.testing.assert_allclose(after, level_at(LEVEL, TARGET, TIME_CONSTANTS, PERIOD), rtol=1e-14)


def test_mean_level_times_the_period_is_the_integral_of_the_level() -> None:
    mean = mean_level(LEVEL, TARGET, lag_factors(TIME_CONSTANTS, PERIOD).mean)
    for jet in range(len(TIME_CONSTANTS)):
        integral, _ = quad(
            lambda time, jet=jet: level_at(LEVEL, TARGET, TIME_CONSTANTS, time)[jet], 0.0, PERIOD, epsabs=1e-13
        )
        assert mean[jet] * PERIOD == pytest.approx(integral, abs=1e-12)


def test_zero_time_constant_is_instantaneous() -> None:
    factors = lag_factors(np.zeros(5), PERIOD)
    np.testing.assert_array_equal(level_after(LEVEL, TARGET, factors.remaining), TARGET)
    np.testing.assert_array_equal(mean_level(LEVEL, TARGET, factors.mean), TARGET)


@pytest.mark.parametrize("elapsed", [0.0, -1e-12])
def test_level_at_the_start_is_the_old_one_where_there_is_lag(elapsed: float) -> None:
    np.testing.assert_array_equal(level_at(LEVEL, TARGET, TIME_CONSTANTS, elapsed), [TARGET[0], *LEVEL[1:]])


def test_two_half_periods_make_a_whole_one() -> None:
    half, whole = lag_factors(TIME_CONSTANTS, 0.5 * PERIOD), lag_factors(TIME_CONSTANTS, PERIOD)
    middle = level_after(LEVEL, TARGET, half.remaining)
    np.testing.assert_allclose(
        level_after(middle, TARGET, half.remaining), level_after(LEVEL, TARGET, whole.remaining), rtol=1e-14
    )
    mean = 0.5 * (mean_level(LEVEL, TARGET, half.mean) + mean_level(middle, TARGET, half.mean))
    np.testing.assert_allclose(mean, mean_level(LEVEL, TARGET, whole.mean), rtol=1e-14)


@pytest.mark.parametrize("samples", [1, 2, 7])
def test_build_up_and_tail_off_of_a_firing_balance(samples: int) -> None:
    # what build-up lacks, tail-off brings: the impulse is n T times full thrust
    constants = np.array([0.0, 0.004, 0.015, 0.08])
    factors = lag_factors(constants, PERIOD)
    level, impulse = np.zeros(4), np.zeros(4)
    # 50 periods of tail-off leave exp(-50) of the slowest level
    for command in [1.0] * samples + [0.0] * 50:
        target = np.full(4, command)
        impulse += PERIOD * mean_level(level, target, factors.mean)
        level = level_after(level, target, factors.remaining)
    np.testing.assert_allclose(impulse, samples * PERIOD, rtol=1e-14)


@pytest.mark.parametrize("time_constant", [0.004, 0.3])
def test_decay_integral_is_the_integral_of_the_decay(time_constant: float) -> None:
    integral, _ = quad(lambda time: np.exp(-time / time_constant), 0.0, 0.05, epsabs=1e-14)
    assert decay_integral(time_constant, 0.05) == pytest.approx(integral, rel=1e-12)


def test_decay_integral_of_a_very_short_time_keeps_its_digits() -> None:
    # tau (x - x^2 / 2 + ...) with x = 1e-10: the next term is 2e-21 of the first
    assert decay_integral(2.0, 2e-10) == pytest.approx(2e-10 * (1.0 - 0.5e-10), rel=1e-15)
