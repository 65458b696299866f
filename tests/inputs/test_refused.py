"""Wrong scenarios and vehicles: one message each that says file, line, field and what would be right."""

from __future__ import annotations

import copy
import re
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import cube_data

from massprop_drake import InputError, Scenario, load_scenario, load_vehicle
from massprop_drake.inputs.model import validate_data
from massprop_drake.inputs.vehicle_file import Vehicle
from massprop_drake.inputs.yaml import Document, to_yaml

DELETED = object()


def refused(call: Callable[[], object]) -> str:
    """The only message, in one line."""
    with pytest.raises(InputError) as caught:
        call()
    (problem,) = caught.value.problems
    assert "\n" not in problem
    return problem


def require(said: str, pattern: str) -> None:
    """The message has the pattern in it; `*` stands for any text."""
    assert re.search(re.escape(pattern).replace(r"\*", ".*"), said), said


def listed(key: str, *entries: str) -> str:
    return f"duration_s: 60\n{key}:\n" + "".join(f"  - {{{entry}}}\n" for entry in entries)


maneuver, failures, jumps, pulses, errors = (
    partial(listed, key) for key in ("maneuver", "failures", "jumps", "jet_schedule", "sensors:\n  errors")
)
WINDOW = "controller: rhc, axis: +x, start_s: 1, end_s: 3"
ON = "kind: stuck_on, jet: R4R, start_s: 50"
DOCK = "kind: dock, time_s: 45, mass: 10, position: [32, 0, 2]"
RELEASE = DOCK.replace("dock", "release")
INDEFINITE = (np.eye(10) + 2.0 * np.eye(10)[::-1]).tolist()
COUPLED = np.eye(10)
COUPLED[9, 2] = COUPLED[2, 9] = 0.1

FILES = [
    (maneuver(WINDOW, WINDOW), ", line 4: maneuver[1]: overlaps maneuver[0] on the same axis*1 to 3 s and 1 to 3 s"),
    (maneuver(WINDOW.replace("end_s: 3", "end_s: 1")), "line 3: maneuver[0]: end_s must be later than start_s, got 1"),
    (maneuver(WINDOW.replace(", end_s: 3", "")), "line 3: maneuver[0].end_s: missing"),
    (pulses("jet: R9R, start_s: 0, end_s: 1"), "line 3: jet_schedule[0].jet: 'R9R' is no jet of vehicle 'orbiter'; di"),
    (maneuver(WINDOW) + "jet_schedule:\n  - {jet: R4R, start_s: 0, end_s: 1}\n", ": a maneuver is flown by the autopi"),
    (errors("sensor: gyr"), "line 4: sensors.errors[0].sensor: 'gyr' is no sensor of vehicle 'orbiter'; did you mean"),
    ("sensors: {gyro: acc1}\n", "line 1: sensors.gyro: 'acc1' is no gyro of vehicle 'orbiter'; valid are: gyro"),
    ("plant: {time_step: 0.05}\n", "plant.time_step: must be 0 (continuous) or the vehicle's sample period, 0.08 s"),
    ("duration_s: '50'\n", "line 1: duration_s: *valid number, got '50'"),
    (
        "rotation:\n  process_noise_std: [0, 0, 0, 0, 0, 0, 0, 0, -1]\n",
        "line 2: rotation.process_noise_std[8]: *equal to 0, got -1",
    ),
    ("rotation:\n  filtr: extended\n", "line 2: rotation.filtr: unknown key; did you mean 'filter'?"),
    ("vehicle: orbitr\n", "line 1: vehicle: 'orbitr' is neither a bundled vehicle nor a file; did you mean 'orbiter'?"),
    ("", ": the document is empty"),
    # failures and payloads
    (jumps(f"{DOCK}, inertia: [[9e8, 0, 0], [5, 1, 0], [0, 0, 1]]"), "line 3: jumps[0].inertia: must be symmetric"),
    ("duration_s: 0.05\n", "line 1: duration_s: must be at least one sample period, 0.08 s"),
    ("name: a\nseed: 1\nname: b\n", "line 3: name: the key appears twice, first in line 1"),
    (errors("sensor: gyro", "sensor: gyro"), "line 5: sensors.errors[1].sensor: 'gyro' has errors already"),
    (failures(ON, "kind: stuck_off, jet: R4R, start_s: 55"), "line 4: failures[1]: overlaps failures[0]*R4R"),
    (failures("kind: degraded, jet: R4R, start_s: 50"), "line 3: failures[0].fraction: missing; this field is require"),
    (failures(ON + ", force: 3"), "line 3: failures[0].force: is a key of kind: leak, and the kind is stuck_on"),
    (failures("kind: stuckon, jet: R4R, start_s: 50"), "line 3: failures[0]*'stuckon'*stuck_on, stuck_off, degraded,"),
    (failures("jet: R4R, start_s: 50"), "line 3: failures[0]: missing kind*stuck_on, stuck_off, degraded, leak, inter"),
    (jumps(RELEASE.replace("10", "6000")), "line 3: jumps[0].mass: *6000*5908.11"),
    (jumps(RELEASE.replace("10", "3000"), RELEASE.replace("10", "3000")), "line 4: jumps[1].mass: *3000*2908.11"),
    # a given start
    ("estimation: {start: given}\n", "estimation: start: given and the field `given` go together"),
    (f"estimation: {{start: given, given: {{covariance: {INDEFINITE}}}}}\n", "covariance: must be symmetric and posit"),
    (
        f"estimation: {{filter: thesis, start: given, given: {{covariance: {COUPLED.tolist()}}}}}\n",
        "covariance: must be zero between 1/m and the others, whose filters are apart",
    ),
    # priors of faults
    ("faults:\n  drifting: 0.3\n  full_thrust: 0.8\n", "line 3: faults.full_thrust: is with drifting 1.1 of all failu"),
    ("faults:\n  false_per_hour: 1e-3\n", "line 2: faults.false_per_hour: 0.001 is not below jet_per_hour, 0.001: "),
    ("faults:\n  jet_per_hour: 2000\n", "faults: rates of 44 jets, *8.8e+04 per hour, 1.96 events in a sample period"),
    ("faults:\n  reading_per_hour: 6000\n", "faults: rates of 44 jets, *12 components*7.2e+04 per hour, 1.6 events in"),
    ("faults:\n  jets:\n    R4R: {modes: []}\n", "line 3: faults.jets.R4R.modes: is empty; this field is required: na"),
    ("faults:\n  jets:\n    R4S: {per_hour: 0.1}\n", "line 3: faults.jets.R4S: 'R4S' is no jet of vehicle 'orbiter';"),
    ("estimation: {filter: thesis}\nfaults:\n  drifting: 0.1\n", "line 3: faults.drifting: is a key of estimation.fil"),
]


@pytest.mark.parametrize(("text", "message"), FILES, ids=[message[:50] for _, message in FILES])
def test_a_wrong_scenario_file_is_named_with_line_and_field(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "case.yaml"
    path.write_text(text, encoding="utf-8")
    said = refused(lambda: load_scenario(path))
    assert said.startswith(str(path))
    require(said, message)
    assert "this field is required" not in said or "missing" in said or "is empty" in said


MOVE = "joint: j, position: 0"
MODEL = "plant={kind: multibody, model: servicer_slosh.sdf, body: bus, "
LEAK = "failures=[{kind: leak, jet: R4R, start_s: 1, force: %s}]"
PAYLOAD = "jumps=[{kind: dock, time_s: 1, mass: %s, position: %s, inertia: %s}]"
TONE = "sensors.errors=[{sensor: gyro, vibration: [{frequency_hz: %s, amplitude: %s}]}]"
MOCAP = "{name: mocap, position_std: 1e-4, attitude_std: 1e-3}"
SLOSH = (
    "vehicle.moving=[{name: tank, kind: slosh, mass: %s, position: [0.1, 0.2, 0.3], axes: %s, frequency_hz: %s, "
    "damping: 0.02}]"
)
THESIS, JOINT, ARM, FREE = "sample_maneuver", "orbiter_maneuver", "servicer_slosh", "air_bearing_pulses"

OVERRIDES = [
    # not an override, or none that can be set
    (THESIS, "maneuver[99].axis=-x", "there is no 99"),
    (THESIS, "maneuver[x].axis=-x", "expected an index such as [0] in 'maneuver[x].axis'"),
    (THESIS, f"failures[{'9' * 5000}].jet=x", "expected an index such as [0]"),
    (THESIS, "sede=1", "sede: unknown key; did you mean 'seed'?"),
    (THESIS, f"name={'x' * 3000}", "got 'x*x... (3000 characters)"),
    # what no physical run can be
    (THESIS, "plant.initial_rate=[0, 50, 0]", "plant.initial_rate: turns the vehicle by 4 rad in a sample of 0.08 s"),
    (THESIS, "plant.disturbance.torque=[1.0e14, 0, 0]", "in SI units 1.356e+14 N-m, is above 1e+12 N-m"),
    (
        THESIS,
        ["estimation.start=nominal", "rotation.process_noise_std=[1,1,1,1,1,1,0,0,0]"],
        "the covariance could lose its definiteness",
    ),
    (THESIS, PAYLOAD % ("1e300", "[0, 0, 0]", "null"), "jumps[0].mass: 1e+300, in SI units"),
    (ARM, ["seed=1", "plant.mass=150"], "--set plant.mass: unknown key"),
    (
        THESIS,
        ["plant.mass_properties.mass=3", "plant.mass_properties.center_of_mass=[0, 0, 0]"],
        "--set plant.mass_properties.center_of_mass: plant.mass_properties.inertia: missing; this field is required",
    ),
    (JOINT, "vehicle.mass_properties.mass=-1", "--set vehicle.mass_properties.mass: input should be greater than 0"),
    # keys of the other filter, kind or detector
    (JOINT, "rotation.filter=extended", "rotation.filter: is a key of estimation.filter: thesis, and the filter is jo"),
    (ARM, "plant.depletion=false", "plant.depletion: is a key of kind: rigid, and the kind is multibody"),
    (ARM, "execution.engine=loop", "loop does not cover a continuous plant, whose steps are Drake's; use diagram"),
    (ARM, "jumps=[{kind: dock, time_s: 1, mass: 2, position: [0, 0, 0]}]", "jumps: a multibody plant knows no payload"),
    (
        ARM,
        f"{MODEL}moves: [{{{MOVE}, start_s: 1, end_s: 3}}, {{{MOVE}, start_s: 2, end_s: 4}}]}}",
        "plant.moves[1]: overlaps moves[0] on the same axis, jet or joint (j): 2 to 4 s and 1 to 3 s",
    ),
    (ARM, f"{MODEL}joints: [{{joint: j}}, {{joint: j}}]}}", "plant.joints[1].joint: 'j' has an entry already; give on"),
    (FREE, ["estimation={filter: thesis}", "detector={}"], "thesis does not go with vehicle 'air_bearing', which need"),
    (JOINT, ["estimation={filter: pose}", "joint={}"], "pose does not go with vehicle 'orbiter', which has no pose"),
    # a vehicle's parts
    (JOINT, "vehicle.disturbance={time_constant_s: 60}", "vehicle.disturbance: nothing is said to act; give torque_st"),
    (JOINT, "vehicle.accelerometers=[]", "preferred_accelerometer: 'acc2' is not an accelerometer"),
    (ARM, SLOSH % (4, "[x, [0.6, 0.8, 0.0]]", 0.1), "vehicle.moving[0].axes: *square to each other"),
    (ARM, SLOSH % (500, "[x]", 0.1), "moving: *as much mass"),
    (ARM, SLOSH % (4, "[x]", 1.1), "moving: *too fast for samples of 0.1 s, up to 1 Hz"),
    ("servicer_panel_stated", "moving[1].name=left", "moving: two parts have one name"),
    (
        "servicer_panel_stated",
        ["estimation.filter=thesis", "detector.kind=cglr", "joint={}", "faults={}"],
        "moving: plays no part",
    ),
    ("cubesat_leak", "vehicle.wheels[0].axis=[1, 1, 0]", "vehicle.wheels[0].axis: must have length 1 within 0.002"),
    ("cubesat_leak", f"vehicle.poses=[{MOCAP}]", "play no part in a fixed frame"),
    (FREE, "vehicle.jets[2].direction=[0, 0, 1]", "jets[2].direction: with motion: planar a jet along z moves nothing"),
    (FREE, f"vehicle.poses=[{MOCAP}, {{name: cam}}]", "sensor 'cam' measures nothing: give position_std, attitude_std"),
    (FREE, f"vehicle.poses=[{MOCAP}, {MOCAP}]", "vehicle.poses[1].name: 'mocap' appears twice; it must be unique"),
    (FREE, "vehicle.disturbance={torque_std: 1, time_constant_s: 60}", "disturbance: is not estimated in a fixed fram"),
    (
        FREE,
        "vehicle.mass_properties.inertia=[[0.3, 0, 0.01], [0, 0.3, 0], [0.01, 0, 0.3]]",
        "mass_properties.inertia: with motion: planar products xz and yz play no part; give 0",
    ),
    (THESIS, LEAK % "1e5", "failures[0].force: is 115 times the thrust of jet 'R4R'"),
    (THESIS, TONE % (3, [1.0e9, 1, 1]), "sensors.errors[0].vibration[0].amplitude[0]: 1e+09 rad/s, is above"),
    (JOINT, "detector.kind=cglr", "detector.kind: cglr does not go with estimation.filter: joint; use hypotheses or"),
    ("cubesat_leak", "vehicle.wheels[0].name=wheels", "'wheels' is a signal of every run"),
]


@pytest.mark.parametrize(("name", "overrides", "message"), OVERRIDES, ids=[message[:50] for *_, message in OVERRIDES])
def test_a_wrong_override_is_named_with_its_field(name: str, overrides: str | list[str], message: str) -> None:
    given = [overrides] if isinstance(overrides, str) else overrides
    require(refused(lambda: load_scenario(name, given)), message)


def test_a_scenario_that_a_program_makes_wrong_is_refused_where_it_is_made() -> None:
    with pytest.raises(ValueError, match="'servicr' is neither a bundled vehicle nor a file; did you mean 'servicer'"):
        Scenario(vehicle="servicr")
    with pytest.raises(ValueError, match=r"faults.jets.R4S\n.*'R4S' is no jet of vehicle 'orbiter'"):
        Scenario(vehicle="orbiter", faults={"jets": {"R4S": {}}})  # type: ignore[arg-type]


def test_missing_files_and_unknown_names_are_told(tmp_path: Path) -> None:
    for load, kind, name in ((load_scenario, "scenario", "sample_manuever"), (load_vehicle, "vehicle", "orbitr")):
        require(refused(lambda load=load: load(tmp_path / "nowhere.yaml")), "nowhere.yaml: no such file")
        require(refused(lambda load=load: load(tmp_path)), "is a folder, and no run's")
        near = f"'{name}' is neither a bundled {kind} nor a file; did you mean"
        require(refused(lambda load=load, name=name: load(name)), near)
        require(refused(lambda load=load: load("x" * 300)), "")
    (tmp_path / "latin.yaml").write_bytes(b"name: \xe9t\xe9\n")
    require(refused(lambda: load_vehicle(tmp_path / "latin.yaml")), "latin.yaml: not a text file in UTF-8")


def changed(data: dict[str, Any], path: str, value: Any) -> dict[str, Any]:
    """A copy with one field, or the field of every entry of a list (`*`), replaced or deleted."""
    data = copy.deepcopy(data)
    here: list[Any] = [data]
    *inner, last = path.split(".")
    for part in inner:
        here = [
            inside for one in here for inside in (one if part == "*" else [one[int(part) if part.isdigit() else part]])
        ]
    for one in here:
        if value is DELETED:
            del one[last]
        else:
            one[int(last) if last.isdigit() else last] = value
    return data


def diagonal(x: float, y: float | None = None, z: float | None = None) -> list[list[float]]:
    return np.diag([x, x if y is None else y, x if z is None else z]).tolist()


INERTIA, KIND = "mass_properties.inertia", "jet_kinds.primary"
VEHICLES = [
    (INERTIA, diagonal(1.0, 1.0, 2.1), "mass_properties.inertia: *exceeds the sum of the other two"),
    (INERTIA, diagonal(1e-6), "too small for this mass: the radius of gyration is 0.0001 m"),
    ("mass_properties.mass", 1e300, "above 1e+09 kg: from a satellite on a chip"),
    ("mass_properties.center_of_mass", [0.0, 5e3, 0.0], "mass_properties.center_of_mass[1]: 5000 m, is above 1000 m"),
    ("units", DELETED, "units: missing"),
    ("jets.4.thrust", "10", "jets[4].thrust: *valid number, got '10'"),
    ("jets.1.mass_flow", 1e-12, "gives a specific impulse that cannot be"),
    ("gyros.0.quantum", 1e-11, "the covariance could lose its definiteness in rounding"),
    ("uncertainty", 1e6, "uncertainty: 1e+06, is above 10: less is beyond any scale, more says nothing"),
    ("jets.1.direction", [0.0, 1.0, 0.5], "jets[1].direction: *length 1 within 0.002, got 1.118"),
    (INERTIA, diagonal(1.0, 1.0, 0.0), "mass_properties.inertia: *positive definite"),
    (f"{INERTIA}.0.1", 5.0, "mass_properties.inertia: must be symmetric"),
    (INERTIA, diagonal(0.05), "turns it by 2 rad more in the sample"),
    ("jets.2.position", [1.0, 0.0], "jets[2].position: *3 values, got 2"),
    ("jets.0.thrusts", 1.0, "jets[0].thrusts: unknown key; did you mean 'thrust'?"),
    ("jets.4.designation", "J1", "jets[4].designation: 'J1' appears twice"),
    ("jets.4.kind", "primry", "jets[4].kind: *did you mean 'primary'?"),
    ("jets.1.thrust", 2e5, "jets[1].thrust: accelerates 100 kg at 2000 m/s^2, 203.9 times the weight on Earth"),
    ("jets.1.designation", "J\x1b[31m", "jets[1].designation: must be printable characters"),
    ("jets.1.designation", "j1", "'j1' has a column in telemetry that is like one of 'J1', but for the case of letter"),
    ("preferred_accelerometer", "ac", "preferred_accelerometer: *did you mean 'acc'?"),
    ("gyros.0.quantum", 0.0, "gyros[0]: *cannot use a perfect sensor"),
    ("gyros.0.range", 1e-7, "gyros[0].range: is 1e-07, for a quantum of 1e-06: hardly a reading lies within it"),
    ("gyros", [], "gyros: is empty; this field is required: without measured rates neither inertia nor center of mass"),
    ("gyros", DELETED, "gyros: missing; this field is required: without measured rates neither inertia nor center of"),
    (f"{KIND}.specific_impulse_s", 1e6, "above 30000 s: cold gas gives tens of seconds"),
]


@pytest.mark.parametrize(("path", "value", "message"), VEHICLES, ids=[message[:50] for *_, message in VEHICLES])
def test_a_wrong_vehicle_file_is_named_with_line_and_field(tmp_path: Path, path: str, value: Any, message: str) -> None:
    file = tmp_path / "toy.yaml"
    file.write_text(to_yaml(changed(cube_data(), path, value)), encoding="utf-8")
    with pytest.raises(InputError) as caught:  # of a number that upsets several others there may be more than one
        load_vehicle(file)
    said = " | ".join(caught.value.problems)
    assert re.match(re.escape(str(file)) + r"(, line \d+)?: ", said), said
    require(said, message)


def test_the_line_is_that_of_the_field_and_all_mistakes_are_found(tmp_path: Path) -> None:
    data = changed(changed(cube_data(), "jets.7.thrust", -3.25), "color", "red")
    del data["units"]
    path = tmp_path / "toy.yaml"
    path.write_text(to_yaml(data), encoding="utf-8")
    line = next(n for n, text in enumerate(path.read_text(encoding="utf-8").splitlines(), 1) if "-3.25" in text)
    with pytest.raises(InputError, match=r"\(and 2 more problems\)") as caught:
        load_vehicle(path)
    assert len(caught.value.problems) == 3
    assert any(said.startswith(f"{path}, line {line}: jets[7].thrust") for said in caught.value.problems)


def test_thousands_of_mistakes_are_told_in_a_hundred_lines() -> None:
    document = Document("jets:\n" + "- {}\n" * 400, "toy.yaml")
    with pytest.raises(InputError) as caught:
        validate_data(Vehicle, document.data, document)
    assert len(caught.value.problems) == 101
    assert caught.value.problems[-1].endswith("more like these")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("jets:\n  - number: 1\n    number: 2\n", ", line 3: jets[0].number: the key appears twice, first in line 2"),
        ("a:\n\t- b\n", ": not valid YAML: *line 2"),
        ("a: !!python/object:os.system 1\n", ": not valid YAML: "),
        ("? [a, b]\n: 1\n", ", line 1: a key must be a plain word"),
        ("a: &x\n  b: *x\n", ""),
        ("a: " + 60 * "[" + 60 * "]" + "\n", ""),
        ("name: !!bool maybe\n", "tag tag:yaml.org,2002:bool says what the value is not"),
        ("name: " + 500_000 * "a " + "\n", "1000007 characters; no vehicle or scenario needs more"),
    ],
    ids=range(8),
)
def test_what_is_no_yaml_of_ours_is_refused(text: str, message: str) -> None:
    said = refused(lambda: Document(text, "case.yaml"))
    assert said.startswith("case.yaml")
    require(said, message)


def test_tags_that_fit_are_read_and_numbers_as_people_and_yaml_write_them() -> None:
    numbers = {"1e-6": 1e-6, "2": 2, "+.5": 0.5, "1.": 1.0, "3E+02": 300.0}
    for written, value in numbers.items():
        assert Document(f"quantum: {written}\n", "toy.yaml").data == {"quantum": value}
    text = "a: !!float 1e-5\nb: !!str 5\nc: !!map {d: !!seq [!!int 1, !!null ~]}\ne: !!float 2\n"
    assert Document(text, "case.yaml").data == {"a": 1e-5, "b": "5", "c": {"d": [1, None]}, "e": 2.0}
    assert to_yaml({"a": float("nan"), "b": -float("inf")}) == "a: .nan\nb: -.inf\n"
