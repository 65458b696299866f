"""The estimator in a fixed frame through every runner: the same bits, restarts, and every mix of sensors."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from pose_probe import again, told
from replay_probe import replayed

from massprop_drake import (
    Estimator,
    EstimatorStep,
    InputError,
    Run,
    Scenario,
    estimate,
    load_scenario,
    load_vehicle,
    simulate,
)
from massprop_drake.inputs.scenario import resolved
from massprop_drake.inputs.vehicle_file import Vehicle
from massprop_drake.inputs.vehicle_sensors import Accelerometer, Gyro, PoseSensor, VelocitySensor
from massprop_drake.runners.recorded import settings_alone


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    return load_scenario("air_bearing_pulses", ["duration_s=12"])


@pytest.fixture(scope="module")
def flown(scenario: Scenario) -> Run:
    return simulate(scenario)


@pytest.fixture(scope="module")
def folder(flown: Run, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return flown.save(tmp_path_factory.mktemp("pose") / "run", pictures=False, report=False)


def stepped(dut: Estimator, run: Run, row: int, name: str = "mocap") -> EstimatorStep:
    return dut.step(run.time_s[row], None, None, run["command"][row], tracked={name: run[name][row]})


RESTARTS = (0, 1, 12, 70)  # after so many rows
AFTER = 20  # rows, 1.3 s: longer than commands act


class Stepped(NamedTuple):
    """An estimator that has read the flight row by row, what it said, and its states at the restarts, as JSON."""

    scenario: Scenario
    dut: Estimator
    steps: list[EstimatorStep]
    states: dict[int, str]


@pytest.fixture(scope="module", params=["off", "thrust_factors"])
def whole(request: pytest.FixtureRequest, flown: Run) -> Stepped:
    """By the detector; with one to the end of the flight, without only as far as restarts are looked at."""
    scenario = load_scenario("air_bearing_pulses", ["duration_s=12", f"detector={{kind: {request.param}}}"])
    found = Stepped(scenario, Estimator(scenario.vehicle_data, scenario), [], {})
    for row in range(RESTARTS[-1] + AFTER if request.param == "off" else len(flown.time_s)):
        if row in RESTARTS:
            found.states[row] = json.dumps(found.dut.state)
        found.steps.append(stepped(found.dut, flown, row))
    return found


# ----------------------------------------------------------------------------------------- same bits


def test_record_and_replay_diagram_give_the_bits_of_the_flight(flown: Run, folder: Path) -> None:
    found = estimate(folder / "telemetry.csv", load_scenario(folder))
    second = replayed(folder / "telemetry.csv", settings_alone(flown.scenario))
    for name, expected in second.signals.items():
        # a record does not have the last command, which acts at once where the delay may be negative
        np.testing.assert_array_equal(flown[name][:-1], expected[:-1], err_msg=name)
        np.testing.assert_array_equal(found[name], expected, err_msg=name)
    off = found["estimate"][-1] - flown["estimate"][-1]
    assert np.nanmax(np.abs(off) / flown["standard_deviation"][-1]) < 1e-3
    assert {"thrust_factor", "position_estimate", "verdict", "kick"} <= set(second.signals)
    assert found.state["states"] == second.states
    assert found.results.detections == flown.results.detections


def test_the_jet_that_was_dead_is_named_and_no_other(flown: Run) -> None:
    named = [(entry.kind, entry.jets) for entry in flown.results.detections]
    assert named == [("jet_off", ("T2",))]
    assert flown.summary["unconfirmed"] == []


@pytest.mark.parametrize("whole", ["thrust_factors"], indirect=True)
def test_the_estimator_gives_the_bits_of_estimate(whole: Stepped, flown: Run) -> None:
    said = []
    for row, step in enumerate(whole.steps):
        np.testing.assert_array_equal(step.estimate, flown["estimate"][row])
        np.testing.assert_array_equal(step.standard_deviation, flown["standard_deviation"][row])
        assert step.alarm == bool(flown["alarm"][row, 0])
        if step.detection is not None:
            said.append(step)
    assert [step.detection.jets for step in said if step.detection is not None] == [("T2",)]
    np.testing.assert_array_equal(np.flatnonzero(whole.dut.step(20.0, None, None, np.zeros(8)).removed), [1])
    assert said[0].time_s == flown.results.detections[0].time_s


def test_the_telemetry_of_the_run_has_all_that_was_read(flown: Run, folder: Path) -> None:
    heading = (folder / "telemetry.csv").read_text(encoding="utf-8").splitlines()[0].split(",")
    assert heading[1:8] == ["mocap_x", "mocap_y", "mocap_z", "mocap_qw", "mocap_qx", "mocap_qy", "mocap_qz"]
    assert heading[8:] == [f"jet_T{jet}" for jet in range(1, 9)]
    table = np.genfromtxt(folder / "telemetry.csv", delimiter=",", skip_header=1)
    np.testing.assert_array_equal(table[:, 1:8], flown["mocap"])
    np.testing.assert_array_equal(table[:-1, 8:], flown["command"][:-1])


# ------------------------------------------------------------------------------------------ restarts


@pytest.mark.parametrize("rows", RESTARTS)
def test_an_estimator_goes_on_after_a_restart_to_the_bit(whole: Stepped, flown: Run, rows: int) -> None:
    """Commands that still act are kept, and hypotheses that are not decided."""
    other = Estimator(whole.scenario.vehicle_data, whole.scenario)
    other.restore(json.loads(whole.states[rows]))
    for row in range(rows, rows + AFTER):
        one, two = whole.steps[row], stepped(other, flown, row)
        np.testing.assert_array_equal(two.estimate, one.estimate)
        np.testing.assert_array_equal(two.standard_deviation, one.standard_deviation)
        assert two.alarm == one.alarm
        assert two.detection == one.detection


def test_what_was_named_stays_known_after_a_restart(scenario: Scenario, flown: Run, folder: Path) -> None:
    state = json.loads((folder / "filter_state.json").read_text(encoding="utf-8"))
    dut = Estimator(scenario.vehicle_data, scenario)
    dut.restore(state)
    step = dut.step(flown.time_s[-1] + 0.0632, None, None, np.zeros(8))
    np.testing.assert_array_equal(np.flatnonzero(step.removed), [1])
    np.testing.assert_allclose(dut.covariance, flown.covariance, rtol=1e-2)


@pytest.mark.parametrize(
    ("part", "place", "value", "message"),
    [
        ("mean", 0, None, "only commands may be missing"),
        ("known", 1, 0.5, "known must be 0 or 1, and opens a jet's index"),
        ("opens", 0, 8.0, "known must be 0 or 1, and opens a jet's index"),
        ("opens", 0, 0.5, "known must be 0 or 1, and opens a jet's index"),
        ("covariance", 0, -1.0, "the covariance must be symmetric, and no variance negative"),
        ("covariance", 1, 0.5, "the covariance must be symmetric, and no variance negative"),
        ("rotation", 0, 3.0, "rotation must be a rotation matrix"),
        ("level", 2, 1.5, "commands must be fractions of 0 to 1"),
        ("started", 0, 0.3, "started must be 0 or 1"),
    ],
)
def test_a_state_that_no_run_leaves_is_refused(
    part: str, place: int, value: float | None, message: str, scenario: Scenario, flown: Run
) -> None:
    dut = Estimator(scenario.vehicle_data, scenario)
    state = json.loads(json.dumps(flown.state))
    params = dut._params.filter_params
    jets, size, free = 8, params.pose.parts.size, params.pose.free.size
    sizes = {"mean": size, "covariance": free**2, "rotation": 9, "opens": 1, "reference": 3, "turned": 9}
    sizes |= {"known": 1 + 2 * jets, "level": jets, "time_s": 1, "started": 1}
    begin = sum(list(sizes.values())[: list(sizes).index(part)])
    state["states"]["pose_estimator"][0][begin + place] = value
    with pytest.raises(InputError, match=f"pose_estimator: {message}; it was not written by a run"):
        dut.restore(state)
    dut.restore(flown.state)  # as it was


def test_a_detectors_state_that_no_run_leaves_is_refused(scenario: Scenario, flown: Run) -> None:
    state = json.loads(json.dumps(flown.state))
    state["states"]["thrust_factor_detector"][0][0] = 2.0
    with pytest.raises(InputError, match="thrust_factor_detector: must be 0 or 1; it was not written by a run"):
        Estimator(scenario.vehicle_data, scenario).restore(state)


@pytest.mark.parametrize(
    ("place", "value", "message"),
    [
        (0, 0.5, "hypotheses must be counted by whole numbers"),
        (0, 3000.0, "hypotheses are cut short"),
        (2, 99.0, "commands must be in order of time"),
    ],
)
def test_hypotheses_that_no_run_leaves_are_refused(
    place: int, value: float, message: str, scenario: Scenario, flown: Run
) -> None:
    dut = Estimator(scenario.vehicle_data, scenario)
    state = json.loads(json.dumps(flown.state))
    params = dut._params.filter_params
    header = params.pose.parts.size + params.pose.free.size**2 + 9 + 1 + 3 + 9 + 17 + 8 + 2
    state["states"]["pose_estimator"][0][header + place] = value
    with pytest.raises(InputError, match=f"pose_estimator: {message}; it was not written by a run"):
        dut.restore(state)


# ------------------------------------------------------------------------------------ outside forces


@pytest.mark.parametrize("whole", ["thrust_factors"], indirect=True)
def test_a_known_outside_force_is_no_slope_and_no_jet(whole: Stepped, flown: Run) -> None:
    """0.3 N along x through the center of mass from 4.4 s on, two thirds of a jet; before, the flight as it was."""
    begin = RESTARTS[-1]
    outside = np.zeros((len(flown.time_s), 6))
    truth, force = flown["truth"][0], np.array([0.3, 0.0, 0.0])
    outside[begin:] = np.concatenate((np.cross(truth[6:9], force), force))
    pushed = _with_force(flown, outside, truth)
    ends = []
    for known in (True, False):
        dut = Estimator(whole.scenario.vehicle_data, whole.scenario)
        dut.restore(json.loads(whole.states[begin]))
        said = []
        for row in range(begin, len(flown.time_s)):
            step = dut.step(
                flown.time_s[row],
                None,
                None,
                flown["command"][row],
                outside_wrench=outside[row] if known else None,
                tracked={"mocap": pushed[row]},
            )
            if step.detection is not None:
                said.append((step.detection.kind, step.detection.jets))
        ends.append(((step.estimate - truth)[9] / step.standard_deviation[9], said))
    assert abs(ends[0][0]) < 3.0
    assert ends[0][1] == [("jet", ("T2",))]
    assert ends[1][1] != ends[0][1]  # what is not known is taken for something else


def _with_force(run: Run, outside: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Poses of the run with what a force through the center of mass adds, shape (rows, 7)."""
    period = run.time_s[1] - run.time_s[0]
    poses, speed, moved = run["mocap"].copy(), np.zeros(2), np.zeros(2)
    for row in range(1, len(poses)):
        heading = 2.0 * np.arctan2(poses[row - 1, 6], poses[row - 1, 3])
        x, y = outside[row - 1, 3:5] * truth[9]
        cosine, sine = np.cos(heading), np.sin(heading)
        gained = np.array([cosine * x - sine * y, sine * x + cosine * y])
        moved = moved + period * speed + 0.5 * period**2 * gained
        speed = speed + period * gained
        poses[row, :2] += moved
    return poses


# --------------------------------------------------------------------------------------- step by step


def test_what_a_step_is_given_is_checked(scenario: Scenario) -> None:
    dut = Estimator(scenario.vehicle_data, scenario)
    off = np.zeros(8)
    with pytest.raises(ValueError, match=r"tracked: 'cam' is no sensor in a fixed frame; the vehicle has \['mocap'\]"):
        dut.step(0.0, None, None, off, tracked={"cam": np.zeros(7)})
    with pytest.raises(ValueError, match=r"mocap must have shape \(7,\), got \(3,\)"):
        dut.step(0.0, None, None, off, tracked={"mocap": np.zeros(3)})
    with pytest.raises(ValueError, match="gyro: the vehicle has none; give None"):
        dut.step(0.0, np.zeros(3), None, off)
    step = dut.step(0.0, None, None, off)
    np.testing.assert_allclose(step.estimate[9], 1.0 / 23.09)
    with pytest.raises(ValueError, match="time must go forward"):
        dut.step(0.0, None, None, off)


def test_nothing_begins_before_position_and_attitude_have_been_read(scenario: Scenario, flown: Run) -> None:
    dut = Estimator(scenario.vehicle_data, scenario)
    blind = flown["mocap"][0].copy()
    blind[3:] = np.nan
    first = dut.step(0.0, None, None, np.zeros(8), tracked={"mocap": blind})
    for row in range(1, 30):
        last = stepped(dut, flown, row)
    assert not first.used
    assert last.used
    assert last.standard_deviation[9] < first.standard_deviation[9]


def test_rows_at_any_time_and_a_quaternion_of_any_length_are_taken(scenario: Scenario, flown: Run) -> None:
    one, other = (Estimator(scenario.vehicle_data, scenario) for _ in range(2))
    for row in range(0, 60, 3):
        first = stepped(one, flown, row)
        doubled = flown["mocap"][row] * [1, 1, 1, -2, -2, -2, -2]
        second = other.step(flown.time_s[row], None, None, flown["command"][row], tracked={"mocap": doubled})
        np.testing.assert_allclose(second.estimate, first.estimate, rtol=1e-9)


# --------------------------------------------------------------------------------------------- mixes

CAMERAS = {"position_std": 3e-4, "attitude_std": 2e-3}
GYRO = Gyro(name="gyro", quantum=7e-4, noise_std=7e-4)
ACCELEROMETER = Accelerometer(name="acc", position=(0.05, 0.03, -0.03), quantum=1e-4, noise_std=2e-4)
SPEED = VelocitySensor(name="speed", noise_std=1e-3, position=(0.02, 0.0, 0.01))
MIXES: dict[str, dict[str, Any]] = {
    "pose": {"poses": (PoseSensor(name="cam", **CAMERAS, point=(0.03, 0.0, 0.02), point_std=0.002),)},
    "gyro and pose": {"gyros": (GYRO,), "poses": (PoseSensor(name="cam", **CAMERAS),)},
    "accelerometer and pose": {"accelerometers": (ACCELEROMETER,), "poses": (PoseSensor(name="cam", **CAMERAS),)},
    "star tracker": {"poses": (PoseSensor(name="stars", attitude_std=1e-3),)},
    "velocity and attitude": {"velocities": (SPEED,), "poses": (PoseSensor(name="stars", attitude_std=1e-3),)},
    "two cameras": {
        "poses": (
            PoseSensor(name="one", position_std=5e-4),
            PoseSensor(name="two", attitude_std=2e-3, position_std=1e-3),
        )
    },
}


def _flyer(**sensors: Any) -> Vehicle:
    vehicle = load_vehicle("tracked_flyer")
    kind = {"command_delay_s": 0.0, "command_delay_std_s": 0.01, "repeatability": 0.0}
    kinds = {"cold_gas": vehicle.jet_kinds["cold_gas"].model_copy(update=kind)}
    return again(vehicle, jet_kinds=kinds, **({"poses": (), "gyros": ()} | sensors))


def _pulsed(vehicle: Vehicle, rows: int, **more: Any) -> Scenario:
    """Pulses of all jets; true mass properties and thrusts as they may be."""
    commands, period = told(vehicle, rows, seed=4), vehicle.sample_period_s
    pulses = []
    for jet, name in enumerate(vehicle.designations):
        edges = np.flatnonzero(np.diff(commands[:, jet], prepend=0.0, append=0.0))
        for begin, end in edges.reshape(-1, 2).tolist():
            pulses.append({"jet": name, "start_s": begin * period, "end_s": end * period})
    true = {"mass": 4.5, "center_of_mass": [0.002, -0.003, 0.001]}
    true["inertia"] = [[0.025, 0.0005, 0.0], [0.0005, 0.021, -0.0004], [0.0, -0.0004, 0.023]]
    plant = {"thrust_dispersion": 0.03, "mass_properties": true}
    return resolved(
        {
            "name": "mix",
            "vehicle": vehicle,
            "seed": 2,
            "duration_s": rows * period,
            "jet_schedule": pulses,
            "plant": plant,
        }
        | {"detector": {"kind": "off"}}
        | more
    )


@pytest.mark.parametrize("mix", MIXES)
def test_every_mix_of_sensors_keeps_its_sigmas(mix: str) -> None:
    run = simulate(_pulsed(_flyer(**MIXES[mix]), 180))
    first, last = run["standard_deviation"][0], run["standard_deviation"][-1]
    error = (run["estimate"][-1] - run["truth"][-1]) / last
    # of 60 numbers one or two are beyond 2.5 sigma by chance, one beyond 4 in 200 such runs
    assert np.abs(error).max() < 4.0, error.round(2)
    assert (last[:3] < 0.5 * first[:3]).all()
    if mix != "star tracker":  # which sees no force
        assert last[9] < 0.5 * first[9]
    else:
        assert last[9] == first[9]


def test_a_mix_runs_by_record_and_by_the_diagram_alike(tmp_path: Path) -> None:
    scenario = _pulsed(_flyer(gyros=(GYRO,), accelerometers=(ACCELEROMETER,), velocities=(SPEED,),
                              poses=(PoseSensor(name="cam", **CAMERAS),)), 60)  # fmt: skip
    run = simulate(scenario)
    folder = run.save(tmp_path / "run", pictures=False, report=False)
    found = estimate(folder / "telemetry.csv", load_scenario(folder))
    for name in ("estimate", "standard_deviation", "rotation_nis", "mass_nis", "speed", "cam", "acc"):
        np.testing.assert_array_equal(found[name][:-1], run[name][:-1], err_msg=name)
