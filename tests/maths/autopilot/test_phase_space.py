"""The phase-space controller: attitude by the gyro, commanded rates, and when it asks for jets."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from massprop_drake.maths.attitude import from_rotation_vector, multiply, propagated
from massprop_drake.maths.autopilot.phase_space import (
    AttitudeMemory,
    AttitudeStep,
    PhaseSpaceParams,
    Request,
    Sensed,
    TranslationMemory,
    Urgency,
    attitude_step,
    commanded_rate,
    phase_space_request,
)
from massprop_drake.maths.linear_algebra import Array

PERIOD = 0.08  # s
SETTINGS = PhaseSpaceParams(
    period_s=PERIOD,
    discrete_rate=0.01,
    hold_gain=0.2,
    hold_rate_limit=0.004,
    capture_rate=0.001,
    rate_deadband=0.0005,
    acceleration=0.5,
    horizon_s=2.0,
    resolve_rate=0.002,
    resolve_after_s=0.4,
)
NONE = np.zeros(3)
IDLE = TranslationMemory(NONE, NONE, 0.0, 0.0)
FORWARD = np.array([1.0, 0.0, 0.0])
LEVEL = np.array([1.0, 0.0, 0.0, 0.0])  # attitude
HOLDING = np.ones(3)


def request(
    rotation: Array = NONE,
    translation: Array = NONE,
    error: Array = NONE,
    rate: Array = NONE,
    delivered: Array = NONE,
    memory: TranslationMemory = IDLE,
) -> tuple[Request, TranslationMemory]:
    return phase_space_request(Sensed(rotation, translation, error, rate, delivered), memory, SETTINGS)


def step(
    attitude: Array = LEVEL,
    reference: Array = LEVEL,
    holding: Array = HOLDING,
    before: Array = NONE,
    rate: Array = NONE,
    command: Array = NONE,
) -> AttitudeStep:
    memory = AttitudeMemory(attitude, reference, holding, before)
    return attitude_step(memory, rate, command, PERIOD, SETTINGS.capture_rate)


def test_axis_out_of_detent_turns_at_the_discrete_rate_whatever_its_attitude() -> None:
    rate = commanded_rate(np.array([1.0, -1.0, 0.0]), np.array([0.5, 0.5, 0.0]), SETTINGS)
    np.testing.assert_array_equal(rate, [0.01, -0.01, 0.0])


def test_axis_in_detent_turns_back_in_proportion_to_its_error() -> None:
    rate = commanded_rate(NONE, np.array([0.01, -0.005, 0.0]), SETTINGS)
    np.testing.assert_allclose(rate, [-0.002, 0.001, 0.0], rtol=1e-15)


def test_rate_back_to_the_held_attitude_is_limited_either_way() -> None:
    np.testing.assert_array_equal(commanded_rate(NONE, np.array([1.0, -1.0, 0.0201]), SETTINGS), [-4e-3, 4e-3, -4e-3])


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_rate_error_of_any_axis_beyond_the_deadband_asks_once_jets_are_idle(axis: int, sign: float) -> None:
    rate = np.zeros(3)
    rate[axis] = sign * 0.000501
    answer, memory = request(rate=rate)
    assert answer.urgency == Urgency.WHEN_IDLE
    assert answer.time_limit_s == np.inf
    np.testing.assert_array_equal(answer.rate_change, -rate)
    np.testing.assert_array_equal(answer.velocity_change, NONE)
    assert memory.horizon_left_s == 0.0


def test_rate_error_within_the_deadband_asks_for_nothing() -> None:
    answer, _ = request(rate=np.array([0.000499, -0.000499, 0.0]))
    assert answer.urgency == Urgency.NONE


def test_rate_change_is_commanded_minus_measured_rate() -> None:
    # x: discrete rate 0.01; y: back from an error of 0.01 at -0.002; z: held
    answer, _ = request(FORWARD, error=np.array([0.3, 0.01, 0.0]), rate=np.array([0.004, 0.001, -0.003]))
    np.testing.assert_allclose(answer.rate_change, [0.006, -0.003, 0.003], rtol=1e-12)


def test_translation_starts_at_once_for_a_horizon_of_its_acceleration() -> None:
    # 0.5 for 2 s: 1 along x, -1 along z
    command = np.array([1.0, 0.0, -1.0])
    answer, memory = request(translation=command)
    assert answer.urgency == Urgency.AT_ONCE
    np.testing.assert_array_equal(answer.velocity_change, command)
    np.testing.assert_array_equal(answer.rate_change, NONE)
    assert answer.time_limit_s == 2.0
    np.testing.assert_array_equal(memory.command, command)
    np.testing.assert_array_equal(memory.velocity_left, command)
    assert memory.horizon_left_s == 2.0
    assert memory.since_selection_s == 0.0


def test_translation_request_carries_the_rate_error_along() -> None:
    answer, _ = request(translation=FORWARD, rate=np.array([0.0, 0.0001, 0.0]))
    np.testing.assert_array_equal(answer.rate_change, [0.0, -0.0001, 0.0])


def test_delivered_velocity_is_subtracted_and_time_runs() -> None:
    _, memory = request(translation=FORWARD)
    for delivered in (0.04, 0.03):
        answer, memory = request(translation=FORWARD, delivered=np.array([delivered, 0.001, 0.0]), memory=memory)
        assert answer.urgency == Urgency.NONE
    # 1 - 0.04 - 0.03 left, and what came sideways to be undone; 2 - 2 * 0.08 s left
    np.testing.assert_allclose(answer.velocity_change, [0.93, -0.002, 0.0], rtol=1e-12)
    assert answer.time_limit_s == pytest.approx(1.84, rel=1e-12)
    assert memory.since_selection_s == pytest.approx(0.16, rel=1e-12)


def test_horizon_is_renewed_when_it_has_run_out() -> None:
    # 2 s are 25 periods: the 25th sample after the start asks again, for the whole velocity change
    memory = IDLE
    asked = []
    for number in range(51):
        answer, memory = request(translation=FORWARD, delivered=0.04 * FORWARD, memory=memory)
        if answer.urgency == Urgency.AT_ONCE:
            asked.append(number)
            np.testing.assert_array_equal(answer.velocity_change, FORWARD)
            assert answer.time_limit_s == 2.0
    assert asked == [0, 25, 50]


def test_another_translation_command_replaces_the_old_one_at_once() -> None:
    _, memory = request(translation=FORWARD)
    answer, memory = request(translation=-FORWARD, delivered=0.04 * FORWARD, memory=memory)
    assert answer.urgency == Urgency.AT_ONCE
    np.testing.assert_array_equal(answer.velocity_change, -FORWARD)
    np.testing.assert_array_equal(memory.command, -FORWARD)


def test_large_rate_error_in_a_translation_asks_again_but_not_too_often() -> None:
    # 0.4 s are 5 periods since the last selection
    rate = np.array([0.0, 0.00201, 0.0])
    memory = IDLE
    asked = []
    for number in range(13):
        answer, memory = request(translation=FORWARD, rate=rate, delivered=0.04 * FORWARD, memory=memory)
        if answer.urgency == Urgency.AT_ONCE:
            asked.append(number)
    assert asked == [0, 5, 10]
    # asked again for what was left after ten samples, within the same horizon
    np.testing.assert_allclose(memory.velocity_left, [1.0 - 12 * 0.04, 0.0, 0.0], rtol=1e-12)
    assert memory.horizon_left_s == pytest.approx(2.0 - 12 * PERIOD, rel=1e-12)


def test_small_rate_error_in_a_translation_is_left_until_the_next_selection() -> None:
    # beyond the deadband 0.0005, but below the 0.002 that ask for a new selection
    rate = np.array([0.0, 0.00199, 0.0])
    memory = IDLE
    urgencies = []
    for _ in range(13):
        answer, memory = request(translation=FORWARD, rate=rate, memory=memory)
        urgencies.append(answer.urgency)
    assert urgencies == [Urgency.AT_ONCE] + [Urgency.NONE] * 12


def test_release_of_the_translation_replaces_the_running_burst_at_once() -> None:
    _, memory = request(translation=FORWARD)
    answer, memory = request(delivered=0.04 * FORWARD, memory=memory)
    assert answer.urgency == Urgency.AT_ONCE
    np.testing.assert_array_equal(answer.velocity_change, NONE)  # the velocity reached is kept
    assert answer.time_limit_s == np.inf
    np.testing.assert_array_equal(memory.velocity_left, NONE)
    answer, _ = request(memory=memory)
    assert answer.urgency == Urgency.NONE


def test_attitude_of_a_constant_rate_is_exact() -> None:
    # 100 samples of 0.08 s at a constant body rate are one rotation of 8 s times the rate
    rate = np.array([0.02, -0.05, 0.03])
    attitude = from_rotation_vector(np.array([0.3, 0.2, -0.1]))
    expected = multiply(attitude, from_rotation_vector(8.0 * rate))
    for _ in range(100):
        attitude = step(attitude=attitude, before=rate, rate=rate).attitude
    np.testing.assert_allclose(attitude, expected, rtol=0.0, atol=1e-13)  # a hundred roundings


def test_attitude_uses_the_mean_of_the_two_readings() -> None:
    before, rate = np.array([0.02, 0.0, 0.0]), np.array([0.04, 0.0, 0.0])
    answer = step(before=before, rate=rate)
    np.testing.assert_allclose(answer.attitude, propagated(LEVEL, np.array([0.03, 0.0, 0.0]), PERIOD), rtol=1e-15)


def test_holding_axes_keep_their_reference_and_gather_the_error() -> None:
    rate = np.array([0.02, -0.05, 0.03])
    answer = step(before=rate, rate=rate)
    np.testing.assert_array_equal(answer.reference, LEVEL)
    np.testing.assert_allclose(answer.error, PERIOD * rate, rtol=1e-12)
    np.testing.assert_array_equal(answer.holding, HOLDING)


def test_error_is_the_rotation_from_reference_to_body() -> None:
    reference = from_rotation_vector(np.array([0.5, -0.4, 0.3]))
    error = np.array([0.02, 0.01, -0.03])
    answer = step(attitude=multiply(reference, from_rotation_vector(error)), reference=reference)
    np.testing.assert_allclose(answer.error, error, rtol=1e-12)


def test_reference_follows_an_axis_out_of_detent_and_keeps_the_error_of_the_others() -> None:
    error = np.array([0.02, 0.01, -0.03])
    answer = step(attitude=from_rotation_vector(error), command=np.array([0.0, 1.0, 0.0]))
    np.testing.assert_allclose(answer.error, [0.02, 0.0, -0.03], rtol=1e-12)
    np.testing.assert_array_equal(answer.holding, [1, 0, 1])
    # seen from the new reference the body is turned by just what is left of the error
    np.testing.assert_allclose(
        multiply(answer.reference, from_rotation_vector(answer.error)), answer.attitude, rtol=0.0, atol=1e-15
    )


@pytest.mark.parametrize(("rate", "holding"), [(0.00101, 0.0), (0.00099, 1.0), (-0.00101, 0.0), (-0.00099, 1.0)])
def test_released_axis_is_captured_once_it_is_slow(rate: float, holding: float) -> None:
    measured = np.array([0.0, 0.0, rate])
    answer = step(before=measured, rate=measured, holding=np.array([1.0, 1.0, 0.0]))
    assert answer.holding[2] == holding
    # a free axis has no error to go back to; a captured one starts from the error of this sample
    assert answer.error[2] == pytest.approx(holding * rate * PERIOD, rel=1e-9)


def test_captured_axis_holds_however_fast_it_is_pushed_later() -> None:
    rate = np.array([0.0, 0.0, 0.5])
    np.testing.assert_array_equal(step(before=rate, rate=rate).holding, HOLDING)


def test_released_axis_holds_the_attitude_at_capture() -> None:
    # slewed about x, then released and slowed down: the error counts from where it was last free
    memory = step(command=FORWARD, before=np.array([0.01, 0.0, 0.0]), rate=np.array([0.01, 0.0, 0.0]))
    speeds = [0.01, 0.006, 0.002, 0.0009, 0.0005]
    for before, speed in pairwise(speeds):
        memory = step(
            memory.attitude,
            memory.reference,
            memory.holding,
            np.array([before, 0.0, 0.0]),
            np.array([speed, 0.0, 0.0]),
        )
    # captured at 0.0009: samples with mean rates 0.00145 and 0.0007 count
    assert memory.holding[0] == 1.0
    assert memory.error[0] == pytest.approx(PERIOD * (0.00145 + 0.0007), rel=1e-12)


def test_axis_in_command_does_not_hold_even_when_slow() -> None:
    np.testing.assert_array_equal(step(command=np.array([0.0, 0.0, -1.0])).holding, [1, 1, 0])
