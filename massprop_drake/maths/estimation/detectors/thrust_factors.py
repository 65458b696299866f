"""Detector of jets that are weak or stuck open, also from the start, by the pose filter's thrust factors.

The mathematics is in `pose.hypotheses`; the filter carries the hypotheses, and this judges them. A jet that is named
alone is put out of use.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from massprop_drake.maths.estimation.adaptation import NO_ADAPTATION
from massprop_drake.maths.estimation.detector import NO_KNOWN_FORCE, STATUS, Detector, Judgment, KnownJets, Verdict
from massprop_drake.maths.estimation.faults.declarations import Declaration, JetsDeclared, Unexplained, Word
from massprop_drake.maths.estimation.faults.fault_report import HYPOTHESIS_REPORT, declaration_row
from massprop_drake.maths.estimation.filters.pose import PoseEvidence, PoseFilterParams
from massprop_drake.maths.estimation.pose import delays, pose_hypotheses
from massprop_drake.maths.estimation.pose.pose_hypotheses import PoseOutcome, PoseRules
from massprop_drake.maths.estimation.pose.pose_layout import PoseParams
from massprop_drake.maths.linear_algebra import Array

GROUP = "thrust_factor_detector"  # its part of a saved state


class FactorParams(NamedTuple):
    """Parameters of the detector.

    Attributes:
        thrusts: full force of each jet, lbf or N, shape (n_jets,).
        rules: when a failure is named.
    """

    pose: PoseParams
    thrusts: Array
    rules: PoseRules


class ThrustFactorsState(NamedTuple):
    """State of the detector between samples.

    Attributes:
        grouped: members of the group that has been named last, 1 each, shape (1 + 2 n_jets,).
        force, variance: zero; what a failed jet gives is known to the filter, shape (n_jets,).
        removed: 1 for each jet that is named alone, shape (n_jets,).
        closed: 1 for each jet whose manifold is closed: none, shape (n_jets,).
    """

    grouped: Array
    force: Array
    variance: Array
    removed: Array
    closed: Array


def make_params(jets: KnownJets, options: Any, filter_params: PoseFilterParams) -> FactorParams:
    """Makes the detector's parameters from those of the pose filter, the jets' thrusts and the scenario's block."""
    rules = PoseRules(options.lead, options.lead_nothing, options.least)
    return FactorParams(filter_params.pose, jets.thrusts, rules)


def initial_state(params: FactorParams) -> ThrustFactorsState:
    """Returns the detector's state before the first sample: nothing declared, no jet removed."""
    none = np.zeros(params.thrusts.size)
    return ThrustFactorsState(np.zeros(1 + 2 * none.size), none, none, none, none)


def judge(state: ThrustFactorsState, evidence: PoseEvidence, params: FactorParams) -> Judgment:
    """Declares the jet, or group, that the pose filter's hypotheses show to have failed; returns the judgment."""
    jets = params.thrusts.size
    if not evidence.tested:
        nothing = np.full(jets, np.nan)
        own = declaration_row((), jets)._replace(racing=0.0)
        return Judgment(state, NO_ADAPTATION, _status_row(None, None, 0.0, params), nothing, nothing, own=own)
    odds = evidence.tried.likelihood[1 : 1 + 2 * jets]
    leads = np.maximum(odds[:jets], odds[jets:])
    tried, outcome = delays.name_failure_over_delays(evidence.tried, evidence.time_s, params.rules, params.pose)
    ahead = pose_hypotheses.leading_hypothesis(tried, params.rules)
    if outcome is not None:
        members = np.zeros(1 + 2 * jets)
        members[list(outcome.members)] = 1.0
        if len(outcome.members) > 1 and np.array_equal(members, state.grouped):
            outcome = None  # said already
        else:
            state = state._replace(grouped=members)
    pushed = outcome is not None and 2 * jets in outcome.members
    if outcome is not None and len(outcome.members) == 1 and not pushed:
        removed = state.removed.copy()
        removed[outcome.members[0] % jets] = 1.0
        state = state._replace(removed=removed)
    likeliest = int(np.argmax(odds)) if np.isfinite(odds).any() else None
    said = () if outcome is None else (_make_declaration(outcome, evidence, params),)
    lead = float(leads.max()) if np.isfinite(leads).any() else math.nan
    racing = float(lead > params.rules.lead_nothing)
    own = declaration_row(said, jets)._replace(racing=racing, lead=lead if racing else math.nan)
    return Judgment(
        state=state,
        adaptation=NO_ADAPTATION,
        status=_status_row(outcome, likeliest, racing, params),
        likelihood=leads,
        magnitude=own.verdict_magnitude,
        replacement=tried,
        published=ahead,
        own=own,
    )


def _make_declaration(outcome: PoseOutcome, evidence: PoseEvidence, params: FactorParams) -> Declaration:
    """Makes the declaration of a failure or unexplained push, its onset by the clock of the cycles, s."""
    n, onset_s = params.thrusts.size, evidence.cycle_s - (evidence.time_s - outcome.onset_s)
    if 2 * n in outcome.members:
        return Unexplained(onset_s)
    jets = tuple(dict.fromkeys(member % n for member in outcome.members))
    sign, thrusts = -1 if outcome.members[0] < n else 1, params.thrusts[list(jets)]
    forces, sigmas = (tuple((share * thrusts).tolist()) for share in outcome.share)
    word = Word.FAILED if len(outcome.members) == 1 else Word.GROUP
    return JetsDeclared(word, jets, (sign,) * len(jets), forces, sigmas, onset_s)


def _status_row(outcome: PoseOutcome | None, likeliest: int | None, suspected: float, params: FactorParams) -> Any:
    """Makes a cycle's log row, `detector.STATUS`: of the declared failure, or else of the suspected jet."""
    jets = params.thrusts.size
    if outcome is None:
        row: dict[str, float] = {} if likeliest is None or not suspected else {"suspected_jet": float(likeliest % jets)}
        tested = float(likeliest is not None)
        return STATUS.make(tested=tested, alarm=suspected, detector_event=float(Verdict.NOTHING), **row)
    if 2 * jets in outcome.members:
        return STATUS.make(
            tested=1.0, alarm=1.0, detector_event=float(Verdict.OTHER), onset=outcome.onset_s, alarms=1.0
        )
    leader, jet = outcome.members[0], outcome.members[0] % jets
    force = (-1.0 if leader < jets else 1.0) * outcome.share[0] * params.thrusts[jet]
    return STATUS.make(
        tested=1.0,
        alarm=1.0,
        detector_event=float(Verdict.DECLARED),
        suspected_jet=float(jet),
        jet_isolated=float(len(outcome.members) == 1),
        suspected_magnitude=force,
        suspected_magnitude_std=outcome.share[1] * params.thrusts[jet],
        suspected_likelihood=outcome.lead[1],
        onset=outcome.onset_s,
        alarms=1.0,
    )


def save_state(state: ThrustFactorsState, _params: FactorParams) -> Array:
    """Packs the detector's state into a vector: jets declared as a group, and jets removed."""
    return np.concatenate((state.grouped, state.removed))


def restore_state(vector: Array, params: FactorParams) -> ThrustFactorsState:
    """Unpacks the detector's state from a vector: the inverse of `save_state`.

    Raises:
        ValueError: when the state holds what the detector cannot leave.
    """
    jets = params.thrusts.size
    if not np.isin(vector, (0.0, 1.0)).all():
        raise ValueError(f"{GROUP}: must be 0 or 1")
    return initial_state(params)._replace(grouped=vector[: 1 + 2 * jets].copy(), removed=vector[1 + 2 * jets :].copy())


DETECTOR = Detector(
    made_for="pose",
    params=make_params,
    initial=initial_state,
    known_force=lambda *_: NO_KNOWN_FORCE,
    judge=judge,
    saved=save_state,
    restored=restore_state,
    group=GROUP,
    report=HYPOTHESIS_REPORT,
)
