"""How a command ends when it is interrupted, or when its result cannot be printed."""

from __future__ import annotations

import contextlib
import io
import itertools
import json
import os
import signal
import subprocess
import sys
import time
import warnings
from collections.abc import Callable
from importlib.abc import MetaPathFinder
from pathlib import Path
from typing import Any, TextIO

import pytest
from command_probe import Massprop

from massprop_drake import InputError, estimate, load_vehicle
from massprop_drake.cli import main as cli_main
from massprop_drake.cli import show
from massprop_drake.inputs.model import yaml_text
from massprop_drake.inputs.scenario import Scenario
from massprop_drake.inputs.yaml import to_yaml
from massprop_drake.results.folder import write_files
from massprop_drake.results.run import Run

RUN = ("run", "sample_maneuver", "--no-report", "--out", "there")
PROGRAM = (sys.executable, "-m", "massprop_drake")
FULL = Path("/dev/full")
SCHEMA = ("check", "--schema", "scenario")  # prints much and loads no Drake
needs_full = pytest.mark.skipif(not FULL.exists(), reason="no device that is full")


@pytest.fixture
def at_once(monkeypatch: pytest.MonkeyPatch, short_run: Run) -> None:
    """Simulates nothing: the run is there."""
    monkeypatch.setattr("massprop_drake.runners.simulate.simulate", lambda *_, **__: short_run)


def _nobody() -> TextIO:
    """A pipe whose reader has left."""
    reading, writing = os.pipe()
    os.close(reading)
    return open(writing, "w", encoding="utf-8")


def _everything() -> list[str]:
    return sorted(str(path) for path in Path().rglob("*"))


# ------------------------------------------------------------------------------------ streams that fail


@pytest.mark.usefixtures("at_once")
@needs_full
@pytest.mark.parametrize("options", [(), ("--json",)])
def test_a_run_that_cannot_be_printed_is_saved(
    massprop: Massprop, monkeypatch: pytest.MonkeyPatch, options: tuple[str, ...]
) -> None:
    with FULL.open("w", encoding="utf-8") as full:
        monkeypatch.setattr(sys, "stdout", full)
        done = massprop(*RUN, *options)
    words = "the result cannot be printed: No space left on device; the run is saved in there/"
    assert (done.status, done.err) == (1, f"massprop: {words}\n")
    assert Run.load("there").summary["scenario"] == "sample_maneuver"


@pytest.mark.usefixtures("at_once")
def test_a_reader_that_left_is_told_where_the_run_is(massprop: Massprop, monkeypatch: pytest.MonkeyPatch) -> None:
    with _nobody() as stream:
        monkeypatch.setattr(sys, "stdout", stream)
        done = massprop(*RUN)
        assert (done.status, done.err) == (0, "massprop: the run is saved in there/\n")
    assert Run.load("there").summary["scenario"] == "sample_maneuver"


@pytest.mark.usefixtures("at_once")
def test_output_that_is_not_utf_8(massprop: Massprop, monkeypatch: pytest.MonkeyPatch) -> None:
    raw = io.BytesIO()
    with io.TextIOWrapper(raw, "ascii") as stream:
        monkeypatch.setattr(sys, "stdout", stream)
        done = massprop(*RUN)
        assert (done.status, done.err) == (0, "")
        assert b"Ixx\\u207b\\xb9" in raw.getvalue()


@needs_full
@pytest.mark.parametrize(
    ("redirection", "status", "said"),
    [
        (">/dev/full", 1, "massprop: the result cannot be printed: No space left on device\n"),
        (">&-", 1, "massprop: the result cannot be printed: Bad file descriptor\n"),
        (">/dev/full 2>&- <&-", 1, ""),
    ],
)
def test_the_program_ends_in_order(tmp_path: Path, redirection: str, status: int, said: str) -> None:
    """Also the last flush, of the interpreter that shuts down."""
    command = f"{' '.join([*PROGRAM, *SCHEMA])} {redirection}"
    done = subprocess.run(command, shell=True, capture_output=True, text=True, cwd=tmp_path, check=False)
    assert (done.returncode, done.stderr) == (status, said)


def test_a_locale_in_which_drake_does_not_load_is_refused(tmp_path: Path) -> None:
    ascii_text = {**os.environ, "LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    done = subprocess.run([*PROGRAM, *RUN], capture_output=True, text=True, cwd=tmp_path, env=ascii_text, check=False)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == "massprop: Drake does not load where text is ASCII, as in the C locale; set PYTHONUTF8=1\n"
    assert list(tmp_path.iterdir()) == []


# -------------------------------------------------------------------------------------------- signals

ENDS = {signal.SIGINT: (130, "interrupted"), signal.SIGTERM: (143, "ended by SIGTERM")}


def _signals(number: signal.Signals) -> Callable[..., None]:
    """Raises a signal when it is first called."""
    calls = itertools.count()
    return lambda *_, **__: None if next(calls) else signal.raise_signal(number)


@pytest.mark.usefixtures("at_once")
@pytest.mark.parametrize("number", ENDS)
@pytest.mark.parametrize(
    ("at", "saved"),
    [
        ("cli.sources.load_scenario", False),
        ("runners.simulate.simulate", False),
        ("results.run.Run._write_telemetry", True),
        ("display.figures.Plots.save", True),
        ("cli.show.simulated", True),
    ],
)
def test_a_signal_tells_what_is_saved(
    massprop: Massprop, monkeypatch: pytest.MonkeyPatch, number: signal.Signals, at: str, saved: bool
) -> None:
    monkeypatch.setattr(f"massprop_drake.{at}", _signals(number))
    status, word = ENDS[number]
    kept = "the run is saved in there/" if saved else "nothing was saved"
    assert massprop(*RUN) == (status, "", f"massprop: {word}: {kept}\n")
    assert Path("there").exists() == saved
    assert saved or _everything() == []
    handlers = {signal.getsignal(each) for each in ENDS}
    assert handlers == {signal.default_int_handler, signal.SIG_DFL}


@pytest.mark.usefixtures("at_once")
@pytest.mark.parametrize(("at", "saved"), [("runners.simulate.simulate", False), ("cli.show.simulated", True)])
def test_an_earlier_run_is_not_taken_for_the_new_one(
    massprop: Massprop, monkeypatch: pytest.MonkeyPatch, at: str, saved: bool
) -> None:
    massprop(*RUN, "-q")
    earlier = Path("there/summary.json").stat().st_ino
    monkeypatch.setattr(f"massprop_drake.{at}", _signals(signal.SIGINT))
    kept = "the run is saved in there/" if saved else "nothing was saved"
    assert massprop(*RUN).err == f"massprop: interrupted: {kept}\n"
    assert (Path("there/summary.json").stat().st_ino != earlier) == saved


def test_a_signal_is_told_while_a_module_loads(massprop: Massprop, monkeypatch: pytest.MonkeyPatch) -> None:
    """Drake turns what is raised while it loads into an error of its own."""

    class Signaling(MetaPathFinder):
        def find_spec(self, name: str, *_: object) -> None:
            if name == "massprop_drake.cli.app":
                try:
                    signal.raise_signal(signal.SIGINT)
                except BaseException as error:
                    raise ImportError("initialization failed") from error

    monkeypatch.delitem(sys.modules, "massprop_drake.cli.app", raising=False)
    monkeypatch.setattr(sys, "meta_path", [Signaling(), *sys.meta_path])
    assert massprop(*RUN) == (130, "", "massprop: interrupted: nothing was saved\n")


def test_an_interrupted_reproduction_goes_on(reproduction: Massprop, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("reproduction.reproduce.run_missing", _signals(signal.SIGINT))
    done = reproduction("--only", "fig_5_6", "--out", "there")
    kept = "finished runs are kept in there/, and the same command goes on from there"
    assert done == (130, "", f"massprop: interrupted: {kept}\n")


@pytest.mark.usefixtures("at_once")
def test_an_interrupted_view(massprop: Massprop, monkeypatch: pytest.MonkeyPatch) -> None:
    def write(*arguments: Any, **options: Any) -> None:
        write_files(*arguments, **options)
        signal.raise_signal(signal.SIGINT)

    massprop(*RUN, "-q")
    with monkeypatch.context() as patch:
        patch.setattr("massprop_drake.display.flight3d.replay_html", _signals(signal.SIGINT))
        assert massprop("view", "there") == (130, "", "massprop: interrupted: nothing was saved\n")
    monkeypatch.setattr("massprop_drake.cli.pages.write_files", write)
    done = massprop("view", "there")
    assert done == (130, "", "massprop: interrupted: the replay is saved in there/replay.html\n")


def test_an_interruption_that_is_swallowed_comes_again(massprop: Massprop, monkeypatch: pytest.MonkeyPatch) -> None:
    def swallow(*_: Any, **__: Any) -> None:
        with contextlib.suppress(BaseException):
            signal.raise_signal(signal.SIGINT)
        time.sleep(600.0)

    monkeypatch.setattr("massprop_drake.runners.simulate.simulate", swallow)
    assert massprop(*RUN) == (130, "", "massprop: interrupted: nothing was saved\n")


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
            time.sleep(3.0 * cli_main._AGAIN_S)
            tidied.append(True)

    monkeypatch.setattr(cli_main, "_AGAIN_S", 0.05)
    monkeypatch.setattr("massprop_drake.runners.simulate.simulate", tidy)
    assert massprop(*RUN) == (130, "", "massprop: interrupted: nothing was saved\n")
    assert tidied


def test_a_signal_that_is_ignored_stays_so(massprop: Massprop, monkeypatch: pytest.MonkeyPatch) -> None:
    """As of a shell's background jobs, and after nohup."""
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        monkeypatch.setattr(show, "schema", _signals(signal.SIGINT))
        assert massprop(*SCHEMA) == (0, "", "")
        assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGINT, before)


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


# -------------------------------------------------------------------------- hostile names from end to end


def test_a_failed_jet_of_any_name_is_printed(massprop: Massprop, monkeypatch: pytest.MonkeyPatch) -> None:
    name = "[/red][bold]\\[x]\\"
    vehicle = load_vehicle("orbiter")
    Path("v.yaml").write_text(yaml_text(vehicle).replace("designation: R4R\n", f"designation: '{name}'\n"), "utf-8")
    case = {
        "vehicle": "v.yaml",
        "duration_s": 4,
        "maneuver": [{"controller": "rhc", "axis": "+x", "start_s": 0.2, "end_s": 0.8}],
        "failures": [{"kind": "stuck_on", "jet": name, "start_s": 1}],
        "estimation": {"filter": "thesis", "start": "nominal", "std_fraction": 0.001},
    }
    Path("case.yaml").write_text(to_yaml(case), encoding="utf-8")
    done = massprop("run", "case.yaml", "--out", "there", "--no-report")
    assert (done.status, done.err) == (0, "")
    assert f"out of use: {name}\n" in done.out
    detected = f"detected:    jet {name} (cluster"
    assert detected in done.out

    rows = Path("there/telemetry.csv").read_bytes()
    again = ("estimate", "-", "--like", "there", "--out", "again", "--no-report")
    done = massprop(*again, stdin=rows)
    assert (done.status, done.err) == (0, "")
    assert done.out.startswith(detected)  # told while rows come in, long before anything is saved
    with _nobody() as stream:
        monkeypatch.setattr(sys, "stdout", stream)
        assert massprop(*again, stdin=rows) == (0, "", "massprop: the run is saved in again/\n")
    assert len(Run.load("again").summary["detections"]) == 1


HOSTILE_ARGUMENTS = [
    ("run", "[/red]"),
    ("run", "\x1b[31m[bold]x\u202e"),
    ("run", "a", "[/red]\x1b[0m"),
    ("\x1b[31m[/red]",),
    ("run", "a", "--\x1b[31m[/red]"),
    ("run", "a", "--seed", "\x1b[31m[/red]"),
    ("check", "--schema", "\x1b[31m[/red]"),
    ("run", "sample_maneuver", "--set", "\x1b]0;x\x07[/red]=1"),
    ("graph", "\x1b[2J[/red]"),
    ("estimate", "\x1b[2J[/red].csv", "--vehicle", "orbiter"),
    ("estimate", "x.csv", "--vehicle", "\n[/red]"),
    ("check", "-q", "[/red]\x1b.yaml"),
]


@pytest.mark.parametrize("arguments", HOSTILE_ARGUMENTS, ids=ascii)
def test_hostile_arguments_are_refused_in_one_safe_line(massprop: Massprop, arguments: tuple[str, ...]) -> None:
    done = massprop(*arguments)
    assert (done.status, done.out) == (2, "")
    assert done.err.startswith("massprop: ")
    assert done.err.removesuffix("\n").isprintable()
    assert "[/red]" in done.err or "--seed" in done.err or "[bold]x\\u202e" in done.err


@pytest.mark.parametrize(
    "arguments",
    [
        ("estimate", "fl\udcffght.csv", "--vehicle", "orbiter"),
        ("run", "sample_maneuver", "--out", "there\udcff"),
        ("run", "sample_maneuver", "--set", "name=\udcff"),
        ("check", "a\0b.csv"),
        ("run", "a\0b.yaml"),
        ("view", "a\0b"),
        ("run", "sample_maneuver", "--out", "a\0b"),
    ],
    ids=ascii,
)
def test_arguments_that_are_no_text_are_refused(massprop: Massprop, arguments: tuple[str, ...]) -> None:
    done = massprop(*arguments)
    assert (done.status, done.out) == (2, "")
    assert done.err.count("\n") == 1
    assert "\\udcff: " in done.err or "\\udcffght.csv: has bytes" in done.err or "the character NUL" in done.err
    assert _everything() == []


# --------------------------------------------------------------------------------------------- the rest


def test_check_when_quiet_says_what_is_wrong(massprop: Massprop, toy_data: dict[str, Any]) -> None:
    Path("bad.yaml").write_text("sede: 1\nduration_s: -1\n", encoding="utf-8")
    Path("toy.yaml").write_text(to_yaml(toy_data), encoding="utf-8")
    assert massprop("check", "-q", "toy.yaml", "sample_maneuver") == (0, "", "")
    done = massprop("check", "-q", "toy.yaml", "bad.yaml", "nowhere.yaml")
    assert (done.status, done.out) == (2, "")
    lines = done.err.splitlines()
    assert len(lines) == 3
    assert all(line.startswith("massprop: bad.yaml, line ") for line in lines[:2])
    assert lines[2] == "massprop: nowhere.yaml: no such file"
    both = massprop("check", "-q", "--json", "bad.yaml")
    assert (both.status, both.err) == (2, "")
    assert not json.loads(both.out)[0]["ok"]


def test_warnings_are_safe_lines(massprop: Massprop, monkeypatch: pytest.MonkeyPatch) -> None:
    def warn(_: object) -> None:
        for _ in range(2):
            warnings.showwarning("[/red]\x1b[31m", UserWarning, "there.py", 7)

    monkeypatch.setattr(show, "schema", warn)
    assert massprop(*SCHEMA) == (0, "", "massprop: there.py:7: UserWarning: [/red]\\x1b[31m\n")


def test_a_failure_of_ours_is_a_safe_line(massprop: Massprop, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(_: object) -> None:
        raise RuntimeError("two\nlines \x1b[31m[/red]")

    monkeypatch.setattr(show, "schema", fail)
    done = massprop(*SCHEMA)
    assert done == (1, "", "massprop: internal failure: RuntimeError: two\\nlines \\x1b[31m[/red]\n")


def test_without_arguments_there_is_help_alone(massprop: Massprop) -> None:
    done = massprop()
    assert (done.status, done.err) == (2, "")
    assert "Usage: " in done.out


def test_a_record_whose_name_is_no_text_is_refused_before_the_work(
    tmp_path: Path, short_scenario: Scenario, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("fl\udcffght.csv").write_text("time_s\n0\n", encoding="utf-8")
    for name in ("fl\udcffght.csv", "a\0b.csv"):
        with pytest.raises(InputError, match=r"no text in this system's encoding|the character NUL"):
            estimate(name, short_scenario)
