"""Signals of a run of any length: kept on disk while it goes on, and written out without holding them."""

from __future__ import annotations

import json
import tempfile
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from massprop_drake.errors import InputError

Array = NDArray[np.float64]

_LEVEL = 1  # of compression: signals are mostly constant, and a higher level only takes longer


class _Piece(NamedTuple):
    offset: int
    size: int
    shape: tuple[int, ...]


class Spool(Mapping[str, Array]):
    """Signals that grow at the end, compressed in a temporary file; reading one makes an array of it.

    The file has no name, so nothing is left behind whatever happens.

    Args:
        folder: where the file is to lie; default the system's place for temporary files.
        rows_per_piece: rows that are kept in memory before they are put into the file.

    Raises:
        InputError: when the file cannot be made or written.
    """

    def __init__(self, folder: Path | None = None, *, rows_per_piece: int = 4096):
        try:
            self._file = tempfile.TemporaryFile(dir=folder)  # noqa: SIM115 (closed with the object)
        except OSError as error:
            raise InputError(f"{folder or tempfile.gettempdir()}: cannot be written: {error.strerror}") from None
        self._folder = folder
        self._rows_per_piece = rows_per_piece
        self._pieces: dict[str, list[_Piece]] = {}
        self._waiting: list[dict[str, Array]] = []
        self._n_waiting = 0
        self.n_rows = 0

    def __del__(self) -> None:
        if hasattr(self, "_file"):
            self._file.close()

    def __iter__(self) -> Iterator[str]:
        return iter(self._pieces or (self._waiting[0] if self._waiting else {}))

    def __len__(self) -> int:
        return len(list(iter(self)))

    def __contains__(self, name: object) -> bool:
        return name in list(iter(self))

    def __getitem__(self, name: str) -> Array:
        if name not in self:
            raise KeyError(name)
        return np.concatenate([block[name] for block in self.blocks(name)])

    def append(self, rows: Mapping[str, Array]) -> None:
        """Adds rows to every signal.

        Args:
            rows: by signal, the same names each time, shape (n,) or (n, components).
        """
        block = dict(rows)
        if self.n_rows and set(block) != set(self):
            raise ValueError(f"the signals are {sorted(self)}, got {sorted(block)}")
        count = len(next(iter(block.values())))
        self._waiting.append(block)
        self._n_waiting += count
        self.n_rows += count
        if self._n_waiting >= self._rows_per_piece:
            self._put_away()

    def _put_away(self) -> None:
        try:
            for name in self._waiting[0]:
                values = np.concatenate([block[name] for block in self._waiting])
                data = zlib.compress(np.ascontiguousarray(values, dtype="<f8").tobytes(), _LEVEL)
                self._pieces.setdefault(name, []).append(_Piece(self._file.seek(0, 2), len(data), values.shape))
                self._file.write(data)
        except OSError as error:
            raise InputError(f"{self._folder or tempfile.gettempdir()}: cannot be written: {error.strerror}") from None
        self._waiting, self._n_waiting = [], 0

    def blocks(self, *names: str) -> Iterator[dict[str, Array]]:
        """Some signals from beginning to end, block by block."""
        for index in range(len(next(iter(self._pieces.values()), []))):
            yield {name: self._read(self._pieces[name][index]) for name in names}
        for block in self._waiting:
            yield {name: block[name] for name in names}

    def _read(self, piece: _Piece) -> Array:
        self._file.seek(piece.offset)
        data = zlib.decompress(self._file.read(piece.size))
        return np.frombuffer(data, dtype="<f8").reshape(piece.shape)


def blocks(signals: Mapping[str, Array], *names: str) -> Iterator[Mapping[str, Array]]:
    """Some signals, block by block where they are spooled, else all at once."""
    if isinstance(signals, Spool):
        yield from signals.blocks(*names)
    else:
        yield {name: signals[name] for name in names}


def write_npz(path: Path, signals: Mapping[str, Array], description: Mapping[str, Any]) -> None:
    """Writes signals as a compressed numpy archive, one after the other and each block by block.

    Args:
        path: of the file.
        signals: by name; of each, its rows from beginning to end.
        description: of each, kept as JSON under `_description`.
    """
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=_LEVEL) as archive:
        for name in signals:
            _write_member(archive, name, blocks(signals, name), _shape(signals, name))
        text = np.array(json.dumps(description))
        with archive.open(_member("_description"), "w") as file:
            np.lib.format.write_array(file, text, allow_pickle=False)


def _member(name: str) -> zipfile.ZipInfo:
    member = zipfile.ZipInfo(f"{name}.npy")  # the same bytes whenever it is written
    member.compress_type = zipfile.ZIP_DEFLATED
    member.external_attr = 0o644 << 16
    return member


def _shape(signals: Mapping[str, Array], name: str) -> tuple[int, ...]:
    if isinstance(signals, Spool):
        return (signals.n_rows, *next(signals.blocks(name))[name].shape[1:])
    return signals[name].shape


def _write_member(
    archive: zipfile.ZipFile, name: str, parts: Iterator[Mapping[str, Array]], shape: tuple[int, ...]
) -> None:
    header = {"descr": "<f8", "fortran_order": False, "shape": shape}
    with archive.open(_member(name), "w", force_zip64=True) as file:
        np.lib.format.write_array_header_1_0(file, header)
        for part in parts:
            file.write(np.ascontiguousarray(part[name], dtype="<f8").tobytes())


# ------------------------------------------------------------------------------------- thinning out


def outstanding_rows(
    signals: Mapping[str, Array],
    n_rows: int,
    *,
    keys: tuple[str, ...],
    events: tuple[str, ...],
    peaks: tuple[str, ...] = (),
    buckets: int = 1000,
) -> NDArray[np.int_]:
    """Rows that show what a figure of a long run must show; each is a row as recorded.

    Of each of so many stretches of equal length the rows where a component of a key signal is least and
    greatest; the first and the last row; and rows at which an event signal is not zero, four for each
    stretch at the most.

    Args:
        signals: by name, shape (n_rows, components).
        n_rows: number of rows.
        keys: signals that must not lose their extremes; NaN does not count.
        peaks: signals of which the greatest is enough.
        events: signals that are not zero, or missing, at rows to keep.
        buckets: number of stretches.

    Returns:
        Indices, ascending.
    """
    if n_rows <= 4 * buckets:
        return np.arange(n_rows)
    kept = {0, n_rows - 1}
    edges = np.linspace(0, n_rows, buckets + 1).astype(int)
    names = [name for name in dict.fromkeys((*keys, *peaks, *events)) if name in signals]
    start = 0
    # stretches that a block ends in go on in the next: extremes so far, per component
    best: dict[tuple[int, str, int, int], tuple[float, int]] = {}
    counts: dict[int, int] = {}
    for block in blocks(signals, *names):
        size = len(next(iter(block.values())))
        first = int(np.searchsorted(edges, start, side="right")) - 1
        bucket = first
        while bucket < buckets and edges[bucket] < start + size:
            part = slice(max(int(edges[bucket]) - start, 0), min(int(edges[bucket + 1]) - start, size))
            for name in names:
                values = block[name][part]
                offset = start + part.start
                if name in keys or name in peaks:
                    _note_extremes(best, bucket, name, values, offset, (1, -1) if name in keys else (1,))
                if name in events:
                    rows = np.flatnonzero(~(values == 0.0).all(axis=1))[: max(0, 4 - counts.get(bucket, 0))]
                    counts[bucket] = counts.get(bucket, 0) + rows.size
                    kept.update((offset + rows).tolist())
            bucket += 1
        for key in [key for key in best if edges[key[0] + 1] <= start + size]:
            kept.add(best.pop(key)[1])
        start += size
    kept.update(row for _, row in best.values())
    return np.array(sorted(kept))


def _note_extremes(
    best: dict[tuple[int, str, int, int], tuple[float, int]],
    bucket: int,
    name: str,
    values: Array,
    offset: int,
    signs: tuple[int, ...],
) -> None:
    for column in range(values.shape[1]):
        component = values[:, column]
        there = np.flatnonzero(np.isfinite(component))
        if not there.size:
            continue
        for sign in signs:
            row = there[np.argmax(sign * component[there])]
            value = float(sign * component[row])
            key = (bucket, name, column, sign)
            if key not in best or value > best[key][0]:
                best[key] = (value, offset + int(row))


def picked(
    signals: Mapping[str, Array], rows: NDArray[np.int_], *, leaving_out: tuple[str, ...] = ()
) -> dict[str, Array]:
    """Some rows of every signal.

    Args:
        signals: by name.
        rows: indices, ascending.
        leaving_out: signals that are not wanted.
    """
    names = [name for name in signals if name not in leaving_out]
    found: dict[str, Array] = {}
    start = 0
    for block in blocks(signals, *names):
        size = len(next(iter(block.values())))
        first, last = np.searchsorted(rows, [start, start + size])
        for name, values in block.items():
            if name not in found:
                found[name] = np.empty((rows.size, *values.shape[1:]))
            found[name][first:last] = values[rows[first:last] - start]
        start += size
    return found
