"""A whole cycle of the joint filter and of its detector as one kernel, while there is nothing to be judged.

Nothing happens in most cycles: the filter goes on, the bank of onsets is carried with it, and the test finds nothing.
What such a cycle keeps stays within a `kernels.Holder` and in arrays that are written in place, and what is logged of
it goes straight into rows. A cycle that is anything else is not taken: it is left to the parts, `cycle.step`, which
begin with what `Quiet.state` makes of these.

All compiled code of the joint filter is one function, `work`, of whose parts Python asks for one at a time: machine
code is made of each kernel once, and not for each of its callers.
"""

from __future__ import annotations

from collections import deque
from contextlib import suppress
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from massprop_drake.maths.arrays import Layout
from massprop_drake.maths.estimation.cycle import EstimationParams, EstimationState
from massprop_drake.maths.estimation.detector import STATUS
from massprop_drake.maths.estimation.faults import hypothesis_filter as faults
from massprop_drake.maths.estimation.faults.alarms import Watch, WatchedCycle
from massprop_drake.maths.estimation.faults.fault_report import HYPOTHESIS_REPORT, nothing_said
from massprop_drake.maths.estimation.faults.tree import SURPRISE, Tree
from massprop_drake.maths.estimation.filters import joint
from massprop_drake.maths.estimation.filters.joint import (
    JointFilterParams,
    JointFilterState,
    Seen,
    mass_report,
    rotation_report,
)
from massprop_drake.maths.estimation.impulses import Impulses, interval_impulses
from massprop_drake.maths.estimation.joint import start as starts
from massprop_drake.maths.estimation.joint.bank import (
    ALARM,
    OLDEST,
    ONSETS,
    Bank,
    Followed,
    Following,
    Roots,
    Since,
    alarming,
    empty,
    followed,
)
from massprop_drake.maths.estimation.joint.burns import Burn
from massprop_drake.maths.estimation.joint.disturbance_states import Wander
from massprop_drake.maths.estimation.joint.hypotheses import NO_SCORE, Score
from massprop_drake.maths.estimation.joint.joint_cycle import (
    OWN_CHOICE,
    Crossing,
    Cycled,
    Cycling,
    JointSample,
    course_of,
    cycled,
    gone_over,
    initial,
)
from massprop_drake.maths.estimation.joint.layout import (
    RATE,
    JointParams,
    JointState,
    Places,
    pack,
    settled,
    state_layout,
    unpack,
)
from massprop_drake.maths.estimation.joint.measurement import rate_read, readings
from massprop_drake.maths.estimation.joint.orientation import STILL, shared_attitude
from massprop_drake.maths.estimation.joint.sensitivity import LINK, Link, Traces, traced
from massprop_drake.maths.estimation.joint.swing import unswung
from massprop_drake.maths.estimation.joint.ticks import LONGEST, Clock, Stamped, on_ticks, on_time, started
from massprop_drake.maths.estimation.joint.wheels import Spun, spun
from massprop_drake.maths.estimation.whole import Samples, one_sample
from massprop_drake.maths.kernels import chosen, either, fill, held, kernel, released, shared
from massprop_drake.maths.linear_algebra import Array, NotPositiveDefiniteError
from massprop_drake.maths.vehicle.engine_thrust import N_CHANNELS
from massprop_drake.maths.vehicle.on_times import pieces
from massprop_drake.maths.vehicle.thrust import LagFactors, lag_factors

GO_ON, CYCLE, FOLLOW, GO_OVER = range(4)  # parts of `work`
_TESTED, _LIKELIHOOD = (STATUS.slice(name).start for name in ("tested", "suspected_likelihood"))


class JointMemory(NamedTuple):
    """Memory between two cycles.

    Attributes:
        joint: see `JointState`.
        clock: see `Clock`.
        estimate, covariance: see `JointFilterState`.
        since: see `bank.Since`.
        command, level: see `cycle.EstimationState`.
        cycle: number of the newest sample.
        frame, speeds: see `JointFilterState`.
    """

    joint: JointState
    clock: Clock
    estimate: Array
    covariance: Array
    since: Since
    command: Array
    level: Array
    cycle: float
    frame: Array
    speeds: Array


class Past(NamedTuple):
    """States and cycles of the past, written in place.

    Attributes:
        states: of the onsets, packed, in any order, shape (ONSETS, size of a state).
        roots: of the same, shape (ONSETS, size, size).
        places: of each onset's among them, oldest first, shape (ONSETS,).
        links: of the last cycles, packed as `LINK`, each in the row of its number, shape (n, size of a link).
        excess: by how much less likely the readings of each of these were than expected, nats, shape (n,).
    """

    states: Array
    roots: Array
    places: NDArray[np.int_]
    links: Array
    excess: Array


class JointRows(NamedTuple):
    """Log rows, one per cycle, as the layouts of the same names have them; one row of no cycle is empty."""

    impulses: Array
    rotation_report: Array
    mass_report: Array
    joint_report: Array
    detector_report: Array
    hypothesis_report: Array


class Besides(NamedTuple):
    """Readings and commands beside those of the samples, a row per cycle, and what cycles make of them, in place.

    Attributes:
        quaternions: that trackers read, NaN where missing, shape (n, n_trackers, 4).
        speeds: of the wheels as they are read, NaN where missing, rad/s, shape (n, n_wheels).
        onsets_s: of the commands, NaN where these are levels, shape (n, n_jets).
        durations_s: of the intervals that end, shape (n,).
        frames, attitudes: see `cycle.Sample`, shapes (n, 2, 4) and (n, n_trackers, 3).
        before: speeds that were read last before each, NaN where none has been, rad/s, shape (n, n_wheels).
    """

    quaternions: Array
    speeds: Array
    onsets_s: Array
    durations_s: Array
    frames: Array
    attitudes: Array
    before: Array


def besides(count: int, places: Places, tracked: Array | None = None, onsets_s: Array | None = None) -> Besides:
    """Returns the layout of quantities that rows hold besides.

    Args:
        count: number of rows.
        places: see `Places`.
        tracked: see `filter.Told`, shape (n, columns); None: nothing.
        onsets_s: of the commands, shape (n, n_jets) at least; None: these are levels.
    """
    poses = 7 * places.trackers
    read = np.full((count, poses + places.wheels), np.nan) if tracked is None else tracked
    return Besides(
        np.ascontiguousarray(read[:, :poses].reshape(count, -1, 7)[:, :, 3:]) if poses else np.zeros((count, 0, 4)),
        np.ascontiguousarray(read[:, read.shape[1] - places.wheels :]),
        np.full((count, places.jets), np.nan) if onsets_s is None else np.ascontiguousarray(onsets_s[:count]),
        np.zeros(count),
        np.zeros((count, 2, 4)),
        np.zeros((count, places.trackers, 3)),
        np.zeros((count, places.wheels)),
    )


class Rules(NamedTuple):
    """Parameters of a cycle besides the filter's.

    Attributes:
        period_s, impulse_per_level, lag: see `cycle.EstimationParams`.
        detector_row, hypothesis_row: what is logged of the detector where nothing is found.
    """

    period_s: float
    impulse_per_level: Array
    lag: LagFactors
    detector_row: Array
    hypothesis_row: Array


class JointDesk(NamedTuple):
    """Inputs of cycles, and the rows that they write.

    Attributes:
        samples: one a row.
        stamps_s: see `cycle.Sample`, shape (n,).
        besides: see `Besides`.
        rows: to be filled in.
        reached: the row that is being made, and that before which to stop, shape (2,).
        past: see `Past`.
        rules: see `Rules`.
    """

    samples: Samples
    stamps_s: Array
    besides: Besides
    rows: JointRows
    reached: NDArray[np.int_]
    past: Past
    rules: Rules


class Asked(NamedTuple):
    """Arguments that parts take one by one.

    Attributes:
        cycling: see `joint_cycle.Cycling`.
        about: see `joint_cycle.gone_over`.
    """

    cycling: Cycling
    about: Array


@kernel
def work(part: int, asked: Any, following: Any, memory: Any, desk: Any, holder: Any) -> Any:
    """Runs a part of the joint filter's work.

    Args:
        part: GO_ON: see `watch`; CYCLE: see `joint_cycle.cycled`; FOLLOW: see `bank.followed`; GO_OVER: see
            `joint_cycle.gone_over`.
        asked: holder of `Asked`, for CYCLE and GO_OVER.
        following: holder of `bank.Following`, for FOLLOW.
        memory, desk: holders of `JointMemory` and `JointDesk`, for GO_ON.
        holder: of the parameters.

    Returns:
        What the three last parts give, None for those that are not done.
    """
    params = holder.value
    one = found = over = None
    if part == GO_ON:
        watch(memory, desk.value, params)
    elif part == FOLLOW:
        told = following.value
        found = followed(told.since, told.roots, told.seen, told.cycle, told.least, params)
    else:
        cycling = asked.value.cycling
        if part == CYCLE:
            one = cycled(cycling.state, cycling.sample, cycling.thresholds, cycling.counts, params)
        else:
            over = gone_over(cycling.state, cycling.sample, asked.value.about, params)
    return one, found, over


@kernel
def watch(memory: Any, desk: JointDesk, params: JointParams) -> None:
    """Runs cycles up to a row, or to the first in which something happens; that one has changed nothing.

    Args:
        memory: holder of a `JointMemory`.
        desk: see `JointDesk`.
        params: see `JointParams`.
    """
    reached = desk.reached
    while reached[0] < reached[1]:
        after, on = _watched(memory.value, desk, reached[0], params)
        if not on:
            break
        memory.value = after
        reached[0] += 1


@kernel
def _watched(kept: JointMemory, desk: JointDesk, row: int, params: JointParams) -> tuple[JointMemory, bool]:
    """Runs a cycle; returns the memory after it, and whether nothing has happened in it."""
    samples, rules = desk.samples, desk.rules
    stamp_s, command = desk.stamps_s[row], samples.commands[row].copy()  # rows may be written to again
    duration_s = _passed(kept.clock, stamp_s, rules.period_s, params)
    if duration_s == 0.0 or np.isnan(command).any():
        return kept, False
    outside = samples.outside[row] * duration_s
    impulses = interval_impulses(command, kept.command, kept.level, rules.impulse_per_level, rules.lag, outside)
    sample = _sample(kept, desk, row, duration_s, params)
    done = cycled(kept.joint, sample, params.thresholds, np.zeros(0, dtype=np.bool_), params)
    after = done.state
    if done.incremented or not (np.isfinite(after.mean).all() and np.isfinite(after.root).all()):
        return kept, False
    seen = traced(kept.joint.mean, course_of(done), sample)
    roots, cycle = Roots(desk.past.roots, desk.past.places), kept.cycle + 1.0
    found = followed(kept.since, roots, seen, cycle, ALARM, params)
    likelihood = 0.0
    if found.some:
        likelihood = found.tested.likelihood.max()
        if alarming(likelihood, found.tested.total.max()):
            return kept, False
    newest = 0.5 * (found.link.nis - found.link.degrees)
    if newest - _usual(desk.past.excess, found.since.cycles[0], cycle, newest) > SURPRISE:
        return kept, False
    _remember(desk.past, after, found, cycle)
    _log(desk.rows, row, impulses, done, params)
    desk.rows.detector_report[row] = rules.detector_row
    desk.rows.detector_report[row, _TESTED] = found.complete
    desk.rows.detector_report[row, _LIKELIHOOD] = likelihood
    desk.rows.hypothesis_report[row] = rules.hypothesis_row
    clock = started(stamp_s, command)
    clock.earlier_onset_s[:] = desk.besides.onsets_s[row]
    estimate, covariance = done.estimate.copy(), done.covariance.copy()
    speeds = either(np.isnan(desk.besides.speeds[row]), kept.speeds, desk.besides.speeds[row])
    frame = sample.frames[1].copy()
    kept = JointMemory(after, clock, estimate, covariance, found.since, command, impulses.level, cycle, frame, speeds)
    return kept, True


@kernel
def _passed(clock: Clock, stamp_s: float, period_s: float, params: JointParams) -> float:
    """Returns the length of the interval that ends with a stamp, s; 0: it is not as usual."""
    if params.rates.period_s == 0.0:
        return period_s if on_time(clock, stamp_s, period_s) else 0.0
    passed_s = stamp_s - clock.stamp_s
    return passed_s if 0.0 < passed_s <= LONGEST * period_s else 0.0


@kernel
def _shut(places: Places) -> Burn:
    """Returns the burn of engines that are shut."""
    return Burn(np.zeros((places.engines, 3, N_CHANNELS)), np.zeros((places.engines, N_CHANNELS)))


@kernel
def _sample(kept: JointMemory, desk: JointDesk, row: int, duration_s: float, params: JointParams) -> JointSample:
    """Makes the sample of a row; what `Quiet` cannot tell from the row again is kept beside it."""
    samples, beside = desk.samples, desk.besides
    onset_s, command = beside.onsets_s[row].copy(), samples.commands[row].copy()
    durations, commands = pieces(command, onset_s, desk.rules.period_s, (0.0, duration_s))
    rates, velocities = samples.rates[row].copy(), samples.velocities[row].copy()
    frames, attitudes = np.zeros((2, 4)), np.zeros((params.places.trackers, 3))
    if params.places.trackers > 0:
        before = kept.joint.mean[RATE]
        shown = rate_read(rates, kept.joint.mean, params).rate
        rate = 0.5 * (before + either(np.isnan(shown), before, shown))
        frames[0] = kept.frame
        frames[1], attitudes = shared_attitude(kept.frame, rate, duration_s, beside.quaternions[row])
    speeds, _ = spun(kept.speeds, beside.speeds[row], duration_s, params.wheels)
    beside.durations_s[row] = duration_s
    beside.frames[row], beside.attitudes[row], beside.before[row] = frames, attitudes, kept.speeds
    outside = samples.outside[row] * duration_s
    return JointSample(
        samples.time_s[row],
        durations,
        commands,
        outside,
        rates,
        velocities,
        on_ticks(),
        attitudes,
        frames,
        speeds,
        _shut(params.places),
    )


@kernel
def _remember(past: Past, after: JointState, found: Followed, cycle: float) -> None:
    """Stores the newest onset in a free place, and its cycle beside it."""
    stay = found.keep.shape[0]
    past.places[:stay] = past.places[found.keep]
    free = np.ones(ONSETS)
    free[past.places[:stay]] = 0.0
    place = np.argmax(free)
    past.places[stay] = place
    past.roots[place] = after.root
    fill(past.states[place], after)
    number = int(cycle) % past.excess.shape[0]
    fill(past.links[number], found.link)
    past.excess[number] = 0.5 * (found.link.nis - found.link.degrees)


@kernel
def _usual(excess: Array, oldest: float, cycle: float, newest: float) -> float:
    """Computes the mean of what cycles between the oldest onset and the newest added; without any, the newest's."""
    total, count = 0.0, 0
    for number in range(int(oldest) + 1, int(cycle)):
        total += excess[number % excess.shape[0]]
        count += 1
    return total / count if count > 0 else newest


@kernel
def _log(rows: JointRows, row: int, impulses: Impulses, done: Cycled, params: JointParams) -> None:
    """Fills in the filter's log rows."""
    expected, gyros = done.expected, 3 * params.places.gyros
    accelerometers = 3 * params.places.accelerometers
    seen = Seen(
        done.innovation,
        done.innovation_std,
        expected.used,
        done.gyro_nis,
        done.accelerometer_nis,
        done.gyro_degrees,
        done.accelerometer_degrees,
        done.incremented,
        expected.prediction.coupled,
    )
    fill(
        rows.impulses[row],
        (impulses.angular_impulse, impulses.linear_impulse, impulses.usable, impulses.firing),
    )
    fill(rows.rotation_report[row], rotation_report(done.estimate, done.covariance, seen, gyros))
    fill(rows.mass_report[row], mass_report(done.estimate, done.covariance, seen, gyros, accelerometers))
    fill(rows.joint_report[row], (done.gyro_degrees, done.accelerometer_degrees, settled(done.state, params)))


# ------------------------------------------------------------------------------------- asked for by Python


class Work:
    """Compiled `work`, or the plain one, for some parameters; compiled now, and not in the midst of a flight.

    Args:
        params: of the filter.
        compile_it: whether it is compiled.
    """

    def __init__(self, params: JointParams, *, compile_it: bool = True):
        self._work, self._compiled = chosen(work, compile_it), compile_it
        self._params = held(params, compile_it)
        state, sample = initial(params), _no_sample(params.places)
        cycling = Cycling(state, sample, params.thresholds, OWN_CHOICE)
        self._no_asked = held(Asked(cycling, state.mean), compile_it)
        self._no_following = held(_no_following(params.places, sample), compile_it)
        self._no_memory = held(_no_memory(state, params.places), compile_it)
        self._no_desk = held(_no_desk(params.places), compile_it)
        if compile_it:
            self.watch(self._no_memory, self._no_desk)

    def watch(self, memory: Any, desk: Any) -> None:
        """Runs `watch`, see there; both are holders."""
        self._work(GO_ON, self._no_asked, self._no_following, memory, desk, self._params)

    def cycled(self, cycling: Cycling) -> Cycled:
        """Runs `joint_cycle.cycled`, see there."""
        one, _, _ = self._asked(CYCLE, Asked(cycling, cycling.state.mean))
        return one

    def gone_over(self, state: JointState, sample: JointSample, about: Array) -> tuple[JointState, float, float]:
        """Runs `joint_cycle.gone_over`, see there."""
        _, _, over = self._asked(GO_OVER, Asked(Cycling(state, sample, state.mean, OWN_CHOICE), about))
        return over

    def _asked(self, part: int, asked: Asked) -> Any:
        given = shared(asked, self._compiled)
        return self._work(part, given, self._no_following, self._no_memory, self._no_desk, self._params)

    def followed(self, following: Following) -> Followed:
        """Runs `bank.followed`, see there."""
        given = shared(following, self._compiled)
        _, found, _ = self._work(FOLLOW, self._no_asked, given, self._no_memory, self._no_desk, self._params)
        return found


def with_compiled(params: JointParams) -> JointParams:
    """Returns parameters of a filter whose work is compiled."""
    return params._replace(compiled=Work(params))


def _no_sample(places: Places) -> JointSample:
    rates, velocities = np.zeros((places.gyros, 3)), np.zeros((places.accelerometers, 3))
    attitudes, command = np.zeros((places.trackers, 3)), np.zeros((1, places.jets))
    none = np.zeros(places.wheels)
    around = STILL.copy(), Spun(none, none, none, none), _shut(places)
    return JointSample(0.0, np.ones(1), command, np.zeros(6), rates, velocities, on_ticks(), attitudes, *around)


def _no_following(places: Places, sample: JointSample) -> Following:
    n, m = places.size, places.outputs
    rows, learned = np.zeros((3, n)), (np.zeros((0, 0)), np.zeros((n, 0)), np.zeros(n))
    told = (np.zeros((m, n)), np.zeros((m, n)), np.zeros(m), np.zeros(m, dtype=np.bool_), np.zeros(m))
    given = (np.zeros(places.jets), readings(sample.rates, sample.velocities, sample.attitudes))
    stamp = Stamped(np.zeros(n), np.zeros(n), np.zeros(n), 1.0)
    nothing = Crossing(np.zeros((m, n)), np.zeros((n, m)), np.zeros(n), 0.0)
    each, slow = np.zeros(places.n_slow), np.zeros((6, places.n_slow))
    wander = Wander(each, slow, slow, each, each)
    before = (
        np.zeros(n),
        rows,
        rows,
        np.zeros((2, places.n_attitude, 3)),
        1.0,
        np.zeros((6, 6)),
        wander,
        unswung(places.n_swing, places.size),
        1.0,
    )
    seen = Traces(*before, *told, *learned, *given, nothing, stamp, 0.0, 0.0, 0.0)
    return Following(Since(*empty(places)[1:]), Roots(np.zeros((0, n, n)), np.arange(0)), seen, 0.0, 0.0)


def _no_memory(state: JointState, places: Places) -> JointMemory:
    clock, none, since = started(0.0, state.level), np.zeros(places.jets), Since(*empty(places)[1:])
    frame, speeds = np.zeros(4), np.zeros(places.wheels)
    return JointMemory(state, clock, np.zeros(10), np.zeros((10, 10)), since, none, none, 0.0, frame, speeds)


def _no_past(places: Places, links: int) -> Past:
    states = np.zeros((ONSETS, state_layout(places).size))
    kept = np.zeros((links, _link_layout(places).size))
    roots, order = np.zeros((ONSETS, places.size, places.size)), np.zeros(ONSETS, dtype=np.int_)
    return Past(states, roots, order, kept, np.zeros(links))


def _no_desk(places: Places) -> JointDesk:
    samples, nothing = one_sample(places.gyros, places.accelerometers, places.jets), np.zeros(1)
    rules = Rules(1.0, np.zeros((places.jets, 6)), lag_factors(np.zeros(places.jets), 1.0), nothing, nothing)
    rows, reached = JointRows(*[np.zeros((1, 1))] * len(JointRows._fields)), np.zeros(2, dtype=np.int_)
    return JointDesk(samples, np.zeros(1), besides(1, places), rows, reached, _no_past(places, 2), rules)


def _link_layout(places: Places) -> Layout:
    counts = {"jets": places.jets, "outputs": places.outputs, "attitude": places.n_attitude}
    return LINK.sized(size=places.size, slow=places.n_slow, swing=places.n_swing, disturbed=6 + places.n_slow, **counts)


# --------------------------------------------------------------------------------------- taken up and left


class Quiet:
    """Cycles in which nothing happens, between those that are left to `cycle.step`.

    Args:
        made: parameters of the cycle, see `covers`.
        compiled: whether the kernel is.

    Attributes:
        on: whether the last cycle was such that one of these may follow.
    """

    def __init__(self, made: EstimationParams, *, compiled: bool):
        joint = made.filter_params.joint
        self.on = False
        self._work: Work = joint.compiled
        self._places, self._wheels, self._compiled = joint.places, joint.wheels, compiled
        self._links = OLDEST * joint.rates.steps + 2  # that are kept: the oldest onset's, and those since
        self._past, self._reached = _no_past(joint.places, self._links), np.zeros(2, dtype=np.int_)
        jets = joint.places.jets
        self._rules = Rules(
            made.period_s,
            np.ascontiguousarray(made.impulse_per_level),
            made.lag,
            np.zeros(STATUS.size + 4 * jets),
            HYPOTHESIS_REPORT.sized(jets=jets).pack(nothing_said(jets)),
        )
        self._cycles: deque[JointSample | tuple[Samples, Besides, int]] = deque(
            maxlen=self._links
        )  # by row or as it was

    def begin(
        self, samples: Samples, stamps_s: Array, beside: tuple[Array | None, Array | None], rows: JointRows
    ) -> None:
        """Takes rows that cycles are to go through, and those that they fill in.

        Args:
            samples, stamps_s: see `JointDesk`.
            beside: tracked readings and onsets, see `besides`.
            rows: to be filled in.
        """
        self._samples, self._besides = samples, besides(samples.time_s.size, self._places, *beside)
        desk = JointDesk(samples, stamps_s, self._besides, rows, self._reached, self._past, self._rules)
        self._desk = shared(desk, self._compiled)

    def take_up(self, state: EstimationState) -> None:
        """Goes on from a state, if nothing is happening in it."""
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
        layout = _link_layout(self._places)
        self._cycles.clear()
        for number, record in enumerate(records, start=tree.cycle - len(records) + 1):
            self._past.links[number % self._links] = layout.pack(record.link)
            self._past.excess[number % self._links] = 0.5 * (record.link.nis - record.link.degrees)
            self._cycles.append(record.sample)
        fill(self._rules.detector_row, faults.unremarkable(detector))
        memory = JointMemory(
            filtered.joint,
            filtered.clock,
            filtered.estimate,
            filtered.covariance,
            Since(*bank[1:]),
            state.command,
            state.level,
            float(tree.cycle),
            filtered.frame,
            filtered.speeds,
        )
        self._memory = held(memory, self._compiled)

    def advance(self, row: int, until: int) -> int:
        """Advances from a row as long as nothing happens, or to another that is not taken any more; returns which."""
        self._reached[:] = row, until
        with suppress(NotPositiveDefiniteError, np.linalg.LinAlgError):  # the parts will say what it is
            self._work.watch(self._memory, self._desk)
        reached = int(self._reached[0])
        self._cycles.extend((self._samples, self._besides, done) for done in range(row, reached))
        self.on = reached == until
        return reached

    def state(self) -> EstimationState:
        """Returns the state with which the next cycle begins."""
        kept: JointMemory = released(self._memory)
        since, places, cycle = kept.since, self._past.places.tolist(), int(kept.cycle)
        states = self._past.states.copy()
        onsets = tuple(unpack(states[places[index]], self._places) for index in range(since.cycles.size))
        before = self._before.detector
        records = self._records(cycle)
        leader = before.tree.leader
        run = leader.run._replace(state=kept.joint, cycle=cycle, score=records[-1].score)
        of_bank = records[-(cycle - int(since.cycles[0]) + 1) :]
        trail = tuple(record.score.likelihood for record in records)
        watch = Watch(Bank(onsets, *since), of_bank)
        leader = leader._replace(run=run, weight=run.score.likelihood, trail=trail, watch=watch)
        tree = Tree(cycle, (leader,), samples=tuple((record.sample, record.link) for record in records))
        filtered = JointFilterState(kept.joint, kept.clock, kept.estimate, kept.covariance, starts.OVER)
        filtered = filtered._replace(frame=kept.frame, speeds=kept.speeds)
        return EstimationState(kept.command, kept.level, filtered, before._replace(tree=tree))

    def _records(self, cycle: int) -> tuple[WatchedCycle, ...]:
        """Returns records of the last cycles; scores count from the first of them."""
        layout, links, score = _link_layout(self._places), self._past.links.copy(), NO_SCORE
        seen, found = list(self._cycles), []
        for number, each in enumerate(seen, start=cycle - len(seen) + 1):
            over = Link(*layout.read(links[number % self._links]))
            score = score.plus(Score(over.log_likelihood, over.nis, over.degrees))
            found.append(WatchedCycle(self._sample(each), over, score))
        return tuple(found)

    def _sample(self, each: JointSample | tuple[Samples, Besides, int]) -> JointSample:
        if isinstance(each, JointSample):
            return each
        samples, beside, row = each
        duration_s = float(beside.durations_s[row])
        outside, wheels = samples.outside[row] * duration_s, self._wheels
        durations, commands = pieces(
            samples.commands[row], beside.onsets_s[row], self._rules.period_s, (0.0, duration_s)
        )
        plain = JointSample(
            float(samples.time_s[row]),
            durations,
            commands,
            outside,
            samples.rates[row],
            samples.velocities[row],
            on_ticks(),
        )
        if self._places.trackers:
            plain = plain._replace(attitudes=beside.attitudes[row], frames=beside.frames[row])
        if self._places.wheels:
            plain = plain._replace(speeds=spun(beside.before[row], beside.speeds[row], duration_s, wheels)[0])
        return plain


def covers(made: EstimationParams) -> bool:
    """Tests whether the kernel can make most cycles of these parameters."""
    return (
        made.filter is joint.FILTER
        and made.detector is faults.DETECTOR
        and made.filter_params.joint.compiled is not None
        and made.filter_params.joint.places.accelerometers > 0
        and made.filter_params.joint.places.engines == 0
        and (made.filter_params.joint.rates.period_s > 0.0 or _is_plain(made.filter_params))
    )


def _is_plain(made: JointFilterParams) -> bool:
    """Tests whether there are neither trackers, wheels nor on-times."""
    return made.joint.places.trackers == 0 and made.joint.places.wheels == 0 and made.opens_at is None


def _is_quiet(filtered: JointFilterState, tree: Tree) -> bool:
    """Tests whether the next cycle may be one in which nothing happens: no start, no event, and no alarm."""
    clock = filtered.clock
    if len(tree.hypotheses) != 1 or tree.births or not filtered.joint.guarded or filtered.start.under_way:
        return False
    watch: Watch | None = tree.leader.watch
    return (
        not tree.leader.events
        and watch is not None
        and watch.alarm is None
        and bool(watch.bank.states)
        and not (clock.lost or clock.off or np.isnan(clock.earlier).any())
    )
