"""The hypothesis filter as a detector of the registry: its state, its logs, and the jets that it takes out of use.

Forces of failed jets are states of the filter, so that none acts through the impulse model; those that have been
declared stand in `force` and `variance` for the autopilot and the logs. A jet that is named alone is put out of use
until its declaration is withdrawn; of a group none is.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from massprop_drake.maths.estimation.adaptation import NO_ADAPTATION
from massprop_drake.maths.estimation.detector import NO_KNOWN_FORCE, Detector, Judgment, KnownJets
from massprop_drake.maths.estimation.faults.declarations import Declaration, JetsDeclared, Word
from massprop_drake.maths.estimation.faults.fault_report import (
    HYPOTHESIS_REPORT,
    hypothesis_report_row,
    no_fault_odds,
    status_row,
)
from massprop_drake.maths.estimation.faults.priors import Params, Priors
from massprop_drake.maths.estimation.faults.saved import pack_tree, unpack_tree
from massprop_drake.maths.estimation.faults.search import BEGUN, SearchOutcome, StartSearch, advance_search
from massprop_drake.maths.estimation.faults.tree import Tree, advance, tree_from_search
from massprop_drake.maths.estimation.faults.verdicts import Verdicts, fault_probabilities, update_verdicts
from massprop_drake.maths.estimation.filters.joint import JointFilterParams
from massprop_drake.maths.estimation.joint.hypotheses import failure_slot, without_increments
from massprop_drake.maths.estimation.joint.joint_cycle import JointEvidence
from massprop_drake.maths.estimation.joint.layout import JointParams
from massprop_drake.maths.estimation.joint.thrust_scale import force_with_scale
from massprop_drake.maths.linear_algebra import Array

GROUP = "hypothesis_detector"  # its part of a saved state


class HypothesisFilterState(NamedTuple):
    """State of the detector. Never changed; a cycle makes a new one.

    Attributes:
        search: of failures in the start, see `search.StartSearch`.
        force, variance: of the declared jets that push untold, as the filter has them, lbf or N, shape (n_jets,).
        removed: 1 for each jet that is named alone, shape (n_jets,).
        closed: 1 for each jet whose manifold is closed: none, shape (n_jets,).
    """

    tree: Tree
    verdicts: Verdicts
    search: StartSearch
    force: Array
    variance: Array
    removed: Array
    closed: Array


def make_params(_jets: KnownJets, options: Any, filter_params: JointFilterParams) -> Params:
    """Makes the fault detector's parameters from those of the joint filter and the scenario's block `faults`."""
    priors, of_jets = Priors.stated(options), options.jets.values()
    allowed = [*(jet.gives_more for jet in of_jets), *(jet.gives_less for jet in of_jets)]
    rates = np.array([jet.per_hour for jet in of_jets]) / priors.jet_per_hour
    return Params(without_increments(filter_params.joint), priors, np.array(allowed, dtype=float), rates)


def initial(params: Params) -> HypothesisFilterState:
    """Returns the detector's state before the first sample: no hypotheses, nothing declared."""
    none = np.zeros(params.joint.places.jets)
    return HypothesisFilterState(Tree(), Verdicts(), BEGUN, none, none, none, none)


def judge(state: HypothesisFilterState, evidence: JointEvidence, params: Params) -> Judgment:
    """Advances the fault hypotheses by a sample; returns new state, declarations and log rows as a judgment.

    Raises:
        NotPositiveDefiniteError: see `joint_cycle.step`.
    """
    joint = params.joint
    search, outcomes = _advance_start_search(state.search, evidence, params)
    tree = tree_from_search(outcomes, state.tree, params) if outcomes else advance(state.tree, evidence, params)
    verdicts, declarations = state.verdicts, tuple[Declaration, ...]()
    if not search.contradicted:  # else what it finds would change what is declared
        verdicts, declarations = update_verdicts(state.verdicts, tree, params)
    probable = fault_probabilities(tree, joint)
    force, variance = _declared_forces(verdicts, tree, joint)
    kept = HypothesisFilterState(
        tree, verdicts, search, force, variance, _update_removed_jets(state.removed, declarations), state.closed
    )
    watch, now = tree.leader.watch, tree.next_state(params)
    tested, statistic = (watch.tested, watch.statistic) if watch is not None else (False, 0.0)
    own = hypothesis_report_row(declarations, probable, tree.history)
    return Judgment(
        state=kept,
        adaptation=NO_ADAPTATION,
        status=status_row(declarations, probable, tested, statistic),
        likelihood=np.full(joint.places.jets, np.nan),
        magnitude=own.verdict_magnitude,
        replacement=None if now is evidence.after else now,
        own=own,
    )


def _advance_start_search(
    search: StartSearch, evidence: JointEvidence, params: Params
) -> tuple[StartSearch, tuple[SearchOutcome, ...]]:
    """Advances the search for faults in the initialization by a cycle; returns it and outcomes, () until done."""
    report = evidence.report
    if report.course is None or params.joint.places.n_force == 0:
        return BEGUN, ()
    if not (search.under_way and (report.starting or report.contradicted or search.contradicted)):
        return search, ()
    return advance_search(search, evidence.before, report, evidence.sample, params.priors, params.joint)


def _declared_forces(verdicts: Verdicts, tree: Tree, params: JointParams) -> tuple[Array, Array]:
    """Returns force and variance of jets declared to fire uncommanded, 0 for others, shape (n_jets,) each."""
    force, variance = np.zeros(params.places.jets), np.zeros(params.places.jets)
    state = tree.leader.run.state
    for jet, sign in verdicts.ways & tree.leader.ways:
        if sign > 0:
            found, sigma = force_with_scale(state, failure_slot(state, jet, sign), params)
            force[jet], variance[jet] = max(found, 0.0), sigma**2
    return force, variance


def quiet_log_rows(state: HypothesisFilterState) -> tuple[Any, ...]:
    """Returns log values of a cycle with no declaration or alarm: `STATUS`; likelihood to force variance by jet."""
    n = state.force.size
    nothing = np.full(n, np.nan)
    return (
        *status_row((), no_fault_odds(n), tested=False, statistic=0.0),
        nothing,
        nothing,
        state.force,
        state.variance,
    )


def _update_removed_jets(removed: Array, declarations: tuple[Declaration, ...]) -> Array:
    """Updates flags of jets out of use: 1 where declared failed alone, 0 where withdrawn, shape (n_jets,)."""
    for declaration in declarations:
        if isinstance(declaration, JetsDeclared) and len(declaration.jets) == 1:
            removed = removed.copy()
            removed[list(declaration.jets)] = float(declaration.word != Word.WITHDRAWN)
    return removed


def pack_state(state: HypothesisFilterState, params: Params) -> Array:
    """Packs the detector's state into a vector, see `faults.saved`."""
    own = pack_tree(state.tree, state.verdicts, params.joint.places)
    return np.concatenate((state.force, state.variance, state.removed, own))


def unpack_state(vector: Array, params: Params) -> HypothesisFilterState:
    """Unpacks the detector's state from a vector: the inverse of `pack_state`.

    Raises:
        ValueError: when the detector cannot have left such a state.
    """
    n = params.joint.places.jets
    if vector.size < 3 * n:
        raise ValueError(f"{GROUP}: ends too soon")
    force, variance, removed = vector[:n], vector[n : 2 * n], vector[2 * n : 3 * n]
    if not np.isfinite(vector[: 3 * n]).all() or (variance < 0.0).any():
        raise ValueError(f"{GROUP}: forces must be finite, and their variances zero or positive")
    if not np.isin(removed, (0.0, 1.0)).all():
        raise ValueError(f"{GROUP}: removed must be 0 or 1 for each jet")
    tree, verdicts = unpack_tree(vector[3 * n :], params.joint.places)
    return HypothesisFilterState(tree, verdicts, BEGUN, force, variance, removed, np.zeros(n))


DETECTOR = Detector(
    made_for="joint",
    params=make_params,
    initial=initial,
    known_force=lambda *_: NO_KNOWN_FORCE,
    judge=judge,
    saved=pack_state,
    restored=unpack_state,
    group=GROUP,
    report=HYPOTHESIS_REPORT,
)
