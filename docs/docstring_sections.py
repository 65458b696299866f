"""Conversion of this project's docstrings for Sphinx.

Some habits of the docstrings are not reStructuredText: sections of their own (Ports, State, ...), equations
set off by indentation alone, sketches with arrows, headings within a line ("Timing: ...") and |bars|. They are
rewritten before napoleon reads the Google-style sections.
"""

from __future__ import annotations

import re
from typing import Any

from sphinx.application import Sphinx

_LISTED = ("Ports",)
_SPOKEN = ("Ports", "State", "Parameters", "Timing", "Frames", "Source", "Assumptions and limitations")
_GOOGLE = ("Args", "Returns", "Raises", "Attributes", "Yields", "Example", "Note")
_HEADING = re.compile(rf"^({'|'.join(_SPOKEN)}): ?(.*)$")


def rewritten(lines: list[str]) -> list[str]:
    """Rewrites a docstring's lines in reStructuredText, but for the sections that napoleon knows."""
    result: list[str] = []
    position = 0
    while position < len(lines):
        line = lines[position]
        heading = _HEADING.match(line)
        if heading and heading[1] in _LISTED and not heading[2]:
            block, position = _indented(lines, position + 1)
            result += [f"**{heading[1]}**", "", *_entries(block), ""]
        elif line.rstrip(":") in _GOOGLE and line.endswith(":"):
            block, position = _indented(lines, position + 1)
            block = [_text(part) for part in block]
            if block[0].startswith("    - "):  # a list, which napoleon would take for a type
                result += [f"**{line[:-1]}**", "", *(part[4:] for part in block)]
            else:
                result += [line, *block]
        elif line.startswith("    ") and _separate(result):
            block, position = _indented(lines, position)
            result += [".. code-block:: text", "", *block, ""]
        elif _separate(result) and any("-->" in part for part in _paragraph(lines, position)):
            sketch = _paragraph(lines, position)
            result += [".. code-block:: text", "", *(f"    {part}" for part in sketch), ""]
            position += len(sketch)
        else:
            result.append(_text(f"**{heading[1]}**: {heading[2]}" if heading else line))
            position += 1
    return result


def _text(line: str) -> str:
    """Rewrites a line of text whose bars, outside of literals, stand for magnitudes and not for substitutions."""
    parts = re.split(r"(`[^`]*`)", line)
    return "".join(part if part.startswith("`") else part.replace("|", r"\|") for part in parts)


def _paragraph(lines: list[str], start: int) -> list[str]:
    """Returns the lines up to the next blank one."""
    end = start
    while end < len(lines) and lines[end].strip():
        end += 1
    return lines[start:end]


def _separate(before: list[str]) -> bool:
    """Tests whether an indented line is a block of its own, and not the rest of a list's entry."""
    if before and before[-1].strip():
        return False
    last = next((line for line in reversed(before) if line.strip()), "")
    return not last.endswith("::")


def _indented(lines: list[str], start: int) -> tuple[list[str], int]:
    """Returns the indented lines from a place on, blank ones between them included, and where they end."""
    end = start
    while end < len(lines) and (lines[end].startswith("    ") or not lines[end].strip()):
        end += 1
    block = lines[start:end]
    while block and not block[-1].strip():
        block.pop()
    return [*block, ""], end


def _entries(block: list[str]) -> list[str]:
    """Makes a list, an item for each entry `name (in, 3): meaning`, whose continuation is indented further."""
    result: list[str] = []
    for line in block[:-1]:
        text = line[4:]
        if text.startswith(" "):
            result.append(f"  {_text(text.strip())}")
        else:
            # what is listed stands before the first colon that no parenthesis holds
            match = re.match(r"((?:[^:(]|\([^)]*\))+):(.*)", text)
            result.append(f"* ``{match[1]}``:{_text(match[2])}" if match else f"* ``{text.strip()}``")
    return result


def _process(_app: Sphinx, _what: str, _name: str, _object: Any, _options: Any, lines: list[str]) -> None:
    lines[:] = rewritten(lines)


def _skip(_app: Sphinx, _what: str, name: str, member: Any, skip: bool, _options: Any) -> bool | None:
    """Leaves out the fields of named tuples, which their class describes already, and pydantic's settings."""
    return True if name == "model_config" or type(member).__name__ == "_tuplegetter" else skip or None


def _signature(
    _app: Sphinx, _what: str, _name: str, thing: Any, _options: Any, arguments: str | None, result: str | None
) -> tuple[str | None, str | None]:
    """Shows a file's model without its keys, which have pages of their own, and short names of types as such."""
    if isinstance(thing, type) and hasattr(thing, "model_fields"):
        return "", None
    return arguments and re.sub(r"TypeAliasForwardRef\('(\w+)'\)", r"\1", arguments), result


def setup(app: Sphinx) -> dict[str, bool]:
    """Connects the rewriting before napoleon's, whose priority is 500."""
    app.connect("autodoc-process-docstring", _process, priority=400)
    app.connect("autodoc-skip-member", _skip)
    app.connect("autodoc-process-signature", _signature)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
