"""Payloads that leave the rigid body or are fixed to it: what goes on as it was, and what changes."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from systems_probe import PERIOD_S

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
)
from massprop_drake.maths.vehicle.sensing import point_velocity
from massprop_drake.systems.vehicle.rigid_body_plant import Jump, RigidBodyPlant

BODY = MassProperties(
    10.0, np.array([1.0, -0.2, 0.3]), np.array([[20.0, 1.0, -2.0], [1.0, 30.0, 0.5], [-2.0, 0.5, 40.0]])
)
SPIN = np.array([0.3, -0.2, 0.4])  # rad/s
WRENCH = np.array([2.0, -1.0, 3.0, 4.0, -5.0, 6.0, 0.1])  # torque about the origin, force, mass flow
PAYLOAD = Jump(2 * PERIOD_S, -3.0, np.array([2.0, 1.0, -1.0]), np.zeros((3, 3)))
EXTENDED = Jump(2 * PERIOD_S, 4.0, np.array([-1.0, 0.5, 2.0]), np.diag([3.0, 2.0, 4.0]))


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


class Flight:
    """The plant under a steady wrench."""

    def __init__(self, *jumps: Jump, time_step: float = 0.0):
        self.dut = RigidBodyPlant(BODY, time_step=time_step, initial_rate=SPIN, jumps=jumps, period_s=PERIOD_S)
        self.simulator = Simulator(self.dut)
        self.context: Any = self.simulator.get_mutable_context()
        port = "wrench" if time_step == 0.0 else "wrench_profile"
        self.dut.GetInputPort(port).FixValue(self.context, WRENCH)
        if time_step == 0.0:
            integrator = self.simulator.get_mutable_integrator()
            integrator.set_maximum_step_size(PERIOD_S)
            integrator.set_target_accuracy(1e-12)
        self.simulator.Initialize()

    def moment(self) -> Moment:
        return Moment(
            self.dut.GetOutputPort("body_state").Eval(self.context),
            self.dut.GetOutputPort("structure").Eval(self.context),
        )

    def around(self, time_s: float) -> tuple[Moment, Moment]:
        """Just before and just after the events of a time; of a continuous plant nothing but jumps happen then."""
        self.simulator.AdvanceTo(time_s)
        before = self.moment()
        self.simulator.AdvancePendingEvents()
        return before, self.moment()


@pytest.mark.parametrize("jump", [PAYLOAD, EXTENDED], ids=["release", "dock"])
def test_the_structure_goes_on_as_it_was(jump: Jump) -> None:
    before, after = Flight(jump).around(jump.time_s)
    assert after.state[MASS] != before.state[MASS]
    for part in (QUATERNION, RATE, ORIGIN_VELOCITY, SPIN_INTEGRAL):
        np.testing.assert_array_equal(after.state[part], before.state[part])
    for point in (np.zeros(3), np.array([3.0, -2.0, 1.0]), jump.position):
        np.testing.assert_allclose(after.place(point), before.place(point), atol=1e-14)
        np.testing.assert_allclose(after.motion(point), before.motion(point), atol=1e-14)
    # the center of mass moved, and with it its velocity
    assert np.abs(after.state[VELOCITY] - before.state[VELOCITY]).max() > 0.01


@pytest.mark.parametrize("jump", [PAYLOAD, EXTENDED], ids=["release", "dock"])
def test_what_an_accelerometer_has_gathered_is_continuous(jump: Jump) -> None:
    before, after = Flight(jump).around(jump.time_s)
    point = np.array([3.0, -2.0, 1.0])
    gathered = [
        point_velocity(m.state[ORIGIN_VELOCITY], m.state[RATE], m.state[SPIN_INTEGRAL], point) for m in (before, after)
    ]
    np.testing.assert_array_equal(gathered[0], gathered[1])


def momenta(moment: Moment) -> tuple[Array, Array]:
    """Linear momentum, and angular momentum about the origin of N."""
    linear = moment.state[MASS] * moment.state[VELOCITY]
    spin = moment.rotation @ moment.properties.inertia @ moment.state[RATE]
    return linear, spin + np.cross(moment.state[POSITION], linear)


@pytest.mark.parametrize("jump", [PAYLOAD, EXTENDED], ids=["release", "dock"])
def test_momentum_is_kept_with_what_leaves_or_comes(jump: Jump) -> None:
    # the payload moves as the structure does where it lies, and turns with it
    before, after = Flight(jump).around(jump.time_s)
    velocity = before.motion(jump.position)
    spin = before.rotation @ jump.inertia @ before.state[RATE]
    linear = momenta(before)[0] + jump.mass * velocity
    angular = momenta(before)[1] + spin + np.cross(before.place(jump.position), jump.mass * velocity)
    np.testing.assert_allclose(momenta(after)[0], linear, rtol=1e-12)
    np.testing.assert_allclose(momenta(after)[1], angular, rtol=1e-12, atol=1e-12)


def cloud(seed: int, count: int) -> tuple[Array, Array]:
    """Point masses and where they are."""
    rng = np.random.default_rng(seed)
    return rng.uniform(0.5, 2.0, count), rng.normal(size=(count, 3))


def of_cloud(masses: Array, places: Array) -> MassProperties:
    """Mass properties of point masses, summed one by one."""
    center = masses @ places / masses.sum()
    inertia = np.zeros((3, 3))
    for mass, arm in zip(masses, places - center, strict=True):
        inertia += mass * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    return MassProperties(masses.sum(), center, inertia)


def test_the_parallel_axis_theorem_against_point_masses() -> None:
    ours, theirs = cloud(1, 7), cloud(2, 4)
    both = of_cloud(np.append(ours[0], theirs[0]), np.vstack([ours[1], theirs[1]]))
    body, payload = of_cloud(*ours), of_cloud(*theirs)
    docked = joined(body, payload.mass, payload.center_of_mass, payload.inertia)
    released = joined(both, -payload.mass, payload.center_of_mass, -payload.inertia)
    for found, expected in ((docked, both), (released, body)):
        np.testing.assert_allclose(found.mass, expected.mass, rtol=1e-14)
        np.testing.assert_allclose(found.center_of_mass, expected.center_of_mass, atol=1e-14)
        np.testing.assert_allclose(found.inertia, expected.inertia, atol=1e-13)


def test_the_release_of_the_scenario_by_hand() -> None:
    # two point masses of 1 at x = 0 and x = 2; the one at 2 leaves: mass 1 at 0, no inertia left
    pair = MassProperties(2.0, np.array([1.0, 0.0, 0.0]), np.diag([0.0, 2.0, 2.0]))
    left = joined(pair, -1.0, np.array([2.0, 0.0, 0.0]), np.zeros((3, 3)))
    assert left.mass == 1.0
    np.testing.assert_allclose(left.center_of_mass, np.zeros(3), atol=1e-15)
    np.testing.assert_allclose(left.inertia, np.zeros((3, 3)), atol=1e-15)


def test_mass_used_up_before_a_jump_is_gone_for_good() -> None:
    before, after = Flight(PAYLOAD).around(PAYLOAD.time_s)
    np.testing.assert_allclose(before.state[MASS], 10.0 - 0.1 * PAYLOAD.time_s, rtol=1e-12)
    np.testing.assert_allclose(after.state[MASS], before.state[MASS] - 3.0, rtol=1e-14)
    # and the theorem is applied to the mass that is there
    expected = joined(before.properties, PAYLOAD.mass, PAYLOAD.position, PAYLOAD.inertia)
    np.testing.assert_allclose(after.structure[6:], expected.center_of_mass, rtol=1e-13)
    np.testing.assert_allclose(symmetric(after.structure[:6]), expected.inertia, rtol=1e-12)


@pytest.mark.parametrize(
    ("time_s", "sample"), [(0.0, 0), (PERIOD_S, 1), (PERIOD_S + 1e-6, 2), (1.5 * PERIOD_S, 2), (3 * PERIOD_S, 3)]
)
@pytest.mark.parametrize("time_step", [0.0, PERIOD_S])
def test_a_jump_happens_at_the_first_sample_not_before_its_time(time_s: float, sample: int, time_step: float) -> None:
    flight = Flight(PAYLOAD._replace(time_s=time_s), time_step=time_step)
    centers = []
    for number in range(5):
        _, after = flight.around(number * PERIOD_S)
        centers.append(after.structure[6])
    np.testing.assert_array_equal(np.flatnonzero(np.diff([BODY.center_of_mass[0], *centers])), [sample])


def test_two_payloads_may_go_and_come_at_once_and_later() -> None:
    back = PAYLOAD._replace(time_s=4 * PERIOD_S, mass=3.0)
    flight = Flight(PAYLOAD, EXTENDED, back)
    start = flight.around(2 * PERIOD_S)
    expected = start[0].properties
    for jump in (PAYLOAD, EXTENDED):
        expected = joined(expected, jump.mass, jump.position, jump.inertia)
    np.testing.assert_allclose(start[1].structure[6:], expected.center_of_mass, rtol=1e-13)
    before, after = flight.around(4 * PERIOD_S)
    expected = joined(before.properties, 3.0, PAYLOAD.position, PAYLOAD.inertia)
    np.testing.assert_allclose(symmetric(after.structure[:6]), expected.inertia, rtol=1e-12)


def test_true_parameters_follow_a_jump() -> None:
    flight = Flight(PAYLOAD)
    _, after = flight.around(PAYLOAD.time_s)
    expected = MassProperties(after.state[MASS], after.structure[6:], symmetric(after.structure[:6])).vector()
    found = flight.dut.GetOutputPort("mass_properties").Eval(flight.context)
    np.testing.assert_allclose(found, expected, rtol=1e-12)


def test_the_body_moves_by_its_new_properties_after_a_jump() -> None:
    # over the next sample, against a body that had these properties all along
    flight = Flight(PAYLOAD)
    _, after = flight.around(PAYLOAD.time_s)
    flight.simulator.AdvanceTo(3 * PERIOD_S)
    plain = RigidBodyPlant(after.properties, time_step=0.0, initial_rate=after.state[RATE])
    simulator = Simulator(plain)
    context: Any = simulator.get_mutable_context()
    plain.GetInputPort("wrench").FixValue(context, WRENCH)
    simulator.get_mutable_integrator().set_target_accuracy(1e-12)
    simulator.AdvanceTo(PERIOD_S)
    alone = plain.GetOutputPort("body_state").Eval(context)
    # rates do not care where the body is; the integrator's accuracy
    np.testing.assert_allclose(flight.moment().state[RATE], alone[RATE], atol=1e-11)
    gained = flight.moment().state[ORIGIN_VELOCITY] - after.state[ORIGIN_VELOCITY]
    np.testing.assert_allclose(gained, alone[ORIGIN_VELOCITY], atol=1e-10)


def test_the_stepped_plant_agrees_with_the_continuous_one_through_jumps() -> None:
    late = EXTENDED._replace(time_s=5 * PERIOD_S)
    stepped, continuous = (Flight(PAYLOAD, late, time_step=step) for step in (PERIOD_S, 0.0))
    for number in range(1, 9):
        stepped.simulator.AdvanceTo(number * PERIOD_S)
        continuous.simulator.AdvanceTo(number * PERIOD_S)
        # before the events of t_k both show the body at t_k, but for the accuracy asked of the integrator,
        # 1e-12 a step
        np.testing.assert_allclose(stepped.moment().state, continuous.moment().state, rtol=0.0, atol=1e-10)
        np.testing.assert_allclose(stepped.moment().structure, continuous.moment().structure, rtol=0.0, atol=1e-10)
    assert stepped.moment().state[MASS] == pytest.approx(10.0 - 3.0 + 4.0 - 0.1 * 8 * PERIOD_S, rel=1e-12)
