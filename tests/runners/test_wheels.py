"""A satellite on reaction wheels: an absolute scale, speeds that are missing or false, trackers, no accelerometer."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from massprop_drake import Estimator, Run, simulate
from massprop_drake.inputs.scenario import Scenario
from massprop_drake.inputs.vehicle_file import load_vehicle

Array = NDArray[np.float64]
HALF = 0.5**0.5
AXES = {"W1": [HALF, 0.0, HALF], "W2": [-HALF, 0.0, HALF], "W3": [0.0, HALF, HALF], "W4": [0.0, -HALF, HALF]}
FALSE_S = 14.0  # from when on something reads falsely


def scenario(seed: int, failures: tuple[dict[str, Any], ...] = (), **changed: Any) -> Scenario:
    """The servicer with four wheels of 0.5 %, thrusts of 2 %, pulses of jets and torques of wheels."""
    random, vehicle = np.random.default_rng(seed), load_vehicle("servicer").model_dump()
    for jet in vehicle["jets"]:
        jet.pop("mass_flow", None)
    for kind in vehicle["jet_kinds"].values():
        kind["thrust_uncertainty"] = 0.02
    own = {"inertia": 0.005, "inertia_uncertainty": 0.005, "quantum": 0.01, "torque": 0.1}
    vehicle["wheels"] = [{"name": name, "axis": axis, **own} for name, axis in AXES.items()]
    vehicle["poses"] = [{"name": "stars", "attitude_std": 1e-4}]
    small = [jet["designation"] for jet in vehicle["jets"] if jet["kind"] == "attitude"]
    jets, wheels = list[dict[str, Any]](), list[dict[str, Any]]()
    for begin in range(1, 20):
        for jet in random.choice(small, 2, replace=False).tolist():
            jets.append({"jet": jet, "start_s": float(begin), "end_s": begin + float(random.choice([0.2, 0.4]))})
    for name in AXES:
        for begin in range(0, 18, 3):
            torque = float(random.uniform(-0.08, 0.08))
            wheels.append({"wheel": name, "start_s": begin + 0.5, "end_s": begin + 3.0, "torque": torque})
    spread = {"mass_percent": 8.0, "center_of_mass": 0.02, "second_moments_percent": 8.0}
    plant = {
        "dispersion": spread,
        "thrust_dispersion": 0.02,
        "wheel_dispersion": 0.005,
        "wheel_speeds": dict(zip(AXES, random.uniform(-150.0, 150.0, 4).tolist(), strict=True)),
    }
    made = {"vehicle": vehicle | changed, "duration_s": 20.0, "seed": seed, "plant": plant, "failures": failures}
    return Scenario.model_validate({**made, "jet_schedule": jets, "wheel_schedule": wheels})


@cache
def flown(seed: int) -> Run:
    """A healthy flight, of which nothing is looked back on."""
    return simulate(scenario(seed), look_back=False)


def followed(run: Run, change: Callable[[int, dict[str, Array]], None]) -> tuple[Array, list[Any]]:
    """Errors of the ten parameters in their sigma at the end, and what is said, of readings that are changed."""
    estimator, said = Estimator(run.scenario.vehicle_data, run.scenario), []
    for row, time_s in enumerate(run.time_s.tolist()):
        tracked = {name: run[name][row].copy() for name in (*AXES, "stars")}
        change(row, tracked)
        told = estimator.step(time_s, run["gyro"][row], run["acc"][row], run["command"][row], tracked=tracked)
        if told.detection is not None:
            said.append(told.detection)
    return (told.estimate - run["truth"][-1]) / told.standard_deviation, said


def test_wheels_give_the_scale_that_thrusts_do_not() -> None:
    """Inertia and mass are known to the wheels' 0.5 % / 4^1/2 where every thrust is off by 2 %."""
    run = flown(1)
    relative = (run["standard_deviation"][-1] / np.abs(run["truth"][-1]))[[0, 1, 2, 9]]
    assert (relative < 0.0035).all()
    errors = (run["estimate"][-1] - run["truth"][-1]) / run["standard_deviation"][-1]
    assert np.abs(errors).max() < 3.5


def test_a_false_speed_is_named_and_no_jet() -> None:
    """Leave a wheel whose speed stands still from a time on out of the estimation."""
    stands = list[float]()

    def false(row: int, tracked: dict[str, Array]) -> None:
        if row * 0.1 >= FALSE_S:
            stands.append(float(tracked["W3"][0]))
            tracked["W3"][:] = stands[0]

    errors, said = followed(flown(1), false)
    assert [(one.kind, one.sensor, one.axis) for one in said] == [("false_reading", "W3", "speed")]
    assert np.abs(errors).max() < 3.5


def test_a_tracker_that_takes_other_stars_for_its_own_turns_nothing() -> None:
    turn = np.array([np.cos(0.01), 0.6 * np.sin(0.01), 0.0, 0.8 * np.sin(0.01)])

    def jumped(row: int, tracked: dict[str, Array]) -> None:
        if row * 0.1 >= FALSE_S:
            tracked["stars"][3:] = product(turn, tracked["stars"][3:])

    errors, said = followed(flown(1), jumped)
    assert {(one.kind, one.sensor) for one in said} == {("false_reading", "stars")}
    assert np.abs(errors).max() < 3.5


def product(left: Array, right: Array) -> Array:
    """Product of two quaternions, scalar first."""
    vector = left[0] * right[1:] + right[0] * left[1:] + np.cross(left[1:], right[1:])
    return np.concatenate(([left[0] * right[0] - left[1:] @ right[1:]], vector))


def test_a_leak_is_named_by_rotation_alone() -> None:
    """Name a leak from gyros alone, on a vehicle without an accelerometer; its mass is not observable."""
    leak = {"kind": "leak", "jet": "YP2", "start_s": 12.0, "force": 0.05}
    run = simulate(scenario(2, (leak,), accelerometers=[]), look_back=False)
    (found,) = run.summary["detections"]
    assert (found["jet"], found["withdrawn_s"]) == ("YP2", None)
    assert found["time_s"] < 14.0
    assert found["magnitude"] == pytest.approx(0.05, abs=0.01)
    assert np.isnan(run["estimate"][-1, 9])
    assert np.abs((run["estimate"][-1] - run["truth"][-1]) / run["standard_deviation"][-1])[:9].max() < 3.5
