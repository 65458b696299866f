"""Clock of a topic: found by names of columns and by how their numbers rise."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from massprop_drake.errors import InputError
from massprop_drake.inputs.units import si_factor
from massprop_drake.maths.linear_algebra import Array
from massprop_drake.records.names import ColumnName, si_factor_or_none
from massprop_drake.records.reader import JITTER
from massprop_drake.records.stamps import parse_stamp
from massprop_drake.records.topics import Topic

_RISES = 0.99  # share of rows in which a clock must go on
_UNITS = ("s", "ms", "us", "ns")
_DECIMALS = 9  # of seconds to which stamps are rounded at the most


class TopicClock(NamedTuple):
    """Stamps of a topic.

    Attributes:
        data: of a map's `time`.
        reason: a sentence.
        coarse: a sentence on stamps too coarse for the sample period; "": they are not.
    """

    data: dict[str, Any]
    reason: str
    coarse: str


class _ClockColumn(NamedTuple):
    """Times of a column in a possible unit, s."""

    data: dict[str, Any]
    times_s: Array
    why: str

    @property
    def steps(self) -> Array:
        """Differences, s, of successive times that are finite, shape (n - 1,)."""
        return np.diff(self.times_s[np.isfinite(self.times_s)])

    @property
    def rises(self) -> bool:
        """True if the times advance from row to row, but for rare exceptions."""
        return bool(self.steps.size) and float((self.steps > 0.0).mean()) > _RISES


def find_clock(topic: Topic, names: Sequence[ColumnName], period_s: float) -> TopicClock | None:
    """Finds the column, or pair of seconds and fraction, that times a topic's rows; None where there is none."""
    timed = [name for name in names if name.is_timed]
    clocks = [
        *_find_split_times(topic, names),
        *(one for name in timed for one in _read_time_column(topic, names, name, period_s)),
    ]
    if not any(one.rises for one in clocks):
        clocks += [
            one
            for name in names
            if name not in timed and _is_text(topic, name)
            for one in _read_time_column(topic, names, name, period_s)
        ]
    rising = [one for one in clocks if one.rises]
    if rising:
        best = min(rising, key=lambda one: not _steps_divide_period(one.steps, period_s))
        return TopicClock(best.data, f"time: {best.why}", _describe_coarse_stamps(best, period_s, rises=True))
    coarse = [one for one in clocks if one.steps.size and one.steps.min() >= 0.0 and one.steps.max() > 0.0]
    guessed = _find_rising_column(topic, names, period_s)
    if guessed is not None:
        return guessed
    if coarse:
        return TopicClock({}, "", _describe_coarse_stamps(coarse[0], period_s, rises=False))
    return None


def _is_text(topic: Topic, name: ColumnName) -> bool:
    """Tests whether a column of a topic holds text, not numbers."""
    return topic.columns[name.column].dtype == object


def _steps_divide_period(steps: Array, period_s: float) -> bool:
    """Tests whether the sample period is a whole multiple of the median time step, within the jitter."""
    step = float(np.median(steps))
    count = max(round(period_s / step), 1) if step > 0.0 else 1
    return abs(step * count - period_s) <= JITTER * period_s


def _is_date(topic: Topic, name: ColumnName) -> bool:
    """Tests whether a column holds dates without a time of day."""
    if not _is_text(topic, name):
        return False
    cells = topic.texts(name.column)
    return any(cells) and all(":" not in cell and parse_stamp(cell) is not None for cell in cells)


def clock_fault(topic: Topic, names: Sequence[ColumnName], period_s: float) -> str:
    """Describes a column that may be a time but falls, cannot be read, or has no known unit; "": there is none."""
    for name in names:
        if not name.is_timed:
            continue
        try:
            times_s = topic.times_s(name.column, 1.0)
        except InputError as error:
            return "; ".join(error.problems)
        steps = np.diff(times_s[np.isfinite(times_s)])
        if steps.size and float((steps < 0.0).mean()) > _RISES:
            return f"column {name.column} falls from row to row: are the rows in reverse order? Sort them by time"
    for name in names:
        numeric = topic.columns[name.column].dtype.kind in "biuf"
        if numeric and math.isfinite(step := _even_step(topic.numbers(name.column))):
            return (
                f"column {name.column} rises by {step:.6g} a row, which in {', '.join(_UNITS)} is not the sample "
                f"period of {period_s:g} s: if it is the time, give its unit, too"
            )
    return ""


def _read_time_column(
    topic: Topic, names: Sequence[ColumnName], name: ColumnName, period_s: float
) -> list[_ClockColumn]:
    """Reads a column as times, s, in its name's unit or one that fits the sample period; empty where it cannot."""
    column = name.column
    if _is_text(topic, name):
        cells = topic.texts(column)
        if not cells or not any(cells) or any(parse_stamp(cell) is None for cell in cells):
            return []
        data = {"column": column}
        of_day = all(re.match(r"\s*(\d\d?:\d\d|$)", cell) for cell in cells)  # a time without a date
        date = next((one.column for one in names if _is_date(topic, one)), None) if of_day else None
        if date is not None:
            data["date"] = date
        meaning = "stamps of date and time" if date is None else f"time of day, of the dates in column {date}"
        return [_ClockColumn(data, topic.times_s(column, 1.0, date), f"column {column}, {meaning}")]
    try:
        numbers = topic.numbers(column)
    except InputError:
        return []
    unit, why = name.unit, "as its name says"
    steps = np.diff(numbers[np.isfinite(numbers)])
    steps = steps[steps > 0.0]
    if not steps.size:
        return []
    if (
        not unit
        or si_factor_or_none(unit, "time") is None
        or not _steps_divide_period(steps * si_factor(unit, "time"), period_s)
    ):
        step = float(np.median(steps))
        nearest = min(_UNITS, key=lambda one: abs(math.log(step * si_factor(one, "time") / period_s)))
        known = bool(unit) and si_factor_or_none(unit, "time") is not None
        if not known or _steps_divide_period(steps * si_factor(nearest, "time"), period_s):
            unit = nearest
            why = f"since its steps of {step:.6g} are nearest to the sample period of {period_s:g} s so"
    text = f"column {column}, which rises from row to row, in {unit} {why}"
    return [_ClockColumn({"column": column, "unit": unit}, numbers * si_factor(unit, "time"), text)]


def _find_split_times(topic: Topic, names: Sequence[ColumnName]) -> list[_ClockColumn]:
    """Finds pairs of columns of whole seconds and fractions of a second; returns their times, s."""
    timed = [
        name
        for name in names
        if (name.is_timed or name.is_fraction or si_factor_or_none(name.unit or "1", "time") is not None)
        and not _is_text(topic, name)
    ]
    clocks = []
    for whole in timed:
        seconds = topic.numbers(whole.column)
        if whole.unit not in ("", "s", "sec", "secs", "seconds") or whole.is_fraction or _is_fractional(seconds):
            continue
        for part in timed:
            rest = topic.numbers(part.column)
            unit = part.unit if part.unit and si_factor_or_none(part.unit, "time") is not None else _fraction_unit(rest)
            alike = part.words == whole.words or part.is_fraction
            if part is whole or not alike or not unit or (si_factor(unit, "time") >= 1.0 and not _is_fractional(rest)):
                continue
            fraction = rest * si_factor(unit, "time")
            if (
                not np.isfinite(fraction).any()
                or np.nanmin(fraction) < 0.0
                or np.nanmax(fraction) >= 1.0
                or not np.nanmax(fraction)
            ):
                continue
            data = {"column": whole.column, "unit": "s", "fraction": part.column, "fraction_unit": unit}
            why = f"whole seconds in column {whole.column}, and {unit} below them in column {part.column}"
            clocks.append(_ClockColumn(data, seconds + fraction, why))
    return clocks


def _is_fractional(values: Array) -> bool:
    """Tests whether any finite value is no whole number."""
    finite = values[np.isfinite(values)]
    return bool((finite != np.round(finite)).any())


def _fraction_unit(values: Array) -> str:
    """Returns the unit, "s", "ms", "us" or "ns", in which all values are just below a second; "": none."""
    largest = float(np.nanmax(values, initial=0.0))
    if _is_fractional(values):
        return "s" if largest < 1.0 else ""
    return next((unit for unit in ("ms", "us", "ns") if 0.0 < largest < 1.0 / si_factor(unit, "time")), "")


def _even_step(times: Array) -> float:
    """Returns the step by which numbers rise from row to row, within the jitter; NaN where they do not."""
    steps = np.diff(times[np.isfinite(times)])
    if steps.size < 2 or not (steps > 0.0).mean() > _RISES:
        return math.nan
    step = float(np.median(steps))
    return step if float(np.median(np.abs(steps - step))) <= JITTER * step else math.nan


def _find_rising_column(topic: Topic, names: Sequence[ColumnName], period_s: float) -> TopicClock | None:
    """Finds a column that rises evenly, in a unit of time by its name, else by a sample period; None: there is none."""
    unnamed = {name.column: si_factor_or_none(name.unit or "1", "time") is None for name in names}
    for name in sorted(names, key=lambda one: unnamed[one.column]):
        for clock in [] if _is_text(topic, name) else _read_time_column(topic, names, name, period_s):
            step_s = _even_step(clock.times_s)
            if abs(step_s - period_s) <= (JITTER * period_s if unnamed[name.column] else math.inf):
                return TopicClock(clock.data, f"time: {clock.why}: a guess", "")
    return None


def _describe_coarse_stamps(clock: _ClockColumn, period_s: float, *, rises: bool) -> str:
    """Describes time stamps that are too coarse to time the rows; "" where they are fine enough."""
    steps = clock.steps
    column = clock.data["column"]
    if not rises:
        longest = int(np.diff(np.flatnonzero(steps > 0.0), prepend=0).max())
        return (
            f"the stamps of column {column} are coarse: they stand still for up to {longest} rows and then go on by "
            f"{float(steps.max()):.4g} s, which does not time rows of {period_s:g} s; log finer stamps, or name "
            "another column"
        )
    quantum = next((10.0**-n for n in range(_DECIMALS) if _is_multiple(steps, 10.0**-n)), 0.0)
    off = float(np.abs(steps - np.median(steps)).max())
    if quantum <= JITTER * period_s or off < 0.5 * quantum:
        return ""
    return (
        f"the stamps of column {column} are coarse, to {quantum:g} s, {100.0 * quantum / period_s:.2g} % of the sample "
        f"period: rows seem to come up to {off:.2g} s early or late, and what is off by more than {100.0 * JITTER:g} % "
        "of a period counts as a gap"
    )


def _is_multiple(steps: Array, quantum: float) -> bool:
    """Tests whether all time steps are whole multiples of a quantum."""
    scaled = steps / quantum
    return bool((np.abs(scaled - np.round(scaled)) < 1e-3).all())
