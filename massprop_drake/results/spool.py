"""Signals of a run of any length: spooled to disk as they come, and archived block by block."""

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

_LEVEL = 1  # of compression: signals are mostly constant, so a higher level costs time and gains little


class _Piece(NamedTuple):
    offset: int
    size: int
    shape: tuple[int, ...]


class Spool(Mapping[str, Array]):
    """Appends signals to a compressed temporary file; looking one up reads all of it into an array.

    The file is unnamed, so nothing is left behind, even after a crash.

    Args:
        folder: for the file; default the system's temporary folder.
        rows_per_piece: rows to hold in memory before they are written.

    Raises:
        InputError: when the file cannot be created or written.
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
        """Appends rows to every signal.

        Args:
            rows: by signal, shape (n,) or (n, components).

        Raises:
            ValueError: when the signals are not those of the rows before.
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
        """Yields some signals from beginning to end, block by block."""
        for index in range(len(next(iter(self._pieces.values()), []))):
            yield {name: self._read(self._pieces[name][index]) for name in names}
        for block in self._waiting:
            yield {name: block[name] for name in names}

    def _read(self, piece: _Piece) -> Array:
        self._file.seek(piece.offset)
        data = zlib.decompress(self._file.read(piece.size))
        return np.frombuffer(data, dtype="<f8").reshape(piece.shape)


def blocks(signals: Mapping[str, Array], *names: str) -> Iterator[Mapping[str, Array]]:
    """Yields some signals, block by block where they are spooled, else all at once."""
    if isinstance(signals, Spool):
        yield from signals.blocks(*names)
    else:
        yield {name: signals[name] for name in names}


def write_npz(path: Path, signals: Mapping[str, Array], description: Mapping[str, Any]) -> None:
    """Writes signals as a compressed numpy archive, reading spooled signals block by block.

    Args:
        path: of the archive.
        signals: by name.
        description: of each signal, stored as JSON under `_description`.
    """
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=_LEVEL) as archive:
        for name in signals:
            _write_member(archive, name, blocks(signals, name), _shape(signals, name))
        text = np.array(json.dumps(description))
        with archive.open(_member("_description"), "w") as file:
            np.lib.format.write_array(file, text, allow_pickle=False)


def _member(name: str) -> zipfile.ZipInfo:
    member = zipfile.ZipInfo(f"{name}.npy")  # without a date, so the same bytes each time
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
