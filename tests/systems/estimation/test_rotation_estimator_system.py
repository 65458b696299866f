"""The rotation estimator as a system: ports, timing and missing readings."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from params_probe import rotation_params
from systems_probe import PERIOD_S, advance, feedthrough, inputs, outputs

from massprop_drake.maths.estimation.filter import RotationReport
from massprop_drake.maths.estimation.filters.rotation_filter import RotationCoupling
from massprop_drake.maths.estimation.filters.thesis import ROTATION_STATE, Turning
from massprop_drake.maths.estimation.redundancy import Rule
from massprop_drake.maths.linear_algebra import NotPositiveDefiniteError
from massprop_drake.systems.estimation._readings import KnownPackage
from massprop_drake.systems.estimation.rotation_estimator import RotationEstimator
from massprop_drake.systems.layouts import ROTATION_REPORT, TURNING

# inverse inertia diag(0.5, 0.25, 0.2), center of mass (1, 0, 0), 1-sigma 0.1 each
ESTIMATE = np.array([0.5, 0.25, 0.2, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0])
VARIANCE = 0.01
READING_VARIANCE = 5e-4  # so that of an increment is 1e-3
# 2 about x, no force: h = (0.5 x 2, 0, 0), H = A_6((2, 0, 0)), curvature 0
TWIST = [2.0, 0.0, 0.0, 0.0, 0.0, 0.0]
COAST = [0.0] * 6 + [1.0, 0.0]


def _dut(
    gyros: tuple[str, ...] = ("gyro",),
    limit: float = np.inf,
    thrust_errors: np.ndarray | None = None,
    **params: Any,
) -> tuple[RotationEstimator, Any]:
    dut = RotationEstimator(
        estimate=ESTIMATE,
        covariance=VARIANCE * np.eye(9),
        gyros=tuple(KnownPackage(name, limit) for name in gyros),
        thrust_errors=thrust_errors,
        params=rotation_params(gyro_variances=np.full(len(gyros), READING_VARIANCE), **params),
    )
    context = dut.CreateDefaultContext()
    dut.GetInputPort("impulses").FixValue(context, COAST)
    return dut, context


def _report(dut: RotationEstimator, context: Any) -> RotationReport:
    return RotationReport._make(ROTATION_REPORT.read(dut.GetOutputPort("report").Eval(context)))


def _turning(dut: RotationEstimator, context: Any, jets: int = 0) -> Turning:
    return Turning._make(TURNING.sized(jets=jets).read(dut.GetOutputPort("turning").Eval(context)))


def _sample(
    dut: RotationEstimator, context: Any, gyro: list[float], impulses: list[float] | None = None
) -> RotationReport:
    """The report of a sample; the sample is then over."""
    dut.GetInputPort("gyro").FixValue(context, gyro)
    dut.GetInputPort("impulses").FixValue(context, impulses or COAST)
    report = _report(dut, context)
    advance(dut, context)
    return report


def _out(dut: RotationEstimator, context: Any, name: str) -> np.ndarray:
    return dut.GetOutputPort(name).Eval(context)


def _sensitivity(context: Any) -> np.ndarray:
    """What one sigma of each of two jets' thrust errors has done to the estimate, shape (9, 2)."""
    return ROTATION_STATE.sized(gyros=1, errors=2).read(context.get_discrete_state(0).CopyToVector()).sensitivity


def test_topology() -> None:
    dut, context = _dut(("gyro", "spare"))
    assert inputs(dut) == {"gyro": 3, "spare": 3, "impulses": 8, "known_force": 24, "adaptation": 26}
    assert outputs(dut) == {
        "predicted_estimate": 9,
        "turning": 136,
        "innovation": 3,
        "innovation_covariance": 9,
        "estimate": 9,
        "covariance": 81,
        "report": 28,
    }
    # the mass filter uses the prediction, which must not wait for the measurement
    # and the detector makes the adaptation from the innovation, which must not wait for it
    measured = {"gyro", "spare", "impulses", "known_force"}  # where one gyro is missing, the other is used
    expected = dict.fromkeys(outputs(dut), measured | {"adaptation"})
    expected |= dict.fromkeys(("turning", "innovation", "innovation_covariance"), measured)
    expected |= {"predicted_estimate": set()}
    assert feedthrough(dut) == expected
    assert context.get_discrete_state().num_groups() == 1
    assert context.get_discrete_state(0).size() == 9 + 81 + 1 + 2 * 3


def test_it_starts_from_what_it_is_given() -> None:
    dut, context = _dut()
    dut.GetInputPort("gyro").FixValue(context, [0.1, 0.2, 0.3])
    np.testing.assert_array_equal(_out(dut, context, "predicted_estimate"), ESTIMATE)
    turning = _turning(dut, context)
    np.testing.assert_array_equal(turning.estimate, ESTIMATE)
    np.testing.assert_array_equal(turning.covariance, VARIANCE * np.eye(9))


def test_the_first_reading_measures_nothing() -> None:
    dut, context = _dut()
    report = _sample(dut, context, [0.1, 0.2, 0.3], [*TWIST, 1.0, 1.0])
    np.testing.assert_array_equal([*report.rotation_innovation, report.rotation_nis], [np.nan] * 4)
    assert (report.rotation_used, report.rotation_jump, report.coupling_subtracted) == (False, False, False)
    np.testing.assert_array_equal(report.estimate, ESTIMATE)
    np.testing.assert_array_equal(_out(dut, context, "predicted_estimate"), ESTIMATE)


def test_one_sample_by_hand() -> None:
    dut, context = _dut()
    _sample(dut, context, [0.0, 0.0, 0.0])
    dut.GetInputPort("gyro").FixValue(context, [1.2, -0.1, 0.05])
    dut.GetInputPort("impulses").FixValue(context, [*TWIST, 1.0, 1.0])
    # increment and mean of the two readings, and the variance of the increment's error
    turning = _turning(dut, context)
    found = [*turning.increment, *turning.rate, turning.rate_variance]
    np.testing.assert_allclose(found, [1.2, -0.1, 0.05, 0.6, -0.05, 0.025, 0.001], rtol=1e-15)
    # e = dw - (0.5 x 2, 0, 0); Y = (4 x 0.01 + 0.001) 1
    np.testing.assert_allclose(_out(dut, context, "innovation"), [0.2, -0.1, 0.05], rtol=1e-14)
    np.testing.assert_allclose(_out(dut, context, "innovation_covariance").reshape(3, 3), 0.041 * np.eye(3), rtol=1e-14)
    # the same facts where the mass filter, the detector and the log read them
    np.testing.assert_array_equal(turning.innovation, _out(dut, context, "innovation"))
    np.testing.assert_array_equal(turning.innovation_covariance.ravel(), _out(dut, context, "innovation_covariance"))
    report = _report(dut, context)
    np.testing.assert_array_equal(report.rotation_innovation, _out(dut, context, "innovation"))
    np.testing.assert_allclose(report.rotation_innovation_std, [0.041**0.5] * 3, rtol=1e-14)
    np.testing.assert_allclose(report.rotation_nis, (0.04 + 0.01 + 0.0025) / 0.041, rtol=1e-13)
    assert (report.rotation_used, report.rotation_jump, report.coupling_subtracted) == (True, False, False)
    # gain 2 x 0.01 / 0.041 on Ixx^-1, Ixy^-1 and Ixz^-1, in that order of the innovation
    gain = 0.02 / 0.041
    expected = ESTIMATE + gain * np.array([0.2, 0.0, 0.0, 0.0, 0.05, -0.1, 0.0, 0.0, 0.0])
    np.testing.assert_allclose(_out(dut, context, "estimate"), expected, rtol=1e-13)
    variance = np.full(9, VARIANCE)
    variance[[0, 4, 5]] *= 0.001 / 0.041
    np.testing.assert_allclose(
        _out(dut, context, "covariance").reshape(9, 9), np.diag(variance), rtol=1e-12, atol=1e-18
    )
    np.testing.assert_array_equal(report.estimate, _out(dut, context, "estimate"))
    np.testing.assert_allclose(report.standard_deviation, np.sqrt(variance), rtol=1e-12)


def test_the_update_makes_the_estimate_the_next_prediction() -> None:
    dut, context = _dut()
    _sample(dut, context, [0.0, 0.0, 0.0])
    dut.GetInputPort("gyro").FixValue(context, [1.2, -0.1, 0.05])
    dut.GetInputPort("impulses").FixValue(context, [*TWIST, 1.0, 1.0])
    estimate, covariance = _out(dut, context, "estimate"), _out(dut, context, "covariance")
    np.testing.assert_array_equal(_out(dut, context, "predicted_estimate"), ESTIMATE)  # not before the update
    advance(dut, context)
    np.testing.assert_array_equal(_out(dut, context, "predicted_estimate"), estimate)
    turning = _turning(dut, context)
    np.testing.assert_array_equal(turning.estimate, estimate)
    np.testing.assert_array_equal(turning.covariance.ravel(), covariance)
    assert not np.array_equal(estimate, ESTIMATE)


@pytest.mark.parametrize(("usable", "firing"), [(0.0, 1.0), (1.0, 0.0), (0.0, 0.0)])
def test_a_sample_that_is_unsteady_or_without_thrust_is_measured_and_not_used(usable: float, firing: float) -> None:
    dut, context = _dut()
    _sample(dut, context, [0.0, 0.0, 0.0])
    report = _sample(dut, context, [1.2, 0.0, 0.0], [*TWIST, usable, firing])
    assert np.isfinite([*report.rotation_innovation, report.rotation_nis]).all()
    assert not report.rotation_used
    np.testing.assert_array_equal(_out(dut, context, "predicted_estimate"), ESTIMATE)
    np.testing.assert_array_equal(_turning(dut, context).covariance, VARIANCE * np.eye(9))


def test_a_missing_reading_costs_two_samples_and_harms_nothing() -> None:
    dut, context = _dut()
    fire = [*TWIST, 1.0, 1.0]
    _sample(dut, context, [0.0, 0.0, 0.0])
    used, estimates = [], []
    for gyro in ([1.1, 0.0, 0.0], [np.nan] * 3, [3.3, 0.0, 0.0], [4.4, 0.0, 0.0]):
        report = _sample(dut, context, gyro, fire)
        used.append(report.rotation_used)
        assert np.isnan(report.rotation_nis) == (not report.rotation_used)
        estimates.append(_out(dut, context, "predicted_estimate"))
    # neither the increment to the missing reading nor the one from it is known
    assert used == [True, False, False, True]
    np.testing.assert_array_equal(estimates[1], estimates[0])
    np.testing.assert_array_equal(estimates[2], estimates[0])
    assert np.isfinite(estimates[3]).all()
    assert not np.array_equal(estimates[3], estimates[2])


def test_a_reading_with_one_axis_missing_is_not_used() -> None:
    dut, context = _dut()
    _sample(dut, context, [0.0, 0.0, 0.0])
    assert not _sample(dut, context, [1.1, 0.0, np.nan], [*TWIST, 1.0, 1.0]).rotation_used
    np.testing.assert_array_equal(_out(dut, context, "predicted_estimate"), ESTIMATE)


def test_only_the_package_in_use_need_be_connected() -> None:
    dut, context = _dut(("gyro", "spare"))
    _sample(dut, context, [0.0, 0.0, 0.0])
    assert _sample(dut, context, [1.2, 0.0, 0.0], [*TWIST, 1.0, 1.0]).rotation_used


def test_a_large_innovation_raises_the_covariance_first() -> None:
    # NIS 0.04 / 0.041 is below 1, above 0.5
    jump = np.zeros((9, 9))
    jump[0, 0] = 1.0
    for threshold, jumped in ((1.0, 0.0), (0.5, 1.0)):
        dut, context = _dut(jump_threshold=threshold, jump_covariance=jump)
        _sample(dut, context, [0.0, 0.0, 0.0])
        report = _sample(dut, context, [1.2, 0.0, 0.0], [*TWIST, 1.0, 1.0])
        np.testing.assert_allclose(report.rotation_nis, 0.04 / 0.041, rtol=1e-13)  # reported as it was before
        assert report.rotation_jump == jumped
        variance = VARIANCE + jumped
        gain = 2.0 * variance / (4.0 * variance + 0.001)
        np.testing.assert_allclose(_out(dut, context, "predicted_estimate")[0], 0.5 + 0.2 * gain, rtol=1e-12)


def test_the_hybrid_rule_is_remembered_while_coasting() -> None:
    # Y = 0.041 and R = 0.001: subtract when the limit is above 41
    for limit, subtracts in ((42.0, True), (40.0, False)):
        dut, context = _dut(coupling=RotationCoupling.HYBRID, coupling_limit=limit)
        assert not _sample(dut, context, [0.0, 0.0, 0.0]).coupling_subtracted
        assert not _sample(dut, context, [0.01, 0.0, 0.0]).coupling_subtracted  # coasting says nothing
        assert _sample(dut, context, [1.01, 0.0, 0.0], [*TWIST, 0.0, 1.0]).coupling_subtracted == subtracts
        assert _sample(dut, context, [1.01, 0.0, 0.0]).coupling_subtracted == subtracts


def test_dynamic_coupling_is_subtracted() -> None:
    # turning with (1, 1, 0), I = diag(2, 4, 5): w x I w = (0, 0, 2), so dw_z = -0.2 x 2 x 0.08
    dut, context = _dut(coupling=RotationCoupling.SUBTRACT)
    _sample(dut, context, [1.0, 1.0, 0.0])
    innovation = _sample(dut, context, [1.0, 1.0, -0.032]).rotation_innovation
    # the mean rate has w_z = -0.016: what it adds is w x I w = (1 x 5 - 4) x -0.016 and (2 - 5) x -0.016
    np.testing.assert_allclose(innovation[2], 0.0, atol=1e-15)
    np.testing.assert_allclose(innovation[:2], [-0.016 * 0.5 * PERIOD_S, 0.048 * 0.25 * PERIOD_S], rtol=1e-12)


def test_a_lost_definiteness_names_the_system_and_the_time() -> None:
    dut, context = _dut(disturbance_covariance=-1.0 * np.eye(3))
    _sample(dut, context, [0.0, 0.0, 0.0])
    dut.GetInputPort("gyro").FixValue(context, [0.1, 0.0, 0.0])
    with pytest.raises(NotPositiveDefiniteError, match=r"rotation_estimator: .*innovation covariance.*at t = 0\.08 s"):
        _out(dut, context, "estimate")


# ------------------------------------------------------------------------- several packages, and their range


def test_while_the_gyro_in_use_is_missing_the_next_takes_over() -> None:
    dut, context = _dut(("gyro", "spare"))
    increments = []
    for number in range(6):
        dut.GetInputPort("spare").FixValue(context, [2.0 * number, 0.0, 5.0])
        dut.GetInputPort("gyro").FixValue(context, [np.nan if number == 2 else 1.0 * number, 0.0, 0.0])
        increments.append(_turning(dut, context).increment[0])
        advance(dut, context)
    # the missing reading bounds two increments; the gyro then comes back
    np.testing.assert_array_equal(increments, [np.nan, 1.0, 2.0, 2.0, 1.0, 1.0])


def test_a_gyro_at_its_range_is_skipped() -> None:
    dut, context = _dut(limit=2.0)
    fire = [*TWIST, 1.0, 1.0]
    rates = (0.0, 1.0, 2.0, 1.9, 1.8, -2.0, 1.0, 1.1)
    used = [_sample(dut, context, [rate, 0.0, 0.0], fire).rotation_used for rate in rates]
    assert used == [False, True, False, False, True, False, False, True]


def test_two_gyros_are_averaged_and_tell_the_mass_filter_how_well() -> None:
    dut, context = _dut(("gyro", "spare"), rule=Rule.AVERAGE)
    for gyro, spare in ((0.0, 0.0), (1.0, 1.2)):
        dut.GetInputPort("spare").FixValue(context, [spare, 0.0, 0.0])
        dut.GetInputPort("gyro").FixValue(context, [gyro, 0.0, 0.0])
        turning = _turning(dut, context)
        advance(dut, context)
    sample = [*turning.increment, *turning.rate, turning.rate_variance]
    np.testing.assert_allclose(sample, [1.1, 0.0, 0.0, 0.55, 0.0, 0.0, 0.0005], rtol=1e-14)


# ------------------------------------------------------------------------------- considered thrust errors


def test_thrust_errors_add_a_port_and_a_state() -> None:
    dut, context = _dut(thrust_errors=np.ones((2, 6)))
    assert inputs(dut)["mean_level"] == 2
    assert outputs(dut)["turning"] == 136 + 24
    depends = feedthrough(dut)
    assert "mean_level" in depends["innovation"]
    assert depends["turning"] == depends["innovation"]
    assert context.get_discrete_state(0).size() == 9 + 81 + 1 + 3 + 18


def test_thrust_errors_count_by_the_level_of_their_jet() -> None:
    # one sigma turns with 0.2 and 0.4 about x at full level; the first jet is on, the second at a half: effects
    # 0.5 x 0.2 each about x; products H_j S H_j^T = 0.2^2 x 0.01 of each about every axis
    errors = np.zeros((2, 6))
    errors[:, 0] = 0.2, 0.4
    dut, context = _dut(thrust_errors=errors)
    dut.GetInputPort("mean_level").FixValue(context, [1.0, 0.5])
    _sample(dut, context, [0.0, 0.0, 0.0])
    dut.GetInputPort("gyro").FixValue(context, [1.2, -0.1, 0.05])
    dut.GetInputPort("impulses").FixValue(context, [*TWIST, 1.0, 1.0])
    effects = [[0.1, 0.1], [0.0, 0.0], [0.0, 0.0]]
    np.testing.assert_allclose(_turning(dut, context, jets=2).effects, effects, rtol=1e-13)
    expected = np.diag([0.041 + 0.02, 0.041, 0.041]) + 2 * 0.04 * 0.01 * np.eye(3)
    np.testing.assert_allclose(
        _out(dut, context, "innovation_covariance").reshape(3, 3), expected, rtol=1e-13, atol=1e-18
    )
    advance(dut, context)
    sensitivity = _sensitivity(context)
    assert (sensitivity[0] < 0.0).all()  # more torque looks like a larger inverse inertia: truth minus estimate falls
    # coasting, none bears on the sample
    dut.GetInputPort("mean_level").FixValue(context, [0.0, 0.0])
    _sample(dut, context, [1.2, -0.1, 0.05])
    assert not _turning(dut, context, jets=2).effects.any()
    np.testing.assert_array_equal(_sensitivity(context), sensitivity)
