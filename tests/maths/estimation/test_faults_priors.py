"""Priors of faults: what a force is worth against quadrature, rates, and what a jet can give."""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import pairwise

import pytest
from scipy.integrate import quad
from scipy.stats import norm

from massprop_drake.maths.estimation.faults.priors import Priors, force_correction, log_possible, log_rate

THRUST = 40.0
PRIORS = Priors(full_thrust=0.4)
FORCES = [(1.0, 0.01), (0.95, 0.03), (0.5, 0.02), (0.1, 0.01), (0.02, 0.003), (0.8, 0.1)]  # and 1 sigma, of full thrust


def mean_of(ratio: Callable[[float], float], force: float, sigma: float, *edges: float) -> float:
    """Mean over N(force, sigma^2) by adaptive quadrature, split where the density has an edge or a peak."""
    low, high = force - 9.0 * sigma, force + 9.0 * sigma
    marks = sorted({low, high, *(edge for edge in edges if low < edge < high)})
    total = 0.0
    for a, b in pairwise(marks):
        total += quad(lambda x: ratio(x) * norm.pdf(x, force, sigma), a, b, epsabs=0.0, epsrel=1e-9, limit=400)[0]
    return total


@pytest.mark.parametrize(("share", "width"), FORCES)
@pytest.mark.parametrize("missing", [False, True])
def test_a_new_force_is_worth_its_prior_over_the_one_it_was_opened_with(
    share: float, width: float, missing: bool
) -> None:
    """Half full thrust within 3 %; of the rest a leak log-uniform from a thousandth on, a loss uniform."""

    def ratio(x: float) -> float:
        rest = 0.0
        if 1e-3 < x < 1.05:
            rest = 1.0 / 1.049 if missing else 1.0 / (x * math.log(1050.0))
        density = 0.4 * norm.pdf(x, 1.0, 0.03) + 0.6 * rest
        return float(density / norm.pdf(x))

    expected = mean_of(ratio, share, width, 1e-3, 1.0, 1.05)
    found = force_correction(share * THRUST, width * THRUST, THRUST, PRIORS, missing=missing)
    assert found == pytest.approx(math.log(expected), abs=0.06)  # the nodes see an edge within their spacing


@pytest.mark.parametrize(("share", "width"), [*FORCES, (0.0, 0.01)])
def test_a_changed_force_is_gone_or_full_or_anything(share: float, width: float) -> None:
    """A third each; opened about the force that it was."""
    about = 0.6

    def ratio(x: float) -> float:
        density = norm.pdf(x, 0.0, 0.03) + norm.pdf(x, 1.0, 0.03) + (1.0 / 1.05 if 0.0 < x < 1.05 else 0.0)
        return float(density / 3.0 / norm.pdf(x, about))

    expected = mean_of(ratio, share, width, 0.0, 1.0, 1.05)
    found = force_correction(share * THRUST, width * THRUST, THRUST, PRIORS, missing=False, about=about * THRUST)
    assert found == pytest.approx(math.log(expected), abs=0.06)


def test_rates_are_probabilities_by_the_hour() -> None:
    assert log_rate(2.0, 3600.0) == pytest.approx(math.log(2.0))
    assert log_rate(1e-3, 0.08) - log_rate(1e-3, 0.16) == pytest.approx(-math.log(2.0))


def test_the_doubt_of_a_declaration_is_what_a_user_accepts_over_what_fails() -> None:
    assert Priors(false_per_hour=1e-6).doubt(1e-3) == pytest.approx(1e-3)
    assert Priors(false_per_hour=1.0).doubt(1e-6) == 0.5


@pytest.mark.parametrize(
    ("force", "sigma"), [(20.0, 1.0), (0.5, 1.0), (-3.0, 1.0), (41.0, 2.0), (44.0, 0.5), (-29.99, 1.0), (-1e5, 1.0)]
)
def test_a_force_is_possible_between_nothing_and_a_little_more_than_full_thrust(force: float, sigma: float) -> None:
    """However far off: of a filter that has gone astray, beyond what a float's exponential has."""
    expected = norm.logcdf(force / sigma) + norm.logcdf((1.05 * THRUST - force) / sigma)
    assert log_possible(force, sigma, THRUST) == pytest.approx(expected, rel=1e-6, abs=1e-9)
    if force < -20.0:
        assert force_correction(force, 1e-3 * THRUST, THRUST, PRIORS, missing=False) < -100.0
