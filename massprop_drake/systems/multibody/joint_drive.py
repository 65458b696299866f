"""Drives of a MultibodyPlant's joints."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import LeafSystem

from massprop_drake.maths.linear_algebra import Array
from massprop_drake.maths.vehicle.joint_moves import Move, drive_force, effective_inertias, reference
from massprop_drake.systems.multibody.plants import joint_named


class _Driven(NamedTuple):
    """A driven joint: its places in state and velocities, where it starts, what it does and moves."""

    position_at: int
    velocity_at: int
    start: float
    moves: Sequence[Move]
    inertia: float


class JointDrive(LeafSystem):
    """Holds joints where they start and moves them when told, each by a drive of its own.

    The drive is critically damped, with feedforward; see `maths.vehicle.joint_moves`. Its inertia is that which the
    joint moves at the start, so the closed loop's frequency changes somewhat as an arm unfolds.

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
        self._frequency_hz, self._nv = frequency_hz, plant.num_velocities()
        context = plant.CreateDefaultContext()
        plant.SetPositions(context, positions)
        inverse = np.linalg.inv(plant.CalcMassMatrix(context))
        joints = [joint_named(plant, name) for name in moves]
        inertias = effective_inertias(inverse, [joint.velocity_start() for joint in joints])
        self._driven = [
            _Driven(
                joint.position_start(),
                joint.velocity_start(),
                float(positions[joint.position_start()]),
                told,
                inertia,
            )
            for joint, told, inertia in zip(joints, moves.values(), inertias, strict=True)
        ]
        self._nq = plant.num_positions()
        state = self._state = self.DeclareVectorInputPort("state", plant.num_multibody_states())
        needs = {self.input_port_ticket(state.get_index()), self.time_ticket()}
        self.DeclareVectorOutputPort("generalized_force", self._nv, self._calc, prerequisites_of_calc=needs)

    def _calc(self, context: Any, output: Any) -> None:
        state, forces = self._state.Eval(context), np.zeros(self._nv)
        for joint in self._driven:
            wanted = reference(joint.start, joint.moves, context.get_time())
            position, rate = state[joint.position_at], state[self._nq + joint.velocity_at]
            forces[joint.velocity_at] = drive_force(wanted, position, rate, joint.inertia, self._frequency_hz)
        output.SetFromVector(forces)
