"""A star tracker beside gyro and accelerometer: nothing is worse with it, through every runner."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pose_probe import again

from massprop_drake import Estimator, InputError, Run, Scenario, estimate, load_scenario, load_vehicle, simulate
from massprop_drake.inputs.scenario import resolved
from massprop_drake.inputs.vehicle_file import Vehicle
from massprop_drake.inputs.vehicle_sensors import PoseSensor
from massprop_drake.runners.recorded import settings_alone

TRACKER = PoseSensor(name="st", attitude_std=5e-5)
_TURNS = [("+x", 0.5), ("-x", 1.5), ("+y", 2.5), ("-y", 3.5), ("+z", 4.5), ("-z", 5.5)]
_MOVES = [("+x", 6.5), ("+y", 7.5), ("+z", 8.5), ("-x", 9.5)]
LEAKS_S = 12.0


def leaking(vehicle: Vehicle, **more: Any) -> Scenario:
    """Ten seconds of turns and translations, then a leak of 5 % while nothing is commanded."""
    maneuver = [
        {"controller": controller, "axis": axis, "start_s": start_s, "end_s": start_s + 1.0}
        for controller, windows in (("rhc", _TURNS), ("thc", _MOVES))
        for axis, start_s in windows
    ]
    inertia = [[100.0, -1.0, 2.0], [-1.0, 125.0, -0.5], [2.0, -0.5, 150.0]]
    properties = {"mass": 520.0, "center_of_mass": [0.06, 0.01, -0.03], "inertia": inertia}
    data: dict[str, Any] = {
        "name": "leaking",
        "vehicle": vehicle,
        "duration_s": 13.0,
        "seed": 1,
        "maneuver": maneuver,
        "plant": {"mass_properties": properties},
        "failures": [{"kind": "leak", "jet": "YN1", "start_s": LEAKS_S, "force": 0.25}],
    }
    return resolved(data | more)


@pytest.fixture(scope="module")
def plain() -> Vehicle:
    return load_vehicle("small_satellite")


@pytest.fixture(scope="module")
def tracked(plain: Vehicle) -> Vehicle:
    return again(plain, poses=(TRACKER,))


@pytest.fixture(scope="module")
def flown(tracked: Vehicle) -> Run:
    return simulate(leaking(tracked), look_back=False)


@pytest.fixture(scope="module")
def folder(flown: Run, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return flown.save(tmp_path_factory.mktemp("star") / "run", pictures=False, report=False)


def test_a_tracker_makes_nothing_worse(flown: Run, plain: Vehicle) -> None:
    """Every 1-sigma is as small, errors are within it, and the leak is named as soon."""
    without = simulate(leaking(plain, execution={"engine": "loop"}), look_back=False)
    for row in (60, 100, 119, -1):
        assert (flown["standard_deviation"][row] <= 1.001 * without["standard_deviation"][row]).all()
    error = flown["estimate"][-1] - flown["truth"][-1][:10]
    assert (np.abs(error) < 3.0 * flown["standard_deviation"][-1]).all()
    (found,), (plainly,) = flown.summary["detections"], without.summary["detections"]
    assert found["jet"] == plainly["jet"] == "YN1"
    assert found["time_s"] <= plainly["time_s"] <= LEAKS_S + 1.0
    assert found["magnitude"] == pytest.approx(0.25, abs=3.0 * found["magnitude_std"])


def test_record_loop_and_diagram_give_the_bits_of_the_flight(flown: Run, folder: Path, tracked: Vehicle) -> None:
    found = estimate(folder / "telemetry.csv", load_scenario(folder))
    loop = simulate(leaking(tracked, execution={"engine": "loop"}), look_back=False)
    for name in ("estimate", "standard_deviation", "rotation_nis", "fault_probability", "st"):
        np.testing.assert_array_equal(found[name], flown[name], err_msg=name)
        np.testing.assert_array_equal(loop[name], flown[name], err_msg=name)
    assert found.state["states"] == flown.state["states"] == loop.state["states"]


def test_an_estimator_goes_on_from_its_state_with_a_tracker_that_reads_now_and_then(flown: Run) -> None:
    """Rows of the tracker are empty between its readings; what is kept holds the attitude that is shared."""
    first, second = (Estimator(flown.scenario.vehicle_data, flown.scenario) for _ in range(2))

    def step(dut: Estimator, row: int) -> Any:
        seen = {"st": flown["st"][row]} if row % 3 == 0 else None
        return dut.step(flown.time_s[row], flown["gyro"][row], flown["acc"][row], flown["command"][row], tracked=seen)

    last: Any = None
    for row in range(100):
        last = step(first, row)
    second.restore(first.state)
    for row in range(100, 108):
        one, other = step(first, row), step(second, row)
        np.testing.assert_allclose(other.estimate, one.estimate, rtol=1e-9)
    every = flown["standard_deviation"][99]
    assert (last.standard_deviation >= 0.999 * every).all()
    broken = first.state
    states = dict(broken["states"])
    states["joint_estimator"] = [[*states["joint_estimator"][0][:-1], 7.0]]
    with pytest.raises(InputError, match="shared attitude must be a unit quaternion"):
        second.restore({**broken, "states": states})


def test_a_tracker_that_never_reads_changes_nothing(flown: Run, folder: Path, plain: Vehicle, tmp_path: Path) -> None:
    with (folder / "telemetry.csv").open(newline="") as file:
        rows = list(csv.reader(file))
    kept = [place for place, name in enumerate(rows[0]) if not name.startswith("st_")]
    path = tmp_path / "without.csv"
    with path.open("w", newline="") as file:
        csv.writer(file).writerows([[row[place] for place in kept] for row in rows[:80]])
    blind = estimate(path, settings_alone(flown.scenario))
    without = estimate(path, settings_alone(leaking(plain)))
    np.testing.assert_allclose(blind["estimate"], without["estimate"], rtol=1e-6)
    np.testing.assert_allclose(blind["standard_deviation"], without["standard_deviation"], rtol=1e-6)


def test_poor_readings_are_told_from_good_ones(plain: Vehicle) -> None:
    """One reading in twenty ten times as noisy costs next to nothing, and nothing false is said."""
    poor = again(plain, poses=(PoseSensor(name="st", attitude_std=5e-5, outliers=0.05, time_std_s=1e-3),))
    run = simulate(leaking(poor, failures=[], duration_s=12.0, execution={"engine": "loop"}), look_back=False)
    assert run.summary["detections"] == []
    error = run["estimate"][-1] - run["truth"][-1][:10]
    assert (np.abs(error) < 3.5 * run["standard_deviation"][-1]).all()


def test_which_filter_a_vehicle_goes_to(plain: Vehicle, tracked: Vehicle) -> None:
    located = again(plain, poses=(PoseSensor(name="cam", attitude_std=1e-3, position_std=1e-3),))
    for vehicle, expected in ((plain, "joint"), (tracked, "joint"), (located, "pose")):
        assert leaking(vehicle).estimation.filter == expected
    assert leaking(tracked, estimation={"filter": "pose"}).estimation.filter == "pose"
    assert leaking(tracked, estimation={"filter": "thesis"}).estimation.filter == "thesis"
    with pytest.raises(InputError, match="joint does not go with vehicle"):
        leaking(located, estimation={"filter": "joint"})
