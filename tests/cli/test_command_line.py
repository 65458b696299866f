"""The command line: what it prints, where, with which exit status, and what it leaves behind."""

from __future__ import annotations

import copy
import importlib.util
import json
import math
import re
import resource
import shutil
import subprocess
import sys
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_probe import FILES, Massprop, Outcome
from conftest import REPOSITORY

from massprop_drake import Run
from massprop_drake.display import graphs
from massprop_drake.inputs.yaml import to_yaml
from massprop_drake.maths.kernels import compiler

COMMANDS = ("list", "run", "estimate", "compare", "graph", "view", "report", "check")
MANEUVER = "maneuver:\n  - {controller: rhc, axis: +x, start_s: 0.2, end_s: 1}\n"


def _python(*arguments: str, folder: Path) -> subprocess.CompletedProcess[str]:
    """The command line in a process of its own."""
    command = [sys.executable, "-m", "massprop_drake", *arguments]
    return subprocess.run(command, capture_output=True, text=True, cwd=folder, check=False)


def _everything(folder: Path) -> list[str]:
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*"))


def _without_timing(summary: dict[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in summary.items() if key != "timing"}


def _summary(folder: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    return found


def _assert_refused(done: Outcome, *words: str) -> None:
    """One message on the error stream, status 2, nothing else."""
    assert done.status == 2, done
    assert done.out == ""
    assert done.err.startswith("massprop: ")
    assert done.err.endswith("\n")
    assert done.err.count("\n") == 1, done.err
    assert "Traceback" not in done.err
    for word in words:
        assert word in done.err


# --------------------------------------------------------------------------------------------- list


def test_list_names_everything_that_is_bundled(massprop: Massprop) -> None:
    done = massprop("list")
    assert (done.status, done.err) == (0, "")
    lines = done.out.splitlines()
    for kind, name in (
        ("vehicle", "orbiter"),
        ("vehicle", "small_satellite"),
        ("vehicle", "free_flyer"),
        ("vehicle", "lander"),
        ("scenario", "sample_maneuver"),
        ("scenario", "jet_pulses"),
        ("diagram", "closed_loop"),
        ("diagram", "estimation"),
    ):
        assert any(re.match(rf"{kind}\s+{name}\s+\S", line) for line in lines), name


def test_list_as_json(massprop: Massprop) -> None:
    done = massprop("list", "--json")
    assert (done.status, done.err) == (0, "")
    found = json.loads(done.out)
    assert set(found) == {"vehicles", "scenarios", "diagrams", "campaigns"}
    whole = {"vehicle", "autopilot", "estimation", "closed_loop", "open_loop", "replay"}
    assert set(found["diagrams"]) == whole | {"vehicle_tracked", "estimation_joint", "estimation_pose"}
    assert all(description for kind in found.values() for description in kind.values())


# ---------------------------------------------------------------------------------------------- run


def test_run_writes_a_folder_and_prints_the_estimates(massprop: Massprop) -> None:
    done = massprop("run", "sample_maneuver", "--set", "duration_s=3")
    assert (done.status, done.err) == (0, "")
    folder = Path("runs/sample_maneuver")
    assert {path.name for path in folder.iterdir()} == FILES
    assert _summary(folder)["duration_s"] == pytest.approx(2.96)
    for parameter in ("Ixx⁻¹", "Iyy⁻¹", "Izz⁻¹", "Iyz⁻¹", "Ixz⁻¹", "Ixy⁻¹", "x_cm", "y_cm", "z_cm", "1/m"):
        assert parameter in done.out
    for heading in ("estimate", "truth", "error %", "1-sigma", "in 3 sigma"):
        assert heading in done.out
    assert "files:       runs/sample_maneuver/" in done.out


def test_what_a_flight_has_hardly_touched_is_not_called_right(massprop: Massprop) -> None:
    done = massprop("run", "sample_maneuver", "--set", "duration_s=3", "--no-report", "--no-figures")
    rows = {line.split()[1]: line for line in done.out.splitlines() if line.startswith("│")}
    assert rows["Ixx⁻¹"].split()[-2] == "yes"
    assert rows["x_cm"].split()[-3:-1] == ["not", "excited"]
    assert "x_cm not excited: 1-sigma is still" in done.out


def test_run_prints_json_alone(massprop: Massprop) -> None:
    done = massprop("run", "sample_maneuver", "--set", "duration_s=1", "--json", "--out", "there")
    assert (done.status, done.err) == (0, "")
    assert json.loads(done.out) == _summary(Path("there"))


def test_run_prints_nothing_when_quiet(massprop: Massprop) -> None:
    assert massprop("run", "sample_maneuver", "--set", "duration_s=1", "--quiet") == (0, "", "")
    assert (Path("runs") / "sample_maneuver" / "summary.json").exists()


def test_run_takes_overrides_and_a_seed(massprop: Massprop) -> None:
    overrides = ["--set", "duration_s=1", "--set", "seed=3", "--set", "rotation.filter=extended"]
    assert massprop("run", "sample_maneuver", *overrides, "--seed", "5", "--out", "a", "-q").status == 0
    run = Run.load("a")
    assert run.scenario.seed == run.summary["seed"] == 5
    assert run.scenario.rotation.filter == "extended"


def test_a_run_repeats_itself_and_seeds_differ(massprop: Massprop) -> None:
    for name, seed in (("one", "1"), ("again", "1"), ("two", "2")):
        massprop("run", "sample_maneuver", "--set", "duration_s=3", "--seed", seed, "--out", name, "-q")
    one, again, two = (_summary(Path(name)) for name in ("one", "again", "two"))
    assert _without_timing(one) == _without_timing(again)
    assert (Path("one") / "telemetry.csv").read_bytes() == (Path("again") / "telemetry.csv").read_bytes()
    assert one["estimates"] != two["estimates"]


def test_a_runs_folder_runs_again(massprop: Massprop) -> None:
    massprop("run", "sample_maneuver", "--set", "duration_s=3", "--seed", "4", "--out", "first", "-q")
    assert massprop("run", "first", "--out", "second", "-q").status == 0
    assert _without_timing(_summary(Path("first"))) == _without_timing(_summary(Path("second")))
    for name in ("telemetry.csv", "scenario.yaml", "filter_state.json"):
        assert (Path("first") / name).read_bytes() == (Path("second") / name).read_bytes()


def test_an_earlier_run_is_replaced(massprop: Massprop) -> None:
    massprop("run", "sample_maneuver", "--set", "duration_s=1", "--out", "there", "-q")
    assert (
        massprop("run", "sample_maneuver", "--set", "duration_s=1", "--seed", "9", "--out", "there", "-q").status == 0
    )
    assert {path.name for path in Path("there").iterdir()} == FILES
    assert _summary(Path("there"))["seed"] == 9
    assert [path.name for path in Path().iterdir()] == ["there"]


def test_files_of_others_need_force(massprop: Massprop) -> None:
    Path("mine").mkdir()
    (Path("mine") / "notes.txt").write_text("keep", encoding="utf-8")
    done = massprop("run", "sample_maneuver", "--set", "duration_s=1", "--out", "mine")
    _assert_refused(done, "mine: holds files that are not of an earlier run", "notes.txt", "--force")
    assert _everything(Path()) == ["mine", "mine/notes.txt"]
    assert massprop("run", "sample_maneuver", "--set", "duration_s=1", "--out", "mine", "--force", "-q").status == 0
    assert {path.name for path in Path("mine").iterdir()} == FILES
    assert (Path("mine.1") / "notes.txt").read_text(encoding="utf-8") == "keep"


def test_a_users_file_in_a_runs_folder_is_kept(massprop: Massprop) -> None:
    run = ("run", "sample_maneuver", "--set", "duration_s=1", "--out", "K", "-q")
    assert massprop(*run).status == 0
    assert massprop(*run).status == 0
    Path("K/logs").mkdir()
    Path("K/telemetry.csv").rename("K/logs/flight.csv")
    Path("K/my_scenario.yaml").write_text("duration_s: 1\n", encoding="utf-8")
    Path("link").symlink_to("K")
    before = _everything(Path())
    for arguments in (
        ("estimate", "K/logs/flight.csv", "--like", "K", "--out", "K"),
        ("estimate", "K/logs/flight.csv", "--like", "K", "--out", "link"),
        ("estimate", "link/logs/flight.csv", "--vehicle", "orbiter", "--out", "K"),
        ("run", "K/my_scenario.yaml", "--out", "K"),
        ("run", "K", "--out", "K"),
        ("run", "K", "--out", "."),
    ):
        for force in ((), ("--force",)):
            done = massprop(*arguments, *force)
            _assert_refused(done, "holds what is to be read", "would be replaced; give another folder")
    _assert_refused(massprop(*run), "K: holds files", "my_scenario.yaml, logs/flight.csv", "keep what is there as K.1")
    assert _everything(Path()) == before
    assert massprop(*run, "--force", "-q").status == 0
    assert (Path("K.1") / "logs" / "flight.csv").exists()
    assert Run.load("K").summary["scenario"] == "sample_maneuver"


@pytest.mark.parametrize("arguments", [("run", "sample_maneuver"), ("graph", "autopilot"), ("reproduction",)])
def test_a_link_to_nowhere_is_refused_before_the_work(
    massprop: Massprop, reproduction: Massprop, monkeypatch: pytest.MonkeyPatch, arguments: tuple[str, ...]
) -> None:
    def fail(*_: object, **__: object) -> None:
        raise AssertionError

    monkeypatch.setattr("massprop_drake.runners.simulate.simulate", fail)
    monkeypatch.setattr("massprop_drake.display.graphs.build", fail)
    call = reproduction if arguments == ("reproduction",) else partial(massprop, *arguments)
    Path("dangling").symlink_to("nowhere")
    _assert_refused(call("--out", "dangling"), "dangling: is a link to nowhere")
    Path("loop").symlink_to("loop")
    _assert_refused(call("--out", "loop"), "loop: ")
    assert _everything(Path()) == ["dangling", "loop"]


def test_a_link_to_a_folder_stands_for_it(massprop: Massprop) -> None:
    Path("disk").mkdir()
    Path("disk/run").mkdir()
    Path("link").symlink_to("disk/run")
    run = ("run", "sample_maneuver", "--set", "duration_s=1", "--out", "link", "-q")
    assert massprop(*run).status == 0
    assert massprop(*run).status == 0
    assert Path("link").is_symlink()
    assert {path.name for path in Path("disk/run").iterdir()} == FILES
    assert sorted(path.name for path in Path("disk").iterdir()) == ["run"]


def test_the_folder_that_one_is_in_is_no_place(massprop: Massprop) -> None:
    _assert_refused(massprop("run", "sample_maneuver", "--out", "."), "is the current folder or one above it")
    assert _everything(Path()) == []


def test_a_scenario_file_is_run_into_a_folder_of_its_name(massprop: Massprop) -> None:
    Path("case.yaml").write_text("name: my_case\nduration_s: 1\n" + MANEUVER, encoding="utf-8")
    assert massprop("run", "case.yaml", "-q").status == 0
    assert _summary(Path("runs/my_case"))["scenario"] == "my_case"


# ------------------------------------------------------------------------------------- bad input

BAD_SCENARIOS = {
    "unknown field": ("maneuvers: []\n", "maneuvers: unknown key; did you mean 'maneuver'?"),
    "missing field": ("maneuver:\n  - {controller: rhc, axis: +x, start_s: 1}\n", "maneuver[0].end_s: missing"),
    "wrong length": ("plant:\n  initial_rate: [0, 0, 0, 0]\n", "plant.initial_rate: "),
    "too short": ("plant:\n  initial_rate: [0, 0]\n", "plant.initial_rate: "),
    "NaN": ("duration_s: .nan\n", "duration_s: input should be a finite number, got nan"),
    "repeated key": ("seed: 1\nseed: 2\n", "seed: the key appears twice"),
    "unknown jet": ("jet_schedule:\n  - {jet: R9R, start_s: 0, end_s: 1}\n", "'R9R' is no jet of vehicle 'orbiter'"),
    "negative time": (
        MANEUVER.replace("0.2", "-0.2"),
        "maneuver[0].start_s: input should be greater than or equal to 0, got -0.2",
    ),
    "overlapping windows": (
        MANEUVER + "  - {controller: rhc, axis: -x, start_s: 0.5, end_s: 2}\n",
        "maneuver[1]: overlaps maneuver[0]",
    ),
    "no YAML": ("name: [a\n", "not valid YAML"),
    "empty": ("", "the document is empty"),
    "unknown vehicle": ("vehicle: orbitr\n", "did you mean 'orbiter'?"),
    "unknown integrator": (MANEUVER + "duration_s: 1\nplant: {time_step: 0, integrator: euler}\n", "plant.integrator"),
    "endless alias": ("plant: &x\n  initial_rate: *x\n", "alias *x is not supported"),
}


@pytest.mark.parametrize(("text", "words"), list(BAD_SCENARIOS.values()), ids=list(BAD_SCENARIOS))
def test_run_refuses_a_bad_scenario(massprop: Massprop, text: str, words: str) -> None:
    Path("case.yaml").write_text(text, encoding="utf-8")
    _assert_refused(massprop("run", "case.yaml", "--out", "deep/down"), "case.yaml", words)
    assert _everything(Path()) == ["case.yaml"]


def _diagonal(x: float, y: float, z: float) -> list[list[float]]:
    return [[x, 0.0, 0.0], [0.0, y, 0.0], [0.0, 0.0, z]]


BAD_VEHICLES: dict[str, tuple[tuple[Any, ...], Any, str]] = {
    "direction": (("jets", 1, "direction"), [0.0, 1.0, 0.5], "jets[1].direction: must have length 1"),
    "singular inertia": (("mass_properties", "inertia"), _diagonal(1.0, 1.0, 0.0), "mass_properties.inertia: must be"),
    "impossible inertia": (("mass_properties", "inertia"), _diagonal(1.0, 1.0, 3.0), "no rigid body has this inertia"),
    "asymmetric inertia": (("mass_properties", "inertia", 0, 1), 7.0, "mass_properties.inertia: must be symmetric"),
    "NaN": (("mass_properties", "mass"), math.nan, "mass_properties.mass: input should be a finite number"),
    "wrong length": (("jets", 0, "position"), [0.0] * 4, "jets[0].position"),
    "unknown field": (("jets", 0, "thrusts"), 1.0, "jets[0].thrusts: unknown key; did you mean 'thrust'?"),
    "designation twice": (("jets", 1, "designation"), "J1", "designation 'J1' appears twice"),
}


@pytest.mark.parametrize(("path", "value", "words"), list(BAD_VEHICLES.values()), ids=list(BAD_VEHICLES))
def test_run_refuses_a_bad_vehicle(
    massprop: Massprop, toy_data: dict[str, Any], path: tuple[Any, ...], value: Any, words: str
) -> None:
    data = copy.deepcopy(toy_data)
    here: Any = data
    for part in path[:-1]:
        here = here[part]
    here[path[-1]] = value
    Path("toy.yaml").write_text(to_yaml(data), encoding="utf-8")
    Path("case.yaml").write_text("vehicle: toy.yaml\n", encoding="utf-8")
    _assert_refused(massprop("run", "case.yaml", "--out", "there"), "toy.yaml", words)
    assert _everything(Path()) == ["case.yaml", "toy.yaml"]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("run", "nowhere.yaml"), "nowhere.yaml: no such file"),
        (("run", "sample_manuever"), "did you mean 'sample_maneuver'?"),
        (("run", "sample_maneuver", "--seed", "-1"), "seed: input should be greater than or equal to 0, got -1"),
        (("run", "sample_maneuver", "--set", "seed"), "--set seed: expected KEY=VALUE"),
        (("run", "sample_maneuver", "--set", "sede=1"), "sede: unknown key; did you mean 'seed'?"),
        (("run", "sample_maneuver", "--set", "maneuver[99].axis=-x"), "there is no 99"),
        (("run", "x" * 300), "x" * 300),
        (("run", "sample_maneuver", "--set", "duration_s=1", "--out", "y" * 300), "y" * 300),
        (("graph", "closed_lop"), "'closed_lop' is no diagram; did you mean 'closed_loop'?"),
        (("graph", "mine.py"), "'mine.py' is a file; say which of its functions builds the diagram: mine.py:build"),
        (("check",), "nothing to check"),
    ],
    ids=lambda value: " ".join(value)[:40] if isinstance(value, tuple) else None,
)
def test_bad_arguments_are_refused(massprop: Massprop, arguments: tuple[str, ...], words: str) -> None:
    _assert_refused(massprop(*arguments), words)
    assert _everything(Path()) == []


@pytest.mark.parametrize("arguments", [("run", "sample_maneuver"), ("graph", "autopilot")])
def test_a_folder_that_cannot_be_written_is_refused(massprop: Massprop, arguments: tuple[str, ...]) -> None:
    Path("file").write_text("x", encoding="utf-8")
    _assert_refused(massprop(*arguments, "--out", "file/below"), "below: cannot be written")
    _assert_refused(massprop(*arguments, "--out", "file"), "file: is a file; give a folder to write to")
    assert _everything(Path()) == ["file"]
    assert Path("file").read_text(encoding="utf-8") == "x"


@pytest.mark.parametrize(
    "arguments",
    [
        ("run", "sample_maneuver", "--compiled"),
        ("run", "sample_maneuver", "--set", "execution.compiled=true", "--out", "a/b/c"),
        ("campaign", "run", "every_jet", "--compiled"),
        ("campaign", "run", "every_jet", "--compiled", "--quiet"),
    ],
)
def test_without_numba_nothing_is_begun_that_needs_it(
    massprop: Massprop, monkeypatch: pytest.MonkeyPatch, arguments: tuple[str, ...]
) -> None:
    find = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name, *of: None if name == "numba" else find(name, *of))
    compiler.cache_clear()
    _assert_refused(massprop(*arguments), "execution.compiled: needs numba: pip install 'massprop-drake[fast]'")
    assert _everything(Path()) == []


def test_a_folder_that_was_made_to_be_written_in_goes_again(massprop: Massprop) -> None:
    Path("bad.csv").write_text("a,b\n", encoding="utf-8")
    _assert_refused(massprop("estimate", "bad.csv", "--vehicle", "orbiter"), "bad.csv: no columns time_s")
    assert _everything(Path()) == ["bad.csv"]
    Path("mine").mkdir()
    _assert_refused(massprop("estimate", "bad.csv", "--vehicle", "orbiter", "--out", "mine/a/b"), "bad.csv: no columns")
    assert _everything(Path()) == ["bad.csv", "mine"]


@pytest.mark.parametrize(
    "arguments",
    [("rum",), ("fly",), ("run",), ("run", "a", "b"), ("run", "a", "--sed", "1"), ("run", "a", "--seed", "one")],
)
def test_wrong_usage_ends_with_status_2(massprop: Massprop, arguments: tuple[str, ...]) -> None:
    done = massprop(*arguments)
    assert done.status == 2
    assert done.out == ""
    assert ". Usage: " in done.err or "? Usage: " in done.err
    assert "?. " not in done.err
    assert "Traceback" not in done.err


def test_a_failure_of_ours_is_told_as_such_and_leaves_nothing(
    massprop: Massprop, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object, **__: object) -> None:
        raise RuntimeError("the solver is out of sorts")

    monkeypatch.setattr("massprop_drake.runners.simulate.simulate", fail)
    done = massprop("run", "sample_maneuver", "--out", "there")
    assert done.status == 1
    assert done.out == ""
    assert done.err == "massprop: internal failure: RuntimeError: the solver is out of sorts\n"
    assert _everything(Path()) == []


# -------------------------------------------------------------------------------------------- check


def test_check_says_what_is_in_good_files(massprop: Massprop, toy_data: dict[str, Any]) -> None:
    Path("toy.yaml").write_text(to_yaml(toy_data), encoding="utf-8")
    Path("case.yaml").write_text("name: mine\nvehicle: toy.yaml\nduration_s: 4\n", encoding="utf-8")
    done = massprop("check", "toy.yaml", "case.yaml", "orbiter", "sample_maneuver")
    assert (done.status, done.err) == (0, "")
    # a vehicle's report is indented
    assert [line for line in done.out.splitlines() if not line.startswith(" ")] == [
        "toy.yaml: ok: vehicle 'toy', 12 jets, 1 gyro and 1 accelerometer packages, units si",
        "case.yaml: ok: scenario 'mine', 4 s, vehicle 'toy'",
        "orbiter: ok: vehicle 'orbiter', 44 jets, 1 gyro and 3 accelerometer packages, units us",
        "sample_maneuver: ok: scenario 'sample_maneuver', 50 s, vehicle 'orbiter'",
    ]


def test_check_finds_every_mistake_of_every_file(massprop: Massprop, toy_data: dict[str, Any]) -> None:
    toy_data["jets"][0]["thrust"] = -1.0
    toy_data["color"] = "red"
    Path("toy.yaml").write_text(to_yaml(toy_data), encoding="utf-8")
    Path("case.yaml").write_text("sede: 1\n", encoding="utf-8")
    done = massprop("check", "toy.yaml", "orbiter", "case.yaml", "nowhere.yaml")
    assert done.status == 2
    assert "Traceback" not in done.out + done.err
    lines = [line for line in done.out.splitlines() if not line.startswith(" ")]
    assert len(lines) == 5
    assert any("jets[0].thrust" in line for line in lines)
    assert any("color: unknown key" in line for line in lines)
    assert any("case.yaml, line 1: sede: unknown key; did you mean 'seed'?" in line for line in lines)
    assert any("nowhere.yaml: no such file" in line for line in lines)
    assert any(line.startswith("orbiter: ok") for line in lines)


def test_check_reports_on_a_vehicle(massprop: Massprop, toy_data: dict[str, Any]) -> None:
    toy_data["accelerometers"] = []
    for jet in toy_data["jets"]:
        jet["direction"] = [abs(part) for part in jet["direction"]]
    Path("toy.yaml").write_text(to_yaml(toy_data), encoding="utf-8")
    done = massprop("check", "toy.yaml", "--pairs", "2")
    assert (done.status, done.err) == (0, "")
    first, *lines = done.out.splitlines()
    assert first.startswith("toy.yaml: ok: vehicle 'toy'")
    text = "\n".join(lines)
    assert "control:     rank 6 of 6" in text
    assert "cannot push alone: " in text
    assert "translate -x" in text
    assert "observable:  9 of the 10 mass properties" in text
    assert "not: m_inv" in text
    assert "no accelerometer: the mass cannot be observed" in text
    assert sum(" deg  " in line for line in lines) == 2
    assert sum("on untold:" in line or "lost, firing:" in line for line in lines) == 2


def test_check_reports_on_a_vehicle_as_json(massprop: Massprop) -> None:
    done = massprop("check", "free_flyer", "sample_maneuver", "--json", "--pairs", "7")
    assert (done.status, done.err) == (0, "")
    vehicle, scenario = json.loads(done.out)
    assert set(vehicle["report"]) == {"body", "control", "observability", "notes", "alike", "isolable"}
    assert len(vehicle["report"]["alike"]) == 7
    assert "report" not in scenario


def test_check_as_json_and_quiet(massprop: Massprop) -> None:
    Path("case.yaml").write_text("sede: 1\n", encoding="utf-8")
    done = massprop("check", "case.yaml", "orbiter", "--json")
    assert (done.status, done.err) == (2, "")
    bad, good = json.loads(done.out)
    assert (bad["file"], bad["ok"], good["file"], good["ok"]) == ("case.yaml", False, "orbiter", True)
    assert "sede: unknown key" in bad["findings"][0]
    assert massprop("check", "case.yaml", "--quiet").out == ""
    assert massprop("check", "orbiter", "--quiet") == (0, "", "")


@pytest.mark.parametrize(
    ("kind", "name", "unit"), [("vehicle", "jets[].thrust", "lbf | N"), ("scenario", "rotation.filter", "-")]
)
def test_check_shows_the_keys_of_a_kind_of_file(massprop: Massprop, kind: str, name: str, unit: str) -> None:
    done = massprop("check", "--schema", kind, "--json")
    assert (done.status, done.err) == (0, "")
    keys = {key["name"]: key for key in json.loads(done.out)}
    assert keys[name]["unit"] == unit
    assert all(set(key) == {"name", "type", "unit", "default", "range", "meaning"} for key in keys.values())
    assert all(key["meaning"] for key in keys.values())
    done = massprop("check", "--schema", kind)
    assert (done.status, done.err) == (0, "")
    for key in keys:
        assert key in done.out, key


# -------------------------------------------------------------------------------------------- graph


def test_graph_writes_dot_and_svg(massprop: Massprop) -> None:
    done = massprop("graph", "autopilot", "--out", "graphs")
    assert (done.status, done.err) == (0, "")
    names = ["autopilot.dot", "autopilot.svg", "autopilot_overview.dot", "autopilot_overview.svg"]  # nothing to open
    assert sorted(path.name for path in Path("graphs").iterdir()) == [*names, "manifest.json"]
    assert sorted(Path(line).name for line in done.out.splitlines()) == names
    assert "digraph" in (Path("graphs") / "autopilot.dot").read_text(encoding="utf-8")
    svg = (Path("graphs") / "autopilot.svg").read_text(encoding="utf-8")
    assert "<svg" in svg
    for name in ("jet_selection", "phase_space_controller", "attitude_reference"):
        assert name in svg


def test_graph_without_a_program_to_draw_writes_dot_and_says_so(
    massprop: Massprop, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(graphs, "svg_text", lambda _: None)
    done = massprop("graph", "--out", "graphs")
    assert done.status == 0
    assert done.err.startswith("massprop: no SVG: install a program that draws it")
    assert done.err.count("\n") == 1
    nested = {"closed_loop", "open_loop", "replay", "vehicle", "vehicle_tracked"}
    names = {f"{name}{part}.dot" for name in graphs.DIAGRAMS for part in ("", "_overview")}
    names |= {f"{name}_inside.dot" for name in nested}
    assert {path.name for path in Path("graphs").iterdir()} == names | {"manifest.json"}
    assert massprop("graph", "estimation", "--out", "graphs", "--quiet") == (0, "", "")


def test_graph_replaces_no_file_of_others(massprop: Massprop, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(graphs, "svg_text", lambda _: None)
    Path("autopilot.dot").write_text("mine", encoding="utf-8")
    here = ("graph", "autopilot", "--out", ".", "-q")
    _assert_refused(massprop(*here), "autopilot.dot: is there already", "--force to keep it as autopilot.dot.1")
    assert _everything(Path()) == ["autopilot.dot"]
    assert massprop(*here, "--force") == (0, "", massprop(*here).err)
    assert Path("autopilot.dot.1").read_text(encoding="utf-8") == "mine"
    assert Path("autopilot.dot").read_text(encoding="utf-8").startswith("digraph")
    assert sorted(_everything(Path())) == [
        "autopilot.dot",
        "autopilot.dot.1",
        "autopilot_overview.dot",
        "manifest.json",
    ]


def test_graph_as_json(massprop: Massprop, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(graphs, "svg_text", lambda _: "<svg/>")
    done = massprop("graph", "estimation", "vehicle", "--json")
    assert (done.status, done.err) == (0, "")
    written = json.loads(done.out)
    assert len(written) == 10
    assert all(Path(name).exists() for name in written)
    assert written[0] == "runs/graphs/estimation.dot"


# ------------------------------------------------------------------------------------- report, view


def test_run_without_report_and_with_a_view(massprop: Massprop) -> None:
    done = massprop("run", "sample_maneuver", "--set", "duration_s=1", "--out", "there", "--no-report", "--view")
    assert (done.status, done.err) == (0, "")
    names = {path.name for path in Path("there").iterdir()}
    assert "report.html" not in names
    assert "replay.html" in names
    assert "replay: there/replay.html" in done.out


def test_view_writes_the_replay_beside_the_run_and_the_report_leads_to_it(massprop: Massprop) -> None:
    massprop("run", "sample_maneuver", "--set", "duration_s=1", "--out", "there", "-q")
    assert "replay.html" not in (Path("there") / "report.html").read_text(encoding="utf-8")
    done = massprop("view", "there")
    assert (done.status, done.out, done.err) == (0, "there/replay.html\n", "")
    assert 'href="replay.html"' in (Path("there") / "report.html").read_text(encoding="utf-8")
    assert massprop("view", "there", "--out", "elsewhere.html", "-q") == (0, "", "")
    assert Path("elsewhere.html").read_text(encoding="utf-8").startswith("<!DOCTYPE html>")


@pytest.fixture
def short_replay(monkeypatch: pytest.MonkeyPatch) -> None:
    """A replay that costs nothing to make."""
    monkeypatch.setattr("massprop_drake.display.flight3d.replay_html", lambda _: "<!DOCTYPE html>\n" + 300_000 * ".")


@pytest.mark.usefixtures("short_replay")
def test_a_runs_folder_can_be_replaced_after_a_view(massprop: Massprop) -> None:
    run = ("run", "sample_maneuver", "--set", "duration_s=1", "--out", "there", "-q")
    for arguments in (run, ("view", "there", "-q"), ("view", "there", "-q"), run):
        assert massprop(*arguments) == (0, "", "")
    assert {path.name for path in Path("there").iterdir()} == FILES  # the replay went with the run that it showed
    assert _everything(Path())[0] == "there"


@pytest.mark.usefixtures("short_replay")
def test_view_replaces_no_file_of_others(massprop: Massprop) -> None:
    massprop("run", "sample_maneuver", "--set", "duration_s=1", "--out", "there", "-q")
    view = ("view", "there", "-q")
    for name in ("there/report.html", "page.html"):
        Path(name).write_text("mine", encoding="utf-8")
    assert massprop(*view) == (0, "", "")  # the report is left as it is
    assert Path("there/report.html").read_text(encoding="utf-8") == "mine"
    Path("there/replay.html").write_text("mine", encoding="utf-8")
    Path("dangling.html").symlink_to("nowhere")
    before = _everything(Path())
    _assert_refused(massprop(*view), "there/replay.html: is there already", "keep it as replay.html.1")
    for name in ("page.html", "dangling.html"):
        _assert_refused(massprop(*view, "--out", name), f"{name}: is there already", "--force")
    assert _everything(Path()) == before
    assert Path("page.html").read_text(encoding="utf-8") == "mine"
    for options in ((), ("--out", "page.html"), ("--out", "page.html")):
        assert massprop(*view, *options, "--force") == (0, "", "")
    assert massprop(*view, "--out", "page.html") == (0, "", "")  # it is ours now
    assert sorted({*_everything(Path())} - {*before}) == ["page.html.1", "there/replay.html.1", "there/report.html.1"]
    for name in ("page.html.1", "there/replay.html.1", "there/report.html.1"):
        assert Path(name).read_text(encoding="utf-8") == "mine"


@pytest.mark.usefixtures("short_replay")
@pytest.mark.parametrize("options", [(), ("--out", "page.html"), ("--force",)], ids=" ".join)
def test_a_full_disk_leaves_nothing_of_a_view(massprop: Massprop, options: tuple[str, ...]) -> None:
    massprop("run", "sample_maneuver", "--set", "duration_s=1", "--out", "there", "--no-report", "-q")
    before = {path: path.read_bytes() for path in Path().rglob("*") if path.is_file()}
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (200_000, limits[1]))
    try:
        done = massprop("view", "there", *options)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    _assert_refused(done, "cannot be written: File too large")
    assert {path: path.read_bytes() for path in Path().rglob("*") if path.is_file()} == before
    assert [path.name for path in Path().iterdir()] == ["there"]


def test_view_of_what_is_no_run_is_refused(massprop: Massprop) -> None:
    _assert_refused(massprop("view", "nowhere", "--out", "x.html"), "nowhere: there is no such run")
    massprop("run", "sample_maneuver", "--set", "duration_s=1", "--out", "there", "-q")
    _assert_refused(massprop("view", "there", "--out", "no/such/folder.html"), "no/such/folder.html: cannot be written")
    assert not Path("x.html").exists()


def test_a_run_is_shown_live_on_this_machine(massprop: Massprop) -> None:
    options = ["--set", "duration_s=1", "--out", "there", "--live", "--speed", "1000", "--no-report"]
    done = massprop("run", "sample_maneuver", *options)
    assert done.status == 0
    assert re.fullmatch(r"massprop: the run is shown at http://localhost:\d+\n", done.err)
    massprop("run", "sample_maneuver", "--set", "duration_s=1", "--out", "unseen", "-q")
    assert _summary(Path("there"))["estimates"] == _summary(Path("unseen"))["estimates"]


@pytest.mark.parametrize("speed", ["0", "-1", "nan", "inf"])
def test_a_speed_that_is_none_is_refused(massprop: Massprop, speed: str) -> None:
    _assert_refused(massprop("run", "sample_maneuver", "--live", "--speed", speed), "must be a number above zero")


def test_a_report_is_written_again_and_leads_to_the_replay_that_is_there(massprop: Massprop) -> None:
    massprop("run", "sample_maneuver", "--set", "duration_s=1", "--out", "there", "--no-report", "-q")
    massprop("view", "there", "-q")
    assert massprop("report", "there") == (0, "there/report.html\n", "")
    assert 'href="replay.html"' in (Path("there") / "report.html").read_text(encoding="utf-8")
    assert massprop("report", "there", "--out", "elsewhere.html", "-q") == (0, "", "")
    assert 'href="replay.html"' not in Path("elsewhere.html").read_text(encoding="utf-8")
    assert massprop("run", "sample_maneuver", "--set", "duration_s=1", "--out", "there", "-q").status == 0  # it is ours


def test_a_run_that_is_not_there_is_sought(massprop: Massprop) -> None:
    massprop("run", "sample_maneuver", "--set", "duration_s=1", "--no-report", "-q")
    for command in ("view", "report"):
        _assert_refused(
            massprop(command, "sample_maneuver"), "there is no such run; did you mean 'runs/sample_maneuver'?"
        )
        _assert_refused(massprop(command, "stuck_on_29"), "'massprop run stuck_on_29' makes one in runs/stuck_on_29")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("run", "orbiter"), "'orbiter' is a vehicle, not a scenario"),
        (("run", "every_jet"), "'every_jet' is a campaign, not a scenario: 'massprop campaign run' takes it"),
        (("estimate", "flight.csv", "--vehicle", "two_failures"), "'two_failures' is a scenario, not a vehicle"),
        (("campaign", "run", "two_failures"), "'two_failures' is a scenario, not a campaign"),
        (("run", "tug.yaml"), "tug.yaml: is a vehicle, not a scenario"),
        (("run", "many.yaml"), "many.yaml: is a campaign, not a scenario"),
        (("campaign", "plan", "tug.yaml"), "tug.yaml: is a vehicle, not a campaign"),
    ],
)
def test_a_file_of_another_kind_is_named_as_what_it_is(
    massprop: Massprop, arguments: tuple[str, ...], words: str
) -> None:
    shutil.copy(REPOSITORY / "docs" / "tutorials" / "tug.yaml", ".")
    shutil.copy(REPOSITORY / "scenarios" / "campaigns" / "every_jet.yaml", "many.yaml")
    _assert_refused(massprop(*arguments), words)


def test_windows_that_overlap_are_told_with_their_lines(massprop: Massprop) -> None:
    windows = [f"  - {{controller: rhc, axis: +x, start_s: {start}, end_s: {start + 2}}}" for start in (1, 2, 9, 8)]
    Path("case.yaml").write_text("\n".join(["name: case", "maneuver:", *windows]), encoding="utf-8")
    done = massprop("check", "case.yaml")
    assert done.status == 2
    assert "case.yaml, line 4: maneuver[1]: overlaps maneuver[0]" in done.out
    assert "case.yaml, line 6: maneuver[3]: overlaps maneuver[2]" in done.out


@pytest.mark.parametrize(
    ("words", "offered"),
    [
        ("massprop run stuck_o", ["stuck_off_11", "stuck_on_29"]),
        ("massprop run mine", ["mine.yaml"]),
        ("massprop graph cl", ["closed_loop"]),
        ("massprop estimate --vehicle orb", ["orbiter"]),
        ("massprop check --vehicle lan", ["lander"]),
        ("massprop campaign run every", ["every_jet"]),
        ("massprop view runs/", ["runs/one"]),
        ("massprop compare runs/one o", ["other"]),
    ],
)
def test_a_shell_is_offered_names(
    massprop: Massprop,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    words: str,
    offered: list[str],
) -> None:
    for folder in ("runs/one", "other"):
        Path(folder).mkdir(parents=True)
        (Path(folder) / "summary.json").touch()
    Path("mine.yaml").touch()
    monkeypatch.setenv("_MASSPROP_COMPLETE", "complete_bash")
    monkeypatch.setenv("COMP_WORDS", words)
    monkeypatch.setenv("COMP_CWORD", str(len(words.split()) - 1))
    with pytest.raises(SystemExit):
        massprop()
    assert capsys.readouterr().out.split() == offered


# ------------------------------------------------------------------------------------------ compare


def test_compare_writes_a_page_of_plots_over_each_other(massprop: Massprop) -> None:
    short = ("--set", "duration_s=2", "--no-report", "-q")
    for seed in ("1", "2"):
        assert massprop("run", "sample_maneuver", *short, "--seed", seed, "--out", f"seed{seed}").status == 0
    done = massprop("compare", "seed1", "seed2")
    assert done.out.endswith("plots:       runs/comparison.html\n")
    page = Path("runs/comparison.html").read_text(encoding="utf-8")
    data = json.loads(re.search(r'id="data">(.*?)</script>', page, re.DOTALL).group(1))  # type: ignore[union-attr]
    rates = data["plots"][0]
    assert [trace["name"] for trace in rates["traces"]] == ["seed1", "seed2"] * 3
    for trace, name in zip(rates["traces"], ["seed1", "seed2"], strict=False):
        shown = data["lists"][trace["y"]]
        np.testing.assert_allclose(shown, np.degrees(Run.load(name)["rate"][:, 0]), rtol=1e-5, atol=1e-9)
    assert massprop("compare", "seed1", "seed2", "--out", "mine.html", "-q") == (0, "", "")
    Path("mine.html").write_text("mine", encoding="utf-8")
    _assert_refused(massprop("compare", "seed1", "seed2", "--out", "mine.html"), "mine.html: is there already")


def test_compare_prints_two_runs_side_by_side(massprop: Massprop) -> None:
    short = ("--set", "duration_s=2", "--no-report", "-q")
    joint = ("--set", "estimation={filter: joint}", "--set", "mass={}", "--set", "detector.kind=off")
    assert massprop("run", "sample_maneuver", *short, "--out", "one").status == 0
    assert massprop("run", "sample_maneuver", *short, *joint, "--out", "other").status == 0
    done = massprop("compare", "one", "other", "--json")
    assert (done.status, done.err) == (0, "")
    found = json.loads(done.out)
    assert list(found) == ["one", "other"]
    for name, parameters in found.items():
        results = Run.load(name).results
        assert [entry["percent_error"] for entry in parameters.values()] == pytest.approx(results.percent_error)
    done = massprop("compare", "one", "other")
    rows = [line for line in done.out.splitlines() if line.startswith("│")]
    assert len(rows) == 10
    assert f"{found['other']['Iyy_inv']['percent_error']:+.5f}" in rows[1]
    assert re.search(r"^one: 2 s, [a-z ]+; found: no failure$", done.out, flags=re.MULTILINE)


def test_compare_of_a_record_shows_estimates(massprop: Massprop) -> None:
    assert massprop("run", "sample_maneuver", "--set", "duration_s=2", "--no-report", "-q", "--out", "one").status == 0
    record = ("estimate", "one/telemetry.csv", "--like", "one", "--no-report", "-q", "--out", "two")
    assert massprop(*record).status == 0
    done = massprop("compare", "one", "two")
    assert done.status == 0
    assert "error %" in done.out
    assert f"{Run.load('two').results.estimates[0]:.6g}" in done.out


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("one",), "give two folders of runs or more"),
        (("one", "nowhere"), "nowhere: there is no such run"),
        (("one", "flyer"), "flyer: is of vehicle 'free_flyer' in units si, and one of 'orbiter' in us"),
    ],
)
def test_what_cannot_be_compared_is_refused(massprop: Massprop, arguments: tuple[str, ...], words: str) -> None:
    for name, scenario in (("one", "sample_maneuver"), ("flyer", "free_flyer_maneuver")):
        assert massprop("run", scenario, "--set", "duration_s=1", "--no-report", "-q", "--out", name).status == 0
    done = massprop("compare", *arguments)
    assert (done.status, done.out) == (2, "")
    assert words in done.err


@pytest.mark.parametrize("options", [(), ("--only", "fig_5_6", "--out", "there", "-q"), ("--json", "--force")])
def test_the_reproduction_says_where_it_went(massprop: Massprop, options: tuple[str, ...]) -> None:
    _assert_refused(massprop("reproduce", *options), "make reproduce", "python -m reproduction", "clone")
    assert _everything(Path()) == []


# --------------------------------------------------------------------------------------------- help


def test_help_names_every_command(massprop: Massprop) -> None:
    done = massprop("--help")
    assert done.status == 0
    for command in COMMANDS:
        assert re.search(rf"\b{command}\b", done.out)


@pytest.mark.parametrize("command", COMMANDS)
def test_help_of_a_command_shows_an_example(massprop: Massprop, command: str) -> None:
    done = massprop(command, "--help")
    assert (done.status, done.err) == (0, "")
    text = re.sub(r"\x1b\[[0-9;]*m", "", done.out)
    assert re.search(rf"Example:\s+`?massprop {command}\b", text), text


# ----------------------------------------------------------------------------- processes of their own


def test_the_module_runs_as_a_program(tmp_path: Path) -> None:
    done = _python("list", "--json", folder=tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    assert "sample_maneuver" in json.loads(done.stdout)["scenarios"]


def test_bad_input_to_the_program(tmp_path: Path) -> None:
    (tmp_path / "case.yaml").write_text("sede: 1\n", encoding="utf-8")
    done = _python("run", "case.yaml", folder=tmp_path)
    _assert_refused(Outcome(done.returncode, done.stdout, done.stderr), "case.yaml, line 1: sede: unknown key")
    assert _everything(tmp_path) == ["case.yaml"]


def test_a_run_of_the_program_with_its_figures(tmp_path: Path) -> None:
    # long enough to hold every window of its own
    (tmp_path / "case.yaml").write_text("name: mine\nduration_s: 1.6\n" + MANEUVER, encoding="utf-8")
    done = _python("run", "case.yaml", "--json", folder=tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    assert json.loads(done.stdout) == _summary(tmp_path / "runs" / "mine")
    assert len(list((tmp_path / "runs" / "mine" / "figures").glob("*.png"))) == 19  # no sample was tested: no margins


def test_a_run_of_the_program_without_figures(tmp_path: Path) -> None:
    options = ["--set", "duration_s=1", "--out", "there"]
    done = _python("run", "sample_maneuver", "--no-figures", *options, folder=tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    assert {path.name for path in (tmp_path / "there").iterdir()} == FILES - {"figures"}
    assert done.stdout.splitlines()[-1] == "files:       there/   report: there/report.html"


@pytest.mark.parametrize("arguments", [("list",), ("check", "--schema", "scenario", "--json")], ids=" ".join)
def test_a_closed_pipe_ends_the_program_quietly(tmp_path: Path, arguments: tuple[str, ...]) -> None:
    """As in `massprop list | head -0`: nobody reads, nobody is told."""
    command = [sys.executable, "-m", "massprop_drake", *arguments]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=tmp_path) as program:
        assert program.stdout is not None
        assert program.stderr is not None
        program.stdout.close()  # long before anything is printed
        err = program.stderr.read()
    assert (program.returncode, err) == (0, "")
