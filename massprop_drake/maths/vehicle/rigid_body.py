r"""Rigid body pushed by jets: its equations of motion and a step of high order.

Frames: N inertial; B body axes at the center of mass; V vehicle frame, axes of B, origin O fixed in
the structure. No gravity: positions and velocities are relative to free fall.

State, shape (23,), in this order (the slices below name the parts):

    quaternion q_NB (4) | rate w_NB_B (3) rad/s | position of the center of mass in N (3) |
    velocity of the center of mass in N (3) | mass | origin velocity V_O (3) | spin integral (6)

V_O is the time integral, in body axes, of the specific force at O, and the spin integral that of
w w^T as xx, yy, zz, yz, xz, xy: together they give what an integrating accelerometer anywhere on the
body has gathered (`sensing.point_velocity`).

With M the torque about the center of mass, F the force, both in body axes (2-30), (3-17):

    dw/dt = I^-1 (M - w x I w),    dv_N/dt = R F / m,    dm/dt = -flow,
    dV_O/dt = F / m - dw/dt x r_cm - w x (w x r_cm)

Inertia and center of mass stay as they are while mass is used up, as in the thesis, unless it comes from tanks that are
stated, see `depletion`: over a step they are then those of its middle. Reaction wheels have an angular
momentum h relative to the body, whose inertia I has them locked, which changes evenly in a step:

    dw/dt = I^-1 (M - dh/dt - w x (I w + h))
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from massprop_drake.errors import moment
from massprop_drake.maths.arrays import Layout
from massprop_drake.maths.attitude import rotation_matrix
from massprop_drake.maths.kernels import kernel, numbers, value_of
from massprop_drake.maths.linear_algebra import Array, cross, has_nonzero, inverse
from massprop_drake.maths.mass_properties import (
    MassProperties,
    Spread,
    attach_body,
    draw_body,
    six_elements,
    symmetric_matrix,
)
from massprop_drake.maths.noise import Seed, normal_sample
from massprop_drake.maths.vehicle.thrust import decay_integral

N_STATE = 23
N_WRENCH = 7  # torque about the vehicle origin (3), force (3), mass flow

QUATERNION = slice(0, 4)
RATE = slice(4, 7)
POSITION = slice(7, 10)
VELOCITY = slice(10, 13)
MASS = 13
ORIGIN_VELOCITY = slice(14, 17)
SPIN_INTEGRAL = slice(17, 23)
STRUCTURE = Layout("structure", inertia=6, center_of_mass=3)  # what does not change but at a jump

# One substep turns the body by at most this much about each axis, rad: the classical Runge-Kutta step then errs by
# less than (angle^5 / 120) = 3e-14 of the rate.
_LARGEST_ANGLE = 0.005

_MOST_TURNS = 1.0  # in a step: beyond, no sensor shows which way a vehicle turns, and no step comes to an end


class SpunUpError(ArithmeticError):
    """Error of jets that have spun the vehicle up beyond all that can be followed.

    Args:
        turns: that it makes in the step.
        time_s: when, once a system that knows the time passes the error on.
    """

    def __init__(self, turns: float, time_s: float = math.nan):
        self.turns, self.time_s = turns, time_s
        super().__init__(f"at t = {moment(time_s)} s the vehicle makes {turns:.3g} turns in a step")

    def at(self, time_s: float) -> SpunUpError:
        """Returns the same error with the simulation time added, s."""
        return SpunUpError(self.turns, time_s)


class OutOfMassError(ArithmeticError):
    """Error of jets that use up the vehicle's whole mass.

    Args:
        left: mass at the beginning of the step, slug or kg.
        wanted: what the jets would use in it.
        time_s: when, once a system that knows the time passes the error on.
    """

    def __init__(self, left: float, wanted: float, time_s: float = math.nan):
        self.left, self.wanted, self.time_s = left, wanted, time_s
        super().__init__(f"at t = {moment(time_s)} s the vehicle has a mass of {left:g} and its jets use {wanted:g}")

    def at(self, time_s: float) -> OutOfMassError:
        """Returns the same error with the simulation time added, s."""
        return OutOfMassError(self.left, self.wanted, time_s)


@kernel
def require_mass(mass: float, used_mass: float) -> None:
    """Raises OutOfMassError when jets would use up all mass of the vehicle.

    Args:
        mass: mass of the vehicle, slug or kg; below zero at a trial step beyond the end.
        used_mass: mass to be used, slug or kg.
    """
    if not mass > used_mass:
        raise OutOfMassError(max(mass, 0.0), used_mass)


_Decay = tuple[Array, float]  # a wrench that dies away, shape (7,), and its time constant, s


_NOTHING = np.empty(0)


class Body(NamedTuple):
    """Constants of a rigid body's motion, as plain numbers for the inner loop.

    Attributes:
        inertia, inverse: six elements each, in the order 11, 22, 33, 23, 13, 12.
        center: center of mass in the vehicle frame, ft or m.
        momentum, momentum_rate: h of the wheels at the start of a step, ft-lbf-s or N-m-s, and its time derivative.
    """

    inertia: tuple[float, ...]
    inverse: tuple[float, ...]
    center: tuple[float, ...]
    momentum: tuple[float, float, float]
    momentum_rate: tuple[float, float, float]


def motion_constants(properties: MassProperties) -> Body:
    """Computes inertia, its inverse and center of mass of a body as constants of its motion."""
    return Body(
        tuple(six_elements(properties.inertia).tolist()),
        tuple(six_elements(inverse(properties.inertia)).tolist()),
        tuple(np.asarray(properties.center_of_mass).tolist()),
        (0.0, 0.0, 0.0),
        (0.0, 0.0, 0.0),
    )


@kernel
def add_wheel_momentum(body: Body, wheels: Array, elapsed_s: float = 0.0) -> Body:
    """Returns the constants of a body's motion with its wheels' angular momentum and torque put in.

    Args:
        body: without them.
        wheels: h at some time and its derivative, shape (6,).
        elapsed_s: time since then, s.
    """
    hx, hy, hz, dx, dy, dz = numbers(wheels, 6)
    momentum = hx + elapsed_s * dx, hy + elapsed_s * dy, hz + elapsed_s * dz
    return Body(body.inertia, body.inverse, body.center, momentum, (dx, dy, dz))


def pack_structure(properties: MassProperties) -> Array:
    """Packs a body's inertia and center of mass into a vector laid out as `STRUCTURE`, shape (9,)."""
    return STRUCTURE.pack((six_elements(properties.inertia), properties.center_of_mass))


def constants_from_structure(structure: Array) -> Body:
    """Computes a body's constants of motion from inertia and center of mass packed as `STRUCTURE`."""
    read = STRUCTURE.read(structure)
    return motion_constants(MassProperties(math.nan, read.center_of_mass, symmetric_matrix(read.inertia)))


@kernel
def constants_kernel(structure: Array) -> Body:
    """Computes constants of motion from a `STRUCTURE` of floats, in compiled code too."""
    inverted = np.linalg.inv(symmetric_matrix(structure[:6]))
    jxx, jyy, jzz = inverted[0, 0], inverted[1, 1], inverted[2, 2]
    off = inverted[1, 2], inverted[0, 2], inverted[0, 1]
    still = (0.0, 0.0, 0.0)
    return Body(numbers(structure[:6], 6), (jxx, jyy, jzz, *off), numbers(structure[6:9], 3), still, still)


def draw_true_body(seed: Seed, body: MassProperties, spread: Spread) -> MassProperties:
    """Draws a vehicle's true mass properties at the start of a run: the nominal ones, spread by a seed."""
    return draw_body(body, spread, normal_sample(seed, "mass properties", 0, 10))


class Jump(NamedTuple):
    """Sudden change of mass: something is fixed to the vehicle, or leaves it, at once.

    Attributes:
        time_s: when, s; it happens at the first sample not before this.
        mass: slug or kg; negative: it leaves.
        position: of its center of mass in the vehicle frame, ft or m, shape (3,).
        inertia: about its own center of mass, body axes, shape (3, 3); negative if it leaves.
    """

    time_s: float
    mass: float
    position: Array
    inertia: Array


def jumps_by_sample(jumps: tuple[Jump, ...], period_s: float) -> dict[int, tuple[Jump, ...]]:
    """Groups mass-property jumps by the index of the sample at which each happens, in their order."""
    found: dict[int, tuple[Jump, ...]] = {}
    for jump in jumps:
        sample = math.ceil(jump.time_s / period_s - 1e-9)
        found[sample] = (*found.get(sample, ()), jump)
    return found


def apply_jumps(state: Array, structure: Array, jumps: tuple[Jump, ...]) -> tuple[Array, Array]:
    """Applies mass-property jumps in a row at one sample; returns state, (23,), and packed structure.

    Args:
        structure: packed as `STRUCTURE`.
        jumps: one after the other.
    """
    read = STRUCTURE.read(structure)
    properties = MassProperties(state[MASS], read.center_of_mass, symmetric_matrix(read.inertia))
    for jump in jumps:
        after = attach_body(properties, jump.mass, jump.position, jump.inertia)
        state = change_properties(state, properties, after)
        properties = after
    return state, pack_structure(properties)


@kernel
def round_as_stored(value: Any, start: Any) -> Any:
    """Rounds a value as `RigidBodyPlant` stores it: a start, which is a parameter, plus the change since, a state."""
    return start + (value - start)


def initial_state(mass: float) -> Array:
    """Returns the body state at rest at the origin of N, shape (23,); velocity integrals are zero."""
    state = np.zeros(N_STATE)
    state[0] = 1.0
    state[MASS] = mass
    return state


@kernel
def torque_about_center(wrench: Array, center_of_mass: Array) -> Array:
    """Computes the torque about the center of mass of a wrench about the vehicle origin, shape (3,)."""
    return wrench[:3] - cross(center_of_mass, wrench[3:6])


def derivative(state: Array, wrench: Array, body: Body) -> Array:
    """Computes the time derivative of the body state under a wrench about the vehicle origin, shape (23,).

    Args:
        wrench: torque about the vehicle origin, force, mass flow, body axes, shape (7,).
        body: constants of the motion.
    """
    return _derivative(state, wrench, _NOTHING, body, 0.0)


@kernel
def _derivative(state: Array, wrench: Array, transient_impulse: Array, body: Body, elapsed_s: float) -> Array:
    """Computes the body state's derivative without decaying thrust; ``elapsed_s``: since wheels' momentum was set.

    ``transient_impulse`` is the impulse (torque about the vehicle origin, force, mass) that decaying thrust has
    given since the step began, and its mass flow now, shape (8,); empty: there is none. Its effect on rate,
    velocity and origin velocity is known in closed form; what is integrated here is the rest:

        w = w' + I^-1 E_M,   v_N = v_N' + R E_F / m,   V_O = V_O' + E_F / m - (I^-1 E_M) x r_cm
    """
    qw, qx, qy, qz, wx, wy, wz, _, _, _, vx, vy, vz, mass = numbers(state[:14], 14)
    mx, my, mz, fx, fy, fz, flow = numbers(wrench, 7)
    ixx, iyy, izz, iyz, ixz, ixy = body.inertia
    jxx, jyy, jzz, jyz, jxz, jxy = body.inverse
    cx, cy, cz = body.center
    # R_NB
    r00, r01, r02 = 1.0 - 2.0 * (qy * qy + qz * qz), 2.0 * (qx * qy - qw * qz), 2.0 * (qx * qz + qw * qy)
    r10, r11, r12 = 2.0 * (qx * qy + qw * qz), 1.0 - 2.0 * (qx * qx + qz * qz), 2.0 * (qy * qz - qw * qx)
    r20, r21, r22 = 2.0 * (qx * qz - qw * qy), 2.0 * (qy * qz + qw * qx), 1.0 - 2.0 * (qx * qx + qy * qy)
    # torque about the center of mass
    mx, my, mz = mx - (cy * fz - cz * fy), my - (cz * fx - cx * fz), mz - (cx * fy - cy * fx)
    # specific force
    ax, ay, az = fx / mass, fy / mass, fz / mass
    tx = ty = tz = 0.0  # what the transient part takes from the derivative of the velocity, body axes
    if transient_impulse.size:
        ex, ey, ez, gx, gy, gz, lost, transient_flow = numbers(transient_impulse, 8)
        mass -= lost
        ax, ay, az = fx / mass, fy / mass, fz / mass
        ex, ey, ez = ex - (cy * gz - cz * gy), ey - (cz * gx - cx * gz), ez - (cx * gy - cy * gx)
        wx += jxx * ex + jxy * ey + jxz * ez
        wy += jxy * ex + jyy * ey + jyz * ez
        wz += jxz * ex + jyz * ey + jzz * ez
        gx, gy, gz = gx / mass, gy / mass, gz / mass
        vx += r00 * gx + r01 * gy + r02 * gz
        vy += r10 * gx + r11 * gy + r12 * gz
        vz += r20 * gx + r21 * gy + r22 * gz
        # the specific force of E_F / m while the mass falls
        rate_of_mass = -(flow + transient_flow) / mass
        ax, ay, az = ax + gx * rate_of_mass, ay + gy * rate_of_mass, az + gz * rate_of_mass
        tx, ty, tz = wy * gz - wz * gy, wz * gx - wx * gz, wx * gy - wy * gx
    # Euler's equation
    px, py, pz = body.momentum
    dx, dy, dz = body.momentum_rate
    mx, my, mz = mx - dx, my - dy, mz - dz
    hx = ixx * wx + ixy * wy + ixz * wz + (px + elapsed_s * dx)
    hy = ixy * wx + iyy * wy + iyz * wz + (py + elapsed_s * dy)
    hz = ixz * wx + iyz * wy + izz * wz + (pz + elapsed_s * dz)
    nx, ny, nz = mx - (wy * hz - wz * hy), my - (wz * hx - wx * hz), mz - (wx * hy - wy * hx)
    ox = jxx * nx + jxy * ny + jxz * nz
    oy = jxy * nx + jyy * ny + jyz * nz
    oz = jxz * nx + jyz * ny + jzz * nz
    # velocity of the center of mass in N
    bx, by, bz = ax - tx, ay - ty, az - tz
    # w x r_cm, then the specific force at the vehicle origin
    sx, sy, sz = wy * cz - wz * cy, wz * cx - wx * cz, wx * cy - wy * cx
    return np.array(
        [
            -0.5 * (qx * wx + qy * wy + qz * wz),
            0.5 * (qw * wx + qy * wz - qz * wy),
            0.5 * (qw * wy + qz * wx - qx * wz),
            0.5 * (qw * wz + qx * wy - qy * wx),
            ox,
            oy,
            oz,
            vx,
            vy,
            vz,
            r00 * bx + r01 * by + r02 * bz,
            r10 * bx + r11 * by + r12 * bz,
            r20 * bx + r21 * by + r22 * bz,
            -flow,
            ax - (oy * cz - oz * cy) - (wy * sz - wz * sy),
            ay - (oz * cx - ox * cz) - (wz * sx - wx * sz),
            az - (ox * cy - oy * cx) - (wx * sy - wy * sx),
            wx * wx,
            wy * wy,
            wz * wz,
            wy * wz,
            wx * wz,
            wx * wy,
        ]
    )


@kernel
def step(
    state: Array,
    steady: Array,
    transient: Array,
    time_constants_s: Sequence[float] | Array,
    duration_s: float,
    body: Body,
) -> Array:
    r"""Computes the body state, (23,), after a step under a steady wrench and exponentially decaying ones.

    The wrench is ``steady + sum_c transient[c] exp(-s / tau_c)``, s the time since the step began. The
    decaying part is integrated in closed form and only its small effect through rotation by the
    classical fourth-order Runge-Kutta method, so a step may be much longer than a time constant.

    Args:
        state: at the start, shape (23,).
        steady: wrench about the vehicle origin that the jets tend to, shape (7,).
        transient: difference from it at the start, one row per time constant, shape (n, 7).
        time_constants_s: positive, s, one per row of ``transient``.
        duration_s: length of the step, s.
        body: constants of the motion.

    Raises:
        ValueError: when there are not as many transients as time constants.
        OutOfMassError: when the jets use up the vehicle's mass in the step.
        SpunUpError: when the vehicle makes more than a turn in it.
    """
    if transient.shape[0] != len(time_constants_s):
        raise ValueError("every time constant needs its transient")
    used, fastest = 0.0, math.inf
    lagging = []
    for index in range(transient.shape[0]):
        row, tau = transient[index], time_constants_s[index]
        used += value_of(row[6]) * decay_integral(tau, duration_s)
        if has_nonzero(row):
            lagging.append((row, tau))
            fastest = min(fastest, tau)
    require_mass(value_of(state[MASS]), value_of(steady[6]) * duration_s + used)
    longest = value_of(_longest_substep(state, steady, lagging, duration_s, body))
    turns = duration_s / longest * _LARGEST_ANGLE / (2.0 * math.pi)
    if not turns <= _MOST_TURNS:
        raise SpunUpError(turns)
    elapsed = 0.0
    while elapsed < duration_s:
        # while thrust decays: half a time constant at first, then each substep as long as all before
        length = min(duration_s - elapsed, longest, max(0.5 * fastest, elapsed))
        if duration_s - elapsed - length < 1e-9 * duration_s:
            length = duration_s - elapsed
        amplitudes = [(row * math.exp(-elapsed / tau), tau) for row, tau in lagging]
        state = _substep(state, steady, amplitudes, (elapsed, length), body)
        elapsed += length
    quaternion = state[QUATERNION]
    state[QUATERNION] = quaternion / np.sqrt(np.dot(quaternion, quaternion))
    return state


@kernel
def _longest_substep(state: Array, steady: Array, decays: list[_Decay], duration_s: float, body: Body) -> float:
    """Computes the longest substep, s, in which the body turns by no more than a small angle."""
    wrench = steady
    if len(decays) > 0:
        wrench = np.abs(steady)
        for row, _ in decays:
            wrench = wrench + np.abs(row)
    mx, my, mz, fx, fy, fz, _ = numbers(np.abs(wrench), 7)
    cx, cy, cz = abs(body.center[0]), abs(body.center[1]), abs(body.center[2])
    torque = max(mx + cy * fz + cz * fy, my + cz * fx + cx * fz, mz + cx * fy + cy * fx)
    wx, wy, wz = numbers(np.abs(state[RATE]), 3)
    rate, least_inertia = max(wx, wy, wz), max(body.inverse[0], body.inverse[1], body.inverse[2])
    rate += torque * least_inertia * duration_s
    for momentum, by_time in zip(body.momentum, body.momentum_rate):  # noqa: B905 (for numba)
        rate += (abs(momentum) + abs(by_time) * duration_s) * least_inertia  # it nutates, and turns
    return math.inf if rate == 0.0 else _LARGEST_ANGLE / rate


@kernel
def _substep(state: Array, steady: Array, amplitudes: list[_Decay], timing_s: tuple[float, float], body: Body) -> Array:
    """Computes the body state after a Runge-Kutta substep; ``timing_s``: start within the step, and length, s."""
    since, length = timing_s
    start = middle = end = _NOTHING
    if len(amplitudes) > 0:
        start, middle, end = (
            _decayed_impulse(amplitudes, 0.0),
            _decayed_impulse(amplitudes, 0.5 * length),
            _decayed_impulse(amplitudes, length),
        )
    half = 0.5 * length
    k1 = _derivative(state, steady, start, body, since)
    k2 = _derivative(state + half * k1, steady, middle, body, since + half)
    k3 = _derivative(state + half * k2, steady, middle, body, since + half)
    k4 = _derivative(state + length * k3, steady, end, body, since + length)
    state = state + (length / 6.0) * (k1 + 2.0 * (k2 + k3) + k4)
    if end.size:
        _add_transient(state, end[:N_WRENCH], body)
    return state


@kernel
def _decayed_impulse(amplitudes: list[_Decay], elapsed_s: float) -> Array:
    """Computes the impulse of decaying wrenches since a substep began, and their mass flow now, shape (8,)."""
    gathered = np.zeros(N_WRENCH + 1, dtype=amplitudes[0][0].dtype)
    for row, tau in amplitudes:
        gathered[:N_WRENCH] += row * decay_integral(tau, elapsed_s)
        gathered[N_WRENCH] += row[6] * math.exp(-elapsed_s / tau)
    return gathered


@kernel
def _add_transient(state: Array, transient_impulse: Array, body: Body) -> None:
    """Adds the closed-form effect of decaying thrust to the state, in place; see `_derivative`."""
    center = np.array(body.center)
    rate_change = symmetric_matrix(np.array(body.inverse)) @ torque_about_center(transient_impulse, center)
    state[MASS] -= transient_impulse[6]
    velocity_change = transient_impulse[3:6] / state[MASS]
    rotation = rotation_matrix(state[QUATERNION] / np.linalg.norm(state[QUATERNION]))
    state[RATE] += rate_change
    state[VELOCITY] += rotation @ velocity_change
    state[ORIGIN_VELOCITY] += velocity_change - cross(rate_change, center)


def change_properties(state: Array, before: MassProperties, after: MassProperties) -> Array:
    """Computes the body state after mass properties jump, the structure's motion going on, shape (23,).

    Rate, attitude and the motion of every point of the structure go on as they were; the new center of
    mass has that structure's motion where it lies, so what leaves takes its momentum along.

    Args:
        before, after: mass properties.
    """
    moved = rotation_matrix(state[QUATERNION])
    shift = after.center_of_mass - before.center_of_mass
    result = state.copy()
    result[POSITION] += moved @ shift
    result[VELOCITY] += moved @ cross(state[RATE], shift)
    result[MASS] = after.mass
    return result


@kernel
def center_shift_increment(state: Array, rate: Array, shift: Array) -> Array:
    """Computes the body state's change as the center of mass shifts, structure moving on, shape (23,).

    Args:
        rate: mean while it moves, rad/s, body axes, shape (3,).
        shift: of the center of mass, vehicle frame, ft or m, shape (3,).
    """
    moved, change = rotation_matrix(state[QUATERNION]), np.zeros(N_STATE)
    change[POSITION] = moved @ shift
    change[VELOCITY] = moved @ cross(rate, shift)
    return change


def angular_momentum(state: Array, properties: MassProperties) -> Array:
    """Computes a body's angular momentum about the center of mass in N, shape (3,)."""
    return rotation_matrix(state[QUATERNION]) @ (properties.inertia @ state[RATE])
