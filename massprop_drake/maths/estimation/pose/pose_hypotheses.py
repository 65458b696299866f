r"""Hypotheses about jets, each a filter of the bank: nothing has failed; a jet is weak; one stands open; a push.

A weak jet's factor is g_j = phi g, g the mean of the healthy ones, phi ~ N(.5, .3^2): anything from nothing to all. A
jet that stands open is so by h ~ N(.5, .3^2). A jet may have failed before the record begins, with probability
`BEFORE`, or at any time since: every `RENEWAL_S` each hypothesis takes in what the first of them has become, with its
jet failing now, in proportion to likelihood and to the chance of a failure in that time; where both weigh anything
they are merged by their moments. So the number of filters does not grow, and none is late by more than that.

*A push.* What else happens to a vehicle must be among the hypotheses, or some jet is blamed for it: from some time on
it is pushed and turned by anything up to what a jet can do, N(0, (a/2)^2) on each axis. Beforehand that is as probable
as all failures together. It is said as something unexplained.

*Apart.* A weak jet and the open one against it foretell the same for as long as the weak one is told to fire; their
likelihoods then differ by what was probable beforehand, and by how noisy each is taken to be. So a lead counts only
over a hypothesis that has foretold something else, by sigmas whose squares sum up to twice the lead that is asked.

A failure is named when its likelihood leads the next one and that of no failure by enough (`PoseRules`), and it is of a
size: a loss, or an opening, above a tenth of the thrust and above three sigma, of what its own filter now knows and,
of a loss, of what healthy jets differ by. Odds that were won while little was known are not given back, and odds alone
would name healthy jets whose factor is a few percent off, for which a wide hypothesis is as good as a narrow one. The
named hypothesis is then the first, and all begin anew from it. It must have been so for `STEADY` samples: one that is
poor is soon over. What nothing tells apart is named as a group once it has led for `PATIENCE_S`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from massprop_drake.maths.estimation.pose.pose_cycle import Doubt, PoseCycled, add_weights, merge_banks, step
from massprop_drake.maths.estimation.pose.pose_layout import PUSHED, Commands, PoseBank, PoseParams, PoseReadings
from massprop_drake.maths.linear_algebra import Array, cross_products, symmetrized_stack
from massprop_drake.maths.mass_properties import ELEMENT

BEFORE = 0.01  # probability of a failure of each kind of each jet before the record begins
AGAIN_S = 1900.0  # seconds in which a jet fails as probably as it has before
RENEWAL_S = 1.0
PATIENCE_S = 10.0
SETTLING_S = 3.0  # from the first sample on, in which a poor reading must stand out from good and poor alike
STEADY = 10  # samples
_SIGMAS = 3.0  # that a size must have
_MIDDLE, _SPREAD = 0.5, 0.3  # of a factor of which nothing is known
_NEVER = -np.inf


class Tried(NamedTuple):
    """Bank of hypotheses after a sample.

    Attributes:
        bank: nothing has failed but what is known; then each jet weak; then each jet open; then a push.
        likelihood: of each, with what was probable beforehand, nats, shape (2 + 2 n_jets,).
        onset_s: since when each holds, shape (2 + 2 n_jets,).
        known: hypotheses that are taken for true, 0 or 1, shape (1 + 2 n_jets,).
        renewed_s: when hypotheses were renewed last.
        led_s: since when one or several lead that of no failure; NaN: none does.
        leader: hypothesis that was to be named by the last sample, as an index of `known`; -1: none was.
        steady: samples in a row by which it was.
        doubt: see `pose_cycle.Doubt`.
        apart: how far what two have foretold is apart, sum of squares in sigmas, shape (2 + 2 n_jets, 2 + 2 n_jets);
            None: nothing has been foretold.
        total: logarithm of the density of all readings if nothing has failed, and of what was probable beforehand;
            likelihoods are over it, nats.
        elsewhere: the same with other delays of the commands, see `delays`.
    """

    bank: PoseBank
    likelihood: Array
    onset_s: Array
    known: Array
    renewed_s: float
    led_s: float
    leader: int = -1
    steady: int = 0
    doubt: Doubt | None = None
    apart: Array | None = None
    total: float = 0.0
    elsewhere: tuple[Tried, ...] = ()


class PoseRules(NamedTuple):
    """Thresholds at which a failure is named.

    Attributes:
        lead, lead_nothing: over every other hypothesis, and over that of no failure, nats.
        least: loss or opening, of the thrust.
    """

    lead: float = 6.0
    lead_nothing: float = 12.0
    least: float = 0.1


class PoseOutcome(NamedTuple):
    """Failure named after a sample.

    Attributes:
        members: hypotheses that may be it, the likeliest first, as indices of `Tried.known`.
        onset_s: when it began.
        lead: over the next, and over that of no failure, nats.
        share: what is lost of the thrust, or how far the jet stands open, and its 1-sigma.
    """

    members: tuple[int, ...]
    onset_s: float
    lead: tuple[float, float]
    share: tuple[float, float]


def begin_hypotheses(
    bank: PoseBank, time_s: float, params: PoseParams, known_failures: Array | None = None, chance: float = BEFORE
) -> Tried:
    """Branches a filter into hypotheses: no new failure, each jet weak, each jet stuck open, an unexplained push.

    Args:
        bank: of one filter.
        time_s: now.
        known_failures: see `Tried`; None: nothing is.
        chance: probability of a failure of each kind of each jet.
    """
    known_failures = np.zeros(1 + 2 * params.pushes.shape[0]) if known_failures is None else known_failures
    every = _stack_banks(bank, branch_failures(bank, known_failures, params))
    onset, likelihood = np.full(1 + known_failures.size, time_s), np.append(0.0, np.log(chance) + _log_priors(params))
    fresh = Tried(every, likelihood, onset, known_failures, time_s, np.nan)
    return fresh._replace(likelihood=np.append(0.0, _possible_odds(fresh)))


def make_single_filter(bank: PoseBank, known_failures: Array, time_s: float) -> Tried:
    """Wraps a bank of one filter as hypotheses without any further failure, from a time on.

    Args:
        bank: of one filter.
        known_failures: see `Tried`.
        time_s: now.
    """
    return Tried(bank, np.zeros(1), np.full(1, time_s), known_failures, time_s, np.nan)


def _log_priors(params: PoseParams) -> Array:
    """Computes each hypothesis's log prior relative to a failure of one jet, nats, shape (1 + 2 n_jets,)."""
    jets = params.pushes.shape[0]
    result = np.zeros(1 + 2 * jets)
    result[-1] = np.log(2.0 * jets)
    return result


def branch_failures(bank: PoseBank, known_failures: Array, params: PoseParams) -> PoseBank:
    """Copies a bank's first filter per failure, with that failure beginning now: a bank of 1 + 2 n_jets."""
    jets, parts, free = params.pushes.shape[0], params.parts, params.free
    count = 1 + 2 * jets
    mean = np.repeat(bank.mean[:1], count, axis=0)
    through = np.repeat(np.eye(free.size)[None], count, axis=0)
    added = np.zeros((count, free.size))
    place = {int(element): index for index, element in enumerate(free)}
    good = known_failures[:jets] == 0.0
    opens = np.full(count, bank.opens[0])
    for jet in range(jets):
        others = np.flatnonzero(good & (np.arange(jets) != jet))
        typical = float(np.mean(bank.mean[0, others])) if others.size else 1.0
        mean[jet, jet] = _MIDDLE * typical
        row = place.get(jet)
        if row is not None:
            through[jet, row] = 0.0
            for other in others:
                if other in place:
                    through[jet, row, place[int(other)]] = _MIDDLE / others.size
            added[jet, row] = (_SPREAD * typical) ** 2
        if bank.opens[0] < 0:
            opened = jets + jet
            opens[opened] = jet
            mean[opened, parts.open] = _MIDDLE
            added[opened, place[parts.open.start]] = _SPREAD**2
    if bank.opens[0] < 0:
        opens[-1] = PUSHED
    for axis, size in enumerate(_largest_accelerations(params)):
        row = place.get(parts.push.start + axis)
        if row is not None:
            added[-1, row] = (_MIDDLE * size) ** 2
    covariance = through @ bank.covariance[:1] @ np.swapaxes(through, 1, 2)
    covariance = symmetrized_stack(covariance) + added[:, :, None] * np.eye(free.size)
    same = [np.repeat(part[:1], count, axis=0) for part in (bank.rotation, bank.reference, bank.turned)]
    return PoseBank(mean, covariance, same[0], opens, same[1], same[2])


def _largest_accelerations(params: PoseParams) -> Array:
    """Computes the largest linear, then angular acceleration of a jet, per axis, nominal vehicle, shape (6,)."""
    spin = params.start[params.parts.spin][ELEMENT]
    moments = cross_products(params.positions - params.start[params.parts.center], params.pushes)
    turns = np.linalg.norm(moments @ spin, axis=1)
    return np.repeat((np.linalg.norm(params.pushes, axis=1).max(), turns.max()), 3)


def _stack_banks(first: PoseBank, rest: PoseBank) -> PoseBank:
    """Joins the first filter of one bank and all filters of another into one bank."""
    return PoseBank(*(np.concatenate((one[:1], many)) for one, many in zip(first, rest, strict=True)))


def renew_hypotheses(hypotheses: Tried, time_s: float, params: PoseParams) -> Tried:
    """Merges into each hypothesis, once a second, the no-failure filter with that failure beginning now."""
    if hypotheses.doubt is not None or time_s - hypotheses.renewed_s < RENEWAL_S:
        return hypotheses
    chance = np.log(BEFORE * (time_s - hypotheses.renewed_s) / AGAIN_S) + _log_priors(params)
    before = hypotheses.likelihood[1:]
    total, share = add_weights(before, hypotheses.likelihood[0] + chance)
    share = np.where(np.isneginf(before) & (hypotheses.known > 0.0), 0.0, share)
    failing = branch_failures(hypotheses.bank, hypotheses.known, params)
    both = merge_banks(hypotheses.bank.select(slice(1, None)), failing, share, params)
    likelihood = np.append(hypotheses.likelihood[:1], np.where(_select_possible(hypotheses), total, _NEVER))
    apart = hypotheses.apart
    if apart is not None:  # what fails now foretells as the first has
        old = np.concatenate(([1.0], 1.0 - share))
        apart = old[:, None] * apart + (1.0 - old)[:, None] * apart[0]
        apart = old * apart + (1.0 - old) * apart[:, :1]
    onset = np.concatenate((hypotheses.onset_s[:1], np.where(share > 0.5, time_s, hypotheses.onset_s[1:])))
    bank = _stack_banks(hypotheses.bank, both)
    return hypotheses._replace(bank=bank, likelihood=likelihood, onset_s=onset, renewed_s=time_s, apart=apart)


def _select_possible(hypotheses: Tried) -> np.ndarray:
    """Flags hypotheses that may yet become true: not known, no second open jet, shape (1 + 2 n_jets,)."""
    jets = hypotheses.known.size // 2
    possible = hypotheses.known == 0.0
    if hypotheses.bank.opens[0] >= 0:
        possible[jets : 2 * jets] = False
    return possible


def _possible_odds(hypotheses: Tried) -> Array:
    """Returns failures' log-odds over no failure, -inf where impossible, nats, shape (1 + 2 n_jets,)."""
    return np.where(_select_possible(hypotheses), hypotheses.likelihood[1:], _NEVER)


def advance_hypotheses(
    hypotheses: Tried, commands: Commands, span_s: tuple[float, float], readings: PoseReadings, params: PoseParams
) -> tuple[Tried, PoseCycled]:
    """Advances all hypotheses by a sample: filters, log weights, and how far predictions differ.

    Args:
        hypotheses: after the last sample.
        commands, span_s, readings, params: see `pose_cycle.step`.
    """
    if span_s[1] - hypotheses.onset_s[0] < SETTLING_S:
        params = params._replace(pose=params.pose._replace(tells=params.pose.outlier_scale))
    done = step(hypotheses.bank, commands, span_s, readings, params, hypotheses.doubt)
    likelihood = hypotheses.likelihood + done.likelihood
    first = float(likelihood[0])
    after = hypotheses._replace(
        bank=done.bank, likelihood=likelihood - first, doubt=done.doubt, total=hypotheses.total + first
    )
    if done.whitened is None:
        return after, done
    products = done.whitened @ done.whitened.T
    squares = products.diagonal()
    more = np.maximum(squares[:, None] + squares - 2.0 * products, 0.0)
    return after._replace(apart=more if hypotheses.apart is None else hypotheses.apart + more), done


def name_failure(
    hypotheses: Tried, time_s: float, rules: PoseRules, params: PoseParams, *, is_waiting: bool = False
) -> tuple[Tried, PoseOutcome | None]:
    """Decides whether to declare a failure; returns the hypotheses, restarted if only one is left, and it or None.

    Args:
        hypotheses: after the sample.
        time_s: of it.
        is_waiting: whether nothing is to be named yet.
    """
    if hypotheses.doubt is not None:  # the next sample decides first
        return hypotheses, None
    hypotheses = renew_hypotheses(hypotheses, time_s, params)
    if is_waiting:
        return hypotheses._replace(leader=-1, steady=0), None
    outcome, hypotheses = _decide_failure(hypotheses, time_s, rules, params)
    if outcome is not None and len(outcome.members) == 1:  # all begin again from it
        bank, known_failures = _accept_failure(hypotheses, outcome.members[0])
        hypotheses = begin_hypotheses(bank, time_s, params, known_failures, BEFORE * RENEWAL_S / AGAIN_S)
    return hypotheses, outcome


def failure_sizes(hypotheses: Tried, params: PoseParams) -> tuple[Array, Array]:
    """Computes each failure's loss or opening, share of thrust, and 1-sigma, shape (1 + 2 n_jets,) each.

    That of a loss counts by how much healthy jets differ. A push has none, and is always large enough.
    """
    jets, parts = params.pushes.shape[0], params.parts
    place = {int(element): index for index, element in enumerate(params.free)}
    good = hypotheses.known[:jets] == 0.0
    size, deviation = np.zeros(1 + 2 * jets), np.full(1 + 2 * jets, np.inf)
    size[-1], deviation[-1] = np.inf, 0.0
    for jet in range(jets):
        row, others = place.get(jet), np.flatnonzero(good & (np.arange(jets) != jet))
        if row is not None:
            mean, covariance = hypotheses.bank.mean[1 + jet], hypotheses.bank.covariance[1 + jet]
            typical = float(np.median(mean[others])) if others.size else 1.0
            weights = np.zeros(params.free.size)
            weights[row] = 1.0
            for other in others:
                if other in place:
                    weights[place[int(other)]] -= mean[jet] / typical / others.size
            size[jet] = 1.0 - mean[jet] / typical
            healthy = (1.0 + 1.0 / max(others.size, 1)) * params.thrust_std[jet] ** 2
            deviation[jet] = np.sqrt(weights @ covariance @ weights / typical**2 + healthy)
        opening = place.get(parts.open.start)
        if opening is not None:
            size[jets + jet] = hypotheses.bank.mean[1 + jets + jet, parts.open.start]
            deviation[jets + jet] = np.sqrt(hypotheses.bank.covariance[1 + jets + jet, opening, opening])
    return size, deviation


def leading_hypothesis(hypotheses: Tried, rules: PoseRules) -> Tried | None:
    """Returns the likeliest failure's filter as sole hypothesis; None unless its log-odds suffice.

    What it has learned is right, or less wrong, even while nothing tells which one of several it is.
    """
    odds = _possible_odds(hypotheses)
    leader = int(np.argmax(odds))
    if not odds[leader] > rules.lead_nothing:
        return None
    return make_single_filter(*_accept_failure(hypotheses, leader), hypotheses.renewed_s)


def _accept_failure(hypotheses: Tried, index: int) -> tuple[PoseBank, Array]:
    """Returns the filter of one failure (a bank of one), and the flags of known failures including it."""
    known = hypotheses.known.copy()
    known[index] = float(index < known.size - 1)  # a push may come again
    return hypotheses.bank.select(slice(1 + index, 2 + index)), known


def _decide_failure(
    hypotheses: Tried, time_s: float, rules: PoseRules, params: PoseParams
) -> tuple[PoseOutcome | None, Tried]:
    """Returns the failure to declare, or None, and the hypotheses with leader and counters updated."""
    odds = _possible_odds(hypotheses)
    leader = int(np.argmax(odds))
    best = float(odds[leader])
    if best <= rules.lead_nothing:
        return None, hypotheses._replace(led_s=np.nan, leader=-1, steady=0)
    size, deviation = failure_sizes(hypotheses, params)
    if np.isnan(hypotheses.led_s):
        hypotheses = hypotheses._replace(led_s=time_s)
    leads = best - odds
    behind = leads > rules.lead
    if hypotheses.apart is not None:
        behind &= hypotheses.apart[1 + leader, 1:] > 2.0 * rules.lead
    behind[leader] = False
    group = sorted(np.flatnonzero(~behind & np.isfinite(odds)).tolist(), key=lambda each: -odds[each])
    large = size[leader] > max(rules.least, _SIGMAS * deviation[leader])
    if not large or (len(group) > 1 and time_s - hypotheses.led_s < PATIENCE_S):
        return None, hypotheses._replace(leader=-1, steady=0)
    hypotheses = hypotheses._replace(leader=leader, steady=hypotheses.steady + 1 if hypotheses.leader == leader else 1)
    if hypotheses.steady < STEADY:
        return None, hypotheses
    after = float(leads[behind].min()) if behind.any() else np.inf
    share = float(size[leader]), float(deviation[leader])
    return PoseOutcome(tuple(group), float(hypotheses.onset_s[1 + leader]), (after, best), share), hypotheses
