"""Typed, validated data from YAML files: the base of vehicle, scenario and other file models.

A file is read with its line numbers, checked against a pydantic model, and every problem is reported
with file, line and dotted field. YAML is read by the 1.2 rules for scalars: 1e-6 is a number, `on` and
`yes` are words.
"""

from __future__ import annotations

import hashlib
import json
import types
import typing
import weakref
from collections.abc import Iterable
from functools import lru_cache
from typing import Annotated, Any, TypeVar

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError
from pydantic.fields import FieldInfo
from pydantic_core import InitErrorDetails, PydanticCustomError

from massprop_drake.errors import InputError, dotted, suggestion
from massprop_drake.inputs.yaml import Document, FieldPath, to_yaml

Real = Annotated[float, Field(strict=True, allow_inf_nan=False)]
Whole = Annotated[int, Field(strict=True)]
Flag = Annotated[bool, Field(strict=True)]
Text = Annotated[str, Field(strict=True)]
Count = Annotated[Whole, Field(ge=0, lt=2**63)]
NotNegative = Annotated[Real, Field(ge=0.0)]
Positive = Annotated[Real, Field(gt=0.0)]
Share = Annotated[Real, Field(ge=0.0, le=1.0)]
Probability = Annotated[Real, Field(gt=0.0, lt=1.0)]
RelativeSigma = Annotated[Real, Field(ge=0.0, le=0.3)]


def _require_plain_name(value: str) -> str:
    """Returns a name; raises ValueError for unprintable characters or blanks at its ends."""
    if not value.isprintable() or value != value.strip():
        raise ValueError(f"must be printable characters, with no blank at either end, got {value!r}")
    return value


Name = Annotated[str, Field(strict=True, max_length=100), AfterValidator(_require_plain_name)]
Vector3 = tuple[Real, Real, Real]
Matrix3 = tuple[Vector3, Vector3, Vector3]
NotNegative3 = tuple[NotNegative, NotNegative, NotNegative]


class Model(BaseModel):
    """The base of all file models: frozen, without unknown keys, NaN or infinity."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    def __eq__(self, other: object) -> bool:
        # by its fields alone: arrays derived from them may be cached beside, which pydantic's would compare
        if type(self) is not type(other):
            return False
        return all(getattr(self, name) == getattr(other, name) for name in type(self).model_fields)

    __hash__ = None  # type: ignore[assignment] # a vehicle holds mappings


M = TypeVar("M", bound=Model)

_LONGEST = 80  # of a value in a message, characters

_MOST_PROBLEMS = 100  # that are told of one file


class Span(typing.NamedTuple):
    """Range of sizes that a physical quantity can have, other than zero, and the reason for it.

    Attributes:
        least, most: of the absolute value, in SI units whatever the units of the file.
        why: the reason, as the end of a sentence.
    """

    least: float
    most: float
    why: str


def described(
    default: Any, meaning: str, unit: str = "-", *, reason: str = "", span: Span | None = None, **constraints: Any
) -> Any:
    """Declares a pydantic field with default, meaning, unit, span of plausible sizes, and constraints.

    Args:
        default: `...` makes the field required.
        meaning: for the documentation.
        unit: with the alternatives of the unit systems, SI last: "slug | kg".
        reason: why it is required.
        span: of each number in it; `plausible.out_of_span` compares.
        **constraints: pydantic's.
    """
    extra = {"unit": unit, "reason": reason, "span": span}
    return Field(default, description=meaning, json_schema_extra=extra, **constraints)  # type: ignore[arg-type]


def span_of(field: FieldInfo) -> tuple[Span | None, str]:
    """Returns the span of plausible sizes of a field, None where it has none, and the name of its SI unit."""
    extra = field.json_schema_extra
    if not isinstance(extra, dict):
        return None, "-"
    return extra.get("span"), str(extra["unit"]).rpartition("| ")[2]  # type: ignore[return-value]


# ------------------------------------------------------------------------------------- validating


def field_validation_error(problems: Iterable[tuple[FieldPath, str]]) -> ValidationError:
    """Makes the error that a validator raises from problems, pairs of the path of a field and a sentence."""
    details = [
        InitErrorDetails(
            type=PydanticCustomError("value_error", "{problem}", {"problem": problem}), loc=path, input=None
        )
        for path, problem in problems
    ]
    return ValidationError.from_exception_data("refused", details)


def validate_data(model: type[M], data: Any, document: Document | None = None, source: str = "") -> M:
    """Makes a model from data; raises InputError with one message per problem.

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
        raise InputError(*_describe_problems(model, data, error, document, source)) from None


def _describe_problems(
    model: type[Model], data: Any, error: ValidationError, document: Document | None, source: str
) -> list[str]:
    """Writes a message for each error of a validation: file, line, field and sentence; unknown keys first."""
    problems = []
    # unknown keys first: a misspelled one is often the cause of a missing one
    items = sorted(error.errors(include_url=False), key=lambda item: item["type"] != "extra_forbidden")
    items = _drop_echoes(items)
    for item in items[:_MOST_PROBLEMS]:
        path = _drop_union_tags(item["loc"], data)
        if document is not None:
            location = document.where(path)
        else:
            location = ": ".join(part for part in (source, dotted(path)) if part)
        problems.append(f"{location}: {_problem_sentence(model, data, item, path)}")
    more = len(items) - _MOST_PROBLEMS
    if more > 0:
        problems.append(f"{document.source if document else source}: {more} more like these")
    return list(dict.fromkeys(problems))


def _drop_echoes(items: list[Any]) -> list[Any]:
    """Returns pydantic's validation errors without those that only follow from another one.

    Pydantic also reports a list with a bad item as too short, and each value that a short list lacks as missing.
    """
    kept: list[Any] = []
    value_counts: dict[FieldPath, int] = {}
    parent_paths = {item["loc"][:length] for item in items for length in range(len(item["loc"]))}
    kept_paths: set[FieldPath] = set()
    for item in items:
        path = item["loc"]
        if item["type"] == "missing" and isinstance(path[-1], int):
            value_counts[path[:-1]] = max(value_counts.get(path[:-1], 0), path[-1] + 1)
            if path[:-1] not in kept_paths:
                kept.append({**item, "type": "too_few_values", "loc": path[:-1], "ctx": value_counts})
                kept_paths.add(path[:-1])
        elif not (item["type"] == "too_short" and path in parent_paths):
            kept.append(item)
            kept_paths.add(path)
    return kept


def _drop_union_tags(location: tuple[str | int, ...], data: Any) -> FieldPath:
    """Returns the path of a pydantic error without the names of union members, which are no keys of the file."""
    path: list[str | int] = []
    for part in location:
        is_index = isinstance(data, (list, tuple)) and isinstance(part, int) and part < len(data)
        if is_index or (isinstance(data, dict) and part in data):
            path.append(part)
            data = data[part]
        elif isinstance(data, dict) and part == location[-1] and part != data.get("kind"):
            path.append(part)
    return tuple(path)


def _shorten_value(value: Any) -> str:
    """Returns a value as text for a message, cut off after 80 characters."""
    text = repr(value)
    return text if len(text) <= _LONGEST else f"{text[:_LONGEST]}... ({len(str(value))} characters)"


def _problem_sentence(model: type[Model], data: Any, item: Any, path: FieldPath) -> str:
    """Writes the sentence of one of pydantic's errors, without file and field, in the file's terms."""
    kind, value = item["type"], item.get("input")
    if kind in ("missing", "too_short"):
        reason = _required_reason(model, path, data)
        if kind == "missing" or reason:
            return f"{'missing' if kind == 'missing' else 'is empty'}; this field is required{reason}"
    if kind == "extra_forbidden":
        return _explain_unknown_key(model, path, data, item["loc"])
    if kind == "too_few_values":
        return f"must have {item['ctx'][item['loc']]} values, got {len(_value_at(data, path))}"
    if kind in ("union_tag_not_found", "union_tag_invalid"):
        expected = item["ctx"].get("expected_tags", "'kind'")
        found = f"kind {item['ctx']['tag']!r} is not one of" if "tag" in item["ctx"] else "missing kind; one of"
        accepted = ", ".join(tag for member in _models_at(model, path, data) for tag in _tags_of(member))
        return f"{found} {accepted or expected}"
    message = item["msg"].removeprefix("Value error, ")
    if kind == "value_error":
        return message
    message = (message[0].lower() + message[1:]).replace("tuple", "list").replace("dictionary", "mapping")
    if kind == "literal_error":
        return f"{_shorten_value(value)} is not one of {item['ctx']['expected']}"
    if isinstance(value, (str, int, float, bool)) or value is None:
        return f"{message}, got {_shorten_value(value)}"
    if isinstance(value, (list, tuple)) and "length" in kind:
        return f"{message}, got {len(value)}"
    return message


def _explain_unknown_key(model: type[Model], path: FieldPath, data: Any, tags: tuple[str | int, ...]) -> str:
    """Writes the sentence of an unknown key: the other kind of block that has it, or a similar key."""
    members = _models_at(model, path[:-1], data)
    chosen = _choose_member(members, _value_at(data, path[:-1]), tags)
    for member in members:
        if path[-1] in member.model_fields:
            return f"is a key of kind: {_tags_of(member)[0]}, and the kind is {_tags_of(chosen)[0]}"
    return f"unknown key{suggestion(path[-1], list(chosen.model_fields))}"


def _required_reason(model: type[Model], path: FieldPath, data: Any) -> str:
    """Returns the reason why a field is required, as the end of a sentence; empty if none was given."""
    if not path or not isinstance(path[-1], str):
        return ""
    owner = _choose_member(_models_at(model, path[:-1], data), _value_at(data, path[:-1]))
    field = owner.model_fields.get(path[-1])
    extra = None if field is None else field.json_schema_extra
    reason = str(extra.get("reason", "")) if isinstance(extra, dict) else ""
    return f": {reason}" if reason else ""


def _value_at(data: Any, path: FieldPath) -> Any:
    """Returns the value at a path in nested data."""
    for part in path:
        data = data[part]
    return data


def _models_at(model: type[Model], path: FieldPath, data: Any) -> list[type[Model]]:
    """Returns the model classes that may describe the data at a path: more than one where there is a union."""
    models: list[type[Model]] = [model]
    for part in path:
        owner, data = _choose_member(models, data), data[part]
        if isinstance(part, str) and part in owner.model_fields:
            models = _models_in(owner.model_fields[part].annotation) or models
    return models


def _choose_member(members: list[type[Model]], data: Any, tags: tuple[str | int, ...] = ()) -> type[Model]:
    """Returns the model class of a union that the `kind` of the data selects, else the tags, else the first."""
    if len(members) > 1 and isinstance(data, dict):
        selected_tags = (data["kind"],) if "kind" in data else tags
        return next((member for member in members if any(tag in _tags_of(member) for tag in selected_tags)), members[0])
    return members[0]


_BOUNDS = {"gt": "> {:g}", "ge": ">= {:g}", "lt": "< {:g}", "le": "<= {:g}", "min_length": "at least {:g} long"}


def keys_of_former_kind(model: type[Model], data: Any, path: FieldPath, former_kind: Any) -> list[str]:
    """Lists keys of a block that its new kind lacks, or that mean something else there than in the former kind.

    Args:
        model: of the data.
        data: with the new kind in place.
        path: of the block.
        former_kind: kind that the block had; None: it was not written out.
    """
    block = _value_at(data, path)
    members = {tag: one for one in _models_at(model, path, data) if "kind" in one.model_fields for tag in _tags_of(one)}
    new, old = members.get(str(block["kind"])), members.get(str(former_kind))
    if new is None:
        return []
    known = [old] if old else members.values()
    return [
        key
        for key in block
        if key != "kind" and any(key in one.model_fields for one in known) and not (_means_same(key, new, old or new))
    ]


def _means_same(key: str, *models: type[Model]) -> bool:
    """Tests whether a key has the same meaning and default in all of several model classes."""
    fields = [model.model_fields.get(key) for model in models]
    meanings = {None if field is None else (field.description, repr(field.default)) for field in fields}
    return None not in meanings and len(meanings) == 1


def _bounds_text(field: FieldInfo) -> str:
    """Returns the bounds of a field's value as text, such as "> 0, <= 10 s"; "-" if it has none."""
    constraints = [*field.metadata]
    if typing.get_origin(field.annotation) in (typing.Union, types.UnionType):  # as of `Positive | None`
        parts = (part for member in typing.get_args(field.annotation) for part in getattr(member, "__metadata__", ()))
        constraints += (one for part in parts for one in getattr(part, "metadata", ()))
    bounds = [
        text.format(getattr(part, name))
        for part in constraints
        for name, text in _BOUNDS.items()
        if getattr(part, name, None) is not None
    ]
    span, unit = span_of(field)
    if span is not None:
        unit = "" if unit == "-" else f" {unit}"
        if "> 0" in bounds:
            bounds = [f"{span.least:g} to {span.most:g}{unit}" if span.least else f"> 0, <= {span.most:g}{unit}"]
        elif ">= 0" in bounds:
            bounds = [f"0, {span.least:g} to {span.most:g}{unit}" if span.least else f"0 to {span.most:g}{unit}"]
        else:
            bounds = [f"{-span.most:g} to {span.most:g}{unit}"]
    return ", ".join(bounds) or "-"


def _models_in(annotation: Any) -> list[type[Model]]:
    """Returns the model classes inside an annotation such as list[Model], Model | None or a union of models."""
    if isinstance(annotation, type) and issubclass(annotation, Model):
        return [annotation]
    return [found for argument in typing.get_args(annotation) for found in _models_in(argument)]


def _tags_of(model: type[Model]) -> tuple[str, ...]:
    """Returns the values of `kind` that select this model class in a union."""
    return tuple(map(str, typing.get_args(model.model_fields["kind"].annotation)))


# ---------------------------------------------------------------------------------------- writing


def yaml_text(model: Model) -> str:
    """Returns a model as YAML text with every default; reading it back gives an equal model."""
    return _yaml_of(json.dumps(model.model_dump(mode="json")))


@lru_cache(maxsize=8)  # a run's folder and its report hold the same text, a tenth of a second each
def _yaml_of(json_text: str) -> str:
    """Returns JSON text as YAML text."""
    return to_yaml(json.loads(json_text))


_digests: dict[int, tuple[weakref.ref[Model], str]] = {}  # of models that there are, which never change


def digest(model: Model) -> str:
    """Computes SHA-256 of a model's full content, hexadecimal; cached while the model exists."""
    key = id(model)
    cached = _digests.get(key)
    if cached is not None and cached[0]() is model:
        return cached[1]
    value = hashlib.sha256(model.model_dump_json().encode()).hexdigest()
    forget = _digests.pop  # the module's names may be gone when the last models go, at the end of the program
    _digests[key] = weakref.ref(model, lambda _: forget(key, None)), value
    return value


# ----------------------------------------------------------------------------------------- schema


class Key(typing.NamedTuple):
    """One key of a file, as `massprop check --schema` and the documentation show it."""

    name: str
    type: str
    unit: str
    default: str
    range: str
    meaning: str


def list_keys(model: type[Model], prefix: str = "") -> list[Key]:
    """Lists every key of a model class, and of models nested in it, in order, for documentation."""
    keys = []
    for name, field in model.model_fields.items():
        extra = field.json_schema_extra
        unit = str(extra.get("unit", "-")) if isinstance(extra, dict) else "-"
        if field.is_required():
            default = "required"
        else:
            value = field.get_default(call_default_factory=True)
            default = "see below" if isinstance(value, Model) else _format_default(value)
        full = f"{prefix}{name}"
        keys.append(
            Key(full, _type_name(field.annotation), unit, default, _bounds_text(field), field.description or "")
        )
        kind = _type_name(field.annotation)
        inside = "[]" if kind.startswith("list") else "{}" if kind.startswith("map of") else ""
        members = _models_in(field.annotation)
        for member in members:
            tag_text = ""
            if len(members) > 1:
                tag_text = f" ({', '.join(_tags_of(member))})"
                meaning = (member.__doc__ or "").strip().removesuffix(".")
                keys.append(Key(f"{full}{inside}{tag_text}", "mapping", "-", "-", "-", meaning))
            keys.extend(list_keys(member, f"{full}{inside}{tag_text}."))
    return keys


def _format_default(value: Any) -> str:
    """Formats a field's default for the documentation of keys."""
    return "(empty)" if value == "" else json.dumps(value).replace('"', "")


def _type_name(annotation: Any) -> str:
    """Names the type of a field for documentation, such as "number" or "list of text"."""
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
        if "|" in inner:
            return f"{len(arguments)} of {inner}"
        return f"{len(arguments)} {inner}s"
    if origin is dict:
        return f"map of {_type_name(arguments[1])}"
    names = {float: "number", int: "integer", bool: "true | false", str: "text", Any: "anything"}
    return names.get(annotation, "mapping")
