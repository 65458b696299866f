r"""Readings of gyros and integrating accelerometers, and which of them count.

    gyro g            y = w + sigma_g b_g
    accelerometer s   y = c_s + O rho_s,    rho_s = p_s - r,    O = [(w - w_ref) x] + C

with C the integral of [w x]^2 dt since the last rebase, w_ref the rate then. Derivatives: 1 by c_s, -[rho_s x] by w,
-O by r; C is taken as known.

*Quantizer.* A rate that stays within one step gives the same reading again and again, which says nothing new. A
component is used when, with Y the variance of its prediction (without the reading's own),

    |y^ - y^_last| >= q    or    |y - y^| > q/2 + 3 sqrt(Y)    or    sqrt(Y) > q/2,

y^_last its filtered output when it was used last; always where the sensor's noise dithers it, sigma_n >= q/4, which
params say by a step of zero. A reading that is missing (NaN) is not used.

A force of which nothing is known, as that of a jet that gives something else every time, makes all predictions worse
than that in each sample, and the roundings of those that stand still would be taken for new ones. Of it one reading
tells, the one that it moves by most in 1-sigmas of the reading; Y of the others is that given this reading, see
`told_by_one`.
"""

from __future__ import annotations

import numpy as np

from massprop_drake.maths.estimation.joint.covariance import compressed
from massprop_drake.maths.estimation.joint.layout import CENTER, RATE, VELOCITY, JointParams, JointState
from massprop_drake.maths.estimation.joint.prediction import RateRead, turning
from massprop_drake.maths.kernels import kernel
from massprop_drake.maths.linear_algebra import Array, skew

_IDENTITY = np.eye(3)
_UNKNOWN = 0.9  # of full thrust, 1 sigma: a force of which nothing is known


@kernel
def readings(rates: Array, velocities: Array) -> Array:
    """All components that are read, gyros first, shape (n_outputs,).

    Args:
        rates: of each gyro package, NaN where missing, rad/s, shape (n_gyros, 3).
        velocities: of each accelerometer package, shape (n_accelerometers, 3).
    """
    return np.concatenate((rates.ravel(), velocities.ravel()))


@kernel
def rate_read(rates: Array, mean: Array, params: JointParams) -> RateRead:
    """The rate that gyros show, weighted by their variances.

    Args:
        rates: of each package, NaN where missing, rad/s, shape (n_gyros, 3).
        mean: with the biases, shape (size,).
        params: see `JointParams`.
    """
    places = params.places
    rate, rows, variance = np.full(3, np.nan), np.zeros((3, places.size)), np.full(3, np.inf)
    for axis in range(3):
        total = weighted = 0.0
        for package in range(places.gyros):
            if not np.isnan(rates[package, axis]):
                weight = 1.0 / params.variances[3 * package + axis]
                total += weight
                weighted += weight * rates[package, axis]
        if total == 0.0:
            continue
        rate[axis], variance[axis] = weighted / total, 1.0 / total
        if places.n_gyro_bias > 0:
            for package in range(places.gyros):
                if not np.isnan(rates[package, axis]):
                    column = places.gyro_bias + 3 * package + axis
                    share = 1.0 / (params.variances[3 * package + axis] * total)
                    rows[axis, column] = -share * params.gyro_bias_sigma
                    rate[axis] += rows[axis, column] * mean[column]
    return RateRead(rate, rows, variance)


@kernel
def outputs(mean: Array, reference: Array, spin: Array, params: JointParams) -> tuple[Array, Array]:
    """Predicted outputs of all components, shape (m,), and their derivative by the state, shape (m, size)."""
    places = params.places
    n_outputs = 3 * (places.gyros + places.accelerometers)
    values, jacobian = np.empty(n_outputs), np.zeros((n_outputs, places.size))
    for package in range(places.gyros):
        rows = slice(3 * package, 3 * package + 3)
        values[rows] = mean[RATE]
        jacobian[rows, RATE] = _IDENTITY
        if places.n_gyro_bias > 0:
            columns = slice(places.gyro_bias + 3 * package, places.gyro_bias + 3 * package + 3)
            values[rows] += params.gyro_bias_sigma * mean[columns]
            jacobian[rows, columns] = params.gyro_bias_sigma * _IDENTITY
    if places.accelerometers > 0:
        turn = turning(mean[RATE], reference, spin)
        for package in range(places.accelerometers):
            begin = 3 * (places.gyros + package)
            rows = slice(begin, begin + 3)
            columns = slice(VELOCITY + 3 * package, VELOCITY + 3 * package + 3)
            arm = params.accelerometer_positions[package] - mean[CENTER]
            values[rows] = mean[columns] + turn @ arm
            jacobian[rows, columns] = _IDENTITY
            jacobian[rows, RATE] = -skew(arm)
            jacobian[rows, CENTER] = -turn
    return values, jacobian


@kernel
def used(read: Array, predicted: Array, last: Array, deviation: Array, quanta: Array) -> np.ndarray:
    """Which components count, shape (m,).

    Args:
        read, predicted: readings, NaN where missing, and outputs, shape (m,).
        last: filtered output when each was used last, shape (m,).
        deviation: 1-sigma of the prediction, shape (m,).
        quanta: see `JointParams`, shape (m,).
    """
    moved = np.abs(predicted - last) >= quanta
    off = np.abs(read - predicted) > 0.5 * quanta + 3.0 * deviation
    poor = deviation > 0.5 * quanta
    return ~np.isnan(read) & (moved | off | poor)


@kernel
def unknown_forces(state: JointState, params: JointParams) -> int:
    """How many failed jets there are of whose force nothing is known."""
    count = 0
    for slot in range(state.slot_jet.shape[0]):
        if state.slot_jet[slot] >= 0:
            most = params.thrusts[int(state.slot_jet[slot])]
            count += np.sqrt(np.sum(state.root[params.places.force + slot] ** 2)) >= _UNKNOWN * most
    return count


@kernel
def told_by_one(projected: Array, read: Array, forces: int, variances: Array) -> tuple[Array, np.ndarray]:
    """1-sigma of each prediction once one reading for each unknown force is known, and which readings these are.

    Args:
        projected: H times a root of the state's covariance, shape (m, k).
        read: readings, NaN where missing, shape (m,).
        forces: how many there are of which nothing is known.
        variances: of the readings, shape (m,).

    Returns:
        Shape (m,), and (m,).
    """
    telling = np.zeros(read.shape[0], dtype=np.bool_)
    if forces == 0:
        return np.sqrt(np.sum(projected * projected, axis=1)), telling
    covariance = projected @ projected.T
    for _ in range(forces):
        ratio = np.where(np.isnan(read) | telling, 0.0, np.diag(covariance) / variances)
        most = np.argmax(ratio)
        if ratio[most] == 0.0:
            break
        telling[most] = True
        column = covariance[:, most].copy()
        covariance = covariance - np.outer(column, column) / (column[most] + variances[most])
    return np.sqrt(np.maximum(np.diag(covariance), 0.0)), telling


def rebased(state: JointState, params: JointParams) -> JointState:
    """The state with what accelerometers have gathered so far taken as it is, whatever the center of mass now becomes.

    c_s <- c_s + O rho_s, w_ref <- w, C <- 0: for a jump of the mass properties, and never for an increment, after which
    the old center of mass was wrong all along.
    """
    places = params.places
    turn = turning(state.mean[RATE], state.reference, state.spin)
    mean, root = state.mean.copy(), state.root.copy()
    shift = turn @ state.root[CENTER]
    for package in range(places.accelerometers):
        part = slice(VELOCITY + 3 * package, VELOCITY + 3 * package + 3)
        mean[part] += turn @ (params.accelerometer_positions[package] - mean[CENTER])
        root[part] -= shift
    return state._replace(
        mean=mean, root=compressed(root, places.thrust), reference=state.mean[RATE].copy(), spin=np.zeros(6)
    )
