"""Blocks of a table's rows, and what all tables have."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from massprop_drake.errors import InputError
from massprop_drake.maths.linear_algebra import Array
from massprop_drake.records.completeness import Loss, Ragged

LARGEST = 1e12  # number of any meaning, whatever its unit


class Block(NamedTuple):
    """A block of rows of a table.

    Attributes:
        lines: line (CSV) or row (Parquet) of each, counted from 1, shape (n,).
        values: of the wanted columns, NaN where missing, shape (n, n_columns).
    """

    lines: NDArray[np.int_]
    values: Array


class Table(ABC):
    """A table opened for reading.

    Attributes:
        source: what to call it in messages.
        header: names of the columns, in order.
        place: what rows are counted in, "line" or "row".
        ragged: rows left out.
        losses: of the table; all of them once it has been read.
        notes: on what is doubtful in it, a sentence each.
        information: on how it was made, likewise.
        own_times: whether there is a row whenever anything is read or commanded, and not one a sample.
    """

    own_times: bool = False
    place: str = "row"
    notes: Sequence[str] = ()
    information: Sequence[str] = ()
    source: str
    header: list[str]
    ragged: Ragged
    losses: Sequence[Loss]

    @abstractmethod
    def blocks(self, indices: list[int]) -> Iterator[Block]:
        """Yields blocks of rows: line numbers, and values of the columns at these indices, NaN where missing.

        Raises:
            InputError: for a value that is no number, or means nothing.
        """

    def where(self, line: int, _column: str) -> str:
        """Returns source and line of a row as text for messages, such as "flight.csv, line 7"."""
        return f"{self.source}, {self.place} {line}"

    @property
    @abstractmethod
    def done(self) -> float:
        """The fraction of the table that has been read so far, 0 to 1; 0 if its size is unknown."""

    @abstractmethod
    def sha256(self) -> str:
        """Returns SHA-256 of the table's whole content, hexadecimal; valid once all of it has been read."""

    def close(self) -> None:  # noqa: B027 (most have nothing to close)
        """Closes the file, if one is open."""


def require_unique(header: list[str], location: str) -> None:
    """Raises InputError where a column name appears twice in a table's header."""
    seen: set[str] = set()
    for name in header:
        if name and name in seen:
            raise InputError(f"{location}: column '{name}' appears twice; keep one of them")
        seen.add(name)


def infinite_value_message(location: str, column: str) -> str:
    """Returns the text of the error for an infinite value in a cell."""
    return f"{location}, column {column}: is infinite; leave the cell empty where there is no value"


def require_meaningful(block: Block, columns: Sequence[str], source: str, row_word: str) -> None:
    """Raises InputError, with row and column, for a value that is infinite or larger than 1e12.

    Args:
        block: of a table.
        columns: names of its columns.
        source: what to call the table in messages.
        row_word: what its rows are counted in.
    """
    wrong = np.abs(block.values) > LARGEST  # NaN is not
    if wrong.any():
        row, column = np.argwhere(wrong)[0]
        location = f"{source}, {row_word} {block.lines[row]}"
        value = float(block.values[row, column])
        if math.isinf(value):
            raise InputError(infinite_value_message(location, columns[column]))
        raise InputError(f"{location}, column {columns[column]}: {value:g} is too large to mean anything")
