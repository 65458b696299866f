"""The jets of a vehicle on a body of a MultibodyPlant."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import BodyIndex, RigidBody
from pydrake.systems.framework import Diagram, DiagramBuilder

from massprop_drake.maths.linear_algebra import Array
from massprop_drake.maths.vehicle.true_failures import Failure
from massprop_drake.systems.arguments import require_vector
from massprop_drake.systems.multibody.body_wrench import BodyWrench
from massprop_drake.systems.vehicle.reaction_jets_system import ReactionJets


class _StatedJets(Protocol):
    """Jets of a vehicle as stated, see `inputs.vehicle_file.Vehicle`."""

    @property
    def wrenches(self) -> Array:
        """Torque about the vehicle origin and force at full thrust, shape (n_jets, 6)."""

    @property
    def time_constants_s(self) -> Array:
        """Time constants of build-up and tail-off, s, shape (n_jets,)."""

    @property
    def mass_flows(self) -> Array:
        """Mass flows at full thrust, shape (n_jets,)."""

    @property
    def sample_period_s(self) -> float:
        """Sample period of the commands, s."""


class Thrusters(Diagram):
    """Applies the jets of a vehicle as one force on a body of a MultibodyPlant.

    Ports:
        command (in, n_jets), held_command (in, n_jets), closed (in, n_jets), held_closed (in, n_jets), seed (in, 1):
            see `ReactionJets`; held_command alone is required.
        body_poses (in): of the plant. Required.
        spatial_forces (out): for the plant's `applied_spatial_force`; where it has others, too, by way of an
            `ExternallyAppliedSpatialForceMultiplexer`.
        thrust (out, n_jets): mean force over the coming sample, see `ReactionJets`; needs command.

    Timing: as `ReactionJets`.

    Args:
        vehicle: with the jets, such as `load_vehicle("servicer")`. Its units are the plant's: m, kg, N for `si`,
            ft, slug, lbf for `us`, to which a gravity of the plant must conform.
        plant: continuous and finalized.
        body: name, index or the body itself; its frame is the vehicle frame.
        factors: true over nominal thrust of each jet, shape (n_jets,); default 1.
        failures: of jets, see `maths.vehicle.true_failures`.
        seed: of intermittent failures.

    Raises:
        ValueError: when the plant is discrete, has no such body, or factors are not one for each jet.

    Assumptions and limitations: firing uses up no mass of the plant.
    """

    def __init__(
        self,
        vehicle: _StatedJets,
        plant: MultibodyPlant,
        body: str | RigidBody | BodyIndex,
        *,
        factors: Array | None = None,
        failures: tuple[Failure, ...] = (),
        seed: int = 0,
    ):
        super().__init__()
        stated = np.ones(len(vehicle.wrenches)) if factors is None else factors
        scales = require_vector("thrusters: factors", stated, len(vehicle.wrenches))
        wrenches = scales[:, None] * np.column_stack([vehicle.wrenches, vehicle.mass_flows])
        builder = DiagramBuilder()
        force = builder.AddSystem(BodyWrench(plant, body))
        jets = builder.AddSystem(
            ReactionJets(
                wrenches=wrenches,
                time_constants_s=vehicle.time_constants_s,
                period_s=vehicle.sample_period_s,
                failures=failures,
                seed=seed,
            )
        )
        builder.Connect(jets.GetOutputPort("wrench"), force.GetInputPort("wrench"))
        for name in ("command", "held_command", "closed", "held_closed", "seed"):
            builder.ExportInput(jets.GetInputPort(name), name)
        builder.ExportInput(force.GetInputPort("body_poses"), "body_poses")
        builder.ExportOutput(force.GetOutputPort("spatial_forces"), "spatial_forces")
        builder.ExportOutput(jets.GetOutputPort("thrust"), "thrust")
        builder.BuildInto(self)
        self.set_name("thrusters")
