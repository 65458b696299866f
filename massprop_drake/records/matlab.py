"""MATLAB's .mat files: through scipy, and from version 7.3 on, which are HDF5, through h5py."""

from __future__ import annotations

import io
import zlib
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal

import numpy as np

from massprop_drake.errors import InputError, counted
from massprop_drake.inputs.record_map import RecordMap
from massprop_drake.records.completeness import Loss, first_line
from massprop_drake.records.topics import MOST_ELEMENTS, Column, Recording, Topic, digest, format_item, missing_extra

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
    RuntimeError,
    NameError,  # a slip of scipy's own, on damaged texts
)
_SIGNATURE_AT = (0, 512)  # a .mat file of version 7.3 has a header of its own before it


def read_mat(path: Path, record_map: RecordMap | None, rows: int | None) -> Recording:
    """Reads a .mat file into a recording: structures as topics, arrays of equal length as their columns.

    A matrix with a column per component gives `name[0]`, `name[1]`, ...

    Raises:
        InputError: when it cannot be read.
    """
    try:
        with path.open("rb") as file:
            start = file.read(520)
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None
    losses: list[Loss] = []
    hdf = any(start[offset:].startswith(_SIGNATURE) for offset in _SIGNATURE_AT)
    if not hdf and start.startswith(b"MATLAB 7.3"):
        raise InputError(f"{path}: not a .mat file that can be read: it is cut off")
    content = _read_hdf(path, losses) if hdf else _read_classic(path, losses)
    topics, left_out = {}, []
    for name, variables in _group_by_topic(content).items():
        columns, others = _select_columns(variables, rows)
        if columns:
            topics[name] = Topic(f"{path}{f', {name}' if name else ''}", columns)
        left_out += [f"{name}.{other}" if name else other for other in others]
    if not topics:
        reasons = f": {', '.join(left_out)}" if left_out else ""
        raise InputError(*(one.text for one in losses), f"{path}: has no variable that gives columns{reasons}")
    # of a map all that it does not name is not wanted
    notes = (f"{path}: left out: {', '.join(left_out)}",) if left_out and record_map is None else ()
    return Recording(str(path), "mat", topics, notes=notes, sha256=digest(path), losses=tuple(losses))


def _read_classic(path: Path, losses: list[Loss]) -> dict[str, Any]:
    """Maps names to variables of a .mat file up to version 7; damaged ones are left out and added to losses."""
    from scipy.io import loadmat  # noqa: PLC0415 (slow to load)
    from scipy.io.matlab import MatReadError  # noqa: PLC0415

    variables: dict[str, Any] = {}
    for begin, part in _split_variables(path, losses):
        try:
            variables |= loadmat(io.BytesIO(part), simplify_cells=True)
        except (MatReadError, zlib.error, *_DAMAGED) as error:
            if not begin:
                raise InputError(f"{path}: not a .mat file that can be read: {first_line(error)}") from None
            text = f"the variable that begins at byte {begin} is damaged, and left out"
            losses.append(Loss("damaged", f"{path}: {text}: {first_line(error)}"))
    return {name: value for name, value in variables.items() if not name.startswith("__")}


def _split_variables(path: Path, losses: list[Loss]) -> Iterator[tuple[int, bytes]]:
    """Yields offset and bytes of .mat files with one variable each; a file of version 4 as a whole, at 0.

    scipy's compiled reader is not safe from damaged lengths, so that no variable reaches it that is not whole.
    """
    content = path.read_bytes()
    if not content.startswith(b"MATLAB 5"):
        yield 0, content  # what is no .mat file is told by the reader
        return
    order: Literal["little", "big"] = "big" if content[126:128] == b"MI" else "little"
    offset = _HEADER
    while offset < len(content):
        tag = content[offset : offset + 8]
        kind, size = int.from_bytes(tag[:4], order), int.from_bytes(tag[4:], order)
        end = offset + 8 + size
        if len(tag) == 8 and kind not in (_MATRIX, _COMPRESSED):
            losses.append(Loss("damaged", f"{path}: is damaged from byte {offset} on, and not read further"))
            return
        if end > len(content):
            short = counted(end - len(content), "byte")
            losses.append(Loss("truncated", f"{path}: is cut off: it ends within a variable, {short} short"))
            return
        yield offset, content[:_HEADER] + content[offset:end]
        offset = end
    if len(content) <= _HEADER:
        losses.append(Loss("truncated", f"{path}: is cut off: it has no variable"))


def _read_hdf(path: Path, losses: list[Loss]) -> dict[str, Any]:
    """Maps names to variables of a .mat file of version 7.3; damaged ones are left out and added to losses."""
    try:
        import h5py  # noqa: PLC0415 (an extra)
    except ImportError:
        raise missing_extra(path, "h5py", "mat", "a .mat file of version 7.3") from None
    variables = {}
    try:
        with h5py.File(path, "r") as file:
            for name in [key for key in file if not key.startswith("#")]:
                try:
                    variables[name] = _hdf_value(h5py, file, file[name])
                except _DAMAGED as error:
                    losses.append(Loss("damaged", f"{path}: {name} is damaged, and left out: {first_line(error)}"))
    except _DAMAGED as error:
        reason = first_line(error)
        if "truncated file" in reason:
            reason = "it is cut off, and HDF5 gives nothing of such a file"
        raise InputError(f"{path}: not a .mat file that can be read: {reason}") from None
    return variables


def _hdf_value(h5py: Any, file: Any, item: Any) -> Any:
    """Returns an HDF5 item as scipy returns a MATLAB variable: dict, text, array, or cells as objects."""
    if item is None:
        raise ValueError("a variable is lost")
    if isinstance(item, h5py.Group):
        return {name: _hdf_value(h5py, file, inner) for name, inner in item.items()}
    if item.attrs.get("MATLAB_empty", 0):
        return np.empty(0)
    if h5py.check_dtype(ref=item.dtype) is not None:  # a cell array
        cells = [_hdf_value(h5py, file, file[reference]) for reference in np.asarray(item).T.ravel()]
        array = np.empty(len(cells), dtype=object)
        array[:] = cells
        return array
    values = np.asarray(item).T
    if item.attrs.get("MATLAB_class") == b"char":
        return "".join(map(chr, values.ravel()))
    return _squeeze(values)


def _group_by_topic(content: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """Maps each topic to its variables by name: topic "" for plain ones, and one for each structure."""
    topics: dict[str, dict[str, Any]] = {"": {}}
    for name, value in content.items():
        if isinstance(value, dict):
            topics[name] = dict(_flatten_fields(value))
        elif (rows := _as_structures(value)) is not None:
            topics[name] = {key: np.array([row[key] for row in rows]) for key in rows[0]}
        else:
            topics[""][name] = value
    return topics


def _as_structures(value: Any) -> list[dict[str, Any]] | None:
    """Returns an array of structures as a list of dicts of single numbers; None for any other value."""
    rows = list(value.ravel()) if isinstance(value, np.ndarray) else value if isinstance(value, list) else []
    if not rows or not all(isinstance(row, dict) and row.keys() == rows[0].keys() for row in rows):
        return None
    return rows if all(np.ndim(one) == 0 and _is_numeric(one) for row in rows for one in row.values()) else None


def _is_numeric(value: Any) -> bool:
    """Tests whether a value has boolean, integer or real numbers."""
    return np.asarray(value).dtype.kind in "biuf"


def _flatten_fields(fields: dict[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yields name and value of a structure's fields; names within nested structures are joined by dots."""
    for name, value in fields.items():
        if isinstance(value, dict):
            yield from _flatten_fields(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", value


def _select_columns(variables: dict[str, Any], rows: int | None) -> tuple[dict[str, Column], list[str]]:
    """Returns variables of the commonest length as columns by name, and a text on every one left out."""
    arrays = {name: _squeeze(_as_array(value)) for name, value in variables.items() if not isinstance(value, str)}
    lengths = Counter(len(one) for one in arrays.values() if one.ndim and len(one) > 1 and _is_table(one))
    length = max(lengths, key=lambda one: (lengths[one], one), default=0)
    columns: dict[str, Column] = {}
    left_out = []
    for name, value in arrays.items():
        upright = value.T if value.ndim == 2 and len(value) != length else value
        if not value.ndim and value.dtype != object:
            continue
        if not _is_table(value):
            left_out.append(f"{name} ({_no_column_reason(value)})")
        elif len(upright) != length or upright.ndim > 2:
            shape = " x ".join(map(str, value.shape))
            left_out += [f"{name} (of {shape} values)"] if value.size > 1 else []
        elif upright.ndim == 2 and upright.shape[1] > MOST_ELEMENTS:
            left_out.append(f"{name} (of more than {MOST_ELEMENTS} columns)")
        elif upright.ndim == 2:
            columns |= {f"{name}[{index}]": upright[:rows, index] for index in range(upright.shape[1])}
        elif upright.dtype == object:
            columns[name] = _cell_column(upright[:rows])
        else:
            columns[name] = upright[:rows] if upright.dtype.kind in "biuf" else upright[:rows].astype(object)
    return columns, left_out


def _as_array(value: Any) -> Any:
    """Returns a variable as an array; an array of objects if its elements differ in shape."""
    try:
        return np.asarray(value)
    except ValueError:
        array = np.empty(len(value), dtype=object)
        array[:] = list(value)
        return array


def _is_table(value: Any) -> bool:
    """Tests whether an array holds real numbers, text, or cells of these."""
    if value.dtype != object:
        return value.dtype.kind in "biufU"
    return value.ndim == 1 and all(_as_array(one).dtype.kind in "biufU" for one in value)


def _no_column_reason(value: Any) -> str:
    """Returns words for the content of an array that gives no columns, such as "structures"."""
    if value.dtype == object and any(isinstance(one, dict) for one in value.ravel()):
        return "structures"
    if value.dtype == object and value.ndim:
        return "cells in cells" if value.ndim == 1 else "cells in rows and columns"
    return "complex numbers" if value.dtype.kind == "c" else "objects"


def _squeeze(value: Any) -> Any:
    """Returns an array without its dimensions of length one; unchanged if it has none or is a vector."""
    return value.squeeze() if value.ndim > 1 and 1 in value.shape else value


def _cell_column(values: Any) -> Column:
    """Makes a column from cells: numbers if all hold a single one, else texts of their items."""
    cells = [np.ravel(one) for one in values]
    if all(one.size == 1 and _is_numeric(one) for one in cells):
        return np.array([float(one[0]) for one in cells])
    return np.array([" ".join(map(format_item, one)) for one in cells], object)
