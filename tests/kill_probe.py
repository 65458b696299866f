"""Kills commands at random file operations and looks at what they leave: python kill_probe.py FOLDER SEED COUNT.

Commands run in forks of this process, which has everything imported, so that a kill costs no start. A child is killed
just before the k-th of its audit events that touch files. The faults that were found are printed as JSON, with the
number of those that were killed before their end.
"""

from __future__ import annotations

import importlib
import json
import os
import random
import shutil
import signal
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from massprop_drake import Run, load_scenario
from massprop_drake.cli.main import main
from massprop_drake.display import flight3d
from massprop_drake.results import exchange, manifest
from massprop_drake.runners import simulate
from reproduction import __main__ as program

EVENTS = {"open", "os.rename", "os.mkdir", "os.remove", "os.rmdir", "os.scandir", "fcntl.flock", "ctypes.dlsym"}
SECOND = ("duration_s=1", "execution.engine=loop")
LEAN = ("--no-figures", "--no-report", "-q")
Child = Callable[[], None]


def massprop(*arguments: str, run: Child = main) -> Child:
    """The command line as a function."""

    def call() -> None:
        sys.argv = ["massprop", *arguments]
        run()

    return call


def two_renames(child: Child) -> Child:
    """The same where the system cannot exchange folders."""

    def call() -> None:
        vars(exchange)["swapped"] = lambda *_: False
        child()

    return call


RUN = ("run", "sample_maneuver", "--set", "duration_s=1", "--out", "K", *LEAN, "--seed", "1")
OTHER = massprop(*RUN[:-1], "2")
ANEW = "run anew"  # where no earlier run is
TRIALS: dict[str, Child] = {
    "run": massprop(*RUN),
    ANEW: massprop(*RUN),
    "run by two renames": two_renames(massprop(*RUN)),
    "run with force": massprop(*RUN, "--force"),
    "two writers": massprop(*RUN),
    "view": massprop("view", "K", "-q"),
    "view elsewhere": massprop("view", "K", "--out", "page.html", "-q"),
    "estimate": massprop("estimate", "flight.csv", "--vehicle", "orbiter", "--out", "K", *LEAN),
    "reproduce": massprop("--only", "fig_1_1", "--out", "R", "-q", run=partial(main, program.load, program.NAME)),
}


class Prober:
    """Runs trials below a folder, and collects their faults."""

    def __init__(self, folder: Path, seed: int):
        for name in ("massprop_drake.runners.recorded", "massprop_drake.display.page", "reproduction.reproduce"):
            importlib.import_module(name)  # which commands load late
        self._folder, self._random = folder, random.Random(seed)
        short = [load_scenario("sample_maneuver", [*SECOND, f"seed={seed}"]) for seed in range(3)]
        self._runs = [simulate.simulate(one) for one in short]
        self._earlier = self._runs[0].save(folder / "earlier", pictures=False, report=True)
        self._counts: dict[str, int] = {}
        self.faults: list[str] = []
        self.killed = 0

    def trial(self, number: int) -> None:
        """Kills one command, looks at what is left, starts another one, and looks again."""
        name = list(TRIALS)[number % len(TRIALS)]
        if name not in self._counts:
            here = self._place("whole", name)
            _ended(self._start(TRIALS[name], here, 0, counted=here.parent / "events"))
            self._counts[name] = int((here.parent / "events").read_text())
            shutil.rmtree(here)
        event = self._random.randint(1, self._counts[name])
        told, here = f"{number} {name} at event {event} of {self._counts[name]}", self._place(str(number), name)
        victim = self._start(TRIALS[name], here, event)
        other = self._start(OTHER, here, 0) if name == "two writers" else 0
        self.killed += _ended(victim) == -signal.SIGKILL
        if other:
            _ended(other)  # which may refuse to replace what the first has put there, and then keeps its result beside
            if 2 not in _seeds(here):
                self.faults.append(f"{told}: the result of the one that was not killed is lost")
        self._look(here, told, name)
        again = _read if name != "reproduce" and self._random.random() < 0.5 else TRIALS[name]
        status = _ended(self._start(again, here, 0))
        if status:
            self.faults.append(f"{told}: the next start ends with {status}")
        self._look(here, f"{told}, next start", name, tidy=True)
        shutil.rmtree(here)

    def _place(self, number: str, name: str) -> Path:
        here = self._folder / number
        here.mkdir()
        (here / "notes.txt").write_text("mine")
        shutil.copy(self._earlier / "telemetry.csv", here / "flight.csv")
        if name != ANEW:
            shutil.copytree(self._earlier, here / "K")
        return here

    def _start(self, child: Child, here: Path, event: int, counted: Path | None = None) -> int:
        """Starts a child, which is killed at an event, 0: at none; returns its number."""
        process = os.fork()
        if process:
            return process
        status = 1
        try:
            os.chdir(here)
            null = os.open(os.devnull, os.O_WRONLY)
            os.dup2(null, 1)
            os.dup2(null, 2)
            vars(simulate)["simulate"] = lambda case, **_: self._runs[case.seed]
            vars(flight3d)["replay_html"] = lambda _: "<!DOCTYPE html>" + "replay" * 1000
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

    def _look(self, here: Path, told: str, name: str, *, tidy: bool = False) -> None:
        """Every folder is whole, nothing of others is gone, and after a next start nothing hidden is left."""
        if (here / "notes.txt").read_text() != "mine" or not (here / "flight.csv").exists():
            self.faults.append(f"{told}: a user's file is lost")
        needs_next = name in ("run by two renames", "run with force", ANEW)
        if not (here / "K").exists() and (name != ANEW if tidy else not needs_next):
            self.faults.append(f"{told}: the earlier run is gone")
        for folder in sorted(here.glob("K*")):
            found = manifest.read(folder)
            strange = [
                one for one in manifest.foreign_entries(folder, found) if tidy or not one.startswith(".massprop-")
            ]
            missing = [] if found is None else [entry for entry in found.files if not (folder / entry).exists()]
            if found is None or missing or (strange and (tidy or name != "view")):
                self.faults.append(f"{told}: {folder.name} is not whole: {strange} {missing}")
        if name == "run with force" and 0 not in _seeds(here):
            self.faults.append(f"{told}: the run that was to be kept is lost")
        hidden = [str(path.relative_to(here)) for path in here.rglob(".massprop-*")]
        if tidy and hidden:
            self.faults.append(f"{told}: hidden: {hidden}")
        pages = [path for path in here.glob("page.html") if manifest.sealed_kind(path) is None]
        if pages or not all(json.loads(path.read_text()) for path in here.glob("R/*.json")):
            self.faults.append(f"{told}: a page or a result is not whole")


def _ended(process: int) -> int:
    return os.waitstatus_to_exitcode(os.waitpid(process, 0)[1])


def _seeds(here: Path) -> set[int]:
    """Seeds of the runs that are there."""
    return {json.loads(path.read_text())["seed"] for path in here.glob("K*/summary.json")}


def _count(event: int, here: str) -> list[int]:
    """Counts the file operations of this process from now on, and kills it at one of them."""
    seen = [0]

    def heard(name: str, arguments: tuple[Any, ...]) -> None:
        if name in EVENTS and (name != "open" or str(arguments[0]).startswith((here, "K", "R", "page"))):
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


if __name__ == "__main__":
    prober = Prober(Path(sys.argv[1]), int(sys.argv[2]))
    for index in range(int(sys.argv[3])):
        prober.trial(index)
    sys.stdout.write(json.dumps({"killed": prober.killed, "faults": prober.faults}))
