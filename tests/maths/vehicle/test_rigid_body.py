"""The rigid body's motion against independent integration, closed forms and conservation laws."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.integrate import solve_ivp

from massprop_drake.inputs.vehicle_file import Vehicle, load_vehicle
from massprop_drake.maths.attitude import from_rotation_vector, rotation_matrix
from massprop_drake.maths.linear_algebra import Array
from massprop_drake.maths.mass_properties import MassProperties, symmetric_matrix
from massprop_drake.maths.vehicle import rigid_body
from massprop_drake.maths.vehicle.rigid_body import (
    MASS,
    N_STATE,
    ORIGIN_VELOCITY,
    POSITION,
    QUATERNION,
    RATE,
    SPIN_INTEGRAL,
    VELOCITY,
    initial_state,
    motion_constants,
    step,
)
from massprop_drake.maths.vehicle.sensing import point_velocity

PERIOD = 0.08  # s
DEGREE = np.pi / 180.0
NO_TRANSIENT = np.zeros((0, 7))
SMALL = MassProperties(  # kg, m, kg-m^2
    12.0, np.array([0.3, -0.1, 0.2]), np.array([[3.0, 0.2, -0.1], [0.2, 4.0, 0.3], [-0.1, 0.3, 5.0]])
)
POINT = np.array([1.5, -0.7, 0.4])


def moving_state(mass: float, rate: Array) -> Array:
    state = initial_state(mass)
    state[QUATERNION] = from_rotation_vector(np.array([0.4, -0.7, 1.1]))
    state[RATE], state[POSITION], state[VELOCITY] = rate, [1.0, 2.0, 3.0], [0.3, -0.2, 0.1]
    return state


def equations(state: Array, wrench: Array, properties: MassProperties, point: Array) -> Array:
    """(2-30) and (3-17) in vector form, then the specific force at a point in the vehicle frame."""
    quaternion, rate, mass = state[QUATERNION], state[RATE], state[MASS]
    center, inertia, force = properties.center_of_mass, properties.inertia, wrench[3:6]
    torque = wrench[:3] - np.cross(center, force)
    acceleration = np.linalg.solve(inertia, torque - np.cross(rate, inertia @ rate))
    scalar, vector = quaternion[0], quaternion[1:]

    def specific_force(position: Array) -> Array:
        arm = position - center
        return force / mass + np.cross(acceleration, arm) + np.cross(rate, np.cross(rate, arm))

    spin = np.outer(rate, rate)
    turning = [[-0.5 * vector @ rate], 0.5 * (scalar * rate + np.cross(vector, rate)), acceleration]
    moving = [state[VELOCITY], rotation_matrix(quaternion) @ force / mass, [-wrench[6]], specific_force(np.zeros(3))]
    integrals = [[spin[0, 0], spin[1, 1], spin[2, 2], spin[1, 2], spin[0, 2], spin[0, 1]], specific_force(point)]
    return np.concatenate([*turning, *moving, *integrals])


def integrated(
    state: Array, wrench: Callable[[float], Array], duration: float, properties: MassProperties, point: Array = POINT
) -> Array:
    """The state after a duration, with what a point has gathered appended, by an integrator of eighth order."""
    solution = solve_ivp(
        lambda time, extended: equations(extended[:N_STATE], wrench(time), properties, point),
        (0.0, duration), np.append(state, np.zeros(3)), method="DOP853", rtol=1e-12, atol=1e-15,
    )  # fmt: skip
    return solution.y[:, -1]


def gathered(start: Array, end: Array, point: Array) -> Array:
    """The velocity that an accelerometer at a point has gathered."""
    read = [point_velocity(each[ORIGIN_VELOCITY], each[RATE], each[SPIN_INTEGRAL], point) for each in (start, end)]
    return read[1] - read[0]


def jets_of(vehicle: Vehicle, *designations: str) -> Array:
    rows = [vehicle.jet_index(name) for name in designations]
    return np.column_stack([vehicle.wrenches, vehicle.mass_flows])[rows].sum(axis=0)


def test_derivative_is_that_of_the_equations_of_motion() -> None:
    rng = np.random.default_rng(1)
    for _ in range(20):
        state, wrench = rng.standard_normal(N_STATE), rng.standard_normal(7)
        state[QUATERNION] /= np.linalg.norm(state[QUATERNION])
        state[MASS] = rng.uniform(5.0, 20.0)
        expected = equations(state, wrench, SMALL, POINT)[:N_STATE]
        # some dozen products of size up to ten
        assert_allclose(rigid_body.derivative(state, wrench, motion_constants(SMALL)), expected, rtol=0.0, atol=3e-14)


ORBITER = load_vehicle("orbiter")
PUSHED = np.array([0.5, -0.3, 0.2, 3.0, -2.0, 1.0, 0.01])
# a substep of 0.005 rad errs by 3e-14; of the turning, of velocities, of the position, and of the spin integral
CASES = {
    "orbiter": (
        ORBITER.nominal, DEGREE * np.array([0.5, -0.3, 0.2]), jets_of(ORBITER, "F1L", "F2R", "L1A", "R4U", "L5D"),
        (12, PERIOD), (1e-12, 1e-11, 3e-11, 1e-13),
    ),
    "coasting": (SMALL, np.array([0.6, -0.7, 1.0]), np.zeros(7), (50, PERIOD), (4e-11, 4e-11, 4e-10, 4e-10)),
    "coasting in one step": (SMALL, np.array([0.6, -0.7, 1.0]), np.zeros(7), (1, 4.0), (4e-11, 4e-11, 4e-10, 4e-10)),
    "fast tumble": (SMALL, np.array([0.6, -0.7, 1.0]), PUSHED, (25, PERIOD), (2e-11, 2e-11, 2e-10, 2e-10)),
    "torque from rest": (
        SMALL, np.zeros(3), np.array([10.0, -8.0, 5.0, 0, 0, 0, 0]), (1, 1.0), (2.4e-11, 1e-10, 1e-10, 1e-10)
    ),
    **{
        f"force along {axis} from rest, {arm} off": (
            SMALL._replace(center_of_mass=np.eye(3)[arm]), np.zeros(3), 10.0 * np.eye(7)[3 + axis], (1, 1.0),
            (2.1e-11, 2e-10, 2e-10, 2e-10),
        )
        for axis, arm in ((0, 1), (0, 2), (1, 0), (1, 2), (2, 0), (2, 1))
    },
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_motion_under_a_constant_wrench_follows_the_integrator(case: str) -> None:
    properties, rate, wrench, (count, period), (turning, velocity, position, spin) = CASES[case]
    start, body = moving_state(properties.mass, rate), motion_constants(properties)
    expected, state = integrated(start, lambda _: wrench, count * period, properties), start
    before = start.copy()
    for _ in range(count):
        state = step(state, wrench, NO_TRANSIENT, (), period, body)
        assert np.linalg.norm(state[QUATERNION]) == pytest.approx(1.0, abs=4e-16)
    assert_array_equal(start, before)
    for part, atol in ((RATE, turning), (QUATERNION, turning), (VELOCITY, velocity), (ORIGIN_VELOCITY, velocity)):
        assert_allclose(state[part], expected[part], rtol=0.0, atol=atol)
    assert_allclose(state[POSITION], expected[POSITION], rtol=0.0, atol=position)
    assert_allclose(state[SPIN_INTEGRAL], expected[SPIN_INTEGRAL], rtol=0.0, atol=spin)
    assert_allclose(gathered(start, state, POINT), expected[N_STATE:], rtol=0.0, atol=max(position, spin))
    assert state[MASS] == pytest.approx(expected[MASS], rel=1e-13)


def test_velocity_gained_obeys_the_rocket_equation() -> None:
    # a thrust through the center of mass, build-up and tail-off alike: dv = c ln(m_0 / m), c = F / flow
    exhaust_velocity, level, state = 400.0, 0.0, initial_state(SMALL.mass)
    force, center = np.array([3.0, 4.0, 0.0]), SMALL.center_of_mass
    jet = np.concatenate([np.cross(center, force), force, [np.linalg.norm(force) / exhaust_velocity]])
    for command in (1.0, 1.0, 0.0, 1.0, 0.0, 0.0, 0.0):
        state = step(state, command * jet, (level - command) * jet[None], (0.3,), 1.0, motion_constants(SMALL))
        level = command + (level - command) * np.exp(-1.0 / 0.3)
    # decaying thrust leaves (F tau / m) flow / m = 1.3e-4 of acceleration to the Runge-Kutta method, whose substeps
    # of up to a time constant, 0.3 s, err by a few 1e-4 of that: 1e-8 per step
    gained = exhaust_velocity * np.log(SMALL.mass / state[MASS]) * force / 5.0
    assert state[MASS] < 0.998 * SMALL.mass
    assert_allclose(state[VELOCITY], gained, rtol=0.0, atol=1e-7)
    assert_allclose(state[ORIGIN_VELOCITY], gained, rtol=0.0, atol=1e-7)
    assert_allclose(state[RATE], 0.0, rtol=0.0, atol=1e-15)


@pytest.mark.parametrize("mass", [-3.0, 4.0])
def test_a_payload_takes_its_momentum_along_and_the_structure_goes_on_as_it_was(mass: float) -> None:
    inertia, place, state = (
        np.sign(mass) * np.diag([0.3, 0.2, 0.4]),
        POINT,
        moving_state(12.0, np.array([0.3, -0.2, 0.4])),
    )
    jump = rigid_body.Jump(0.0, mass, place, inertia)
    after, structure = rigid_body.apply_jumps(state, rigid_body.pack_structure(SMALL), (jump,))
    center, rotation = structure[6:], rotation_matrix(state[QUATERNION])

    def motion(body: Array, middle: Array, point: Array) -> tuple[Array, Array]:
        arm = point - middle
        return body[POSITION] + rotation @ arm, body[VELOCITY] + rotation @ np.cross(body[RATE], arm)

    def momenta(body: Array, middle: Array, moment: Array) -> Array:
        spin = rotation @ moment @ body[RATE] + body[MASS] * np.cross(body[POSITION], body[VELOCITY])
        return np.concatenate((body[MASS] * body[VELOCITY], spin))

    for point in (np.zeros(3), place):
        assert_allclose(motion(after, center, point), motion(state, SMALL.center_of_mass, point), atol=1e-14)
    where, velocity = motion(state, SMALL.center_of_mass, place)
    spin = rotation @ inertia @ state[RATE] + mass * np.cross(where, velocity)
    expected = momenta(state, SMALL.center_of_mass, SMALL.inertia) + np.concatenate((mass * velocity, spin))
    assert_allclose(momenta(after, center, symmetric_matrix(structure[:6])), expected, rtol=1e-12, atol=1e-13)
    for part in (QUATERNION, RATE, ORIGIN_VELOCITY, SPIN_INTEGRAL):
        assert_array_equal(after[part], state[part])


@pytest.mark.parametrize(
    ("wrench", "transient", "error", "message"),
    [
        (np.zeros(7), np.zeros((1, 7)), ValueError, "every time constant needs its transient"),
        (12.1 * np.eye(7)[6], np.zeros((2, 7)), rigid_body.OutOfMassError, "mass of 12 and its jets use 12.1"),
        (np.eye(7)[6], 35.0 * np.eye(7)[[6, 0]], rigid_body.OutOfMassError, "mass of 12 and its jets use"),
        (50.0 * np.eye(7)[2], np.zeros((2, 7)), rigid_body.SpunUpError, "turns in a step"),
    ],
)
def test_what_cannot_be_followed_is_one_message(
    wrench: Array, transient: Array, error: type[Exception], message: str
) -> None:
    with pytest.raises(error, match=message):
        step(initial_state(SMALL.mass), wrench, transient, (0.5, 0.3), 1.0, motion_constants(SMALL))
