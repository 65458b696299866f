"""Losses of a record: cut off, damaged, or with rows of wrong lengths."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from typing import Literal, NamedTuple, TextIO

from massprop_drake.errors import InputError, counted

MISSING = {"", "nan", "null", "n/a", "na", "-"}  # cells that say that there is no value, in any case
NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")
_LONGEST_LINE = 1_000_000  # characters; a row of a thousand columns has some 20 000
FEW_RAGGED, RAGGED_SHARE = 10, 0.01  # rows of a wrong length that a file may have: so many, or this share
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
    """Returns "complete", "truncated" or "damaged", by the gravest of a record's losses."""
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
        """Counts a row with a wrong number of cells, and notes its line."""
        self.first_line, self.last_line = self.first_line or line, line
        self.count += 1

    def losses(self, source: str) -> list[Loss]:
        """Returns the losses of a table: rows left out and a cut last row; their texts begin with its name."""
        found, complete = [], self.count - self.last_incomplete
        if complete:
            text = f"{counted(complete, 'row')} left out with a wrong number of cells"
            found.append(Loss("damaged", f"{source}: {text}, the first in line {self.first_line}"))
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

    def note_last_cell(self, cell: str) -> None:
        """Keeps the length of the shortest last cell of complete rows."""
        self._shortest = min(self._shortest, len(cell))

    def is_cut(self, cell: str, *, is_numeric: bool) -> bool:
        """Tests whether the last cell of a line without a line end looks cut off."""
        text = cell.strip()
        is_broken = is_numeric and text.lower() not in MISSING and not NUMBER.fullmatch(text)
        return is_broken or 0 < len(cell) < self._shortest


def text_lines(file: TextIO, source: str, losses: list[Loss]) -> Iterator[tuple[int, str]]:
    """Yields number and text of each line of a text file; adds a loss where its end is zeros.

    Args:
        file: the file.
        source: what to call it in messages.
        losses: takes in what is lost.

    Raises:
        InputError: for what is no text in UTF-8, or longer than a row of telemetry can be.
    """
    number = 0
    while True:
        number += 1
        try:
            line = file.readline(_LONGEST_LINE)
            if "\0" in line:
                head = line[: line.index("\0")]
                if number == 1 or not _are_zeros(line[len(head) :], file):
                    raise InputError(f"{source}, line {number}: holds a NUL byte; expected text in UTF-8")
                losses.append(Loss("truncated", f"{source}: has nothing but zeros from line {number} on"))
                line = head
        except UnicodeDecodeError:
            raise InputError(
                f"{source}: not a text file in UTF-8 from line {number} on; expected a table of separated values"
            ) from None
        except OSError as error:
            raise InputError(unreadable_message(source, error)) from None
        if not line:
            return
        if len(line) >= _LONGEST_LINE:
            raise InputError(f"{source}, line {number}: is longer than a row of telemetry can be")
        yield number, line


def _are_zeros(text: str, file: TextIO) -> bool:
    """Tests whether a text, and all that follows it in a file, are NUL characters."""
    while text:
        if text.strip("\0"):
            return False
        text = file.read(1 << 16)
    return True


def unreadable_message(path: object, error: Exception) -> str:
    """Returns the text of the error for a file that is missing or cannot be read."""
    if isinstance(error, FileNotFoundError):
        return f"{path}: no such file"
    return f"{path}: cannot be read: {getattr(error, 'strerror', None) or error}"


def first_line(error: Exception) -> str:
    """Returns the first line of an exception's text, or its type's name where it has none."""
    return (str(error).splitlines() or [type(error).__name__])[0]
