"""The rotation estimator as a system: ports, and one sample by hand; its mathematics have their own."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from params_probe import rotation_params
from systems_probe import advance, feedthrough, inputs, output, outputs

from massprop_drake.maths.linear_algebra import NotPositiveDefiniteError
from massprop_drake.systems import RotationEstimator
from massprop_drake.systems.estimation.rotation_estimator import KnownPackage
from massprop_drake.systems.layouts import ROTATION_REPORT, TURNING

# inverse inertia diag(0.5, 0.25, 0.2), center of mass (1, 0, 0), 1-sigma 0.1 each
ESTIMATE = np.array([0.5, 0.25, 0.2, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0])
VARIANCE = 0.01
# 2 about x, no force: h = (0.5 x 2, 0, 0), H = A_6((2, 0, 0)), curvature 0
TWIST = [2.0, *[0.0] * 5, 1.0, 1.0]
READ = [1.2, -0.1, 0.05]


def made(*gyros: str, **given: Any) -> tuple[Any, Any]:
    """With variances of 1e-3 of increments."""
    params = rotation_params(gyro_variances=np.full(len(gyros), 5e-4), **given)
    dut = RotationEstimator(
        estimate=ESTIMATE, covariance=VARIANCE * np.eye(9), params=params,
        gyros=tuple(KnownPackage(name, np.inf) for name in gyros),
    )  # fmt: skip
    return dut, dut.CreateDefaultContext()


def reported(dut: Any, context: Any, gyro: Any, impulses: Any = TWIST) -> Any:
    return ROTATION_REPORT.read(output(dut, context, "report", gyro=gyro, impulses=impulses))


def test_topology() -> None:
    dut, context = made("gyro", "spare")
    assert inputs(dut) == {"gyro": 3, "spare": 3, "impulses": 8, "known_force": 24, "adaptation": 26}
    measured = {"turning": 136, "innovation": 3, "innovation_covariance": 9}
    assert outputs(dut) == {"predicted_estimate": 9, **measured, "estimate": 9, "covariance": 81, "report": 28}
    # the mass filter uses the prediction, which must not wait for the measurement; the detector makes the adaptation
    # from the innovation, which must not wait for it
    depends = feedthrough(dut)
    assert depends.pop("predicted_estimate") == set()
    assert depends == {name: set(inputs(dut)) - ({"adaptation"} if name in measured else set()) for name in depends}
    assert context.get_discrete_state(0).size() == 9 + 81 + 1 + 2 * 3


def test_one_sample_by_hand() -> None:
    dut, context = made("gyro", "spare")  # only the one in use need be connected
    first = reported(dut, context, np.zeros(3))
    assert_array_equal([*first.rotation_innovation, first.rotation_nis, first.rotation_used], [np.nan] * 4 + [False])
    advance(dut, context)
    report, turning = reported(dut, context, READ), TURNING.sized(jets=0).read(output(dut, context, "turning"))
    # increment and mean of the two readings, and the variance of the increment's error
    found = [*turning.increment, *turning.rate, turning.rate_variance]
    assert_allclose(found, [*READ, 0.6, -0.05, 0.025, 0.001], rtol=1e-15)
    # e = dw - (0.5 x 2, 0, 0); Y = (4 x 0.01 + 0.001) 1
    for innovation in (output(dut, context, "innovation"), turning.innovation, report.rotation_innovation):
        assert_allclose(innovation, [0.2, -0.1, 0.05], rtol=1e-14)
    for spread in (output(dut, context, "innovation_covariance"), turning.innovation_covariance.ravel()):
        assert_allclose(spread, 0.041 * np.eye(3).ravel(), rtol=1e-14)
    assert_allclose(report.rotation_nis, (0.04 + 0.01 + 0.0025) / 0.041, rtol=1e-13)
    # gain 2 x 0.01 / 0.041 on Ixx^-1, Ixy^-1 and Ixz^-1, in that order of the innovation
    estimate = ESTIMATE + 0.02 / 0.041 * np.array([0.2, 0.0, 0.0, 0.0, 0.05, -0.1, 0.0, 0.0, 0.0])
    variance = VARIANCE * np.where(np.isin(np.arange(9), (0, 4, 5)), 0.001 / 0.041, 1.0)
    assert_allclose(report.estimate, estimate, rtol=1e-13)
    assert_allclose(report.standard_deviation, np.sqrt(variance), rtol=1e-12)
    assert_array_equal(output(dut, context, "estimate"), report.estimate)
    assert_allclose(output(dut, context, "covariance"), np.diag(variance).ravel(), rtol=1e-12, atol=1e-18)
    assert_array_equal(output(dut, context, "predicted_estimate"), ESTIMATE)  # not before the update
    advance(dut, context)
    assert_array_equal(output(dut, context, "predicted_estimate"), report.estimate)
    assert not reported(dut, context, [np.nan] * 3).rotation_used
    assert not reported(dut, context, READ, [*TWIST[:6], 0.0, 1.0]).rotation_used  # of a sample that is not usable


def test_a_lost_definiteness_names_the_system_and_the_time() -> None:
    dut, context = made("gyro", disturbance_covariance=-1.0 * np.eye(3))
    reported(dut, context, np.zeros(3))
    advance(dut, context)
    with pytest.raises(NotPositiveDefiniteError, match=r"rotation_estimator: .*innovation covariance.*at t = 0\.08 s"):
        reported(dut, context, READ)
