"""The rigid body as a system, stepped and continuous."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from systems_probe import PERIOD_S, feedthrough, inputs, outputs, update

from massprop_drake.maths.mass_properties import MassProperties
from massprop_drake.maths.vehicle.rigid_body import (
    MASS,
    ORIGIN_VELOCITY,
    POSITION,
    QUATERNION,
    RATE,
    SPIN_INTEGRAL,
    VELOCITY,
)
from massprop_drake.systems.vehicle.rigid_body_plant import RigidBodyPlant

BODY = MassProperties(10.0, np.array([1.0, 0.0, 0.0]), np.diag([2.0, 4.0, 5.0]))


def _stepped(lags: tuple[float, ...] = (), initial_rate: np.ndarray | None = None) -> tuple[RigidBodyPlant, Any]:
    dut = RigidBodyPlant(BODY, time_step=PERIOD_S, lag_time_constants_s=lags, initial_rate=initial_rate)
    return dut, dut.CreateDefaultContext()


def _continuous(initial_rate: np.ndarray | None = None) -> tuple[RigidBodyPlant, Any]:
    dut = RigidBodyPlant(BODY, time_step=0.0, initial_rate=initial_rate)
    return dut, dut.CreateDefaultContext()


def _state(dut: RigidBodyPlant, context: Any) -> np.ndarray:
    return dut.GetOutputPort("body_state").Eval(context)


@pytest.mark.parametrize("lags", [(), (0.015,), (0.015, 0.04)])
def test_topology_of_the_stepped_plant(lags: tuple[float, ...]) -> None:
    dut, context = _stepped(lags)
    assert inputs(dut) == {"wrench_profile": 7 * (1 + len(lags))}
    assert outputs(dut) == {"body_state": 23, "structure": 9, "mass_properties": 10}
    # the sensors read the body at t_k before the command of t_k moves it
    assert feedthrough(dut) == {"body_state": set(), "structure": set(), "mass_properties": set()}
    assert context.num_continuous_states() == 0
    assert context.num_discrete_state_groups() == 1


def test_topology_of_the_continuous_plant() -> None:
    dut, context = _continuous()
    assert inputs(dut) == {"wrench": 7}
    assert outputs(dut) == {"body_state": 23, "structure": 9, "mass_properties": 10}
    assert feedthrough(dut) == {"body_state": set(), "structure": set(), "mass_properties": set()}
    assert context.has_only_continuous_state()
    assert context.num_continuous_states() == 23
    assert dut.GetUniquePeriodicDiscreteUpdateAttribute() is None


@pytest.mark.parametrize("make", [_stepped, _continuous])
def test_it_starts_at_rest_or_at_the_given_rate(make: Any) -> None:
    dut, context = make()
    state = _state(dut, context)
    np.testing.assert_array_equal(state[QUATERNION], [1.0, 0.0, 0.0, 0.0])
    assert state[MASS] == 10.0
    assert np.flatnonzero(state).tolist() == [0, MASS]
    dut, context = make(initial_rate=np.array([0.1, -0.2, 0.3]))
    np.testing.assert_array_equal(_state(dut, context)[RATE], [0.1, -0.2, 0.3])


def test_structure_and_ten_parameters() -> None:
    dut, context = _stepped()
    structure = dut.GetOutputPort("structure").Eval(context)
    np.testing.assert_array_equal(structure, [2.0, 4.0, 5.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0])
    parameters = dut.GetOutputPort("mass_properties").Eval(context)
    np.testing.assert_allclose(parameters, [0.5, 0.25, 0.2, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.1], rtol=1e-15)


def test_a_step_under_a_steady_torque() -> None:
    # 0.5 about x on an inertia of 2, no force: 0.25 rad/s^2 for 0.08 s, exactly
    dut, context = _stepped()
    dut.GetInputPort("wrench_profile").FixValue(context, [0.5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    update(dut, context)
    state = _state(dut, context)
    np.testing.assert_allclose(state[RATE], [0.25 * PERIOD_S, 0.0, 0.0], rtol=1e-13, atol=1e-18)
    half = 0.25 * 0.25 * PERIOD_S**2  # half the angle turned
    np.testing.assert_allclose(state[QUATERNION], [np.cos(half), np.sin(half), 0.0, 0.0], rtol=1e-12, atol=1e-18)
    # the integral of w^2, (0.25 t)^2, over the step
    np.testing.assert_allclose(state[SPIN_INTEGRAL][0], 0.25**2 * PERIOD_S**3 / 3.0, rtol=1e-12)


def test_a_force_off_the_center_of_mass_turns_the_body_too() -> None:
    # 3 along z at the vehicle origin, center of mass 1 ahead of it: torque about it
    # (0 - r_cm) x F = (-1, 0, 0) x (0, 0, 3) = (0, 3, 0), on 4: 0.75 rad/s^2
    dut, context = _stepped()
    dut.GetInputPort("wrench_profile").FixValue(context, [0.0, 0.0, 0.0, 0.0, 0.0, 3.0, 0.0])
    update(dut, context)
    state = _state(dut, context)
    np.testing.assert_allclose(state[RATE], [0.0, 0.75 * PERIOD_S, 0.0], rtol=1e-13, atol=1e-18)
    # force along body z, which leans over by 0.375 t^2 about y while it pushes with 0.3: small angles
    np.testing.assert_allclose(state[VELOCITY][2], 0.3 * PERIOD_S, rtol=1e-5)
    np.testing.assert_allclose(state[VELOCITY][0], 0.3 * 0.375 * PERIOD_S**3 / 3.0, rtol=1e-5)
    np.testing.assert_allclose(state[POSITION][2], 0.5 * 0.3 * PERIOD_S**2, rtol=1e-5)
    # the specific force at the origin, along z: F / m - (dw/dt x r_cm)_z = 0.3 + 0.75 x 1
    np.testing.assert_allclose(state[ORIGIN_VELOCITY][2], 1.05 * PERIOD_S, rtol=1e-12)


def test_a_step_under_thrust_that_builds_up() -> None:
    # torque 0.5 (1 - exp(-s / tau)) on 2; its integral over T is 0.5 (T - tau (1 - exp(-T / tau)))
    tau = 0.015
    dut, context = _stepped((tau,))
    profile = np.zeros((2, 7))
    profile[0, 0], profile[1, 0] = 0.5, -0.5
    dut.GetInputPort("wrench_profile").FixValue(context, profile.ravel())
    update(dut, context)
    impulse = 0.5 * (PERIOD_S - tau * (1.0 - np.exp(-PERIOD_S / tau)))
    np.testing.assert_allclose(_state(dut, context)[RATE], [impulse / 2.0, 0.0, 0.0], rtol=1e-13, atol=1e-18)


def test_firing_uses_up_mass_and_shows_in_the_tenth_parameter() -> None:
    dut, context = _stepped()
    dut.GetInputPort("wrench_profile").FixValue(context, [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 25.0])
    update(dut, context)
    assert _state(dut, context)[MASS] == pytest.approx(8.0, rel=1e-14)
    parameters = dut.GetOutputPort("mass_properties").Eval(context)
    np.testing.assert_allclose(parameters[9], 1.0 / 8.0, rtol=1e-14)
    np.testing.assert_array_equal(parameters[:9], [0.5, 0.25, 0.2, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0])


def test_outputs_at_a_sample_do_not_see_the_command_of_that_sample() -> None:
    dut, context = _stepped()
    dut.GetInputPort("wrench_profile").FixValue(context, [0.5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    assert not _state(dut, context)[RATE].any()
    update(dut, context)
    assert _state(dut, context)[RATE][0] > 0.0


def test_derivatives_of_the_continuous_plant() -> None:
    # Euler's equation by hand: w = (0.1, 0.2, 0), I w = (0.2, 0.8, 0), w x I w = (0, 0, 0.04);
    # torque about the center of mass (0.5, 0, 0.2) - (1, 0, 0) x (0, 0, 3) = (0.5, 3, 0.2)
    dut, context = _continuous(initial_rate=np.array([0.1, 0.2, 0.0]))
    dut.GetInputPort("wrench").FixValue(context, [0.5, 0.0, 0.2, 0.0, 0.0, 3.0, 0.7])
    derivative = dut.EvalTimeDerivatives(context).get_vector().CopyToVector()
    np.testing.assert_allclose(derivative[RATE], [0.25, 0.75, 0.16 / 5.0], rtol=1e-13)
    np.testing.assert_allclose(derivative[QUATERNION], [0.0, 0.05, 0.1, 0.0], rtol=1e-13, atol=1e-18)
    np.testing.assert_allclose(derivative[VELOCITY], [0.0, 0.0, 0.3], rtol=1e-13, atol=1e-18)
    np.testing.assert_allclose(derivative[MASS], -0.7, rtol=1e-15)
    np.testing.assert_allclose(derivative[SPIN_INTEGRAL], [0.01, 0.04, 0.0, 0.0, 0.0, 0.02], rtol=1e-13, atol=1e-18)


def test_the_inertia_in_the_context_is_the_one_that_turns() -> None:
    # a body whose inertia about x is changed in the context turns by the new one
    dut, context = _stepped()
    dut.parameters.set(context, inertia_xx=8.0)
    np.testing.assert_allclose(dut.GetOutputPort("mass_properties").Eval(context)[0], 0.125, rtol=1e-15)
    dut.GetInputPort("wrench_profile").FixValue(context, [0.5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    update(dut, context)
    np.testing.assert_allclose(_state(dut, context)[RATE][0], 0.5 / 8.0 * PERIOD_S, rtol=1e-13)
