"""The rigid body as a system, stepped and continuous, with payloads that leave it or are fixed to it."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from pydrake.systems.analysis import Simulator
from systems_probe import PERIOD_S, feedthrough, give, inputs, output, outputs, update

from massprop_drake.maths.attitude import rotation_matrix
from massprop_drake.maths.linear_algebra import Array
from massprop_drake.maths.mass_properties import MassProperties, joined, symmetric
from massprop_drake.maths.vehicle.rigid_body import (
    MASS,
    ORIGIN_VELOCITY,
    POSITION,
    QUATERNION,
    RATE,
    SPIN_INTEGRAL,
    VELOCITY,
    Jump,
    body_of,
    derivative,
    initial_state,
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
    expected = step(START, WRENCH, profile[1:], lags, PERIOD_S, body_of(BODY))
    assert_allclose(output(dut, context, "body_state"), expected, rtol=1e-14)
    vector = BODY.vector()
    assert_array_equal(output(dut, context, "structure")[6:], BODY.center_of_mass)
    assert_array_equal(symmetric(output(dut, context, "structure")[:6]), BODY.inertia)
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
    assert_array_equal(found, derivative(START, WRENCH, body_of(BODY)))


@pytest.mark.parametrize("time_step", [0.0, PERIOD_S])
def test_the_mass_properties_in_the_context_are_those_that_move_it(time_step: float) -> None:
    dut, changed = RigidBodyPlant(BODY, time_step=time_step), BODY._replace(mass=20.0, inertia=np.diag([8.0, 4.0, 5.0]))
    context = dut.CreateDefaultContext()
    dut.parameters.set(context, mass=20.0, inertia=[8.0, 4.0, 5.0, 0, 0, 0])
    assert output(dut, context, "body_state")[MASS] == 20.0
    assert_allclose(output(dut, context, "mass_properties"), changed.vector(), rtol=1e-15)
    give(dut, context, **{"wrench_profile" if time_step else "wrench": WRENCH})
    if time_step:
        update(dut, context)
        found, expected = output(dut, context, "body_state"), step(
            initial_state(20.0), WRENCH, np.zeros((0, 7)), (), PERIOD_S, body_of(changed)
        )  # fmt: skip
    else:
        found = dut.EvalTimeDerivatives(context).get_vector().CopyToVector()
        expected = derivative(initial_state(20.0), WRENCH, body_of(changed))
    assert_allclose(found, expected, rtol=1e-14)


# -------------------------------------------------------------------------------------------- payloads


class Moment(NamedTuple):
    """Body and structure at one time."""

    state: Array
    structure: Array

    @property
    def rotation(self) -> Array:
        return rotation_matrix(self.state[QUATERNION])

    @property
    def properties(self) -> MassProperties:
        return MassProperties(self.state[MASS], self.structure[6:], symmetric(self.structure[:6]))

    def place(self, point: Array) -> Array:
        """Where a point of the structure is in N."""
        return self.state[POSITION] + self.rotation @ (point - self.structure[6:])

    def motion(self, point: Array) -> Array:
        """Its velocity in N."""
        return self.state[VELOCITY] + self.rotation @ np.cross(self.state[RATE], point - self.structure[6:])

    def momenta(self) -> tuple[Array, Array]:
        """Linear momentum, and angular momentum about the origin of N."""
        linear = self.state[MASS] * self.state[VELOCITY]
        spin = self.rotation @ self.properties.inertia @ self.state[RATE]
        return linear, spin + np.cross(self.state[POSITION], linear)


class Flight:
    """The plant under a steady wrench."""

    def __init__(self, *jumps: Jump, time_step: float = 0.0):
        self.dut = RigidBodyPlant(BODY, time_step=time_step, initial_rate=SPIN, jumps=jumps, period_s=PERIOD_S)
        self.simulator = Simulator(self.dut)
        self.context: Any = self.simulator.get_mutable_context()
        give(self.dut, self.context, **{"wrench_profile" if time_step else "wrench": WRENCH})
        if time_step == 0.0:
            integrator = self.simulator.get_mutable_integrator()
            integrator.set_maximum_step_size(PERIOD_S)
            integrator.set_target_accuracy(1e-12)
        self.simulator.Initialize()

    def moment(self) -> Moment:
        return Moment(*(output(self.dut, self.context, name) for name in ("body_state", "structure")))

    def around(self, time_s: float) -> tuple[Moment, Moment]:
        """Just before and just after the events of a time; of a continuous plant nothing but jumps happen then."""
        self.simulator.AdvanceTo(time_s)
        before = self.moment()
        self.simulator.AdvancePendingEvents()
        return before, self.moment()


@pytest.mark.parametrize("jump", [RELEASE, DOCK], ids=["release", "dock"])
def test_the_structure_goes_on_as_it_was_and_momentum_is_kept(jump: Jump) -> None:
    flight = Flight(jump)
    before, after = flight.around(jump.time_s)
    assert_allclose(before.state[MASS], 10.0 - 0.1 * jump.time_s, rtol=1e-12)  # used up before, and gone for good
    for part in (QUATERNION, RATE, ORIGIN_VELOCITY, SPIN_INTEGRAL):  # and so what an accelerometer has gathered
        assert_array_equal(after.state[part], before.state[part])
    for point in (np.zeros(3), np.array([3.0, -2.0, 1.0]), jump.position):
        assert_allclose(after.place(point), before.place(point), atol=1e-14)
        assert_allclose(after.motion(point), before.motion(point), atol=1e-14)
    expected = joined(before.properties, jump.mass, jump.position, jump.inertia)
    for one, other in zip(after.properties, expected, strict=True):
        assert_allclose(one, other, rtol=1e-12)
    assert_allclose(output(flight.dut, flight.context, "mass_properties"), expected.vector(), rtol=1e-12)
    # the payload moves as the structure does where it lies, and turns with it
    velocity, spin = before.motion(jump.position), before.rotation @ jump.inertia @ before.state[RATE]
    linear, angular = before.momenta()
    angular = angular + spin + np.cross(before.place(jump.position), jump.mass * velocity)
    assert_allclose(after.momenta()[0], linear + jump.mass * velocity, rtol=1e-12)
    assert_allclose(after.momenta()[1], angular, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("time_step", [0.0, PERIOD_S])
def test_a_jump_happens_at_the_first_sample_not_before_its_time(time_step: float) -> None:
    for time_s, sample in ((0.0, 0), (PERIOD_S, 1), (PERIOD_S + 1e-6, 2), (1.5 * PERIOD_S, 2), (3 * PERIOD_S, 3)):
        flight = Flight(RELEASE._replace(time_s=time_s), time_step=time_step)
        centers = [flight.around(number * PERIOD_S)[1].structure[6] for number in range(5)]
        assert np.flatnonzero(np.diff([BODY.center_of_mass[0], *centers])).tolist() == [sample]


def test_stepped_and_continuous_plant_agree_through_several_jumps() -> None:
    jumps = (RELEASE, DOCK, RELEASE._replace(time_s=5 * PERIOD_S, mass=3.0))  # two at once
    stepped, continuous = (Flight(*jumps, time_step=step_s) for step_s in (PERIOD_S, 0.0))
    for number in range(1, 9):
        for flight in (stepped, continuous):
            flight.simulator.AdvanceTo(number * PERIOD_S)
        # before the events of t_k both show the body at t_k, but for the accuracy asked of the integrator,
        # 1e-12 a step
        assert_allclose(stepped.moment().state, continuous.moment().state, rtol=0.0, atol=1e-10)
        assert_allclose(stepped.moment().structure, continuous.moment().structure, rtol=0.0, atol=1e-10)
    assert stepped.moment().state[MASS] == pytest.approx(10.0 + 4.0 - 0.1 * 8 * PERIOD_S, rel=1e-12)
