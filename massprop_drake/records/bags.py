"""Bags of ROS 1 and ROS 2, SQLite or MCAP, through rosbags."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from massprop_drake.errors import InputError
from massprop_drake.inputs.record_map import RecordMap
from massprop_drake.records.recording import (
    MOST_ELEMENTS,
    Column,
    Recording,
    Topic,
    digest,
    missing_topic,
    needs,
    spread,
)

_NANO = 1e-9
_HEAVY = (
    "Image",
    "CompressedImage",
    "PointCloud2",
    "LaserScan",
    "OccupancyGrid",
    "CameraInfo",
    "Marker",
    "MarkerArray",
)
# what reading a damaged file ends in, beside the library's own errors
_DAMAGED = (
    struct.error,
    ArithmeticError,
    AssertionError,
    AttributeError,
    EOFError,
    LookupError,
    MemoryError,
    OSError,
    RuntimeError,
    TypeError,
    ValueError,
)
_DEEPEST = 6  # levels of messages in messages


def read(path: Path, by: RecordMap | None, rows: int | None) -> Recording:
    """Reads a bag; a field of a message is a column, `angular_velocity.x`, an element of an array `data[0]`.

    Stamps are those of the messages' headers, or where there are none those at which they were recorded. They count
    from the bag's first message: a double has no room for nanoseconds since 1970.

    Args:
        path: of a .bag, .mcap or .db3 file, or the folder of a ROS 2 bag.
        by: the map, of whose topics alone are read.
        rows: so many messages at the most of each topic.

    Raises:
        InputError: when rosbags is not installed, or the bag cannot be read.
    """
    try:
        import apsw  # noqa: PLC0415 (of rosbags)
        from rosbags.highlevel import AnyReader, AnyReaderError  # noqa: PLC0415 (an extra)
        from rosbags.rosbag1 import ReaderError as Reader1Error  # noqa: PLC0415
        from rosbags.rosbag2 import ReaderError as Reader2Error  # noqa: PLC0415
        from rosbags.serde import SerdeError  # noqa: PLC0415
        from rosbags.typesys import Stores, TypesysError, get_typestore  # noqa: PLC0415
    except ImportError:
        raise needs(path, "rosbags", "rosbag", "a bag") from None
    own = (AnyReaderError, Reader1Error, Reader2Error, SerdeError, TypesysError, apsw.Error)
    try:
        with AnyReader([path], default_typestore=get_typestore(Stores.LATEST)) as reader:
            types = {one.topic: one.msgtype for one in reader.connections}
            if by is None:
                chosen = [one for one in reader.connections if one.msgtype.rpartition("/")[2] not in _HEAVY]
            else:
                chosen = [one for one in reader.connections if one.topic in by.topics]
            gathered: dict[str, _Gathered] = {}
            for connection, stamp, raw in reader.messages(chosen) if chosen else ():
                topic = gathered.setdefault(connection.topic, _Gathered())
                if rows is None or len(topic.stamps) < rows:
                    topic.add(stamp, reader.deserialize(raw, connection.msgtype))
            origin = reader.start_time
    except (*own, *_DAMAGED) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{path}: not a bag that can be read whole: {_words(error)}{_remedy(path)}") from None
    for name in () if by is None else sorted(by.topics - set(types)):
        raise missing_topic(str(path), name, list(types))
    if by is not None:  # those without a message, too, or it would be said that there is no such topic
        gathered |= {name: _Gathered() for name in by.topics & set(types) - set(gathered)}
    topics = {name: found.topic(f"{path}, {name}", origin) for name, found in gathered.items()}
    notes = (f"{path}: times count from the bag's first message, {origin * _NANO:.3f} s of its clock",)
    kind = "ros1" if path.suffix.lower() == ".bag" else "ros2"
    return Recording(str(path), kind, topics, notes=notes, sha256=digest(path), types=types)


class _Gathered:
    """The messages of a topic."""

    def __init__(self) -> None:
        self.stamps: list[int] = []
        self.own: list[int] = []  # of the headers
        self.fields: list[dict[str, Any]] = []

    def add(self, stamp: int, message: Any) -> None:
        """Takes in a message, and the time at which it was recorded, ns."""
        self.stamps.append(stamp)
        header = getattr(message, "header", None)
        if header is not None and hasattr(header, "stamp"):
            self.own.append(header.stamp.sec * 1_000_000_000 + header.stamp.nanosec)
        self.fields.append(dict(_flat(message)))

    def topic(self, source: str, origin: int) -> Topic:
        """The columns."""
        headed = len(self.own) == len(self.stamps) and any(self.own)
        stamps: NDArray[np.int64] = np.array(self.own if headed else self.stamps, dtype=np.int64)
        names = dict.fromkeys(name for fields in self.fields for name in fields)
        columns: dict[str, Column] = {}
        for name in names:
            columns |= _column(name, [fields.get(name) for fields in self.fields])
        return Topic(source, columns, np.multiply(stamps - origin, _NANO))


def _flat(message: Any, before: str = "", depth: int = 0) -> Iterator[tuple[str, Any]]:
    """Fields of a message by name: numbers, text, and arrays that are not too long."""
    for name in message.__dataclass_fields__:
        if name == "__msgtype__":
            continue
        value = getattr(message, name)
        full = f"{before}{name}"
        if hasattr(value, "__dataclass_fields__"):
            if depth < _DEEPEST:
                yield from _flat(value, f"{full}.", depth + 1)
        elif isinstance(value, (list, tuple)) and value and hasattr(value[0], "__dataclass_fields__"):
            for index, inner in enumerate(value[:MOST_ELEMENTS]):
                yield from _flat(inner, f"{full}[{index}].", depth + 1)
        elif isinstance(value, (bool, int, float, str)) or (np.ndim(value) == 1 and len(value) <= MOST_ELEMENTS):
            yield full, value


def _column(name: str, values: list[Any]) -> dict[str, Column]:
    """The columns of a field, None where a message has it not."""
    if any(np.ndim(value) for value in values if value is not None and not isinstance(value, str)):
        return spread(name, [None if value is None else list(value) for value in values])
    if any(isinstance(value, str) for value in values):
        return {name: np.array(["" if value is None else str(value) for value in values], dtype=object)}
    if all(isinstance(value, int) for value in values):
        return {name: np.array(values)}
    return {name: np.array([np.nan if value is None else float(value) for value in values])}


def _words(error: BaseException) -> str:
    text = str(error.args[0]) if error.args else ""
    return ((text or type(error).__name__).splitlines() or [""])[0].rstrip(".")


def _remedy(path: Path) -> str:
    remedies = {".bag": "; `rosbag reindex` mends one that was cut off", ".mcap": "; `mcap recover` mends such a file"}
    return remedies.get(path.suffix.lower(), "")
