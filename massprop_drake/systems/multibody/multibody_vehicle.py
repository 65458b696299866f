"""A MultibodyPlant with the ports of `RigidBodyPlant`: on its own, or as the bridge to one of another diagram."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import BodyIndex, RigidBody
from pydrake.systems.framework import Diagram, DiagramBuilder, LeafSystem
from pydrake.systems.primitives import MatrixGain

from massprop_drake.errors import InputError
from massprop_drake.maths.linear_algebra import Array
from massprop_drake.maths.vehicle.joint_moves import Move
from massprop_drake.systems.multibody.body_motion import FROM_PLANT, BodyMotion
from massprop_drake.systems.multibody.body_wrench import BodyWrench
from massprop_drake.systems.multibody.joint_drive import JointDrive
from massprop_drake.systems.multibody.plants import find_body, start_state

TRUTH = ("body_state", "structure", "mass_properties")


class BodyBridge(Diagram):
    """Connects a body of a MultibodyPlant with the parts of a vehicle diagram.

    Ports: wrench (in, 7), with wheels wheels (in, 6), and spatial_forces (out) as `BodyWrench`; body_poses,
    body_spatial_velocities, body_spatial_accelerations (in), body_state (out, 23), structure (out, 9), mass_properties
    (out, 10) as `BodyMotion`.

    Args:
        plant: continuous and finalized.
        body: name, index or the body itself; its frame is the vehicle frame.
        wheels: whether it carries reaction wheels.

    Raises:
        ValueError: when the plant is discrete, has no such body, or the bodies no mass.
    """

    def __init__(self, plant: MultibodyPlant, body: str | RigidBody | BodyIndex, *, wheels: bool = False):
        super().__init__()
        builder = DiagramBuilder()
        force = builder.AddSystem(BodyWrench(plant, body, wheels=wheels))
        motion = builder.AddSystem(BodyMotion(plant, body))
        for name in ("wrench", *(("wheels",) if wheels else ())):
            builder.ExportInput(force.GetInputPort(name), name)
        for name in FROM_PLANT:
            of_plant = builder.ExportInput(motion.GetInputPort(name), name)
            if force.HasInputPort(name):
                builder.ConnectInput(of_plant, force.GetInputPort(name))
        builder.ExportOutput(force.GetOutputPort("spatial_forces"), "spatial_forces")
        for name in TRUTH:
            builder.ExportOutput(motion.GetOutputPort(name), name)
        builder.BuildInto(self)
        self.set_name("body_bridge")


class MultibodyVehicle(Diagram):
    """A vehicle of several bodies, with the ports of a continuous `RigidBodyPlant`.

    Ports:
        wrench (in, 7), with wheels wheels (in, 6): see `BodyWrench`. Required.
        body_state (out, 23), structure (out, 9), mass_properties (out, 10): see `BodyMotion`.
        joint_positions (out, n): of the joints that are shown, rad, ft or m; where there are any.

    Args:
        plant: continuous and finalized; it becomes part of the diagram.
        body: name; its frame is the vehicle frame.
        positions, rates: of joints at the start, by name, rad, ft or m and per s.
        rate: of the body at the start, rad/s, body axes, shape (3,).
        moves: of driven joints by name; all other joints are free.
        drive_frequency_hz: see `JointDrive`.
        shown: names of joints.
        wheels: whether the body carries reaction wheels.

    Raises:
        ValueError: when the plant is discrete, there is no such body or joint, or the vehicle is not free.
    """

    def __init__(
        self,
        plant: MultibodyPlant,
        body: str,
        *,
        positions: Mapping[str, float],
        rates: Mapping[str, float],
        rate: Array,
        moves: Mapping[str, Sequence[Move]],
        drive_frequency_hz: float,
        shown: Sequence[str] = (),
        wheels: bool = False,
    ):
        super().__init__()
        carrier = find_body(plant, body)
        start, self._velocities = start_state(plant, carrier, positions, rates, rate)
        plant.SetDefaultPositions(start)
        builder = DiagramBuilder()
        bridge = builder.AddSystem(BodyBridge(plant, carrier, wheels=wheels))
        self._plant = builder.AddNamedSystem("plant", plant)
        for name in FROM_PLANT:
            builder.Connect(plant.GetOutputPort(name), bridge.GetInputPort(name))
        builder.Connect(bridge.GetOutputPort("spatial_forces"), plant.get_applied_spatial_force_input_port())
        if moves:
            drive = builder.AddSystem(JointDrive(plant, start, moves, frequency_hz=drive_frequency_hz))
            builder.Connect(plant.get_state_output_port(), drive.GetInputPort("state"))
            builder.Connect(drive.GetOutputPort("generalized_force"), plant.get_applied_generalized_force_input_port())
        if self._velocities.any():
            check = builder.AddSystem(_StartCheck(plant.num_positions(), plant.num_velocities()))
            builder.Connect(plant.get_state_output_port(), check.get_input_port())
        for name in ("wrench", *(("wheels",) if wheels else ())):
            builder.ExportInput(bridge.GetInputPort(name), name)
        for name in TRUTH:
            builder.ExportOutput(bridge.GetOutputPort(name), name)
        joints = [plant.GetJointByName(name) for name in shown]
        places = [joint.position_start() + n for joint in joints for n in range(joint.num_positions())]
        if places:
            selection = np.zeros((len(places), plant.num_multibody_states()))
            selection[range(len(places)), places] = 1.0
            selector = builder.AddNamedSystem("joint_positions", MatrixGain(selection))
            builder.Connect(plant.get_state_output_port(), selector.get_input_port())
            builder.ExportOutput(selector.get_output_port(), "joint_positions")
        builder.BuildInto(self)
        self.set_name("multibody_vehicle")

    def set_initial_velocities(self, root: Any) -> None:
        """Writes the velocities at the start into a context: in a MultibodyPlant's default one, all are zero.

        Args:
            root: context of the diagram that this one is in.
        """
        context = self._plant.GetMyMutableContextFromRoot(root)
        self._plant.SetVelocities(context, self._velocities)


class _StartCheck(LeafSystem):
    """System that refuses to start at rest where a vehicle moves at the start.

    Ports: state (in, n_positions + n_velocities): of the plant. Required.

    Args:
        n_positions, n_velocities: of the plant.
    """

    def __init__(self, n_positions: int, n_velocities: int):
        super().__init__()
        self.set_name("start_check")
        self._n_positions = n_positions
        self._state = self.DeclareVectorInputPort("state", n_positions + n_velocities)
        self.DeclareInitializationPublishEvent(self._require_motion)

    def _require_motion(self, context: Any) -> None:
        """Raises InputError when all velocities are zero at the start."""
        if context.get_time() == 0.0 and not self._state.Eval(context)[self._n_positions :].any():
            raise InputError(
                "the multibody vehicle moves at the start, but the context has all velocities zero: before Initialize, "
                "call massprop_drake.diagrams.multibody.set_initial_velocities(diagram, context)"
            )
