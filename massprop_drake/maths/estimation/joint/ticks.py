r"""When commands switched within an interval between two readings, from the stamps of the readings alone.

Commands switch at ticks of the control computer, a sample period apart; a reading is stamped when it was taken, which
may be a little before or after its tick. So the interval from one stamp to the next may begin with an end of the
command before, or end with the beginning of the one that comes, and its length is the stamps' difference.

Ticks are not recorded. They are estimated from the stamps by a Kalman filter of two states, the tick and the period,
that takes a stamp as its tick with an error of `_JITTER`. Stamps on a grid of the sample period are ticks themselves.
Otherwise the filter says how well a tick is known, and over that time what switches at it has a command that is not
known: a millisecond of a large jet moves a fine gyro by many steps.

Rows that are missing: one or two in a row are bridged, with the command of both sides where these are equal, and as
not known where they differ. After a longer gap, and over the interval that follows it, in which thrust settles, rate
and gathered velocity begin anew: nobody knows what happened meanwhile.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from massprop_drake.maths.arrays import FLAG, NUMBER, Layout
from massprop_drake.maths.estimation.joint.impulses import pieces
from massprop_drake.maths.kernels import kernel
from massprop_drake.maths.linear_algebra import Array

_EXACT = 1e-6  # of the period: less is rounding of a stamp
_NEAR = 0.05  # of the period: by so much a reading may be off the sample period after the one before
_SHARP = 1e-5  # of the period: 1-sigma of a tick that is as good as known
_JITTER = 0.01  # of the period: 1-sigma of a stamp about its tick
_PERIOD = 1e-3  # relative 1-sigma of the period at the beginning
_TICK_NOISE, _PERIOD_NOISE = 1e-6, 1e-7  # of the period: 1-sigma of what both change by at a tick
_LONGEST = 3.0  # periods that are bridged


class Clock(NamedTuple):
    """What is known of time after a sample.

    Attributes:
        stamp_s: of the last reading.
        tick_s: when its tick was, from which the present command acts.
        period_s: estimated.
        variances: of the errors of tick and period, and their covariance, in periods squared, shape (3,).
        lost: whether the last interval was too long to be bridged.
        earlier: the command up to that tick, NaN where not known, shape (n_jets,).
    """

    stamp_s: float
    tick_s: float
    period_s: float
    variances: Array
    lost: bool
    earlier: Array


CLOCK = Layout("clock", stamp_s=NUMBER, tick_s=NUMBER, period_s=NUMBER, variances=3, lost=FLAG, earlier="jets")


class Elapsed(NamedTuple):
    """An interval between two readings.

    Attributes:
        durations_s, commands: its pieces, see `impulses.fire`, shapes (n_pieces,) and (n_pieces, n_jets).
        anew: whether it tells nothing of how the vehicle moved.
    """

    durations_s: Array
    commands: Array
    anew: bool


def started(stamp_s: float, command: Array, period_s: float) -> Clock:
    """The clock at the first reading, or after a gap.

    Args:
        stamp_s: of the reading.
        command: up to it, shape (n_jets,).
        period_s: sample period.
    """
    variances = np.array([_JITTER**2, _PERIOD**2, 0.0])
    return Clock(stamp_s, stamp_s, period_s, variances, False, command)


def elapsed(
    clock: Clock, stamp_s: float, command: Array, coming: Array | None, period_s: float
) -> tuple[Clock, Elapsed]:
    """What happened from the last reading to this one, and the clock then.

    Args:
        clock: after the last reading.
        stamp_s: of this one, later.
        command: of the row before, NaN where not known, shape (n_jets,).
        coming: of this row; None: not known yet.
        period_s: sample period.
    """
    length = stamp_s - clock.stamp_s
    known = command
    bridged = length <= _LONGEST * period_s
    if bridged and coming is not None:
        known = np.where(np.isnan(command) & (clock.earlier == coming), coming, command)
    off_period, off_tick = abs(length - period_s), stamp_s - (clock.tick_s + clock.period_s)
    if on_time(clock, stamp_s, period_s):
        after = clock._replace(stamp_s=stamp_s, tick_s=stamp_s, lost=False, earlier=known)
        return after, Elapsed(np.array([period_s]), known.reshape(1, -1), clock.lost)
    if off_period > _NEAR * period_s * (1.0 + 1e-9):
        after = started(stamp_s, known, period_s)._replace(lost=not bridged)
        return after, Elapsed(np.array([length]), known.reshape(1, -1), clock.lost or not bridged)
    after = _ticked(clock, off_tick, period_s)._replace(stamp_s=stamp_s, lost=False, earlier=known)
    ticks, commands = [clock.tick_s - clock.period_s, clock.tick_s], [clock.earlier, known]
    if coming is not None:
        ticks.append(after.tick_s)
        commands.append(coming)
    began_s, acting = np.array(ticks), np.stack(commands)
    sigma = float(np.sqrt(after.variances[0]))
    if sigma > _SHARP:
        began_s, acting = _blurred(began_s, acting, sigma * period_s)
    durations, told = pieces(clock.stamp_s, stamp_s, began_s, acting)
    return after, Elapsed(durations, told, clock.lost)


@kernel
def on_time(clock: Clock, stamp_s: float, period_s: float) -> bool:
    """Whether a stamp is a sample period after the last one, and at its tick; arguments as those of `elapsed`."""
    off_period, off_tick = abs(stamp_s - clock.stamp_s - period_s), stamp_s - (clock.tick_s + clock.period_s)
    return max(off_period, abs(off_tick)) <= _EXACT * period_s


def _blurred(ticks_s: Array, commands: Array, sigma_s: float) -> tuple[Array, Array]:
    """Commands that are not known about each tick, where they differ, for as long as makes the variance that of a tick.

    A level that is not known over 2 sigma has the variance sigma^2; all jets that switch at a tick are early or late
    together, which as if each were by itself is covered by the root of their number times as long.

    Args:
        ticks_s: when each command began to act, ascending, shape (n,).
        commands: which then acted until the next tick, shape (n, n_jets).
        sigma_s: 1-sigma of a tick.
    """
    times, told = [ticks_s[:1]], [commands[:1]]
    for tick_s, before, after in zip(ticks_s[1:], commands[:-1], commands[1:], strict=True):
        differs = before != after
        half_s = sigma_s * np.sqrt(np.count_nonzero(differs))
        if differs.any():
            times.append(np.array([tick_s - half_s, tick_s + half_s]))
            told.append(np.stack((np.where(differs, np.nan, after), after)))
    return np.concatenate(times), np.concatenate(told)


def _ticked(clock: Clock, off_tick: float, period_s: float) -> Clock:
    """The clock's estimates after a stamp that is so much later than its tick was expected."""
    tick, period, both = clock.variances
    tick, both = tick + 2.0 * both + period + _TICK_NOISE**2, both + period
    period = period + _PERIOD_NOISE**2
    total = tick + _JITTER**2
    of_tick, of_period = tick / total, both / total
    variances = np.array([tick * (1.0 - of_tick), period - of_period * both, both * (1.0 - of_tick)])
    return clock._replace(
        tick_s=clock.tick_s + clock.period_s + of_tick * off_tick,
        period_s=clock.period_s + of_period * off_tick,
        variances=variances,
    )
