"""Tables of numbers, read block by block from CSV and Parquet files in memory that does not grow with their length."""

from __future__ import annotations

import contextlib
import csv
import hashlib
import io
import math
import os
import re
import stat
from array import array
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import chain
from operator import itemgetter
from pathlib import Path
from typing import IO, Any, Literal, NamedTuple, Protocol, TextIO

import numpy as np
from numpy.typing import NDArray

from massprop_drake.errors import InputError, counted, require_text

Array = NDArray[np.float64]

MISSING = {"", "nan", "null", "n/a", "na", "-"}  # cells that say that there is no value, in any case
_NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")
_LONGEST_LINE = 1_000_000  # characters; a row of a thousand columns has some 20 000
LARGEST = 1e12  # number of any meaning, whatever its unit
_PARQUET = b"PAR1"  # first and last bytes
_FEW_RAGGED, _RAGGED_SHARE = 10, 0.01  # rows of a wrong length that a file may have: so many, or this share


class Block(NamedTuple):
    """A block of rows of a table.

    Attributes:
        lines: line (CSV) or row (Parquet) of each, counted from 1, shape (n,).
        values: of the wanted columns, NaN where missing, shape (n, n_columns).
    """

    lines: NDArray[np.int_]
    values: Array


Completeness = Literal["complete", "truncated", "damaged"]


class Loss(NamedTuple):
    """Part of a record that could not be read.

    Attributes:
        kind: "truncated", its end is missing; "damaged", something else is.
        text: what is missing, and how much of it where that is known.
    """

    kind: Literal["truncated", "damaged"]
    text: str


def completeness(losses: Iterable[Loss]) -> Completeness:
    """Computes the completeness of a record, by the gravest of its losses."""
    kinds = {one.kind for one in losses}
    if "damaged" in kinds:
        return "damaged"
    return "truncated" if kinds else "complete"


class Ragged:
    """Count of the rows left out because their number of cells is wrong.

    Attributes:
        count: of all.
        first_line: of the first; 0: none.
        last_line: of the last; likewise.
        last_incomplete: whether the last row of the file was one, and had too few.
    """

    def __init__(self) -> None:
        self.count = 0
        self.first_line = self.last_line = 0
        self.last_incomplete = False

    def add(self, line: int) -> None:
        """Counts a row, given its line."""
        self.first_line, self.last_line = self.first_line or line, line
        self.count += 1

    def losses(self, source: str) -> list[Loss]:
        """Returns the lost rows of a table, given what to call it."""
        found, before = [], self.count - self.last_incomplete
        if before:
            what = f"{counted(before, 'row')} left out with a wrong number of cells"
            found.append(Loss("damaged", f"{source}: {what}, the first in line {self.first_line}"))
        if self.last_incomplete:
            found.append(Loss("truncated", f"{source}: is cut off within line {self.last_line}, which is left out"))
        return found


class Ending:
    """Test whether the last line of a text file was cut off: a line without an end may be.

    A last cell is held for cut where it is shorter than every other one of its column, or no number while the column
    has numbers.
    """

    def __init__(self) -> None:
        self._shortest = _LONGEST_LINE

    def saw(self, cell: str) -> None:
        """Takes in the last cell of a whole row."""
        self._shortest = min(self._shortest, len(cell))

    def is_cut(self, cell: str, *, number: bool) -> bool:
        """Tests whether the last cell of a line without an end is cut off.

        Args:
            cell: as it stands.
            number: whether its column has numbers.
        """
        text = cell.strip()
        broken = number and text.lower() not in MISSING and not _NUMBER.fullmatch(text)
        return broken or 0 < len(cell) < self._shortest


def text_lines(text: TextIO, source: str, losses: list[Loss]) -> Iterator[tuple[int, str]]:
    """Yields the lines of a text file with their numbers; zeros at its end, as a loss of power leaves them, are lost.

    Args:
        text: the file.
        source: what to call it in messages.
        losses: takes in what is lost.

    Raises:
        InputError: for what is no text in UTF-8, or longer than a row of telemetry can be.
    """
    number = 0
    while True:
        number += 1
        try:
            line = text.readline(_LONGEST_LINE)
            if "\0" in line:
                head = line[: line.index("\0")]
                if number == 1 or not _are_zeros(line[len(head) :], text):
                    raise InputError(f"{source}, line {number}: holds a NUL byte; expected text in UTF-8")
                losses.append(Loss("truncated", f"{source}: has nothing but zeros from line {number} on"))
                line = head
        except UnicodeDecodeError:
            raise InputError(
                f"{source}: not a text file in UTF-8 from line {number} on; expected a table of separated values"
            ) from None
        except OSError as error:
            raise InputError(_unreadable(source, error)) from None
        if not line:
            return
        if len(line) >= _LONGEST_LINE:
            raise InputError(f"{source}, line {number}: is longer than a row of telemetry can be")
        yield number, line


def _are_zeros(begin: str, text: TextIO) -> bool:
    """Tests whether a text and all that follows in a file are zeros."""
    while begin:
        if begin.strip("\0"):
            return False
        begin = text.read(1 << 16)
    return True


class Table(Protocol):
    """The interface of a table opened for reading.

    Attributes:
        source: what to call it in messages.
        header: names of the columns, in order.
        place: what rows are counted in, "line" or "row".
        ragged: rows left out.
        own_times: whether there is a row whenever anything is read or commanded, and not one a sample.
    """

    own_times: bool
    source: str
    header: list[str]
    place: str
    ragged: Ragged

    @property
    def losses(self) -> Sequence[Loss]:
        """Losses of the table; all of them once it has been read."""

    @property
    def notes(self) -> Sequence[str]:
        """Notes on how the table was made, a sentence each."""

    def blocks(self, wanted: list[int]) -> Iterator[Block]:
        """Yields the values of the chosen columns, given by position, block by block."""

    def where(self, line: int, column: str) -> str:
        """Returns the place of a row for messages, given its number in a block, and the column that is meant."""

    @property
    def done(self) -> float:
        """The fraction of the table read so far, 0 to 1; 0 if its size is unknown."""

    def sha256(self) -> str:
        """Computes SHA-256 of the whole content, hexadecimal; valid once all of it has been read."""

    def close(self) -> None:
        """Closes the file."""


def open_table(path: Path, *, rows_per_block: int = 1024) -> Table:
    """Opens a CSV file, or a Parquet file, recognized by its ending `.parquet` or `.pq`.

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
        raise InputError(_unreadable(path, error)) from None
    try:
        return CsvTable(binary, str(path), rows_per_block, os.fstat(binary.fileno()).st_size)
    except BaseException:
        binary.close()
        raise


def require_file(path: Path) -> None:
    """Requires that a path is a file or a folder: a pipe may never begin, and a device never end.

    Raises:
        InputError: when it is there, and neither.
    """
    try:
        kind = path.stat().st_mode
    except (OSError, ValueError):  # told when it is opened
        return
    if not (stat.S_ISREG(kind) or stat.S_ISDIR(kind)):
        what = "a pipe" if stat.S_ISFIFO(kind) else "a socket" if stat.S_ISSOCK(kind) else "a device"
        raise InputError(f"{path}: is {what}, not a file; rows of telemetry are read from standard input, as '-'")


def _unreadable(path: object, error: Exception) -> str:
    if isinstance(error, FileNotFoundError):
        return f"{path}: no such file"
    return f"{path}: cannot be read: {getattr(error, 'strerror', None) or error}"


# -------------------------------------------------------------------------------------------- CSV


class _Watched(io.RawIOBase):
    """Binary stream that hashes and counts the bytes read from it."""

    def __init__(self, inner: IO[bytes]):
        self._read = getattr(inner, "read1", inner.read)  # what is there, without waiting for more
        self.hash = hashlib.sha256()
        self.count = 0

    def readable(self) -> bool:
        """Returns True: the stream can be read."""
        return True

    def readinto(self, buffer: Any) -> int:
        """Reads the bytes available into a buffer."""
        data = self._read(len(buffer)) or b""
        buffer[: len(data)] = data
        self.hash.update(data)
        self.count += len(data)
        return len(data)


class CsvTable:
    """Comma-separated values with a line of column names, UTF-8, a byte-order mark allowed.

    Args:
        binary: the stream; closed by `close`, but for standard input.
        source: what to call it in messages.
        rows_per_block: at most; 1 hands out each row as it arrives.
        size: of the stream, bytes; 0: unknown.

    Raises:
        InputError: when the first line has no names, or one of them twice.
    """

    place, own_times = "line", False
    notes: Sequence[str] = ()

    def __init__(self, binary: IO[bytes], source: str, rows_per_block: int, size: int = 0):
        self._binary = binary
        self.source = source
        self._rows_per_block = rows_per_block
        self._size = size
        self._watched = _Watched(binary)
        self._suspicious = False  # whether the last line may hold what `float` takes, but a cell must not
        self._line = 0
        self._unended = False  # whether the last line has no end
        self._zeros: list[Loss] = []
        self.ragged = Ragged()
        self._text = self._lines()
        self.header = self._read_header()

    def where(self, line: int, _column: str) -> str:
        """Returns the place of a row."""
        return f"{self.source}, {self.place} {line}"

    @property
    def done(self) -> float:
        """Fraction of the file read so far."""
        return self._watched.count / self._size if self._size else 0.0

    @property
    def losses(self) -> Sequence[Loss]:
        """Losses so far."""
        return [*self._zeros, *self.ragged.losses(self.source)]

    def sha256(self) -> str:
        """Returns SHA-256 of the bytes read so far, hexadecimal."""
        return self._watched.hash.hexdigest()

    def close(self) -> None:
        """Closes the stream."""
        self._binary.close()

    def _lines(self) -> Iterator[str]:
        text = io.TextIOWrapper(io.BufferedReader(self._watched, 1 << 16), encoding="utf-8-sig", newline="")
        for number, line in text_lines(text, self.source, self._zeros):
            self._line = number
            self._suspicious = "_" in line
            self._unended = line[-1] not in "\r\n"
            yield line

    def _rows(self) -> Iterator[list[str]]:
        """Yields the cells of each row; a line in which nothing is quoted needs only be split, which is faster."""
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
        row = next((row for row in self._rows() if row), None)
        if row is None:
            raise InputError(f"{self.source}: is empty; expected a line of column names, time_s first")
        header = [name.strip() for name in row]
        for separator, name in ((";", "semicolons"), ("\t", "tabs")):
            if len(header) <= 2 and separator in row[0]:
                where = f"{self.source}, line {self._line}"
                expected = "expected commas; 'massprop map' proposes a map of other files"
                raise InputError(f"{where}: columns are separated by {name}; {expected}")
        if all(_NUMBER.fullmatch(name) for name in header if name):
            raise InputError(f"{self.source}, line {self._line}: has numbers; expected a line of column names")
        _require_unique(header, f"{self.source}, line {self._line}")
        return header

    def blocks(self, wanted: list[int]) -> Iterator[Block]:
        """Yields the values of the chosen columns, block by block.

        Raises:
            InputError: when a cell is neither a number nor missing, or too many rows have a wrong length.
        """
        width = len(self.header)
        pick, ending = _picker(wanted, width), Ending()
        numeric = width - 1 in wanted
        lines: list[int] = []
        values = array("d")
        good, pending = 0, 0  # rows taken; line of a ragged row that may be the last
        for row in self._rows():
            if not row:
                continue
            if pending:
                self.ragged.add(pending)
                self.ragged.last_incomplete = False
                self._require_regular(good)
                pending = 0
            if len(row) != width or (self._unended and ending.is_cut(row[-1], number=numeric)):
                pending, self.ragged.last_incomplete = self._line, len(row) <= width
                continue
            ending.saw(row[-1])
            cells = pick(row)
            try:
                values.extend(map(float, self._strictly(cells, wanted) if self._suspicious else cells))
            except ValueError:
                del values[len(lines) * len(wanted) :]
                values.extend(self._strictly(cells, wanted))
            lines.append(self._line)
            good += 1
            if len(lines) == self._rows_per_block:
                yield self._block(lines, values, wanted)
                lines, values = [], array("d")
        if lines:
            yield self._block(lines, values, wanted)
        if pending:
            self.ragged.add(pending)
        self._require_regular(good, at_end=True)

    def _strictly(self, cells: Sequence[str], wanted: list[int]) -> list[float]:
        return [self._number(cell, self.header[column]) for cell, column in zip(cells, wanted, strict=True)]

    def _number(self, cell: str, column: str) -> float:
        text = cell.strip()
        if text.lower() in MISSING:
            return np.nan
        if text.lower().lstrip("+-") in ("inf", "infinity"):
            raise InputError(_infinite(f"{self.source}, line {self._line}", column))
        if not _NUMBER.fullmatch(text):
            shown = text if len(text) <= 40 else text[:37] + "..."
            raise InputError(
                f"{self.source}, line {self._line}, column {column}: {shown!r} is not a number; "
                "leave the cell empty where there is no value"
            )
        return float(text)

    def _block(self, lines: list[int], values: array[float], wanted: list[int]) -> Block:
        block = Block(np.array(lines), np.frombuffer(values).reshape(len(lines), len(wanted)))
        require_meaningful(block, [self.header[column] for column in wanted], self.source, self.place)
        return block

    def _require_regular(self, good: int, *, at_end: bool = False) -> None:
        require_regular(self.ragged, self.source, good, len(self.header), at_end=at_end)


def require_regular(ragged: Ragged, source: str, good: int, width: int, *, at_end: bool = True) -> None:
    """Raises InputError where too many rows of a table have another number of cells than columns.

    Args:
        ragged: those that have.
        source: what to call the table.
        good: rows that have not.
        width: number of columns.
        at_end: whether all of the table has been read.
    """
    count = ragged.count
    if count > _FEW_RAGGED and count > (_RAGGED_SHARE if at_end else 0.5) * (good + count):
        raise InputError(
            f"{source}: {count} of {good + count} rows have another number of cells than the "
            f"{width} columns, first line {ragged.first_line}; check the separator and the export"
        )


def _picker(wanted: list[int], width: int) -> Callable[[list[str]], Sequence[str]]:
    """Makes a function that returns the wanted cells of a row of so many."""
    if wanted == list(range(width)):
        return lambda row: row
    if len(wanted) == 1:
        return lambda row: [row[wanted[0]]]
    return itemgetter(*wanted)


def _require_unique(header: list[str], where: str) -> None:
    seen: set[str] = set()
    for name in header:
        if name and name in seen:
            raise InputError(f"{where}: column '{name}' appears twice; keep one of them")
        seen.add(name)


def _infinite(where: str, column: str) -> str:
    return f"{where}, column {column}: is infinite; leave the cell empty where there is no value"


def require_meaningful(block: Block, columns: Sequence[str], source: str, place: str) -> None:
    """Requires that all values of a block are finite and of some meaning; raises InputError with the place of another.

    Args:
        block: of a table.
        columns: names of its columns.
        source: what to call the table in messages.
        place: what its rows are counted in.
    """
    wrong = np.abs(block.values) > LARGEST  # NaN is not
    if wrong.any():
        row, column = np.argwhere(wrong)[0]
        where = f"{source}, {place} {block.lines[row]}"
        value = float(block.values[row, column])
        if math.isinf(value):
            raise InputError(_infinite(where, columns[column]))
        raise InputError(f"{where}, column {columns[column]}: {value:g} is too large to mean anything")


# ---------------------------------------------------------------------------------------- Parquet


class ParquetTable:
    """A Parquet file, read by pyarrow.

    Args:
        path: of the file.
        rows_per_block: at most.

    Raises:
        InputError: when pyarrow is not installed, or the file is no Parquet file.
    """

    place, own_times = "row", False
    notes: Sequence[str] = ()

    def __init__(self, path: Path, rows_per_block: int):
        self._arrow, self._file = open_parquet(path)
        self._path = path
        self.source = str(path)
        self._rows_per_block = rows_per_block
        self.ragged = Ragged()
        self.losses: list[Loss] = []
        self._read = 0
        self.header = list(self._file.schema_arrow.names)
        self._rows = self._file.metadata.num_rows
        _require_unique(self.header, str(path))

    def where(self, line: int, _column: str) -> str:
        """Returns the place of a row."""
        return f"{self.source}, {self.place} {line}"

    @property
    def done(self) -> float:
        """Fraction of the rows read so far."""
        return self._read / self._rows if self._rows else 0.0

    def sha256(self) -> str:
        """Returns SHA-256 of the file, hexadecimal."""
        with self._path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()

    def close(self) -> None:
        """Closes the file."""
        self._file.close()

    def blocks(self, wanted: list[int]) -> Iterator[Block]:
        """Yields the values of the chosen columns, block by block.

        Raises:
            InputError: when a column holds no numbers.
        """
        arrow = self._arrow
        names = [self.header[column] for column in wanted]
        schema = self._file.schema_arrow  # made anew each time that it is asked for
        for name in names:
            kind = schema.field(name).type
            number = arrow.types.is_integer(kind) or arrow.types.is_floating(kind) or arrow.types.is_boolean(kind)
            if not (number or arrow.types.is_decimal(kind) or arrow.types.is_null(kind)):
                raise InputError(f"{self._path}, column {name}: holds {kind}; expected numbers")
        for first, batch in parquet_batches(self._file, names, self._rows_per_block, self.source, self.losses):
            columns = [self._numbers(batch.column(name)) for name in names]
            self._read = first + batch.num_rows
            block = Block(first + 1 + np.arange(batch.num_rows), np.column_stack(columns))
            require_meaningful(block, names, str(self._path), self.place)
            yield block

    def _numbers(self, column: Any) -> Array:
        if self._arrow.types.is_boolean(column.type):
            column = column.cast(self._arrow.int8())
        values: Array = column.cast(self._arrow.float64(), safe=False).to_numpy(zero_copy_only=False)
        return np.array(values, dtype=float)


def open_parquet(path: Path) -> tuple[Any, Any]:
    """Returns the module pyarrow, and a Parquet file that it has opened.

    Raises:
        InputError: when pyarrow is not installed, or the file is no Parquet file.
    """
    try:
        import pyarrow  # noqa: PLC0415 (an extra, and slow to load)
        from pyarrow import parquet  # noqa: PLC0415
    except ImportError:
        raise InputError(
            f"{path}: reading Parquet needs pyarrow: pip install 'massprop-drake[parquet]', or give CSV"
        ) from None
    try:
        # neither whole row groups nor the whole file are kept in memory
        file = parquet.ParquetFile(path, buffer_size=1 << 20, pre_buffer=False, page_checksum_verification=True)
        file.schema_arrow.names  # noqa: B018 (a damaged schema is told here)
    except (OSError, ValueError, pyarrow.ArrowException) as error:
        reason = _first_line(error)
        with contextlib.suppress(OSError), path.open("rb") as bytes_of:
            begin, size = bytes_of.read(4), bytes_of.seek(0, os.SEEK_END)
            bytes_of.seek(max(size - 4, 0))
            if begin == _PARQUET != bytes_of.read(4):
                reason = "it is cut off: its end is missing, which says where its columns are"
        raise InputError(f"{path}: not a Parquet file that can be read: {reason}") from None
    return pyarrow, file


def parquet_batches(
    file: Any, names: Sequence[str], rows: int, source: str, losses: list[Loss]
) -> Iterator[tuple[int, Any]]:
    """Yields a Parquet file's rows in batches, each after the number of rows before it; damaged parts are left out.

    Args:
        file: opened by pyarrow.
        names: of the columns.
        rows: of a batch, at the most.
        source: what to call the file in messages.
        losses: takes in what is lost.

    Raises:
        InputError: when none of its rows can be read.
    """
    import pyarrow  # noqa: PLC0415 (slow to load)

    begin, lost, reason = 0, 0, ""
    for group in range(file.metadata.num_row_groups):
        place, begin = begin, begin + file.metadata.row_group(group).num_rows
        try:
            for batch in file.iter_batches(batch_size=rows, row_groups=[group], columns=list(names)):
                yield place, batch
                place += batch.num_rows
        except (OSError, ValueError, pyarrow.ArrowException) as error:
            if isinstance(error, InputError):
                raise
            lost, reason = lost + begin - place, _first_line(error)
            losses.append(Loss("damaged", f"{source}: rows {place + 1} to {begin} are damaged, and left out: {reason}"))
    if lost and lost == begin:
        raise InputError(f"{source}: none of its {counted(lost, 'row')} can be read: {reason}")
    if file.metadata.num_rows != begin:
        stated = counted(file.metadata.num_rows, "row")
        losses.append(Loss("damaged", f"{source}: says that it has {stated}, and has {begin}"))


def _first_line(error: Exception) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0]
