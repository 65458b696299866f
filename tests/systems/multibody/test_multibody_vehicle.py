"""A vehicle of several bodies: its start, its joints' drives, and the star tracker beside it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from multibody_probe import arm
from numpy.testing import assert_allclose, assert_array_equal
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from systems_probe import feedthrough, give, inputs, output, outputs

from massprop_drake.maths.attitude import conjugate, multiply, to_rotation_vector
from massprop_drake.maths.vehicle.joint_moves import Move, drive_forces, driven_inertia, joint_reference
from massprop_drake.maths.vehicle.rigid_body import N_STATE, POSITION, QUATERNION, RATE, VELOCITY
from massprop_drake.systems import StarTracker
from massprop_drake.systems.multibody import JointDrive, MultibodyVehicle

STOWED = {"shoulder": 1.57, "elbow": -2.8}
OUT = {"shoulder": (Move(0.1, 1.1, 1.2),), "elbow": (Move(0.2, 1.2, -2.6), Move(1.2, 1.5, -2.65))}


def made(**given: Any) -> MultibodyVehicle:
    usual = {"positions": STOWED, "rates": {}, "rate": np.zeros(3), "moves": {}, "drive_frequency_hz": 2.0}
    return MultibodyVehicle(arm(), "bus", **{**usual, "shown": ("shoulder", "elbow"), **given})


def flown(dut: MultibodyVehicle, *times_s: float) -> list[dict[str, np.ndarray]]:
    """The truth at some times, with no force from outside."""
    builder = DiagramBuilder()
    builder.AddSystem(dut)
    simulator = Simulator(builder.Build())
    root = simulator.get_mutable_context()
    context, rows = dut.GetMyMutableContextFromRoot(root), []
    give(dut, context, wrench=np.zeros(7))
    dut.set_initial_velocities(root)
    simulator.get_mutable_integrator().set_target_accuracy(1e-8)
    for time_s in times_s:
        simulator.AdvanceTo(time_s)
        rows.append({name: output(dut, context, name) for name in outputs(dut)})
    return rows


def test_it_starts_along_the_inertial_axes_with_its_center_of_mass_at_rest_and_at_the_origin() -> None:
    rate = np.array([0.1, -0.2, 0.3])
    dut = made(rates={"shoulder": 0.5, "elbow": -1.0}, rate=rate)
    assert inputs(dut) == {"wrench": 7}
    assert outputs(dut) == {"body_state": 23, "structure": 9, "mass_properties": 10, "joint_positions": 2}
    assert not any(feedthrough(dut).values())
    assert "joint_positions" not in outputs(made(shown=()))
    start, later = flown(dut, 0.0, 0.1)
    body = start["body_state"]
    assert_allclose(body[QUATERNION], [1.0, 0.0, 0.0, 0.0], atol=1e-15)
    assert_allclose(body[RATE], rate, atol=1e-15)
    assert_allclose([body[POSITION], body[VELOCITY]], 0.0, atol=1e-15)
    assert_array_equal(start["joint_positions"], [1.57, -2.8])
    # joints without a drive are free
    assert_allclose(later["joint_positions"], [1.57 + 0.05, -2.8 - 0.1], atol=5e-3)


def test_a_drive_gives_the_forces_of_its_mathematics() -> None:
    plant = arm()
    positions = np.zeros(plant.num_positions())
    positions[0], joint = 1.0, plant.GetJointByName("elbow")
    dut = JointDrive(plant, positions, {"elbow": (Move(0.0, 1.0, 0.5),)}, frequency_hz=2.0)
    assert inputs(dut) == {"state": plant.num_multibody_states()}
    assert feedthrough(dut) == {"generalized_force": {"state"}}
    state, at, moving = np.zeros(plant.num_multibody_states()), joint.position_start(), joint.velocity_start()
    state[[at, plant.num_positions() + moving]] = 0.1, 0.2
    context, bodies = dut.CreateDefaultContext(), plant.CreateDefaultContext()
    context.SetTime(0.3)
    plant.SetPositions(bodies, positions)
    inertia = driven_inertia(plant.CalcMassMatrix(bodies), [moving])
    wanted = [joint_reference(0.0, (Move(0.0, 1.0, 0.5),), 0.3)]
    expected = np.zeros(plant.num_velocities())
    expected[moving] = drive_forces(wanted, np.array([0.1]), np.array([0.2]), inertia, 2.0)[0]
    assert_allclose(output(dut, context, "generalized_force", state=state), expected, rtol=1e-12)


@pytest.mark.parametrize("given", [{"positions": {"wrist": 1.0}}, {"moves": {"wrist": ()}}])
def test_an_unknown_joint_is_named(given: dict[str, Any]) -> None:
    with pytest.raises(
        ValueError, match=r"'wrist' is no joint of one degree of freedom in the model; joints are: elbow"
    ):
        made(**given)


def test_a_star_tracker_errs_by_a_small_turn_about_the_vehicles_axes() -> None:
    attitude, dut = np.array([0.5, -0.5, 0.5, 0.5]), StarTracker("stars", noise_std=(1e-4, 1e-4, 1e-3))
    assert outputs(dut) == {"reading": 4}
    context, body = dut.CreateDefaultContext(), np.zeros(N_STATE)
    body[QUATERNION] = attitude
    give(dut, context, body_state=body, structure=np.zeros(9))
    assert_array_equal(output(dut, context, "reading", noise=np.zeros(3)), attitude)
    turned = multiply(conjugate(attitude), output(dut, context, "reading", noise=[1.0, -2.0, 0.5]))
    assert_allclose(to_rotation_vector(turned), [1e-4, -2e-4, 5e-4], rtol=1e-9)
    for std in (-1.0, (1.0, 2.0), (1.0, -1.0, 0.0)):
        with pytest.raises(ValueError, match=r"star tracker 'stars': noise_std must be a number or three, zero or"):
            StarTracker("stars", noise_std=std)
