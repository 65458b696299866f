"""The joint filter through every runner: the same bits, restarts, jittered and missing rows, and what it is worth."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from replay_probe import replayed

from massprop_drake import Estimator, InputError, Run, Scenario, estimate, load_scenario, simulate
from massprop_drake.runners.recorded import settings_alone

ACCELEROMETERS = ("acc1", "acc2", "acc3")
LOOP = "execution.engine=loop"  # the diagram's bits, sooner


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    return load_scenario("orbiter_maneuver", ["duration_s=14"])


@pytest.fixture(scope="module")
def flown(scenario: Scenario) -> Run:
    return simulate(scenario, look_back=False)


@pytest.fixture(scope="module")
def folder(flown: Run, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return flown.save(tmp_path_factory.mktemp("joint") / "run", pictures=False, report=False)


def stepped(dut: Estimator, run: Run, row: int) -> Any:
    readings = {name: run[name][row] for name in ACCELEROMETERS}
    return dut.step(run.time_s[row], run["gyro"][row], readings, run["command"][row])


def over(run: Run) -> int:
    """A row where the start has been gone over: before, a restart loses its samples."""
    return int(np.flatnonzero(run["tested"])[0]) + 5


def test_record_and_replay_diagram_give_the_bits_of_the_flight(flown: Run, folder: Path) -> None:
    found = estimate(folder / "telemetry.csv", load_scenario(folder))
    second = replayed(folder / "telemetry.csv", settings_alone(flown.scenario))
    for name, expected in second.signals.items():
        np.testing.assert_array_equal(found[name], expected, err_msg=name)
        np.testing.assert_array_equal(flown[name], expected, err_msg=name)
    assert {"estimate", "rotation_nis", "gyro_components", "accelerometer_components", "settled"} <= set(second.signals)
    np.testing.assert_array_equal(found.covariance, flown.covariance)
    assert found.state["states"] == flown.state["states"] == second.states
    samples = found.summary["data_quality"]["samples"]["rotation"]
    assert samples["used"] == flown["rotation_used"].sum() > 20
    assert samples["within_a_quantum"] > 20
    assert sum(samples.values()) == len(flown.time_s)


def test_the_estimator_gives_them_too_and_goes_on_after_a_restart(scenario: Scenario, flown: Run) -> None:
    dut = Estimator(scenario.vehicle_data, scenario)
    row_of_restart = over(flown)
    for row in range(len(flown.time_s)):
        step = stepped(dut, flown, row)
        np.testing.assert_array_equal(step.estimate, flown["estimate"][row])
        np.testing.assert_array_equal(step.standard_deviation, flown["standard_deviation"][row])
        assert step.used == bool(flown["rotation_used"][row, 0])
        if row == row_of_restart:
            kept = dut.state
            dut = Estimator(scenario.vehicle_data, scenario)
            dut.restore(kept)
    np.testing.assert_array_equal(dut.covariance, flown.covariance)


def test_a_state_of_the_other_filter_is_refused(scenario: Scenario) -> None:
    kept = Estimator(scenario.vehicle_data, load_scenario("sample_maneuver", ["detector.kind=off"])).state
    with pytest.raises(InputError, match=r"estimation\.filter was 'thesis' and is 'joint'"):
        Estimator(scenario.vehicle_data, scenario).restore(kept)


def test_an_edited_state_is_refused(scenario: Scenario, folder: Path, tmp_path: Path) -> None:
    dut = Estimator(scenario.vehicle_data, scenario)
    kept = dut.state
    kept["states"]["joint_estimator"][0][0] = None
    with pytest.raises(
        InputError, match="joint_estimator: only commands and readings may be missing; it was not written by a run"
    ):
        dut.restore(kept)


def _rows(folder: Path) -> list[list[str]]:
    with (folder / "telemetry.csv").open(encoding="utf-8") as file:
        return list(csv.reader(file))


def _written(path: Path, rows: list[list[str]]) -> Path:
    with path.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file).writerows(rows)
    return path


def test_estimating_goes_on_from_a_saved_state(flown: Run, folder: Path, tmp_path: Path) -> None:
    heading, *rows = _rows(folder)
    scenario, many = load_scenario(folder), over(flown)
    first = estimate(_written(tmp_path / "first.csv", [heading, *rows[:many]]), scenario)
    first.save(tmp_path / "first", pictures=False, report=False)
    rest = estimate(folder / "telemetry.csv", scenario, resume_from=tmp_path / "first")
    np.testing.assert_array_equal(rest["estimate"], flown["estimate"][many:])
    assert rest.state["states"] == flown.state["states"]


def test_missing_rows_and_cells_cost_little(flown: Run, folder: Path, tmp_path: Path) -> None:
    """A few rows and readings less; and a gap of seconds while nothing fires."""
    heading, *rows = _rows(folder)
    gyro = heading.index("gyro_x")
    for row in (30, 61):
        rows[row][gyro : gyro + 3] = ["", "", ""]
    rows = [row for number, row in enumerate(rows) if number not in (20, 45) and not 104 <= number <= 108]
    found = estimate(_written(tmp_path / "holes.csv", [heading, *rows]), load_scenario(folder))
    assert found.summary["data_quality"]["gaps"]["count"] == 3
    error = found["estimate"][-1] - flown["truth"][-1]
    assert (np.abs(error) < 4.0 * found["standard_deviation"][-1]).all()
    assert (found["standard_deviation"][-1, :3] < 3.0 * flown["standard_deviation"][-1, :3]).all()


def test_a_record_that_is_not_commanded_to_the_stamps_is_read_right(tmp_path: Path) -> None:
    """Readings up to 1 ms off their ticks, with their true stamps: consistent, and told."""
    scenario = load_scenario(
        "small_satellite_maneuver", ["estimation={filter: joint, start: nominal}", "mass={}", LOOP]
    )
    plain = ["estimation.filter=thesis", "detector.kind=off", "duration_s=30", LOOP]  # flies the same, sooner
    run = simulate(load_scenario("small_satellite_maneuver", plain), look_back=False)
    rng = np.random.default_rng(1)
    period = scenario.vehicle_data.sample_period_s
    off = rng.uniform(-0.001, 0.001, size=run.time_s.size)
    # what a linear change between samples makes of a reading taken a little off its tick
    readings = {}
    for name in ("gyro", "acc"):
        values = run[name]
        slopes = np.diff(values, axis=0) / period
        late, early = np.vstack([slopes, slopes[-1:]]), np.vstack([slopes[:1], slopes])
        readings[name] = values + off[:, None] * np.where(off[:, None] > 0.0, late, early)
    folder = run.save(tmp_path / "run", pictures=False, report=False)
    heading, *rows = _rows(folder)
    for number, row in enumerate(rows):
        row[0] = repr(float(row[0]) + float(off[number]))
        for name in ("gyro", "acc"):
            first = heading.index(f"{name}_x")
            row[first : first + 3] = map(repr, readings[name][number].tolist())
    found = estimate(_written(tmp_path / "jitter.csv", [heading, *rows]), scenario)
    error = (found["estimate"][-1] - run["truth"][-1]) / found["standard_deviation"][-1]
    assert np.abs(error).max() < 4.0
    assert any("off the sample period" in warning for warning in found.summary["data_quality"]["warnings"])


@pytest.fixture(scope="module")
def at_stamps(flown: Run, folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The flight's commands, given and read by one task that starts up to 2 ms early or late."""
    step_s, count = 2e-3, flown.time_s.size
    late = np.random.default_rng(3).integers(-1, 2, count)
    rows = np.round(flown.time_s / step_s).astype(int) + late
    rows[0], command, pulses = 0, np.array(flown["command"]), []
    for jet, name in enumerate(flown.scenario.vehicle_data.designations):
        edges = np.diff(np.concatenate(([0.0], command[:-1, jet], [0.0])))
        for begin, end in zip(np.flatnonzero(edges > 0.0), np.flatnonzero(edges < 0.0), strict=True):
            pulses.append({"jet": name, "start_s": float(rows[begin]) * step_s, "end_s": float(rows[end]) * step_s})
    plain = ["estimation={filter: thesis}", "joint={}", "mass={}", "detector.kind=off", "maneuver=[]", LOOP]
    fine = [f"jet_schedule={json.dumps(pulses)}", f"vehicle.sample_period_s={step_s}", "duration_s=14.1"]
    again = simulate(load_scenario("orbiter_maneuver", [*plain, *fine]), look_back=False)
    heading, *written = _rows(folder)
    for row, place in zip(written, np.minimum(rows, again.time_s.size - 1), strict=True):
        row[0] = repr(float(again.time_s[place]))
        for name in ("gyro", *ACCELEROMETERS):
            first = heading.index(f"{name}_x")
            row[first : first + 3] = map(repr, again[name][place].tolist())
    return _written(tmp_path_factory.mktemp("stamps") / "stamps.csv", [heading, *written])


def test_commands_that_switch_at_the_stamps_are_said_to_and_then_believed(
    at_stamps: Path, flown: Run, folder: Path
) -> None:
    scenario = load_scenario(folder)
    wrong = estimate(at_stamps, scenario).summary
    assert wrong["consistency"]["verdict"] == "inconsistent"
    assert "joint.switching=stamps" in wrong["consistency"]["reasons"][0]
    assert any("joint.switching=stamps" in each for each in wrong["data_quality"]["warnings"])
    right = estimate(at_stamps, load_scenario(folder, ["joint.switching=stamps"]))
    assert right.summary["consistency"]["verdict"] == "consistent"
    error = (right["estimate"][-1] - flown["truth"][-1]) / right["standard_deviation"][-1]
    assert np.abs(error).max() < 4.0


def test_outside_forces_that_are_known_are_taken_into_account(folder: Path, flown: Run, tmp_path: Path) -> None:
    heading, *rows = _rows(folder)
    heading += [f"known_force_{axis}" for axis in "xyz"] + [f"known_torque_{axis}" for axis in "xyz"]
    pushed = [[*row, "50", *["0"] * 5] for row in rows[:60]]
    found = estimate(_written(tmp_path / "pushed.csv", [heading, *pushed]), load_scenario(folder))
    assert np.abs(found["estimate"][59] - flown["estimate"][59]).max() > 0.0


def test_the_maneuver_is_estimated_consistently() -> None:
    """From zero: every parameter within its sigma, to a thousandth of a percent on the diagonal.

    NIS is on the scale 3 sum(e^2) / sum(1 - v), whose expectation is 3. Readings without noise are believed with care:
    the floor of a prediction and the half of a variance that a cell leaves make a sigma up to 1.3 times too large, and
    so NIS as little as 3 / 1.3^2. The mean of chi-square scatters by 3 sqrt(2 / sum(1 - v)), of which 4 are allowed.
    """
    run = simulate(load_scenario("orbiter_maneuver", ["duration_s=40", "seed=5", LOOP]), look_back=False)
    error = run["estimate"][-1] - run["truth"][-1]
    deviation = run["standard_deviation"][-1]
    assert (np.abs(error) < 4.0 * deviation).all()
    assert (np.abs(error[:3] / run["truth"][-1, :3]) < 5e-5).all()
    assert run["converged"][-1, 0] == 1.0
    assert run["settled"][-1, 0] == 1.0
    found = run.summary["consistency"]
    for filtered, components in (("rotation", "gyro_components"), ("translation", "accelerometer_components")):
        degrees = float(np.nansum(run[components]))
        scatter, mean = 4.0 * np.sqrt(2.0 / degrees), found[f"{filtered}_nis_mean"]
        assert degrees > 60.0
        assert 3.0 / 1.3**2 * (1.0 - scatter) < mean < 3.0 * (1.0 + scatter)


def test_pulses_without_attitude_control_are_estimated_consistently() -> None:
    """The vehicle drifts at rates that nobody holds while inertia is not known: increments must not be misled."""
    choice = ["estimation={filter: joint}", "joint={thrust_uncertainty: 0, tank_fraction: 0}", LOOP]
    run = simulate(load_scenario("jet_pulses", choice), look_back=False)
    error = run["estimate"][-1] - run["truth"][-1]
    assert (np.abs(error) < 4.0 * run["standard_deviation"][-1]).all()
    assert (np.abs(error[:3] / run["truth"][-1, :3]) < 5e-3).all()
