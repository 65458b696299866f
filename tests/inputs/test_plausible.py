"""Plausibility: entries that are hardly meant are doubted, possible ones neither doubted nor refused."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from test_refused import LEAK, changed, diagonal

from massprop_drake import InputError, load_scenario, load_vehicle, simulate
from massprop_drake.inputs.model import validate_data
from massprop_drake.inputs.scenario import Scenario, resolve_scenario
from massprop_drake.inputs.vehicle_file import Vehicle, bundled_vehicles

OF_A_VEHICLE = [
    ("mass_properties.inertia", diagonal(1e5), "mass_properties.inertia: is too large for this mass"),
    ("mass_properties.mass", 1459.0, "is small for this mass: the largest radius of gyration is 0.3103 m, the RMS d"),
    ("jets.1.thrust", 20.0, "jets[1].thrust: is 2 times the nominal thrust of its kind; impingement takes away"),
    ("gyros.0.quantum", 1e-8, "gyros[0]: what one sample of jet"),
    ("gyros.0.quantum", 500.0, "gyros[0]: a sample of the strongest jet shows as"),
]
IN_A_SCENARIO = [
    ("jet_pulses", "failures=[{kind: stuck_on, jet: R4R, start_s: 50}]", "failures[0].start_s: comes at or after"),
    ("jet_pulses", "plant.initial_rate=[0, 3, 0]", "plant.initial_rate: turns the vehicle by 0.24 rad in a sample"),
    ("jet_pulses", LEAK % "1000", "failures[0].force: is 1.15 times the thrust of jet 'R4R'"),
    ("sample_maneuver", "mass.process_noise_std=1", "mass.process_noise_std: is 1 in each sample, more than the p"),
    ("jet_pulses", "plant.disturbance.torque_std=[1.0e6, 0, 0]", "1e+06 ft-lbf, and the strongest jet gives"),
    ("small_satellite_maneuver", "plant.disturbance.torque_std=[1.0e6, 0, 0]", "1e+06 N-m, and the strongest jet"),
]


@pytest.mark.parametrize(("first", "second", "words"), [*OF_A_VEHICLE, *IN_A_SCENARIO])
def test_what_is_hardly_meant_is_doubted(toy_data: dict[str, Any], first: str, second: Any, words: str) -> None:
    if (first, second, words) in OF_A_VEHICLE:
        doubts = validate_data(Vehicle, changed(toy_data, first, second)).doubts
    else:
        doubts = load_scenario(first, [second]).doubts
    assert words in " ".join(map(str, doubts))


@pytest.mark.parametrize("name", bundled_vehicles())
def test_a_mass_in_kg_for_slug_is_doubted_for_every_vehicle(name: str) -> None:
    vehicle = load_vehicle(name)
    assert vehicle.doubts == []
    data = vehicle.model_dump(mode="json")
    data["mass_properties"]["mass"] *= 14.59
    said = " ".join(map(str, validate_data(Vehicle, data).doubts))
    assert "the largest radius of gyration" in said
    assert ("is the mass in slug" if vehicle.units == "us" else "is every position in m") in said


def test_doubts_bear_on_what_is_done(toy_data: dict[str, Any]) -> None:
    assert load_scenario("sample_maneuver", ["duration_s=3"]).simulation_doubts == []  # a run may be cut short
    told = "jet_schedule=[{jet: R4R, start_s: 0, end_s: 1}, {jet: F1F, start_s: 1.01, end_s: 1.04}]"
    (short,) = load_scenario("jet_pulses", [told]).simulation_doubts
    assert "jet_schedule[1]: is shorter than a sample, 0.08 s" in str(short)
    assert load_scenario("jet_pulses", [told, "vehicle.jet_commands={as: on_time}"]).simulation_doubts == []
    toy_data["jets"][1]["thrust"] = 20.0
    case = resolve_scenario({"vehicle": toy_data, "failures": [{"kind": "stuck_on", "jet": "J1", "start_s": 99.0}]})
    assert [found.path for found in case.doubts] == [("vehicle", "jets", 1, "thrust"), ("failures", 0, "start_s")]
    assert case.simulation_doubts == case.doubts
    # a record ends where it ends: what a simulation does with failures does not bear on it
    assert [found.path for found in case.estimation_doubts] == [("vehicle", "jets", 1, "thrust")]


@pytest.mark.parametrize(
    ("keys", "chosen_by"),
    [
        ({"sensors": {"combine": {"gyros": "average"}}}, "sensors.combine"),
        ({"rotation": {}, "estimation": {"thrust_uncertainty": 0.1}}, "rotation, estimation.thrust_uncertainty"),
        ({"detector": {"kind": "cusum"}}, "detector.kind"),
        ({"sensors": {"combine": {}}, "estimation": {"filter": "thesis"}}, None),
        ({"vehicle": "air_bearing"}, None),
    ],
)
def test_a_filter_that_keys_choose_is_told(keys: dict[str, Any], chosen_by: str | None) -> None:
    case = resolve_scenario({"vehicle": "small_satellite"} | keys)
    told = (
        [] if chosen_by is None else [f"estimation.filter: is thesis, chosen by {chosen_by}: write filter: thesis if"]
    )
    assert [str(doubt)[: len(told[0])] for doubt in case.simulation_doubts] == told
    assert case.estimation_doubts == case.simulation_doubts


def scaled(vehicle: Vehicle, mass: float, length: float, thrust: float, **changes: Any) -> dict[str, Any]:
    """A vehicle's data with mass, lengths and thrusts multiplied."""
    data = vehicle.model_dump(mode="json")
    body = data["mass_properties"]
    body["mass"] *= mass
    body["center_of_mass"] = [length * value for value in body["center_of_mass"]]
    body["inertia"] = [[mass * length**2 * value for value in row] for row in body["inertia"]]
    for jet in data["jets"]:
        jet["position"] = [length * value for value in jet["position"]]
        jet["thrust"] *= thrust
    for kind in data["jet_kinds"].values():
        kind["nominal_thrust"] *= thrust
    return {**data, **changes}


def test_the_smallest_and_the_largest_vehicles_are_plausible() -> None:
    satellite = load_vehicle("small_satellite")  # 500 kg, 1.2 m, 5 N
    cubesat = scaled(satellite, 1.0 / 500.0, 0.1, 2e-4)  # 1 kg, 12 cm, 1 mN
    station = scaled(satellite, 840.0, 40.0, 25.0, sample_period_s=1.0)  # 420 t, 50 m, 125 N
    for data in (cubesat, station):
        assert validate_data(Vehicle, data).doubts == []


def test_what_is_just_sharp_enough_stays_definite() -> None:
    # the bound is no obstacle where the filter still works, and leaves it room
    data = load_scenario(
        "small_satellite_maneuver", ["duration_s=1", "estimation.start=zero", "execution.engine=loop"]
    ).model_dump(mode="json")

    def accepted(quantum: float) -> Scenario | None:
        data["vehicle"]["gyros"][0] = {"name": "gyro", "quantum": quantum}
        try:
            return resolve_scenario(data)
        except InputError:
            return None

    sharpest = next(found for exponent in range(-9, -6) if (found := accepted(10.0**exponent)) is not None)
    assert sharpest.vehicle_data.gyros[0].quantum <= 1e-8
    assert np.isfinite(simulate(sharpest, look_back=False)["standard_deviation"]).all()


@pytest.mark.parametrize("engine", ["diagram", "loop"])
def test_a_vehicle_that_a_jet_spins_up_for_good_ends_the_run(toy_data: dict[str, Any], engine: str) -> None:
    # 50 N on an arm of 1 m adds 2 rad/s to a moment of 2.5 kg-m^2 in a sample of 0.1 s: a turn in one after 3.1 s
    data = changed(changed(toy_data, "mass_properties.inertia", diagonal(2.5)), "jets.*.thrust", 50.0)
    case = {
        **{"vehicle": data, "duration_s": 5.0, "failures": [{"kind": "stuck_on", "jet": "J1", "start_s": 0.0}]},
        **{"detector": {"kind": "off"}, "jet_schedule": [{"jet": "J1", "start_s": 0.0, "end_s": 1.0}]},
        **{"execution": {"engine": engine}},
    }
    with pytest.raises(InputError, match=r"at t = 3\.\d+ s the vehicle makes 1\.\d+ turns in a sample"):
        simulate(resolve_scenario(case))
