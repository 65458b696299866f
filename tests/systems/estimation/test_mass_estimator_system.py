"""The mass estimator as a system: ports, timing and missing readings."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from params_probe import mass_params
from systems_probe import advance, feedthrough, inputs, outputs

from massprop_drake.maths.estimation.filter import Joint, MassReport
from massprop_drake.maths.estimation.filters.mass_filter import Compensation
from massprop_drake.maths.estimation.filters.thesis import MASS_STATE
from massprop_drake.maths.estimation.redundancy import Rule
from massprop_drake.systems.estimation._readings import KnownPackage
from massprop_drake.systems.estimation.mass_estimator import MassEstimator
from massprop_drake.systems.layouts import EVIDENCE, MASS_REPORT, TURNING

RECIPROCAL, VARIANCE = 0.1, 4e-4
READING_VARIANCE = 5e-3  # so that of an increment is 0.01
PUSH = [0.0, 0.0, 0.0, 5.0, 0.0, 0.0, 1.0, 1.0]  # a linear impulse of 5 along x, usable, firing
STILL = (np.zeros(3), np.zeros(3), 0.0)  # rate increment, mean rate, variance of the increment's error
UNKNOWN = (np.full(3, np.nan), np.full(3, np.nan), np.nan)
POSITION = [3.0, 0.0, 0.0]
CENTER = np.array([1.0, 0.0, 0.0])
ROTATION = np.concatenate([np.zeros(6), CENTER])
Motion = tuple[Any, Any, float]


def _dut(
    accelerometers: tuple[str, ...] = ("acc",),
    limit: float = np.inf,
    thrust_errors: np.ndarray | None = None,
    **params: Any,
) -> tuple[MassEstimator, Any]:
    dut = MassEstimator(
        mass_reciprocal=RECIPROCAL,
        variance=VARIANCE,
        accelerometers=tuple(KnownPackage(name, limit) for name in accelerometers),
        thrust_errors=thrust_errors,
        params=mass_params(
            positions=np.array([POSITION] * len(accelerometers)),
            variances=np.full(len(accelerometers), READING_VARIANCE),
            **params,
        ),
    )
    context = dut.CreateDefaultContext()
    dut.GetInputPort("predicted_estimate").FixValue(context, ROTATION)
    dut.GetInputPort("impulses").FixValue(context, PUSH)
    _turn(dut, context)
    return dut, context


def _turn(dut: MassEstimator, context: Any, motion: Motion = STILL, **changes: Any) -> None:
    """What the rotation filter says of the sample."""
    port = dut.GetInputPort("turning")
    n_errors = (port.size() - TURNING.sized(jets=0).size) // 12
    layout = TURNING.sized(jets=n_errors)
    turning = {
        "innovation": np.zeros(3),
        "innovation_covariance": np.eye(3),
        "increment": motion[0],
        "rate": motion[1],
        "rate_variance": motion[2],
        "estimate": ROTATION,
        "covariance": np.zeros((9, 9)),
        "cross_covariance": np.zeros((3, 9)),
        "effects": np.zeros((3, n_errors)),
        "sensitivity": np.zeros((9, n_errors)),
    }
    port.FixValue(context, layout.pack(layout.make(**(turning | changes))))


def _report(dut: MassEstimator, context: Any) -> MassReport:
    return MassReport._make(MASS_REPORT.read(dut.GetOutputPort("report").Eval(context)))


def _evidence(dut: MassEstimator, context: Any) -> Joint:
    return Joint._make(EVIDENCE.read(dut.GetOutputPort("evidence").Eval(context)))


def _assert_not_measured(report: MassReport) -> None:
    np.testing.assert_array_equal([*report.mass_innovation, report.mass_nis], [np.nan] * 4)
    assert (report.mass_used, report.mass_jump) == (False, False)


def _sample(
    dut: MassEstimator,
    context: Any,
    reading: list[float],
    impulses: list[float] | None = None,
    motion: Motion = STILL,
    **changes: Any,
) -> MassReport:
    """The report of a sample; the sample is then over."""
    dut.GetInputPort("acc").FixValue(context, reading)
    dut.GetInputPort("impulses").FixValue(context, impulses or PUSH)
    _turn(dut, context, motion, **changes)
    report = _report(dut, context)
    advance(dut, context)
    return report


def _estimate(dut: MassEstimator, context: Any) -> np.ndarray:
    """1/m and its variance in the state."""
    return context.get_discrete_state(0).CopyToVector()[:2]


def _sensitivity(context: Any) -> np.ndarray:
    """What one sigma of each of two jets' thrust errors has done to the estimate, shape (2,)."""
    layout = MASS_STATE.sized(accelerometers=1, window=1, errors=2)
    return layout.read(context.get_discrete_state(0).CopyToVector()).sensitivity


def test_topology() -> None:
    dut, context = _dut(("acc", "spare"))
    assert inputs(dut) == {
        "acc": 3,
        "spare": 3,
        "impulses": 8,
        "turning": 136,
        "predicted_estimate": 9,
        "known_force": 24,
        "adaptation": 26,
    }
    assert outputs(dut) == {
        "predicted": 10,
        "evidence": 213,
        "innovation": 3,
        "innovation_covariance": 9,
        "estimate": 2,
        "report": 11,
    }
    # where one package is missing, the other is used; the prediction alone goes to `predicted` and nowhere else
    used = set(inputs(dut)) - {"predicted_estimate"}
    # the detector makes the adaptation from the innovation, which therefore must not wait for it
    measured = used - {"adaptation"}
    assert feedthrough(dut) == {
        "predicted": {"predicted_estimate"},
        "evidence": measured,
        "innovation": measured,
        "innovation_covariance": measured,
        "report": used,
        "estimate": used,
    }
    assert context.get_discrete_state(0).size() == 11


def test_the_first_reading_measures_nothing() -> None:
    dut, context = _dut()
    _assert_not_measured(_sample(dut, context, [7.0, 8.0, 9.0]))
    np.testing.assert_array_equal(_estimate(dut, context), [RECIPROCAL, VARIANCE])


def test_one_sample_by_hand() -> None:
    dut, context = _dut()
    _sample(dut, context, [1.0, 1.0, 1.0])
    dut.GetInputPort("acc").FixValue(context, [1.6, 1.2, 1.0])
    # e = (0.6, 0.2, 0) - 5 x 0.1; Y = diag(25 x 4e-4 + 0.01, 0.01, 0.01)
    np.testing.assert_allclose(dut.GetOutputPort("innovation").Eval(context), [0.1, 0.2, 0.0], rtol=1e-14, atol=1e-16)
    covariance = dut.GetOutputPort("innovation_covariance").Eval(context).reshape(3, 3)
    np.testing.assert_allclose(covariance, np.diag([0.02, 0.01, 0.01]), rtol=1e-14)
    report = _report(dut, context)
    np.testing.assert_array_equal(report.mass_innovation, dut.GetOutputPort("innovation").Eval(context))
    np.testing.assert_allclose(report.mass_innovation_std, np.sqrt([0.02, 0.01, 0.01]), rtol=1e-14)
    np.testing.assert_allclose(report.mass_nis, 0.01 / 0.02 + 0.04 / 0.01, rtol=1e-13)
    assert (report.mass_used, report.mass_jump) == (True, False)
    # gain 4e-4 x 5 / 0.02 = 0.1, so 0.1 + 0.1 x 0.1; the variance halves
    estimate = dut.GetOutputPort("estimate").Eval(context)
    np.testing.assert_allclose(estimate, [0.11, 2e-4], rtol=1e-13)
    np.testing.assert_array_equal([report.mass_reciprocal, report.variance], estimate)
    np.testing.assert_array_equal(_estimate(dut, context), [RECIPROCAL, VARIANCE])  # not before the update
    advance(dut, context)
    np.testing.assert_array_equal(_estimate(dut, context), estimate)


@pytest.mark.parametrize(("usable", "firing"), [(0.0, 1.0), (1.0, 0.0), (0.0, 0.0)])
def test_a_sample_that_is_unsteady_or_without_thrust_is_measured_and_not_used(usable: float, firing: float) -> None:
    dut, context = _dut()
    _sample(dut, context, [1.0, 1.0, 1.0])
    report = _sample(dut, context, [1.6, 1.0, 1.0], [*PUSH[:6], usable, firing])
    assert np.isfinite([*report.mass_innovation, report.mass_nis]).all()
    assert not report.mass_used
    np.testing.assert_array_equal(_estimate(dut, context), [RECIPROCAL, VARIANCE])


def test_a_missing_reading_costs_two_samples_and_harms_nothing() -> None:
    dut, context = _dut()
    _sample(dut, context, [0.0, 0.0, 0.0])
    used = []
    for reading in ([0.6, 0.0, 0.0], [np.nan] * 3, [1.8, 0.0, 0.0], [2.4, 0.0, 0.0]):
        report = _sample(dut, context, reading)
        used.append(report.mass_used)
        assert np.isnan(report.mass_nis) == (not report.mass_used)
        assert np.isfinite(_estimate(dut, context)).all()
    assert used == [True, False, False, True]


def test_a_sample_without_its_rates_is_not_used() -> None:
    dut, context = _dut(compensation=Compensation.TRANSVERSE)
    _sample(dut, context, [0.0, 0.0, 0.0])
    _assert_not_measured(_sample(dut, context, [0.6, 0.0, 0.0], motion=UNKNOWN))
    np.testing.assert_array_equal(_estimate(dut, context), [RECIPROCAL, VARIANCE])
    assert _sample(dut, context, [1.2, 0.0, 0.0]).mass_used  # the reading itself was there


def test_transverse_motion_is_taken_out_about_the_predicted_center_of_mass() -> None:
    # dw = (0, 0, 0.1) at 2 ahead of the center of mass: dw x r = (0, 0.2, 0)
    dut, context = _dut(compensation=Compensation.TRANSVERSE)
    _sample(dut, context, [0.0, 0.0, 0.0])
    turning = ([0.0, 0.0, 0.1], [0.0, 0.0, 0.05], 0.0)
    report = _sample(dut, context, [0.5, 0.2, 0.0], motion=turning)
    np.testing.assert_allclose(report.mass_innovation, [0.0, 0.0, 0.0], atol=1e-16)
    # with the center of mass 1 further aft, 0.3 is expected
    dut, context = _dut(compensation=Compensation.TRANSVERSE)
    _sample(dut, context, [0.0, 0.0, 0.0])
    report = _sample(dut, context, [0.5, 0.2, 0.0], motion=turning, estimate=np.zeros(9))
    np.testing.assert_allclose(report.mass_innovation, [0.0, -0.1, 0.0], rtol=1e-14, atol=1e-16)


def test_centripetal_motion_is_taken_out_too() -> None:
    # turning about z at 0.5: w x (w x r) T = -0.25 x 2 x 0.08 along x
    dut, context = _dut(compensation=Compensation.TRANSVERSE_CENTRIPETAL)
    _sample(dut, context, [0.0, 0.0, 0.0])
    report = _sample(dut, context, [0.5 - 0.04, 0.0, 0.0], motion=([0.0, 0.0, 0.0], [0.0, 0.0, 0.5], 0.0))
    np.testing.assert_allclose(report.mass_innovation, [0.0, 0.0, 0.0], atol=1e-16)


def test_unknown_rotation_and_center_of_mass_widen_the_innovation() -> None:
    # dw = (0, 0, 0.1), S_cm = 0.09 in y: [dw x] S [dw x]^T has 0.01 x 0.09 in x;
    # W = var (tr M 1 - M), var = 0.001, M = diag(4, 0.09, 0)
    dut, context = _dut(compensation=Compensation.TRANSVERSE, compensation_covariance=True)
    covariance = np.zeros((9, 9))
    covariance[7, 7] = 0.09
    _sample(dut, context, [0.0, 0.0, 0.0], covariance=covariance)
    dut.GetInputPort("acc").FixValue(context, [0.5, 0.2, 0.0])
    _turn(dut, context, ([0.0, 0.0, 0.1], [0.0, 0.0, 0.05], 1e-3), covariance=covariance)
    found = dut.GetOutputPort("innovation_covariance").Eval(context).reshape(3, 3)
    expected = np.diag([0.02 + 0.0009 + 1e-3 * 0.09, 0.01 + 1e-3 * 4.0, 0.01 + 1e-3 * 4.09])
    np.testing.assert_allclose(found, expected, rtol=1e-13, atol=1e-18)


def test_only_the_package_in_use_need_be_connected() -> None:
    dut, context = _dut(("acc", "spare"))
    _sample(dut, context, [0.0, 0.0, 0.0])
    assert _sample(dut, context, [0.6, 0.0, 0.0]).mass_used


# ------------------------------------------------------------------------- several packages, and their range


def _both(dut: MassEstimator, context: Any, acc: list[float], spare: list[float]) -> MassReport:
    """The report of a sample with two packages; the sample is then over."""
    dut.GetInputPort("spare").FixValue(context, spare)
    return _sample(dut, context, acc)


def test_while_the_package_in_use_is_missing_the_next_takes_over() -> None:
    # velocities of the two differ by their offset, 100 along y, which cancels in each package's own increments
    dut, context = _dut(("acc", "spare"))
    missing, seen = [np.nan] * 3, []
    for number in range(7):
        acc = missing if number in (2, 3) else [0.6 * number, 0.0, 0.0]
        seen.append(_both(dut, context, acc, [0.7 * number, 100.0, 0.0]))
    # increments 0.6 of acc, 0.7 of spare, where 0.5 is first expected; 2 to 4 have no increment of acc
    assert [report.mass_used for report in seen] == [False] + [True] * 6
    expected, estimate, variance = [], RECIPROCAL, VARIANCE
    for increment in (0.6, 0.7, 0.7, 0.7, 0.6, 0.6):
        expected.append(increment - 5.0 * estimate)
        gain = 5.0 * variance / (25.0 * variance + 0.01)
        estimate, variance = estimate + gain * expected[-1], variance * (1.0 - 5.0 * gain)
    np.testing.assert_allclose([report.mass_innovation[0] for report in seen[1:]], expected, rtol=1e-10)


def test_where_all_packages_are_missing_the_sample_is_skipped() -> None:
    dut, context = _dut(("acc", "spare"))
    _both(dut, context, [0.0] * 3, [0.0] * 3)
    missing = [np.nan] * 3
    _assert_not_measured(_both(dut, context, missing, missing))
    np.testing.assert_array_equal(_estimate(dut, context), [RECIPROCAL, VARIANCE])


def test_a_package_at_its_range_counts_as_missing() -> None:
    dut, context = _dut(("acc", "spare"), limit=1.0)
    _both(dut, context, [0.0] * 3, [0.0] * 3)
    # acc has just reached it, spare not yet; then both, then acc alone is back
    first = _both(dut, context, [1.0, 0.0, 0.0], [0.7, 0.0, 0.0]).mass_innovation
    assert first[0] == pytest.approx(0.7 - 0.5)
    assert np.isnan(_both(dut, context, [1.0, 0.0, 0.0], [0.0, 0.0, -1.2]).mass_innovation).all()
    assert np.isnan(_both(dut, context, [0.1, 0.0, 0.0], [0.0, 0.0, 0.0]).mass_innovation).all()
    assert np.isfinite(_both(dut, context, [0.2, 0.0, 0.0], [0.0, 0.0, 0.0]).mass_innovation).all()


def test_a_spare_package_need_not_be_connected_to_be_averaged() -> None:
    dut, context = _dut(("acc", "spare"), rule=Rule.AVERAGE)
    _sample(dut, context, [0.0, 0.0, 0.0])
    assert _sample(dut, context, [0.6, 0.0, 0.0]).mass_innovation[0] == pytest.approx(0.1)
    dut, context = _dut(("acc", "spare"), rule=Rule.AVERAGE)
    _both(dut, context, [0.0] * 3, [0.0] * 3)
    assert _both(dut, context, [0.6, 0.0, 0.0], [0.8, 0.0, 0.0]).mass_innovation[0] == pytest.approx(0.2)


# ----------------------------------------------------------------------------- what the detector is told


def test_the_ten_predictions_are_those_before_the_sample() -> None:
    dut, context = _dut()
    _sample(dut, context, [1.0, 1.0, 1.0])
    dut.GetInputPort("acc").FixValue(context, [1.6, 1.2, 1.0])
    np.testing.assert_array_equal(dut.GetOutputPort("predicted").Eval(context), [*ROTATION, RECIPROCAL])
    updated = dut.GetOutputPort("estimate").Eval(context)[0]
    advance(dut, context)
    np.testing.assert_array_equal(dut.GetOutputPort("predicted").Eval(context), [*ROTATION, updated])


def test_the_evidence_puts_both_innovations_and_predictions_side_by_side() -> None:
    dut, context = _dut()
    _sample(dut, context, [1.0, 1.0, 1.0])
    dut.GetInputPort("acc").FixValue(context, [1.6, 1.2, 1.0])
    about = {"innovation": np.array([1.0, 2.0, 3.0]), "innovation_covariance": np.diag([4.0, 5.0, 6.0])}
    _turn(dut, context, covariance=np.diag(np.arange(1.0, 10.0)), **about)
    evidence = _evidence(dut, context)
    np.testing.assert_allclose(evidence.innovation, [0.1, 0.2, 0.0, 1.0, 2.0, 3.0], rtol=1e-14, atol=1e-16)
    np.testing.assert_allclose(evidence.covariance, np.diag([0.02, 0.01, 0.01, 4.0, 5.0, 6.0]), rtol=1e-14)
    assert not evidence.coupled
    np.testing.assert_array_equal(evidence.estimate, [*ROTATION, RECIPROCAL])
    np.testing.assert_array_equal(evidence.estimate_covariance, np.diag([*np.arange(1.0, 10.0), VARIANCE]))


def test_an_unsteady_sample_gives_no_evidence() -> None:
    dut, context = _dut()
    _sample(dut, context, [1.0, 1.0, 1.0])
    dut.GetInputPort("acc").FixValue(context, [1.6, 1.2, 1.0])
    dut.GetInputPort("impulses").FixValue(context, [*PUSH[:6], 0.0, 1.0])
    evidence = _evidence(dut, context)
    assert np.isnan(evidence.innovation).all()
    assert not evidence.coupled


# ------------------------------------------------------------------------------- considered thrust errors


def test_thrust_errors_add_a_port_and_a_state() -> None:
    dut, context = _dut(thrust_errors=np.ones((2, 6)))
    assert inputs(dut)["mean_level"] == 2
    assert inputs(dut)["turning"] == 136 + 24
    depends = feedthrough(dut)
    assert "mean_level" in depends["innovation"]
    assert depends["evidence"] == depends["innovation"]
    assert context.get_discrete_state(0).size() == 2 + 3 + 3 + 2


def test_thrust_errors_count_by_the_level_of_their_jet() -> None:
    # two jets push along x with one sigma of 0.2 and 0.4 at full level; the first is on, the second at a half:
    # effects 0.1 x 0.2 and 0.1 x 0.2 along x, and the products 4e-4 (0.04 + 0.04)
    errors = np.zeros((2, 6))
    errors[:, 3] = 0.2, 0.4
    dut, context = _dut(thrust_errors=errors)
    dut.GetInputPort("mean_level").FixValue(context, [1.0, 0.5])
    _sample(dut, context, [0.0, 0.0, 0.0])
    dut.GetInputPort("acc").FixValue(context, [0.6, 0.0, 0.0])
    # one sigma of each jet shows as 1 and 2 in the rate about z: what both share is 0.02 x 1 + 0.02 x 2
    _turn(dut, context, effects=np.array([[0.0, 0.0], [0.0, 0.0], [1.0, 2.0]]))
    evidence = _evidence(dut, context)
    assert evidence.coupled
    shared = np.zeros((3, 3))
    shared[0, 2] = 0.02 * 1.0 + 0.02 * 2.0
    np.testing.assert_allclose(evidence.covariance[:3, 3:], shared, rtol=1e-13)
    np.testing.assert_array_equal(evidence.covariance[3:, :3], evidence.covariance[:3, 3:].T)
    _turn(dut, context, effects=np.eye(3, 2))  # of each alone
    np.testing.assert_allclose(_evidence(dut, context).covariance[0, 3], 0.02, rtol=1e-13)
    _turn(dut, context, effects=np.eye(3, 2, 1))
    np.testing.assert_allclose(_evidence(dut, context).covariance[0, 3], 0.02, rtol=1e-13)
    _turn(dut, context)  # none bears on the rotation
    assert not _evidence(dut, context).coupled
    covariance = dut.GetOutputPort("innovation_covariance").Eval(context).reshape(3, 3)
    expected = [0.02 + 2 * 4e-4 + 4e-4 * 0.08, 0.01, 0.01]
    np.testing.assert_allclose(covariance, np.diag(expected), rtol=1e-13, atol=1e-18)
    advance(dut, context)
    sensitivity = _sensitivity(context)
    assert (sensitivity < 0.0).all()  # more thrust than thought looks like a larger 1/m: truth minus estimate falls
    # no thrust error bears on a sample in which nothing fired
    dut.GetInputPort("mean_level").FixValue(context, [0.0, 0.0])
    _sample(dut, context, [0.6, 0.0, 0.0], [0.0] * 6 + [1.0, 0.0])
    np.testing.assert_array_equal(_sensitivity(context), sensitivity)
