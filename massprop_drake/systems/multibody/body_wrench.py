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
from massprop_drake.systems.multibody.plants import body_of, require_continuous


class BodyWrench(LeafSystem):
    """Applies a wrench in body axes to a body of a MultibodyPlant, whose frame is the vehicle frame.

    Ports:
        wrench (in, 7): torque about the vehicle origin (3), force (3), body axes, and mass flow, which a
            MultibodyPlant cannot follow and which plays no part. Required.
        body_poses (in, list of RigidTransform): of the plant. Required.
        spatial_forces (out, list of one ExternallyAppliedSpatialForce): for the plant's `applied_spatial_force`.

    State: none.

    Args:
        plant: continuous and finalized.
        body: name, index or the body itself.

    Raises:
        ValueError: when the plant is discrete or has no such body.
    """

    def __init__(self, plant: MultibodyPlant, body: str | RigidBody | BodyIndex):
        super().__init__()
        self.set_name("body_wrench")
        require_continuous(plant)
        index = self._index = body_of(plant, body).index()
        self._place = int(index)
        wrench = self._wrench = self.DeclareVectorInputPort("wrench", N_WRENCH)
        model = plant.GetOutputPort("body_poses").Allocate()
        poses = self._poses = self.DeclareAbstractInputPort("body_poses", model)
        model = plant.get_applied_spatial_force_input_port().Allocate()
        needs = {self.input_port_ticket(port.get_index()) for port in (wrench, poses)}
        self.DeclareAbstractOutputPort("spatial_forces", model.Clone, self._calc, prerequisites_of_calc=needs)

    def _calc(self, context: Any, output: Any) -> None:
        wrench = WRENCH.read(self._wrench.Eval(context))
        rotation = self._poses.Eval(context)[self._place].rotation()
        force = ExternallyAppliedSpatialForce()
        force.body_index = self._index
        force.p_BoBq_B = np.zeros(3)
        force.F_Bq_W = SpatialForce(rotation @ wrench.torque, rotation @ wrench.force)
        output.set_value([force])
