"""The joint filter through every runner: the same bits, restarts, jittered and missing rows, and what it is worth."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from massprop_drake import Run, Scenario, estimate, load_scenario, simulate

ACCELEROMETERS = ("acc1", "acc2", "acc3")
LOOP = "execution.engine=loop"  # the diagram's bits, sooner


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    return load_scenario("orbiter_maneuver", ["duration_s=11", LOOP])


@pytest.fixture(scope="module")
def flown(scenario: Scenario) -> Run:
    return simulate(scenario, look_back=False)


@pytest.fixture(scope="module")
def folder(flown: Run, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return flown.save(tmp_path_factory.mktemp("joint") / "run", pictures=False, report=False)


def over(run: Run) -> int:
    """A row where the start has been gone over: before, a restart loses its samples."""
    return int(np.flatnonzero(run["tested"])[0]) + 5


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
    fine = [f"jet_schedule={json.dumps(pulses)}", f"vehicle.sample_period_s={step_s}", "duration_s=11.1"]
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
