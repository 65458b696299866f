"""The mass estimator as a system: ports, timing and missing readings."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from params_probe import mass_params
from systems_probe import advance, feedthrough, inputs, outputs

from massprop_drake.maths.estimation.filters.mass_filter import Compensation
from massprop_drake.maths.estimation.redundancy import Rule
from massprop_drake.systems.estimation._readings import Package
from massprop_drake.systems.estimation.mass_estimator import MassEstimator

RECIPROCAL, VARIANCE = 0.1, 4e-4
READING_VARIANCE = 5e-3  # so that of an increment is 0.01
PUSH = [0.0, 0.0, 0.0, 5.0, 0.0, 0.0, 1.0, 1.0]  # a linear impulse of 5 along x, usable, firing
STILL = [0.0] * 7
POSITION = [3.0, 0.0, 0.0]
CENTER = np.array([1.0, 0.0, 0.0])


def _dut(
    accelerometers: tuple[str, ...] = ("acc",),
    limit: float = np.inf,
    thrust_errors: np.ndarray | None = None,
    **params: Any,
) -> tuple[MassEstimator, Any]:
    dut = MassEstimator(
        mass_reciprocal=RECIPROCAL,
        variance=VARIANCE,
        accelerometers=tuple(Package(name, limit) for name in accelerometers),
        thrust_errors=thrust_errors,
        params=mass_params(
            positions=np.array([POSITION] * len(accelerometers)),
            variances=np.full(len(accelerometers), READING_VARIANCE),
            **params,
        ),
    )
    context = dut.CreateDefaultContext()
    dut.GetInputPort("predicted_estimate").FixValue(context, np.concatenate([np.zeros(6), CENTER]))
    dut.GetInputPort("predicted_covariance").FixValue(context, np.zeros(81))
    dut.GetInputPort("rate_sample").FixValue(context, STILL)
    dut.GetInputPort("impulses").FixValue(context, PUSH)
    return dut, context


def _sample(
    dut: MassEstimator,
    context: Any,
    reading: list[float],
    impulses: list[float] | None = None,
    rate_sample: list[float] | None = None,
) -> np.ndarray:
    """The status of a sample; the sample is then over."""
    dut.GetInputPort("acc").FixValue(context, reading)
    dut.GetInputPort("impulses").FixValue(context, impulses or PUSH)
    dut.GetInputPort("rate_sample").FixValue(context, rate_sample or STILL)
    status = dut.GetOutputPort("status").Eval(context)
    advance(dut, context)
    return status


def _estimate(dut: MassEstimator, context: Any) -> np.ndarray:
    """1/m and its variance in the state."""
    return context.get_discrete_state(0).CopyToVector()[:2]


def test_topology() -> None:
    dut, context = _dut(("acc", "spare"))
    assert inputs(dut) == {
        "acc": 3,
        "spare": 3,
        "impulses": 8,
        "rate_sample": 7,
        "predicted_estimate": 9,
        "predicted_covariance": 81,
        "known_force": 24,
        "adaptation": 26,
    }
    assert outputs(dut) == {
        "predicted": 11,
        "innovation": 3,
        "innovation_covariance": 9,
        "estimate": 2,
        "status": 6,
        "judged": 12,
        "report": 8,
    }
    used = set(inputs(dut))  # where one package is missing, the other is used
    # the detector makes the adaptation from the innovation, which therefore must not wait for it
    measured = used - {"adaptation"}
    assert feedthrough(dut) == {
        "predicted": set(),
        "innovation": measured,
        "innovation_covariance": measured,
        "judged": measured,
        "report": used,
        "estimate": used,
        "status": used,
    }
    assert context.get_discrete_state(0).size() == 11


def test_the_first_reading_measures_nothing() -> None:
    dut, context = _dut()
    np.testing.assert_array_equal(_sample(dut, context, [7.0, 8.0, 9.0]), [np.nan] * 4 + [0.0, 0.0])
    np.testing.assert_array_equal(_estimate(dut, context), [RECIPROCAL, VARIANCE])


def test_one_sample_by_hand() -> None:
    dut, context = _dut()
    _sample(dut, context, [1.0, 1.0, 1.0])
    dut.GetInputPort("acc").FixValue(context, [1.6, 1.2, 1.0])
    # e = (0.6, 0.2, 0) - 5 x 0.1; Y = diag(25 x 4e-4 + 0.01, 0.01, 0.01)
    np.testing.assert_allclose(dut.GetOutputPort("innovation").Eval(context), [0.1, 0.2, 0.0], rtol=1e-14, atol=1e-16)
    covariance = dut.GetOutputPort("innovation_covariance").Eval(context).reshape(3, 3)
    np.testing.assert_allclose(covariance, np.diag([0.02, 0.01, 0.01]), rtol=1e-14)
    status = dut.GetOutputPort("status").Eval(context)
    np.testing.assert_allclose(status, [0.1, 0.2, 0.0, 0.01 / 0.02 + 0.04 / 0.01, 1.0, 0.0], rtol=1e-13, atol=1e-16)
    # gain 4e-4 x 5 / 0.02 = 0.1, so 0.1 + 0.1 x 0.1; the variance halves
    estimate = dut.GetOutputPort("estimate").Eval(context)
    np.testing.assert_allclose(estimate, [0.11, 2e-4], rtol=1e-13)
    np.testing.assert_array_equal(_estimate(dut, context), [RECIPROCAL, VARIANCE])  # not before the update
    advance(dut, context)
    np.testing.assert_array_equal(_estimate(dut, context), estimate)


@pytest.mark.parametrize(("usable", "firing"), [(0.0, 1.0), (1.0, 0.0), (0.0, 0.0)])
def test_a_sample_that_is_unsteady_or_without_thrust_is_measured_and_not_used(usable: float, firing: float) -> None:
    dut, context = _dut()
    _sample(dut, context, [1.0, 1.0, 1.0])
    status = _sample(dut, context, [1.6, 1.0, 1.0], [*PUSH[:6], usable, firing])
    assert np.isfinite(status[:4]).all()
    assert status[4] == 0.0
    np.testing.assert_array_equal(_estimate(dut, context), [RECIPROCAL, VARIANCE])


def test_a_missing_reading_costs_two_samples_and_harms_nothing() -> None:
    dut, context = _dut()
    _sample(dut, context, [0.0, 0.0, 0.0])
    used = []
    for reading in ([0.6, 0.0, 0.0], [np.nan] * 3, [1.8, 0.0, 0.0], [2.4, 0.0, 0.0]):
        status = _sample(dut, context, reading)
        used.append(status[4])
        assert np.isnan(status[3]) == (status[4] == 0.0)
        assert np.isfinite(_estimate(dut, context)).all()
    assert used == [1.0, 0.0, 0.0, 1.0]


def test_a_sample_without_its_rates_is_not_used() -> None:
    dut, context = _dut(compensation=Compensation.TRANSVERSE)
    _sample(dut, context, [0.0, 0.0, 0.0])
    status = _sample(dut, context, [0.6, 0.0, 0.0], rate_sample=[np.nan] * 7)
    np.testing.assert_array_equal(status, [np.nan] * 4 + [0.0, 0.0])
    np.testing.assert_array_equal(_estimate(dut, context), [RECIPROCAL, VARIANCE])
    assert _sample(dut, context, [1.2, 0.0, 0.0])[4] == 1.0  # the reading itself was there


def test_transverse_motion_is_taken_out_about_the_predicted_center_of_mass() -> None:
    # dw = (0, 0, 0.1) at 2 ahead of the center of mass: dw x r = (0, 0.2, 0)
    dut, context = _dut(compensation=Compensation.TRANSVERSE)
    _sample(dut, context, [0.0, 0.0, 0.0])
    status = _sample(dut, context, [0.5, 0.2, 0.0], rate_sample=[0.0, 0.0, 0.1, 0.0, 0.0, 0.05, 0.0])
    np.testing.assert_allclose(status[:3], [0.0, 0.0, 0.0], atol=1e-16)
    # with the center of mass 1 further aft, 0.3 is expected
    dut, context = _dut(compensation=Compensation.TRANSVERSE)
    dut.GetInputPort("predicted_estimate").FixValue(context, np.zeros(9))
    _sample(dut, context, [0.0, 0.0, 0.0])
    status = _sample(dut, context, [0.5, 0.2, 0.0], rate_sample=[0.0, 0.0, 0.1, 0.0, 0.0, 0.05, 0.0])
    np.testing.assert_allclose(status[:3], [0.0, -0.1, 0.0], rtol=1e-14, atol=1e-16)


def test_centripetal_motion_is_taken_out_too() -> None:
    # turning about z at 0.5: w x (w x r) T = -0.25 x 2 x 0.08 along x
    dut, context = _dut(compensation=Compensation.TRANSVERSE_CENTRIPETAL)
    _sample(dut, context, [0.0, 0.0, 0.0])
    status = _sample(dut, context, [0.5 - 0.04, 0.0, 0.0], rate_sample=[0.0, 0.0, 0.0, 0.0, 0.0, 0.5, 0.0])
    np.testing.assert_allclose(status[:3], [0.0, 0.0, 0.0], atol=1e-16)


def test_unknown_rotation_and_center_of_mass_widen_the_innovation() -> None:
    # dw = (0, 0, 0.1), S_cm = 0.09 in y: [dw x] S [dw x]^T has 0.01 x 0.09 in x;
    # W = var (tr M 1 - M), var = 0.001, M = diag(4, 0.09, 0)
    dut, context = _dut(compensation=Compensation.TRANSVERSE, compensation_covariance=True)
    covariance = np.zeros((9, 9))
    covariance[7, 7] = 0.09
    dut.GetInputPort("predicted_covariance").FixValue(context, covariance.ravel())
    _sample(dut, context, [0.0, 0.0, 0.0])
    dut.GetInputPort("acc").FixValue(context, [0.5, 0.2, 0.0])
    dut.GetInputPort("rate_sample").FixValue(context, [0.0, 0.0, 0.1, 0.0, 0.0, 0.05, 1e-3])
    found = dut.GetOutputPort("innovation_covariance").Eval(context).reshape(3, 3)
    expected = np.diag([0.02 + 0.0009 + 1e-3 * 0.09, 0.01 + 1e-3 * 4.0, 0.01 + 1e-3 * 4.09])
    np.testing.assert_allclose(found, expected, rtol=1e-13, atol=1e-18)


def test_only_the_package_in_use_need_be_connected() -> None:
    dut, context = _dut(("acc", "spare"))
    _sample(dut, context, [0.0, 0.0, 0.0])
    assert _sample(dut, context, [0.6, 0.0, 0.0])[4] == 1.0


# ------------------------------------------------------------------------- several packages, and their range


def _both(dut: MassEstimator, context: Any, acc: list[float], spare: list[float]) -> np.ndarray:
    """The status of a sample with two packages; the sample is then over."""
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
    assert [status[4] for status in seen] == [0.0] + [1.0] * 6
    expected, estimate, variance = [], RECIPROCAL, VARIANCE
    for increment in (0.6, 0.7, 0.7, 0.7, 0.6, 0.6):
        expected.append(increment - 5.0 * estimate)
        gain = 5.0 * variance / (25.0 * variance + 0.01)
        estimate, variance = estimate + gain * expected[-1], variance * (1.0 - 5.0 * gain)
    np.testing.assert_allclose([status[0] for status in seen[1:]], expected, rtol=1e-10)


def test_where_all_packages_are_missing_the_sample_is_skipped() -> None:
    dut, context = _dut(("acc", "spare"))
    _both(dut, context, [0.0] * 3, [0.0] * 3)
    missing = [np.nan] * 3
    status = _both(dut, context, missing, missing)
    np.testing.assert_array_equal(status, [np.nan] * 4 + [0.0, 0.0])
    np.testing.assert_array_equal(_estimate(dut, context), [RECIPROCAL, VARIANCE])


def test_a_package_at_its_range_counts_as_missing() -> None:
    dut, context = _dut(("acc", "spare"), limit=1.0)
    _both(dut, context, [0.0] * 3, [0.0] * 3)
    # acc has just reached it, spare not yet; then both, then acc alone is back
    assert _both(dut, context, [1.0, 0.0, 0.0], [0.7, 0.0, 0.0])[0] == pytest.approx(0.7 - 0.5)
    assert np.isnan(_both(dut, context, [1.0, 0.0, 0.0], [0.0, 0.0, -1.2])[0])
    assert np.isnan(_both(dut, context, [0.1, 0.0, 0.0], [0.0, 0.0, 0.0])[0])
    assert np.isfinite(_both(dut, context, [0.2, 0.0, 0.0], [0.0, 0.0, 0.0])[0])


def test_a_spare_package_need_not_be_connected_to_be_averaged() -> None:
    dut, context = _dut(("acc", "spare"), rule=Rule.AVERAGE)
    _sample(dut, context, [0.0, 0.0, 0.0])
    assert _sample(dut, context, [0.6, 0.0, 0.0])[0] == pytest.approx(0.1)
    dut, context = _dut(("acc", "spare"), rule=Rule.AVERAGE)
    _both(dut, context, [0.0] * 3, [0.0] * 3)
    assert _both(dut, context, [0.6, 0.0, 0.0], [0.8, 0.0, 0.0])[0] == pytest.approx(0.2)


# ------------------------------------------------------------------------------- considered thrust errors


def test_thrust_errors_add_a_port_and_a_state() -> None:
    dut, context = _dut(thrust_errors=np.ones((2, 6)))
    assert inputs(dut)["mean_level"] == 2
    assert outputs(dut)["thrust_error_effects"] == 6
    depends = feedthrough(dut)
    assert "mean_level" in depends["innovation"]
    assert depends["thrust_error_effects"] == depends["innovation"]
    assert context.get_discrete_state(1).size() == 2


def test_thrust_errors_count_by_the_level_of_their_jet() -> None:
    # two jets push along x with one sigma of 0.2 and 0.4 at full level; the first is on, the second at a half:
    # effects 0.1 x 0.2 and 0.1 x 0.2 along x, and the products 4e-4 (0.04 + 0.04)
    errors = np.zeros((2, 6))
    errors[:, 3] = 0.2, 0.4
    dut, context = _dut(thrust_errors=errors)
    dut.GetInputPort("mean_level").FixValue(context, [1.0, 0.5])
    _sample(dut, context, [0.0, 0.0, 0.0])
    dut.GetInputPort("acc").FixValue(context, [0.6, 0.0, 0.0])
    effects = dut.GetOutputPort("thrust_error_effects").Eval(context)
    np.testing.assert_allclose(effects, [0.02, 0.02, 0.0, 0.0, 0.0, 0.0], rtol=1e-13)
    covariance = dut.GetOutputPort("innovation_covariance").Eval(context).reshape(3, 3)
    expected = [0.02 + 2 * 4e-4 + 4e-4 * 0.08, 0.01, 0.01]
    np.testing.assert_allclose(covariance, np.diag(expected), rtol=1e-13, atol=1e-18)
    advance(dut, context)
    sensitivity = context.get_discrete_state(1).CopyToVector()
    assert (sensitivity < 0.0).all()  # more thrust than thought looks like a larger 1/m: truth minus estimate falls
    # no thrust error bears on a sample in which nothing fired
    dut.GetInputPort("mean_level").FixValue(context, [0.0, 0.0])
    _sample(dut, context, [0.6, 0.0, 0.0], [0.0] * 6 + [1.0, 0.0])
    np.testing.assert_array_equal(context.get_discrete_state(1).CopyToVector(), sensitivity)
