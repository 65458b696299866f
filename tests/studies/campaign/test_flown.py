"""A flown campaign: bad cases are rows with their reason, and each good one is flown again bit for bit."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

import pyarrow.parquet as pq
import pytest
from campaign_probe import BAD, CASES, outcome, row, study

from massprop_drake import InputError, load_scenario, simulate
from massprop_drake.display.run import Run
from massprop_drake.inputs.scenario import Scenario
from massprop_drake.studies.campaign import engine, store
from massprop_drake.studies.campaign.campaign import Campaign
from massprop_drake.studies.campaign.measure import measure_case


def scenario_of(folder: Path, case_id: int) -> Scenario:
    campaign = Campaign.load(folder)
    return campaign.planned()[case_id].scenario(campaign.spec.base, campaign.spec.file.name)


def test_every_case_has_its_row_and_bad_ones_their_reason(flown: Path) -> None:
    rows = outcome(flown).to_pylist()
    assert [row["case_id"] for row in rows] == list(range(CASES))
    failed = {row["case_id"]: row["reason"] for row in rows if row["status"] != "flown"}
    assert failed == {
        10: "its process was ended by SIGSEGV: words on standard output",
        11: "needed more than 800 MB of memory",
        12: "ArithmeticError: no number",
    }
    assert set(failed) == set(BAD)
    for found in rows:
        if found["status"] == "flown":
            assert found["reason"] is None
            assert found["duration_s"] == 0.96  # of the last sample
            assert len(found["injected"]) == 1
        else:
            assert {name for name, value in found.items() if value is not None} == {"case_id", "status", "reason"}


def test_status_and_table_come_from_the_folder_alone(flown: Path) -> None:
    campaign = Campaign.load(flown)
    counts = campaign.status().counts
    assert (counts.planned, counts.tried, counts.failed_to_run) == (CASES, CASES, len(BAD))
    assert counts.flown == CASES - len(BAD)
    table = campaign.to_pandas()
    assert list(table.index) == list(range(CASES))
    assert table["draw.failures[0].force"].between(5, 200).all()
    assert table["worker"].nunique() == 1
    assert (table["wall_s"] > 0.0).all()
    assert repr(campaign).startswith("<Campaign 'short'")


def test_cases_flown_alone_keep_their_runs_and_what_failed_gets_another_row(flown: Path, tmp_path: Path) -> None:
    here = shutil.copytree(flown, tmp_path / "short")
    with engine.local_client(1) as client:
        Campaign.load(here).run(only=[5, 12], client=client)
        assert list(client.nthreads().values()) == [1]
        assert list(client.run(lambda: "pydrake" in sys.modules).values()) == [False]
    assert outcome(here, CASES - 1).equals(outcome(flown, CASES - 1))
    assert row(here, 12)["status"] == "flown"  # nothing is injected here
    assert Campaign.load(here).status().counts.failed_to_run == len(BAD) - 1
    assert sorted(path.name for path in (here / store.CASES).iterdir()) == ["0005", "0012"]
    assert not list(here.glob(".seen*"))
    for case_id in (5, 12):
        kept = here / store.CASES / f"{case_id:04d}"
        assert load_scenario(kept) == scenario_of(here, case_id)
        run = simulate(load_scenario(kept))
        again, stored = measure_case(run, [0.5]), row(here, case_id)
        assert {name: stored[name] for name in again} == again
        summary = Run.load(kept).summary  # with hindsight, which no row needs
        assert len(summary["identifiability"]) == 10
        for part in ("identifiability", "consistency", "detections"):
            assert summary[part] == run.summary[part]


def test_a_folder_with_results_is_gone_on_with_only_where_asked(flown: Path, tmp_path: Path) -> None:
    here = shutil.copytree(flown, tmp_path / "short")
    campaign = Campaign.load(study(tmp_path, CASES))
    with pytest.raises(InputError, match="holds results already; --resume goes on with them"):
        campaign.run(here)
    with pytest.raises(InputError, match="--only 13: the plan has cases 0 to 12"):
        campaign.run(here, only=[3, 13])
    campaign.run(here, resume=True)  # nothing is left to fly, so nothing starts
    assert outcome(here).equals(outcome(flown))


def test_a_folder_of_another_plan_is_refused(flown: Path, tmp_path: Path) -> None:
    here = shutil.copytree(flown, tmp_path / "short")
    before = sorted(path.stat().st_mtime_ns for path in here.rglob("*"))
    for override, said in (
        ("seed=4", "holds the plan of another campaign"),
        ("set.duration_s=2.0", "holds the plan of another campaign"),
        ("cases=12", "holds a plan of 13 cases, more than 12"),
    ):
        with pytest.raises(InputError, match=said):
            Campaign.load(study(tmp_path, CASES), [override]).run(here, resume=True)
    assert sorted(path.stat().st_mtime_ns for path in here.rglob("*")) == before
    other = tmp_path / "other"
    other.mkdir()
    (other / "notes.txt").write_text("mine")
    with pytest.raises(InputError, match="other: holds files that are not of an earlier campaign"):
        Campaign.load(study(tmp_path, CASES)).run(other)
    with pytest.raises(InputError, match="has its plan already"):
        Campaign.load(here, ["cases=3"])


def test_a_plan_grows_by_cases_and_keeps_what_is_flown(flown: Path, tmp_path: Path) -> None:
    here = shutil.copytree(flown, tmp_path / "short")
    grown = Campaign.load(study(tmp_path, CASES + 2)).plan(here)
    assert grown.status().counts.planned == CASES + 2
    assert grown.status().counts.tried == CASES
    assert store.read_plan(here)[1] == store.read_plan(flown)[1]  # its execution, too
    fixed = tmp_path / "fixed"
    Campaign.load(study(tmp_path, 6, more="method: lhs\n")).plan(fixed)
    with pytest.raises(InputError, match="6 cases that are not the first of these 12: lhs makes draws as a whole"):
        Campaign.load(study(tmp_path, 12, more="method: lhs\n")).plan(fixed)


@pytest.mark.parametrize("damage", ["cut", "flipped", "other"])
def test_a_damaged_file_of_rows_is_told_and_its_cases_flown_again(flown: Path, tmp_path: Path, damage: str) -> None:
    here = shutil.copytree(flown, tmp_path / "short")
    chunk = sorted((here / store.RESULTS).iterdir())[0]
    content = bytearray(chunk.read_bytes())
    if damage == "cut":
        chunk.write_bytes(content[:-100])
    elif damage == "flipped":
        content[200] ^= 0x55
        chunk.write_bytes(content)
    else:
        pq.write_table(pq.read_table(chunk).drop_columns(["case_id"]), chunk)
    campaign = Campaign.load(here)
    with pytest.raises(InputError, match=f"{chunk.name}: is .*; remove it, and --resume flies its cases again"):
        campaign.to_pandas()
    if damage != "flipped":  # which only the column concerned shows
        with pytest.raises(InputError, match="remove it"):
            campaign.run(resume=True)
    chunk.unlink()
    assert campaign.status().counts.tried < CASES
