"""On-times as pulses of at most a cycle."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from massprop_drake.maths.autopilot.pulses import (
    Pulses,
    burst_pulses,
    coming_pulse,
    max_edges,
    pulse_onsets,
    remaining_after_pulse,
    round_to_clock,
    valve_pulses,
    whole_cycle_pulses,
)

PERIOD = 0.1  # s


def valves(place: float = 0.0, *, accumulates: bool = True, minimum: float = 0.010, clock: float = 0.004) -> Pulses:
    return valve_pulses(np.full(1, minimum), np.full(1, clock), PERIOD, place, accumulates)


def flown(cycles: float, pulses: Pulses) -> list[float]:
    """Shares of the cycles in which an on-time is flown."""
    left, shares = np.full(1, cycles), []
    while left[0] > 0.0:
        shares.append(float((share := coming_pulse(left, pulses))[0]))
        left = remaining_after_pulse(left, share)
    return shares


def test_on_times_are_whole_steps_of_the_clock_and_so_is_the_minimum() -> None:
    assert_allclose(valves().least * PERIOD, 0.012, rtol=1e-12)
    assert_allclose(valves(clock=0.0).least * PERIOD, 0.010, rtol=1e-12)
    assert_allclose(valves(minimum=0.0).least * PERIOD, 0.004, rtol=1e-12)
    for on_time, expected in ((0.0, 0.0), (0.0139, 0.012), (0.0141, 0.016), (0.0999999, 0.1)):
        assert_allclose(round_to_clock(np.array([on_time / PERIOD]), valves()) * PERIOD, expected, atol=1e-15)


def test_a_long_on_time_is_flown_as_full_cycles_and_the_rest_or_in_equal_shares() -> None:
    assert_allclose(flown(2.36, valves()), [1.0, 1.0, 0.36], rtol=1e-12)
    assert flown(3.0, whole_cycle_pulses(1)) == [1.0, 1.0, 1.0]
    assert_allclose(flown(2.36, valves(0.5)), [0.8, 0.8, 0.76], rtol=1e-12)
    # each of which is long enough, or none is flown beyond full cycles
    for asked, given in ((1.3, 1.3), (1.1, 1.0)):
        rare = valves(0.5, minimum=0.06, clock=0.0)
        assert_allclose(burst_pulses(np.array([asked]), np.zeros(1), rare)[0], given)


def test_onsets_lie_where_the_vehicle_says_and_edges_are_foreseen() -> None:
    for place, expected, edges in ((0.0, 0.0, 1), (0.5, 0.03, 2), (1.0, 0.06, 1)):
        assert_allclose(pulse_onsets(np.array([0.4]), valves(place), PERIOD), expected, atol=1e-15)
        assert max_edges(valves(place)) == edges
    assert np.isnan(pulse_onsets(np.array([1.0]), whole_cycle_pulses(1), PERIOD)).all()
    assert max_edges(whole_cycle_pulses(3)) == 0


def test_what_is_too_short_is_dropped_or_adds_up_until_it_can_be_flown() -> None:
    remaining, owed = burst_pulses(np.array([0.08]), np.zeros(1), valves(accumulates=False))
    assert (remaining.item(), owed.item()) == (0.0, 0.0)
    pulses, given = valves(), []
    for _ in range(50):
        remaining, owed = burst_pulses(np.array([0.05]), owed, pulses)
        assert remaining.item() in (0.0, pulses.least.item())
        given.append(remaining.item())
    assert sum(given) + owed.item() == pytest.approx(50 * 0.05)
    assert max(given) > 0.0
    for asked in (0.0, 0.5):  # asked for no more; flown
        assert burst_pulses(np.array([asked]), np.array([0.09]), pulses)[1] == 0.0
