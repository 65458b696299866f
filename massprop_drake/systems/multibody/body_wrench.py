"""The wrench of a vehicle's jets as a force on a body of a MultibodyPlant."""

from __future__ import annotations

from typing import Any

import numpy as np
from pydrake.multibody.math import SpatialForce
from pydrake.multibody.plant import ExternallyAppliedSpatialForce, MultibodyPlant
from pydrake.multibody.tree import BodyIndex, RigidBody
from pydrake.systems.framework import LeafSystem

from massprop_drake.maths.vehicle.rigid_body import N_WRENCH
from massprop_drake.systems.layouts import WRENCH
from massprop_drake.systems.multibody.plants import find_body, require_continuous


class BodyWrench(LeafSystem):
    """Applies a wrench in body axes to a body of a MultibodyPlant, whose frame is the vehicle frame.

    Ports:
        wrench (in, 7): torque about the vehicle origin (3), force (3), body axes, and mass flow, which a
            MultibodyPlant cannot follow and which plays no part. Required.
        body_poses (in, list of RigidTransform): of the plant. Required.
        wheels (in, 6), body_spatial_velocities (in, list of SpatialVelocity), with wheels: see `ReactionWheels` and the
            plant. Required. Wheels of the momentum h turn the body by -dh/dt - w x h, w its rate.
        spatial_forces (out, list of one ExternallyAppliedSpatialForce): for the plant's `applied_spatial_force`.

    State: none.

    Args:
        plant: continuous and finalized.
        body: name, index or the body itself.
        wheels: whether it carries reaction wheels, locked in the plant's mass properties.

    Raises:
        ValueError: when the plant is discrete or has no such body.
    """

    def __init__(self, plant: MultibodyPlant, body: str | RigidBody | BodyIndex, *, wheels: bool = False):
        super().__init__()
        self.set_name("body_wrench")
        require_continuous(plant)
        index = self._index = find_body(plant, body).index()
        self._place = int(index)
        wrench = self._wrench = self.DeclareVectorInputPort("wrench", N_WRENCH)
        model = plant.GetOutputPort("body_poses").Allocate()
        poses = self._poses = self.DeclareAbstractInputPort("body_poses", model)
        model = plant.get_applied_spatial_force_input_port().Allocate()
        read = [wrench, poses]
        self._carries = wheels
        if wheels:
            velocities = plant.GetOutputPort("body_spatial_velocities").Allocate()
            self._wheels = self.DeclareVectorInputPort("wheels", 6)
            self._velocities = self.DeclareAbstractInputPort("body_spatial_velocities", velocities)
            read += [self._wheels, self._velocities]
        needs = {port.ticket() for port in read}
        self.DeclareAbstractOutputPort("spatial_forces", model.Clone, self._calc_force, prerequisites_of_calc=needs)

    def _calc_force(self, context: Any, output: Any) -> None:
        """Computes the spatial force on the body from the wrench port, with the reaction of the wheels."""
        wrench = WRENCH.read(self._wrench.Eval(context))
        rotation = self._poses.Eval(context)[self._place].rotation()
        force = ExternallyAppliedSpatialForce()
        force.body_index = self._index
        force.p_BoBq_B = np.zeros(3)
        torque = rotation @ wrench.torque
        if self._carries:
            momentum, momentum_rate = np.split(self._wheels.Eval(context), 2)
            rate = self._velocities.Eval(context)[self._place].rotational()
            torque = torque - rotation @ momentum_rate - np.cross(rate, rotation @ momentum)
        force.F_Bq_W = SpatialForce(torque, rotation @ wrench.force)
        output.set_value([force])
