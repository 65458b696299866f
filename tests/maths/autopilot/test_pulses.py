"""On-times as pulses of at most a cycle."""

from __future__ import annotations

import numpy as np
import pytest

from massprop_drake.maths.autopilot.pulses import (
    Pulses,
    after_pulse,
    burst_pulses,
    clocked,
    coming_pulse,
    most_edges,
    pulse_onsets,
    valve_pulses,
    whole_cycles,
)

PERIOD = 0.1  # s
MINIMUM, CLOCK = 0.010, 0.004  # s; the least whole number of steps is 12 ms


def valves(place: float = 0.0, *, accumulates: bool = True, minimum: float = MINIMUM, clock: float = CLOCK) -> Pulses:
    return valve_pulses(np.full(1, minimum), np.full(1, clock), PERIOD, place, accumulates)


def flown(cycles: float, pulses: Pulses) -> list[float]:
    """Shares of the cycles in which an on-time is flown."""
    left, shares = np.full(1, cycles), []
    while left[0] > 0.0:
        share = coming_pulse(left, pulses)
        shares.append(float(share[0]))
        left = after_pulse(left, share)
    return shares


def test_the_minimum_is_raised_to_the_clock() -> None:
    np.testing.assert_allclose(valves().least * PERIOD, 0.012, rtol=1e-12)
    np.testing.assert_allclose(valves(clock=0.0).least * PERIOD, MINIMUM, rtol=1e-12)
    np.testing.assert_allclose(valves(minimum=0.0).least * PERIOD, CLOCK, rtol=1e-12)


@pytest.mark.parametrize(("on_time", "expected"), [(0.0, 0.0), (0.0139, 0.012), (0.0141, 0.016), (0.0999999, 0.1)])
def test_on_times_are_whole_steps_of_the_clock(on_time: float, expected: float) -> None:
    np.testing.assert_allclose(clocked(np.array([on_time / PERIOD]), valves()) * PERIOD, expected, atol=1e-15)


def test_a_long_on_time_is_flown_as_full_cycles_and_the_rest() -> None:
    np.testing.assert_allclose(flown(2.36, valves()), [1.0, 1.0, 0.36], rtol=1e-12)
    assert flown(3.0, whole_cycles(1)) == [1.0, 1.0, 1.0]


def test_elsewhere_in_the_cycle_it_is_flown_in_equal_shares() -> None:
    shares = flown(2.36, valves(0.5))
    np.testing.assert_allclose(shares, [0.8, 0.8, 0.76], rtol=1e-12)
    # each of which is long enough, or none is flown beyond full cycles
    long, none = valves(0.5, minimum=0.06, clock=0.0), np.zeros(1)
    np.testing.assert_allclose(burst_pulses(np.array([1.3]), none, long)[0], 1.3)
    np.testing.assert_allclose(burst_pulses(np.array([1.1]), none, long)[0], 1.0)


@pytest.mark.parametrize(("place", "expected"), [(0.0, 0.0), (0.5, 0.03), (1.0, 0.06)])
def test_onsets_lie_where_the_vehicle_says(place: float, expected: float) -> None:
    np.testing.assert_allclose(pulse_onsets(np.array([0.4]), valves(place), PERIOD), expected, atol=1e-15)
    assert np.isnan(pulse_onsets(np.array([1.0]), whole_cycles(1), PERIOD)).all()


def test_what_is_too_short_is_dropped() -> None:
    remaining, owed = burst_pulses(np.array([0.08]), np.zeros(1), valves(accumulates=False))
    assert (remaining.item(), owed.item()) == (0.0, 0.0)


def test_what_is_too_short_adds_up_until_it_can_be_flown() -> None:
    pulses, owed, given = valves(), np.zeros(1), []
    for _ in range(50):
        remaining, owed = burst_pulses(np.array([0.05]), owed, pulses)
        assert remaining.item() in (0.0, pulses.least.item())
        given.append(remaining.item())
    assert sum(given) + owed.item() == pytest.approx(50 * 0.05)
    assert max(given) > 0.0
    assert burst_pulses(np.array([0.0]), np.array([0.09]), pulses)[1] == 0.0  # asked for no more
    assert burst_pulses(np.array([0.5]), np.array([0.09]), pulses)[1] == 0.0  # flown


def test_edges_are_foreseen() -> None:
    assert (most_edges(whole_cycles(3)), most_edges(valves()), most_edges(valves(0.5))) == (0, 1, 2)
