r"""Delays of commands that one filter cannot hold: the hypotheses again for each part of the possible delays.

What a reading says of a delay is linear only as far as a pulse reaches: with pulses of one sample, within about half a
sample. A filter that begins further off sees no way to go, and grows sure of where it is. So what is known beforehand,

    d ~ (1 - FAR) N(d_0, sigma^2) + FAR (anything within `REACH` samples of d_0),

is a sum of parts a sample apart, each N(d_0 + k T, (T/2)^2), or of the stated sigma where that is less: nearly flat
where they join. The part FAR is for a file that is not right, also where it states a delay as exact, or none. Each part
has all hypotheses about jets, from the first sample on. One whose likelihood falls behind by `BEHIND` is given up; two
become one, by moments, when a filter can hold what both leave open and neither is lost in that. Several kinds of jets
are late together, as by a radio or by a clock that is off.

A failure is named when its part leads every other one, too, since with a delay that is wrong some jet is to blame.
"""

from __future__ import annotations

import numpy as np

from massprop_drake.maths.estimation.pose import pose_hypotheses
from massprop_drake.maths.estimation.pose.pose_cycle import PoseCycled, add_weights, merge_banks
from massprop_drake.maths.estimation.pose.pose_hypotheses import PoseRules, Tried
from massprop_drake.maths.estimation.pose.pose_layout import Commands, Delays, PoseBank, PoseParams, PoseReadings
from massprop_drake.maths.linear_algebra import Array, NotPositiveDefiniteError

FAR = 0.01  # probability that a delay is not as stated
REACH = 5  # samples by which it may be off then
BEHIND = 15.0  # nats
_KEPT = 0.5  # of the wider of two variances, that becoming one must leave


def divide_delays(delays_s: Array, stds_s: Array, period_s: float) -> Delays:
    """Splits the prior of the command delay into Gaussian components a sample apart, with log probabilities.

    Args:
        delays_s, stds_s: as stated, by kind of jet, zero: exact, shape (n_kinds,).
    """
    half = 0.5 * period_s
    single = stds_s.size == 1
    steps = np.arange(-REACH, REACH + 1)
    steps = steps[np.argsort(np.abs(steps), kind="stable")]
    # what was commanded later than a sample from now is not known yet
    steps = steps[(steps == 0) | (delays_s.min() + steps * period_s >= -period_s)]
    weights = np.full(steps.size, FAR / max(steps.size, 1))
    left = float(stds_s.max()) ** 2 - half**2 if single else 0.0
    stated = np.exp(-0.5 * (steps * period_s) ** 2 / left) if left > 0.0 else np.where(steps == 0, 1.0, 0.0)
    weights += (1.0 - FAR) * stated / stated.sum()
    weights /= weights.sum()
    own = np.minimum(stds_s, half) if single else stds_s
    others = np.full(1, half) if single else np.maximum(stds_s, half)
    return Delays(steps * period_s, np.log(weights), np.stack((own, others)), half)


def split_by_delay(bank: PoseBank, params: PoseParams) -> list[PoseBank]:
    """Copies the filter at the first sample for each part of the delay's prior; returns a bank per part."""
    delays, places = params.delays, _delay_indices(params)
    kinds = params.free[places] - params.parts.delay.start
    result = []
    for number, shift in enumerate(delays.shifts_s):
        mean, covariance = bank.mean.copy(), bank.covariance.copy()
        mean[:, params.free[places]] += shift
        covariance[:, places, places] = delays.stds_s[min(number, 1), kinds] ** 2
        result.append(bank._replace(mean=mean, covariance=covariance))
    return result


def _delay_indices(params: PoseParams) -> np.ndarray:
    """Returns the indices, among the free elements, of the commands' delays."""
    part = params.parts.delay
    return np.flatnonzero((params.free >= part.start) & (params.free < part.stop))


def join_delays(parts: list[Tried], params: PoseParams) -> Tried:
    """Joins the hypotheses of all parts of the delay's prior, the likeliest first, others as `elsewhere`.

    Args:
        parts: of each, as at the first sample.
    """
    chances = params.delays.chances.tolist()
    return _order_parts([part._replace(total=chance) for part, chance in zip(parts, chances, strict=True)])


def advance_over_delays(
    hypotheses: Tried, commands: Commands, span_s: tuple[float, float], readings: PoseReadings, params: PoseParams
) -> tuple[Tried, PoseCycled]:
    """Advances the hypotheses of every delay by a sample; returns them, and the filter step of the likeliest delay.

    Args:
        hypotheses: after the last sample.
        commands, span_s, readings, params: see `pose_cycle.step`.

    Raises:
        NotPositiveDefiniteError: see `pose_cycle.step`; of the likeliest where none is left.
    """
    parts, done, trouble = [], [], None
    for part in (hypotheses._replace(elsewhere=()), *hypotheses.elsewhere):
        try:
            after, cycled = pose_hypotheses.advance_hypotheses(part, commands, span_s, readings, params)
        except NotPositiveDefiniteError as error:
            trouble = trouble or error
            continue
        parts.append(after)
        done.append(cycled)
    if trouble is not None and not parts:
        raise trouble
    if len(parts) == 1:
        return parts[0], done[0]
    likeliest = int(np.argmax([log_weight(part) for part in parts]))
    return _order_parts(_merge_close_parts(parts, params)), done[likeliest]


def name_failure_over_delays(
    hypotheses: Tried, time_s: float, rules: PoseRules, params: PoseParams
) -> tuple[Tried, pose_hypotheses.PoseOutcome | None]:
    """Decides on a failure after a sample; returns the hypotheses, and the failure or None."""
    others = tuple(pose_hypotheses.renew_hypotheses(part, time_s, params) for part in hypotheses.elsewhere)
    alone = hypotheses._replace(elsewhere=())
    after, found = pose_hypotheses.name_failure(
        alone, time_s, rules, params, is_waiting=not is_delay_settled(hypotheses, rules.lead)
    )
    if found is not None and len(found.members) == 1:
        return after, found  # the other delays are given up with what was not named
    return after._replace(elsewhere=others), found


def is_delay_settled(hypotheses: Tried, margin: float) -> bool:
    """Tests whether the likeliest delay's log weight exceeds every other one's by a margin, nats."""
    best = log_weight(hypotheses)
    return all(best - log_weight(part) > margin for part in hypotheses.elsewhere)


def merge_delays(hypotheses: Tried, params: PoseParams) -> PoseBank:
    """Merges the no-failure filters of all delays by moment matching to a bank of one, for the report."""
    first, total = hypotheses.bank.select(slice(1)), log_weight(hypotheses)
    for part in hypotheses.elsewhere:
        own = log_weight(part)
        both = float(np.logaddexp(total, own))
        share = np.array([np.exp(own - both)])
        first, total = merge_banks(first, part.bank.select(slice(1)), share, params), both
    return first


def log_weight(hypotheses: Tried) -> float:
    """Computes the log of the summed probability of all hypotheses of one delay, up to a common constant, nats."""
    return hypotheses.total + float(np.logaddexp.reduce(hypotheses.likelihood))


def _order_parts(parts: list[Tried]) -> Tried:
    """Orders delays by weight, dropping unlikely ones; returns the first, the others in its `elsewhere`."""
    weights = np.array([log_weight(part) for part in parts])
    order = np.argsort(-weights, kind="stable")
    kept = [parts[place] for place in order if weights[order[0]] - weights[place] < BEHIND]
    return kept[0]._replace(elsewhere=tuple(kept[1:]))


def _merge_close_parts(parts: list[Tried], params: PoseParams) -> list[Tried]:
    """Merges pairs of delays that one filter can hold; returns the hypotheses of each delay left."""
    if any(part.doubt is not None for part in parts):
        return parts
    result: list[Tried] = []
    for part in parts:
        same = [place for place, other in enumerate(result) if _can_merge(part, other, params)]
        if same:
            result[same[0]] = _merge_pair(result[same[0]], part, params)
        else:
            result.append(part)
    return result


def _can_merge(first: Tried, second: Tried, params: PoseParams) -> bool:
    """Tests whether one filter can hold both delays, as if equally likely, without losing either.

    A filter that is sure of its delay does not become one with a wide one that is much less likely: together they would
    be nearly as sure, and the way to what the wide one leaves open would be lost.
    """
    places = _delay_indices(params)
    if not np.array_equal(first.known, second.known):
        return False
    apart = (first.bank.mean[0] - second.bank.mean[0])[params.free[places]]
    own = [each.bank.covariance[0][places, places] for each in (first, second)]
    wider = np.maximum(*own)
    share = float(np.exp(log_weight(second) - np.logaddexp(log_weight(first), log_weight(second))))
    both = (1.0 - share) * own[0] + share * own[1] + share * (1.0 - share) * apart**2
    holds = (wider + 0.25 * apart**2 <= params.delays.reach_s**2) & (both >= _KEPT * wider)
    return bool(holds.all())


def _merge_pair(first: Tried, second: Tried, params: PoseParams) -> Tried:
    """Merges the hypotheses of two delays one by one by moments; the likelier delay's counters stay."""
    total, share = add_weights(first.total + first.likelihood, second.total + second.likelihood)
    likelier = first if log_weight(first) >= log_weight(second) else second
    return likelier._replace(
        bank=merge_banks(first.bank, second.bank, share, params),
        likelihood=total - total[0],
        onset_s=np.where(share > 0.5, second.onset_s, first.onset_s),
        total=float(total[0]),
    )
