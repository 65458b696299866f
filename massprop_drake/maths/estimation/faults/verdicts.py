"""What is declared, from posterior probabilities alone."""

from __future__ import annotations

import math
from typing import NamedTuple

from massprop_drake.maths.estimation.faults.declarations import (
    Declaration,
    JetsDeclared,
    JumpDeclared,
    ReadingDeclared,
    Word,
)
from massprop_drake.maths.estimation.faults.priors import Priors
from massprop_drake.maths.estimation.faults.tree import Hypothesis, Tree, force_of, probabilities, weight
from massprop_drake.maths.estimation.joint.hypotheses import Cause, Kind, slot_of
from massprop_drake.maths.estimation.joint.layout import JointParams
from massprop_drake.maths.estimation.joint.payload import UNKNOWN

_HELD = 2  # samples: a probability must hold
_GROUP_S = 2.0  # for which a group must hold
_GROUP = 3  # jets at most
_LEAST_LEAK, _LEAST_LOSS = 0.002, 0.1  # of full thrust: less is no failure, but a thrust that is not as stated


class Verdicts(NamedTuple):
    """What has been declared, and for how long what may be declared has held."""

    declared: frozenset[object] = frozenset()
    held: tuple[tuple[object, int], ...] = ()
    grouped: tuple[frozenset[object], int] = (frozenset(), 0)


def marginals(tree: Tree, params: JointParams) -> dict[object, float]:
    """Probability of each event: (jet, sign), or a cause."""
    found: dict[object, float] = {}
    for each, share in probabilities(tree, params):
        for part in each.key:
            found[part] = found.get(part, 0.0) + share * _above_floor(part, each, params)
    return found


def _above_floor(part: object, each: Hypothesis, params: JointParams) -> float:
    """Probability that a failed jet's force is larger than what is called a failure; 1 for anything else."""
    if isinstance(part, Cause):
        return 1.0
    jet, sign = part
    force, sigma = force_of(each.run.state, slot_of(each.run.state, jet, sign), params)
    floor = (_LEAST_LOSS if sign < 0 else _LEAST_LEAK) * float(params.thrusts[jet])
    return 0.5 * math.erfc((floor - force) / (math.sqrt(2.0) * sigma))


def judged(
    verdicts: Verdicts, tree: Tree, priors: Priors, params: JointParams
) -> tuple[Verdicts, tuple[Declaration, ...]]:
    """What is declared after a sample.

    Args:
        verdicts: before it.
        tree: after it.
        priors: see `Priors`.
        params: see `JointParams`.
    """
    found, doubt = marginals(tree, params), priors.doubt
    best = weight(tree.leader, params)
    waits = sum(math.exp(min(birth.first_order - best, 0.0)) for birth in tree.births) > doubt
    unheard = max(
        (each.watch.alarm.unheard for each in tree.hypotheses if each.watch and each.watch.alarm), default=0.0
    )
    held, said, declared = {}, [], set(verdicts.declared)
    counts = dict(verdicts.held)
    for part, probability in found.items():
        if part in declared or probability / (1.0 + unheard) < 1.0 - doubt or waits:
            continue
        held[part] = counts.get(part, 0) + 1
        if held[part] >= _HELD:
            said.append(_declaration(part, tree, params))
            declared.add(part)
    for part in verdicts.declared:
        if found.get(part, 0.0) < 0.5 and not isinstance(part, Cause):
            jet, sign = part
            said.append(JetsDeclared(Word.WITHDRAWN, (jet,), (sign,), (0.0,), (0.0,), tree.samples[-1][0].time_s))
            declared.discard(part)
    return Verdicts(frozenset(declared), tuple(held.items())), tuple(said)


def _declaration(part: object, tree: Tree, params: JointParams) -> Declaration:
    holder = next(each for each in tree.hypotheses if part in each.key)
    cause, onset_s = next(pair for pair in holder.events if part in (pair[0].failures or {pair[0]}))
    if not isinstance(part, Cause):
        jet, sign = part
        force, sigma = force_of(holder.run.state, slot_of(holder.run.state, jet, sign), params)
        return JetsDeclared(Word.FAILED, (jet,), (sign,), (force,), (sigma,), onset_s)
    if cause.kind == Kind.JUMP:
        return JumpDeclared(False, onset_s, *UNKNOWN)
    return ReadingDeclared(cause.component, onset_s)
