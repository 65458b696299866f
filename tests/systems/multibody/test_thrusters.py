"""Jets of a vehicle file on a body of a MultibodyPlant."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from multibody_probe import arm, tumbling
from pydrake.multibody.tree import JacobianWrtVariable
from pydrake.systems.framework import DiagramBuilder

from massprop_drake import load_vehicle
from massprop_drake.maths.vehicle.true_failures import Failure, FailureKind
from massprop_drake.systems.multibody import BodyWrench, Thrusters

SERVICER = load_vehicle("servicer")
ON = np.eye(16)[5]  # XP2: 1 N along x at (-0.5, 0.36, 0.15)


def _accelerations(*, time_s: float, **given: Any) -> tuple[np.ndarray, np.ndarray, Any]:
    """What jet 5 adds to the generalized accelerations of a tumbling plant, with the plant and its context."""
    plant, builder = arm(), DiagramBuilder()
    builder.AddSystem(plant)
    dut = builder.AddSystem(Thrusters(SERVICER, plant, "bus", **given))
    builder.Connect(plant.GetOutputPort("body_poses"), dut.GetInputPort("body_poses"))
    builder.Connect(dut.GetOutputPort("spatial_forces"), plant.get_applied_spatial_force_input_port())
    builder.ExportInput(dut.GetInputPort("held_command"), "held_command")
    diagram = builder.Build()
    root = diagram.CreateDefaultContext()
    context = plant.GetMyMutableContextFromRoot(root)
    plant.SetPositionsAndVelocities(context, plant.GetPositionsAndVelocities(tumbling(plant)))
    root.SetTime(time_s)
    rates = []
    for command in (ON, 0.0 * ON):
        diagram.GetInputPort("held_command").FixValue(root, command)
        rates.append(plant.EvalTimeDerivatives(context).CopyToVector()[plant.num_positions() :])
    return rates[0] - rates[1], plant, context


def _by_hand(plant: Any, context: Any, thrust: float) -> np.ndarray:
    """The same from the jet's place and direction: M^-1 J^T F."""
    bus = plant.GetBodyByName("bus")
    jacobian = plant.CalcJacobianTranslationalVelocity(
        context=context,
        with_respect_to=JacobianWrtVariable.kV,
        frame_B=bus.body_frame(),
        p_BoBi_B=np.array([[-0.5], [0.36], [0.15]]),
        frame_A=plant.world_frame(),
        frame_E=plant.world_frame(),
    )
    force = plant.EvalBodyPoseInWorld(context, bus).rotation() @ np.array([thrust, 0.0, 0.0])
    return np.linalg.solve(plant.CalcMassMatrix(context), jacobian.T @ force)


def test_a_jet_pushes_where_it_is_and_along_its_direction() -> None:
    found, plant, context = _accelerations(time_s=0.5)  # long after its lag
    np.testing.assert_allclose(found, _by_hand(plant, context, 1.0), rtol=1e-9, atol=1e-12)


def test_thrust_builds_up_with_the_vehicles_time_constant() -> None:
    # the state of the jets, all off, is that of t = -0.1 s
    found, plant, context = _accelerations(time_s=-0.1 + 0.015)
    np.testing.assert_allclose(found, _by_hand(plant, context, 1.0 - np.exp(-1.0)), rtol=1e-9, atol=1e-12)


def test_factors_and_failures_are_those_of_the_true_thrust() -> None:
    found, plant, context = _accelerations(time_s=0.5, factors=1.0 + 0.1 * ON)
    np.testing.assert_allclose(found, _by_hand(plant, context, 1.1), rtol=1e-9, atol=1e-12)
    weak = Failure(jet=5, kind=FailureKind.DEGRADED, start_s=-1.0, end_s=9.0, amount=0.25, probability=0.0, stream="")
    found, plant, context = _accelerations(time_s=0.5, failures=(weak,))
    np.testing.assert_allclose(found, _by_hand(plant, context, 0.25), rtol=1e-9, atol=1e-12)


def test_the_force_does_not_wait_for_the_coming_command() -> None:
    dut = Thrusters(SERVICER, arm(), "bus")
    command = dut.GetInputPort("command").get_index()
    assert not dut.HasDirectFeedthrough(command, dut.GetOutputPort("spatial_forces").get_index())
    assert dut.GetInputPort("command").size() == dut.GetOutputPort("thrust").size() == 16


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"body": "hull"}, r"'hull' is no body of the MultibodyPlant; bodies are: bus, forearm"),
        ({"factors": np.ones(3)}, r"thrusters: factors: must be a vector of 16 numbers, got shape \(3,\)"),
        ({"factors": np.full(16, np.nan)}, r"thrusters: factors: must be finite, got \[nan"),
        ({"body": 1}, r"body: must be the name, the BodyIndex or the body itself, got 1"),
    ],
)
def test_what_does_not_fit_is_refused(given: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Thrusters(SERVICER, arm(), **{"body": "bus", **given})
    with pytest.raises(ValueError, match=r"is discrete"):
        BodyWrench(arm(time_step=0.01), "bus")
