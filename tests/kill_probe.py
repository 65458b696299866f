"""Kills commands at random moments and looks at what they leave: python kill_probe.py FOLDER SEED COUNT.

Commands run in forks of this process, which has everything imported, so that a kill costs no start. A child is killed
after a random time, or at a chosen file operation: just before the k-th of its audit events that touch files. The
faults that were found are printed as JSON, with the number of those that were killed before their end.
"""

from __future__ import annotations

import contextlib
import importlib
import json
import os
import random
import shutil
import signal
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from massprop_drake import Run, load_scenario
from massprop_drake.cli.main import main
from massprop_drake.display import flight3d
from massprop_drake.results import exchange, manifest
from massprop_drake.runners import simulate
from reproduction import __main__ as program

EVENTS = {"open", "os.rename", "os.mkdir", "os.remove", "os.rmdir", "os.scandir", "fcntl.flock", "ctypes.dlsym"}
SHORT = "duration_s=1"
LEAN = ("--no-figures", "--no-report", "-q")
Child = Callable[[], None]


class Trial(NamedTuple):
    """A command to be killed.

    Attributes:
        child: the command.
        there: whether its target holds an earlier run.
        other: a second command on the same folder, which is not killed.
    """

    child: Child
    there: bool = True
    other: Child | None = None


def massprop(*arguments: str, run: Child = main) -> Child:
    """The command line as a function."""

    def call() -> None:
        sys.argv = ["massprop", *arguments]
        run()

    return call


def run(seed: int, *options: str) -> Child:
    """`massprop run` into the folder K."""
    return massprop("run", "sample_maneuver", "--set", SHORT, "--seed", str(seed), "--out", "K", *LEAN, *options)


def two_renames(child: Child) -> Child:
    """The same where the system cannot exchange folders."""

    def call() -> None:
        exchange.swapped = lambda *_: False  # type: ignore[assignment]
        child()

    return call


ESTIMATE = massprop("estimate", "flight.csv", "--vehicle", "orbiter", "--out", "K", *LEAN)
REPRODUCE = massprop("--only", "fig_1_1", "--out", "R", "-q", run=partial(main, program.load, program.NAME))
TRIALS = {
    "run": Trial(run(1)),
    "run anew": Trial(run(1), there=False),
    "run by two renames": Trial(two_renames(run(1))),
    "run with force": Trial(run(1, "--force")),
    "estimate": Trial(ESTIMATE),
    "view": Trial(massprop("view", "K", "-q")),
    "view elsewhere": Trial(massprop("view", "K", "--out", "page.html", "-q")),
    "reproduce": Trial(REPRODUCE),
    "two writers": Trial(run(1), other=run(2)),
    "two writers anew": Trial(run(1), there=False, other=ESTIMATE),
}


class Prober:
    """Runs trials below a folder, and collects their faults."""

    def __init__(self, folder: Path, seed: int):
        for name in ("massprop_drake.runners.recorded", "massprop_drake.display.page", "reproduction.reproduce"):
            importlib.import_module(name)  # which commands load late
        self._folder = folder
        self._random = random.Random(seed)
        self._runs = {
            number: simulate.simulate(load_scenario("sample_maneuver", [SHORT, f"seed={number}"]))
            for number in (0, 1, 2)
        }
        self._earlier = self._runs[0].save(folder / "earlier", pictures=False, report=True)
        self._spans: dict[str, tuple[float, int]] = {}
        self.faults: list[str] = []
        self.killed = 0

    def trial(self, number: int) -> None:
        """Kills one command, looks at what is left, starts another one, and looks again."""
        name = list(TRIALS)[number % len(TRIALS)]
        trial = TRIALS[name]
        duration_s, events = self._span(name)
        timed = number % 3 == 2  # the others end at the operation that is asked for, however busy the machine
        delay_s, event = self._random.uniform(0.0, duration_s), self._random.randint(1, events)
        with self._place(f"{number}", trial) as here:
            victim = self._start(trial.child, here, 0 if timed else event, real=timed)
            other = self._start(trial.other, here, 0, real=False) if trial.other else None
            if timed:
                time.sleep(delay_s)
                os.kill(victim, signal.SIGKILL)
            self.killed += os.WIFSIGNALED(os.waitpid(victim, 0)[1])
            if other:
                os.waitpid(other, 0)
            told = f"{number} {name} " + (
                f"after {delay_s:.3f} of {duration_s:.3f} s" if timed else f"at event {event} of {events}"
            )
            self._look(here, told, trial, name)
            reads = name != "reproduce" and self._random.random() < 0.5
            again = _read if reads else trial.child
            before = self._seeds(here)
            status = os.waitstatus_to_exitcode(os.waitpid(self._start(again, here, 0, real=False), 0)[1])
            if status:
                self.faults.append(f"{told}: the next start ends with {status}")
            self._look(here, f"{told}, next start", trial, name, tidy=True)
            if trial.other and again is _read and not self._seeds(here) >= before:
                self.faults.append(f"{told}: a reader has lost a result")
            if trial.other and not before & ({2} if name == "two writers" else {-1}):
                self.faults.append(f"{told}: the result of the one that was not killed is lost")

    def _span(self, name: str) -> tuple[float, int]:
        """How long a command takes, and in how many file operations, when it is not killed."""
        if name not in self._spans:
            with self._place("whole", TRIALS[name]) as here:
                counted = here.parent / "events"
                began = time.perf_counter()
                os.waitpid(self._start(TRIALS[name].child, here, 0, real=True, counted=counted), 0)
                self._spans[name] = time.perf_counter() - began, int(counted.read_text())
        return self._spans[name]

    @contextlib.contextmanager
    def _place(self, name: str, trial: Trial) -> Any:
        here = self._folder / name
        here.mkdir()
        (here / "notes.txt").write_text("mine")
        shutil.copy(self._earlier / "telemetry.csv", here / "flight.csv")
        if trial.there:
            shutil.copytree(self._earlier, here / "K")
        yield here
        shutil.rmtree(here)

    def _start(self, child: Child, here: Path, event: int, *, real: bool, counted: Path | None = None) -> int:
        process = os.fork()
        if process:
            return process
        status = 1
        try:
            os.chdir(here)
            null = os.open(os.devnull, os.O_WRONLY)
            os.dup2(null, 1)
            if "KILL_PROBE_LOUD" not in os.environ:
                os.dup2(null, 2)
            if not real:
                simulate.simulate = lambda case, **_: self._runs[case.seed]  # type: ignore[assignment]
                flight3d.replay_html = lambda _: "<!DOCTYPE html>" + "replay" * 1000  # type: ignore[assignment]
            seen = _count(event, str(here))
            try:
                child()
                status = 0
            except SystemExit as end:
                status = int(end.code or 0)
            if counted is not None:
                counted.write_text(str(seen[0]))
        finally:
            os._exit(status)

    def _look(self, here: Path, told: str, trial: Trial, name: str, *, tidy: bool = False) -> None:
        """Every folder is whole, nothing of others is gone, and after a next start nothing hidden is left."""
        if (here / "notes.txt").read_text() != "mine" or not (here / "flight.csv").exists():
            self.faults.append(f"{told}: a user's file is lost")
        two = name == "run by two renames"  # which needs the next start
        if trial.there and not (here / "K").exists() and (tidy or not (two or name == "run with force")):
            self.faults.append(f"{told}: the earlier run is gone")
        for folder in sorted(path for path in here.iterdir() if path.name[0] == "K"):
            found = manifest.read(folder)
            strange = [*manifest.foreign(folder, found)]
            if name == "view" and not tidy:
                strange = [entry for entry in strange if not entry.startswith(".massprop-")]
            missing = [] if found is None else [entry for entry in found.files if not (folder / entry).exists()]
            if found is None or strange or missing:
                self.faults.append(f"{told}: {folder.name} is not whole: {strange} {missing}")
        if tidy:
            hidden = [str(path.relative_to(here)) for path in here.rglob(".massprop-*")]
            if hidden:
                self.faults.append(f"{told}: hidden: {hidden}")
        if name == "run with force" and 0 not in self._seeds(here):
            self.faults.append(f"{told}: the run that was to be kept is lost")
        for path in [*here.glob("R/*.json"), *here.glob("page.html")]:
            if not _is_whole(path):
                self.faults.append(f"{told}: {path.name} is not whole")

    def _seeds(self, here: Path) -> set[int]:
        """Which results are there: seeds of runs, -1 for an estimate."""
        found = set()
        for folder in here.glob("K*"):
            with contextlib.suppress(OSError):
                summary = json.loads((folder / "summary.json").read_text())
                found.add(-1 if "data_quality" in summary else summary["seed"])
        return found


def _count(event: int, here: str) -> list[int]:
    """Counts the file operations of this process from now on, and kills it at one of them."""
    seen = [0]

    def heard(name: str, arguments: tuple[Any, ...]) -> None:
        if name not in EVENTS or (name == "open" and not str(arguments[0]).startswith((here, "K", "R", "page"))):
            return
        seen[0] += 1
        if seen[0] == event:
            os.kill(os.getpid(), signal.SIGKILL)

    sys.addaudithook(heard)
    return seen


def _read() -> None:
    """A next start that only reads."""
    exchange.recover(Path("K/summary.json"))
    if Path("K").exists():
        Run.load("K")


def _is_whole(path: Path) -> bool:
    if path.suffix == ".json":
        return bool(json.loads(path.read_text()))
    return manifest.sealed_kind(path) is not None


if __name__ == "__main__":
    prober = Prober(Path(sys.argv[1]), int(sys.argv[2]))
    for index in range(int(sys.argv[3])):
        prober.trial(index)
    sys.stdout.write(json.dumps({"killed": prober.killed, "faults": prober.faults}))
