"""What sensors and truth are told of a MultibodyPlant's motion, against Drake's own reckoning."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from multibody_probe import arm, tumble
from numpy.testing import assert_allclose, assert_array_equal
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import SpatialInertia
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from systems_probe import feedthrough, outputs

from massprop_drake.maths.attitude import rotation_matrix
from massprop_drake.maths.mass_properties import symmetric_matrix
from massprop_drake.maths.vehicle.rigid_body import (
    MASS,
    ORIGIN_VELOCITY,
    POSITION,
    QUATERNION,
    RATE,
    SPIN_INTEGRAL,
    STRUCTURE,
    VELOCITY,
)
from massprop_drake.systems import BodyMotion

PORTS = ("body_poses", "body_spatial_velocities", "body_spatial_accelerations")


def fed(dut: BodyMotion, plant: MultibodyPlant, context: Any) -> Any:
    """A context of the system that has what the plant's ports say."""
    given = dut.CreateDefaultContext()
    for name in PORTS:
        value = plant.GetOutputPort(name).Allocate()
        value.set_value(plant.GetOutputPort(name).Eval(context))
        dut.GetInputPort(name).FixValue(given, value)
    return given


@pytest.mark.parametrize("name", ["bus", "forearm"])
def test_motion_and_mass_properties_are_those_of_all_that_is_joined_as_it_stands(name: str) -> None:
    plant = arm()
    context, body = tumble(plant, plant.CreateDefaultContext()), plant.GetBodyByName(name)
    dut = BodyMotion(plant, name)
    assert outputs(dut) == {"body_state": 23, "structure": 9, "mass_properties": 10}
    # not on accelerations, and so not on the jets, whose command may come from what is read here
    standing = {"body_poses"}
    moving = {"body_poses", "body_spatial_velocities"}
    assert feedthrough(dut) == {"body_state": moving, "structure": standing, "mass_properties": standing}
    state, structure, ten = (dut.GetOutputPort(port).Eval(fed(dut, plant, context)) for port in outputs(dut))
    every = [plant.get_body(index).index() for index in plant.GetBodyIndices(body.model_instance())]
    spatial = plant.CalcSpatialInertia(context, body.body_frame(), every)
    inertia = spatial.Shift(spatial.get_com()).CalcRotationalInertia().CopyToFullMatrix3()
    read = STRUCTURE.read(structure)
    assert_allclose(read.center_of_mass, spatial.get_com(), rtol=0.0, atol=1e-14)
    assert_allclose(symmetric_matrix(read.inertia), inertia, rtol=1e-13, atol=1e-12)
    assert_allclose(symmetric_matrix(ten[:6]), np.linalg.inv(inertia), rtol=1e-12, atol=1e-16)
    assert_allclose([1.0 / ten[9], state[MASS]], 183.0, rtol=1e-14)
    rotation = plant.EvalBodyPoseInWorld(context, body).rotation().matrix()
    assert_allclose(rotation_matrix(state[QUATERNION]), rotation, atol=1e-14)
    rate = plant.EvalBodySpatialVelocityInWorld(context, body).rotational()
    assert_allclose(state[RATE], rotation.T @ rate, atol=1e-14)
    assert_allclose(state[POSITION], plant.CalcCenterOfMassPositionInWorld(context), atol=1e-14)
    assert_allclose(state[VELOCITY], plant.CalcCenterOfMassTranslationalVelocityInWorld(context), atol=1e-14)
    assert_array_equal(state[14:], 0.0)


def integrals(plant: MultibodyPlant) -> np.ndarray:
    """The integrals after some time of a plant that starts turning."""
    builder = DiagramBuilder()
    builder.AddSystem(plant)
    motion = builder.AddSystem(BodyMotion(plant, "bus"))
    for name in PORTS:
        builder.Connect(plant.GetOutputPort(name), motion.GetInputPort(name))
    simulator = Simulator(builder.Build())
    root = simulator.get_mutable_context()
    tumble(plant, plant.GetMyMutableContextFromRoot(root))
    simulator.get_mutable_integrator().set_target_accuracy(1e-10)
    simulator.AdvanceTo(0.4)
    return motion.GetOutputPort("body_state").Eval(motion.GetMyContextFromRoot(root))


def test_what_falls_freely_feels_no_gravity_and_what_stands_that_it_is_held_up() -> None:
    floating, falling = (integrals(arm(gravity)) for gravity in ((0.0, 0.0, 0.0), (1.0, -2.0, -9.81)))
    both = slice(ORIGIN_VELOCITY.start, SPIN_INTEGRAL.stop)
    assert_allclose(falling[both], floating[both], rtol=1e-7, atol=1e-7)
    assert np.abs(floating[ORIGIN_VELOCITY]).max() > 0.01  # the arm pulls at it
    plant = MultibodyPlant(0.0)
    body = plant.AddRigidBody("block", SpatialInertia.SolidCubeWithDensity(1000.0, 0.1))
    plant.WeldFrames(plant.world_frame(), body.body_frame(), RigidTransform(RotationMatrix.MakeXRotation(0.5 * np.pi)))
    plant.Finalize()
    dut = BodyMotion(plant, "block")
    rates = dut.EvalTimeDerivatives(fed(dut, plant, plant.CreateDefaultContext())).CopyToVector()
    assert_allclose(rates, [0.0, 9.81, 0.0, *[0.0] * 6], atol=1e-14)
