"""PX4's ULog files, through pyulog."""

from __future__ import annotations

import contextlib
import io
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from massprop_drake.errors import InputError, counted
from massprop_drake.inputs.record_map import RecordMap
from massprop_drake.records.completeness import Loss, first_line
from massprop_drake.records.topics import Column, Recording, Topic, digest, missing_extra, missing_topic

_MAGIC, _HEADER = b"ULog\x01\x12\x35", 16  # first bytes, and length of the file's header
_DAMAGED = (ValueError, KeyError, IndexError, TypeError, OverflowError, MemoryError, RecursionError, OSError)
_LONGEST = 10_000  # bytes of a message; pyulog takes a longer one for damaged
_MESSAGE = struct.Struct("<HB")  # size and type before each message


def read_ulog(path: Path, record_map: RecordMap | None, rows: int | None) -> Recording:
    """Reads a PX4 ULog into a recording; its topics are `name`, and `name/1` for the second instance of a topic.

    Args:
        path: of the file.
        record_map: the map, of whose topics alone are read.
        rows: so many at the most of each topic.

    Raises:
        InputError: when pyulog is not installed, or the file is no ULog.
    """
    try:
        from pyulog import ULog  # noqa: PLC0415 (an extra)
        from pyulog.core import ULogException  # noqa: PLC0415
    except ImportError:
        raise missing_extra(path, "pyulog", "ulog", "ULog") from None
    cut_end = _find_last_message(path)
    topic_names = None if record_map is None else sorted({name.partition("/")[0] for name in record_map.topics})
    output = io.StringIO()  # pyulog prints what it thinks of the file
    try:
        with contextlib.redirect_stdout(output), path.open("rb") as file:
            log = ULog(file, topic_names)
    except (ULogException, struct.error, *_DAMAGED) as error:
        raise InputError(f"{path}: not a ULog that can be read: {first_line(error)}") from None
    topics = {}
    for data in log.data_list:
        if "timestamp" not in data.data:
            continue
        name = data.name if data.multi_id == 0 else f"{data.name}/{data.multi_id}"
        stamps = data.data["timestamp"][:rows]
        columns: dict[str, Column] = {key: value[:rows] for key, value in data.data.items() if "_padding" not in key}
        topics[name] = Topic(f"{path}, {name}", columns, stamps.astype(np.int64) * 1e-6)
    for name in () if record_map is None else sorted(record_map.topics - set(topics)):
        if name.partition("/")[0] not in {one.partition("/")[0] for one in topics}:
            raise missing_topic(str(path), name, list(log.message_formats))
    parameters = {**log.initial_parameters, **{name: value for _, name, value in log.changed_parameters}}
    return Recording(
        str(path),
        "ulog",
        topics,
        {name: float(value) for name, value in parameters.items() if isinstance(value, (int, float))},
        sha256=digest(path),
        losses=tuple(_losses(path, log, cut_end)),
    )


def _losses(path: Path, log: Any, cut_end: tuple[int, int]) -> Iterator[Loss]:
    """Yields the losses of a log: damage, a cut end (its offset and missing bytes given), and dropouts."""
    offset, n_missing = cut_end
    if log.file_corruption:
        yield Loss("damaged", f"{path}: is damaged in places, which are left out")
    elif n_missing > _LONGEST:
        yield Loss("damaged", f"{path}: is damaged from byte {offset} on, and not read further")
    elif n_missing:
        short = counted(n_missing, "byte")
        yield Loss("truncated", f"{path}: is cut off: it ends within a message, {short} short, which is left out")
    if log.dropouts:
        total = sum(one.duration for one in log.dropouts)
        yield Loss(
            "damaged", f"{path}: the logger dropped data {counted(len(log.dropouts), 'time')}, {total} ms in all"
        )


def _find_last_message(path: Path) -> tuple[int, int]:
    """Returns the offset of a ULog's last message, and the number of bytes that it lacks; 0: it is whole."""
    try:
        content = path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None
    if not content:
        raise InputError(f"{path}: is empty: it has no row of data")
    if not content.startswith(_MAGIC) or len(content) < _HEADER:
        raise InputError(f"{path}: not a ULog: it does not begin as one")
    begin, offset, size = 0, _HEADER, len(content)
    while offset < size:
        begin, offset = offset, offset + _MESSAGE.size
        if offset <= size:
            offset += _MESSAGE.unpack_from(content, begin)[0]
    return begin, offset - size
