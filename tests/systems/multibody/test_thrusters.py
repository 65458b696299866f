"""Jets of a vehicle file on a body of a MultibodyPlant."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from multibody_probe import arm, tumble
from pydrake.multibody.tree import JacobianWrtVariable
from pydrake.systems.framework import DiagramBuilder

from massprop_drake import load_vehicle
from massprop_drake.maths.vehicle.true_failures import Failure, FailureKind
from massprop_drake.systems import Thrusters

SERVICER = load_vehicle("servicer")
ON = np.eye(16)[5]  # XP2: 1 N along x at (-0.5, 0.36, 0.15)
WEAK = Failure(5, FailureKind.DEGRADED, -1.0, 9.0, amount=0.25)


@pytest.mark.parametrize(
    ("time_s", "given", "thrust"),
    [
        (0.5, {}, 1.0),  # long after its lag
        (-0.1 + 0.015, {}, 1.0 - np.exp(-1.0)),  # the state of the jets, all off, is that of t = -0.1 s
        (0.5, {"factors": 1.0 + 0.1 * ON}, 1.1),
        (0.5, {"failures": (WEAK,)}, 0.25),
    ],
)
def test_a_jet_pushes_where_it_is_and_along_its_direction(time_s: float, given: dict[str, Any], thrust: float) -> None:
    """What it adds to the generalized accelerations of a tumbling plant is M^-1 J^T F."""
    plant, builder = arm(), DiagramBuilder()
    builder.AddSystem(plant)
    dut = builder.AddSystem(Thrusters(SERVICER, plant, "bus", **given))
    # the force does not wait for the coming command
    command, forces = dut.GetInputPort("command"), dut.GetOutputPort("spatial_forces")
    assert not dut.HasDirectFeedthrough(command.get_index(), forces.get_index())
    assert command.size() == dut.GetOutputPort("thrust").size() == 16
    builder.Connect(plant.GetOutputPort("body_poses"), dut.GetInputPort("body_poses"))
    builder.Connect(forces, plant.get_applied_spatial_force_input_port())
    builder.ExportInput(dut.GetInputPort("held_command"), "held_command")
    diagram = builder.Build()
    root = diagram.CreateDefaultContext()
    context = tumble(plant, plant.GetMyMutableContextFromRoot(root))
    root.SetTime(time_s)
    rates = []
    for told in (ON, 0.0 * ON):
        diagram.GetInputPort("held_command").FixValue(root, told)
        rates.append(plant.EvalTimeDerivatives(context).CopyToVector()[plant.num_positions() :])
    bus = plant.GetBodyByName("bus")
    jacobian = plant.CalcJacobianTranslationalVelocity(
        context, JacobianWrtVariable.kV, bus.body_frame(), np.array([[-0.5], [0.36], [0.15]]), plant.world_frame(),
        plant.world_frame(),
    )  # fmt: skip
    force = plant.EvalBodyPoseInWorld(context, bus).rotation() @ np.array([thrust, 0.0, 0.0])
    expected = np.linalg.solve(plant.CalcMassMatrix(context), jacobian.T @ force)
    np.testing.assert_allclose(rates[0] - rates[1], expected, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"factors": np.ones(3)}, r"thrusters: factors: must be a vector of 16 numbers, got shape \(3,\)"),
        ({"factors": np.full(16, np.nan)}, r"thrusters: factors: must be finite, got \[nan"),
        ({"body": 1}, r"body: must be the name, the BodyIndex or the body itself, got 1"),
    ],
)
def test_what_does_not_fit_is_refused(given: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Thrusters(SERVICER, arm(), **{"body": "bus", **given})
