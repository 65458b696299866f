"""Levels with lag: against fine integration, differences, and the pieces of an interval."""

from __future__ import annotations

import numpy as np
import pytest

from massprop_drake.maths.estimation.joint.lagged_impulses import LEAST_LAG, Firing, fire, time_constants

LEVEL = np.array([0.0, 1.0, 0.3, 0.8])
CONSTANTS = np.array([0.015, 0.05, 0.4, 0.0])
DURATIONS = np.array([0.03, 0.05])
COMMANDS = np.array([[1.0, 1, 0, 1], [1, 0, 0.5, 0]])


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


def fired(
    level: np.ndarray,
    constants: np.ndarray = CONSTANTS,
    durations: np.ndarray = DURATIONS,
    commands: np.ndarray = COMMANDS,
) -> Firing:
    """Levels and impulses of jets whose levels at the start are known."""
    none = np.zeros_like(level)
    return fire((level, none, none), constants, durations, commands, np.zeros((0, 2)))


def gone_on(before: Firing, constants: np.ndarray, durations: np.ndarray, commands: np.ndarray) -> Firing:
    """Those of a further interval."""
    return fire((before.level, before.slope, before.level_std), constants, durations, commands, np.zeros((0, 2)))


@pytest.mark.parametrize("jet", range(4))
def test_amount_bow_and_level_agree_with_fine_integration(jet: int) -> None:
    firing, (amount, bow, level) = fired(LEVEL), finely(jet)
    assert firing.amount[jet] == pytest.approx(amount, rel=1e-7)
    assert firing.bow[:, jet] == pytest.approx(bow, rel=1e-6)
    assert firing.level[jet] == pytest.approx(level, rel=1e-12)


def test_derivatives_by_the_logarithm_of_the_time_constant() -> None:
    """Over two intervals, so that what the level at the start depends on counts, too."""

    def twice(scale: float) -> Firing:
        constants = CONSTANTS * scale
        return gone_on(fired(LEVEL, constants), constants, DURATIONS, 1.0 - COMMANDS)

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
    first = fire(levels, *further, np.zeros((0, 2)))
    np.testing.assert_allclose(first.variance, [(0.5 * 0.015 * (1.0 - left)) ** 2, 0.0], rtol=1e-12)
    np.testing.assert_allclose(first.level_std, [0.5 * left, 0.0], rtol=1e-12)
    assert first.unknown.tolist() == [True, False]
    assert not gone_on(gone_on(first, *further), *further).unknown.any()


def test_time_constants_follow_their_kind_linearly_and_never_vanish() -> None:
    constants, slope = time_constants(np.array([0.01, 0.02]), np.array([1, 0]), 0.2, np.array([1.0, -10.0]))
    np.testing.assert_allclose(constants, [0.01 * LEAST_LAG, 0.02 * 1.2])
    np.testing.assert_allclose(slope[1], 0.2 / 1.2)
