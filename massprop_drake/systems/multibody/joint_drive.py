"""Drives of a MultibodyPlant's joints."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import LeafSystem

from massprop_drake.maths.linear_algebra import Array
from massprop_drake.maths.vehicle.joint_moves import Move, drive_forces, driven_inertia, joint_reference
from massprop_drake.systems.caching import declare_output
from massprop_drake.systems.multibody.plants import find_joint


class JointDrive(LeafSystem):
    """Holds joints where they start, and moves them when commanded.

    The drives are critically damped, with feedforward; see `maths.vehicle.joint_moves`. They are told the inertia that
    the joints move at the start, so that the frequency of the closed loop changes as an arm unfolds.

    Ports:
        state (in, nq + nv): of the plant. Required.
        generalized_force (out, nv): for the plant's `applied_generalized_force`.

    State: none.

    Args:
        plant: finalized.
        positions: generalized positions at the start, shape (nq,).
        moves: of each driven joint by name, in the order of time.
        frequency_hz: of the drives' closed loop, Hz.

    Raises:
        ValueError: when there is no such joint.
    """

    def __init__(
        self, plant: MultibodyPlant, positions: Array, moves: Mapping[str, Sequence[Move]], *, frequency_hz: float
    ):
        super().__init__()
        self.set_name("joint_drive")
        self._frequency_hz, self._size = frequency_hz, plant.num_velocities()
        joints = [find_joint(plant, name) for name in moves]
        self._velocities = [joint.velocity_start() for joint in joints]  # places of the driven joints among them
        self._positions = [joint.position_start() for joint in joints]
        self._rates = [plant.num_positions() + place for place in self._velocities]  # in the state
        context = plant.CreateDefaultContext()
        plant.SetPositions(context, positions)
        self._inertia = driven_inertia(plant.CalcMassMatrix(context), self._velocities)
        self._moves = list(zip(positions[self._positions].tolist(), moves.values(), strict=True))
        state = self._state = self.DeclareVectorInputPort("state", plant.num_multibody_states())
        needs = {state.ticket(), self.time_ticket()}
        declare_output(self, "generalized_force", self._size, self._calc_forces, needs)

    def _calc_forces(self, context: Any) -> Any:
        """Computes the generalized forces that hold or move joints as commanded, shape (n_velocities,)."""
        state, time_s, forces = self._state.Eval(context), context.get_time(), np.zeros(self._size)
        references = [joint_reference(start, moves, time_s) for start, moves in self._moves]
        positions, rates = state[self._positions], state[self._rates]
        forces[self._velocities] = drive_forces(references, positions, rates, self._inertia, self._frequency_hz)
        return forces
