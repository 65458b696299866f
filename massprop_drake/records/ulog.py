"""PX4's ULog files, through pyulog."""

from __future__ import annotations

import contextlib
import io
import struct
from pathlib import Path
from typing import Any

import numpy as np

from massprop_drake.errors import InputError
from massprop_drake.inputs.record_map import RecordMap
from massprop_drake.records.recording import Column, Recording, Topic, digest, missing_topic, needs

_MAGIC, _HEADER = b"ULog\x01\x12\x35", 16  # first bytes, and length of the file's header
_DAMAGED = (ValueError, KeyError, IndexError, TypeError, OverflowError, MemoryError, RecursionError, OSError)
_MESSAGE = struct.Struct("<HB")  # size and type before each message


def read(path: Path, by: RecordMap | None, rows: int | None) -> Recording:
    """Reads a ULog; its topics are `name`, and `name/1` for the second instance of a topic.

    Args:
        path: of the file.
        by: the map, of whose topics alone are read.
        rows: so many at the most of each topic.

    Raises:
        InputError: when pyulog is not installed, or the file is no ULog, or ends within a message.
    """
    try:
        from pyulog import ULog  # noqa: PLC0415 (an extra)
        from pyulog.core import ULogException  # noqa: PLC0415
    except ImportError:
        raise needs(path, "pyulog", "ulog", "ULog") from None
    cut = _cut_off(path)
    if cut and (by is None or by.cut_off == "refuse"):
        raise InputError(
            f"{path}: is cut off: it ends within a message, {cut} bytes short; get the whole file, or take what is "
            "there with `cut_off: accept` in the map"
        )
    wanted = None if by is None else sorted({name.partition("/")[0] for name in by.topics})
    said = io.StringIO()  # pyulog prints what it thinks of the file
    try:
        with contextlib.redirect_stdout(said), path.open("rb") as file:
            log = ULog(file, wanted)
    except (ULogException, struct.error, *_DAMAGED) as error:
        first = (str(error).splitlines() or [type(error).__name__])[0]
        raise InputError(f"{path}: not a ULog that can be read: {first}") from None
    topics = {}
    for data in log.data_list:
        if "timestamp" not in data.data:
            continue
        name = data.name if data.multi_id == 0 else f"{data.name}/{data.multi_id}"
        stamps = data.data["timestamp"][:rows]
        columns: dict[str, Column] = {key: value[:rows] for key, value in data.data.items() if "_padding" not in key}
        topics[name] = Topic(f"{path}, {name}", columns, stamps.astype(np.int64) * 1e-6)
    for name in () if by is None else sorted(by.topics - set(topics)):
        if name.partition("/")[0] not in {one.partition("/")[0] for one in topics}:
            raise missing_topic(str(path), name, list(log.message_formats))
    parameters = {**log.initial_parameters, **{name: value for _, name, value in log.changed_parameters}}
    return Recording(
        str(path),
        "ulog",
        topics,
        {name: float(value) for name, value in parameters.items() if isinstance(value, (int, float))},
        tuple(_notes(path, log, cut)),
        digest(path),
    )


def _notes(path: Path, log: Any, cut: int) -> list[str]:
    notes = []
    if cut:
        notes.append(f"{path} is cut off within a message, the last one left out")
    if log.file_corruption:
        notes.append(f"{path} is damaged in places, which are left out")
    if log.dropouts:
        total = sum(one.duration for one in log.dropouts)
        notes.append(f"{path}: the logger dropped data {len(log.dropouts)} times, {total} ms in all")
    return notes


def _cut_off(path: Path) -> int:
    """By how many bytes a file ends too early for its last message; 0: it is whole.

    Raises:
        InputError: when it does not begin as a ULog does.
    """
    try:
        content = path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None
    if not content:
        raise InputError(f"{path}: is empty: it has no row of data")
    if not content.startswith(_MAGIC) or len(content) < _HEADER:
        raise InputError(f"{path}: not a ULog: it does not begin as one")
    place, size = _HEADER, len(content)
    while place < size:
        if place + _MESSAGE.size > size:
            return place + _MESSAGE.size - size
        length, _ = _MESSAGE.unpack_from(content, place)
        place += _MESSAGE.size + length
    return place - size
