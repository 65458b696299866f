"""First-order comparison of all jets over a start: columns beside a filter without a failure, see `screen`.

The filter takes rounding for white noise. What it learns from a cell far off its prediction is not linear in its
errors, and would favor wrong jets by a tenth of what a failure explains.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from massprop_drake.maths.estimation.faults.priors import Priors, log_event_probability
from massprop_drake.maths.estimation.joint import screen as screens
from massprop_drake.maths.estimation.joint.hypotheses import Kind, known_forces
from massprop_drake.maths.estimation.joint.joint_cycle import restart
from massprop_drake.maths.estimation.joint.layout import RATE, JointParams, JointState
from massprop_drake.maths.estimation.joint.measurement import readings
from massprop_drake.maths.estimation.joint.relinearization import run_relinearized
from massprop_drake.maths.estimation.joint.screen import Contender, Screen
from massprop_drake.maths.estimation.joint.sensitivity import collect_cycle_terms, linearize_terms
from massprop_drake.maths.estimation.joint.start import Kept
from massprop_drake.maths.linear_algebra import Array

_ONSETS = 16  # of a screening: compute budget
_FINER, _FINE = 3, 2  # by which intervals between onsets are divided, until they are so many samples
_LENIENT = 1.5  # times its thrust that a jet may be found to give where a screening is linearized far off


class Screening(NamedTuple):
    """Comparison in progress.

    Attributes:
        entry: state before the first kept sample.
        about: estimate at which it is linearized, shape (size,).
        state: of the filter that knows of no failure.
        screen: see `Screen`; onsets are numbers of kept samples before them.
        coarse: found with coarser onsets.
    """

    entry: JointState
    about: Array
    state: JointState
    screen: Screen
    coarse: tuple[Contender, ...] = ()


def begin_screening(
    entry_state: JointState,
    linearization_point: Array,
    samples: tuple[Kept, ...],
    onset_window: tuple[int, int] | None,
    params: JointParams,
) -> Screening:
    """Begins a first-order test of all jets for failures at onsets among the kept samples.

    Args:
        entry_state, linearization_point: see `entry` and `about` of `Screening`.
        onset_window: onset about which it looks, and samples between onsets; None: it looks everywhere.
    """
    count, first = len(samples), samples[0].sample
    middle, gap = onset_window or (0, -(-count // _ONSETS))
    least = middle % gap if middle < gap * (_ONSETS // 2) else middle - gap * (_ONSETS // 2)
    onsets = tuple(range(least, count, gap))[: _ONSETS + 1]
    gaps = tuple(gap if onset > 0 else 1 for onset in onsets)
    read = readings(first.rates, first.velocities, first.attitudes)
    return Screening(
        entry_state,
        linearization_point,
        entry_state,
        screens.begin_screen((entry_state, 0), onsets, gaps, read, params, single=True),
    )


def step_screening(screening: Screening, kept_sample: Kept, params: JointParams) -> Screening:
    """Advances the first-order test of all jets by the next kept sample."""
    screen, sample = screening.screen, kept_sample.sample
    if kept_sample.anew:
        state, _ = restart(screening.state, sample, params)
        columns = screen.columns.copy()
        columns[RATE.start : params.places.thrust] = 0.0
        scores = (*screen.scores, screen.scores[-1])
        return screening._replace(
            state=state, screen=screen._replace(cycle=screen.cycle + 1, columns=columns, scores=scores)
        )
    none = np.zeros_like(params.cells)
    rounded = params._replace(cells=none, quanta=none, floors=params.variances)
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        state, course, _ = run_relinearized(screening.state, sample, screening.about, rounded)
        screen = screens.advance_screen(
            screen, linearize_terms(collect_cycle_terms(screening.about, course, sample), params), params
        )
    return screening._replace(state=state, screen=screen)


def refine_onsets(screening: Screening, samples: tuple[Kept, ...], params: JointParams) -> Screening | None:
    """Begins a first-order test with finer onsets about the likeliest; None: they are fine enough, or no jet found."""
    found, gap = rank_jets(screening, params), screening.screen.gaps[-1]
    if not found or gap <= _FINE:
        return None
    finer = begin_screening(screening.entry, screening.about, samples, (found[0].onset, max(1, gap // _FINER)), params)
    return finer._replace(coarse=tuple(found))


def rank_jets(screening: Screening, params: JointParams) -> list[Contender]:
    """Lists jet failures that the first-order test finds, likeliest first; those only a coarser test found last."""
    entry = screening.entry
    known = known_forces(entry, params)
    allowed = (np.ones_like(known) if (entry.slot_jet < 0).any() else known) > 0.0
    lenient = params._replace(thrusts=_LENIENT * params.thrusts)
    found: dict[object, Contender] = {}
    for each in (*screens.propose_faults(screening.screen, allowed, known, lenient), *screening.coarse):
        if each.cause.kind == Kind.JETS:
            found.setdefault(each.cause.key, each)
    return list(found.values())


def log_prior(proposal: Contender, screening: Screening, samples: tuple[Kept, ...], priors: Priors) -> float:
    """Computes the log prior of a jet's failure at the onsets that the first-order test finds likely, nats."""
    interval_s = (samples[-1].sample.time_s - screening.entry.time_s) / len(samples)
    gaps = dict(zip(screening.screen.onsets, screening.screen.gaps, strict=True))
    likely = [(gaps.get(onset, 1), lead - proposal.lead) for onset, lead in proposal.at_onsets]
    count = sum(gap * math.exp(min(less, 0.0)) for gap, less in likely)
    return log_event_probability(priors.jet_per_hour, interval_s * min(max(count, 1.0), len(samples)))
