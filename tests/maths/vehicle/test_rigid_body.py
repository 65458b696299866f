"""The rigid body's motion against independent integration, closed forms and conservation laws."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from massprop_drake.inputs.vehicle_file import Vehicle
from massprop_drake.maths.attitude import from_rotation_vector, rotation_matrix
from massprop_drake.maths.linear_algebra import Array
from massprop_drake.maths.mass_properties import MassProperties, symmetric
from massprop_drake.maths.vehicle.rigid_body import (
    MASS,
    N_STATE,
    ORIGIN_VELOCITY,
    POSITION,
    QUATERNION,
    RATE,
    SPIN_INTEGRAL,
    VELOCITY,
    angular_momentum,
    body_of,
    derivative,
    initial_state,
    step,
    torque_about_center,
)
from massprop_drake.maths.vehicle.sensing import point_velocity

PERIOD = 0.08  # s
DEGREE = np.pi / 180.0
NO_WRENCH = np.zeros(7)
NO_TRANSIENT = np.zeros((0, 7))
SMALL = MassProperties(  # kg, m, kg-m^2
    12.0, np.array([0.3, -0.1, 0.2]), np.array([[3.0, 0.2, -0.1], [0.2, 4.0, 0.3], [-0.1, 0.3, 5.0]])
)

Wrench = Callable[[float], Array]


def moving_state(mass: float, rate: Array) -> Array:
    state = initial_state(mass)
    state[QUATERNION] = from_rotation_vector(np.array([0.4, -0.7, 1.1]))
    state[RATE] = rate
    state[POSITION] = [1.0, 2.0, 3.0]
    state[VELOCITY] = [0.3, -0.2, 0.1]
    return state


def equations(state: Array, wrench: Array, properties: MassProperties, point: Array) -> Array:
    """(2-30) and (3-17) in vector form, then the specific force at a point in the vehicle frame."""
    quaternion, rate, mass = state[QUATERNION], state[RATE], state[MASS]
    center, inertia = properties.center_of_mass, properties.inertia
    force = wrench[3:6]
    torque = wrench[:3] - np.cross(center, force)
    acceleration = np.linalg.solve(inertia, torque - np.cross(rate, inertia @ rate))
    scalar, vector = quaternion[0], quaternion[1:]
    turned = scalar * rate + np.cross(vector, rate)

    def specific_force(position: Array) -> Array:
        arm = position - center
        return force / mass + np.cross(acceleration, arm) + np.cross(rate, np.cross(rate, arm))

    spin = np.outer(rate, rate)
    return np.concatenate(
        [
            [-0.5 * vector @ rate],
            0.5 * turned,
            acceleration,
            state[VELOCITY],
            rotation_matrix(quaternion) @ force / mass,
            [-wrench[6]],
            specific_force(np.zeros(3)),
            [spin[0, 0], spin[1, 1], spin[2, 2], spin[1, 2], spin[0, 2], spin[0, 1]],
            specific_force(point),
        ]
    )


def integrated(
    state: Array, wrench: Wrench, duration: float, properties: MassProperties, point: Array | None = None
) -> Array:
    """The state after a duration, with what a point has gathered appended, by an integrator of eighth order."""
    where = np.zeros(3) if point is None else point
    solution = solve_ivp(
        lambda time, extended: equations(extended[:N_STATE], wrench(time), properties, where),
        (0.0, duration),
        np.concatenate([state, np.zeros(3)]),
        method="DOP853",
        rtol=1e-12,
        atol=1e-15,
    )
    return solution.y[:, -1]


def jets_of(vehicle: Vehicle, *designations: str) -> Array:
    rows = [vehicle.jet_index(name) for name in designations]
    return np.column_stack([vehicle.wrenches, vehicle.mass_flows])[rows].sum(axis=0)


def test_derivative_is_that_of_the_equations_of_motion() -> None:
    rng = np.random.default_rng(1)
    body = body_of(SMALL)
    for _ in range(20):
        state = rng.standard_normal(N_STATE)
        state[QUATERNION] /= np.linalg.norm(state[QUATERNION])
        state[MASS] = rng.uniform(5.0, 20.0)
        wrench = rng.standard_normal(7)
        expected = equations(state, wrench, SMALL, np.zeros(3))[:N_STATE]
        # some dozen products of size up to ten
        np.testing.assert_allclose(derivative(state, wrench, body), expected, rtol=0.0, atol=3e-14)


def test_derivative_of_hand_value() -> None:
    # I = diag(1, 2, 4), w = (1, 2, 3): Iw = (1, 4, 12), w x Iw = (12, -9, 2)
    # r_cm = (1, 0, 0), F = (0, 6, 0): r_cm x F = (0, 0, 6); torque (12, -7, 12) - (0, 0, 6)
    # dw = ((12-12)/1, (-7+9)/2, (6-2)/4) = (0, 1, 1)
    # at the origin, arm -r_cm: F/m = (0, 3, 0); dw x (-1, 0, 0) = (0, -1, 1);
    # w x (-1, 0, 0) = (0, -3, 2), w x that = (4+9, -2, -3)
    properties = MassProperties(2.0, np.array([1.0, 0.0, 0.0]), np.diag([1.0, 2.0, 4.0]))
    state = initial_state(2.0)
    state[RATE] = [1.0, 2.0, 3.0]
    state[VELOCITY] = [7.0, 8.0, 9.0]
    rates = derivative(state, np.array([12.0, -7.0, 12.0, 0.0, 6.0, 0.0, 0.5]), body_of(properties))
    np.testing.assert_allclose(rates[QUATERNION], [0.0, 0.5, 1.0, 1.5], rtol=1e-15)
    np.testing.assert_allclose(rates[RATE], [0.0, 1.0, 1.0], rtol=1e-15, atol=1e-15)
    np.testing.assert_array_equal(rates[POSITION], [7, 8, 9])
    np.testing.assert_array_equal(rates[VELOCITY], [0, 3, 0])
    assert rates[MASS] == -0.5
    np.testing.assert_allclose(rates[ORIGIN_VELOCITY], [13.0, 0.0, -2.0], rtol=1e-15, atol=1e-15)
    np.testing.assert_array_equal(rates[SPIN_INTEGRAL], [1, 4, 9, 6, 3, 2])


def test_body_starts_at_rest_at_the_origin() -> None:
    expected = np.zeros(N_STATE)
    expected[0], expected[MASS] = 1.0, 5.0
    np.testing.assert_array_equal(initial_state(5.0), expected)


def test_torque_about_the_center_of_hand_value() -> None:
    # (1, 2, 3) x (0, 0, 5) = (10, -5, 0)
    torque = torque_about_center(np.array([1.0, 1.0, 1.0, 0.0, 0.0, 5.0, 9.0]), np.array([1.0, 2.0, 3.0]))
    np.testing.assert_array_equal(torque, [-9, 6, 1])


def test_constants_of_a_body_are_its_inertia_and_inverse() -> None:
    body = body_of(SMALL)
    np.testing.assert_array_equal(symmetric(np.array(body.inertia)), SMALL.inertia)
    np.testing.assert_allclose(symmetric(np.array(body.inverse)) @ SMALL.inertia, np.eye(3), rtol=0.0, atol=1e-15)
    assert body.center == (0.3, -0.1, 0.2)


def test_angular_momentum_is_given_in_inertial_axes() -> None:
    # quarter turn about z: body x lies along inertial y
    state = initial_state(1.0)
    state[QUATERNION] = [np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)]
    state[RATE] = [2.0, 0.0, 0.0]
    properties = MassProperties(1.0, np.zeros(3), np.diag([3.0, 4.0, 5.0]))
    np.testing.assert_allclose(angular_momentum(state, properties), [0.0, 6.0, 0.0], rtol=0.0, atol=6e-15)


def test_coasting_body_moves_in_a_straight_line() -> None:
    state = moving_state(SMALL.mass, np.array([0.01, -0.02, 0.03]))
    after = step(state, NO_WRENCH, NO_TRANSIENT, (), 5.0, body_of(SMALL))
    np.testing.assert_array_equal(after[VELOCITY], state[VELOCITY])
    np.testing.assert_allclose(after[POSITION], state[POSITION] + 5.0 * state[VELOCITY], rtol=1e-14)
    assert after[MASS] == SMALL.mass


@pytest.mark.parametrize("rates", [(0.5, 0.5, 0.5), (-0.4, 0.6, 0.3)])
def test_coasting_orbiter_keeps_its_angular_momentum(orbiter: Vehicle, rates: tuple[float, ...]) -> None:
    body = body_of(orbiter.nominal)
    state = moving_state(orbiter.nominal.mass, DEGREE * np.array(rates))
    start = angular_momentum(state, orbiter.nominal)
    for _ in range(625):  # 50 s
        state = step(state, NO_WRENCH, NO_TRANSIENT, (), PERIOD, body)
    drift = np.linalg.norm(angular_momentum(state, orbiter.nominal) - start)
    # 625 steps that turn by 0.0012 rad: each errs by rounding, and by 0.0012^5 / 120 = 2e-17
    assert drift < 1e-12 * np.linalg.norm(start)


def test_orbiter_under_constant_jets_follows_the_integrator(orbiter: Vehicle) -> None:
    wrench = jets_of(orbiter, "F1L", "F2R", "L1A", "R4U", "L5D")
    body = body_of(orbiter.nominal)
    state = moving_state(orbiter.nominal.mass, DEGREE * np.array([0.5, -0.3, 0.2]))
    expected = integrated(state, lambda _: wrench, 12 * PERIOD, orbiter.nominal)
    for _ in range(12):
        state = step(state, wrench, NO_TRANSIENT, (), PERIOD, body)
    # the integrator's tolerance, 1e-12 of each element per step
    np.testing.assert_allclose(state[RATE], expected[RATE], rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(state[QUATERNION], expected[QUATERNION], rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(state[POSITION], expected[POSITION], rtol=1e-11)
    np.testing.assert_allclose(state[VELOCITY], expected[VELOCITY], rtol=0.0, atol=1e-11)
    assert state[MASS] == pytest.approx(expected[MASS], rel=1e-13)
    np.testing.assert_allclose(state[ORIGIN_VELOCITY], expected[ORIGIN_VELOCITY], rtol=0.0, atol=1e-11)
    np.testing.assert_allclose(state[SPIN_INTEGRAL], expected[SPIN_INTEGRAL], rtol=0.0, atol=1e-13)


def fired_in_turns(vehicle: Vehicle, time_constants: tuple[float, ...], slowness: float) -> tuple[Array, Array, Array]:
    """Twelve samples with several jets on and off: the state by steps, by the integrator, and what a point gathered.

    ``slowness`` multiplies the time constants.
    """
    constants = tuple(slowness * constant for constant in time_constants)
    jets = [jets_of(vehicle, *names) for names in (("F1L", "L1A"), ("R4U",), ("F2D", "R1R", "F5L"))[: len(constants)]]
    commands = np.array([[1, 1, 1, 0, 0, 1, 1, 0, 1, 0, 0, 0], [0, 1, 1, 1, 1, 1, 0, 1, 1, 1, 0, 0], [1, 0] * 6])
    properties = vehicle.nominal
    body = body_of(properties)
    point = np.array([90.068, -1.146, 1.833])
    state = moving_state(properties.mass, DEGREE * np.array([0.5, -0.3, 0.2]))
    reference, gathered = state, np.zeros(3)
    level = np.zeros(len(constants))
    for command in commands[: len(constants)].T:
        difference = level - command
        steady = sum(share * jet for share, jet in zip(command, jets, strict=True))
        transient = np.array([share * jet for share, jet in zip(difference, jets, strict=True)])

        def wrench(time: float, steady: Array = steady, transient: Array = transient) -> Array:
            return steady + np.exp(-time / np.array(constants)) @ transient

        extended = integrated(reference, wrench, PERIOD, properties, point)
        reference, gathered = extended[:N_STATE], gathered + extended[N_STATE:]
        state = step(state, steady, transient, constants, PERIOD, body)
        level = command + difference * np.exp(-PERIOD / np.array(constants))
    start = moving_state(properties.mass, DEGREE * np.array([0.5, -0.3, 0.2]))
    read = [point_velocity(each[ORIGIN_VELOCITY], each[RATE], each[SPIN_INTEGRAL], point) for each in (start, state)]
    return state, reference, (read[1] - read[0]) - gathered


@pytest.mark.parametrize("slowness", [0.2, 1.0, 10.0])
def test_orbiter_under_jets_that_build_up_and_tail_off_follows_the_integrator(
    orbiter: Vehicle, slowness: float
) -> None:
    # time constants from a hundredth of a sample to several samples
    state, reference, missed = fired_in_turns(orbiter, (0.015, 0.004, 0.04), slowness)
    # attitude, position and spin come from the closed-form velocities by Simpson's rule. A substep of h = tau
    # errs by tau (h / tau)^4 / 2880 e^-1 = 1.2e-4 tau of what the transient gives, F tau / m = 0.012 ft/s and
    # 4e-4 rad/s at tau = 0.04 s: per sample 6e-8 ft and 2e-9 rad
    np.testing.assert_allclose(state[POSITION], reference[POSITION], rtol=0.0, atol=1e-7)
    np.testing.assert_allclose(state[QUATERNION], reference[QUATERNION], rtol=0.0, atol=3e-9)
    # rates of 0.01 rad/s bring a hundredth of the error of the attitude into the rate, and specific forces
    # of 0.3 ft/s^2 a third of it into the velocities
    np.testing.assert_allclose(state[RATE], reference[RATE], rtol=0.0, atol=3e-11)
    np.testing.assert_allclose(state[SPIN_INTEGRAL], reference[SPIN_INTEGRAL], rtol=0.0, atol=6e-11)
    np.testing.assert_allclose(state[VELOCITY], reference[VELOCITY], rtol=0.0, atol=2e-9)
    np.testing.assert_allclose(state[ORIGIN_VELOCITY], reference[ORIGIN_VELOCITY], rtol=0.0, atol=2e-9)
    assert state[MASS] == pytest.approx(reference[MASS], rel=1e-14)
    # so does an accelerometer 58 ft from the center of mass
    np.testing.assert_allclose(missed, 0.0, rtol=0.0, atol=4e-9)


def test_rate_of_a_spherical_body_is_exact_whatever_the_time_constants() -> None:
    # no coupling: I w = M T + sum of transient tau (1 - exp(-T / tau)), with the torque about the center of mass
    properties = MassProperties(10.0, np.array([0.5, 0.2, -0.3]), 2.0 * np.eye(3))
    rng = np.random.default_rng(2)
    steady, transient = 1e-3 * rng.standard_normal(7), 1e-3 * rng.standard_normal((4, 7))
    constants = (1e-4, 0.01, 0.2, 3.0)
    after = step(initial_state(10.0), steady, transient, constants, 0.5, body_of(properties))
    impulse = 0.5 * steady
    for row, tau in zip(transient, constants, strict=True):
        impulse = impulse + row * tau * (1.0 - np.exp(-0.5 / tau))
    torque = impulse[:3] - np.cross(properties.center_of_mass, impulse[3:6])
    np.testing.assert_allclose(after[RATE], torque / 2.0, rtol=1e-13)
    assert after[MASS] == pytest.approx(10.0 - impulse[6], rel=1e-15)


def test_velocity_gained_obeys_the_rocket_equation() -> None:
    # a thrust through the center of mass, build-up and tail-off alike: dv = c ln(m_0 / m), c = F / flow
    exhaust_velocity = 400.0
    force, center = np.array([3.0, 4.0, 0.0]), SMALL.center_of_mass
    jet = np.concatenate([np.cross(center, force), force, [np.linalg.norm(force) / exhaust_velocity]])
    state = initial_state(SMALL.mass)
    level = 0.0
    for command in (1.0, 1.0, 0.0, 1.0, 0.0, 0.0, 0.0):
        state = step(state, command * jet, (level - command) * jet[None], (0.3,), 1.0, body_of(SMALL))
        level = command + (level - command) * np.exp(-1.0 / 0.3)
    # decaying thrust leaves (F tau / m) flow / m = 1.3e-4 of acceleration to the Runge-Kutta method, whose substeps
    # of up to a time constant, 0.3 s, err by a few 1e-4 of that: 1e-8 per step
    gained = exhaust_velocity * np.log(SMALL.mass / state[MASS]) * force / 5.0
    assert state[MASS] < 0.998 * SMALL.mass
    np.testing.assert_allclose(state[VELOCITY], gained, rtol=0.0, atol=1e-7)
    np.testing.assert_allclose(state[ORIGIN_VELOCITY], gained, rtol=0.0, atol=1e-7)
    np.testing.assert_allclose(state[RATE], 0.0, rtol=0.0, atol=1e-15)


def test_fast_tumble_of_a_symmetric_body_is_that_of_the_closed_form() -> None:
    # moments 2, 2, 3: w_x + i w_y turns at (3 - 2) / 2 w_z in body axes
    properties = MassProperties(1.0, np.zeros(3), np.diag([2.0, 2.0, 3.0]))
    state = moving_state(1.0, np.array([0.6, 0.0, 0.8]))
    body = body_of(properties)
    for _ in range(125):  # 10 s
        state = step(state, NO_WRENCH, NO_TRANSIENT, (), PERIOD, body)
    # 2000 substeps of 0.005 rad, each with an error of 0.005^5 / 120 = 3e-14
    expected = [0.6 * np.cos(0.4 * 10.0), 0.6 * np.sin(0.4 * 10.0), 0.8]
    np.testing.assert_allclose(state[RATE], expected, rtol=0.0, atol=2000 * 3e-14)


def test_fast_tumble_under_thrust_follows_the_integrator() -> None:
    wrench = np.array([0.5, -0.3, 0.2, 3.0, -2.0, 1.0, 0.01])
    point = np.array([1.5, -0.7, 0.4])
    start = moving_state(SMALL.mass, np.array([0.6, -0.7, 1.0]))
    expected = integrated(start, lambda _: wrench, 25 * PERIOD, SMALL, point)
    state, body = start, body_of(SMALL)
    for _ in range(25):
        state = step(state, wrench, NO_TRANSIENT, (), PERIOD, body)
    # 2 s at rates up to 1.5 rad/s are 600 substeps of 0.005 rad; scaled by the size of each quantity
    bound = 600 * 3e-14
    np.testing.assert_allclose(state[RATE], expected[RATE], rtol=0.0, atol=bound)
    np.testing.assert_allclose(state[QUATERNION], expected[QUATERNION], rtol=0.0, atol=bound)
    np.testing.assert_allclose(state[POSITION], expected[POSITION], rtol=0.0, atol=10 * bound)
    np.testing.assert_allclose(state[VELOCITY], expected[VELOCITY], rtol=0.0, atol=bound)
    np.testing.assert_allclose(state[ORIGIN_VELOCITY], expected[ORIGIN_VELOCITY], rtol=0.0, atol=bound)
    np.testing.assert_allclose(state[SPIN_INTEGRAL], expected[SPIN_INTEGRAL], rtol=0.0, atol=10 * bound)
    gathered = [
        point_velocity(each[ORIGIN_VELOCITY], each[RATE], each[SPIN_INTEGRAL], point) for each in (start, state)
    ]
    np.testing.assert_allclose(gathered[1] - gathered[0], expected[N_STATE:], rtol=0.0, atol=10 * bound)


def test_one_long_step_of_a_tumbling_body_is_as_good_as_many_short_ones() -> None:
    start = moving_state(SMALL.mass, np.array([0.6, -0.7, 1.0]))
    body = body_of(SMALL)
    short = start
    for _ in range(50):
        short = step(short, NO_WRENCH, NO_TRANSIENT, (), PERIOD, body)
    long = step(start, NO_WRENCH, NO_TRANSIENT, (), 50 * PERIOD, body)
    # 4 s at up to 1.4 rad/s: 1100 substeps
    np.testing.assert_allclose(long, short, rtol=0.0, atol=1100 * 3e-14 * 5.0)


def test_torque_from_rest_is_substepped_for_the_rate_it_will_bring() -> None:
    # 10 N m on 3 to 5 kg m^2 turns a resting body by about 1 rad in a second
    wrench = np.array([10.0, -8.0, 5.0, 0.0, 0.0, 0.0, 0.0])
    state = step(initial_state(SMALL.mass), wrench, NO_TRANSIENT, (), 1.0, body_of(SMALL))
    expected = integrated(initial_state(SMALL.mass), lambda _: wrench, 1.0, SMALL)
    # at most 4 / 0.005 = 800 substeps of 3e-14
    np.testing.assert_allclose(state[RATE], expected[RATE], rtol=0.0, atol=800 * 3e-14)
    np.testing.assert_allclose(state[QUATERNION], expected[QUATERNION], rtol=0.0, atol=800 * 3e-14)


@pytest.mark.parametrize(("force_axis", "offset_axis"), [(0, 1), (0, 2), (1, 0), (1, 2), (2, 0), (2, 1)])
def test_torque_of_a_force_beside_the_center_of_mass_is_substepped_too(force_axis: int, offset_axis: int) -> None:
    # 10 N at 1 m from the center of mass, through the vehicle origin; from rest to 2 or 3 rad/s in a second
    properties = SMALL._replace(center_of_mass=np.eye(3)[offset_axis])
    wrench = np.zeros(7)
    wrench[3 + force_axis] = 10.0
    state = step(initial_state(SMALL.mass), wrench, NO_TRANSIENT, (), 1.0, body_of(properties))
    expected = integrated(initial_state(SMALL.mass), lambda _: wrench, 1.0, properties)
    # at most 3.5 / 0.005 = 700 substeps of 3e-14
    np.testing.assert_allclose(state[RATE], expected[RATE], rtol=0.0, atol=700 * 3e-14)
    np.testing.assert_allclose(state[QUATERNION], expected[QUATERNION], rtol=0.0, atol=700 * 3e-14)


def test_transient_that_has_died_away_makes_no_difference() -> None:
    wrench = np.array([0.5, -0.3, 0.2, 3.0, -2.0, 1.0, 0.01])
    start = moving_state(SMALL.mass, np.array([0.1, 0.2, 0.3]))
    body = body_of(SMALL)
    without = step(start, wrench, NO_TRANSIENT, (), PERIOD, body)
    np.testing.assert_array_equal(step(start, wrench, np.zeros((2, 7)), (0.015, 0.3), PERIOD, body), without)


def test_every_time_constant_needs_its_transient() -> None:
    with pytest.raises(ValueError, match="every time constant needs its transient"):
        step(initial_state(1.0), NO_WRENCH, np.zeros((1, 7)), (0.015, 0.3), PERIOD, body_of(SMALL))


def test_attitude_stays_normalized(orbiter: Vehicle) -> None:
    wrench = jets_of(orbiter, "L1A", "R4U")
    state = moving_state(orbiter.nominal.mass, np.array([0.3, -0.2, 0.1]))
    body = body_of(orbiter.nominal)
    for _ in range(50):
        state = step(state, wrench, -wrench[None], (0.015,), PERIOD, body)
        assert np.linalg.norm(state[QUATERNION]) == pytest.approx(1.0, abs=4e-16)


def test_state_given_is_not_changed() -> None:
    start = moving_state(SMALL.mass, np.array([0.1, 0.2, 0.3]))
    before = start.copy()
    wrench, transient = np.ones(7), -np.ones((1, 7))
    step(start, wrench, transient, (0.015,), PERIOD, body_of(SMALL))
    np.testing.assert_array_equal(start, before)
    np.testing.assert_array_equal(wrench, np.ones(7))
    np.testing.assert_array_equal(transient, -np.ones((1, 7)))
