"""When commands switched, from the stamps of readings."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pytest
from joint_probe import elapsed, small_params, some_state, unread

from massprop_drake.maths.estimation.joint import ticks
from massprop_drake.maths.estimation.joint.joint_cycle import initial
from massprop_drake.maths.estimation.joint.lagged_impulses import fire
from massprop_drake.maths.estimation.joint.layout import JointParams, JointState
from massprop_drake.maths.estimation.joint.prediction import Drive, drive, gathered_rows, predict
from massprop_drake.maths.estimation.joint.sensitivity import Link, informed
from massprop_drake.maths.estimation.joint.ticks import (
    JITTER,
    PERIOD,
    Clock,
    Commanded,
    Elapsed,
    Pace,
    Timing,
    bridged,
    stamped,
    started,
)
from massprop_drake.maths.linear_algebra import Array

T = 0.08
PACE = Pace(T)
SIGMA = T * np.array([JITTER, PERIOD])
A, B, C = (np.array(command, dtype=float) for command in ((1, 0), (0, 1), (0, 0)))
PARAMS = small_params(tick_sigma=SIGMA)
PLACES = PARAMS.places
THETA = slice(PLACES.ticks, PLACES.ticks + 2)


def known(state: JointState) -> tuple[Array, Array]:
    """Offset and period error of the ticks, s, and their covariance."""
    rows = SIGMA[:, None] * state.root[THETA]
    return SIGMA * state.mean[THETA], rows @ rows.T


class Found(NamedTuple):
    """An interval, the clock after it, and what stamps have told by then."""

    clock: Clock
    interval: Elapsed
    state: JointState
    acting: Drive


def record(stamps: Array, commands: Array, params: JointParams = PARAMS, pace: Pace = PACE) -> list[Found]:
    """The intervals of a record, and a state that learns from its stamps alone."""
    clock, state, found = started(stamps[0], np.zeros(commands.shape[1])), initial(params), []
    for k in range(1, stamps.size):
        clock, interval = elapsed(clock, stamps[k], (commands[k - 1], commands[k]), pace)
        state, _ = stamped(state, interval.timing, params)
        acting = drive(state, interval.durations_s, interval.commands, np.zeros(6), interval.timing, params)
        state = state._replace(level=acting.firing.level, slope=acting.firing.slope, tick_slope=acting.tick_slope)
        found.append(Found(clock, interval, state, acting))
    return found


def scattered(count: int, seed: int, sigma_s: float = 1e-3) -> tuple[Array, Array, Array]:
    """Ticks, stamps about them, at most two sigmas off, the first one on it, and commands of six jets."""
    rng = np.random.default_rng(seed)
    ticks = 3.0 + T * np.arange(count)
    off = np.clip(sigma_s * rng.standard_normal(count), -2.0 * sigma_s, 2.0 * sigma_s)
    off[0] = 0.0
    commands = np.repeat(rng.uniform(size=(count // 2 + 1, 6)) < 0.5, 2, axis=0)[:count].astype(float)
    return ticks, ticks + off, commands


def test_stamps_on_the_grid_give_one_piece_of_exactly_a_period() -> None:
    clock = started(7.0, A)
    for k in range(1, 200):
        clock, interval = elapsed(clock, 7.0 + k * T, (B, C), PACE)
        np.testing.assert_array_equal(interval.durations_s, [T])
        np.testing.assert_array_equal(interval.commands, [B])
        assert not interval.anew
        assert not interval.timing.off


def test_a_late_reading_has_a_piece_of_the_command_that_comes_and_an_early_one_of_that_before() -> None:
    exact = started(0.0, A)._replace(off=True)  # ticks are on the line, and known
    after, interval = elapsed(exact, T + 0.002, (A, C), PACE)
    np.testing.assert_allclose(interval.durations_s, [T, 0.002], atol=1e-9)
    np.testing.assert_array_equal(interval.commands, [A, C])
    after, interval = elapsed(after, 2 * T + 0.001, (C, B), PACE)
    np.testing.assert_allclose(interval.durations_s, [T - 0.002, 0.001], atol=1e-9)
    np.testing.assert_array_equal(interval.commands, [C, B])
    after, interval = elapsed(after, 3 * T - 0.003, (B, A), PACE)
    np.testing.assert_allclose(interval.durations_s, [T - 0.004], atol=1e-9)
    _, interval = elapsed(after, 4 * T - 0.001, (A, A), PACE)
    np.testing.assert_allclose(interval.durations_s, [0.003, T - 0.001], atol=1e-9)
    np.testing.assert_array_equal(interval.commands, [B, A])
    _, interval = elapsed(exact, T + 0.002, (A, None), PACE)
    np.testing.assert_allclose(interval.durations_s, [T + 0.002], atol=1e-9)


def test_commands_that_switch_at_stamps_have_intervals_of_one_piece() -> None:
    _, stamps, commands = scattered(50, 0)
    for k, found in enumerate(record(stamps, commands, pace=Pace(T, at_stamps=True))):
        np.testing.assert_allclose(found.interval.durations_s, stamps[k + 1] - stamps[k])
        np.testing.assert_array_equal(found.interval.commands, commands[k : k + 1])
        assert not found.interval.timing.off
    assert not found.state.root[THETA].any()


def _given(stamps: Array, ticks: Array, commands: Array) -> Array:
    """Seconds of full thrust of each jet in each interval, with the ticks as they were."""
    lags, level = PARAMS.time_constants_s, np.zeros(6)
    given, edges = np.zeros((stamps.size - 1, 6)), np.concatenate((ticks, [np.inf]))
    for k in range(stamps.size - 1):
        inside = np.flatnonzero((ticks > stamps[k]) & (ticks < stamps[k + 1]))
        times = np.concatenate(([stamps[k]], edges[inside], [stamps[k + 1]]))
        acting = commands[np.maximum(np.searchsorted(ticks, times[:-1], side="right") - 1, 0)]
        done = fire((level, np.zeros(6), np.zeros(6)), lags, np.diff(times), acting, np.zeros((0, 2)))
        given[k], level = done.amount, done.level
    return given


def test_what_jets_give_is_linear_in_the_ticks_however_late_stamps_are() -> None:
    """A state that knows the ticks predicts what acts from pieces that others have made of the stamps they had by then.

    But for a reading that is close to a tick, where these have a switch on its wrong side.
    """
    for seed in range(4):
        ticks, stamps, commands = scattered(200, seed)
        offset = 0.8 * T * JITTER * (-1.0) ** seed
        stamps = stamps.copy()
        stamps[0] -= offset  # the line begins at the first stamp
        commands[0] = 0.0
        total, worst, state = np.zeros(6), 0.0, initial(PARAMS)
        true = _given(stamps, ticks, commands)
        for k, found in enumerate(record(stamps, commands)):
            interval, timing = found.interval, found.interval.timing
            begin_s = stamps[k + 1] - timing.late_s - T * timing.numbers[1]
            state.mean[THETA] = np.array([ticks[0] - begin_s, 0.0]) / SIGMA
            acting = drive(state, interval.durations_s, interval.commands, np.zeros(6), timing, PARAMS)
            firing = acting.firing
            state = state._replace(level=firing.level, slope=firing.slope, tick_slope=acting.tick_slope)
            total += firing.amount - true[k]
            if k > 50:
                worst = max(worst, float(np.abs(firing.amount - true[k]).max()))
        assert worst < 1e-4  # lagged: a switch that is put on the wrong side of its reading shows in the second order
        assert np.abs(total).max() < 1.5e-4


def test_derivatives_by_the_ticks_agree_with_central_differences() -> None:
    """Of the rate and of what accelerometers gather, with jets that have failed, and levels that ticks have moved."""
    params = small_params(tick_sigma=SIGMA, second_order=False)
    clock = started(0.0, np.zeros(6))._replace(off=True, covariance=np.diag((0.1 * SIGMA) ** 2))
    commands = np.array([[0.0, 1, 0, 1, 1, 0], [1.0, 0, 0, 1, 0, 1], [0.0, 0, 1, 0, 1, 1]])
    clock, _ = elapsed(clock, T - 3e-4, (commands[0], commands[1]), PACE)
    _, interval = elapsed(clock, 2.0 * T + 4e-4, (commands[1], commands[2]), PACE)
    state = some_state(params)

    def predicted(theta: Array) -> tuple[Array, Array]:
        mean = state.mean.copy()
        mean[THETA] += theta
        at = state._replace(mean=mean, level=state.level + (SIGMA * theta) @ state.tick_slope)
        acting = drive(at, interval.durations_s, interval.commands, np.zeros(6), interval.timing, params)
        acting = acting._replace(firing=acting.firing._replace(bow=np.zeros((3, 6))))
        found = predict(at, acting, unread(params), params)
        return found.mean[10:16], np.vstack((found.rate_rows, gathered_rows(found, 0)))[:, THETA]

    rows = predicted(np.zeros(2))[1]
    for column, step in enumerate(0.1 * np.eye(2)):
        difference = (predicted(step)[0] - predicted(-step)[0]) / 0.2
        np.testing.assert_allclose(rows[:, column], difference, rtol=1e-3, atol=1e-3 * np.abs(difference).max())
    assert np.abs(rows).min(axis=0).max() > 1e-6


@pytest.mark.parametrize("late", [-1.5, -0.3, 0.0, 0.7, 2.0, 9.0])
def test_a_switch_about_its_reading_is_as_likely_on_either_side_as_the_tick_says(late: float) -> None:
    """Mean, share and spread of what acted before the reading, against draws; with the next interval, all of it."""
    sigma = 2e-4
    commands = np.array([0.0]), np.array([1.0])
    before = started(0.0, commands[0])._replace(off=True, scatter=1e9)  # the stamp itself tells nothing
    before = before._replace(covariance=np.diag([sigma**2, 0.0]))
    stamp = T + late * sigma
    clock, interval = elapsed(before, stamp, commands, PACE)
    drawn = np.maximum(stamp - (T + sigma * np.random.default_rng(0).standard_normal(400_000)), 0.0)
    acted = float(interval.durations_s[-1]) if interval.durations_s.size > 1 else 0.0
    assert acted - float(interval.timing.beyond_s[1]) == pytest.approx(drawn.mean(), abs=1e-6)
    slope = float(np.mean(drawn > 0.0))
    assert interval.timing.shares[1] == pytest.approx(slope, abs=5e-3)
    assert interval.timing.spreads[1] == pytest.approx(drawn.var() - (slope * sigma) ** 2, abs=0.01 * sigma**2)
    _, following = elapsed(clock, 2.0 * T - 2e-3, (commands[1], commands[1]), PACE)
    rest = float(following.durations_s[0]) if following.durations_s.size > 1 else 0.0
    rest += float(following.timing.beyond_s[0])
    assert acted - rest == pytest.approx(late * sigma, abs=1e-6)
    assert following.timing.shares[0] == pytest.approx(1.0 - interval.timing.shares[1])


def test_stamps_tell_of_ticks_as_a_line_through_them_does() -> None:
    """By batch: the prior, and each stamp with the scatter that it was taken to have."""
    _, stamps, commands = scattered(150, 3)
    found = record(1.0005 * stamps, 0.0 * commands)
    information, vector = np.diag(SIGMA**-2.0), np.zeros(2)
    for each in found:
        timing = each.interval.timing
        row = np.array([1.0, timing.numbers[1]])
        information += np.outer(row, row) / timing.jitter
        vector += row * timing.late_s / timing.jitter
    mean, covariance = known(found[-1].state)
    np.testing.assert_allclose(mean, np.linalg.solve(information, vector), rtol=0.05)
    np.testing.assert_allclose(covariance, np.linalg.inv(information), rtol=0.05)
    assert mean[1] == pytest.approx(0.0005 * T, abs=4.0 * np.sqrt(covariance[1, 1]))


@pytest.mark.parametrize("sigma_s", [2e-5, 3e-4, 1.5e-3])
def test_the_scatter_of_stamps_is_found_from_them(sigma_s: float) -> None:
    _, stamps, commands = scattered(400, 5, sigma_s)
    jitter = np.sqrt(record(stamps, commands)[-1].interval.timing.jitter)
    clipped = 0.88 * sigma_s  # of a normal distribution, cut at two sigmas
    assert 0.9 * clipped < jitter < 1.1 * np.sqrt(clipped**2 + 10.0 / 410.0 * (JITTER * T) ** 2)


def test_a_stamp_leaves_what_it_says_nothing_of() -> None:
    state = some_state(PARAMS)
    timing = _timing(late_s=5e-4, number=3.0)
    uncorrelated = state._replace(root=state.root.copy())
    uncorrelated.root[THETA] = 0.0
    after, told = stamped(uncorrelated, timing._replace(anew=True), PARAMS)
    others = np.delete(np.arange(PLACES.size), np.arange(PLACES.size)[THETA])
    np.testing.assert_allclose(after.mean[others], state.mean[others])
    np.testing.assert_allclose(
        (after.root @ after.root.T)[np.ix_(others, others)],
        (uncorrelated.root @ uncorrelated.root.T)[np.ix_(others, others)],
        rtol=1e-9,
        atol=1e-18,
    )
    np.testing.assert_allclose(told.correction[others], 0.0, atol=1e-15)
    assert told.kept == 0.0


def test_a_stamp_moves_levels_with_the_ticks() -> None:
    state = some_state(PARAMS)
    state.root[THETA] *= 1e4
    after, told = stamped(state, _timing(late_s=5e-4, number=3.0), PARAMS)
    moved = SIGMA * (after.mean - state.mean)[THETA]
    np.testing.assert_allclose(after.level, state.level + moved @ state.tick_slope)
    assert np.abs(moved).max() > 1e-6
    np.testing.assert_allclose(after.mean - state.mean, told.correction)
    innovation = 5e-4 - told.row @ state.mean
    np.testing.assert_allclose(told.correction, told.gain * innovation)


@pytest.mark.parametrize("anew", [False, True])
def test_an_error_goes_through_a_stamp_as_two_filters_differ(anew: bool) -> None:
    state, timing = some_state(PARAMS), _timing(late_s=5e-4, number=3.0)._replace(anew=anew)
    state.root[THETA] *= 1e4
    error = np.random.default_rng(0).standard_normal(PLACES.size)
    after, told = stamped(state, timing, PARAMS)
    other, _ = stamped(state._replace(mean=state.mean + error), timing, PARAMS)
    nothing: Any = dict.fromkeys(Link._fields, np.zeros(0))
    over = Link(**nothing)._replace(stamp_row=told.row, stamp_gain=told.gain, ticks_kept=told.kept)
    found = informed(error.reshape(-1, 1), over, PLACES)[:, 0]
    np.testing.assert_allclose(found, other.mean - after.mean, rtol=1e-9, atol=1e-12)
    assert np.abs(found - error)[THETA].max() > 1e-2


def _timing(late_s: float, number: float) -> Timing:
    none = np.zeros(2)
    return Timing(
        True, False, late_s, SIGMA[0] ** 2, np.array([number - 1.0, number]), np.zeros((1, 2)), none, none, none, none
    )


def test_a_missing_row_has_the_command_of_both_neighbors() -> None:
    unknown = np.full(2, np.nan)
    clock = started(0.0, C)
    clock, interval = elapsed(clock, T, (A, unknown), PACE)  # the last row before it: its command is known
    np.testing.assert_array_equal(interval.commands, [A])
    both = unknown, np.array([1.0, 1.0])
    np.testing.assert_array_equal(bridged(clock, 2 * T, both, PACE), [1.0, np.nan])  # on, and off, before; on after
    np.testing.assert_array_equal(bridged(clock, 5 * T, both, PACE), unknown)
    clock, interval = elapsed(clock, 2 * T, both, PACE)
    np.testing.assert_array_equal(interval.commands, [unknown])
    assert not interval.anew


def test_ticks_go_on_over_rows_that_are_missing() -> None:
    ticks, stamps, commands = scattered(60, 7)
    rows = np.delete(np.arange(60), [30, 31])
    found = record(stamps[rows], commands[rows])
    after = found[29]
    assert after.interval.timing.numbers[1] == after.clock.number == found[28].clock.number + 3.0
    assert not after.interval.timing.anew
    assert after.clock.tick_s + known(after.state)[0] @ [1.0, after.clock.number] == pytest.approx(ticks[32], abs=1e-3)


def test_a_stamp_off_any_tick_begins_anew() -> None:
    _, stamps, commands = scattered(60, 7)
    later = stamps + np.where(np.arange(60) > 30, 0.3 * T, 0.0)
    found = record(later, commands)
    assert not found[30].interval.timing.off
    np.testing.assert_allclose(found[30].interval.durations_s, later[31] - later[30])
    assert found[31].interval.timing.anew
    assert found[31].interval.timing.numbers[1] == 1.0
    assert not found[32].interval.timing.anew


def test_a_long_gap_begins_anew_and_so_does_the_interval_after_it() -> None:
    unknown = np.full(2, np.nan)
    clock = started(0.0, A)
    clock, interval = elapsed(clock, 10.3, (unknown, A), PACE)
    np.testing.assert_array_equal(interval.commands, [unknown])
    assert interval.anew
    clock, interval = elapsed(clock, 10.3 + T, (A, A), PACE)
    assert interval.anew
    clock, interval = elapsed(clock, 10.3 + 2 * T, (A, A), PACE)
    assert not interval.anew


# ---------------------------------------------------------------- jets that open within a sample


def opening(*told: tuple[list[float], list[float]]) -> list[Commanded]:
    return [Commanded(np.array(command), np.array(onset_s)) for command, onset_s in told]


def test_a_jet_that_opens_within_a_sample_cuts_the_interval() -> None:
    first, second = opening(([0.5, 1.0], [0.01, 0.0]), ([0.25, 0.0], [0.0, 0.0]))
    clock, interval = ticks.elapsed(started(0.0, C), T, (first, second), PACE)
    np.testing.assert_allclose(interval.durations_s, [0.01, 0.04, 0.03], rtol=1e-12)
    np.testing.assert_array_equal(interval.commands, [[0, 1], [1, 1], [0, 1]])
    assert not interval.timing.off
    np.testing.assert_array_equal(clock.earlier_onset_s, first.onset_s)
    _, late = ticks.elapsed(clock, 2.4 * T, (second, first), Pace(T, at_stamps=True))
    np.testing.assert_allclose(late.durations_s, [0.02, 0.092], rtol=1e-12)  # shut once the on-time is over
    np.testing.assert_array_equal(late.commands, [[1, 0], [0, 0]])


def test_where_stamps_are_off_their_ticks_edges_stay_where_the_ticks_have_them() -> None:
    exact = started(0.0, C)._replace(off=True, acted=1.0)
    first, second, third = opening(([0.5, 0.0], [0.01, 0.0]), ([0.5, 1.0], [0.001, 0.0]), ([0.0, 0.25], [0.0, 0.059]))
    after, interval = ticks.elapsed(exact, T + 0.002, (first, second), PACE)
    np.testing.assert_allclose(interval.durations_s, [0.01, 0.04, 0.03, 0.001, 0.001], atol=1e-9)
    np.testing.assert_array_equal(interval.commands, [[0, 0], [1, 0], [0, 0], [0, 1], [1, 1]])
    after, interval = ticks.elapsed(after, 2.0 * T - 0.001, (second, third), PACE)
    np.testing.assert_allclose(interval.durations_s, [0.039, 0.038], atol=1e-9)
    np.testing.assert_array_equal(interval.commands, [[1, 1], [0, 1]])
    _, interval = ticks.elapsed(after, 3.0 * T - 0.001, (third, third), PACE)
    np.testing.assert_allclose(interval.durations_s, [0.001, 0.059, 0.02], atol=1e-9)
    np.testing.assert_allclose(interval.commands, [[0, 1], [0, 0], [0, 1]], atol=1e-8)


def test_edges_go_with_their_ticks() -> None:
    """Derivatives of impulses by offset and period error, against records whose ticks are elsewhere."""
    params = small_params(tick_sigma=SIGMA, second_order=False)
    drawn = np.random.default_rng(3)
    told = [np.where(drawn.random(6) < 0.6, drawn.uniform(0.1, 0.5, 6), 0.0) for _ in range(3)]
    commands = [Commanded(each, 0.3 * T * drawn.random(6)) for each in told]
    clock = started(0.0, np.zeros(6))._replace(off=True, covariance=np.diag((0.1 * SIGMA) ** 2))
    clock, _ = ticks.elapsed(clock, T - 3e-4, (commands[0], commands[1]), PACE)
    _, interval = ticks.elapsed(clock, 2.0 * T + 4e-4, (commands[1], commands[2]), PACE)
    state = some_state(params)
    state = state._replace(tick_slope=np.zeros_like(state.tick_slope))

    def acts(theta: Array) -> tuple[Array, Array]:
        mean = state.mean.copy()
        mean[THETA] += theta
        found = drive(
            state._replace(mean=mean), interval.durations_s, interval.commands, np.zeros(6), interval.timing, params
        )
        return found.firing.amount, SIGMA[:, None] * found.by_ticks

    slopes = acts(np.zeros(2))[1]
    shifts = interval.timing.numbers[2:]
    assert interval.timing.edges.shape[1] == 2 + shifts.size
    for column, step in enumerate(0.1 * np.eye(2)):
        difference = (acts(step)[0] - acts(-step)[0]) / 0.2
        np.testing.assert_allclose(slopes[column], difference, rtol=1e-6, atol=1e-12)
    # the same by moving every edge of the pieces by what its tick moves
    levels, none = (np.zeros(6), np.zeros(6), np.zeros(6)), np.zeros((0, interval.timing.edges.shape[1]))
    constants, late_s, by_edges = params.time_constants_s, 1e-6, interval.timing.edges.sum(axis=1)
    early, later = (
        fire(levels, constants, interval.durations_s + shift * by_edges, interval.commands, none)
        for shift in (-late_s, late_s)
    )
    exact = fire(levels, constants, interval.durations_s, interval.commands, interval.timing.edges)
    np.testing.assert_allclose(exact.by_tick.sum(axis=0), (later.amount - early.amount) / (2 * late_s), atol=1e-6)
