"""Levels with lag, and when commands switched, from the stamps of readings: against integration and differences."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pytest
from joint_probe import elapsed, small_params, some_sample, some_state, unread

from massprop_drake.maths.estimation.joint.beginning import initial_joint_state
from massprop_drake.maths.estimation.joint.forcing import compute_forces
from massprop_drake.maths.estimation.joint.joint_sample import JointSample
from massprop_drake.maths.estimation.joint.lagged_impulses import LEAST_LAG, Firing, integrate_thrust, time_constants
from massprop_drake.maths.estimation.joint.layout import JointState
from massprop_drake.maths.estimation.joint.prediction import predict, velocity_gain_rows
from massprop_drake.maths.estimation.joint.sensitivity import Link, propagate_crossings
from massprop_drake.maths.estimation.joint.ticks import (
    JITTER,
    PERIOD,
    Clock,
    Elapsed,
    Pace,
    Timing,
    fill_missing_command,
    start_clock,
    update_by_stamp,
)
from massprop_drake.maths.linear_algebra import Array
from massprop_drake.maths.vehicle.on_times import level_onsets

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


def started(stamp_s: float, command: Array) -> Clock:
    """The clock at a first reading, after a command that is a level."""
    return start_clock(stamp_s, command, level_onsets(command.size))


def of_interval(interval: Elapsed) -> JointSample:
    """A sample of an interval, nothing read."""
    pieces = {"durations_s": interval.durations_s, "commands": interval.commands, "timing": interval.timing}
    return some_sample(PARAMS, **pieces)


def gone_over(state: JointState, interval: Elapsed) -> tuple[JointState, Array]:
    """The state with levels after an interval, and what each jet gave in it."""
    acting = compute_forces(state, of_interval(interval), PARAMS)
    firing = acting.firing
    return state._replace(level=firing.level, slope=firing.slope, tick_slope=acting.tick_slope), firing.amount


def record(stamps: Array, commands: Array) -> list[Found]:
    """The intervals of a record, and a state that learns from its stamps alone."""
    clock, state, found = started(stamps[0], np.zeros(commands.shape[1])), initial_joint_state(PARAMS), []
    for k in range(1, stamps.size):
        clock, interval = elapsed(clock, stamps[k], (commands[k - 1], commands[k]), PACE)
        state, _ = gone_over(update_by_stamp(state, interval.timing, PARAMS)[0], interval)
        found.append(Found(clock, interval, state))
    return found


def scattered(count: int, seed: int, sigma_s: float = 1e-3) -> tuple[Array, Array, Array]:
    """Ticks, stamps about them, at most two sigmas off, the first one on it, and commands of six jets."""
    rng = np.random.default_rng(seed)
    ticks = 3.0 + T * np.arange(count)
    off = np.clip(sigma_s * rng.standard_normal(count), -2.0 * sigma_s, 2.0 * sigma_s)
    off[0] = 0.0
    commands = np.repeat(rng.uniform(size=(count // 2 + 1, 6)) < 0.5, 2, axis=0)[:count].astype(float)
    return ticks, ticks + off, commands


def _given(stamps: Array, ticks: Array, commands: Array) -> Array:
    """Seconds of full thrust of each jet in each interval, with the ticks as they were."""
    lags, level = PARAMS.time_constants_s, np.zeros(6)
    given, edges = np.zeros((stamps.size - 1, 6)), np.concatenate((ticks, [np.inf]))
    for k in range(stamps.size - 1):
        inside = np.flatnonzero((ticks > stamps[k]) & (ticks < stamps[k + 1]))
        times = np.concatenate(([stamps[k]], edges[inside], [stamps[k + 1]]))
        acting = commands[np.maximum(np.searchsorted(ticks, times[:-1], side="right") - 1, 0)]
        done = integrate_thrust((level, np.zeros(6), np.zeros(6)), lags, np.diff(times), acting, np.zeros((0, 2)))
        given[k], level = done.amount, done.level
    return given


def test_what_jets_give_is_linear_in_the_ticks_however_late_stamps_are() -> None:
    """A state that knows the ticks predicts what acts from pieces that others have made of the stamps they had by then.

    But for a reading that is close to a tick, where these have a switch on its wrong side.
    """
    for seed in range(2):
        ticks, stamps, commands = scattered(80, seed)
        offset = 0.8 * T * JITTER * (-1.0) ** seed
        stamps = stamps.copy()
        stamps[0] -= offset  # the line begins at the first stamp
        commands[0] = 0.0
        total, worst, state = np.zeros(6), 0.0, initial_joint_state(PARAMS)
        true = _given(stamps, ticks, commands)
        for k, found in enumerate(record(stamps, commands)):
            timing = found.interval.timing
            begin_s = stamps[k + 1] - timing.late_s - T * timing.numbers[1]
            state.mean[THETA] = np.array([ticks[0] - begin_s, 0.0]) / SIGMA
            state, amount = gone_over(state, found.interval)
            total += amount - true[k]
            if k > 50:
                worst = max(worst, float(np.abs(amount - true[k]).max()))
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
        acting = compute_forces(at, of_interval(interval), params)
        acting = acting._replace(firing=acting.firing._replace(bow=np.zeros((3, 6))))
        found = predict(at, acting, unread(params), params)
        return found.mean[10:16], np.vstack((found.rate_rows, velocity_gain_rows(found, 0)))[:, THETA]

    rows = predicted(np.zeros(2))[1]
    for column, step in enumerate(0.1 * np.eye(2)):
        difference = (predicted(step)[0] - predicted(-step)[0]) / 0.2
        np.testing.assert_allclose(rows[:, column], difference, rtol=1e-3, atol=1e-3 * np.abs(difference).max())
    assert np.abs(rows).min(axis=0).max() > 1e-6


@pytest.mark.parametrize("late", [-1.5, -0.3, 0.7, 9.0])
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


@pytest.mark.parametrize("anew", [False, True])
def test_a_stamp_is_an_update_that_moves_levels_with_the_ticks(anew: bool) -> None:
    """And an error goes through it as two filters differ."""
    state, none, numbers = some_state(PARAMS), np.zeros(2), np.array([2.0, 3.0])
    timing = Timing(True, anew, 5e-4, SIGMA[0] ** 2, numbers, np.zeros((1, 2)), none, none, none, none)
    state.root[THETA] *= 1e4
    after, told = update_by_stamp(state, timing, PARAMS)
    moved = after.mean - state.mean
    assert told.kept == float(not anew)
    if not anew:
        np.testing.assert_allclose(moved, told.correction)
        np.testing.assert_allclose(after.level, state.level + (SIGMA * moved[THETA]) @ state.tick_slope)
        np.testing.assert_allclose(moved, told.gain * (5e-4 - told.row @ state.mean))
        assert np.abs(SIGMA * moved[THETA]).max() > 1e-6
    error = np.random.default_rng(0).standard_normal(PLACES.size)
    other, _ = update_by_stamp(state._replace(mean=state.mean + error), timing, PARAMS)
    nothing: Any = dict.fromkeys(Link._fields, np.zeros(0))
    over = Link(**nothing)._replace(stamp_row=told.row, stamp_gain=told.gain, ticks_kept=told.kept)
    found = propagate_crossings(error.reshape(-1, 1), over, PLACES)[:, 0]
    np.testing.assert_allclose(found, other.mean - after.mean, rtol=1e-9, atol=1e-12)
    assert np.abs(found - error)[THETA].max() > 1e-2


def test_missing_rows_have_the_command_of_both_neighbors() -> None:
    unknown = np.full(2, np.nan)
    clock, interval = elapsed(started(0.0, C), T, (A, unknown), PACE)  # the last row before it: its command is known
    np.testing.assert_array_equal(interval.commands, [A])
    both = unknown, np.array([1.0, 1.0])  # on, and off, before; on after
    np.testing.assert_array_equal(fill_missing_command(clock, 2 * T, both, PACE), [1.0, np.nan])
    np.testing.assert_array_equal(fill_missing_command(clock, 5 * T, both, PACE), unknown)
    _, interval = elapsed(clock, 2 * T, both, PACE)
    np.testing.assert_array_equal(interval.commands, [unknown])
    assert not interval.anew
    # ticks go on over a few
    line, stamps, commands = scattered(40, 7)
    rows = np.delete(np.arange(40), [30, 31])
    before, after = record(stamps[rows], commands[rows])[28:30]
    assert after.interval.timing.numbers[1] == after.clock.number == before.clock.number + 3.0
    assert not after.interval.timing.anew
    assert after.clock.tick_s + known(after.state)[0] @ [1.0, after.clock.number] == pytest.approx(line[32], abs=1e-3)


LEVEL = np.array([0.0, 1.0, 0.3, 0.8])
LAGS = np.array([0.015, 0.05, 0.4, 0.0])
PIECES_S = np.array([0.03, 0.05])
PIECEWISE = np.array([[1.0, 1, 0, 1], [1, 0, 0.5, 0]])


def finely(jet: int) -> tuple[float, tuple[float, float, float], float]:
    """Amount, bow and last level, by the midpoint rule."""
    level, constant = LEVEL[jet], LAGS[jet]
    amount, steps, so_far = 0.0, [], []
    for duration, command in zip(PIECES_S, PIECEWISE[:, jet], strict=True):
        n = 20_000
        step = duration / n
        time = (np.arange(n) + 0.5) * step
        levels = command + (level - command) * np.exp(-time / constant) if constant else np.full(n, command)
        so_far.append(amount + (np.cumsum(levels) - 0.5 * levels) * step)
        steps.append(np.full(n, step))
        amount += float(levels.sum() * step)
        level = command + (level - command) * float(np.exp(-duration / constant)) if constant else float(command)
    weights = np.concatenate(steps) / PIECES_S.sum()
    along = np.cumsum(weights) - 0.5 * weights
    off = np.concatenate(so_far) - amount * along
    mean, moment = float(off @ weights), float(off * (along - 0.5) @ weights)
    return amount, (mean, moment, float(np.sqrt(off**2 @ weights) * np.sign(mean))), level


def fired(level: Array, constants: Array = LAGS, durations: Array = PIECES_S, commands: Array = PIECEWISE) -> Firing:
    """Levels and impulses of jets whose levels at the start are known."""
    none = np.zeros_like(level)
    return integrate_thrust((level, none, none), constants, durations, commands, np.zeros((0, 2)))


def gone_on(before: Firing, constants: Array, durations: Array, commands: Array) -> Firing:
    """Events of a further interval."""
    return integrate_thrust(
        (before.level, before.slope, before.level_std), constants, durations, commands, np.zeros((0, 2))
    )


@pytest.mark.parametrize("jet", range(4))
def test_amount_bow_and_level_agree_with_fine_integration(jet: int) -> None:
    firing, (amount, bow, level) = fired(LEVEL), finely(jet)
    assert firing.amount[jet] == pytest.approx(amount, rel=1e-7)
    assert firing.bow[:, jet] == pytest.approx(bow, rel=1e-6)
    assert firing.level[jet] == pytest.approx(level, rel=1e-12)


def test_derivatives_by_the_logarithm_of_the_time_constant() -> None:
    """Over two intervals, so that what the level at the start depends on counts, too."""

    def twice(scale: float) -> Firing:
        constants = LAGS * scale
        return gone_on(fired(LEVEL, constants), constants, PIECES_S, 1.0 - PIECEWISE)

    step, second = 1e-5, twice(1.0)
    above, below = twice(np.exp(step)), twice(np.exp(-step))
    np.testing.assert_allclose(second.amount_slope, (above.amount - below.amount) / (2 * step), rtol=1e-7, atol=1e-12)
    np.testing.assert_allclose(second.slope, (above.level - below.level) / (2 * step), rtol=1e-7, atol=1e-12)


def test_a_command_that_is_not_known_leaves_its_level_to_a_coin_which_settles_with_the_lag() -> None:
    firing = fired(np.zeros(2), np.zeros(2), np.array([0.1]), np.array([[np.nan, 1.0]]))
    np.testing.assert_allclose(firing.amount, [0.05, 0.1])
    np.testing.assert_allclose([firing.level, firing.level_std], [[0.5, 1.0], [0.5, 0.0]])
    assert firing.unknown.tolist() == [True, False]
    assert firing.commanded
    constants, levels = np.array([0.015, 0.0]), (np.full(2, 0.5), np.zeros(2), np.full(2, 0.5))
    further, left = (constants, np.array([0.1]), np.zeros((1, 2))), np.exp(-0.1 / 0.015)
    first = integrate_thrust(levels, *further, np.zeros((0, 2)))
    np.testing.assert_allclose(first.variance, [(0.5 * 0.015 * (1.0 - left)) ** 2, 0.0], rtol=1e-12)
    np.testing.assert_allclose(first.level_std, [0.5 * left, 0.0], rtol=1e-12)
    assert first.unknown.tolist() == [True, False]
    assert not gone_on(gone_on(first, *further), *further).unknown.any()


def test_time_constants_follow_their_kind_linearly_and_never_vanish() -> None:
    constants, slope = time_constants(np.array([0.01, 0.02]), np.array([1, 0]), 0.2, np.array([1.0, -10.0]))
    np.testing.assert_allclose(constants, [0.01 * LEAST_LAG, 0.02 * 1.2])
    np.testing.assert_allclose(slope[1], 0.2 / 1.2)
