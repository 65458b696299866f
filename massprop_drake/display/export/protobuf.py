"""Messages of numbers in Protocol Buffers' encoding (protobuf.dev/programming-guides/encoding), without its library.

A message has a `double` for each component, which keeps every bit of it, NaN included.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_VARINT, _DOUBLE, _BYTES = 0, 1, 2  # wire types
_OPTIONAL, _TYPE_DOUBLE = 1, 1  # label and type in google.protobuf.FieldDescriptorProto
_MESSAGE_TYPE, _FIELD = 4, 2  # numbers of fields in FileDescriptorProto and DescriptorProto
PACKAGE = "massprop"


def identifiers(names: Sequence[str]) -> list[str]:
    """Converts names to distinct field names of letters, digits and underscores."""
    used: list[str] = []
    for name in names:
        plain = re.sub(r"[^A-Za-z0-9_]", "_", name)
        plain = plain if re.match("[A-Za-z]", plain) else f"c{plain}"
        alike = 2
        unique = plain
        while unique in used:
            unique, alike = f"{plain}_{alike}", alike + 1
        used.append(unique)
    return used


def schema(message_name: str, comment: str, fields: Sequence[tuple[str, str]]) -> bytes:
    """Returns a google.protobuf.FileDescriptorSet, encoded, with one message of numbers in package `massprop`.

    Args:
        message_name: its name, an identifier.
        comment: what the message is.
        fields: name, an identifier, and comment, its unit, of each.
    """
    described = _text(1, message_name)
    for number, (name, _) in enumerate(fields, start=1):
        field = _text(1, name) + _number(3, number) + _number(4, _OPTIONAL) + _number(5, _TYPE_DOUBLE)
        described += _bytes(_FIELD, field + _text(10, name))
    places: list[tuple[tuple[int, ...], str]] = [((_MESSAGE_TYPE, 0), comment)]
    places += [((_MESSAGE_TYPE, 0, _FIELD, index), unit) for index, (_, unit) in enumerate(fields)]
    comments = b""
    for line, (path, text) in enumerate(places):
        span = bytes([line, 0, 1]) if line < 128 else _varint(line) + b"\0\1"
        location = _bytes(1, bytes(b for part in path for b in _varint(part))) + _bytes(2, span)
        comments += _bytes(1, location + _text(3, f" {text}\n"))
    file = _text(1, f"{PACKAGE}/{message_name}.proto") + _text(2, PACKAGE) + _bytes(_MESSAGE_TYPE, described)
    return _bytes(1, file + _bytes(9, comments) + _text(12, "proto3"))


def encode_rows(values: Array) -> list[bytes]:
    """Encodes each row of an array, shape (n, components), as a message, the first column in field 1."""
    tags = [_varint(number << 3 | _DOUBLE) for number in range(1, values.shape[1] + 1)]
    template = np.frombuffer(b"".join(tag + bytes(8) for tag in tags), dtype=np.uint8)
    table = np.tile(template, (values.shape[0], 1))
    parts = np.ascontiguousarray(values, dtype="<f8").view(np.uint8).reshape(*values.shape, 8)
    place = 0
    for column, tag in enumerate(tags):
        place += len(tag)
        table[:, place : place + 8] = parts[:, column]
        place += 8
    return [row.tobytes() for row in table]


def _varint(value: int) -> bytes:
    """Encodes a nonnegative integer as a varint: groups of seven bits, least significant first."""
    parts = []
    while value > 127:
        parts.append(value & 127 | 128)
        value >>= 7
    return bytes([*parts, value])


def _number(field: int, value: int) -> bytes:
    """Encodes an integer field."""
    return _varint(field << 3 | _VARINT) + _varint(value)


def _bytes(field: int, content: bytes) -> bytes:
    """Encodes a length-delimited field."""
    return _varint(field << 3 | _BYTES) + _varint(len(content)) + content


def _text(field: int, text: str) -> bytes:
    """Encodes a text field."""
    return _bytes(field, text.encode())
