"""The body of a scenario that is a MultibodyPlant."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from pydrake.multibody.plant import MultibodyPlant

from massprop_drake.inputs import true_params
from massprop_drake.inputs.model_file import attribute_errors_to, model_joints, model_kind
from massprop_drake.inputs.scenario import Scenario
from massprop_drake.inputs.true_blocks import JointMove, JointStart, MultibodyBlock
from massprop_drake.systems.multibody.multibody_vehicle import MultibodyVehicle
from massprop_drake.systems.multibody.plants import (
    find_body,
    find_joint,
    floating_base,
    parse_plant,
    require_joint_limits,
    require_motion,
)


def build_body(block: MultibodyBlock, *, wheels: bool = False) -> MultibodyVehicle:
    """Makes the multibody system of a scenario's block, with the ports of a `RigidBodyPlant`.

    Args:
        block: of the scenario.
        wheels: whether its vehicle has reaction wheels.

    Raises:
        InputError: when Drake cannot make a plant of its model, or body and joints that it names are not in it.
    """
    plant = _parse_checked_plant(block)
    with attribute_errors_to("plant"):
        return MultibodyVehicle(
            plant,
            block.body,
            positions={joint.joint: joint.position for joint in block.joints},
            rates={joint.joint: joint.rate for joint in block.joints},
            rate=np.array(block.initial_rate),
            moves=true_params.joint_moves(block),
            drive_frequency_hz=block.drive_frequency_hz,
            shown=[joint.name for joint in model_joints(block.model)],
            wheels=wheels,
        )


def _parse_checked_plant(block: MultibodyBlock) -> MultibodyPlant:
    """Makes the plant of a block's model; raises InputError where a body or joint of the block is not in it."""
    with attribute_errors_to("plant.model"):
        plant = parse_plant(block.model, model_kind(block.model))
    with attribute_errors_to("plant.body"):
        floating_base(plant, find_body(plant, block.body))
    entries: dict[str, Sequence[JointStart | JointMove]] = {"joints": block.joints, "moves": block.moves}
    for name, index, entry in ((name, *numbered) for name, of in entries.items() for numbered in enumerate(of)):
        with attribute_errors_to(f"plant.{name}[{index}].joint"):
            joint = find_joint(plant, entry.joint)
        with attribute_errors_to(f"plant.{name}[{index}].position"):
            require_joint_limits(joint, entry.position)
    with attribute_errors_to("plant.model"):
        require_motion(plant)
    return plant


def require_model(scenario: Scenario) -> None:
    """Raises InputError where a scenario has a multibody plant that Drake cannot fly.

    Raises:
        InputError: as `build_body`.
    """
    if isinstance(scenario.plant, MultibodyBlock):
        build_body(scenario.plant)
