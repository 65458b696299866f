"""On-times: pieces of a sample, shares of pulses, and levels by an independent integration."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from massprop_drake.maths.vehicle.on_times import (
    command_onsets,
    has_pulse,
    onsets,
    pulse_samples,
    pulse_shares,
    split_sample,
)
from massprop_drake.maths.vehicle.reaction_jets import level_course
from massprop_drake.maths.vehicle.true_failures import Failure, FailureKind, failure_table

T = 0.1
WHOLE = (0.0, T)


def test_a_sample_is_cut_where_a_jet_opens_or_closes() -> None:
    lengths, levels = split_sample(np.array([0.35, 0.5, 1.0, 0.0]), np.array([0.0, 0.02, 0.0, 0.0]), T, WHOLE)
    np.testing.assert_allclose(lengths, [0.02, 0.015, 0.035, 0.03], rtol=1e-12)
    np.testing.assert_array_equal(levels, [[1, 0, 1, 0], [1, 1, 1, 0], [0, 1, 1, 0], [0, 0, 1, 0]])


def test_a_command_without_an_onset_is_a_level_and_one_that_is_not_known_stays_so() -> None:
    lengths, levels = split_sample(np.array([0.35, np.nan]), np.array([np.nan, 0.01]), T, WHOLE)
    np.testing.assert_array_equal(lengths, [T])
    np.testing.assert_array_equal(levels, [[0.35, np.nan]])
    assert not has_pulse(np.array([0.35, np.nan, 1.0, 0.0]), np.array([np.nan, 0.01, 0.0, 0.03]))
    assert has_pulse(np.array([0.0, 0.35]), np.array([0.0, 0.0]))


def test_a_part_of_a_sample_and_the_time_after_it() -> None:
    told = np.array([0.5, 1.0]), np.array([0.02, 0.0])
    lengths, levels = split_sample(*told, T, (0.05, 0.15))
    np.testing.assert_allclose(lengths, [0.02, 0.08], rtol=1e-12)
    np.testing.assert_array_equal(levels, [[1, 1], [0, 1]])  # what is on for a whole sample goes on


@given(st.lists(st.tuples(st.floats(0.0, 1.0), st.floats(0.0, 1.0)), min_size=1, max_size=8))
@settings(max_examples=60, derandomize=True, deadline=None)
@example([(0.35, 0.0), (0.35 + 1e-9, 0.0), (1e-9, 0.0)])  # closer than arithmetic tells
def test_no_impulse_is_lost(drawn: list[tuple[float, float]]) -> None:
    """However close edges lie."""
    command = np.array([share for share, _ in drawn])
    onset_s = np.array([T * (1.0 - share) * late for share, late in drawn])
    lengths, levels = split_sample(command, onset_s, T, WHOLE)
    assert (lengths > 1e-7 * T).all()
    assert ((levels >= 0.0) & (levels <= 1.0)).all()
    np.testing.assert_allclose(lengths.sum(), T, rtol=1e-14)
    np.testing.assert_allclose(lengths @ levels, T * command, rtol=1e-12, atol=1e-14)


@pytest.mark.parametrize(("place", "expected"), [("start", 0.0), ("center", 0.0325), ("end", 0.065)])
def test_where_an_on_time_lies_that_has_no_onset(place: str, expected: float) -> None:
    found = onsets(np.array([0.35, 1.0]), place, T)  # type: ignore[arg-type]
    np.testing.assert_allclose(found, [expected, 0.0], atol=1e-15)
    told = command_onsets(np.array([0.35]), None, place, T)  # type: ignore[arg-type]
    np.testing.assert_allclose(told, [expected], atol=1e-15)
    assert np.isnan(command_onsets(np.array([0.35]), None, None, T)).all()
    np.testing.assert_array_equal(command_onsets(np.array([0.35]), np.array([0.01]), "end", T), [0.01])


def test_the_samples_of_a_pulse() -> None:
    found = list(pulse_shares(1.02, 1.25, T, 100))
    np.testing.assert_allclose(found, [(10, 0.02, 0.8), (11, 0.0, 1.0), (12, 0.0, 0.5)], atol=1e-12)
    assert list(pulse_shares(1.02, 1.25, T, 11)) == found[:1]  # the record ends
    assert list(pulse_shares(0.3, 0.6, T, 100)) == [(3, 0.0, 1.0), (4, 0.0, 1.0), (5, 0.0, 1.0)]
    assert pulse_samples(0.3, 0.6, T) == (3, 6)


def stepped(command: np.ndarray, onset_s: np.ndarray, tau_s: np.ndarray, level: np.ndarray) -> tuple[np.ndarray, ...]:
    """Mean level over a sample and the last one, by small steps of the lag."""
    count, total = 2_000, np.zeros_like(level)
    step = T / count
    for index in range(count):
        now = (index + 0.5) * step
        target = ((now >= onset_s) & (now < onset_s + command * T)).astype(float)
        after = target + (level - target) * np.exp(-step / tau_s)
        total += 0.5 * (level + after) * step
        level = after
    return total / T, level


def test_levels_follow_their_pulses_through_the_lag() -> None:
    told = np.array([0.35, 0.2, 1.0]), np.array([0.02, 0.08, 0.0])
    tau_s, begin = np.array([0.015, 0.03, 0.02]), np.array([0.4, 0.0, 0.1])
    nothing = failure_table(()), np.zeros(0, dtype=np.bool_)
    found = level_course(begin, (*told, np.zeros(3)), (0.0, T), nothing, tau_s)
    mean, end = stepped(*told, tau_s, begin)
    np.testing.assert_allclose(found.mean, mean, atol=2e-6)
    np.testing.assert_allclose(found.end, end, atol=2e-5)
    at_once = level_course(begin, (*told, np.zeros(3)), (0.0, T), nothing, np.zeros(3))
    np.testing.assert_allclose(at_once.mean, told[0], rtol=1e-14)


def test_a_failure_and_a_closed_manifold_act_in_every_piece() -> None:
    failing = (Failure(0, FailureKind.STUCK_ON, 0.05, np.inf), Failure(1, FailureKind.DEGRADED, 0.0, np.inf, 0.5))
    struck = failure_table(failing), np.zeros(2, dtype=np.bool_)
    told = np.array([0.2, 0.4, 0.4]), np.array([0.0, 0.03, 0.03])
    found = level_course(np.zeros(3), (*told, np.array([0.0, 0.0, 1.0])), (0.0, T), struck, np.zeros(3))
    np.testing.assert_allclose(found.mean, [0.7, 0.2, 0.0], rtol=1e-12)  # .02 s and, stuck, .05 s of .1 s
