"""Reaction wheels that a body of a MultibodyPlant carries: like those of the rigid plant, and like bodies on joints."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from multibody_probe import arm
from pose_probe import again
from pydrake.multibody.math import SpatialVelocity
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import RevoluteJoint, SpatialInertia, UnitInertia
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource

from massprop_drake import Scenario, load_vehicle, simulate
from massprop_drake.diagrams import open_loop
from massprop_drake.diagrams.multibody import add_thrusters_and_sensors
from massprop_drake.inputs.scenario import resolved
from massprop_drake.inputs.vehicle_file import Vehicle
from massprop_drake.inputs.vehicle_sensors import Wheel
from massprop_drake.systems.multibody.body_wrench import BodyWrench

AXIS, SPIN = np.array([0.6, 0.0, 0.8]), 0.02  # kg-m^2
UNIT = UnitInertia(0.1, 0.15, 0.2, 0.01, -0.02, 0.01)
START = np.array([0.1, -0.05, 0.08])  # rad/s
LINK = """<?xml version="1.0"?>
<sdf version="1.9"><model name="one"><link name="bus"><inertial>
<pose>0.04 0 -0.02 0 0 0</pose><mass>500</mass>
<inertia><ixx>95</ixx><iyy>130</iyy><izz>142</izz><ixy>-1.2</ixy><ixz>2.5</ixz><iyz>-0.8</iyz></inertia>
</inertial></link></model></sdf>"""


def with_wheels() -> Vehicle:
    wheels = (
        Wheel(name="W1", axis=tuple(AXIS), inertia=SPIN, quantum=0.05, torque=0.2),
        Wheel(name="W2", axis=(0.0, 1.0, 0.0), inertia=0.015, quantum=0.05, torque=0.2),
    )
    return again(load_vehicle("small_satellite"), wheels=wheels)


def flight(plant: dict[str, Any]) -> Scenario:
    turned = [
        {"wheel": "W1", "start_s": 0.2, "end_s": 1.4, "torque": 0.1},
        {"wheel": "W2", "start_s": 0.5, "end_s": 2.0, "torque": -0.15},
    ]
    fired = [{"jet": "YP1", "start_s": 0.4, "end_s": 1.0}]
    started = {"wheel_speeds": {"W1": 60.0}, "initial_rate": [0.1, -0.2, 0.05], "wheel_dispersion": 0.02}
    own = {"vehicle": with_wheels(), "duration_s": 2.0, "wheel_schedule": turned, "jet_schedule": fired}
    return resolved(own | {"plant": plant | started, "detector": {"kind": "off"}})


def test_one_body_moves_as_the_rigid_plant_does() -> None:
    rigid = simulate(flight({"time_step": 0.0, "depletion": False}), look_back=False)
    other = simulate(flight({"kind": "multibody", "model": LINK, "body": "bus"}), look_back=False)
    for name, least in (("rate", 1e-8), ("velocity", 1e-8), ("W1", 1e-12), ("acc", 2e-4)):
        np.testing.assert_allclose(other[name], rigid[name], atol=least, err_msg=name)
    unmoved = np.array(flight({}).plant.initial_rate)
    assert np.abs(rigid["rate"] - unmoved).max() > 0.01


def of_bodies(torque: float, speed: float, until_s: float) -> tuple[np.ndarray, np.ndarray, SpatialInertia]:
    """Rate at the end of a bus in which a wheel turns on a joint, speeds of the wheel, and the two as one body."""
    plant = MultibodyPlant(0.0)
    bus = plant.AddRigidBody("bus", SpatialInertia(40.0, np.zeros(3), UNIT))
    own = SPIN * (0.6 * np.eye(3) + 0.4 * np.outer(AXIS, AXIS)) / 2.0
    made = UnitInertia(own[0, 0], own[1, 1], own[2, 2], own[0, 1], own[0, 2], own[1, 2])
    wheel = plant.AddRigidBody("wheel", SpatialInertia(2.0, np.zeros(3), made))
    joint = plant.AddJoint(RevoluteJoint("spin", bus.body_frame(), wheel.body_frame(), AXIS))
    plant.AddJointActuator("motor", joint)
    plant.mutable_gravity_field().set_gravity_vector(np.zeros(3))
    plant.Finalize()
    builder = DiagramBuilder()
    builder.AddSystem(plant)
    motor = builder.AddSystem(ConstantVectorSource([torque]))
    builder.Connect(motor.get_output_port(), plant.get_actuation_input_port())
    simulator = Simulator(builder.Build())
    simulator.get_mutable_integrator().set_target_accuracy(1e-10)
    context = plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    plant.SetFreeBodySpatialVelocity(context, bus, SpatialVelocity(START, np.zeros(3)))
    joint.set_angular_rate(context, speed)
    speeds = [speed]
    simulator.AdvanceTo(until_s)
    speeds.append(joint.get_angular_rate(context))
    pose, velocity = plant.EvalBodyPoseInWorld(context, bus), plant.EvalBodySpatialVelocityInWorld(context, bus)
    whole = SpatialInertia(40.0, np.zeros(3), UNIT)
    whole += SpatialInertia(2.0, np.zeros(3), made)
    return pose.rotation().matrix().T @ velocity.rotational(), np.array(speeds), whole


def test_the_couple_is_that_of_a_body_on_a_joint() -> None:
    """Over a tenth of a second the wheel's speed goes as good as straight from one value to the other."""
    until_s = 0.1
    expected, speeds, whole = of_bodies(0.4, 80.0, until_s)
    plant = MultibodyPlant(0.0)
    bus = plant.AddRigidBody("bus", whole)
    plant.mutable_gravity_field().set_gravity_vector(np.zeros(3))
    plant.Finalize()
    builder = DiagramBuilder()
    builder.AddSystem(plant)
    dut = builder.AddSystem(BodyWrench(plant, bus, wheels=True))
    changing = SPIN * (speeds[1] - speeds[0]) / until_s * AXIS
    middle = SPIN * speeds.mean() * AXIS
    for name, value in (("wrench", np.zeros(7)), ("wheels", np.concatenate((middle, changing)))):
        builder.Connect(builder.AddSystem(ConstantVectorSource(value)).get_output_port(), dut.GetInputPort(name))
    for name in ("body_poses", "body_spatial_velocities"):
        builder.Connect(plant.GetOutputPort(name), dut.GetInputPort(name))
    builder.Connect(dut.GetOutputPort("spatial_forces"), plant.get_applied_spatial_force_input_port())
    simulator = Simulator(builder.Build())
    simulator.get_mutable_integrator().set_target_accuracy(1e-10)
    context = plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    plant.SetFreeBodySpatialVelocity(context, bus, SpatialVelocity(START, np.zeros(3)))
    simulator.AdvanceTo(until_s)
    pose, velocity = plant.EvalBodyPoseInWorld(context, bus), plant.EvalBodySpatialVelocityInWorld(context, bus)
    found = pose.rotation().matrix().T @ velocity.rotational()
    np.testing.assert_allclose(found, expected, atol=2e-6)  # the momentum is held at its mean
    assert np.abs(expected - START).max() > 5e-3


def test_a_plant_of_the_users_own_has_the_ports_of_wheels() -> None:
    builder, plant = DiagramBuilder(), arm()
    builder.AddSystem(plant)
    added = add_thrusters_and_sensors(
        builder, plant, again(load_vehicle("servicer"), wheels=with_wheels().wheels), "bus"
    )
    assert added.GetInputPort("wheel_torque").size() == 2
    assert added.GetOutputPort("W1").size() == 1


def test_a_diagram_of_a_multibody_vehicle_starts_with_its_wheels() -> None:
    scenario = flight({"kind": "multibody", "model": LINK, "body": "bus"})
    dut = open_loop.build(scenario)
    context = dut.CreateDefaultContext()
    assert dut.GetOutputPort("wheel_speeds").Eval(context)[0] == pytest.approx(60.0)
