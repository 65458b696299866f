"""Failures of true jets: the level that a jet delivers in place of the commanded one.

The truth's side of a failure; how one is found stands in `maths.estimation.detectors`.
"""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from massprop_drake.maths.kernels import kernel
from massprop_drake.maths.linear_algebra import Array
from massprop_drake.maths.noise import Seed, uniform_sample

_LEAST_SHARE = 1e-9  # of a sample that a failure covers


class FailureKind(IntEnum):
    """Kind of failure of a jet."""

    STUCK_ON = 0
    STUCK_OFF = 1
    DEGRADED = 2
    LEAK = 3
    INTERMITTENT = 4
    DRIFT = 5


class Failure(NamedTuple):
    """Failure of one jet.

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


class FailureTable(NamedTuple):
    """Failures one after the other, as arrays; see `Failure`, shape (n,) each."""

    jets: NDArray[np.int_]
    kinds: NDArray[np.int_]
    starts_s: Array
    ends_s: Array
    amounts: Array


def leaks_as_levels(failures: tuple[Failure, ...], thrusts: Array) -> tuple[Failure, ...]:
    """Returns failures with the forces of leaks, lbf or N, converted to shares of their jets' thrust.

    Args:
        failures: amount of a leak: its force.
        thrusts: true thrust of each jet, lbf or N, shape (n_jets,).
    """
    return tuple(
        one._replace(amount=one.amount / thrusts[one.jet]) if one.kind == FailureKind.LEAK else one for one in failures
    )


def failure_table(failures: tuple[Failure, ...]) -> FailureTable:
    """Packs jet failures (jets, kinds, amounts, times) into arrays, an element per failure."""
    return FailureTable(
        np.array([failure.jet for failure in failures], dtype=np.int_),
        np.array([int(failure.kind) for failure in failures], dtype=np.int_),
        np.array([failure.start_s for failure in failures], dtype=float),
        np.array([failure.end_s for failure in failures], dtype=float),
        np.array([failure.amount for failure in failures] or np.zeros(0)),
    )


def delivered_levels(command: Array, sample: int, period_s: float, failures: tuple[Failure, ...], seed: int) -> Array:
    """Computes each jet's target level over a sample under failures, 1: full thrust, shape (n_jets,).

    A failure that begins or ends within the sample acts with the share of the sample it covers.

    Args:
        command: fraction commanded over the sample, 0 to 1, shape (n_jets,).
        sample: number of the sample, which begins at sample x period.
        failures: one after the other; a jet may have several.
        seed: of the run, for intermittent failures.
    """
    if not failures:
        return command
    table = failure_table(failures)
    return apply_failures(command, sample * period_s, period_s, draw_strikes(failures, sample, period_s, seed), table)


def draw_strikes(failures: tuple[Failure, ...], sample: int, period_s: float, seed: Seed) -> NDArray[np.bool_]:
    """Draws which intermittent failures act in a sample, a mask of shape (n,); see `delivered_levels`."""
    result = np.zeros(len(failures), dtype=np.bool_)
    begins = sample * period_s
    for index, failure in enumerate(failures):
        if failure.kind != FailureKind.INTERMITTENT:
            continue
        if failure.start_s < begins + period_s and failure.end_s > begins:
            result[index] = uniform_sample(seed, failure.stream, sample) < failure.probability
    return result


@kernel
def apply_failures(
    command: Array, begins_s: float, period_s: float, strikes: NDArray[np.bool_], failures: FailureTable
) -> Array:
    """Computes each jet's target level under failures, shape (n_jets,), intermittent ones drawn before.

    Args:
        command: fraction commanded over the sample, 0 to 1, shape (n_jets,).
        begins_s: when the sample does, s.
        strikes: see `draw_strikes`, shape (n,).
    """
    level = np.copy(command)
    for index in range(failures.jets.size):
        start, jet = failures.starts_s[index], failures.jets[index]
        covered = min(failures.ends_s[index], begins_s + period_s) - max(start, begins_s)
        share = min(max(covered / period_s, 0.0), 1.0)
        if share > _LEAST_SHARE:
            told, kind, amount = command[jet], failures.kinds[index], failures.amounts[index]
            late = max(0.0, begins_s - start)
            level[jet] += share * (_failed_level(told, kind, amount, strikes[index], late) - told)
    return level


@kernel
def _failed_level(command: float, kind: int, amount: float, strikes: bool, elapsed_s: float) -> float:
    """Computes a failed jet's thrust level, 1: full, under a command; ``elapsed_s``: time since the failure began."""
    if kind == FailureKind.STUCK_ON:
        return 1.0
    if kind == FailureKind.STUCK_OFF:
        return 0.0
    if kind == FailureKind.DEGRADED:
        return command * amount
    if kind == FailureKind.LEAK:
        return command + amount
    if kind == FailureKind.INTERMITTENT:
        return amount if strikes else command
    return command * max(0.0, 1.0 + amount * elapsed_s)
