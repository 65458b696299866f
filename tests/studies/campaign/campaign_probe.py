"""What the tests of campaigns share: a short campaign, faults injected from outside, and looks at processes."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import psutil
import pyarrow as pa
import pytest
from once_probe import once

from massprop_drake.studies.campaign import store
from massprop_drake.studies.campaign.campaign import Campaign

# a second with a turn in it, and whatever can be drawn
SHORT = """\
name: short
base: sample_maneuver
seed: 3
set: {duration_s: 1.0, maneuver: [{controller: rhc, axis: +x, start_s: 0.1, end_s: 0.4}]}
times_s: [0.5]
keep: none
draw:
  plant.mass_properties: {mass_percent: 5, center_of_mass: 0.3, second_moments_percent: 3, axes_deg: 1}
  plant.thrust_dispersion: 0.01
  failures:
    - kind: {choice: [stuck_on, stuck_off, leak, degraded]}
      jet: {choice: all}
      start_s: {uniform: {low: 0.1, high: 0.5}}
      force: {loguniform: {low: 5, high: 200}}
"""
CASES = 13
GOOD = 10  # the first cases of which none is bad
BAD = {10: "segfault", 11: "eat", 12: "raise"}
LIMITS = "{time_s: 600, memory_mb: 800}"  # no machine is so busy that a good case takes longer

# Python runs this at the start of every process; it is about those alone that fly cases. What a case does wrong is
# asked for by its number, how long every case takes besides by the environment.
_SITE = """
import sys
if sys.orig_argv[-1].endswith("studies.campaign.child"):
    import json, os, platform, time
    version = platform.python_version()
    platform.python_version = lambda: os.environ.get("PROBE_PYTHON", version)
    from massprop_drake.runners import simulate as module
    bad, slow, right = json.loads(os.environ["PROBE_BAD"]), float(os.environ["PROBE_SLOW_S"]), module.simulate

    def simulate(scenario, **options):
        time.sleep(slow)
        print("words on standard output")
        what = bad.get(str(int(scenario.name.rpartition("_")[2])))
        if what == "segfault":
            import ctypes
            ctypes.string_at(0)
        while what == "hang":
            time.sleep(1.0)
        eaten = []
        while what == "eat":
            eaten.append(b"x" * 50_000_000)
            time.sleep(0.02)
        if what == "raise":
            raise ArithmeticError("no number")
        return right(scenario, **options)

    module.simulate = simulate
"""


def environment(folder: Path, *, bad: dict[int, str] | None = None, slow_s: float = 0.0) -> dict[str, str]:
    """Variables by which the processes that fly cases do wrong.

    Args:
        folder: for what Python loads at its start.
        bad: what is wrong with a case, by its number.
        slow_s: what every case takes longer, s.
    """
    folder.mkdir(exist_ok=True)
    (folder / "sitecustomize.py").write_text(_SITE, encoding="utf-8")
    return {"PYTHONPATH": str(folder), "PROBE_BAD": json.dumps(bad or {}), "PROBE_SLOW_S": str(slow_s)}


def study(folder: Path, cases: int, text: str = SHORT, more: str = "") -> Path:
    """Writes the short campaign's file."""
    path = folder / "short.yaml"
    path.write_text(f"{text}cases: {cases}\nlimits: {LIMITS}\n{more}", encoding="utf-8")
    return path


def outcome(folder: Path, cases: int | None = None) -> pa.Table:
    """All that depends on the cases alone, of the first of them."""
    rows = store.read_rows(folder)
    assert rows is not None
    kept = rows.drop_columns(list(store.CIRCUMSTANCES))
    return kept if cases is None else kept.slice(0, cases)


def row(folder: Path, case_id: int) -> dict[str, Any]:
    """One row, without its circumstances."""
    [found] = outcome(folder).slice(case_id, 1).to_pylist()
    assert found["case_id"] == case_id
    return dict(found)


def fly_once(shared: Path) -> Path:
    """The folder of a short campaign of which three cases fail to run, flown by two workers; change nothing in it."""

    def fly(folder: Path) -> None:
        with pytest.MonkeyPatch.context() as patch:
            for name, value in {**environment(shared / "faulty", bad=BAD), "PROBE_MARK": f"flown-{shared}"}.items():
                patch.setenv(name, value)
            Campaign.load(study(shared, CASES)).run(folder)

    return once(shared / "flown", fly)


# ------------------------------------------------------------------------------------- processes


def offspring(marker: str) -> list[psutil.Process]:
    """Every living process whose environment holds a word, whoever its parent is; not the tracker of Python's own."""
    found = []
    for process in psutil.process_iter():
        try:
            own = process.pid == os.getpid() or any("resource_tracker" in word for word in process.cmdline())
            if process.status() != psutil.STATUS_ZOMBIE and marker in process.environ().values() and not own:
                found.append(process)
        except psutil.Error:
            continue
    return found


def are_gone(marker: str) -> bool:
    """Tells that no process of a word is left, once it is so; one that stays is for the limit that every test has."""
    while offspring(marker):
        time.sleep(0.1)
    return True


def fliers(marker: str) -> list[psutil.Process]:
    """The processes of a word that fly cases."""
    return [process for process in offspring(marker) if process.cmdline()[-1:] == [CHILD]]


CHILD = "massprop_drake.studies.campaign.child"

_DRIVER = """
import json, signal, sys
signal.signal(signal.SIGINT, signal.default_int_handler)
from massprop_drake.studies.campaign.campaign import Campaign
from massprop_drake.errors import InputError

def wait(done, total):
    print("at", done, total, flush=True)
    if not sys.stdin.readline():
        sys.exit("nobody asks")

options = json.loads(sys.argv[3])
try:
    run = Campaign.load(sys.argv[1]).run(sys.argv[2], progress=wait, **options)
except KeyboardInterrupt:
    print("interrupted", flush=True)
except InputError as error:
    print("refused", error, flush=True)
else:
    print("ended", flush=True)
"""


class Driver:
    """A process of its own that flies a campaign, and waits for a word after each chunk.

    Args:
        file: of the campaign.
        folder: to fly in.
        environ: besides this process's; PROBE_MARK marks it and all that it starts.
        **options: of `Campaign.run`.
    """

    def __init__(self, file: Path, folder: Path, environ: dict[str, str], **options: Any):
        self._process = subprocess.Popen(
            [sys.executable, "-c", _DRIVER, str(file), str(folder), json.dumps(options)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            env={**os.environ, **environ},
            start_new_session=True,
            text=True,
        )
        self.pid = self._process.pid
        self.said = ""

    def line(self) -> str:
        """The next line that it says; empty at its end."""
        assert self._process.stdout is not None
        self.said = self._process.stdout.readline().strip()
        return self.said

    def go_on(self) -> None:
        """Lets it take the next chunk."""
        assert self._process.stdin is not None
        self._process.stdin.write("on\n")
        self._process.stdin.flush()

    def to_the_end(self) -> str:
        """Lets it go on until it says something else than how far it is."""
        while self.line().startswith("at"):
            self.go_on()
        return self.said

    def send(self, signal: int, *, group: bool = False) -> None:
        """Sends it a signal, or, as a terminal does, its group."""
        (os.killpg if group else os.kill)(self.pid, signal)

    def ended(self) -> tuple[int, str]:
        """Its status and what it said on standard error, once it has ended."""
        _, errors = self._process.communicate()
        return self._process.returncode, errors
