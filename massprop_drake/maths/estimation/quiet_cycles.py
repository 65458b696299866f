"""Cycles in which nothing happens, taken by the kernel of `whole_joint` between those of `cycle.step`."""

from __future__ import annotations

from collections import deque
from contextlib import suppress

import numpy as np

from massprop_drake.maths.estimation.cycle import EstimationParams, EstimationState
from massprop_drake.maths.estimation.detector import STATUS
from massprop_drake.maths.estimation.faults import hypothesis_filter as faults
from massprop_drake.maths.estimation.faults.alarms import Watch, WatchedCycle
from massprop_drake.maths.estimation.faults.fault_report import HYPOTHESIS_REPORT, hypothesis_report_row, no_fault_odds
from massprop_drake.maths.estimation.faults.tree import Tree
from massprop_drake.maths.estimation.filters import joint
from massprop_drake.maths.estimation.filters.joint import JointFilterParams, JointFilterState
from massprop_drake.maths.estimation.joint import start as starts
from massprop_drake.maths.estimation.joint.bank import OLDEST, ONSETS, Bank
from massprop_drake.maths.estimation.joint.hypotheses import NO_SCORE, Score
from massprop_drake.maths.estimation.joint.joint_sample import JointSample
from massprop_drake.maths.estimation.joint.layout import pack, unpack
from massprop_drake.maths.estimation.joint.sensitivity import Link
from massprop_drake.maths.estimation.joint.ticks import timing_on_ticks
from massprop_drake.maths.estimation.joint.wheels import interval_wheel_speeds
from massprop_drake.maths.estimation.joint_desk import (
    Besides,
    JointDesk,
    JointMemory,
    JointRows,
    Rules,
    empty_past,
    link_layout,
    make_extra_readings,
)
from massprop_drake.maths.estimation.whole import Samples
from massprop_drake.maths.estimation.whole_joint import Work
from massprop_drake.maths.kernels import fill, make_holder, make_shared_holder, read_holder
from massprop_drake.maths.linear_algebra import Array, NotPositiveDefiniteError
from massprop_drake.maths.vehicle.on_times import split_sample


class Quiet:
    """Cycles in which nothing happens, between those that are left to `cycle.step`.

    Args:
        params: of the cycle, see `covers`.
        compiled: whether the kernel is.

    Attributes:
        on: whether the last cycle was such that one of these may follow.
    """

    def __init__(self, params: EstimationParams, *, compiled: bool):
        joint = params.filter_params.joint
        self.on = False
        self._work: Work = joint.compiled
        self._places, self._wheels, self._compiled = joint.places, joint.wheels, compiled
        self._links = OLDEST * joint.rates.steps + 2  # that are kept: the oldest onset's, and those since
        self._past, self._reached = empty_past(joint.places, self._links), np.zeros(2, dtype=np.int_)
        jets = joint.places.jets
        self._rules = Rules(
            params.period_s,
            np.ascontiguousarray(params.impulse_per_level),
            params.lag,
            np.zeros(STATUS.size + 4 * jets),
            HYPOTHESIS_REPORT.sized(jets=jets).pack(hypothesis_report_row((), no_fault_odds(jets))),
        )
        self._cycles: deque[JointSample | tuple[Samples, Besides, int]] = deque(
            maxlen=self._links
        )  # by row or as it was

    def begin(
        self, samples: Samples, stamps_s: Array, tracked: tuple[Array | None, Array | None], rows: JointRows
    ) -> None:
        """Sets samples, with tracked readings and onsets, that compiled cycles take, and log rows that they fill in."""
        self._samples, self._besides = samples, make_extra_readings(samples.time_s.size, self._places, *tracked)
        desk = JointDesk(samples, stamps_s, self._besides, rows, self._reached, self._past, self._rules)
        self._desk = make_shared_holder(desk, self._compiled)

    def take_up(self, state: EstimationState) -> None:
        """Starts compiled cycles from a state; turns them off if it is initializing or has a fault event or alarm."""
        filtered, detector = state.filter, state.detector
        self.on = _is_quiet(filtered, detector.tree) and not detector.search.contradicted
        if not self.on:
            return
        tree: Tree = detector.tree
        watch: Watch = tree.leader.watch
        self._before, bank, records = state, watch.bank, watch.records[-self._links :]
        for place, each in enumerate(bank.states):
            self._past.states[place], self._past.roots[place] = pack(each, self._places), each.root
        self._past.places[:] = np.arange(ONSETS)
        layout = link_layout(self._places)
        self._cycles.clear()
        for number, record in enumerate(records, start=tree.cycle - len(records) + 1):
            self._past.links[number % self._links] = layout.pack(record.link)
            self._past.excess[number % self._links] = 0.5 * (record.link.nis - record.link.degrees)
            self._cycles.append(record.sample)
        fill(self._rules.detector_row, faults.quiet_log_rows(detector))
        memory = JointMemory(
            filtered.joint,
            filtered.clock,
            filtered.estimate,
            filtered.covariance,
            bank.since,
            state.command,
            state.level,
            float(tree.cycle),
            filtered.frame,
            filtered.speeds,
        )
        self._memory = make_holder(memory, self._compiled)

    def advance(self, row: int, end_row: int) -> int:
        """Runs compiled cycles from a row to the first alarm or event, or to `end_row`; returns the row reached."""
        self._reached[:] = row, end_row
        with suppress(NotPositiveDefiniteError, np.linalg.LinAlgError):  # the parts will say what it is
            self._work.run_quiet_cycles(self._memory, self._desk)
        reached = int(self._reached[0])
        self._cycles.extend((self._samples, self._besides, done) for done in range(row, reached))
        self.on = reached == end_row
        return reached

    def state(self) -> EstimationState:
        """Makes the estimation's state after the last compiled cycle, with which the next begins."""
        memory: JointMemory = read_holder(self._memory)
        since, places, cycle = memory.since, self._past.places.tolist(), int(memory.cycle)
        states = self._past.states.copy()
        onsets = tuple(unpack(states[places[index]], self._places) for index in range(since.cycles.size))
        before = self._before.detector
        records = self._records(cycle)
        leader = before.tree.leader
        run = leader.run._replace(state=memory.joint, cycle=cycle, score=records[-1].score)
        of_bank = records[-(cycle - int(since.cycles[0]) + 1) :]
        trail = tuple(record.score.likelihood for record in records)
        watch = Watch(Bank(onsets, since), of_bank)
        leader = leader._replace(run=run, weight=run.score.likelihood, trail=trail, watch=watch)
        tree = Tree(cycle, (leader,), samples=tuple((record.sample, record.link) for record in records))
        filtered = JointFilterState(memory.joint, memory.clock, memory.estimate, memory.covariance, starts.OVER)
        filtered = filtered._replace(frame=memory.frame, speeds=memory.speeds)
        return EstimationState(memory.command, memory.level, filtered, before._replace(tree=tree))

    def _records(self, cycle: int) -> tuple[WatchedCycle, ...]:
        """Rebuilds the last cycles with sample, linearization and score, scores counted from the first of them."""
        layout, links, score = link_layout(self._places), self._past.links.copy(), NO_SCORE
        seen, found = list(self._cycles), []
        for number, each in enumerate(seen, start=cycle - len(seen) + 1):
            link = Link(*layout.read(links[number % self._links]))
            score = score.plus(Score(link.log_likelihood, link.nis, link.degrees))
            found.append(WatchedCycle(self._past_sample(each), link, score))
        return tuple(found)

    def _past_sample(self, stored_sample: JointSample | tuple[Samples, Besides, int]) -> JointSample:
        """Returns the joint filter's sample of a past cycle: as stored, or rebuilt from its row."""
        if isinstance(stored_sample, JointSample):
            return stored_sample
        samples, beside, row = stored_sample
        duration_s = float(beside.durations_s[row])
        outside, wheels = samples.outside[row] * duration_s, self._wheels
        durations, commands = split_sample(
            samples.commands[row], beside.onsets_s[row], self._rules.period_s, (0.0, duration_s)
        )
        plain = JointSample(
            float(samples.time_s[row]),
            durations,
            commands,
            outside,
            samples.rates[row],
            samples.velocities[row],
            timing_on_ticks(),
        )
        if self._places.trackers:
            plain = plain._replace(attitudes=beside.attitudes[row], frames=beside.frames[row])
        if self._places.wheels:
            plain = plain._replace(
                speeds=interval_wheel_speeds(beside.before[row], beside.speeds[row], duration_s, wheels)[0]
            )
        return plain


def covers(params: EstimationParams) -> bool:
    """Tests whether the compiled kernel can run cycles with a given filter, detector and vehicle."""
    return (
        params.filter is joint.FILTER
        and params.detector is faults.DETECTOR
        and params.filter_params.joint.compiled is not None
        and params.filter_params.joint.places.accelerometers > 0
        and params.filter_params.joint.places.engines == 0
        and (params.filter_params.joint.rates.period_s > 0.0 or _is_plain(params.filter_params))
    )


def _is_plain(params: JointFilterParams) -> bool:
    """Tests whether a vehicle has neither trackers nor wheels, and no jets commanded by on-times."""
    return params.joint.places.trackers == 0 and params.joint.places.wheels == 0 and params.opens_at is None


def _is_quiet(filter_state: JointFilterState, tree: Tree) -> bool:
    """Tests whether the compiled kernel may run the next cycle: initialized, no fault hypothesis, no alarm."""
    clock = filter_state.clock
    if len(tree.hypotheses) != 1 or tree.births or not filter_state.joint.guarded or filter_state.start.under_way:
        return False
    watch: Watch | None = tree.leader.watch
    return (
        not tree.leader.events
        and watch is not None
        and watch.alarm is None
        and bool(watch.bank.states)
        and not (clock.lost or clock.off or np.isnan(clock.earlier).any())
    )
