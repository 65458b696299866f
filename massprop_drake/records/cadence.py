"""Commands that hold between rows, and readings at rates of their own."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from massprop_drake.maths.vehicle.on_times import level_onsets, rest_of_sample
from massprop_drake.records.rows import Array, Continuation, Flags

FIRST_INTERVALS = 20  # in which the sample period must show
HELD = 1.2  # sample periods for which a command holds in rows that have none; longer, it is not known
_LATE_READING = 1.5  # of the interval between readings: what is longer lacks one


class HeldRows:
    """Commands and outside wrench that hold in rows which have none.

    Args:
        n_jets: number of jets.
        after: see `Reader`.
    """

    def __init__(self, n_jets: int, previous: Continuation | None):
        self._command = np.full(n_jets, np.nan) if previous is None else previous.command
        self._onset_s = level_onsets(n_jets) if previous is None or previous.onset_s is None else previous.onset_s
        self._wrench = np.zeros(6) if previous is None else previous.outside_wrench
        self._told_s = -math.inf if previous is None else previous.time_s
        self._pushed_s = self._told_s

    def fill_in(
        self, times: Array, recorded: Flags, signals: tuple[Array, Array | None, Array | None], period_s: float
    ) -> tuple[Array, Array | None, Array | None]:
        """Returns commands, onsets and outside wrench by row; rows without values hold those of an earlier row.

        Args:
            times: of the rows, s, shape (n,).
            recorded: see `Rows`.
            signals: commands, onsets and wrench as they stand in the rows, NaN where they do not.
            period_s: sample period.
        """
        commands, onsets_s, wrench = signals
        earlier_and_new = np.vstack((self._command, commands))
        opening = level_onsets(commands.shape) if onsets_s is None else onsets_s
        opens = np.vstack((self._onset_s, opening))
        age_s, index = _age_of_values(self._told_s, times, rows_with_values(commands))
        known = (age_s < HELD * period_s) & recorded
        held, acting_s = rest_of_sample(earlier_and_new[index], opens[index], np.where(known, age_s, 0.0), period_s)
        held[~known], acting_s[~known] = np.nan, np.nan
        self._command, self._onset_s = earlier_and_new[index[-1]], opens[index[-1]]
        self._told_s = float(times[-1] - age_s[-1])
        if wrench is not None:
            pushes = np.vstack((self._wrench, np.nan_to_num(wrench)))
            age_s, index = _age_of_values(self._pushed_s, times, rows_with_values(wrench))
            self._wrench, self._pushed_s = pushes[index[-1]], float(times[-1] - age_s[-1])
            wrench = np.where(((age_s < HELD * period_s) & recorded)[:, None], pushes[index], 0.0)
        return held, None if onsets_s is None else acting_s, wrench


def rows_with_values(values: Array) -> Flags:
    """Flags rows in which any column of commands or wrench is not NaN, shape (n,)."""
    flags: Flags = np.asarray((~np.isnan(values)).any(axis=1))
    return flags


def _age_of_values(earlier_s: float, times: Array, is_given: Flags) -> tuple[Array, NDArray[np.int_]]:
    """Computes the age of the value held in each row, s, and its row plus 1 (0: earlier), shape (n,) both."""
    row = np.maximum.accumulate(np.where(is_given, np.arange(1, times.size + 1), 0))
    return times - np.append(earlier_s, times)[row], row


class Cadence:
    """Times at which a package is read.

    Args:
        rate_hz: as stated; None: as the first readings have it.
    """

    def __init__(self, rate_hz: float | None):
        self._usual_s = None if rate_hz is None else 1.0 / rate_hz
        self._last_s = self._before_s = math.nan

    def count_missing(self, times: Array, reading: Array) -> int:
        """Returns the number of missing readings of a package in a block, or of incomplete ones if larger."""
        complete = ~np.isnan(reading).any(axis=1)
        partly = int((~complete & ~np.isnan(reading).all(axis=1)).sum())
        read_s = np.append(self._last_s, times[complete]) if math.isfinite(self._last_s) else times[complete]
        steps = np.diff(read_s)
        if self._usual_s is None and steps.size >= FIRST_INTERVALS:
            self._usual_s = float(np.median(steps))
        self._last_s = float(read_s[-1]) if read_s.size else self._last_s
        if self._usual_s is None or not steps.size:
            return partly
        long = steps[steps > _LATE_READING * self._usual_s]
        return max(int((np.round(long / self._usual_s) - 1.0).sum()), partly)

    def steps(self, times: Array, reading: Array, period_s: float) -> Array:
        """Computes the time since the previous reading, s, zero in rows without a reading, shape (n, 1)."""
        complete = ~np.isnan(reading).any(axis=1)
        read_s, steps = times[complete], np.zeros((times.size, 1))
        if read_s.size:
            first = self._before_s if math.isfinite(self._before_s) else read_s[0] - (self._usual_s or period_s)
            steps[complete, 0] = np.diff(read_s, prepend=first)
            self._before_s = float(read_s[-1])
        return steps
