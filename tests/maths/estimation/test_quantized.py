"""Moments of truncated Gaussians, and quantized readings as measurements."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import norm

from massprop_drake.maths.estimation.joint.quantized import FLOOR, Sites, sites, truncated_moments
from massprop_drake.maths.linear_algebra import Array

COVARIANCE = np.array([[0.5, 0.2, 0.0], [0.2, 0.8, -0.1], [0.0, -0.1, 0.3]])


def integrated(lower: float, upper: float) -> tuple[float, float, float]:
    """Log probability, mean and variance by numerical integration, relative to the density's peak in the interval."""
    peak = min(max(lower, 0.0), upper)
    upper = min(upper, peak + 40.0)
    lower = max(lower, peak - 40.0)

    def moment(power: int, about: float = 0.0) -> float:
        def density(x: float) -> float:
            return float((x - about) ** power * np.exp(-0.5 * (x - peak) * (x + peak)))

        found: float = quad(density, lower, upper, epsabs=1e-14 * (upper - lower), epsrel=1e-12, limit=200)[0]
        return found

    mass = moment(0)
    mean = moment(1) / mass
    return float(np.log(mass) - 0.5 * peak**2 - 0.5 * np.log(2.0 * np.pi)), mean, moment(2, mean) / mass


@pytest.mark.parametrize(
    ("lower", "upper"),
    [
        (-1.0, 1.0),
        (0.0, 1.0),
        (-3.0, 7.0),
        (-0.45, 0.5),
        (0.3, 0.3005),
        (-4e-4, 5e-4),
        (2.0, 50.0),
        (5.0, 5.5),
        (10.0, 10.0009),
        (26.0, 26.1),
        (26.0, 29.0),
        (-40.0, -39.0),
        (100.0, 100.02),
        (300.0, 300.0005),
        (1e3, 1e3 + 1.0),
    ],
)
def test_moments_are_those_of_the_density(lower: float, upper: float) -> None:
    """To rounding, the variance of a narrow cell and of a far tail included."""
    found, (log_probability, mean, variance) = truncated_moments(lower, upper), integrated(lower, upper)
    assert found.log_probability == pytest.approx(log_probability, rel=1e-11, abs=1e-11)
    assert found.mean == pytest.approx(mean, rel=1e-11, abs=1e-11 * (upper - lower))
    assert found.variance == pytest.approx(variance, rel=1e-10)


def test_an_interval_mirrored_has_its_moments_mirrored() -> None:
    found, mirrored = truncated_moments(0.3, 1.7), truncated_moments(-1.7, -0.3)
    assert mirrored == pytest.approx((found.log_probability, -found.mean, found.variance))


@pytest.mark.parametrize(
    "border", [(0.999999, 2.1, 1.000001, 2.100002), (-0.5, 0.499999, -0.5, 0.500001), (0.9, 1.899999, 0.9, 1.900001)]
)
def test_moments_go_on_across_the_border_between_two_forms(border: tuple[float, float, float, float]) -> None:
    before, after = truncated_moments(*border[:2]), truncated_moments(*border[2:])
    assert after == pytest.approx(before, abs=5e-6)


@pytest.mark.parametrize("bound", [np.inf, 1e20, -1e20])
def test_a_filter_that_has_overflowed_or_is_off_beyond_arithmetic_gets_no_number(bound: float) -> None:
    assert np.isnan(truncated_moments(bound, bound)).all()


def test_a_reading_that_is_not_quantized_is_a_measurement_with_its_noise() -> None:
    errors, floors = np.array([0.4, -0.7, 1.1]), np.array([0.1, 0.2, 0.3])
    found = sites(errors, COVARIANCE, np.zeros(3), floors)
    np.testing.assert_allclose(found.innovation, errors)
    np.testing.assert_allclose(found.variance, floors)
    total = COVARIANCE + np.diag(floors)
    expected = -0.5 * (errors @ np.linalg.solve(total, errors) + np.linalg.slogdet(2.0 * np.pi * total)[1])
    assert found.log_likelihood.sum() == pytest.approx(expected)
    assert found.nis.sum() == pytest.approx(errors @ np.linalg.solve(total, errors))
    np.testing.assert_allclose(found.degrees, 1.0)


def test_a_narrow_cell_is_a_measurement_with_uniform_noise() -> None:
    quantum = 1e-2
    found = sites(np.array([0.3]), np.array([[1.0]]), np.array([quantum]), np.array([1e-8]))
    assert found.variance[0] == pytest.approx(quantum**2 / 12.0 + 1e-8, rel=1e-3)
    assert found.innovation[0] == pytest.approx(0.3, rel=1e-4)


def test_cells_that_cover_everything_are_certain_together() -> None:
    cells, quantum, floor = np.arange(-60, 61), 0.4, 1e-4
    each = [sites(np.array([quantum * c]), np.array([[1.3]]), np.array([quantum]), np.array([floor])) for c in cells]
    probabilities = np.exp([one.log_likelihood[0] for one in each])
    assert probabilities.sum() == pytest.approx(1.0)
    assert probabilities[60] == pytest.approx(norm.cdf(0.2, scale=np.sqrt(1.3 + floor)) * 2 - 1)
    nis, degrees = (np.array([getattr(one, name)[0] for one in each]) for name in ("nis", "degrees"))
    assert probabilities @ nis == pytest.approx(probabilities @ degrees)  # what is expected of the one is the other


def test_readings_are_taken_in_given_those_before() -> None:
    errors, quanta, floors = np.array([0.4, -0.7, 0.2]), np.full(3, 0.5), np.full(3, 1e-4)
    found = sites(errors, COVARIANCE, quanta, floors)
    first = sites(errors[:1], COVARIANCE[:1, :1], quanta[:1], floors[:1])
    gain = COVARIANCE[1:, 0] / (COVARIANCE[0, 0] + first.variance[0])
    shift, left = gain * first.innovation[0], COVARIANCE[1:, 1:] - np.outer(gain, COVARIANCE[0, 1:])
    rest = sites(errors[1:] - shift, left, quanta[1:], floors[1:])
    np.testing.assert_allclose(found.variance[1:], rest.variance)
    np.testing.assert_allclose(found.innovation[1:], rest.innovation + shift)
    np.testing.assert_allclose(found.log_likelihood[1:], rest.log_likelihood)


def test_one_cell_halves_a_variance_at_most() -> None:
    """A cell five sigmas off would leave a thirtieth of the variance; no Gaussian is believed so far out.

    What is left of a variance P by a measurement with the variance R is R / (P + R).
    """
    found = sites(np.array([7.0]), np.array([[1.0]]), np.array([4.0]), np.array([1.6e-3]))
    assert found.degrees[0] > 0.95
    assert found.variance[0] / (1.0 + found.variance[0]) == pytest.approx(0.5, rel=2e-3)


def test_a_wide_cell_about_the_prediction_says_nothing() -> None:
    found = sites(np.array([0.1]), np.array([[1.0]]), np.array([100.0]), np.array([1.0]))
    assert found.variance[0] > 1e8
    assert found.log_likelihood[0] == pytest.approx(0.0, abs=1e-12)


def test_rounding_of_a_huge_covariance_leaves_no_negative_variance() -> None:
    huge = 1e30 * np.outer([1.0, 1.0 + 1e-9], [1.0, 1.0 + 1e-9])
    found = sites(np.array([1.0, 2.0]), huge, np.full(2, 1e-6), np.full(2, 1e-16))
    assert (found.variance > 0.0).all()


def test_moments_of_any_interval_are_those_of_a_variable_within_it() -> None:
    rng = np.random.default_rng(5)
    for _ in range(2000):
        lower, width = 40.0 * rng.standard_normal(), 10.0 ** rng.uniform(-6.0, 2.0)
        found = truncated_moments(lower, lower + width)
        slack = 1e-9 * (1.0 + abs(lower))
        assert lower - slack <= found.mean <= lower + width + slack
        assert -1e-12 <= found.variance <= min(1.0, 0.25 * width**2) + 1e-9
        assert found.log_probability <= 1e-12
        mirrored = truncated_moments(-lower - width, -lower)
        assert mirrored.mean == pytest.approx(-found.mean, rel=1e-6, abs=1e-9)
        assert mirrored.log_probability == pytest.approx(found.log_probability, rel=1e-6, abs=1e-9)


def taken_in(prior: Array, jacobian: Array, found: Sites) -> tuple[Array, Array]:
    """Mean and covariance of a state after measurements that stand for readings, all at once."""
    total = jacobian @ prior @ jacobian.T + np.diag(found.variance)
    gain = prior @ jacobian.T @ np.linalg.inv(total)
    return gain @ found.innovation, prior - gain @ jacobian @ prior


RNG = np.random.default_rng(4)
JACOBIAN = RNG.standard_normal((3, 5))
PRIOR = np.cov(RNG.standard_normal((5, 40)))


def test_readings_of_independent_components_have_the_exact_moments_of_all() -> None:
    """A state of three, each read by itself: what is left is what each cell leaves."""
    sigmas, quanta, errors = np.array([1.0, 0.5, 2.0]), np.array([1.5, 1.0, 3.0]), np.array([0.2, -0.6, 1.0])
    floors = np.full(3, 1e-12)
    found = sites(errors, np.diag(sigmas**2), quanta, floors)
    mean, covariance = taken_in(np.diag(sigmas**2), np.eye(3), found)
    for j in range(3):
        low, high = (errors[j] + side * quanta[j] / 2.0 for side in (-1.0, 1.0))
        probability, shift, left = integrated(low / sigmas[j], high / sigmas[j])
        assert mean[j] == pytest.approx(sigmas[j] * shift, rel=1e-6)
        uniform = quanta[j] ** 2 / 12.0
        least = min(0.5, uniform / (sigmas[j] ** 2 + uniform))
        assert covariance[j, j] == pytest.approx(sigmas[j] ** 2 * max(left, least), rel=1e-6)
        assert found.log_likelihood[j] == pytest.approx(probability)
        assert (found.nis[j], found.degrees[j]) == (pytest.approx(shift**2), pytest.approx(1.0 - left))


def test_readings_one_after_the_other_are_measurements_all_at_once() -> None:
    """Of correlated predictions: each given those before, and the update of all by what stands for them."""
    errors, quanta, floors = np.array([0.4, -0.7, 0.1]), np.array([1.0, 0.5, 2.0]), np.full(3, 1e-4)
    found = sites(errors, JACOBIAN @ PRIOR @ JACOBIAN.T, quanta, floors)
    mean, covariance = np.zeros(5), PRIOR
    for j in range(3):
        row = JACOBIAN[j : j + 1]
        one = sites(errors[j : j + 1] - row @ mean, row @ covariance @ row.T, quanta[j : j + 1], floors[:1])
        assert one.log_likelihood[0] == pytest.approx(found.log_likelihood[j])
        shift, covariance = taken_in(covariance, row, one)
        mean = mean + shift
    together, left = taken_in(PRIOR, JACOBIAN, found)
    np.testing.assert_allclose(together, mean, rtol=1e-9)
    np.testing.assert_allclose(left, covariance, atol=1e-12)


@pytest.mark.parametrize("quantum", [0.2, 1.0, 3.0, 10.0])
def test_all_cells_together_are_certain_and_their_nis_is_as_expected(quantum: float) -> None:
    """Over all that one reading may be: probabilities sum to one, E[nis] = E[degrees]."""
    sigma, floor = 1.0, (FLOOR * quantum) ** 2
    marks = quantum * (np.arange(-200, 201) + 0.3)
    cells = [sites(np.array([mark]), np.array([[sigma**2]]), np.array([quantum]), np.array([floor])) for mark in marks]
    probability = np.exp([each.log_likelihood[0] for each in cells])
    assert probability.sum() == pytest.approx(1.0, abs=1e-9)
    nis, degrees = (probability @ [getattr(each, name)[0] for each in cells] for name in ("nis", "degrees"))
    assert nis == pytest.approx(degrees, rel=1e-6)
    assert 0.0 < degrees <= 1.0


@pytest.mark.parametrize(("quantum", "sigma", "error"), [(1.0, 0.1, 0.9), (1.0, 0.02, 1.0), (1.0, 1.0, 3.0)])
def test_one_reading_at_most_halves_a_variance(quantum: float, sigma: float, error: float) -> None:
    """However far off its cell lies; a cell that is narrower than a sigma leaves what uniform rounding would."""
    floor = (FLOOR * quantum) ** 2
    found = sites(np.array([error]), np.array([[sigma**2]]), np.array([quantum]), np.array([floor]))
    total, uniform = sigma**2 + floor, quantum**2 / 12.0
    exact = truncated_moments(*((error + side * quantum / 2.0) / math.sqrt(total) for side in (-1.0, 1.0))).variance
    least = min(0.5, uniform / (total + uniform))
    left = 1.0 - total / (sigma**2 + found.variance[0])
    assert left == pytest.approx(max(least, exact))
    assert exact < 0.5
    assert found.degrees[0] == pytest.approx(1.0 - exact)
