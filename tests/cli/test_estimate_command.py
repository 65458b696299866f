"""`massprop estimate` and `massprop check` on telemetry: what they print, write and refuse."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from command_probe import FILES, Massprop, everything, require_refused
from telemetry_probe import Log, toy_vehicle

from massprop_drake import Run, load_scenario
from massprop_drake.inputs.vehicle_file import Vehicle
from massprop_drake.inputs.yaml import to_yaml


@pytest.fixture
def toy(toy_data: dict[str, Any], massprop: Massprop) -> Vehicle:
    """The toy vehicle, also as toy.yaml in the current folder, with its telemetry in flight.csv."""
    Path("toy.yaml").write_text(to_yaml(toy_data), encoding="utf-8")
    vehicle = toy_vehicle(toy_data)
    Log(vehicle).write(Path("flight.csv"))
    return vehicle


@pytest.mark.usefixtures("toy")
def test_a_vehicle_and_a_log_give_a_folder_and_a_table(massprop: Massprop) -> None:
    done = massprop("estimate", "flight.csv", "--vehicle", "toy.yaml")
    assert (done.status, done.err) == (0, "")
    assert {path.name for path in Path("runs/flight").iterdir()} == FILES
    assert [path.name for path in Path("runs").iterdir()] == ["flight"]
    lines = done.out.splitlines()
    assert lines[0].startswith("flight.csv: toy, 5.9 s")
    for beginning in (
        "consistency: inconsistent; mean NIS",  # rates of the log do not couple
        "inconsistent: a steady force or an accelerometer bias ",
        "Izz⁻¹ not excited: ",
        "samples:     60 rows;",
        "detected:    nothing, since no sample was tested",
        "files:",
    ):
        assert any(line.startswith(beginning) for line in lines), beginning
    (warning,) = [line for line in lines if line.startswith("warning")]  # six seconds excite too little
    assert "no sample was tested for failed jets" in warning
    assert Run.load("runs/flight").scenario.vehicle_data.name == "toy"
    done = massprop("estimate", "flight.csv", "--vehicle", "toy.yaml", "--json", "--no-figures", "--out", "there")
    assert json.loads(done.out) == json.loads(Path("there/summary.json").read_text(encoding="utf-8"))
    assert {path.name for path in Path("there").iterdir()} == FILES - {"figures"}


@pytest.mark.usefixtures("toy")
def test_like_takes_every_setting_and_options_replace_some(massprop: Massprop) -> None:
    Path("mine.yaml").write_text(
        "name: mine\nvehicle: toy.yaml\nrotation: {filter: extended}\nestimation: {start: zero}\n"
        "maneuver:\n  - {controller: rhc, axis: +x, start_s: 1, end_s: 2}\n",
        encoding="utf-8",
    )
    assert massprop("estimate", "flight.csv", "--like", "mine.yaml").status == 0
    scenario = load_scenario("runs/flight")
    assert (scenario.name, scenario.rotation.filter, scenario.estimation.start) == ("mine", "extended", "zero")
    assert not scenario.maneuver  # what was to be flown is no setting of the estimators
    options = ("--start", "nominal", "--set", "detector.margin=5", "--out", "again")
    assert massprop("estimate", "flight.csv", "--like", "runs/flight", *options).status == 0
    scenario = load_scenario("again")
    assert (scenario.estimation.start, scenario.detector.margin) == ("nominal", 5.0)


@pytest.mark.usefixtures("toy")
def test_going_on_needs_nothing_but_the_folder(massprop: Massprop, toy: Vehicle) -> None:
    log = Log(toy)
    rows = log.rows
    for part, some in (("one", rows[:31]), ("two", rows[30:])):
        log.rows = some
        log.write(Path(f"{part}.csv"))
    assert massprop("estimate", "flight.csv", "--vehicle", "toy.yaml", "--set", "name=x").status == 0
    assert massprop("estimate", "one.csv", "--vehicle", "toy.yaml").status == 0
    assert massprop("estimate", "two.csv", "--resume-from", "runs/one").status == 0
    whole, two = Run.load("runs/flight"), Run.load("runs/two")
    assert two.summary["estimates"] == whole.summary["estimates"]
    assert two.state["states"] == whole.state["states"]


@pytest.mark.usefixtures("toy")
def test_rows_on_standard_input(massprop: Massprop) -> None:
    content = Path("flight.csv").read_bytes()
    done = massprop("estimate", "-", "--vehicle", "toy.yaml", stdin=content)
    assert (done.status, done.err) == (0, "")
    assert done.out.startswith("standard input: toy, 5.9 s")
    assert massprop("estimate", "flight.csv", "--vehicle", "toy.yaml", "--quiet").status == 0
    one, other = Run.load("runs/stdin").summary, Run.load("runs/flight").summary
    assert one["estimates"] == other["estimates"]


def test_a_vehicle_without_gyro_is_refused_with_a_reason(massprop: Massprop, toy_data: dict[str, Any]) -> None:
    toy_data["gyros"] = []
    Path("bare.yaml").write_text(to_yaml(toy_data), encoding="utf-8")
    done = massprop("estimate", "flight.csv", "--vehicle", "bare.yaml")
    require_refused(done, "bare.yaml", "gyros: is empty", "without measured rates")


@pytest.mark.usefixtures("toy")
@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("flight.csv",), "whose telemetry is it? Give --vehicle"),
        (("flight.csv", "--vehicle", "toy.yaml", "--like", "sample_maneuver"), "give either --vehicle or --like"),
        (("nowhere.csv", "--vehicle", "toy.yaml"), "nowhere.csv: no such file"),
        (("flight.csv", "--vehicle", "nowhere.yaml"), "nowhere.yaml: no such file"),
        (("flight.csv", "--vehicle", "orbiter"), "flight.csv: no columns jet_F1F, jet_F3F"),
        (("flight.csv", "--vehicle", "toy.yaml", "--set", "rotation.filtr=extended"), "did you mean 'filter'?"),
        (("flight.csv", "--resume-from", "nowhere"), "nowhere"),
        (("broken.csv", "--vehicle", "toy.yaml"), "broken.csv, line 52, column"),
        (("flight.csv", "--vehicle", "toy.yaml", "--out", "."), "holds what is to be read, and would be replaced"),
        (("flight.csv", "--vehicle", "toy.yaml", "--out", "toy.yaml"), "toy.yaml: is a file; give a folder"),
    ],
)
def test_what_is_refused(massprop: Massprop, arguments: tuple[str, ...], words: str) -> None:
    lines = Path("flight.csv").read_text(encoding="utf-8").splitlines()
    lines[51] = lines[51].replace(",", ",broken", 1)
    Path("broken.csv").write_text("\n".join(lines), encoding="utf-8")
    before = everything()
    require_refused(massprop("estimate", *arguments), words)
    assert [name for name in everything() if name != "runs"] == before


# -------------------------------------------------------------------------------------------- check


def test_check_telemetry(massprop: Massprop, toy: Vehicle) -> None:
    done = massprop("check", "flight.csv")
    assert (done.status, done.out) == (0, "flight.csv: ok: telemetry, 60 rows, 0.1 s apart, from 0 to 5.9 s\n")
    log = Log(toy)
    del log.rows[20:25]
    log.add("note", ["hello"] * 55)
    log.write(Path("other.csv"))
    done = massprop("check", "other.csv", "toy.yaml", "--vehicle", "toy.yaml")
    assert done.status == 0
    assert "telemetry of toy, 55 rows, 0.1 s apart, from 0 to 5.9 s; 1 gaps; columns not used: note" in done.out
    done = massprop("check", "other.csv", "--json")
    assert done.status == 2
    (finding,) = json.loads(done.out)
    assert finding["findings"] == [
        "other.csv, line 2, column note: 'hello' is not a number; leave the cell empty where there is no value"
    ]
