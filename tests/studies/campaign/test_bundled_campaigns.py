"""The bundled campaigns: each can be loaded and planned, and asks what it says it asks."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import pytest

from massprop_drake.errors import InputError
from massprop_drake.inputs.campaign_file import (
    CampaignSpec,
    bundled_campaigns,
    campaign_from,
    load_campaign,
    settings_of,
    with_settings,
)
from massprop_drake.inputs.scenario import load_scenario
from massprop_drake.inputs.yaml import Document
from massprop_drake.studies.campaign.plan import PlannedCase, design, planned

WISHES = {  # of the thesis, section 6.2, and those of this project
    *("gyro_quantum", "accelerometer_quantum", "sampling_period", "sensor_bandwidth", "thrust_dispersion", "jet_lag"),
    *("disturbance_torque", "vibration", "several_failures", "soft_failures"),
    *("healthy_maneuver", "healthy_dispersed", "every_jet"),
    *("joint_maneuver", "joint_dispersed"),
}


def _few(name: str) -> list[PlannedCase]:
    """A case of each cell; of a grid all."""
    grid = load_campaign(name).file.method == "grid"
    return planned(load_campaign(name, () if grid else ("cases=1",)))


def test_every_wish_has_its_campaign() -> None:
    assert set(bundled_campaigns()) == WISHES


@pytest.mark.parametrize("name", sorted(WISHES - {"every_jet"}))
def test_each_can_be_planned_in_every_cell(name: str) -> None:
    spec = load_campaign(name)
    assert spec.file.name == name
    assert spec.file.description
    cells = list(itertools.product(*spec.file.sweep.values()))
    assert [case.cell for case in _few(name)] == list(range(len(cells)))


def test_every_jet_has_each_failure_once() -> None:
    spec = load_campaign("every_jet")
    jets = spec.base.vehicle_data.designations
    found = []
    for row in design(spec).astype(int):
        kinds, names = (quantity.distribution.grid() or [] for quantity in spec.quantities)
        settings = settings_of(spec, {"failures[0].kind": kinds[row[0]], "failures[0].jet": names[row[1]]})
        (failure,) = settings["failures"]
        found.append((failure["jet"], failure["kind"], failure.get("force")))
    kinds = [("stuck_on", None), ("stuck_off", None), ("leak", 10), ("leak", 30)]
    assert sorted(found, key=str) == sorted(((jet, *kind) for jet in jets for kind in kinds), key=str)
    with_settings(spec.base, {"failures": [{"kind": "leak", "force": 10, "jet": jets[-1], "start_s": 50}]})


def test_the_nominal_start_states_the_uncertainty_of_the_draw() -> None:
    case = _few("healthy_maneuver")[2]
    scenario = case.scenario(load_campaign("healthy_maneuver").base, "campaign")
    deviation = scenario.estimation.given.standard_deviation  # type: ignore[union-attr]
    nominal = scenario.vehicle_data.nominal
    # 5 % of the mass, 0.3 ft; 1 degree between the moments about x and y makes the product of their difference
    assert deviation[9] == pytest.approx(0.05 / nominal.mass, rel=0.05)  # type: ignore[index]
    assert deviation[6:9] == pytest.approx([0.3] * 3)  # type: ignore[index]
    inverse = [1.0 / nominal.inertia[axis, axis] for axis in range(2)]
    assert deviation[5] == pytest.approx((inverse[0] - inverse[1]) * 3.14159 / 180.0, rel=0.05)  # type: ignore[index]


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


def test_keys_of_the_vehicle_reach_into_a_vehicle_that_is_named() -> None:
    keys = {"vehicle.sample_period_s": 0.04, "vehicle.gyros[0].quantum": 1e-5}
    base = load_scenario("sample_maneuver")
    swept = with_settings(base, keys)
    set_so = load_scenario("sample_maneuver", [f"{key}={value}" for key, value in keys.items()])
    for vehicle in (swept.vehicle_data, set_so.vehicle_data):
        assert vehicle.sample_period_s == 0.04
        assert vehicle.gyros[0].quantum == 1e-5
        assert vehicle.jets == base.vehicle_data.jets
    assert base.vehicle_data.sample_period_s == 0.08


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("vehicle.sample_perid_s", "1", "vehicle.sample_perid_s: unknown key; did you mean 'sample_period_s'?"),
        ("vehicle.gyros[3].quantum", "1", "vehicle.gyros[3].quantum"),
        ("vehicle.sample_period_s", "-1", "vehicle.sample_period_s: input should be greater than 0, got -1"),
    ],
)
def test_a_wrong_key_of_the_vehicle_is_named(key: str, value: str, message: str) -> None:
    with pytest.raises(InputError) as error:
        load_scenario("sample_maneuver", [f"{key}={value}"])
    assert message in str(error.value)
    with pytest.raises(InputError) as error:
        _campaign(f"sweep: {{'{key}': [{value}]}}")
    assert message in str(error.value)
    assert "c.yaml, line 3" in str(error.value)
