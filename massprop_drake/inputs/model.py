"""Typed, validated data from YAML files: what vehicle, scenario and other files have in common.

A file is read with its line numbers, checked against a pydantic model, and every problem is reported
with file, line and dotted field. YAML is read by the 1.2 rules for scalars: 1e-6 is a number, `on` and
`yes` are words.
"""

from __future__ import annotations

import hashlib
import re
import types
import typing
from pathlib import Path
from typing import Annotated, Any, TypeVar

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError
from pydantic.fields import FieldInfo

from massprop_drake.errors import InputError, suggestion

Real = Annotated[float, Field(strict=True, allow_inf_nan=False)]
Whole = Annotated[int, Field(strict=True)]
Flag = Annotated[bool, Field(strict=True)]
Text = Annotated[str, Field(strict=True)]
Vector3 = tuple[Real, Real, Real]
Matrix3 = tuple[Vector3, Vector3, Vector3]


class Model(BaseModel):
    """Base of all file models: frozen, no unknown keys, no NaN or infinity."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    def __eq__(self, other: object) -> bool:
        # by its fields alone: arrays derived from them may be cached beside
        if type(self) is not type(other):
            return False
        return all(getattr(self, name) == getattr(other, name) for name in type(self).model_fields)

    __hash__ = None  # type: ignore[assignment] # a vehicle holds mappings


M = TypeVar("M", bound=Model)


def described(default: Any, meaning: str, unit: str = "-", *, reason: str = "", **constraints: Any) -> Any:
    """A field with its default, meaning and unit; `...` as default makes it required, for a reason if given."""
    return Field(default, description=meaning, json_schema_extra={"unit": unit, "reason": reason}, **constraints)


# ---------------------------------------------------------------------------------------- reading


class _Loader(yaml.SafeLoader):
    """Safe YAML with the scalars of YAML 1.2 and without aliases, which can make small files endless."""

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        """A node; refuses an alias."""
        if self.check_event(yaml.events.AliasEvent):
            event = self.peek_event()  # type: ignore[no-untyped-call]
            raise yaml.composer.ComposerError(
                None, None, f"alias *{event.anchor} is not supported; write the value out", event.start_mark
            )
        return super().compose_node(parent, index)


_Loader.yaml_implicit_resolvers = {
    first: [(tag, pattern) for tag, pattern in resolvers if not tag.endswith((":bool", ":float", ":int", ":timestamp"))]
    for first, resolvers in yaml.SafeLoader.yaml_implicit_resolvers.items()
}
_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:bool", re.compile(r"^(?:true|True|TRUE|false|False|FALSE)$"), list("tTfF")
)
_Loader.add_implicit_resolver("tag:yaml.org,2002:int", re.compile(r"^[-+]?[0-9]+$"), list("-+0123456789"))
_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float",
    re.compile(
        r"^(?:[-+]?(?:\.[0-9]+|[0-9]+(?:\.[0-9]*)?)(?:[eE][-+]?[0-9]+)?|[-+]?\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN))$"
    ),
    list("-+0123456789."),
)


def _int(_: yaml.SafeLoader, node: Any) -> int:
    return int(node.value)  # decimal: 007 is 7


def _float(_: yaml.SafeLoader, node: Any) -> float:
    return float(node.value.lower().replace(".inf", "inf").replace(".nan", "nan"))


_Loader.add_constructor("tag:yaml.org,2002:int", _int)
_Loader.add_constructor("tag:yaml.org,2002:float", _float)

Path_ = tuple[str | int, ...]


class Document:
    """A YAML document: its data, and the line of each part.

    Args:
        text: the YAML text.
        source: what to call it in messages, a file's path as the user gave it.

    Raises:
        InputError: when the text is not YAML, is empty, is no mapping, or has a key twice.
    """

    def __init__(self, text: str, source: str):
        self.source = source
        self._lines: dict[Path_, int] = {}
        try:
            loader = _Loader(text)
            node = loader.get_single_node()
        except yaml.YAMLError as error:
            raise InputError(f"{source}: not valid YAML: {_yaml_problem(error)}") from None
        except RecursionError:
            raise InputError(f"{source}: nested too deeply; no file of ours needs more than a few levels") from None
        if not isinstance(node, yaml.MappingNode):
            what = "is empty" if node is None else "is no mapping"
            raise InputError(f"{source}: the document {what}; expected keys with values, such as 'name: ...'")
        self._walk(node, ())
        try:
            self.data: dict[str, Any] = loader.construct_document(node)
        except (yaml.YAMLError, ValueError) as error:
            raise InputError(f"{source}: not valid YAML: {_yaml_problem(error)}") from None

    def _walk(self, node: yaml.Node, path: Path_) -> None:
        self._lines[path] = node.start_mark.line + 1
        if isinstance(node, yaml.MappingNode):
            seen: dict[str, int] = {}
            for key, value in node.value:
                line = key.start_mark.line + 1
                if not isinstance(key, yaml.ScalarNode):
                    raise InputError(f"{self.source}, line {line}: a key must be a plain word")
                if key.value in seen:
                    raise InputError(
                        f"{self.source}, line {line}: {dotted((*path, key.value))}: the key appears twice, "
                        f"first in line {seen[key.value]}; keep one of them"
                    )
                seen[key.value] = line
                self._walk(value, (*path, key.value))
                self._lines[(*path, key.value)] = line
        elif isinstance(node, yaml.SequenceNode):
            for index, value in enumerate(node.value):
                self._walk(value, (*path, index))

    def where(self, path: Path_) -> str:
        """File, line where it is known, and dotted field: the beginning of a message."""
        for length in range(len(path), 0, -1):
            if path[:length] in self._lines:
                return f"{self.source}, line {self._lines[path[:length]]}: {dotted(path)}"
        return f"{self.source}: {dotted(path)}" if path else self.source


def _yaml_problem(error: Exception) -> str:
    mark = getattr(error, "problem_mark", None)
    problem = getattr(error, "problem", None) or str(error).splitlines()[0]
    return problem if mark is None else f"{problem} (line {mark.line + 1}, column {mark.column + 1})"


def dotted(path: Path_) -> str:
    """A path as people write it: jets[3].direction."""
    text = ""
    for part in path:
        text += f"[{part}]" if isinstance(part, int) else (f".{part}" if text else str(part))
    return text


def exists(path: Path) -> bool:
    """Whether there is such a file or folder; no for a name that none can have."""
    try:
        return path.exists()
    except OSError:
        return False


def read_text(path: Path) -> str:
    """A text file's content.

    Raises:
        InputError: when it is missing, unreadable or not UTF-8.
    """
    try:
        return path.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise InputError(f"{path}: no such file") from None
    except UnicodeDecodeError:
        raise InputError(f"{path}: not a text file in UTF-8") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None


def validated(model: type[M], data: Any, document: Document | None = None, source: str = "") -> M:
    """A model made of data, or one message per problem.

    Args:
        model: the pydantic model.
        data: a mapping, from a file or a program.
        document: where the data came from, for lines; without it ``source`` names it.
        source: what to call the data in messages.

    Raises:
        InputError: naming each field that is wrong.
    """
    try:
        return model.model_validate(data)
    except ValidationError as error:
        raise InputError(*_problems(model, data, error, document, source)) from None


def _problems(
    model: type[Model], data: Any, error: ValidationError, document: Document | None, source: str
) -> list[str]:
    problems = []
    # unknown keys first: a misspelled one is often the cause of a missing one
    items = sorted(error.errors(include_url=False), key=lambda item: item["type"] != "extra_forbidden")
    for item in _without_echoes(items):
        path = _without_union_tags(item["loc"], data)
        if document is not None:
            where = document.where(path)
        else:
            where = ": ".join(part for part in (source, dotted(path)) if part)
        problems.append(f"{where}: {_sentence(model, data, item, path)}")
    return list(dict.fromkeys(problems))


def _without_echoes(items: list[Any]) -> list[Any]:
    """The errors less those that another one brings along.

    A list with a bad item counts as too short besides, and each value that a short list lacks is missing.
    """
    kept: list[Any] = []
    lacking: dict[Path_, int] = {}
    for item in items:
        place = item["loc"]
        if item["type"] == "missing" and isinstance(place[-1], int):
            lacking[place[:-1]] = max(lacking.get(place[:-1], 0), place[-1] + 1)
            if place[:-1] in [other["loc"] for other in kept]:
                continue
            kept.append({**item, "type": "too_few_values", "loc": place[:-1], "ctx": lacking})
            continue
        inside = [other for other in items if len(other["loc"]) > len(place) and other["loc"][: len(place)] == place]
        if not (item["type"] == "too_short" and inside):
            kept.append(item)
    return kept


def _without_union_tags(location: tuple[str | int, ...], data: Any) -> Path_:
    """Pydantic names the member of a union in its path; the file has no such key."""
    path: list[str | int] = []
    for part in location:
        within = isinstance(data, (list, tuple)) and isinstance(part, int) and part < len(data)
        if within or (isinstance(data, dict) and part in data):
            path.append(part)
            data = data[part]
        elif isinstance(data, dict) and part == location[-1] and part != data.get("kind"):
            path.append(part)
    return tuple(path)


def _sentence(model: type[Model], data: Any, item: Any, path: Path_) -> str:
    kind, given = item["type"], item.get("input")
    if kind in ("missing", "too_short"):
        reason = _reason(model, path, data)
        if kind == "missing" or reason:
            return f"{'missing' if kind == 'missing' else 'is empty'}; this field is required{reason}"
    if kind == "extra_forbidden":
        return f"unknown key{suggestion(path[-1], list(_model_at(model, path[:-1], data).model_fields))}"
    if kind == "too_few_values":
        return f"must have {item['ctx'][item['loc']]} values, got {len(_at(data, path))}"
    if kind in ("union_tag_not_found", "union_tag_invalid"):
        expected = item["ctx"].get("expected_tags", "'kind'")
        found = f"kind {item['ctx']['tag']!r} is not one of" if "tag" in item["ctx"] else "missing kind; one of"
        return f"{found} {_tags_at(model, path, data) or expected}"
    message = item["msg"].removeprefix("Value error, ")
    if kind == "value_error":
        return message
    message = (message[0].lower() + message[1:]).replace("tuple", "list").replace("dictionary", "mapping")
    if kind == "literal_error":
        return f"{given!r} is not one of {item['ctx']['expected']}"
    if isinstance(given, (str, int, float, bool)) or given is None:
        return f"{message}, got {given!r}"
    if isinstance(given, (list, tuple)) and "length" in kind:
        return f"{message}, got {len(given)}"
    return message


def _reason(model: type[Model], path: Path_, data: Any) -> str:
    """Why a field is required, as the end of a sentence; empty where it goes without saying."""
    if not path or not isinstance(path[-1], str):
        return ""
    field = _model_at(model, path[:-1], data).model_fields.get(path[-1])
    extra = None if field is None else field.json_schema_extra
    reason = str(extra.get("reason", "")) if isinstance(extra, dict) else ""
    return f": {reason}" if reason else ""


def _at(data: Any, path: Path_) -> Any:
    for part in path:
        data = data[part]
    return data


def _model_at(model: type[Model], path: Path_, data: Any) -> type[Model]:
    """The model at a path of some data."""
    here: list[type[Model]] = [model]
    for part in path:
        data = data[part]
        if isinstance(part, str) and part in here[0].model_fields:
            here = _models_in(here[0].model_fields[part].annotation) or here
        if len(here) > 1 and isinstance(data, dict):  # a union: the member that the data name
            here = [member for member in here if _tag_of(member) == data.get("kind")] or here
    return here[0]


def _tags_at(model: type[Model], path: Path_, data: Any) -> str:
    """Kinds that the union at a path of some data knows."""
    names = [part for part in path if isinstance(part, str)]
    holder = _model_at(model, path[: path.index(names[-1])], data)
    members = _models_in(holder.model_fields[names[-1]].annotation)
    return ", ".join(_tag_of(member) for member in members)


_BOUNDS = {"gt": "> {:g}", "ge": ">= {:g}", "lt": "< {:g}", "le": "<= {:g}", "min_length": "at least {:g} long"}


def _range(field: FieldInfo) -> str:
    """The bounds of a field's value, as text; "-" without any."""
    bounds = [
        text.format(getattr(part, name))
        for part in field.metadata
        for name, text in _BOUNDS.items()
        if getattr(part, name, None) is not None
    ]
    return ", ".join(bounds) or "-"


def _models_in(annotation: Any) -> list[type[Model]]:
    """The models that an annotation such as list[Model], Model | None or a union of models holds."""
    if isinstance(annotation, type) and issubclass(annotation, Model):
        return [annotation]
    return [found for argument in typing.get_args(annotation) for found in _models_in(argument)]


def _tag_of(model: type[Model]) -> str:
    """The value of `kind` that picks a member of a union."""
    return str(typing.get_args(model.model_fields["kind"].annotation)[0])


# ---------------------------------------------------------------------------------------- writing


class _Dumper(yaml.SafeDumper):
    """Short lists of numbers on one line; floats that read back exactly."""


def _represent_float(dumper: yaml.SafeDumper, value: float) -> yaml.Node:
    return dumper.represent_scalar("tag:yaml.org,2002:float", repr(value))


def _represent_list(dumper: yaml.SafeDumper, value: list[Any]) -> yaml.Node:
    flat = all(not isinstance(item, (list, dict)) for item in value)
    return dumper.represent_sequence("tag:yaml.org,2002:seq", value, flow_style=flat)


_Dumper.add_representer(float, _represent_float)
_Dumper.add_representer(list, _represent_list)


def yaml_text(model: Model) -> str:
    """A model as YAML in full, every default written out; reading it gives an equal model."""
    return yaml.dump(model.model_dump(mode="json"), Dumper=_Dumper, sort_keys=False, width=110, allow_unicode=True)


def digest(model: Model) -> str:
    """SHA-256 of a model's full content, hexadecimal."""
    return hashlib.sha256(yaml_text(model).encode()).hexdigest()


# ----------------------------------------------------------------------------------------- schema


class Key(typing.NamedTuple):
    """One key of a file: for `massprop check --schema` and the documentation."""

    name: str
    type: str
    unit: str
    default: str
    range: str
    meaning: str


def keys(model: type[Model], prefix: str = "") -> list[Key]:
    """Every key of a model and of the models in it, in order."""
    found = []
    for name, field in model.model_fields.items():
        extra = field.json_schema_extra
        unit = str(extra.get("unit", "-")) if isinstance(extra, dict) else "-"
        if field.is_required():
            default = "required"
        else:
            value = field.get_default(call_default_factory=True)
            default = "see below" if isinstance(value, Model) else _plain(value)
        full = f"{prefix}{name}"
        found.append(Key(full, _type_name(field.annotation), unit, default, _range(field), field.description or ""))
        kind = _type_name(field.annotation)
        inside = "[]" if kind.startswith("list") else "{}" if kind.startswith("map of") else ""
        members = _models_in(field.annotation)
        for member in members:
            which = ""
            if len(members) > 1:
                which = f" ({_tag_of(member)})"
                meaning = (member.__doc__ or "").strip().removesuffix(".")
                found.append(Key(f"{full}{inside}{which}", "mapping", "-", "-", "-", meaning))
            found.extend(keys(member, f"{full}{inside}{which}."))
    return found


def _plain(value: Any) -> str:
    if value is None:
        return "null"
    if value == "":
        return "(empty)"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(_plain(item) for item in value) + "]"
    if isinstance(value, dict):
        return "{}"
    return str(value)


def _type_name(annotation: Any) -> str:
    if annotation is None or annotation is type(None):
        return "null"
    if hasattr(annotation, "__metadata__"):
        return _type_name(typing.get_args(annotation)[0])
    origin, arguments = typing.get_origin(annotation), typing.get_args(annotation)
    if origin is typing.Literal:
        return " | ".join(str(argument) for argument in arguments)
    if origin in (typing.Union, types.UnionType):
        return " | ".join(dict.fromkeys(_type_name(argument) for argument in arguments))
    if origin is list:
        return f"list of {_type_name(arguments[0])}"
    if origin is tuple:
        inner = _type_name(arguments[0])
        if Ellipsis in arguments:
            return f"list of {inner}"
        if inner.endswith(" numbers"):
            return f"{len(arguments)} x {inner}"
        return f"{len(arguments)} {inner}s"
    if origin is dict:
        return f"map of {_type_name(arguments[1])}"
    names = {float: "number", int: "integer", bool: "true | false", str: "text"}
    return names.get(annotation, "mapping")
