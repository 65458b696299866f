"""The phase-space controller: attitude by the gyro, commanded rates, and when it asks for jets."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from massprop_drake.maths.attitude import from_rotation_vector, multiply, propagate_attitude
from massprop_drake.maths.autopilot.phase_space import (
    AttitudeMemory,
    AttitudeStep,
    PhaseSpaceParams,
    Request,
    Sensed,
    TranslationMemory,
    Urgency,
    attitude_step,
    initial_memory,
    phase_space_request,
)

PERIOD = 0.08  # s
# discrete rate, hold gain and limit, capture rate, deadband; acceleration and horizon, rate and time of a new selection
SETTINGS = PhaseSpaceParams(PERIOD, 0.01, 0.2, 0.004, 0.001, 0.0005, 0.5, 2.0, 0.002, 0.4)
NONE, FORWARD, LEVEL = np.zeros(3), np.array([1.0, 0.0, 0.0]), np.array([1.0, 0.0, 0.0, 0.0])
IDLE = initial_memory().translation


def request(memory: TranslationMemory = IDLE, **sensed: Any) -> tuple[Request, TranslationMemory]:
    given = {name: np.asarray(sensed.get(name, NONE), dtype=float) for name in Sensed._fields}
    return phase_space_request(Sensed(**given), memory, SETTINGS)


@pytest.mark.parametrize(
    ("sensed", "change", "urgency"),
    [
        # an axis out of detent turns at the discrete rate whatever its attitude, another goes back in proportion to
        # its error, up to a limit, less the rate that is
        ({"rotation_command": [1, -1, 0], "attitude_error": [0.5, 0.5, 0]}, [0.01, -0.01, 0], Urgency.WHEN_IDLE),
        ({"attitude_error": [0.01, -0.005, 0]}, [-0.002, 0.001, 0], Urgency.WHEN_IDLE),
        ({"attitude_error": [1.0, -1.0, 0.0201]}, [-0.004, 0.004, -0.004], Urgency.WHEN_IDLE),
        (
            {"rotation_command": [1, 0, 0], "attitude_error": [0.3, 0.01, 0], "rate": [0.004, 0.001, -0.003]},
            [0.006, -0.003, 0.003],
            Urgency.WHEN_IDLE,
        ),
        *(({"rate": s * 0.000501 * np.eye(3)[k]}, -s * 0.000501 * np.eye(3)[k], 1) for k in range(3) for s in (1, -1)),
        ({"rate": [0.000499, -0.000499, 0]}, [-0.000499, 0.000499, 0], Urgency.NONE),  # within the deadband
    ],
)
def test_rate_requests_of_hand_value(sensed: dict[str, Any], change: list[float], urgency: Urgency) -> None:
    answer, memory = request(**sensed)
    assert_allclose(answer.rate_change, change, rtol=1e-12, atol=1e-18)
    assert_array_equal(answer.velocity_change, NONE)
    assert (answer.urgency, answer.time_limit_s, memory.horizon_left_s) == (urgency, np.inf, 0.0)


def test_a_translation_is_asked_for_at_once_and_what_is_delivered_is_taken_off() -> None:
    # 0.5 for 2 s: 1 along x, -1 along z
    command = np.array([1.0, 0.0, -1.0])
    answer, memory = request(translation_command=command, rate=[0.0, 0.0001, 0.0])
    assert (answer.urgency, answer.time_limit_s, memory.since_selection_s) == (Urgency.AT_ONCE, 2.0, 0.0)
    assert_array_equal(answer.velocity_change, command)
    assert_array_equal(answer.rate_change, [0.0, -0.0001, 0.0])
    for delivered in (0.04, 0.03):
        answer, memory = request(memory, translation_command=command, delivered=[delivered, 0.001, 0.0])
        assert answer.urgency == Urgency.NONE
    assert_allclose(answer.velocity_change, [0.93, -0.002, -1.0], rtol=1e-12)
    assert (answer.time_limit_s, memory.since_selection_s) == pytest.approx((1.84, 0.16), rel=1e-12)
    turned, _ = request(memory, translation_command=-command, delivered=[0.04, 0, 0])  # replaces the old one
    assert (turned.urgency, turned.velocity_change.tolist()) == (Urgency.AT_ONCE, [-1.0, 0.0, 1.0])
    released, memory = request(memory, delivered=[0.04, 0, 0])  # the velocity reached is kept
    assert (released.urgency, released.time_limit_s) == (Urgency.AT_ONCE, np.inf)
    assert not released.velocity_change.any()
    assert request(memory)[0].urgency == Urgency.NONE


@pytest.mark.parametrize(
    ("rate", "expected"),
    [
        (0.0, [0, 25, 50]),  # 2 s are 25 periods: then it is asked again for the whole velocity change
        (0.00199, [0, 25, 50]),  # beyond the deadband 0.0005, but below the 0.002 that ask for a new selection
        (0.00201, [*range(0, 25, 5), *range(25, 51, 5)]),  # 0.4 s are 5 periods since the last selection
    ],
)
def test_a_translation_is_asked_for_again(rate: float, expected: list[int]) -> None:
    memory, asked = IDLE, []
    for number in range(51):
        given = {"translation_command": FORWARD, "rate": [0.0, rate, 0.0], "delivered": 0.04 * FORWARD}
        answer, memory = request(memory, **given)
        if answer.urgency == Urgency.AT_ONCE:
            asked.append(number)
        assert answer.velocity_change[0] == pytest.approx(1.0 - 0.04 * (number % 25), rel=1e-9)
        assert answer.time_limit_s == pytest.approx(2.0 - PERIOD * (number % 25), rel=1e-9)
    assert asked == expected


def step(memory: AttitudeStep | None = None, before: Any = NONE, rate: Any = NONE, command: Any = NONE) -> AttitudeStep:
    memory = memory or AttitudeStep(LEVEL, LEVEL, NONE, np.ones(3))
    kept = AttitudeMemory(memory.attitude, memory.reference, memory.holding, np.asarray(before))
    return attitude_step(kept, np.asarray(rate), np.asarray(command), PERIOD, SETTINGS.capture_rate)


def test_attitude_integrates_the_mean_of_two_readings() -> None:
    before, rate = np.array([0.02, 0.0, 0.01]), np.array([0.04, 0.0, -0.03])
    answer = step(None, before, rate)
    assert_allclose(answer.attitude, propagate_attitude(LEVEL, 0.5 * (before + rate), PERIOD), rtol=1e-15)
    assert_allclose(answer.error, 0.5 * PERIOD * (before + rate), rtol=1e-12)
    assert_array_equal(answer.reference, LEVEL)
    first = attitude_step(initial_memory().attitude, rate, NONE, PERIOD, SETTINGS.capture_rate)
    assert_array_equal(first.attitude, LEVEL)  # the first reading turns nothing


def test_reference_follows_an_axis_out_of_detent_and_keeps_the_error_of_the_others() -> None:
    held, error = from_rotation_vector(np.array([0.5, -0.4, 0.3])), np.array([0.02, 0.01, -0.03])
    turned = AttitudeStep(multiply(held, from_rotation_vector(error)), held, NONE, np.ones(3))
    assert_allclose(step(turned).error, error, rtol=1e-12)  # the rotation from reference to body
    answer = step(turned, command=[0.0, 1.0, 0.0])
    assert_allclose(answer.error, [0.02, 0.0, -0.03], rtol=1e-12)
    assert_array_equal(answer.holding, [1, 0, 1])
    # seen from the new reference the body is turned by just what is left of the error
    assert_allclose(multiply(answer.reference, from_rotation_vector(answer.error)), answer.attitude, atol=1e-15)


@pytest.mark.parametrize(("rate", "holding"), [(0.00101, 0.0), (0.00099, 1.0), (-0.00101, 0.0), (-0.00099, 1.0)])
def test_released_axis_is_captured_once_it_is_slow_and_then_held(rate: float, holding: float) -> None:
    measured = np.array([0.0, 0.0, rate])
    answer = step(AttitudeStep(LEVEL, LEVEL, NONE, np.array([1.0, 1.0, 0.0])), measured, measured)
    assert answer.holding[2] == holding
    # a free axis has no error to go back to; a captured one starts from the error of this sample
    assert answer.error[2] == pytest.approx(holding * rate * PERIOD, rel=1e-9)
    assert_array_equal(step(None, [0.0, 0.0, 0.5], [0.0, 0.0, 0.5]).holding, np.ones(3))  # however fast it is pushed
