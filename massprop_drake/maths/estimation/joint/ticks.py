"""Times within an interval between two readings at which commands switched, from the stamps of the readings.

Equations: theory page of the joint filter, "Stamps", "On-times" and "Unknown commands". Where pieces are cut is taken
from stamps alone, which is the same for every hypothesis: the state counts what its own ticks are later than that. By
how much stamps scatter about ticks is found from what they were off: with nu of the expected variance p + R that is
`JITTER` squared, as if seen in `_SEEN` stamps, and the mean of nu^2 - p. What is random about a switch close to its
reading counts as noise, here and once more in the next interval.

One or two missing rows are bridged. Their command is that of both sides where these are equal and the readings bear
that out, and else not known (`unknown`). After a longer gap, and over the interval that follows it, in which thrust
settles, rate and gathered velocity begin anew. Where a stamp is off any tick, ticks begin anew with it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from massprop_drake.maths.arrays import FLAG, NUMBER, Layout
from massprop_drake.maths.estimation.joint.covariance import joseph_update
from massprop_drake.maths.estimation.joint.layout import JointParams, JointState, replace_levels
from massprop_drake.maths.kernels import kernel
from massprop_drake.maths.linear_algebra import Array
from massprop_drake.maths.vehicle.on_times import split_sample

_EXACT = 1e-6  # of the period: less is rounding of a stamp
_NEAR = 0.05  # of the period: by so much a reading may be off so many periods after the one before
JITTER = 0.01  # of the period: 1-sigma of a stamp about its tick
PERIOD = 1e-3  # relative 1-sigma of the period at the beginning
_SEEN = 10.0  # stamps that what is expected of them counts as
_LEAST = 1e-4  # of what is expected of one
_NOISE = 1e-4  # of these sigmas: 1-sigma of what offset and period change by at a tick
LONGEST = 3.0  # periods that are bridged
_FAR = 6.0  # sigmas from a reading to a tick that is on one side of it
_EDGE = 1e-6  # of the period: from a reading to a tick that belongs to its interval


class Clock(NamedTuple):
    """Clock after a sample, estimated from stamps alone.

    Attributes:
        stamp_s: of the last reading.
        tick_s: of the line t_0 + k T when its tick was, from which the present command acts.
        number: k of it.
        off: whether stamps are off their ticks, so that there is a line.
        about_s: its offset and period error, shape (2,).
        covariance: of their errors, s^2, shape (2, 2).
        at_s: when that tick was, as estimated with its stamp.
        rest_s: by how much it was later than the stamp, expected; what acted before the stamp left out.
        acted: share of its derivative that belongs to the interval before the stamp, Phi.
        spread: variance of what is not linear in it, s^2.
        scatter: sum of what stamps were off their ticks squared, less what is due to these, s^2.
        seen: number of them.
        lost: whether the last interval was too long to be bridged.
        earlier, earlier_onset_s: the command up to that tick, NaN where not known, and its onsets, NaN where it is a
            level, shape (n_jets,) each.
    """

    stamp_s: float
    tick_s: float
    number: float
    off: bool
    about_s: Array
    covariance: Array
    at_s: float
    rest_s: float
    acted: float
    spread: float
    scatter: float
    seen: float
    lost: bool
    earlier: Array
    earlier_onset_s: Array


CLOCK = Layout(
    "clock",
    stamp_s=NUMBER,
    tick_s=NUMBER,
    number=NUMBER,
    off=FLAG,
    about_s=2,
    covariance=(2, 2),
    at_s=NUMBER,
    rest_s=NUMBER,
    acted=NUMBER,
    spread=NUMBER,
    scatter=NUMBER,
    seen=NUMBER,
    lost=FLAG,
    earlier="jets",
    earlier_onset_s="jets",
)


class Timing(NamedTuple):
    """Timing of an interval's pieces relative to ticks that are not known.

    Attributes:
        off: whether they are; nothing else has a meaning where not.
        anew: whether a line of ticks begins: nothing is known of it.
        late_s: the stamp at the end of the interval less its tick of the line.
        jitter: variance of a stamp about its tick, s^2.
        numbers: k of the ticks at the beginning and at the end of the interval, and of those with which edges go at
            which jets open or close within a sample, shape (2 + any,).
        edges: see `lagged_impulses.integrate_thrust`, shape (n_pieces, 2 + any); none where not off.
        beyond_s: by how much these ticks are later than where the pieces have them, in that shape.
        shares: of the derivative by each tick that belongs to this interval, likewise.
        spreads: variance of each tick that is not linear in it, s^2, likewise.
        about_s: offset and period error at which both are taken, shape (2,).
    """

    off: bool
    anew: bool
    late_s: float
    jitter: float
    numbers: Array
    edges: Array
    beyond_s: Array
    shares: Array
    spreads: Array
    about_s: Array


class Elapsed(NamedTuple):
    """An interval between two readings.

    Attributes:
        durations_s, commands: its pieces, see `lagged_impulses.integrate_thrust`.
        timing: see `Timing`.
        anew: whether it tells nothing of how the vehicle moved.
    """

    durations_s: Array
    commands: Array
    timing: Timing
    anew: bool


@kernel
def timing_on_ticks() -> Timing:
    """Returns the timing of an interval whose stamps coincide with command ticks: no offsets."""
    none = np.zeros(2)
    return Timing(False, False, 0.0, 0.0, none, np.zeros((0, 2)), none, none, none, none)


@kernel
def start_clock(stamp_s: float, command: Array, onset_s: Array) -> Clock:
    """Returns a clock that begins at a reading's stamp, first or after a gap, with no line of command ticks estimated.

    Args:
        stamp_s: of the reading.
        command, onset_s: up to it, see `Commanded`.
    """
    none, covariance = np.zeros(2), np.zeros((2, 2))
    return Clock(
        stamp_s, stamp_s, 0.0, False, none, covariance, stamp_s, 0.0, 0.0, 0.0, 0.0, 0.0, False, command, onset_s
    )


class Pace(NamedTuple):
    """Times at which commands switch.

    Attributes:
        period_s: sample period.
        at_stamps: whether they do at stamps, whenever these are, and not at regular ticks.
    """

    period_s: float
    at_stamps: bool = False


class Commanded(NamedTuple):
    """Command of the jets for a sample and its onsets, see `maths.vehicle.on_times`, shape (n_jets,) each."""

    command: Array
    onset_s: Array


def fill_missing_command(clock: Clock, stamp_s: float, commands: tuple[Array, Array | None], pace: Pace) -> Array:
    """Returns the last row's command, missing jets as in the rows before and after where these agree, (n_jets,)."""
    command, next_command = commands
    if next_command is None or stamp_s - clock.stamp_s > LONGEST * pace.period_s:
        return command
    filled: Array = np.where(np.isnan(command) & (clock.earlier == next_command), next_command, command)
    return filled


def measure_interval(
    clock: Clock, stamp_s: float, commands: tuple[Commanded, Commanded | None], pace: Pace
) -> tuple[Clock, Elapsed]:
    """Computes pieces of constant command between two readings, and the updated clock.

    Args:
        clock: after the last reading.
        stamp_s: of this one, later.
        commands: of the row before, NaN where not known, and of this row, None: not known yet.
    """
    (told, next_commanded), (period_s, at_stamps) = commands, pace
    length = stamp_s - clock.stamp_s
    short = length <= LONGEST * period_s
    if is_on_time(clock, stamp_s, period_s):
        whole = split_sample(*told, period_s, (0.0, period_s))
        return start_clock(stamp_s, *told), Elapsed(*whole, timing_on_ticks(), clock.lost)
    passed = max(round(length / period_s), 1)
    off_ticks = abs(length - passed * period_s)
    near = off_ticks <= _NEAR * period_s * (1.0 + _EXACT) and (clock.off or off_ticks > _EXACT * period_s)
    if at_stamps or not (short and near):
        after = start_clock(stamp_s, *told)._replace(lost=not short)
        return after, Elapsed(*split_sample(*told, period_s, (0.0, length)), timing_on_ticks(), clock.lost or not short)
    sigma_s = period_s * np.array([JITTER, PERIOD])
    line = clock if clock.off else clock._replace(covariance=np.diag(sigma_s**2))
    jitter = max(_SEEN * sigma_s[0] ** 2 + line.scatter, _LEAST * sigma_s[0] ** 2) / (_SEEN + line.seen)
    updated = _update_clock(line, stamp_s, (passed, period_s), sigma_s, jitter)
    if next_commanded is not None:
        row = np.array([1.0, updated.number])
        variance = float(row @ updated.covariance @ row)
        acted_s, acted, spread = _acting_time_moments(stamp_s - updated.at_s, math.sqrt(max(variance, 0.0)))
        updated = updated._replace(rest_s=updated.rest_s + acted_s, acted=acted, spread=spread)
    updated = updated._replace(earlier=told.command, earlier_onset_s=told.onset_s)
    return updated, Elapsed(*_divide_interval(clock, updated, next_commanded, jitter, period_s), clock.lost)


def _update_clock(clock: Clock, stamp_s: float, periods: tuple[int, float], sigma_s: Array, jitter: float) -> Clock:
    """Updates the clock's tick offset and period by one stamp; seconds that a command acted before it set to zero."""
    line_s, number = clock.tick_s + periods[0] * periods[1], clock.number + periods[0]
    noise = _NOISE * np.array([[sigma_s[0], -number * sigma_s[1]], [0.0, sigma_s[1]]])
    covariance, row = clock.covariance + noise @ noise.T, np.array([1.0, number])
    off_s, gain = stamp_s - line_s - float(row @ clock.about_s), covariance @ row
    before = float(row @ gain)
    about_s = clock.about_s + gain * (off_s / (before + jitter))
    at_s = line_s + float(row @ about_s)
    return clock._replace(
        stamp_s=stamp_s,
        tick_s=line_s,
        number=number,
        off=True,
        about_s=about_s,
        covariance=covariance - np.outer(gain, gain) / (before + jitter),
        at_s=at_s,
        rest_s=at_s - stamp_s,
        acted=0.0,
        spread=0.0,
        scatter=clock.scatter + off_s * off_s - before,
        seen=clock.seen + 1.0,
        lost=False,
    )


def _acting_time_moments(late_s: float, sigma_s: float) -> tuple[float, float, float]:
    """Computes mean, derivative, variance of seconds a new command acted before a reading late by N(late, sigma^2)."""
    if abs(late_s) >= _FAR * sigma_s:
        return max(late_s, 0.0), float(late_s > 0.0), 0.0
    z = late_s / sigma_s
    below, density = 0.5 * math.erfc(-z / math.sqrt(2.0)), math.exp(-0.5 * z * z) / math.sqrt(2.0 * math.pi)
    mean = z * below + density
    spread = (z * z + 1.0) * below + z * density - mean * mean - below * below
    return sigma_s * mean, below, sigma_s * sigma_s * max(spread, 0.0)


def _divide_interval(
    before: Clock, after: Clock, next_commanded: Commanded | None, jitter: float, period_s: float
) -> tuple[Array, Array, Timing]:
    """Divides an interval where commands switch, at ticks off its stamps; returns durations, commands and timing."""
    about_s = after.about_s
    moved_s = (before.tick_s + about_s[0] + about_s[1] * before.number) - before.at_s
    rest_s, margin_s = before.rest_s + (1.0 - before.acted) * moved_s, _EDGE * period_s
    earlier, told = (Commanded(clock.earlier, clock.earlier_onset_s) for clock in (before, after))
    begins = before.acted < 1.0 and not np.array_equal(earlier, told, equal_nan=True)
    ends = after.acted > 0.0
    true_s = np.array([before.stamp_s + rest_s, after.at_s - after.rest_s])  # of the share that counts in this interval
    put_s = true_s.copy()
    put_s[0] = min(max(true_s[0], before.stamp_s + margin_s), after.stamp_s - 2.0 * margin_s)
    put_s[1] = min(max(true_s[1], put_s[0] + margin_s), after.stamp_s - margin_s)
    which = np.flatnonzero([begins, ends])
    times_s = np.concatenate(([before.stamp_s], put_s[which], [after.stamp_s]))
    begin_s = before.tick_s + about_s[0] + about_s[1] * before.number
    acting = [(told, begin_s, before.number)]  # since when each has been in force, and which tick that is
    if begins:
        acting = [(earlier, begin_s - period_s, before.number - 1.0), *acting]
    if ends:
        assert next_commanded is not None, "nothing has acted of what is not known"
        acting = [*acting, (next_commanded, after.at_s, after.number)]
    rows = np.zeros((times_s.size, 2 + len(acting)))
    rows[1 + np.arange(which.size), which] = 1.0
    lengths, levels, edges = [], [], [rows[:1]]
    for place, (command, since_s, _) in enumerate(acting):
        begin, end = times_s[place] - since_s, times_s[place + 1] - since_s
        own_s, own_levels = split_sample(*command, period_s, (begin, end))
        own_s[0] += times_s[place + 1] - times_s[place] - own_s.sum()  # to the last digit
        within = np.zeros((own_s.size - 1, rows.shape[1]))
        within[:, 2 + place] = 1.0
        lengths.append(own_s)
        levels.append(own_levels)
        edges += [within, rows[place + 1 : place + 2]]
    others = np.zeros(len(acting))
    timing = Timing(
        off=True,
        anew=not before.off,
        late_s=after.stamp_s - after.tick_s,
        jitter=jitter,
        numbers=np.array([before.number, after.number, *(number for _, _, number in acting)]),
        edges=np.diff(np.concatenate(edges), axis=0),
        beyond_s=np.append(np.where([begins, ends], true_s - put_s, 0.0), others),
        shares=np.append([1.0 - before.acted, after.acted], others + 1.0),
        spreads=np.append([before.spread, after.spread], others),
        about_s=about_s,
    )
    return np.concatenate(lengths), np.concatenate(levels), timing


@kernel
def is_on_time(clock: Clock, stamp_s: float, period_s: float) -> bool:
    """Tests whether stamps have coincided with ticks until now, and this one is a sample period after the last."""
    return not clock.off and abs(stamp_s - clock.stamp_s - period_s) <= _EXACT * period_s


class Stamped(NamedTuple):
    """Update of the state by a stamp.

    Attributes:
        row: h, derivative of the stamp by the state, shape (size,).
        gain: k of the update by it, shape (size,).
        correction: of the mean, shape (size,).
        kept: 0 where a line of ticks begins, of which nothing is known; else 1.
    """

    row: Array
    gain: Array
    correction: Array
    kept: float


@kernel
def update_by_stamp(state: JointState, timing: Timing, params: JointParams) -> tuple[JointState, Stamped]:
    """Updates the state's tick offset and period by an interval's final stamp; returns state, linearized update."""
    places = params.places
    row, gain, correction = np.zeros(places.size), np.zeros(places.size), np.zeros(places.size)
    if not timing.off or places.n_ticks == 0:
        return state, Stamped(row, gain, correction, 1.0)
    offset, period, number = places.ticks, places.ticks + 1, timing.numbers[1]
    mean, root, tick_slope, columns = state.mean.copy(), state.root.copy(), state.tick_slope, np.zeros((places.size, 4))
    if timing.anew:
        mean[offset : period + 1] = 0.0
        root[offset : period + 1] = 0.0
        tick_slope = np.zeros_like(tick_slope)
        columns[offset, 0] = columns[period, 1] = 1.0
    columns[offset, 2] = columns[period, 3] = _NOISE  # the period's does not move the tick itself
    columns[offset, 3] = -_NOISE * number * params.tick_sigma[1] / params.tick_sigma[0]
    wide = np.hstack((root, columns))
    row[offset], row[period] = params.tick_sigma[0], params.tick_sigma[1] * number
    variance, innovation = np.full(1, timing.jitter), np.full(1, timing.late_s - row @ mean)
    update = joseph_update(wide, (row @ wide).reshape(1, -1), variance, innovation, places.thrust)
    correction = update.correction
    moved_s = params.tick_sigma * correction[offset : period + 1]
    after = replace_levels(state, mean + correction, update.root, state.level + moved_s @ tick_slope, tick_slope)
    return after, Stamped(row, update.half_gain[:, 0] / update.upper[0, 0], correction, 0.0 if timing.anew else 1.0)
