"""Recorded telemetry: sensor readings and jet commands, one row per sample.

Written as CSV; read from CSV, Parquet or a stream, block by block, put in order and judged by the way.
"""

from __future__ import annotations

import bisect
import csv
import difflib
import math
import re
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence, Set
from pathlib import Path
from typing import IO, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from massprop_drake.errors import InputError, moment
from massprop_drake.inputs import factors
from massprop_drake.inputs.scenario import Scenario, filter_of, resolved, set_field
from massprop_drake.inputs.vehicle_file import Vehicle
from massprop_drake.maths.vehicle.on_times import continued, levels_alone, onsets
from massprop_drake.records.command_scales import CommandTally, hint_about
from massprop_drake.records.tables import Block, CsvTable, Loss, Table, completeness, open_table
from massprop_drake.signals import AXES

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

JITTER = 0.05  # of the sample period: by so much rows may be early or late
AT_STAMPS = 0.5  # of it where commands switch with them: what is farther is another row
_ROUNDING = 1e-6  # of either: times of a million seconds have no more digits
_FEW = 5  # missing columns that a message names
_EXACT = 1e-3  # of the sample period: less is not counted as jitter
_SAME = 1e-6  # of the sample period: rows closer than this have one time
_FRACTION_TOLERANCE = 1e-9  # of a commanded fraction
_FIRST_INTERVALS = 20  # in which the sample period must show
_HOLE = 2.5  # sample periods: where rows may come at any time, longer is a gap
HELD = 1.2  # sample periods for which a command holds in rows that have none; longer, it is not known
_LATE_READING = 1.5  # of the interval between readings: what is longer lacks one
_STUCK_CLOCK = 25  # rows in a row whose time does not go on
_LISTED_GAPS = 5
_TURNING_FAST = {"rotation": {"coupling": "model"}, "mass": {"compensation": "transverse_centripetal"}}
WRENCH = tuple(f"known_{what}_{axis}" for what in ("torque", "force") for axis in AXES)


def columns(vehicle: Vehicle) -> list[str]:
    """Lists the column names in order: time, three axes per sensor package, each jet."""
    sensors = [f"{name}_{axis}" for name in vehicle.sensor_names() for axis in AXES]
    return ["time_s", *sensors, *vehicle.tracked_columns, *(f"jet_{jet}" for jet in vehicle.designations)]


def on_time_columns(vehicle: Vehicle) -> list[str]:
    """Lists the columns of on-times, a jet each."""
    return [f"on_{jet}_s" for jet in vehicle.designations]


def _jet_columns(vehicle: Vehicle, present: Set[str]) -> list[str]:
    """Returns the column of each jet's command: its fraction, or its on-time where a table has that alone."""
    names = zip(vehicle.designations, on_time_columns(vehicle), strict=True)
    fractions = ((f"jet_{jet}", timed) for jet, timed in names)
    return [timed if fraction not in present and timed in present else fraction for fraction, timed in fractions]


def onset_columns(vehicle: Vehicle) -> list[str]:
    """Lists the columns of onsets, a jet each."""
    return [f"onset_{jet}_s" for jet in vehicle.designations]


def scenario_name(telemetry: str | Path) -> str:
    """Derives a scenario's name from the name of a telemetry file."""
    stem = "stdin" if str(telemetry) == "-" else Path(telemetry).stem
    return re.sub(r"[^A-Za-z0-9_.-]+", "_", stem).lstrip("_.-") or "telemetry"


def vehicle_scenario(name: str, vehicle: str, overrides: list[str] | None = None) -> Scenario:
    """Makes a scenario of default settings for a vehicle.

    With the thesis's filters dynamic coupling and centripetal acceleration are modeled: a recorded vehicle may turn
    faster than the orbiter in its maneuvers.

    Args:
        name: of the scenario.
        vehicle: a bundled one's name, or the path of a file.
        overrides: `KEY=VALUE` each, as of `load_scenario`.

    Raises:
        InputError: when there is no such vehicle, or a setting is wrong.
    """
    data: dict[str, Any] = {"name": name, "vehicle": vehicle}
    for override in overrides or []:
        set_field(data, override)
    if filter_of(data) == "thesis":  # others have no such choice
        for block, keys in _TURNING_FAST.items():
            given = data.setdefault(block, {})
            if isinstance(given, dict):
                data[block] = {**keys, **given}
    return resolved(data)


class Rows(NamedTuple):
    """A block of rows in time order, ready for the filters.

    Attributes:
        time_s: of each row, s, shape (n,).
        readings: of each sensor package, NaN where missing, shape (n, 3).
        commands: fraction commanded over the interval that starts at the row's time, NaN where unknown,
            shape (n, n_jets).
        outside_wrench: known outside torque about the vehicle origin and force over that interval, mean,
            shape (n, 6); None: the record has none.
        recorded: whether the row is in the record; a row that fills a gap has neither readings nor
            commands, shape (n,).
        tracked: readings of the sensors in a fixed frame, as `Vehicle.tracked_columns` names them, NaN where missing,
            shape (n, columns); None: the vehicle has none.
        onsets_s: of the commands, see `maths.vehicle.on_times`, NaN where not told, shape (n, n_jets); None: jets
            switch with samples.
        told: rows that have commands of their own, shape (n,); None: all.
    """

    time_s: Array
    readings: Mapping[str, Array]
    commands: Array
    outside_wrench: Array | None
    recorded: Flags
    tracked: Array | None = None
    onsets_s: Array | None = None
    told: Flags | None = None

    def first(self, count: int) -> Rows:
        """Returns the first rows."""
        return self.chosen(slice(count))

    def chosen(self, which: slice | NDArray[np.int_]) -> Rows:
        """Returns some of the rows."""
        readings = {name: values[which] for name, values in self.readings.items()}
        outside, tracked, onsets_s = (
            None if part is None else part[which] for part in (self.outside_wrench, self.tracked, self.onsets_s)
        )
        told = None if self.told is None else self.told[which]
        recorded = self.recorded[which]
        return Rows(self.time_s[which], readings, self.commands[which], outside, recorded, tracked, onsets_s, told)


# ---------------------------------------------------------------------------------------- writing


def write_csv(path: Path, vehicle: Vehicle, rows: Iterable[Rows]) -> None:
    """Writes telemetry as CSV; every number reads back exactly, and NaN becomes an empty cell.

    Args:
        path: of the file.
        vehicle: whose packages and jets name the columns.
        rows: block by block; rows that only fill gaps are left out.
    """
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        heading = False
        for block in rows:
            outside = [] if block.outside_wrench is None else [block.outside_wrench]
            if not heading:
                opening = [] if block.onsets_s is None else onset_columns(vehicle)
                writer.writerow([*columns(vehicle), *opening, *(WRENCH if outside else ())])
                heading = True
            sensors = [block.readings[name] for name in vehicle.sensor_names()]
            tracked = [] if block.tracked is None else [block.tracked]
            onsets = [] if block.onsets_s is None else [block.onsets_s]
            parts = [block.time_s, *sensors, *tracked, block.commands, *onsets, *outside]
            table = np.column_stack(parts)[block.recorded]
            writer.writerows([_cell(value) for value in row] for row in table.tolist())


def _cell(value: float) -> str:
    if math.isnan(value):  # not measured, or not commanded
        return ""
    return str(int(value)) if value in (0.0, 1.0) else repr(value)


# ---------------------------------------------------------------------------------------- reading


class Record:
    """Statistics gathered while a record is read, for the quality report.

    Attributes:
        rows: taken; first_s, last_s: their times, s.
        intervals, interval_sum_s: those of about a sample period, and their sum.
        jitter, largest_jitter_s: intervals off by more than 0.1 % of the period, and the most.
        gaps, gap_sum_s, longest_gap_s, first_gaps: longer or shorter intervals; (time, length) of the first.
        duplicates, backward, first_late_line: rows left out because their time is that of the row before, or
            earlier; line of the first.
        without_time, before_start: rows left out that have no time, or were estimated from already.
        missing: rows in which a sensor package lacks a reading, by its name.
        absent: packages that the record does not have.
        unknown: columns not used, each with a name that may have been meant, or "".
        notes: of how the rows were made, a sentence each.
    """

    def __init__(self) -> None:
        self.rows = self.intervals = self.jitter = self.gaps = self.duplicates = self.backward = 0
        self.without_time = self.before_start = self.first_late_line = 0
        self.first_s = self.last_s = math.nan
        self.interval_sum_s = self.largest_jitter_s = self.gap_sum_s = self.longest_gap_s = 0.0
        self.first_gaps: list[tuple[float, float]] = []
        self.missing: dict[str, int] = {}
        self.absent: list[str] = []
        self.unknown: dict[str, str] = {}
        self.notes: list[str] = []

    @property
    def period_s(self) -> float | None:
        """Mean interval between rows without a gap, s."""
        return self.interval_sum_s / self.intervals if self.intervals else None


class Continuation(NamedTuple):
    """End of an earlier part of a record, from which reading continues.

    Attributes:
        time_s: of its last row.
        command: of that row, NaN where unknown, shape (n_jets,).
        outside_wrench: of that row, shape (6,).
        velocity: integral of each acceleration so far, by package, shape (3,) each.
        onset_s: of the command, NaN where not told, shape (n_jets,); None: jets switch with samples.
    """

    time_s: float
    command: Array
    outside_wrench: Array
    velocity: Mapping[str, Array]
    onset_s: Array | None = None


class Reader:
    """Reads a record of a vehicle's telemetry, block by block, in time order.

    Iterating gives `Rows`. Rows whose time does not advance are left out. Missing rows are replaced by a
    single row without readings, so that differences start anew. Statistics are collected in `record`.

    Args:
        telemetry: a CSV or Parquet file, "-" for standard input, or an open table.
        vehicle: whose packages and jets name the columns.
        gyro: the package that must be there; None: a sensor in a fixed frame must.
        after: go on from the end of an earlier part; its last row may be there again, and gives its command.
        stream: instead of a file; what is there is read row by row.
        rows_per_block: at most, of a file.

    Attributes:
        record: what has been found so far.
        before: command, outside wrench and onsets of the row before the first, with `after`.
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
        after: Continuation | None = None,
        stream: IO[bytes] | None = None,
        rows_per_block: int = 1024,
    ):
        self.record = Record()
        self.jitter = JITTER
        self._vehicle = vehicle
        self._period_s = vehicle.sample_period_s
        self.own_times = False
        if isinstance(telemetry, (str, Path)):
            self._table = _opened(telemetry, stream, rows_per_block)
        else:
            self._table = telemetry
        self.source = self._table.source
        self.record.notes = list(self._table.notes)
        try:
            self._plan(gyro)
        except BaseException:
            self._table.close()
            raise
        self._after = after
        self._awaiting = after is not None
        n_jets = len(vehicle.jets)
        self.before: tuple[Array, Array, Array | None] = np.zeros(n_jets), np.zeros(6), None
        if after is not None:
            self.before = after.command, after.outside_wrench, after.onset_s
        start = {} if after is None else after.velocity
        self.velocity = {name: np.array(start.get(name, np.zeros(3))) for name in self._accelerations}
        self._held = _Held(n_jets, after)
        self._cadence = {package.name: _Cadence(package.rate_hz) for package in vehicle.sensors}
        self._last_s = math.nan if after is None else after.time_s
        self._before_s = self._last_s
        self._late_in_a_row = 0
        self._first_steps: list[float] = []
        self._tally = CommandTally(self._period_s)
        self._first: Block | None = None
        self._begun: Iterator[Block] | None = None

    @property
    def _any_time(self) -> bool:
        """True if rows may come whenever something is read."""
        return self._vehicle.needs_pose_filter or self.own_times

    @property
    def done(self) -> float:
        """The fraction of the file read so far, 0 to 1; 0 for a stream."""
        return self._table.done

    @property
    def ragged(self) -> tuple[int, int, bool]:
        """Number of rows with the wrong number of cells, the line of the first, and whether the last was cut off."""
        found = self._table.ragged
        return found.count, found.first_line, found.last_incomplete

    @property
    def losses(self) -> Sequence[Loss]:
        """Losses of the record; all of them once it has been read."""
        return self._table.losses

    def sha256(self) -> str:
        """Returns SHA-256 of the record, hexadecimal; valid once it has been read."""
        return self._table.sha256()

    def close(self) -> None:
        """Closes the file."""
        self._table.close()

    # ----------------------------------------------------------------------------------- columns

    def _plan(self, gyro: str | None) -> None:
        """Decides which columns of the table to read, and where each lies among them."""
        vehicle, header = self._vehicle, self._table.header
        present = set(header)
        jets = _jet_columns(vehicle, present)
        own = [f"{gyro}_{axis}" for axis in AXES] if gyro is not None else []
        problems = self._missing_columns(["time_s", *own, *jets], present)
        self._wanted: list[int] = []
        self._accelerations: list[str] = []
        used: set[str] = set()

        def place(names: Iterable[str]) -> list[int]:
            places = []
            for name in names:
                used.add(name)
                self._wanted.append(header.index(name))
                places.append(len(self._wanted) - 1)
            return places

        self._sensor_places: dict[str, list[int]] = {}
        if not problems:
            place(["time_s"])
        for package in vehicle.sensors:
            names = [f"{package.name}_{axis}" for axis in AXES]
            accelerations = [f"{package.name}_accel_{axis}" for axis in AXES]
            if package not in vehicle.gyros and not present & set(names) and present & set(accelerations):
                names = accelerations
                self._accelerations.append(package.name)
            there = [name for name in names if name in present]
            if there and len(there) < 3:
                lacking = next(name for name in names if name not in present)
                if not any(lacking in problem for problem in problems):
                    problems.append(
                        f"{self.source}: has column '{there[0]}' but no '{lacking}'; give all three axes or none"
                        + _meant(lacking, present - used)
                    )
            elif there and not problems:
                self._sensor_places[package.name] = place(names)
            elif not there:
                self.record.absent.append(package.name)
        self._tracked = [index for index, name in enumerate(vehicle.tracked_columns) if name in present]
        self._tracked_places = [] if problems else place(vehicle.tracked_columns[index] for index in self._tracked)
        self.record.absent += [one.name for one in vehicle.tracked if not present & set(one.columns)]
        outside = [name for name in WRENCH if name in present]
        for what in ("torque", "force"):
            axes = [name for name in outside if name.startswith(f"known_{what}")]
            if axes and len(axes) < 3:
                problems.append(f"{self.source}: has column '{axes[0]}' but not all of known_{what}_x, _y, _z")
        if problems:
            raise InputError(*problems)
        self._outside = [WRENCH.index(name) for name in outside]
        self._outside_places = place(outside)
        self._command_places = place(jets)
        self._timed = np.array([name in on_time_columns(vehicle) for name in jets])
        opening = onset_columns(vehicle)
        self._opening = [jet for jet, name in enumerate(opening) if name in present]
        self._opening_places = place(opening[jet] for jet in self._opening)
        known = [name for name in [*columns(vehicle), *WRENCH] if name not in present]
        self.record.unknown = {name: _close(name, known) for name in dict.fromkeys(header) if name and name not in used}

    @property
    def _own_sensor(self) -> str:
        return "its gyro's three axes" if self._vehicle.gyros else "its sensors"

    def _missing_columns(self, required: list[str], present: set[str]) -> list[str]:
        missing = [name for name in required if name not in present]
        sensors = self._vehicle.tracked
        if sensors and not self._vehicle.gyros and not present & set(self._vehicle.tracked_columns):
            missing.insert(1, sensors[0].columns[0])
        if not missing:
            return []
        shown = ", ".join(missing[:_FEW]) + (f" and {len(missing) - _FEW} more" if len(missing) > _FEW else "")
        strange = present - set(columns(self._vehicle))
        hint = next((hint for hint in (_meant(name, strange) for name in missing) if hint), "")
        return [
            f"{self.source}: no column{'s' if len(missing) > 1 else ''} {shown}{hint}; vehicle "
            f"'{self._vehicle.name}' needs time_s, {self._own_sensor} and a column for each jet"
            + ("; 'massprop map' proposes what another program's columns mean" if len(missing) > _FEW else "")
        ]

    # -------------------------------------------------------------------------------------- rows

    def __iter__(self) -> Iterator[Rows]:
        try:
            for block in self._blocks():
                self._check_commands(block)
                ordered = self._ordered(block)
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
        """Yields the table's blocks, one that has been looked at first."""
        if self._begun is None:
            self._begun = iter(self._table.blocks(self._wanted))
        if self._first is not None:
            yield self._first
        yield from self._begun

    def readings_per_s(self) -> float | None:
        """Returns times at which something is read a second, where rows come at times of their own; None: one a sample.

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
        told = ~np.isnan(self._first.values[:, self._command_places]).all(axis=1)
        dense = steps.size and float(np.median(steps)) < self._period_s * (1.0 - JITTER)
        if not dense or (told.all() and not self._table.own_times):
            return None
        return float(steps.size / steps.sum())

    def _check_commands(self, block: Block) -> None:
        self._check_on_times(block)
        commands = np.where(self._timed, np.nan, block.values[:, self._command_places])
        self._tally.add(commands)
        wrong = (commands < -_FRACTION_TOLERANCE) | (commands > 1.0 + _FRACTION_TOLERANCE)
        if not wrong.any():
            return
        row, jet = np.argwhere(wrong)[0]
        value, column = float(commands[row, jet]), f"jet_{self._vehicle.designations[jet]}"
        hint = hint_about(commands, self._period_s)
        raise InputError(
            f"{self._table.where(int(block.lines[row]), column)}, column {column}: "
            f"{value:g} is no fraction of 0 to 1{hint}"
        )

    def _check_on_times(self, block: Block) -> None:
        """Checks that jets are on and open within the sample, where on-times or onsets are given."""
        period_s, given = self._period_s, block.values[:, self._command_places]
        wrong = self._timed & ((given < 0.0) | (given > period_s * (1.0 + JITTER)))
        if wrong.any():
            row, jet = np.argwhere(wrong)[0]
            column = on_time_columns(self._vehicle)[jet]
            raise InputError(
                f"{self._table.where(int(block.lines[row]), column)}, column {column}: {given[row, jet]:g} s is no "
                f"on-time of 0 to {period_s:g} s, the sample period"
            )
        on_s = np.where(self._timed, given, given * period_s)[:, self._opening]
        opens_s = block.values[:, self._opening_places]
        late = ((opens_s < 0.0) | (opens_s + on_s > period_s * (1.0 + _ROUNDING))) & (on_s > 0.0) & (on_s <= period_s)
        if late.any():
            row, place = np.argwhere(late)[0]
            column = onset_columns(self._vehicle)[self._opening[place]]
            raise InputError(
                f"{self._table.where(int(block.lines[row]), column)}, column {column}: opens after "
                f"{opens_s[row, place]:g} s for {on_s[row, place]:g} s, which is not within the sample of "
                f"{period_s:g} s"
            )

    def _told(self, values: Array) -> tuple[Array, Array | None]:
        """Reads commands of rows of the table, as fractions, and their onsets; None: jets switch with samples."""
        commands = values[:, self._command_places]
        commands = np.where(self._timed, np.minimum(commands / self._period_s, 1.0), commands)
        vehicle = self._vehicle
        if not (vehicle.has_on_times or self._timed.any() or self._opening):
            return commands, None
        onsets_s = onsets(commands, vehicle.jet_commands.at, self._period_s)
        given = values[:, self._opening_places]
        onsets_s[:, self._opening] = np.where(np.isnan(given), onsets_s[:, self._opening], given)
        return commands, onsets_s

    def _ordered(self, block: Block) -> Rows | None:
        """Keeps the rows of a block that advance in time, and inserts a row at each gap."""
        times = block.values[:, 0]
        steps = np.diff(times, prepend=self._last_s)
        off = ~self._follows(steps)
        if not self._awaiting and not off.any():
            self._count_steps(steps, self.record.interval_sum_s + float(steps.sum()))
            self._last_s = float(times[-1])
            self._late_in_a_row = 0
            return self._rows(block, np.arange(times.size), {})
        # rows that follow a row in use by a period are taken together, others one by one
        ends = [*np.flatnonzero(off).tolist(), times.size]
        taken: list[int] = []
        breaks: dict[int, float] = {}
        index = 0
        while index < times.size:
            end = ends[bisect.bisect_left(ends, index)]
            before = self._last_s if index == 0 else times[index - 1]
            if end > index and not self._awaiting and self._last_s == before:
                self._count_steps(steps[index:end], _added_up(self.record.interval_sum_s, steps[index:end]))
                taken.extend(range(index, end))
                self._last_s, self._late_in_a_row = float(times[end - 1]), 0
                index = end
            else:
                self._place(index, float(times[index]), block, taken, breaks)
                index += 1
        return self._rows(block, np.array(taken, dtype=int), breaks) if taken else None

    def _follows(self, steps: Array) -> Flags:
        """Tests whether rows follow those before them without a gap; NaN does not."""
        if self._any_time:
            within: Flags = (steps > _SAME * self._period_s) & (steps <= _HOLE * self._period_s)
            return within
        follows: Flags = np.abs(steps - self._period_s) <= self.jitter * self._period_s * (1.0 + _ROUNDING)
        return follows

    def _place(self, index: int, time: float, block: Block, taken: list[int], breaks: dict[int, float]) -> None:
        """Decides whether a row is taken, left out, or taken after a gap."""
        record, period = self.record, self._period_s
        line = int(block.lines[index])
        if math.isnan(time):
            record.without_time += 1
            return
        step = time - self._last_s
        if self._awaiting:
            if abs(step) <= JITTER * period:  # the row at which the earlier part ended
                self.before = self._boundary(block, index)
                self._last_s = time
                self._awaiting = False
                return
            if step < 0.0:
                record.before_start += 1
                return
            self._awaiting = False
        if step <= _SAME * period:
            same = abs(step) <= _SAME * period
            record.duplicates += same
            record.backward += not same
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
            if self._follows(np.array([step]))[0]:
                self._count_steps(np.array([step]), record.interval_sum_s + step)
            else:
                breaks[len(taken)] = self._last_s + min(period, 0.5 * step)
                taken.append(-1)
                record.gaps += 1
                record.gap_sum_s += step
                record.longest_gap_s = max(record.longest_gap_s, step)
                if len(record.first_gaps) < _LISTED_GAPS:
                    record.first_gaps.append((self._last_s, step))
                self._watch_period([step])
        taken.append(index)
        self._last_s = time

    def _boundary(self, block: Block, index: int) -> tuple[Array, Array, Array | None]:
        values = block.values[index]
        wrench = np.zeros(6)
        wrench[self._outside] = np.nan_to_num(values[self._outside_places])
        commands, onsets_s = self._told(values[None])
        if self.own_times and np.isnan(commands).all() and self._after is not None:
            return self._after.command, self._after.outside_wrench, self._after.onset_s
        return np.clip(commands[0], 0.0, 1.0), wrench, None if onsets_s is None else onsets_s[0]

    def _count_steps(self, steps: Array, sum_s: float) -> None:
        record = self.record
        size = np.abs(steps - self._period_s)
        record.intervals += steps.size
        record.interval_sum_s = sum_s
        record.jitter += int((size > _EXACT * self._period_s).sum())
        record.largest_jitter_s = max(record.largest_jitter_s, float(size.max()))
        self._watch_period(steps.tolist())

    def _watch_period(self, steps: list[float]) -> None:
        lacking = _FIRST_INTERVALS - len(self._first_steps)
        if lacking > 0:
            self._first_steps.extend(steps[:lacking])
            if len(self._first_steps) == _FIRST_INTERVALS:
                self._require_period()

    def _require_period(self, *, at_end: bool = False) -> None:
        """Raises InputError for a record with a different sample period, or none of whose rows follow each other."""
        seldom = self.own_times and not at_end
        if (self._any_time and not seldom) or not self._first_steps:
            return
        if at_end and len(self._first_steps) == _FIRST_INTERVALS:
            return
        median = float(np.median(self._first_steps))
        off = median > _HOLE * self._period_s if seldom else abs(median - self._period_s) > JITTER * self._period_s
        if off:
            units = [one.words for one in factors.near(median / self._period_s, factors.of_times())]
            looks = f", as with {units[0]}" if units else ""
            raise InputError(
                f"{self.source}: rows are {median:.6g} s apart, but the sample period of vehicle "
                f"'{self._vehicle.name}' is {self._period_s:g} s{looks}; resample the record, or set sample_period_s"
            )

    def _rows(self, block: Block, taken: NDArray[np.int_], breaks: dict[int, float]) -> Rows:
        values = block.values[taken]
        recorded = taken >= 0
        for row, time in breaks.items():
            values[row] = np.nan
            values[row, 0] = time
        record = self.record
        times = values[:, 0]
        if not record.rows:
            record.first_s = float(times[recorded][0])
        record.last_s = float(times[-1])
        record.rows += int(recorded.sum())

        readings, steps = {}, self._steps(times)
        for name in self._vehicle.sensor_names():
            places = self._sensor_places.get(name)
            reading = np.full((taken.size, 3), np.nan) if places is None else values[:, places]
            if places is not None:
                lacking = self._lacking(name, times[recorded], reading[recorded])
                record.missing[name] = record.missing.get(name, 0) + lacking
            if name in self._accelerations:
                since_s = self._cadence[name].steps(times, reading, self._period_s) if self.own_times else steps
                reading = self._integrated(name, reading, since_s)
            readings[name] = reading
        outside = None
        if self._outside:
            outside = np.zeros((taken.size, 6))
            outside[:, self._outside] = values[:, self._outside_places]
        commands, onsets_s = self._told(values)
        commands = np.clip(commands, 0.0, 1.0)
        own: Flags | None = None
        if self.own_times:
            own, told = _any_told(commands), (commands, onsets_s, outside)
            commands, onsets_s, outside = self._held.over(times, recorded, told, self._period_s)
        if outside is not None:
            outside = np.nan_to_num(outside)
        tracked = None
        if self._vehicle.tracked:
            tracked = np.full((taken.size, len(self._vehicle.tracked_columns)), np.nan)
            tracked[:, self._tracked] = values[:, self._tracked_places]
        return Rows(times, readings, commands, outside, recorded, tracked, onsets_s, own)

    def _lacking(self, name: str, times: Array, reading: Array) -> int:
        """Counts the rows that lack a reading of a package, or the readings that lack in its own cadence."""
        if not self.own_times:
            return int(np.isnan(reading).any(axis=1).sum())
        return self._cadence[name].lacking(times, reading)

    def _steps(self, times: Array) -> Array:
        """Computes the length of the sample that ends with each row, s, shape (n, 1): the period, or time passed."""
        if not self._any_time:
            return np.full((times.size, 1), self._period_s)
        first = self._before_s if math.isfinite(self._before_s) else float(times[0]) - self._period_s
        self._before_s = float(times[-1])
        return np.diff(times, prepend=first)[:, None]

    def _integrated(self, name: str, acceleration: Array, steps_s: Array) -> Array:
        """Integrates the mean acceleration of each sample; NaN where it is missing, continuing from the last value."""
        missing = np.isnan(acceleration)
        steps = np.where(missing, 0.0, acceleration) * steps_s
        velocity = np.cumsum(np.vstack([self.velocity[name], steps]), axis=0)[1:]
        self.velocity[name] = velocity[-1].copy()
        return np.where(missing, np.nan, velocity)


class _Held:
    """Commands and outside wrench that hold in rows which have none.

    Args:
        n_jets: number of jets.
        after: see `Reader`.
    """

    def __init__(self, n_jets: int, after: Continuation | None):
        self._command = np.full(n_jets, np.nan) if after is None else after.command
        self._onset_s = levels_alone(n_jets) if after is None or after.onset_s is None else after.onset_s
        self._wrench = np.zeros(6) if after is None else after.outside_wrench
        self._told_s = -math.inf if after is None else after.time_s
        self._pushed_s = self._told_s

    def over(
        self, times: Array, recorded: Flags, told: tuple[Array, Array | None, Array | None], period_s: float
    ) -> tuple[Array, Array | None, Array | None]:
        """Returns commands, onsets and outside wrench of rows, filled in where there are none.

        Args:
            times: of the rows, s, shape (n,).
            recorded: see `Rows`.
            told: commands, onsets and wrench as they stand in the rows, NaN where they do not.
            period_s: sample period.
        """
        commands, onsets_s, wrench = told
        here = np.vstack((self._command, commands))
        opening = levels_alone(commands.shape) if onsets_s is None else onsets_s
        opens = np.vstack((self._onset_s, opening))
        since, place = _since(self._told_s, times, _any_told(commands))
        known = (since < HELD * period_s) & recorded
        acting, acting_s = continued(here[place], opens[place], np.where(known, since, 0.0), period_s)
        acting[~known], acting_s[~known] = np.nan, np.nan
        self._command, self._onset_s = here[place[-1]], opens[place[-1]]
        self._told_s = float(times[-1] - since[-1])
        if wrench is not None:
            pushes = np.vstack((self._wrench, np.nan_to_num(wrench)))
            since, place = _since(self._pushed_s, times, _any_told(wrench))
            self._wrench, self._pushed_s = pushes[place[-1]], float(times[-1] - since[-1])
            wrench = np.where(((since < HELD * period_s) & recorded)[:, None], pushes[place], 0.0)
        return acting, None if onsets_s is None else acting_s, wrench


def _any_told(values: Array) -> Flags:
    """Finds rows in which any command or wrench is given, shape (n,)."""
    told: Flags = np.asarray((~np.isnan(values)).any(axis=1))
    return told


def _since(before_s: float, times: Array, told: Flags) -> tuple[Array, NDArray[np.int_]]:
    """Computes the time since each row's value was given, s, and its row, 0: before the first, shape (n,) each."""
    place = np.maximum.accumulate(np.where(told, np.arange(1, times.size + 1), 0))
    return times - np.append(before_s, times)[place], place


class _Cadence:
    """Times at which a package is read.

    Args:
        rate_hz: as stated; None: as the first readings have it.
    """

    def __init__(self, rate_hz: float | None):
        self._usual_s = None if rate_hz is None else 1.0 / rate_hz
        self._last_s = self._before_s = math.nan

    def lacking(self, times: Array, reading: Array) -> int:
        """Counts readings that lack, or have not all axes."""
        there = ~np.isnan(reading).any(axis=1)
        partly = int((~there & ~np.isnan(reading).all(axis=1)).sum())
        read = np.append(self._last_s, times[there]) if math.isfinite(self._last_s) else times[there]
        steps = np.diff(read)
        if self._usual_s is None and steps.size >= _FIRST_INTERVALS:
            self._usual_s = float(np.median(steps))
        self._last_s = float(read[-1]) if read.size else self._last_s
        if self._usual_s is None or not steps.size:
            return partly
        long = steps[steps > _LATE_READING * self._usual_s]
        return max(int((np.round(long / self._usual_s) - 1.0).sum()), partly)

    def steps(self, times: Array, reading: Array, period_s: float) -> Array:
        """Computes the time from the reading before to that in each row, s, zero where there is none, shape (n, 1)."""
        there = ~np.isnan(reading).any(axis=1)
        read, steps = times[there], np.zeros((times.size, 1))
        if read.size:
            first = self._before_s if math.isfinite(self._before_s) else read[0] - (self._usual_s or period_s)
            steps[there, 0] = np.diff(read, prepend=first)
            self._before_s = float(read[-1])
        return steps


def _added_up(start: float, steps: Array) -> float:
    """Adds each step to a sum, one after the other: as it would be row by row."""
    return float(np.add.accumulate([start, *steps.tolist()])[-1])


def _opened(telemetry: str | Path, stream: IO[bytes] | None, rows_per_block: int) -> Table:
    if stream is not None or str(telemetry) == "-":
        return CsvTable(stream or sys.stdin.buffer, "standard input", 1)
    return open_table(Path(telemetry), rows_per_block=rows_per_block)


def _close(word: str, valid: Iterable[str]) -> str:
    by_lower = {name.lower(): name for name in valid}
    found = difflib.get_close_matches(word.lower(), list(by_lower), n=1, cutoff=0.75)
    return by_lower[found[0]] if found else ""


def _meant(missing: str, strange: Iterable[str]) -> str:
    """Suggests ' (is it ...?)' when a column that is there looks like the missing one."""
    found = _close(missing, strange)
    return f" (is '{found}' meant to be '{missing}'?)" if found else ""


# --------------------------------------------------------------------------------------- checking


def check(path: Path, vehicle: Vehicle | None = None, gyro: str | None = None) -> dict[str, Any]:
    """Reads a whole record and describes its content, without estimating.

    Args:
        path: of a CSV or Parquet file.
        vehicle: whose columns and period it must have; None: only that it is a table of numbers in
            time order.
        gyro: the package that must be there; default the vehicle's first.

    Returns:
        rows, first_s, last_s, period_s, gaps, jitter, late (rows left out because time did not go on),
        unknown columns, absent packages, notes (what may be meant otherwise, a sentence each), completeness,
        completeness_detail (what could not be read, a sentence each).

    Raises:
        InputError: when the record cannot be used.
    """
    if vehicle is None:
        return _check_structure(path)
    reader = Reader(path, vehicle, gyro=gyro or next((package.name for package in vehicle.gyros), None))
    for _ in reader:
        pass
    record = reader.record
    return {
        "rows": record.rows,
        "first_s": record.first_s,
        "last_s": record.last_s,
        "period_s": record.period_s,
        "gaps": record.gaps,
        "jitter": record.jitter,
        "late": record.duplicates + record.backward,
        "unknown": list(record.unknown),
        "absent": record.absent,
        "notes": record.notes,
        "completeness": completeness(reader.losses),
        "completeness_detail": [one.text for one in reader.losses],
    }


def _check_structure(path: Path) -> dict[str, Any]:
    table = open_table(path)
    try:
        if "time_s" not in table.header:
            hint = _meant("time_s", table.header)
            raise InputError(f"{path}: no column time_s{hint}; telemetry has the time of each row, in seconds")
        time = table.header.index("time_s")
        wanted = [time, *(place for place, name in enumerate(table.header) if name and place != time)]
        parts = []
        for block in table.blocks(wanted):
            parts.append(block.values[:, 0])
    finally:
        table.close()
    times = np.concatenate([np.empty(0), *parts])
    times = times[np.isfinite(times)]
    if not times.size:
        raise InputError(f"{path}: has no usable row; expected a row per sample")
    steps = np.diff(times)
    forward = steps[steps > 0.0]
    period = float(np.median(forward)) if forward.size else None
    off = np.abs(forward - (period or 0.0))
    gaps = off > JITTER * (period or 0.0) * (1.0 + _ROUNDING)
    return {
        "rows": int(times.size),
        "first_s": float(times[0]),
        "last_s": float(times[-1]),
        "period_s": period,
        "gaps": int(gaps.sum()),
        "jitter": int((off[~gaps] > _EXACT * (period or 0.0)).sum()),
        "late": int((steps <= 0.0).sum()),
        "unknown": [],
        "absent": [],
        "notes": [],
        "completeness": completeness(table.losses),
        "completeness_detail": [one.text for one in table.losses],
    }
