"""What it costs that jets give no less than nothing and no more than their thrusts."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from massprop_drake.maths.estimation.joint.possible import beyond


@pytest.mark.parametrize("jets", [1, 2])
def test_it_is_the_least_distance_to_what_is_possible(jets: int) -> None:
    random = np.random.default_rng(jets)
    force = random.normal(0.0, 8.0, (60, jets))
    half = random.normal(0.0, 2.0, (60, jets, jets))
    covariance = half @ half.transpose(0, 2, 1) + 0.01 * np.eye(jets)
    most = random.uniform(2.0, 10.0, (60, jets))
    found = beyond(force, covariance, most)
    for row in range(60):
        half = np.linalg.cholesky(np.linalg.inv(covariance[row])).T
        least = lsq_linear(half, half @ force[row], bounds=(np.zeros(jets), most[row]), method="bvls")
        assert found[row] == pytest.approx(least.cost, rel=1e-9, abs=1e-9)


def test_two_that_are_each_within_their_sigmas_may_be_impossible_together() -> None:
    """Their sum is known to a tenth: -8; their difference hardly."""
    direction = np.array([1.0, 1.0]) / np.sqrt(2.0)
    covariance = np.diag([3.0, 3.0]) ** 2
    covariance -= (9.0 - 0.005) * np.outer(direction, direction)
    force = np.array([[-3.0, -5.0]])
    assert (np.abs(force[0]) < 3.0 * np.sqrt(np.diag(covariance))).all()
    assert beyond(force, covariance[None], np.array([[800.0, 800.0]]))[0] > 1000.0
    assert beyond(np.array([[9.0, -1.0]]), covariance[None], np.array([[800.0, 800.0]]))[0] < 1.0


def test_what_is_possible_costs_nothing() -> None:
    force = np.array([[0.0, 10.0], [10.0, 3.0]])
    assert beyond(force, np.tile(np.eye(2), (2, 1, 1)), np.full((2, 2), 10.0)).tolist() == [0.0, 0.0]
