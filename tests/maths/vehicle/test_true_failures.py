"""What failed jets deliver in place of what they are told."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.stats import binom

from massprop_drake.maths.linear_algebra import Array
from massprop_drake.maths.vehicle.true_failures import Failure, FailureKind, delivered_levels

PERIOD_S = 0.08
COMMAND = np.array([0.0, 0.5, 1.0])
ONSET = 10  # sample at whose beginning the failures here set in
ONSET_S = ONSET * PERIOD_S
# the share of a sample that a failure covers is a difference of times of up to 400 s over 0.08 s
ROUNDING = 1e-11


def flown(failures: tuple[Failure, ...], sample: int, seed: int = 0) -> Array:
    command = COMMAND.copy()
    level = delivered_levels(command, sample, PERIOD_S, failures, seed)
    assert_array_equal(command, COMMAND)
    return level


# told 0, 0.5 and 1; the drift is seen 25 and 50 samples = 2 and 4 s after onset, at whatever time of the sample
@pytest.mark.parametrize(
    ("kind", "values", "expected", "later"),
    [
        (FailureKind.STUCK_ON, {}, [1.0, 1.0, 1.0], 0.0),
        (FailureKind.STUCK_OFF, {}, [0.0, 0.0, 0.0], 0.0),
        (FailureKind.DEGRADED, {"amount": 0.3}, [0.0, 0.15, 0.3], 0.0),
        (FailureKind.LEAK, {"amount": 0.015}, [0.015, 0.515, 1.015], 0.0),
        (FailureKind.INTERMITTENT, {"amount": 0.25, "probability": 1.0}, [0.25, 0.25, 0.25], 0.0),
        (FailureKind.INTERMITTENT, {"amount": 0.25, "probability": 0.0}, [0.0, 0.5, 1.0], 0.0),
        (FailureKind.DRIFT, {"amount": -0.1}, [0.0, 0.4, 0.8], -0.2),
        (FailureKind.DRIFT, {"amount": 0.1}, [0.0, 0.6, 1.2], 0.2),
        (FailureKind.DRIFT, {"amount": -0.6}, [0.0, 0.0, 0.0], 0.0),  # nothing is left, and it does not turn round
    ],
)
def test_each_kind(kind: int, values: dict[str, float], expected: list[float], later: float) -> None:
    for jet in range(3):
        failure = (Failure(jet, FailureKind(kind), ONSET_S, math.inf, **values),)  # type: ignore[arg-type]
        level = flown(failure, ONSET + 25)
        drift = abs(values.get("amount", 0.0)) * PERIOD_S if kind == FailureKind.DRIFT else ROUNDING
        assert_allclose(level[jet], expected[jet], atol=0.5 * drift + ROUNDING)
        assert_allclose(flown(failure, ONSET + 50)[jet] - level[jet], later * COMMAND[jet], atol=ROUNDING)
        assert_array_equal(np.delete(level, jet), np.delete(COMMAND, jet))
        assert_array_equal(flown(failure, ONSET - 1), COMMAND)


MIDDLE = ONSET_S + 0.5 * PERIOD_S


@pytest.mark.parametrize(
    ("jet", "failures", "expected"),
    [
        # 3/4 of a sample, and 3/4 of the next
        (2, ((FailureKind.STUCK_OFF, ONSET_S + 0.02, ONSET_S + PERIOD_S + 0.06, 0.0),), [1.0, 0.25, 0.25, 1.0]),
        (0, ((FailureKind.STUCK_ON, ONSET_S + 0.02, ONSET_S + 0.04, 0.0),), [0.0, 0.25, 0.0, 0.0]),
        (1, ((FailureKind.LEAK, MIDDLE, math.inf, 0.2),), [0.5, 0.6, 0.7, 0.7]),
        # one after the other, and two in one sample, each for its part of it
        (
            2,
            (
                (FailureKind.STUCK_OFF, ONSET_S, ONSET_S + PERIOD_S, 0.0),
                (FailureKind.DEGRADED, ONSET_S + PERIOD_S, ONSET_S + 2 * PERIOD_S, 0.4),
            ),
            [1.0, 0.0, 0.4, 1.0],
        ),
        (
            0,
            ((FailureKind.STUCK_ON, ONSET_S, MIDDLE, 0.0), (FailureKind.STUCK_OFF, MIDDLE, math.inf, 0.0)),
            [0.0, 0.5, 0.0, 0.0],
        ),
        (2, ((FailureKind.DRIFT, ONSET_S + 0.06, math.inf, -0.5),), [1.0, 1.0, 0.99, 0.95]),  # by 0.04 a sample
    ],
)
def test_failures_count_by_the_part_of_a_sample_that_they_cover(
    jet: int, failures: tuple[tuple[FailureKind, float, float, float], ...], expected: list[float]
) -> None:
    made = tuple(Failure(jet, kind, start, end, amount=amount) for kind, start, end, amount in failures)
    for order in (made, made[::-1]):
        level = [flown(order, k)[jet] for k in range(ONSET - 1, ONSET + 3)]
        assert_allclose(level, expected, atol=ROUNDING)


FLICKER = Failure(0, FailureKind.INTERMITTENT, 0.0, math.inf, amount=1.0, probability=0.3, stream="failure 0 of A")


def flickers(failure: Failure, samples: range, seed: int) -> list[float]:
    return [float(flown((failure,), k, seed=seed)[0]) for k in samples]


def test_intermittent_failures_are_reproducible_and_strike_at_their_rate_independently() -> None:
    chance = flickers(FLICKER, range(200), seed=5)
    assert flickers(FLICKER, range(199, -1, -1), seed=5) == chance[::-1]
    # two independent records of 200 samples agree throughout with a probability below 1e-40
    assert chance != flickers(FLICKER, range(200), seed=6)
    assert chance != flickers(FLICKER._replace(stream="failure 1 of A"), range(200), seed=5)
    count, record = 2000, np.array(flickers(FLICKER, range(2000), seed=2))
    struck = np.round(record)
    assert np.abs(record - struck).max() < ROUNDING  # all or nothing
    # 99.9 % intervals of the binomial law, for strikes and for two in a row (non-overlapping pairs)
    for found, trials, rate in ((struck.sum(), count, 0.3), ((struck[::2] * struck[1::2]).sum(), count // 2, 0.09)):
        low, high = binom.interval(0.999, trials, rate)
        assert low <= found <= high
