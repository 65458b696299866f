"""Cost of forces below zero or above the jets' thrusts."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from massprop_drake.maths.estimation.joint.possible import impossible_force_cost


@pytest.mark.parametrize("jets", [1, 2])
def test_it_is_the_least_distance_to_what_is_possible(jets: int) -> None:
    random = np.random.default_rng(jets)
    force = random.normal(0.0, 8.0, (60, jets))
    half = random.normal(0.0, 2.0, (60, jets, jets))
    covariance = half @ half.transpose(0, 2, 1) + 0.01 * np.eye(jets)
    most = random.uniform(2.0, 10.0, (60, jets))
    found = impossible_force_cost(force, covariance, most)
    for row in range(60):
        half = np.linalg.cholesky(np.linalg.inv(covariance[row])).T
        least = lsq_linear(half, half @ force[row], bounds=(np.zeros(jets), most[row]), method="bvls")
        assert found[row] == pytest.approx(least.cost, rel=1e-9, abs=1e-9)
    assert impossible_force_cost(np.array([[0.0, 10.0][:jets]]), np.eye(jets)[None], np.full((1, jets), 10.0))[0] == 0.0
