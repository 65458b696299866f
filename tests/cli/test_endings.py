"""How a command ends when it is interrupted, or when its result cannot be printed."""

from __future__ import annotations

import contextlib
import itertools
import json
import os
import signal
import subprocess
import sys
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from command_probe import FILES, Massprop, everything

from massprop_drake.cli import show
from massprop_drake.display.run import Run

RUN = ("run", "sample_maneuver", "--no-report", "--out", "there")
PROGRAM = (sys.executable, "-m", "massprop_drake")
SCHEMA = ("check", "--schema", "scenario")  # prints much and loads no Drake
needs_full = pytest.mark.skipif(not Path("/dev/full").exists(), reason="no device that is full")


@pytest.fixture
def at_once(monkeypatch: pytest.MonkeyPatch, short_run: Run) -> None:
    """Simulates nothing: the run is there."""
    monkeypatch.setattr("massprop_drake.runners.simulate.simulate", lambda *_, **__: short_run)


def _nobody() -> int:
    """A pipe whose reader has left."""
    reading, writing = os.pipe()
    os.close(reading)
    return writing


# ------------------------------------------------------------------------ the program, as a process

_FULL = "massprop: the result cannot be printed: No space left on device\n"
_BAD = "massprop: the result cannot be printed: Bad file descriptor\n"


@needs_full
@pytest.mark.parametrize(
    ("streams", "said"),
    [
        (">/dev/full", _FULL),  # also the last flush, of the interpreter that shuts down
        (">&-", _BAD),
        (">/dev/full 2>&- <&-", ""),
    ],
)
def test_the_program_ends_in_order(streams: str, said: str) -> None:
    line = f"{' '.join((*PROGRAM, *SCHEMA))} {streams}"
    done = subprocess.run(line, shell=True, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (1, "", said)


def test_a_run_of_the_program_with_its_figures(tmp_path: Path) -> None:
    maneuver = "maneuver:\n  - {controller: rhc, axis: +x, start_s: 0.2, end_s: 1}\n"
    (tmp_path / "case.yaml").write_text(f"name: mine\nduration_s: 1.6\n{maneuver}", encoding="utf-8")
    done = subprocess.run([*PROGRAM, "run", "case.yaml", "--json"], capture_output=True, cwd=tmp_path, check=False)
    assert (done.returncode, done.stderr) == (0, b"")
    folder = tmp_path / "runs" / "mine"
    assert json.loads(done.stdout) == json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    assert {path.name for path in folder.iterdir()} == FILES
    assert len(list(folder.glob("figures/*.png"))) == 19  # no sample was tested: no margins


def test_a_closed_pipe_ends_the_program_quietly(tmp_path: Path) -> None:
    """Ends quietly as in `massprop check --schema scenario | head -0`, where nobody reads."""
    pipe = subprocess.PIPE
    with subprocess.Popen([*PROGRAM, *SCHEMA], stdout=pipe, stderr=pipe, text=True, cwd=tmp_path) as program:
        assert program.stdout is not None
        assert program.stderr is not None
        program.stdout.close()  # long before anything is printed
        err = program.stderr.read()
    assert (program.returncode, err) == (0, "")


def test_ctrl_c_ends_the_program(tmp_path: Path) -> None:
    command = [*PROGRAM, "run", "sample_maneuver", "--live", "--speed", "0.01"]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdout=pipe, stderr=pipe, text=True, cwd=tmp_path) as program:
        assert program.stderr is not None
        assert "the run is shown at" in program.stderr.readline()
        program.send_signal(signal.SIGINT)
        out, err = program.communicate()
    assert (program.returncode, out, err) == (130, "", "massprop: interrupted: nothing was saved\n")
    assert not list(tmp_path.iterdir())


def test_a_locale_in_which_drake_does_not_load_is_refused(tmp_path: Path) -> None:
    ascii_text = {**os.environ, "LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    done = subprocess.run([*PROGRAM, *RUN], capture_output=True, text=True, cwd=tmp_path, env=ascii_text, check=False)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == "massprop: Drake does not load where text is ASCII, as in the C locale; set PYTHONUTF8=1\n"
    assert list(tmp_path.iterdir()) == []


# ----------------------------------------------------------------------------- streams that fail


@pytest.mark.usefixtures("at_once")
@needs_full
def test_a_run_that_cannot_be_printed_is_saved(massprop: Massprop, monkeypatch: pytest.MonkeyPatch) -> None:
    kept = "the run is saved in there/\n"
    full = f"massprop: the result cannot be printed: No space left on device; {kept}"
    for place, status, said in (("/dev/full", 1, full), (_nobody(), 0, f"massprop: {kept}")):
        with open(place, "w", encoding="utf-8") as stream:
            monkeypatch.setattr(sys, "stdout", stream)
            done = massprop(*RUN)
        assert (done.status, done.err) == (status, said)
        assert Run.load("there").summary["scenario"] == "sample_maneuver"


# -------------------------------------------------------------------------------------------- signals

ENDS = {signal.SIGINT: (130, "interrupted"), signal.SIGTERM: (143, "ended by SIGTERM")}
NOTHING = "massprop: interrupted: nothing was saved\n"


def _signals(number: signal.Signals) -> Callable[..., None]:
    """Raises a signal when it is first called."""
    calls = itertools.count()
    return lambda *_, **__: None if next(calls) else signal.raise_signal(number)


@pytest.mark.usefixtures("at_once")
@pytest.mark.parametrize(
    ("at", "number", "saved"),
    [
        ("cli.sources.load_scenario", signal.SIGINT, False),
        ("runners.simulate.simulate", signal.SIGTERM, False),
        ("display.figures.Plots.save", signal.SIGINT, True),
        ("cli.show.print_simulation", signal.SIGTERM, True),
    ],
)
def test_a_signal_tells_what_is_saved(
    massprop: Massprop, monkeypatch: pytest.MonkeyPatch, at: str, number: signal.Signals, saved: bool
) -> None:
    status, word = ENDS[number]
    kept = "the run is saved in there/" if saved else "nothing was saved"
    for _ in range(2):  # an earlier run is not taken for the new one
        with monkeypatch.context() as patch:
            patch.setattr(f"massprop_drake.{at}", _signals(number))
            assert massprop(*RUN) == (status, "", f"massprop: {word}: {kept}\n")
        assert Path("there").exists() or (not saved and everything() == [])
        handlers = {signal.getsignal(each) for each in ENDS}
        assert handlers == {signal.default_int_handler, signal.SIG_DFL}
        massprop(*RUN, "-q")


def test_an_interruption_that_is_swallowed_comes_again(massprop: Massprop, monkeypatch: pytest.MonkeyPatch) -> None:
    def swallow(*_: Any, **__: Any) -> None:
        with contextlib.suppress(BaseException):
            signal.raise_signal(signal.SIGINT)
        time.sleep(600.0)

    monkeypatch.setattr("massprop_drake.runners.simulate.simulate", swallow)
    assert massprop(*RUN) == (130, "", NOTHING)


def test_an_interruption_does_not_come_again_while_things_are_tidied_up(
    massprop: Massprop, monkeypatch: pytest.MonkeyPatch
) -> None:
    tidied = []

    def tidy(*_: Any, **__: Any) -> None:
        try:
            signal.raise_signal(signal.SIGINT)
        finally:
            with contextlib.suppress(ValueError):
                raise ValueError
            time.sleep(0.2)
            tidied.append(True)

    monkeypatch.setattr("massprop_drake.cli.main.AGAIN_S", 0.05)
    monkeypatch.setattr("massprop_drake.runners.simulate.simulate", tidy)
    assert massprop(*RUN) == (130, "", NOTHING)
    assert tidied


def test_a_signal_that_is_ignored_stays_so(massprop: Massprop, monkeypatch: pytest.MonkeyPatch) -> None:
    """As of a shell's background jobs, and after nohup."""
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        monkeypatch.setattr(show, "print_schema", _signals(signal.SIGINT))
        assert massprop(*SCHEMA) == (0, "", "")
        assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGINT, before)


# --------------------------------------------------------------------------- hostile names and failures

HOSTILE = {
    ("run", "\x1b[31m[bold]x\u202e"): "[bold]x\\u202e",
    ("run", "a", "[/red]\x1b[0m"): "[/red]",
    ("\x1b[31m[/red]",): "[/red]",
    ("run", "a", "--seed", "\x1b[31m[/red]"): "--seed",
    ("estimate", "x.csv", "--vehicle", "\n[/red]"): "[/red]",
    ("check", "-q", "[/red]\x1b.yaml"): "[/red]",
    ("estimate", "fl\udcffght.csv", "--vehicle", "orbiter"): "\\udcffght.csv: has bytes",
    ("run", "sample_maneuver", "--out", "there\udcff"): "\\udcff: ",
    ("run", "sample_maneuver", "--set", "name=\udcff"): "\\udcff: ",
    ("check", "a\0b.csv"): "the character NUL",
}


@pytest.mark.parametrize("arguments", HOSTILE, ids=ascii)
def test_hostile_arguments_are_refused_in_one_safe_line(massprop: Massprop, arguments: tuple[str, ...]) -> None:
    done = massprop(*arguments)
    assert (done.status, done.out) == (2, "")
    assert done.err.startswith("massprop: ")
    assert done.err.removesuffix("\n").isprintable()
    assert HOSTILE[arguments] in done.err
    assert everything() == []


def test_warnings_and_failures_of_ours_are_safe_lines(massprop: Massprop, monkeypatch: pytest.MonkeyPatch) -> None:
    def warn(_: object) -> None:
        for _ in range(2):
            warnings.showwarning("[/red]\x1b[31m", UserWarning, "there.py", 7)

    def fail(*_: object, **__: object) -> None:
        raise RuntimeError("two\nlines \x1b[31m[/red]")

    monkeypatch.setattr(show, "print_schema", warn)
    assert massprop(*SCHEMA) == (0, "", "massprop: there.py:7: UserWarning: [/red]\\x1b[31m\n")
    monkeypatch.setattr("massprop_drake.runners.simulate.simulate", fail)
    said = "massprop: internal failure: RuntimeError: two\\nlines \\x1b[31m[/red]\n"
    assert massprop(*RUN) == (1, "", said)
    assert everything() == []
