"""Malformed input of every kind that the command line reads, made from sound one by a number; and a verdict on each.

A case is a function of its kind and number alone: the same damage to the same sound files.
"""

from __future__ import annotations

import copy
import io
import json
import os
import random
import shutil
import signal
import sys
import warnings
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from conftest import cube_data
from ruamel.yaml import YAML
from telemetry_probe import Log

from massprop_drake import Run, estimate, load_scenario, simulate
from massprop_drake.cli import main as cli
from massprop_drake.inputs.model import yaml_text
from massprop_drake.inputs.vehicle_file import load_vehicle
from massprop_drake.inputs.yaml import to_yaml
from massprop_drake.results.manifest import sealed_kind

LONGEST_S = 5.0  # of computing, for one case
LONG = -2  # in place of the status of a run that asks for more than that
QUIET = ["--no-figures", "--no-report"]

NUMBERS: list[Any] = [
    *(0, 1, -1, 3, 2**31, 2**63, 2**70, -(2**63), 10**400, 0.0, -0.0, 0.5, -1.0, 1e-3, 1e-9, 5e-324, 1e-300, 1e-150),
    *(10.0, 1e4, 1e6, 1e9, 1e15, 1e30, 1e154, 1e300, 1.7e308, float("nan"), float("inf"), float("-inf")),
]
WORDS: list[Any] = [
    *("", " ", "x", "gyro", "time_s", "jet_J1", "J1 ", "nominal", "null", "true", "1e3", "nan", "\u0663", "e\u0301"),
    *("\u202eabc", "\x07", "a\nb", "[/red]", "{x}", "%s%n", "</script><script>alert(1)</script>", "../../etc/passwd"),
    *("/dev/null", "a" * 5000, "😀" * 20, "\ufeff", "\ud7ff", "a,b", '"', "*alias", "!!python/object:os.system"),
]
OTHERS: list[Any] = [
    *(None, True, [], {}, [[]], [None], {"": None}, [1.0, 2.0, 3.0], ["x"] * 3, {"kind": "x"}, [{}], [[0.0] * 3] * 3),
    [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
]
# what YAML and JSON have beyond data: each stands in place of a value
TOKENS = [
    *("!!bool maybe", "!!timestamp xx", "!!int x", "!!binary ?", "!!set {a}", "!!omap [a]", "!x y", "!!map x", "*a"),
    *("!!python/name:os.system", "&a [*a]", "<<", "{<<: {a: 1}}", "? a", ": ", "|", "|\n  text", "@x", "#", "[1, 2"),
    *('"open', "1_000", "0o17", "1:30", "2020-01-01", "1e400", ".nan", "~", "NaN", "\t", "\x00", "\u2028", "---"),
    *("--- a\n--- b", "[" * 60 + "]" * 60, "9" * 5000, "{[a]: 1}", "{a: 1, a: 2}"),
]
CELLS = [
    *("", "nan", "inf", "-", "x", "1e400", "1e308", "1e16", "1e5", "-1", "50", "0.5", "5e-324", "-0", "1_0", "\u0663"),
    *('"a', "1,1", "\0", "0x1", " 1 ", "1 1", "NULL", ".5", "+1", "1e", "\u22121", "9" * 5000),
]
HEADINGS = ["time_s", "gyro_x", "jet_J1", "jet_", "", " ", "known_force_x", "acc_accel_x", "GYRO_X", "é", "\x1b[31m"]

Place = tuple[str | int, ...]


def nasty(rng: random.Random, before: Any = None) -> Any:
    """A value of no good, often a number where a number was."""
    if isinstance(before, (int, float)) and not isinstance(before, bool) and rng.random() < 0.8:
        if rng.random() < 0.3 and abs(before) < 1e100:
            return type(before)(before * rng.choice([-1.0, 1e-12, 1e-6, 0.1, 1.001, 10.0, 1e3, 1e12]))
        return rng.choice(NUMBERS)
    return copy.deepcopy(rng.choice(WORDS if isinstance(before, str) else [*NUMBERS, *WORDS, *OTHERS]))


def picked(data: Any, rng: random.Random) -> tuple[Any, Any, Any]:
    """A random place of a mapping, each level as likely as the many values of a matrix: holder, key and value."""
    holder = key = None
    here = data
    while isinstance(here, (dict, list)) and here and (holder is None or rng.random() < 0.8):
        holder, key = here, rng.choice(list(here)) if isinstance(here, dict) else rng.randrange(len(here))
        here = holder[key]
    return holder, key, here


def spoil_data(data: Any, rng: random.Random) -> None:
    """Damages nested data in place."""
    here, last, value = picked(data, rng)
    match rng.randrange(10):
        case _ if here is None:
            return
        case 0:
            del here[last]
        case 1 if isinstance(here, dict):
            here[rng.choice([f"{last}x", *WORDS])] = here.pop(last)
        case 1:
            here.extend(copy.deepcopy(here[-1:]) * rng.choice([1, 2, 50]))
        case 2:
            here[last] = copy.deepcopy(picked(data, rng)[2])
        case _:
            here[last] = nasty(rng, value)


def spoil_text(text: str, rng: random.Random) -> bytes:
    """Damages text, as words or as bytes."""
    if rng.random() < 0.5:  # a token in place of a value
        lines = text.split("\n")
        row = rng.randrange(len(lines))
        head, colon, _ = lines[row].partition(":")
        lines[row] = f"{head}{colon} {rng.choice(TOKENS)}" if colon and rng.random() < 0.8 else rng.choice(TOKENS)
        text = "\n".join(lines)
    data = encoded(text, rng)
    return spoil_bytes(data, rng) if rng.random() < 0.6 else data


def encoded(text: str, rng: random.Random) -> bytes:
    return text.encode(rng.choice(["utf-8"] * 9 + ["utf-8-sig", "utf-16", "latin-1"]), errors="replace")


def spoil_bytes(content: bytes, rng: random.Random) -> bytes:
    """Damages bytes: some replaced, a stretch gone or twice, cut short."""
    data = bytearray(content)
    for _ in range(rng.choice([1, 1, 20]) if data else 0):
        place, length = rng.randrange(len(data) or 1), rng.choice([1, 10, 1000])
        odd = rng.choice([rng.randbytes(1), b"\0", b"\xff", b"\xc3", b"\r", b"\n", b"\x1b", b"\xef\xbb\xbf"])
        match rng.randrange(5):
            case 0:
                data[place : place + 1] = odd
            case 1:
                del data[place : place + length]
            case 2:
                data[place:place] = data[place : place + length]
            case 3:
                data[place:place] = odd
            case _:
                del data[place:]
    return bytes(data)


SCENARIO = """
name: sound
vehicle: vehicle.yaml
duration_s: 1.0
maneuver: [{controller: rhc, axis: +x, start_s: 0.2, end_s: 0.7}, {controller: thc, axis: -z, start_s: 0.3, end_s: 0.9}]
sensors: {errors: [{sensor: gyro, noise_std: 1.0e-6, bias: [1.0e-6, 0.0, 0.0], delay_samples: 1}]}
estimation: {thrust_uncertainty: 0.02}
failures:
  - {kind: stuck_on, jet: J3, start_s: 0.5}
  - {kind: leak, jet: J4, start_s: 0.2, end_s: 0.6, force: 1.0}
jumps: [{kind: dock, time_s: 0.8, mass: 1.0, position: [0.1, 0.0, 0.0]}]
"""
SCHEDULED = """
name: scheduled
vehicle: vehicle.yaml
duration_s: 1.0
jet_schedule: [{jet: J1, start_s: 0.1, end_s: 0.6}, {jet: J5, start_s: 0.3, end_s: 0.9}]
plant: {time_step: 0}
estimation:
  start: given
  given: {standard_deviation: [1.0e-3, 1.0e-3, 1.0e-3, 1.0e-4, 1.0e-4, 1.0e-4, 0.2, 0.2, 0.2, 2.0e-3]}
"""
CAMPAIGN = """
name: drawn
base: sample_maneuver
cases: 3
seed: 4
set: {duration_s: 3.0}
draw:
  plant.mass_properties: {mass_percent: 5.0, center_of_mass: 0.3, second_moments_percent: 3.0, axes_deg: 1.0}
  plant.initial_rate: [{normal: {std: 0.001, low: -0.01, high: 0.01}}, 0.0, {loguniform: {low: 1e-5, high: 1}}]
  failures: [{kind: {choice: [leak, stuck_on]}, jet: {choice: all}, start_s: 1.0, force: 5.0}]
sweep: {detector.margin: [4.0, 6.0]}
gates: {nees_in_band: {min: 0.9, on: lower_bound}}
limits: {time_s: 60.0, memory_mb: 1000.0}
"""


def loaded(text: str) -> Any:
    return YAML(typ="safe", pure=True).load(text)


class Sound:
    """Sound files of every kind, written once."""

    def __init__(self, folder: Path):
        self.folder, self.vehicle = folder, cube_data()
        self.vehicle["jet_kinds"]["primary"]["time_constant_s"] = 0.02
        self.vehicle["gyros"].append({"name": "gyro2", "quantum": 1e-6, "noise_std": 1e-6, "range": 1.0})
        self.vehicle["shape"] = [{"kind": "box", "size": [1.0, 1.0, 1.0]}]
        (folder / "vehicle.yaml").write_text(to_yaml(self.vehicle), encoding="utf-8")
        for name, text in (("sound", SCENARIO), ("scheduled", SCHEDULED), ("campaign", CAMPAIGN)):
            (folder / f"{name}.yaml").write_text(text, encoding="utf-8")
        full = simulate(load_scenario(folder / "sound.yaml"))
        full.save(folder / "run", pictures=False)
        self.scenarios = [loaded(text) for text in (SCENARIO, SCHEDULED, yaml_text(full.scenario))]
        vehicle = load_vehicle(folder / "vehicle.yaml")
        self.log = Log(vehicle, n_rows=40)
        self.log.write(folder / "log.csv")
        Log(vehicle, n_rows=20).write(folder / "first.csv")
        estimate(folder / "first.csv", load_scenario(folder / "run")).save(folder / "estimated", pictures=False)


class Case(NamedTuple):
    """Arguments of the command, and its standard input."""

    arguments: list[str]
    stdin: bytes = b""


OUT = ["--out", "out", *QUIET]


def write_spoilt(path: Path, data: Any, rng: random.Random) -> None:
    data = copy.deepcopy(data)
    if rng.random() < 0.25:
        path.write_bytes(spoil_text(to_yaml(data), rng))
        return
    for _ in range(rng.choice([1, 1, 2])):
        spoil_data(data, rng)
    for key, longest in (("duration_s", 1.0), ("cases", 3)):
        if isinstance(data.get(key), (int, float)) and 2 * longest < data[key] <= 1e6:  # sound, and long
            data[key] = longest
    path.write_bytes(to_yaml(data).encode("utf-8", errors="replace"))


def vehicle_case(rng: random.Random, sound: Sound, here: Path) -> Case:
    write_spoilt(here / "vehicle.yaml", sound.vehicle, rng)
    runs = [["run", f"{name}.yaml", *OUT] for name in ("sound", "scheduled")]
    return Case(
        rng.choice([["check", "vehicle.yaml"], *runs, ["estimate", "log.csv", "--vehicle", "vehicle.yaml", *OUT]])
    )


def scenario_case(rng: random.Random, sound: Sound, here: Path) -> Case:
    write_spoilt(here / "case.yaml", rng.choice(sound.scenarios), rng)
    like = ["estimate", "log.csv", "--like", "case.yaml", *OUT]
    return Case(rng.choice([["check", "case.yaml"], ["run", "case.yaml", *OUT], like]))


def campaign_case(rng: random.Random, sound: Sound, here: Path) -> Case:
    write_spoilt(here / "campaign.yaml", loaded(CAMPAIGN), rng)
    return Case(rng.choice([["check", "campaign.yaml"], ["campaign", "plan", "campaign.yaml", "--out", "out"]]))


def csv_case(rng: random.Random, sound: Sound, here: Path) -> Case:
    log = copy.deepcopy(sound.log)
    for _ in range(rng.choice([0, 1, 1, 2])):
        spoil_table(log.header, log.rows, rng)
    data = encoded(log.text().replace(",", rng.choice([",", ",", ",", ";", "\t", "|"])), rng)
    data = spoil_bytes(data, rng) if rng.random() < 0.3 else data
    if rng.random() < 0.3:
        return Case(["estimate", "-", "--like", "run", *OUT], data)
    (here / "log.csv").write_bytes(data)
    vehicle = ["--vehicle", "vehicle.yaml"]
    how = (vehicle, ["--like", "run"], ["--like", "run", "--start", "zero"], ["--resume-from", "run"])
    estimates = [["estimate", "log.csv", *options, *OUT] for options in how]
    return Case(rng.choice([["check", "log.csv"], ["check", "log.csv", *vehicle], *estimates]))


def spoil_table(header: list[str], rows: list[list[str]], rng: random.Random) -> None:
    row, column = rng.randrange(max(len(rows), 1)), rng.randrange(max(len(header), 1))
    match rng.randrange(8):
        case 0 if rows and column < len(rows[row]):
            rows[row][column] = rng.choice(CELLS)
        case 1:
            del rows[row : row + rng.choice([1, 12, 100])]
        case 2 if rows:
            rows[row:row] = [list(rng.choice(rows))] * rng.choice([1, 30])
        case 3 if rows:
            del rows[row][column:]
        case 4 if header:
            header[column] = rng.choice(HEADINGS)
        case 5 | 6:
            texts = [] if rng.random() < 0.5 else [rng.choice(CELLS)]
            for cells in rows if texts else [header, *rows]:
                cells[column : column + 1] = texts
        case _:
            rows.reverse()


def folder_case(rng: random.Random, sound: Sound, here: Path) -> Case:
    folder = rng.choice(["run", "estimated"])
    path = here / folder / rng.choice(["scenario.yaml", "summary.json", "history.npz", "filter_state.json"])
    if path.suffix == ".npz":
        spoil_archive(path, rng)
    elif path.suffix == ".json" and rng.random() < 0.8:
        data = json.loads(path.read_text(encoding="utf-8"))
        spoil_data(data, rng)
        path.write_text(json.dumps(data), encoding="utf-8")
    else:
        path.write_bytes(spoil_text(path.read_text(encoding="utf-8"), rng))
    option = {"filter_state.json": "--resume-from", "scenario.yaml": "--like"}.get(path.name)
    if option:
        return Case(["estimate", "log.csv", option, folder, *OUT])
    return Case(["view", folder, *rng.choice([[], ["--out", "page.html"]])])


def spoil_archive(path: Path, rng: random.Random) -> None:
    if rng.random() < 0.35:
        path.write_bytes(spoil_bytes(path.read_bytes(), rng))
        return
    with np.load(path) as archive:
        members: dict[str, Any] = dict(archive)
    name = rng.choice([*members, "time_s", "estimate"])
    array = members.pop(name)
    changed = [
        array[:-1] if array.ndim else array,
        array[..., None],
        np.full(array.shape, rng.choice([np.nan, np.inf, 1e308, -1.0])),
        np.zeros(array.shape, dtype=rng.choice(["<U5", "complex128", "bool", "S3", ">f8"])),
    ]
    if rng.random() < 0.8:
        members[rng.choice([name, name, "../x", "[/red]"])] = rng.choice(changed)
    np.savez(path, **members)


Maker = Callable[[random.Random, Sound, Path], Case]
KINDS: dict[str, Maker] = {
    **{"vehicle": vehicle_case, "scenario": scenario_case, "campaign": campaign_case, "csv": csv_case},
    "folder": folder_case,
}


class Hung(BaseException):
    """A case has computed for too long."""


class Verdict(NamedTuple):
    """What became of a case: its exit status, what is wrong about it ('' for nothing), and what it said."""

    status: int
    fault: str
    said: str
    arguments: list[str]


def judged(make: Maker, number: int, sound: Sound, here: Path) -> Verdict:
    """Makes a case in an empty folder, runs it through the command line and judges it."""
    shutil.copytree(sound.folder, here, dirs_exist_ok=True)
    case = make(random.Random(f"{make.__name__} {number}"), sound, here)
    before = contents(here)
    status, said, fault = called(case, here)
    return Verdict(status, fault or fault_of(status, said, before, here), said, case.arguments)


def contents(here: Path) -> dict[str, int]:
    """Every file below a folder, with what is in it."""
    return {str(path.relative_to(here)): hash(path.read_bytes()) if path.is_file() else 0 for path in here.rglob("*")}


def called(case: Case, here: Path) -> tuple[int, str, str]:
    """Status, both streams, and a fault."""
    streams = [io.TextIOWrapper(io.BytesIO(), encoding="utf-8", errors="backslashreplace") for _ in range(2)]
    saved = sys.argv, sys.stdin, sys.stdout, sys.stderr, Path.cwd()
    sys.argv, sys.stdin = ["massprop", *case.arguments], io.TextIOWrapper(io.BytesIO(case.stdin), encoding="utf-8")
    sys.stdout, sys.stderr = streams
    os.chdir(here)
    fault, status = "", -1

    def hung(*_: Any) -> None:
        raise Hung

    handler = signal.signal(signal.SIGPROF, hung)
    signal.setitimer(signal.ITIMER_PROF, LONGEST_S)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("default")
            status = cli.run()
    except Hung:
        status, fault = (LONG, "") if is_long(case, here) else (-1, "hung")
    except BaseException as error:
        fault = f"raised {type(error).__name__}: {error}"
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, handler)
        sys.argv, sys.stdin, sys.stdout, sys.stderr = saved[:4]
        os.chdir(saved[4])
    for stream in streams:
        stream.flush()
    return status, "".join(stream.buffer.getvalue().decode(errors="replace") for stream in streams), fault


def is_long(case: Case, here: Path) -> bool:
    """Whether more samples are asked for than can be flown in time: a damaged duration or period may still be one."""
    name, *rest = case.arguments[1:]
    if case.arguments[0] != "run":
        return False
    asked = load_scenario(here / name, [after for option, after in pairwise(rest) if option == "--set"])
    return asked.duration_s > 25 * asked.vehicle_data.sample_period_s


def fault_of(status: int, said: str, before: dict[str, int], here: Path) -> str:
    after = contents(here)
    if "Traceback" in said or status not in (0, 2, LONG):
        return f"status {status}"
    if status == 2 and len(said.strip()) < 20:
        return "no message"
    ours = ("report.html", "replay.html", "manifest.json")
    if changed := [name for name in before if after.get(name) != before[name] and Path(name).name not in ours]:
        return f"input changed: {changed}"
    new = {name for name in after if name not in before}
    pages = {name for name in new if name.endswith(".html") and not name.startswith("out/")}
    if strange := {name for name in new - pages if name != "out" and not name.startswith("out/")}:
        return f"left behind: {sorted(strange)}"
    if status == 2 and new and "out" not in new:
        return f"half-written: {sorted(new)}"
    for name in pages:
        if sealed_kind(here / name) is None and not (here / name).read_text(encoding="utf-8").endswith("</html>"):
            return f"half-written: {name}"
    if "out" in new and (here / "out" / "history.npz").exists():
        try:
            ended = Run.load(here / "out").results.ended
            json.loads((here / "out" / "filter_state.json").read_text(encoding="utf-8"))
        except Exception as error:
            return f"not whole: {type(error).__name__}: {error}"
        if (ended is not None) != (status == 2):
            return f"status {status}: {ended}"
    return ""
