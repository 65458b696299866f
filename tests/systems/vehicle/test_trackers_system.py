"""Trackers in a fixed frame as systems."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from systems_probe import feedthrough, inputs, output

from massprop_drake.maths.vehicle.rigid_body import N_STATE, POSITION, QUATERNION
from massprop_drake.maths.vehicle.tracking import PoseModel
from massprop_drake.systems.vehicle.trackers import PoseTracker, VelocityTracker


@pytest.mark.parametrize("kind", ["pose", "velocity"])
def test_a_tracker_reads_the_true_body_from_its_structure(kind: str) -> None:
    model = PoseModel(np.array([0.2, 0.0, 0.0]), 0.01, 0.02, 0.0, 0.0, planar=False)
    pose = PoseTracker("cam", model)
    velocity = VelocityTracker("cam", position=np.array([0.2, 0.0, 0.0]), noise_std=0.1)
    dut: Any = pose if kind == "pose" else velocity
    body = np.zeros(N_STATE)
    body[QUATERNION], body[POSITION] = (1.0, 0.0, 0.0, 0.0), (1.0, 2.0, 3.0)
    structure = np.zeros(9)
    assert inputs(dut) == {"body_state": N_STATE, "structure": 9, "noise": dut.n_noise}
    assert feedthrough(dut)["reading"] == set(inputs(dut))
    context = dut.CreateDefaultContext()
    dut.GetInputPort("body_state").FixValue(context, body)
    dut.GetInputPort("structure").FixValue(context, structure)
    dut.GetInputPort("noise").FixValue(context, np.eye(dut.n_noise)[0])
    expected = [1.21, 2.0, 3.0, 1.0, 0.0, 0.0, 0.0] if kind == "pose" else [0.1, 0.0, 0.0]
    np.testing.assert_allclose(output(dut, context, "reading"), expected, atol=1e-12)
