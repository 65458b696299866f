"""A star tracker beside gyro and accelerometer: nothing is worse with it, through every runner."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from pose_probe import again

from massprop_drake import InputError, Run, Scenario, load_vehicle, simulate
from massprop_drake.inputs.scenario import resolve_scenario
from massprop_drake.inputs.vehicle_file import Vehicle
from massprop_drake.inputs.vehicle_sensors import PoseSensor

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
    return resolve_scenario(data | more)


@pytest.fixture(scope="module")
def plain() -> Vehicle:
    return load_vehicle("small_satellite")


@pytest.fixture(scope="module")
def tracked(plain: Vehicle) -> Vehicle:
    return again(plain, poses=(TRACKER,))


@pytest.fixture(scope="module")
def flown(tracked: Vehicle) -> Run:
    return simulate(leaking(tracked, execution={"engine": "loop"}), look_back=False)


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
