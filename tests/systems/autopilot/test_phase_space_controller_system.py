"""The phase-space controller: requests of the manual modes."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from systems_probe import PERIOD_S, advance, feedthrough, inputs, outputs

from massprop_drake.maths.autopilot.phase_space import PhaseSpaceParams, Urgency
from massprop_drake.systems.autopilot.phase_space_controller import PhaseSpaceController

SETTINGS = PhaseSpaceParams(
    period_s=PERIOD_S,
    discrete_rate=0.01,
    hold_gain=0.15,
    hold_rate_limit=0.002,
    capture_rate=0.001,
    rate_deadband=0.0005,
    acceleration=0.5,
    horizon_s=2.0,
    resolve_rate=0.004,
    resolve_after_s=0.4,
)


def _dut() -> tuple[PhaseSpaceController, Any]:
    dut = PhaseSpaceController(SETTINGS)
    return dut, dut.CreateDefaultContext()


def _request(
    dut: PhaseSpaceController,
    context: Any,
    *,
    rotation: tuple[float, ...] = (0.0, 0.0, 0.0),
    translation: tuple[float, ...] = (0.0, 0.0, 0.0),
    error: tuple[float, ...] = (0.0, 0.0, 0.0),
    rate: tuple[float, ...] = (0.0, 0.0, 0.0),
    delivered: tuple[float, ...] = (0.0, 0.0, 0.0),
) -> np.ndarray:
    """The request of one sample; the sample is then over."""
    dut.GetInputPort("hand_controllers").FixValue(context, [*rotation, *translation])
    dut.GetInputPort("attitude_error").FixValue(context, list(error))
    dut.GetInputPort("gyro").FixValue(context, list(rate))
    dut.GetInputPort("delivered").FixValue(context, list(delivered))
    request = dut.GetOutputPort("request").Eval(context)
    advance(dut, context)
    return request


def test_topology() -> None:
    dut, context = _dut()
    assert inputs(dut) == {"hand_controllers": 6, "attitude_error": 3, "gyro": 3, "delivered": 3}
    assert outputs(dut) == {"request": 8}
    assert feedthrough(dut) == {"request": {"hand_controllers", "attitude_error", "gyro", "delivered"}}
    assert context.get_discrete_state(0).size() == 8


def test_at_rest_and_in_detent_nothing_is_asked() -> None:
    dut, context = _dut()
    np.testing.assert_array_equal(_request(dut, context), [0.0] * 6 + [np.inf, Urgency.NONE])


def test_the_rotational_hand_controller_asks_for_the_discrete_rate_less_the_rate_that_is() -> None:
    dut, context = _dut()
    request = _request(dut, context, rotation=(1.0, 0.0, -1.0), rate=(0.004, 0.0, 0.001))
    np.testing.assert_allclose(request[:3], [0.006, 0.0, -0.011], rtol=1e-12)
    np.testing.assert_array_equal(request[3:], [0.0, 0.0, 0.0, np.inf, Urgency.WHEN_IDLE])


@pytest.mark.parametrize(("rate", "urgency"), [(0.00049, Urgency.NONE), (0.00051, Urgency.WHEN_IDLE)])
def test_a_rate_error_within_the_deadband_asks_for_nothing(rate: float, urgency: float) -> None:
    dut, context = _dut()
    request = _request(dut, context, rate=(0.0, -rate, 0.0))
    np.testing.assert_allclose(request[1], rate, rtol=1e-12)
    assert request[7] == urgency


def test_attitude_hold_commands_a_rate_in_proportion_to_the_error_up_to_a_limit() -> None:
    dut, context = _dut()
    # 0.15 / s x 0.01 rad = 0.0015 rad/s back; 0.15 / s x 0.02 rad is beyond the limit of 0.002 rad/s
    request = _request(dut, context, error=(0.01, -0.02, 0.0))
    np.testing.assert_allclose(request[:3], [-0.0015, 0.002, 0.0], rtol=1e-12)
    assert request[7] == Urgency.WHEN_IDLE


def test_a_translation_is_asked_for_at_once_over_the_horizon() -> None:
    dut, context = _dut()
    # 0.5 ft/s^2 for 2 s
    request = _request(dut, context, translation=(0.0, -1.0, 0.0), rate=(0.0, 0.0, 0.0003))
    np.testing.assert_allclose(request[:6], [0.0, 0.0, -0.0003, 0.0, -1.0, 0.0], rtol=1e-12)
    np.testing.assert_array_equal(request[6:], [2.0, Urgency.AT_ONCE])


def test_during_a_translation_what_was_delivered_is_taken_off() -> None:
    dut, context = _dut()
    _request(dut, context, translation=(1.0, 0.0, 0.0))
    second = _request(dut, context, translation=(1.0, 0.0, 0.0), delivered=(0.03, 0.01, 0.0))
    np.testing.assert_allclose(second[3:], [0.97, -0.01, 0.0, 2.0 - PERIOD_S, Urgency.NONE], rtol=1e-12)
    third = _request(dut, context, translation=(1.0, 0.0, 0.0), delivered=(0.04, 0.0, 0.0))
    np.testing.assert_allclose(third[3:], [0.93, -0.01, 0.0, 2.0 - 2 * PERIOD_S, Urgency.NONE], rtol=1e-12)


def test_a_translation_longer_than_the_horizon_is_asked_for_again() -> None:
    dut, context = _dut()
    urgencies = [_request(dut, context, translation=(1.0, 0.0, 0.0))[7] for _ in range(60)]
    # 2 s are 25 samples
    assert [sample for sample, urgency in enumerate(urgencies) if urgency == Urgency.AT_ONCE] == [0, 25, 50]


def test_a_rate_error_during_a_translation_is_corrected_after_a_pause() -> None:
    dut, context = _dut()
    turning = (0.0041, 0.0, 0.0)
    urgencies = [_request(dut, context, translation=(1.0, 0.0, 0.0), rate=turning)[7] for _ in range(12)]
    # 0.4 s are 5 samples
    assert [sample for sample, urgency in enumerate(urgencies) if urgency == Urgency.AT_ONCE] == [0, 5, 10]


def test_a_change_of_the_translation_command_is_asked_for_at_once() -> None:
    dut, context = _dut()
    _request(dut, context, translation=(1.0, 0.0, 0.0))
    _request(dut, context, translation=(1.0, 0.0, 0.0), delivered=(0.1, 0.0, 0.0))
    request = _request(dut, context, translation=(1.0, 0.0, 1.0), delivered=(0.1, 0.0, 0.0))
    np.testing.assert_allclose(request[3:], [1.0, 0.0, 1.0, 2.0, Urgency.AT_ONCE], rtol=1e-12)


def test_on_release_the_rest_of_a_translation_is_dropped_at_once() -> None:
    dut, context = _dut()
    _request(dut, context, translation=(1.0, 0.0, 0.0))
    request = _request(dut, context, rate=(0.0, 0.0, 0.0001))
    np.testing.assert_allclose(request, [0.0, 0.0, -0.0001, 0.0, 0.0, 0.0, np.inf, Urgency.AT_ONCE], rtol=1e-12)
    # and only once
    assert _request(dut, context)[7] == Urgency.NONE
