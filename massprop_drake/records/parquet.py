"""Tables in Parquet files, read in batches; damaged parts are left out."""

from __future__ import annotations

import contextlib
import hashlib
import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from massprop_drake.errors import InputError, counted
from massprop_drake.maths.linear_algebra import Array
from massprop_drake.records.blocks import Block, Table, require_meaningful, require_unique
from massprop_drake.records.completeness import Loss, Ragged, first_line

_PARQUET = b"PAR1"  # first and last bytes


class ParquetTable(Table):
    """A Parquet file, read by pyarrow.

    Args:
        path: of the file.
        rows_per_block: at most.

    Raises:
        InputError: when pyarrow is not installed, or the file is no Parquet file.
    """

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
        require_unique(self.header, str(path))

    @property
    def done(self) -> float:
        """Fraction of the rows that have been read so far, 0 to 1."""
        return self._read / self._rows if self._rows else 0.0

    def sha256(self) -> str:
        """Returns SHA-256 of the file, hexadecimal."""
        with self._path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()

    def close(self) -> None:
        """Closes the file."""
        self._file.close()

    def blocks(self, indices: list[int]) -> Iterator[Block]:
        """Yields blocks of rows: row numbers, and values of the columns at these indices.

        Raises:
            InputError: when a column holds no numbers.
        """
        arrow = self._arrow
        names = [self.header[column] for column in indices]
        schema = self._file.schema_arrow  # made anew each time that it is asked for
        for name in names:
            kind = schema.field(name).type
            number = arrow.types.is_integer(kind) or arrow.types.is_floating(kind) or arrow.types.is_boolean(kind)
            if not (number or arrow.types.is_decimal(kind) or arrow.types.is_null(kind)):
                raise InputError(f"{self._path}, column {name}: holds {kind}; expected numbers")
        for first, batch in parquet_batches(self._file, names, self._rows_per_block, self.source, self.losses):
            columns = [self._to_floats(batch.column(name)) for name in names]
            self._read = first + batch.num_rows
            block = Block(first + 1 + np.arange(batch.num_rows), np.column_stack(columns))
            require_meaningful(block, names, str(self._path), self.place)
            yield block

    def _to_floats(self, column: Any) -> Array:
        """Returns a pyarrow column of numbers or booleans as floats, NaN where missing, shape (n,)."""
        if self._arrow.types.is_boolean(column.type):
            column = column.cast(self._arrow.int8())
        values: Array = column.cast(self._arrow.float64(), safe=False).to_numpy(zero_copy_only=False)
        return np.array(values, dtype=float)


def open_parquet(path: Path) -> tuple[Any, Any]:
    """Opens a Parquet file; returns the module pyarrow and the file.

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
        reason = first_line(error)
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
    """Yields batches of a Parquet file's rows, with the number of rows before them; leaves out damaged rows.

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

    begin, n_lost, reason = 0, 0, ""
    for group in range(file.metadata.num_row_groups):
        row, begin = begin, begin + file.metadata.row_group(group).num_rows
        try:
            for batch in file.iter_batches(batch_size=rows, row_groups=[group], columns=list(names)):
                yield row, batch
                row += batch.num_rows
        except (OSError, ValueError, pyarrow.ArrowException) as error:
            if isinstance(error, InputError):
                raise
            n_lost, reason = n_lost + begin - row, first_line(error)
            losses.append(Loss("damaged", f"{source}: rows {row + 1} to {begin} are damaged, and left out: {reason}"))
    if n_lost and n_lost == begin:
        raise InputError(f"{source}: none of its {counted(n_lost, 'row')} can be read: {reason}")
    if file.metadata.num_rows != begin:
        stated = counted(file.metadata.num_rows, "row")
        losses.append(Loss("damaged", f"{source}: says that it has {stated}, and has {begin}"))
