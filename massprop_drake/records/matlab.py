"""MATLAB's .mat files: through scipy, and from version 7.3 on, which are HDF5, through h5py."""

from __future__ import annotations

import zlib
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal

import numpy as np

from massprop_drake.errors import InputError
from massprop_drake.inputs.record_map import RecordMap
from massprop_drake.records.recording import MOST_ELEMENTS, Column, Recording, Topic, digest, needs

_SIGNATURE = b"\x89HDF\r\n\x1a\n"
_HEADER, _MATRIX, _COMPRESSED = 128, 14, 15  # length of the header, and types of variables, to version 7
_DAMAGED = (
    OSError,
    ValueError,
    TypeError,
    KeyError,
    IndexError,
    NotImplementedError,
    EOFError,
    MemoryError,
    NameError,  # a slip of scipy's own, on damaged texts
)
_SIGNATURE_AT = (0, 512)  # a .mat file of version 7.3 has a header of its own before it


def read(path: Path, by: RecordMap | None, rows: int | None) -> Recording:
    """Reads a .mat file: structures are topics, arrays of equal length their columns.

    A matrix with a column per component gives `name[0]`, `name[1]`, ...

    Raises:
        InputError: when it cannot be read.
    """
    try:
        with path.open("rb") as file:
            start = file.read(520)
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None
    hdf = any(start[at:].startswith(_SIGNATURE) for at in _SIGNATURE_AT)
    content = _hdf(path) if hdf else _classic(path)
    topics, notes = {}, []
    for name, variables in _by_topic(content).items():
        columns, left_out = _columns(variables, rows)
        if columns:
            topics[name] = Topic(f"{path}{f', {name}' if name else ''}", columns)
        if left_out:
            shown = f"{', '.join(left_out[:5])}{', ...' if left_out[5:] else ''}"
            notes.append(f"{topics[name].source if name in topics else path}: not of its length: {shown}")
    if by is not None:
        notes = []  # what a map does not name is not wanted
    return Recording(str(path), "mat", topics, notes=tuple(notes), sha256=digest(path))


def _classic(path: Path) -> dict[str, Any]:
    from scipy.io import loadmat  # noqa: PLC0415 (slow to load)
    from scipy.io.matlab import MatReadError  # noqa: PLC0415

    _require_whole(path)
    try:
        found = loadmat(path, simplify_cells=True)
    except (MatReadError, zlib.error, *_DAMAGED) as error:
        raise InputError(f"{path}: not a .mat file that can be read: {_first_line(error)}") from None
    return {name: value for name, value in found.items() if not name.startswith("__")}


def _require_whole(path: Path) -> None:
    """Walks the variables of a file of versions 5 to 7: scipy's compiled reader is not safe from damaged lengths.

    Raises:
        InputError: when a variable does not end within the file, or is none.
    """
    content = path.read_bytes()
    if not content.startswith(b"MATLAB 5"):
        return  # version 4 has no such header, and what is no .mat file is told by the reader
    order: Literal["little", "big"] = "big" if content[126:128] == b"MI" else "little"
    place = _HEADER
    while place < len(content):
        tag = content[place : place + 8]
        kind, size = int.from_bytes(tag[:4], order), int.from_bytes(tag[4:], order)
        place += len(tag) + size
        if len(tag) < 8 or kind not in (_MATRIX, _COMPRESSED) or place > len(content):
            raise InputError(f"{path}: not a .mat file that can be read: it is damaged or cut off")


def _hdf(path: Path) -> dict[str, Any]:
    try:
        import h5py  # noqa: PLC0415 (an extra)
    except ImportError:
        raise needs(path, "h5py", "mat", "a .mat file of version 7.3") from None
    try:
        with h5py.File(path, "r") as file:
            return {name: _of_hdf(h5py, file, item) for name, item in file.items() if not name.startswith("#")}
    except (OSError, ValueError, RuntimeError, KeyError, MemoryError, TypeError) as error:
        raise InputError(f"{path}: not a .mat file that can be read: {_first_line(error)}") from None


def _of_hdf(h5py: Any, file: Any, item: Any) -> Any:
    """A variable as scipy would give it: MATLAB writes arrays with their dimensions reversed."""
    if item is None:
        raise ValueError("a variable is lost")
    if isinstance(item, h5py.Group):
        return {name: _of_hdf(h5py, file, inner) for name, inner in item.items()}
    if item.attrs.get("MATLAB_empty", 0):
        return np.empty(0)
    if h5py.check_dtype(ref=item.dtype) is not None:  # a cell array
        cells = [_of_hdf(h5py, file, file[reference]) for reference in np.asarray(item).T.ravel()]
        found = np.empty(len(cells), dtype=object)
        found[:] = cells
        return found
    values = np.asarray(item).T
    if item.attrs.get("MATLAB_class") == b"char":
        return "".join(map(chr, values.ravel()))
    return values.squeeze() if values.ndim > 1 and 1 in values.shape else values


def _by_topic(content: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """Variables at the top, of topic "", and those of each structure."""
    topics: dict[str, dict[str, Any]] = {"": {}}
    for name, value in content.items():
        if isinstance(value, dict):
            topics[name] = dict(_flat(value))
        else:
            topics[""][name] = value
    return topics


def _flat(fields: dict[str, Any], before: str = "") -> Iterator[tuple[str, Any]]:
    for name, value in fields.items():
        if isinstance(value, dict):
            yield from _flat(value, f"{before}{name}.")
        else:
            yield f"{before}{name}", value


def _columns(variables: dict[str, Any], rows: int | None) -> tuple[dict[str, Column], list[str]]:
    """The columns of the commonest length, and the names of what has another."""
    arrays = {name: _tall(np.asarray(value)) for name, value in variables.items() if not isinstance(value, str)}
    lengths = Counter(len(one) for one in arrays.values() if one.ndim and len(one) > 1)
    if not lengths:
        return {}, []
    length = max(lengths, key=lambda one: (lengths[one], one))
    arrays = {name: value if value.ndim < 2 or len(value) == length else value.T for name, value in arrays.items()}
    columns: dict[str, Column] = {}
    for name, value in arrays.items():
        if not value.ndim or len(value) != length or value.ndim > 2:
            continue
        if value.ndim == 2:
            if value.shape[1] <= MOST_ELEMENTS:
                columns |= {f"{name}[{index}]": value[:rows, index] for index in range(value.shape[1])}
        elif value.dtype == object:
            columns[name] = np.array([_cell(one) for one in value[:rows]], dtype=object)
        elif value.dtype.kind in "biuf":
            columns[name] = value[:rows]
        elif value.dtype.kind == "U":
            columns[name] = value[:rows].astype(object)
    left_out = [name for name, value in arrays.items() if value.ndim and len(value) > 1 and len(value) != length]
    return columns, left_out


def _tall(value: Any) -> Any:
    """An array without dimensions of one."""
    return value.squeeze() if value.ndim > 1 and 1 in value.shape else value


def _cell(value: Any) -> str:
    """A cell as text: names as they are, arrays of numbers with blanks between them."""
    if isinstance(value, str):
        return value
    return " ".join(f"{one:g}" for one in np.asarray(value, dtype=float).ravel())


def _first_line(error: Exception) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0]
