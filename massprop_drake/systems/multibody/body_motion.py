"""Motion and mass properties of a vehicle that is a MultibodyPlant, as its sensors and its truth need them."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import BodyIndex, RigidBody
from pydrake.systems.framework import LeafSystem

from massprop_drake.maths.mass_properties import MassProperties
from massprop_drake.maths.vehicle.attached_bodies import BodyPlaces, center_velocity, composite_body, sensed_derivatives
from massprop_drake.maths.vehicle.rigid_body import (
    MASS,
    N_STATE,
    ORIGIN_VELOCITY,
    POSITION,
    QUATERNION,
    RATE,
    SPIN_INTEGRAL,
    STRUCTURE,
    VELOCITY,
    pack_structure,
)
from massprop_drake.systems.caching import Cached, declare_output
from massprop_drake.systems.multibody.plants import (
    connected_bodies,
    find_body,
    mass_properties_of,
    pack_poses,
    require_continuous,
)


class _Configuration(NamedTuple):
    """Configuration of the bodies: pose of the carrier, places of all in its frame, and the composite body."""

    carrier: RigidTransform
    places: BodyPlaces
    properties: MassProperties


_INTEGRALS = slice(ORIGIN_VELOCITY.start, SPIN_INTEGRAL.stop)
FROM_PLANT = ("body_poses", "body_spatial_velocities", "body_spatial_accelerations")  # ports of a MultibodyPlant


class BodyMotion(LeafSystem):
    """Turns the motion of a MultibodyPlant's bodies into the ports of `RigidBodyPlant`, for sensors and truth.

    Rate, attitude and the integrals that accelerometers gather are those of one body, whose frame is the vehicle
    frame. Mass, center of mass with its position and velocity, and inertia are those of all bodies that joints hold
    together with it, as they stand at the moment. Specific force is acceleration less the plant's gravity.

    Ports:
        body_poses, body_spatial_velocities, body_spatial_accelerations (in): of the plant. Required.
        body_state (out, 23), structure (out, 9), mass_properties (out, 10): see `RigidBodyPlant`. No feedthrough
            from accelerations, and so none from the jets.

    State: integrals (9), continuous: those of specific force and of the spin, as `body_state` has them.

    Args:
        plant: continuous and finalized.
        body: name, index or the body itself.

    Raises:
        ValueError: when the plant is discrete, has no such body, or the bodies no mass.

    Assumptions and limitations: the bodies' mass properties are the plant's default parameters.
    """

    def __init__(self, plant: MultibodyPlant, body: str | RigidBody | BodyIndex):
        super().__init__()
        self.set_name("body_motion")
        require_continuous(plant)
        carrier = find_body(plant, body)
        bodies = connected_bodies(plant, carrier)
        self._bodies = mass_properties_of(bodies)
        self._carrier, *self._others = (int(part.index()) for part in bodies)
        has_gravity = plant.is_gravity_enabled(carrier.model_instance())
        self._gravity = np.array(plant.gravity_field().gravity_vector()) if has_gravity else np.zeros(3)

        models = {name: plant.GetOutputPort(name).Allocate() for name in FROM_PLANT}
        ports = [self.DeclareAbstractInputPort(name, model) for name, model in models.items()]
        self._poses, self._velocities, self._accelerations = ports
        self.DeclareContinuousState(SPIN_INTEGRAL.stop - ORIGIN_VELOCITY.start)
        poses, velocities, _ = (port.ticket() for port in ports)
        self._configuration = Cached(self, "composite", self._compute_configuration, {poses})
        motion = {self._configuration.ticket, velocities, self.xc_ticket()}
        declare_output(self, "body_state", N_STATE, self._calc_body_state, motion)
        configuration = {self._configuration.ticket}
        declare_output(self, "structure", STRUCTURE.size, self._calc_structure, configuration)
        declare_output(self, "mass_properties", 10, self._calc_properties, configuration)

    def _compute_configuration(self, context: Any) -> _Configuration:
        """Computes pose of the carrier, all bodies' places in its frame, and the composite mass properties."""
        poses = self._poses.Eval(context)
        carrier = poses[self._carrier]
        to_carrier = carrier.inverse()
        others = [to_carrier @ poses[index] for index in self._others]
        places = pack_poses([RigidTransform(), *others])  # that of the carrier exactly
        return _Configuration(carrier, places, composite_body(self._bodies, places))

    def _calc_body_state(self, context: Any) -> Any:
        """Computes the body's state as `RigidBodyPlant` has it, shape (23,)."""
        carrier, places, properties = self._configuration.get(context)
        rotation, velocities = carrier.rotation().matrix(), self._velocities.Eval(context)
        twists = [velocities[index] for index in (self._carrier, *self._others)]
        rates, speeds = (np.array([getattr(one, part)() for one in twists]) for part in ("rotational", "translational"))
        state = np.empty(N_STATE)
        state[QUATERNION] = carrier.rotation().ToQuaternion().wxyz()
        state[RATE] = velocities[self._carrier].rotational() @ rotation
        state[POSITION] = carrier @ properties.center_of_mass
        state[VELOCITY] = rotation @ center_velocity(self._bodies, places, rates @ rotation, speeds @ rotation)
        state[MASS] = properties.mass
        state[_INTEGRALS] = context.get_continuous_state_vector().CopyToVector()
        return state

    def _calc_structure(self, context: Any) -> Any:
        """Computes inertia and center of mass of all bodies, packed as `STRUCTURE`, shape (9,)."""
        return pack_structure(self._configuration.get(context).properties)

    def _calc_properties(self, context: Any) -> Any:
        """Computes the true ten parameters of all bodies together, shape (10,)."""
        return self._configuration.get(context).properties.vector()

    def DoCalcTimeDerivatives(self, context: Any, derivatives: Any) -> None:  # noqa: N802 (overrides Drake's)
        """Computes the time derivatives of the integrals that accelerometers read."""
        index = self._carrier
        rotation = self._poses.Eval(context)[index].rotation().matrix()
        rate = self._velocities.Eval(context)[index].rotational()
        acceleration = self._accelerations.Eval(context)[index].translational()
        rates = sensed_derivatives(rotation, rate, acceleration, self._gravity)
        derivatives.get_mutable_vector().SetFromVector(rates)
