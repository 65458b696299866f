"""Tree of hypotheses: each sample advances it, and unlikely ones are pruned.

advance   steps every hypothesis and adds the log likelihood of what its filter takes in
propose   opens what may have happened instead where a likely one does not explain its readings (`proposals`)
replay    steps what has been opened from its onset to now, best first, so many steps a sample
prune     merges hypotheses with the same events, and drops those that are far behind
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from massprop_drake.maths.estimation.faults import review as reviews
from massprop_drake.maths.estimation.faults.alarms import (
    UNTOLD,
    Alarm,
    Leads,
    advance_watch,
    likelihood_loss,
    raise_alarm,
)
from massprop_drake.maths.estimation.faults.fault_events import (
    Event,
    Hypothesis,
    add_interval_noise,
    advance_hypothesis,
    force_walk_sigmas,
    log_weight_deficit,
    needs_special_cycle,
    no_fault_hypothesis,
    record_cycle,
    restart_hypothesis,
    split_on_command,
    update_weight,
)
from massprop_drake.maths.estimation.faults.fault_report import History
from massprop_drake.maths.estimation.faults.priors import Params
from massprop_drake.maths.estimation.faults.proposals import Birth, draw_proposals, end_push, proposal_key
from massprop_drake.maths.estimation.faults.search import SearchOutcome
from massprop_drake.maths.estimation.joint import bank as banks
from massprop_drake.maths.estimation.joint.guard import reset_guard
from massprop_drake.maths.estimation.joint.hypotheses import NO_SCORE, Kind, Runner, prepare_cycle
from massprop_drake.maths.estimation.joint.joint_cycle import JointEvidence, step
from massprop_drake.maths.estimation.joint.joint_sample import JointSample
from massprop_drake.maths.estimation.joint.layout import JointParams, JointState
from massprop_drake.maths.estimation.joint.sensitivity import Link, linearize_cycle
from massprop_drake.maths.linear_algebra import NotPositiveDefiniteError

_BEHIND = 30.0  # nats at which a hypothesis is dropped: a probability of 1e-13
_LONG_BEHIND = 14.0  # likewise long after its newest event: a probability of 1e-6; what is likely is proposed anew
_MOST = 16  # hypotheses: compute budget
_BUDGET = 24  # filter steps a sample beside those of the hypotheses: compute budget
_WATCHED = 4  # hypotheses whose readings are watched: compute budget
_LIKELY = 5.0  # nats behind the likeliest within which they are: a probability of 1 %
SURPRISE = 10.0  # nats by which newest readings are likelier by another: as rare as an event
_REVIEWED = 3  # hypotheses that are reviewed at a time: compute budget
_DRAWS = 1  # of alarms, and of reviews, a sample: compute budget
_CATCH_UP = 8  # cycles of a review a sample: compute budget
_NO_ROOM = "no room"  # origin of proposals that have been hypotheses
_ROOT_S = 8.0  # for which what was likeliest before an alarm has children, and after which an event is long ago


class Tree(NamedTuple):
    """All hypotheses, likeliest first, and proposals that wait.

    Attributes:
        cycle: number of samples taken.
        births: see `Birth`, best first.
        samples: those since the oldest onset that a proposal may have, with their links.
        tried: proposals that have arrived of late, whatever has become of them.
        history: None: the likeliest history is the one that has been reported.
    """

    cycle: int = 0
    hypotheses: tuple[Hypothesis, ...] = ()
    births: tuple[Birth, ...] = ()
    samples: tuple[tuple[JointSample, Link], ...] = ()
    tried: frozenset[tuple[object, int]] = frozenset()
    history: History | None = None

    @property
    def leader(self) -> Hypothesis:
        """Likeliest hypothesis of the tree."""
        return self.hypotheses[0]

    def next_state(self, params: Params) -> JointState:
        """Returns the likeliest hypothesis's filter state, interval noise added, with which the next cycle begins."""
        if not self.samples:
            return self.leader.run.state
        return add_interval_noise(self.leader, self.samples[-1][1], params.joint)


def advance(tree: Tree, evidence: JointEvidence, params: Params) -> Tree:
    """Advances all fault hypotheses by one sample: filters, alarms, proposals, reviews and pruning.

    Args:
        evidence: of the cycle of the filter, which began with the leader's state.
    """
    cycle, report = tree.cycle + 1, evidence.report
    if not tree.hypotheses:
        return Tree(cycle, (no_fault_hypothesis(evidence.after, cycle, params.joint),))
    leader = tree.leader
    if report.course is None or (report.incremented and not leader.events):
        begins = record_cycle(leader, leader.run._replace(state=evidence.after, cycle=cycle), params.joint)
        begins = begins._replace(watch=None)
        rest = tree.hypotheses[1:] if report.course is None else ()
        others = [restart_hypothesis(each, evidence.sample, cycle, params.joint) for each in rest]
        return Tree(cycle, (begins, *others))
    if report.incremented:  # a jump was larger than it was expected
        leader = leader._replace(prior=leader.prior + math.log(params.priors.start))
        tree = tree._replace(hypotheses=(leader, *tree.hypotheses[1:]))
    interval = linearize_cycle(evidence.before, report, evidence.sample, params.joint)
    samples = (*tree.samples, (evidence.sample, interval))[-(banks.OLDEST * params.joint.rates.steps + 2) :]
    before = tree.leader
    tree = tree._replace(cycle=cycle, samples=samples, history=None)
    stepped = _step_hypotheses(tree.hypotheses, evidence, cycle, params, interval)
    tree = tree._replace(hypotheses=tuple(_raise_alarms(stepped, before.weight, cycle, params)))
    tree = _advance_reviews(_draw_due_proposals(tree, params), params)
    tree = _replay_proposals(tree, params, starting=report.starting)
    return _record_history(_prune_hypotheses(tree, evidence.sample.time_s, params), before)


def tree_from_search(outcomes: Sequence[SearchOutcome], tree: Tree, params: Params) -> Tree:
    """Makes the tree of fault hypotheses from the outcomes of a search over the initialization."""
    cycle = tree.cycle + 1
    hypotheses = []
    for outcome in outcomes:
        run = Runner(outcome.cause, 0, (), cycle, outcome.state, outcome.score)
        events = () if outcome.cause.kind == Kind.NOTHING else (Event(outcome.cause, outcome.onset_s, NO_SCORE),)
        start = no_fault_hypothesis(outcome.state, cycle, params.joint)
        hypotheses.append(update_weight(start._replace(run=run, events=events, prior=outcome.log_prior), params))
    ordered = sorted(zip(hypotheses, outcomes, strict=True), key=lambda pair: -pair[0].weight)
    _, likeliest = ordered[0]
    return Tree(cycle, tuple(each for each, _ in ordered), history=History(likeliest.since_s, likeliest.score))


def _step_hypotheses(
    hypotheses: tuple[Hypothesis, ...], evidence: JointEvidence, cycle: int, params: Params, interval: Link
) -> list[Hypothesis]:
    """Advances and weights all hypotheses by one sample; the first uses the main filter's cycle if it needs no own."""
    joint, sample, starting, found = params.joint, evidence.sample, evidence.report.starting, []
    best = hypotheses[0].weight
    for place, whole in enumerate(hypotheses):
        likely = whole.weight > best - _LIKELY
        for each in split_on_command(whole, sample):
            try:
                if needs_special_cycle(each, interval.duration_s, joint):
                    if each.run.lying or each.run.age == 0:
                        after = advance_hypothesis(each, sample, interval, joint, starting=starting)
                        found.append(after._replace(watch=None))
                    else:
                        found.append(_advance_after_onset(each, evidence, cycle, interval, joint, likely=likely))
                elif place == 0 and each.run.state is whole.run.state:
                    found.append(advance_watch(each, evidence, cycle, joint, likely=likely))
                elif each.watch is not None or (place < _WATCHED and likely):
                    before = add_interval_noise(each, interval, joint)
                    found.append(_advance_from_state(before, each, evidence, cycle, joint, likely=likely))
                else:
                    found.append(advance_hypothesis(each, sample, interval, joint, starting=starting))
            except NotPositiveDefiniteError:
                if place == 0:
                    raise
    found = [update_weight(each._replace(before=each.weight), params) for each in found]
    if all(each.weight == -math.inf for each in found):  # something more has happened, of which forces tell nothing
        return [each._replace(weight=each.run.score.likelihood + each.prior) for each in found]
    return found


def _advance_after_onset(
    hypothesis: Hypothesis, evidence: JointEvidence, cycle: int, interval: Link, params: JointParams, *, likely: bool
) -> Hypothesis:
    """Advances a hypothesis and its fault test soon after its failure's onset, when a further impulse may still act.

    What else fails meanwhile is proposed from its own state.
    """
    erratic = force_walk_sigmas(hypothesis, interval.duration_s)
    before, likelihood = prepare_cycle(hypothesis.run, evidence.sample, interval, erratic, hypothesis.push, params)
    run = hypothesis.run._replace(score=hypothesis.run.score.plus(NO_SCORE._replace(likelihood=likelihood)))
    return _advance_from_state(before, hypothesis._replace(run=run), evidence, cycle, params, likely=likely)


def _advance_from_state(
    state: JointState, hypothesis: Hypothesis, evidence: JointEvidence, cycle: int, params: JointParams, *, likely: bool
) -> Hypothesis:
    """Advances a hypothesis and its fault test by a filter cycle that begins with the state passed in."""
    after, report = step(state, evidence.sample, params)
    after = reset_guard(after) if evidence.report.starting else after
    report = report._replace(rotation_known=evidence.report.rotation_known)
    own = JointEvidence(state, after, report, evidence.sample, False)
    return advance_watch(hypothesis, own, cycle, params, likely=likely)


def _raise_alarms(hypotheses: list[Hypothesis], best_weight: float, cycle: int, params: Params) -> list[Hypothesis]:
    """Adds alarms to hypotheses that were likely before the newest sample, and have lost likelihood with it."""
    now = max(each.weight for each in hypotheses)
    return [
        raise_alarm(each, cycle, params.joint)
        if each.before > best_weight - _LIKELY and (each.weight < now - SURPRISE or likelihood_loss(each) > SURPRISE)
        else each
        for each in hypotheses
    ]


def _draw_due_proposals(tree: Tree, params: Params) -> Tree:
    """Adds proposals of alarms that are due for another draw, and hypotheses in which an unknown push ends."""
    births, hypotheses, more, left = list(tree.births), [], [], _DRAWS
    sample, interval = tree.samples[-1]
    now_s, leader = sample.time_s, max(tree.hypotheses, key=lambda each: each.weight)
    for each in tree.hypotheses:
        age = each.run.age
        if each.push > 0.0 and age > 0 and _is_draw_due(age, age - 1):
            more.append(update_weight(end_push(each, interval.duration_s, params.joint), params))
        alarm = each.alarm
        if alarm is None:
            hypotheses.append(each)
            continue
        age, until_s, origin = tree.cycle - alarm.cycle, each.root_until_s, (each.key, alarm.cycle)
        reviewed = _is_reviewed(each, tree)
        if each.weight < leader.weight - _BEHIND and (reviewed or _is_alarm_exhausted(alarm, leader, tree)):
            births = births if not reviewed and alarm.rest == UNTOLD else _remove_draw(births, origin)
            hypotheses.append(each._replace(watch=None, root_until_s=-math.inf))
            continue
        if alarm.drawn < 0:
            until_s = max(until_s, now_s + _ROOT_S)
        if reviewed:
            births, alarm = _remove_draw(births, origin), alarm._replace(rest=None)
        elif left > 0 and _is_draw_due(age, alarm.drawn):
            left -= 1
            there = _map_known_proposals(tree, tree.hypotheses, births)
            fresh, rest = draw_proposals(each, tree.cycle, tree.hypotheses, params)
            births = _join_new_draw(births if rest == UNTOLD else _remove_draw(births, origin), fresh, origin, there)
            alarm = alarm._replace(drawn=age, rest=rest)
        if now_s > until_s:
            births, alarm = _remove_draw(births, origin), None
        hypotheses.append(each._replace(watch=each.watch._replace(alarm=alarm), root_until_s=until_s))
    return tree._replace(hypotheses=(*hypotheses, *more), births=tuple(births))


def _is_alarm_exhausted(alarm: Alarm, leader: Hypothesis, tree: Tree) -> bool:
    """Tests whether more draws of an alarm are useless: first-order tests fail, or the leader's review replaces it."""
    untold = alarm.rest == UNTOLD and not reviews.is_reviewable(leader)
    return alarm.drawn >= 0 and (untold or _is_leader_reviewed(leader, tree))


def _is_reviewed(hypothesis: Hypothesis, tree: Tree) -> bool:
    """Tests whether a likely descendant of a hypothesis has a review, which replaces draws of its own alarm."""
    n, best = len(hypothesis.events), max(other.weight for other in tree.hypotheses)
    return any(
        other.review is not None
        and other.review.drawn >= 0
        and other.weight > best - _LIKELY
        and len(other.events) > n
        and other.events[:n] == hypothesis.events
        for other in tree.hypotheses
    )


def _alarm_age(hypothesis: Hypothesis, tree: Tree) -> int:
    """Returns the number of cycles since the alarm of a hypothesis; -1: it has none."""
    return -1 if hypothesis.alarm is None else tree.cycle - hypothesis.alarm.cycle


def _is_leader_reviewed(leader: Hypothesis, tree: Tree) -> bool:
    """Tests whether the likeliest hypothesis has no alarm, and its own review has drawn alternatives."""
    return leader.review is not None and leader.review.drawn >= 0 and _alarm_age(leader, tree) < 0


def _is_draw_due(age: int, last_draw_age: int) -> bool:
    """Tests whether proposals are due to be drawn, at ages of 0, 1, 2, 4, 8 ... cycles, given the last draw's."""
    return age >= 0 and (1 << age.bit_length()) >> 1 > last_draw_age


def hypotheses_with_draws(tree: Tree) -> tuple[Hypothesis, ...]:
    """Returns hypotheses whose draws may leave proposals out: all, or those near the likeliest if it is reviewed."""
    leader = tree.leader
    if leader.review is None or leader.review.drawn < 0:
        return tree.hypotheses
    return tuple(each for each in tree.hypotheses if each.weight > leader.weight - _BEHIND)


def is_likely(hypothesis: Hypothesis, tree: Tree) -> bool:
    """Tests whether a hypothesis's log weight is within 5 nats of the likeliest."""
    return hypothesis.weight > tree.leader.weight - _LIKELY


def relative_log_weights(tree: Tree) -> Leads:
    """Maps each sequence of events to the largest log weight of its hypotheses, relative to the likeliest, nats."""
    best = max(each.weight for each in tree.hypotheses)
    found: dict[tuple[Event, ...], float] = {}
    for each in tree.hypotheses:
        found[each.events] = max(found.get(each.events, -math.inf), each.weight - best)
    return found


def _advance_reviews(tree: Tree, params: Params) -> Tree:
    """Advances the reviews of the likeliest hypotheses, and adds the alternatives that these propose."""
    births, hypotheses, left = list(tree.births), list(tree.hypotheses), _DRAWS
    best, now_s = max(each.weight for each in hypotheses), tree.samples[-1][0].time_s
    calm = _is_leader_reviewed(max(hypotheses, key=lambda each: each.weight), tree)
    likely = [
        place
        for place, each in enumerate(hypotheses)
        if (each.weight > best - _LIKELY or (not calm and _alarm_age(each, tree) >= 0))
        and reviews.is_reviewable(each)
        and now_s - each.events[-1].onset_s < _ROOT_S
    ]
    for place in sorted(likely, key=lambda place: -hypotheses[place].weight)[:_REVIEWED]:
        each = hypotheses[place]
        review = each.review or reviews.begin_review(each, params.joint)
        if tree.cycle - review.run.cycle > len(tree.samples):
            continue
        for _ in range(min(tree.cycle - review.run.cycle, _CATCH_UP)):
            sample, interval = tree.samples[review.run.cycle - tree.cycle]
            review = reviews.advance_review(review, each, sample, interval, params.joint)
        age, alarmed = each.run.age, _alarm_age(each, tree)
        due = _is_draw_due(age, review.drawn) or _is_draw_due(alarmed, review.drawn - age + alarmed)
        due = due and left > 0 and review.run.cycle == tree.cycle
        if due and reviews.is_force_significant(review, each, params.joint):
            left -= 1
            origin, there = ("review", each.key), _map_known_proposals(tree, hypotheses, births)
            review, fresh, rest = reviews.draw_alternatives(review, each, hypotheses, params)
            if each.weight == best:
                births = [birth for birth in births if not _is_rival(birth, each)]
            births = _join_new_draw(_remove_draw(births, origin), fresh, origin, there)
            review = review._replace(drawn=age, rest=rest)
        hypotheses[place] = each._replace(review=review)
    tree = tree._replace(hypotheses=tuple(hypotheses))
    return tree._replace(births=_interleave_proposals(births, relative_log_weights(tree)))


def _is_rival(proposal: Birth, hypothesis: Hypothesis) -> bool:
    """Tests whether a drawn proposal has another jet failure in place of a hypothesis's newest event."""
    same = proposal.child.events[:-1] == hypothesis.events[:-1]
    return proposal.origin != _NO_ROOM and proposal.child.run.cause.kind == Kind.JETS and same


def _interleave_proposals(proposals: Sequence[Birth], log_weights: Leads) -> tuple[Birth, ...]:
    """Orders proposals for their replay: first the best of each draw, then the second of each, and so on.

    What different draws neglect differs, and so what jets and jumps do; a draw that is too sure of itself must not keep
    all others waiting. Those are best that might be likeliest, by what the first order may be off: they keep
    declarations waiting.
    """
    ranks: dict[tuple[object, Kind], int] = {}
    ranked: list[tuple[int, float, int, Birth]] = []
    for birth in sorted(proposals, key=lambda birth: -birth.log_weight(log_weights) - birth.doubt):
        draw = (birth.origin, birth.child.run.cause.kind)
        ranks[draw] = ranks.get(draw, -1) + 1
        ranked.append((ranks[draw], -birth.log_weight(log_weights) - birth.doubt, len(ranked), birth))
    return tuple(birth for *_, birth in sorted(ranked, key=lambda one: one[:3]))


def _map_known_proposals(
    tree: Tree, hypotheses: Sequence[Hypothesis], proposals: Sequence[Birth]
) -> dict[object, Birth | None]:
    """Maps keys of present and past hypotheses to None, and keys of waiting proposals to the proposals."""
    there: dict[object, Birth | None] = {_proposal_onset_key(birth.child): birth for birth in proposals}
    return there | dict.fromkeys(map(_proposal_onset_key, hypotheses)) | dict.fromkeys(tree.tried)


def _proposal_onset_key(hypothesis: Hypothesis) -> tuple[object, int]:
    """Returns the key that equal proposals share, and the cycle of their onset."""
    return proposal_key(hypothesis), hypothesis.run.onset


def _remove_draw(proposals: Sequence[Birth], origin: object) -> list[Birth]:
    """Returns the proposals without those of one draw, identified by its origin."""
    return [birth for birth in proposals if birth.origin != origin]


def _join_new_draw(
    pending: Sequence[Birth], new: Sequence[Birth], origin: object, known_by_key: Mapping[object, Birth | None]
) -> list[Birth]:
    """Adds a draw's new proposals to waiting ones; a proposal that is known already keeps its replay so far."""
    kept = list(pending)
    waiting = {_proposal_onset_key(birth.child) for birth in kept}
    for birth in new:
        same = _proposal_onset_key(birth.child)
        if same in waiting or (same in known_by_key and known_by_key[same] is None):
            continue
        known = known_by_key.get(same)
        kept.append(birth._replace(child=birth.child if known is None else known.child, origin=origin))
        waiting.add(same)
    return kept


def _replay_proposals(tree: Tree, params: Params, *, starting: bool) -> Tree:
    """Replays proposals to the newest sample within the step budget; likely ones that arrive become hypotheses."""
    left, arrived, tried = _BUDGET, list(tree.hypotheses), set(tree.tried)
    best = max(tree.hypotheses, key=lambda each: each.weight)
    queue, waiting = list(tree.births), []
    while queue:
        birth = queue.pop(0)
        child = birth.child
        if tree.cycle - child.run.cycle > len(tree.samples):  # too old to be heard any more
            continue
        try:
            while left > 0 and child.run.cycle < tree.cycle and log_weight_deficit(child, best) < _BEHIND:
                sample, interval = tree.samples[child.run.cycle - tree.cycle]
                if child.run.age > 0:
                    child, *twins = split_on_command(child, sample)
                    queue[:0] = [birth._replace(child=twin) for twin in twins]
                child = advance_hypothesis(child, sample, interval, params.joint, starting=starting)
                left -= 1
        except (NotPositiveDefiniteError, np.linalg.LinAlgError):
            continue
        if log_weight_deficit(child, best) >= _BEHIND:
            tried.add(_proposal_onset_key(child))
        elif child.run.cycle == tree.cycle:
            arrived.append(update_weight(child, params))
            tried.add(_proposal_onset_key(child))
        else:
            waiting.append(birth._replace(child=child))
    kept = frozenset(one for one in tried if one[1] >= tree.cycle - len(tree.samples))
    return tree._replace(hypotheses=tuple(arrived), births=tuple(waiting), tried=kept)


def _prune_hypotheses(tree: Tree, now_s: float, params: Params) -> Tree:
    """Prunes unlikely hypotheses, merges equal ones, and sorts the rest, likeliest first.

    Those for which there is no room wait where they are, as proposals.
    """
    order = sorted(tree.hypotheses, key=lambda each: -each.weight)
    best, kept = order[0].weight, dict[object, Hypothesis]()
    for each in order:
        settled = not each.events or now_s > each.events[-1].onset_s + _ROOT_S
        late = settled and each.run.state.stir == 0.0  # how strong something unstated is, only its strongest times show
        if each.weight < best - (_LONG_BEHIND if late else _BEHIND) and now_s > each.root_until_s:
            continue
        same = kept.get(each.key)
        if same is None or (each.watch is not None and now_s <= each.root_until_s):
            kept[each.key if same is None else object()] = each
            continue
        more = math.log1p(math.exp(each.weight - same.weight))
        kept[each.key] = same._replace(prior=same.prior + more, weight=same.weight + more)
    order = sorted(kept.values(), key=lambda each: -each.weight)
    roots = (each for each in order[_MOST:] if now_s <= each.root_until_s)
    waits = (
        Birth(each._replace(watch=None, review=None), each.weight - best, order[0].events, 0.0, _NO_ROOM)
        for each in order[_MOST:]
        if now_s > each.root_until_s
    )
    tree = tree._replace(hypotheses=(*order[:_MOST], *roots), births=(*tree.births, *waits))
    births, leads = [_detach_reference(birth, tree) for birth in tree.births], relative_log_weights(tree)
    return tree._replace(births=tuple(one for one in births if one and one.log_weight(leads) + one.doubt > -_BEHIND))


def _detach_reference(proposal: Birth, tree: Tree) -> Birth | None:
    """Weighs a proposal against the likeliest if its reference is unlikely; None: the likeliest continues that."""
    than, best = proposal.than, tree.leader.weight
    if than is None or any(each.events == than and each.weight > best - _BEHIND for each in tree.hypotheses):
        return proposal
    if tree.leader.events[: len(than)] == than:
        return None
    before = max(each.before for each in tree.hypotheses)
    lead = max((each.before - before for each in tree.hypotheses if each.events == than), default=0.0)
    return proposal._replace(ahead=proposal.ahead + max(lead, -_LIKELY), than=None)


def _record_history(tree: Tree, previous_leader: Hypothesis) -> Tree:
    """Records onset and score of the likeliest history where its events differ from the previous leader's."""
    known, now = previous_leader.events, tree.leader.events
    if now == known:
        return tree
    place = next((at for at, event in enumerate(now) if at >= len(known) or event != known[at]), None)
    if place is None:
        return tree
    score = tree.leader.run.score.without(now[place].score)
    return tree._replace(history=History(now[place].onset_s, score))


def probabilities(tree: Tree) -> list[tuple[Hypothesis, float]]:
    """Returns pairs of hypothesis and posterior probability, in the tree's order."""
    weights = np.array([each.weight for each in tree.hypotheses])
    odds = np.exp(weights - weights.max())
    return list(zip(tree.hypotheses, (odds / odds.sum()).tolist(), strict=True))
