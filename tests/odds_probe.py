"""A detector for the joint filter that gives posterior probabilities by heart, in place of the hypothesis filter."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from massprop_drake.maths.estimation.adaptation import NO_ADAPTATION
from massprop_drake.maths.estimation.detector import NO_KNOWN_FORCE, Detector, Judgment
from massprop_drake.maths.estimation.faults.declarations import Mode
from massprop_drake.maths.estimation.faults.fault_report import (
    HYPOTHESIS_REPORT,
    History,
    Odds,
    hypothesis_report_row,
    status_row,
)
from massprop_drake.maths.estimation.joint.hypotheses import Score

Array = NDArray[np.float64]


class State(NamedTuple):
    """What such a detector remembers: how many samples it has seen, and no failed jet."""

    samples: int
    force: Array
    variance: Array
    removed: Array
    closed: Array


def odds(n: int, jets: dict[int, float], none: float = 0.0, unknown: float = 0.0) -> Odds:
    """Odds of which each likely jet leaks by ten.

    Args:
        n: number of jets.
        jets: probability that each has failed, by index.
        none, unknown: see `Odds`.
    """
    probabilities, modes = np.zeros(n), np.zeros(n)
    forces, sigmas = np.full(n, np.nan), np.full(n, np.nan)
    for jet, probability in jets.items():
        probabilities[jet], modes[jet] = probability, Mode.LEAK
        forces[jet], sigmas[jet] = 10.0, 0.25
    return Odds(3, none, unknown, probabilities, modes, forces, sigmas)


def history(since_s: float, rotation: tuple[float, float], mass: tuple[float, float]) -> History:
    """A history that has become the likeliest, with sum of the NIS and its expectation by filter."""
    nis, degrees = (one + other for one, other in zip(rotation, mass, strict=True))
    return History(since_s, Score(0.0, nis, degrees, *rotation))


def detector(told: Callable[[int], tuple[Odds, History | None]]) -> Detector:
    """A detector that declares nothing.

    Args:
        told: by number of the sample, what it says.
    """

    def judge(state: State, evidence: Any, params: int) -> Judgment:
        now, past = told(state.samples)
        unknown = np.full(params, np.nan)
        status = status_row((), now, True, 0.0)
        after = state._replace(samples=state.samples + 1)
        return Judgment(after, NO_ADAPTATION, status, unknown, unknown, own=hypothesis_report_row((), now, past))

    return Detector(
        made_for="joint",
        params=lambda jets, options, filter_params: jets.thrusts.size,
        initial=lambda params: State(0, *(np.zeros(params) for _ in range(4))),
        known_force=lambda *_: NO_KNOWN_FORCE,
        judge=judge,
        saved=lambda state, params: np.array([float(state.samples)]),
        restored=lambda vector, params: State(int(vector[0]), *(np.zeros(params) for _ in range(4))),
        group="hypothesis_detector",
        report=HYPOTHESIS_REPORT,
    )
