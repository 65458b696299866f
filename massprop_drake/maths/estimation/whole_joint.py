"""A whole cycle of the joint filter and of its detector as one kernel, while there is nothing to be judged.

Nothing happens in most cycles: the filter goes on, the bank of onsets is carried with it, and the test finds nothing.
What such a cycle keeps stays within a `kernels.Holder` and in arrays that are written in place, and what is logged of
it goes straight into rows. A cycle that is anything else is not taken: it is left to the parts, `cycle.step`, which
begin with what `quiet_cycles.Quiet.state` makes of these.

All compiled code of the joint filter is one function, `run_part`, of whose parts Python asks for one at a time: machine
code is made of each kernel once, and not for each of its callers.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from massprop_drake.maths.estimation.detector import STATUS
from massprop_drake.maths.estimation.faults.tree import SURPRISE
from massprop_drake.maths.estimation.filters.joint_reports import mass_report, rotation_report
from massprop_drake.maths.estimation.impulses import Impulses, interval_impulses
from massprop_drake.maths.estimation.joint.bank import (
    ALARM,
    ONSETS,
    Followed,
    Following,
    Roots,
    empty_bank,
    follow_cycle,
    is_alarming,
)
from massprop_drake.maths.estimation.joint.beginning import initial_joint_state
from massprop_drake.maths.estimation.joint.burns import shut_engine_burn
from massprop_drake.maths.estimation.joint.joint_cycle import OWN_CHOICE, Report, run_cycle
from massprop_drake.maths.estimation.joint.joint_sample import JointSample
from massprop_drake.maths.estimation.joint.layout import RATE, JointParams, JointState, is_initialized
from massprop_drake.maths.estimation.joint.measurement import combine_gyros
from massprop_drake.maths.estimation.joint.orientation import shared_attitude
from massprop_drake.maths.estimation.joint.relinearization import repeat_start_cycle
from massprop_drake.maths.estimation.joint.sensitivity import collect_cycle_terms
from massprop_drake.maths.estimation.joint.ticks import LONGEST, Clock, is_on_time, start_clock, timing_on_ticks
from massprop_drake.maths.estimation.joint.wheels import interval_wheel_speeds
from massprop_drake.maths.estimation.joint_desk import (
    JointDesk,
    JointMemory,
    JointRows,
    Past,
    empty_buffers,
    empty_sample,
    initial_memory,
)
from massprop_drake.maths.kernels import compile_kernel_if, fill, kernel, make_holder, make_shared_holder, select_where
from massprop_drake.maths.linear_algebra import Array
from massprop_drake.maths.vehicle.on_times import split_sample

GO_ON, CYCLE, FOLLOW, GO_OVER = range(4)  # parts of `run_part`
_TESTED, _LIKELIHOOD = (STATUS.slice(name).start for name in ("tested", "suspected_likelihood"))


class Asked(NamedTuple):
    """Arguments of the parts of a cycle that `run_part` runs one by one.

    Attributes:
        state: of the filter, see `joint_cycle.run_cycle`, as the next three.
        sample, thresholds, counts: likewise.
        about: see `relinearization.repeat_start_cycle`.
    """

    state: JointState
    sample: JointSample
    thresholds: Array
    counts: np.ndarray
    about: Array


@kernel
def run_part(part: int, arguments: Any, bank_arguments: Any, memory: Any, buffers: Any, params_holder: Any) -> Any:
    """Runs the part of the joint filter's cycle that `part` selects; a kernel compiled once for all parts.

    Args:
        part: GO_ON: see `run_quiet_cycles`; CYCLE: see `joint_cycle.run_cycle`; FOLLOW: see `bank.follow_cycle`;
            GO_OVER: see `relinearization.repeat_start_cycle`.
        arguments: holder of `Asked`, for CYCLE and GO_OVER.
        bank_arguments: holder of `bank.Following`, for FOLLOW.
        memory, buffers: holders of `JointMemory` and `JointDesk`, for GO_ON.
        params_holder: of the parameters.

    Returns:
        What the three last parts give, None for those that are not done.
    """
    params = params_holder.value
    cycle = followed = repeated = None
    if part == GO_ON:
        run_quiet_cycles(memory, buffers.value, params)
    elif part == FOLLOW:
        bank = bank_arguments.value
        followed = follow_cycle(bank.since, bank.roots, bank.seen, bank.cycle, bank.least, params)
    else:
        given = arguments.value
        if part == CYCLE:
            cycle = run_cycle(given.state, given.sample, given.thresholds, given.counts, params)
        else:
            repeated = repeat_start_cycle(given.state, given.sample, given.about, params)
    return cycle, followed, repeated


@kernel
def run_quiet_cycles(memory: Any, buffers: JointDesk, params: JointParams) -> None:
    """Runs cycles up to a row or the first alarm or event, whose cycle is discarded; updates the holder `memory`."""
    reached = buffers.reached
    while reached[0] < reached[1]:
        after, on = _run_quiet_cycle(memory.value, buffers, reached[0], params)
        if not on:
            break
        memory.value = after
        reached[0] += 1


@kernel
def _run_quiet_cycle(
    memory: JointMemory, buffers: JointDesk, row: int, params: JointParams
) -> tuple[JointMemory, bool]:
    """Runs a cycle on a row; returns the memory, and False with the old memory if an alarm or event came up."""
    samples, rules = buffers.samples, buffers.rules
    stamp_s, command = buffers.stamps_s[row], samples.commands[row].copy()  # rows may be written to again
    duration_s = _interval_length(memory.clock, stamp_s, rules.period_s, params)
    if duration_s == 0.0 or np.isnan(command).any():
        return memory, False
    outside = samples.outside[row] * duration_s
    impulses = interval_impulses(command, memory.command, memory.level, rules.impulse_per_level, rules.lag, outside)
    sample = _make_sample(memory, buffers, row, duration_s, params)
    after, report = run_cycle(memory.joint, sample, params.thresholds, np.zeros(0, dtype=np.bool_), params)
    if report.incremented or not (np.isfinite(after.mean).all() and np.isfinite(after.root).all()):
        return memory, False
    seen = collect_cycle_terms(memory.joint.mean, report.course, sample)  # type: ignore[arg-type] # not of a first sample
    roots, cycle = Roots(buffers.past.roots, buffers.past.places), memory.cycle + 1.0
    found = follow_cycle(memory.since, roots, seen, cycle, ALARM, params)
    likelihood = 0.0
    if found.some:
        likelihood = found.tested.likelihood.max()
        if is_alarming(likelihood, found.tested.total.max()):
            return memory, False
    newest = 0.5 * (found.link.nis - found.link.degrees)
    if newest - _mean_excess(buffers.past.excess, found.since.cycles[0], cycle, newest) > SURPRISE:
        return memory, False
    _store_onset(buffers.past, after, found, cycle)
    _fill_log_rows(buffers.rows, row, impulses, (after, report), params)
    buffers.rows.detector_report[row] = rules.detector_row
    buffers.rows.detector_report[row, _TESTED] = found.complete
    buffers.rows.detector_report[row, _LIKELIHOOD] = likelihood
    buffers.rows.hypothesis_report[row] = rules.hypothesis_row
    clock = start_clock(stamp_s, command, buffers.besides.onsets_s[row].copy())
    estimate, covariance = report.estimate.copy(), report.covariance.copy()
    speeds = select_where(np.isnan(buffers.besides.speeds[row]), memory.speeds, buffers.besides.speeds[row])
    frame = sample.frames[1].copy()
    memory = JointMemory(after, clock, estimate, covariance, found.since, command, impulses.level, cycle, frame, speeds)
    return memory, True


@kernel
def _interval_length(clock: Clock, stamp_s: float, period_s: float, params: JointParams) -> float:
    """Returns the length of the interval that ends with a time stamp, s; 0: too long, or off the clock."""
    if params.rates.period_s == 0.0:
        return period_s if is_on_time(clock, stamp_s, period_s) else 0.0
    passed_s = stamp_s - clock.stamp_s
    return passed_s if 0.0 < passed_s <= LONGEST * period_s else 0.0


@kernel
def _make_sample(
    memory: JointMemory, buffers: JointDesk, row: int, duration_s: float, params: JointParams
) -> JointSample:
    """Makes the joint filter's sample of a row, and stores beside it what cannot be rebuilt from the row."""
    samples, beside = buffers.samples, buffers.besides
    onset_s, command = beside.onsets_s[row].copy(), samples.commands[row].copy()
    durations, commands = split_sample(command, onset_s, buffers.rules.period_s, (0.0, duration_s))
    rates, velocities = samples.rates[row].copy(), samples.velocities[row].copy()
    frames, attitudes = np.zeros((2, 4)), np.zeros((params.places.trackers, 3))
    if params.places.trackers > 0:
        before = memory.joint.mean[RATE]
        shown = combine_gyros(rates, memory.joint.mean, params).rate
        rate = 0.5 * (before + select_where(np.isnan(shown), before, shown))
        frames[0] = memory.frame
        frames[1], attitudes = shared_attitude(memory.frame, rate, duration_s, beside.quaternions[row])
    speeds, _ = interval_wheel_speeds(memory.speeds, beside.speeds[row], duration_s, params.wheels)
    beside.durations_s[row] = duration_s
    beside.frames[row], beside.attitudes[row], beside.before[row] = frames, attitudes, memory.speeds
    outside = samples.outside[row] * duration_s
    return JointSample(
        samples.time_s[row],
        durations,
        commands,
        outside,
        rates,
        velocities,
        timing_on_ticks(),
        attitudes,
        frames,
        speeds,
        shut_engine_burn(params.places.engines),
    )


@kernel
def _store_onset(past: Past, state: JointState, followed: Followed, cycle: float) -> None:
    """Stores the filter state as the newest onset in a free place, and the cycle's linearization."""
    stay = followed.keep.shape[0]
    past.places[:stay] = past.places[followed.keep]
    free = np.ones(ONSETS)
    free[past.places[:stay]] = 0.0
    place = np.argmax(free)
    past.places[stay] = place
    past.roots[place] = state.root
    fill(past.states[place], state)
    number = int(cycle) % past.excess.shape[0]
    fill(past.links[number], followed.link)
    past.excess[number] = 0.5 * (followed.link.nis - followed.link.degrees)


@kernel
def _mean_excess(excess: Array, oldest: float, cycle: float, newest: float) -> float:
    """Averages half the excess NIS stored of cycles after `oldest` and before `cycle`; `newest` if there are none."""
    total, count = 0.0, 0
    for number in range(int(oldest) + 1, int(cycle)):
        total += excess[number % excess.shape[0]]
        count += 1
    return total / count if count > 0 else newest


@kernel
def _fill_log_rows(
    rows: JointRows, row: int, impulses: Impulses, state_and_report: tuple[JointState, Report], params: JointParams
) -> None:
    """Writes impulses, rotation, mass and joint-filter values of a cycle into its log rows."""
    after, seen = state_and_report
    gyros, accelerometers = 3 * params.places.gyros, 3 * params.places.accelerometers
    fill(rows.impulses[row], (impulses.angular_impulse, impulses.linear_impulse, impulses.usable, impulses.firing))
    fill(rows.rotation_report[row], rotation_report(seen.estimate, seen.covariance, seen, gyros))
    fill(rows.mass_report[row], mass_report(seen.estimate, seen.covariance, seen, gyros, accelerometers))
    fill(rows.joint_report[row], (seen.gyro_degrees, seen.accelerometer_degrees, is_initialized(after, params)))


class Work:
    """Runner of the parts of the joint filter's cycle, compiled where asked, when it is made and not in a flight.

    Args:
        params: of the filter.
        compile_it: whether it is compiled.
    """

    def __init__(self, params: JointParams, *, compile_it: bool = True):
        self._work, self._compiled = compile_kernel_if(run_part, compile_it), compile_it
        self._params = make_holder(params, compile_it)
        state, sample = initial_joint_state(params), empty_sample(params.places)
        self._no_asked = make_holder(Asked(state, sample, params.thresholds, OWN_CHOICE, state.mean), compile_it)
        _, report = run_cycle(state, sample, params.thresholds, OWN_CHOICE, params)
        none = Roots(np.zeros((0, *state.root.shape)), np.arange(0))
        assert report.course is not None, "the first sample is no cycle"
        seen = collect_cycle_terms(state.mean, report.course, sample)
        following = Following(empty_bank(params.places).since, none, seen, 0.0, 0.0)
        self._no_following = make_holder(following, compile_it)
        self._no_memory = make_holder(initial_memory(state, params.places), compile_it)
        self._no_desk = make_holder(empty_buffers(params.places), compile_it)
        if compile_it:
            self.run_quiet_cycles(self._no_memory, self._no_desk)

    def run_quiet_cycles(self, memory: Any, buffers: Any) -> None:
        """Runs cycles up to a row, or to the first alarm or other event; both arguments are holders."""
        self._work(GO_ON, self._no_asked, self._no_following, memory, buffers, self._params)

    def run_cycle(
        self, state: JointState, sample: JointSample, thresholds: Array, counts: np.ndarray
    ) -> tuple[JointState, Report]:
        """Runs a joint filter's cycle after the first; returns state and report, see `joint_cycle.run_cycle`."""
        cycle, _, _ = self._run(CYCLE, Asked(state, sample, thresholds, counts, state.mean))
        return cycle

    def repeat_start_cycle(
        self, state: JointState, sample: JointSample, linearization_point: Array
    ) -> tuple[JointState, float, float]:
        """Repeats a cycle of the initialization, relinearized; see `relinearization.repeat_start_cycle`."""
        _, _, repeated = self._run(GO_OVER, Asked(state, sample, state.mean, OWN_CHOICE, linearization_point))
        return repeated

    def _run(self, part: int, arguments: Asked) -> Any:
        """Runs one part of a joint filter's cycle; returns the results of all parts, None for others."""
        given = make_shared_holder(arguments, self._compiled)
        return self._work(part, given, self._no_following, self._no_memory, self._no_desk, self._params)

    def follow_cycle(self, arguments: Following) -> Followed:
        """Advances a bank of possible fault onsets over a cycle and tests them, see `bank.follow_cycle`."""
        given = make_shared_holder(arguments, self._compiled)
        _, found, _ = self._work(FOLLOW, self._no_asked, given, self._no_memory, self._no_desk, self._params)
        return found


def with_compiled(params: JointParams) -> JointParams:
    """Returns the joint filter's parameters with its cycle compiled for them."""
    return params._replace(compiled=Work(params))
