"""The attitude reference: strapdown attitude, and what of it is held."""

from __future__ import annotations

from typing import Any

import numpy as np
from systems_probe import PERIOD_S, advance, feedthrough, inputs, outputs

from massprop_drake.systems.autopilot.attitude_reference import AttitudeReference

CAPTURE_RATE = 1e-3


def _dut() -> tuple[AttitudeReference, Any]:
    dut = AttitudeReference(period_s=PERIOD_S, capture_rate=CAPTURE_RATE)
    context = dut.CreateDefaultContext()
    dut.GetInputPort("hand_controllers").FixValue(context, np.zeros(6))
    dut.GetInputPort("gyro").FixValue(context, np.zeros(3))
    return dut, context


def _sample(dut: AttitudeReference, context: Any, gyro: list[float], rotation: list[float] | None = None) -> np.ndarray:
    """The error that belongs to a reading; the sample is then over."""
    dut.GetInputPort("gyro").FixValue(context, gyro)
    dut.GetInputPort("hand_controllers").FixValue(context, [*(rotation or [0.0] * 3), 0.0, 0.0, 0.0])
    error = dut.GetOutputPort("attitude_error").Eval(context)
    advance(dut, context)
    return error


def test_topology() -> None:
    dut, context = _dut()
    assert inputs(dut) == {"gyro": 3, "hand_controllers": 6}
    assert outputs(dut) == {"attitude_error": 3}
    # the controller at t_k acts on the reading at t_k
    assert feedthrough(dut) == {"attitude_error": {"gyro", "hand_controllers"}}
    assert context.get_discrete_state(0).size() == 14


def test_the_first_reading_turns_nothing() -> None:
    dut, context = _dut()
    np.testing.assert_array_equal(_sample(dut, context, [0.1, -0.2, 0.3]), np.zeros(3))


def test_the_error_at_a_sample_uses_the_reading_of_that_sample() -> None:
    # rate 0 at the first sample and 0.02 rad/s about x at the second: mean 0.01 rad/s for 0.08 s
    dut, context = _dut()
    _sample(dut, context, [0.0, 0.0, 0.0])
    error = _sample(dut, context, [0.02, 0.0, 0.0])
    np.testing.assert_allclose(error, [0.01 * PERIOD_S, 0.0, 0.0], rtol=1e-12, atol=1e-18)


def test_a_held_attitude_is_left_by_the_angle_turned_since() -> None:
    # constant 0.01 rad/s about a slanted axis for 10 samples: 0.008 rad about that axis
    dut, context = _dut()
    axis = np.array([2.0, -1.0, 2.0]) / 3.0
    for _ in range(10):
        _sample(dut, context, (0.01 * axis).tolist())
    error = _sample(dut, context, (0.01 * axis).tolist())
    np.testing.assert_allclose(error, 10 * PERIOD_S * 0.01 * axis, rtol=1e-12)


def test_an_axis_out_of_detent_has_no_error_and_leaves_the_others_alone() -> None:
    # while x is commanded it is free; y, in detent, keeps the error that it has
    dut, context = _dut()
    _sample(dut, context, [0.0, 0.0, 0.0])
    _sample(dut, context, [0.0, 5e-4, 0.0])
    error = _sample(dut, context, [0.01, 0.0, 0.0], rotation=[1.0, 0.0, 0.0])
    assert error[0] == 0.0
    # two samples of mean 2.5e-4 rad/s about y; what the small turn about x mixes in is of second order,
    # (4e-4 rad)(4e-5 rad) = 2e-8 of 4e-5
    np.testing.assert_allclose(error[1], 2 * 2.5e-4 * PERIOD_S, rtol=1e-3)


def test_back_in_detent_an_axis_holds_once_its_rate_is_below_the_capture_rate() -> None:
    dut, context = _dut()
    _sample(dut, context, [0.01, 0.0, 0.0])
    _sample(dut, context, [0.01, 0.0, 0.0], rotation=[1.0, 0.0, 0.0])
    # in detent but still turning: not held, no error
    assert _sample(dut, context, [0.01, 0.0, 0.0])[0] == 0.0
    assert _sample(dut, context, [2 * CAPTURE_RATE, 0.0, 0.0])[0] == 0.0
    # slow enough: held from this sample on, so what turned up to it counts, and all that follows
    slow = 0.5 * CAPTURE_RATE
    first = _sample(dut, context, [slow, 0.0, 0.0])[0]
    np.testing.assert_allclose(first, 0.5 * (2 * CAPTURE_RATE + slow) * PERIOD_S, rtol=1e-9)
    second = _sample(dut, context, [slow, 0.0, 0.0])[0]
    np.testing.assert_allclose(second - first, slow * PERIOD_S, rtol=1e-9)


def test_a_held_axis_stays_held_however_fast_it_turns() -> None:
    # the capture rate matters on the way to holding only: a disturbed hold is brought back
    dut, context = _dut()
    _sample(dut, context, [0.0, 0.0, 0.0])
    error = _sample(dut, context, [0.0, 0.0, 100 * CAPTURE_RATE])
    np.testing.assert_allclose(error, [0.0, 0.0, 50 * CAPTURE_RATE * PERIOD_S], rtol=1e-12, atol=1e-18)


def test_asking_for_the_output_changes_nothing() -> None:
    dut, context = _dut()
    _sample(dut, context, [0.0, 0.0, 0.0])
    dut.GetInputPort("gyro").FixValue(context, [0.02, 0.0, 0.0])
    before = context.get_discrete_state(0).CopyToVector()
    for _ in range(3):
        dut.GetOutputPort("attitude_error").Eval(context)
    np.testing.assert_array_equal(context.get_discrete_state(0).CopyToVector(), before)
