"""Topics of a recording: columns by name, with the place of each row in its file."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from massprop_drake.errors import InputError, suggestion
from massprop_drake.inputs.record_map import CsvForm
from massprop_drake.maths.linear_algebra import Array
from massprop_drake.records.completeness import MISSING, Loss, Ragged
from massprop_drake.records.stamps import is_number, parse_stamp

Column = NDArray[Any]
MOST_ELEMENTS = 64  # of an array that become columns: an image has more, a vehicle's jets fewer
_MOST_COLUMNS = 4096  # of a table for which a map can be proposed: a budget of seconds


@dataclass(frozen=True)
class Topic:
    """Columns that were logged together.

    Attributes:
        source: what to call it in messages.
        columns: numbers or text, by name, shape (n,) each.
        stamps_s: that the log itself keeps, s, shape (n,); None: none.
        place: what rows are counted in, "line" or "row".
        lines: of each row, shape (n,); None: rows, from 1.
        unread: names of columns besides, which the map does not name.
        units: of columns, as a line below their names has them, "" where it has none.
    """

    source: str
    columns: Mapping[str, Column]
    stamps_s: Array | None = None
    place: str = "row"
    lines: NDArray[np.int64] | None = None
    unread: tuple[str, ...] = ()
    units: Mapping[str, str] = field(default_factory=dict)

    @property
    def rows(self) -> int:
        """Number of rows of the topic's table."""
        if self.stamps_s is not None:
            return len(self.stamps_s)
        return len(next(iter(self.columns.values()), ()))

    def column(self, name: str) -> Column:
        """Returns a column's values; raises InputError where there is none of that name."""
        if name not in self.columns:
            raise InputError(f"{self.source}: no column '{name}'{suggestion(name, [*self.columns, *self.unread])}")
        return self.columns[name]

    def where(self, row: int) -> str:
        """Returns source and line of a row as text for messages, such as "flight.csv, line 7"."""
        line = row + 1 if self.lines is None else int(self.lines[row])
        return f"{self.source}, {self.place} {line}"

    def numbers(self, name: str) -> Array:
        """Returns a column's numbers, NaN where missing, shape (n,).

        Raises:
            InputError: when it is not there, or holds text or infinity.
        """
        values = self.column(name)
        if values.dtype == object:
            for row, cell in enumerate(values):
                if not is_number(cell):
                    shown = str(cell) if len(str(cell)) <= 40 else f"{str(cell)[:37]}..."
                    raise InputError(
                        f"{self.where(row)}, column {name}: {shown!r} is not a number"
                        + ("; is it a line of units? Give `csv: {below: 1}` in the map" if row == 0 else "")
                    )
            values = np.array([np.nan if cell.strip().lower() in MISSING else float(cell) for cell in values])
        numbers: Array = np.asarray(values, dtype=float)
        infinite = np.isinf(numbers)
        if infinite.any():
            raise InputError(f"{self.where(int(np.argmax(infinite)))}, column {name}: is infinite")
        return numbers

    def times_s(self, name: str, unit_s: float, date: str | None = None) -> Array:
        """Returns a column's times, s, NaN where missing, shape (n,), from numbers of a unit or ISO 8601 stamps.

        Args:
            name: of the column.
            unit_s: of numbers, s.
            date: column of the dates of stamps that are a time of day alone; None: none.

        Raises:
            InputError: when it is not there, or holds other text.
        """
        values = self.column(name)
        if date is not None:
            pairs = zip(self.texts(date), self.texts(name), strict=True)
            joined = [f"{day.strip()} {clock.strip()}" if day.strip() and clock.strip() else "" for day, clock in pairs]
            values = np.array(joined, dtype=object)
        filled = [cell for cell in values if str(cell).strip().lower() not in MISSING] if values.dtype == object else []
        if not filled or any(map(is_number, filled)):
            return self.numbers(name) * unit_s
        stamps = [parse_stamp(str(cell)) for cell in values]
        wrong = [row for row, stamp in enumerate(stamps) if stamp is None]
        if wrong:
            raise InputError(
                f"{self.where(wrong[0])}, column {name}: {str(values[wrong[0]])[:40]!r} is neither a number nor an "
                "ISO 8601 stamp such as 2024-05-01T12:00:00.25Z"
            )
        elapsed = np.array(stamps, "datetime64[ns]") - np.datetime64(0, "s")
        seconds, rest = elapsed.astype("timedelta64[s]"), elapsed % np.timedelta64(1, "s")
        times: Array = seconds / np.timedelta64(1, "s") + rest / np.timedelta64(1, "s")
        return times

    def texts(self, name: str) -> list[str]:
        """Returns a column's cells as texts, "" for None."""
        return ["" if cell is None else str(cell) for cell in self.column(name)]


@dataclass(frozen=True)
class Recording:
    """Content of a file of any recorder.

    Attributes:
        source: its name in messages.
        kind: "table", "mat", "ulog", "ros1" or "ros2".
        topics: by name; a table is the topic "".
        parameters: of the vehicle, as a ULog has them, by name.
        notes: what is doubtful in it, a sentence each.
        information: what is to be known besides, likewise.
        sha256: of the file, hexadecimal.
        types: of a bag's topics, by name.
        ragged: rows of a text file that were left out.
        form: how a text file is written.
        losses: what could not be read.
    """

    source: str
    kind: str
    topics: Mapping[str, Topic]
    parameters: Mapping[str, float] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    information: tuple[str, ...] = ()
    sha256: str = ""
    types: Mapping[str, str] = field(default_factory=dict)
    ragged: Ragged = field(default_factory=Ragged)
    form: CsvForm = field(default_factory=CsvForm)
    losses: tuple[Loss, ...] = ()

    def topic(self, name: str) -> Topic:
        """Returns a topic's table; raises InputError where the recording has none of that name."""
        if name not in self.topics:
            raise missing_topic(self.source, name, list(self.topics), self.losses)
        return self.topics[name]


def missing_topic(source: str, name: str, known: list[str], losses: Sequence[Loss] = ()) -> InputError:
    """Makes the InputError for a topic that a recording lacks, with a name alike or a loss as hint."""
    if not name:
        shown = ", ".join(known[:10]) + (", ..." if known[10:] else "")
        return InputError(f"{source}: has topics, and the map names none: give `topic`, one of {shown}")
    if known == [""]:
        return InputError(f"{source}: is a table without topics, and the map names topic '{name}'")
    lost = f"; besides, {losses[0].text}" if losses else ""
    return InputError(f"{source}: no topic '{name}'{suggestion(name, known)}{lost}")


def missing_extra(path: Path, package: str, extra: str, file_kind: str) -> InputError:
    """Makes the InputError for a package that is not installed, with the extra that installs it."""
    return InputError(f"{path}: reading {file_kind} needs {package}: pip install 'massprop-drake[{extra}]'")


def digest(path: Path) -> str:
    """Computes SHA-256 of a file, or of the names and digests of a folder's files, hexadecimal."""
    if path.is_dir():
        total = hashlib.sha256()
        for inner in sorted(one for one in path.iterdir() if one.is_file()):
            total.update(f"{inner.name} {digest(inner)}\n".encode())
        return total.hexdigest()
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def unused_columns(names: Sequence[str], used: Sequence[str]) -> tuple[str, ...]:
    """Returns the names, but empty ones, that are not among the used ones."""
    known = set(used)
    return tuple(name for name in names if name and name not in known)


def require_few_columns(path: Path, names: Sequence[str]) -> None:
    """Raises InputError where a table has more columns than a map can be proposed for."""
    if len(names) > _MOST_COLUMNS:
        raise InputError(
            f"{path}: has {len(names)} columns, and a map is proposed for at most {_MOST_COLUMNS}; write the map "
            "(docs/records.md), of which the columns it names are read, or keep those of sensors and jets"
        )


def split_lists(name: str, values: Sequence[Sequence[Any] | None]) -> dict[str, Column]:
    """Maps `name[0]`, `name[1]`, ... to the items of a column of short lists; unlike lengths add them as text."""
    lists = [() if one is None else tuple(one) for one in values]
    longest = max(map(len, lists), default=0)
    columns: dict[str, Column] = {}
    if any(len(one) != longest for one in lists) or not longest:
        columns[name] = np.array([" ".join(map(format_item, one)) for one in lists], dtype=object)
    if longest <= MOST_ELEMENTS and not any(isinstance(item, str) for one in lists for item in one):
        for index in range(longest):
            columns[f"{name}[{index}]"] = np.array([one[index] if index < len(one) else np.nan for one in lists], float)
    elif name not in columns and longest <= MOST_ELEMENTS:
        columns[name] = np.array([" ".join(map(format_item, one)) for one in lists], dtype=object)
    return columns


def format_item(item: Any) -> str:
    """Formats a list's item as text to compare with names; a whole number without a decimal point."""
    if isinstance(item, (float, np.floating)) and float(item).is_integer():
        return str(int(item))
    return str(item)
