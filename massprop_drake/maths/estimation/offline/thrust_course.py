"""Course of the jets' thrust over a stretch of a record, and data of the stretch that depend on no unknown."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from massprop_drake.maths.estimation.joint.lagged_impulses import (
    LEAST_LAG,
    Lingering,
    initial_level_decay,
    integrate_thrust,
)
from massprop_drake.maths.estimation.joint.layout import MASS
from massprop_drake.maths.estimation.offline.flight_model import FlightModel, Stretch, columns
from massprop_drake.maths.estimation.offline.record_kernels import add_decayed_sums
from massprop_drake.maths.linear_algebra import Array
from massprop_drake.maths.vehicle.on_times import is_pulse, split_sample

_EXACT = 1e-6  # of the period: less is rounding of a stamp
Lengths = float | Array  # of all intervals, or of each, s


def weigh_by_length(terms: Array, lengths_s: Lengths) -> Array:
    """Multiplies terms by their intervals' lengths where these differ; else returns them as they are."""
    return terms * lengths_s if isinstance(lengths_s, np.ndarray) else terms


def common_length(lengths_s: Lengths) -> float:
    """Returns the common length of all intervals, s; 1 where lengths differ, see `weigh_by_length`."""
    return 1.0 if isinstance(lengths_s, np.ndarray) else lengths_s


class RecordedStretch(NamedTuple):
    """Data of a stretch that do not depend on the unknowns."""

    stretch: Stretch
    period_s: Lengths  # of the ticks; of rows at times of their own lengths of the intervals, (m - 1,)
    late_s: Array  # of each stamp after its tick, (m,)
    lengths_s: Array  # from each switching to the next, (m - 1,)
    on: NDArray[np.int_]  # the jets that acted, (j,)
    commands: Array  # of these, (m - 1, j)
    rate: Array  # (3, m), straight where none is read; zero about an axis of which none ever is
    there: NDArray[np.bool_]  # whether it is read, or zero, (3, m)
    known: NDArray[np.bool_]  # whether any gyro has read the axis, (3,)
    to_use: Array  # propellant from no tank that is still to be used, in the middle of each interval, (m - 1,)
    readings: Array  # (n_packages, 3, m)
    momenta: Array  # of each wheel, by its speeds as read and its inertia as stated, straight where none is, (w, 3, m)
    to_draw: Array  # from each tank, beyond the middle of the stretch, in the middle of each interval, (n, m - 1)
    by_draw: Array  # derivatives of elements 0 to 8 by that, about the middle, (n, 9)
    shifts: Array  # of elements 0 to 8 by what is drawn, from those of the middle, (9, m - 1)
    through: MiddleDerivatives | None = None  # None: without tanks


def prepare_stretch(stretch: Stretch, model: FlightModel) -> RecordedStretch:
    """Computes a stretch's data that depend on no unknown: gyro rates, firing jets, late stamps, propellant drawn."""
    told = (stretch.commands[:-1] != 0.0).any(axis=0)
    on = np.flatnonzero(told | (stretch.before != 0.0).any(axis=0))
    rates = np.ascontiguousarray(stretch.readings[:, : model.gyros].transpose(1, 2, 0))
    there = np.asarray(~np.isnan(rates).all(axis=0))
    known = np.asarray(there.any(axis=1))
    there[~known] = True
    mean = np.nansum(rates, axis=0) / np.maximum((~np.isnan(rates)).sum(axis=0), 1)  # of gyros that read
    rate = interpolate_missing(mean, there, row_positions(stretch, model))
    readings = np.ascontiguousarray(stretch.readings.transpose(1, 2, 0))
    period, late = _fit_ticks(stretch.time_s, model.period_s)
    lengths = np.full(late.shape[0] - 1, period)
    if model.at_stamps:
        lengths, late = np.diff(stretch.time_s), np.zeros_like(late)
    drawn, momenta = drawn_propellant(stretch, model), _wheel_momenta(stretch, model)
    left = stretch.used_after - drawn.sum(axis=0)
    to_use, to_draw = 0.5 * (left[:-1] + left[1:]), 0.5 * (drawn[:, :-1] + drawn[:, 1:])
    none = np.zeros((drawn.shape[0], MASS)), np.zeros((MASS, to_use.size))
    of_tanks = to_draw - drawn[:, drawn.shape[1] // 2, None], *none
    commands, each = stretch.commands[:-1, on], lengths if model.own_times else period
    seen = stretch, each, late, lengths, on, commands, rate, there, known, to_use, readings, momenta
    return RecordedStretch(*seen, *of_tanks)


def drawn_propellant(stretch: Stretch, model: FlightModel) -> Array:
    """Computes propellant drawn from each tank between each row and the end of the flight, shape (n, m)."""
    if stretch.seconds is None or not model.tanks.fill.size:
        return np.zeros((0, stretch.time_s.size))
    return np.asarray((model.tanks.feeds * model.flows) @ stretch.seconds[:, 1].T)


class MiddleDerivatives(NamedTuple):
    """Derivatives of the parameters in the middle of a stretch by the unknowns.

    Attributes:
        by: derivative of the ten parameters there by all unknowns, shape (10, n).
        slopes: derivatives of `RecordedStretch.by_draw` by these, shape (n_tanks, 9, n).
        by_jets: derivative of `RecordedStretch.to_draw` by each thrust error, shape (n_tanks, n_jets, m - 1).
    """

    by: Array
    slopes: Array
    by_jets: Array


def row_positions(stretch: Stretch, model: FlightModel) -> Array:
    """Returns rows' abscissas for interpolation, (m,): times, s, or row numbers where rows follow the command clock."""
    return stretch.time_s if model.own_times else np.arange(stretch.time_s.size, dtype=np.float64)


def _wheel_momenta(stretch: Stretch, model: FlightModel) -> Array:
    """Computes each wheel's angular momentum at the rows, (w, 3, m); zero for wheels never read."""
    wheels = model.wheels
    if stretch.speeds is None:
        return np.zeros((0, 3, stretch.time_s.size))
    record = np.asarray(~np.isnan(stretch.speeds.T))
    record[~record.any(axis=1)] = True
    speeds = np.nan_to_num(interpolate_missing(stretch.speeds.T, record, row_positions(stretch, model)))
    return np.asarray((wheels.inertias[:, None] * wheels.axes)[:, :, None] * speeds[:, None])


class ThrustCourse(NamedTuple):
    """Course of the jets' thrust over a stretch, by rows; jets that are not listed gave none."""

    read: RecordedStretch
    amount: Array  # seconds of full thrust, (m - 1, j)
    by_lag: Array  # its derivative by the time constant
    lacking: Array  # how far each level is off at the beginning, (m - 1, j): times
    shape: Array  # it is the bow, see `Firing`, s, (3, j), or by interval (3, m - 1, j)
    level: Array  # at each stamp, (m, j), where one is late
    bent: Array | None  # bow besides, of jets that open or close within a sample, s, (3, m - 1, j)


def thrust_course(record: RecordedStretch, unknowns: Array, model: FlightModel) -> ThrustCourse:
    """Computes impulse, lag derivative and level of each firing jet over a stretch, interval by interval."""
    on, commands, period, late = record.on, record.commands, record.period_s, record.late_s
    m = late.shape[0]
    given, lag_error = model.time_constants_s[on], unknowns[columns(model).lag][model.kinds][on]
    constants = np.where(given > 0.0, np.maximum(given + lag_error, LEAST_LAG * given), 0.0)
    each = period[:, None] if isinstance(period, np.ndarray) else period
    lagged, left = constants > 0.0, initial_level_decay(constants / each)
    before = record.stretch.before[:, on]
    level = np.concatenate((before, commands))
    slope, tick_s = np.zeros_like(level), model.period_s if model.own_times else period
    pulses = _pulse_corrections(record, constants, left, tick_s)
    if pulses is not None:
        level = level + pulses.tends
    if lagged.any() and isinstance(period, np.ndarray):
        _apply_lag_by_interval(level, slope, left)
    elif lagged.any():
        model.compute.lag(level, slope, left.remaining, left.by_logarithm)
    if pulses is not None:
        slope += pulses.slope
    level, slope = level[-m:], slope[-m:]
    off = level[:-1] - commands
    amount = record.lengths_s[:, None] * commands + off * (each * left.mean)
    share = each / np.where(lagged, constants, 1.0)
    by_lag = off * (share * (left.mean - left.remaining)) + slope[:-1] * (share * left.mean)
    if pulses is not None:
        amount = amount + pulses.amount
        by_lag = by_lag + pulses.by_logarithm / np.where(lagged, constants, 1.0)
    if not lagged.all():
        lost = level[:-1] - level[1:]
        by_lag = np.where(lagged, by_lag, lost)
        amount = amount + np.where(lagged, 0.0, lost * lag_error)
    if late.any():
        told = record.stretch.commands[:, on]
        sided = np.where((late > 0.0)[:, None] & (np.arange(m) < m - 1)[:, None], told, level)
        level = np.where(lagged, level, np.nan_to_num(sided))
    bent = None if pulses is None else pulses.bow
    return ThrustCourse(record, amount, by_lag, off, each * left.bow, level, bent)


def _apply_lag_by_interval(level: Array, level_slope: Array, lingering: Lingering) -> None:
    """Applies valve lag to levels, in place, over intervals of different lengths; see `apply_lag`."""
    since = level.shape[0] - lingering.remaining.shape[0]
    for row in range(1, level.shape[0]):
        of = max(row - since, 0)
        off = level[row - 1] - level[row]
        level[row] += off * lingering.remaining[of]
        level_slope[row] = level_slope[row - 1] * lingering.remaining[of] + off * lingering.by_logarithm[of]


class _Pulses(NamedTuple):
    """Corrections for jets that open or close within samples, to commands that are levels.

    The lag is linear: what a sample begins with dies away beside what its command does to jets that were shut. So
    impulses and bows differ by those of shut jets, and levels go on as if another level had been commanded.
    """

    tends: Array  # what that level is above the command, (b + m - 1, j)
    slope: Array  # what derivatives of levels by ln tau are besides, likewise
    amount: Array  # of impulses, s, (m - 1, j)
    by_logarithm: Array  # derivative of these by ln tau
    bow: Array  # see `Firing`, s, (3, m - 1, j)


def _pulse_corrections(
    record: RecordedStretch, time_constants_s: Array, lingering: Lingering, period_s: Lengths
) -> _Pulses | None:
    """Computes corrections for jets that switch within samples, see `_Pulses`; None: none does."""
    stretch, on = record.stretch, record.on
    if stretch.onsets_s is None or stretch.before_onsets_s is None:
        return None
    commands = np.concatenate((stretch.before[:, on], record.commands))
    onsets_s = np.concatenate((stretch.before_onsets_s[:, on], stretch.onsets_s[:-1, on]))
    rows = np.flatnonzero(is_pulse(commands, onsets_s).any(axis=1)).tolist()
    if not rows:
        return None
    tends, late, amount, by_logarithm = (np.zeros_like(commands) for _ in range(4))
    bow, shut, no_ticks = np.zeros((3, *commands.shape)), np.zeros((3, on.size)), np.zeros((0, 2))
    since, alike = stretch.before.shape[0], not isinstance(record.period_s, np.ndarray)
    remaining, by_tau = (each if alike else each[np.maximum(np.arange(-since, len(each)), 0)] for each in lingering[:2])
    for row in rows:
        length_s = float(period_s if alike else record.lengths_s[max(row - since, 0)])
        own = split_sample(commands[row], onsets_s[row], float(period_s), (0.0, length_s))
        pulse = integrate_thrust((shut[0], shut[1], shut[2]), time_constants_s, *own, no_ticks)
        whole = np.array([length_s]), commands[row : row + 1]
        kept, slower = (remaining, by_tau) if alike else (remaining[row], by_tau[row])
        level = integrate_thrust((shut[0], shut[1], shut[2]), time_constants_s, *whole, no_ticks)
        tends[row] = (pulse.level - level.level) / (1.0 - kept)
        late[row] = pulse.slope - level.slope + tends[row] * slower
        amount[row] = pulse.amount - level.amount
        by_logarithm[row] = pulse.amount_slope - level.amount_slope
        bow[:, row] = pulse.bow - level.bow
    late[0] = 0.0
    if alike:
        add_decayed_sums(late, lingering.remaining)
    else:
        for row in range(1, late.shape[0]):
            late[row] += late[row - 1] * remaining[row]
    return _Pulses(tends, late, amount[since:], by_logarithm[since:], bow[:, since:])


def _fit_ticks(time_s: Array, period_s: float) -> tuple[float, Array]:
    """Fits the command clock's period to stamps; returns it, s, and how late each stamp is, s, (m,)."""
    counts = centered_counts(time_s.shape[0])
    since = time_s - time_s.mean()
    period = float(counts @ since) / float(counts @ counts)
    if abs(period - period_s) < _EXACT * period_s:
        period = period_s
    late = since - counts * period
    return period, np.where(np.abs(late) < _EXACT * period, 0.0, late)


def is_off_ticks(stretch: Stretch, model: FlightModel) -> bool:
    """Tests whether any time stamp of a stretch is off the command clock."""
    return not model.own_times and bool(_fit_ticks(stretch.time_s, model.period_s)[1].any())


def interpolate_missing(rate: Array, is_read: NDArray[np.bool_], rows: Array) -> Array:
    """Interpolates rates, shape (k, m), linearly at rows without a reading."""
    rate = rate.copy()
    for axis in np.flatnonzero(~is_read.all(axis=1)).tolist():
        rate[axis] = np.interp(rows, rows[is_read[axis]], rate[axis, is_read[axis]])
    return rate


def centered_counts(count: int) -> Array:
    """Returns row numbers relative to the middle of the rows, shape (count,)."""
    return np.arange(0.5 * (1.0 - count), 0.5 * count)
