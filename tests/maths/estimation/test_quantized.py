"""Moments of truncated Gaussians, and quantized readings as measurements."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import quad

from massprop_drake.maths.estimation.joint.quantized import FLOOR, Sites, match_moments, truncated_moments
from massprop_drake.maths.linear_algebra import Array


def integrated(lower: float, upper: float) -> tuple[float, float, float]:
    """Log probability, mean and variance by numerical integration, relative to the density's peak in the interval."""
    peak = min(max(lower, 0.0), upper)
    lower, upper = max(lower, peak - 40.0), min(upper, peak + 40.0)

    def moment(power: int, about: float = 0.0) -> float:
        def density(x: float) -> float:
            return float((x - about) ** power * np.exp(-0.5 * (x - peak) * (x + peak)))

        return float(quad(density, lower, upper, epsabs=1e-14 * (upper - lower), epsrel=1e-12, limit=200)[0])

    mass = moment(0)
    mean = moment(1) / mass
    return float(np.log(mass) - 0.5 * peak**2 - 0.5 * np.log(2.0 * np.pi)), mean, moment(2, mean) / mass


@pytest.mark.parametrize(
    ("lower", "upper"),
    [
        (-3.0, 7.0),
        (-0.45, 0.499999),  # about the borders between two forms
        (-0.45, 0.5),
        (0.999999, 2.1),
        (1.000001, 2.1),
        (0.9, 1.900001),
        (-4e-4, 5e-4),
        (5.0, 5.5),
        (10.0, 10.0009),
        (26.0, 29.0),
        (-40.0, -39.0),
        (300.0, 300.0005),
        (1e3, 1e3 + 1.0),
    ],
)
def test_moments_are_those_of_the_density(lower: float, upper: float) -> None:
    """To rounding, the variance of a narrow cell and of a far tail included; mirrored they are mirrored."""
    found, (log_probability, mean, variance) = truncated_moments(lower, upper), integrated(lower, upper)
    assert found.log_probability == pytest.approx(log_probability, rel=1e-11, abs=1e-11)
    assert found.mean == pytest.approx(mean, rel=1e-11, abs=1e-11 * (upper - lower))
    assert found.variance == pytest.approx(variance, rel=1e-10)
    assert truncated_moments(-upper, -lower) == pytest.approx((found.log_probability, -found.mean, found.variance))


def taken_in(prior: Array, jacobian: Array, found: Sites) -> tuple[Array, Array]:
    """Mean and covariance of a state after measurements that stand for readings, all at once."""
    total = jacobian @ prior @ jacobian.T + np.diag(found.variance)
    gain = prior @ jacobian.T @ np.linalg.inv(total)
    return gain @ found.innovation, prior - gain @ jacobian @ prior


RNG = np.random.default_rng(4)
JACOBIAN, ROOT = RNG.standard_normal((3, 5)), RNG.standard_normal((5, 9))
PRIOR = ROOT @ ROOT.T / 9.0


@pytest.mark.parametrize("quantum", [0.0, 0.7])
def test_readings_one_after_the_other_are_measurements_all_at_once(quantum: float) -> None:
    """Those that are not quantized with their own noise, and its likelihood."""
    errors, quanta, floors = np.array([0.4, -0.9, 1.3]), np.full(3, quantum), np.array([0.1, 0.2, 0.3])
    projected = JACOBIAN @ PRIOR @ JACOBIAN.T
    found = match_moments(errors, projected, quanta, floors)
    mean, covariance = np.zeros(5), PRIOR
    for j in range(3):
        row = JACOBIAN[j : j + 1]
        one = match_moments(
            errors[j : j + 1] - row @ mean, row @ covariance @ row.T, quanta[j : j + 1], floors[j : j + 1]
        )
        assert one.log_likelihood[0] == pytest.approx(found.log_likelihood[j])
        shift, covariance = taken_in(covariance, row, one)
        mean = mean + shift
    together, left = taken_in(PRIOR, JACOBIAN, found)
    np.testing.assert_allclose(together, mean, rtol=1e-9)
    np.testing.assert_allclose(left, covariance, atol=1e-12)
    if quantum == 0.0:
        total = projected + np.diag(floors)
        nis = errors @ np.linalg.solve(total, errors)
        np.testing.assert_allclose([found.innovation, found.variance], [errors, floors])
        assert found.log_likelihood.sum() == pytest.approx(-0.5 * (nis + np.linalg.slogdet(2.0 * np.pi * total)[1]))
        assert found.nis.sum() == pytest.approx(nis)
        np.testing.assert_allclose(found.degrees, 1.0)


@pytest.mark.parametrize("quantum", [0.2, 1.0, 10.0])
def test_all_cells_together_are_certain_and_their_nis_is_as_expected(quantum: float) -> None:
    """Over all that one reading may be: probabilities sum to one, E[nis] = E[degrees]."""
    floor, marks = np.array([(FLOOR * quantum) ** 2]), quantum * (np.arange(-50, 51) + 0.3)
    cells = [match_moments(np.array([mark]), np.eye(1), np.array([quantum]), floor) for mark in marks]
    probability = np.exp([each.log_likelihood[0] for each in cells])
    assert probability.sum() == pytest.approx(1.0, abs=1e-9)
    nis, degrees = (probability @ [getattr(each, name)[0] for each in cells] for name in ("nis", "degrees"))
    assert nis == pytest.approx(degrees, rel=1e-6)
    assert 0.0 < degrees <= 1.0


@pytest.mark.parametrize(("quantum", "sigma", "error"), [(1.0, 0.1, 0.9), (1.0, 0.02, 1.0), (1.0, 1.0, 3.0)])
def test_one_reading_at_most_halves_a_variance(quantum: float, sigma: float, error: float) -> None:
    """However far off its cell lies; a cell that is narrower than a sigma leaves what uniform rounding would."""
    floor = (FLOOR * quantum) ** 2
    found = match_moments(np.array([error]), np.array([[sigma**2]]), np.array([quantum]), np.array([floor]))
    total, uniform = sigma**2 + floor, quantum**2 / 12.0
    exact = truncated_moments(*((error + side * quantum / 2.0) / math.sqrt(total) for side in (-1.0, 1.0))).variance
    left = 1.0 - total / (sigma**2 + found.variance[0])
    assert left == pytest.approx(max(min(0.5, uniform / (total + uniform)), exact))
    assert exact < 0.5
    assert found.degrees[0] == pytest.approx(1.0 - exact)
