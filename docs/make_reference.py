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

from massprop_drake.inputs.campaign import campaign_keys
from massprop_drake.inputs.model import Key, keys
from massprop_drake.inputs.record_map import map_keys
from massprop_drake.inputs.scenario import Scenario
from massprop_drake.inputs.vehicle import Vehicle
from massprop_drake.systems.views import JETS, PORTS, elements

DOCS = Path(__file__).parent
KEYS: dict[str, Callable[[], list[Key]]] = {
    "vehicle.md": partial(keys, Vehicle),
    "scenario.md": partial(keys, Scenario),
    "campaign.md": campaign_keys,
    "records.md": map_keys,
}
MARK = "<!-- docs/make_reference.py writes what follows from the code: edit the descriptions there -->"
HEADINGS = ("key", "type", "unit", "default", "range", "meaning")
_TOLD = re.compile(r"<!-- default ([^>]+) -->`[^`\n]*`")
_MOST = 10  # elements of a field that are all shown
_LONG = 12  # characters of a number beyond which its page shows six digits


def updated(text: str, tables: str) -> str:
    """Returns a page's text with its tables replaced.

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


def reference(found: Sequence[Key]) -> str:
    """Makes a table of keys for the file itself, then one for each mapping in it, in Markdown."""
    shown = [key for key in found if not key.name.startswith("vehicle.")]  # a scenario's: on a page of its own
    meanings = {key.name: key.meaning for key in shown}
    groups: dict[str, list[Key]] = {}
    for key in shown:
        groups.setdefault(_parent(key.name), []).append(key)
    parts = []
    for parent, members in groups.items():
        meaning = meanings.get(parent.removesuffix("[]").removesuffix("{}"), "")
        heading = f"`{parent}`: {_escaped(meaning.partition(';')[0])}" if parent else "Top level"
        parts.append("\n".join([f"### {heading}", "", *_table(members)]))
    return "\n\n".join(parts) + "\n"


def _parent(name: str) -> str:
    """Returns the mapping that a key stands in; what is in parentheses may have dots of its own."""
    head, _, inside = name.partition(" (")
    return head if inside.endswith(")") and "." in inside else name.rpartition(".")[0]


def _table(members: list[Key]) -> list[str]:
    rows = [HEADINGS, ("---",) * len(HEADINGS), *map(_cells, members)]
    return ["| " + " | ".join(cells) + " |" for cells in rows]


def _cells(key: Key) -> tuple[str, ...]:
    shown = (_escaped(part) for part in (key.type, key.unit))
    return (f"`{key.name}`", *shown, _default(key), _escaped(key.range), _escaped(key.meaning))


def _escaped(text: str) -> str:
    """Escapes what Markdown's tables would take as marks."""
    return text.replace("|", "\\|").replace("<", "\\<")


def _default(key: Key) -> str:
    """Formats a default as it is written in a file; angles in degrees too."""
    if key.default in ("required", "see below"):
        return key.default
    if key.type != "number" or len(key.default) < _LONG:
        return f"`{key.default}`" if key.default else '`""`'
    value = float(key.default)
    degrees = f" ({math.degrees(value):.6g} deg{key.unit.removeprefix('rad')})" if key.unit.startswith("rad") else ""
    return f"`{value:.6g}`{degrees}"


def ports() -> str:
    """Makes a table of the ports whose elements have names, in Markdown."""
    rows = [("port", "elements"), ("---", "---"), *((f"`{port}`", _elements_of(port)) for port in PORTS)]
    return "\n".join("| " + " | ".join(cells) + " |" for cells in rows) + "\n"


def _elements_of(port: str) -> str:
    """Returns the names of a port's elements, field by field."""
    return ", ".join(_shortened([_named(part) for part in of_field]) for of_field in elements(port).values())


def _named(part: Sequence[str]) -> str:
    return "`" + "_".join("<jet>" if word == JETS else word for word in part if word) + "`"


def _shortened(names: Sequence[str]) -> str:
    """Returns names of a field; of many the first two and the last."""
    return ", ".join(names if len(names) <= _MOST else [*names[:2], "...", names[-1]])


def told(text: str, defaults: Mapping[str, str]) -> str:
    """Returns a page's text with the defaults in its prose replaced.

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
    """Makes the tables by page, in Markdown."""
    return {page: reference(found()) for page, found in KEYS.items()} | {"reference/ports.md": ports()}


def all_defaults() -> dict[str, str]:
    """Returns the defaults of a vehicle's and a scenario's keys, as they are written."""
    return {key.name: _default(key) for key in (*keys(Vehicle), *keys(Scenario))}


def pages() -> list[Path]:
    """Returns all pages, and the README."""
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
