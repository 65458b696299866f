"""The rigid body as a system, stepped and continuous, with payloads that leave it or are fixed to it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from pydrake.systems.analysis import Simulator
from systems_probe import PERIOD_S, feedthrough, give, inputs, output, outputs, update

from massprop_drake.maths.mass_properties import MassProperties, symmetric_matrix
from massprop_drake.maths.vehicle.rigid_body import (
    MASS,
    RATE,
    Jump,
    apply_jumps,
    derivative,
    initial_state,
    motion_constants,
    step,
)
from massprop_drake.systems import RigidBodyPlant

BODY = MassProperties(
    10.0, np.array([1.0, -0.2, 0.3]), np.array([[20.0, 1.0, -2.0], [1.0, 30.0, 0.5], [-2.0, 0.5, 40.0]])
)
SPIN = np.array([0.3, -0.2, 0.4])  # rad/s
WRENCH = np.array([2.0, -1.0, 3.0, 4.0, -5.0, 6.0, 0.1])  # torque about the origin, force, mass flow
RELEASE = Jump(2 * PERIOD_S, -3.0, np.array([2.0, 1.0, -1.0]), np.zeros((3, 3)))
DOCK = Jump(2 * PERIOD_S, 4.0, np.array([-1.0, 0.5, 2.0]), np.diag([3.0, 2.0, 4.0]))
START = initial_state(BODY.mass)
START[RATE] = SPIN


def test_a_stepped_plant_moves_as_the_mathematics_say_after_its_outputs() -> None:
    lags = (0.015, 0.04)
    dut = RigidBodyPlant(BODY, time_step=PERIOD_S, lag_time_constants_s=lags, initial_rate=SPIN)
    assert inputs(dut) == {"wrench_profile": 21}
    assert outputs(dut) == {"body_state": 23, "structure": 9, "mass_properties": 10}
    # the sensors read the body at t_k before the command of t_k moves it
    assert not any(feedthrough(dut).values())
    context = dut.CreateDefaultContext()
    assert (context.num_continuous_states(), context.num_discrete_state_groups()) == (0, 1)
    profile = np.vstack((WRENCH, -WRENCH, 0.5 * WRENCH))
    assert_array_equal(output(dut, context, "body_state", wrench_profile=profile.ravel()), START)
    update(dut, context)
    expected = step(START, WRENCH, profile[1:], lags, PERIOD_S, motion_constants(BODY))
    assert_allclose(output(dut, context, "body_state"), expected, rtol=1e-14)
    vector = BODY.vector()
    assert_array_equal(output(dut, context, "structure")[6:], BODY.center_of_mass)
    assert_array_equal(symmetric_matrix(output(dut, context, "structure")[:6]), BODY.inertia)
    # firing uses up mass, which shows in the tenth parameter
    assert_allclose(output(dut, context, "mass_properties"), [*vector[:9], 1.0 / expected[MASS]], rtol=1e-14)


def test_a_continuous_plant_has_the_derivatives_of_the_mathematics() -> None:
    dut = RigidBodyPlant(BODY, time_step=0.0, initial_rate=SPIN)
    assert inputs(dut) == {"wrench": 7}
    assert not any(feedthrough(dut).values())
    context = dut.CreateDefaultContext()
    assert context.has_only_continuous_state()
    assert dut.GetUniquePeriodicDiscreteUpdateAttribute() is None
    give(dut, context, wrench=WRENCH)
    found = dut.EvalTimeDerivatives(context).get_vector().CopyToVector()
    assert_array_equal(found, derivative(START, WRENCH, motion_constants(BODY)))


@pytest.mark.parametrize("time_step", [0.0, PERIOD_S])
def test_a_jump_happens_at_the_first_sample_not_before_its_time(time_step: float) -> None:
    for time_s, expected in ((PERIOD_S, 1), (PERIOD_S + 1e-6, 2), (1.5 * PERIOD_S, 2)):
        jumps = (RELEASE._replace(time_s=time_s), DOCK._replace(time_s=time_s))
        dut = RigidBodyPlant(BODY, time_step=time_step, jumps=jumps, period_s=PERIOD_S, initial_rate=SPIN)
        simulator = Simulator(dut)
        context: Any = simulator.get_mutable_context()
        give(dut, context, **{"wrench_profile" if time_step else "wrench": np.zeros(7)})
        simulator.Initialize()
        for sample in range(4):
            simulator.AdvanceTo(sample * PERIOD_S)
            before = [output(dut, context, name).copy() for name in ("body_state", "structure")]
            simulator.AdvancePendingEvents()
            after = [output(dut, context, name) for name in ("body_state", "structure")]
            assert (after[1] != before[1]).any() == (sample == expected)
            if sample == expected and not time_step:  # a stepped body is that of the next sample already
                for found, mathematics in zip(after, apply_jumps(*before, jumps), strict=True):
                    assert_allclose(found, mathematics, rtol=1e-12, atol=1e-13)
