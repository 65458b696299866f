"""True reaction wheels: against bodies and joints of Drake's MultibodyPlant; readings and limits."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from pydrake.multibody.math import SpatialVelocity
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import RevoluteJoint, SpatialInertia, UnitInertia
from pydrake.systems.analysis import Simulator
from systems_probe import feedthrough, inputs, output, outputs, update

from massprop_drake.maths.mass_properties import MassProperties
from massprop_drake.maths.vehicle import rigid_body
from massprop_drake.maths.vehicle.wheel_motors import WheelsModel, read_speed
from massprop_drake.systems.vehicle.reaction_wheels import ReactionWheels

Array = NDArray[np.float64]
AXES = np.array([[0.6, 0.0, 0.8], [0.0, 1.0, 0.0]])
SPIN = np.array([0.02, 0.015])  # kg-m^2, about each axis


def model(**changed: Any) -> WheelsModel:
    """Two wheels that stand."""
    nothing = np.zeros(2)
    return WheelsModel(AXES, SPIN, np.full(2, 0.2), nothing, nothing, 0.0, nothing, np.full(2, np.inf))._replace(
        **changed
    )


def multibody(torques: Array, step_s: float, steps: int) -> tuple[Array, Array, Array]:
    """Rates of a body in which two wheels turn, their speeds, at each step, and its inertia with the wheels locked."""
    plant = MultibodyPlant(0.0)
    whole = SpatialInertia(40.0, np.zeros(3), UnitInertia(0.1, 0.15, 0.2, 0.01, -0.02, 0.01))
    body, joints = plant.AddRigidBody("bus", whole), []
    for place, (axis, spin) in enumerate(zip(AXES, SPIN, strict=True)):
        unit = spin * (0.6 * np.eye(3) + 0.4 * np.outer(axis, axis)) / 2.0
        own = SpatialInertia(2.0, np.zeros(3), UnitInertia(*unit.diagonal(), unit[0, 1], unit[0, 2], unit[1, 2]))
        wheel = plant.AddRigidBody(f"wheel{place}", own)
        joints.append(plant.AddJoint(RevoluteJoint(f"spin{place}", body.body_frame(), wheel.body_frame(), axis)))
        plant.AddJointActuator(f"motor{place}", joints[-1])
        whole += own
    plant.mutable_gravity_field().set_gravity_vector(np.zeros(3))
    plant.Finalize()
    simulator = Simulator(plant)
    simulator.get_mutable_integrator().set_target_accuracy(1e-10)
    context = simulator.get_mutable_context()
    plant.get_actuation_input_port().FixValue(context, torques)
    plant.SetFreeBodySpatialVelocity(context, body, SpatialVelocity(np.array([0.1, -0.05, 0.08]), np.zeros(3)))
    joints[0].set_angular_rate(context, 30.0)
    rates, speeds = [], []
    for step in range(steps + 1):
        simulator.AdvanceTo(step * step_s)
        pose, velocity = plant.EvalBodyPoseInWorld(context, body), plant.EvalBodySpatialVelocityInWorld(context, body)
        rates.append(pose.rotation().matrix().T @ velocity.rotational())
        speeds.append([joint.get_angular_rate(context) for joint in joints])
    return np.array(rates), np.array(speeds), whole.CalcRotationalInertia().CopyToFullMatrix3()


def test_a_body_with_wheels_moves_as_bodies_and_joints_do() -> None:
    step_s, steps = 0.02, 100
    rates, speeds, inertia = multibody(np.array([0.05, -0.08]), step_s, steps)
    body, state = (
        rigid_body.motion_constants(MassProperties(44.0, np.zeros(3), inertia)),
        rigid_body.initial_state(44.0),
    )
    state[rigid_body.RATE] = rates[0]
    for before, after in pairwise((speeds * SPIN) @ AXES):
        carried = rigid_body.add_wheel_momentum(body, np.concatenate((before, (after - before) / step_s)))
        state = rigid_body.step(state, np.zeros(7), np.zeros((0, 7)), (), step_s, carried)
    np.testing.assert_allclose(state[rigid_body.RATE], rates[-1], atol=1e-7)
    assert np.abs(rates[-1] - rates[0]).max() > 0.01


def test_a_speed_is_read_with_noise_and_in_steps() -> None:
    read = model(quanta=np.array([0.5, 0.0]), noise_std=np.array([0.1, 0.2]))
    assert read_speed(10.2, 1.0, 0, read) == 10.5
    assert read_speed(10.2, -2.0, 1, read) == pytest.approx(9.8)


def test_a_motor_leaves_its_wheel_at_the_largest_speed() -> None:
    """The first wheel gets .1 N m, so 5 rad/s^2: in a sample of .1 s half a rad/s, of which .2 are left."""
    near = model(fastest=np.array([10.0, np.inf]), start=np.array([9.8, -3.0]))
    dut = ReactionWheels(near, ("W1", "W2"), period_s=0.1, stepped=True, seed=0)
    assert inputs(dut) == {"wheel_torque": 2, "noise": 2, "seed": 1}
    assert outputs(dut) == {"wheels": 6, "wheel_speeds": 2, "W1": 1, "W2": 1}
    assert feedthrough(dut)["wheel_speeds"] == {"seed"}
    context = dut.CreateDefaultContext()
    assert not output(dut, context, "wheels")[3:].any()  # without a torque
    changing = output(dut, context, "wheels", wheel_torque=[0.1, 0.1], noise=np.zeros(2))[3:]
    np.testing.assert_allclose(changing, 0.02 * 0.2 / 0.1 * AXES[0] + 0.1 * AXES[1], rtol=1e-12)
    update(dut, context)
    context.SetTime(0.1)
    np.testing.assert_allclose(output(dut, context, "wheel_speeds"), [10.0, -3.0 + 0.1 / 0.015 * 0.1], rtol=1e-12)
