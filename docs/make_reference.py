"""Writes the tables of keys and of ports' elements, and the defaults in all pages.

The keys stand in vehicle.md, scenario.md, campaign.md and records.md, the elements in reference/ports.md.

The text above the tables is kept, but for the defaults: what follows `<!-- default mass.jump -->` in a page, between
backquotes, is the default of that key.

python docs/make_reference.py
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

from massprop_drake.inputs.campaign_file import campaign_keys
from massprop_drake.inputs.model import Key, list_keys
from massprop_drake.inputs.record_map import map_keys
from massprop_drake.inputs.scenario import Scenario
from massprop_drake.inputs.vehicle_file import Vehicle
from massprop_drake.systems.views import JETS, PORTS, elements

DOCS = Path(__file__).parent
KEYS: dict[str, Callable[[], list[Key]]] = {
    "vehicle.md": partial(list_keys, Vehicle),
    "scenario.md": partial(list_keys, Scenario),
    "campaign.md": campaign_keys,
    "records.md": map_keys,
}
MARK = "<!-- docs/make_reference.py writes what follows from the code: edit the descriptions there -->"
HEADINGS = ("key", "value, default", "meaning")
ELSEWHERE = {"scenario.md": ("vehicle.", "moving[]")}  # beginnings of keys that the page on vehicles has
_MAPPINGS = ("mapping", "mapping | null", "list of mapping", "map of mapping")
_KIND = re.compile(r" \(([^).]*)\)")  # of a mapping that has several; with a dot it is the key of something else
_TOLD = re.compile(r"<!-- default ([^>]+) -->`[^`\n]*`")
_MOST = 8  # elements of a field that are all shown
_VAST, _TINY = 500.0, 1e-4  # bounds of a range beyond which it only keeps slips out
_LONG = 12  # characters of a number beyond which its page shows six digits


def updated(text: str, tables: str) -> str:
    """A page's text with its tables made anew.

    Args:
        text: of the page; what stands before `MARK` is kept.
        tables: in Markdown.

    Raises:
        ValueError: when the page has no `MARK`.
    """
    introduction, mark, _ = text.partition(MARK)
    if not mark:
        raise ValueError(f"the page has no line '{MARK}' to write below")
    return f"{introduction}{MARK}\n\n{tables}"


class Row(NamedTuple):
    """One row of a table: a key, and the mappings in which it stands with the same meaning."""

    key: Key
    parents: tuple[str, ...]


def reference(found: Sequence[Key], elsewhere: tuple[str, ...] = ()) -> str:
    """A table of keys for the file itself, then one for each mapping in it, in Markdown.

    Kinds of a mapping share a table, and so do mappings with the same keys. Two keys or more that stand in an earlier
    table with the same words are named alone.

    Args:
        found: all keys of the file.
        elsewhere: beginnings of keys that another page has.
    """
    shown = [key for key in found if not any(key.name != one and key.name.startswith(one) for one in elsewhere)]
    by_name = {key.name: key for key in shown}
    blocks: dict[str, list[str]] = {}
    for parent in dict.fromkeys(_parent(key.name) for key in shown):
        blocks.setdefault(_KIND.sub("", parent), []).append(parent)
    alike: dict[tuple[Row | Key, ...], list[list[str]]] = {}
    for parents in blocks.values():
        rows = _rows([key for key in shown if _parent(key.name) in parents], parents, by_name, set(blocks))
        same = tuple(row.key if row.parents == tuple(parents) else row for row in rows)
        alike.setdefault(same or (Key(parents[0], "", "", "", "", ""),), []).append(parents)
    seen: dict[Key, str] = {}
    parts = [_block(same, members, by_name, seen) for same, members in alike.items()]
    return "\n\n".join(filter(None, parts)) + "\n"


def _parent(name: str) -> str:
    """The mapping that a key stands in; what is in parentheses may have dots of its own."""
    head, _, inside = name.partition(" (")
    return head if inside.endswith(")") and "." in inside else name.rpartition(".")[0]


def _bare(parent: str) -> str:
    """The key of a mapping, or of a list or map of them."""
    return parent.removesuffix("[]").removesuffix("{}")


def _rows(members: list[Key], parents: list[str], by_name: Mapping[str, Key], blocks: set[str]) -> list[Row]:
    """Rows of the keys in all kinds of a mapping; its kind comes first, and what has a table of its own is left out."""
    where: dict[Key, list[str]] = {}
    for key in members:
        own = any(_KIND.sub("", key.name) + end in blocks for end in ("", "[]", "{}"))
        parent, _, leaf = key.name.rpartition(".")
        if (key.type in _MAPPINGS and own) or key.default == "-" or (leaf == "kind" and len(parents) > 1):
            continue
        where.setdefault(key._replace(name=key.name[len(_parent(key.name)) :].removeprefix(".")), []).append(parent)
    rows = [Row(key, tuple(found)) for key, found in where.items()]
    kinds = [key for key in members if key.name.endswith(".kind")]
    if len(parents) == 1 or not kinds:
        return rows
    said = "; ".join(f"{_kinds([key.name])}: {_lowered(by_name[_parent(key.name)].meaning)}" for key in kinds)
    usual = next((key.default for key in kinds if key.default != "required"), "required")
    kind = Key("kind", " | ".join(key.type for key in kinds), "-", usual, "-", said)
    return [Row(kind, tuple(parents)), *rows]


def _kinds(parents: Sequence[str]) -> str:
    return " | ".join(_KIND.findall(parent)[-1] for parent in parents)


def _lowered(text: str) -> str:
    """Text that goes on a sentence."""
    return text[:1].lower() + text[1:]


def _heading(parents: Sequence[str]) -> str:
    """The name of a mapping with its kinds: `plant (rigid | multibody).disturbance`."""
    if len(parents) == 1:
        return f"`{parents[0]}`"
    return f"`{_KIND.sub(lambda _: f' ({_kinds(parents)})', parents[0])}`"


def _block(
    same: Sequence[Row | Key], members: Sequence[list[str]], by_name: Mapping[str, Key], seen: dict[Key, str]
) -> str:
    """One table under its heading; `seen` has the mapping in which each row stood first, and gains its own."""
    rows = [row if isinstance(row, Row) else Row(row, ()) for row in same if row[1]]
    names = [_bare(_KIND.sub("", parents[0]) if parents[0].endswith(")") else parents[0]) for parents in members]
    said = [by_name[name] for name in names if name in by_name]
    if not rows and not said:
        return ""
    heading = ", ".join(map(_heading, members)) if members[0][0] else "Top level"
    parts = [f"### {heading}"]
    if members[0][0]:
        parts.append(" ".join(dict.fromkeys(map(_told_of, said))))
    before: dict[str, list[Row]] = {}
    for row in rows:
        if row.key in seen and not row.parents:
            before.setdefault(seen[row.key], []).append(row)
        seen.setdefault(row.key, _KIND.sub("", members[0][0]))
    known = {place: found for place, found in before.items() if len(found) > 1}
    own = [row for row in rows if not any(row in found for found in known.values())]
    if own:
        cells = [HEADINGS, ("---",) * len(HEADINGS), *map(_cells, own)]
        parts.append("\n".join("| " + " | ".join(one) + " |" for one in cells))
    for place, found in known.items():
        parts.append(f"{', '.join(f'`{row.key.name}`' for row in found)}: as in `{place}`.")
    return "\n\n".join(filter(None, parts))


def _told_of(key: Key) -> str:
    """The meaning of a mapping as a sentence, and what it is where a file leaves it out."""
    text = _escaped(key.meaning)
    more = {"required": " Required.", "null": " Default `null`."}.get(key.default, "")
    return f"{text[:1].upper()}{text[1:]}.{more}"


def _cells(row: Row) -> tuple[str, ...]:
    key = row.key
    of = f" ({_escaped(_kinds(row.parents))})" if row.parents else ""
    default = "zero" if re.fullmatch(r"\[0\.0(, 0\.0)+\]", key.default) else _default(key)
    return (f"`{key.name}`{of}", f"{_escaped(_value(key))}, {default}", _escaped(key.meaning))


def _value(key: Key) -> str:
    """Type, SI unit and range of a key; a number's type is left out, and what its default or its meaning tells."""
    words = key.type.split(" | ")
    told = re.findall(r"(?:^|; )([\w, ]+): ", key.meaning)
    kind = "a word" if len(words) > 1 and {*words} <= {word for one in told for word in one.split(", ")} else key.type
    if key.default == "null":
        kind = kind.removesuffix(" | null")
    span = _span(key)
    unit = "-" if span.endswith(f" {key.unit.rpartition('| ')[2]}") else _si(key.unit)
    if kind == "number" and (unit, span) != ("-", "-"):
        kind = "-"
    return ", ".join(part for part in (kind, unit, span) if part != "-")


def _span(key: Key) -> str:
    """The range of a key, unless its bounds only refuse what no vehicle can have, as `check --schema` has them."""
    span = key.range.replace(", < 9.22337e+18", "").replace(">= 0, >= 1", ">= 1")
    span = span.replace("at least 1 long", "not empty")
    bounds = [abs(float(number)) for number in re.findall(r"(?<![\w^/.])-?\d[\d.]*(?:e[-+]\d+)?(?= |,|$)", span)]
    if span == ">= 0" or any(bound >= _VAST or 0.0 < bound <= _TINY for bound in bounds):
        return "not empty" if "not empty" in span else "-"
    span = re.sub(r">= (\S+), <= (\S+)", r"\1 to \2", span)
    span = re.sub(r"^-(\S+) to \1\b", r"±\1", span)
    return span.replace("<= ", "≤ ").replace(">= ", "≥ ")


def _si(unit: str) -> str:
    """A unit without its twins in feet, slugs and pounds."""
    return " | ".join(one for one in unit.split(" | ") if not re.search(r"ft|slug|lbf", one))


def _escaped(text: str) -> str:
    """Text with what Markdown's tables would take as marks."""
    return text.replace("|", "\\|").replace("<", "\\<")


def _default(key: Key) -> str:
    """A default as it is written in a file; angles in degrees too."""
    if key.default in ("required", "see below"):
        return key.default
    if key.type != "number" or len(key.default) < _LONG:
        return f"`{key.default}`" if key.default else '`""`'
    value = float(key.default)
    degrees = f" ({math.degrees(value):.6g} deg{key.unit.removeprefix('rad')})" if key.unit.startswith("rad") else ""
    return f"`{value:.6g}`{degrees}"


def ports() -> str:
    """A table of the ports whose elements have names, in Markdown."""
    rows = [("port", "elements"), ("---", "---")]
    for port in PORTS:
        shown: list[str] = []
        for of_field in elements(port).values():
            names = ["_".join("<jet>" if word == JETS else word for word in part if word) for part in of_field]
            quoted = [f"`{name}`" for name in names]
            shown += quoted if len(names) <= _MOST else [*quoted[:2], "...", quoted[-1]]
        rows.append((f"`{port}`", ", ".join(shown)))
    return "\n".join("| " + " | ".join(cells) + " |" for cells in rows) + "\n"


def told(text: str, defaults: Mapping[str, str]) -> str:
    """A page's text with the defaults that its prose tells.

    Args:
        text: of the page.
        defaults: as they are written, by key.

    Raises:
        ValueError: when it tells that of a key that is not there.
    """
    unknown = [name for name in _TOLD.findall(text) if name not in defaults]
    if unknown:
        raise ValueError(f"the page tells the default of '{unknown[0]}': there is no such key")
    return _TOLD.sub(lambda found: f"<!-- default {found[1]} -->{defaults[found[1]]}", text)


def tables() -> dict[str, str]:
    """The tables by page, in Markdown."""
    return {page: reference(found(), ELSEWHERE.get(page, ())) for page, found in KEYS.items()} | {
        "reference/ports.md": ports()
    }


def all_defaults() -> dict[str, str]:
    """The defaults of a vehicle's and a scenario's keys, as they are written."""
    return {key.name: _default(key) for key in (*list_keys(Vehicle), *list_keys(Scenario))}


def pages() -> list[Path]:
    """All pages, and the README."""
    return [*sorted(DOCS.rglob("*.md")), DOCS.parent / "README.md"]


def main() -> None:
    """Writes the pages."""
    defaults, made = all_defaults(), {DOCS / page: text for page, text in tables().items()}
    for page in pages():
        before = page.read_text(encoding="utf-8")
        text = told(before, defaults)
        if page in made:
            text = updated(text, made[page])
        if text != before:
            page.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
