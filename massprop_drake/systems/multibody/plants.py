"""MultibodyPlants: made from SDF or URDF, checked, and searched for the bodies of a vehicle."""

from __future__ import annotations

import re
import textwrap
from collections import deque
from collections.abc import Mapping, Sequence
from typing import Any, Literal

import numpy as np
from pydrake.math import RigidTransform
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import BodyIndex, Joint, RigidBody

from massprop_drake.errors import collect_drake_warnings
from massprop_drake.maths.linear_algebra import Array
from massprop_drake.maths.vehicle.attached_bodies import Bodies, BodyPlaces, center_velocity, composite_body

_PLACE = re.compile(r"(<literal-string>\.\w+:\d+: )?(error|warning): |Failure at \S+ in |<data-string>:\d+: ")
_MOST_LETTERS = 500  # of a message of Drake's, which may hold the whole model


def parse_plant(text: str, kind: Literal["sdf", "urdf"]) -> MultibodyPlant:
    """Makes a continuous MultibodyPlant from the text of an SDF or URDF, without gravity and contact.

    Args:
        text: of the model.
        kind: its format.

    Raises:
        ValueError: when Drake cannot make a plant of it, an inertia in it is none, or it has constraints.
    """
    plant = MultibodyPlant(0.0)
    with collect_drake_warnings() as warnings:
        try:
            Parser(plant).AddModelsFromString(text, kind)
            plant.mutable_gravity_field().set_gravity_vector(np.zeros(3))
            plant.Finalize()
        except (Exception, SystemExit) as error:  # a failed DRAKE_DEMAND is the latter
            raise ValueError(f"Drake cannot read this {kind.upper()}: {_shorten_message(str(error))}") from None
    inertia_warning = next((text for text in warnings if "nertia" in text), None)
    if inertia_warning is not None:
        raise ValueError(f"Drake cannot read this {kind.upper()}: {_shorten_message(inertia_warning)}")
    if plant.num_constraints():
        raise ValueError("has a constraint, such as <mimic>, which a continuous plant cannot keep; leave it out")
    return plant


def require_motion(plant: MultibodyPlant) -> None:
    """Raises ValueError where inertias of a finalized plant are too small for Drake to move it."""
    try:
        plant.EvalTimeDerivatives(plant.CreateDefaultContext())
    except (RuntimeError, SystemExit) as error:
        raise ValueError(f"Drake cannot move this model: {_shorten_message(str(error))}") from None


def _shorten_message(text: str) -> str:
    """Shortens an error message of Drake to one line, without file and line numbers."""
    return textwrap.shorten(_PLACE.sub("", text), _MOST_LETTERS, placeholder=" ...")


def require_continuous(plant: MultibodyPlant) -> None:
    """Raises ValueError where a plant is discrete or not finalized: the truth must be continuous."""
    if plant.time_step() > 0.0:
        raise ValueError(
            f"the MultibodyPlant is discrete, with a time step of {plant.time_step():g} s: its steps are of first "
            "order, too coarse for sensors; make it continuous, MultibodyPlant(time_step=0.0)"
        )
    if not plant.is_finalized():
        raise ValueError("the MultibodyPlant is not finalized; call its Finalize() first")


def find_body(plant: MultibodyPlant, body: str | RigidBody | BodyIndex) -> RigidBody:
    """Returns the body of a plant, from its name, its index or the body itself.

    Raises:
        ValueError: when there is none, or more than one, of that name; or the body is of another plant, or the world.
    """
    if isinstance(body, str):
        found = [one for one in _bodies(plant) if one.name() == body]
        if len(found) > 1:
            raise ValueError(f"{len(found)} bodies of the MultibodyPlant are named '{body}'; rename all but one")
        if not found:
            names = sorted({one.name() for one in _bodies(plant)})
            raise ValueError(f"'{body}' is no body of the MultibodyPlant; bodies are: {', '.join(names)}")
        return found[0]
    if isinstance(body, BodyIndex):
        if not 0 < int(body) < plant.num_bodies():
            raise ValueError(
                f"body {int(body)}: must be from 1 to {plant.num_bodies() - 1}, an index of the MultibodyPlant's bodies"
            )
        return plant.get_body(body)
    if not isinstance(body, RigidBody):
        raise ValueError(f"body: must be the name, the BodyIndex or the body itself, got {body!r}")
    if body.GetParentPlant() is not plant or body.index() == plant.world_body().index():
        raise ValueError(f"body '{body.name()}' must be one of the MultibodyPlant's own, and not its world")
    return body


def _bodies(plant: MultibodyPlant) -> list[RigidBody]:
    """Returns all bodies but the world."""
    return [plant.get_body(BodyIndex(number)) for number in range(1, plant.num_bodies())]


def _joints(plant: MultibodyPlant) -> list[Joint]:
    """Returns all joints of a plant."""
    return [plant.get_joint(index) for index in plant.GetJointIndices()]


def connected_bodies(plant: MultibodyPlant, body: RigidBody) -> tuple[RigidBody, ...]:
    """Returns all bodies of the vehicle that joints connect with a body, the body first, without the world."""
    world = plant.world_body().index()
    neighbors: dict[BodyIndex, list[RigidBody]] = {}
    for joint in _joints(plant):
        one, other = joint.parent_body(), joint.child_body()
        if world not in (one.index(), other.index()):
            neighbors.setdefault(one.index(), []).append(other)
            neighbors.setdefault(other.index(), []).append(one)
    found, waiting = {body.index(): body}, deque([body])
    while waiting:
        for other in neighbors.get(waiting.popleft().index(), ()):
            if other.index() not in found:
                found[other.index()] = other
                waiting.append(other)
    return tuple(found.values())


def mass_properties_of(bodies: tuple[RigidBody, ...]) -> Bodies:
    """Returns masses, centers and inertias of bodies, as their plant has them by default.

    Raises:
        ValueError: when together they have no mass.
    """
    spatial = [one.default_spatial_inertia() for one in bodies]
    masses = np.array([one.get_mass() for one in spatial])
    if not masses.sum() > 0.0:
        names = ", ".join(f"'{one.name()}'" for one in bodies)
        raise ValueError(f"the mass of body {names} of the MultibodyPlant must be positive, got {masses.sum():g}")
    centers = np.array([one.get_com() for one in spatial])
    about_centers = [one.Shift(one.get_com()).CalcRotationalInertia().CopyToFullMatrix3() for one in spatial]
    return Bodies(masses, centers, np.array(about_centers))


def floating_base(plant: MultibodyPlant, body: RigidBody) -> RigidBody:
    """Returns the body by which a vehicle floats freely in the world.

    Raises:
        ValueError: when a joint or a weld holds the vehicle to the world.
    """
    for one in connected_bodies(plant, body):
        if one.is_floating_base_body():
            return one
    raise ValueError(f"body '{body.name()}' must be free, but a joint holds it to the world; leave that joint out")


def find_joint(plant: MultibodyPlant, name: str) -> Joint:
    """Returns the joint of a name, which must have one degree of freedom.

    Raises:
        ValueError: when there is none such.
    """
    single = [joint for joint in _joints(plant) if joint.num_velocities() == 1]
    found = [joint for joint in single if joint.name() == name]
    if len(found) != 1:
        known = sorted(joint.name() for joint in single)
        says = "is the name of more than one joint" if found else "is no joint of one degree of freedom in the model"
        raise ValueError(f"'{name}' {says}; joints are: {', '.join(known) or 'none'}")
    return found[0]


def require_joint_limits(joint: Joint, position: float) -> None:
    """Raises ValueError where a position is beyond the limits of a joint of one degree of freedom."""
    lower, upper = joint.position_lower_limits()[0], joint.position_upper_limits()[0]
    if not lower <= position <= upper:
        raise ValueError(f"{position:g} is beyond the limits of joint '{joint.name()}', {lower:g} to {upper:g}")


def start_state(
    plant: MultibodyPlant,
    body: RigidBody,
    joint_positions: Mapping[str, float],
    joint_rates: Mapping[str, float],
    body_rate: Array,
) -> tuple[Array, Array]:
    """Computes generalized positions and velocities: frames aligned, center of mass at rest at the origin.

    Args:
        plant: finalized.
        body: whose frame is the vehicle's.
        joint_positions, joint_rates: of joints, by name; default: those of the model, and at rest.
        body_rate: of the body, rad/s, body axes, shape (3,).

    Returns:
        Generalized positions and velocities.

    Raises:
        ValueError: when there is no such joint, or the vehicle is not free.
    """
    context, base, bodies = plant.CreateDefaultContext(), floating_base(plant, body), connected_bodies(plant, body)
    state = plant.GetPositionsAndVelocities(context)
    for name, position in joint_positions.items():
        state[find_joint(plant, name).position_start()] = position
    for name, joint_rate in joint_rates.items():
        state[plant.num_positions() + find_joint(plant, name).velocity_start()] = joint_rate
    plant.SetPositionsAndVelocities(context, state)
    properties = mass_properties_of(bodies)
    plant.SetFreeBodyPose(context, base, RigidTransform())
    pose = plant.EvalBodyPoseInWorld(context, body).inverse()
    plant.SetFreeBodyPose(context, base, pose)
    center = composite_body(properties, _body_places(plant, context, bodies)).center_of_mass
    plant.SetFreeBodyPose(context, base, RigidTransform(pose.rotation(), pose.translation() - center))

    velocities, first = plant.GetVelocities(context), base.floating_velocities_start_in_v()
    turning, _ = _body_velocities(plant, context, bodies)
    velocities[first : first + 3] = body_rate - turning[0]
    plant.SetVelocities(context, velocities)
    drift = center_velocity(properties, _body_places(plant, context, bodies), *_body_velocities(plant, context, bodies))
    velocities[first + 3 : first + 6] = -drift
    return plant.GetPositions(context), velocities


def _body_velocities(plant: MultibodyPlant, context: Any, bodies: tuple[RigidBody, ...]) -> tuple[Array, Array]:
    """Computes angular velocities and velocities of bodies in the world, shape (n, 3) each."""
    velocities = [plant.EvalBodySpatialVelocityInWorld(context, body) for body in bodies]
    return np.array([body.rotational() for body in velocities]), np.array([body.translational() for body in velocities])


def _body_places(plant: MultibodyPlant, context: Any, bodies: tuple[RigidBody, ...]) -> BodyPlaces:
    """Returns orientations and origins of bodies in the world."""
    return pack_poses([plant.EvalBodyPoseInWorld(context, one) for one in bodies])


def pack_poses(poses: Sequence[RigidTransform]) -> BodyPlaces:
    """Packs poses into arrays of rotation matrices and origins."""
    return BodyPlaces(
        np.array([pose.rotation().matrix() for pose in poses]), np.array([pose.translation() for pose in poses])
    )
