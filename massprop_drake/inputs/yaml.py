"""YAML text to data with the line of every field, and data to YAML text.

Reading follows the scalars of YAML 1.2: 1e-6 is a number, `on` and `yes` are words. What is written means the same by
YAML 1.1 and 1.2, and its floats read back exactly.
"""

from __future__ import annotations

import contextlib
import io
import re
import sys
from collections.abc import Iterator
from contextvars import ContextVar
from copy import copy, deepcopy
from functools import lru_cache
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.composer import Composer, ComposerError, MaxDepthExceededError
from ruamel.yaml.emitter import Emitter
from ruamel.yaml.error import YAMLError
from ruamel.yaml.events import AliasEvent, ScalarEvent, SequenceStartEvent
from ruamel.yaml.nodes import MappingNode, Node, ScalarNode, SequenceNode
from ruamel.yaml.representer import SafeRepresenter
from ruamel.yaml.resolver import VersionedResolver
from ruamel.yaml.tag import Tag

from massprop_drake.errors import InputError, dotted
from massprop_drake.inputs import renamed
from massprop_drake.inputs.kinds import (
    Kind,
    bundled_files,
    bundled_text,
    describe_folder,
    require_kind,
    require_known_name,
)

FieldPath = tuple[str | int, ...]

_DEEPEST = 50  # levels of nesting
_LONGEST = 1_000_000  # characters; a vehicle of 500 jets has some 100 000

# ---------------------------------------------------------------------------------------- reading


class _Resolver(VersionedResolver):
    """Resolver of numbers, booleans and null; a group of the pattern is named after the type it means."""

    plain = re.compile(
        r"""(?P<null> ~ | null | Null | NULL | )
        | (?P<bool> true | True | TRUE | false | False | FALSE)
        | (?P<int> [-+]?[0-9]+)
        | (?P<float> [-+]? (\.[0-9]+ | [0-9]+(\.[0-9]*)?) ([eE][-+]?[0-9]+)? | [-+]?\.(inf|Inf|INF) | \.(nan|NaN|NAN))
        """,
        re.VERBOSE,
    )

    def resolve(self, kind: Any, value: Any, implicit: Any) -> Any:
        """Returns the YAML tag of a node, by its value where it has no tag of its own: text, number or the like."""
        if kind is not ScalarNode or not implicit[0]:
            return super().resolve(kind, value, implicit)
        match = self.plain.fullmatch(value)
        return self.DEFAULT_SCALAR_TAG if match is None else Tag(suffix=f"tag:yaml.org,2002:{match.lastgroup}")


class _Composer(Composer):
    """Composer that refuses aliases, which can make small files endless, and tags that do not fit their values."""

    def compose_node(self, parent: Any, index: Any) -> Any:
        """Composes a node with all nodes in it; raises ComposerError for an alias or a tag that misfits its value."""
        if self.parser.check_event(AliasEvent):
            event = self.parser.peek_event()
            raise ComposerError(
                None, None, f"alias *{event.anchor} is not supported; write the value out", event.start_mark
            )
        event = self.parser.peek_event()
        if event.tag is not None and not _tag_fits(event):
            raise ComposerError(
                None, None, f"tag {event.tag} says what the value is not; write the value alone", event.start_mark
            )
        return super().compose_node(parent, index)


def _tag_fits(event: Any) -> bool:
    """Tests whether a YAML tag agrees with its value's own type, or marks a scalar as text."""
    if isinstance(event, ScalarEvent):
        match = _Resolver.plain.fullmatch(event.value)
        kinds = {"str"} if match is None else {"str", match.lastgroup}
        kinds |= {"float"} if "int" in kinds else set()
    else:
        kinds = {"seq" if isinstance(event, SequenceStartEvent) else "map"}
    return str(event.tag) in {f"tag:yaml.org,2002:{kind}" for kind in kinds}


class Document:
    """YAML document: its data, and the line of each part.

    Args:
        text: the YAML text.
        source: what to call it in messages, a file's path as the user gave it.
        within: the place in a vehicle or scenario that the value of its one key is meant for, if it is not all of it.

    Keys of version 0.1 get their present names, with one warning.

    Attributes:
        source, data: see above.
        overridden: fields that `--set` has put into the data.

    Raises:
        InputError: when the text is not YAML, is empty, is no mapping, or has a key twice.
    """

    def __init__(self, text: str, source: str, parent_path: FieldPath = ()):
        self.source = source
        self.overridden = set[FieldPath]()
        self._above: FieldPath = ()
        try:
            data, self._lines, old = _read(text, parent_path)
        except InputError as error:
            raise InputError(f"{source}{error}") from None
        if old:
            renamed.warn(f"{source}: {', '.join(f'{key} is now {new}' for key, new in old.items())}", 3)
        self.data: dict[str, Any] = deepcopy(data)

    def move(self, old: FieldPath, new: FieldPath) -> None:
        """Moves the line number of a field to another path, to which its value has been moved."""
        if old in self._lines:
            self._lines = {**self._lines, new: self._lines[old]}

    def under(self, path: FieldPath) -> Document:
        """Returns a copy of the document whose paths are relative to a block of it."""
        part = copy(self)
        part._above = (*self._above, *path)
        return part

    def where(self, path: FieldPath) -> str:
        """Returns the beginning of a message: file, line where it is known, and dotted field, or the key of `--set`."""
        path = (*self._above, *path)
        known = next((length for length in range(len(path), 0, -1) if path[:length] in self._lines), 0)
        for key in sorted(self.overridden, key=lambda path_: (-len(path_), str(path_))):
            is_new_block = known < len(path) and path[: known + 1] == key[: known + 1]  # a block that the file lacks
            is_above = bool(path) and key[: len(path)] == path  # what the file says there is no longer what holds
            if path[: len(key)] == key or is_new_block or is_above:
                return f"--set {dotted(key)}" + ("" if path == key else f": {dotted(path)}")
        if known:
            return f"{self.source}, line {self._lines[path[:known]]}: {dotted(path)}"
        return f"{self.source}: {dotted(path)}" if path else self.source


@lru_cache(maxsize=128)  # composing takes ten times as long as all else, and a vehicle is read with every scenario
def _read(text: str, parent_path: FieldPath) -> tuple[dict[str, Any], dict[FieldPath, int], dict[str, str]]:
    """Parses YAML text into data, line of each field, and new names of old keys; errors lack the file's name."""
    if len(text) > _LONGEST:
        raise InputError(f": has {len(text)} characters; no vehicle or scenario needs more than {_LONGEST}")
    reader = YAML(typ="safe", pure=True)
    reader.Resolver, reader.Composer = _Resolver, _Composer
    reader.max_depth = _DEEPEST
    try:
        node = reader.compose(text)
    except MaxDepthExceededError:
        raise InputError(": nested too deeply; no file of ours needs more than a few levels") from None
    except YAMLError as error:
        raise InputError(f": not valid YAML: {_error_text(error)}") from None
    if not isinstance(node, MappingNode):
        reason = "is empty" if node is None else "is no mapping"
        raise InputError(f": the document {reason}; expected keys with values, such as 'name: ...'")
    walk = _Walk(parent_path)
    walk.visit(node, ())
    try:
        return reader.constructor.construct_document(node), walk.lines, walk.renamed
    except (YAMLError, ValueError) as error:
        raise InputError(f": not valid YAML: {_error_text(error)}") from None


class _Walk:
    """Walk that notes the line of each part of a document, renames old keys and refuses a key that comes twice."""

    def __init__(self, parent_path: FieldPath):
        self._within = parent_path
        self.lines: dict[FieldPath, int] = {}
        self.renamed: dict[str, str] = {}

    def visit(self, node: Node, path: FieldPath) -> None:
        """Notes the line of every field in a node by its path, renames old keys and refuses repeated ones."""
        self.lines.setdefault(path, node.start_mark.line + 1)
        if isinstance(node, MappingNode):
            for key, value in node.value:
                line = key.start_mark.line + 1
                if not isinstance(key, ScalarNode):
                    raise InputError(f", line {line}: a key must be a plain word")
                full_path = (*self._within, *path[1:]) if self._within else path
                present_name = renamed.present_key_name((*full_path, key.value))
                if present_name is not None:
                    self.renamed[key.value], key.value = present_name, present_name
                field = (*path, key.value)
                if field in self.lines:
                    raise InputError(
                        f", line {line}: {dotted(field)}: the key appears twice, "
                        f"first in line {self.lines[field]}; keep one of them"
                    )
                self.lines[field] = line
                self.visit(value, field)
        elif isinstance(node, SequenceNode):
            for index, value in enumerate(node.value):
                self.visit(value, (*path, index))


def _error_text(error: Exception) -> str:
    """Returns the problem of a YAML error as text, with line and column where they are known."""
    mark = getattr(error, "problem_mark", None)
    problem = getattr(error, "problem", None) or str(error).splitlines()[0]
    return problem if mark is None else f"{problem} (line {mark.line + 1}, column {mark.column + 1})"


def exists(path: Path) -> bool:
    """Tests like `path.exists()`, but returns False in place of an error for a name that no file can have."""
    try:
        return path.exists()
    except (OSError, ValueError):
        return False


_noted: ContextVar[list[Path] | None] = ContextVar("noted", default=None)


@contextlib.contextmanager
def collect_files_read() -> Iterator[list[Path]]:
    """Yields a list to which `read_text` adds the path of every file read within the context."""
    paths: list[Path] = []
    token = _noted.set(paths)
    try:
        yield paths
    finally:
        _noted.reset(token)


def read_text(path: Path) -> str:
    """Returns the text of a file in UTF-8.

    Raises:
        InputError: when it is missing, unreadable or not UTF-8.
    """
    if (noted := _noted.get()) is not None:
        noted.append(path)
    try:
        return path.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise InputError(f"{path}: no such file") from None
    except IsADirectoryError:
        folder_text = describe_folder(path) or "is a folder, and no run's, which has a scenario.yaml; name a file"
        raise InputError(f"{path}: {folder_text}") from None
    except UnicodeDecodeError:
        raise InputError(f"{path}: not a text file in UTF-8") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None
    except ValueError:  # such as a NUL
        raise InputError(f"{str(path)!r}: no file can have this name") from None


def open_document(name_or_path: str | Path, kind: Kind) -> tuple[Document, Path]:
    """Opens a bundled file by name, or a file by path; returns its document and the folder of paths in it.

    Args:
        name_or_path: name or path, of a scenario also that of a run's folder.
        kind: of the file.

    Raises:
        InputError: when there is none of that name, or it is of another kind.
    """
    name = str(name_or_path)
    if name in bundled_files(kind):
        return Document(bundled_text(kind, name), f"{kind} '{name}'"), Path()
    path = Path(name_or_path)
    if kind == "scenario" and exists(path / "scenario.yaml"):
        path = path / "scenario.yaml"
    if not exists(path):
        require_known_name(name, kind)
    document = Document(read_text(path), str(path))
    require_kind(document.data, kind, str(path))
    return document, path.parent


# ---------------------------------------------------------------------------------------- writing


class _WrittenResolver(_Resolver):
    """Resolver of words that some YAML reader, of 1.1 or 1.2, takes for another type, so that they are quoted."""

    plain = re.compile(
        r"""(?P<null> ~ | null | Null | NULL | )
        | (?P<bool> (?i: yes | no | true | false | on | off))
        | (?P<float> [-+]?[0-9][0-9_]*\.[0-9_]*([eE][-+][0-9]+)? | \.[0-9][0-9_]*([eE][-+][0-9]+)?
            | [-+]?[0-9][0-9_]*(:[0-5]?[0-9])+\.[0-9_]* | [-+]?\.(inf|Inf|INF) | \.(nan|NaN|NAN))
        | (?P<int> [-+]?(0b[01_]+ | 0[0-7_]+ | 0 | [1-9][0-9_]*(:[0-5]?[0-9])* | 0x[0-9a-fA-F_]+))
        | (?P<timestamp> [0-9]{4}-[0-9]{2}-[0-9]{2})
        | (?P<merge> <<) | (?P<value> =)
        """,
        re.VERBOSE,
    )


class _Emitter(Emitter):
    """Emitter that breaks a long text after the word that passes the width, with no space left at the line's end."""

    def write_plain(self, text: str, split: bool = True) -> None:
        """Writes a text without quotes, breaking lines after the word that passes the width."""
        width, self.best_width = self.best_width, sys.maxsize
        for word in re.split(r"(?<! ) (?! )", text):
            if split and self.column > width:
                self.write_indent()
            super().write_plain(word, split=False)
        self.best_width = width


class _Representer(SafeRepresenter):
    """Representer of short lists on one line, texts of several lines as such, and floats that read back exactly."""


_Representer.add_representer(
    float,
    lambda representer, value: representer.represent_scalar(
        "tag:yaml.org,2002:float", repr(value).replace("inf", ".inf").replace("nan", ".nan")
    ),
)
_Representer.add_representer(
    str,
    lambda representer, value: representer.represent_scalar(
        "tag:yaml.org,2002:str", value, style="|" if "\n" in value.strip("\n") else None
    ),
)
_Representer.add_representer(
    list,
    lambda representer, value: representer.represent_sequence(
        "tag:yaml.org,2002:seq", value, flow_style=not any(isinstance(item, (list, dict)) for item in value)
    ),
)


def to_yaml(data: dict[str, Any]) -> str:
    """Writes mappings, lists, text, numbers, booleans and None as YAML text; reading it gives equal data."""
    writer = YAML(typ="safe", pure=True)
    writer.Resolver, writer.Representer, writer.Emitter = _WrittenResolver, _Representer, _Emitter
    writer.default_flow_style = False
    writer.sort_base_mapping_type_on_output = False  # type: ignore[assignment] # declared as None
    writer.width = 110
    stream = io.StringIO()
    writer.dump(data, stream)
    return stream.getvalue()
