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
from massprop_drake.inputs.vehicle_file import Vehicle, Wheel
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


def turned(plant: MultibodyPlant, simulator: Simulator, until_s: float) -> np.ndarray:
    """Rate of the bus after some time in which it starts turning, body axes."""
    bus, context = plant.GetBodyByName("bus"), plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    simulator.get_mutable_integrator().set_target_accuracy(1e-10)
    plant.SetFreeBodySpatialVelocity(context, bus, SpatialVelocity(START, np.zeros(3)))
    simulator.AdvanceTo(until_s)
    rate = plant.EvalBodySpatialVelocityInWorld(context, bus).rotational()
    return plant.EvalBodyPoseInWorld(context, bus).rotation().matrix().T @ rate


def with_bus(inertia: SpatialInertia) -> MultibodyPlant:
    plant = MultibodyPlant(0.0)
    plant.AddRigidBody("bus", inertia)
    plant.mutable_gravity_field().set_gravity_vector(np.zeros(3))
    return plant


def test_the_couple_is_that_of_a_body_on_a_joint() -> None:
    """Over a tenth of a second the wheel's speed goes as good as straight from one value to the other."""
    until_s, whole = 0.1, SpatialInertia(40.0, np.zeros(3), UNIT)
    unit = SPIN * (0.6 * np.eye(3) + 0.4 * np.outer(AXIS, AXIS)) / 2.0
    own = SpatialInertia(2.0, np.zeros(3), UnitInertia(*unit.diagonal(), unit[0, 1], unit[0, 2], unit[1, 2]))
    plant = with_bus(whole)
    wheel, bus = plant.AddRigidBody("wheel", own), plant.GetBodyByName("bus")
    joint = plant.AddJoint(RevoluteJoint("spin", bus.body_frame(), wheel.body_frame(), AXIS))
    plant.AddJointActuator("motor", joint)
    plant.Finalize()
    simulator = Simulator(plant)
    context = simulator.get_mutable_context()
    plant.get_actuation_input_port().FixValue(context, [0.4])
    joint.set_angular_rate(context, 80.0)
    expected, speeds = turned(plant, simulator, until_s), np.array([80.0, joint.get_angular_rate(context)])

    whole += own
    plant, builder = with_bus(whole), DiagramBuilder()
    plant.Finalize()
    builder.AddSystem(plant)
    dut = builder.AddSystem(BodyWrench(plant, "bus", wheels=True))
    momenta = SPIN * np.outer([speeds.mean(), (speeds[1] - speeds[0]) / until_s], AXIS)
    for name, value in (("wrench", np.zeros(7)), ("wheels", momenta.ravel())):
        builder.Connect(builder.AddSystem(ConstantVectorSource(value)).get_output_port(), dut.GetInputPort(name))
    for name in ("body_poses", "body_spatial_velocities"):
        builder.Connect(plant.GetOutputPort(name), dut.GetInputPort(name))
    builder.Connect(dut.GetOutputPort("spatial_forces"), plant.get_applied_spatial_force_input_port())
    found = turned(plant, Simulator(builder.Build()), until_s)
    np.testing.assert_allclose(found, expected, atol=2e-6)  # the momentum is held at its mean
    assert np.abs(expected - START).max() > 5e-3


def test_ports_of_wheels_are_there_and_they_start_as_they_are_told() -> None:
    builder, plant = DiagramBuilder(), arm()
    builder.AddSystem(plant)
    vehicle = again(load_vehicle("servicer"), wheels=with_wheels().wheels)
    added = add_thrusters_and_sensors(builder, plant, vehicle, "bus")  # of the user's own
    assert (added.GetInputPort("wheel_torque").size(), added.GetOutputPort("W1").size()) == (2, 1)
    dut = open_loop.build(flight({"kind": "multibody", "model": LINK, "body": "bus"}))
    assert dut.GetOutputPort("wheel_speeds").Eval(dut.CreateDefaultContext())[0] == pytest.approx(60.0)
