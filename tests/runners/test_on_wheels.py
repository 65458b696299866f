"""A servicer on four wheels: attitude held, momentum taken off by jets, and estimates beside it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from pose_probe import again
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import LogVectorOutput

from massprop_drake import Scenario, load_vehicle
from massprop_drake.diagrams import autopilot, vehicle
from massprop_drake.inputs.scenario import resolve_scenario
from massprop_drake.inputs.vehicle_file import Vehicle
from massprop_drake.inputs.vehicle_sensors import Wheel

PYRAMID = [[0.57735, 0.57735, 0.57735], [0.57735, -0.57735, 0.57735], [0.57735, -0.57735, -0.57735]]
PYRAMID += [[0.57735, 0.57735, -0.57735]]
DEADBAND, HOLD_GAIN = 0.0005, 0.25  # rad/s, 1/s
PUSHED = {"torque": [0.006, -0.004, 0.005]}  # N-m


def on_wheels(count: int = 4, **changed: Any) -> Vehicle:
    stated = load_vehicle("servicer")
    wheel = {"inertia": 0.006, "inertia_uncertainty": 0.005, "quantum": 0.05, "torque": 0.1, "speed_limit": 400.0}
    wheels = tuple(Wheel(name=f"RW{one}", axis=PYRAMID[one], **(wheel | changed)) for one in range(count))
    valve = {"minimum_on_time_s": 0.01, "on_time_quantum_s": 0.001}
    kinds = {name: kind.model_copy(update=valve) for name, kind in stated.jet_kinds.items()}
    return again(stated, wheels=wheels, jet_kinds=kinds)


def flight(**more: Any) -> Scenario:
    pilot = {
        "jet_kinds": ["attitude"],
        "hold_gain": HOLD_GAIN,
        "rate_deadband": DEADBAND,
        "capture_rate": 0.001,
        "discrete_rate": 0.005,
        "jet_selection": {"output": "on_time"},
        "wheels": {"unload_above": 0.5, "unload_below": 0.2},
    }
    start = {"RW0": 220.0, "RW1": -100.0, "RW2": 60.0, "RW3": -30.0}
    plant = {"disturbance": PUSHED, "wheel_speeds": start}
    own = {"name": "on_wheels", "vehicle": on_wheels(), "duration_s": 40.0, "detector": {"kind": "off"}}
    return resolve_scenario(own | {"autopilot": pilot, "plant": plant} | more)


def flown(scenario: Scenario, *names: str) -> list[np.ndarray]:
    """Ports of the autopilot and the vehicle alone, at each sample."""
    builder = DiagramBuilder()
    pilot, body = builder.AddSystem(autopilot.build(scenario)), builder.AddSystem(vehicle.build(scenario))
    wheels = [wheel.name for wheel in scenario.vehicle_data.wheels]
    for name in ("gyro", *wheels):
        builder.Connect(body.GetOutputPort(name), pilot.GetInputPort(name))
    for name in ("command", "held_command", "command_onset", "held_command_onset", "wheel_torque"):
        builder.Connect(pilot.GetOutputPort(name), body.GetInputPort(name))
    period_s = scenario.vehicle_data.sample_period_s
    logs = []
    for name in names:
        source = pilot if pilot.HasOutputPort(name) else body
        logs.append(LogVectorOutput(source.GetOutputPort(name), builder, period_s))
    diagram = builder.Build()
    simulator = Simulator(diagram)
    simulator.AdvanceTo(scenario.duration_s)
    return [log.FindLog(simulator.get_context()).data().T.copy() for log in logs]


@pytest.fixture(scope="module")
def held() -> list[np.ndarray]:
    return flown(flight(), "attitude_error", "wheel_speeds", "command")


def test_wheels_hold_attitude_within_the_deadband(held: list[np.ndarray]) -> None:
    error, _, _ = held
    # the error that the hold gain makes as much rate of as the deadband is
    assert np.abs(error).max() < DEADBAND / HOLD_GAIN


def test_jets_take_momentum_off_until_it_is_little(held: list[np.ndarray]) -> None:
    _, speeds, command = held
    momentum = 0.006 * speeds @ np.array(PYRAMID)
    shared = momentum @ np.linalg.pinv(np.array(PYRAMID)) / 0.006  # speeds that it takes
    below = int(np.argmax(np.abs(shared).max(axis=1) < 0.2 * 400.0))
    fired = np.flatnonzero(command.any(axis=1))
    assert fired.size > 10
    assert below - 20 < fired.max() <= below + 2
    assert np.abs(shared[below:]).max() < 0.25 * 400.0


def test_without_unloading_wheels_gather_what_pushes() -> None:
    settings = flight(duration_s=20.0).autopilot.model_dump()
    settings["wheels"] = {"unload_above": None}
    error, speeds, command = flown(
        flight(duration_s=20.0, autopilot=settings), "attitude_error", "wheel_speeds", "command"
    )
    assert not command.any()
    gained = 0.006 * (speeds[-1] - speeds[0]) @ np.array(PYRAMID)
    np.testing.assert_allclose(gained, 20.0 * np.array(PUSHED["torque"]), rtol=0.1, atol=0.01)
    assert np.abs(error[-1]).max() < DEADBAND / HOLD_GAIN
