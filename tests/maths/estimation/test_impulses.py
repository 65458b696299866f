"""Impulses of commanded jets and the steady-combination gate."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from massprop_drake.inputs.vehicle_file import Vehicle
from massprop_drake.maths.estimation.impulses import interval_impulses
from massprop_drake.maths.linear_algebra import Array
from massprop_drake.maths.vehicle.thrust import lag_factors, thrust_wrenches

PERIOD = 0.5  # s
POSITIONS = np.array([[1.0, 2.0, 3.0], [0.0, -1.0, 2.0]])
THRUSTS = np.array([[0.0, 0.0, 10.0], [4.0, 0.0, 0.0]])
NO_LAG = lag_factors(np.zeros(2), PERIOD)


def per_level(positions: Array = POSITIONS, thrusts: Array = THRUSTS) -> Array:
    return thrust_wrenches(positions, thrusts) * PERIOD


def test_wrenches_of_hand_value() -> None:
    # (1, 2, 3) x (0, 0, 10) = (20, -10, 0); (0, -1, 2) x (4, 0, 0) = (0, 8, 4)
    wrenches = thrust_wrenches(POSITIONS, THRUSTS)
    np.testing.assert_array_equal(wrenches, [[20, -10, 0, 0, 0, 10], [0, 8, 4, 4, 0, 0]])


def test_impulses_of_two_jets_of_hand_value() -> None:
    # half a second of both: torques (20, -2, 4) and forces (4, 0, 10), halved
    on = np.ones(2)
    impulses = interval_impulses(on, on, on, per_level(), NO_LAG)
    np.testing.assert_array_equal(impulses.angular_impulse, [10, -1, 2])
    np.testing.assert_array_equal(impulses.linear_impulse, [2, 0, 5])
    np.testing.assert_array_equal(impulses.level, on)
    assert impulses.usable
    assert impulses.firing


def test_fractional_command_gives_its_fraction_of_the_impulse() -> None:
    # a quarter of the first jet, nothing of the second
    impulses = interval_impulses(np.array([0.25, 0.0]), np.zeros(2), np.zeros(2), per_level(), NO_LAG)
    np.testing.assert_array_equal(impulses.angular_impulse, [2.5, -1.25, 0])
    np.testing.assert_array_equal(impulses.linear_impulse, [0, 0, 1.25])


def test_another_origin_changes_the_angular_impulse_by_shift_cross_linear_impulse(orbiter: Vehicle) -> None:
    # r' -> r' + s: a -> a + s x lambda, lambda unchanged
    shift = np.array([3.0, -20.0, 7.0])
    command = (np.arange(44) % 3 == 0).astype(float)
    no_lag = lag_factors(np.zeros(44), 0.08)
    here, there = (
        interval_impulses(command, command, command, 0.08 * thrust_wrenches(positions, orbiter.thrusts), no_lag)
        for positions in (orbiter.positions, orbiter.positions + shift)
    )
    np.testing.assert_array_equal(there.linear_impulse, here.linear_impulse)
    expected = here.angular_impulse + np.cross(shift, here.linear_impulse)
    # sums of 15 products of at most 0.08 * 900 * 100 = 7e3
    np.testing.assert_allclose(there.angular_impulse, expected, rtol=0.0, atol=15 * 7e3 * 2e-16)


def test_sum_over_jets_is_that_of_the_definition(orbiter: Vehicle) -> None:
    # (2-45) and (2-46) jet by jet
    level = np.random.default_rng(1).uniform(size=44)
    linear, angular = np.zeros(3), np.zeros(3)
    for position, thrust, share in zip(orbiter.positions, orbiter.thrusts, level, strict=True):
        linear += share * thrust * 0.08
        angular += share * np.cross(position, thrust) * 0.08
    impulses = interval_impulses(level, level, level, orbiter.wrenches * 0.08, lag_factors(np.zeros(44), 0.08))
    np.testing.assert_allclose(impulses.linear_impulse, linear, rtol=0.0, atol=44 * 72.0 * 2e-16)
    np.testing.assert_allclose(impulses.angular_impulse, angular, rtol=0.0, atol=44 * 7e3 * 2e-16)


@pytest.mark.parametrize(
    ("command", "before", "usable"),
    [
        ([1.0, 0.0], [1.0, 0.0], True),
        ([1.0, 1.0], [1.0, 1.0], True),
        ([0.0, 0.0], [0.0, 0.0], True),  # the empty combination is steady too
        ([1.0, 0.0], [0.0, 0.0], False),  # a jet was switched on
        ([0.0, 0.0], [1.0, 0.0], False),  # a jet was switched off
        ([1.0, 0.0], [0.0, 1.0], False),  # as many jets, but others
        ([1.0, 0.5], [1.0, 0.5], False),  # steady, but part of the interval only
        ([0.5, 0.0], [1.0, 0.0], False),
    ],
)
def test_gate_opens_for_an_unchanged_combination_of_whole_firings(
    command: list[float], before: list[float], usable: bool
) -> None:
    impulses = interval_impulses(np.array(command), np.array(before), np.zeros(2), per_level(), NO_LAG)
    assert impulses.usable is usable


@pytest.mark.parametrize(("command", "firing"), [([0.0, 0.0], False), ([0.0, 1.0], True), ([0.1, 0.0], True)])
def test_any_commanded_jet_is_a_firing(command: list[float], firing: bool) -> None:
    impulses = interval_impulses(np.array(command), np.zeros(2), np.zeros(2), per_level(), NO_LAG)
    assert impulses.firing is firing


def test_lag_holds_impulse_back_at_the_start_and_gives_it_after_the_end() -> None:
    # first jet: tau = T / 2, so from level 0 the mean over a period is 1 - (1 - e^-2) / 2 and the level
    # after it 1 - e^-2; then, switched off, the mean is (1 - e^-2) / 2 of that
    lag = lag_factors(np.array([0.5 * PERIOD, 0.0]), PERIOD)
    on, off = np.array([1.0, 0.0]), np.zeros(2)
    left = np.exp(-2.0)
    first = interval_impulses(on, off, off, per_level(), lag)
    np.testing.assert_allclose(first.linear_impulse, [0.0, 0.0, 5.0 * (1.0 - 0.5 * (1.0 - left))], rtol=1e-14)
    np.testing.assert_allclose(first.level, [1.0 - left, 0.0], rtol=1e-14)
    second = interval_impulses(off, on, first.level, per_level(), lag)
    np.testing.assert_allclose(second.linear_impulse, [0.0, 0.0, 5.0 * 0.5 * (1.0 - left) ** 2], rtol=1e-14)
    np.testing.assert_allclose(second.level, [(1.0 - left) * left, 0.0], rtol=1e-14)


def test_lag_does_not_change_the_gate() -> None:
    lag = lag_factors(np.full(2, 0.1), PERIOD)
    on = np.array([1.0, 0.0])
    assert interval_impulses(on, on, 0.9 * on, per_level(), lag).usable
    assert not interval_impulses(on, np.zeros(2), np.zeros(2), per_level(), lag).usable


# ------------------------------------------------------------------------ unknown commands, outside forces

UNKNOWN = np.array([1.0, np.nan])


def test_where_a_command_is_not_known_nothing_fires_and_two_samples_are_unusable() -> None:
    on = np.array([1.0, 0.0])
    commands = [on, on, UNKNOWN, on, on]
    results = [
        interval_impulses(now, before, np.zeros(2), per_level(), NO_LAG) for before, now in itertools.pairwise(commands)
    ]
    # the sample itself, and the next, whose combination cannot be compared
    assert [result.usable for result in results] == [True, False, False, True]
    for result in results:
        for part in (result.angular_impulse, result.linear_impulse, result.level, result.mean_level):
            assert np.isfinite(part).all()
    # the jet that is not known is taken as off, the other as it is commanded
    np.testing.assert_array_equal(results[1].linear_impulse, [0, 0, 5])
    np.testing.assert_array_equal(results[1].mean_level, [1, 0])


def test_commands_of_which_none_is_known_are_no_firing() -> None:
    unknown = np.full(2, np.nan)
    impulses = interval_impulses(unknown, unknown, np.zeros(2), per_level(), NO_LAG)
    assert not impulses.usable  # two unknown combinations are not the same one
    assert not impulses.firing
    np.testing.assert_array_equal(impulses.angular_impulse, np.zeros(3))
    np.testing.assert_array_equal(impulses.level, np.zeros(2))


def test_the_level_decays_where_a_command_is_not_known_and_recovers() -> None:
    lag = lag_factors(np.full(2, 0.5 * PERIOD), PERIOD)
    left = np.exp(-2.0)
    unknown = interval_impulses(np.array([np.nan, 1.0]), np.ones(2), np.ones(2), per_level(), lag)
    np.testing.assert_allclose(unknown.level, [left, 1.0], rtol=1e-14)
    np.testing.assert_allclose(unknown.mean_level, [0.5 * (1.0 - left), 1.0], rtol=1e-14)
    again = interval_impulses(np.ones(2), np.array([np.nan, 1.0]), unknown.level, per_level(), lag)
    np.testing.assert_allclose(again.level, [1.0 - (1.0 - left) * left, 1.0], rtol=1e-14)


def test_what_was_commanded_is_not_changed() -> None:
    command = UNKNOWN.copy()
    interval_impulses(command, command, np.zeros(2), per_level(), NO_LAG)
    np.testing.assert_array_equal(command, UNKNOWN)


def test_an_outside_impulse_adds_to_the_jets_and_counts_as_firing() -> None:
    off, on = np.zeros(2), np.array([1.0, 0.0])
    outside = np.array([1.0, -2.0, 3.0, 0.5, 0.0, -0.25])
    alone = interval_impulses(off, off, off, per_level(), NO_LAG, outside)
    np.testing.assert_array_equal(alone.angular_impulse, [1, -2, 3])
    np.testing.assert_array_equal(alone.linear_impulse, [0.5, 0, -0.25])
    assert alone.usable
    assert alone.firing
    both = interval_impulses(on, on, on, per_level(), NO_LAG, outside)
    # half a second of the first jet: torque (20, -10, 0), force (0, 0, 10)
    np.testing.assert_array_equal(both.angular_impulse, [11, -7, 3])
    np.testing.assert_array_equal(both.linear_impulse, [0.5, 0, 4.75])
    # it is no thrust of a jet
    np.testing.assert_array_equal(alone.mean_level, off)
    np.testing.assert_array_equal(outside, [1.0, -2.0, 3.0, 0.5, 0.0, -0.25])


def test_an_outside_impulse_of_zero_is_none() -> None:
    off = np.zeros(2)
    assert not interval_impulses(off, off, off, per_level(), NO_LAG, np.zeros(6)).firing


def test_an_outside_impulse_does_not_make_an_unsteady_combination_usable() -> None:
    result = interval_impulses(np.array([1.0, 0.0]), np.zeros(2), np.zeros(2), per_level(), NO_LAG, np.ones(6))
    assert not result.usable
