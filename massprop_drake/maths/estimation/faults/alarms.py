"""Alarms: a watched hypothesis does not explain its newest readings, by the test of its bank of onsets."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from massprop_drake.maths.estimation.faults.fault_events import Event, Hypothesis, record_cycle
from massprop_drake.maths.estimation.joint import bank as banks
from massprop_drake.maths.estimation.joint import screen as screens
from massprop_drake.maths.estimation.joint.bank import Bank, Since
from massprop_drake.maths.estimation.joint.guard import knows_rotation
from massprop_drake.maths.estimation.joint.hypotheses import Score, cycle_score
from massprop_drake.maths.estimation.joint.joint_cycle import JointEvidence
from massprop_drake.maths.estimation.joint.joint_sample import JointSample
from massprop_drake.maths.estimation.joint.layout import JointParams, JointState
from massprop_drake.maths.estimation.joint.screen import Screen
from massprop_drake.maths.estimation.joint.sensitivity import Link, Traces, collect_cycle_terms
from massprop_drake.maths.estimation.joint.unknown import is_untestable
from massprop_drake.maths.linear_algebra import Array

_SHARE = 0.7  # of the largest statistic: older onsets explain the end point as well
_FEWEST = 2  # onsets of a bank
# Log weights of all hypotheses over that of the likeliest, by their events: of one that is no more, minus infinity.
Leads = Mapping[tuple[Event, ...], float]


class WatchedCycle(NamedTuple):
    """Cycle of a watched hypothesis, and its score after it."""

    sample: JointSample
    link: Link
    score: Score


class Rest(NamedTuple):
    """Sum of the proposals that are not followed.

    Attributes:
        ahead: log weight to first order over that of the hypothesis that it is compared with, nats.
        than: events of that hypothesis; None: the likeliest when it was drawn.
    """

    ahead: float
    than: tuple[Event, ...] | None

    def log_weight(self, log_weights: Leads) -> float:
        """Returns the first-order log weight of the proposals left out, relative to the likeliest hypothesis, nats."""
        return self.ahead if self.than is None else self.ahead + log_weights.get(self.than, -math.inf)


UNTOLD = Rest(0.0, None)  # of a draw whose first orders tell nothing any more: anything may be left


class Alarm(NamedTuple):
    """Alarm: a hypothesis does not explain its newest readings.

    Attributes:
        cycle: of the first alarm.
        states: where the screen begins, and at each of its onsets.
        scores: at each of its onsets.
        read: readings at the first onset, shape (m,).
        drawn: age of the newest draw.
        rest: of that draw; None: nothing is left.
    """

    cycle: int
    states: tuple[JointState, ...]
    scores: tuple[Score, ...]
    screen: Screen
    read: Array
    drawn: int = -1
    rest: Rest | None = None


class Watch(NamedTuple):
    """Bank of onsets of a hypothesis, its cycles since the oldest, and its alarm.

    Attributes:
        alarm: None: its readings are explained.
        tested: whether the newest readings were tested.
        statistic: largest GLR of a jet in them.
    """

    bank: Bank
    records: tuple[WatchedCycle, ...]
    alarm: Alarm | None = None
    tested: bool = False
    statistic: float = 0.0


def advance_watch(
    hypothesis: Hypothesis, evidence: JointEvidence, cycle: int, params: JointParams, *, likely: bool
) -> Hypothesis:
    """Tests a hypothesis for new faults with a plain filter cycle's readings; returns it with its alarm updated.

    Args:
        likely: whether its readings were explained before the cycle, so that something new may happen to it; else its
            alarm is of what has happened, and what moves its state since is no onset.
    """
    run, sample = hypothesis.run, evidence.sample
    score = run.score.plus(cycle_score(evidence.report))
    done = run._replace(cycle=cycle, state=evidence.after, score=score)
    if not _is_testable(evidence, params) or hypothesis.push > 0.0:
        return record_cycle(hypothesis, done, params)._replace(watch=None)
    watch = hypothesis.watch or Watch(banks.empty_bank(params.places), ())
    course = evidence.report.course
    assert course is not None, "the first sample is no cycle"
    seen = collect_cycle_terms(evidence.before.mean, course, sample)
    seen = _add_walk_noise(seen, evidence.before, np.minimum(hypothesis.walks * seen.duration_s, 1.0), params)
    interval, found, tested, bank = banks.advance_bank(watch.bank, seen, evidence.after, cycle, banks.ALARM, params)
    record, statistic = WatchedCycle(sample, interval, score), 0.0
    records = (*watch.records, record)
    alarm = watch.alarm
    if found is not None:
        statistic = float(found.likelihood.max())
    if alarm is not None:
        alarm = alarm._replace(screen=screens.advance_screen(alarm.screen, interval, params))
    if found is not None and banks.is_alarming(statistic, float(found.total.max())):
        index = int(np.flatnonzero(found.total >= _SHARE * found.total.max())[-1])  # older ones explain as much
        if alarm is None or (likely and watch.bank.since.cycles[index] > alarm.cycle):  # something new
            alarm = _make_alarm(watch.bank, records, index, cycle, params)
    oldest = int(bank.since.cycles[0])
    if alarm is not None:
        oldest = min(oldest, alarm.screen.began)
    tested = tested and not is_untestable(course.acting.firing, course.acting.anything)
    watch = Watch(bank, records[-(cycle - oldest + 1) :], alarm, tested, statistic)
    return record_cycle(hypothesis, done, params)._replace(watch=watch)


def _is_testable(evidence: JointEvidence, params: JointParams) -> bool:
    """Tests whether the filter has converged, in all or in rotation, so that its innovations can be tested."""
    after, report = evidence.after, evidence.report
    assert report.course is not None, "the first sample is no cycle"
    acting = report.course.acting.firing.amount > 0.0
    return after.guarded or (report.rotation_known and knows_rotation(after, params, acting))


def likelihood_loss(hypothesis: Hypothesis) -> float:
    """Computes the newest sample's half excess NIS minus its mean over earlier samples, nats; 0 with too few."""
    records = hypothesis.watch.records if hypothesis.watch is not None else ()
    if len(records) < _FEWEST + 1:
        return 0.0
    first, last, newest = (records[place].score.excess for place in (0, -2, -1))
    usual = (last - first) / (len(records) - 2)
    return newest - last - usual


def raise_alarm(hypothesis: Hypothesis, cycle: int, params: JointParams) -> Hypothesis:
    """Adds an alarm at the last onset but one to a hypothesis that is watched and has none; else changes nothing."""
    watch = hypothesis.watch
    if watch is None or hypothesis.alarm is not None or len(watch.bank.states) < _FEWEST:
        return hypothesis
    bank = Bank(watch.bank.states[:-1], Since(*(part[:-1] for part in watch.bank.since)))
    alarm = _make_alarm(bank, watch.records, len(bank.states) - 1, cycle, params)
    return hypothesis._replace(watch=watch._replace(alarm=alarm))


def _add_walk_noise(traces: Traces, state: JointState, walk_sigmas: Array, params: JointParams) -> Traces:
    """Returns the linearized interval with the variance of randomly walking jet forces added to its noise."""
    noise = traces.noise
    for slot in np.flatnonzero(walk_sigmas):
        column = params.places.force + int(slot)
        effect = np.concatenate((traces.rate_rows[:, column], traces.velocity_rows[:, column]))
        may_change = walk_sigmas[slot] * params.thrusts[int(state.slot_jet[slot])]
        noise = noise + may_change**2 * np.outer(effect, effect)
    return traces._replace(noise=noise)


def _make_alarm(
    bank: Bank, records: tuple[WatchedCycle, ...], onset_index: int, cycle: int, params: JointParams
) -> Alarm:
    """Makes an alarm with its first-order fault test, run from two onsets before the likeliest to the newest sample."""
    first, chosen = max(onset_index - 2, 0), range(max(onset_index - 2, 0), min(onset_index + 2, len(bank.states)))
    cycles = bank.since.cycles.astype(np.intp)
    onsets = tuple(int(cycles[k]) for k in chosen)
    gaps = tuple(int(cycles[k] - cycles[k - 1]) if k > 0 else 1 for k in chosen)
    began = int(cycles[first])
    read = records[began - cycle - 1].link.read
    screen = screens.begin_screen((bank.states[first], began), onsets, gaps, read, params)
    for record in records[len(records) - (cycle - began) :]:
        screen = screens.advance_screen(screen, record.link, params)
    scores = tuple(records[onset - cycle - 1].score for onset in onsets)
    return Alarm(cycle, tuple(bank.states[k] for k in chosen), scores, screen, read)
