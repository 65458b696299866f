"""When commands switched, from the stamps of readings."""

from __future__ import annotations

import numpy as np
import pytest

from massprop_drake.maths.estimation.joint.ticks import Clock, Elapsed, elapsed, started

T = 0.08
A, B, C = (np.array(command, dtype=float) for command in ((1, 0), (0, 1), (0, 0)))


def test_stamps_on_the_grid_give_one_piece_of_exactly_a_period() -> None:
    clock = started(7.0, A, T)
    for k in range(1, 200):
        clock, interval = elapsed(clock, 7.0 + k * T, B, C, T)
        np.testing.assert_array_equal(interval.durations_s, [T])
        np.testing.assert_array_equal(interval.commands, [B])
        assert not interval.anew


def test_a_late_reading_has_a_piece_of_the_command_that_comes_and_an_early_one_of_that_before() -> None:
    exact = Clock(0.0, 0.0, T, np.zeros(3), False, A)  # ticks are known, so a stamp moves them by nothing
    after, interval = elapsed(exact, T + 0.002, B, C, T)
    np.testing.assert_allclose(interval.durations_s, [T, 0.002], atol=1e-9)
    np.testing.assert_array_equal(interval.commands, [B, C])
    after, interval = elapsed(after, 2 * T + 0.001, C, A, T)
    np.testing.assert_allclose(interval.durations_s, [T - 0.002, 0.001], atol=1e-9)
    np.testing.assert_array_equal(interval.commands, [C, A])
    early = exact._replace(stamp_s=-0.003)
    _, interval = elapsed(early, T - 0.001, B, C, T)
    np.testing.assert_allclose(interval.durations_s, [0.003, T - 0.001], atol=1e-9)
    np.testing.assert_array_equal(interval.commands, [A, B])
    _, interval = elapsed(exact, T + 0.002, B, None, T)
    np.testing.assert_allclose(interval.durations_s, [T + 0.002], atol=1e-9)


def _record(stamps: np.ndarray, commands: np.ndarray, period_s: float) -> list[tuple[Clock, Elapsed]]:
    clock, found = started(stamps[0], np.zeros(commands.shape[1]), period_s), []
    for k in range(1, stamps.size):
        clock, interval = elapsed(clock, stamps[k], commands[k - 1], commands[k], period_s)
        found.append((clock, interval))
    return found


def test_jitter_neither_makes_nor_loses_impulse() -> None:
    """Of a lag-free jet each interval gets what acted in it, to what the ticks are known; the sum is exact.

    What is not known of a tick counts as half.
    """
    rng = np.random.default_rng(0)
    count, most = 400, 0.001
    ticks = 3.0 + T * np.arange(count)
    stamps = ticks + rng.uniform(-most, most, count)
    commands = (rng.uniform(size=(count, 1)) < 0.5).astype(float)
    found = _record(stamps, commands, T)
    told = [np.where(np.isnan(interval.commands[:, 0]), 0.5, interval.commands[:, 0]) for _, interval in found]
    acted = np.array([float(each.durations_s @ one) for (_, each), one in zip(found, told, strict=True)])
    edges = np.concatenate([[-np.inf], ticks[1:], [np.inf]])
    true = np.empty(count - 1)
    for k in range(count - 1):
        shares = np.clip(np.minimum(edges[1:], stamps[k + 1]) - np.maximum(edges[:-1], stamps[k]), 0.0, None)
        true[k] = shares @ commands[:, 0]
    assert np.abs(acted - true)[100:].max() < 3e-4  # a tenth of the jitter's largest
    assert abs((acted - true).sum()) < 2e-3
    error = np.array([clock.tick_s for clock, _ in found]) - ticks[1:]
    assert np.abs(error[100:]).max() < 4.0 * 2.0 * most / np.sqrt(3 * 100)  # the end of a line through as many stamps


def test_what_is_not_known_of_a_tick_covers_its_error() -> None:
    """Jets that switch together are early or late together: the sum of what they gave varies no more than stated."""
    rng = np.random.default_rng(1)
    count, jets = 60, 4
    errors, stated = [], []
    for _ in range(40):
        ticks = T * np.arange(count)
        stamps = ticks + np.clip(0.01 * T * rng.standard_normal(count), -0.02 * T, 0.02 * T)
        on = (np.arange(count) // 3 % 2).astype(float)
        found = _record(stamps, np.tile(on.reshape(-1, 1), jets), T)
        for k in range(30, count - 1):
            interval = found[k][1]
            unknown = np.isnan(interval.commands)
            mean = float(interval.durations_s @ np.where(unknown, 0.5, interval.commands).sum(axis=1))
            shares = np.clip(np.minimum(ticks + T, stamps[k + 1]) - np.maximum(ticks, stamps[k]), 0.0, None)
            errors.append(mean - jets * float(shares @ on))
            stated.append(0.25 * jets * float((interval.durations_s**2) @ unknown[:, 0]))
    switched = np.array(stated) > 0.0
    ratio = np.mean(np.square(errors)[switched]) / np.mean(np.array(stated)[switched])
    assert 0.3 < ratio < 1.5  # less than all of it: where a blur is cut by a reading, its parts count by themselves
    assert np.abs(np.array(errors)[~switched]).max() < 1e-12


def test_a_clock_that_runs_fast_is_followed() -> None:
    true = 1.001 * T
    stamps = true * np.arange(200)
    found = _record(stamps, np.zeros((200, 1)), T)
    assert found[-1][0].period_s == pytest.approx(true, rel=1e-6)
    assert found[-1][0].tick_s == pytest.approx(stamps[-1], abs=1e-4 * T)
    assert sum(float(interval.durations_s.sum()) for _, interval in found) == pytest.approx(stamps[-1])


def test_a_missing_row_has_the_command_of_both_neighbors() -> None:
    unknown = np.full(2, np.nan)
    clock = started(0.0, C, T)
    clock, interval = elapsed(clock, T, A, unknown, T)  # the last row before it: its command is known
    np.testing.assert_array_equal(interval.commands, [A])
    clock, interval = elapsed(clock, 2 * T, unknown, np.array([1.0, 1.0]), T)
    np.testing.assert_array_equal(interval.commands, [[1.0, np.nan]])  # on before and after; off before, on after
    assert not interval.anew


def test_a_long_gap_begins_anew_and_so_does_the_interval_after_it() -> None:
    unknown = np.full(2, np.nan)
    clock = started(0.0, A, T)
    clock, interval = elapsed(clock, 10.3, unknown, A, T)
    np.testing.assert_array_equal(interval.commands, [unknown])
    assert interval.anew
    clock, interval = elapsed(clock, 10.3 + T, A, A, T)
    assert interval.anew
    clock, interval = elapsed(clock, 10.3 + 2 * T, A, A, T)
    assert not interval.anew
