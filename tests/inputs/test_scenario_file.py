"""Scenario files: the bundled ones, overrides, and what is wrong with a wrong file."""

from __future__ import annotations

import gc
import math
import re
import shutil
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import REPOSITORY

from massprop_drake import InputError, Scenario, load_scenario, simulate
from massprop_drake.inputs import model, params
from massprop_drake.inputs.model import Model, digest, yaml_text
from massprop_drake.inputs.params import thrust_factors, true_properties
from massprop_drake.inputs.scenario import FaultsBlock, JointBlock, bundled_scenarios, resolved, set_field
from massprop_drake.inputs.yaml import to_yaml
from massprop_drake.maths.estimation.detector import STATUS
from massprop_drake.maths.estimation.faults.fault_report import HYPOTHESIS_REPORT

DATA = REPOSITORY / "tests" / "data"
MANEUVER = "maneuver:\n  - {controller: rhc, axis: +x, start_s: 1, end_s: 3}\n"


def _written(folder: Path, text: str, name: str = "case.yaml") -> Path:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


def _problem(path: Path, overrides: list[str] | None = None) -> str:
    with pytest.raises(InputError) as caught:
        load_scenario(path, overrides)
    assert len(caught.value.problems) == 1, caught.value.problems
    assert "\n" not in caught.value.problems[0]
    return caught.value.problems[0]


# ---------------------------------------------------------------------------------- the bundled ones


@pytest.mark.parametrize("name", bundled_scenarios())
def test_every_bundled_scenario_loads_and_runs_shortened(name: str) -> None:
    scenario = load_scenario(name, ["duration_s=4"])
    assert scenario.name == name
    assert scenario.description
    run = simulate(scenario)
    period_s = scenario.vehicle_data.sample_period_s
    assert run.summary["duration_s"] == pytest.approx(math.floor(4.0 / period_s + 1e-9) * period_s, rel=1e-12)
    assert run.summary["autopilot"]["firings"] > 0
    assert run["rotation_used"].sum() > 0
    suspicion = {*STATUS.logged, *HYPOTHESIS_REPORT.logged, "failure_magnitude", "likelihood"}
    suspicion |= {name for name in run.signals if name.startswith(("verdict", "jump_", "fault_"))}
    for signal, logged in run.signals.items():
        # these are NaN or infinite at times; hypotheses say nothing where there is none
        of_hypotheses = scenario.detector.kind in ("hypotheses", "thrust_factors") and signal in suspicion
        planar = scenario.vehicle_data.motion == "planar" and signal == "standard_deviation"
        values = logged[:, [2, 6, 7, 9]] if planar else logged  # what cannot move has none
        if signal in ("estimate", "standard_deviation") and not params.weighs(scenario):
            values = logged[:, :9]  # without an accelerometer there is no mass
        if signal == "tracker":
            values = logged[:, 3:]  # an attitude without a position
            values = values[np.isfinite(values).any(axis=1)]  # at times of its own
        at_times = (
            signal.endswith(("innovation", "innovation_std", "nis", "likelihood", "failure_magnitude"))
            or signal == "request"
        )
        if not (at_times or of_hypotheses):
            assert np.isfinite(values).all(), signal


def test_the_bundled_scenarios_are_those_that_are_promised() -> None:
    assert {"sample_maneuver", "jet_pulses"} <= set(bundled_scenarios())


def test_the_sample_maneuver_is_that_of_the_thesis(sample_maneuver: Scenario) -> None:
    assert sample_maneuver.duration_s == 50.0
    assert sample_maneuver.vehicle_data.name == "orbiter"
    assert sample_maneuver.plant.thrust_transient == "none"
    assert sample_maneuver.estimation.start == "zero"
    assert len(sample_maneuver.maneuver) == 13


def test_a_scenario_that_states_nothing_has_the_defaults() -> None:
    scenario = load_scenario(DATA / "defaults.yaml")
    assert scenario.model_copy(update={"vehicle": "orbiter"}) == Scenario()
    assert scenario.vehicle_data.name == "orbiter"
    short = simulate(load_scenario(DATA / "defaults.yaml", ["duration_s=1"]))
    assert not short["command"].any()


def _unset(model: Model, prefix: str = "") -> list[str]:
    """Fields of a model, and of the models in it, that are at their defaults."""
    found = []
    for name, field in type(model).model_fields.items():
        value = getattr(model, name)
        if not field.is_required() and value == field.get_default(call_default_factory=True):
            found.append(prefix + name)
        items = value if isinstance(value, tuple) else (value,)
        for item in items:
            if isinstance(item, Model) and name != "vehicle":
                found += _unset(item, f"{prefix}{name}.")
    return found


def test_one_of_everything_runs(tmp_path: Path, toy_data: dict[str, Any]) -> None:
    toy_data["jet_kinds"]["vernier"] = {"nominal_thrust": 1.0, "specific_impulse_s": 60.0}
    toy_data["jets"][-1]["kind"] = "vernier"
    toy_data["jets"][-1]["thrust"] = 1.0
    toy_data["jet_commands"] = {"as": "on_time"}
    _written(tmp_path, to_yaml(toy_data), "toy.yaml")
    path = tmp_path / "one_of_everything.yaml"
    shutil.copy(DATA / "one_of_everything.yaml", path)
    scenario = load_scenario(path)
    joint = ["joint", *(f"joint.{key}" for key in JointBlock.model_fields)]  # of the other filter
    faults = ["faults", *(f"faults.{key}" for key in FaultsBlock.model_fields)]  # likewise
    left_out = [
        "moving",  # which the filters of the thesis do not follow
        "jet_schedule",
        "wheel_schedule",  # of wheels, which the filters of the thesis do not know
        "engine_schedule",  # nor engines
        "plant.kind",
        "plant.wheel_speeds",
        "plant.wheel_dispersion",
        "plant.engine_errors",
        "plant.engine_dispersion",
        "plant.propellant",  # of tanks, likewise
        "autopilot.engaged",  # for jets that are prescribed
        "autopilot.test_firing",  # by the joint filter alone
        "autopilot.wheels",  # likewise
        "autopilot.gimbal_bandwidth",
        "estimation.given.covariance",
        "estimation.readings_per_s",
        *joint,
        "detector.kind",
        *faults,
        "engine_failures",
        "execution",
        "execution.engine",
        "execution.compiled",
    ]  # continuous
    assert _unset(scenario) == left_out  # a new field belongs into the file
    run = simulate(scenario)
    assert run.time_s.size == 21
    assert run["command"].any()
    # what was asked for arrives: nothing is used up, the mass is the one drawn about 110 kg until 1 kg docks at 1 s,
    # which the sample after shows; thrust is instantaneous, and only the first six jets fail
    mass = true_properties(scenario).mass
    assert 100.0 < mass < 120.0
    assert mass != 110.0
    np.testing.assert_allclose(1.0 / run["truth"][:, 9], [mass] * 11 + [mass + 1.0] * 10, rtol=1e-14)
    full = np.array([jet.thrust for jet in scenario.vehicle_data.jets]) * thrust_factors(scenario)
    np.testing.assert_allclose(run["thrust"][:, 6:], (run["command"] * full)[:, 6:], rtol=1e-12)
    assert ((run["command"] > 0.0) & (run["command"] < 1.0)).any()  # on-times
    assert run["thrust"][12, 0] == full[0]
    np.testing.assert_allclose(run["thrust"][14, 3] - run["command"][14, 3] * full[3], 0.2, rtol=1e-12)
    np.testing.assert_allclose(run["rate"][0], [0.001, 0.0, -0.002], rtol=0.0, atol=0.0)


@pytest.mark.parametrize("name", bundled_scenarios())
def test_a_resolved_scenario_written_out_reads_back_equal(tmp_path: Path, name: str) -> None:
    choice = {
        "joint": "joint.rate_walk=1e-7",
        "pose": "detector.lead=7",
        "thesis": "rotation.process_noise_std=[1e-9,0,0,0,0,0,0.1,0,1e-7]",
    }[load_scenario(name).estimation.filter]
    scenario = load_scenario(name, ["seed=5", choice])
    again = load_scenario(_written(tmp_path, yaml_text(scenario)))
    assert again == scenario
    assert digest(again) == digest(scenario)
    assert yaml_text(again) == yaml_text(scenario)


# ----------------------------------------------------------------------------------------- a given start

TEN = "[1e-7, 1e-8, 1e-8, 1e-9, 1e-9, 1e-9, 1, 1, 1, 1e-5]"


def _matrix(row: int, column: int, value: float) -> str:
    """A covariance of ones on the diagonal with one element changed, as YAML."""
    matrix = np.eye(10)
    matrix[row, column] = value
    return str(matrix.tolist())


@pytest.mark.parametrize(
    ("estimation", "words"),
    [
        ("{start: given}", "estimation: start: given and the field `given` go together"),
        (f"{{given: {{standard_deviation: {TEN}}}}}", "estimation: start: given and the field `given` go together"),
        (f"{{start: zero, given: {{standard_deviation: {TEN}}}}}", "go together"),
        ("{start: given, given: {}}", r"estimation\.given: give either standard_deviation or covariance"),
        (
            f"{{start: given, given: {{standard_deviation: {TEN}, covariance: {_matrix(0, 0, 1.0)}}}}}",
            "give either standard_deviation or covariance",
        ),
        (
            f"{{start: given, given: {{standard_deviation: {TEN.replace('1e-5', '-1e-5')}}}}}",
            "standard_deviation: must be zero or positive",
        ),
        ("{start: given, given: {standard_deviation: [1, 2, 3]}}", r"estimation\.given\.standard_deviation"),
        ("{start: given, given: {standard_deviation: [.nan, 1, 1, 1, 1, 1, 1, 1, 1, 1]}}", "standard_deviation"),
        (f"{{start: given, given: {{covariance: {_matrix(0, 1, 0.5)}}}}}", "must be symmetric and positive"),
        (f"{{start: given, given: {{covariance: {_matrix(3, 3, -1.0)}}}}}", "must be symmetric and positive"),
        (
            "{start: given, given: {covariance: COUPLED}}",
            "covariance: must be zero between 1/m and the others, whose filters are apart",
        ),
    ],
)
def test_a_given_start_that_makes_no_sense_is_refused(tmp_path: Path, estimation: str, words: str) -> None:
    coupled = np.eye(10)
    coupled[9, 2] = coupled[2, 9] = 0.1
    text = f"estimation: {estimation}\n".replace("COUPLED", str(coupled.tolist()))
    assert re.search(words, _problem(_written(tmp_path, text)))


@pytest.mark.parametrize("field", ["plant.thrust_dispersion", "estimation.thrust_uncertainty"])
@pytest.mark.parametrize("value", ["-0.01", "0.31", ".nan"])
def test_a_thrust_error_lies_within_bounds(field: str, value: str) -> None:
    with pytest.raises(InputError, match=field.partition(".")[2]):
        load_scenario("sample_maneuver", [f"{field}={value}"])


@pytest.mark.parametrize("kind", ["gyros", "accelerometers"])
def test_a_rule_for_several_packages_is_one_of_six(kind: str) -> None:
    for rule in ("single", "most_accurate", "mid_value", "average", "weighted_average", "serial"):
        assert (
            getattr(load_scenario("sample_maneuver", [f"sensors.combine.{kind}={rule}"]).sensors.combine, kind) == rule
        )
    with pytest.raises(InputError, match="weighted_average"):
        load_scenario("sample_maneuver", [f"sensors.combine.{kind}=median"])


# --------------------------------------------------------------------------------------- overrides


@pytest.mark.parametrize(
    ("override", "field", "value"),
    [
        ("seed=3", "seed", 3),
        ("rotation.filter=extended", "rotation.filter", "extended"),
        ("plant.depletion=false", "plant.depletion", False),
        ("mass.process_noise_std=1e-7", "mass.process_noise_std", 1e-7),
        ("estimation.std_fraction=null", "estimation.std_fraction", None),
        ("estimation.std_fraction=", "estimation.std_fraction", None),
        ("plant.initial_rate=[0, 0.1, 0]", "plant.initial_rate", (0.0, 0.1, 0.0)),
        ("autopilot.jet_kinds=[primary, vernier]", "autopilot.jet_kinds", ("primary", "vernier")),
        ("description=a = b", "description", "a = b"),
    ],
)
def test_an_override_replaces_a_field(override: str, field: str, value: Any) -> None:
    here: Any = load_scenario("sample_maneuver", [override])
    for part in field.split("."):
        here = getattr(here, part)
    assert here == value
    assert type(here) is type(value)


def test_overrides_reach_into_lists_and_add_to_them() -> None:
    scenario = load_scenario(
        "sample_maneuver",
        [
            "maneuver[0].axis=-x",
            "maneuver[1]={controller: thc, axis: +z, start_s: 5, end_s: 6}",
            "maneuver[13]={controller: rhc, axis: +x, start_s: 48, end_s: 49}",
            "sensors.errors[0]={sensor: gyro}",
            "sensors.errors[0].noise_std=1e-6",
        ],
    )
    assert scenario.maneuver[0].axis == "-x"
    assert (scenario.maneuver[1].controller, scenario.maneuver[1].axis) == ("thc", "+z")
    assert len(scenario.maneuver) == 14
    assert scenario.maneuver[13].start_s == 48.0
    assert scenario.sensors.errors[0].noise_std == 1e-6


def test_later_overrides_win_and_the_original_stays() -> None:
    assert load_scenario("sample_maneuver", ["seed=1", "seed=2"]).seed == 2
    assert load_scenario("sample_maneuver").seed == 0


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ("seed", "expected KEY=VALUE"),
        ("=3", "expected KEY=VALUE"),
        ("seed=[", "not valid YAML"),
        ("maneuver[99].axis=-x", "there is no 99"),
        ("maneuver[99]={}", "there is no 99"),
        ("maneuver[x].axis=-x", r"expected an index such as [0] in 'maneuver[x].axis'"),
        ("maneuver[-1].axis=-x", "expected an index"),
        ("maneuver.0.axis=-x", "there is no '0'"),
        ("rotation..filter=extended", "empty part"),
        ("seed.x=1", "there is no 'x'"),
    ],
)
def test_an_override_that_cannot_be_set_is_named(override: str, words: str) -> None:
    with pytest.raises(InputError) as caught:
        load_scenario("sample_maneuver", [override])
    message = str(caught.value)
    assert message.startswith(f"--set {override}: ")
    assert words in message


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ("rotation.filtr=extended", r"rotation\.filtr: unknown key; did you mean 'filter'\?"),
        ("sede=1", r"sede: unknown key; did you mean 'seed'\?"),
        ("seed=-1", r"seed: input should be greater than or equal to 0, got -1"),
        ("seed=1.5", r"seed: .*integer, got 1\.5"),
        ("duration_s=.nan", r"duration_s: .*finite number, got nan"),
        ("rotation.filter=ekf", r"rotation\.filter: 'ekf' is not one of 'second_order', "),
        ("rotation=3", r"rotation: .*got 3"),
        ("plant.depletion=yes", r"plant\.depletion: .*boolean, got 'yes'"),
    ],
)
def test_an_override_is_checked_like_the_file(override: str, words: str) -> None:
    with pytest.raises(InputError, match=words):
        load_scenario("sample_maneuver", [override])


# --------------------------------------------------------------------------------------- bad files


BAD_FILES = {
    "overlapping windows": (
        MANEUVER + "  - {controller: rhc, axis: -x, start_s: 2, end_s: 4}\n",
        r", line \d+: maneuver\[1\]: overlaps maneuver\[0\] on the same axis, .*2 to 4 s and 1 to 3 s",
    ),
    "negative start": (
        MANEUVER.replace("start_s: 1", "start_s: -1"),
        r", line 2: maneuver\[0\]\.start_s: .*greater than or equal to 0, got -1",
    ),
    "end before start": (
        MANEUVER.replace("end_s: 3", "end_s: 0.5"),
        r", line 2: maneuver\[0\]: end_s must be later than start_s, got 1 to 0\.5",
    ),
    "no length": (
        MANEUVER.replace("end_s: 3", "end_s: 1"),
        r", line 2: maneuver\[0\]: end_s must be later than start_s",
    ),
    "axis without a sign": (
        MANEUVER.replace("+x", "x"),
        r", line 2: maneuver\[0\]\.axis: 'x' is not one of '\+x', '-x'",
    ),
    "unknown controller": (
        MANEUVER.replace("rhc", "rch"),
        r", line 2: maneuver\[0\]\.controller: 'rch' is not one of 'rhc' or 'thc'",
    ),
    "NaN": (
        MANEUVER.replace("end_s: 3", "end_s: .nan"),
        r", line 2: maneuver\[0\]\.end_s: .*finite number, got nan",
    ),
    "missing end": (
        MANEUVER.replace(", end_s: 3", ""),
        r", line 2: maneuver\[0\]\.end_s: missing",
    ),
    "unknown jet": (
        "jet_schedule:\n  - {jet: R9R, start_s: 0, end_s: 1}\n",
        r", line 2: jet_schedule\[0\]\.jet: 'R9R' is no jet of vehicle 'orbiter'; did you mean",
    ),
    "negative start of a pulse": (
        "jet_schedule:\n  - {jet: R4R, start_s: -1, end_s: 1}\n",
        r", line 2: jet_schedule\[0\]\.start_s: .*got -1",
    ),
    "pulse of no length": (
        "jet_schedule:\n  - {jet: R4R, start_s: 1, end_s: 1}\n",
        r", line 2: jet_schedule\[0\]: end_s must be later",
    ),
    "overlapping pulses": (
        "jet_schedule:\n  - {jet: R4R, start_s: 0, end_s: 2}\n  - {jet: R4R, start_s: 1, end_s: 3}\n",
        r", line 3: jet_schedule\[1\]: overlaps jet_schedule\[0\]",
    ),
    "maneuver and schedule": (
        MANEUVER + "jet_schedule:\n  - {jet: R4R, start_s: 0, end_s: 1}\n",
        r": a maneuver is flown by the autopilot, which does not fly: leave out either",
    ),
    "unknown sensor": (
        "sensors:\n  errors:\n    - {sensor: gyr}\n",
        r", line 3: sensors\.errors\[0\]\.sensor: 'gyr' is no sensor of vehicle 'orbiter'; did you mean 'gyro'\?",
    ),
    "sensor twice": (
        "sensors:\n  errors:\n    - {sensor: gyro}\n    - {sensor: gyro}\n",
        r", line 4: sensors\.errors\[1\]\.sensor: 'gyro' has errors already",
    ),
    "unknown gyro": (
        "sensors: {gyro: acc1}\n",
        r", line 1: sensors\.gyro: 'acc1' is no gyro of vehicle 'orbiter'; valid are: gyro",
    ),
    "unknown accelerometer": (
        "sensors: {accelerometer: acc9}\n",
        r", line 1: sensors\.accelerometer: 'acc9' is no accelerometer .*did you mean 'acc",
    ),
    "unknown jet kind": (
        "autopilot: {jet_kinds: [primry]}\n",
        r", line 1: autopilot\.jet_kinds\[0\]: 'primry' is no jet kind .*did you mean 'primary'",
    ),
    "no jet kind": (
        "autopilot: {jet_kinds: []}\n",
        r", line 1: autopilot\.jet_kinds: .*at least 1",
    ),
    "time step": (
        "plant: {time_step: 0.05}\n",
        r", line 1: plant\.time_step: must be 0 \(continuous\) or the vehicle's sample period, 0\.08 s; got 0\.05",
    ),
    "negative time step": (
        "plant: {time_step: -0.08}\n",
        r", line 1: plant\.time_step: must be 0",
    ),
    "too short": (
        "duration_s: 0.05\n",
        r", line 1: duration_s: must be at least one sample period, 0\.08 s",
    ),
    "no duration": (
        "duration_s: 0\n",
        r", line 1: duration_s: .*greater than 0, got 0",
    ),
    "text for a number": (
        "duration_s: '50'\n",
        r", line 1: duration_s: .*valid number, got '50'",
    ),
    "seed too large": (
        "seed: 9223372036854775808\n",
        r", line 1: seed: .*less than 9223372036854775808",
    ),
    "negative noise": (
        "rotation:\n  process_noise_std: [0, 0, 0, 0, 0, 0, 0, 0, -1]\n",
        r", line 2: rotation\.process_noise_std: must be zero or positive",
    ),
    "name that is a path": (
        "name: ../../etc/passwd\n",
        r", line 1: name: .*got '\.\./\.\./etc/passwd'",
    ),
    "unknown field": (
        "maneuvers: []\n",
        r", line 1: maneuvers: unknown key; did you mean 'maneuver'\?",
    ),
    "unknown inner field": (
        "rotation:\n  filtr: extended\n",
        r", line 2: rotation\.filtr: unknown key; did you mean 'filter'\?",
    ),
    "key twice": (
        "name: a\nseed: 1\nname: b\n",
        r", line 3: name: the key appears twice, first in line 1",
    ),
    "null for a list": (
        "maneuver: null\n",
        r", line 1: maneuver: .*got None",
    ),
    "unknown vehicle": (
        "vehicle: orbitr\n",
        r", line 1: vehicle: 'orbitr' is neither a bundled vehicle nor a file; did you mean 'orbiter'\?",
    ),
    "missing vehicle file": (
        "vehicle: nowhere.yaml\n",
        r", line 1: vehicle: nowhere\.yaml: no such file",
    ),
    "no YAML": (
        "name: [a\nb: c\n",
        r": not valid YAML: .*line 2",
    ),
    "empty": (
        "",
        r": the document is empty",
    ),
    "list": (
        "- a\n",
        r": the document is no mapping",
    ),
}


@pytest.mark.parametrize(("text", "words"), list(BAD_FILES.values()), ids=list(BAD_FILES))
def test_a_wrong_field_is_named_with_its_file(tmp_path: Path, text: str, words: str) -> None:
    path = _written(tmp_path, text)
    problem = _problem(path)
    assert re.match(re.escape(str(path)) + words, problem), problem


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("rotation:\n  process_noise_std: [0, 0, 0]\n", r", line 2: rotation\.process_noise_std: .*9"),
        ("plant:\n  initial_rate: [0, 0]\n", r", line 2: plant\.initial_rate: .*3"),
        ("plant:\n  integrator: nonsense\n", r", line 2: plant\.integrator: .*'nonsense'"),
    ],
    ids=["three of nine", "two of three", "unknown integrator"],
)
def test_one_mistake_gives_one_message_that_fits(tmp_path: Path, text: str, words: str) -> None:
    path = _written(tmp_path, text)
    problem = _problem(path)
    assert re.match(re.escape(str(path)) + words, problem), problem
    assert "this field is required" not in problem  # it is there


def test_windows_may_touch_and_axes_may_go_together(tmp_path: Path) -> None:
    text = MANEUVER + (
        "  - {controller: rhc, axis: -x, start_s: 3, end_s: 4}\n"  # follows at once
        "  - {controller: rhc, axis: +y, start_s: 1, end_s: 3}\n"  # another axis
        "  - {controller: thc, axis: +x, start_s: 1, end_s: 3}\n"  # another controller
    )
    assert len(load_scenario(_written(tmp_path, text)).maneuver) == 4


def test_the_sample_period_may_be_given_as_the_time_step(tmp_path: Path) -> None:
    assert load_scenario(_written(tmp_path, "plant: {time_step: 0.08}\n")).plant.time_step == 0.08
    assert load_scenario(_written(tmp_path, "plant: {time_step: 0}\n")).plant.time_step == 0.0


def test_a_missing_file_or_an_unknown_name(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"nowhere\.yaml: no such file"):
        load_scenario(tmp_path / "nowhere.yaml")
    with pytest.raises(InputError, match="'sample_manuever' is neither a bundled scenario nor a file; did you mean"):
        load_scenario("sample_manuever")
    with pytest.raises(InputError, match="is a folder, and no run's"):
        load_scenario(tmp_path)  # a folder that is no run's


# ---------------------------------------------------------------------------------------- vehicles


def test_a_vehicle_file_is_found_beside_the_scenario(
    tmp_path: Path, toy_data: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "cases").mkdir()
    (tmp_path / "vehicles").mkdir()
    _written(tmp_path / "vehicles", to_yaml(toy_data), "toy.yaml")
    path = _written(tmp_path / "cases", "vehicle: ../vehicles/toy.yaml\n")
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    monkeypatch.chdir(elsewhere)
    assert load_scenario(path).vehicle_data.name == "toy"


def test_what_is_wrong_with_a_vehicles_file_is_told_with_both_files(tmp_path: Path, toy_data: dict[str, Any]) -> None:
    toy_data["jets"][2]["thrust"] = -1.0
    _written(tmp_path, to_yaml(toy_data), "toy.yaml")
    path = _written(tmp_path, "seed: 1\nvehicle: toy.yaml\n")
    problem = _problem(path)
    assert problem.startswith(f"{path}, line 2: vehicle: ")
    assert re.search(r"toy\.yaml, line \d+: jets\[2\]\.thrust: .*got -1\.0", problem)


def test_a_vehicle_may_stand_in_the_scenario(tmp_path: Path, toy_data: dict[str, Any]) -> None:
    scenario = load_scenario(_written(tmp_path, to_yaml({"vehicle": toy_data})))
    assert scenario.vehicle_data.name == "toy"
    assert resolved({"vehicle": toy_data}) == scenario


def test_what_is_wrong_with_a_vehicle_in_the_scenario_is_told_with_its_field(
    tmp_path: Path, toy_data: dict[str, Any]
) -> None:
    toy_data["jets"][2]["thrust"] = -1.0
    path = _written(tmp_path, to_yaml({"vehicle": toy_data}))
    problem = _problem(path)
    assert problem.startswith(str(path))
    assert "vehicle.jets[2].thrust: input should be greater than 0, got -1.0" in problem
    with pytest.raises(InputError, match=r": vehicle: preferred_accelerometer: 'acc2' is not an accelerometer"):
        load_scenario("orbiter_maneuver", ["vehicle.accelerometers=[]"])


def test_overrides_reach_into_a_vehicle_in_the_scenario(tmp_path: Path, toy_data: dict[str, Any]) -> None:
    path = _written(tmp_path, to_yaml({"vehicle": toy_data}))
    scenario = load_scenario(path, ["vehicle.mass_properties.mass=123.5"])
    assert scenario.vehicle_data.nominal.mass == 123.5


def test_a_scenario_of_a_program_is_checked_without_a_file(toy_data: dict[str, Any]) -> None:
    with pytest.raises(InputError, match=r"scenario: jet_schedule\[0\]\.jet: 'J99' is no jet of vehicle 'toy'"):
        resolved({"vehicle": toy_data, "jet_schedule": [{"jet": "J99", "start_s": 0.0, "end_s": 1.0}]})


def test_a_scenario_of_a_program_has_its_vehicle_and_its_model() -> None:
    plant = {"kind": "multibody", "model": "servicer_slosh.sdf", "body": "bus"}
    made = Scenario(vehicle="servicer", duration_s=60.0, plant=plant)
    named = [f"{key}={value}" for key, value in {"vehicle": "servicer", "maneuver": "[]", "autopilot": "{}"}.items()]
    kept = {"name": "scenario", "description": ""}
    assert made == load_scenario("servicer_slosh", named).model_copy(update=kept)
    assert Scenario(vehicle="tracked_flyer").estimation.filter == "pose"


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"vehicle": "servicr"}, "'servicr' is neither a bundled vehicle nor a file; did you mean 'servicer'?"),
        (
            {"vehicle": "servicer", "failures": [{"jet": "YP3", "kind": "stuck_on", "start_s": 1.0}]},
            "'YP3' is no jet of vehicle 'servicer'; did you mean 'YP",
        ),
        (
            {"vehicle": "servicer", "plant": {"kind": "multibody", "model": "mine.sdf", "body": "bus"}},
            "plant.model: 'mine.sdf' is neither a bundled model nor the file mine.sdf",
        ),
    ],
)
def test_a_wrong_scenario_of_a_program_is_refused_where_it_is_made(fields: dict[str, Any], words: str) -> None:
    with pytest.raises(ValueError, match=re.escape(words)):
        Scenario(**fields)


def test_a_vehicle_without_accelerometers_can_be_flown(toy_data: dict[str, Any]) -> None:
    """Its mass is not observed, all else is."""
    del toy_data["accelerometers"]
    window = {"controller": "rhc", "axis": "+x", "start_s": 0.2, "end_s": 1.0}
    run = simulate(resolved({"vehicle": toy_data, "duration_s": 2.0, "maneuver": [window]}))
    assert np.isfinite(run["estimate"][:, :9]).all()
    assert np.isnan(run["estimate"][:, 9]).all()
    assert run.summary["estimates"]["mass_reciprocal"] is None
    assert run.summary["consistency"]["translation_nis_mean"] is None


def test_a_long_text_is_told_by_its_beginning() -> None:
    with pytest.raises(InputError, match=r"got 'x+\.\.\. \(3000 characters\)$") as told:
        load_scenario("sample_maneuver", [f"name={'x' * 3000}"])
    assert len(str(told.value)) < 250


def test_a_model_may_outlive_the_module_that_has_its_digest(monkeypatch: pytest.MonkeyPatch) -> None:
    # as at the end of a program, where a module's names go before the last objects do
    said: list[Any] = []
    scenario: Any = load_scenario("sample_maneuver")
    digest(scenario)
    monkeypatch.setattr(sys, "unraisablehook", said.append)
    monkeypatch.setattr(model, "_digests", None)
    del scenario
    gc.collect()
    assert said == []


@pytest.mark.parametrize(
    ("former", "overrides", "left"),
    [
        ({"kind": "multi_hypothesis", "trigger_jet": 28.0, "slots": 2}, ["kind=off"], {"kind": "off"}),
        ({"kind": "multi_hypothesis", "lead": 7.0}, ["kind=cusum", "drift=2.0"], {"kind": "cusum", "drift": 2.0}),
        ({"kind": "cglr", "threshold": 0.0}, ["kind=cusum"], {"kind": "cusum"}),  # means something else there
        ({"kind": "cglr", "margin": 7.0}, ["kind=off"], {"kind": "off", "margin": 7.0}),
        ({"kind": "cglr", "margin": 7.0}, ["drift=2.0", "kind=cusum"], {"kind": "cusum", "drift": 2.0}),
        ({"kind": "hypotheses", "trigger": 45.0}, ["kind=off"], {"kind": "off"}),
        ({"kind": "multi_hypothesis", "lead": 7.0}, ["kind=thrust_factors"], {"kind": "thrust_factors"}),
        ({"slots": 2}, ["kind=off"], {"kind": "off"}),
        ({"lead": 7.0}, ["kind=thrust_factors"], {"kind": "thrust_factors", "lead": 7.0}),
        ({"kind": "cglr", "margin": 7.0}, ["kind=hypotheses"], {"kind": "hypotheses"}),
    ],
)
def test_a_kind_that_is_set_takes_the_keys_of_the_former_one_along(
    former: dict[str, Any], overrides: list[str], left: dict[str, Any]
) -> None:
    data, given = {"detector": dict(former)}, set()
    for override in overrides:
        set_field(data, f"detector.{override}", given)
    assert data == {"detector": left}


def test_a_key_that_is_set_is_not_dropped_with_the_former_kind(tmp_path: Path) -> None:
    path = tmp_path / "scenario.yaml"
    path.write_text(
        yaml_text(resolved({"estimation": {"filter": "joint"}})),
        encoding="utf-8",
    )
    assert load_scenario(path, ["detector.kind=off"]).detector.kind == "off"
    with pytest.raises(InputError, match="drift: is a key of kind: cusum, and the kind is cglr"):
        load_scenario(path, ["detector.drift=2", "detector.kind=off"])


def test_what_kinds_have_in_common_stays_when_the_kind_is_set() -> None:
    data = {"failures": [{"kind": "leak", "jet": "R1U", "force": 3.0}]}
    set_field(data, "failures[0].kind=stuck_off")
    assert data == {"failures": [{"kind": "stuck_off", "jet": "R1U"}]}
