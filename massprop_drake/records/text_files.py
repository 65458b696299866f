"""Tables of other programs in text files, whose separators, comments and units are found in the first lines."""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from itertools import chain, islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from massprop_drake.errors import InputError
from massprop_drake.inputs.record_map import CsvForm, RecordMap
from massprop_drake.inputs.units import parse_unit
from massprop_drake.records.completeness import MISSING, Ending, Loss, Ragged, text_lines
from massprop_drake.records.stamps import is_number, parse_stamp
from massprop_drake.records.tables import require_regular
from massprop_drake.records.topics import Column, Recording, Topic, digest, require_few_columns, unused_columns

_LOOKED_AT = 100  # lines of text by which its form is told
_LOOKED_ACROSS = 200  # cells of such a line that are looked at
CHUNK = 4096  # rows of text that are turned into numbers at once


def read_text_file(path: Path, record_map: RecordMap | None, rows: int | None) -> Recording:
    """Reads a text table, as its map says, into a recording of at most so many rows."""
    as_text = set() if record_map is None or record_map.commands.listed is None else {record_map.commands.listed.column}
    losses: list[Loss] = []
    try:
        form, units = _detect_form(path) if record_map is None else (record_map.csv, [])
        with path.open(encoding="utf-8-sig", newline="") as file:
            numbered = _plain_lines(file, form, losses)
            current = _CurrentLine()
            lined = current.follow(numbered)
            names_line = next(lined, "")
            header = _split_cells(names_line, form.separator)
            marked = names_line.strip().partition(form.separator)[0].strip()
            if record_map is not None and _comment_mark(names_line) and marked in record_map.columns:
                header[0] = marked
            cells = csv.reader(lined, delimiter=form.separator, strict=True)
            _require_names(header, form, f"{path}, line {current.line}")
            if record_map is None:
                require_few_columns(path, header)
            wanted_names = set(header) if record_map is None else record_map.columns
            wanted = [name for name in header if name and name in wanted_names]
            columns, lines, ragged = _collect_columns(cells, header, wanted, (form, as_text, rows, current))
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
        unused_columns(header, wanted),
        dict(zip(header, map(unit_in, units), strict=False)),
    )
    losses += ragged.losses(str(path))
    return Recording(
        str(path), "table", {"": topic}, sha256=digest(path), ragged=ragged, form=form, losses=tuple(losses)
    )


_SEPARATORS = (",", ";", "\t", " ")  # the likelier first; a blank is any run of blanks and tabs
_MARKS = ("#", "%", "//")  # that begin comments, and lines of names
_WITH_COMMA = re.compile(r"\s*[+-]?\d+,\d+(?:[eE][+-]?\d+)?\s*")
_BLANK_NAME = re.compile(r"(?:[^\s\[(]|[\[(][^\])]*[\])])+(?:\s+[\[(][^\])]*[\])])?")  # with its unit in brackets


def _detect_form(path: Path) -> tuple[CsvForm, list[str]]:
    """Detects separator, decimal, comments and skipped lines of a text file; returns these, and its cells of units."""
    with path.open(encoding="utf-8-sig") as file:
        numbered = islice(((number, line) for number, line in enumerate(file, 1) if line.strip()), _LOOKED_AT)
        lines = [(number, line, _comment_mark(line)) for number, line in numbered]
    if not lines:
        return CsvForm(), []
    counts = {one: [_count_cells(line, one) for _, line, _ in lines] for one in _SEPARATORS}
    common = {one: Counter(found).most_common(1)[0][0] for one, found in counts.items()}
    regular = {one: found.count(common[one]) if common[one] > 1 else 0 for one, found in counts.items()}
    separator = max(_SEPARATORS, key=lambda one: regular[one])
    whole = [index for index, count in enumerate(counts[separator]) if count == common[separator]]
    cells = {index: _split_cells(lines[index][1], separator)[:_LOOKED_ACROSS] for index in whole}
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
    return form, next((_split_cells(lines[index][1], separator) for index in units if index > names), [])


def _comment_mark(line: str) -> str:
    """Returns the comment mark, "#", "%" or "//", with which a line begins; "": none."""
    return next((mark for mark in _MARKS if line.lstrip().startswith(mark)), "")


def _count_cells(line: str, separator: str) -> int:
    """Returns the number of cells in a line, for a separator."""
    if separator == " " or '"' in line:
        return len(_split_cells(line, separator))
    return line.count(separator) + 1


def _split_cells(line: str, separator: str) -> list[str]:
    """Splits a line, without a comment mark before it, into its cells."""
    mark = _comment_mark(line)
    line = line.strip(" \r\n").removeprefix(mark)
    if separator == " ":
        return [one.group() for one in _BLANK_NAME.finditer(line)] if mark or set("[(") & set(line) else line.split()
    return [cell.strip() for cell in next(csv.reader([line], delimiter=separator), [])]


def _is_value(cell: str) -> bool:
    """Tests whether a cell is a number or a date, as in a row of data."""
    if cell.strip().lower() in MISSING:
        return False
    return is_number(cell.replace(",", ".")) or parse_stamp(cell) is not None


def _has_units(cells: list[str]) -> bool:
    """Tests whether most cells of a line are names of units."""
    units = [unit_in(cell) for cell in cells if cell.strip("-[]() ")]
    return bool(units) and sum(map(bool, units)) > 0.5 * len(units)


def unit_in(text: str) -> str:
    """Returns the unit in a text, with or without brackets, as `inputs.units` has it; "": none."""
    text = text.strip().strip("[]()").strip()
    for candidate in (text, text.lower()):
        try:
            parse_unit(candidate)
        except InputError:
            continue
        return candidate
    return ""


class _CurrentLine:
    """Line that is being read.

    Attributes:
        line: its number.
        unended: whether it has no end, as the last of a file may.
    """

    def __init__(self) -> None:
        self.line = 0
        self.unended = False

    def follow(self, numbered: Iterator[tuple[int, str]]) -> Iterator[str]:
        """Yields the texts of numbered lines, and stores the number of the current one."""
        for self.line, text in numbered:
            self.unended = text[-1] not in "\r\n"
            yield text


def _plain_lines(file: Any, form: CsvForm, losses: list[Loss]) -> Iterator[tuple[int, str]]:
    """Yields the lines of column names and rows of a text file, with their numbers.

    The names are in the first line that is no comment, or, where that is a row already, in the first comment.
    """
    n_lines, commented = 0, None
    for number, line in text_lines(file, file.name, losses):
        if number <= form.skip or not line.strip():
            continue
        if form.comment and line.startswith(form.comment):
            commented = commented or (number, line)
            continue
        n_lines += 1
        if n_lines == 1 and commented and any(map(_is_value, _split_cells(line, form.separator))):
            yield commented
            n_lines += 1
        if n_lines == 1 or n_lines > 1 + form.below:
            yield number, line if n_lines == 1 or form.separator != " " else " ".join(line.split()) + "\n"


def _require_names(header: list[str], form: CsvForm, location: str) -> None:
    """Raises InputError where a header is empty, has numbers, a column twice or another separator."""
    if not header:
        raise InputError(f"{location.rpartition(', line')[0]}: is empty; expected a line of column names")
    for separator, name in ((";", "semicolons"), ("\t", "tabs"), (",", "commas")):
        if len(header) == 1 and separator in header[0] and separator != form.separator:
            raise InputError(
                f"{location}: columns are separated by {name}; give `csv: {{separator: {separator!r}}}` in the map"
            )
    if all(is_number(name) for name in header if name):
        raise InputError(f"{location}: has numbers; expected a line of column names")
    twice = next((name for name, count in Counter(header).items() if name and count > 1), None)
    if twice is not None:
        raise InputError(f"{location}: column '{twice}' appears twice; keep one of them")


def _collect_columns(
    cells: Iterator[list[str]],
    header: list[str],
    names: list[str],
    options: tuple[CsvForm, set[str], int | None, _CurrentLine],
) -> tuple[dict[str, Column], NDArray[np.int64], Ragged]:
    """Returns columns by name, the line of each row, and the rows with a wrong number of cells."""
    form, as_text, max_rows, current = options
    place_of = {name: index for index, name in reversed(list(enumerate(header)))}
    indices = [place_of[name] for name in names]
    pieces: list[list[Column]] = [[] for _ in names]
    cells_read: list[list[str]] = [[] for _ in names]
    lines: list[int] = []
    ragged, ending = Ragged(), Ending()

    def convert_held() -> None:
        """Moves the cells gathered so far into the columns, as numbers if all are, else as texts."""
        for name, piece, column in zip(names, pieces, cells_read, strict=True):
            piece.append(_as_numbers(column, form.decimal) if name not in as_text else np.array(column, dtype=object))
            column.clear()

    def is_last_numeric() -> bool:
        """Tests whether the header's last column is collected and had numbers alone so far."""
        if header[-1] not in names or header[-1] in as_text:
            return False
        previous = cells_read[names.index(header[-1])]
        return previous != [] and all(is_number(one.replace(form.decimal, ".")) for one in previous)

    for row in _whole_rows(cells, current):
        cut = (
            current.unended
            and len(row) == len(header)
            and ending.is_cut(row[-1].replace(form.decimal, "."), is_numeric=is_last_numeric())
        )
        ragged.last_incomplete = cut or len(row) < len(header)
        if cut or len(row) != len(header):
            ragged.add(current.line)
            continue
        ending.note_last_cell(row[-1])
        for index, column in zip(indices, cells_read, strict=True):
            column.append(row[index])
        lines.append(current.line)
        if len(lines) % CHUNK == 0:
            convert_held()
        if max_rows is not None and len(lines) >= max_rows:
            break
    convert_held()
    return (
        {name: _join_pieces(piece) for name, piece in zip(names, pieces, strict=True)},
        np.array(lines, np.int64),
        ragged,
    )


def _whole_rows(cells: Iterator[list[str]], current: _CurrentLine) -> Iterator[list[str]]:
    """Yields the cells of each row; an empty list for one that the file's end cuts within quotes."""
    try:
        yield from cells
    except csv.Error:
        if not current.unended:
            raise
        yield []


def _as_numbers(cells: list[str], decimal: str) -> Column:
    """Returns cells as an array of numbers, NaN where missing, if all are numbers; else of texts."""
    if decimal != ".":
        cells = [cell.replace(decimal, ".") for cell in cells]
    try:
        return np.array(cells, dtype=float)
    except ValueError:
        pass
    if all(map(is_number, cells)):
        return np.array([np.nan if cell.strip().lower() in MISSING else float(cell) for cell in cells])
    return np.array(cells, dtype=object)


def _join_pieces(pieces: Sequence[Column]) -> Column:
    """Joins pieces of a column; to texts where any piece has texts."""
    if any(piece.dtype == object for piece in pieces):
        pieces = [
            piece if piece.dtype == object else np.array([repr(one) for one in piece], object) for piece in pieces
        ]
    return np.concatenate(pieces)
