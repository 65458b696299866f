"""The hypothesis filter as one of the detectors: what it remembers, what logs keep, which jets are put out of use.

Forces of failed jets are states of the filter, so that none acts through the impulse model; those that have been
declared stand in `force` and `variance` for the autopilot and the logs. A jet that is named alone is put out of use
until its declaration is withdrawn; of a group none is.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from massprop_drake.maths.estimation.adaptation import NO_ADAPTATION
from massprop_drake.maths.estimation.detector import NO_KNOWN_FORCE, Detector, Jets, Judgment
from massprop_drake.maths.estimation.faults.declarations import Declaration, JetsDeclared, Word
from massprop_drake.maths.estimation.faults.priors import Priors
from massprop_drake.maths.estimation.faults.report import HYPOTHESIS_REPORT, certain, own_row, status_row
from massprop_drake.maths.estimation.faults.tree import Tree, advance, begun
from massprop_drake.maths.estimation.faults.verdicts import Verdicts, judged
from massprop_drake.maths.estimation.filters.joint import JointFilterParams
from massprop_drake.maths.estimation.joint.cycle import JointEvidence
from massprop_drake.maths.estimation.joint.layout import JointParams
from massprop_drake.maths.linear_algebra import Array

GROUP = "hypothesis_detector"  # the system that holds the state in a diagram


class Params(NamedTuple):
    """What shapes the hypothesis filter.

    Attributes:
        joint: of the filter.
        priors: see `Priors`.
        allowed: 1 for each fault of a jet that there may be, more thrust and then less, shape (2 n_jets,).
        rates: failures per hour of each jet in terms of the usual rate, shape (n_jets,).
    """

    joint: JointParams
    priors: Priors
    allowed: Array
    rates: Array


class State(NamedTuple):
    """All that is remembered. Never changed; a cycle makes a new one.

    Attributes:
        tree: see `Tree`.
        verdicts: see `Verdicts`.
        force, variance: of the declared jets that push untold, as the filter has them, lbf or N, shape (n_jets,).
        removed: 1 for each jet that is named alone, shape (n_jets,).
        closed: 1 for each jet whose manifold is closed: none, shape (n_jets,).
    """

    tree: Tree
    verdicts: Verdicts
    force: Array
    variance: Array
    removed: Array
    closed: Array


def make_params(_jets: Jets, options: Any, filter_params: JointFilterParams) -> Params:
    """Parameters from those of the filter and the scenario's block `faults`, with an entry for each jet."""
    priors, of_jets = Priors(*(getattr(options, name) for name in Priors._fields)), options.jets.values()
    allowed = [*(jet.gives_more for jet in of_jets), *(jet.gives_less for jet in of_jets)]
    rates = np.array([jet.per_hour for jet in of_jets]) / priors.jet_per_hour
    return Params(filter_params.joint, priors, np.array(allowed, dtype=float), rates)


def initial(params: Params) -> State:
    """Before the first sample."""
    none = np.zeros(params.joint.places.jets)
    return State(Tree(), Verdicts(), none, none, none, none)


def judge(state: State, evidence: JointEvidence, params: Params) -> Judgment:
    """What is made of a cycle of the filter."""
    joint, report = params.joint, evidence.report
    tree, verdicts, said = state.tree, state.verdicts, ()
    starting = report.course is None or report.incremented or not evidence.after.guarded or evidence.anew
    if starting and len(tree.hypotheses) <= 1:
        tree = Tree(tree.cycle + 1, (begun(evidence.after, tree.cycle + 1, joint),))
    else:
        tree = advance(tree, evidence, params.priors, joint)
        verdicts, said = judged(verdicts, tree, params.priors, joint)
    leader = tree.leader.run.state
    removed = _removed(state.removed, said)
    kept = State(tree, verdicts, state.force, state.variance, removed, state.closed)
    n = joint.places.jets
    own = own_row(said, certain(n))
    return Judgment(
        state=kept,
        adaptation=NO_ADAPTATION,
        status=status_row(said, certain(n), True, 0.0),
        likelihood=np.full(n, np.nan),
        magnitude=own.verdict_magnitude,
        replacement=None if leader is evidence.after else leader,
        own=own,
    )


def _removed(removed: Array, said: tuple[Declaration, ...]) -> Array:
    """1 for each jet that is to be out of use."""
    for one in said:
        if isinstance(one, JetsDeclared) and len(one.jets) == 1:
            removed = removed.copy()
            removed[list(one.jets)] = float(one.word != Word.WITHDRAWN)
    return removed


DETECTOR = Detector(
    made_for="joint",
    params=make_params,
    initial=initial,
    known_force=lambda *_: NO_KNOWN_FORCE,
    judge=judge,
    group=GROUP,
    report=HYPOTHESIS_REPORT,
)
