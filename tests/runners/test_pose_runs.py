"""The estimator in a fixed frame through every runner: the same bits, restarts, and every mix of sensors."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest
from pose_probe import again, told

from massprop_drake import (
    Estimator,
    InputError,
    Run,
    Scenario,
    load_scenario,
    load_vehicle,
    simulate,
)
from massprop_drake.inputs.scenario import resolve_scenario
from massprop_drake.inputs.vehicle_file import Vehicle
from massprop_drake.inputs.vehicle_sensors import Gyro, PoseSensor, VelocitySensor


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    return load_scenario("air_bearing_pulses", ["duration_s=12", "execution.engine=loop"])


@pytest.fixture(scope="module")
def flown(scenario: Scenario) -> Run:
    return simulate(scenario, look_back=False)


# ----------------------------------------------------------------------------------------- same bits


def test_the_jet_that_was_dead_is_named_and_no_other(flown: Run) -> None:
    named = [(entry.kind, entry.jets) for entry in flown.results.detections]
    assert named == [("jet_off", ("T2",))]
    assert flown.summary["unconfirmed"] == []


# ------------------------------------------------------------------------------------------ restarts


@pytest.mark.parametrize(
    ("system", "place", "value", "message"),
    [
        ("pose_estimator", 0, None, "only commands may be missing"),
        ("thrust_factor_detector", 0, 2.0, "must be 0 or 1"),
    ],
)
def test_a_state_that_no_run_leaves_is_refused(
    system: str, place: int, value: float | None, message: str, scenario: Scenario, flown: Run
) -> None:
    dut = Estimator(scenario.vehicle_data, scenario)
    state = json.loads(json.dumps(flown.state))
    state["states"][system][0][place] = value
    with pytest.raises(InputError, match=f"{system}: {message}; it was not written by a run"):
        dut.restore(state)
    dut.restore(flown.state)  # as it was


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


# --------------------------------------------------------------------------------------------- mixes

CAMERAS = {"position_std": 3e-4, "attitude_std": 2e-3}
GYRO = Gyro(name="gyro", quantum=7e-4, noise_std=7e-4)
SPEED = VelocitySensor(name="speed", noise_std=1e-3, position=(0.02, 0.0, 0.01))
MIXES: dict[str, dict[str, Any]] = {
    "gyro and pose": {"gyros": (GYRO,), "poses": (PoseSensor(name="cam", **CAMERAS),)},
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
    return resolve_scenario(
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
    run = simulate(_pulsed(_flyer(**MIXES[mix]), 180, execution={"engine": "loop"}), look_back=False)
    first, last = run["standard_deviation"][0], run["standard_deviation"][-1]
    error = (run["estimate"][-1] - run["truth"][-1]) / last
    # of 60 numbers one or two are beyond 2.5 sigma by chance, one beyond 4 in 200 such runs
    assert np.abs(error).max() < 4.0, error.round(2)
    assert (last[:3] < 0.5 * first[:3]).all()
    if mix != "star tracker":  # which sees no force
        assert last[9] < 0.5 * first[9]
    else:
        assert last[9] == first[9]
