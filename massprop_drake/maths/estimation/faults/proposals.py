"""Proposals: fault events ranked to first order where a hypothesis does not explain the readings.

A screen (`joint.screen`) follows the first-order effects of every fault from a few onsets before an alarm on, and is
drawn from at ages of 0, 1, 2, 4, 8 ... samples. The first order only proposes.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from massprop_drake.maths.estimation.faults.alarms import UNTOLD, Alarm, Leads, Rest
from massprop_drake.maths.estimation.faults.fault_events import ANEW, Event, Hypothesis
from massprop_drake.maths.estimation.faults.priors import Params, Priors, log_event_probability, log_jump_probability
from massprop_drake.maths.estimation.joint import screen as screens
from massprop_drake.maths.estimation.joint.hypotheses import (
    DRIFT,
    JUMP_SHARES,
    STIRS,
    STUCK_SHARE,
    STUCK_THRUST,
    TURNED,
    Cause,
    Kind,
    Runner,
    Score,
    failure_slot,
    first_engine_index,
    known_forces,
    stronger_disturbances,
)
from massprop_drake.maths.estimation.joint.layout import CENTER, JointParams, JointState
from massprop_drake.maths.estimation.joint.screen import PAIR_PRIOR, Contender
from massprop_drake.maths.estimation.joint.unknown import reading_sigmas
from massprop_drake.maths.estimation.joint.wheels import largest_wheel_turn
from massprop_drake.maths.linear_algebra import Array
from massprop_drake.maths.mass_properties import ELEMENT
from massprop_drake.maths.vehicle.engine_thrust import N_CHANNELS, N_ERRORS, thrust

_SINGLES, _PAIRS = 12, 24  # proposals of a draw: compute budget
_FINEST = 4  # cycles that an onset stands for, up to which a proposal is made for each: compute budget
_DRIFTS = 4  # of the likeliest single failures, as drifting ones: compute budget
_NEAR = 20.0  # nats of first order within which proposals are followed: what is less likely counts as unheard
_OFF = 5e-3  # of the largest lead, by which the first order may be off: a linearization
_BENT = 0.2  # of the misfit, that the first order of a jump may leave: forces act on what has jumped
_NEARER = 3.0  # the same of a hypothesis that is reviewed: first orders are of what is near it
_HOPELESS = 50.0  # nats behind the likeliest hypothesis, to first order, at which nothing is followed
_PUSHES = (1.0, 0.1, 0.01)  # of an unknown push, in what all jets give
_INTERMITTENT_PER_S = 1.0  # changes of an intermittent force
_ENDS_PER_S = 1.0  # of an unknown push
_LATER = 4  # cycles after an alarm, in which steps go to failed jets: compute budget
_BEFORE = 48  # cycles before an alarm from which on something unstated is followed: compute budget
_JUMPS_PER_HOUR = 0.1  # probability: of a disturbance that nobody stated, where there is one
_NATS_OF_A_PUSH = 20.0  # that an unknown push costs a sample: as its readings tell nothing else


class Birth(NamedTuple):
    """Proposal that is being replayed from its onset to the newest sample.

    Attributes:
        ahead, than: see `Rest`.
        doubt: by which the first order may be off, nats.
        origin: draws that it is of.
    """

    child: Hypothesis
    ahead: float
    than: tuple[Event, ...] | None
    doubt: float
    origin: object = None

    def log_weight(self, log_weights: Leads) -> float:
        """Returns the proposal's first-order log weight, relative to that of the likeliest hypothesis, nats."""
        return Rest(self.ahead, self.than).log_weight(log_weights)


class Origin(NamedTuple):
    """Origin of a proposal: its parent, and the screen that proposed it.

    Attributes:
        parent: hypothesis that did not explain its readings.
        cycle: number of the sample with which that showed.
        onsets, gaps, states, scores: of the screen, see `Alarm` and `Screen`.
        read: readings at the first of them, shape (m,).
    """

    parent: Hypothesis
    cycle: int
    onsets: tuple[int, ...]
    gaps: tuple[int, ...]
    states: tuple[JointState, ...]
    scores: tuple[Score, ...]
    read: Array


def draw_proposals(
    parent: Hypothesis, cycle: int, hypotheses: Sequence[Hypothesis], params: Params
) -> tuple[list[Birth], Rest | None]:
    """Proposes faults that may explain a hypothesis's alarm; returns them, and summed weight of those left out."""
    alarm: Alarm = parent.alarm
    since = parent.watch.records[-1].score.without(alarm.scores[0])
    explained = alarm.scores[0].likelihood + since.likelihood + since.excess  # as if what has been read were expected
    log_weight = explained + parent.prior - 0.5 * alarm.screen.misfit
    births, left = rank_proposals(parent, alarm, log_weight, hypotheses, params, error=_OFF)
    best = max(other.weight for other in hypotheses)
    births += _propose_jumps(parent, alarm, log_weight - best, params)
    for push in _PUSHES:
        child = _make_pushed_child(parent, push, alarm, params)
        spent = _NATS_OF_A_PUSH * (cycle - alarm.screen.onsets[0]) * (1.0 + 0.3 * math.log10(push))
        births.append(Birth(child, explained - best + child.prior - spent, None, _NEAR))
    births += _propose_component_faults(parent, alarm, explained - best, cycle, params)
    if cycle - alarm.cycle >= _LATER:
        births += _propose_disturbances(parent, alarm, explained - best, cycle, params)
    return births, left


def rank_proposals(
    parent: Hypothesis,
    alarm: Alarm,
    log_weight: float,
    hypotheses: Sequence[Hypothesis],
    params: Params,
    *,
    error: float,
) -> tuple[list[Birth], Rest | None]:
    """Ranks an alarm's jet faults and false readings to first order; returns those to replay, the rest's weight.

    Args:
        log_weight: log weight that a lead of zero stands for.
        error: of first-order leads, relative.
    """
    joint = params.joint
    state, known = alarm.states[0], known_forces(alarm.states[0], joint)
    free = int((state.slot_jet < 0).sum())
    allowed = ((params.allowed if free > 0 else np.zeros_like(known)) + known) > 0.0

    def slots_needed(candidate: Contender) -> int:
        """Counts the force slots of the filter state that a proposal needs besides those in use."""
        ways = (jet + (joint.places.jets if sign < 0 else 0) for jet, sign in candidate.cause.failures)
        return sum(known[way] == 0.0 for way in ways)

    found = screens.propose_faults(alarm.screen, allowed, known, joint, -_NEAR)
    found = [candidate for candidate in found if slots_needed(candidate) <= free]
    priors = [_log_prior(parent, candidate, alarm, params) for candidate in found]
    worth = [
        candidate.lead + prior + PAIR_PRIOR * max(len(candidate.cause.jets) - 1, 0)
        for candidate, prior in zip(found, priors, strict=True)
    ]
    order = sorted(range(len(found)), key=lambda index: -worth[index])
    singles = [index for index in order if len(found[index].cause.jets) <= 1][:_SINGLES]
    pairs = [index for index in order if len(found[index].cause.jets) == 2][:_PAIRS]
    top = max((worth[index] for index in (*singles, *pairs)), default=0.0)
    best = max(other.weight for other in hypotheses)
    entry, than = log_weight - best, None
    causes = [found[index].cause for index in order]
    known_one = _find_known_proposal(parent, causes, alarm.states[0].time_s, hypotheses)
    if error * top > _HOPELESS:  # what first orders neglect is more than what matters
        if known_one is not None:
            return [], UNTOLD
        if alike := _find_shared_proposal(parent, causes, alarm, hypotheses):
            place, other, ahead = alike
            children = _make_children(parent, found[order[place]], priors[order[place]], alarm, params)
            return [Birth(child, ahead + less, other.events, _NEAR) for child, less in children], UNTOLD
    if error > 0.0 and error * top < _NEARER:  # what first orders neglect is little
        known_one = None
    if known_one is not None:  # first orders are compared among each other: what they neglect is much the same
        place, other = known_one
        entry, than = other.weight - best - worth[order[place]], other.events
    behind = 0.0 if known_one is None else known_one[1].weight - best
    doubt = min(_NEARER + error * max(top, 0.0), _NEAR)
    chosen = [
        index
        for index in (*singles, *pairs)
        if worth[index] > top - max(_NEAR, error * top) and entry + worth[index] > -_HOPELESS
    ]
    births = [
        Birth(child, entry + worth[index] + less - behind, than, doubt)
        for index in chosen
        for child, less in _make_children(parent, found[index], priors[index], alarm, params)
    ]
    for index in [index for index in singles if index in chosen and _may_drift(found[index], known, params)][:_DRIFTS]:
        child = _make_drifting_child(parent, found[index], alarm, params)
        ahead = entry + worth[index] + child.prior - parent.prior - priors[index] - behind
        births.append(Birth(child, ahead, than, doubt))
    opened = {id(found[index].cause) for index in chosen}
    left = sum(
        math.exp(min(entry + worth[index], 0.0))
        for place, index in enumerate(order)
        if id(found[index].cause) not in opened and (known_one is None or place != known_one[0])
    )
    return births, Rest(math.log(left) - behind, than) if left > 0.0 else None


def _find_known_proposal(
    parent: Hypothesis, causes: list[Cause], since_s: float, hypotheses: Sequence[Hypothesis]
) -> tuple[int, Hypothesis] | None:
    """Finds a proposed cause that a likely hypothesis already has; returns its index and the latter, or None."""
    n, found = len(parent.events), list[tuple[int, Hypothesis]]()
    best = max(other.weight for other in hypotheses)
    for other in hypotheses:
        if other.weight < best - _NEAR or len(other.events) != n + 1 or other.events[:n] != parent.events:
            continue
        if other.origin is not None and other.origin.parent.key != parent.key:  # a force that walks, there or here
            continue
        cause, onset_s, _ = other.events[n]
        if onset_s < since_s:
            continue
        if (place := _find_same_failures(cause, causes)) is not None:
            found.append((place, other))
    return max(found, key=lambda one: one[1].weight, default=None)


def _find_same_failures(cause: Cause, causes: list[Cause]) -> int | None:
    """Returns the index of the first cause in a list with the same failures as another; None: there is none."""
    return next(
        (at for at, one in enumerate(causes) if one.kind == cause.kind and one.failures == cause.failures), None
    )


def _find_shared_proposal(
    hypothesis: Hypothesis, causes: list[Cause], alarm: Alarm, hypotheses: Sequence[Hypothesis]
) -> tuple[int, Hypothesis, float] | None:
    """Finds a proposal that is a likely child of another parent: index, child and relative log weight, or None.

    What happens next is as probable whatever has happened before: it is ahead by as much as its parent was, nats.
    """
    first, since_s = alarm.screen.onsets[0], alarm.states[0].time_s
    best = max(other.weight for other in hypotheses)
    for other in sorted(hypotheses, key=lambda other: -other.weight):
        if other.origin is None or other.weight < best - _NEAR or other.events[-1].onset_s < since_s:
            continue
        parent: Hypothesis = other.origin.parent
        since, cause = parent.run.cycle - first, other.events[-1].cause
        place = _find_same_failures(cause, causes)
        if place is not None and 0 <= since < len(parent.trail):
            before = alarm.scores[0].likelihood + hypothesis.prior
            return place, other, before - parent.trail[-1 - since] - parent.prior
    return None


def proposal_key(child: Hypothesis) -> object:
    """Returns the key that equal proposals share: all events, the newest one's jets and size, and unknown pushes."""
    _, *newest = child.run.cause
    return frozenset(child.parts), *newest, tuple(child.walks), child.push, child.run.share


def _onset_span_s(alarm: Alarm, onset_index: int) -> float:
    """Returns the length of the time span that an onset of an alarm's first-order test represents, s."""
    states = alarm.states
    if onset_index > 0:
        return states[onset_index].time_s - states[onset_index - 1].time_s
    gap = alarm.screen.gaps[0]
    return gap * (states[1].time_s - states[0].time_s) / max(alarm.screen.gaps[1], 1) if len(states) > 1 else 0.1 * gap


def _log_prior(parent: Hypothesis, proposal: Contender, alarm: Alarm, params: Params) -> float:
    """Computes the log prior of a proposed fault event within its onset's time span, not of its forces, nats."""
    priors, cause = params.priors, proposal.cause
    seconds = _onset_span_s(alarm, alarm.screen.onsets.index(proposal.onset))
    if cause.kind == Kind.LIES:
        return log_event_probability(priors.reading_per_hour, seconds)
    new = [jet for jet, sign in zip(cause.jets, cause.signs, strict=True) if (jet, sign) not in parent.ways]
    total = math.log(priors.together) * max(len(new) - 1, 0)
    if new:
        total += log_event_probability(priors.jet_per_hour * float(np.mean(params.rates[new])), seconds)
        total += math.log1p(-priors.drifting)
    for way in zip(cause.jets, cause.signs, strict=True):
        if way in parent.ways:
            total += _log_change_probability(way, parent, seconds, priors)
    return total


def _log_change_probability(failure: tuple[int, int], parent: Hypothesis, duration_s: float, priors: Priors) -> float:
    """Computes the log prior that a failed jet's force changes in a time, higher after repeated changes, nats.

    That it is intermittent is the likelier the more often it has changed.
    """
    onsets = [event.onset_s for event in parent.events if failure in event.cause.failures]
    rare, often = priors.change_per_hour / 3600.0, _INTERMITTENT_PER_S
    lasted, changes = parent.run.state.time_s - onsets[0], len(onsets) - 1
    odds = math.log(priors.intermittent / (1.0 - priors.intermittent))
    odds += changes * math.log(often / rare) - (often - rare) * lasted
    share = 1.0 / (1.0 + math.exp(-max(min(odds, 500.0), -500.0)))
    return math.log(min((share * often + (1.0 - share) * rare) * duration_s, 0.5))


def _make_children(
    parent: Hypothesis, proposal: Contender, log_prior: float, alarm: Alarm, params: Params
) -> list[tuple[Hypothesis, float]]:
    """Makes a proposal's hypotheses at every likely onset, in pairs with their relative log weight, nats.

    An onset of the screen stands for the cycles since the one before; a filter is told them apart by single readings.
    """
    found, screen = [], alarm.screen
    for onset, lead in proposal.at_onsets or ((proposal.onset, proposal.lead),):
        if lead <= proposal.lead - _NEARER:
            continue
        place = screen.onsets.index(onset)
        apart = screen.gaps[place] if place > 0 and screen.gaps[place] <= _FINEST else 1
        each_prior = log_prior - math.log(apart)
        for cycle in range(onset - apart + 1, onset + 1):
            child = _make_child(
                parent, proposal, each_prior, alarm, (place if cycle == onset else place - 1, cycle, apart), params
            )
            found.append((child, lead - proposal.lead - math.log(apart)))
    return found


def _make_child(
    parent: Hypothesis, proposal: Contender, log_prior: float, alarm: Alarm, span: tuple[int, int, int], params: Params
) -> Hypothesis:
    """Makes a proposal's hypothesis at one onset; `span`: its index in the test, cycle, and cycles it stands for."""
    place, onset, apart = span
    begins, state, score = alarm.screen.onsets[place], alarm.states[place], alarm.scores[place]
    kicks = tuple(tuple(kick / apart for kick in kicks) for kicks in proposal.kicks)
    lies = proposal.cause.kind == Kind.LIES
    run = Runner(proposal.cause, onset, kicks, begins, state, score, lies)
    child = _branch_hypothesis(parent, run, log_prior, params.joint, make_origin(parent, alarm))
    if onset == begins:
        return child
    later_s = (alarm.states[place + 1].time_s - state.time_s) * (onset - begins) / apart
    event = child.events[-1]._replace(onset_s=state.time_s + later_s)
    return child._replace(events=(*child.events[:-1], event))


def make_origin(hypothesis: Hypothesis, alarm: Alarm) -> Origin:
    """Makes the origin of an alarm's proposals: the parent hypothesis, and the onsets of its first-order test."""
    screen = alarm.screen
    parent = hypothesis._replace(watch=None, origin=None, review=None)
    return Origin(parent, alarm.cycle, screen.onsets, screen.gaps, alarm.states, alarm.scores, alarm.read)


def _branch_hypothesis(
    parent: Hypothesis, runner: Runner, log_prior: float, params: JointParams, origin: Origin | None = None
) -> Hypothesis:
    """Makes a child hypothesis with one more event, that begins with the filter state at its onset."""
    opened_at, walks, state = parent.opened_at.copy(), parent.walks.copy(), runner.state
    slots = state.slot_jet.copy()
    for way in runner.cause.failures if runner.cause.kind == Kind.JETS else ():
        slot = failure_slot(state._replace(slot_jet=slots), *way)
        known = slots[slot] >= 0
        slots[slot] = way[0]
        opened_at[slot] = state.mean[params.places.force + slot] if known else np.nan
        if known and sum(way in event.cause.failures for event in parent.events) >= INTERMITTENT_AFTER:
            walks[slot] = ANEW
    event = Event(runner.cause, state.time_s, runner.score)
    return Hypothesis(
        runner,
        (*parent.events, event),
        parent.prior + log_prior,
        opened_at,
        walks,
        decided=parent.decided,
        push=parent.push,
        earlier=state if runner.cause.kind == Kind.JUMP else parent.earlier,
        jumped=runner.share if runner.cause.kind == Kind.JUMP else parent.jumped,
        origin=origin,
    )


INTERMITTENT_AFTER = 3  # changes, from which on anything is expected of a force at every interval


def _may_drift(proposal: Contender, slot_forces: Array, params: Params) -> bool:
    """Tests whether a proposal is a single jet's new failure, whose force may grow slowly from nothing."""
    cause = proposal.cause
    if cause.kind != Kind.JETS or len(cause.jets) != 1:
        return False
    column = cause.jets[0] + (params.joint.places.jets if cause.signs[0] < 0 else 0)
    return bool(slot_forces[column] == 0.0 and params.priors.drifting > 0.0)


def _make_drifting_child(parent: Hypothesis, proposal: Contender, alarm: Alarm, params: Params) -> Hypothesis:
    """Makes the child hypothesis in which the proposal's failed jet drifts: its force grows slowly from nothing."""
    priors, place = params.priors, alarm.screen.onsets.index(proposal.onset)
    seconds = _onset_span_s(alarm, place)
    rate = priors.jet_per_hour * float(params.rates[proposal.cause.jets[0]])
    prior = log_event_probability(rate, seconds) + math.log(priors.drifting)
    start = DRIFT * seconds * float(params.joint.thrusts[proposal.cause.jets[0]])
    onset = alarm.screen.onsets[place]
    run = Runner(proposal.cause, onset, (), onset, alarm.states[place], alarm.scores[place], expected=((0.0, start),))
    child = _branch_hypothesis(parent, run, prior, params.joint)
    walks = child.walks.copy()
    walks[failure_slot(run.state, proposal.cause.jets[0], proposal.cause.signs[0])] = DRIFT
    return child._replace(walks=walks)


def _make_pushed_child(parent: Hypothesis, push: float, alarm: Alarm, params: Params) -> Hypothesis:
    """Makes the child hypothesis in which an unknown wrench pushes the vehicle from the alarm's first onset on."""
    onset, state, score = alarm.screen.onsets[0], alarm.states[0], alarm.scores[0]
    prior = log_event_probability(params.priors.unknown_per_hour, _onset_span_s(alarm, 0)) - math.log(len(_PUSHES))
    run = Runner(Cause(Kind.UNKNOWN), onset, (), onset, state, score)
    return _branch_hypothesis(parent, run, prior, params.joint)._replace(push=push)


def _propose_disturbances(
    parent: Hypothesis, alarm: Alarm, log_weight: float, cycle: int, params: Params
) -> list[Birth]:
    """Proposes slow disturbances that the scenario does not state, stronger than the hypothesis has already.

    What such a hypothesis spends is that of a filter that follows, beside a rate, an acceleration that walks: with s
    what the walk over a sample is in sigmas of the reading, the innovation is as good as that of the reading alone for
    s << 1, and s of it for s >> 1 (Kalata 1984, the tracking index).
    """
    joint, seconds = params.joint, parent.watch.records[-1].link.duration_s
    unit = np.sqrt(np.sum(joint.unstated**2, axis=1)) * seconds / reading_sigmas(joint)
    prior = math.log(params.priors.disturbed / len(STIRS))
    now, found = parent.run.state, list[Birth]()
    by_now = _following_cost(now.stir, now.stir_s, unit, seconds)
    sudden = log_event_probability(_JUMPS_PER_HOUR, _onset_span_s(alarm, 0))
    begins = [(alarm.screen.onsets[0], alarm.states[0], alarm.scores[0], 1.0)]
    if cycle - alarm.cycle >= 2 * _LATER:
        bank = parent.watch.bank
        place = min(int(np.searchsorted(bank.since.cycles, cycle - _BEFORE)), len(bank.states) - 1)
        onset = int(bank.since.cycles[place])
        begins.append((onset, bank.states[place], parent.watch.records[onset - cycle - 1].score, 0.0))
    for stir in stronger_disturbances(now, joint):
        each_sample = _following_cost(*STIRS[stir], unit, seconds) - by_now
        for since, state, score, jumps in begins:
            same = STIRS[stir] == (now.stir, now.stir_s)
            if same if jumps == 0.0 else not same and stir // 2 % 2 > 0:  # what begins at once, level by decade
                continue
            run = Runner(Cause(Kind.WANDER, component=stir), since, (), since, state, score, share=jumps)
            child = _branch_hypothesis(parent, run, prior + (sudden if jumps > 0.0 else 0.0), joint)
            found.append(Birth(child, log_weight + child.prior - each_sample * (cycle - since), None, _NEARER))
    return found


def _following_cost(level: float, time_constant_s: float, increment: Array, duration_s: float) -> float:
    """Computes log likelihood lost per sample by estimating an acceleration that walks randomly at a level, nats."""
    walked = level * increment * math.sqrt(2.0 * duration_s / time_constant_s)
    return 0.5 * float(np.log1p(np.sqrt(2.0 * walked) + walked**2).sum())


def _propose_jumps(parent: Hypothesis, alarm: Alarm, log_weight: float, params: Params) -> list[Birth]:
    """Proposes jumps of the mass properties, of several sizes, at each onset of an alarm.

    The first order, which is of the screen's beginning alone, may miss a share of what there is to explain.
    """
    screen, found = alarm.screen, list[Birth]()
    least = (1.0 - _BENT) * 0.5 * screen.misfit - _NEAR
    for share, lead in zip(JUMP_SHARES, screens.jump_log_likelihoods(screen, params.joint).tolist(), strict=True):
        if lead < least:
            continue
        for place, (onset, state, score) in enumerate(zip(screen.onsets, alarm.states, alarm.scores, strict=True)):
            prior = log_jump_probability(_onset_span_s(alarm, place), params.priors)
            run = Runner(Cause(Kind.JUMP), onset, (), onset, state, score, share=share)
            child = _branch_hypothesis(parent, run, prior, params.joint)
            found.append(Birth(child, log_weight + lead + child.prior - parent.prior, None, _NEAR))
    return found


def _propose_component_faults(
    parent: Hypothesis, alarm: Alarm, log_weight: float, cycle: int, params: Params
) -> list[Birth]:
    """Proposes wrong wheel speeds, a jump of a single tracker's attitude, and engine failures at each onset.

    Of several trackers one that jumps contradicts the others, and lies.
    """
    joint, found = params.joint, list[Birth]()
    places, inverse = joint.places, parent.run.state.mean[:6][ELEMENT]
    finest = float(np.sqrt(joint.variances[: 3 * places.gyros].min(initial=np.inf)))
    causes, rare = [], params.priors.reading_per_hour
    for wheel in range(places.wheels):
        if math.isnan(parent.run.state.assumed[wheel]):
            wide = largest_wheel_turn(wheel, inverse, parent.watch.records[-1].link.duration_s, joint.wheels) / finest
            causes.append((Cause(Kind.SPEED, component=places.outputs + wheel), rare, 0.0, math.log1p(wide)))
    if places.trackers == 1:
        wide = TURNED / math.sqrt(float(joint.trackers.variances[0]))
        causes.append((Cause(Kind.TURN, component=places.outputs + places.wheels), rare, 3.0 * math.log1p(wide), 0.0))
    rate = params.priors.jet_per_hour
    causes += [(cause, rate, spent, 0.0) for cause, spent in _propose_engine_faults(parent, finest, joint)]
    for cause, per_hour, at_once, by_sample in causes:
        for place, onset in enumerate(alarm.screen.onsets):
            state, score = alarm.states[place], alarm.scores[place]
            prior = log_event_probability(per_hour, _onset_span_s(alarm, place))
            child = _branch_hypothesis(parent, Runner(cause, onset, (), onset, state, score), prior, joint)
            spent = at_once + by_sample * (cycle - onset)
            found.append(Birth(child, log_weight + child.prior - spent, None, _NEAR))
    return found


def _propose_engine_faults(parent: Hypothesis, gyro_sigma: float, params: JointParams) -> list[tuple[Cause, float]]:
    """Lists failures of the engines that burn, as pairs of cause and cost in log likelihood, nats."""
    burn, mean, found = parent.watch.records[-1].sample.burn, parent.run.state.mean, list[tuple[Cause, float]]()
    inverse, seconds = mean[:6][ELEMENT], parent.watch.records[-1].link.duration_s
    for engine, points in enumerate(burn.points):
        if not points[:, 0].any():
            continue
        given = thrust(engine, points[-1:], np.zeros(N_ERRORS), params.engines)
        arm, full = given.place - mean[CENTER], params.engines.thrusts[engine] * seconds
        by_angles = STUCK_SHARE * params.engines.stops[engine, 1:, None] * given.by_angles[:, 0]
        opened = [STUCK_THRUST * given.along[0], *by_angles]
        for channel, force in enumerate(opened):
            place = params.places.wheels + N_CHANNELS * engine + channel
            if force.any() and math.isnan(parent.run.state.assumed[place]):
                turned = float(np.linalg.norm(inverse @ np.cross(arm, full * force)))
                component = first_engine_index(params.places) + N_CHANNELS * engine + channel
                found.append((Cause(Kind.ENGINE, component=component), math.log1p(turned / gyro_sigma)))
    return found


def end_push(parent: Hypothesis, duration_s: float, params: JointParams) -> Hypothesis:
    """Makes the child hypothesis in which an unknown push ends with the newest sample."""
    run = parent.run
    fresh = Runner(Cause(Kind.UNKNOWN), run.cycle, (), run.cycle, run.state, run.score)
    return _branch_hypothesis(parent, fresh, math.log(_ENDS_PER_S * duration_s), params)._replace(push=0.0)
