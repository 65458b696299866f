"""Terminal on which every text of a user is printed as it is, and tables of which no cell is cut."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterable, Sequence
from typing import Any

from rich.box import HEAVY_HEAD
from rich.cells import cell_len
from rich.console import Console
from rich.style import Style
from rich.table import Table
from rich.text import Text

from massprop_drake.cli.streams import escape_unprintable

ABOUT = ("parameter", "signal", "cause", "unit", "")  # headings of what a row is about
_ANY_WIDTH = 10_000  # characters, for a table as wide as it needs


class Terminal(Console):
    """Standard output that prints every `str` as plain text, never as markup or control sequence.

    The program's own styles are given apart from the words, as `words` takes them.

    Args:
        width: in characters where output goes to a file; a terminal has its own.
    """

    def __init__(self, width: int | None = None):
        super().__init__(width=None if sys.stdout.isatty() else width, highlight=False)

    def render_str(self, text: str, *, style: str | Style = "", **_: Any) -> Text:
        """Converts a string to rich text without markup; rich calls it for lines, titles and cells."""
        return Text(escape_unprintable(text, self.encoding), style=style)

    def words(self, *parts: str | tuple[str, str]) -> Text:
        """Joins strings, or pairs of a string and its style, to one rich text."""
        pairs = ((part, "") if isinstance(part, str) else part for part in parts)
        return Text.assemble(*(self.render_str(part, style=style) for part, style in pairs))

    def say(self, *parts: str | tuple[str, str]) -> None:
        """Prints strings, or pairs of string and style, as one line; a terminal wraps it with an indent."""
        line = self.words(*parts)
        if not sys.stdout.isatty():
            self.print(line, soft_wrap=True)
            return
        label = _LABEL.match(line.plain)
        indent = label.end() if label else 0
        for number, piece in enumerate(line.divide(_line_starts(line.plain, self.width, indent))):
            piece.rstrip()
            self.print(Text(" " * indent if number else "") + piece, soft_wrap=True)


_LABEL = re.compile(r"(?:[a-z]+:)?\s+")  # what a line begins with, `detected:    ` or the blanks below it
_WORD = re.compile(r"\S+(?: ± \S+)?\s*")  # what stays together


def _line_starts(text: str, width: int, indent: int) -> list[int]:
    """Returns the indices in a text at which its wrapped lines begin, without the first."""
    begins, room = [0], width
    for word in _WORD.finditer(text, indent):
        if word.start() > max(begins[-1], indent) and cell_len(text[begins[-1] : word.end()].rstrip()) > room:
            begins.append(word.start())
            room = width - indent
    return begins[1:]


def print_table(
    console: Terminal,
    title: str,
    headings: Sequence[str],
    rows: Iterable[Sequence[Text | str] | None],
    *,
    droppable: Sequence[str] = (),
    hidden: Sequence[str] = (),
) -> None:
    """Prints a table without cutting a cell: a table that is too wide loses frame and columns, or is a list.

    Where it is too wide for the terminal it goes without its frame, then closer, and then without columns. What is
    still too wide is listed on a terminal, a line for each cell, and printed as wide as it is into a file.

    Args:
        console: to print on.
        title: above it.
        headings: of the columns, in one line or several.
        rows: cells, "-" where one is missing at the end; None: a line between two sections.
        droppable: headings of columns that can be spared, the first one first.
        hidden: headings of columns that are never printed.
    """
    cells = [row and [*row, *["-"] * (len(headings) - len(row))] for row in rows]
    layouts = [(HEAVY_HEAD, 1, 0), (None, 2, 0), *((None, 1, count) for count in range(len(droppable) + 1))]
    for frame, gap, left_out in layouts:
        kept = [place for place, heading in enumerate(headings) if heading not in (*hidden, *droppable[:left_out])]
        padding = (0, gap, 0, 1 if frame else 0)
        table = Table(title=title, title_justify="left", header_style="bold", box=frame, padding=padding)
        for place in kept:
            left = headings[place] in ABOUT
            lines = Text("\n").join(map(console.render_str, headings[place].split("\n")))
            table.add_column(lines, justify="left" if left else "right", no_wrap=True)
        for row in cells:
            if row is None and frame:
                table.add_section()
            elif row is None:
                table.add_row()
            else:
                table.add_row(*(row[place] for place in kept))
        width = console.measure(table, options=console.options.update(max_width=_ANY_WIDTH)).maximum
        if width <= console.width:
            break
    if width > console.width and sys.stdout.isatty():
        shown = [[row[place] for place in kept] for row in cells if row is not None]
        _print_as_list(console, title, [headings[place] for place in kept], shown)
        return
    console.width = max(console.width, width)
    console.print(table)


def _print_as_list(
    console: Terminal, title: str, headings: Sequence[str], rows: Iterable[Sequence[Text | str]]
) -> None:
    """Prints a table as a list: the subject of a row, with its unit, and below it a line per other cell."""
    console.say((title, "italic"))
    names = [heading.replace("\n", " ") for heading in headings]
    longest = max(map(cell_len, names))
    for row in rows:
        subject = [place for place, heading in enumerate(names) if heading in ABOUT]
        console.say((", ".join(str(row[place]) for place in subject), "bold"))
        for place, cell in enumerate(row):
            if place not in subject:
                padding = " " * (longest - cell_len(names[place]) + 2)
                shown = cell if isinstance(cell, Text) else console.words(cell)
                console.print(console.words(f"  {names[place]}{padding}") + shown, soft_wrap=True)
