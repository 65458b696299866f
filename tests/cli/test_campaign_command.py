"""`massprop campaign`: plan, run, status, report and compare, and campaigns in `list`, `check` and `run`."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from campaign_rows import declaration, failure, folder, lost, row
from command_probe import Massprop, contents, require_refused
from dask_probe import client_here

from massprop_drake import Campaign, Run
from massprop_drake.inputs.model import yaml_text
from massprop_drake.inputs.vehicle_file import load_vehicle
from massprop_drake.studies.campaign import engine

SHORT = """
name: short
base: sample_maneuver
cases: 3
seed: 3
set: {duration_s: 1.0}
keep: none
draw:
  plant.thrust_dispersion: {uniform: {low: 0.0, high: 0.01}}
sweep: {estimation.start: [zero, nominal]}
gates: {failed_to_run: {max: 0}}
"""


def written(text: str = SHORT, name: str = "short.yaml") -> str:
    Path(name).write_text(text, encoding="utf-8")
    return name


# ------------------------------------------------------------------------------------- what is kept


@pytest.mark.parametrize("force", [(), ("--force",)], ids=["", "force"])
def test_a_campaigns_folder_and_what_is_read_stay(
    massprop: Massprop, monkeypatch: pytest.MonkeyPatch, force: tuple[str, ...]
) -> None:
    assert massprop("campaign", "plan", written(), "--out", "K/C", "-q").status == 0
    Path("V").mkdir()
    Path("V/vehicle.yaml").write_text(yaml_text(load_vehicle("orbiter")), encoding="utf-8")
    case = written("vehicle: V/vehicle.yaml\nduration_s: 1.0\n", "case.yaml")
    written("base: ../case.yaml\ncases: 2\nseed: 1\n", "V/many.yaml")
    before = contents()
    for command in (
        ("run", case, "--out", "V"),
        *(("run", case, "--out", name) for name in ("K/C", "K/C/cases/0000")),
        ("campaign", "plan", "V/many.yaml", "--out", "V"),
        ("campaign", "plan", "V/many.yaml", "--out", "."),
        ("campaign", "run", "V/many.yaml", "--out", "K"),
        ("campaign", "run", "V/many.yaml", "--out", "K/C/cases", "--workers", "1"),
    ):
        done = massprop(*command, *force, "-q")
        require_refused(done, f"{command[command.index('--out') + 1]}: ", "give another folder")
        assert contents() == before
    monkeypatch.chdir("V")
    for target in (".", "..", "../V"):
        require_refused(
            massprop("campaign", "plan", "many.yaml", "--out", target, *force), f"{target}: ", "another folder"
        )


def test_a_runs_folder_is_told_from_a_campaigns(massprop: Massprop) -> None:
    assert massprop("campaign", "plan", written(), "--out", "C", "-q").status == 0
    assert massprop("run", "sample_maneuver", "--set", "duration_s=1", "--out", "A", "-q", "--no-report").status == 0
    for command in (("campaign", "status"), ("campaign", "plan"), ("campaign", "run")):
        require_refused(massprop(*command, "A"), "massprop: A: is a run's folder; 'massprop run A'")
    require_refused(massprop("estimate", "A/telemetry.csv", "--vehicle", "A", "--out", "B"), "A: is a run's folder;")
    Path("C/summary.json").write_text("{}", encoding="utf-8")  # as of its report
    for command in (("report", "C"), ("view", "C"), ("compare", "C", "A"), ("run", "C")):
        require_refused(massprop(*command), "massprop: C: is a campaign's folder; 'massprop campaign report C'")


# --------------------------------------------------------------------------------- all of it, once


def test_a_campaign_is_flown_reported_and_flown_again_alone(
    massprop: Massprop, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(engine, "local_client", client_here)
    flight = ("campaign", "run", written(), "--set", "cases=1", "--workers", "1", "--out", "K")
    done = massprop(*flight)
    assert done.status == 0, done
    assert all("Dask's dashboard is at http://" in line for line in done.err.splitlines())
    assert "Gate passed: Cases that failed to run" in done.out
    assert done.out.endswith("report: K/campaign.html\n")
    cases = json.loads(Path("K/summary.json").read_text(encoding="utf-8"))["cases"]
    assert cases == {
        "planned": 2, "tried": 2, "flown": 2, "judged": 2, "failing": 0, "measured": 2, "ended_wrong": 0,
        "failed_to_run": 0,
    }  # fmt: skip
    said = "K: holds results already; --resume goes on with them, --out names another folder\n"
    require_refused(massprop(*flight), said)
    said = "'massprop campaign run K --only 1' flies it and keeps it\n"
    require_refused(massprop("run", "K/cases/0001"), said)
    alone = massprop("campaign", "run", "K", "--only", "1")
    assert alone.out == "case 1: K/cases/0001/; 'massprop run K/cases/0001' flies it again\n", alone
    assert massprop("run", "K/cases/0001", "--no-figures", "--no-report", "--out", "B", "-q").status == 0
    kept, flown = Run.load("K/cases/0001").summary, Run.load("B").summary
    assert {**kept, "timing": None} == {**flown, "timing": None}
    row_1 = Campaign.load("K").to_pandas().loc[1]
    assert row_1["estimate.Ixx_inv"] == kept["estimates"]["inverse_inertia"][0][0]
    assert row_1["sweep.estimation.start"] == "nominal"


# -------------------------------------------------------------------------------- plan and status


def test_a_plan_says_what_is_drawn_and_writes_it(massprop: Massprop) -> None:
    done = massprop("campaign", "plan", written(), "--set", "cases=4")
    assert (done.status, done.err) == (0, "")
    assert "8 cases of 'sample_maneuver', 2 of each draw; drawn: plant.thrust_dispersion" in done.out
    assert done.out.endswith("plan: runs/short/plan.parquet\n")
    status = massprop("campaign", "status", "runs/short")
    assert status.out == "0 of 8 planned cases have been flown so far.\n"
    cases = json.loads(massprop("campaign", "plan", "short.yaml", "--json", "--out", "other").out)
    assert [case["cell"] for case in cases] == [0, 1] * 3
    assert cases[0]["drawn"] == cases[1]["drawn"] != cases[2]["drawn"]


WITHOUT_DASK = """
import sys
sys.modules.update(dict.fromkeys(("dask", "distributed", "psutil", "threadpoolctl")))
from massprop_drake.cli.main import run
for words in (("plan", "short.yaml", "--out", "K", "-q"), ("run", "K")):
    sys.argv = ["massprop", "campaign", *words]
    print(run())
"""


def test_planning_needs_no_dask_and_flying_says_that_it_does(tmp_path: Path) -> None:
    (tmp_path / "short.yaml").write_text(SHORT, encoding="utf-8")
    command = [sys.executable, "-c", WITHOUT_DASK]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["0", "2"]
    assert done.stderr == (
        "massprop: flights of a campaign need dask, distributed, psutil, threadpoolctl: "
        "pip install 'massprop-drake[campaign]'\n"
    )


# ------------------------------------------------------------------------------------------ report


@pytest.mark.parametrize(("asked", "status"), [("{max: 1000}", 0), ("{max: 0.001}", 3)])
def test_a_gate_that_fails_is_status_3(massprop: Massprop, asked: str, status: int) -> None:
    text = f"{SHORT}".replace("failed_to_run: {max: 0}", f"false_declarations_per_hour: {asked}")
    cases = [{**row(number), "declared": []} for number in range(6)]
    folder(Path("K"), text, cases)
    done = massprop("campaign", "report", "K")
    assert done.status == (status and 0)  # without a false declaration both pass
    text = text.replace("{max", "{on: upper_bound, max")
    folder(Path("L"), text, cases)
    assert massprop("campaign", "report", "L").status == status


def test_cases_that_failed_to_run_are_status_4(massprop: Massprop) -> None:
    folder(Path("K"), SHORT, [*(row(number) for number in range(5)), lost(5, "ArithmeticError: no number")])
    done = massprop("campaign", "report", "K")
    assert done.status == 4
    assert "1 of 6 cases failed to run." in done.out
    found = json.loads(massprop("campaign", "report", "K", "--json").out)
    assert found["failed_to_run"] == {"ArithmeticError: no number": 1}


SAID = """All 6 planned cases have been flown.
1 of 6 cases failed to run.
{failing} of 5 cases are failing (a wrong estimate, a false or missing declaration, or a healthy jet out of use): \
{cells[0]} of 3 with start zero; {cells[1]} of 2 with start nominal.
{wrong} of 5 cases end wrong (a parameter more than 6 sigma off): {wrong} of 3 with start zero; 0 of 2 with start \
nominal.
"""
MISSED = row(2, [failure(outcome="missed")])  # even numbers are cases of the first cell
FALSE = row(3, declared=[declaration(cause="healthy")])  # the reference, which alone was in the report


@pytest.mark.parametrize(
    ("others", "cells", "wrong"),
    [
        ([MISSED, FALSE], (1, 1), 0),
        ([row(2, z={"x_cm": -7.0}), FALSE], (1, 1), 1),
        ([row(2, z=5.9), row(3)], (0, 0), 0),
    ],
)
def test_status_and_report_count_the_same_in_every_cell(
    massprop: Massprop, others: list[Any], cells: tuple[int, int], wrong: int
) -> None:
    rows = [row(0), row(1), *others, row(4), lost(5, "ArithmeticError: no number")]
    folder(Path("K"), SHORT, rows)
    status = massprop("campaign", "status", "K").out
    assert status == SAID.format(failing=sum(cells), cells=cells, wrong=wrong)
    reported = massprop("campaign", "report", "K").out
    assert all(line in reported for line in status.splitlines()[1:])
    counts = json.loads(massprop("campaign", "status", "K", "--json").out)
    summary = json.loads(massprop("campaign", "report", "K", "--json").out)
    assert [{**one, "cells": None} for one in (counts, summary["cases"])] == [{**counts, "cells": None}] * 2
    assert [one["failing"] for one in counts["cells"]] == list(cells)
    for one, cell in zip(counts["cells"], summary["cells"], strict=True):
        assert one == {"settings": cell["settings"], **cell["cases"]}
        for name, of in (("failing", "judged"), ("ended_wrong", "measured")):
            assert cell["figures"][name]["value"] == pytest.approx(one[name] / one[of])


# --------------------------------------------------------------------------------------- bad input

BAD = {
    "draw.plant.thrust_dispersion={uniformm: {low: 0, high: 1}}": "there is no distribution 'uniformm'",
    "draw.plant.thrust_dispersion={uniform: {low: 0.2, high: 0.1}}": "high must be above low",
    "sweep.detector.marign=[1, 2]": "marign",
    "gates.false_alarms={max: 1}": "there is no such figure",
    "base=nothing_of_the_kind": "nothing_of_the_kind",
    "draw.plant.mass_properties={mass: {uniform: {low: -10, high: -5}}}": "mass",
}


@pytest.mark.parametrize("override", BAD)
def test_bad_campaigns_are_one_message(massprop: Massprop, override: str) -> None:
    done = massprop("campaign", "run", written(), "--set", override)
    require_refused(done, BAD[override])
    assert not Path("runs").exists()


def test_folders_that_hold_no_campaign_are_refused(massprop: Massprop) -> None:
    Path("empty").mkdir()
    for command in ("status", "report", "compare"):
        require_refused(massprop("campaign", command, "empty"), "empty")
    massprop("campaign", "plan", written(), "--out", "K")
    require_refused(massprop("campaign", "report", "K"), "K: no case has been flown yet")
    require_refused(
        massprop("campaign", "plan", "short.yaml", "--set", "seed=4", "--out", "K"), "K: holds the plan of another"
    )
    Path("mine").mkdir()
    Path("mine/notes.txt").write_text("mine", encoding="utf-8")
    require_refused(
        massprop("campaign", "run", "short.yaml", "--out", "mine"), "mine: holds files that are not of an earlier"
    )


def test_workers_of_two_kinds_are_refused(massprop: Massprop) -> None:
    done = massprop("campaign", "run", written(), "--workers", "2", "--scheduler", "tcp://127.0.0.1:1")
    require_refused(done, "give either --workers or --scheduler")
