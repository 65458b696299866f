r"""Hypotheses about what has happened, each a filter with a log weight and a list of events.

advance   steps every hypothesis and adds the log likelihood of what its filter takes in
watch     looks, in those that are likely, for anything that they do not explain
propose   ranks what may have happened to first order, and opens the likeliest at its onset
replay    steps what has been opened from its onset to now, best first, so many steps a sample
prune     merges hypotheses with the same events, and drops those that are far behind
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from massprop_drake.maths.estimation.faults.priors import Priors, force_correction, log_rate
from massprop_drake.maths.estimation.joint import bank as banks
from massprop_drake.maths.estimation.joint import screen as screens
from massprop_drake.maths.estimation.joint.bank import Bank
from massprop_drake.maths.estimation.joint.cycle import JointEvidence, Sample, step
from massprop_drake.maths.estimation.joint.hypotheses import (
    NO_SCORE,
    Cause,
    Kind,
    Runner,
    Score,
    known_forces,
    stepped,
    told,
    without_increments,
)
from massprop_drake.maths.estimation.joint.layout import JointParams, JointState
from massprop_drake.maths.estimation.joint.screen import Contender, Screen
from massprop_drake.maths.estimation.joint.sensitivity import Link, link, traces
from massprop_drake.maths.kernels import kernel
from massprop_drake.maths.linear_algebra import NotPositiveDefiniteError

_NOTHING = Cause(Kind.NOTHING)
_ALARM = 22.0  # GLR of a single jet, chi-square: once in 1e6 samples
_ALARM_ANY = 40.0  # of anything, six components
_SHARE = 0.7  # of the largest statistic: older onsets explain the end point as well
_BEHIND = 30.0  # nats at which a hypothesis is dropped
_MOST = 16  # hypotheses: compute budget
_BUDGET = 24  # filter steps a sample beside those of the hypotheses
_SINGLES, _PAIRS = 12, 10  # proposals of a draw
_NEAR = 20.0  # nats within which proposals are looked at
_ROOT_S = 8.0  # for which what was likeliest before an alarm has children
_KICKED = 3  # intervals after its onset in which a force may build up


class Record(NamedTuple):
    """A cycle of a watched hypothesis."""

    sample: Sample
    link: Link
    score: Score  # after it


class Alarm(NamedTuple):
    """Something that a hypothesis does not explain.

    Attributes:
        cycle: of the first alarm.
        states: where the screen begins, and at each of its onsets.
        scores: at each of its onsets.
        screen: see `Screen`.
        drawn: age of the newest draw.
        unheard: weight of what it left to first order, over that of what it opened.
    """

    cycle: int
    states: tuple[JointState, ...]
    scores: tuple[Score, ...]
    screen: Screen
    drawn: int = -1
    unheard: float = 0.0


class Watch(NamedTuple):
    """Bank of onsets of a hypothesis, its cycles since the oldest, and its alarm."""

    bank: Bank
    records: tuple[Record, ...]
    alarm: Alarm | None = None


class Hypothesis(NamedTuple):
    """What may have happened.

    Attributes:
        run: filter, with the newest event and the log likelihood of all readings since the common origin.
        events: causes with their onsets, s, oldest first.
        prior: log prior of the events, nats.
        watch: see `Watch`; None: it is not watched.
        root_until_s: time until which it is kept, whatever its weight.
    """

    run: Runner
    events: tuple[tuple[Cause, float], ...] = ()
    prior: float = 0.0
    watch: Watch | None = None
    root_until_s: float = -math.inf

    @property
    def key(self) -> frozenset[object]:
        """By which hypotheses are the same."""
        return frozenset(part for cause, _ in self.events for part in (cause.failures or {cause}))


class Birth(NamedTuple):
    """A proposal, on its way from its onset to now."""

    child: Hypothesis
    first_order: float
    origin: object


class Tree(NamedTuple):
    """All hypotheses, likeliest first, and proposals that wait.

    Attributes:
        cycle: number of samples taken.
        hypotheses: see `Hypothesis`.
        births: see `Birth`, best first.
        samples: those since the oldest onset that a proposal may have, with their links.
    """

    cycle: int = 0
    hypotheses: tuple[Hypothesis, ...] = ()
    births: tuple[Birth, ...] = ()
    samples: tuple[tuple[Sample, Link], ...] = ()

    @property
    def leader(self) -> Hypothesis:
        """The likeliest."""
        return self.hypotheses[0]


@kernel
def alarming(likelihood: float, total: float) -> bool:
    """Whether readings say that a hypothesis does not explain them.

    Args:
        likelihood, total: largest GLR of a jet, and of anything.
    """
    return likelihood > _ALARM or total > _ALARM_ANY


def weight(each: Hypothesis, params: JointParams) -> float:
    """Log weight of a hypothesis: likelihood, prior of its events, and what its forces are worth."""
    total = each.run.score.likelihood + each.prior
    state = each.run.state
    for slot in np.flatnonzero(state.slot_jet >= 0):
        force, sigma = force_of(state, int(slot), params)
        thrust = float(params.thrusts[int(state.slot_jet[slot])])
        total += force_correction(force, sigma, thrust, missing=bool(state.slot_sign[slot] < 0.0))
    return total


def force_of(state: JointState, slot: int, params: JointParams) -> tuple[float, float]:
    """Force in a slot, and its 1-sigma, lbf or N."""
    row = params.places.force + slot
    return float(state.mean[row]), float(np.sqrt(np.sum(state.root[row] ** 2)))


def begun(state: JointState, cycle: int, params: JointParams) -> Hypothesis:
    """The hypothesis that nothing has happened."""
    run = Runner(_NOTHING, cycle, (), cycle, state, NO_SCORE, False)
    return Hypothesis(run, watch=Watch(banks.empty(params.places), ()))


def advance(tree: Tree, evidence: JointEvidence, priors: Priors, params: JointParams) -> Tree:
    """The tree after one more sample.

    Args:
        tree: before it.
        evidence: of the cycle of the filter, which goes on from the leader's state.
        priors: see `Priors`.
        params: see `JointParams`.
    """
    quiet = without_increments(params)
    sample, cycle = evidence.sample, tree.cycle + 1
    leader, first = _watched(tree.leader, evidence, quiet, cycle)
    samples = (*tree.samples, (sample, first.link))[-(banks.OLDEST + 2) :]
    on = [leader]
    for each in tree.hypotheses[1:]:
        try:
            on.append(_stepped(each, sample, first.link, cycle, quiet))
        except NotPositiveDefiniteError:
            continue
    tree = tree._replace(cycle=cycle, hypotheses=tuple(on), samples=samples)
    tree = _proposed(tree, priors, params)
    tree = _replayed(tree, quiet)
    return _pruned(tree, sample.time_s, params)


def _watched(each: Hypothesis, evidence: JointEvidence, params: JointParams, cycle: int) -> tuple[Hypothesis, Record]:
    """The leader after a cycle that the filter has made, if it has, and its record."""
    run, sample = each.run, evidence.sample
    if (run.age < _KICKED and run.cause.kind != Kind.NOTHING) or run.lying:
        over = link(evidence.before, evidence.report, sample, params)
        done = stepped(run, sample, over, np.zeros(params.places.n_force), params)
        return each._replace(run=done), Record(sample, over, done.score)
    score = run.score.plus(told(evidence.report))
    done = run._replace(cycle=cycle, state=evidence.after, score=score, newest=told(evidence.report))
    watch = each.watch or Watch(banks.empty(params.places), ())
    seen = traces(evidence.before, evidence.report, sample)
    over, found, _, bank = banks.followed_on(watch.bank, seen, evidence.after, cycle, _ALARM, params)
    record = Record(sample, over, score)
    records = (*watch.records, record)
    alarm = watch.alarm
    if alarm is not None:
        alarm = alarm._replace(screen=screens.screened(alarm.screen, over, params))
    elif found is not None and (found.likelihood.max() > _ALARM or found.total.max() > _ALARM_ANY):
        alarm = _alarm(watch.bank, records, banks.onset_of(found.total, _SHARE), cycle, params)
    oldest = int(bank.cycles[0]) if alarm is None else min(int(bank.cycles[0]), alarm.screen.began)
    watch = Watch(bank, records[-(cycle - oldest + 1) :], alarm)
    return each._replace(run=done, watch=watch), record


def _alarm(bank: Bank, records: tuple[Record, ...], index: int, cycle: int, params: JointParams) -> Alarm:
    first, chosen = max(index - 2, 0), range(max(index - 2, 0), min(index + 2, len(bank.states)))
    cycles = bank.cycles.astype(np.intp)
    onsets = tuple(int(cycles[k]) for k in chosen)
    gaps = tuple(int(cycles[k] - cycles[k - 1]) if k > 0 else 1 for k in chosen)
    began = int(cycles[first])
    screen = screens.begin((bank.states[first], began), onsets, gaps, records[began - cycle - 1].link.read, params)
    for record in records[len(records) - (cycle - began) :]:
        screen = screens.screened(screen, record.link, params)
    scores = tuple(records[onset - cycle - 1].score for onset in onsets)
    return Alarm(cycle, tuple(bank.states[k] for k in chosen), scores, screen)


def _stepped(each: Hypothesis, sample: Sample, over: Link, cycle: int, params: JointParams) -> Hypothesis:
    """A hypothesis that does not lead after a cycle; a root is watched on."""
    run = each.run
    if each.watch is None or (run.age < _KICKED and run.cause.kind != Kind.NOTHING):
        return each._replace(run=stepped(run, sample, over, np.zeros(params.places.n_force), params))
    after, report = step(run.state, sample, params)
    evidence = JointEvidence(run.state, after, report, sample, False)
    return _watched(each, evidence, params, cycle)[0]


def _proposed(tree: Tree, priors: Priors, params: JointParams) -> Tree:
    """The tree with proposals of every alarm that is due to be drawn."""
    births, hypotheses = list(tree.births), []
    for each in tree.hypotheses:
        alarm = each.watch.alarm if each.watch is not None else None
        if alarm is None:
            hypotheses.append(each)
            continue
        age, until_s = tree.cycle - alarm.cycle, each.root_until_s
        now_s = tree.samples[-1][0].time_s
        due = age == 0 or age & (age - 1) == 0
        if due and alarm.drawn != age:
            births = [birth for birth in births if birth.origin != (each.key, alarm.cycle)]
            more, unheard = _drawn(each, alarm, tree, priors, params)
            births += more
            alarm = alarm._replace(drawn=age, unheard=unheard)
            until_s = max(until_s, _until(each, now_s, age))
        if now_s > until_s:
            alarm = None
        hypotheses.append(each._replace(watch=each.watch._replace(alarm=alarm), root_until_s=until_s))
    births.sort(key=lambda birth: -birth.first_order)
    return tree._replace(hypotheses=tuple(hypotheses), births=tuple(births))


def _until(each: Hypothesis, now_s: float, age: int) -> float:
    return now_s + _ROOT_S if age == 0 else each.root_until_s


def _drawn(
    each: Hypothesis, alarm: Alarm, tree: Tree, priors: Priors, params: JointParams
) -> tuple[list[Birth], float]:
    """Proposals of a draw that are not there yet, and the weight of what is left over that of what is opened."""
    state, known = alarm.states[0], known_forces(alarm.states[0], params)
    free = int((state.slot_jet < 0).sum())
    allowed = (np.ones(2 * params.places.jets) if free > 0 else known) > 0.0
    found = screens.contenders(alarm.screen, allowed, known, params)
    singles = [one for one in found if len(one.cause.jets) <= 1][:_SINGLES]
    pairs = [one for one in found if len(one.cause.jets) == 2 and free > 1][:_PAIRS]
    best = max((one.lead for one in (*singles, *pairs)), default=0.0)
    there = {(other.key, other.run.onset) for other in tree.hypotheses}
    there |= {(birth.child.key, birth.child.run.onset) for birth in tree.births}
    births, origin = [], (each.key, alarm.cycle)
    for one in (*singles, *pairs):
        if one.lead < best - max(_NEAR, 0.05 * best):
            continue
        child = _child(each, one, alarm, priors, params)
        if child is None or (child.key, child.run.onset) in there:
            continue
        births.append(
            Birth(child, alarm.scores[0].likelihood + child.prior + one.lead - 0.5 * alarm.screen.misfit, origin)
        )
    chosen = {id(one) for one in (*singles, *pairs)}
    left = [one.lead + _log_prior(one.cause, priors) for one in found if id(one) not in chosen]
    opened = [one.lead + _log_prior(one.cause, priors) for one in (*singles, *pairs)]
    top = max(opened, default=0.0)
    heard = sum(math.exp(one - top) for one in opened)
    return births, sum(math.exp(min(one - top, 30.0)) for one in left) / heard if heard else 0.0


def _log_prior(cause: Cause, priors: Priors) -> float:
    return math.log(priors.together) * max(len(cause.jets) - 1, 0)


def _child(each: Hypothesis, one: Contender, alarm: Alarm, priors: Priors, params: JointParams) -> Hypothesis | None:
    """The hypothesis that a proposal is, at its onset."""
    screen, cause = alarm.screen, one.cause
    place = 0 if cause.kind == Kind.JUMP else screen.onsets.index(one.onset)
    onset, state, score = screen.onsets[place], alarm.states[place], alarm.scores[place]
    period_s = each.watch.records[-1].link.duration_s if each.watch is not None else 1.0
    seconds = screen.gaps[place] * period_s
    match cause.kind:
        case Kind.JETS:
            prior = log_rate(priors.jet_per_hour, seconds) + math.log(priors.together) * (len(cause.jets) - 1)
        case Kind.JUMP:
            prior = log_rate(priors.payload_per_hour, seconds)
        case _:
            prior = log_rate(priors.reading_per_hour, seconds)
    run = Runner(cause, onset, one.kicks, onset, state, score, cause.kind == Kind.LIES, share=one.share)
    events = (*each.events, (cause, state.time_s))
    return Hypothesis(run, events, each.prior + prior)


def _replayed(tree: Tree, params: JointParams) -> Tree:
    """The tree with its proposals as far as the budget lets them go; those that have arrived are hypotheses."""
    left, waiting, arrived = _BUDGET, [], list(tree.hypotheses)
    for birth in tree.births:
        run = birth.child.run
        if tree.cycle - run.cycle > len(tree.samples):  # too old to be heard any more
            continue
        try:
            while left > 0 and run.cycle < tree.cycle:
                sample, over = tree.samples[run.cycle - tree.cycle]
                run = stepped(run, sample, over, np.zeros(params.places.n_force), params)
                left -= 1
        except (NotPositiveDefiniteError, np.linalg.LinAlgError):
            continue
        child = birth.child._replace(run=run)
        if run.cycle == tree.cycle:
            arrived.append(child)
        elif len(tree.samples) > tree.cycle - run.cycle:
            waiting.append(birth._replace(child=child))
    return tree._replace(hypotheses=tuple(arrived), births=tuple(waiting))


def _pruned(tree: Tree, now_s: float, params: JointParams) -> Tree:
    """The tree without those that are far behind, likeliest first; the same events merged."""
    weights = {id(each): weight(each, params) for each in tree.hypotheses}
    order = sorted(tree.hypotheses, key=lambda each: -weights[id(each)])
    best, kept, by_key = weights[id(order[0])], [], {}
    for each in order:
        mine = weights[id(each)]
        if mine < best - _BEHIND and now_s > each.root_until_s:
            continue
        same = by_key.get(each.key)
        if same is not None and each.watch is None:
            place = kept.index(same)
            more = math.log1p(math.exp(mine - weights[id(same)]))
            joined = same._replace(prior=same.prior + more)
            weights[id(joined)] = weights[id(same)] + more
            kept[place] = by_key[each.key] = joined
            continue
        by_key.setdefault(each.key, each)
        kept.append(each)
    kept = [each for place, each in enumerate(kept) if place < _MOST or now_s <= each.root_until_s]
    births = tuple(birth for birth in tree.births if birth.first_order > best - _BEHIND)
    return tree._replace(hypotheses=tuple(kept), births=births)


def probabilities(tree: Tree, params: JointParams) -> list[tuple[Hypothesis, float]]:
    """Posterior probability of each hypothesis."""
    weights = np.array([weight(each, params) for each in tree.hypotheses])
    shares = np.exp(weights - weights.max())
    return list(zip(tree.hypotheses, (shares / shares.sum()).tolist(), strict=True))
