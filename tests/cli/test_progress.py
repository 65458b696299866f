"""The progress bar shows on a terminal, and only for work that takes a while."""

from __future__ import annotations

import io
import sys

import pytest

from massprop_drake.cli import progress


class _Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.fixture
def at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Any work counts as long."""
    monkeypatch.setattr(progress, "_AFTER_S", 0.0)


@pytest.fixture(autouse=True)
def terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    """A terminal on which a bar can be drawn."""
    monkeypatch.setenv("TERM", "xterm")


def _shown(monkeypatch: pytest.MonkeyPatch, stream: io.StringIO, *, shown: bool = True) -> str:
    """What some work leaves on the error stream."""
    monkeypatch.setattr(sys, "stderr", stream)
    with progress.Progress("simulating", 2.0, shown=shown) as report:
        report(0.5)
        report(2.0)
    return stream.getvalue()


@pytest.mark.usefixtures("at_once")
def test_long_work_on_a_terminal_shows_a_bar(monkeypatch: pytest.MonkeyPatch) -> None:
    bar = _shown(monkeypatch, _Terminal())
    assert "simulating" in bar
    assert "100%" in bar


def test_short_work_shows_none(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(progress, "_AFTER_S", 600.0)  # any work counts as short, however busy the machine
    assert _shown(monkeypatch, _Terminal()) == ""


@pytest.mark.usefixtures("at_once")
def test_a_bar_that_is_not_wanted_is_not_shown(monkeypatch: pytest.MonkeyPatch) -> None:
    assert _shown(monkeypatch, _Terminal(), shown=False) == ""


@pytest.mark.usefixtures("at_once")
def test_a_file_sees_no_bar(monkeypatch: pytest.MonkeyPatch) -> None:
    assert _shown(monkeypatch, io.StringIO()) == ""
