"""What failed jets deliver in place of what they are told."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from scipy.stats import binom

from massprop_drake.maths.linear_algebra import Array
from massprop_drake.maths.vehicle.true_failures import Failure, FailureKind, delivered

PERIOD_S = 0.08
COMMAND = np.array([0.0, 0.5, 1.0])
ONSET = 10  # sample at whose beginning the failures here set in
ONSET_S = ONSET * PERIOD_S
# the share of a sample that a failure covers is a difference of times of up to 400 s over 0.08 s
ROUNDING = 1e-11


def lasting(kind: int, jet: int = 1, **values: float) -> Failure:
    """A failure that never ends, from the beginning of sample ONSET on."""
    return Failure(jet, kind, ONSET_S, math.inf, **values)  # type: ignore[arg-type]


def flown(failures: tuple[Failure, ...], sample: int, command: Array = COMMAND, seed: int = 0) -> Array:
    return delivered(command, sample, PERIOD_S, failures, seed)


def test_without_failures_jets_do_what_they_are_told() -> None:
    np.testing.assert_array_equal(flown((), 5), COMMAND)


# told 0, 0.5 and 1; the drift is seen 25 samples = 2 s after onset
@pytest.mark.parametrize(
    ("kind", "values", "expected"),
    [
        (FailureKind.STUCK_ON, {}, [1.0, 1.0, 1.0]),
        (FailureKind.STUCK_OFF, {}, [0.0, 0.0, 0.0]),
        (FailureKind.DEGRADED, {"amount": 0.3}, [0.0, 0.15, 0.3]),
        (FailureKind.LEAK, {"amount": 0.015}, [0.015, 0.515, 1.015]),
        (FailureKind.INTERMITTENT, {"amount": 0.25, "probability": 1.0}, [0.25, 0.25, 0.25]),
        (FailureKind.INTERMITTENT, {"amount": 0.25, "probability": 0.0}, [0.0, 0.5, 1.0]),
    ],
)
def test_each_kind(kind: int, values: dict[str, float], expected: list[float]) -> None:
    level = [flown((lasting(kind, jet, **values),), ONSET + 25)[jet] for jet in range(3)]
    np.testing.assert_allclose(level, expected, atol=ROUNDING)


def test_a_drift_changes_the_thrust_in_proportion_to_time() -> None:
    failure = (lasting(FailureKind.DRIFT, jet=2, amount=-0.1),)
    level = [flown(failure, ONSET + k)[2] for k in (25, 50)]
    # -0.1 per second after 2 s and 4 s; where in the sample the drift is read off leaves half a period's
    # worth, 0.004, open
    np.testing.assert_allclose(level, [0.8, 0.6], atol=0.0041)
    np.testing.assert_allclose(level[0] - level[1], 0.2, atol=ROUNDING)
    # after 20 s nothing is left, and it does not turn round
    np.testing.assert_allclose(flown(failure, ONSET + 250)[2], 0.0, atol=ROUNDING)
    assert flown((lasting(FailureKind.DRIFT, jet=2, amount=0.1),), ONSET + 25)[2] > 1.19


def test_only_the_failed_jet_is_touched_and_the_command_is_left_alone() -> None:
    command = COMMAND.copy()
    level = flown((lasting(FailureKind.STUCK_ON, jet=0),), ONSET, command)
    np.testing.assert_allclose(level, [1.0, 0.5, 1.0], atol=ROUNDING)
    np.testing.assert_array_equal(level[1:], COMMAND[1:])
    np.testing.assert_array_equal(command, COMMAND)


def test_failures_of_different_jets_stand_side_by_side() -> None:
    failures = (
        lasting(FailureKind.STUCK_ON, jet=0),
        lasting(FailureKind.LEAK, jet=1, amount=0.1),
        lasting(FailureKind.STUCK_OFF, jet=2),
    )
    np.testing.assert_allclose(flown(failures, ONSET + 1), [1.0, 0.6, 0.0], atol=ROUNDING)


@pytest.mark.parametrize("sample", [1, 3, 7, 19, 625, 1234, 4999])
def test_a_failure_at_a_sample_mark_begins_and_ends_with_whole_samples(sample: int) -> None:
    # sample x period is rarely exact; a sliver of a sample must not count
    failure = (Failure(0, FailureKind.STUCK_ON, sample * PERIOD_S, (sample + 2) * PERIOD_S),)
    level = [flown(failure, k)[0] for k in range(sample - 1, sample + 4)]
    np.testing.assert_allclose(level, [0.0, 1.0, 1.0, 0.0, 0.0], atol=ROUNDING)
    assert level[0] == level[3] == 0.0


def test_onset_and_end_within_a_sample_count_by_the_part_they_cover() -> None:
    begins = 4 * PERIOD_S
    failure = (
        Failure(2, FailureKind.STUCK_OFF, begins + 0.02, begins + PERIOD_S + 0.06),
    )  # 3/4 of one, 3/4 of the next
    level = [flown(failure, k)[2] for k in range(3, 7)]
    np.testing.assert_allclose(level, [1.0, 0.25, 0.25, 1.0], atol=ROUNDING)
    inside = (Failure(0, FailureKind.STUCK_ON, begins + 0.02, begins + 0.04),)  # a quarter, within one sample
    np.testing.assert_allclose(flown(inside, 4)[0], 0.25, atol=ROUNDING)


def test_a_partial_sample_mixes_the_failed_and_the_commanded_level() -> None:
    failure = (Failure(1, FailureKind.LEAK, ONSET_S + 0.04, math.inf, amount=0.2),)
    np.testing.assert_allclose(flown(failure, ONSET)[1], 0.5 + 0.5 * 0.2, atol=ROUNDING)


def test_one_failure_of_a_jet_after_another() -> None:
    failures = (
        Failure(2, FailureKind.STUCK_OFF, 5 * PERIOD_S, 7 * PERIOD_S),
        Failure(2, FailureKind.DEGRADED, 7 * PERIOD_S, 9 * PERIOD_S, amount=0.4),
        Failure(2, FailureKind.LEAK, 10 * PERIOD_S, math.inf, amount=0.1),
    )
    level = [flown(failures, k)[2] for k in range(4, 12)]
    np.testing.assert_allclose(level, [1.0, 0.0, 0.0, 0.4, 0.4, 1.0, 1.1, 1.1], atol=ROUNDING)
    reverse = [flown(failures[::-1], k)[2] for k in range(4, 12)]
    np.testing.assert_allclose(reverse, level, atol=ROUNDING)


def test_two_failures_of_a_jet_that_share_a_sample_each_act_for_their_part_of_it() -> None:
    # on for the first half of the sample, off for the second, told nothing: half the thrust on average
    middle = ONSET_S + 0.5 * PERIOD_S
    failures = (Failure(0, FailureKind.STUCK_ON, ONSET_S, middle), Failure(0, FailureKind.STUCK_OFF, middle, math.inf))
    np.testing.assert_allclose(flown(failures, ONSET)[0], 0.5, atol=ROUNDING)
    np.testing.assert_allclose(flown(failures[::-1], ONSET)[0], 0.5, atol=ROUNDING)


def test_a_drift_downwards_never_raises_the_thrust() -> None:
    failure = (Failure(2, FailureKind.DRIFT, ONSET_S + 0.06, math.inf, amount=-0.5),)
    level = [flown(failure, k)[2] for k in range(ONSET - 1, ONSET + 4)]
    assert max(level) <= 1.0 + ROUNDING
    assert all(later <= earlier + ROUNDING for earlier, later in itertools.pairwise(level))


# --------------------------------------------------------------------------------------- intermittent

FLICKER = Failure(0, FailureKind.INTERMITTENT, 0.0, math.inf, amount=1.0, probability=0.3, stream="failure 0 of A")


def flickers(failure: Failure, samples: range, seed: int) -> list[float]:
    return [float(flown((failure,), k, seed=seed)[0]) for k in samples]


def test_intermittent_failures_are_reproducible_in_any_order() -> None:
    forward = flickers(FLICKER, range(200), seed=5)
    backward = flickers(FLICKER, range(199, -1, -1), seed=5)
    assert forward == backward[::-1]


def test_intermittent_failures_differ_between_seeds_and_between_jets() -> None:
    chance = flickers(FLICKER, range(200), seed=5)
    # two independent records of 200 samples agree throughout with a probability below 1e-40
    assert chance != flickers(FLICKER, range(200), seed=6)
    assert chance != flickers(FLICKER._replace(stream="failure 1 of A"), range(200), seed=5)


def test_intermittent_failures_strike_at_their_rate_independently() -> None:
    count = 3000
    struck = np.array(flickers(FLICKER, range(count), seed=2))
    assert np.abs(struck - np.round(struck)).max() < ROUNDING  # all or nothing
    struck = np.round(struck)
    # 99.9 % intervals of the binomial law, for strikes and for two in a row (non-overlapping pairs)
    low, high = binom.interval(0.999, count, 0.3)
    assert low <= struck.sum() <= high
    low, high = binom.interval(0.999, count // 2, 0.09)
    assert low <= (struck[::2] * struck[1::2]).sum() <= high
