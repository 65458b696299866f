"""Declarations, from posterior probabilities alone."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from massprop_drake.maths.estimation.faults.declarations import (
    Declaration,
    DisturbanceDeclared,
    JetsDeclared,
    JumpDeclared,
    Mode,
    ReadingDeclared,
    Unexplained,
    Word,
)
from massprop_drake.maths.estimation.faults.fault_events import ANEW, Hypothesis, Part, Way, needs_special_cycle
from massprop_drake.maths.estimation.faults.fault_report import Odds, no_fault_odds
from massprop_drake.maths.estimation.faults.priors import Params, Priors
from massprop_drake.maths.estimation.faults.proposals import INTERMITTENT_AFTER
from massprop_drake.maths.estimation.faults.tree import (
    Tree,
    hypotheses_with_draws,
    is_likely,
    probabilities,
    relative_log_weights,
)
from massprop_drake.maths.estimation.joint.hypotheses import Kind, failure_slot, unstated_disturbance_sigmas
from massprop_drake.maths.estimation.joint.layout import JointParams, JointState, is_initialized
from massprop_drake.maths.estimation.joint.payload import UNKNOWN, gained_payload
from massprop_drake.maths.estimation.joint.separation import Separation, find_separation
from massprop_drake.maths.estimation.joint.thrust_scale import force_with_scale

_GROUP_S = 2.0  # for which that of a group must be there
_GROUP = 3  # jets that a group may have
_PUSHING = (Kind.UNKNOWN, Kind.WANDER)  # causes of something unknown that pushes: for once, or all along
_LEAST_LEAK, _LEAST_LOSS = 0.002, 0.1  # of full thrust: less is no failure, but a thrust that is not as stated
_STUCK_ON, _STUCK_OFF = 0.5, 0.9  # of full thrust, from which on it is called so
_SIGNIFICANT = 3.0  # sigmas by which a force must have changed to be said to have, and
_CHANGE = 0.1  # of full thrust, by which it must, too
_MEASURED = 0.1  # of a payload's mass, to which it is known when its size is told
_APART = 14.0  # log likelihood ratio, doubled, at which jets are told apart: a probability of 1e-3 is left


class Declared(NamedTuple):
    """Declared failure: its force as declared or known better since, lbf or N, and its changes."""

    way: Way
    force: float
    sigma: float
    changes: int = 0


class Verdicts(NamedTuple):
    """Declarations so far, and those that may follow.

    Attributes:
        others: other parts of the likeliest history.
        group: smallest set of jets that is likely enough, and since when, s.
        earlier: state before a jump whose size has not been told.
    """

    jets: tuple[Declared, ...] = ()
    others: frozenset[Part] = frozenset()
    group: tuple[frozenset[Way], float] = (frozenset(), math.inf)
    groups: frozenset[frozenset[Way]] = frozenset()
    earlier: JointState | None = None

    @property
    def ways(self) -> frozenset[Way]:
        """Declared jet failures, as pairs of jet index and sign."""
        return frozenset(one.way for one in self.jets)


def probability_above_floor(failure: Way, hypothesis: Hypothesis, params: JointParams) -> float:
    """Computes under a hypothesis the probability that a jet's force error exceeds the least failure.

    One whose force comes and goes has failed, whatever it gives now.
    """
    jet, sign = failure
    if sum(failure in event.cause.failures for event in hypothesis.events) >= INTERMITTENT_AFTER:
        return 1.0
    force, sigma = force_with_scale(hypothesis.run.state, failure_slot(hypothesis.run.state, jet, sign), params)
    floor = (_LEAST_LOSS if sign < 0 else _LEAST_LEAK) * float(params.thrusts[jet])
    return 0.5 * math.erfc((floor - force) / (math.sqrt(2.0) * sigma))


def jet_fault_probabilities(tree: Tree, params: JointParams) -> dict[Way, float]:
    """Maps each jet failure, a pair of jet index and sign, to its posterior probability."""
    found: dict[Way, float] = {}
    for each, share in probabilities(tree):
        for way in each.ways if each.run.age > 0 else ():
            found[way] = found.get(way, 0.0) + share * probability_above_floor(way, each, params)
    return found


def other_event_probabilities(tree: Tree) -> dict[Part, float]:
    """Maps events but jet failures, as (kind, component, earlier count), to their posterior probability."""
    found: dict[Part, float] = {}
    for each, share in probabilities(tree):
        for part in each.parts:
            if isinstance(part[0], Kind):
                found[part] = found.get(part, 0.0) + share
    return found


def fault_probabilities(tree: Tree, params: JointParams) -> Odds:
    """Computes posterior probabilities of no fault, of unknown pushes and of each jet's failure, with forces."""
    n = params.places.jets
    if len(tree.hypotheses) == 1 and not tree.leader.events:
        return no_fault_odds(n)
    failed, modes = np.zeros((2, n))
    forces, sigmas, best = np.full(n, np.nan), np.full(n, np.nan), np.full(n, -np.inf)
    none = unknown = 0.0
    for each, share in probabilities(tree):
        none += share * float(not each.events)
        unknown += share * float(any(event.cause.kind in _PUSHING for event in each.events))
        for way in each.ways if each.run.age > 0 else ():
            jet, sign = way
            failed[jet] += share * probability_above_floor(way, each, params)
            if share > best[jet]:
                best[jet], modes[jet] = share, float(jet_fault_mode(way, each, params))
                force, sigmas[jet] = force_with_scale(each.run.state, failure_slot(each.run.state, jet, sign), params)
                forces[jet] = sign * force
    return Odds(len(tree.hypotheses), min(none, 1.0), min(unknown, 1.0), np.minimum(failed, 1.0), modes, forces, sigmas)


def jet_fault_mode(failure: Way, hypothesis: Hypothesis, params: JointParams) -> Mode:
    """Returns a failed jet's mode: stuck on or off, leak, loss, drifting or intermittent."""
    jet, sign = failure
    slot = failure_slot(hypothesis.run.state, jet, sign)
    if hypothesis.walks[slot] > 0.0:
        return Mode.INTERMITTENT if hypothesis.walks[slot] == ANEW else Mode.DRIFTING
    share = force_with_scale(hypothesis.run.state, slot, params)[0] / float(params.thrusts[jet])
    if sign > 0:
        return Mode.STUCK_ON if share > _STUCK_ON else Mode.LEAK
    return Mode.STUCK_OFF if share > _STUCK_OFF else Mode.LOSS


def update_verdicts(verdicts: Verdicts, tree: Tree, params: Params) -> tuple[Verdicts, tuple[Declaration, ...]]:
    """Declares and withdraws faults after a sample; returns the verdicts, and the new declarations."""
    if len(tree.hypotheses) == 1 and not tree.leader.events and not verdicts.jets:
        return Verdicts(others=verdicts.others), ()
    joint = params.joint
    jets, others = jet_fault_probabilities(tree, joint), other_event_probabilities(tree)
    verdicts, declarations = _withdraw_unlikely(verdicts, jets, tree)
    undeclared = {way: share for way, share in jets.items() if way not in verdicts.ways}
    new = undeclared | {part: share for part, share in others.items() if part not in verdicts.others}
    for part, share in new.items():
        enough = _declaration_threshold(part, params.priors)
        if share >= enough and share * (1.0 - pending_probability(part, tree)) >= enough:
            verdicts, more = _declare_event(part, verdicts, tree, joint)
            declarations += more
    verdicts, more = _declare_group(verdicts, undeclared, tree, params)
    declarations += more
    if _is_settled(tree, joint):
        verdicts, more = _declare_updates(verdicts, tree, joint)
        declarations += more
    return verdicts, tuple(declarations)


def _declaration_threshold(event_key: Part, priors: Priors) -> float:
    """Returns the posterior probability at which an event is declared, closer to 1 for events of higher rate."""
    rates = dict.fromkeys((Kind.LIES, Kind.SPEED, Kind.TURN), priors.reading_per_hour)
    rates |= {Kind.JUMP: priors.payload_per_hour, Kind.WANDER: priors.payload_per_hour}
    return 1.0 - priors.doubt(max(rates.get(event_key[0], 0.0), priors.jet_per_hour))


def pending_probability(event_key: Part | frozenset[Way], tree: Tree) -> float:
    """Bounds, to first order, the probability of pending proposals that lack an event about to be declared.

    Args:
        event_key: an event; or jet failures, of which one is enough.
    """
    total, leads = _waiting_odds(tree, lambda child: not _has_event(event_key, child)), relative_log_weights(tree)
    for each in hypotheses_with_draws(tree):
        draws = (each.alarm, each.review if is_likely(each, tree) else None)
        total += sum(math.exp(min(one.rest.log_weight(leads), 0.0)) for one in draws if one and one.rest)
        total += float(each.alarm is not None and each.alarm.drawn < 0)
    return total / (1.0 + total)


def _waiting_odds(tree: Tree, accept: Callable[[Hypothesis], bool]) -> float:
    """Sums the first-order odds, against the likeliest, of waiting proposals whose hypothesis passes a test."""
    leads = relative_log_weights(tree)
    return sum(
        math.exp(min(birth.log_weight(leads) + birth.doubt, 0.0)) for birth in tree.births if accept(birth.child)
    )


def _has_event(event_key: Part | frozenset[Way], hypothesis: Hypothesis) -> bool:
    """Tests whether a hypothesis's history has an event, or any of a set of jet failures."""
    if isinstance(event_key, frozenset):
        return bool(event_key & hypothesis.ways)
    return event_key in hypothesis.ways or event_key in hypothesis.parts


def _is_settled(tree: Tree, params: JointParams) -> bool:
    """Tests whether the likeliest hypothesis has no alarm and no onset impulse left, and no proposal is waiting."""
    leader = tree.leader
    if leader.watch is None or leader.alarm is not None or tree.births or not tree.samples:
        return False
    _, interval = tree.samples[-1]
    return not needs_special_cycle(leader, interval.duration_s, params)


def _withdraw_unlikely(verdicts: Verdicts, jets: dict[Way, float], tree: Tree) -> tuple[Verdicts, list[Declaration]]:
    """Withdraws jet failures whose probability is surely below 0.5; returns verdicts and withdrawals."""
    gone = [one for one in verdicts.jets if _bound_probability(one.way, jets.get(one.way, 0.0), tree) < 0.5]
    now_s = tree.leader.run.state.time_s
    declarations: list[Declaration] = [
        JetsDeclared(Word.WITHDRAWN, (one.way[0],), (one.way[1],), (0.0,), (one.sigma,), now_s) for one in gone
    ]
    return verdicts._replace(jets=tuple(one for one in verdicts.jets if one not in gone)), declarations


def _bound_probability(failure: Way, probability: float, tree: Tree) -> float:
    """Returns a jet failure's probability; below 1/2 as if all proposals with it not yet run as filters were true."""
    waiting = _waiting_odds(tree, lambda child: failure in child.ways) if probability < 0.5 else 0.0
    return (probability + waiting) / (1.0 + waiting)


def _declare_event(
    event_key: Part, verdicts: Verdicts, tree: Tree, params: JointParams
) -> tuple[Verdicts, list[Declaration]]:
    """Declares one event of a history; returns the verdicts, and its declaration in a list, empty if a push ends."""
    holder = next(each for each in tree.hypotheses if event_key in each.ways or event_key in each.parts)
    if not isinstance(event_key[0], Kind):
        way: Way = (event_key[0], event_key[1])
        event = next(event for event in holder.events if way in event.cause.failures)
        force, sigma = force_with_scale(holder.run.state, failure_slot(holder.run.state, *way), params)
        declaration = JetsDeclared(Word.FAILED, (way[0],), (way[1],), (force,), (sigma,), event.onset_s)
        return verdicts._replace(jets=(*verdicts.jets, Declared(way, force, sigma))), [declaration]
    verdicts = verdicts._replace(others=verdicts.others | {event_key})
    event = [event for event in holder.events if event.cause.part == event_key[:2]][event_key[2]]
    match event_key[0]:
        case Kind.JUMP:
            return verdicts._replace(earlier=holder.earlier), [JumpDeclared(False, event.onset_s, *UNKNOWN)]
        case Kind.LIES | Kind.SPEED | Kind.TURN | Kind.ENGINE:
            return verdicts, [ReadingDeclared(event.cause.component, event.onset_s)]
        case Kind.WANDER:
            return verdicts, [
                DisturbanceDeclared(event.onset_s, *unstated_disturbance_sigmas(holder.run.state.stir, params))
            ]
        case _:
            begins = event_key[2] % 2 == 0  # pushes begin and end in turn
            return verdicts, [Unexplained(event.onset_s)] if begins else []


def _declare_group(
    verdicts: Verdicts, undeclared: dict[Way, float], tree: Tree, params: Params
) -> tuple[Verdicts, list[Declaration]]:
    """Declares the smallest jet set one of which has failed, once likely for 2 s; returns verdicts and declarations."""
    now_s = tree.leader.run.state.time_s
    likely = sorted(undeclared, key=lambda way: -undeclared[way])[:_GROUP]
    group: frozenset[Way] = frozenset()
    for count in range(2, len(likely) + 1):
        candidates = frozenset(likely[:count])
        some = sum(
            share * max(probability_above_floor(way, each, params.joint) for way in candidates & each.ways)
            for each, share in probabilities(tree)
            if candidates & each.ways and each.run.age > 0
        )
        enough = _declaration_threshold(likely[0], params.priors)
        if undeclared[likely[0]] < enough <= some * (1.0 - pending_probability(candidates, tree)):
            group = candidates
            break
    if not group or any(group <= other or other <= group for other in verdicts.groups):
        return verdicts._replace(group=(frozenset(), math.inf)), []
    since_s = verdicts.group[1] if verdicts.group[0] == group else now_s
    verdicts = verdicts._replace(group=(group, since_s))
    if now_s - since_s < _GROUP_S:
        return verdicts, []
    ways = [way for way in likely if way in group]
    holders = [next(each for each in tree.hypotheses if way in each.ways) for way in ways]
    forces = [
        force_with_scale(each.run.state, failure_slot(each.run.state, *way), params.joint)
        for way, each in zip(ways, holders, strict=True)
    ]
    event = next(event for event in reversed(holders[0].events) if ways[0] in event.cause.failures)
    apart = _find_separation(ways, [force for force, _ in forces], tree, params.joint)
    jets, signs = zip(*ways, strict=True)
    declaration = JetsDeclared(
        Word.GROUP, jets, signs, tuple(one for one, _ in forces), tuple(one for _, one in forces), event.onset_s, apart
    )
    return verdicts._replace(groups=verdicts.groups | {group}, group=(frozenset(), math.inf)), [declaration]


def _find_separation(failures: list[Way], forces: list[float], tree: Tree, params: JointParams) -> Separation:
    """Finds the jet firing or coasting time that would separate a group's jets; neither if no alarm is up."""
    alarm = next((each.alarm for each in tree.hypotheses if each.alarm), None)
    if alarm is None:
        return Separation()
    members = [(jet, sign, force) for (jet, sign), force in zip(failures, forces, strict=True)]
    return find_separation(alarm.screen, tree.samples[-1][1], alarm.screen.onsets[-1], members, _APART, params)


def _declare_updates(verdicts: Verdicts, tree: Tree, params: JointParams) -> tuple[Verdicts, list[Declaration]]:
    """Declares changed forces, and a jump's size once measured; returns the verdicts and declarations."""
    leader, declarations = tree.leader, list[Declaration]()
    now = leader.run.state
    earlier = verdicts.earlier
    if earlier is not None and is_initialized(now, params):
        size = gained_payload(earlier, now, params)
        if size.mass_sigma < _MEASURED * abs(size.mass):
            declarations.append(JumpDeclared(True, earlier.time_s, *size))
            earlier = None
    kept = []
    for one in verdicts.jets:
        after, word = _update_declared(one, leader, params)
        kept.append(after)
        if word is not None:
            event = next(event for event in reversed(leader.events) if one.way in event.cause.failures)
            declarations.append(
                JetsDeclared(word, one.way[:1], one.way[1:], (after.force,), (after.sigma,), event.onset_s)
            )
    return verdicts._replace(jets=tuple(kept), earlier=earlier), declarations


def _update_declared(declared: Declared, leader: Hypothesis, params: JointParams) -> tuple[Declared, Word | None]:
    """Updates a declared failure's force; returns it, and the kind of change to declare, or None."""
    if declared.way not in leader.ways:
        return declared, None
    now = leader.run.state
    slot = failure_slot(now, *declared.way)
    force, sigma = force_with_scale(now, slot, params)
    if leader.walks[slot] == ANEW:
        sigma = math.hypot(sigma, float(params.thrusts[declared.way[0]]))  # it may give anything at any time
        erratic = declared._replace(force=force, sigma=sigma, changes=INTERMITTENT_AFTER)
        return erratic, Word.ERRATIC if declared.changes < INTERMITTENT_AFTER else None
    least = max(_SIGNIFICANT * math.hypot(sigma, declared.sigma), _CHANGE * float(params.thrusts[declared.way[0]]))
    if abs(force - declared.force) > least:
        changes = declared.changes + 1
        word = Word.ERRATIC if changes == INTERMITTENT_AFTER else Word.CHANGED
        return declared._replace(force=force, sigma=sigma, changes=changes), word
    if sigma < 0.5 * declared.sigma:  # the same force, known better: it is what a change is told from
        return declared._replace(force=force, sigma=sigma), None
    return declared, None
