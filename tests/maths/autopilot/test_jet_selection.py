"""Activity vectors, and from on-times to whole cycles."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from massprop_drake.inputs.vehicle_file import Vehicle
from massprop_drake.maths.autopilot.jet_selection import (
    activity_vectors,
    burst_cycles,
    delivered_velocity,
    jet_forces,
    least_change,
    least_cycles,
    must_select,
)
from massprop_drake.maths.autopilot.phase_space import Request, Urgency

PERIOD = 0.08  # s


def test_activity_vectors_are_those_of_the_definition_jet_by_jet(orbiter: Vehicle) -> None:
    nominal, properties = orbiter.nominal, orbiter.nominal.vector()
    vectors = activity_vectors(orbiter.wrenches, properties)
    assert vectors.shape == (6, 44)
    for jet in range(44):
        arm = orbiter.positions[jet] - nominal.center_of_mass
        rotation = np.linalg.solve(nominal.inertia, np.cross(arm, orbiter.thrusts[jet]))
        expected = np.concatenate([rotation, orbiter.thrusts[jet] / nominal.mass])
        # differences of torques up to 1e5 lbf-ft in either way of computing; condition of the inertia 8
        assert_allclose(vectors[:, jet], expected, rtol=0.0, atol=1e-14 * np.abs(expected).max())
    command = np.zeros(44)
    command[[3, 17, 40]] = 1.0, 0.5, 1.0
    given = delivered_velocity(command, jet_forces(orbiter.wrenches), properties[9], PERIOD)
    assert_allclose(given, vectors[3:] @ command * PERIOD, rtol=1e-14)
    assert not delivered_velocity(np.zeros(44), jet_forces(orbiter.wrenches), properties[9], PERIOD).any()


@pytest.mark.parametrize(
    ("on_time_s", "minimum_s", "cycles"),
    [
        *((0.0, 0.0, 0), (0.0399, 0.0, 0), (0.0401, 0.0, 1), (0.119, 0.0, 1), (0.121, 0.0, 2), (8.0, 0.0, 100)),
        # a minimum of 0.2 s is 2.5 cycles: three; 0.24 s is exactly three whatever the rounding of 0.24 / 0.08
        *((0.03, 0.2, 0), (0.05, 0.2, 3), (0.17, 0.2, 3), (0.40, 0.2, 5), (0.05, 0.24, 3)),
    ],
)
def test_on_times_are_rounded_to_the_nearest_cycle_but_none_to_less_than_the_minimum(
    on_time_s: float, minimum_s: float, cycles: int
) -> None:
    least = least_cycles(np.array([minimum_s]), PERIOD)
    assert_array_equal(burst_cycles(np.array([on_time_s]), PERIOD, least), [cycles])
    assert_array_equal(burst_cycles(np.array([0.25, 0.75]), 0.5, np.zeros(2)), [1, 2])  # half a cycle is rounded up


def test_least_change_is_what_lifts_the_longest_on_time_to_half_a_cycle() -> None:
    request, on_times = np.array([1e-4, -3e-4, 2e-4, 0.0, 0.0, 0.0]), np.array([0.0, 0.01, 0.03])
    # longest 0.03 s must grow to 0.04 s: by a third, and 3e-4 / 3 = 1e-4 rad/s
    change = least_change(request, on_times, 0.5 * PERIOD)
    assert change == pytest.approx(1e-4, rel=1e-12)
    grown = on_times * (3e-4 + change) / 3e-4
    for factor, last in ((1.0 + 1e-9, 1), (1.0 - 1e-9, 0)):
        assert burst_cycles(grown * factor, PERIOD, np.zeros(3)).tolist() == [0, 0, last]
    assert least_change(request, np.zeros(3), 0.5 * PERIOD) == 0.0  # no firing at all: asked again at once


NOTHING, FIRING, MOVED = np.zeros(4), np.array([0.0, 2.0, 0.0, 1.0]), np.array([0.02, 0.0, 0.0])
NEAR = np.array([0.0, -0.009, 0.0])


@pytest.mark.parametrize(
    ("change", "urgency", "remaining", "acts", "declared", "expected"),
    [
        (MOVED, Urgency.NONE, NOTHING, False, False, False),
        (MOVED, Urgency.NONE, NOTHING, True, False, True),  # a known force is undone in every idle cycle
        (MOVED, Urgency.NONE, FIRING, True, False, False),
        (MOVED, Urgency.NONE, FIRING, False, True, True),  # whatever runs, a failure stops it
        (MOVED, Urgency.WHEN_IDLE, NOTHING, False, False, True),
        (MOVED, Urgency.WHEN_IDLE, FIRING, False, False, False),
        (MOVED, Urgency.AT_ONCE, FIRING, False, False, True),
        (NEAR, Urgency.WHEN_IDLE, NOTHING, False, False, False),  # what came to nothing waits until it has changed
        (NEAR, Urgency.WHEN_IDLE, NOTHING, True, False, True),
    ],
)
def test_when_jets_are_selected(
    change: np.ndarray, urgency: Urgency, remaining: np.ndarray, acts: bool, declared: bool, expected: bool
) -> None:
    refused = np.array([0.0, 0.0, 0.0, 0.01])  # asked before, and to change by so much
    request = Request(change, np.zeros(3), np.inf, urgency)
    assert must_select(remaining, request, refused, acts, declared) == expected
