"""The impulse model: impulses of the interval that ended, and the steady-combination gate."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from systems_probe import PERIOD_S, advance, feedthrough, inputs, outputs

from massprop_drake.systems.estimation.impulse_model import ImpulseModel

# torque about the vehicle origin and force of two jets
WRENCHES = np.array([[10.0, -20.0, 30.0, 1.0, 2.0, 3.0], [0.0, 5.0, 0.0, -4.0, 0.0, 0.5]])


def _dut(time_constant_s: float = 0.0) -> tuple[ImpulseModel, Any]:
    dut = ImpulseModel(wrenches=WRENCHES, time_constants_s=np.full(2, time_constant_s), period_s=PERIOD_S)
    return dut, dut.CreateDefaultContext()


def _impulses(dut: ImpulseModel, context: Any, command: list[float]) -> np.ndarray:
    """Impulses of an interval with this command; its sample is then over."""
    dut.GetInputPort("jet_commands").FixValue(context, command)
    impulses = dut.GetOutputPort("impulses").Eval(context)
    advance(dut, context)
    return impulses


def test_topology() -> None:
    dut, context = _dut()
    assert inputs(dut) == {"jet_commands": 2, "known_force": 24, "outside_wrench": 6}
    assert outputs(dut) == {"impulses": 8, "mean_level": 2}
    assert feedthrough(dut) == {
        "impulses": {"jet_commands", "known_force", "outside_wrench"},
        "mean_level": {"jet_commands", "outside_wrench"},
    }
    assert context.get_discrete_state(0).size() == 4


def test_impulses_are_torque_and_force_times_the_period() -> None:
    dut, context = _dut()
    impulses = _impulses(dut, context, [1.0, 0.0])
    np.testing.assert_allclose(impulses[:6], [0.8, -1.6, 2.4, 0.08, 0.16, 0.24], rtol=1e-14)
    impulses = _impulses(dut, context, [0.5, 1.0])
    np.testing.assert_allclose(impulses[:6], [0.4, -0.4, 1.2, -0.28, 0.08, 0.16], rtol=1e-14)


def test_before_the_first_sample_all_jets_are_taken_as_off() -> None:
    dut, context = _dut()
    # at t = 0 the held command is zero: nothing fires, a steady combination of none
    np.testing.assert_array_equal(_impulses(dut, context, [0.0, 0.0]), [0.0] * 6 + [1.0, 0.0])
    dut, context = _dut()
    assert _impulses(dut, context, [1.0, 0.0])[6] == 0.0


@pytest.mark.parametrize(
    ("before", "now", "usable", "firing"),
    [
        ([1.0, 0.0], [1.0, 0.0], 1.0, 1.0),  # steady
        ([1.0, 0.0], [1.0, 1.0], 0.0, 1.0),  # one came on
        ([1.0, 1.0], [1.0, 0.0], 0.0, 1.0),  # one went off
        ([1.0, 0.0], [0.0, 0.0], 0.0, 0.0),  # tail-off
        ([0.0, 0.0], [0.0, 0.0], 1.0, 0.0),  # coasting
        ([0.5, 0.0], [0.5, 0.0], 0.0, 1.0),  # a fraction is never steady
        ([1.0, 0.0], [0.0, 1.0], 0.0, 1.0),  # one for another
    ],
)
def test_a_sample_is_usable_when_two_whole_commands_agree(
    before: list[float], now: list[float], usable: float, firing: float
) -> None:
    dut, context = _dut()
    _impulses(dut, context, before)
    np.testing.assert_array_equal(_impulses(dut, context, now)[6:], [usable, firing])


def test_with_a_lag_the_impulse_is_that_of_the_mean_level() -> None:
    # T = 2 tau. First interval from nothing: mean level 1 - (1 - exp(-2)) / 2, level at its end 1 - exp(-2);
    # second interval: mean 1 - exp(-2) (1 - exp(-2)) / 2
    dut, context = _dut(0.5 * PERIOD_S)
    left = math.exp(-2.0)
    first = _impulses(dut, context, [0.0, 1.0])
    np.testing.assert_allclose(first[:6], WRENCHES[1] * PERIOD_S * (1.0 - 0.5 * (1.0 - left)), rtol=1e-13)
    second = _impulses(dut, context, [0.0, 1.0])
    np.testing.assert_allclose(second[:6], WRENCHES[1] * PERIOD_S * (1.0 - 0.5 * left * (1.0 - left)), rtol=1e-13)
    # tail-off from the level reached: an impulse although nothing is commanded
    third = _impulses(dut, context, [0.0, 0.0])
    level = 1.0 - left**2
    np.testing.assert_allclose(third[:6], WRENCHES[1] * PERIOD_S * level * 0.5 * (1.0 - left), rtol=1e-13)
    np.testing.assert_array_equal(third[6:], [0.0, 0.0])


def test_asking_for_the_impulses_changes_nothing() -> None:
    dut, context = _dut()
    dut.GetInputPort("jet_commands").FixValue(context, [1.0, 0.0])
    for _ in range(3):
        assert dut.GetOutputPort("impulses").Eval(context)[6] == 0.0
    assert not context.get_discrete_state(0).CopyToVector().any()


def test_an_unknown_command_costs_two_samples() -> None:
    dut, context = _dut()
    usable = [_impulses(dut, context, [1.0, second])[6] for second in (0.0, 0.0, math.nan, 0.0, 0.0)]
    assert usable == [0.0, 1.0, 0.0, 0.0, 1.0]


def test_the_lag_goes_on_from_a_finite_level_after_an_unknown_command() -> None:
    dut, context = _dut(0.5 * PERIOD_S)
    for _ in range(20):
        _impulses(dut, context, [0.0, 1.0])
    impulses = _impulses(dut, context, [0.0, math.nan])
    # taken as off: what is left of a level of one, its mean (1 - e^-2) / 2
    np.testing.assert_allclose(impulses[:6], WRENCHES[1] * PERIOD_S * 0.5 * (1.0 - math.exp(-2.0)), rtol=1e-12)
    for _ in range(20):
        impulses = _impulses(dut, context, [0.0, 1.0])
    np.testing.assert_allclose(impulses[:6], WRENCHES[1] * PERIOD_S, rtol=1e-12)


def test_an_outside_wrench_adds_over_the_interval_and_counts_as_firing() -> None:
    dut, context = _dut()
    dut.GetInputPort("outside_wrench").FixValue(context, [1.0, 0.0, -2.0, 0.0, 3.0, 0.0])
    impulses = _impulses(dut, context, [0.0, 0.0])
    np.testing.assert_allclose(impulses, [0.08, 0.0, -0.16, 0.0, 0.24, 0.0, 1.0, 1.0], rtol=1e-14)
    _impulses(dut, context, [1.0, 0.0])
    impulses = _impulses(dut, context, [1.0, 0.0])
    np.testing.assert_allclose(impulses[:6], [0.88, -1.6, 2.24, 0.08, 0.40, 0.24], rtol=1e-14)
    assert not dut.GetOutputPort("mean_level").Eval(context)[1:].any()


def test_the_mean_level_is_the_command_without_a_lag_and_the_lags_mean_with_it() -> None:
    for constant, expected in ((0.0, 1.0), (0.5 * PERIOD_S, 1.0 - 0.5 * (1.0 - math.exp(-2.0)))):
        dut, context = _dut(constant)
        dut.GetInputPort("jet_commands").FixValue(context, [0.0, 1.0])
        np.testing.assert_allclose(dut.GetOutputPort("mean_level").Eval(context), [0.0, expected], rtol=1e-14)
