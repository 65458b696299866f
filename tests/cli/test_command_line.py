"""The command line: what it prints, where, with which exit status, and what it leaves behind."""

from __future__ import annotations

import importlib.util
import json
import re
import resource
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_probe import FILES, Massprop, contents, everything, require_refused
from conftest import REPOSITORY

from massprop_drake import Run
from massprop_drake.display import graphs
from massprop_drake.inputs.yaml import to_yaml
from massprop_drake.maths.kernels import compiler

COMMANDS = ("list", "run", "estimate", "compare", "graph", "view", "report", "check")
LOOP = ("--set", "execution.engine=loop")  # the diagram's bits, sooner
SHORT = ("run", "sample_maneuver", "--set", "duration_s=1", *LOOP)
LEAN = ("--no-report", "-q")


def _summary(folder: str) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(Path(folder, "summary.json").read_text(encoding="utf-8"))
    return {key: value for key, value in found.items() if key != "timing"}


def test_list_names_everything_that_is_bundled(massprop: Massprop) -> None:
    done = massprop("list", "--json")
    assert (done.status, done.err) == (0, "")
    found = json.loads(done.out)
    assert set(found) == {"vehicles", "scenarios", "diagrams", "campaigns"}
    whole = {"vehicle", "autopilot", "estimation", "closed_loop", "open_loop", "replay"}
    assert set(found["diagrams"]) == whole | {"vehicle_tracked", "estimation_joint", "estimation_pose"}
    assert all(description for kind in found.values() for description in kind.values())
    lines = massprop("list").out
    for kind, name in (("vehicle", "lander"), ("scenario", "jet_pulses"), ("diagram", "estimation")):
        assert re.search(rf"^{kind}\s+{name}\s+\S", lines, re.MULTILINE), name


# ---------------------------------------------------------------------------------------------- run


def test_run_writes_a_folder_and_prints_the_estimates(massprop: Massprop) -> None:
    done = massprop("run", "sample_maneuver", "--set", "duration_s=3")
    assert (done.status, done.err) == (0, "")
    assert {path.name for path in Path("runs/sample_maneuver").iterdir()} == FILES
    assert _summary("runs/sample_maneuver")["duration_s"] == pytest.approx(2.96)
    for parameter in ("Ixx⁻¹", "Iyy⁻¹", "Izz⁻¹", "Iyz⁻¹", "Ixz⁻¹", "Ixy⁻¹", "x_cm", "y_cm", "z_cm", "1/m"):
        assert parameter in done.out
    for heading in ("estimate", "truth", "error %", "1-sigma", "in 3 sigma"):
        assert heading in done.out
    assert "files:       runs/sample_maneuver/" in done.out
    assert massprop(*SHORT, "--quiet") == (0, "", "")  # in the place of the earlier run
    assert everything()[:2] == ["runs", "runs/sample_maneuver"]
    said = "there is no such run; did you mean 'runs/sample_maneuver'?"
    require_refused(massprop("view", "sample_maneuver"), said)


def test_run_prints_json_alone(massprop: Massprop) -> None:
    done = massprop(*SHORT, "--json", "--out", "there", "--no-report", "--view")
    assert (done.status, done.err) == (0, "")
    assert json.loads(done.out) == json.loads(Path("there/summary.json").read_text(encoding="utf-8"))
    assert {path.name for path in Path("there").iterdir()} == FILES - {"report.html"} | {"replay.html"}


def test_run_takes_overrides_and_a_seed(massprop: Massprop) -> None:
    overrides = ["--set", "seed=3", "--set", "rotation.filter=extended"]
    assert massprop(*SHORT, *overrides, "--seed", "5", "--out", "a", *LEAN).status == 0
    run = Run.load("a")
    assert run.scenario.seed == run.summary["seed"] == 5
    assert run.scenario.rotation.filter == "extended"


def test_a_runs_folder_runs_again_and_seeds_differ(massprop: Massprop) -> None:
    for name, scenario, seed in (("one", "sample_maneuver", "4"), ("again", "one", "4"), ("two", "one", "5")):
        asked = ("--set", "duration_s=3", *LOOP, "--seed", seed, "--out", name, *LEAN)
        assert massprop("run", scenario, *asked).status == 0
    assert _summary("one") == _summary("again")
    for name in ("telemetry.csv", "scenario.yaml", "filter_state.json"):
        assert Path("one", name).read_bytes() == Path("again", name).read_bytes()
    assert _summary("one")["estimates"] != _summary("two")["estimates"]


def test_files_of_others_need_force(massprop: Massprop) -> None:
    Path("mine").mkdir()
    Path("mine/notes.txt").write_text("keep", encoding="utf-8")
    done = massprop(*SHORT, "--out", "mine")
    require_refused(done, "mine: holds files that are not of an earlier run", "notes.txt", "--force")
    assert everything() == ["mine", "mine/notes.txt"]
    assert massprop(*SHORT, "--out", "mine", "--force", *LEAN).status == 0
    assert {path.name for path in Path("mine").iterdir()} == FILES - {"report.html"}
    assert Path("mine.1/notes.txt").read_text(encoding="utf-8") == "keep"


def test_a_run_is_shown_live_on_this_machine(massprop: Massprop) -> None:
    done = massprop(*SHORT, "--out", "there", "--live", "--speed", "1000", "--no-report")
    assert done.status == 0
    assert re.fullmatch(r"massprop: the run is shown at http://localhost:\d+\n", done.err)
    massprop(*SHORT, "--out", "unseen", *LEAN)
    assert _summary("there")["estimates"] == _summary("unseen")["estimates"]


# ---------------------------------------------------------------------------------- what is refused

MINE = {
    "file": "x",
    "key.yaml": "sede: 1\n",
    "nan.yaml": "duration_s: .nan\n",
    "torn.yaml": "name: [a\n",
    "toy.yaml": "name: toy\nunits: si\n",
    "other.yaml": "vehicle: toy.yaml\n",
    "bad.csv": "a,b\n",
}
REFUSED: dict[tuple[str, ...], str] = {
    ("run", "key.yaml"): "key.yaml, line 1: sede: unknown key; did you mean 'seed'?",
    ("run", "nan.yaml"): "nan.yaml, line 1: duration_s: input should be a finite number, got nan",
    ("run", "torn.yaml"): "torn.yaml: not valid YAML",
    ("run", "other.yaml"): "toy.yaml",
    ("run", "nowhere.yaml"): "nowhere.yaml: no such file",
    ("run", "sample_manuever"): "did you mean 'sample_maneuver'?",
    ("run", "sample_maneuver", "--seed", "-1"): "Invalid value for '--seed'",
    ("run", "sample_maneuver", "--set", "maneuver[0].end_s=0.1"): "--set maneuver[0].end_s: maneuver[0]: ",
    ("run", "sample_maneuver", "--set", "seed"): "--set seed: expected KEY=VALUE",
    ("run", "sample_maneuver", "--set", "sede=1"): "sede: unknown key; did you mean 'seed'?",
    ("run", "sample_maneuver", "--live", "--speed", "nan"): "must be a number above zero",
    ("run", "x" * 300): "x" * 300,
    (*SHORT, "--out", "y" * 300): "y" * 300,
    (*SHORT, "--out", "."): "is the current folder or one above it",
    (*SHORT, "--out", "file"): "file: is a file; give a folder to write to",
    (*SHORT, "--out", "file/below"): "below: cannot be written",
    (*SHORT, "--out", "dangling"): "dangling: is a link to nowhere",
    (*SHORT, "--out", "loop"): "loop: ",
    ("run", "orbiter"): "'orbiter' is a vehicle, not a scenario",
    ("run", "every_jet"): "'every_jet' is a campaign, not a scenario: 'massprop campaign run' takes it",
    ("campaign", "plan", "tug.yaml"): "tug.yaml: is a vehicle, not a campaign",
    ("campaign", "run", "two_failures"): "'two_failures' is a scenario, not a campaign",
    ("estimate", "flight.csv", "--vehicle", "two_failures"): "'two_failures' is a scenario, not a vehicle",
    ("estimate", "bad.csv", "--vehicle", "orbiter", "--out", "a/b"): "bad.csv: no columns time_s",
    ("graph", "autopilot", "--out", "dangling"): "dangling: is a link to nowhere",
    ("graph", "autopilot", "--out", "file/below"): "below: cannot be written",
    ("graph", "closed_lop"): "'closed_lop' is no diagram; did you mean 'closed_loop'?",
    ("graph", "mine.py"): "'mine.py' is a file; say which of its functions builds the diagram: mine.py:build",
    ("check",): "nothing to check",
    ("view", "nowhere", "--out", "x.html"): "nowhere: there is no such run",
    ("report", "stuck_on_29"): "'massprop run stuck_on_29' makes one in runs/stuck_on_29",
    ("compare", "one"): "give two folders of runs or more",
    ("reproduce", "--only", "fig_5_6", "--out", "there", "-q"): "make reproduce",
}


@pytest.mark.parametrize("arguments", REFUSED, ids=lambda words: " ".join(words)[:60])
def test_what_is_wrong_is_one_message_before_the_work(
    massprop: Massprop, monkeypatch: pytest.MonkeyPatch, arguments: tuple[str, ...]
) -> None:
    def fail(*_: object, **__: object) -> None:
        raise AssertionError

    monkeypatch.setattr("massprop_drake.runners.simulate.simulate", fail)
    monkeypatch.setattr("massprop_drake.display.graphs.build", fail)
    for name, text in MINE.items():
        Path(name).write_text(text, encoding="utf-8")
    shutil.copy(REPOSITORY / "docs" / "tutorials" / "tug.yaml", ".")
    Path("dangling").symlink_to("nowhere")
    Path("loop").symlink_to("loop")
    before = everything()
    require_refused(massprop(*arguments), REFUSED[arguments])
    assert everything() == before


@pytest.mark.parametrize("arguments", [("run", "sample_maneuver"), ("campaign", "run", "every_jet")])
def test_without_numba_nothing_is_begun_that_needs_it(
    massprop: Massprop, monkeypatch: pytest.MonkeyPatch, arguments: tuple[str, ...]
) -> None:
    find = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name, *of: None if name == "numba" else find(name, *of))
    compiler.cache_clear()
    done = massprop(*arguments, "--compiled")
    require_refused(done, "execution.compiled: needs numba: pip install 'massprop-drake[fast]'")
    assert everything() == []


@pytest.mark.parametrize(
    "arguments",
    [("rum",), ("run",), ("run", "a", "b"), ("run", "a", "--sed", "1"), ("run", "a", "--seed", "one")],
)
def test_wrong_usage_ends_with_status_2(massprop: Massprop, arguments: tuple[str, ...]) -> None:
    done = massprop(*arguments)
    require_refused(done)
    assert ". Usage: " in done.err or "? Usage: " in done.err
    assert "?. " not in done.err


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
    windows = [f"  - {{controller: rhc, axis: +x, start_s: {start}, end_s: {start + 2}}}" for start in (1, 2)]
    Path("case.yaml").write_text("sede: 1\n", encoding="utf-8")
    Path("flown.yaml").write_text("\n".join(["maneuver:", *windows]), encoding="utf-8")
    Path("toys.yaml").write_text("vehicle: toy.yaml\n", encoding="utf-8")
    files = ("toy.yaml", "orbiter", "case.yaml", "flown.yaml", "nowhere.yaml", "toys.yaml")
    done = massprop("check", *files)
    assert (done.status, "Traceback" in done.out + done.err) == (2, False)
    text = "\n".join(lines := [line for line in done.out.splitlines() if not line.startswith(" ")])
    assert len(lines) == 7
    assert lines[-1] == "toys.yaml: 2 problems of the vehicle, told above"
    for words in ("jets[0].thrust", "color: unknown key", "nowhere.yaml: no such file", "orbiter: ok"):
        assert words in text
    assert "case.yaml, line 1: sede: unknown key; did you mean 'seed'?" in text
    assert "flown.yaml, line 3: maneuver[1]: overlaps maneuver[0]" in text
    found = massprop("check", *files, "--json")
    assert (found.status, found.err) == (2, "")
    assert [one["ok"] for one in json.loads(found.out)] == [False, True, False, False, False, False]
    assert massprop("check", "orbiter", "--quiet") == (0, "", "")
    quiet = massprop("check", "-q", "nowhere.yaml", "orbiter")
    require_refused(quiet, "massprop: nowhere.yaml: no such file\n")


def test_check_reports_on_a_vehicle_as_json(massprop: Massprop) -> None:
    done = massprop("check", "free_flyer", "sample_maneuver", "--json", "--pairs", "7")
    assert (done.status, done.err) == (0, "")
    vehicle, scenario = json.loads(done.out)
    assert set(vehicle["report"]) == {"body", "control", "observability", "notes", "alike", "isolable"}
    assert len(vehicle["report"]["alike"]) == 7
    assert "report" not in scenario


@pytest.mark.parametrize(
    ("kind", "name", "unit"),
    [
        ("vehicle", "jets[].thrust", "lbf | N"),
        ("scenario", "rotation.filter", "-"),
        ("campaign", "gates{}.max", None),
        ("map", "time.differences[].rate", None),
    ],
)
def test_check_shows_the_keys_of_a_kind_of_file(massprop: Massprop, kind: str, name: str, unit: str | None) -> None:
    done = massprop("check", "--schema", kind, "--json")
    assert (done.status, done.err) == (0, "")
    keys = {key["name"]: key for key in json.loads(done.out)}
    assert unit in (keys[name]["unit"], None)
    assert all(set(key) == {"name", "type", "unit", "default", "range", "meaning"} for key in keys.values())
    assert all(key["meaning"] for key in keys.values())
    shown = massprop("check", "--schema", kind).out
    assert [key for key in keys if key not in shown] == []


# --------------------------------------------------------------------------------- graph, report, view


def test_graph_writes_dot_and_svg(massprop: Massprop) -> None:
    done = massprop("graph", "autopilot", "--json")
    assert (done.status, done.err) == (0, "")
    names = ["autopilot.dot", "autopilot.svg", "autopilot_overview.dot", "autopilot_overview.svg"]  # nothing to open
    assert sorted(path.name for path in Path("runs/graphs").iterdir()) == [*names, "manifest.json"]
    assert sorted(json.loads(done.out)) == [f"runs/graphs/{name}" for name in names]
    assert Path("runs/graphs/autopilot.dot").read_text(encoding="utf-8").startswith("digraph")
    svg = Path("runs/graphs/autopilot.svg").read_text(encoding="utf-8")
    for name in ("<svg", "jet_selection", "phase_space_controller", "attitude_reference"):
        assert name in svg


def test_graph_without_a_program_to_draw_writes_dot_and_says_so(
    massprop: Massprop, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(graphs, "svg_text", lambda _: None)
    done = massprop("graph", "vehicle", "autopilot", "--out", "graphs")
    assert (done.status, done.err.count("\n")) == (0, 1)
    assert done.err.startswith("massprop: no SVG: install a program that draws it")
    dots = {"vehicle.dot", "vehicle_inside.dot", "vehicle_overview.dot", "autopilot.dot", "autopilot_overview.dot"}
    assert {path.name for path in Path("graphs").iterdir()} == dots | {"manifest.json"}
    Path("autopilot.dot").write_text("mine", encoding="utf-8")
    here = ("graph", "autopilot", "--out", ".", "-q")
    require_refused(massprop(*here), "autopilot.dot: is there already", "--force to keep it as autopilot.dot.1")
    assert massprop(*here, "--force") == (0, "", "")
    assert Path("autopilot.dot.1").read_text(encoding="utf-8") == "mine"
    assert Path("autopilot.dot").read_text(encoding="utf-8").startswith("digraph")


def test_report_and_replay_are_written_again_and_lead_to_each_other(massprop: Massprop) -> None:
    massprop(*SHORT, "--out", "there", "-q")
    report = Path("there/report.html")
    assert "replay.html" not in report.read_text(encoding="utf-8")
    assert massprop("view", "there") == (0, "there/replay.html\n", "")
    assert 'href="replay.html"' in report.read_text(encoding="utf-8")
    report.write_text("mine", encoding="utf-8")
    assert massprop("view", "there", "-q") == (0, "", "")  # the report is left as it is
    require_refused(massprop("report", "there"), "there/report.html: is there already", "keep it as report.html.1")
    report.unlink()
    assert massprop("report", "there") == (0, "there/report.html\n", "")
    assert 'href="replay.html"' in report.read_text(encoding="utf-8")
    for command in ("report", "view"):
        assert massprop(command, "there", "--out", f"{command}.html", "-q") == (0, "", "")
        assert Path(f"{command}.html").read_text(encoding="utf-8").startswith("<!DOCTYPE html>")
    assert massprop(*SHORT, "--out", "there", "-q").status == 0  # the replay goes with the run that it showed
    assert {path.name for path in Path("there").iterdir()} == FILES


def test_a_full_disk_leaves_nothing_of_a_view(massprop: Massprop, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("massprop_drake.display.flight3d.replay_html", lambda _: "<!DOCTYPE html>\n" + 300_000 * ".")
    massprop(*SHORT, "--out", "there", *LEAN)
    before = contents()
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (200_000, limits[1]))
    try:
        refused = [massprop("view", "there", *options) for options in ((), ("--out", "page.html"))]
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    for done in refused:
        require_refused(done, "cannot be written: File too large")
    assert contents() == before


# --------------------------------------------------------------------------------------- compare, help


def test_compare_prints_runs_side_by_side_and_plots_them_over_each_other(massprop: Massprop) -> None:
    short = ("run", "sample_maneuver", "--set", "duration_s=2", *LOOP, *LEAN)
    joint = ("--set", "estimation={filter: joint}", "--set", "mass={}", "--set", "detector.kind=off")
    assert massprop(*short, "--out", "one").status == 0
    assert massprop(*short, *joint, "--out", "other").status == 0
    found = json.loads(massprop("compare", "one", "other", "--json").out)
    assert list(found) == ["one", "other"]
    for name, parameters in found.items():
        results = Run.load(name).results
        assert [entry["percent_error"] for entry in parameters.values()] == pytest.approx(results.percent_error)
    done = massprop("compare", "one", "other")
    assert (done.status, done.err) == (0, "")
    rows = [line for line in done.out.splitlines() if line.startswith("│")]
    assert len(rows) == 10
    assert f"{found['other']['Iyy_inv']['percent_error']:+.5f}" in rows[1]
    assert re.search(r"^one: 2 s, [a-z ]+; found: no failure$", done.out, flags=re.MULTILINE)
    assert done.out.endswith("plots:       runs/comparison.html\n")
    page = Path("runs/comparison.html").read_text(encoding="utf-8")
    data = json.loads(re.search(r'id="data">(.*?)</script>', page, re.DOTALL).group(1))  # type: ignore[union-attr]
    traces = data["plots"][0]["traces"]
    assert [trace["name"] for trace in traces] == ["one", "other"] * 3
    for trace, name in zip(traces, ["one", "other"], strict=False):
        expected = np.degrees(Run.load(name)["rate"][:, 0])
        np.testing.assert_allclose(data["lists"][trace["y"]], expected, rtol=1e-5, atol=1e-9)
    flyer = ("run", "free_flyer_maneuver", "--set", "duration_s=1", *LEAN, "--out", "flyer")
    assert massprop(*flyer).status == 0
    done = massprop("compare", "one", "flyer")
    require_refused(done, "flyer: is of vehicle 'free_flyer' in units si, and one of 'orbiter' in us")


@pytest.mark.parametrize("command", COMMANDS)
def test_help_of_a_command_shows_an_example(massprop: Massprop, command: str) -> None:
    done = massprop(command, "--help")
    assert (done.status, done.err) == (0, "")
    text = re.sub(r"\x1b\[[0-9;]*m", "", done.out)
    assert re.search(rf"Example:\s+`?massprop {command}\b", text), text


OFFERED = {
    "massprop run stuck_o": ["stuck_off_11", "stuck_on_29"],
    "massprop run mine": ["mine.yaml"],
    "massprop graph cl": ["closed_loop"],
    "massprop estimate --vehicle orb": ["orbiter"],
    "massprop compare runs/one o": ["other"],
}


@pytest.mark.parametrize("words", OFFERED)
def test_a_shell_is_offered_names(
    massprop: Massprop, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], words: str
) -> None:
    for folder in ("runs/one", "other"):
        Path(folder).mkdir(parents=True)
        Path(folder, "summary.json").touch()
    Path("mine.yaml").touch()
    monkeypatch.setenv("_MASSPROP_COMPLETE", "complete_bash")
    monkeypatch.setenv("COMP_WORDS", words)
    monkeypatch.setenv("COMP_CWORD", str(len(words.split()) - 1))
    with pytest.raises(SystemExit):
        massprop()
    assert capsys.readouterr().out.split() == OFFERED[words]
