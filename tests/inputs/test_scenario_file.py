"""Scenario files: the bundled ones, overrides, vehicles, and what is chosen where nothing is said."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import REPOSITORY
from ruamel.yaml import YAML
from test_refused import refused, require

from massprop_drake import InputError, Scenario, load_scenario, simulate
from massprop_drake.inputs import params, true_params
from massprop_drake.inputs.estimation_blocks import FaultsBlock, JointBlock
from massprop_drake.inputs.model import Model, digest, yaml_text
from massprop_drake.inputs.scenario import bundled_scenarios, resolve_scenario, set_field
from massprop_drake.inputs.scenario_fields import ExecutionBlock
from massprop_drake.inputs.true_blocks import PlantBlock
from massprop_drake.inputs.vehicle_file import Vehicle
from massprop_drake.inputs.yaml import to_yaml

DATA = REPOSITORY / "tests" / "data"
WINDOW = "{controller: rhc, axis: +x, start_s: 1, end_s: 3}"


def written(folder: Path, text: str, name: str = "case.yaml") -> Path:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


NOT_USUAL = {
    "joint": "joint.rate_walk=1e-7",
    "pose": "detector.lead=7",
    "thesis": "rotation.process_noise_std=[1e-9,0,0,0,0,0,0.1,0,1e-7]",
}


WITH_VEHICLE = ("leak_named", "cubesat_leak", "air_bearing_pulses", "servicer_slosh")  # whose text has it whole


@pytest.mark.parametrize("name", bundled_scenarios())
def test_every_bundled_scenario_is_sound_and_reads_back_equal(tmp_path: Path, name: str) -> None:
    bundled = load_scenario(name)
    assert (bundled.name, bundled.doubts, bundled.description != "") == (name, [], True)
    data = bundled.model_dump(exclude_unset=True)
    set_field(data, NOT_USUAL[bundled.estimation.filter])
    scenario = resolve_scenario(data | {"seed": 5})
    text = yaml_text(scenario)
    if name not in WITH_VEHICLE:  # those of vehicles are read back by themselves
        assert isinstance(scenario.vehicle, Vehicle)
        text = to_yaml({**scenario.model_dump(mode="json", exclude={"vehicle"}), "vehicle": scenario.vehicle.name})
    again = load_scenario(written(tmp_path, text))
    assert again == scenario
    assert digest(again) == digest(scenario)


def unset(model: Model, prefix: str = "") -> list[str]:
    """Fields of a model, and of the models in it, that are at their defaults."""
    found = []
    for name, field in type(model).model_fields.items():
        value = getattr(model, name)
        if not field.is_required() and value == field.get_default(call_default_factory=True):
            found.append(prefix + name)
        for item in value if isinstance(value, tuple) else (value,):
            if isinstance(item, Model) and name != "vehicle":
                found += unset(item, f"{prefix}{name}.")
    return found


def test_one_of_everything_runs(tmp_path: Path, toy_data: dict[str, Any]) -> None:
    toy_data["jet_kinds"]["vernier"] = {"nominal_thrust": 1.0, "specific_impulse_s": 60.0}
    toy_data["jets"][-1] |= {"kind": "vernier", "thrust": 1.0}
    toy_data["jet_commands"] = {"as": "on_time"}
    written(tmp_path, to_yaml(toy_data), "toy.yaml")
    path = Path(shutil.copy(DATA / "one_of_everything.yaml", tmp_path))
    scenario = load_scenario(path)
    # a new field belongs into the file, unless the thesis's filters, a maneuver or jets alone do not go with it
    left_out = {"joint", "faults", "execution", "moving", "detector.kind", "plant.kind", "plant.propellant"}
    left_out |= {f"{what}_schedule" for what in ("jet", "wheel", "engine")} | {"engine_failures"}
    left_out |= {f"plant.{key}" for key in ("wheel_speeds", "wheel_dispersion", "engine_errors", "engine_dispersion")}
    left_out |= {f"autopilot.{key}" for key in ("engaged", "test_firing", "wheels", "gimbal_bandwidth")}
    left_out |= {"estimation.given.covariance", "estimation.readings_per_s"}
    blocks = {"joint": JointBlock, "faults": FaultsBlock, "execution": ExecutionBlock}
    left_out |= {f"{block}.{key}" for block, model in blocks.items() for key in model.model_fields}
    assert set(unset(scenario)) == left_out
    run = simulate(scenario, look_back=False)
    assert run.time_s.size == 21
    # nothing is used up, the mass is the one drawn about 110 kg until 1 kg docks at 1 s, which the sample after shows;
    # thrust is instantaneous, and only the first six jets fail
    mass = true_params.true_properties(scenario).mass
    assert 100.0 < mass < 120.0
    assert mass != 110.0
    np.testing.assert_allclose(1.0 / run["truth"][:, 9], [mass] * 11 + [mass + 1.0] * 10, rtol=1e-14)
    full = np.array([jet.thrust for jet in scenario.vehicle_data.jets]) * params.thrust_factors(scenario)
    np.testing.assert_allclose(run["thrust"][:, 6:], (run["command"] * full)[:, 6:], rtol=1e-12)
    assert ((run["command"] > 0.0) & (run["command"] < 1.0)).any()  # on-times
    assert run["thrust"][12, 0] == full[0]
    np.testing.assert_allclose(run["thrust"][14, 3] - run["command"][14, 3] * full[3], 0.2, rtol=1e-12)
    np.testing.assert_array_equal(run["rate"][0], [0.001, 0.0, -0.002])


def test_what_follows_at_once_or_goes_together_is_fine(tmp_path: Path) -> None:
    text = (
        f"maneuver: [{WINDOW}, {{controller: rhc, axis: -x, start_s: 3, end_s: 4}}, "
        "{controller: rhc, axis: +y, start_s: 1, end_s: 3}, {controller: thc, axis: +x, start_s: 1, end_s: 3}]\n"
        "failures: [{kind: stuck_on, jet: R4R, start_s: 5, end_s: 6}, {kind: stuck_off, jet: R4R, start_s: 6}, "
        "{kind: stuck_on, jet: F2R, start_s: 5}, {kind: degraded, jet: F1L, start_s: 0, fraction: 0}, "
        "{kind: intermittent, jet: F1D, start_s: 0, probability: 1, level: 1}, "
        "{kind: drift, jet: L1A, start_s: 5, rate_per_s: -0.001}]\n"
        # the second may only go because the first comes before
        "jumps: [{kind: release, time_s: 9, mass: 6000, position: [32.1, 0, 2]}, "
        "{kind: dock, time_s: 8, mass: 6000, position: [32.1, 0, 2]}]\nplant: {time_step: 0.08}\n"
    )
    found = load_scenario(written(tmp_path, text))
    assert (len(found.maneuver), found.plant.time_step) == (4, 0.08)
    assert [one.kind for one in found.failures][2:] == ["stuck_on", "degraded", "intermittent", "drift"]
    assert [one.kind for one in found.jumps] == ["release", "dock"]


@pytest.mark.parametrize(
    ("data", "chosen"),
    [
        ({}, ("joint", "hypotheses")),
        ({"detector": {"kind": "off"}}, ("joint", "off")),
        ({"estimation": {"filter": "thesis"}}, ("thesis", "cglr")),
        # files of before there was a choice name no filter, and have keys of the thesis's alone
        ({"rotation": {"filter": "extended"}}, ("thesis", "cglr")),
        ({"sensors": {"combine": {"gyros": "average"}}}, ("thesis", "cglr")),
        ({"detector": {"kind": "cusum"}}, ("thesis", "cusum")),
        ({"vehicle": "tracked_flyer"}, ("pose", "thrust_factors")),
        ({"vehicle": "air_bearing", "detector": {"lead": 8.0}}, ("pose", "thrust_factors")),
    ],
)
def test_filter_and_detector_of_a_scenario(data: dict[str, Any], chosen: tuple[str, str]) -> None:
    for scenario in (resolve_scenario(data), Scenario.model_validate(data)):
        assert (scenario.estimation.filter, scenario.detector.kind) == chosen
    again = resolve_scenario(YAML(typ="safe", pure=True).load(yaml_text(scenario)))
    assert (again.estimation, again.detector) == (scenario.estimation, scenario.detector)


def test_overrides_replace_fields_reach_into_lists_and_later_ones_win() -> None:
    window = "maneuver[13]={controller: rhc, axis: +x, start_s: 48, end_s: 49}"
    gyro = ("sensors.errors[0]={sensor: gyro}", "sensors.errors[0].noise_std=1e-6")
    plain = ("seed=1", "seed=2", "rotation.filter=extended", "plant.depletion=false", "plant.initial_rate=[0, 0.1, 0]")
    found = load_scenario("sample_maneuver", ["maneuver[0].axis=-x", window, *gyro, *plain, "estimation.std_fraction="])
    assert (found.maneuver[0].axis, len(found.maneuver), found.maneuver[13].start_s) == ("-x", 14, 48.0)
    assert (found.sensors.errors[0].noise_std, found.seed, found.rotation.filter) == (1e-6, 2, "extended")
    assert isinstance(found.plant, PlantBlock)
    assert (found.plant.depletion, found.estimation.std_fraction) == (False, None)
    assert found.plant.initial_rate == (0.0, 0.1, 0.0)
    assert load_scenario("sample_maneuver").seed == 0


def test_a_key_that_is_set_is_not_dropped_with_the_former_kind(tmp_path: Path) -> None:
    path = written(tmp_path, yaml_text(resolve_scenario({"estimation": {"filter": "joint"}})))
    assert load_scenario(path, ["detector.kind=off"]).detector.kind == "off"
    with pytest.raises(InputError, match="drift: is a key of kind: cusum, and the kind is cglr"):
        load_scenario(path, ["detector.drift=2", "detector.kind=off"])
    data = {"failures": [{"kind": "leak", "jet": "R1U", "force": 3.0}]}
    set_field(data, "failures[0].kind=stuck_off")
    assert data == {"failures": [{"kind": "stuck_off", "jet": "R1U"}]}


def test_a_vehicle_is_found_beside_it_or_stands_in_it(
    tmp_path: Path, toy_data: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("cases", "vehicles", "elsewhere"):
        (tmp_path / name).mkdir()
    vehicle = written(tmp_path / "vehicles", to_yaml(toy_data), "toy.yaml")
    path = written(tmp_path / "cases", "seed: 1\nvehicle: ../vehicles/toy.yaml\n")
    inline = written(tmp_path, to_yaml({"vehicle": toy_data}))
    monkeypatch.chdir(tmp_path / "elsewhere")
    assert load_scenario(path).vehicle_data.name == "toy"
    assert resolve_scenario({"vehicle": toy_data}) == load_scenario(inline)
    assert load_scenario(inline, ["vehicle.mass_properties.mass=123.5"]).vehicle_data.nominal.mass == 123.5
    toy_data["jets"][2]["thrust"] = -1.0
    vehicle.write_text(to_yaml(toy_data), encoding="utf-8")
    beside = f"{path}, line 2: vehicle: *toy.yaml, line *: jets[2].thrust: *got -1.0"
    require(refused(lambda: load_scenario(path)), beside)
    inline = written(tmp_path, to_yaml({"vehicle": toy_data}))
    within = f"{inline}*vehicle.jets[2].thrust: input should be greater than 0, got -1.0"
    require(refused(lambda: load_scenario(inline)), within)
