"""What a flight has told of each parameter, against updates done one by one."""

from __future__ import annotations

import numpy as np
import pytest

from massprop_drake.maths.estimation.identifiability import Flag, asked, flags, foretold

NOWHERE = np.zeros(10, dtype=bool)


def _spread(seed: int) -> np.ndarray:
    root = np.random.default_rng(seed).normal(size=(10, 10))
    return root @ root.T


def test_one_parameter_is_told_by_the_jet_that_moves_it_most() -> None:
    covariance = np.diag([4.0, *np.ones(9)])
    rows = np.zeros((3, 1, 10))
    rows[:, 0, 0] = 0.5, -3.0, 1.0
    found = foretold(covariance, rows, np.eye(1))
    assert found.jet[0] == 1  # whichever way it pushes
    assert found.left[0] == pytest.approx(np.sqrt(1.0 / (9.0 * 4.0 + 1.0)))
    np.testing.assert_allclose(found.left[1:], 1.0)


def test_it_is_the_update_of_a_kalman_filter() -> None:
    covariance, random = _spread(1), np.random.default_rng(2)
    rows, noise = random.normal(size=(5, 6, 10)), np.diag(random.uniform(0.1, 2.0, 6))
    found = foretold(covariance, rows, noise)
    left = []
    for h in rows:  # in information form, another way to the same
        after = np.linalg.inv(np.linalg.inv(covariance) + h.T @ np.linalg.inv(noise) @ h)
        left.append(np.sqrt(after.diagonal() / covariance.diagonal()))
    np.testing.assert_allclose(found.left, np.min(left, axis=0), rtol=1e-9)
    np.testing.assert_array_equal(found.jet, np.argmin(left, axis=0))


def test_what_is_not_observed_is_left_out() -> None:
    covariance = _spread(3)
    covariance[9], covariance[:, 9] = np.nan, np.nan
    rows = np.random.default_rng(4).normal(size=(2, 3, 10))
    found = foretold(covariance, rows, np.eye(3))
    assert np.isnan(found.left[9])
    np.testing.assert_allclose(found.left[:9], foretold(_spread(3), rows * ([1.0] * 9 + [0.0]), np.eye(3)).left[:9])


def test_a_product_is_asked_for_beside_its_diagonal() -> None:
    estimate = np.array([4.0, 9.0, -16.0, 0.0, 0.0, 0.0, 1.0, 2.0, 3.0, 0.5])
    limits = np.array([0.02, 0.3, 0.2])
    expected = [0.08, 0.18, 0.32, 0.02 * 12.0, 0.02 * 8.0, 0.02 * 6.0, 0.3, 0.3, 0.3, 0.1]
    np.testing.assert_allclose(asked(estimate, limits), expected)


def test_the_flight_must_tell_more_than_the_start() -> None:
    start, limit = np.ones(10), np.full(10, 0.1)
    deviation = np.array([0.05, 0.2, 0.7, 0.72, 1.0, 3.0, np.nan, 0.05, 0.05, 0.05])
    hidden = NOWHERE.copy()
    hidden[9] = True
    found = flags(start, deviation, limit, hidden)
    assert found[:7] == [
        Flag.IDENTIFIED, Flag.WEAK, Flag.WEAK, Flag.NOT_EXCITED, Flag.NOT_EXCITED, Flag.NOT_EXCITED,
        Flag.NOT_OBSERVABLE,
    ]  # fmt: skip
    assert found[7:] == [Flag.IDENTIFIED, Flag.IDENTIFIED, Flag.NOT_OBSERVABLE]
