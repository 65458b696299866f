"""The rotation estimator as a system: ports, timing and missing readings."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from params_probe import rotation_params
from systems_probe import PERIOD_S, advance, feedthrough, give, inputs, output, outputs

from massprop_drake.maths.estimation.filter import RotationReport
from massprop_drake.maths.estimation.filters.rotation_filter import RotationCoupling
from massprop_drake.maths.estimation.filters.thesis import ROTATION_STATE, Turning
from massprop_drake.maths.estimation.redundancy import Rule
from massprop_drake.maths.linear_algebra import NotPositiveDefiniteError
from massprop_drake.systems import RotationEstimator
from massprop_drake.systems.estimation._readings import KnownPackage
from massprop_drake.systems.layouts import ROTATION_REPORT, TURNING

# inverse inertia diag(0.5, 0.25, 0.2), center of mass (1, 0, 0), 1-sigma 0.1 each
ESTIMATE = np.array([0.5, 0.25, 0.2, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0])
VARIANCE, READING_VARIANCE = 0.01, 5e-4  # so that of an increment is 1e-3
# 2 about x, no force: h = (0.5 x 2, 0, 0), H = A_6((2, 0, 0)), curvature 0
TWIST, COAST = [2.0, *[0.0] * 5, 1.0, 1.0], [*[0.0] * 6, 1.0, 0.0]


class Rig:
    """The estimator with its inputs in hand."""

    def __init__(self, gyros: tuple[str, ...] = ("gyro",), limit: float = np.inf, **given: Any):
        errors, params = given.pop("thrust_errors", None), rotation_params(
            gyro_variances=np.full(len(gyros), READING_VARIANCE), **given
        )  # fmt: skip
        self.jets = 0 if errors is None else len(errors)
        self.dut = RotationEstimator(
            estimate=ESTIMATE, covariance=VARIANCE * np.eye(9), thrust_errors=errors, params=params,
            gyros=tuple(KnownPackage(name, limit) for name in gyros),
        )  # fmt: skip
        self.context = self.dut.CreateDefaultContext()

    def see(self, *gyros: Any, impulses: Any = TWIST) -> RotationReport:
        """The report of a sample, before its update; a number is a rate about x."""
        rates = [[rate, 0.0, 0.0] if np.ndim(rate) == 0 else rate for rate in gyros]
        give(self.dut, self.context, impulses=impulses, **dict(zip(("gyro", "spare"), rates, strict=False)))
        return RotationReport._make(ROTATION_REPORT.read(self.out("report")))

    def sample(self, *gyros: Any, impulses: Any = TWIST) -> RotationReport:
        """The same; the sample is then over."""
        report = self.see(*gyros, impulses=impulses)
        advance(self.dut, self.context)
        return report

    def out(self, name: str) -> Any:
        return output(self.dut, self.context, name)

    def turning(self) -> Turning:
        return Turning._make(TURNING.sized(jets=self.jets).read(self.out("turning")))

    def sensitivity(self) -> Any:
        """What one sigma of each jet's thrust error has done to the estimate, shape (9, n)."""
        state = self.context.get_discrete_state(0).CopyToVector()
        return ROTATION_STATE.sized(gyros=1, errors=self.jets).read(state).sensitivity


def test_topology() -> None:
    rig = Rig(("gyro", "spare"))
    dut, depends = rig.dut, feedthrough(rig.dut)
    assert inputs(dut) == {"gyro": 3, "spare": 3, "impulses": 8, "known_force": 24, "adaptation": 26}
    of_cycle = {"estimate": 9, "covariance": 81, "report": 28}
    measured = {"turning": 136, "innovation": 3, "innovation_covariance": 9}
    assert outputs(dut) == {"predicted_estimate": 9, **measured, **of_cycle}
    # the mass filter uses the prediction, which must not wait for the measurement; the detector makes the adaptation
    # from the innovation, which must not wait for it
    assert depends.pop("predicted_estimate") == set()
    assert depends == {name: set(inputs(dut)) - ({"adaptation"} if name in measured else set()) for name in depends}
    assert rig.context.get_discrete_state(0).size() == 9 + 81 + 1 + 2 * 3
    errors = Rig(thrust_errors=np.ones((2, 6)))
    assert (inputs(errors.dut)["mean_level"], outputs(errors.dut)["turning"]) == (2, 136 + 24)
    assert "mean_level" in feedthrough(errors.dut)["innovation"]
    assert errors.context.get_discrete_state(0).size() == 9 + 81 + 1 + 3 + 18


def test_one_sample_by_hand() -> None:
    rig = Rig()
    first = rig.sample(0.0)
    assert_array_equal([*first.rotation_innovation, first.rotation_nis, first.rotation_used], [np.nan] * 4 + [False])
    report, turning = rig.see([1.2, -0.1, 0.05]), rig.turning()
    # increment and mean of the two readings, and the variance of the increment's error
    found = [*turning.increment, *turning.rate, turning.rate_variance]
    assert_allclose(found, [1.2, -0.1, 0.05, 0.6, -0.05, 0.025, 0.001], rtol=1e-15)
    # e = dw - (0.5 x 2, 0, 0); Y = (4 x 0.01 + 0.001) 1
    assert_allclose(rig.out("innovation"), [0.2, -0.1, 0.05], rtol=1e-14)
    assert_allclose(rig.out("innovation_covariance"), 0.041 * np.eye(3).ravel(), rtol=1e-14)
    for each in (turning.innovation, report.rotation_innovation):  # where the mass filter and the log read them
        assert_array_equal(each, rig.out("innovation"))
    assert_array_equal(turning.innovation_covariance.ravel(), rig.out("innovation_covariance"))
    assert_allclose(report.rotation_innovation_std, [0.041**0.5] * 3, rtol=1e-14)
    assert_allclose(report.rotation_nis, (0.04 + 0.01 + 0.0025) / 0.041, rtol=1e-13)
    assert (report.rotation_used, report.rotation_jump, report.coupling_subtracted) == (True, False, False)
    # gain 2 x 0.01 / 0.041 on Ixx^-1, Ixy^-1 and Ixz^-1, in that order of the innovation
    estimate = ESTIMATE + 0.02 / 0.041 * np.array([0.2, 0.0, 0.0, 0.0, 0.05, -0.1, 0.0, 0.0, 0.0])
    variance = VARIANCE * np.where(np.isin(np.arange(9), (0, 4, 5)), 0.001 / 0.041, 1.0)
    assert_allclose(report.estimate, estimate, rtol=1e-13)
    assert_allclose(report.standard_deviation, np.sqrt(variance), rtol=1e-12)
    assert_array_equal(rig.out("estimate"), report.estimate)
    covariance = rig.out("covariance")
    assert_allclose(covariance, np.diag(variance).ravel(), rtol=1e-12, atol=1e-18)
    assert_array_equal(rig.out("predicted_estimate"), ESTIMATE)  # not before the update
    advance(rig.dut, rig.context)
    assert_array_equal(rig.out("predicted_estimate"), report.estimate)
    assert_array_equal(rig.turning().covariance.ravel(), covariance)


@pytest.mark.parametrize(
    ("limit", "impulses", "rates", "used"),
    [
        *((np.inf, [*TWIST[:6], *flags], [0.0, 1.1], [0, 0]) for flags in ((0, 1), (1, 0), (0, 0))),  # measured only
        # neither the increment to a missing reading nor the one from it is known
        (np.inf, TWIST, [0.0, 1.1, np.nan, 3.3, 4.4], [0, 1, 0, 0, 1]),
        (np.inf, TWIST, [0.0, [1.1, 0.0, np.nan]], [0, 0]),
        (2.0, TWIST, [0.0, 1.1, 2.0, 1.9, 1.8, -2.0, 1.0, 1.1], [0, 1, 0, 0, 1, 0, 0, 1]),
    ],
)
def test_samples_are_used_where_they_tell_something(limit: float, impulses: Any, rates: Any, used: list[int]) -> None:
    rig, found = Rig(limit=limit), []
    for rate in rates:
        before = rig.out("predicted_estimate")
        report = rig.sample(rate, impulses=impulses)
        found.append(report.rotation_used)
        assert np.isfinite(rig.out("predicted_estimate")).all()
        assert np.array_equal(rig.out("predicted_estimate"), before) == (not report.rotation_used)
        assert report.rotation_used <= np.isfinite(report.rotation_nis)
    assert found == used


def test_several_gyros_take_over_from_each_other_or_are_averaged() -> None:
    rig, increments = Rig(("gyro", "spare")), []
    rig.sample(0.0)  # only the one in use need be connected
    assert rig.sample(1.2).rotation_used
    rig = Rig(("gyro", "spare"))
    for number in range(6):
        rig.see(np.nan if number == 2 else float(number), [2.0 * number, 0.0, 5.0])
        increments.append(rig.turning().increment[0])
        advance(rig.dut, rig.context)
    # the missing reading bounds two increments; the gyro then comes back
    assert_array_equal(increments, [np.nan, 1.0, 2.0, 2.0, 1.0, 1.0])
    rig = Rig(("gyro", "spare"), rule=Rule.AVERAGE)
    rig.sample(0.0, 0.0)
    rig.see(1.0, 1.2)
    assert_allclose([rig.turning().increment[0], rig.turning().rate[0], rig.turning().rate_variance], [1.1, 0.55, 5e-4])


def test_a_large_innovation_raises_the_covariance_first() -> None:
    jump = np.zeros((9, 9))
    jump[0, 0] = 1.0
    for threshold, jumped in ((1.0, 0.0), (0.5, 1.0)):  # NIS 0.04 / 0.041 is below 1, above 0.5
        rig = Rig(jump_threshold=threshold, jump_covariance=jump)
        rig.sample(0.0)
        report = rig.sample(1.2)
        assert_allclose(report.rotation_nis, 0.04 / 0.041, rtol=1e-13)  # reported as it was before
        assert report.rotation_jump == jumped
        gain = 2.0 * (VARIANCE + jumped) / (4.0 * (VARIANCE + jumped) + 0.001)
        assert_allclose(rig.out("predicted_estimate")[0], 0.5 + 0.2 * gain, rtol=1e-12)


def test_dynamic_coupling_is_subtracted_and_the_hybrid_rule_remembered_while_coasting() -> None:
    # turning with (1, 1, 0), I = diag(2, 4, 5): w x I w = (0, 0, 2), so dw_z = -0.2 x 2 x 0.08
    rig = Rig(coupling=RotationCoupling.SUBTRACT)
    rig.sample([1.0, 1.0, 0.0], impulses=COAST)
    innovation = rig.sample([1.0, 1.0, -0.032], impulses=COAST).rotation_innovation
    # the mean rate has w_z = -0.016: what it adds is w x I w = (1 x 5 - 4) x -0.016 and (2 - 5) x -0.016
    assert_allclose(innovation[2], 0.0, atol=1e-15)
    assert_allclose(innovation[:2], [-0.016 * 0.5 * PERIOD_S, 0.048 * 0.25 * PERIOD_S], rtol=1e-12)
    for limit, subtracts in ((42.0, True), (40.0, False)):  # Y = 0.041 and R = 0.001: when the limit is above 41
        rig = Rig(coupling=RotationCoupling.HYBRID, coupling_limit=limit)
        unsteady = [*TWIST[:6], 0.0, 1.0]
        told = [(0.0, COAST), (0.01, COAST), (1.01, unsteady), (1.01, COAST)]  # coasting says nothing
        found = [rig.sample(rate, impulses=impulses).coupling_subtracted for rate, impulses in told]
        assert found == [False, False, subtracts, subtracts]


def test_a_lost_definiteness_names_the_system_and_the_time() -> None:
    rig = Rig(disturbance_covariance=-1.0 * np.eye(3))
    rig.sample(0.0)
    with pytest.raises(NotPositiveDefiniteError, match=r"rotation_estimator: .*innovation covariance.*at t = 0\.08 s"):
        rig.see(0.1)


def test_thrust_errors_count_by_the_level_of_their_jet() -> None:
    # one sigma turns with 0.2 and 0.4 about x at full level; the first jet is on, the second at a half: effects
    # 0.5 x 0.2 each about x; products H_j S H_j^T = 0.2^2 x 0.01 of each about every axis
    errors = np.zeros((2, 6))
    errors[:, 0] = 0.2, 0.4
    rig = Rig(thrust_errors=errors)
    give(rig.dut, rig.context, mean_level=[1.0, 0.5])
    rig.sample(0.0)
    rig.see([1.2, -0.1, 0.05])
    assert_allclose(rig.turning().effects, [[0.1, 0.1], [0.0, 0.0], [0.0, 0.0]], rtol=1e-13)
    expected = np.diag([0.041 + 0.02, 0.041, 0.041]) + 2 * 0.04 * 0.01 * np.eye(3)
    assert_allclose(rig.out("innovation_covariance"), expected.ravel(), rtol=1e-13, atol=1e-18)
    advance(rig.dut, rig.context)
    sensitivity = rig.sensitivity()
    assert (sensitivity[0] < 0.0).all()  # more torque looks like a larger inverse inertia: truth minus estimate falls
    give(rig.dut, rig.context, mean_level=[0.0, 0.0])  # coasting, none bears on the sample
    rig.sample([1.2, -0.1, 0.05], impulses=COAST)
    assert not rig.turning().effects.any()
    assert_array_equal(rig.sensitivity(), sensitivity)
