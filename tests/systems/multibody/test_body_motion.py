"""What sensors and truth are told of a MultibodyPlant's motion, against Drake's own reckoning."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from multibody_probe import arm, tumbling
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import SpatialInertia
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from systems_probe import feedthrough, outputs

from massprop_drake.maths.attitude import rotation_matrix
from massprop_drake.maths.mass_properties import symmetric
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
from massprop_drake.systems.multibody import BodyMotion

PORTS = ("body_poses", "body_spatial_velocities", "body_spatial_accelerations")


def _fed(dut: BodyMotion, plant: MultibodyPlant, context: Any) -> Any:
    """A context of the system that has what the plant's ports say."""
    fed = dut.CreateDefaultContext()
    for name in PORTS:
        dut.GetInputPort(name).FixValue(fed, _value(plant, name, context))
    return fed


def _value(plant: MultibodyPlant, name: str, context: Any) -> Any:
    port = plant.GetOutputPort(name)
    value = port.Allocate()
    value.set_value(port.Eval(context))
    return value


@pytest.fixture
def plant() -> MultibodyPlant:
    return arm()


def test_topology(plant: MultibodyPlant) -> None:
    dut = BodyMotion(plant, "bus")
    assert outputs(dut) == {"body_state": 23, "structure": 9, "mass_properties": 10}
    # not on accelerations, and so not on the jets, whose command may come from what is read here
    standing = {"body_poses"}
    moving = {"body_poses", "body_spatial_velocities"}
    assert feedthrough(dut) == {"body_state": moving, "structure": standing, "mass_properties": standing}


@pytest.mark.parametrize("body", ["bus", "forearm"])
def test_mass_properties_are_those_of_all_that_is_joined_as_it_stands(plant: MultibodyPlant, body: str) -> None:
    context, carrier = tumbling(plant), plant.GetBodyByName(body)
    dut = BodyMotion(plant, body)
    fed = _fed(dut, plant, context)
    structure = STRUCTURE.read(dut.GetOutputPort("structure").Eval(fed))
    every = [plant.get_body(index).index() for index in plant.GetBodyIndices(carrier.model_instance())]
    spatial = plant.CalcSpatialInertia(context, carrier.body_frame(), every)
    center = spatial.get_com()
    inertia = spatial.Shift(center).CalcRotationalInertia().CopyToFullMatrix3()
    np.testing.assert_allclose(structure.center_of_mass, center, rtol=0.0, atol=1e-14)
    np.testing.assert_allclose(symmetric(structure.inertia), inertia, rtol=1e-13, atol=1e-12)
    ten = dut.GetOutputPort("mass_properties").Eval(fed)
    np.testing.assert_allclose(symmetric(ten[:6]), np.linalg.inv(inertia), rtol=1e-12, atol=1e-16)
    np.testing.assert_allclose(ten[9], 1.0 / 183.0, rtol=1e-14)


def test_the_motion_is_that_of_the_body_and_of_the_common_center_of_mass(plant: MultibodyPlant) -> None:
    context, bus = tumbling(plant), plant.GetBodyByName("bus")
    dut = BodyMotion(plant, bus)
    state = dut.GetOutputPort("body_state").Eval(_fed(dut, plant, context))
    pose = plant.EvalBodyPoseInWorld(context, bus)
    rotation = pose.rotation().matrix()
    np.testing.assert_allclose(rotation_matrix(state[QUATERNION]), rotation, atol=1e-14)
    rate = plant.EvalBodySpatialVelocityInWorld(context, bus).rotational()
    np.testing.assert_allclose(state[RATE], rotation.T @ rate, atol=1e-14)
    np.testing.assert_allclose(state[POSITION], plant.CalcCenterOfMassPositionInWorld(context), atol=1e-14)
    velocity = plant.CalcCenterOfMassTranslationalVelocityInWorld(context)
    np.testing.assert_allclose(state[VELOCITY], velocity, atol=1e-14)
    assert state[MASS] == pytest.approx(183.0, rel=1e-14)
    np.testing.assert_array_equal(state[14:], 0.0)


def _integrals(plant: MultibodyPlant, body: str, duration_s: float) -> np.ndarray:
    """The integrals after a time of a plant that starts turning."""
    builder = DiagramBuilder()
    builder.AddSystem(plant)
    motion = builder.AddSystem(BodyMotion(plant, body))
    for name in PORTS:
        builder.Connect(plant.GetOutputPort(name), motion.GetInputPort(name))
    simulator = Simulator(builder.Build())
    root = simulator.get_mutable_context()
    context = plant.GetMyMutableContextFromRoot(root)
    plant.SetPositions(context, plant.GetPositions(tumbling(plant)))
    plant.SetVelocities(context, plant.GetVelocities(tumbling(plant)))
    simulator.get_mutable_integrator().set_target_accuracy(1e-11)
    simulator.AdvanceTo(duration_s)
    return motion.GetOutputPort("body_state").Eval(motion.GetMyContextFromRoot(root))


def test_what_falls_freely_feels_no_gravity() -> None:
    floating, falling = (_integrals(arm(gravity), "bus", 1.0) for gravity in ((0.0, 0.0, 0.0), (1.0, -2.0, -9.81)))
    both = slice(ORIGIN_VELOCITY.start, SPIN_INTEGRAL.stop)
    np.testing.assert_allclose(falling[both], floating[both], rtol=1e-7, atol=1e-7)
    assert np.abs(floating[ORIGIN_VELOCITY]).max() > 0.1  # the arm pulls at it


def test_what_stands_feels_that_it_is_held_up() -> None:
    plant = MultibodyPlant(0.0)
    body = plant.AddRigidBody("block", SpatialInertia.SolidCubeWithDensity(1000.0, 0.1))
    plant.WeldFrames(plant.world_frame(), body.body_frame(), RigidTransform(RotationMatrix.MakeXRotation(0.5 * np.pi)))
    plant.Finalize()
    dut = BodyMotion(plant, "block")
    fed = _fed(dut, plant, plant.CreateDefaultContext())
    rates = dut.EvalTimeDerivatives(fed).CopyToVector()
    np.testing.assert_allclose(rates, [0.0, 9.81, 0.0, *[0.0] * 6], atol=1e-14)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"time_step": 0.001}, r"is discrete, with a time step of 0\.001 s: its steps are of first order"),
        ({}, r"'hull' is no body of the MultibodyPlant; bodies are: bus, forearm, payload, upper_arm"),
    ],
)
def test_a_wrong_plant_or_body_is_refused(given: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        BodyMotion(arm(**given), "hull")


def test_a_plant_that_is_not_finalized_is_refused() -> None:
    with pytest.raises(ValueError, match=r"is not finalized; call its Finalize\(\) first"):
        BodyMotion(MultibodyPlant(0.0), "bus")
