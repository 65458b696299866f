"""The nearest inertia that a body can have: against another solver, Drake's check, and points that are possible."""

from __future__ import annotations

import numpy as np
import pytest
from pydrake.multibody.tree import RotationalInertia
from scipy.optimize import minimize

from massprop_drake.maths.linear_algebra import Array
from massprop_drake.maths.mass_properties import (
    derive_mass_and_inertia,
    is_possible_inertia,
    six_elements,
    symmetric_matrix,
)
from massprop_drake.maths.possible_inertia import nearest_possible


def impossible(seed: int, size: float) -> tuple[Array, Array]:
    """An estimate beyond the triangle inequality, and a covariance with correlations."""
    rng = np.random.default_rng(seed)
    turned, _ = np.linalg.qr(rng.standard_normal((3, 3)))
    moments = size * np.array([1.0, 2.0, 3.0 + rng.uniform(0.2, 0.6)])
    inverse = turned @ np.diag(1.0 / moments) @ turned.T
    estimate = np.concatenate([six_elements(0.5 * (inverse + inverse.T)), [1.0, 2.0, 3.0, 0.1]])
    scale = np.append(np.full(6, 0.1 / size), [0.2, 0.2, 0.2, 0.01])
    half = scale[:, None] * rng.standard_normal((10, 14))
    return estimate, half @ half.T


def distance(six: Array, estimate: Array, covariance: Array) -> float:
    error = six - estimate[:6]
    return float(error @ np.linalg.solve(covariance[:6, :6], error))


def inverse_of(half: Array, size: float) -> Array:
    """Inverse inertia of the second moments L L^T: possible whatever L is."""
    lower = np.zeros((3, 3))
    lower[np.tril_indices(3)] = half
    second = size * lower @ lower.T
    return six_elements(np.linalg.inv(np.trace(second) * np.eye(3) - second))


@pytest.mark.parametrize(("seed", "size"), [(0, 0.01), (1, 1e6), (2, 1.0)])
def test_it_is_possible_and_no_possible_one_is_nearer(seed: int, size: float) -> None:
    estimate, covariance = impossible(seed, size)
    found = nearest_possible(estimate, covariance)
    assert found is not None
    inertia = np.linalg.inv(symmetric_matrix(found[:6]))
    assert is_possible_inertia(inertia, tolerance=0.0)
    moments, products = np.diag(inertia) / size, inertia[[0, 0, 1], [1, 2, 2]] / size
    assert RotationalInertia(*moments, *products).CouldBePhysicallyValid()
    reached = distance(found[:6], estimate, covariance)
    rng = np.random.default_rng(seed)
    # another solver, in variables in which every point is possible
    start = np.eye(3)[np.tril_indices(3)] + 0.3 * rng.standard_normal(6)
    other = minimize(lambda half: distance(inverse_of(half, size), estimate, covariance), start, tol=1e-12)
    assert 0.0 < reached <= other.fun + 1e-6  # squared sigmas
    assert reached == pytest.approx(other.fun, rel=1e-3)


def test_what_is_possible_stays_and_what_is_hopeless_is_not_offered() -> None:
    possible = np.array([1.0, 0.5, 0.4, 0, 0, 0, 1, 2, 3, np.nan])
    covariance = np.eye(10)
    np.testing.assert_array_equal(nearest_possible(possible, covariance), possible)
    assert nearest_possible(np.array([1.0, 0.5, -0.4, 0, 0, 0, 1, 2, 3, 0.1]), covariance) is None
    assert nearest_possible(np.zeros(10), covariance) is None
    with pytest.raises(ValueError, match="must be finite"):
        nearest_possible(np.full(10, np.nan), covariance)


def test_a_mass_that_is_not_observed_stays_so() -> None:
    estimate, covariance = impossible(0, 1.0)
    estimate[9], covariance[9], covariance[:, 9] = np.nan, np.nan, np.nan
    found = nearest_possible(estimate, covariance)
    assert found is not None
    assert np.isnan(found[9])
    assert np.isfinite(found[:9]).all()
    assert derive_mass_and_inertia(found, covariance).physically_possible
