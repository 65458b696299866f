"""What no physical vehicle or run can be is refused with its reason; what is hardly meant is doubted."""

from __future__ import annotations

import copy
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_probe import Massprop

from massprop_drake import InputError, load_scenario, load_vehicle, simulate
from massprop_drake.inputs import plausible
from massprop_drake.inputs.model import validated
from massprop_drake.inputs.scenario import Scenario, bundled_scenarios, resolved
from massprop_drake.inputs.vehicle_file import Vehicle, bundled_vehicles
from massprop_drake.inputs.yaml import Document, to_yaml
from massprop_drake.records.reader import columns


def _edited(data: dict[str, Any], path: str, value: Any) -> dict[str, Any]:
    """A copy with one field, or the field of every entry of a list (`*`), replaced."""
    edited = copy.deepcopy(data)
    here: list[Any] = [edited]
    *inner, last = path.split(".")
    for part in inner:
        here = [
            inside for one in here for inside in (one if part == "*" else [one[int(part) if part.isdigit() else part]])
        ]
    for one in here:
        one[int(last) if last.isdigit() else last] = value
    return edited


def _diagonal(moment: float) -> list[list[float]]:
    return (moment * np.eye(3)).tolist()


# ---------------------------------------------------------------------------------------- vehicles

REFUSED_VEHICLES = [
    ("sample_period_s", 1e-12, "sample_period_s: 1e-12 s, is below 0.0001 s: no valve acts within less"),
    ("sample_period_s", 1e4, "above 100 s"),
    ("uncertainty", 1e6, "uncertainty: 1e+06, is above 10: less is beyond any scale, more says nothing"),
    ("mass_properties.mass", 1e300, "above 1e+09 kg: from a satellite on a chip"),
    ("mass_properties.mass", 1e-5, "below 0.001 kg"),
    ("mass_properties.inertia", _diagonal(1e-6), "too small for this mass: the radius of gyration is 0.0001 m"),
    ("mass_properties.inertia", _diagonal(1e10), "too large for this mass: the radius of gyration is 1e+04 m"),
    ("mass_properties.inertia", _diagonal(0.05), "turns it by 2 rad more in the sample"),
    ("mass_properties.center_of_mass", [0.0, 5e3, 0.0], "mass_properties.center_of_mass[1]: 5000 m, is above 1000 m"),
    ("jets.1.position", [2e3, 0.0, 0.0], "jets[1].position[0]: 2000 m, is above 1000 m: no structure is longer"),
    ("jets.1.thrust", 2e5, "jets[1].thrust: accelerates 100 kg at 2000 m/s^2, 203.9 times the weight on Earth"),
    ("jets.*.thrust", 1e-300, "below 1e-09 N: from a colloid thruster"),
    ("jets.1.cluster", 2**70, "jets[1].cluster: input should be less than or equal to 1000000"),
    ("jets.1.number", 2**70, "jets[1].number: input should be less than or equal to 1000000"),
    ("jets.1.mass_flow", 1e-12, "gives a specific impulse that cannot be"),
    ("jets.1.designation", "J\x1b[31m", "jets[1].designation: must be printable characters"),
    ("jets.1.designation", "J2 ", "no blank at either end, got 'J2 '"),
    (
        "jets.1.designation",
        "j1",
        "'j1' has a column in telemetry that is like one of 'J1', but for the case of letters",
    ),
    ("gyros.0.name", "jet_J1", "jets[12].designation: 'J1_x' has a column in telemetry that is like one of 'jet_J1'"),
    ("jet_kinds.primary.specific_impulse_s", 1e6, "above 30000 s: cold gas gives tens of seconds"),
    ("jet_kinds.primary.specific_impulse_s", 1e-3, "below 1 s"),
    ("jet_kinds.primary.time_constant_s", 5e-324, "below 1e-06 s: no valve is faster; 0: instantaneous"),
    ("jet_kinds.primary.time_constant_s", 50.0, "is 500 sample periods: no command of a period would be followed"),
    ("jet_kinds.primary.minimum_on_time_s", 50.0, "jet_kinds.primary.minimum_on_time_s: is 500 sample periods"),
    ("jet_kinds.primary.nominal_thrust", 2e5, "jet_kinds.primary.nominal_thrust: accelerates 100 kg at 2000 m/s^2"),
    ("gyros.0.quantum", 1e6, "gyros[0].quantum: 1e+06 rad/s, is above 1000 rad/s"),
    ("gyros.0.quantum", 1e-11, "the covariance could lose its definiteness in rounding"),
    ("gyros.0.quantum", 1e-300, "below 1e-13 rad/s"),
    ("gyros.0.range", 1e-7, "gyros[0].range: is 1e-07, for a quantum of 1e-06: hardly a reading lies within it"),
    ("accelerometers.0.range", 1e-4, "accelerometers[0].range: is 0.0001, for a quantum of 0.001"),
    ("name", "a\nb", "name: must be printable characters"),
]


@pytest.mark.parametrize(("path", "value", "words"), REFUSED_VEHICLES)
def test_an_impossible_vehicle_is_refused_with_the_reason_and_the_line(
    toy_data: dict[str, Any], path: str, value: Any, words: str
) -> None:
    if path == "gyros.0.name":
        toy_data["jets"].append(
            {**copy.deepcopy(toy_data["jets"][0]), "number": 13, "designation": "J1_x", "cluster": 13}
        )
    document = Document(to_yaml(_edited(toy_data, path, value)), "toy.yaml")
    with pytest.raises(InputError) as caught:
        validated(Vehicle, document.data, document)
    problems = "\n".join(caught.value.problems)
    assert words in problems
    assert "toy.yaml, line " in problems


def test_the_columns_of_an_acceleration_are_its_sensors_own(toy_data: dict[str, Any]) -> None:
    toy_data["accelerometers"].append({**toy_data["accelerometers"][0], "name": "acc_accel"})
    with pytest.raises(InputError, match="'acc_accel' has a column in telemetry that is like one of 'acc'"):
        validated(Vehicle, toy_data)


DOUBTED_VEHICLES = [
    ("mass_properties.inertia", _diagonal(1e5), "mass_properties.inertia: is too large for this mass"),
    ("jets.1.thrust", 20.0, "jets[1].thrust: is 2 times the nominal thrust of its kind; impingement takes away"),
    ("jet_kinds.primary.time_constant_s", 2.0, "is 20 sample periods"),
    ("gyros.0.quantum", 1e-8, "gyros[0]: what one sample of jet"),
    ("gyros.0.quantum", 500.0, "gyros[0]: a sample of the strongest jet shows as"),
    ("gyros.0.range", 5e-6, "gyros[0].range: is 5e-06"),
]


@pytest.mark.parametrize(("path", "value", "words"), DOUBTED_VEHICLES)
def test_what_is_hardly_meant_in_a_vehicle_is_doubted(
    toy_data: dict[str, Any], path: str, value: Any, words: str
) -> None:
    doubts = list(map(str, validated(Vehicle, _edited(toy_data, path, value)).doubts))
    assert any(words in doubt for doubt in doubts), doubts


def test_bounds_are_the_same_in_both_unit_systems(toy_data: dict[str, Any]) -> None:
    def problem(units: str, position: float) -> str:
        shape = [{"kind": "box", "size": [1.0, 1.0, 1.0], "position": [position, 0.0, 0.0]}]
        data = {**toy_data, "units": units, "shape": shape}
        try:
            validated(Vehicle, data)
        except InputError as error:
            return str(error)
        return ""

    assert not problem("si", 999.0)
    assert "1001 m, is above 1000 m" in problem("si", 1001.0)
    assert not problem("us", 3280.0)  # ft: 999.7 m
    assert "3282, in SI units 1000 m, is above 1000 m" in problem("us", 3282.0)


def test_the_us_units_are_the_international_ones() -> None:
    # the pound is 0.45359237 kg, the foot 0.3048 m, both exactly; a slug is lbf s^2 / ft
    np.testing.assert_allclose(plausible.SLUG, 14.593902937206364, rtol=1e-15)


def _scaled(vehicle: Vehicle, mass: float, length: float, thrust: float, **changes: Any) -> dict[str, Any]:
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
    cubesat = _scaled(satellite, 1.0 / 500.0, 0.1, 2e-4)  # 1 kg, 12 cm, 1 mN
    station = _scaled(satellite, 840.0, 40.0, 25.0, sample_period_s=1.0)  # 420 t, 50 m, 125 N
    for data in (cubesat, station):
        assert validated(Vehicle, data).doubts == []


@pytest.mark.parametrize("name", bundled_vehicles())
def test_no_bundled_vehicle_is_doubted(name: str) -> None:
    assert load_vehicle(name).doubts == []


@pytest.mark.parametrize("name", bundled_scenarios())
def test_no_bundled_scenario_is_doubted(name: str) -> None:
    assert load_scenario(name).doubts == []


# --------------------------------------------------------------------------------------- scenarios

LEAK = "failures=[{kind: leak, jet: R4R, start_s: 1, force: %s}]"
PAYLOAD = "jumps=[{kind: dock, time_s: 1, mass: %s, position: %s, inertia: %s}]"
REFUSED_SCENARIOS = [
    ("plant.initial_rate=[0, 1.0e5, 0]", "plant.initial_rate[1]: 100000 rad/s, is above 10000 rad/s"),
    ("plant.initial_rate=[0, 50, 0]", "plant.initial_rate: turns the vehicle by 4 rad in a sample of 0.08 s"),
    ("autopilot.discrete_rate=50", "autopilot.discrete_rate: turns the vehicle by 4 rad in a sample"),
    ("plant.accuracy=1e-300", "plant.accuracy: 1e-300, is below 1e-13: an integrator gets no closer"),
    ("estimation={start: nominal, std_fraction: 1e6}", "estimation.std_fraction: 1e+06, is above 10"),
    (f"estimation={{start: given, given: {{standard_deviation: {[1e150] * 10}}}}}", "the covariance could lose"),
    ("rotation.process_noise_std=[1,1,1,1,1,1,0,0,0]", "the covariance could lose its definiteness"),
    (LEAK % "1e5", "failures[0].force: is 115 times the thrust of jet 'R4R'"),
    (
        "failures=[{kind: drift, jet: R4R, start_s: 1, rate_per_s: 1e300}]",
        "failures[0].rate_per_s: 1e+300 1/s, is above",
    ),
    ("failures=[{kind: stuck_on, jet: R4R, start_s: 1e308}]", "failures[0].start_s: 1e+308 s, is above 1e+09 s"),
    (PAYLOAD % ("1e300", "[0, 0, 0]", "null"), "jumps[0].mass: 1e+300, in SI units"),
    (PAYLOAD % ("1.0", "[1e5, 0, 0]", "null"), "jumps[0].position[0]: 100000, in SI units 3.048e+04 m"),
    (PAYLOAD % ("1.0", "[0, 0, 0]", "[[1, 0, 0], [5, 1, 0], [0, 0, 1]]"), "jumps[0].inertia: must be symmetric"),
    ("sensors.errors=[{sensor: gyro, noise_std: 1e300}]", "sensors.errors[0].noise_std: 1e+300 rad/s, is above 1000"),
    ("sensors.errors=[{sensor: acc2, bias: [1e300, 0, 0]}]", "sensors.errors[0].bias[0]: 1e+300, in SI units"),
    ("sensors.errors=[{sensor: acc2, scale_factor: [1e300, 0, 0]}]", "sensors.errors[0].scale_factor[0]: 1e+300, is"),
    (f"name={'a' * 5000}", "at most 200 characters"),
    ("mass.jump_false_alarm_rate=5e-324", "mass.jump_false_alarm_rate: input should be greater than or equal to"),
]


@pytest.mark.parametrize(("override", "words"), REFUSED_SCENARIOS)
def test_an_impossible_scenario_is_refused_with_the_reason(override: str, words: str) -> None:
    start = ["estimation.start=nominal"] if override.startswith("rotation") else []
    with pytest.raises(InputError) as caught:
        load_scenario("sample_maneuver", [*start, override])
    assert words in "\n".join(caught.value.problems)


def test_a_run_of_more_samples_than_anyone_waits_for_is_refused(toy_data: dict[str, Any]) -> None:
    toy_data["sample_period_s"] = 1e-4
    with pytest.raises(InputError, match=r"duration_s: is 1e\+10 samples of 0\.0001 s; expected 1e\+08 at the most"):
        resolved({"vehicle": toy_data, "duration_s": 1e6})


def test_the_true_body_is_one_of_this_vehicle(toy_data: dict[str, Any]) -> None:
    true = {**toy_data["mass_properties"], "inertia": _diagonal(1e-6)}
    with pytest.raises(InputError) as caught:
        resolved({"vehicle": toy_data, "plant": {"mass_properties": true}})
    assert "plant.mass_properties: is too small for this mass" in "\n".join(caught.value.problems)


DOUBTED_SCENARIOS = [
    ("maneuver.0.start_s=70", "maneuver[0].start_s: 1 of 13 entries come at or after the end of the run, 50 s"),
    ("failures=[{kind: stuck_on, jet: R4R, start_s: 50}]", "failures[0].start_s: comes at or after the end"),
    (PAYLOAD.replace("time_s: 1", "time_s: 60") % ("1.0", "[0, 0, 0]", "null"), "jumps[0].time_s: comes at or after"),
    ("plant.initial_rate=[0, 3, 0]", "plant.initial_rate: turns the vehicle by 0.24 rad in a sample of 0.08 s"),
    (LEAK % "1000", "failures[0].force: is 1.15 times the thrust of jet 'R4R'"),
    ("mass.process_noise_std=1", "mass.process_noise_std: is 1 in each sample, more than the parameter itself"),
]


@pytest.mark.parametrize(("override", "words"), DOUBTED_SCENARIOS)
def test_what_is_hardly_meant_in_a_scenario_is_doubted(override: str, words: str) -> None:
    if override.startswith("maneuver.0"):
        data = load_scenario("sample_maneuver").model_dump(mode="json")
        data["maneuver"][0] |= {"start_s": 70.0, "end_s": 71.0}
        doubts = resolved(data).doubts
    else:
        doubts = load_scenario("sample_maneuver", [override]).doubts
    assert any(words in str(doubt) for doubt in doubts), list(map(str, doubts))


def test_pulses_that_do_not_last_as_they_say_are_told_of() -> None:
    told = "jet_schedule=[{jet: R4R, start_s: 0, end_s: 1}, {jet: F1F, start_s: 1.01, end_s: 1.04}]"
    case = load_scenario("jet_pulses", [told])
    assert "jet_schedule[1]: is shorter than a sample, 0.08 s" in str(case.simulation_doubts[0])
    quick = load_scenario("jet_pulses", [told, "vehicle.jet_commands={as: on_time}"])
    assert quick.simulation_doubts == []


def test_doubts_in_a_scenarios_vehicle_are_its_own_too(toy_data: dict[str, Any]) -> None:
    toy_data["jets"][1]["thrust"] = 20.0
    case = resolved({"vehicle": toy_data, "failures": [{"kind": "stuck_on", "jet": "J1", "start_s": 99.0}]})
    assert [found.path for found in case.doubts] == [("vehicle", "jets", 1, "thrust"), ("failures", 0, "start_s")]
    assert case.simulation_doubts == case.doubts
    # a record ends where it ends: what a simulation does with failures does not bear on it
    assert [found.path for found in case.estimation_doubts] == [("vehicle", "jets", 1, "thrust")]


def test_a_run_may_be_cut_short() -> None:
    case = load_scenario("sample_maneuver", ["duration_s=3"])
    assert [found.path for found in case.doubts] == [("maneuver", 1, "start_s")]
    assert case.simulation_doubts == []


@pytest.mark.parametrize("start", ["nominal", "zero"])
def test_what_is_just_sharp_enough_stays_definite(start: str) -> None:
    # the bound is no obstacle where the filter still works, and leaves it room
    case = load_scenario("small_satellite_maneuver", ["duration_s=6", f"estimation.start={start}"])
    data = case.model_dump(mode="json")

    def accepted(quantum: float) -> Scenario | None:
        data["vehicle"]["gyros"][0] = {"name": "gyro", "quantum": quantum}
        try:
            return resolved(data)
        except InputError:
            return None

    sharpest = next(found for exponent in range(-12, 0) if (found := accepted(10.0**exponent)) is not None)
    assert sharpest.vehicle_data.gyros[0].quantum <= 1e-8
    assert np.isfinite(simulate(sharpest)["standard_deviation"]).all()


@pytest.mark.parametrize("engine", ["diagram", "loop"])
def test_a_vehicle_that_a_jet_spins_up_for_good_ends_the_run(toy_data: dict[str, Any], engine: str) -> None:
    # 50 N on an arm of 1 m adds 2 rad/s to a moment of 2.5 kg-m^2 in a sample of 0.1 s: a turn in one after 3.1 s
    data = _edited(toy_data, "mass_properties.inertia", [[2.5, 0, 0], [0, 2.5, 0], [0, 0, 2.5]])
    data = _edited(data, "jets.*.thrust", 50.0)
    case = {"vehicle": data, "duration_s": 50.0, "failures": [{"kind": "stuck_on", "jet": "J1", "start_s": 0.0}]}
    case["detector"] = {"kind": "off"}
    case["jet_schedule"] = [{"jet": "J1", "start_s": 0.0, "end_s": 1.0}]
    case["execution"] = {"engine": engine}
    with pytest.raises(InputError, match=r"at t = 3\.\d+ s the vehicle makes 1\.\d+ turns in a sample"):
        simulate(resolved(case))


# ------------------------------------------------------------------------------------ what YAML says


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("name: !!bool maybe\n", "tag tag:yaml.org,2002:bool says what the value is not"),
        ("name: !!timestamp xx\n", "tag tag:yaml.org,2002:timestamp"),
        ("duration_s: !!int 1.5\n", "tag tag:yaml.org,2002:int"),
        ("name: !!binary xx\n", "write the value alone (line 1, column 7)"),
        ("name: " + 500_000 * "a " + "\n", "1000007 characters; no vehicle or scenario needs more"),
    ],
)
def test_yaml_that_is_no_file_of_ours_is_refused(text: str, words: str) -> None:
    with pytest.raises(InputError) as caught:
        Document(text, "case.yaml")
    assert words in str(caught.value)


def test_tags_that_fit_are_read() -> None:
    text = "a: !!float 1e-5\nb: !!str 5\nc: !!map {d: !!seq [!!int 1, !!null ~]}\ne: !!float 2\n"
    assert Document(text, "case.yaml").data == {"a": 1e-5, "b": "5", "c": {"d": [1, None]}, "e": 2.0}


def test_numbers_that_are_none_are_written_as_yaml_has_them() -> None:
    assert to_yaml({"a": float("nan"), "b": -float("inf")}) == "a: .nan\nb: -.inf\n"


def test_a_name_that_no_file_can_have_is_no_file(tmp_path: Path) -> None:
    path = tmp_path / "case.yaml"
    path.write_text('vehicle: "a\\0b.yaml"\n', encoding="utf-8")
    with pytest.raises(InputError, match=r"line 1: vehicle: .*no file can have this name"):
        load_scenario(path)


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ("failures[²].jet=x", "expected an index such as [0]"),
        (f"failures[{'9' * 5000}].jet=x", "expected an index such as [0]"),
        ("seed=1\nduration_s: 5", "the value has more than one line"),
        ("seed=\n  1", "the value has more than one line"),
    ],
)
def test_what_set_cannot_say(override: str, words: str) -> None:
    with pytest.raises(InputError) as caught:
        load_scenario("sample_maneuver", [override])
    assert words in str(caught.value)


def test_thousands_of_mistakes_are_told_in_a_hundred_lines(tmp_path: Path) -> None:
    document = Document("jets:\n" + "- {}\n" * 400, "toy.yaml")
    with pytest.raises(InputError) as caught:
        validated(Vehicle, document.data, document)
    assert len(caught.value.problems) == 101
    assert caught.value.problems[-1].endswith("more like these")


# --------------------------------------------------------------------------------- the command line


@pytest.fixture
def odd_file(tmp_path: Path, toy_data: dict[str, Any]) -> Path:
    """A vehicle with a doubt."""
    toy_data["jets"][1]["thrust"] = 20.0
    path = tmp_path / "toy.yaml"
    path.write_text(to_yaml(toy_data), encoding="utf-8")
    return path


def test_check_warns_and_is_content(massprop: Massprop, odd_file: Path) -> None:
    said = massprop("check", odd_file)
    assert said.status == 0
    assert f"{odd_file}: warning: jets[1].thrust: is 2 times the nominal thrust of its kind" in said.out


def test_a_run_notes_what_it_doubts_in_a_line(massprop: Massprop) -> None:
    late = "failures=[{kind: stuck_on, jet: R4R, start_s: 9}]"
    arguments = ("run", "jet_pulses", "--set", "duration_s=1", "--set", late, "--no-report")
    warnings = [line for line in massprop(*arguments).err.splitlines() if "failures" in line]
    assert warnings == [
        "massprop: warning: failures[0].start_s: comes at or after the end of the run, 1 s, and does nothing"
    ]
    assert massprop(*arguments, "--quiet").err == ""


def test_a_designation_may_be_anything_that_telemetry_bears(toy_data: dict[str, Any]) -> None:
    names = ["[/red]", "/*NAME*/", "a,b", "</script>", "é", "1"]
    for jet, name in zip(toy_data["jets"], names, strict=False):
        jet["designation"] = name
    assert [f"jet_{name}" for name in names] == columns(validated(Vehicle, toy_data))[7:13]
