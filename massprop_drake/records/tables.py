"""Tables of numbers, read block by block from CSV and Parquet files in memory that does not grow with their length."""

from __future__ import annotations

import csv
import hashlib
import io
import os
import stat
from array import array
from collections.abc import Callable, Iterator, Sequence
from itertools import chain
from operator import itemgetter
from pathlib import Path
from typing import IO, Any

import numpy as np

from massprop_drake.errors import InputError, require_text
from massprop_drake.records.blocks import Block, Table, infinite_value_message, require_meaningful, require_unique
from massprop_drake.records.completeness import (
    FEW_RAGGED,
    MISSING,
    NUMBER,
    RAGGED_SHARE,
    Ending,
    Loss,
    Ragged,
    text_lines,
    unreadable_message,
)
from massprop_drake.records.parquet import ParquetTable


def open_table(path: Path, *, rows_per_block: int = 1024) -> Table:
    """Opens a CSV file, or a Parquet file, recognized by its suffix `.parquet` or `.pq`, as a table.

    Raises:
        InputError: when it is missing, a folder, unreadable, no such table, or named by what is no text, which no
            result could hold.
    """
    require_text(str(path))
    if path.is_dir():
        raise InputError(f"{path}: is a folder; name a telemetry file, such as telemetry.csv")
    require_file(path)
    try:
        if path.suffix.lower() in (".parquet", ".pq"):
            return ParquetTable(path, rows_per_block)
        binary = path.open("rb", buffering=0)
    except (OSError, ValueError) as error:
        raise InputError(unreadable_message(path, error)) from None
    try:
        return CsvTable(binary, str(path), rows_per_block, os.fstat(binary.fileno()).st_size)
    except BaseException:
        binary.close()
        raise


def require_file(path: Path) -> None:
    """Raises InputError for a path that is neither file nor folder, as a pipe or device, which may block."""
    try:
        kind = path.stat().st_mode
    except (OSError, ValueError):  # told when it is opened
        return
    if not (stat.S_ISREG(kind) or stat.S_ISDIR(kind)):
        what = "a pipe" if stat.S_ISFIFO(kind) else "a socket" if stat.S_ISSOCK(kind) else "a device"
        raise InputError(f"{path}: is {what}, not a file; rows of telemetry are read from standard input, as '-'")


class _HashingStream(io.RawIOBase):
    """Binary stream that hashes and counts the bytes read from it."""

    def __init__(self, inner: IO[bytes]):
        self._read = getattr(inner, "read1", inner.read)  # what is there, without waiting for more
        self.hash = hashlib.sha256()
        self.count = 0

    def readable(self) -> bool:
        """Returns True: the stream can be read."""
        return True

    def readinto(self, buffer: Any) -> int:
        """Reads available bytes into a buffer and adds them to the hash; returns their number."""
        data = self._read(len(buffer)) or b""
        buffer[: len(data)] = data
        self.hash.update(data)
        self.count += len(data)
        return len(data)


class CsvTable(Table):
    """Comma-separated values with a line of column names, UTF-8, a byte-order mark allowed.

    Args:
        binary: the stream; closed by `close`, but for standard input.
        source: what to call it in messages.
        rows_per_block: at most; 1 hands out each row as it arrives.
        size: of the stream, bytes; 0: unknown.

    Raises:
        InputError: when the first line has no names, or one of them twice.
    """

    place = "line"

    def __init__(self, binary: IO[bytes], source: str, rows_per_block: int, size: int = 0):
        self._binary = binary
        self.source = source
        self._rows_per_block = rows_per_block
        self._size = size
        self._watched = _HashingStream(binary)
        self._suspicious = False  # whether the last line may hold what `float` takes, but a cell must not
        self._line = 0
        self._unended = False  # whether the last line has no end
        self._zeros: list[Loss] = []
        self.ragged = Ragged()
        self._text = self._lines()
        self.header = self._read_header()

    @property
    def done(self) -> float:
        """Fraction of the file read so far, 0 to 1."""
        return self._watched.count / self._size if self._size else 0.0

    @property
    def losses(self) -> Sequence[Loss]:  # type: ignore[override] # which grow as lines are read
        """Losses found so far: rows left out, and an end that is cut off or zeros."""
        return [*self._zeros, *self.ragged.losses(self.source)]

    def sha256(self) -> str:
        """Returns SHA-256 of the bytes read so far, hexadecimal."""
        return self._watched.hash.hexdigest()

    def close(self) -> None:
        """Closes the stream."""
        self._binary.close()

    def _lines(self) -> Iterator[str]:
        """Yields the lines as text; stores the number of the current one, and whether it lacks a line end."""
        text = io.TextIOWrapper(io.BufferedReader(self._watched, 1 << 16), encoding="utf-8-sig", newline="")
        for number, line in text_lines(text, self.source, self._zeros):
            self._line = number
            self._suspicious = "_" in line
            self._unended = line[-1] not in "\r\n"
            yield line

    def _rows(self) -> Iterator[list[str]]:
        """Yields the cells of each row as texts; rows without quotes are split, which is faster."""
        limit = csv.field_size_limit()
        try:
            for line in self._text:
                if '"' in line or len(line) > limit:
                    yield next(csv.reader(chain((line,), self._text), strict=True))
                else:
                    cells = line.rstrip("\r\n")
                    yield cells.split(",") if cells else []
        except csv.Error as error:
            if not self._unended:
                raise InputError(f"{self.source}, line {self._line}: not comma-separated values: {error}") from None
            yield [""] * (len(self.header) - 1)  # it ends within quotes

    def _read_header(self) -> list[str]:
        """Returns the column names in the first row; raises InputError where it has none."""
        row = next((row for row in self._rows() if row), None)
        if row is None:
            raise InputError(f"{self.source}: is empty; expected a line of column names, time_s first")
        header = [name.strip() for name in row]
        for separator, name in ((";", "semicolons"), ("\t", "tabs")):
            if len(header) <= 2 and separator in row[0]:
                where = f"{self.source}, line {self._line}"
                expected = "expected commas; 'massprop map' proposes a map of other files"
                raise InputError(f"{where}: columns are separated by {name}; {expected}")
        if all(NUMBER.fullmatch(name) for name in header if name):
            raise InputError(f"{self.source}, line {self._line}: has numbers; expected a line of column names")
        require_unique(header, f"{self.source}, line {self._line}")
        return header

    def blocks(self, indices: list[int]) -> Iterator[Block]:
        """Yields blocks of rows: line numbers, and values of the columns at these indices.

        Raises:
            InputError: when a cell is neither a number nor missing, or too many rows have a wrong length.
        """
        width = len(self.header)
        pick, ending = _make_picker(indices, width), Ending()
        numeric = width - 1 in indices
        lines: list[int] = []
        values = array("d")
        n_regular, pending = 0, 0  # rows taken; line of a ragged row that may be the last
        for row in self._rows():
            if not row:
                continue
            if pending:
                self.ragged.add(pending)
                self.ragged.last_incomplete = False
                self._require_regular(n_regular)
                pending = 0
            if len(row) != width or (self._unended and ending.is_cut(row[-1], is_numeric=numeric)):
                pending, self.ragged.last_incomplete = self._line, len(row) <= width
                continue
            ending.note_last_cell(row[-1])
            cells = pick(row)
            try:
                values.extend(map(float, self._parse_cells(cells, indices) if self._suspicious else cells))
            except ValueError:
                del values[len(lines) * len(indices) :]
                values.extend(self._parse_cells(cells, indices))
            lines.append(self._line)
            n_regular += 1
            if len(lines) == self._rows_per_block:
                yield self._make_block(lines, values, indices)
                lines, values = [], array("d")
        if lines:
            yield self._make_block(lines, values, indices)
        if pending:
            self.ragged.add(pending)
        self._require_regular(n_regular, at_end=True)

    def _parse_cells(self, cells: Sequence[str], columns: list[int]) -> list[float]:
        """Parses cells of a row to numbers; raises InputError with the location of other text."""
        return [self._parse_number(cell, self.header[column]) for cell, column in zip(cells, columns, strict=True)]

    def _parse_number(self, cell: str, column: str) -> float:
        """Returns a cell's number, NaN if missing; raises InputError with its place for other text."""
        text = cell.strip()
        if text.lower() in MISSING:
            return np.nan
        if text.lower().lstrip("+-") in ("inf", "infinity"):
            raise InputError(infinite_value_message(f"{self.source}, line {self._line}", column))
        if not NUMBER.fullmatch(text):
            shown = text if len(text) <= 40 else text[:37] + "..."
            raise InputError(
                f"{self.source}, line {self._line}, column {column}: {shown!r} is not a number; "
                "leave the cell empty where there is no value"
            )
        return float(text)

    def _make_block(self, lines: list[int], values: array[float], columns: list[int]) -> Block:
        """Makes a block from lines and values; raises InputError for a value that is infinite or too large."""
        block = Block(np.array(lines), np.frombuffer(values).reshape(len(lines), len(columns)))
        require_meaningful(block, [self.header[column] for column in columns], self.source, self.place)
        return block

    def _require_regular(self, n_regular: int, *, at_end: bool = False) -> None:
        """Raises InputError where too many rows read so far are ragged."""
        require_regular(self.ragged, self.source, n_regular, len(self.header), at_end=at_end)


def require_regular(ragged: Ragged, source: str, n_regular: int, width: int, *, at_end: bool = True) -> None:
    """Raises InputError where too many rows of a table have a number of cells other than its columns'.

    Args:
        ragged: those that have.
        source: what to call the table.
        n_regular: rows that have not.
        width: number of columns.
        at_end: whether all of the table has been read.
    """
    count = ragged.count
    if count > FEW_RAGGED and count > (RAGGED_SHARE if at_end else 0.5) * (n_regular + count):
        raise InputError(
            f"{source}: {count} of {n_regular + count} rows have another number of cells than the "
            f"{width} columns, first line {ragged.first_line}; check the separator and the export"
        )


def _make_picker(columns: list[int], width: int) -> Callable[[list[str]], Sequence[str]]:
    """Makes a function that returns the cells at some columns of a row with `width` cells."""
    if columns == list(range(width)):
        return lambda row: row
    if len(columns) == 1:
        return lambda row: [row[columns[0]]]
    return itemgetter(*columns)
