"""The pages of campaigns: figures by cell and failure, made of what was flown; what is written by hand stays."""

from __future__ import annotations

import math
import re
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from conftest import REPOSITORY
from script_probe import script

from massprop_drake.inputs.campaign_file import bundled_campaigns, campaign_from, load_campaign
from massprop_drake.inputs.model import yaml_text
from massprop_drake.inputs.yaml import Document
from massprop_drake.studies.campaign import store
from massprop_drake.studies.campaign.campaign import Campaign
from massprop_drake.studies.campaign.campaign_flight import Flights
from massprop_drake.studies.campaign.plan import plan_cases, sample_coordinates

PAGES = {"every_jet"}  # that the repository keeps

CAMPAIGN = """
name: tiny
description: Two cells of two short flights
base: stuck_on_29
cases: 2
seed: 5
set: {duration_s: 2.4, plant.disturbance.force_std: [1, 1, 1]}
draw:
  failures:
    - {kind: {choice: [stuck_on, {kind: leak, force: 20}]}, jet: {choice: [F1F, R4R]}, start_s: 1}
    - {kind: stuck_on, jet: {choice: [F3F, L3A]}, start_s: 1.5}
sweep: {"vehicle.gyros[0].quantum": [1.0e-6, 1.0e-5]}
"""


@pytest.fixture(scope="module")
def pages() -> ModuleType:
    return script(REPOSITORY / "docs" / "make_campaigns.py")


def _flown(spec: Any, cases: Any) -> list[dict[str, Any]]:
    setup = {"base": spec.base.model_dump(mode="json"), "campaign": "tiny", "times_s": [], "keep": "none"}
    setup |= {"folder": "", "token": None}
    flights = Flights(setup)
    return [
        {"case_id": case.case_id, "status": "flown", **flights.fly({**case._asdict(), "keep": False})} for case in cases
    ]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("tiny")
    spec = campaign_from(Document(CAMPAIGN, "tiny.yaml"), Path())
    cases = plan_cases(spec)
    store.write_text(path / store.BASE, yaml_text(spec.base))
    store.write_text(path / store.FILE, yaml_text(spec.file))
    store.write_plan(path, cases, {})
    rows = _flown(spec, cases)
    assert _flown(spec, cases[-1:]) == rows[-1:]  # alone as among others
    store.write_rows(path, rows, store.schema(()))
    return path


def test_a_page_has_a_line_for_each_cell_and_keeps_what_is_written_by_hand(
    pages: ModuleType, folder: Path, tmp_path: Path
) -> None:
    page = pages.write_page(folder, tmp_path)
    made = page.read_text(encoding="utf-8")
    assert made.startswith("# Tiny\n\nTwo cells of two short flights.\n")
    assert "4 of 4 flights" in made
    _, _, estimates = made.partition("## Estimates")
    lines = estimates.partition("##")[0].strip().splitlines()
    assert [line.split("|")[1].strip() for line in lines] == ["`vehicle.gyros[0].quantum`", "---", "1e-06", "1e-05"]
    assert "## Failures by kind and size" in made
    assert "## Failures by their order in the flight" in made
    page.write_text(made.replace("Two cells", "Found: nothing. Two cells"), encoding="utf-8")
    pages.write_page(folder, tmp_path)
    assert page.read_text(encoding="utf-8") == made.replace("Two cells", "Found: nothing. Two cells")


def test_each_failure_is_counted_once(pages: ModuleType, folder: Path) -> None:
    cases, _ = store.read_plan(folder)
    rows = store.read_rows(folder).to_pylist()  # type: ignore[union-attr]
    group = pages.Group((), pages.sized(rows, Campaign.load(folder), cases))
    for split in (pages.by_failure(group, "lbf"), pages.by_order(group)):
        assert sum(len(row["injected"]) for part in split for row in part.rows) == 8
    kinds = {part.labels: part for part in pages.by_failure(group, "lbf")}
    assert set(kinds) == {("leak", "20 lbf"), ("stuck on", "-")}
    planned_leaks = [f for case in cases for f in case.settings["failures"] if f["kind"] == "leak"]
    assert len(kinds["leak", "20 lbf"].rows) == len(planned_leaks) > 0


def test_the_table_of_results_names_each_campaign_and_how_many_flights_it_has() -> None:
    text = (REPOSITORY / "docs" / "campaigns.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| (\[?)(\w+)(?:\]\(campaigns/\2\.md\))? \| .* \| (\d+) of (\d+) \|$", text, re.MULTILINE)
    assert sorted(name for _, name, _, _ in rows) == sorted(bundled_campaigns())
    assert {name for link, name, _, _ in rows if link} == PAGES
    assert all(int(flown) <= int(of) for _, _, flown, of in rows)
    for name in ("every_jet", "healthy_maneuver"):  # reading all takes long
        spec = load_campaign(name)
        flights = len(sample_coordinates(spec)) * math.prod(len(values) for values in spec.file.sweep.values())
        assert [of for _, each, _, of in rows if each == name] == [str(flights)]


def test_every_page_that_is_there_belongs_to_a_bundled_campaign(pages: ModuleType) -> None:
    there = {path.stem for path in pages.PAGES.glob("*.md")}
    assert there == PAGES <= set(bundled_campaigns())
    for name in there:
        assert pages.MARK in (pages.PAGES / f"{name}.md").read_text(encoding="utf-8")
