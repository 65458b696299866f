"""Storage of bags: messages as SQLite, MCAP and ROS 1 files hold them, as far as a file is valid.

Nothing here relies on an index, since a recorder that was stopped has written none. The layouts are those of
mcap.dev/spec, wiki.ros.org/Bags/Format/2.0, and of rosbag2's tables.
"""

from __future__ import annotations

import bz2
import contextlib
import mmap
import re
import shutil
import sqlite3
import struct
import sys
import zlib
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

from massprop_drake.errors import InputError, counted
from massprop_drake.records.completeness import Loss

_MCAP, _ROS1, _SQLITE = b"\x89MCAP0\r\n", b"#ROSBAG V2.0\n", b"SQLite format 3\0"
_SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _CHUNK_INDEX, _STATISTICS = 0x03, 0x04, 0x05, 0x06, 0x08, 0x0B  # of MCAP
_DATA_END, _END = 0x0F, 0x02  # likewise
_NANO = 1e-9
_FOOTER = 37  # bytes of an MCAP file's last record and its closing mark
_BESIDE = ("-wal", "-journal")  # what SQLite has not yet written into the database, by the ending of its name
_PIECE = 1 << 20  # bytes that are unpacked at once
_DAMAGED = (struct.error, UnicodeDecodeError, ValueError, LookupError, OSError, RuntimeError, EOFError, zlib.error)


class StoredTopic(NamedTuple):
    """Topic of a storage file, and how its messages are written.

    Attributes:
        topic: its name.
        msgtype: of its messages.
        encoding: of its messages, such as "cdr" or "ros1".
        language: of the definition, such as "ros2msg"; "": there is none.
        definition: of the type.
        digest: of the definition that the recorder had; "": not stored.
    """

    topic: str
    msgtype: str
    encoding: str
    language: str = ""
    definition: str = ""
    digest: str = ""


class Message(NamedTuple):
    """A message as it was recorded.

    Attributes:
        channel: its topic, and how it is written.
        stamp_ns: time at which it was recorded, ns.
        data: as written; empty for a topic that is not wanted.
    """

    channel: StoredTopic
    stamp_ns: int
    data: bytes


class Storage:
    """A storage file that is read.

    Args:
        path: of the file.
        name: of the file in messages.

    Attributes:
        channels: all that it has, by number; whole once its messages have been read.
        stated: number of messages that the recorder counted, by topic; empty: it did not.
        losses: what could not be read; likewise.
    """

    def __init__(self, path: Path, name: str):
        self.path, self.name = path, name
        self.channels: dict[int, StoredTopic] = {}
        self.stated: Counter[str] = Counter()
        self.losses: list[Loss] = []

    def messages(self, accept: Callable[[StoredTopic], bool]) -> Iterator[Message]:
        """Yields all messages of a bag's file in order, without data for topics that are not accepted.

        Raises:
            InputError: when the file is none of its kind.
        """
        read = {".db3": self._read_sqlite, ".mcap": self._read_mcap, ".bag": self._read_ros1}[self.path.suffix.lower()]
        try:
            yield from read(accept)
        except OSError as error:
            raise InputError(f"{self.name}: cannot be read: {error.strerror or error}") from None

    def _note_loss(self, kind: Any, text: str) -> None:
        """Appends a loss, "truncated" or "damaged", unless it is the same as the last one."""
        loss = Loss(kind, f"{self.name}: {text}")
        if loss not in self.losses[-1:]:
            self.losses.append(loss)

    def _map_file(self, signature: bytes, kind: str) -> memoryview:
        """Maps the file into memory; raises InputError where it does not begin with its kind's signature."""
        with self.path.open("rb") as file:
            start = file.read(len(signature))
            if not start:
                raise InputError(f"{self.name}: is empty: it has no row of data")
            if start != signature:
                raise InputError(f"{self.name}: not {kind}: it does not begin as one")
            return memoryview(mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ))

    # -------------------------------------------------------------------------------------- MCAP

    def _read_mcap(self, accept: Callable[[StoredTopic], bool]) -> Iterator[Message]:
        """Yields the messages of an MCAP file; skips damaged parts and adds them to the losses."""
        content = self._map_file(_MCAP, "an MCAP file")
        chunks, schemas = list[int](), dict[int, tuple[str, str, str]]()
        whole = len(content) > 2 * _FOOTER and content[-8:] == _MCAP
        if whole:  # the summary has all channels and counts; without it they come along the way
            chunks = self._read_mcap_summary(content, schemas)
        offset = len(_MCAP)
        while True:
            for op, body in _mcap_records(content, offset, len(content)):
                offset += 9 + len(body)
                if op in (_DATA_END, _END):
                    checksum = int.from_bytes(body[:4], "little") if op == _DATA_END else 0
                    if checksum and not self.losses and zlib.crc32(content[: offset - 9 - len(body)]) != checksum:
                        self._note_loss("damaged", "its checksum is another: something in it has changed")
                    if not whole:
                        self._note_loss("truncated", "is cut off within the summary at its end; all messages are there")
                    return
                if op == _CHUNK:
                    yield from self._read_mcap_chunk(body, accept, schemas)
                else:
                    yield from self._read_mcap_record(op, body, accept, schemas)
            if not whole:
                self._note_loss(
                    "truncated", f"is cut off: it ends at byte {len(content)}, without the summary at its end"
                )
                if content[offset : offset + 1] == bytes([_CHUNK]):
                    yield from self._read_mcap_chunk(content[offset + 9 :], accept, schemas, is_cut=True)
                return
            following = min((one for one in chunks if one > offset), default=len(content))
            self._note_loss("damaged", f"bytes {offset} to {following} are damaged, and left out")
            offset = following
            if offset == len(content):
                return

    def _read_mcap_summary(self, content: memoryview, schemas: dict[int, tuple[str, str, str]]) -> list[int]:
        """Reads the channels and counts in the summary; returns the offsets of the chunks in the file."""
        chunks = []
        begin = int.from_bytes(content[-28:-20], "little")
        try:
            for op, body in _mcap_records(content, begin, len(content) - 8) if begin else ():
                self._read_mcap_description(op, body, schemas)
                if op == _CHUNK_INDEX:
                    chunks.append(int.from_bytes(body[16:24], "little"))
                elif op == _STATISTICS:
                    counts = body[46 : 46 + int.from_bytes(body[42:46], "little")]
                    for number, count in struct.iter_unpack("<HQ", counts):
                        if number in self.channels:
                            self.stated[self.channels[number].topic] += count
        except _DAMAGED:
            self._note_loss("damaged", "its summary is damaged")
        return chunks

    def _read_mcap_description(self, op: int, body: memoryview, schemas: dict[int, tuple[str, str, str]]) -> None:
        """Adds the schema or channel in an MCAP record to those known; ignores records of other kinds."""
        if op == _SCHEMA:
            number = int.from_bytes(body[:2], "little")
            name, offset = _read_text(body, 2)
            language, offset = _read_text(body, offset)
            schemas[number] = name, language, _read_text(body, offset)[0]
        elif op == _CHANNEL:
            number, schema = struct.unpack_from("<HH", body)
            topic, offset = _read_text(body, 4)
            encoding, _ = _read_text(body, offset)
            msgtype, language, definition = schemas.get(schema, ("of no type", "", ""))
            self.channels[number] = StoredTopic(topic, _ros2_type_name(msgtype), encoding, language, definition)

    def _read_mcap_record(
        self, op: int, body: memoryview, accept: Callable[[StoredTopic], bool], schemas: dict[int, tuple[str, str, str]]
    ) -> Iterator[Message]:
        """Yields the message in an MCAP record, if it is one; adds a schema or channel to those known."""
        try:
            self._read_mcap_description(op, body, schemas)
            if op != _MESSAGE:
                return
            number, _, stamp = struct.unpack_from("<HIQ", body)
            channel = self.channels[number]
        except _DAMAGED:
            self._note_loss("damaged", "a record is damaged, and left out")
            return
        yield Message(channel, stamp, body[22:].tobytes() if accept(channel) else b"")

    def _read_mcap_chunk(
        self,
        body: memoryview,
        accept: Callable[[StoredTopic], bool],
        schemas: dict[int, tuple[str, str, str]],
        *,
        is_cut: bool = False,
    ) -> Iterator[Message]:
        """Yields the messages in an MCAP chunk; of one that is cut off, those before its end."""
        subject = "a chunk is"
        try:
            start, end, size, checksum = struct.unpack_from("<QQQI", body)
            subject = f"messages between {_NANO * start:.3f} and {_NANO * end:.3f} s are"
            compression, offset = _read_text(body, 28)
            data = decompress(body[offset + 8 :][: int.from_bytes(body[offset : offset + 8], "little")], compression)
            if not is_cut and (len(data) != size or (checksum and zlib.crc32(data) != checksum)):
                raise ValueError("its checksum is another")
            for op, record in _mcap_records(memoryview(data), 0, len(data), strict=not is_cut):
                yield from self._read_mcap_record(op, record, accept, schemas)
        except _DAMAGED as error:
            if not is_cut:
                self._note_loss("damaged", f"{subject} damaged, and left out: {error}")

    # -------------------------------------------------------------------------------------- ROS 1

    def _read_ros1(self, accept: Callable[[StoredTopic], bool]) -> Iterator[Message]:
        """Yields the messages of a ROS 1 bag; skips damaged parts and adds them to the losses."""
        content = self._map_file(_ROS1, "a bag of ROS 1")
        header, _ = next(_ros1_records(content, len(_ROS1)), (_Header({}, 0, 0), b""))
        if header.fields.get("encryptor"):
            raise InputError(f"{self.name}: is encrypted")
        index = int.from_bytes(header.fields.get("index_pos", b""), "little")
        whole = 0 < index <= len(content)
        chunks = self._read_ros1_index(content[index:], accept) if whole else []
        offset, end = len(_ROS1), index if whole else len(content)
        while True:
            for header, data in _ros1_records(content[:end], offset):
                offset += header.size + len(data)
                try:
                    if header.op == 5:
                        inner = decompress(data, header.fields["compression"].decode())
                        if len(inner) != header.number("size", "<I"):
                            raise ValueError("a chunk is not whole")
                        yield from self._read_ros1_chunk(inner, accept, strict=True)
                    else:
                        yield from self._read_ros1_record(header, data, accept)
                except _DAMAGED:
                    self._note_loss("damaged", f"the record that ends at byte {offset} is damaged, and left out")
            if offset == end and whole:
                return
            if not whole:
                reason = f"is cut off: it ends at byte {end}" if offset < end or index else "was not finished"
                self._note_loss("truncated", f"{reason}, without the index at its end")
                with contextlib.suppress(*_DAMAGED):
                    header = _Header.read(content, offset)
                    if header.op == 5:
                        inner = decompress(content[offset + header.size :], header.fields["compression"].decode())
                        yield from self._read_ros1_chunk(inner, accept, strict=False)
                return
            following = min((one for one in chunks if one > offset), default=end)
            self._note_loss("damaged", f"bytes {offset} to {following} are damaged, and left out")
            offset = following

    def _read_ros1_index(self, content: memoryview, accept: Callable[[StoredTopic], bool]) -> list[int]:
        """Reads the channels and counts in the index of a bag; returns the offsets of the chunks."""
        chunks, offset = [], 0
        try:
            for header, data in _ros1_records(content, 0):
                offset += header.size + len(data)
                if header.op == 6:
                    chunks.append(header.number("chunk_pos", "<Q"))
                    for number, count in struct.iter_unpack("<II", data):
                        self.stated[self.channels[number].topic] += count
                else:
                    list(self._read_ros1_record(header, data, accept))
        except _DAMAGED:
            self._note_loss("damaged", "its index is damaged")
        if offset < len(content):
            self._note_loss("truncated", "is cut off within the index at its end; all messages are there")
        return chunks

    def _read_ros1_chunk(
        self, content: bytes, accept: Callable[[StoredTopic], bool], *, strict: bool
    ) -> Iterator[Message]:
        """Yields the messages in a decompressed chunk of a ROS 1 bag."""
        for header, data in _ros1_records(memoryview(content), 0, strict=strict):
            yield from self._read_ros1_record(header, data, accept)

    def _read_ros1_record(
        self, header: _Header, data: memoryview, accept: Callable[[StoredTopic], bool]
    ) -> Iterator[Message]:
        """Yields the message in a ROS 1 record, if it is one; adds a connection to the channels."""
        if header.op == 7:
            parts = _split_header(data)
            topic = re.sub("/+", "/", header.fields["topic"].decode())
            definition = parts["message_definition"].decode(errors="replace")
            self.channels[header.number("conn", "<I")] = StoredTopic(
                topic, _ros2_type_name(parts["type"].decode()), "ros1", "ros1msg", definition, parts["md5sum"].decode()
            )
        elif header.op == 2:
            seconds, nanoseconds = struct.unpack("<II", header.fields["time"])
            channel = self.channels[header.number("conn", "<I")]
            stamp = seconds * 1_000_000_000 + nanoseconds
            yield Message(channel, stamp, data.tobytes() if accept(channel) else b"")

    # ------------------------------------------------------------------------------------- SQLite

    def _read_sqlite(self, accept: Callable[[StoredTopic], bool]) -> Iterator[Message]:
        """Yields the messages of an SQLite bag, from a copy where reading could change it or it is cut off."""
        content = self._map_file(_SQLITE, "a database of SQLite")
        size, pages = int.from_bytes(content[16:18], "big"), int.from_bytes(content[28:32], "big")
        size = max(size, 512) if size != 1 else 65536  # of a page; 1 stands for what has no room
        n_missing = max(pages * size - len(content), 0)
        whole = len(content) // size * size  # SQLite would read zeros for the rest of a page
        side_files = [path for end in _BESIDE if (path := self.path.with_name(self.path.name + end)).exists()]
        with TemporaryDirectory(prefix="massprop-") as folder:
            uri = f"{self.path.absolute().as_uri()}?immutable=1"
            if whole < len(content) or any(path.stat().st_size for path in side_files):  # it would write into those
                file = Path(folder, self.path.name)
                file.write_bytes(content[:whole])
                for path in side_files:
                    shutil.copyfile(path, Path(folder, path.name))
                uri = file.as_uri()
            with closing(sqlite3.connect(uri, uri=True)) as connection:
                yield from self._read_sqlite_messages(connection, accept, n_missing)

    def _read_sqlite_messages(
        self, connection: sqlite3.Connection, accept: Callable[[StoredTopic], bool], n_missing: int
    ) -> Iterator[Message]:
        """Yields the messages in a bag's database; adds damaged ones and missing bytes to the losses."""
        cut = f"is cut off: {counted(n_missing, 'byte')} of the database are missing" if n_missing else ""
        try:
            connection.execute("PRAGMA writable_schema=ON")  # or a database that is cut off cannot be read at all
            self._read_sqlite_channels(connection)
            numbers = ",".join(str(number) for number, one in self.channels.items() if accept(one))
            rows = connection.execute(
                f"SELECT topic_id, timestamp, CASE WHEN topic_id IN ({numbers}) THEN data ELSE x'' END FROM messages"
            )
        except (sqlite3.Error, *_DAMAGED) as error:
            why = f"{cut}, and none of its messages can be read" if cut else f"not a bag that can be read: {error}"
            raise InputError(f"{self.name}: {why}") from None
        try:
            for number, stamp, data in rows:
                if number in self.channels and isinstance(stamp, int) and isinstance(data, bytes):
                    yield Message(self.channels[number], stamp, data)
                elif not cut:
                    self._note_loss("damaged", "a message is damaged, and left out")
        except (sqlite3.Error, *_DAMAGED) as error:
            if not cut:
                self._note_loss("damaged", f"cannot be read further: {error}")
        if cut:
            self._note_loss("truncated", cut)

    def _read_sqlite_channels(self, connection: sqlite3.Connection) -> None:
        """Reads the topics in a bag's database, with types and definitions, into the channels."""
        tables = {name for (name,) in connection.execute("SELECT name FROM sqlite_master WHERE type='table'")}
        if not {"topics", "messages"} <= tables:
            raise ValueError("it has no tables of topics and messages")
        names = {row[1] for row in connection.execute("PRAGMA table_info(topics)")}
        digest = "type_description_hash" if "type_description_hash" in names else "''"
        defined: dict[str, tuple[str, str]] = {}
        if "message_definitions" in tables:
            names_of = "topic_type, encoding, encoded_message_definition"
            rows = connection.execute(f"SELECT {names_of} FROM message_definitions")
            defined = {str(name): (str(language), str(text)) for name, language, text in rows if text}
        for number, topic, msgtype, encoding, stored in connection.execute(
            f"SELECT id, name, type, serialization_format, {digest} FROM topics"
        ):
            language, text = defined.get(msgtype, ("", ""))
            self.channels[number] = StoredTopic(topic, msgtype, encoding, language, text, stored)


# ------------------------------------------------------------------------------------------ bytes


def _read_text(body: memoryview, offset: int) -> tuple[str, int]:
    """Reads a length-prefixed text at an offset; returns it and the offset after it."""
    begin = offset + 4
    end = begin + int.from_bytes(body[offset:begin], "little")
    if end > len(body):
        raise ValueError("a text is cut off")
    return body[begin:end].tobytes().decode(), end


def _ros2_type_name(msgtype: str) -> str:
    """Returns the name of a message type in the form of ROS 2, `package/msg/Type`."""
    return msgtype if msgtype.count("/") != 1 else msgtype.replace("/", "/msg/")


def _mcap_records(
    content: memoryview, offset: int, end: int, *, strict: bool = False
) -> Iterator[tuple[int, memoryview]]:
    """Yields kind and body of MCAP records up to the first incomplete one; strict: raises ValueError there."""
    while offset < end:
        op, size = content[offset], int.from_bytes(content[offset + 1 : offset + 9], "little")
        if op == 0 or offset + 9 + size > end:
            if strict:
                raise ValueError("a record is not whole")
            return
        yield op, content[offset + 9 : offset + 9 + size]
        offset += 9 + size


class _Header(NamedTuple):
    """The header of a ROS 1 record.

    Attributes:
        fields: by name.
        size: of the header with the lengths of header and data, bytes.
        length: of the data that follow, bytes.
    """

    fields: dict[str, bytes]
    size: int
    length: int

    @property
    def op(self) -> int:
        """Number of the record's kind; 0: it has none."""
        return int.from_bytes(self.fields.get("op", b""), "little")

    def number(self, name: str, form: str) -> int:
        """Returns a field of the header as an integer, unpacked by a format of `struct`."""
        return int(struct.unpack(form, self.fields[name])[0])

    @staticmethod
    def read(content: memoryview, offset: int) -> _Header:
        """Reads a record's header at an offset; raises ValueError or struct.error where there is none."""
        (size,) = struct.unpack_from("<I", content, offset)
        if offset + 8 + size > len(content):
            raise ValueError("a header is cut off")
        (length,) = struct.unpack_from("<I", content, offset + 4 + size)
        return _Header(_split_header(content[offset + 4 : offset + 4 + size]), 8 + size, length)


def _split_header(content: memoryview) -> dict[str, bytes]:
    """Maps names to values, bytes, of the fields in a ROS 1 record's header."""
    fields, offset = {}, 0
    while offset < len(content):
        (size,) = struct.unpack_from("<I", content, offset)
        name, mark, value = content[offset + 4 : offset + 4 + size].tobytes().partition(b"=")
        if not mark:
            raise ValueError("a field has no name")
        fields[name.decode()] = value
        offset += 4 + size
    return fields


def _ros1_records(content: memoryview, offset: int, *, strict: bool = False) -> Iterator[tuple[_Header, memoryview]]:
    """Yields header and data of ROS 1 records up to the first incomplete one; strict: raises ValueError there."""
    while offset < len(content):
        try:
            header = _Header.read(content, offset)
        except _DAMAGED:
            header = _Header({}, 0, len(content))
        begin = offset + header.size
        if begin + header.length > len(content):
            if strict:
                raise ValueError("a record is not whole")
            return
        yield header, content[begin : begin + header.length]
        offset = begin + header.length


def decompress(data: memoryview, compression: str) -> bytes:
    """Returns decompressed bytes, as far as the compressed ones go: none, bz2, lz4 or zstd.

    Raises:
        ValueError: when the compression is not known, or the bytes are damaged.
    """
    if compression in ("", "none"):
        return data.tobytes()
    if compression == "bz2":
        return bz2.BZ2Decompressor().decompress(data)
    if compression == "lz4":
        from lz4.frame import LZ4FrameDecompressor  # noqa: PLC0415 (of rosbags)

        return bytes(LZ4FrameDecompressor().decompress(data.tobytes()))
    if compression == "zstd":
        try:
            return bytes(zstd_library().ZstdDecompressor().decompress(data))
        except zstd_library().ZstdError as error:
            raise ValueError(str(error)) from None
    raise ValueError(f"compression {compression!r} is not known")


def unpack_file(path: Path, target: Path) -> Loss | None:
    """Decompresses a zstd file to a target file; returns the loss where it is damaged or cut off, else None."""
    inflate = zstd_library().ZstdDecompressor()
    with path.open("rb") as packed, target.open("wb") as file:
        while data := packed.read(_PIECE):
            while data:
                try:
                    file.write(inflate.decompress(data))
                except (zstd_library().ZstdError, EOFError) as error:
                    return Loss("damaged", f"{path}: cannot be unpacked further: {error}")
                data = inflate.unused_data if inflate.eof else b""
                if data:
                    inflate = zstd_library().ZstdDecompressor()
    return None if inflate.eof else Loss("truncated", f"{path}: is cut off: its compressed data do not end")


def zstd_library() -> Any:
    """Returns the module for zstd: Python's own from 3.14 on, else the one that rosbags installs."""
    if sys.version_info >= (3, 14):
        from compression import zstd as library  # noqa: PLC0415
    else:
        from backports import zstd as library  # noqa: PLC0415
    return library
