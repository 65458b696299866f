"""The windowed test for jumps of the mass reciprocal: against its sums, single samples, and chance."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import pytest
from params_probe import mass_params
from scipy.stats import binom, chi2, kstest

from massprop_drake.maths.estimation import adaptation
from massprop_drake.maths.estimation.filters import mass_filter
from massprop_drake.maths.estimation.filters.mass_filter import (
    MassInnovation,
    MassMeasurement,
    MassParams,
    MassSample,
    MassState,
)
from massprop_drake.maths.estimation.filters.mass_jump import JumpTest, empty_window, jump_test
from massprop_drake.maths.linear_algebra import Array

SETTINGS = mass_params(jump_variance=1.0)


class Firing(NamedTuple):
    """Impulses, noises, gains and innovation covariances of a Kalman filter for 1/m over some samples."""

    impulses: Array  # (n, 3)
    noises: Array  # R', (n, 3, 3)
    gains: Array  # (n, 3)
    informations: Array  # inverses of Y, (n, 3, 3)
    variances: Array  # predicted, then after each sample, (n + 1,)

    def share(self, k: int) -> float:
        """kappa^T lambda of a sample."""
        return float(self.gains[k] @ self.impulses[k])

    @property
    def sample(self) -> MassSample:
        """The first one; what was measured is in its innovation."""
        return MassSample(np.full(3, np.nan), self.noises[0], self.impulses[0])


def firing(samples: int, *, variance: float = 0.5, seed: int = 1) -> Firing:
    """Moderate numbers: a sample tells about as much as is known before."""
    rng = np.random.default_rng(seed)
    impulses = rng.normal(size=(samples, 3))
    mixing = rng.normal(size=(samples, 3, 3)) + 1.5 * np.eye(3)
    noises = mixing @ mixing.transpose(0, 2, 1)
    gains, informations, variances = [], [], [variance]
    for impulse, noise in zip(impulses, noises, strict=True):
        information = np.linalg.inv(np.outer(impulse, impulse) * variances[-1] + noise)
        gains.append(variances[-1] * information @ impulse)
        informations.append(information)
        variances.append((1.0 - gains[-1] @ impulse) * variances[-1])
    return Firing(impulses, noises, np.array(gains), np.array(informations), np.array(variances))


def run(flight: Firing, noise: Array, error: float, jump: float, at: int, length: int) -> tuple[float, JumpTest]:
    """The filter and the test along a flight.

    Args:
        flight: see `Firing`.
        noise: of the velocity increments, shape (n, 3).
        error: truth minus estimate before the first sample.
        jump: of the truth.
        at: sample before which it jumps.
        length: of the window.

    Returns:
        Truth minus estimate after the last sample, and the last test.
    """
    window = empty_window(length)
    for k in range(len(flight.impulses)):
        error += jump if k == at else 0.0
        innovation = flight.impulses[k] * error + noise[k]
        test = jump_test(window, flight.impulses[k], flight.informations[k], innovation, flight.share(k))
        window = test.window
        error -= float(flight.gains[k] @ innovation)
    return error, test


# ---------------------------------------------------------------------------------------- the recursion


def effect_on_estimate(flight: Firing, k: int, theta: int) -> float:
    """f of (3-97): the sum over samples of what each update takes up, written out."""
    total = 0.0
    for i in range(theta, k + 1):
        kept = [1.0 - flight.gains[j] @ flight.impulses[j] for j in range(i + 1, k + 1)]
        total += float(np.prod(kept)) * float(flight.gains[i] @ flight.impulses[i])
    return total


def effect_on_innovation(flight: Firing, k: int, theta: int) -> Array:
    """g of (3-100)."""
    return flight.impulses[k] * (1.0 - (effect_on_estimate(flight, k - 1, theta) if k > theta else 0.0))


def test_the_recursion_against_the_sums() -> None:
    samples, length = 6, 4
    flight = firing(samples)
    innovations = np.random.default_rng(2).normal(size=(samples, 3))
    window = empty_window(length)
    for k in range(samples):
        test = jump_test(window, flight.impulses[k], flight.informations[k], innovations[k], flight.share(k))
        window = test.window
        assert window.shape == (length, 3)
        for row in range(length):
            theta = k - length + 1 + row  # the newest last
            if theta < 0:
                assert not window[row].any()
                continue
            g = [effect_on_innovation(flight, i, theta) for i in range(theta, k + 1)]
            y = flight.informations[theta : k + 1]
            information = sum(a @ b @ a for a, b in zip(g, y, strict=True))  # (3-104)
            projection = sum(a @ b @ e for a, b, e in zip(g, y, innovations[theta : k + 1], strict=True))  # (3-105)
            np.testing.assert_allclose(window[row, 0], effect_on_estimate(flight, k, theta), rtol=1e-12)
            np.testing.assert_allclose(window[row, 1:], [information, projection], rtol=1e-10)


def test_what_is_left_of_a_jump_is_the_product_of_what_each_sample_leaves() -> None:
    # 1 - f = prod (1 - kappa^T lambda), the reference's remark on (3-97)
    flight = firing(5)
    _, test = run(flight, np.zeros((5, 3)), 0.0, 0.0, 0, 5)
    left = 1.0 - np.einsum("ij,ij->i", flight.gains, flight.impulses)
    np.testing.assert_allclose(1.0 - test.window[:, 0], np.cumprod(left[::-1])[::-1], rtol=1e-12)


def test_the_likeliest_jump_of_the_window_is_reported() -> None:
    flight = firing(5)
    _, test = run(flight, np.random.default_rng(3).normal(size=(5, 3)), 0.1, 2.0, 2, 5)
    f, c, d = test.window.T
    best = int((d**2 / c).argmax())
    assert len(set(np.round(d**2 / c, 6))) == 5
    np.testing.assert_allclose(test.likelihood, (d**2 / c)[best], rtol=1e-14)
    np.testing.assert_allclose(test.jump, (d / c)[best], rtol=1e-14)
    np.testing.assert_allclose(test.correction, ((1.0 - f) * d / c)[best], rtol=1e-14)
    np.testing.assert_allclose(test.growth, ((1.0 - f) ** 2 / c)[best], rtol=1e-14)


@pytest.mark.parametrize("at", [0, 1, 3])
def test_a_jump_without_noise_is_found_where_and_as_it_was(at: int) -> None:
    flight = firing(5)
    error, test = run(flight, np.zeros((5, 3)), 0.0, -0.8, at, 5)
    f, c, d = test.window[at]
    np.testing.assert_allclose(d / c, -0.8, rtol=1e-10)
    # every sample since is explained, so no other theta explains more
    np.testing.assert_allclose(test.likelihood, d**2 / c, rtol=1e-10)
    # and the correction takes the error away
    np.testing.assert_allclose(error - (1.0 - f) * d / c, 0.0, atol=1e-12)


def test_the_oldest_sample_leaves_the_window() -> None:
    flight = firing(6)
    noise = np.random.default_rng(4).normal(size=(6, 3))
    _, short = run(flight, noise, 0.3, 0.0, 0, 3)
    _, whole = run(flight, noise, 0.3, 0.0, 0, 6)
    np.testing.assert_array_equal(short.window, whole.window[3:])
    assert short.likelihood <= whole.likelihood


def test_a_sample_without_an_impulse_tells_nothing() -> None:
    test = jump_test(empty_window(2), np.zeros(3), np.eye(3), np.ones(3), 0.0)
    assert test[1:] == (0.0, 0.0, 0.0, 0.0)


def test_what_was_handed_in_is_not_changed() -> None:
    flight = firing(3)
    _, test = run(flight, np.ones((3, 3)), 0.3, 0.0, 0, 3)
    before = test.window.copy()
    jump_test(test.window, flight.impulses[0], flight.informations[0], np.ones(3), flight.share(0))
    np.testing.assert_array_equal(test.window, before)


# ------------------------------------------------------------------------------------ (3-113), (3-118)


def linear_parts(flight: Firing, outcome: Callable[[float, JumpTest], float], at: int, length: int) -> Array:
    """An outcome that is linear in initial error, noises and jump: its coefficient of each, in that order."""
    samples = len(flight.impulses)
    none = np.zeros((samples, 3))
    parts = [outcome(*run(flight, none, 1.0, 0.0, at, length))]
    for k in range(samples):
        for axis in range(3):
            noise = none.copy()
            noise[k, axis] = 1.0
            parts.append(outcome(*run(flight, noise, 0.0, 0.0, at, length)))
    parts.append(outcome(*run(flight, none, 0.0, 1.0, at, length)))
    return np.array(parts)


@pytest.mark.parametrize("theta", [0, 2, 4])
def test_the_variance_after_a_jump_is_exact_for_the_right_theta(theta: int) -> None:
    # all is linear in independent errors, so unit errors give the corrected error's variance without sampling
    samples = 5
    flight = firing(samples)

    def corrected(error: float, test: JumpTest) -> float:
        f, c, d = test.window[theta]
        return error - float((1.0 - f) * d / c)  # (3-111)

    parts = linear_parts(flight, corrected, theta, samples)
    covariance = np.zeros((3 * samples + 1, 3 * samples + 1))
    covariance[0, 0] = flight.variances[0]
    for k, noise in enumerate(flight.noises):
        covariance[1 + 3 * k : 4 + 3 * k, 1 + 3 * k : 4 + 3 * k] = noise
    variance = parts[:-1] @ covariance @ parts[:-1]
    _, test = run(flight, np.zeros((samples, 3)), 0.0, 0.0, theta, samples)
    f, c, _ = test.window[theta]
    np.testing.assert_allclose(variance, flight.variances[-1] + (1.0 - f) ** 2 / c, rtol=1e-10)  # (3-113)
    # and nothing of the jump is left
    np.testing.assert_allclose(parts[-1], 0.0, atol=1e-12)


def innovation_of(flight: Firing, error: float, noise: Array) -> MassInnovation:
    seen = flight.impulses[0] * error + noise
    covariance = np.linalg.inv(flight.informations[0])
    nis = float(seen @ flight.informations[0] @ seen)
    return MassInnovation(seen, covariance, flight.informations[0], flight.noises[0], None, nis)


def test_after_a_single_sample_jump_the_sample_alone_counts() -> None:
    # the filter's update with a threshold that anything exceeds, against weighted least squares of this sample:
    # variance 1 / (lambda^T R'^-1 lambda), the corrected (3-118)
    flight = firing(1)
    innovation = innovation_of(flight, 0.4, np.array([0.1, -0.2, 0.3]))
    always = SETTINGS._replace(jump_threshold=0.0)
    state = MassState(2.0, flight.variances[0], empty_window(1))
    result = mass_filter.update(state, flight.sample, innovation, adaptation.NO_ADAPTATION, always)
    assert result.jumped
    impulse, information = flight.impulses[0], np.linalg.inv(flight.noises[0])
    alone = impulse @ information @ impulse
    np.testing.assert_allclose(result.state.variance, 1.0 / alone, rtol=1e-10)
    measured = innovation.innovation + 2.0 * impulse
    np.testing.assert_allclose(result.state.mass_reciprocal, impulse @ information @ measured / alone, rtol=1e-10)


def test_the_variance_after_a_jump_by_sampling() -> None:
    # an independent check of the same: draws of a filter that jumps on the right theta, four samples
    count, samples, theta = 1500, 4, 1
    flight = firing(samples, seed=6)
    rng = np.random.default_rng(7)
    roots = np.linalg.cholesky(flight.noises)
    errors = np.empty(count)
    for draw in range(count):
        noise = np.einsum("kij,kj->ki", roots, rng.normal(size=(samples, 3)))
        first = np.sqrt(flight.variances[0]) * rng.normal()
        error, test = run(flight, noise, first, 1.7, theta, samples)
        f, c, d = test.window[theta]
        errors[draw] = error - (1.0 - f) * d / c
    claimed = flight.variances[-1] + (1.0 - f) ** 2 / c
    # standard errors of mean and variance; 3.5 of them
    assert abs(errors.mean()) < 3.5 * np.sqrt(claimed / count)
    assert abs(errors.var() / claimed - 1.0) < 3.5 * np.sqrt(2.0 / count)


# --------------------------------------------------------------------------------------- laws of chance


@pytest.fixture(scope="module")
def healthy() -> Array:
    """Statistics d^2 / C of every theta of a window of five, nothing having jumped, shape (count, 5)."""
    count, samples = 3000, 5
    flight = firing(samples, seed=8)
    rng = np.random.default_rng(9)
    roots = np.linalg.cholesky(flight.noises)
    statistics = np.empty((count, samples))
    for draw in range(count):
        noise = np.einsum("kij,kj->ki", roots, rng.normal(size=(samples, 3)))
        _, test = run(flight, noise, np.sqrt(flight.variances[0]) * rng.normal(), 0.0, 0, samples)
        statistics[draw] = test.window[:, 2] ** 2 / test.window[:, 1]
        assert test.likelihood == statistics[draw].max()
    return statistics


@pytest.mark.parametrize("theta", range(5))
def test_for_each_theta_the_statistic_is_chi_square_with_one_degree(healthy: Array, theta: int) -> None:
    assert kstest(healthy[:, theta], chi2(1).cdf).pvalue > 1e-3


def test_the_largest_of_the_window_keeps_the_false_alarm_rate_divided_by_its_length(healthy: Array) -> None:
    # at most 1 % by the union bound; the thesis's chi-square with five degrees would be far rarer than asked
    largest = healthy.max(axis=1)
    exceeding = (largest > chi2.isf(0.01 / 5, 1)).sum()
    assert exceeding <= binom.ppf(0.999, len(largest), 0.01)
    assert exceeding >= binom.ppf(0.001, len(largest), 0.01 / 5)  # and at least that of one theta
    assert (largest > chi2.isf(0.01, 1)).mean() > 0.015  # the threshold of one theta is too low for five


# ------------------------------------------------------------------------------------ in the mass filter


def finished(window: Array, adapted: adaptation.Adaptation, params: MassParams) -> mass_filter.MassCycle:
    flight = firing(1)
    measurement = MassMeasurement(flight.sample, innovation_of(flight, 4.0, np.array([0.1, -0.2, 0.3])))
    return mass_filter.finish(MassState(2.0, flight.variances[0], window), measurement, True, True, adapted, params)


def test_the_filter_jumps_when_the_statistic_exceeds_its_threshold() -> None:
    params = SETTINGS._replace(jump_window=3)
    quiet = finished(empty_window(3), adaptation.NO_ADAPTATION, params)
    assert not quiet.jumped
    flight = firing(1)
    innovation = innovation_of(flight, 4.0, np.array([0.1, -0.2, 0.3])).innovation
    share = 1.0 - (1.0 - flight.share(0))  # what the filter's own share is to the last bit
    test = jump_test(empty_window(3), flight.impulses[0], flight.informations[0], innovation, share)
    just_below = finished(
        empty_window(3), adaptation.NO_ADAPTATION, params._replace(jump_threshold=test.likelihood / 1.001)
    )
    assert just_below.jumped
    np.testing.assert_allclose(
        just_below.state.mass_reciprocal, quiet.state.mass_reciprocal + test.correction, rtol=1e-12
    )
    np.testing.assert_allclose(just_below.state.variance, quiet.state.variance + test.growth, rtol=1e-12)
    assert not just_below.state.window.any()  # the next jump is looked for from here
    just_above = finished(
        empty_window(3), adaptation.NO_ADAPTATION, params._replace(jump_threshold=test.likelihood * 1.001)
    )
    assert not just_above.jumped
    np.testing.assert_array_equal(just_above.state.window, test.window)
    assert (just_above.state.mass_reciprocal, just_above.state.variance) == (
        quiet.state.mass_reciprocal,
        quiet.state.variance,
    )


@pytest.mark.parametrize(
    "action", [adaptation.Action.CORRECT, adaptation.Action.CORRECT_THESIS, adaptation.Action.REJECT]
)
def test_a_sample_with_an_alarm_is_not_tested_for_a_jump(action: int) -> None:
    nothing = np.zeros(3), np.zeros(3), np.zeros((3, 3)), np.zeros((3, 3))
    alarmed = adaptation.Adaptation(action, *nothing, mass_jumped=False)
    eager = SETTINGS._replace(jump_window=3, jump_threshold=0.0)
    assert finished(empty_window(3), adaptation.NO_ADAPTATION, eager).jumped
    assert not finished(empty_window(3), alarmed, eager).jumped
