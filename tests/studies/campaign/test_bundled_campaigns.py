"""The bundled campaigns: each can be loaded and planned, and asks what it says it asks."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import pytest

from massprop_drake.inputs.campaign_file import (
    CampaignSpec,
    bundled_campaigns,
    campaign_from,
    load_campaign,
    settings_of,
    with_settings,
)
from massprop_drake.inputs.yaml import Document
from massprop_drake.studies.campaign.plan import plan_cases, sample_coordinates


@pytest.mark.parametrize("name", bundled_campaigns())
def test_each_can_be_planned_in_every_cell(name: str) -> None:
    spec = load_campaign(name)
    assert spec.file.name == name
    assert spec.file.description
    cells = list(itertools.product(*spec.file.sweep.values()))
    if spec.file.method != "grid":
        assert [case.cell for case in plan_cases(load_campaign(name, ("cases=1",)))] == list(range(len(cells)))


def test_every_jet_has_each_failure_once() -> None:
    spec = load_campaign("every_jet")
    jets = spec.base.vehicle_data.designations
    found = []
    for row in sample_coordinates(spec).astype(int):
        kinds, names = (quantity.distribution.grid() or [] for quantity in spec.quantities)
        settings = settings_of(spec, {"failures[0].kind": kinds[row[0]], "failures[0].jet": names[row[1]]})
        (failure,) = settings["failures"]
        found.append((failure["jet"], failure["kind"], failure.get("force")))
    kinds = [("stuck_on", None), ("stuck_off", None), ("leak", 10), ("leak", 30)]
    assert sorted(found, key=str) == sorted(((jet, *kind) for jet in jets for kind in kinds), key=str)
    with_settings(spec.base, {"failures": [{"kind": "leak", "force": 10, "jet": jets[-1], "start_s": 50}]})


# ------------------------------------------------------------------ what they need of the campaign's file


def _campaign(text: str) -> CampaignSpec:
    return campaign_from(Document(f"base: sample_maneuver\ncases: 1\n{text}", "c.yaml"), Path())


def test_a_chosen_kind_may_bring_keys_of_its_own() -> None:
    spec = _campaign(
        "draw: {failures: [{kind: {choice: [stuck_on, {kind: leak, force: 12}]}, jet: F1F, start_s: 3, force: 5}]}"
    )
    chosen: list[Any] = ["stuck_on", {"kind": "leak", "force": 12}]
    given = [settings_of(spec, {"failures[0].kind": kind})["failures"][0] for kind in chosen]
    assert given == [
        {"kind": "stuck_on", "jet": "F1F", "start_s": 3},
        {"kind": "leak", "jet": "F1F", "start_s": 3, "force": 12},
    ]
