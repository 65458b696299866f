"""Levels with lag: against fine integration, differences, and the pieces of an interval."""

from __future__ import annotations

import numpy as np
import pytest

from massprop_drake.maths.estimation.joint.lagged_impulses import LEAST_LAG, Firing, fire, time_constants

LEVEL = np.array([0.0, 1.0, 0.3, 0.8])
CONSTANTS = np.array([0.015, 0.05, 0.4, 0.0])
DURATIONS = np.array([0.03, 0.05])
COMMANDS = np.array([[1.0, 1, 0, 1], [1, 0, 0.5, 0]])
NO_EDGES = np.zeros((0, 2))


def finely(jet: int) -> tuple[float, tuple[float, float, float], float]:
    """Amount, bow and last level, by the midpoint rule."""
    level, constant = LEVEL[jet], CONSTANTS[jet]
    amount, steps, so_far = 0.0, [], []
    for duration, command in zip(DURATIONS, COMMANDS[:, jet], strict=True):
        n = 20_000
        step = duration / n
        time = (np.arange(n) + 0.5) * step
        levels = command + (level - command) * np.exp(-time / constant) if constant else np.full(n, command)
        so_far.append(amount + (np.cumsum(levels) - 0.5 * levels) * step)
        steps.append(np.full(n, step))
        amount += float(levels.sum() * step)
        level = command + (level - command) * float(np.exp(-duration / constant)) if constant else float(command)
    weights = np.concatenate(steps) / DURATIONS.sum()
    along = np.cumsum(weights) - 0.5 * weights
    off = np.concatenate(so_far) - amount * along
    mean, moment = float(off @ weights), float(off * (along - 0.5) @ weights)
    return amount, (mean, moment, float(np.sqrt(off**2 @ weights) * np.sign(mean))), level


@pytest.mark.parametrize("jet", range(4))
def test_amount_bow_and_level_agree_with_fine_integration(jet: int) -> None:
    firing = fire((LEVEL, np.zeros(4), np.zeros(4)), CONSTANTS, DURATIONS, COMMANDS, NO_EDGES)
    amount, bow, level = finely(jet)
    assert firing.amount[jet] == pytest.approx(amount, rel=1e-7)
    assert firing.bow[:, jet] == pytest.approx(bow, rel=1e-6)
    assert firing.level[jet] == pytest.approx(level, rel=1e-12)


def test_steady_thrust_is_not_bowed() -> None:
    firing = fire(
        (np.array([0.0, 1.0, 0.5]), np.zeros(3), np.zeros(3)),
        np.full(3, 0.02),
        np.array([0.08]),
        np.array([[0.0, 1.0, 0.5]]),
        NO_EDGES,
    )
    np.testing.assert_allclose(firing.bow, 0.0, atol=2e-9)


def test_derivatives_by_the_logarithm_of_the_time_constant() -> None:
    """Over two intervals, so that what the level at the start depends on counts, too."""

    def amounts(scale: float) -> tuple[np.ndarray, np.ndarray]:
        first = fire((LEVEL, np.zeros(4), np.zeros(4)), CONSTANTS * scale, DURATIONS, COMMANDS, NO_EDGES)
        second = fire(
            (first.level, first.slope, first.level_std), CONSTANTS * scale, DURATIONS, 1.0 - COMMANDS, NO_EDGES
        )
        return second.amount, second.level

    first = fire((LEVEL, np.zeros(4), np.zeros(4)), CONSTANTS, DURATIONS, COMMANDS, NO_EDGES)
    second = fire((first.level, first.slope, first.level_std), CONSTANTS, DURATIONS, 1.0 - COMMANDS, NO_EDGES)
    step = 1e-5
    above, below = amounts(np.exp(step)), amounts(np.exp(-step))
    np.testing.assert_allclose(second.amount_slope, (above[0] - below[0]) / (2 * step), rtol=1e-7, atol=1e-12)
    np.testing.assert_allclose(second.slope, (above[1] - below[1]) / (2 * step), rtol=1e-7, atol=1e-12)


def test_what_a_late_build_up_takes_is_given_back_at_tail_off() -> None:
    on = fire((np.zeros(1), np.zeros(1), np.zeros(1)), np.array([0.015]), np.array([0.5]), np.ones((1, 1)), NO_EDGES)
    off = fire((on.level, on.slope, on.level_std), np.array([0.015]), np.array([0.5]), np.zeros((1, 1)), NO_EDGES)
    assert on.amount[0] == pytest.approx(0.5 - 0.015)
    assert (on.amount + off.amount)[0] == pytest.approx(0.5)
    assert (on.amount_slope + off.amount_slope)[0] == pytest.approx(0.0, abs=1e-12)


def test_a_command_that_is_not_known_leaves_its_level_to_a_coin() -> None:
    nothing = (np.zeros(2), np.zeros(2), np.zeros(2))
    firing = fire(nothing, np.zeros(2), np.array([0.1]), np.array([[np.nan, 1.0]]), NO_EDGES)
    np.testing.assert_allclose(firing.amount, [0.05, 0.1])
    np.testing.assert_allclose([firing.level, firing.level_std], [[0.5, 1.0], [0.5, 0.0]])
    assert firing.unknown.tolist() == [True, False]
    assert firing.commanded


def test_an_unknown_level_settles_with_the_lag() -> None:
    constants = np.array([0.015, 0.0])
    levels, off = (np.full(2, 0.5), np.zeros(2), np.full(2, 0.5)), np.zeros((1, 2))
    first = fire(levels, constants, np.array([0.1]), off, NO_EDGES)
    np.testing.assert_allclose(first.variance, [(0.5 * 0.015 * (1.0 - np.exp(-0.1 / 0.015))) ** 2, 0.0], rtol=1e-12)
    np.testing.assert_allclose(first.level_std, [0.5 * np.exp(-0.1 / 0.015), 0.0], rtol=1e-12)
    assert first.unknown.tolist() == [True, False]
    later = fire((first.level, first.slope, first.level_std), constants, np.array([0.1]), off, NO_EDGES)
    third = fire((later.level, later.slope, later.level_std), constants, np.array([0.1]), off, NO_EDGES)
    assert not third.unknown.any()


def test_derivatives_by_when_ticks_were_and_by_the_level_before() -> None:
    def over(first: float, second: float, level: np.ndarray = LEVEL) -> Firing:
        durations = np.diff([0.0, first, second, 0.081])
        commands = np.vstack((COMMANDS, COMMANDS[:1]))
        edges = np.diff([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [0.0, 0.0]], axis=0)
        return fire((level, np.zeros(4), np.zeros(4)), CONSTANTS, durations, commands, edges)

    at, step = (0.002, 0.079), 1e-7
    found = over(*at)
    for tick in range(2):
        above, below = (over(*(at + sign * step * np.eye(2)[tick])) for sign in (1.0, -1.0))
        np.testing.assert_allclose(found.by_tick[tick], (above.amount - below.amount) / (2 * step), atol=1e-7)
        np.testing.assert_allclose(found.level_by_tick[tick], (above.level - below.level) / (2 * step), atol=1e-5)
    above, below = over(*at, LEVEL + step), over(*at, LEVEL - step)
    np.testing.assert_allclose(found.by_level[0], (above.amount - below.amount) / (2 * step), atol=1e-8)
    np.testing.assert_allclose(found.by_level[1], (above.level - below.level) / (2 * step), atol=1e-8)


def test_pieces_of_one_command_are_the_whole() -> None:
    whole = fire((LEVEL, np.ones(4), np.zeros(4)), CONSTANTS, np.array([0.08]), COMMANDS[:1], NO_EDGES)
    cut = fire((LEVEL, np.ones(4), np.zeros(4)), CONSTANTS, np.array([0.01, 0.05, 0.02]), COMMANDS[[0, 0, 0]], NO_EDGES)
    for one, other in zip(whole, cut, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=2e-9)  # the root of what is left of a difference


def test_time_constants_follow_their_kind_linearly_and_never_vanish() -> None:
    constants, slope = time_constants(np.array([0.01, 0.02]), np.array([1, 0]), 0.2, np.array([1.0, -10.0]))
    np.testing.assert_allclose(constants, [0.01 * LEAST_LAG, 0.02 * 1.2])
    np.testing.assert_allclose(slope[1], 0.2 / 1.2)
