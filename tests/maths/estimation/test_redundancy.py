"""Several packages as one measurement: by hand, against stacked least squares, and in both filters."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from params_probe import STATE, crossing, mass_params, rotation_params, spd

from massprop_drake.maths.estimation.adaptation import NO_ADAPTATION
from massprop_drake.maths.estimation.filters import mass_filter, rotation_filter
from massprop_drake.maths.estimation.filters.mass_filter import (
    Compensation,
    MassState,
    Rotation,
    compensate_rotation,
)
from massprop_drake.maths.estimation.filters.mass_jump import empty_window
from massprop_drake.maths.estimation.filters.rotation_filter import RotationState
from massprop_drake.maths.estimation.redundancy import Rule, combine_packages
from massprop_drake.maths.linear_algebra import Array, is_covariance

# three packages with variances 2, 1 and 4 per component
READINGS = np.array([[1.0, 10.0, -1.0], [3.0, 20.0, 0.0], [8.0, 0.0, 4.0]])
BEST = [Rule.WEIGHTED_AVERAGE, Rule.SERIAL]


def independent(blocks: Array) -> Array:
    """Covariances R_ij of packages whose errors have nothing in common, shape (s, s, 3, 3)."""
    return np.einsum("ij,iab->ijab", np.eye(len(blocks)), blocks)


ISOTROPIC = independent(np.array([2.0, 1.0, 4.0])[:, None, None] * np.eye(3))


def split(stacked: Array) -> Array:
    """A stacked covariance as blocks R_ij."""
    count = stacked.shape[0] // 3
    return stacked.reshape(count, 3, count, 3).transpose(0, 2, 1, 3).copy()


def stacked_least_squares(readings: Array, stacked: Array) -> tuple[Array, Array]:
    """The best linear unbiased estimate of what all packages measure, by whitening and QR."""
    root = np.linalg.inv(np.linalg.cholesky(stacked))
    design = root @ np.tile(np.eye(3), (len(readings), 1))
    estimate, *_ = np.linalg.lstsq(design, root @ readings.ravel(), rcond=None)
    return estimate, np.linalg.inv(design.T @ design)


@pytest.mark.parametrize(
    ("rule", "reading", "variance"),
    [
        (Rule.SINGLE, [1.0, 10.0, -1.0], 2.0),
        (Rule.MOST_ACCURATE, [3.0, 20.0, 0.0], 1.0),
        (Rule.MID_VALUE, [3.0, 10.0, 0.0], 7.0 / 3.0),
        (Rule.AVERAGE, [4.0, 10.0, 1.0], 7.0 / 9.0),
        # weights 1/2, 1 and 1/4, sum 7/4: (1/2 + 3 + 2), (5 + 20 + 0), (-1/2 + 0 + 1), each over 7/4
        (Rule.WEIGHTED_AVERAGE, [22.0 / 7.0, 100.0 / 7.0, 2.0 / 7.0], 4.0 / 7.0),
        (Rule.SERIAL, [22.0 / 7.0, 100.0 / 7.0, 2.0 / 7.0], 4.0 / 7.0),
    ],
)
def test_each_rule_by_hand(rule: int, reading: list[float], variance: float) -> None:
    before = READINGS.copy(), ISOTROPIC.copy()
    measurement, covariance = combine_packages(READINGS, ISOTROPIC, rule)
    assert_allclose(measurement, reading, rtol=1e-14)
    assert_allclose(covariance, variance * np.eye(3), rtol=1e-14, atol=1e-16)
    own = spd(np.random.default_rng(1), 3)
    for correlated in (True, False):  # a package alone is itself by every rule
        measurement, covariance = combine_packages(READINGS[:1], own[None, None], rule, correlated=correlated)
        assert_array_equal(measurement, READINGS[0])
        assert_array_equal(covariance, own)
        combine_packages(READINGS, ISOTROPIC, rule, correlated=correlated)
    for kept, given in zip(before, (READINGS, ISOTROPIC), strict=True):  # what was handed in is not changed
        assert_array_equal(kept, given)


@pytest.mark.parametrize("rule", BEST)
@pytest.mark.parametrize("count", [2, 3, 4])
@pytest.mark.parametrize("correlated", [True, False])
def test_best_averages_are_the_stacked_least_squares_estimate(rule: int, count: int, *, correlated: bool) -> None:
    rng = np.random.default_rng(4)
    readings, stacked = rng.normal(size=(count, 3)), spd(rng, 3 * count)
    # what packages share counts only where asked
    counted = stacked if correlated else stacked * np.kron(np.eye(count), np.ones((3, 3)))
    expected, spread = stacked_least_squares(readings, counted)
    mean = np.tile(np.eye(3), (1, count)) / count
    plain = combine_packages(readings, split(stacked), Rule.AVERAGE, correlated=correlated)[1]
    assert_allclose(plain, mean @ counted @ mean.T, rtol=1e-12)
    measurement, covariance = combine_packages(readings, split(stacked), rule, correlated=correlated)
    assert_allclose(measurement, expected, rtol=1e-9)
    assert_allclose(covariance, spread, rtol=1e-9, atol=1e-12)
    assert_array_equal(covariance, covariance.T)


PUSH = np.array([3.0, -1.0, 2.0])
VELOCITIES = np.array([[1.2, -0.4, 0.9], [1.0, -0.2, 0.5], [0.8, -0.5, 0.7]])
ACCELEROMETER_VARIANCES = np.array([0.02, 0.05, 0.01])
POSITIONS = np.array([[2.0, -1.0, 0.5], [-1.5, 0.3, 1.0], [0.2, 2.0, -0.7]])
CENTER_COVARIANCE = np.array([[0.30, 0.05, -0.02], [0.05, 0.20, 0.04], [-0.02, 0.04, 0.10]])
TURN = np.array([0.2, -0.3, 0.1])
ROTATION = Rotation(TURN, np.array([0.5, 0.4, -0.8]), 0.04, np.array([0.1, -0.2, 0.3]), CENTER_COVARIANCE)
ARMS = POSITIONS - ROTATION.center
TRANSVERSE = mass_params(compensation=Compensation.TRANSVERSE, compensation_covariance=True)


def weighed(velocities: Array = VELOCITIES, **params: Any) -> tuple[mass_filter.MassCycle, mass_filter.MassMeasurement]:
    """A cycle of the mass filter with these increments."""
    chosen = mass_params(positions=POSITIONS, variances=ACCELEROMETER_VARIANCES, **params)
    state, interval = MassState(0.3, 0.02, empty_window(1)), mass_filter.MassInterval(PUSH)
    before = np.full((3, 3), 0.5)
    measurement = mass_filter.measure(state, before, velocities + before, interval, ROTATION, chosen)
    return mass_filter.finish(state, measurement, True, True, NO_ADAPTATION, chosen), measurement


@pytest.mark.parametrize("rule", BEST)
@pytest.mark.parametrize("correlated", [True, False])
def test_accelerometers_make_one_stacked_update(rule: int, *, correlated: bool) -> None:
    # 1/m and its variance from all at once, in information form
    measurements, stacked, about = (
        VELOCITIES,
        np.kron(np.diag(2.0 * ACCELEROMETER_VARIANCES), np.eye(3)),
        {"rule": rule},
    )
    if correlated:
        about |= {"compensation": Compensation.TRANSVERSE, "compensation_covariance": True, "correlated": True}
        freed = [
            compensate_rotation(velocity, 2.0 * variance * np.eye(3), arm, ROTATION, TRANSVERSE)
            for velocity, variance, arm in zip(VELOCITIES, ACCELEROMETER_VARIANCES, ARMS, strict=True)
        ]
        measurements, blocks = np.array([each[0] for each in freed]), np.zeros((3, 3, 3, 3))
        for i, j in np.ndindex(3, 3):
            # [dw x] S_cm [dw x]^T + sum over axes of var (e x r_i) (e x r_j)^T, and the same of S_cm
            blocks[i, j] = crossing(TURN) @ CENTER_COVARIANCE @ crossing(TURN).T if i != j else freed[i][1]
            for axis in np.eye(3) if i != j else ():
                blocks[i, j] += 0.04 * np.outer(np.cross(axis, ARMS[i]), np.cross(axis, ARMS[j]))
                blocks[i, j] += 0.04 * crossing(axis) @ CENTER_COVARIANCE @ crossing(axis).T
        stacked = blocks.transpose(0, 2, 1, 3).reshape(9, 9)
    assert is_covariance(stacked)
    weights = np.linalg.solve(stacked, np.tile(PUSH, 3))
    information = 1.0 / 0.02 + weights @ np.tile(PUSH, 3)
    done, measurement = weighed(**about)
    expected = (0.3 / 0.02 + weights @ measurements.ravel()) / information, 1.0 / information
    assert done.state[:2] == pytest.approx(expected, rel=1e-11)
    assert len(measurement.each) == (3 if rule == Rule.SERIAL and not correlated else 0)
    if correlated:  # taken as independent, they claim to know more
        assert weighed(**about | {"correlated": False})[0].state.variance < 0.97 / information


def test_a_wild_accelerometer_does_not_get_through_the_middle_value() -> None:
    wild = VELOCITIES.copy()
    wild[1] = [1e6, -1e6, 1e6]
    # the middle of each component is one of the two others'; the noise, the mean of all, stays
    middle, measurement = weighed(wild, rule=Rule.MID_VALUE)
    assert_allclose(measurement.sample.measured, [1.2, -0.5, 0.9], rtol=1e-12)
    assert_allclose(measurement.sample.noise, 2.0 * ACCELEROMETER_VARIANCES.mean() * np.eye(3), rtol=1e-14)
    assert abs(middle.state.mass_reciprocal - 0.3) < 0.2
    # where others are missing, the one that is there stands for all
    wild[[0, 1], 0] = np.nan
    _, measurement = weighed(wild, rule=Rule.AVERAGE)
    assert_allclose(measurement.sample.measured, VELOCITIES[2], rtol=1e-12)


TWIST = np.array([0.7, -1.1, 0.4])
RATES = np.array([[0.30, -0.35, 0.20], [0.34, -0.30, 0.25]])
GYRO_VARIANCES = np.array([2e-3, 5e-4])
PRIOR = 0.01 * spd(np.random.default_rng(10), 6)


def turned(rates: Array = RATES, before: float = 0.0, **params: Any) -> tuple[Any, Any]:
    """A cycle of the rotation filter from rest with the center of mass known, so that all is linear."""
    chosen, covariance = rotation_params(gyro_variances=GYRO_VARIANCES, **params), np.zeros((9, 9))
    covariance[:6, :6] = PRIOR
    state, memory = RotationState(STATE, covariance), rotation_filter.RotationMemory(np.full((2, 3), before), False)
    interval = rotation_filter.RotationInterval(TWIST, np.zeros(3), True)
    measurement = rotation_filter.measure(state, memory, rates, interval, chosen)
    return rotation_filter.finish(state, measurement, True, NO_ADAPTATION, chosen), measurement


@pytest.mark.parametrize("rule", BEST)
def test_two_gyros_are_one_stacked_measurement(rule: int) -> None:
    x, y, z = TWIST
    design = np.array([[x, 0.0, 0.0, 0.0, z, y], [0.0, y, 0.0, z, 0.0, x], [0.0, 0.0, z, y, x, 0.0]])
    information = np.linalg.inv(PRIOR)
    right_side = information @ STATE[:6]
    for increment, variance in zip(RATES, GYRO_VARIANCES, strict=True):
        information = information + design.T @ design / (2.0 * variance)
        right_side = right_side + design.T @ increment / (2.0 * variance)
    done, _ = turned(rule=rule)
    assert_allclose(done.state.estimate[:6], np.linalg.solve(information, right_side), rtol=1e-10)
    assert_allclose(done.state.covariance[:6, :6], np.linalg.inv(information), rtol=1e-8, atol=1e-12)
    # weights 1/5 and 4/5 of the variances 2e-3 and 5e-4; the increment's variance 2 / (1/2e-3 + 1/5e-4)
    sample, mean = turned(rule=rule, before=0.1)[1].sample, 0.2 * RATES[0] + 0.8 * RATES[1]
    assert_allclose(sample.increment, mean - 0.1, rtol=1e-12)
    assert_allclose(sample.rate, 0.5 * (mean + 0.1), rtol=1e-12)
    assert sample.gyro_variance == pytest.approx(8e-4, rel=1e-12)
    assert_allclose(sample.noise, 8e-4 * np.eye(3), rtol=1e-12, atol=1e-18)


@pytest.mark.parametrize("rule", Rule)
def test_where_one_gyro_is_missing_the_other_stands_for_both(rule: int) -> None:
    for missing, there in ((0, 1), (1, 0)):
        rates = RATES.copy()
        rates[missing, 2] = np.nan  # one axis is enough
        _, measurement = turned(rates, rule=rule)
        assert_array_equal(measurement.sample.increment, RATES[there])
        assert_array_equal(measurement.sample.rate, 0.5 * RATES[there])
        assert measurement.sample.gyro_variance == 2.0 * GYRO_VARIANCES[there]
        assert measurement.each == ()
    done, measurement = turned(np.full((2, 3), np.nan), rule=rule)
    assert np.isnan(measurement.innovation.nis)
    assert not done.used
