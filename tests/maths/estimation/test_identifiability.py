"""What a flight has told of each parameter, against updates done one by one."""

from __future__ import annotations

import numpy as np

from massprop_drake.maths.estimation.offline.identifiability import (
    Flag,
    classify_parameters,
    predict_best_firing,
    requested_deviation,
)

NOWHERE = np.zeros(10, dtype=bool)


def _spread(seed: int) -> np.ndarray:
    root = np.random.default_rng(seed).normal(size=(10, 10))
    return root @ root.T


def test_it_is_the_update_of_a_kalman_filter() -> None:
    covariance, random = _spread(1), np.random.default_rng(2)
    rows, noise = random.normal(size=(5, 6, 10)), np.diag(random.uniform(0.1, 2.0, 6))
    jet, found = predict_best_firing(covariance, rows, noise)
    left = []
    for h in rows:  # in information form, another way to the same
        after = np.linalg.inv(np.linalg.inv(covariance) + h.T @ np.linalg.inv(noise) @ h)
        left.append(np.sqrt(after.diagonal() / covariance.diagonal()))
    np.testing.assert_allclose(found, np.min(left, axis=0), rtol=1e-9)
    np.testing.assert_array_equal(jet, np.argmin(left, axis=0))


def test_a_product_is_asked_for_beside_its_diagonal() -> None:
    estimate = np.array([4.0, 9.0, -16.0, 0.0, 0.0, 0.0, 1.0, 2.0, 3.0, 0.5])
    limits = np.array([0.02, 0.3, 0.2])
    expected = [0.08, 0.18, 0.32, 0.02 * 12.0, 0.02 * 8.0, 0.02 * 6.0, 0.3, 0.3, 0.3, 0.1]
    np.testing.assert_allclose(requested_deviation(estimate, limits), expected)


def test_the_flight_must_tell_more_than_the_start() -> None:
    start, limit = np.ones(10), np.full(10, 0.1)
    deviation = np.array([0.05, 0.2, 0.7, 0.72, 1.0, 3.0, np.nan, 0.05, 0.05, 0.05])
    hidden = NOWHERE.copy()
    hidden[9] = True
    found = classify_parameters(start, deviation, limit, hidden)
    assert found[:7] == [
        Flag.IDENTIFIED, Flag.WEAK, Flag.WEAK, Flag.NOT_EXCITED, Flag.NOT_EXCITED, Flag.NOT_EXCITED,
        Flag.NOT_OBSERVABLE,
    ]  # fmt: skip
    assert found[7:] == [Flag.IDENTIFIED, Flag.IDENTIFIED, Flag.NOT_OBSERVABLE]
