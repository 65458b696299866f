"""Recordings: the columns of a file of any recorder, by topic, and the functions that open them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from massprop_drake.errors import InputError, require_text
from massprop_drake.inputs.record_map import RecordMap
from massprop_drake.inputs.yaml import exists
from massprop_drake.records.bags import read_bag
from massprop_drake.records.completeness import Loss, first_line
from massprop_drake.records.matlab import read_mat
from massprop_drake.records.parquet import open_parquet, parquet_batches
from massprop_drake.records.tables import require_file
from massprop_drake.records.text_files import CHUNK, read_text_file
from massprop_drake.records.topics import (
    Column,
    Recording,
    Topic,
    digest,
    require_few_columns,
    split_lists,
    unused_columns,
)
from massprop_drake.records.ulog import read_ulog

_MAPS = "'massprop map' proposes one, and 'massprop estimate --map' takes it"


def open_recording(path: str | Path, record_map: RecordMap | None = None, rows: int | None = None) -> Recording:
    """Reads a telemetry file of any known kind, recognized by its suffix, into topics of columns.

    Args:
        path: of a CSV, Parquet, .mat, ULog (.ulg), ROS 1 (.bag), ROS 2 (folder, .db3) or MCAP (.mcap) file.
        record_map: the map, of whose columns and topics alone are read; None: all that can be.
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
    recording = reader(path, record_map, rows)
    if record_map is not None and record_map.cut_off == "refuse" and recording.losses:
        raise InputError(*(f"{one.text}; the map has `cut_off: refuse`" for one in recording.losses))
    if not any(topic.rows for topic in recording.topics.values()):
        nothing = "has no row of data"
        if recording.losses:
            raise InputError(*(f"{one.text}; it {nothing} that can be read" for one in recording.losses))
        raise InputError(f"{path}: is empty: it {nothing}")
    return recording


def require_table(path: str | Path) -> None:
    """Raises InputError for a file that needs a map, such as a ROS bag, by its name.

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
    """Tests whether a path is a folder with files of a ROS 2 bag."""
    try:
        return path.is_dir() and any({".db3", ".mcap"} & set(one.suffixes) for one in path.iterdir())
    except (OSError, ValueError):
        return False


def _read_parquet(path: Path, record_map: RecordMap | None, rows: int | None) -> Recording:
    """Reads the columns of a Parquet file that the map needs, or all, into a recording of one topic."""
    pyarrow, file = open_parquet(path)
    all_names = names = file.schema_arrow.names
    if record_map is None:
        require_few_columns(path, all_names)
    else:
        wanted = {name.partition("[")[0] for name in record_map.columns} | record_map.columns
        names = [name for name in names if name in wanted]
    losses: list[Loss] = []
    lines_read: list[NDArray[np.int64]] = []
    batches = []
    for first, batch in parquet_batches(file, names, CHUNK, str(path), losses):
        batches.append(batch)
        lines_read.append(np.arange(first + 1, first + 1 + batch.num_rows))
        if rows is not None and sum(map(len, lines_read)) >= rows:
            break
    try:
        schema = file.schema_arrow
        table = pyarrow.Table.from_batches(batches, pyarrow.schema([schema.field(name) for name in names]))
        table = table.slice(0, rows)
        columns: dict[str, Column] = {}
        for name in names:
            columns |= _arrow_column(pyarrow, name, table.column(name))
        information = _convert_dates_to_seconds(columns)
    except (OSError, ValueError, pyarrow.ArrowException) as error:
        raise InputError(f"{path}: not a Parquet file that can be read: {first_line(error)}") from None
    lines = np.concatenate([*lines_read, np.empty(0, np.int64)])[: table.num_rows]
    topic = Topic(str(path), columns, lines=lines, unread=unused_columns(all_names, names))
    return Recording(
        str(path), "table", {"": topic}, information=information, sha256=digest(path), losses=tuple(losses)
    )


def _convert_dates_to_seconds(columns: dict[str, Column]) -> tuple[str, ...]:
    """Converts columns of dates in place to seconds since the first one; returns a sentence on it."""
    dated = {name: values for name, values in columns.items() if values.dtype.kind == "M"}
    firsts = [values[~np.isnat(values)].min() for values in dated.values() if not np.isnat(values).all()]
    if not firsts:
        return ()
    origin = min(firsts).astype("datetime64[s]")
    for name, values in dated.items():
        columns[name] = (values - origin) / np.timedelta64(1, "s")
    return (f"{', '.join(dated)}: times count in seconds from {origin}",)


def _arrow_column(arrow: Any, name: str, column: Any) -> dict[str, Column]:
    """Maps names to columns from a pyarrow column: several for lists; empty for a type that is not read."""
    kind, types = column.type, arrow.types
    if types.is_boolean(kind):
        column = column.cast(arrow.int8())
    if types.is_timestamp(kind):
        return {name: column.cast(arrow.timestamp("ns")).to_numpy()}
    if types.is_list(kind) or types.is_large_list(kind) or types.is_fixed_size_list(kind):
        return split_lists(name, column.to_pylist())
    if types.is_string(kind) or types.is_large_string(kind) or types.is_dictionary(kind):
        return {name: np.array([one or "" for one in column.to_pylist()], dtype=object)}
    if types.is_integer(kind) and not column.null_count:
        return {name: column.to_numpy()}
    if types.is_integer(kind) or types.is_floating(kind) or types.is_boolean(kind) or types.is_decimal(kind):
        return {name: column.cast(arrow.float64(), safe=False).to_numpy()}
    return {}


_READERS: dict[str, Callable[[Path, RecordMap | None, int | None], Recording]] = {
    **dict.fromkeys((".csv", ".tsv", ".txt"), read_text_file),
    **dict.fromkeys((".parquet", ".pq"), _read_parquet),
    ".mat": read_mat,
    **dict.fromkeys((".ulg", ".ulog"), read_ulog),
    **dict.fromkeys((".bag", ".mcap", ".db3", ""), read_bag),
}
_FOREIGN = {
    ".mat": "a .mat file",
    **dict.fromkeys((".ulg", ".ulog"), "a ULog"),
    **dict.fromkeys((".bag", ".mcap", ".db3"), "a ROS bag"),
}
