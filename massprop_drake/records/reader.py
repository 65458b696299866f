"""Recorded telemetry: sensor readings and jet commands, one row per sample.

Written as CSV; read from CSV, Parquet or a stream, block by block, put in order and judged by the way.
"""

from __future__ import annotations

import bisect
import difflib
import math
import sys
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import IO

import numpy as np
from numpy.typing import NDArray

from massprop_drake.errors import InputError, moment
from massprop_drake.inputs import factors
from massprop_drake.inputs.vehicle_file import Vehicle
from massprop_drake.maths.signals import AXES
from massprop_drake.maths.vehicle.on_times import onsets
from massprop_drake.records.blocks import Block, Table
from massprop_drake.records.cadence import FIRST_INTERVALS, Cadence, HeldRows, rows_with_values
from massprop_drake.records.command_scales import CommandTally, scale_hint
from massprop_drake.records.completeness import Loss
from massprop_drake.records.rows import (
    WRENCH,
    Array,
    Continuation,
    Flags,
    Record,
    Rows,
    jet_columns,
    on_time_columns,
    onset_columns,
    telemetry_columns,
)
from massprop_drake.records.tables import CsvTable, open_table

JITTER = 0.05  # of the sample period: by so much rows may be early or late
AT_STAMPS = 0.5  # of it where commands switch with them: what is farther is another row
ROUNDING = 1e-6  # of either: times of a million seconds have no more digits
_FEW = 5  # missing columns that a message names
EXACT = 1e-3  # of the sample period: less is not counted as jitter
_SAME = 1e-6  # of the sample period: rows closer than this have one time
_FRACTION_TOLERANCE = 1e-9  # of a commanded fraction
_HOLE = 2.5  # sample periods: where rows may come at any time, longer is a gap
_STUCK_CLOCK = 25  # rows in a row whose time does not go on
_LISTED_GAPS = 5


class Reader:
    """Reads a record of a vehicle's telemetry, block by block, in time order.

    Iterating gives `Rows`. Rows whose time does not advance are left out. Missing rows are replaced by a
    single row without readings, so that differences start anew. Statistics are collected in `record`.

    Args:
        telemetry: a CSV or Parquet file, "-" for standard input, or an open table.
        vehicle: whose packages and jets name the columns.
        gyro: the package that must be there; None: a sensor in a fixed frame must.
        previous: go on from the end of an earlier part; its last row may be there again, and gives its command.
        stream: instead of a file; what is there is read row by row.
        rows_per_block: at most, of a file.

    Attributes:
        record: what has been found so far.
        before: command, outside wrench and onsets of the row before the first, with `previous`.
        velocity: integral of each acceleration so far, by package.
        jitter: of the sample period, by so much rows may be early or late; more is a gap; set before rows are read.
        own_times: whether rows come whenever anything is read, and commands hold in those that have none; likewise.

    Raises:
        InputError: with file, line and column, when the record cannot be used; also from the iteration.
    """

    def __init__(
        self,
        telemetry: str | Path | Table,
        vehicle: Vehicle,
        *,
        gyro: str | None,
        previous: Continuation | None = None,
        stream: IO[bytes] | None = None,
        rows_per_block: int = 1024,
    ):
        self.record = Record()
        self.jitter = JITTER
        self._vehicle = vehicle
        self._period_s = vehicle.sample_period_s
        self.own_times = False
        self._table: Table
        if not isinstance(telemetry, (str, Path)):
            self._table = telemetry
        elif stream is not None or str(telemetry) == "-":
            self._table = CsvTable(stream or sys.stdin.buffer, "standard input", 1)
        else:
            self._table = open_table(Path(telemetry), rows_per_block=rows_per_block)
        self.source = self._table.source
        self.record.notes, self.record.information = list(self._table.notes), list(self._table.information)
        try:
            self._plan_columns(gyro)
        except BaseException:
            self._table.close()
            raise
        self._after = previous
        self._awaiting = previous is not None
        n_jets = len(vehicle.jets)
        self.before: tuple[Array, Array, Array | None] = np.zeros(n_jets), np.zeros(6), None
        if previous is not None:
            self.before = previous.command, previous.outside_wrench, previous.onset_s
        start = {} if previous is None else previous.velocity
        self.velocity = {name: np.array(start.get(name, np.zeros(3))) for name in self._accelerations}
        self._held = HeldRows(n_jets, previous)
        self._cadence = {package.name: Cadence(package.rate_hz) for package in vehicle.sensors}
        self._last_s = math.nan if previous is None else previous.time_s
        self._before_s = self._last_s
        self._late_in_a_row = 0
        self._first_steps: list[float] = []
        self._tally = CommandTally(self._period_s)
        self._first: Block | None = None
        self._begun: Iterator[Block] | None = None

    @property
    def _any_time(self) -> bool:
        """True if rows may come at any time at which something is read, not at the sample period alone."""
        return self._vehicle.needs_pose_filter or self.own_times

    @property
    def done(self) -> float:
        """The fraction of the record read so far, 0 to 1; 0 for a stream."""
        return self._table.done

    @property
    def ragged(self) -> tuple[int, int, bool]:
        """Number of rows with the wrong number of cells, the line of the first, and whether the last was cut off."""
        rows = self._table.ragged
        return rows.count, rows.first_line, rows.last_incomplete

    @property
    def losses(self) -> Sequence[Loss]:
        """Losses of the record; complete once all of it has been read."""
        return self._table.losses

    def sha256(self) -> str:
        """Returns SHA-256 of the record, hexadecimal; valid once all of it has been read."""
        return self._table.sha256()

    def close(self) -> None:
        """Closes the table that is read."""
        self._table.close()

    # ----------------------------------------------------------------------------------- columns

    def _plan_columns(self, gyro: str | None) -> None:
        """Chooses the columns to read and sets their indices; raises InputError where one is missing."""
        vehicle, header = self._vehicle, self._table.header
        present = set(header)
        jets = jet_columns(vehicle, present)
        gyro_columns = [f"{gyro}_{axis}" for axis in AXES] if gyro is not None else []
        problems = self._describe_missing_columns(["time_s", *gyro_columns, *jets], present)
        self._wanted: list[int] = []
        self._accelerations: list[str] = []
        used: set[str] = set()

        def add(names: Iterable[str]) -> list[int]:
            """Adds columns to those to read, and returns their indices among these."""
            indices = []
            for name in names:
                used.add(name)
                self._wanted.append(header.index(name))
                indices.append(len(self._wanted) - 1)
            return indices

        self._sensor_places: dict[str, list[int]] = {}
        if not problems:
            add(["time_s"])
        for package in vehicle.sensors:
            names = [f"{package.name}_{axis}" for axis in AXES]
            accelerations = [f"{package.name}_accel_{axis}" for axis in AXES]
            if package not in vehicle.gyros and not present & set(names) and present & set(accelerations):
                names = accelerations
                self._accelerations.append(package.name)
            found = [name for name in names if name in present]
            if found and len(found) < 3:
                lacking = next(name for name in names if name not in present)
                if not any(lacking in problem for problem in problems):
                    problems.append(
                        f"{self.source}: has column '{found[0]}' but no '{lacking}'; give all three axes or none"
                        + suggest_column(lacking, present - used)
                    )
            elif found and not problems:
                self._sensor_places[package.name] = add(names)
            elif not found:
                self.record.absent.append(package.name)
        self._tracked = [index for index, name in enumerate(vehicle.tracked_columns) if name in present]
        self._tracked_places = [] if problems else add(vehicle.tracked_columns[index] for index in self._tracked)
        self.record.absent += [one.name for one in vehicle.tracked if not present & set(one.columns)]
        outside = [name for name in WRENCH if name in present]
        for what in ("torque", "force"):
            axes = [name for name in outside if name.startswith(f"known_{what}")]
            if axes and len(axes) < 3:
                problems.append(f"{self.source}: has column '{axes[0]}' but not all of known_{what}_x, _y, _z")
        if problems:
            raise InputError(*problems)
        self._outside = [WRENCH.index(name) for name in outside]
        self._outside_places = add(outside)
        self._command_places = add(jets)
        self._timed = np.array([name in on_time_columns(vehicle) for name in jets])
        opening = onset_columns(vehicle)
        self._opening = [jet for jet, name in enumerate(opening) if name in present]
        self._opening_places = add(opening[jet] for jet in self._opening)
        known = [name for name in [*telemetry_columns(vehicle), *WRENCH] if name not in present]
        self.record.unknown = {
            name: _closest_name(name, known) for name in dict.fromkeys(header) if name and name not in used
        }

    def _describe_missing_columns(self, required: list[str], present: set[str]) -> list[str]:
        """Returns the message on required columns that the table lacks, in a list; empty: none."""
        missing = [name for name in required if name not in present]
        sensors = self._vehicle.tracked
        if sensors and not self._vehicle.gyros and not present & set(self._vehicle.tracked_columns):
            missing.insert(1, sensors[0].columns[0])
        if not missing:
            return []
        names_text = ", ".join(missing[:_FEW]) + (f" and {len(missing) - _FEW} more" if len(missing) > _FEW else "")
        unknown = present - set(telemetry_columns(self._vehicle))
        sensors_text = "its gyro's three axes" if self._vehicle.gyros else "its sensors"
        hint = next((hint for hint in (suggest_column(name, unknown) for name in missing) if hint), "")
        return [
            f"{self.source}: no column{'s' if len(missing) > 1 else ''} {names_text}{hint}; vehicle "
            f"'{self._vehicle.name}' needs time_s, {sensors_text} and a column for each jet"
            + ("; 'massprop map' proposes what another program's columns mean" if len(missing) > _FEW else "")
        ]

    # -------------------------------------------------------------------------------------- rows

    def __iter__(self) -> Iterator[Rows]:
        try:
            for block in self._blocks():
                self._check_commands(block)
                ordered = self._order_rows(block)
                if ordered is not None:
                    yield ordered
        finally:
            self._table.close()
        self._require_period(at_end=True)
        if doubt := self._tally.doubt():
            self.record.notes.insert(0, doubt)
        if not self.record.rows:
            later = (
                ""
                if self._after is None
                else f" later than {moment(self._after.time_s)} s, where the earlier run ended"
            )
            raise InputError(f"{self.source}: has no usable row{later}; expected a row per sample")

    def _blocks(self) -> Iterator[Block]:
        """Yields the table's blocks, also a first one that was read in advance."""
        if self._begun is None:
            self._begun = iter(self._table.blocks(self._wanted))
        if self._first is not None:
            yield self._first
        yield from self._begun

    def readings_per_s(self) -> float | None:
        """Returns the rate of rows, 1/s, if these come faster than samples; None with one a sample.

        Looks at the first block, which is read as ever afterwards. Rows are so where some have no commands, and come
        faster than samples do.
        """
        self._begun = iter(self._table.blocks(self._wanted))
        self._first = next(self._begun, None)
        if self._first is None:
            return None
        times = self._first.values[:, 0]
        times = times[np.isfinite(times)]
        steps = np.diff(times)
        steps = steps[steps > 0.0]
        has_commands = ~np.isnan(self._first.values[:, self._command_places]).all(axis=1)
        dense = steps.size and float(np.median(steps)) < self._period_s * (1.0 - JITTER)
        if not dense or (has_commands.all() and not self._table.own_times):
            return None
        return float(steps.size / steps.sum())

    def _check_commands(self, block: Block) -> None:
        """Raises InputError for commands that are no fractions, on-times or onsets within the sample."""
        self._check_on_times(block)
        commands = np.where(self._timed, np.nan, block.values[:, self._command_places])
        self._tally.add(commands)
        wrong = (commands < -_FRACTION_TOLERANCE) | (commands > 1.0 + _FRACTION_TOLERANCE)
        if not wrong.any():
            return
        row, jet = np.argwhere(wrong)[0]
        value, column = float(commands[row, jet]), f"jet_{self._vehicle.designations[jet]}"
        hint = scale_hint(commands, self._period_s)
        raise InputError(
            f"{self._table.where(int(block.lines[row]), column)}, column {column}: "
            f"{value:g} is no fraction of 0 to 1{hint}"
        )

    def _check_on_times(self, block: Block) -> None:
        """Raises InputError for an on-time beyond the sample period, or an onset and on-time that end after it."""
        period_s, cells = self._period_s, block.values[:, self._command_places]
        wrong = self._timed & ((cells < 0.0) | (cells > period_s * (1.0 + JITTER)))
        if wrong.any():
            row, jet = np.argwhere(wrong)[0]
            column = on_time_columns(self._vehicle)[jet]
            raise InputError(
                f"{self._table.where(int(block.lines[row]), column)}, column {column}: {cells[row, jet]:g} s is no "
                f"on-time of 0 to {period_s:g} s, the sample period"
            )
        on_s = np.where(self._timed, cells, cells * period_s)[:, self._opening]
        opens_s = block.values[:, self._opening_places]
        late = ((opens_s < 0.0) | (opens_s + on_s > period_s * (1.0 + ROUNDING))) & (on_s > 0.0) & (on_s <= period_s)
        if late.any():
            row, index = np.argwhere(late)[0]
            column = onset_columns(self._vehicle)[self._opening[index]]
            raise InputError(
                f"{self._table.where(int(block.lines[row]), column)}, column {column}: opens after "
                f"{opens_s[row, index]:g} s for {on_s[row, index]:g} s, which is not within the sample of "
                f"{period_s:g} s"
            )

    def _read_commands(self, values: Array) -> tuple[Array, Array | None]:
        """Returns commands of rows as fractions, and onsets, s, shape (n, n_jets) each; None: jets switch at rows."""
        commands = values[:, self._command_places]
        commands = np.where(self._timed, np.minimum(commands / self._period_s, 1.0), commands)
        vehicle = self._vehicle
        if not (vehicle.has_on_times or self._timed.any() or self._opening):
            return commands, None
        onsets_s = onsets(commands, vehicle.jet_commands.at, self._period_s)
        recorded = values[:, self._opening_places]
        onsets_s[:, self._opening] = np.where(np.isnan(recorded), onsets_s[:, self._opening], recorded)
        return commands, onsets_s

    def _order_rows(self, block: Block) -> Rows | None:
        """Returns a block's rows that advance in time, with an empty row at each gap; None: no row."""
        times = block.values[:, 0]
        steps = np.diff(times, prepend=self._last_s)
        off = ~self._are_regular(steps)
        if not self._awaiting and not off.any():
            self._count_intervals(steps, self.record.interval_sum_s + float(steps.sum()))
            self._last_s = float(times[-1])
            self._late_in_a_row = 0
            return self._make_rows(block, np.arange(times.size), {})
        # rows that follow a row in use by a period are taken together, others one by one
        ends = [*np.flatnonzero(off).tolist(), times.size]
        chosen: list[int] = []
        gap_times: dict[int, float] = {}
        index = 0
        while index < times.size:
            end = ends[bisect.bisect_left(ends, index)]
            previous_s = self._last_s if index == 0 else times[index - 1]
            if end > index and not self._awaiting and self._last_s == previous_s:
                self._count_intervals(steps[index:end], _accumulate_steps(self.record.interval_sum_s, steps[index:end]))
                chosen.extend(range(index, end))
                self._last_s, self._late_in_a_row = float(times[end - 1]), 0
                index = end
            else:
                self._append_row(index, float(times[index]), block, chosen, gap_times)
                index += 1
        return self._make_rows(block, np.array(chosen, dtype=int), gap_times) if chosen else None

    def _are_regular(self, steps: Array) -> Flags:
        """Flags time steps to the next row without a gap, within the jitter; not NaN ones."""
        if self._any_time:
            within: Flags = (steps > _SAME * self._period_s) & (steps <= _HOLE * self._period_s)
            return within
        follows: Flags = np.abs(steps - self._period_s) <= self.jitter * self._period_s * (1.0 + ROUNDING)
        return follows

    def _append_row(
        self, index: int, time: float, block: Block, chosen: list[int], gap_times: dict[int, float]
    ) -> None:
        """Appends a row's index to the chosen ones, after a gap's where there is one, or counts why it is left out."""
        record, period = self.record, self._period_s
        line = int(block.lines[index])
        if math.isnan(time):
            record.without_time += 1
            return
        step = time - self._last_s
        if self._awaiting:
            if abs(step) <= JITTER * period:  # the row at which the earlier part ended
                self.before = self._state_at_boundary(block, index)
                self._last_s = time
                self._awaiting = False
                return
            if step < 0.0:
                record.before_start += 1
                return
            self._awaiting = False
        if step <= _SAME * period:
            is_same = abs(step) <= _SAME * period
            record.duplicates += is_same
            record.backward += not is_same
            record.first_late_line = record.first_late_line or line
            self._late_in_a_row += 1
            if self._late_in_a_row >= _STUCK_CLOCK:
                raise InputError(
                    f"{self._table.where(line, 'time_s')}: time_s has not gone beyond {self._last_s:.10g} s for "
                    f"{_STUCK_CLOCK} rows, here {time:.10g}; has the clock been set back? Give the parts one by one"
                )
            return
        self._late_in_a_row = 0
        if not math.isnan(step):
            if self._are_regular(np.array([step]))[0]:
                self._count_intervals(np.array([step]), record.interval_sum_s + step)
            else:
                gap_times[len(chosen)] = self._last_s + min(period, 0.5 * step)
                chosen.append(-1)
                record.gaps += 1
                record.gap_sum_s += step
                record.longest_gap_s = max(record.longest_gap_s, step)
                if len(record.first_gaps) < _LISTED_GAPS:
                    record.first_gaps.append((self._last_s, step))
                self._watch_period([step])
        chosen.append(index)
        self._last_s = time

    def _state_at_boundary(self, block: Block, index: int) -> tuple[Array, Array, Array | None]:
        """Returns commands, outside wrench and onsets in the row at which the earlier part ended."""
        values = block.values[index]
        wrench = np.zeros(6)
        wrench[self._outside] = np.nan_to_num(values[self._outside_places])
        commands, onsets_s = self._read_commands(values[None])
        if self.own_times and np.isnan(commands).all() and self._after is not None:
            return self._after.command, self._after.outside_wrench, self._after.onset_s
        return np.clip(commands[0], 0.0, 1.0), wrench, None if onsets_s is None else onsets_s[0]

    def _count_intervals(self, steps: Array, sum_s: float) -> None:
        """Counts the intervals between rows in the record, and those with jitter."""
        record = self.record
        size = np.abs(steps - self._period_s)
        record.intervals += steps.size
        record.interval_sum_s = sum_s
        record.jitter += int((size > EXACT * self._period_s).sum())
        record.largest_jitter_s = max(record.largest_jitter_s, float(size.max()))
        self._watch_period(steps.tolist())

    def _watch_period(self, steps: list[float]) -> None:
        """Collects the first intervals between rows, and checks the sample period once there are enough."""
        n_missing = FIRST_INTERVALS - len(self._first_steps)
        if n_missing > 0:
            self._first_steps.extend(steps[:n_missing])
            if len(self._first_steps) == FIRST_INTERVALS:
                self._require_period()

    def _require_period(self, *, at_end: bool = False) -> None:
        """Raises InputError where rows have another median interval than the vehicle's sample period."""
        seldom = self.own_times and not at_end
        if (self._any_time and not seldom) or not self._first_steps:
            return
        if at_end and len(self._first_steps) == FIRST_INTERVALS:
            return
        median = float(np.median(self._first_steps))
        off = median > _HOLE * self._period_s if seldom else abs(median - self._period_s) > JITTER * self._period_s
        if off:
            units = [one.words for one in factors.factors_near(median / self._period_s, factors.time_factors())]
            looks = f", as with {units[0]}" if units else ""
            raise InputError(
                f"{self.source}: rows are {median:.6g} s apart, but the sample period of vehicle "
                f"'{self._vehicle.name}' is {self._period_s:g} s{looks}; resample the record, or set sample_period_s"
            )

    def _make_rows(self, block: Block, chosen: NDArray[np.int_], gap_times: dict[int, float]) -> Rows:
        """Makes filter rows from the chosen rows of a block, with an empty one at each gap."""
        values = block.values[chosen]
        recorded = chosen >= 0
        for row, time in gap_times.items():
            values[row] = np.nan
            values[row, 0] = time
        record = self.record
        times = values[:, 0]
        if not record.rows:
            record.first_s = float(times[recorded][0])
        record.last_s = float(times[-1])
        record.rows += int(recorded.sum())

        readings, steps = {}, self._sample_lengths(times)
        for name in self._vehicle.sensor_names():
            indices = self._sensor_places.get(name)
            reading = np.full((chosen.size, 3), np.nan) if indices is None else values[:, indices]
            if indices is not None:
                read = times[recorded], reading[recorded]
                n_missing = self._cadence[name].count_missing(*read) if self.own_times else _count_rows_lacking(read[1])
                record.missing[name] = record.missing.get(name, 0) + n_missing
            if name in self._accelerations:
                since_s = self._cadence[name].steps(times, reading, self._period_s) if self.own_times else steps
                reading = self._integrate(name, reading, since_s)
            readings[name] = reading
        outside = None
        if self._outside:
            outside = np.zeros((chosen.size, 6))
            outside[:, self._outside] = values[:, self._outside_places]
        commands, onsets_s = self._read_commands(values)
        commands = np.clip(commands, 0.0, 1.0)
        has_commands: Flags | None = None
        if self.own_times:
            has_commands, signals = rows_with_values(commands), (commands, onsets_s, outside)
            commands, onsets_s, outside = self._held.fill_in(times, recorded, signals, self._period_s)
        if outside is not None:
            outside = np.nan_to_num(outside)
        tracked = None
        if self._vehicle.tracked:
            tracked = np.full((chosen.size, len(self._vehicle.tracked_columns)), np.nan)
            tracked[:, self._tracked] = values[:, self._tracked_places]
        return Rows(times, readings, commands, outside, recorded, tracked, onsets_s, has_commands)

    def _sample_lengths(self, times: Array) -> Array:
        """Computes the length of the sample that ends with each row, s, shape (n, 1)."""
        if not self._any_time:
            return np.full((times.size, 1), self._period_s)
        first = self._before_s if math.isfinite(self._before_s) else float(times[0]) - self._period_s
        self._before_s = float(times[-1])
        return np.diff(times, prepend=first)[:, None]

    def _integrate(self, name: str, acceleration: Array, steps_s: Array) -> Array:
        """Integrates mean accelerations to velocity, from the last block's; NaN where missing, shape (n, 3)."""
        missing = np.isnan(acceleration)
        steps = np.where(missing, 0.0, acceleration) * steps_s
        velocity = np.cumsum(np.vstack([self.velocity[name], steps]), axis=0)[1:]
        self.velocity[name] = velocity[-1].copy()
        return np.where(missing, np.nan, velocity)


def _count_rows_lacking(reading: Array) -> int:
    """Counts the readings that lack any component."""
    return int(np.isnan(reading).any(axis=1).sum())


def _accumulate_steps(start: float, steps: Array) -> float:
    """Returns the start plus all steps, added one by one so that rounding equals that of single rows."""
    return float(np.add.accumulate([start, *steps.tolist()])[-1])


def _closest_name(word: str, valid: Iterable[str]) -> str:
    """Returns the valid name most like a word, upper or lower case; "": none is close."""
    by_lower = {name.lower(): name for name in valid}
    matches = difflib.get_close_matches(word.lower(), list(by_lower), n=1, cutoff=0.75)
    return by_lower[matches[0]] if matches else ""


def suggest_column(missing: str, unknown: Iterable[str]) -> str:
    """Returns a hint for a message, that an unknown column may be the missing one; "": none looks like it."""
    similar = _closest_name(missing, unknown)
    return f" (is '{similar}' meant to be '{missing}'?)" if similar else ""
