"""Several files of telemetry merged into one table: a row for every time at which one of them has one.

Each file has a column `time_s` and columns of its own. All must be stamped by one clock, which their own times show:
a file is refused whose times are in another unit, lie elsewhere, or lie earlier or later by as much at both ends.
"""

from __future__ import annotations

import hashlib
import itertools
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from massprop_drake.errors import InputError, counted, moment
from massprop_drake.inputs import factors
from massprop_drake.maths.linear_algebra import Array
from massprop_drake.records.blocks import Block, Table
from massprop_drake.records.completeness import Loss, Ragged
from massprop_drake.records.tables import open_table

_SAME_S = 1e-6  # times that are no farther apart are one
_SHARED = 0.5  # share of the shorter record over which two of one clock run together
_OTHER_UNIT = 100.0  # times as long as another a record is by its unit
_OFF = 3.0  # intervals of the slower of two by which both their ends are off where clocks differ
_HOLE = 2.5  # intervals: a longer one between commands is none of a cycle
_FEWEST = 5  # commands that show that each is another
_ROWS = 1024  # of a block


class _SourceFile(NamedTuple):
    """Source file of a merged table.

    Attributes:
        source: what to call it in messages.
        path: of the file.
        header: names of its columns.
        place: what its rows are counted in.
        time_s: of its rows that advance, s, shape (n,).
        interval_s: between these, in the median.
    """

    source: str
    path: Path
    header: list[str]
    place: str
    time_s: Array
    interval_s: float


class MergedTable(Table):
    """Files of telemetry, each with its own times, as one `Table`; all that is read is held in memory.

    Args:
        paths: CSV or Parquet files, two at least.

    Attributes:
        rows_per_s: rows of the whole a second; the others are those of a `Table`.

    Raises:
        InputError: for a file without times, a column that two files have, or clocks that disagree.
    """

    own_times = True

    def __init__(self, paths: Sequence[str | Path]):
        twice = [str(path) for number, path in enumerate(paths) if path in paths[:number]]
        if twice:
            raise InputError(f"{twice[0]}: is given twice; give each file once")
        self._parts = [_open_source(Path(path)) for path in paths]
        self.source = " + ".join(part.source for part in self._parts)
        self._owner = _column_owners(self._parts)
        _require_one_clock(self._parts)
        self.header = ["time_s", *self._owner]
        times = np.unique(np.concatenate([part.time_s for part in self._parts]))
        self._time_s = times[np.append(True, np.diff(times) > _SAME_S)]  # what is the same stands once
        span_s = float(self._time_s[-1] - self._time_s[0])
        self.rows_per_s = (self._time_s.size - 1) / span_s if span_s > 0.0 else 0.0
        self.ragged = Ragged()
        self.notes: list[str] = []
        self.losses: list[Loss] = []
        self._digests: list[str] = []
        self._lines = np.zeros((len(self._parts), self._time_s.size), dtype=int)
        self._read = 0

    @property
    def done(self) -> float:
        """Fraction of the merged rows that have been read so far, 0 to 1."""
        return self._read / self._time_s.size

    def where(self, line: int, column: str) -> str:
        """Returns source file and line of a merged row as text for messages, by the column meant."""
        part = self._owner.get(column, 0)
        source_file = self._parts[part]
        return f"{source_file.source}, {source_file.place} {int(self._lines[part, line - 1])}"

    def sha256(self) -> str:
        """Computes SHA-256 of the digests of all files, hexadecimal; valid once all of them have been read."""
        return hashlib.sha256(" ".join(self._digests).encode()).hexdigest()

    def blocks(self, indices: list[int]) -> Iterator[Block]:
        """Yields blocks of merged rows: row numbers, and values of the columns at these indices."""
        values = np.full((self._time_s.size, len(indices)), np.nan)
        names = [self.header[column] for column in indices]
        for number, part in enumerate(self._parts):
            targets = {name: index for index, name in enumerate(names) if self._owner.get(name) == number}
            self._copy_columns(number, part, targets, values)
        for index, name in enumerate(names):
            if name == "time_s":
                values[:, index] = self._time_s
        numbers = np.arange(1, self._time_s.size + 1)
        for begin in range(0, self._time_s.size, _ROWS):
            rows = slice(begin, begin + _ROWS)
            self._read = min(begin + _ROWS, self._time_s.size)
            yield Block(numbers[rows], values[rows])

    def _copy_columns(self, file_index: int, file: _SourceFile, targets: dict[str, int], values: Array) -> None:
        """Writes columns of a source file into the merged values at its times; holds commands logged on change."""
        names, indices = list(targets), list(targets.values())
        table = open_table(file.path)
        try:
            columns = [table.header.index(name) for name in ("time_s", *names)]
            blocks = list(table.blocks(columns))
        finally:
            table.close()
        self._digests.append(table.sha256())
        self.losses += table.losses
        self.ragged.count += table.ragged.count
        self.ragged.first_line = self.ragged.first_line or table.ragged.first_line
        self.ragged.last_incomplete |= table.ragged.last_incomplete
        lines = np.concatenate([block.lines for block in blocks])
        table_values = np.concatenate([block.values for block in blocks])
        kept = _advancing_rows(table_values[:, 0])
        if kept.size < len(table_values):
            left = counted(len(table_values) - kept.size, "row")
            self.notes.append(f"{file.source}: {left} left out that have no time, or whose time does not go on")
        rows = np.searchsorted(self._time_s, table_values[kept, 0] - _SAME_S)
        self._lines[file_index, rows] = lines[kept]
        np.maximum.accumulate(self._lines[file_index], out=self._lines[file_index])
        if not names:
            return
        readings = table_values[kept, 1:]
        values[np.ix_(rows, indices)] = readings
        jets = [index for index, name in enumerate(names) if name.startswith("jet_")]
        if jets and _is_on_change(table_values[kept, 0], readings[:, jets]):
            self.notes.append(f"{file.source}: has a row whenever a command changes: each holds until the next")
            latest = np.searchsorted(rows, np.arange(self._time_s.size), side="right") - 1
            jet_targets = [indices[index] for index in jets]
            values[:, jet_targets] = np.where(latest[:, None] >= 0, readings[np.maximum(latest, 0)][:, jets], np.nan)


def _open_source(path: Path) -> _SourceFile:
    """Reads the header and increasing row times of a telemetry file; raises InputError without times."""
    table = open_table(path)
    try:
        if "time_s" not in table.header:
            names = ", ".join(table.header[:4])
            raise InputError(f"{path}: has no column time_s, but {names}; each file needs its own times, in seconds")
        column = [table.header.index("time_s")]
        parts = [block.values[:, 0] for block in table.blocks(column)]
    finally:
        table.close()
    times = np.concatenate([np.empty(0), *parts])
    times = times[_advancing_rows(times)]
    if times.size < 2:
        raise InputError(f"{path}: has {counted(times.size, 'row')} with a time of its own; expected two at least")
    return _SourceFile(table.source, path, table.header, table.place, times, float(np.median(np.diff(times))))


def _advancing_rows(times: Array) -> NDArray[np.int_]:
    """Returns indices of rows whose time is later than that of every row before."""
    latest = np.maximum.accumulate(np.nan_to_num(times, nan=-np.inf))
    previous = np.append(-np.inf, latest[:-1])
    return np.flatnonzero(np.nan_to_num(times, nan=-np.inf) > previous + _SAME_S)


def _column_owners(parts: Sequence[_SourceFile]) -> dict[str, int]:
    """Maps each column to the index of its file; raises InputError for one that two files have."""
    owner: dict[str, int] = {}
    for number, part in enumerate(parts):
        for name in part.header:
            if name in owner and name:
                first = parts[owner[name]].source
                raise InputError(f"{part.source}: has column '{name}', as {first} has; a column is of one file")
            if name != "time_s" and name:
                owner[name] = number
    return owner


def _require_one_clock(parts: Sequence[_SourceFile]) -> None:
    """Raises InputError where times of two files are not of one clock: another unit, an offset, no overlap."""
    for one, other in itertools.combinations(parts, 2):
        (a0, a1), (b0, b1) = ((float(part.time_s[0]), float(part.time_s[-1])) for part in (one, other))
        spans = f"it runs from {moment(b0)} to {moment(b1)} s, {one.source} from {moment(a0)} to {moment(a1)} s"
        ratio = (b1 - b0) / (a1 - a0)
        if max(ratio, 1.0 / ratio) > _OTHER_UNIT and (units := factors.factors_near(ratio, factors.time_factors())):
            raise InputError(f"{other.source}: its clock runs {ratio:.4g} times as fast: {spans}; {units[0].words}?")
        late, end_late = b0 - a0, b1 - a1
        shared = min(a1, b1) - max(a0, b0)
        step = max(one.interval_s, other.interval_s)
        is_offset = abs(late - end_late) <= step and abs(late) > _OFF * step
        if shared < _SHARED * min(a1 - a0, b1 - b0) or is_offset:
            raise InputError(
                f"{other.source}: its clock is {abs(late):.6g} s {'ahead' if late > 0.0 else 'behind'}: {spans}; give "
                "all files by one clock"
            )


def _is_on_change(time_s: Array, commands: Array) -> bool:
    """Tests whether commands are logged only when one changes, at irregular times."""
    if len(commands) < _FEWEST:
        return False
    changes = (np.diff(commands, axis=0) != 0.0).any(axis=1)
    steps = np.diff(time_s)
    return bool(changes.all()) and float(steps.max()) > _HOLE * float(np.median(steps))
