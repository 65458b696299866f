"""The convergence monitor: ten estimates side by side, and whether to act on them."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from systems_probe import feedthrough, give, inputs, output, outputs

from massprop_drake.maths.mass_properties import is_converged
from massprop_drake.systems import ConvergenceMonitor

# diagonal within 2 %, center of mass within 0.5 ft, 1/m within 20 %
LIMITS = np.array([0.02, 0.5, 0.2])
ESTIMATE = np.array([1.0, 2.0, 4.0, 0.1, 0.2, 0.3, 30.0, 0.0, 2.0, 0.5])
DEVIATION = np.array([0.01, 0.03, 0.07, 9.0, 9.0, 9.0, 0.4, 0.3, 0.2, 0.09])  # products do not matter


@pytest.mark.parametrize("element", [None, 0, 6, 9])
@pytest.mark.parametrize("weighs", [True, False])
def test_the_ten_estimates_their_covariance_and_whether_they_have_converged(
    element: int | None, *, weighs: bool
) -> None:
    dut, deviation = ConvergenceMonitor(LIMITS), DEVIATION.copy()
    if element is not None:
        deviation[element] *= 3.0
    assert inputs(dut) == {"rotation_estimate": 9, "rotation_covariance": 81, "mass_estimate": 2}
    assert outputs(dut) == {"estimate": 10, "standard_deviation": 10, "covariance": 100, "converged": 1}
    assert feedthrough(dut) == {name: set(inputs(dut)) for name in outputs(dut)}
    context = dut.CreateDefaultContext()
    assert context.is_stateless()
    rotation = np.diag(deviation[:9] ** 2) + 1e-3 * (1.0 - np.eye(9))
    give(dut, context, rotation_estimate=ESTIMATE[:9], rotation_covariance=rotation.ravel())
    known = np.nan
    if weighs:
        give(dut, context, mass_estimate=[ESTIMATE[9], deviation[9] ** 2])
        known = 1.0
    ones = np.append(np.ones(9), known)  # without a mass estimate there is no tenth
    assert_array_equal(output(dut, context, "estimate"), ESTIMATE * ones)
    assert_allclose(output(dut, context, "standard_deviation"), deviation * ones, rtol=1e-15)
    whole = np.zeros((10, 10))  # shares nothing between the mass and the others
    whole[:9, :9], whole[9, 9] = rotation, known * deviation[9] ** 2
    assert_array_equal(output(dut, context, "covariance"), whole.ravel())
    assert output(dut, context, "converged") == (weighs and element is None)
    assert bool(is_converged(deviation * ones, ESTIMATE * ones, LIMITS)) == (weighs and element is None)
