"""Recordings: the columns of a file of any recorder, by topic, and the functions that open them."""

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
from massprop_drake.inputs.units import parsed
from massprop_drake.inputs.yaml import exists
from massprop_drake.records.tables import (
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
_LOOKED_AT = 100  # lines of text by which its form is told
_LOOKED_ACROSS = 200  # cells of such a line that are looked at
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
        """Number of rows."""
        if self.stamps_s is not None:
            return len(self.stamps_s)
        return len(next(iter(self.columns.values()), ()))

    def column(self, name: str) -> Column:
        """Returns a column; raises InputError where there is none of that name."""
        if name not in self.columns:
            raise InputError(f"{self.source}: no column '{name}'{suggestion(name, [*self.columns, *self.unread])}")
        return self.columns[name]

    def where(self, row: int) -> str:
        """Returns the place of a row, for messages."""
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
        """Returns a column's times, s, NaN where missing, shape (n,): numbers of a unit, or ISO 8601 stamps.

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
            both = [f"{day.strip()} {clock.strip()}" if day.strip() and clock.strip() else "" for day, clock in pairs]
            values = np.array(both, dtype=object)
        filled = [cell for cell in values if str(cell).strip().lower() not in MISSING] if values.dtype == object else []
        if not filled or any(map(is_number, filled)):
            return self.numbers(name) * unit_s
        stamps = [stamp_of(str(cell)) for cell in values]
        wrong = [row for row, stamp in enumerate(stamps) if stamp is None]
        if wrong:
            raise InputError(
                f"{self.where(wrong[0])}, column {name}: {str(values[wrong[0]])[:40]!r} is neither a number nor an "
                "ISO 8601 stamp such as 2024-05-01T12:00:00.25Z"
            )
        since = np.array(stamps, "datetime64[ns]") - np.datetime64(0, "s")
        seconds, rest = since.astype("timedelta64[s]"), since % np.timedelta64(1, "s")
        found: Array = seconds / np.timedelta64(1, "s") + rest / np.timedelta64(1, "s")
        return found

    def texts(self, name: str) -> list[str]:
        """Returns a column's cells as text."""
        return ["" if cell is None else str(cell) for cell in self.column(name)]


@dataclass(frozen=True)
class Recording:
    """Content of a file of any recorder.

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
        """Returns a topic; raises InputError where there is none of that name."""
        if name not in self.topics:
            raise missing_topic(self.source, name, list(self.topics), self.losses)
        return self.topics[name]


_ZONE = re.compile(
    r"(?P<stamp>.*\d)\s*(?:Z|UTC|GMT)|(?P<local>.*:.*\d)\s*(?P<hours>[+-]\d\d)(?::?(?P<minutes>\d\d))?", re.IGNORECASE
)
_DAY_OF_YEAR = re.compile(r"(\d{4})-(\d{3})(?=$|[T ])")
_CLOCK = re.compile(r"\d\d?:\d\d(:|$)")
_SPELLED = re.compile(r"(\d\d?)[ -]([A-Za-z]{3})[ -](\d{4})(?=\s)")
_MONTHS = ("jan", "feb", "mar", "apr", "may", "jun", "jul", "aug", "sep", "oct", "nov", "dec")


def stamp_of(text: str) -> np.datetime64 | None:
    """Parses a stamp in UTC, of a clock alone on the first day; None for other text.

    A stamp is one of ISO 8601, also with the day of the year, or a date like 01 Jan 2000. One without a zone is UTC.
    """
    text = text.strip()
    if text.lower() in MISSING:
        return np.datetime64("NaT")
    zone, ahead = _ZONE.fullmatch(text), np.timedelta64(0, "m")
    if zone is not None and zone["hours"]:
        minutes = 60 * int(zone["hours"][1:]) + int(zone["minutes"] or 0)
        ahead = np.timedelta64(-minutes if zone["hours"][0] == "-" else minutes, "m")
    plain = (text if zone is None else zone["stamp"] or zone["local"]).replace("/", "-").replace(",", ".")
    if _CLOCK.match(plain):
        plain = f"1970-01-01T{plain if plain[2] == ':' else '0' + plain}"
    spelled = _SPELLED.match(plain)
    if spelled is not None and spelled.group(2).lower() in _MONTHS:
        date = int(spelled.group(3)), 1 + _MONTHS.index(spelled.group(2).lower()), int(spelled.group(1))
        plain = "{:04d}-{:02d}-{:02d}".format(*date) + plain[spelled.end() :]
    of_year, day = _DAY_OF_YEAR.match(plain), np.timedelta64(0, "D")
    if of_year is not None:
        day = np.timedelta64(int(of_year.group(2)) - 1, "D")
        plain = f"{of_year.group(1)}-01-01{plain[of_year.end() :]}"
    try:
        return np.datetime64(plain, "ns") + day - ahead if plain[:4].isdigit() and plain[4:5] == "-" else None
    except ValueError:
        return None


def is_number(cell: Any) -> bool:
    """Tests whether a cell is a number, or missing."""
    text = str(cell).strip().lower()
    if text in MISSING:
        return True
    try:
        float(text)
    except ValueError:
        return False
    return "_" not in text


_MAPS = "'massprop map' proposes one, and 'massprop estimate --map' takes it"


def open_recording(path: str | Path, by: RecordMap | None = None, rows: int | None = None) -> Recording:
    """Reads a file of any known kind, recognized by its ending.

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
    """Requires that a record can be read without a map, by its name.

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
        raise InputError(f"{error}; besides, {kind} needs a map: {_MAPS}") from None
    raise InputError(f"{path}: is {kind}, and needs a map of what is in it: {_MAPS}")


def _has_a_bag(path: Path) -> bool:
    """Tests whether a path is a folder with the files of a bag of ROS 2."""
    try:
        return path.is_dir() and any({".db3", ".mcap"} & set(one.suffixes) for one in path.iterdir())
    except (OSError, ValueError):
        return False


def missing_topic(source: str, name: str, known: list[str], losses: Sequence[Loss] = ()) -> InputError:
    """Makes the error for a topic that a recording does not have, or lost."""
    if not name:
        shown = ", ".join(known[:10]) + (", ..." if known[10:] else "")
        return InputError(f"{source}: has topics, and the map names none: give `topic`, one of {shown}")
    if known == [""]:
        return InputError(f"{source}: is a table without topics, and the map names topic '{name}'")
    lost = f"; besides, {losses[0].text}" if losses else ""
    return InputError(f"{source}: no topic '{name}'{suggestion(name, known)}{lost}")


def needs(path: Path, package: str, extra: str, what: str) -> InputError:
    """Makes the error that names the extra to install."""
    return InputError(f"{path}: reading {what} needs {package}: pip install 'massprop-drake[{extra}]'")


def digest(path: Path) -> str:
    """Computes SHA-256 of a file, or of all files of a folder in their order, hexadecimal."""
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
        form, units = _form_of(path) if by is None else (by.csv, [])
        with path.open(encoding="utf-8-sig", newline="") as file:
            numbered = _plain_lines(file, form, losses)
            where = _Where()
            lined = where.watched(numbered)
            named = next(lined, "")
            header = _cells(named, form.separator)
            marked = named.strip().partition(form.separator)[0].strip()
            if by is not None and _mark(named) and marked in by.columns:
                header[0] = marked
            cells = csv.reader(lined, delimiter=form.separator, strict=True)
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
    topic = Topic(
        str(path),
        columns,
        None,
        "line",
        lines,
        _besides(header, wanted),
        dict(zip(header, map(unit_in, units), strict=False)),
    )
    losses += ragged.losses(str(path))
    return Recording(
        str(path), "table", {"": topic}, sha256=digest(path), ragged=ragged, form=form, losses=tuple(losses)
    )


def _besides(every: Sequence[str], wanted: Sequence[str]) -> tuple[str, ...]:
    """Returns the named columns that are not wanted."""
    known = set(wanted)
    return tuple(name for name in every if name and name not in known)


def _require_few(path: Path, names: Sequence[str]) -> None:
    """Requires that a table has no more columns than a map can be proposed for."""
    if len(names) > _MOST_COLUMNS:
        raise InputError(
            f"{path}: has {len(names)} columns, and a map is proposed for at most {_MOST_COLUMNS}; write the map "
            "(docs/records.md), of which the columns it names are read, or keep those of sensors and jets"
        )


_SEPARATORS = (",", ";", "\t", " ")  # the likelier first; a blank is any run of blanks and tabs
_MARKS = ("#", "%", "//")  # that begin comments, and lines of names
_WITH_COMMA = re.compile(r"\s*[+-]?\d+,\d+(?:[eE][+-]?\d+)?\s*")
_BLANK_NAME = re.compile(r"(?:[^\s\[(]|[\[(][^\])]*[\])])+(?:\s+[\[(][^\])]*[\])])?")  # with its unit in brackets


def _form_of(path: Path) -> tuple[CsvForm, list[str]]:
    """Detects the format of a text file, and the cells of a line of units below the names."""
    with path.open(encoding="utf-8-sig") as file:
        numbered = islice(((number, line) for number, line in enumerate(file, 1) if line.strip()), _LOOKED_AT)
        lines = [(number, line, _mark(line)) for number, line in numbered]
    if not lines:
        return CsvForm(), []
    counts = {one: [_count(line, one) for _, line, _ in lines] for one in _SEPARATORS}
    usual = {one: Counter(found).most_common(1)[0][0] for one, found in counts.items()}
    regular = {one: found.count(usual[one]) if usual[one] > 1 else 0 for one, found in counts.items()}
    separator = max(_SEPARATORS, key=lambda one: regular[one])
    whole = [index for index, count in enumerate(counts[separator]) if count == usual[separator]]
    cells = {index: _cells(lines[index][1], separator)[:_LOOKED_ACROSS] for index in whole}
    first = next((index for index in whole if not lines[index][2] and any(map(_is_value, cells[index]))), 0)
    comma = separator != "," and any(
        map(_WITH_COMMA.fullmatch, chain.from_iterable(cells[index] for index in whole if index >= first))
    )
    above = [index for index in whole if index < first]
    units = [index for index in above[1:] if _has_units(cells[index])]
    names = next((index for index in reversed(above) if index not in units), 0)
    comment = next((mark for _, _, mark in lines[first:] if mark), "")
    below = sum(not (comment and mark) for _, _, mark in lines[names + 1 : first])
    skip = lines[names][0] - 1 if names else 0
    form = CsvForm(separator=separator, decimal="," if comma else ".", skip=skip, below=below, comment=comment)
    return form, next((_cells(lines[index][1], separator) for index in units if index > names), [])


def _mark(line: str) -> str:
    """Returns the mark of a comment that a line begins with; "": none."""
    return next((mark for mark in _MARKS if line.lstrip().startswith(mark)), "")


def _count(line: str, separator: str) -> int:
    """Returns the number of cells in a line."""
    if separator == " " or '"' in line:
        return len(_cells(line, separator))
    return line.count(separator) + 1


def _cells(line: str, separator: str) -> list[str]:
    """Returns the cells of a line, without the mark of a comment."""
    mark = _mark(line)
    line = line.strip(" \r\n").removeprefix(mark)
    if separator == " ":
        return [one.group() for one in _BLANK_NAME.finditer(line)] if mark or set("[(") & set(line) else line.split()
    return [cell.strip() for cell in next(csv.reader([line], delimiter=separator), [])]


def _is_value(cell: str) -> bool:
    """Tests whether a cell is a number or a date, so that its line is a row."""
    if cell.strip().lower() in MISSING:
        return False
    return is_number(cell.replace(",", ".")) or stamp_of(cell) is not None


def _has_units(cells: list[str]) -> bool:
    """Tests whether most cells of a line are units."""
    found = [unit_in(cell) for cell in cells if cell.strip("-[]() ")]
    return bool(found) and sum(map(bool, found)) > 0.5 * len(found)


def unit_in(text: str) -> str:
    """Reads a text as a unit, with or without brackets, as `inputs.units` has it; "": it is none."""
    text = text.strip().strip("[]()").strip()
    for one in (text, text.lower()):
        try:
            parsed(one)
        except InputError:
            continue
        return one
    return ""


class _Where:
    """Line that is being read.

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
    """Yields the lines of names and rows, with their numbers.

    The names are in the first line that is no comment, or, where that is a row already, in the first comment.
    """
    seen, commented = 0, None
    for number, line in text_lines(file, file.name, losses):
        if number <= form.skip or not line.strip():
            continue
        if form.comment and line.startswith(form.comment):
            commented = commented or (number, line)
            continue
        seen += 1
        if seen == 1 and commented and any(map(_is_value, _cells(line, form.separator))):
            yield commented
            seen += 1
        if seen == 1 or seen > 1 + form.below:
            yield number, line if seen == 1 or form.separator != " " else " ".join(line.split()) + "\n"


def _require_names(header: list[str], form: CsvForm, where: str) -> None:
    if not header:
        raise InputError(f"{where.rpartition(', line')[0]}: is empty; expected a line of column names")
    for separator, name in ((";", "semicolons"), ("\t", "tabs"), (",", "commas")):
        if len(header) == 1 and separator in header[0] and separator != form.separator:
            raise InputError(
                f"{where}: columns are separated by {name}; give `csv: {{separator: {separator!r}}}` in the map"
            )
    if all(is_number(name) for name in header if name):
        raise InputError(f"{where}: has numbers; expected a line of column names")
    twice = next((name for name, count in Counter(header).items() if name and count > 1), None)
    if twice is not None:
        raise InputError(f"{where}: column '{twice}' appears twice; keep one of them")


def _gathered(
    cells: Iterator[list[str]], header: list[str], wanted: list[str], how: tuple[CsvForm, set[str], int | None, _Where]
) -> tuple[dict[str, Column], NDArray[np.int64], Ragged]:
    """Collects the wanted columns, the line of each row, and the rows with another number of cells."""
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
        """Tests whether the last column, of names that are wanted, has numbers so far."""
        if header[-1] not in wanted or header[-1] in as_text:
            return False
        above = held[wanted.index(header[-1])]
        return above != [] and all(is_number(one.replace(form.decimal, ".")) for one in above)

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
    """Yields the cells of each row; one that ends within quotes, with the file, has none."""
    try:
        yield from cells
    except csv.Error:
        if not where.unended:
            raise
        yield []


def _as_numbers(cells: list[str], decimal: str) -> Column:
    """Returns cells as numbers if all of them are, else as text."""
    if decimal != ".":
        cells = [cell.replace(decimal, ".") for cell in cells]
    try:
        return np.array(cells, dtype=float)
    except ValueError:
        pass
    if all(map(is_number, cells)):
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
    """Converts dates and times to seconds from the first second of them: a double cannot hold the whole."""
    dated = {name: values for name, values in columns.items() if values.dtype.kind == "M"}
    firsts = [values[~np.isnat(values)].min() for values in dated.values() if not np.isnat(values).all()]
    if not firsts:
        return ()
    origin = min(firsts).astype("datetime64[s]")
    for name, values in dated.items():
        columns[name] = (values - origin) / np.timedelta64(1, "s")
    return (f"{', '.join(dated)}: times count in seconds from {origin}",)


def _arrow_column(arrow: Any, name: str, column: Any) -> dict[str, Column]:
    """Makes the columns of a Parquet column."""
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
        return {name: column.cast(arrow.float64(), safe=False).to_numpy()}
    return {}


def spread(name: str, values: Sequence[Sequence[Any] | None]) -> dict[str, Column]:
    """Splits a column of short lists into `name[0]`, `name[1]`, ...; where their lengths differ adds their text."""
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
    """Returns an item of a list as it is compared with names: whole numbers without a point."""
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
