"""What users wrote reaches the terminal as it is, and streams that fail stop nothing."""

from __future__ import annotations

import errno
import io
import sys
import unicodedata

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from rich.table import Table

from massprop_drake.cli import progress, show, streams
from massprop_drake.cli.streams import Stream, escape_unprintable

HOSTILE = {
    "[/red]": "[/red]",
    "\\[/red]": "\\[/red]",
    "[link=https://example.org]J": "[link=https://example.org]J",
    "100 °C, ±π": "100 °C, ±π",
    "\x1b[31mX": "\\x1b[31mX",
    "\x1b]0;title\x07": "\\x1b]0;title\\x07",
    "a\rb\nc\td": "a\\rb\\nc\\td",
    "a\x00b\x7fc\x08": "a\\x00b\\x7fc\\x08",
    "\u202egnp.\u2066x": "\\u202egnp.\\u2066x",
    "\u2028\u200b\ufeff": "\\u2028\\u200b\\ufeff",
    "fl\udcffght": "fl\\udcffght",
}


def _is_safe(text: str) -> bool:
    """Whether nothing in it is an order to a terminal; categories by the standard, not by our own rule."""
    return not any(unicodedata.category(one) in {"Cc", "Cf", "Cs", "Zl", "Zp"} for one in text)


@given(st.text(st.characters(categories=None)))
@example("\x1b[0m[/]")
def test_no_text_is_an_order(text: str) -> None:
    assert _is_safe(escape_unprintable(text))
    remaining = iter(escape_unprintable(text))
    assert all(one in remaining for one in text if one.isprintable()), "lost, or out of order"
    for encoding in ("utf-8", "latin-1", "ascii"):
        escape_unprintable(text, encoding).encode(encoding)


def _terminal(monkeypatch: pytest.MonkeyPatch, encoding: str = "utf-8") -> io.BytesIO:
    """Puts a stream of an encoding in the place of standard output."""
    raw = io.BytesIO()
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(raw, encoding))
    return raw


@pytest.mark.parametrize(("text", "shown"), HOSTILE.items(), ids=ascii)
def test_every_place_of_a_table_is_safe(monkeypatch: pytest.MonkeyPatch, text: str, shown: str) -> None:
    raw = _terminal(monkeypatch)
    terminal = show.Terminal(120)
    table = Table(text, title=text, caption=text)
    table.add_row(text)
    table.add_row(terminal.words((text, "bold"), text))
    terminal.print(table)
    terminal.say(text, (text, "red"))
    terminal.print(text)
    streams.say(text)
    out = raw.getvalue().decode()
    assert out.count(shown) == 10, out
    assert all(map(_is_safe, out.splitlines()))


class _Terminal(io.StringIO):
    encoding = "utf-8"

    def isatty(self) -> bool:
        return True


@pytest.mark.parametrize(
    ("stream", "after_s", "shown", "seen"),
    [
        (_Terminal, 0.0, True, True),
        (_Terminal, 600.0, True, False),  # any work counts as short, however busy the machine
        (_Terminal, 0.0, False, False),
        (io.StringIO, 0.0, True, False),
    ],
)
def test_long_work_on_a_terminal_shows_a_bar_with_its_title_as_it_is(
    monkeypatch: pytest.MonkeyPatch, stream: type[io.StringIO], after_s: float, shown: bool, seen: bool
) -> None:
    monkeypatch.setattr(progress, "AFTER_S", after_s)
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setattr(sys, "stderr", errors := stream())
    with progress.Progress("simulating [/red]\x1b]0;x\x07", 2.0, shown=shown) as report:
        report(0.5)
        report(2.0)
    bar = errors.getvalue()
    assert ("simulating [/red]\\x1b]0;x\\x07" in bar, "100%" in bar, bar != "") == (seen,) * 3
    assert "\x1b]" not in bar


class _Failing(io.RawIOBase):
    """A file that takes nothing."""

    def __init__(self, number: int):
        self.number = number

    def writable(self) -> bool:
        return True

    def write(self, _: object) -> int:
        raise OSError(self.number, "takes nothing")


def test_a_stream_keeps_its_first_failure() -> None:
    number = errno.ENOSPC
    under = io.TextIOWrapper(io.BufferedWriter(_Failing(number)), "utf-8")
    stream = Stream(under)
    for _ in range(3):
        assert stream.write("x") == 1
        stream.flush()
    assert stream.failure is not None
    assert stream.failure.errno == number
    with pytest.raises(OSError, match="takes nothing"):
        under.close()


def test_what_an_encoding_lacks_is_printed_as_an_escape() -> None:
    raw = io.BytesIO()
    stream = Stream(io.TextIOWrapper(raw, "ascii"))
    stream.write("±")
    stream.flush()
    assert (stream.failure, stream.encoding, stream.isatty()) == (None, "ascii", False)
    assert raw.getvalue() == b"\\xb1"
