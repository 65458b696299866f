"""Failures of jets as they happen: what a jet delivers in place of what it was told.

The truth's side of a failure; how one is found stands in `maths.estimation.detectors`.
"""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple

import numpy as np

from massprop_drake.maths.linear_algebra import Array
from massprop_drake.maths.noise import uniform_sample


class FailureKind(IntEnum):
    """What becomes of a jet."""

    STUCK_ON = 0
    STUCK_OFF = 1
    DEGRADED = 2
    LEAK = 3
    INTERMITTENT = 4
    DRIFT = 5


class Failure(NamedTuple):
    """One failure of one jet.

    Attributes:
        jet: index of the jet.
        kind: STUCK_ON, STUCK_OFF, DEGRADED, LEAK, INTERMITTENT or DRIFT.
        start_s: onset, s.
        end_s: when the jet is well again, s; infinity: never.
        amount: DEGRADED: share of the thrust that is left; LEAK: force over full thrust, commanded or
            not; INTERMITTENT: level the valve shows when it fails; DRIFT: change of the thrust per
            second, relative; else unused.
        probability: INTERMITTENT: of failing in any one sample.
        stream: INTERMITTENT: name of its stream of chance.
    """

    jet: int
    kind: FailureKind
    start_s: float
    end_s: float
    amount: float = 0.0
    probability: float = 0.0
    stream: str = ""


def delivered(command: Array, sample: int, period_s: float, failures: tuple[Failure, ...], seed: int) -> Array:
    """What each jet's level tends to over a sample, 1: full thrust; the command itself without failures.

    A failure that begins or ends within the sample acts with the share of the sample it covers.

    Args:
        command: fraction commanded over the sample, 0 to 1, shape (n_jets,).
        sample: number of the sample, which begins at sample x period.
        period_s: sample period, s.
        failures: one after the other; a jet may have several.
        seed: of the run, for intermittent failures.
    """
    if not failures:
        return command
    level = np.array(command)
    begins = sample * period_s
    for failure in failures:
        covered = min(failure.end_s, begins + period_s) - max(failure.start_s, begins)
        share = min(max(covered / period_s, 0.0), 1.0)
        if share <= 1e-9:
            continue
        told = float(command[failure.jet])
        level[failure.jet] += share * (_failed_level(told, sample, begins, failure, seed) - told)
    return level


def _failed_level(told: float, sample: int, begins_s: float, failure: Failure, seed: int) -> float:
    match failure.kind:
        case FailureKind.STUCK_ON:
            return 1.0
        case FailureKind.STUCK_OFF:
            return 0.0
        case FailureKind.DEGRADED:
            return told * failure.amount
        case FailureKind.LEAK:
            return told + failure.amount
        case FailureKind.INTERMITTENT:
            struck = uniform_sample(seed, failure.stream, sample) < failure.probability
            return failure.amount if struck else told
        case _:
            return told * max(0.0, 1.0 + failure.amount * max(0.0, begins_s - failure.start_s))
