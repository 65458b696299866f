"""A MultibodyPlant of one body against `RigidBodyPlant`: the same jets, the same commands, the same motion."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.analysis import ApplySimulatorConfig, Simulator, SimulatorConfig
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import LogVectorOutput

from massprop_drake import load_scenario
from massprop_drake.diagrams import vehicle
from massprop_drake.inputs import params
from massprop_drake.inputs.scenario import Scenario
from massprop_drake.maths.vehicle.rigid_body import (
    MASS,
    ORIGIN_VELOCITY,
    POSITION,
    QUATERNION,
    RATE,
    SPIN_INTEGRAL,
    VELOCITY,
)
from massprop_drake.systems.autopilot.jet_schedule import JetSchedule

Array = NDArray[np.float64]

DURATION_S = 12.0
COMMON = (
    f"duration_s={DURATION_S:g}",
    "plant.initial_rate=[0.01, -0.02, 0.015]",
    "plant.thrust_dispersion=0.02",
    "plant.thrust_transient=vehicle",
    "plant.disturbance={torque: [0.002, 0.0, -0.001], torque_std: [0.01, 0.01, 0.01], force: [0.0, 0.03, 0.0]}",
    "failures=[{kind: degraded, jet: YP1, start_s: 4, fraction: 0.6}]",
)


def model_of(scenario: Scenario) -> str:
    """SDF of one body with a scenario's true mass properties."""
    mass, center, inertia = params.true_properties(scenario)
    names = (("ixx", 0, 0), ("iyy", 1, 1), ("izz", 2, 2), ("iyz", 1, 2), ("ixz", 0, 2), ("ixy", 0, 1))
    moments = "".join(f"<{name}>{inertia[i, j]}</{name}>" for name, i, j in names)
    place = " ".join(map(str, center))
    return (
        f'<sdf version="1.9"><model name="satellite"><link name="bus"><inertial><pose>{place} 0 0 0</pose>'
        f"<mass>{mass}</mass><inertia>{moments}</inertia></inertial></link></model></sdf>"
    )


def flown_as(scenario: Scenario, commands: Array) -> dict[str, Array]:
    """Motion of a vehicle under commands, a row per sample, with fixed steps of a fifth of the sample period."""
    period_s = scenario.vehicle_data.sample_period_s
    builder = DiagramBuilder()
    flown = builder.AddSystem(vehicle.build(scenario))
    schedule = builder.AddSystem(JetSchedule(commands, period_s=period_s))
    for name in ("command", "held_command"):
        builder.Connect(schedule.GetOutputPort(name), flown.GetInputPort(name))
    logs = {
        name: LogVectorOutput(flown.GetOutputPort(name), builder, period_s)
        for name in ("body_state", "structure", "gyro", "acc")
    }
    simulator = Simulator(builder.Build())
    config = SimulatorConfig(integration_scheme="runge_kutta5", max_step_size=period_s / 5.0, use_error_control=False)
    ApplySimulatorConfig(config, simulator)
    root: Any = simulator.get_mutable_context()
    for part in flown.GetSystems():
        if hasattr(part, "set_initial_velocities"):
            part.set_initial_velocities(root)
    simulator.AdvanceTo(DURATION_S)
    return {name: log.FindLog(root).data().T.copy() for name, log in logs.items()}


def test_motion_mass_properties_and_readings_are_the_same() -> None:
    """Jets come and go at random, and lag."""
    rigid = load_scenario("small_satellite_maneuver", [*COMMON, "plant.time_step=0", "plant.depletion=false"])
    same = load_scenario(
        "small_satellite_maneuver", [*COMMON, "plant.kind=multibody", f"plant.model={model_of(rigid)}", "plant.body=bus"]
    )
    random = np.random.default_rng(4)
    commands = (random.random((120, 12)) < 0.15).astype(float)
    both = expected, found = flown_as(rigid, commands), flown_as(same, commands)
    for part in (RATE, VELOCITY, POSITION, ORIGIN_VELOCITY, SPIN_INTEGRAL):
        one, other = (logs["body_state"][:, part] for logs in both)
        peak = np.abs(one).max()
        assert peak > 1e-3  # they move
        # what is left is the integrator's, 1e-14 with steps of a twentieth of the period
        np.testing.assert_allclose(other, one, rtol=0.0, atol=1e-9 * peak)
    one, other = (logs["body_state"][:, QUATERNION] for logs in both)
    one = one / np.linalg.norm(one, axis=1)[:, None]
    np.testing.assert_allclose(other * np.sign(np.sum(one * other, axis=1))[:, None], one, atol=1e-9)
    np.testing.assert_allclose(found["structure"], expected["structure"], rtol=1e-13, atol=1e-13)
    np.testing.assert_allclose(found["body_state"][:, MASS], expected["body_state"][:, MASS], rtol=1e-14)
    for name in ("gyro", "acc"):  # quantized, to the same marks
        np.testing.assert_array_equal(found[name], expected[name])
        assert np.unique(found[name]).size > 100
