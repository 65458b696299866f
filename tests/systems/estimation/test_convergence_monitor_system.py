"""The convergence monitor: ten estimates side by side, and whether to act on them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from systems_probe import feedthrough, inputs, outputs

from massprop_drake.systems.estimation.convergence_monitor import ConvergenceMonitor

# diagonal within 2 %, center of mass within 0.5 ft, 1/m within 20 %
LIMITS = np.array([0.02, 0.5, 0.2])
ESTIMATE = np.array([1.0, 2.0, 4.0, 0.1, 0.2, 0.3, 30.0, 0.0, 2.0])
DEVIATION = np.array([0.01, 0.03, 0.07, 9.0, 9.0, 9.0, 0.4, 0.3, 0.2])  # products do not matter
RECIPROCAL, RECIPROCAL_STD = 0.5, 0.09


def _dut(
    deviation: np.ndarray = DEVIATION, mass: tuple[float, float] | None = (RECIPROCAL, RECIPROCAL_STD)
) -> tuple[ConvergenceMonitor, Any]:
    dut = ConvergenceMonitor(LIMITS)
    context = dut.CreateDefaultContext()
    dut.GetInputPort("rotation_estimate").FixValue(context, ESTIMATE)
    covariance = np.diag(deviation**2) + 1e-3 * (1.0 - np.eye(9))  # only the diagonal is read
    dut.GetInputPort("rotation_covariance").FixValue(context, covariance.ravel())
    if mass is not None:
        dut.GetInputPort("mass_estimate").FixValue(context, [mass[0], mass[1] ** 2])
    return dut, context


def _converged(dut: ConvergenceMonitor, context: Any) -> float:
    return float(dut.GetOutputPort("converged").Eval(context)[0])


def test_topology() -> None:
    dut, context = _dut()
    assert inputs(dut) == {"rotation_estimate": 9, "rotation_covariance": 81, "mass_estimate": 2}
    assert outputs(dut) == {"estimate": 10, "standard_deviation": 10, "covariance": 100, "converged": 1}
    assert feedthrough(dut) == {name: set(inputs(dut)) for name in outputs(dut)}
    assert context.num_discrete_state_groups() == 0


def test_the_ten_estimates_and_their_deviations() -> None:
    dut, context = _dut()
    np.testing.assert_array_equal(dut.GetOutputPort("estimate").Eval(context), [*ESTIMATE, RECIPROCAL])
    np.testing.assert_allclose(
        dut.GetOutputPort("standard_deviation").Eval(context), [*DEVIATION, RECIPROCAL_STD], rtol=1e-15
    )


def test_the_covariance_shares_nothing_between_the_mass_and_the_others() -> None:
    dut, context = _dut()
    covariance = dut.GetOutputPort("covariance").Eval(context).reshape(10, 10)
    rotation = np.diag(DEVIATION**2) + 1e-3 * (1.0 - np.eye(9))
    np.testing.assert_array_equal(covariance[:9, :9], rotation)
    assert covariance[9, 9] == RECIPROCAL_STD**2
    assert not covariance[9, :9].any()
    assert not covariance[:9, 9].any()


def test_estimates_within_every_limit_have_converged() -> None:
    assert _converged(*_dut()) == 1.0


@pytest.mark.parametrize(("element", "limit"), [(0, 0.02), (1, 0.04), (2, 0.08), (6, 0.5), (7, 0.5), (8, 0.5)])
def test_one_deviation_beyond_its_limit_is_enough_to_wait(element: int, limit: float) -> None:
    deviation = DEVIATION.copy()
    deviation[element] = 1.01 * limit
    assert _converged(*_dut(deviation)) == 0.0
    deviation[element] = 0.99 * limit
    assert _converged(*_dut(deviation)) == 1.0


@pytest.mark.parametrize(("deviation", "converged"), [(0.099, 1.0), (0.101, 0.0)])
def test_the_mass_must_have_converged_too(deviation: float, converged: float) -> None:
    assert _converged(*_dut(mass=(RECIPROCAL, deviation))) == converged


def test_a_negative_estimate_has_not_converged() -> None:
    dut, context = _dut()
    dut.GetInputPort("mass_estimate").FixValue(context, [-RECIPROCAL, RECIPROCAL_STD**2])
    assert _converged(dut, context) == 0.0


def test_without_a_mass_estimate_nothing_converges() -> None:
    dut, context = _dut(mass=None)
    estimate = dut.GetOutputPort("estimate").Eval(context)
    np.testing.assert_array_equal(estimate[:9], ESTIMATE)
    assert np.isnan(estimate[9])
    assert np.isnan(dut.GetOutputPort("standard_deviation").Eval(context)[9])
    covariance = dut.GetOutputPort("covariance").Eval(context).reshape(10, 10)
    np.testing.assert_array_equal(np.argwhere(np.isnan(covariance)), [[9, 9]])
    assert _converged(dut, context) == 0.0
