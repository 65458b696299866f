"""A plant with an arm, as a user has one of his own."""

from __future__ import annotations

from importlib import resources
from typing import Any

import numpy as np
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant

ARM = resources.files("massprop_drake.scenarios").joinpath("models", "servicer_arm.sdf").read_text(encoding="utf-8")


def arm(gravity: tuple[float, float, float] = (0.0, 0.0, 0.0), *, time_step: float = 0.0) -> MultibodyPlant:
    """The servicer with its arm, finalized."""
    plant = MultibodyPlant(time_step)
    Parser(plant).AddModelsFromString(ARM, "sdf")
    plant.mutable_gravity_field().set_gravity_vector(np.array(gravity))
    plant.Finalize()
    return plant


def tumble(plant: MultibodyPlant, context: Any) -> Any:
    """Lets every joint stand and move at random."""
    random = np.random.default_rng(2)
    positions = random.normal(size=plant.num_positions())
    positions[:4] /= np.linalg.norm(positions[:4])
    plant.SetPositions(context, positions)
    plant.SetVelocities(context, random.normal(size=plant.num_velocities()))
    return context
