"""Signals of a run of any length: in memory while they are few, else on disk; read and archived block by block."""

from __future__ import annotations

import json
import tempfile
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import IO, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from massprop_drake.errors import InputError

Array = NDArray[np.float64]

_LEVEL = 1  # of compression: signals are mostly constant, so a higher level costs time and gains little


class _Piece(NamedTuple):
    """Place of a compressed piece of a signal in the file, bytes, and the shape of its array."""

    offset: int
    size: int
    shape: tuple[int, ...]


_LISTED = 10  # signals that a short text of them names


class Signals(dict[str, Array]):
    """Signals by name, shape (n_samples, components), whose `repr` is a short description."""

    def __repr__(self) -> str:
        return describe_signals({name: values.shape for name, values in self.items()})


def describe_signals(shapes: Mapping[str, tuple[int, ...]]) -> str:
    """Describes signals as "<12 signals of 500 samples: rate (3), ...>", from the shape of each."""
    names = [f"{name} ({shape[1]})" for name, shape in shapes.items() if len(shape) == 2]
    rows = next(iter(shapes.values()))[0] if shapes else 0
    more = f", and {len(names) - _LISTED} more" if len(names) > _LISTED else ""
    return f"<{len(names)} signals of {rows} samples: {', '.join(names[:_LISTED])}{more}>"


class Spool(Mapping[str, Array]):
    """Storage of the signals of a run as they come, with no more than a piece of them in memory.

    Pieces that are full go to a compressed temporary file; a run shorter than a piece makes none. The file is
    unnamed, so nothing is left behind, even after a crash. Looking a signal up gives all of it: the array itself
    while it is in memory, else a new one read from disk. Where a piece ends depends on the number of rows alone,
    not on how many came at a time.

    Args:
        folder: for the file, which must be writable; default the system's temporary folder, where one is needed.
        rows_per_piece: rows to hold in memory before they are written.
        index: name of what says which row is which, such as their times: it is looked up like a signal, but not
            listed as one.

    Attributes:
        n_rows: so many have been taken in.

    Raises:
        InputError: when the file cannot be created or written.
    """

    def __init__(self, folder: Path | None = None, *, rows_per_piece: int = 4096, index: str | None = None):
        self._folder = folder
        self._rows_per_piece = rows_per_piece
        self._index = index
        self._file: IO[bytes] | None = None
        self._pieces: dict[str, list[_Piece]] = {}
        self._waiting: list[dict[str, Array]] = []
        self._n_waiting = 0
        self.n_rows = 0
        if folder is not None:  # a place that cannot be written is told before the work, not in the midst of it
            self._create_file().close()

    def __del__(self) -> None:
        file = getattr(self, "_file", None)
        if file is not None:
            file.close()

    def __getstate__(self) -> dict[str, Any]:
        """Returns the state to copy or pickle, all rows on disk included."""
        content = None
        if self._file is not None:
            self._file.seek(0)
            content = self._file.read()
        return {**self.__dict__, "_folder": None, "_file": content}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state, _file=None)
        if state["_file"] is not None:
            self._file = self._create_file()
            self._file.write(state["_file"])

    def __iter__(self) -> Iterator[str]:
        return iter([name for name in self.names if name != self._index])

    def __len__(self) -> int:
        return len(list(iter(self)))

    def __contains__(self, name: object) -> bool:
        return name in list(iter(self))

    def __getitem__(self, name: str) -> Array:
        if name not in self.names:
            raise KeyError(name)
        if self.in_memory:
            return next(self.blocks(name))[name]
        return np.concatenate([block[name] for block in self.blocks(name)])

    def __repr__(self) -> str:
        held: Mapping[str, Array | _Piece] = self._waiting[-1] if self._waiting else {}
        parts = held or {name: pieces[-1] for name, pieces in self._pieces.items()}
        return describe_signals({name: (self.n_rows, *parts[name].shape[1:]) for name in self})

    @property
    def in_memory(self) -> bool:
        """True if no row has been written to disk."""
        return not self._pieces

    @property
    def names(self) -> list[str]:
        """Names of the index and of all signals, in their order."""
        return list(self._pieces or (self._waiting[0] if self._waiting else {}))

    def append(self, rows: Mapping[str, Array]) -> None:
        """Appends rows to every signal; full pieces go to disk.

        Args:
            rows: by signal, shape (n,) or (n, components).

        Raises:
            ValueError: when the signals are not those of the rows before.
        """
        block = dict(rows)
        if self.n_rows and set(block) != set(self.names):
            raise ValueError(f"the signals are {sorted(self.names)}, got {sorted(block)}")
        count = len(next(iter(block.values())))
        self._waiting.append(block)
        self._n_waiting += count
        self.n_rows += count
        if self._n_waiting >= self._rows_per_piece:
            self._write_pieces()

    def last(self, name: str) -> Array:
        """Returns the last row of a signal, shape (components,)."""
        if self._waiting:
            return self._waiting[-1][name][-1]
        return self._read_piece(self._pieces[name][-1])[-1]

    def _write_pieces(self) -> None:
        """Writes full pieces of the rows in memory to the file, compressed; the rest stays in memory."""
        size = self._rows_per_piece
        full = self._n_waiting // size * size
        rest: dict[str, Array] = {}
        try:
            if self._file is None:
                self._file = self._create_file()
            for name in self.names:
                values = np.concatenate([block.pop(name) for block in self._waiting])
                for first in range(0, full, size):
                    piece = np.ascontiguousarray(values[first : first + size], dtype="<f8")
                    data = zlib.compress(piece.tobytes(), _LEVEL)
                    place = _Piece(self._file.seek(0, 2), len(data), piece.shape)
                    self._file.write(data)
                    self._pieces.setdefault(name, []).append(place)
                rest[name] = values[full:].copy()
        except OSError as error:
            raise self._make_write_error(error) from None
        self._n_waiting -= full
        self._waiting = [rest] if self._n_waiting else []

    def _create_file(self) -> IO[bytes]:
        """Creates the unnamed temporary file; InputError where it cannot."""
        try:
            return tempfile.TemporaryFile(dir=self._folder)
        except OSError as error:
            raise self._make_write_error(error) from None

    def _make_write_error(self, error: OSError) -> InputError:
        """Makes the error for a folder that cannot be written."""
        return InputError(f"{self._folder or tempfile.gettempdir()}: cannot be written: {error.strerror}")

    def blocks(self, *names: str) -> Iterator[dict[str, Array]]:
        """Yields rows of the named signals by name, from first to last, in blocks of equal rows for all."""
        for index in range(len(next(iter(self._pieces.values()), []))):
            yield {name: self._read_piece(self._pieces[name][index]) for name in names}
        if len(self._waiting) > 1:
            self._waiting = [
                {name: np.concatenate([block[name] for block in self._waiting]) for name in self._waiting[0]}
            ]
        for block in self._waiting:
            yield {name: block[name] for name in names}

    def _read_piece(self, piece: _Piece) -> Array:
        """Reads one piece of a signal from the file, shape (rows, components)."""
        assert self._file is not None
        self._file.seek(piece.offset)
        data = zlib.decompress(self._file.read(piece.size))
        return np.frombuffer(data, dtype="<f8").reshape(piece.shape)


def blocks(signals: Mapping[str, Array], *names: str) -> Iterator[Mapping[str, Array]]:
    """Yields rows of the named signals by name: in blocks if spooled, else all at once."""
    if isinstance(signals, Spool):
        yield from signals.blocks(*names)
    else:
        yield {name: signals[name] for name in names}


def write_npz(path: Path, signals: Mapping[str, Array], description: Mapping[str, Any]) -> None:
    """Writes signals, and their description as JSON, as a compressed NPZ file, block by block."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=_LEVEL) as archive:
        for name in signals.names if isinstance(signals, Spool) else signals:
            _write_member(archive, name, blocks(signals, name), _shape(signals, name))
        text = np.array(json.dumps(description))
        with archive.open(_archive_entry("_description"), "w") as file:
            np.lib.format.write_array(file, text, allow_pickle=False)


def _archive_entry(name: str) -> zipfile.ZipInfo:
    """Makes the header of a signal's member in an NPZ file, without a date so that bytes repeat."""
    member = zipfile.ZipInfo(f"{name}.npy")
    member.compress_type = zipfile.ZIP_DEFLATED
    member.external_attr = 0o644 << 16
    return member


def _shape(signals: Mapping[str, Array], name: str) -> tuple[int, ...]:
    """Returns the shape of a signal, (n_samples, components), without reading all of it."""
    if isinstance(signals, Spool):
        return (signals.n_rows, *next(signals.blocks(name))[name].shape[1:])
    return signals[name].shape


def _write_member(
    archive: zipfile.ZipFile, name: str, row_blocks: Iterator[Mapping[str, Array]], shape: tuple[int, ...]
) -> None:
    """Writes blocks of one signal as a member of an NPZ file, its total shape known before."""
    header = {"descr": "<f8", "fortran_order": False, "shape": shape}
    with archive.open(_archive_entry(name), "w", force_zip64=True) as file:
        np.lib.format.write_array_header_1_0(file, header)
        for block in row_blocks:
            file.write(np.ascontiguousarray(block[name], dtype="<f8").tobytes())
