"""Several packages as one measurement: by hand, against stacked least squares, and in both filters."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from params_probe import mass_params, rotation_params

from massprop_drake.maths.estimation.adaptation import NO_ADAPTATION
from massprop_drake.maths.estimation.filters import mass_filter, rotation_filter
from massprop_drake.maths.estimation.filters.mass_filter import (
    Compensation,
    MassState,
    Rotation,
    compensated,
    shared_covariance,
)
from massprop_drake.maths.estimation.filters.mass_jump import empty_window
from massprop_drake.maths.estimation.filters.rotation_filter import RotationState
from massprop_drake.maths.estimation.redundancy import Rule, combined
from massprop_drake.maths.linear_algebra import Array, is_covariance

# three packages with variances 2, 1 and 4 per component
READINGS = np.array([[1.0, 10.0, -1.0], [3.0, 20.0, 0.0], [8.0, 0.0, 4.0]])
VARIANCES = np.array([2.0, 1.0, 4.0])
AVERAGING = [Rule.AVERAGE, Rule.WEIGHTED_AVERAGE, Rule.SERIAL]


def independent(blocks: Array) -> Array:
    """Covariances R_ij of packages whose errors have nothing in common, shape (s, s, 3, 3)."""
    count = len(blocks)
    covariances = np.zeros((count, count, 3, 3))
    covariances[np.arange(count), np.arange(count)] = blocks
    return covariances


def isotropic(variances: Array) -> Array:
    return independent(variances[:, None, None] * np.eye(3))


def spd(rng: np.random.Generator, size: int) -> Array:
    mixing = rng.normal(size=(size, size)) + 1.5 * np.eye(size)
    return mixing @ mixing.T / size


def split(stacked: Array) -> Array:
    """A stacked covariance as blocks R_ij."""
    count = stacked.shape[0] // 3
    return stacked.reshape(count, 3, count, 3).transpose(0, 2, 1, 3)


def stacked_least_squares(readings: Array, stacked: Array) -> tuple[Array, Array]:
    """The best linear unbiased estimate of what all packages measure, by whitening and QR."""
    root = np.linalg.inv(np.linalg.cholesky(stacked))
    design = root @ np.tile(np.eye(3), (len(readings), 1))
    estimate, *_ = np.linalg.lstsq(design, root @ readings.ravel(), rcond=None)
    triangle = np.linalg.qr(design)[1]
    return estimate, np.linalg.inv(triangle.T @ triangle)


# ------------------------------------------------------------------------------------------ by hand


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
    measurement, covariance = combined(READINGS, isotropic(VARIANCES), rule)
    np.testing.assert_allclose(measurement, reading, rtol=1e-14)
    np.testing.assert_allclose(covariance, variance * np.eye(3), rtol=1e-14, atol=1e-16)


def test_the_middle_of_an_even_number_is_the_mean_of_the_two_in_it() -> None:
    readings = np.vstack([READINGS, [[1e6, -1e6, 2.0]]])
    measurement, _ = combined(readings, isotropic(np.ones(4)), Rule.MID_VALUE)
    # 1 3 8 1e6; -1e6 0 10 20; -1 0 2 4
    np.testing.assert_array_equal(measurement, [5.5, 5.0, 1.0])


def test_the_most_accurate_has_the_smallest_trace() -> None:
    blocks = np.array([np.diag([1.0, 1.0, 1.0]), np.diag([0.1, 0.1, 2.9]), np.diag([0.9, 1.0, 1.0])])
    measurement, covariance = combined(READINGS, independent(blocks), Rule.MOST_ACCURATE)
    np.testing.assert_array_equal(measurement, READINGS[2])
    np.testing.assert_array_equal(covariance, blocks[2])


@pytest.mark.parametrize(
    "rule", [Rule.SINGLE, Rule.MOST_ACCURATE, Rule.MID_VALUE, Rule.AVERAGE, Rule.WEIGHTED_AVERAGE, Rule.SERIAL]
)
@pytest.mark.parametrize("correlated", [True, False])
def test_a_package_alone_is_itself_by_every_rule(rule: int, *, correlated: bool) -> None:
    covariance = spd(np.random.default_rng(1), 3)
    measurement, found = combined(READINGS[:1], covariance[None, None], rule, correlated=correlated)
    np.testing.assert_array_equal(measurement, READINGS[0])
    np.testing.assert_array_equal(found, covariance)


@pytest.mark.parametrize("rule", AVERAGING)
def test_identical_packages_have_their_covariance_divided_by_their_number(rule: int) -> None:
    covariance = spd(np.random.default_rng(2), 3)
    measurement, found = combined(READINGS, independent(np.array([covariance] * 3)), rule)
    np.testing.assert_allclose(measurement, READINGS.mean(axis=0), rtol=1e-12)
    np.testing.assert_allclose(found, covariance / 3.0, rtol=1e-12)


def test_the_middle_value_shuts_out_a_wild_package() -> None:
    honest = np.array([[1.00, 2.00, 3.00], [1.02, 1.98, 3.01]])
    for wild in ([1e9, -1e9, 1e9], [-50.0, 50.0, 0.0]):
        readings = np.vstack([honest, [wild]])
        middle, _ = combined(readings, isotropic(np.ones(3)), Rule.MID_VALUE)
        assert (middle >= honest.min(axis=0)).all()
        assert (middle <= honest.max(axis=0)).all()
        average, _ = combined(readings, isotropic(np.ones(3)), Rule.AVERAGE)
        assert np.abs(average - honest[0]).max() > 10.0  # which an average does not


# ------------------------------------------------------------------------------------- best averages


def test_the_weighted_average_minimizes_the_variance() -> None:
    # any other unbiased combination, sum of W_j the identity, has a covariance above it
    rng = np.random.default_rng(3)
    blocks = np.array([spd(rng, 3) for _ in range(3)])
    _, best = combined(READINGS, independent(blocks), Rule.WEIGHTED_AVERAGE)
    for _ in range(50):
        weights = rng.normal(size=(3, 3, 3))
        weights[2] = np.eye(3) - weights[0] - weights[1]
        other = sum(weight @ block @ weight.T for weight, block in zip(weights, blocks, strict=True))
        assert np.linalg.eigvalsh(other - best).min() > -1e-12
    _, average = combined(READINGS, independent(blocks), Rule.AVERAGE)
    assert np.linalg.eigvalsh(average - best).min() > 0.0


@pytest.mark.parametrize("rule", [Rule.WEIGHTED_AVERAGE, Rule.SERIAL])
@pytest.mark.parametrize("count", [2, 3, 4])
def test_correlated_packages_make_the_stacked_least_squares_estimate(rule: int, count: int) -> None:
    rng = np.random.default_rng(4)
    readings, stacked = rng.normal(size=(count, 3)), spd(rng, 3 * count)
    measurement, covariance = combined(readings, split(stacked), rule, correlated=True)
    expected, spread = stacked_least_squares(readings, stacked)
    np.testing.assert_allclose(measurement, expected, rtol=1e-9)
    np.testing.assert_allclose(covariance, spread, rtol=1e-9, atol=1e-12)
    np.testing.assert_array_equal(covariance, covariance.T)


@pytest.mark.parametrize("rule", [Rule.WEIGHTED_AVERAGE, Rule.SERIAL])
def test_independent_packages_make_the_stacked_least_squares_estimate(rule: int) -> None:
    rng = np.random.default_rng(5)
    blocks = np.array([spd(rng, 3) for _ in range(3)])
    stacked = np.zeros((9, 9))
    for package, block in enumerate(blocks):
        stacked[3 * package : 3 * package + 3, 3 * package : 3 * package + 3] = block
    for correlated in (True, False):
        measurement, covariance = combined(READINGS, independent(blocks), rule, correlated=correlated)
        expected, spread = stacked_least_squares(READINGS, stacked)
        np.testing.assert_allclose(measurement, expected, rtol=1e-10)
        np.testing.assert_allclose(covariance, spread, rtol=1e-10, atol=1e-14)


def test_the_covariance_of_a_correlated_average_is_that_of_the_mean() -> None:
    stacked = spd(np.random.default_rng(6), 9)
    mean = np.tile(np.eye(3), (1, 3)) / 3.0
    measurement, covariance = combined(READINGS, split(stacked), Rule.AVERAGE, correlated=True)
    np.testing.assert_allclose(covariance, mean @ stacked @ mean.T, rtol=1e-12)
    np.testing.assert_allclose(measurement, READINGS.mean(axis=0), rtol=1e-14)


@pytest.mark.parametrize("rule", AVERAGING)
def test_what_packages_share_counts_only_where_asked(rule: int) -> None:
    stacked = spd(np.random.default_rng(7), 9)
    own = independent(split(stacked)[np.arange(3), np.arange(3)])
    ignored, alone = combined(READINGS, split(stacked), rule), combined(READINGS, own, rule)
    np.testing.assert_array_equal(ignored[1], alone[1])
    counted = combined(READINGS, split(stacked), rule, correlated=True)
    assert np.abs(counted[1] - alone[1]).max() > 0.01


def test_what_was_handed_in_is_not_changed() -> None:
    stacked = split(spd(np.random.default_rng(8), 9)).copy()
    readings, before = READINGS.copy(), stacked.copy()
    for rule in (Rule.SINGLE, Rule.MOST_ACCURATE, Rule.MID_VALUE, *AVERAGING):
        for correlated in (True, False):
            combined(readings, stacked, rule, correlated=correlated)
    np.testing.assert_array_equal(readings, READINGS)
    np.testing.assert_array_equal(stacked, before)


# ------------------------------------------------------------------------------------ in the mass filter

PUSH = np.array([3.0, -1.0, 2.0])
VELOCITIES = np.array([[1.2, -0.4, 0.9], [1.0, -0.2, 0.5], [0.8, -0.5, 0.7]])
ACCELEROMETER_VARIANCES = np.array([0.02, 0.05, 0.01])
POSITIONS = np.array([[2.0, -1.0, 0.5], [-1.5, 0.3, 1.0], [0.2, 2.0, -0.7]])
CENTER = np.array([0.1, -0.2, 0.3])
CENTER_COVARIANCE = np.array([[0.30, 0.05, -0.02], [0.05, 0.20, 0.04], [-0.02, 0.04, 0.10]])
TURN = np.array([0.2, -0.3, 0.1])
RATE = np.array([0.5, 0.4, -0.8])


def weighed(velocities: Array = VELOCITIES, **params: Any) -> tuple[mass_filter.MassCycle, mass_filter.MassMeasurement]:
    """A cycle of the mass filter from rest."""
    chosen = mass_params(positions=POSITIONS, variances=ACCELEROMETER_VARIANCES, **params)
    state = MassState(0.3, 0.02, empty_window(1))
    rotation = Rotation(TURN, RATE, 0.01, CENTER, CENTER_COVARIANCE)
    measurement = mass_filter.measure(
        state, np.zeros((3, 3)), velocities, mass_filter.MassInterval(PUSH), rotation, chosen
    )
    return mass_filter.finish(state, measurement, True, True, NO_ADAPTATION, chosen), measurement


def batch(measurements: Array, stacked: Array) -> tuple[float, float]:
    """1/m and its variance from all accelerometers at once, in information form."""
    design = np.tile(PUSH, len(measurements))
    weights = np.linalg.solve(stacked, design)
    information = 1.0 / 0.02 + weights @ design
    return (0.3 / 0.02 + weights @ measurements.ravel()) / information, 1.0 / information


@pytest.mark.parametrize("rule", [Rule.SERIAL, Rule.WEIGHTED_AVERAGE])
def test_one_after_the_other_equals_all_at_once_where_independent(rule: int) -> None:
    done, measurement = weighed(rule=rule)
    stacked = np.kron(np.diag(2.0 * ACCELEROMETER_VARIANCES), np.eye(3))
    expected, variance = batch(VELOCITIES, stacked)
    assert done.state.mass_reciprocal == pytest.approx(expected, rel=1e-12)
    assert done.state.variance == pytest.approx(variance, rel=1e-12)
    assert len(measurement.each) == (3 if rule == Rule.SERIAL else 0)


TRANSVERSE = mass_params(compensation=Compensation.TRANSVERSE, compensation_covariance=True)


def freed(index: int) -> tuple[Array, Array]:
    """What transverse compensation makes of one accelerometer."""
    noise = 2.0 * ACCELEROMETER_VARIANCES[index] * np.eye(3)
    arm = POSITIONS[index] - CENTER
    rotation = Rotation(TURN, RATE, 0.01, CENTER, CENTER_COVARIANCE)
    return compensated(VELOCITIES[index], noise, arm, rotation, TRANSVERSE)


def cross_covariance(i: int, j: int) -> Array:
    """R'_ij written out: [dw x] S_cm [dw x]^T + sum over axes of var (e x r_i) (e x r_j)^T, and the same of S_cm."""

    def crossing(vector: Array) -> Array:
        columns: Array = np.cross(vector, np.eye(3)).T
        return columns

    matrix = crossing(TURN)
    arms = POSITIONS - CENTER
    total = matrix @ CENTER_COVARIANCE @ matrix.T
    for axis in np.eye(3):
        turn = crossing(axis)
        total += 0.01 * np.outer(np.cross(axis, arms[i]), np.cross(axis, arms[j]))
        total += 0.01 * turn @ CENTER_COVARIANCE @ turn.T
    return total


@pytest.mark.parametrize("rule", [Rule.SERIAL, Rule.WEIGHTED_AVERAGE])
def test_correlated_accelerometers_make_one_stacked_update(rule: int) -> None:
    stacked = np.zeros((9, 9))
    for i in range(3):
        for j in range(3):
            block = freed(i)[1] if i == j else cross_covariance(i, j)
            stacked[3 * i : 3 * i + 3, 3 * j : 3 * j + 3] = block
    assert is_covariance(stacked)
    expected, variance = batch(np.array([freed(i)[0] for i in range(3)]), stacked)
    about = {"compensation": Compensation.TRANSVERSE, "compensation_covariance": True, "rule": rule}
    done, measurement = weighed(correlated=True, **about)
    assert done.state.mass_reciprocal == pytest.approx(expected, rel=1e-11)
    assert done.state.variance == pytest.approx(variance, rel=1e-11)
    assert measurement.each == ()
    # what they share shows: taken as independent, they claim to know more
    assert weighed(**about)[0].state.variance < 0.97 * variance


def test_what_two_accelerometers_share_is_that_of_samples() -> None:
    # dw = dw^ - v and r_cm = r^_cm - dr are common to both: dw x r - dw^ x r^ of each, by sampling
    rng = np.random.default_rng(9)
    count, rate_variance = 400_000, 0.04
    rates = TURN - np.sqrt(rate_variance) * rng.standard_normal((count, 3))
    error = rng.standard_normal((count, 3)) @ np.linalg.cholesky(CENTER_COVARIANCE).T
    arms = POSITIONS[:2] - CENTER
    errors = [np.cross(rates, arm - error) - np.cross(TURN, arm) for arm in arms]
    shared = shared_covariance(
        (arms[0], arms[1]), Rotation(TURN, RATE, rate_variance, CENTER, CENTER_COVARIANCE), TRANSVERSE
    )
    products = errors[0][:, :, None] * errors[1][:, None]
    bounds = 5.0 * products.std(axis=0) / np.sqrt(count)
    assert (np.abs(products.mean(axis=0) - shared) < bounds).all()
    assert (np.abs(products.mean(axis=0) - shared.T) > bounds).any()  # it can tell the two apart


def test_a_wild_accelerometer_does_not_get_through_the_middle_value() -> None:
    wild = VELOCITIES.copy()
    wild[1] = [1e6, -1e6, 1e6]
    # the middle of each component is one of the two others'; the noise, the mean of all, stays
    middle, measurement = weighed(wild, rule=Rule.MID_VALUE)
    np.testing.assert_array_equal(measurement.sample.measured, [1.2, -0.5, 0.9])
    np.testing.assert_allclose(measurement.sample.noise, 2.0 * ACCELEROMETER_VARIANCES.mean() * np.eye(3), rtol=1e-14)
    assert abs(middle.state.mass_reciprocal - 0.3) < 0.2
    assert abs(weighed(wild, rule=Rule.AVERAGE)[0].state.mass_reciprocal - 0.3) > 1e4


# -------------------------------------------------------------------------------- in the rotation filter

INVERSE = np.linalg.inv(np.array([[2.0, 0.1, -0.2], [0.1, 3.0, 0.3], [-0.2, 0.3, 4.0]]))
STATE = np.array([*INVERSE.diagonal(), INVERSE[1, 2], INVERSE[0, 2], INVERSE[0, 1], 0.5, -0.3, 0.2])
TWIST = np.array([0.7, -1.1, 0.4])
RATES = np.array([[0.30, -0.35, 0.20], [0.34, -0.30, 0.25]])
GYRO_VARIANCES = np.array([2e-3, 5e-4])


def turned(rates: Array = RATES, before: Array | None = None, **params: Any) -> tuple[Any, Any]:
    """A cycle of the rotation filter from rest with the center of mass known, so that all is linear."""
    chosen = rotation_params(gyro_variances=GYRO_VARIANCES, **params)
    covariance = np.zeros((9, 9))
    covariance[:6, :6] = 0.01 * spd(np.random.default_rng(10), 6)
    state = RotationState(STATE, covariance)
    start = np.zeros((2, 3)) if before is None else before
    measurement = rotation_filter.measure(
        state,
        rotation_filter.RotationMemory(start, False),
        rates,
        rotation_filter.RotationInterval(TWIST, np.zeros(3), True),
        chosen,
    )
    return rotation_filter.finish(state, measurement, True, NO_ADAPTATION, chosen), measurement


@pytest.mark.parametrize("rule", [Rule.SERIAL, Rule.WEIGHTED_AVERAGE])
def test_two_gyros_are_one_stacked_measurement(rule: int) -> None:
    x, y, z = TWIST
    design = np.array([[x, 0.0, 0.0, 0.0, z, y], [0.0, y, 0.0, z, 0.0, x], [0.0, 0.0, z, y, x, 0.0]])
    information = np.linalg.inv(0.01 * spd(np.random.default_rng(10), 6))
    right_side = information @ STATE[:6]
    for increment, variance in zip(RATES, GYRO_VARIANCES, strict=True):
        information = information + design.T @ design / (2.0 * variance)
        right_side = right_side + design.T @ increment / (2.0 * variance)
    done, _ = turned(rule=rule)
    np.testing.assert_allclose(done.state.estimate[:6], np.linalg.solve(information, right_side), rtol=1e-10)
    np.testing.assert_allclose(done.state.covariance[:6, :6], np.linalg.inv(information), rtol=1e-8, atol=1e-12)


def test_the_sample_of_two_gyros_is_their_weighted_mean_with_its_variance() -> None:
    # weights 1/5 and 4/5 of the variances 2e-3 and 5e-4; the increment's variance 2 / (1/2e-3 + 1/5e-4)
    sample = turned(rule=Rule.WEIGHTED_AVERAGE, before=np.full((2, 3), 0.1))[1].sample
    mean = 0.2 * RATES[0] + 0.8 * RATES[1]
    np.testing.assert_allclose(sample.increment, mean - 0.1, rtol=1e-12)
    np.testing.assert_allclose(sample.rate, 0.5 * (mean + 0.1), rtol=1e-12)
    assert sample.gyro_variance == pytest.approx(8e-4, rel=1e-12)
    np.testing.assert_allclose(sample.noise, 8e-4 * np.eye(3), rtol=1e-12, atol=1e-18)


@pytest.mark.parametrize(
    "rule", [Rule.SINGLE, Rule.MOST_ACCURATE, Rule.MID_VALUE, Rule.AVERAGE, Rule.WEIGHTED_AVERAGE, Rule.SERIAL]
)
def test_where_one_gyro_is_missing_the_other_stands_for_both(rule: int) -> None:
    for missing, there in ((0, 1), (1, 0)):
        rates = RATES.copy()
        rates[missing, 2] = np.nan  # one axis is enough
        _, measurement = turned(rates, rule=rule)
        np.testing.assert_array_equal(measurement.sample.increment, RATES[there])
        assert measurement.sample.gyro_variance == 2.0 * GYRO_VARIANCES[there]
        assert measurement.each == ()
    done, measurement = turned(np.full((2, 3), np.nan), rule=rule)
    assert np.isnan(measurement.innovation.nis)
    assert not done.used
