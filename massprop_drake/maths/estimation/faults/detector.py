"""The hypothesis filter as one of the detectors (under construction: not in the registry)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from massprop_drake.maths.estimation.adaptation import NO_ADAPTATION
from massprop_drake.maths.estimation.detector import NO_KNOWN_FORCE, Detector, Judgment
from massprop_drake.maths.estimation.detectors.hypotheses import GROUP, HYPOTHESIS_REPORT, _own, _removed, _status
from massprop_drake.maths.estimation.detectors.multi_hypothesis import Status
from massprop_drake.maths.estimation.faults.priors import Priors
from massprop_drake.maths.estimation.faults.tree import Tree, advance, begun
from massprop_drake.maths.estimation.faults.verdicts import Verdicts, judged
from massprop_drake.maths.estimation.joint.cycle import JointEvidence
from massprop_drake.maths.estimation.joint.layout import JointParams
from massprop_drake.maths.linear_algebra import Array


class Params(NamedTuple):
    """What shapes the hypothesis filter."""

    joint: JointParams
    priors: Priors = Priors()


class State(NamedTuple):
    """All that is remembered."""

    tree: Tree
    verdicts: Verdicts
    force: Array
    variance: Array
    removed: Array
    closed: Array


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
    own = _own(said, Status(), n)
    return Judgment(
        state=kept,
        adaptation=NO_ADAPTATION,
        status=_status(said, Status(), 0),
        likelihood=np.full(n, np.nan),
        magnitude=own.verdict_magnitude,
        replacement=None if leader is evidence.after else leader,
        own=own,
    )


DETECTOR = Detector(
    made_for="joint",
    params=lambda _jets, _options, filter_params: Params(filter_params.joint),
    initial=initial,
    known_force=lambda *_: NO_KNOWN_FORCE,
    judge=judge,
    group=GROUP,
    report=HYPOTHESIS_REPORT,
)
