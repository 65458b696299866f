"""Activity vectors, and from on-times to whole cycles."""

from __future__ import annotations

import numpy as np
import pytest

from massprop_drake.inputs.vehicle_file import Vehicle
from massprop_drake.maths.autopilot.jet_selection import (
    activity_vectors,
    burst_cycles,
    delivered_velocity,
    forces_of,
    least_change,
    least_cycles,
    must_select,
)
from massprop_drake.maths.autopilot.phase_space import Request, Urgency
from massprop_drake.maths.autopilot.pulses import coming_pulse, whole_cycles
from massprop_drake.maths.mass_properties import MassProperties
from massprop_drake.maths.vehicle.thrust import thrust_wrenches

PERIOD = 0.08  # s


def test_activity_vector_of_hand_value() -> None:
    # arm (1, 2, 3) - (1, 1, 1) = (0, 1, 2); (0, 1, 2) x (0, 0, 10) = (10, 0, 0)
    # I^-1 = [[1/2, 1/10, 0], [1/10, 1/4, 0], [0, 0, 1/5]]: first column times 10; 10 / 4 along z
    properties = np.array([0.5, 0.25, 0.2, 0.0, 0.0, 0.1, 1.0, 1.0, 1.0, 0.25])
    wrenches = thrust_wrenches(np.array([[1.0, 2.0, 3.0]]), np.array([[0.0, 0.0, 10.0]]))
    np.testing.assert_allclose(activity_vectors(wrenches, properties), [[5], [1], [0], [0], [0], [2.5]], rtol=1e-15)


def test_activity_vectors_are_those_of_the_definition_jet_by_jet(orbiter: Vehicle) -> None:
    nominal: MassProperties = orbiter.nominal
    vectors = activity_vectors(orbiter.wrenches, nominal.vector())
    assert vectors.shape == (6, 44)
    for jet in range(44):
        arm = orbiter.positions[jet] - nominal.center_of_mass
        rotation = np.linalg.solve(nominal.inertia, np.cross(arm, orbiter.thrusts[jet]))
        expected = np.concatenate([rotation, orbiter.thrusts[jet] / nominal.mass])
        # differences of torques up to 1e5 lbf-ft in either way of computing; condition of the inertia 8
        np.testing.assert_allclose(vectors[:, jet], expected, rtol=0.0, atol=1e-14 * np.abs(expected).max())


@pytest.mark.parametrize(
    ("on_time", "cycles"),
    [(0.0, 0), (0.0399, 0), (0.0401, 1), (0.08, 1), (0.119, 1), (0.121, 2), (8.0, 100)],
)
def test_on_time_is_rounded_to_the_nearest_cycle(on_time: float, cycles: int) -> None:
    np.testing.assert_array_equal(burst_cycles(np.array([on_time]), PERIOD, np.zeros(1)), [cycles])


def test_half_a_cycle_is_rounded_up() -> None:
    np.testing.assert_array_equal(burst_cycles(np.array([0.25, 0.75, 1.25]), 0.5, np.zeros(3)), [1, 2, 3])


def test_short_firing_is_raised_to_the_jets_minimum_but_none_is_not() -> None:
    # minimum 0.2 s is 2.5 cycles: three; 0.24 s is exactly three whatever the rounding of 0.24 / 0.08
    on_times = np.array([0.03, 0.05, 0.17, 0.40, 0.05])
    minimum = np.array([0.20, 0.20, 0.20, 0.20, 0.24])
    np.testing.assert_array_equal(burst_cycles(on_times, PERIOD, least_cycles(minimum, PERIOD)), [0, 3, 3, 5, 3])


def test_least_change_is_what_lifts_the_longest_on_time_to_half_a_cycle() -> None:
    request = np.array([1e-4, -3e-4, 2e-4, 0.0, 0.0, 0.0])
    on_times = np.array([0.0, 0.01, 0.03])
    # longest 0.03 s must grow to 0.04 s: by a third, and 3e-4 / 3 = 1e-4 rad/s
    change = least_change(request, on_times, 0.5 * PERIOD)
    assert change == pytest.approx(1e-4, rel=1e-12)
    grown = on_times * (3e-4 + change) / 3e-4
    assert burst_cycles(grown * (1.0 + 1e-9), PERIOD, np.zeros(3)).tolist() == [0, 0, 1]
    assert burst_cycles(grown * (1.0 - 1e-9), PERIOD, np.zeros(3)).tolist() == [0, 0, 0]


def test_answer_without_any_firing_may_be_asked_for_again_at_once() -> None:
    assert least_change(np.array([1e-4, 0.0, 0.0, 0.0, 0.0, 0.0]), np.zeros(3), 0.5 * PERIOD) == 0.0


NOTHING, FIRING, MOVED = np.zeros(4), np.array([0.0, 2.0, 0.0, 1.0]), np.array([0.02, 0.0, 0.0])
REFUSED = np.array([0.0, 0.0, 0.0, 0.01])  # asked before, and to change by so much


@pytest.mark.parametrize(
    ("urgency", "remaining", "acts", "declared", "expected"),
    [
        (Urgency.NONE, NOTHING, False, False, False),
        (Urgency.NONE, NOTHING, True, False, True),  # a known force is undone in every idle cycle
        (Urgency.NONE, FIRING, True, False, False),
        (Urgency.NONE, FIRING, False, True, True),  # whatever runs, a failure stops it
        (Urgency.WHEN_IDLE, NOTHING, False, False, True),
        (Urgency.WHEN_IDLE, FIRING, False, False, False),
        (Urgency.AT_ONCE, FIRING, False, False, True),
    ],
)
def test_when_jets_are_selected(
    urgency: Urgency, remaining: np.ndarray, acts: bool, declared: bool, expected: bool
) -> None:
    request = Request(MOVED, np.zeros(3), np.inf, urgency)
    assert must_select(remaining, request, REFUSED, acts, declared) == expected


def test_a_request_that_came_to_nothing_waits_until_it_has_changed() -> None:
    near = Request(np.array([0.0, -0.009, 0.0]), np.zeros(3), np.inf, Urgency.WHEN_IDLE)
    assert not must_select(NOTHING, near, REFUSED, acts=False, declared=False)
    assert must_select(NOTHING, near, REFUSED, acts=True, declared=False)


def test_what_a_command_gives_is_what_its_activity_vectors_say(orbiter: Vehicle) -> None:
    properties = orbiter.nominal.vector()
    remaining = np.zeros(44)
    remaining[[3, 17, 40]] = 1.0, 5.0, 2.0
    command = coming_pulse(remaining, whole_cycles(44))
    assert command.sum() == 3.0
    given = delivered_velocity(command, forces_of(orbiter.wrenches), properties[9], PERIOD)
    expected = activity_vectors(orbiter.wrenches, properties)[3:] @ command * PERIOD
    np.testing.assert_array_equal(given, expected)
    assert not delivered_velocity(np.zeros(44), forces_of(orbiter.wrenches), properties[9], PERIOD).any()
