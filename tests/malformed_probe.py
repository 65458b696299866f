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
import zipfile
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
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

# ------------------------------------------------------------------------------------- nasty things

NUMBERS: list[Any] = [
    *(0, 1, -1, 2, 3, 7, 100, 2**31, 2**53 + 1, 2**63, 2**70, -(2**63), 10**400),
    *(0.0, -0.0, 0.5, 1.5, -1.0, 1e-3, 1e-6, 1e-9, 1e-12, 5e-324, 2.2e-308, 1e-300, 1e-150, 1e-30),
    *(10.0, 1e3, 1e4, 1e5, 1e6, 1e9, 1e12, 1e15, 1e16, 1e30, 1e150, 1e154, 1e200, 1e300, 1.7e308),
    *(float("nan"), float("inf"), float("-inf")),
]
WORDS: list[Any] = [
    *("", " ", "x", "gyro", "time_s", "jet_J1", "J1", "J1 ", "j1", "primary", "toy", "nominal", "off", "none", "null"),
    *("true", "1", "1e3", "0x1", "nan", "\u0663", "é", "e\u0301", "\u202eabc", "\u200b", "\x07", "\x1b[31mred", "a\nb"),
    *("[/red]", "[bold]J", "{x}", "%s%n", "</script><script>alert(1)</script>", "../../etc/passwd", "/dev/null", "."),
    *("a" * 5000, "😀" * 20, "\ufeff", "\ud7ff", "a,b", '"', "'", "*alias", "&anchor", "!!python/object:os.system"),
]
OTHERS: list[Any] = [
    *(None, True, False, [], {}, [[]], [None], {"": None}, [1.0], [1.0, 2.0, 3.0], [0.0, 0.0, 0.0], ["x"] * 3),
    *([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], [[1e-9] * 3] * 3, [[0.0] * 3] * 3, {"kind": "x"}, [{}]),
]
# what YAML and JSON have beyond data: each stands in place of a value
TOKENS = [
    *("!!bool maybe", "!!timestamp xx", "!!int x", "!!float x", "!!binary ?", "!!set {a}", "!!omap [a]", "!x y"),
    *("!!null 1", "!!str [a]", "!!map x", "!!seq {a: 1}", "!!merge <<", "!!python/name:os.system", "!!timestamp 1"),
    *("*a", "&a [*a]", "&a 1", "<<", "{<<: {a: 1}}", "? a", "- a", ": ", "|", ">", "|\n  text", "@x", "`x`", "%x", "#"),
    *("[1, 2", "{a: 1", '"open', "'open", "1_000", "0o17", "0b1", "1:30", "2020-01-01", "1e400", "-1e400", "+.inf"),
    *(".nan", "~", "yes", "NaN", "Infinity", "\t", "\x00", "\x07", "\ufeff", "\u2028", "---", "...", "--- a\n--- b"),
    *("[" * 60 + "]" * 60, "9" * 5000, "1" + "0" * 400 + ".0", "{[a]: 1}", "{{}: 1}", "{a: 1, a: 2}"),
]
CELLS = [
    *("", "nan", "inf", "-inf", "-", "x", "1e400", "-1e400", "1e308", "-1e308", "1e200", "1e154", "1e16", "1e9", "1e5"),
    *("-1", "2", "50", "0.5", "5e-324", "1e-300", "1e-12", "-0", "0", "1", "1_0", "\u0663", '"', '"a', "1,1", "\0"),
    *("0x1", " 1 ", "1 1", "True", "NULL", "#N/A", "1.", ".5", "+1", "1e", "--1", "\u22121", "9" * 5000),
]
HEADINGS = [
    *("time_s", "gyro_x", "acc_z", "jet_J1", "jet_", "", " ", "known_force_x", "known_torque_z", "acc_accel_x"),
    *("GYRO_X", "gyro_x ", "é", "1", "time", "\ufeff", "[/red]", "\x1b[31m", "a" * 5000),
]
KEYS = [
    *("", "x", ".", "..", "a..b", "[0]", "maneuver[²].axis", "failures[-1]", "failures[" + "9" * 5000 + "]"),
    *("failures[1]", "maneuver[0]", "maneuver[0][0]", "vehicle", "vehicle.jets[0].thrust", "name", "seed", "a" * 5000),
    *("maneuver.", "rotation.filter.x", "rotation[0]", "é", "\x00", "[", "]", "[]", "a[", "a]", "a[0", "=", " seed"),
]


def nasty(rng: random.Random, before: Any = None) -> Any:
    """A value of no good, often a number where a number was."""
    if isinstance(before, (int, float)) and not isinstance(before, bool) and rng.random() < 0.75:
        if rng.random() < 0.3 and abs(before) < 1e100:
            return before * rng.choice([-1.0, 1e-12, 1e-6, 1e-3, 0.1, 1.001, 10.0, 1e3, 1e6, 1e12])
        return rng.choice(NUMBERS)
    if isinstance(before, str) and rng.random() < 0.6:
        return rng.choice(WORDS)
    return copy.deepcopy(rng.choice([*NUMBERS, *WORDS, *OTHERS]))


Place = tuple[str | int, ...]


def places(data: Any, path: Place = ()) -> Iterator[Place]:
    """Paths of every value in nested data."""
    if path:
        yield path
    for key, value in data.items() if isinstance(data, dict) else enumerate(data) if isinstance(data, list) else ():
        yield from places(value, (*path, key))


def at(data: Any, path: Place) -> Any:
    for part in path:
        data = data[part]
    return data


def _picked(data: Any, rng: random.Random) -> Place | None:
    """A random place; each level as likely as the many values of a large matrix."""
    path: Place = ()
    here = data
    while isinstance(here, (dict, list)) and here and (not path or rng.random() < 0.8):
        key = rng.choice(list(here)) if isinstance(here, dict) else rng.randrange(len(here))
        path, here = (*path, key), here[key]
    return path or None


def spoil_data(data: Any, rng: random.Random) -> str:
    """Damages nested data in place; says what it did."""
    path = _picked(data, rng)
    if path is None:
        return "nothing"
    here, last = at(data, path[:-1]), path[-1]
    what = rng.randrange(10)
    if what == 0:
        del here[last]
        return f"{path}: gone"
    if what == 1 and isinstance(here, dict):
        key = rng.choice([f"{last}x", *WORDS])
        here[key] = here.pop(last)
        return f"{path}: is {key!r:.40}"
    if what == 1:
        here.extend(copy.deepcopy(here[-1:]) * rng.choice([1, 1, 2, 50]))
        return f"{path[:-1]}: longer"
    if what == 2:
        other = _picked(data, rng)
        if other is not None:
            here[last] = copy.deepcopy(at(data, other))
            return f"{path}: that of {other}"
    if what == 3 and isinstance(here, dict):
        here[rng.choice([word for word in WORDS if isinstance(word, str)])] = nasty(rng)
        return f"{path[:-1]}: one more"
    here[last] = nasty(rng, here[last])
    return f"{path}: {here[last]!r:.60}"


def spoil_number(data: Any, rng: random.Random) -> str:
    """Replaces a number by another in place."""
    numbers = [path for path in places(data) if isinstance(at(data, path), float) or type(at(data, path)) is int]
    kinds = sorted({tuple(part for part in path if isinstance(part, str)) for path in numbers})
    kind = rng.choice(kinds)  # every key as likely as those of the many jets
    path = rng.choice([path for path in numbers if tuple(part for part in path if isinstance(part, str)) == kind])
    here, last = at(data, path[:-1]), path[-1]
    before = here[last]
    if rng.random() < 0.4 and abs(before) < 1e100:
        here[last] = type(before)(before * rng.choice([-1, 1e-12, 1e-9, 1e-6, 1e-3, 0.1, 0.5, 2, 10, 1e3, 1e6, 1e9]))
    else:
        here[last] = rng.choice(NUMBERS)
    return f"{path}: {here[last]!r:.60}"


def spoil_text(text: str, rng: random.Random) -> bytes:
    """Damages text, as words or as bytes."""
    if rng.random() < 0.5:  # a token in place of a value
        lines = text.split("\n")
        row = rng.randrange(len(lines))
        head, colon, _ = lines[row].partition(":")
        token = rng.choice(TOKENS)
        lines[row] = f"{head}{colon} {token}" if colon and rng.random() < 0.8 else token
        text = "\n".join(lines)
    data = bytearray(text.encode(rng.choice(["utf-8"] * 8 + ["utf-8-sig", "utf-16", "latin-1"]), errors="replace"))
    return spoil_bytes(data, rng) if rng.random() < 0.6 else bytes(data)


def spoil_bytes(data: bytes | bytearray, rng: random.Random) -> bytes:
    """Damages bytes: some replaced, a stretch gone or twice, cut short."""
    data = bytearray(data)
    for _ in range(rng.choice([1, 1, 1, 2, 20])):
        if not data:
            break
        place = rng.randrange(len(data))
        match rng.randrange(5):
            case 0:
                data[place] = rng.randrange(256)
            case 1:
                del data[place : place + rng.choice([1, 1, 10, 1000])]
            case 2:
                data[place:place] = data[place : place + rng.choice([1, 10, 1000])]
            case 3:
                data[place:place] = rng.choice([b"\0", b"\xff", b"\xc3", b"\r", b"\n", b"\t", b"\x1b", b"\xef\xbb\xbf"])
            case _:
                del data[place:]
    return bytes(data)


# ------------------------------------------------------------------------------------- sound files

SCENARIO = """
name: sound
vehicle: vehicle.yaml
duration_s: 1.0
maneuver:
  - {controller: rhc, axis: +x, start_s: 0.2, end_s: 0.7}
  - {controller: thc, axis: -z, start_s: 0.3, end_s: 0.9}
sensors:
  errors: [{sensor: gyro, noise_std: 1.0e-6, bias: [1.0e-6, 0.0, 0.0], delay_samples: 1}]
estimation: {thrust_uncertainty: 0.02}
failures:
  - {kind: stuck_on, jet: J3, start_s: 0.5}
  - {kind: leak, jet: J4, start_s: 0.2, end_s: 0.6, force: 1.0}
jumps:
  - {kind: dock, time_s: 0.8, mass: 1.0, position: [0.1, 0.0, 0.0]}
"""
SCHEDULED = """
name: scheduled
vehicle: vehicle.yaml
duration_s: 1.0
jet_schedule:
  - {jet: J1, start_s: 0.1, end_s: 0.6}
  - {jet: J5, start_s: 0.3, end_s: 0.9}
plant: {time_step: 0}
estimation:
  start: given
  given: {standard_deviation: [1.0e-3, 1.0e-3, 1.0e-3, 1.0e-4, 1.0e-4, 1.0e-4, 0.2, 0.2, 0.2, 2.0e-3]}
"""


class Sound:
    """Sound files of every kind, written once."""

    def __init__(self, folder: Path):
        self.folder = folder
        toy = cube_data()
        toy["jet_kinds"]["primary"]["time_constant_s"] = 0.02
        toy["jets"][0]["manifold"] = "A"
        toy["gyros"].append({"name": "gyro2", "quantum": 1e-6, "noise_std": 1e-6, "range": 1.0})
        toy["shape"] = [{"kind": "box", "size": [1.0, 1.0, 1.0]}]
        self.vehicle = toy
        (folder / "vehicle.yaml").write_text(to_yaml(toy), encoding="utf-8")
        texts = {"sound": SCENARIO, "scheduled": SCHEDULED}
        for name, text in texts.items():
            (folder / f"{name}.yaml").write_text(text, encoding="utf-8")
        full = simulate(load_scenario(folder / "sound.yaml"))
        full.save(folder / "run", pictures=False)
        self.scenarios = [_yaml(text) for text in (SCENARIO, SCHEDULED, yaml_text(full.scenario))]
        self.log = Log(load_vehicle(folder / "vehicle.yaml"), n_rows=40)
        self.log.write(folder / "log.csv")
        first = Log(load_vehicle(folder / "vehicle.yaml"), n_rows=20)
        first.write(folder / "first.csv")
        settings = load_scenario(folder / "run")
        estimate(folder / "first.csv", settings).save(folder / "estimated", pictures=False)


def _yaml(text: str) -> Any:

    return YAML(typ="safe", pure=True).load(text)


# ------------------------------------------------------------------------------------------- cases


class Case(NamedTuple):
    """What to call, and what was done to its input."""

    arguments: list[str]
    damage: str
    stdin: bytes = b""


QUIET = ["--no-figures", "--no-report"]


def vehicle_case(rng: random.Random, sound: Sound, here: Path) -> Case:
    damage = _write_data(here / "vehicle.yaml", copy.deepcopy(sound.vehicle), rng)
    call = rng.choice(
        [
            ["check", "vehicle.yaml"],
            ["run", "sound.yaml", "--out", "out", *QUIET],
            ["run", "scheduled.yaml", "--out", "out", *QUIET],
            ["estimate", "log.csv", "--vehicle", "vehicle.yaml", "--out", "out", *QUIET],
        ]
    )
    return Case(call, damage)


def scenario_case(rng: random.Random, sound: Sound, here: Path) -> Case:
    damage = _write_data(here / "case.yaml", copy.deepcopy(rng.choice(sound.scenarios)), rng)
    call = rng.choice(
        [
            ["check", "case.yaml"],
            ["run", "case.yaml", "--out", "out", *QUIET],
            ["run", "case.yaml", "--out", "out", *QUIET],
            ["estimate", "log.csv", "--like", "case.yaml", "--out", "out", *QUIET],
        ]
    )
    return Case(call, damage)


def _write_data(path: Path, data: Any, rng: random.Random) -> str:
    if rng.random() < 0.25:
        path.write_bytes(spoil_text(to_yaml(data), rng))
        return "text"
    how = spoil_number if rng.random() < 0.6 else spoil_data  # a number is the likeliest to get beyond the types
    damage = [how(data, rng) for _ in range(rng.choice([1, 1, 1, 2, 3]))]
    duration = data.get("duration_s", 50.0 if "vehicle" in data else 0.0)
    if isinstance(duration, (int, float)) and 2.0 < duration <= 1e6:  # sound, and long
        data["duration_s"] = 1.0
    path.write_bytes(to_yaml(data).encode("utf-8", errors="replace"))
    return "; ".join(damage)


def set_case(rng: random.Random, sound: Sound, here: Path) -> Case:
    chosen = []
    for _ in range(rng.choice([1, 1, 2])):
        data = sound.scenarios[2]
        path = rng.choice([place for place in places(data) if place[0] != "vehicle" or rng.random() < 0.1])
        key = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in path).lstrip(".")
        key = rng.choice(KEYS) if rng.random() < 0.25 else key
        value = rng.choice(TOKENS) if rng.random() < 0.3 else _flow(nasty(rng, at(data, path)))
        text = f"{key}={value}"
        if rng.random() < 0.1:
            text = spoil_bytes(text.encode(errors="replace"), rng).decode(errors="surrogateescape")
        chosen += ["--set", text]
    base = rng.choice(["run", "run", "sound.yaml", "scheduled.yaml"])
    call = ["run", base, "--out", "out", *QUIET]
    if rng.random() < 0.2:
        call = ["estimate", "log.csv", "--like", base, "--out", "out", *QUIET]
    return Case([*call, *chosen], " ".join(chosen)[:100])


def _flow(value: Any) -> str:
    return value if isinstance(value, str) else json.dumps(value).replace("NaN", ".nan").replace("Infinity", ".inf")


def csv_case(rng: random.Random, sound: Sound, here: Path) -> Case:
    content, damage = _spoilt_log(sound, rng)
    (here / "log.csv").write_bytes(content)
    return Case(_telemetry_call("log.csv", rng), damage)


def stdin_case(rng: random.Random, sound: Sound, here: Path) -> Case:
    content, damage = _spoilt_log(sound, rng)
    flags = rng.choice([[], ["--quiet"], ["--json"]])
    return Case(["estimate", "-", "--like", "run", "--out", "out", *QUIET, *flags], damage, content)


def _spoilt_log(sound: Sound, rng: random.Random) -> tuple[bytes, str]:
    log = copy.deepcopy(sound.log)
    if rng.random() < 0.2:
        del log.rows[rng.choice([0, 1, 2, 3, 25]) :]
    damage = [_spoil_table(log, rng) for _ in range(rng.choice([0, 1, 1, 2, 3]))]
    content = log.text().replace(",", rng.choice([",", ",", ",", ",", ";", "\t", " ", "|"]))
    if rng.random() < 0.1:
        content = content.replace("\n", rng.choice(["\r\n", "\r", "\n\n", "\n\r"]))
    encoding = rng.choice(["utf-8"] * 20 + ["utf-8-sig", "utf-16", "utf-32", "latin-1"])
    data = content.encode(encoding, errors="replace")
    if rng.random() < 0.3:
        data = spoil_bytes(data, rng)
        damage.append("bytes")
    return data, "; ".join(damage)


def _spoil_table(log: Log, rng: random.Random) -> str:
    rows, header = log.rows, log.header
    row, column = rng.randrange(max(len(rows), 1)), rng.randrange(max(len(header), 1))
    match rng.randrange(10):
        case 0 | 1 if rows and column < len(rows[row]):
            rows[row][column] = rng.choice(CELLS)
            return f"row {row} column {column}: {rows[row][column]!r:.20}"
        case 2:
            del rows[row : row + rng.randint(1, 12)]
            return f"rows gone at {row}"
        case 3 if rows:
            rows[row:row] = [list(rng.choice(rows))] * rng.choice([1, 2, 30])
            return f"row {row} of others"
        case 4 if rows:
            del rows[row][column:]
            return f"row {row} cut"
        case 5 if header:
            header[column] = rng.choice(HEADINGS)
            return f"heading {column}: {header[column]!r:.20}"
        case 6 if header:
            del header[column]
            for cells in rows if rng.random() < 0.8 else ():
                del cells[column : column + 1]
            return f"column {column} gone"
        case 7:
            header.append(rng.choice([*HEADINGS, *header]))
            text = rng.choice(CELLS)
            for cells in rows:
                cells.append(text)
            return f"more: {header[-1]!r:.20} {text!r:.20}"
        case 8:
            text = rng.choice(CELLS)
            for cells in rows:
                cells[column : column + 1] = [text]
            return f"column {column}: {text!r:.20}"
        case _:
            rng.shuffle(rows) if rng.random() < 0.5 else rows.reverse()
            return "order"


def _telemetry_call(name: str, rng: random.Random) -> list[str]:
    return rng.choice(
        [
            ["check", name],
            ["check", name, "--vehicle", "vehicle.yaml"],
            ["estimate", name, "--vehicle", "vehicle.yaml", "--out", "out", *QUIET],
            ["estimate", name, "--like", "run", "--out", "out", *QUIET],
            ["estimate", name, "--like", "run", "--start", "zero", "--out", "out", *QUIET],
            ["estimate", name, "--resume-from", "estimated", "--out", "out", *QUIET],
        ]
    )


def parquet_case(rng: random.Random, sound: Sound, here: Path) -> Case:
    log = sound.log
    columns = {name: [float(row[place]) for row in log.rows] for place, name in enumerate(log.header)}
    arrays: dict[str, Any] = {name: pa.array(values) for name, values in columns.items()}
    damage = []
    for _ in range(rng.choice([0, 1, 1, 2])):
        name = rng.choice(list(arrays))
        kind, spoilt = rng.choice(_PARQUET)(columns.get(name, [0.0] * 40), rng)
        damage.append(f"{name}: {kind}")
        if spoilt is None:
            del arrays[name]
        elif kind == "renamed":
            arrays[rng.choice(HEADINGS)] = arrays.pop(name)
        else:
            arrays[name] = spoilt
        if not arrays:
            break
    path = here / rng.choice(["log.parquet", "log.pq"])
    names = list(arrays)
    if names and rng.random() < 0.1:
        names[rng.randrange(len(names))] = rng.choice(names)  # twice the same name
    table = pa.Table.from_arrays(list(arrays.values()), names=names)
    compression = rng.choice(["snappy", "none", "zstd", "gzip"])
    pq.write_table(table, path, compression=compression, row_group_size=rng.choice([1, 7, 1000]))
    if not damage or rng.random() < 0.2:
        path.write_bytes(spoil_bytes(path.read_bytes(), rng) if rng.random() < 0.9 else sound.log.text().encode())
        damage.append("bytes")
    return Case(_telemetry_call(path.name, rng), "; ".join(damage))


_Column = Callable[[list[float], random.Random], tuple[str, Any]]


def _one_value(values: list[float], rng: random.Random) -> tuple[str, Any]:
    value = rng.choice([float("nan"), float("inf"), 1e308, -1e308, 1e154, 1e16, 5e-324, -1.0, 50.0, None])
    spoilt: list[Any] = list(values)
    spoilt[rng.randrange(len(spoilt))] = value
    return f"one {value}", pa.array(spoilt)


_PARQUET: list[_Column] = [
    _one_value,
    _one_value,
    lambda values, rng: ("gone", None),
    lambda values, rng: ("renamed", 1),
    lambda values, rng: ("text", pa.array([str(value) for value in values])),
    lambda values, rng: ("float32", pa.array(values, pa.float32())),
    lambda values, rng: ("float16", pa.array(np.array(values, dtype=np.float16))),
    lambda values, rng: ("int", pa.array([int(value) for value in values], pa.int8())),
    lambda values, rng: ("bool", pa.array([bool(value) for value in values])),
    lambda values, rng: ("nulls", pa.nulls(len(values))),
    lambda values, rng: ("lists", pa.array([[value] for value in values])),
    lambda values, rng: ("structs", pa.array([{"a": value} for value in values])),
    lambda values, rng: ("bytes", pa.array([b"\xff"] * len(values))),
    lambda values, rng: ("time", pa.array([int(value * 1000) for value in values], pa.timestamp("ms"))),
    lambda values, rng: ("decimal", pa.array([round(value) for value in values]).cast(pa.decimal128(38, 3))),
    lambda values, rng: ("words", pa.array([str(value) for value in values]).dictionary_encode()),
    lambda values, rng: ("large", pa.array([2**63 + 1] * len(values), pa.uint64())),
    lambda values, rng: ("back", pa.array(values[::-1])),
    lambda values, rng: ("same", pa.array([rng.choice([1e300, float("nan"), float("inf"), 0.3])] * len(values))),
]


def folder_case(rng: random.Random, sound: Sound, here: Path) -> Case:
    folder = rng.choice(["run", "estimated"])
    name = rng.choice(
        ["scenario.yaml", "summary.json", "summary.json", "history.npz", "history.npz", "filter_state.json"]
    )
    damage = _spoil_file(here / folder / name, rng)
    call = rng.choice(
        [
            ["view", folder],
            ["view", folder, "--out", "page.html"],
            ["run", folder, "--out", "out", *QUIET],
            ["estimate", "log.csv", "--like", folder, "--out", "out", *QUIET],
        ]
        if name == "scenario.yaml"
        else [["view", folder], ["view", folder, "--out", "page.html"]]
    )
    return Case(call, f"{folder}/{name}: {damage}")


def resume_case(rng: random.Random, sound: Sound, here: Path) -> Case:
    folder = rng.choice(["run", "estimated", "estimated"])
    damage = _spoil_json(here / folder / "filter_state.json", rng)
    call = ["estimate", "log.csv", "--resume-from", folder, "--out", "out", *QUIET]
    if rng.random() < 0.3:
        call += rng.choice([["--vehicle", "vehicle.yaml"], ["--like", "sound.yaml"], ["--start", "zero"]])
    return Case(call, f"{folder}: {damage}")


def _spoil_file(path: Path, rng: random.Random) -> str:
    if rng.random() < 0.05:
        if rng.random() < 0.5:
            path.unlink()
            return "gone"
        path.unlink()
        path.mkdir()
        return "a folder"
    if path.suffix == ".json":
        return _spoil_json(path, rng)
    if path.suffix == ".npz":
        return _spoil_archive(path, rng)
    text = path.read_text(encoding="utf-8")
    return _write_data(path, _yaml(text), rng)


def _spoil_json(path: Path, rng: random.Random) -> str:
    text = path.read_text(encoding="utf-8")
    if rng.random() < 0.2:
        path.write_bytes(spoil_text(text, rng))
        return "text"
    if rng.random() < 0.05:
        path.write_text(json.dumps(rng.choice([*NUMBERS, *WORDS, *OTHERS])), encoding="utf-8")
        return "other data"
    data = json.loads(text)
    damage = [spoil_data(data, rng) for _ in range(rng.choice([1, 1, 1, 2]))]
    path.write_text(json.dumps(data), encoding="utf-8")
    return "; ".join(damage)


def _spoil_archive(path: Path, rng: random.Random) -> str:
    if rng.random() < 0.35:
        path.write_bytes(spoil_bytes(path.read_bytes(), rng))
        return "bytes"
    with zipfile.ZipFile(path) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    name = rng.choice([*members, *members, "time_s.npy", "estimate.npy"])
    if rng.random() < 0.1:
        del members[name]
        what = "gone"
    elif rng.random() < 0.1:
        what = rng.choice(["../x.npy", "x.npy", "time_s.npy/", "/x.npy", "é.npy", "[/red].npy"])
        members[what] = members[name]
    else:
        what = rng.choice(list(_MEMBERS))
        members[name] = _MEMBERS[what](members[name], rng)
    method = rng.choice([zipfile.ZIP_DEFLATED] * 6 + [zipfile.ZIP_STORED, zipfile.ZIP_BZIP2])
    with zipfile.ZipFile(path, "w", method) as archive:
        for member, content in members.items():
            archive.writestr(member, content)
    return f"{name}: {what}"


def _on_array(change: Callable[[Any, random.Random], Any]) -> Callable[[bytes, random.Random], bytes]:
    def changed(content: bytes, rng: random.Random) -> bytes:
        return _npy(change(np.lib.format.read_array(io.BytesIO(content)), rng))

    return changed


def _promising(content: bytes, rng: random.Random) -> bytes:
    """A header that promises more than there is, or than there can be."""
    shape = rng.choice([(10**12,), (2**62, 2**62), (-1,), (10**9, 3), (0,), (0, 3)])
    stream = io.BytesIO()
    np.lib.format.write_array_header_1_0(stream, {"descr": "<f8", "fortran_order": False, "shape": shape})
    return stream.getvalue() + bytes(80)


_EXTREME = [np.nan, np.inf, -np.inf, 1e308, 5e-324, -1.0]
_DTYPES: list[Any] = ["<U5", "complex128", "int8", "bool", "datetime64[s]", "S3", ">f8", "float16"]


def _one_element(array: Any, rng: random.Random) -> Any:
    values = np.array(array, dtype=float if array.dtype.kind == "f" else array.dtype)
    if values.size and values.dtype.kind == "f":
        values.flat[rng.randrange(values.size)] = rng.choice([*_EXTREME, 0.0, 1e9, -1e300])
    return values


_MEMBERS: dict[str, Callable[[bytes, random.Random], bytes]] = {
    "a row less": _on_array(lambda array, rng: array[:-1] if array.ndim else array),
    "an axis more": _on_array(lambda array, rng: array[..., None]),
    "a column less": _on_array(lambda array, rng: array[:, :-1].copy() if array.ndim > 1 else array.reshape(-1)),
    "all extreme": _on_array(lambda array, rng: np.full(array.shape, rng.choice(_EXTREME))),
    "one extreme": _on_array(_one_element),
    "another one": _on_array(_one_element),
    "another type": _on_array(lambda array, rng: np.zeros(array.shape, dtype=rng.choice(_DTYPES))),
    "objects": _on_array(lambda array, rng: np.full(array.shape, None, dtype=object)),
    "small on disk": _on_array(lambda array, rng: np.zeros((3 * 10**5, 3))),
    "bytes": spoil_bytes,
    "promising": _promising,
    "no array": lambda content, rng: rng.choice([b"", b"\x93NUMPY", b"x", b"\x93NUMPY\x09\x00"]),
}


def _npy(array: Any) -> bytes:
    stream = io.BytesIO()
    np.lib.format.write_array(stream, array, allow_pickle=True)
    return stream.getvalue()


Maker = Callable[[random.Random, Sound, Path], Case]

# kinds of cases, and how many of ten thousand each is
KINDS: dict[str, tuple[Maker, int]] = {
    "vehicle": (vehicle_case, 2000),
    "scenario": (scenario_case, 2000),
    "set": (set_case, 1500),
    "csv": (csv_case, 1200),
    "parquet": (parquet_case, 600),
    "stdin": (stdin_case, 600),
    "folder": (folder_case, 1100),
    "resume": (resume_case, 1000),
}


# ----------------------------------------------------------------------------------------- verdicts


class Hung(BaseException):
    """A case has computed for too long."""


class Verdict(NamedTuple):
    """What became of a case: its exit status, what is wrong about it ('' for nothing), and what it said."""

    status: int
    fault: str
    said: str
    damage: str
    arguments: list[str]


def judged(make: Maker, number: int, sound: Sound, here: Path) -> Verdict:
    """Makes a case in an empty folder, runs it through the command line and judges it."""
    rng = random.Random(f"{make.__name__} {number}")
    shutil.copytree(sound.folder, here, dirs_exist_ok=True)
    case = make(rng, sound, here)
    before = contents(here)
    status, said, fault = called(case, here)
    if not fault:
        fault = _fault(status, said, before, contents(here), here)
    return Verdict(status, fault, said, case.damage, case.arguments)


def contents(here: Path) -> dict[str, int]:
    """Every file below a folder, with what is in it."""
    return {str(path.relative_to(here)): hash(path.read_bytes()) if path.is_file() else 0 for path in here.rglob("*")}


def called(case: Case, here: Path) -> tuple[int, str, str]:
    """Status, both streams, and a fault."""
    streams = [io.TextIOWrapper(io.BytesIO(), encoding="utf-8", errors="backslashreplace") for _ in range(2)]
    stdin = io.TextIOWrapper(io.BytesIO(case.stdin), encoding="utf-8")
    saved = sys.argv, sys.stdin, sys.stdout, sys.stderr, Path.cwd()
    sys.argv = ["massprop", *case.arguments]
    sys.stdin, sys.stdout, sys.stderr = stdin, *streams
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
        if _is_long(case, here):
            status = LONG
        else:
            fault = "hung"
    except BaseException as error:
        fault = f"raised {type(error).__name__}: {error}"
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, handler)
        sys.argv, sys.stdin, sys.stdout, sys.stderr = saved[:4]
        os.chdir(saved[4])
    said = ""
    for stream in streams:
        stream.flush()
        said += stream.buffer.getvalue().decode(errors="replace")
    return status, said, fault


def _is_long(case: Case, here: Path) -> bool:
    """Whether more samples are asked for than can be flown in time: a damaged duration or period may still be one."""
    name, *rest = case.arguments[1:]
    overrides = [after for option, after in pairwise(rest) if option == "--set"]
    if case.arguments[0] != "run":
        return False
    asked = load_scenario(here / name, overrides)
    return asked.duration_s > 25 * asked.vehicle_data.sample_period_s


def _fault(status: int, said: str, before: dict[str, int], after: dict[str, int], here: Path) -> str:
    if "Traceback" in said:
        return "traceback"
    if status not in (0, 2, LONG):
        return f"status {status}"
    if status == 2 and len(said.strip()) < 20:
        return "no message"
    changed = [name for name in before if after.get(name) != before[name]]
    ours = ("report.html", "replay.html", "manifest.json")
    if [name for name in changed if Path(name).name not in ours]:
        return f"input changed: {changed}"
    new = {name for name in after if name not in before}
    pages = {name for name in new if name.endswith(".html") and not name.startswith("out/")}
    strange = {name for name in new - pages if name != "out" and not name.startswith("out/")}
    if strange:
        return f"left behind: {sorted(strange)}"
    if status == 2 and new and "out" not in new:
        return f"half-written: {sorted(new)}"
    for name in pages:
        if sealed_kind(here / name) is None and not (here / name).read_text(encoding="utf-8").endswith("</html>"):
            return f"half-written: {name}"
    if "out" in new:
        try:
            ended = Run.load(here / "out").results.ended
            if (ended is not None) != (status == 2):
                return f"status {status}: {ended}"
            json.loads((here / "out" / "filter_state.json").read_text(encoding="utf-8"))
        except Exception as error:
            return f"not whole: {type(error).__name__}: {error}"
    return ""
