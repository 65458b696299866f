"""Recordings: the columns of a file of any recorder, by topic, and what opens them."""

from __future__ import annotations

import csv
import hashlib
import re
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import chain, islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from massprop_drake.errors import InputError, require_text, suggestion
from massprop_drake.inputs.record_map import CsvForm, RecordMap
from massprop_drake.inputs.yaml import exists
from massprop_drake.telemetry.tables import (
    MISSING,
    Ending,
    Loss,
    Ragged,
    open_parquet,
    parquet_batches,
    require_file,
    require_regular,
    text_lines,
)

Array = NDArray[np.float64]
Column = NDArray[Any]

MOST_ELEMENTS = 64  # of an array that become columns: an image has more, a vehicle's jets fewer
_MOST_COLUMNS = 4096  # of a table for which a map can be proposed: a budget of seconds
_LOOKED_AT = 50  # rows of text by which the decimal mark is told
_CHUNK = 4096  # rows of text that are turned into numbers at once


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
    """

    source: str
    columns: Mapping[str, Column]
    stamps_s: Array | None = None
    place: str = "row"
    lines: NDArray[np.int64] | None = None
    unread: tuple[str, ...] = ()

    @property
    def rows(self) -> int:
        """The number of rows."""
        if self.stamps_s is not None:
            return len(self.stamps_s)
        return len(next(iter(self.columns.values()), ()))

    def column(self, name: str) -> Column:
        """A column; raises InputError where there is none of that name."""
        if name not in self.columns:
            raise InputError(f"{self.source}: no column '{name}'{suggestion(name, [*self.columns, *self.unread])}")
        return self.columns[name]

    def where(self, row: int) -> str:
        """The place of a row, for messages."""
        line = row + 1 if self.lines is None else int(self.lines[row])
        return f"{self.source}, {self.place} {line}"

    def numbers(self, name: str) -> Array:
        """A column's numbers, NaN where missing, shape (n,).

        Raises:
            InputError: when it is not there, or holds text or infinity.
        """
        values = self.column(name)
        if values.dtype == object:
            for row, cell in enumerate(values):
                if not _is_number(cell):
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

    def texts(self, name: str) -> list[str]:
        """A column's cells as text."""
        return ["" if cell is None else str(cell) for cell in self.column(name)]


@dataclass(frozen=True)
class Recording:
    """What a file holds.

    Attributes:
        source: its name in messages.
        kind: "table", "mat", "ulog", "ros1" or "ros2".
        topics: by name; a table is the topic "".
        parameters: of the vehicle, as a ULog has them, by name.
        notes: what is to be known of it, a sentence each.
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
    sha256: str = ""
    types: Mapping[str, str] = field(default_factory=dict)
    ragged: Ragged = field(default_factory=Ragged)
    form: CsvForm = field(default_factory=CsvForm)
    losses: tuple[Loss, ...] = ()

    def topic(self, name: str) -> Topic:
        """A topic; raises InputError where there is none of that name."""
        if name not in self.topics:
            raise missing_topic(self.source, name, list(self.topics), self.losses)
        return self.topics[name]


def _is_number(cell: Any) -> bool:
    text = str(cell).strip().lower()
    if text in MISSING:
        return True
    try:
        float(text)
    except ValueError:
        return False
    return "_" not in text


def open_recording(path: str | Path, by: RecordMap | None = None, rows: int | None = None) -> Recording:
    """Reads a file of any kind that is known, told by its ending.

    Args:
        path: of a CSV, Parquet, .mat, ULog (.ulg), ROS 1 (.bag), ROS 2 (folder, .db3) or MCAP (.mcap) file.
        by: the map, of whose columns and topics alone are read; None: all that can be.
        rows: so many at the most of each topic; None: all.

    Raises:
        InputError: when it is missing, of no known kind, damaged, or a package is needed that is not installed.
    """
    path = Path(path)
    require_text(str(path))
    if str(path) == "-":
        raise InputError("a map goes with a file, not with standard input, whose rows are telemetry as they stand")
    if not exists(path):
        raise InputError(f"{path}: no such file")
    ending = path.suffix.lower()
    if path.is_dir() and not _has_a_bag(path):
        raise InputError(f"{path}: is a folder, and no ROS 2 bag, which has files .db3 or .mcap")
    reader = _READERS.get("" if path.is_dir() else ending)
    if reader is None:
        known = ", ".join(sorted(one for one in _READERS if one))
        raise InputError(f"{path}: '{ending}' is no ending of a record that is known; known are {known}")
    require_file(path)
    found = reader(path, by, rows)
    if by is not None and by.cut_off == "refuse" and found.losses:
        raise InputError(*(f"{one.text}; the map has `cut_off: refuse`" for one in found.losses))
    if not any(topic.rows for topic in found.topics.values()):
        nothing = "has no row of data"
        if found.losses:
            raise InputError(*(f"{one.text}; it {nothing} that can be read" for one in found.losses))
        raise InputError(f"{path}: is empty: it {nothing}")
    return found


def require_table(path: str | Path) -> None:
    """Requires that a record can be read without a map, as far as its name tells.

    Raises:
        InputError: for a file of another program's, which says what it is and, where it is damaged, how.
    """
    path = Path(path)
    kind = "a ROS bag" if _has_a_bag(path) else _FOREIGN.get(path.suffix.lower())
    if kind is None or not exists(path):
        return
    require_file(path)
    try:
        open_recording(path, None, 1)
    except InputError as error:
        raise InputError(f"{error}; besides, {kind} needs a map (--map), which 'massprop map' proposes") from None
    raise InputError(f"{path}: is {kind}, and needs a map (--map) of what is in it; 'massprop map' proposes one")


def _has_a_bag(path: Path) -> bool:
    """Whether a path is a folder with the files of a bag of ROS 2."""
    try:
        return path.is_dir() and any({".db3", ".mcap"} & set(one.suffixes) for one in path.iterdir())
    except (OSError, ValueError):
        return False


def missing_topic(source: str, name: str, known: list[str], losses: Sequence[Loss] = ()) -> InputError:
    """The error for a topic that a recording does not have, or lost."""
    if not name:
        shown = ", ".join(known[:10]) + (", ..." if known[10:] else "")
        return InputError(f"{source}: has topics, and the map names none: give `topic`, one of {shown}")
    if known == [""]:
        return InputError(f"{source}: is a table without topics, and the map names topic '{name}'")
    lost = f"; besides, {losses[0].text}" if losses else ""
    return InputError(f"{source}: no topic '{name}'{suggestion(name, known)}{lost}")


def needs(path: Path, package: str, extra: str, what: str) -> InputError:
    """The error that names the extra to install."""
    return InputError(f"{path}: reading {what} needs {package}: pip install 'massprop-drake[{extra}]'")


def digest(path: Path) -> str:
    """SHA-256 of a file, or of all files of a folder in their order, hexadecimal."""
    if path.is_dir():
        total = hashlib.sha256()
        for inner in sorted(one for one in path.iterdir() if one.is_file()):
            total.update(f"{inner.name} {digest(inner)}\n".encode())
        return total.hexdigest()
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


# ---------------------------------------------------------------------------------------- tables


def _csv(path: Path, by: RecordMap | None, rows: int | None) -> Recording:
    as_text = set() if by is None or by.commands.listed is None else {by.commands.listed.column}
    losses: list[Loss] = []
    try:
        form = _form_of(path) if by is None else by.csv
        with path.open(encoding="utf-8-sig", newline="") as file:
            numbered = _plain_lines(file, form, losses)
            where = _Where()
            cells = csv.reader(where.watched(numbered), delimiter=form.separator, strict=True)
            header = [name.strip() for name in next(cells, [])]
            _require_names(header, form, f"{path}, line {where.line}")
            if by is None:
                _require_few(path, header)
            read = set(header) if by is None else by.columns
            wanted = [name for name in header if name and name in read]
            columns, lines, ragged = _gathered(cells, header, wanted, (form, as_text, rows, where))
    except UnicodeDecodeError:
        raise InputError(f"{path}: not a text file in UTF-8; expected a table of separated values") from None
    except csv.Error as error:
        raise InputError(f"{path}: no table of separated values: {error}") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None
    require_regular(ragged, str(path), len(lines), len(header))
    topic = Topic(str(path), columns, None, "line", lines, _besides(header, wanted))
    losses += ragged.losses(str(path))
    return Recording(
        str(path), "table", {"": topic}, sha256=digest(path), ragged=ragged, form=form, losses=tuple(losses)
    )


def _besides(every: Sequence[str], wanted: Sequence[str]) -> tuple[str, ...]:
    """The named columns that are not wanted."""
    known = set(wanted)
    return tuple(name for name in every if name and name not in known)


def _require_few(path: Path, names: Sequence[str]) -> None:
    """Requires that a table has no more columns than a map can be proposed for."""
    if len(names) > _MOST_COLUMNS:
        raise InputError(
            f"{path}: has {len(names)} columns, and a map is proposed for at most {_MOST_COLUMNS}; write the map "
            "(docs/records.md), of which the columns it names are read, or keep those of sensors and jets"
        )


_SEPARATORS = (",", ";", "\t")
_WITH_COMMA = re.compile(r"\s*[+-]?\d+,\d+(?:[eE][+-]?\d+)?\s*")


def _form_of(path: Path) -> CsvForm:
    """How a text file is written, where no map says it: what separates the names, and the decimal mark below them."""
    with path.open(encoding="utf-8-sig") as file:
        lines = islice((line for line in file if line.strip()), 1 + _LOOKED_AT)
        names = next(lines, "")
        separator = max(_SEPARATORS, key=names.count)
        cells = chain.from_iterable(line.split(separator) for line in lines)
        comma = separator != "," and any(map(_WITH_COMMA.fullmatch, cells))
    return CsvForm(separator=separator, decimal="," if comma else ".")


class _Where:
    """The line that is being read.

    Attributes:
        line: its number.
        unended: whether it has no end, as the last of a file may.
    """

    def __init__(self) -> None:
        self.line = 0
        self.unended = False

    def watched(self, numbered: Iterator[tuple[int, str]]) -> Iterator[str]:
        for self.line, text in numbered:
            self.unended = text[-1] not in "\r\n"
            yield text


def _plain_lines(file: Any, form: CsvForm, losses: list[Loss]) -> Iterator[tuple[int, str]]:
    """The lines of names and rows, with their numbers."""
    seen = 0
    for number, line in text_lines(file, file.name, losses):
        if number <= form.skip or not line.strip() or (form.comment and line.startswith(form.comment)):
            continue
        seen += 1
        if seen == 1 or seen > 1 + form.below:
            yield number, line


def _require_names(header: list[str], form: CsvForm, where: str) -> None:
    if not header:
        raise InputError(f"{where.rpartition(', line')[0]}: is empty; expected a line of column names")
    for separator, name in ((";", "semicolons"), ("\t", "tabs"), (",", "commas")):
        if len(header) == 1 and separator in header[0] and separator != form.separator:
            raise InputError(
                f"{where}: columns are separated by {name}; give `csv: {{separator: {separator!r}}}` in the map"
            )
    if all(_is_number(name) for name in header if name):
        raise InputError(f"{where}: has numbers; expected a line of column names")
    twice = next((name for name, count in Counter(header).items() if name and count > 1), None)
    if twice is not None:
        raise InputError(f"{where}: column '{twice}' appears twice; keep one of them")


def _gathered(
    cells: Iterator[list[str]],
    header: list[str],
    wanted: list[str],
    how: tuple[CsvForm, set[str], int | None, _Where],
) -> tuple[dict[str, Column], NDArray[np.int64], Ragged]:
    """The wanted columns, the line of each row, and the rows that have another number of cells."""
    form, as_text, most, where = how
    place_of = {name: place for place, name in reversed(list(enumerate(header)))}
    places = [place_of[name] for name in wanted]
    pieces: list[list[Column]] = [[] for _ in wanted]
    held: list[list[str]] = [[] for _ in wanted]
    lines: list[int] = []
    ragged, ending = Ragged(), Ending()

    def settle() -> None:
        for name, piece, column in zip(wanted, pieces, held, strict=True):
            piece.append(_as_numbers(column, form.decimal) if name not in as_text else np.array(column, dtype=object))
            column.clear()

    def numeric() -> bool:
        """Whether the last column, of names that are wanted, has numbers so far."""
        if header[-1] not in wanted or header[-1] in as_text:
            return False
        above = held[wanted.index(header[-1])]
        return above != [] and all(_is_number(one.replace(form.decimal, ".")) for one in above)

    for row in _whole(cells, where):
        cut = (
            where.unended
            and len(row) == len(header)
            and ending.is_cut(row[-1].replace(form.decimal, "."), number=numeric())
        )
        ragged.last_incomplete = cut or len(row) < len(header)
        if cut or len(row) != len(header):
            ragged.add(where.line)
            continue
        ending.saw(row[-1])
        for place, column in zip(places, held, strict=True):
            column.append(row[place])
        lines.append(where.line)
        if len(lines) % _CHUNK == 0:
            settle()
        if most is not None and len(lines) >= most:
            break
    settle()
    return {name: _joined(piece) for name, piece in zip(wanted, pieces, strict=True)}, np.array(lines, np.int64), ragged


def _whole(cells: Iterator[list[str]], where: _Where) -> Iterator[list[str]]:
    """The cells of each row; one that ends within quotes, with the file, has none."""
    try:
        yield from cells
    except csv.Error:
        if not where.unended:
            raise
        yield []


def _as_numbers(cells: list[str], decimal: str) -> Column:
    """Cells as numbers if all of them are, else as text."""
    if decimal != ".":
        cells = [cell.replace(decimal, ".") for cell in cells]
    try:
        return np.array(cells, dtype=float)
    except ValueError:
        pass
    if all(map(_is_number, cells)):
        return np.array([np.nan if cell.strip().lower() in MISSING else float(cell) for cell in cells])
    return np.array(cells, dtype=object)


def _joined(pieces: Sequence[Column]) -> Column:
    if any(piece.dtype == object for piece in pieces):
        pieces = [
            piece if piece.dtype == object else np.array([repr(one) for one in piece], object) for piece in pieces
        ]
    return np.concatenate(pieces)


def _parquet(path: Path, by: RecordMap | None, rows: int | None) -> Recording:
    pyarrow, file = open_parquet(path)
    every = names = file.schema_arrow.names
    if by is None:
        _require_few(path, every)
    else:
        read = {name.partition("[")[0] for name in by.columns} | by.columns
        names = [name for name in names if name in read]
    losses: list[Loss] = []
    places: list[NDArray[np.int64]] = []
    batches = []
    for first, batch in parquet_batches(file, names, _CHUNK, str(path), losses):
        batches.append(batch)
        places.append(np.arange(first + 1, first + 1 + batch.num_rows))
        if rows is not None and sum(map(len, places)) >= rows:
            break
    try:
        schema = file.schema_arrow
        table = pyarrow.Table.from_batches(batches, pyarrow.schema([schema.field(name) for name in names]))
        table = table.slice(0, rows)
        columns: dict[str, Column] = {}
        for name in names:
            columns |= _arrow_column(pyarrow, name, table.column(name))
        notes = _from_the_first(columns)
    except (OSError, ValueError, pyarrow.ArrowException) as error:
        first_line = (str(error).splitlines() or [type(error).__name__])[0]
        raise InputError(f"{path}: not a Parquet file that can be read: {first_line}") from None
    lines = np.concatenate([*places, np.empty(0, np.int64)])[: table.num_rows]
    topic = Topic(str(path), columns, lines=lines, unread=_besides(every, names))
    return Recording(str(path), "table", {"": topic}, notes=notes, sha256=digest(path), losses=tuple(losses))


def _from_the_first(columns: dict[str, Column]) -> tuple[str, ...]:
    """Makes dates and times count in seconds from the first second of them: a double has no room for the whole."""
    dated = {name: values for name, values in columns.items() if values.dtype.kind == "M"}
    firsts = [values[~np.isnat(values)].min() for values in dated.values() if not np.isnat(values).all()]
    if not firsts:
        return ()
    origin = min(firsts).astype("datetime64[s]")
    for name, values in dated.items():
        columns[name] = (values - origin) / np.timedelta64(1, "s")
    return (f"{', '.join(dated)}: times count in seconds from {origin}",)


def _arrow_column(arrow: Any, name: str, column: Any) -> dict[str, Column]:
    """The columns that a Parquet column gives."""
    kind, types = column.type, arrow.types
    if types.is_boolean(kind):
        column = column.cast(arrow.int8())
    if types.is_timestamp(kind):
        return {name: column.cast(arrow.timestamp("ns")).to_numpy()}
    if types.is_list(kind) or types.is_large_list(kind) or types.is_fixed_size_list(kind):
        return spread(name, column.to_pylist())
    if types.is_string(kind) or types.is_large_string(kind) or types.is_dictionary(kind):
        return {name: np.array([one or "" for one in column.to_pylist()], dtype=object)}
    if types.is_integer(kind) and not column.null_count:
        return {name: column.to_numpy()}
    if types.is_integer(kind) or types.is_floating(kind) or types.is_boolean(kind) or types.is_decimal(kind):
        return {name: column.cast(arrow.float64()).to_numpy()}
    return {}


def spread(name: str, values: Sequence[Sequence[Any] | None]) -> dict[str, Column]:
    """Columns of lists: `name[0]`, `name[1]`, ..., and `name`, their text, where their lengths differ."""
    lists = [() if one is None else tuple(one) for one in values]
    longest = max(map(len, lists), default=0)
    found: dict[str, Column] = {}
    if any(len(one) != longest for one in lists) or not longest:
        found[name] = np.array([" ".join(map(plainly, one)) for one in lists], dtype=object)
    if longest <= MOST_ELEMENTS and not any(isinstance(item, str) for one in lists for item in one):
        for index in range(longest):
            found[f"{name}[{index}]"] = np.array([one[index] if index < len(one) else np.nan for one in lists], float)
    elif name not in found and longest <= MOST_ELEMENTS:
        found[name] = np.array([" ".join(map(plainly, one)) for one in lists], dtype=object)
    return found


def plainly(item: Any) -> str:
    """An item of a list as it is compared with names: whole numbers without a point."""
    if isinstance(item, (float, np.floating)) and float(item).is_integer():
        return str(int(item))
    return str(item)


# --------------------------------------------------------------------------------------- kinds


def _mat(path: Path, by: RecordMap | None, rows: int | None) -> Recording:
    from massprop_drake.records.matlab import read  # noqa: PLC0415 (scipy is slow to load)

    return read(path, by, rows)


def _ulog(path: Path, by: RecordMap | None, rows: int | None) -> Recording:
    from massprop_drake.records.ulog import read  # noqa: PLC0415

    return read(path, by, rows)


def _bag(path: Path, by: RecordMap | None, rows: int | None) -> Recording:
    from massprop_drake.records.bags import read  # noqa: PLC0415

    return read(path, by, rows)


_READERS: dict[str, Callable[[Path, RecordMap | None, int | None], Recording]] = {
    **dict.fromkeys((".csv", ".tsv", ".txt"), _csv),
    **dict.fromkeys((".parquet", ".pq"), _parquet),
    ".mat": _mat,
    **dict.fromkeys((".ulg", ".ulog"), _ulog),
    **dict.fromkeys((".bag", ".mcap", ".db3", ""), _bag),
}
_FOREIGN = {
    ".mat": "a .mat file",
    **dict.fromkeys((".ulg", ".ulog"), "a ULog"),
    **dict.fromkeys((".bag", ".mcap", ".db3"), "a ROS bag"),
}
