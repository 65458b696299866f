"""Bags of ROS 1 and ROS 2: their messages, whose types rosbags knows, as columns."""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from massprop_drake.errors import InputError, counted
from massprop_drake.inputs.record_map import RecordMap
from massprop_drake.records.completeness import Loss
from massprop_drake.records.storage import Message, Storage, StoredTopic, unpack_file, zstd_library
from massprop_drake.records.topics import (
    MOST_ELEMENTS,
    Column,
    Recording,
    Topic,
    digest,
    missing_extra,
    missing_topic,
    split_lists,
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
# what reading a damaged message ends in, beside the library's own errors
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
_METADATA = "metadata.yaml"
_PACKED = (".zst", ".zstd")
_LEAST_NS = 1000  # by which a record ends before the recorder's last message, ns; doubles round to a quarter of it


def read_bag(path: Path, record_map: RecordMap | None, rows: int | None) -> Recording:
    """Reads a ROS bag into a recording: a table per topic, whose columns are fields such as `angular_velocity.x`.

    Stamps are those of the messages' headers, or where there are none those at which they were recorded. They count
    from the bag's first message: a double has no room for nanoseconds since 1970. Topics that cannot be read are named
    in the notes, unless the map names them.

    Args:
        path: of a .bag, .mcap or .db3 file, or the folder of a ROS 2 bag.
        record_map: the map, of whose topics alone are read.
        rows: so many messages at the most of each topic.

    Raises:
        InputError: when rosbags is not installed, the file is no bag, or a topic of the map cannot be read.
    """
    try:
        types = _Types()
    except ImportError:
        raise missing_extra(path, "rosbags", "rosbag", "a bag") from None
    bag = _Bag(path)
    tables: dict[str, _TopicMessages] = {}
    types_: dict[str, str] = {}  # type of each topic

    def is_wanted(channel: StoredTopic) -> bool:
        """Tests whether to read a topic: the map names it, or, without a map, its messages are not heavy."""
        if record_map is not None:
            return channel.topic in record_map.topics
        return channel.msgtype.rpartition("/")[2] not in _HEAVY

    for message in bag.messages(is_wanted):
        channel = message.channel
        types_.setdefault(channel.topic, channel.msgtype)
        if is_wanted(channel):
            topic = tables.setdefault(channel.topic, _TopicMessages())
            if rows is None or topic.seen < rows:
                topic.add(message, types)
    types_ = {one.topic: one.msgtype for one in bag.channels} | types_
    if record_map is not None:
        for name in sorted(record_map.topics - set(types_)):
            raise missing_topic(str(path), name, list(types_), bag.losses)
        tables |= {name: _TopicMessages() for name in record_map.topics - set(tables)}  # it is there, without a message
    losses, notes = [*bag.losses, *bag.find_lost_messages()], list(bag.notes)
    for name, table in tables.items():
        if table.unread and not table.fields:
            if record_map is not None:
                raise InputError(f"{path}: topic {name}, of type {types_[name]}, cannot be read: {table.reason}")
            notes.append(f"{path}: topic {name}, of type {types_[name]}, is left out: {table.reason}")
        elif table.unread:
            left_out = f"{counted(table.unread, 'message')} of {name} cannot be read, and left out: {table.reason}"
            losses.append(Loss("damaged", f"{path}: {left_out}"))
    origin = bag.first_ns
    topics = {name: table.topic(f"{path}, {name}", origin) for name, table in tables.items() if table.is_readable}
    information = f"{path}: times count from the bag's first message, {(origin or 0) * _NANO:.3f} s of its clock"
    kind = "ros1" if path.suffix.lower() == ".bag" else "ros2"
    return Recording(
        str(path),
        kind,
        topics,
        notes=tuple(notes),
        information=() if origin is None else (information,),
        sha256=digest(path),
        types=types_,
        losses=tuple(losses),
    )


class _BagMetadata(NamedTuple):
    """Metadata of a bag as its recorder wrote them: files, counts of messages, end.

    Attributes:
        files: names of its files, in order; empty: it says nothing.
        counts: messages by topic, of the whole bag.
        by_file: messages of each file by its name.
        end_ns: time of the last message, ns; None: not known.
        packs: each message is compressed by zstd.
    """

    files: tuple[str, ...] = ()
    counts: Mapping[str, int] = MappingProxyType({})
    by_file: Mapping[str, int] = MappingProxyType({})
    end_ns: int | None = None
    packs: bool = False

    @staticmethod
    def read(folder: Path) -> _BagMetadata:
        """Reads the metadata file of a bag's folder; empty without one, ValueError where it is damaged."""
        from ruamel.yaml import YAML  # noqa: PLC0415
        from ruamel.yaml.error import YAMLError  # noqa: PLC0415

        try:
            text = (folder / _METADATA).read_text(encoding="utf-8")
        except OSError:
            return _BagMetadata()
        try:
            data = YAML(typ="safe").load(text)["rosbag2_bagfile_information"]
            counts = {one["topic_metadata"]["name"]: one["message_count"] for one in data["topics_with_message_count"]}
            by_file = {Path(one["path"]).name: one["message_count"] for one in data.get("files") or []}
            end_ns = data["starting_time"]["nanoseconds_since_epoch"] + data["duration"]["nanoseconds"]
            files = tuple(Path(one).name for one in data["relative_file_paths"])
            packs = str(data.get("compression_mode") or "").lower() == "message"
            return _BagMetadata(files, counts, by_file, int(end_ns), packs)
        except (YAMLError, *_DAMAGED) as error:
            raise ValueError(_first_line(error)) from None


class _Bag:
    """Storage files of a bag, and the parts that are lost of them.

    Attributes:
        channels: all that its files have.
        losses: what could not be read; whole once all messages have been.
        notes: what is to be known besides.
        first_ns, last_ns: times of its first and last message, ns; None: it has none.
    """

    def __init__(self, path: Path):
        self._path = path
        self.channels: list[StoredTopic] = []
        self.losses: list[Loss] = []
        self.notes: list[str] = []
        self.first_ns: int | None = None
        self.last_ns: int | None = None
        self._read: Counter[str] = Counter()
        self._counts: Counter[str] = Counter()  # by the files themselves
        folder = path if path.is_dir() else path.parent
        self._stated, self._files = _BagMetadata(), [path]
        if path.suffix.lower() == ".bag" and not path.is_dir():
            return
        try:
            self._stated = _BagMetadata.read(folder)
        except ValueError as error:
            self.losses.append(Loss("damaged", f"{folder / _METADATA}: cannot be read: {error}"))
        if path.is_dir():
            self._files = self._list_files()

    def _list_files(self) -> list[Path]:
        """Returns the paths of a folder's storage files, as its metadata list them, or else all; notes lost files."""
        present = sorted(one for one in self._path.iterdir() if _content_suffix(one) in (".db3", ".mcap"))
        if not self._stated.files:
            if not self.losses:
                self.losses.append(
                    Loss("truncated", f"{self._path}: has no {_METADATA}: the recorder did not finish it")
                )
            return present
        for name in self._stated.files:
            if not (self._path / name).is_file():
                text = f", of {counted(self._stated.by_file[name], 'message')}" if name in self._stated.by_file else ""
                self.losses.append(Loss("damaged", f"{self._path / name}: is not there{text}"))
        for one in present:
            if one.name not in self._stated.files:
                self.notes.append(f"{one}: is not read: {_METADATA} does not name it")
        paths = [self._path / name for name in self._stated.files if (self._path / name).is_file()]
        if not paths:
            raise InputError(f"{self._path}: none of the files that its {_METADATA} names is there")
        return paths

    def messages(self, accept: Callable[[StoredTopic], bool]) -> Iterator[Message]:
        """Yields every message of all files of the bag; data are empty for topics not accepted."""
        with ExitStack() as stack:
            for path in self._files:
                file = path
                if path.suffix.lower() in _PACKED:
                    file = Path(stack.enter_context(TemporaryDirectory(prefix="massprop-")), path.stem)
                    loss = unpack_file(path, file)
                    self.losses += [loss] if loss is not None else []
                storage = Storage(file, str(path))
                try:
                    for message in storage.messages(accept):
                        self._read[message.channel.topic] += 1
                        stamp = message.stamp_ns
                        self.first_ns = stamp if self.first_ns is None else min(self.first_ns, stamp)
                        self.last_ns = stamp if self.last_ns is None else max(self.last_ns, stamp)
                        yield self._unpack(message) if self._stated.packs and message.data else message
                except InputError as error:
                    if len(self._files) == 1:
                        raise
                    self.losses.append(Loss("damaged", str(error)))
                self.channels += storage.channels.values()
                self.losses += storage.losses
                self._counts += storage.stated

    @staticmethod
    def _unpack(message: Message) -> Message:
        """Returns a message with its data decompressed by zstd; unchanged where these are damaged."""
        try:
            return message._replace(data=zstd_library().decompress(message.data))
        except (zstd_library().ZstdError, EOFError):
            return message

    def find_lost_messages(self) -> Iterator[Loss]:
        """Yields a loss where fewer messages of a topic were read than the recorder counted; notes surpluses."""
        stated, counter = self._stated.counts, str(self._path / _METADATA)
        if not (stated and self._path.is_dir()):
            stated, counter = self._counts, f"{self._path}: its recorder"
            yield from self._find_lost_messages_of_file()
        less = {name: count for name, count in stated.items() if self._read[name] < count}
        if less:
            is_cut = self._stated.end_ns is not None and (self.last_ns or 0) < self._stated.end_ns - _LEAST_NS
            counts = ", ".join(f"{name} {self._read[name]} of {count}" for name, count in less.items())
            text = f"{counter} counted {sum(stated.values())} messages, {self._read.total()} were read: {counts}"
            yield Loss("truncated" if is_cut else "damaged", text)
        for name, count in stated.items():
            if self._read[name] > count:
                self.notes.append(f"{counter} counted {count} messages of {name}, {self._read[name]} were read")

    def _find_lost_messages_of_file(self) -> Iterator[Loss]:
        """Yields a loss where a file read without its folder has fewer messages than the metadata count."""
        total, read = self._stated.by_file.get(self._path.name), self._read.total()
        if total is not None and read < total and not self._path.is_dir():
            metadata = self._path.parent / _METADATA
            yield Loss("truncated", f"{metadata} counted {total} messages in {self._path.name}, {read} were read")


def _content_suffix(path: Path) -> str:
    """Returns the lowercase suffix of a path without a suffix of compression: ".db3" of "a.db3.zst"."""
    return Path(path.stem).suffix.lower() if path.suffix.lower() in _PACKED else path.suffix.lower()


class _Types:
    """Types of messages, each with the definition that its bag has, or else as ROS 2 has it."""

    def __init__(self) -> None:
        from rosbags.serde import SerdeError  # noqa: PLC0415 (an extra)
        from rosbags.typesys import Stores, TypesysError, get_typestore  # noqa: PLC0415

        self._errors = (SerdeError, TypesysError, *_DAMAGED)
        self._empty: Callable[[], Any] = lambda: get_typestore(Stores.EMPTY)
        self._usual: Any = get_typestore(Stores.LATEST)
        self._by_channel: dict[StoredTopic, Callable[[bytes], Any] | str] = {}

    def message(self, channel: StoredTopic, data: bytes) -> Any:
        """Deserializes a message's bytes by its channel's type; raises ValueError with the reason where it cannot."""
        if channel not in self._by_channel:
            try:
                self._by_channel[channel] = self._make_reader(channel)
            except self._errors as error:
                self._by_channel[channel] = _first_line(error)
        reader = self._by_channel[channel]
        if isinstance(reader, str):
            raise ValueError(reader)
        try:
            return reader(data)
        except self._errors as error:
            raise ValueError(_first_line(error)) from None

    def _make_reader(self, channel: StoredTopic) -> Callable[[bytes], Any]:
        """Makes the function from bytes to message for a channel; raises ValueError for an unknown type."""
        from rosbags.typesys import get_types_from_idl, get_types_from_msg  # noqa: PLC0415 (an extra)

        if channel.encoding not in ("cdr", "ros1"):
            raise ValueError(f"its messages are written as {channel.encoding!r}, and cdr and ros1 are known")
        name, store = channel.msgtype, self._usual
        if channel.definition:
            store = self._empty()
            if channel.language in ("ros2msg", "ros1msg"):
                store.register(get_types_from_msg(channel.definition, name))
            else:
                for part in _split_idl(channel.definition):
                    store.register(get_types_from_idl(part))
        elif name not in store.fielddefs:
            raise ValueError("its type is not defined in the bag, and none of ROS 2's own")
        elif channel.digest.startswith("RIHS01") and store.hash_rihs01(name) != channel.digest:
            raise ValueError("its type is not defined in the bag, and another one than ROS 2 has by this name")
        read = store.deserialize_ros1 if channel.encoding == "ros1" else store.deserialize_cdr
        return lambda data: read(data, name)


def _split_idl(definition: str) -> list[str]:
    """Splits an IDL definition of a message type into the texts of the types that it consists of."""
    rule = "=" * 80 + "\n"
    if not definition.startswith(f"{rule}IDL: "):
        return [definition]
    return [part.partition("\n")[2] for part in definition.split(rule)[1:]]


class _TopicMessages:
    """Messages of a topic as they are read: stamps, fields, and a count of those that cannot be read."""

    def __init__(self) -> None:
        self.stamps: list[int] = []
        self.own: list[int] = []  # of the headers
        self.fields: list[dict[str, Any]] = []
        self.unread, self.reason = 0, ""  # messages that cannot be read, and why the first cannot

    @property
    def seen(self) -> int:
        """Number of messages added so far, those that cannot be read included."""
        return len(self.stamps) + self.unread

    @property
    def is_readable(self) -> bool:
        """True if at least one message of the topic can be read, or it has none at all."""
        return bool(self.stamps) or not self.unread

    def add(self, stored: Message, types: _Types) -> None:
        """Deserializes a message and adds its stamp and fields; counts it as unread where it cannot be read."""
        try:
            message = types.message(stored.channel, stored.data)
        except ValueError as error:
            self.unread, self.reason = self.unread + 1, self.reason or str(error)
            return
        self.stamps.append(stored.stamp_ns)
        header = getattr(message, "header", None)
        if header is not None and hasattr(header, "stamp"):
            self.own.append(header.stamp.sec * 1_000_000_000 + header.stamp.nanosec)
        self.fields.append(dict(_flatten_fields(message)))

    def topic(self, source: str, origin: int | None) -> Topic:
        """Makes the table of the topic: a column per field, and stamps in s from the origin, ns, in recorded order."""
        order = np.argsort(self.stamps, kind="stable")
        if (np.diff(order) < 0).any():
            self.stamps, self.fields = [self.stamps[index] for index in order], [self.fields[index] for index in order]
            self.own = [self.own[index] for index in order] if len(self.own) == len(order) else self.own
        headed = len(self.own) == len(self.stamps) and any(self.own)
        stamps: NDArray[np.int64] = np.array(self.own if headed else self.stamps, dtype=np.int64)
        names = dict.fromkeys(name for fields in self.fields for name in fields)
        columns: dict[str, Column] = {}
        for name in names:
            columns |= _field_columns(name, [fields.get(name) for fields in self.fields])
        return Topic(source, columns, np.multiply(stamps - (origin or 0), _NANO))


def _flatten_fields(message: Any, prefix: str = "", depth: int = 0) -> Iterator[tuple[str, Any]]:
    """Yields name and value of a message's numbers, texts and short arrays; nested names are joined by dots."""
    for name in message.__dataclass_fields__:
        if name == "__msgtype__":
            continue
        value = getattr(message, name)
        full = f"{prefix}{name}"
        if hasattr(value, "__dataclass_fields__"):
            if depth < _DEEPEST:
                yield from _flatten_fields(value, f"{full}.", depth + 1)
        elif isinstance(value, (list, tuple)) and value and hasattr(value[0], "__dataclass_fields__"):
            for index, inner in enumerate(value[:MOST_ELEMENTS]):
                yield from _flatten_fields(inner, f"{full}[{index}].", depth + 1)
        elif isinstance(value, (bool, int, float, str)) or (np.ndim(value) == 1 and len(value) <= MOST_ELEMENTS):
            yield full, value


def _field_columns(name: str, values: list[Any]) -> dict[str, Column]:
    """Makes the columns of one message field from its values: NaN or "" where a message lacks it."""
    if any(np.ndim(value) for value in values if value is not None and not isinstance(value, str)):
        return split_lists(name, [None if value is None else list(value) for value in values])
    if any(isinstance(value, str) for value in values):
        return {name: np.array(["" if value is None else str(value) for value in values], dtype=object)}
    if all(isinstance(value, int) for value in values):
        return {name: np.array(values)}
    return {name: np.array([np.nan if value is None else float(value) for value in values])}


def _first_line(error: BaseException) -> str:
    """Returns the first line of an exception's text, without its period; the exception's type where it has none."""
    text = str(error.args[0]) if error.args else ""
    return ((text or type(error).__name__).splitlines() or [""])[0].rstrip(".")
