"""Dynamic coupling of a rate that is linear in time but for its bows, and the turning of accelerometers.

Equations: theory page of the joint filter, "Prediction" and "Measurement", with g, t, u0 = (2 l0 + l1)/6, u1 = (l0 +
2 l1)/6, the bows' angular impulses dL, dL' and dL" (mean, first moment, root mean square), and D0, D1, G as there.
The root mean square is exact where all jets that switch are bowed alike, and close to that otherwise. Before coupling
counts, the most that it can be for any body, |w|^2 T, is noise on w: else an open-loop drift would be taken for what
J and r are to explain. w1, coupling included, is solved for to the last digits: what is left of its equation has one
sign while a vehicle turns fast, and gathers.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from massprop_drake.maths.estimation.filters.rate_increments import angular_block
from massprop_drake.maths.estimation.joint.forcing import Drive, thrust_bow_impulses
from massprop_drake.maths.estimation.joint.layout import INERTIA, N_PROPERTIES, RATE, JointParams, JointState
from massprop_drake.maths.kernels import kernel, numbers, take_elements
from massprop_drake.maths.linear_algebra import Array, cross, inverse_positive_definite, is_positive_definite, skew
from massprop_drake.maths.mass_properties import ELEMENT

_IDENTITY = np.eye(3)
_PAIRS = ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))
PARABOLA = 1.2**0.5  # root mean square over mean
_SETTLED = 1e-9  # of the rate at the end, that is left of the equation for it: a hundredth of that is in the coupling
_ROUNDS = 4  # each squares what is left, which is a hundredth of the rate where a vehicle turns by a degree a sample


class RateRead(NamedTuple):
    """Rate that gyros show at the end of an interval.

    Attributes:
        rate: weighted mean of the packages, biases taken off, NaN where none reads, rad/s, shape (3,).
        rows: its derivative by the state: by the biases, shape (3, size).
        variance: of its error, (rad/s)^2, shape (3,).
    """

    rate: Array
    rows: Array
    variance: Array


class Coupling(NamedTuple):
    """Dynamic coupling over an interval.

    Attributes:
        change: g, rad/s, shape (3,).
        by_inertia: its derivative by J, shape (3, 6).
        by_start, by_end: by w0 and w1, shape (3, 3).
    """

    change: Array
    by_inertia: Array
    by_start: Array
    by_end: Array


@kernel
def known_coupling_change(state: JointState, duration_s: float) -> Array:
    """Computes the rate's change by gyroscopic coupling, rad/s, shape (3,); zero if inertia is poorly known."""
    if not _knows_inertia(state.mean, state.root[:N_PROPERTIES] @ state.root[:N_PROPERTIES].T):
        return np.zeros(3)
    inverse, rate = take_elements(state.mean, ELEMENT), state.mean[RATE]
    return inverse @ cross(inverse_positive_definite(inverse, "inverse inertia") @ rate, rate) * duration_s


@kernel
def coupled_rate(
    state: JointState,
    forces: Drive,
    uncoupled_change: Array,
    reading_and_gain: tuple[RateRead, Array],
    momenta: Array,
    params: JointParams,
) -> tuple[bool, Coupling, Array, Array]:
    """Solves for gyroscopic coupling and final rate; returns whether inertia is known, coupling, rate, its curvature.

    Where coupling does not count, only that by the wheels' momentum is in it.

    Args:
        uncoupled_change: of the rate, rad/s, shape (3,).
        reading_and_gain: of the gyros, see `rate_reading_gain`.
        momenta: h at the start and the end, shape (2, 3).
    """
    mean, duration = state.mean, forces.firing.duration_s
    inverse, start, none = take_elements(mean, ELEMENT), mean[RATE], np.zeros((3, 3))
    counts = _knows_inertia(mean, state.root[:N_PROPERTIES] @ state.root[:N_PROPERTIES].T)
    if not (counts or params.places.wheels + params.places.n_swing > 0):
        nothing = Coupling(none[0], np.zeros((3, 6)), none, none)
        return False, nothing, _correct_rate(start + uncoupled_change, reading_and_gain[0], reading_and_gain[1]), none
    inertias = inverse, inverse_positive_definite(inverse, "inverse inertia") if counts else none
    turning = inertias[1], momenta
    of_thrust = thrust_bow_impulses(state, forces, params)
    line = start + uncoupled_change
    end = _correct_rate(line, reading_and_gain[0], reading_and_gain[1])
    bows = of_thrust + _coupling_bow_impulses(turning, start, end, duration)
    terms = coupling(inertias, (start, end), momenta, bows, duration)
    for _ in range(_ROUNDS):  # by Newton's method: the rate at the end has the coupling in it
        residual = _correct_rate(line + terms.change, reading_and_gain[0], reading_and_gain[1]) - end
        if np.abs(residual).max() <= _SETTLED * np.abs(end).max():
            break
        end = end + np.linalg.solve(_IDENTITY - (1.0 - reading_and_gain[1]).reshape(3, 1) * terms.by_end, residual)
        bows = of_thrust + _coupling_bow_impulses(turning, start, end, duration)
        terms = coupling(inertias, (start, end), momenta, bows, duration)
    return counts, terms, end, bows @ inverse


@kernel
def add_coupling_derivative(rate_rows: Array, terms: Coupling, rate_read: RateRead, gain: Array) -> Array:
    """Returns the derivative of the change of rate by the state, with gyroscopic coupling, shape (3, size)."""
    rows, own = rate_rows.copy(), (1.0 - gain).reshape(3, 1)
    rows[:, RATE] += terms.by_start
    rows[:, INERTIA] += terms.by_inertia
    end_rows = own * rows + gain.reshape(3, 1) * rate_read.rows
    end_rows[:, RATE] += own * _IDENTITY
    return rows + terms.by_end @ np.linalg.solve(_IDENTITY - own * terms.by_end, end_rows)


@kernel
def rate_reading_gain(rate_root: Array, noise: Array, rate_read: RateRead) -> tuple[Array, Array]:
    """Computes the Kalman gain of a rate reading on the predicted rate and the variance left, shape (3,) each.

    Args:
        rate_root: of the covariance of the predicted rate without the noise, shape (3, k).
        noise: of the interval, shape (6, 6).
    """
    gain, remaining = np.zeros(3), np.empty(3)
    for axis in range(3):
        variance = rate_root[axis] @ rate_root[axis] + noise[axis, axis]
        if not np.isnan(rate_read.rate[axis]):
            total = variance + rate_read.variance[axis]
            gain[axis] = variance / total if total > 0.0 else 1.0
        remaining[axis] = (1.0 - gain[axis]) * variance
    return gain, remaining


@kernel
def _correct_rate(rate: Array, rate_read: RateRead, gain: Array) -> Array:
    """Returns the predicted rate corrected by the gyros' reading with given gains, rad/s, shape (3,)."""
    result = rate.copy()
    for axis in range(3):
        if gain[axis] > 0.0:
            result[axis] += gain[axis] * (rate_read.rate[axis] - rate[axis])
    return result


@kernel
def arm_turning_integrals(start: Array, end: Array, arms: Array, duration_s: float) -> Array:
    """Computes derivatives of centripetal velocity gain of lever arms by rates w0 and w1, shape (2, n, 3, 3).

    Args:
        start, end: w0 and w1, rad/s, shape (3,).
        arms: ft or m, shape (n, 3).
    """
    n, rates = arms.shape[0], np.empty((2, 3))  # G is linear in the rate
    rates[0] = (duration_s / 6.0) * (2.0 * start + end)
    rates[1] = (duration_s / 6.0) * (start + 2.0 * end)
    turned = rates.reshape(2, 1, 3, 1) * arms.reshape(1, n, 1, 3)
    turned -= 2.0 * rates.reshape(2, 1, 1, 3) * arms.reshape(1, n, 3, 1)
    turned += (rates @ arms.T).reshape(2, n, 1, 1) * _IDENTITY
    return turned


@kernel
def _coupling_bow_impulses(inertia_momenta: tuple[Array, Array], start: Array, end: Array, duration_s: float) -> Array:
    """Computes mean, first moment, RMS of angular impulse by curvature of the rate under coupling, shape (3, 3)."""
    bows, (inertia, momenta) = np.zeros((3, 3)), inertia_momenta
    at_start, at_end = inertia @ start + momenta[0], inertia @ end + momenta[1]
    bows[0] = (cross(end, at_end) - cross(start, at_start)) * (duration_s / 12.0)
    bows[2] = PARABOLA * bows[0]
    return bows


@kernel
def coupling(
    inertias: tuple[Array, Array], rates: tuple[Array, Array], momenta: Array, bow_impulses: Array, duration_s: float
) -> Coupling:
    """Computes the rate's change by gyroscopic coupling, its bow (curvature) included, and derivatives by J, rates.

    Args:
        inertias: J and its inverse, shape (3, 3) each; zero in its place: h alone is turned.
        rates: w0 and w1, rad/s, shape (3,) each.
        momenta: h at the start and the end, shape (2, 3).
        bow_impulses: dL, dL' and dL", angular impulses about the center of mass, shape (3, 3).
    """
    (inverse, inertia), (start, end) = inertias, rates
    own = inertia @ ((2.0 * start + end) / 6.0), inertia @ ((start + 2.0 * end) / 6.0)
    at_start, at_end = inertia @ start + momenta[0], inertia @ end + momenta[1]
    first, second = (2.0 * at_start + at_end) / 6.0, (at_start + 2.0 * at_end) / 6.0
    turn = cross(start, first) + cross(end, second)
    over_start, over_end = skew(start) @ inertia, skew(end) @ inertia
    by_inertia = angular_block(turn) - inverse @ (over_start @ angular_block(own[0]) + over_end @ angular_block(own[1]))
    by_start = inverse @ (over_start / 3.0 + over_end / 6.0 - skew(first))
    by_end = inverse @ (over_start / 6.0 + over_end / 3.0 - skew(second))
    bowed = bow_impulses @ inverse
    bent = cross(0.5 * (start + end), bow_impulses[0]) + cross(bowed[0], 0.5 * (at_start + at_end))
    bent += cross(end - start, bow_impulses[1]) + cross(bowed[1], at_end - at_start) + cross(bowed[2], bow_impulses[2])
    through = inverse @ (turn + bent) * -duration_s
    return Coupling(through, -duration_s * by_inertia, -duration_s * by_start, -duration_s * by_end)


@kernel
def largest_coupling(start: Array, end: Array, duration_s: float) -> float:
    """Returns the largest change of the rate by gyroscopic coupling for any inertia, w^2 T, rad/s.

    No principal moment of a body exceeds the sum of the other two, so |J (w x J^-1 w)| <= |w|^2.

    Args:
        start, end: rates, rad/s, shape (3,).
    """
    return max(float(start @ start), float(end @ end)) * duration_s


@kernel
def spin_integral(start: Array, end: Array, curvature: Array, duration_s: float) -> Array:
    """Computes the time integral of w w^T, w linear in time but for a curvature, six elements, rad^2/s, shape (6,).

    Args:
        start, end: rates, rad/s, shape (3,).
        curvature: mean, first moment and root mean square of the rate off the line, rad/s, shape (3, 3).
    """
    result, middle, gained = np.empty(6), 0.5 * (start + end), end - start
    for k, (i, j) in enumerate(_PAIRS):
        straight = (start[i] * start[j] + end[i] * end[j]) / 3.0 + (start[i] * end[j] + end[i] * start[j]) / 6.0
        bent = middle[i] * curvature[0, j] + middle[j] * curvature[0, i] + curvature[2, i] * curvature[2, j]
        bent += gained[i] * curvature[1, j] + gained[j] * curvature[1, i]
        result[k] = duration_s * (straight + bent)
    return result


@kernel
def turning_matrix(rate: Array, reference: Array, spin: Array) -> Array:
    """Returns the matrix O from lever arm to its velocity by rotation since the last rebase, rad/s, shape (3, 3).

    Args:
        rate, reference: w and w_ref, rad/s, shape (3,).
        spin: integral of w w^T dt since the last rebase, six elements, shape (6,).
    """
    xx, yy, zz, yz, xz, xy = numbers(spin, 6)
    centripetal = np.array([[-(yy + zz), xy, xz], [xy, -(xx + zz), yz], [xz, yz, -(xx + yy)]])
    return skew(rate - reference) + centripetal


@kernel
def _knows_inertia(mean: Array, covariance: Array) -> bool:
    """Tests whether inverse inertia J is positive definite, and 1-sigmas of its diagonal below half their values."""
    for i in range(3):
        if not np.sqrt(covariance[i, i]) < 0.5 * mean[i]:
            return False
    return is_positive_definite(take_elements(mean, ELEMENT))
