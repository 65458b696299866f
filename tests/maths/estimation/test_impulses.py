"""Impulses of commanded jets and the steady-combination gate."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from massprop_drake.inputs.vehicle_file import Vehicle
from massprop_drake.maths.estimation.impulses import Impulses, interval_impulses
from massprop_drake.maths.linear_algebra import Array
from massprop_drake.maths.vehicle.thrust import lag_factors, thrust_wrenches

PERIOD = 0.5  # s
# (1, 2, 3) x (0, 0, 10) = (20, -10, 0); (0, -1, 2) x (4, 0, 0) = (0, 8, 4)
WRENCHES = np.array([[20.0, -10.0, 0.0, 0.0, 0.0, 10.0], [0.0, 8.0, 4.0, 4.0, 0.0, 0.0]])
NAN, OFF, FIRST, BOTH = np.nan, [0.0, 0.0], [1.0, 0.0], [1.0, 1.0]
LAGGING, LEFT = np.array([0.5 * PERIOD, 0.0]), np.exp(-2.0)  # time constants; of the way left after a period
OUTSIDE = np.array([1.0, -2.0, 3.0, 0.5, 0.0, -0.25])


def impulses(
    command: list[float], before: list[float], outside: Array | None = None, level: Any = (0.0, 0.0), lag: bool = False
) -> Impulses:
    given = np.array(command), np.array(before), np.array(level)
    factors = lag_factors(LAGGING if lag else np.zeros(2), PERIOD)
    result = interval_impulses(*given, WRENCHES * PERIOD, factors, outside)
    assert_array_equal(given[0], command)  # what was commanded is not changed
    return result


@pytest.mark.parametrize(
    ("command", "outside", "expected", "firing"),
    [
        # half a second of both: torques (20, -2, 4) and forces (4, 0, 10), halved
        (BOTH, None, [10, -1, 2, 2, 0, 5], True),
        ([0.25, 0.0], None, [2.5, -1.25, 0, 0, 0, 1.25], True),  # a fraction of the impulse
        (OFF, None, [0] * 6, False),
        (OFF, np.zeros(6), [0] * 6, False),
        (OFF, OUTSIDE, OUTSIDE, True),  # counts as firing
        (FIRST, OUTSIDE, [11, -7, 3, 0.5, 0, 4.75], True),
        ([1.0, NAN], None, [10, -5, 0, 0, 0, 5], True),  # a jet that is not known is taken as off
        ([NAN, NAN], None, [0] * 6, False),
    ],
)
def test_impulses_of_hand_values(command: list[float], outside: Array | None, expected: Array, firing: bool) -> None:
    dut = impulses(command, command, outside)
    assert_array_equal([*dut.angular_impulse, *dut.linear_impulse], expected)
    assert dut.firing is firing
    for level in (dut.level, dut.mean_level):  # outside impulses are no thrust of a jet
        assert_array_equal(level, np.nan_to_num(command))


def test_sum_over_jets_is_that_of_the_definition_and_follows_the_origin(orbiter: Vehicle) -> None:
    # (2-45) and (2-46) jet by jet; r' -> r' + s: a -> a + s x lambda, lambda unchanged
    level, shift = np.random.default_rng(1).uniform(size=44), np.array([3.0, -20.0, 7.0])
    pushes = level[:, None] * orbiter.thrusts * 0.08
    for moved in (np.zeros(3), shift):
        wrenches = thrust_wrenches(orbiter.positions + moved, orbiter.thrusts)
        dut = interval_impulses(level, level, level, wrenches * 0.08, lag_factors(np.zeros(44), 0.08))
        assert_allclose(dut.linear_impulse, pushes.sum(axis=0), rtol=0.0, atol=44 * 72.0 * 2e-16)
        expected = np.cross(orbiter.positions, pushes).sum(axis=0) + np.cross(moved, pushes.sum(axis=0))
        assert_allclose(dut.angular_impulse, expected, rtol=0.0, atol=44 * 7e3 * 2e-16)


@pytest.mark.parametrize(
    ("command", "before", "usable"),
    [
        (FIRST, FIRST, True),
        (BOTH, BOTH, True),
        (OFF, OFF, True),  # the empty combination is steady too
        (FIRST, OFF, False),  # a jet was switched on
        (OFF, FIRST, False),
        (FIRST, [0.0, 1.0], False),  # as many jets, but others
        ([1.0, 0.5], [1.0, 0.5], False),  # steady, but part of the interval only
        ([0.5, 0.0], FIRST, False),
        # where a command is not known nothing is steady, nor in the next sample
        ([1.0, NAN], FIRST, False),
        (FIRST, [1.0, NAN], False),
        ([NAN, NAN], [NAN, NAN], False),
    ],
)
def test_gate_opens_for_an_unchanged_combination_of_whole_firings(
    command: list[float], before: list[float], usable: bool
) -> None:
    assert impulses(command, before).usable is usable
    assert impulses(command, before, OUTSIDE, lag=True).usable is usable  # whatever lags or acts from outside


def test_lag_holds_impulse_back_at_the_start_and_gives_it_after_the_end() -> None:
    # first jet: tau = T / 2, so from level 0 the mean over a period is 1 - (1 - e^-2) / 2 and the level after it
    # 1 - e^-2; then, switched off, the mean is (1 - e^-2) / 2 of that. Not known is off
    mean, level = 1.0 - 0.5 * (1.0 - LEFT), 1.0 - LEFT
    first = impulses(FIRST, OFF, lag=True)
    assert_allclose(first.linear_impulse, [0.0, 0.0, 5.0 * mean], rtol=1e-14)
    assert_allclose([first.level[0], first.mean_level[0]], [level, mean], rtol=1e-14)
    for command in (OFF, [NAN, 0.0]):
        second = impulses(command, FIRST, level=first.level, lag=True)
        assert_allclose(second.linear_impulse, [0.0, 0.0, 5.0 * 0.5 * level**2], rtol=1e-14)
        assert_allclose(second.level, [level * LEFT, 0.0], rtol=1e-14)
