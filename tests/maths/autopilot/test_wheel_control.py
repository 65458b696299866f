"""Reaction wheels that follow a rate, and what jets see of their momentum."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from massprop_drake.maths.autopilot.phase_space import PhaseSpaceParams
from massprop_drake.maths.autopilot.wheel_control import (
    WheelControlParams,
    must_unload,
    rate_for_jets,
    torque_shares,
    wheel_torques,
)

PYRAMID = np.array([[0.5, 0.5, 0.5], [0.5, -0.5, 0.5], [0.5, -0.5, -0.5], [0.5, 0.5, -0.5]]) / np.sqrt(0.75)
INERTIA = np.array([[50.0, -0.4, 0.6], [-0.4, 26.0, -0.3], [0.6, -0.3, 55.0]])
SETTINGS = PhaseSpaceParams(0.1, 0.01, 0.25, 0.0035, 0.001, 0.0005, 0.004, 1.0, 0.007, 0.4)
ERROR, RATE, SPEEDS = np.array([1e-3, -2e-3, 5e-4]), np.array([2e-3, 1e-3, -1e-3]), np.array([100.0, -50.0, 20.0, 5.0])
DETENT, AXES = np.zeros(3), np.eye(3)


def law(**changed: Any) -> WheelControlParams:
    # inertias, largest torque and speed, then the gain, thresholds and rate of unloading
    made = WheelControlParams(
        PYRAMID, torque_shares(PYRAMID), np.full(4, 0.006), np.full(4, 0.1), np.full(4, 400.0), INERTIA, 1.0, 0.5,
        0.2, 1e-3, SETTINGS,
    )  # fmt: skip
    return made._replace(**changed)


def test_the_vehicle_is_accelerated_toward_the_rate_that_holds_attitude() -> None:
    dut = law()
    torques = wheel_torques((DETENT, ERROR, RATE), SPEEDS, dut)
    gained = torques @ PYRAMID  # rate of change of the wheels' momentum
    momentum = INERTIA @ RATE + 0.006 * SPEEDS @ PYRAMID
    acceleration = np.linalg.solve(INERTIA, -gained - np.cross(RATE, momentum))
    np.testing.assert_allclose(acceleration, -0.25 * ERROR - RATE, rtol=1e-12)
    # and no motor works against another one
    np.testing.assert_allclose(np.array([1.0, -1.0, 1.0, -1.0]) @ torques, 0.0, atol=1e-15)


def test_torques_beyond_the_motors_keep_their_direction() -> None:
    turning = np.array([1.0, 0.0, -1.0]), np.zeros(3), np.zeros(3)
    wanted, given = (wheel_torques(turning, np.zeros(4), law(most=np.full(4, most))) for most in (1e3, 0.1))
    assert np.abs(given).max() == pytest.approx(0.1)
    np.testing.assert_allclose(given * np.abs(wanted).max() / 0.1, wanted, rtol=1e-12)


def test_a_wheel_is_made_no_faster_than_it_can_turn() -> None:
    near = np.array([399.5, -399.5, 0.0, 0.0])
    torques = wheel_torques((np.array([-1.0, -1.0, 0.0]), np.zeros(3), np.zeros(3)), near, law())
    assert torques[0] == pytest.approx(0.5 * 0.006 / 0.1)
    assert np.abs(near + torques * 0.1 / 0.006).max() <= 400.0 + 1e-9


def test_jets_begin_to_unload_above_one_share_and_end_below_another() -> None:
    found, unloading = [], False
    for fastest in (190.0, 210.0, 120.0, 90.0, 190.0):
        unloading = must_unload(unloading, np.array([0.0, -fastest, 0.0, 0.0]), law())
        found.append(unloading)
    assert found == [False, True, True, False, False]
    # wheels that turn against each other are not for jets
    against = 250.0 * np.array([1.0, -1.0, 1.0, -1.0])
    np.testing.assert_allclose(against @ PYRAMID, 0.0, atol=1e-12)
    assert not must_unload(True, against, law())


def test_jets_see_the_momentum_as_a_rate() -> None:
    assert rate_for_jets(RATE, False, SPEEDS, law()) is RATE
    momentum = 0.006 * SPEEDS @ PYRAMID
    seen = rate_for_jets(RATE, True, SPEEDS, law(unload_rate=1.0)) - RATE
    np.testing.assert_allclose(INERTIA @ seen, momentum, rtol=1e-9)
    limited = rate_for_jets(RATE, True, SPEEDS, law()) - RATE
    np.testing.assert_allclose(np.abs(limited).max(), 1e-3, rtol=1e-9)
    np.testing.assert_allclose(np.cross(limited, seen), 0.0, atol=1e-18)
    np.testing.assert_array_equal(rate_for_jets(RATE, True, np.zeros(4), law()), RATE)
