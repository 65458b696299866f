"""Readings of gyros, integrating accelerometers and trackers of attitude, and which of them count.

Equations: theory page of the joint filter, "Measurement", with O = [(w - w_ref) x] + C, C the integral of [w x]^2 dt
since the last rebase and w_ref the rate then. Derivatives: 1 by c_s, -[rho_s x] by w, -O by r; C is taken as known.

A reading of a sensor whose noise does not dither it counts when

    it differs from the one before,    it is the one before that,    |y - y^| > q/2 + 3 s,    or    sqrt(h^T P h) > q/2.

`quantized` says what it then tells. One that is missing (NaN) does not count.
"""

from __future__ import annotations

import numpy as np

from massprop_drake.maths.estimation.joint.covariance import compress_root
from massprop_drake.maths.estimation.joint.layout import CENTER, RATE, VELOCITY, JointParams, JointState
from massprop_drake.maths.estimation.joint.rate_coupling import RateRead, turning_matrix
from massprop_drake.maths.kernels import kernel
from massprop_drake.maths.linear_algebra import Array, skew

_IDENTITY = np.eye(3)
POOR = 10.0  # times as noisy as others is a poor reading of a tracker
_OFF = 3.0  # sigmas by which a prediction lies outside a reading's cell


@kernel
def readings(rates: Array, velocities: Array, attitudes: Array) -> Array:
    """Concatenates readings of gyros, accelerometers and trackers into one vector, shape (n_outputs,).

    Args:
        rates: of each gyro package, NaN where missing, rad/s, shape (n_gyros, 3).
        velocities: of each accelerometer package, shape (n_accelerometers, 3).
        attitudes: of each tracker, see `orientation`, shape (n_trackers, 3).
    """
    return np.concatenate((rates.ravel(), velocities.ravel(), attitudes.ravel()))


@kernel
def combine_gyros(rates: Array, mean: Array, params: JointParams) -> RateRead:
    """Averages the gyros' rates weighted by inverse variance, biases removed; with derivatives and variance.

    Args:
        rates: of each package, NaN where missing, rad/s, shape (n_gyros, 3).
        mean: with the biases, shape (size,).
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
                    relative_weight = 1.0 / (params.variances[3 * package + axis] * total)
                    rows[axis, column] = -relative_weight * params.gyro_bias_sigma
                    rate[axis] += rows[axis, column] * mean[column]
    return RateRead(rate, rows, variance)


@kernel
def predict_outputs(mean: Array, reference: Array, spin: Array, params: JointParams) -> tuple[Array, Array]:
    """Predicts readings from the state's mean, shape (m,), and their Jacobian H, shape (m, size)."""
    places = params.places
    values, jacobian = np.empty(places.outputs), np.zeros((places.outputs, places.size))
    for package in range(places.gyros):
        rows = slice(3 * package, 3 * package + 3)
        values[rows] = mean[RATE]
        jacobian[rows, RATE] = _IDENTITY
        if places.n_gyro_bias > 0:
            columns = slice(places.gyro_bias + 3 * package, places.gyro_bias + 3 * package + 3)
            values[rows] += params.gyro_bias_sigma * mean[columns]
            jacobian[rows, columns] = params.gyro_bias_sigma * _IDENTITY
    if places.accelerometers > 0:
        turn = turning_matrix(mean[RATE], reference, spin)
        for package in range(places.accelerometers):
            begin = 3 * (places.gyros + package)
            rows = slice(begin, begin + 3)
            columns = slice(VELOCITY + 3 * package, VELOCITY + 3 * package + 3)
            arm = params.accelerometer_positions[package] - mean[CENTER]
            values[rows] = mean[columns] + turn @ arm
            jacobian[rows, columns] = _IDENTITY
            jacobian[rows, RATE] = -skew(arm)
            jacobian[rows, CENTER] = -turn
    for tracker in range(places.trackers):
        begin = 3 * (places.gyros + places.accelerometers + tracker)
        rows, columns = slice(begin, begin + 3), slice(places.attitude, places.attitude + 3)
        values[rows] = mean[columns]
        jacobian[rows, columns] = _IDENTITY
    return values, jacobian


@kernel
def find_changed(reading: Array, last_reading: Array, params: JointParams) -> np.ndarray:
    """Flags readings at least half a quantizer cell off the last ones, or without a last one, shape (m,).

    Args:
        reading, last_reading: NaN where missing, shape (m,) each.
    """
    return ~np.isnan(reading) & ~(np.abs(reading - last_reading) <= 0.5 * params.cells)


@kernel
def select_counting(
    reading: Array, last_reading: Array, predicted: Array, variance: Array, floors: Array, params: JointParams
) -> tuple[np.ndarray, Array]:
    """Flags readings to use: dithered, changed, off their cell, ill predicted; returns mask and variance floors, (m,).

    Args:
        reading, last_reading: NaN where missing, shape (m,) each.
        predicted, variance: of the outputs, shape (m,) each.
        floors: see `quantized`, shape (m,).
    """
    half = 0.5 * params.cells
    outside = np.abs(reading - predicted) > half + _OFF * np.sqrt(variance + floors)
    changed = (params.dithered > 0.0) | find_changed(reading, last_reading, params) | (np.sqrt(variance) > half)
    return ~np.isnan(reading) & (changed | outside), np.where(outside & ~changed, params.variances, floors)


@kernel
def add_tracker_variances(
    innovation: Array, projected: Array, rate: Array, floors: Array, params: JointParams
) -> tuple[Array, Array]:
    """Returns variances and variance floors of readings, widened for trackers' stamp errors and outliers, shape (m,).

    A stamp that is off by dt turns a reading by the rate times dt. A reading that is likelier a poor one, by the share
    of these, has the variance of one.

    Args:
        innovation: e of all components, NaN where missing, shape (m,).
        projected: H times the root, shape (m, k).
        rate: rad/s, shape (3,).
        floors: see `quantized`, shape (m,).
    """
    variances, floors = params.variances.copy(), floors.copy()
    trackers, begin = params.trackers, params.places.outputs - 3 * params.places.trackers
    for tracker in range(params.places.trackers):
        rows = slice(begin + 3 * tracker, begin + 3 * tracker + 3)
        variance = trackers.variances[tracker] + trackers.stamp_variances[tracker] * (rate @ rate)
        outlier_share, error = trackers.outliers[tracker], innovation[rows] / np.sqrt(variance)
        if outlier_share > 0.0 and not np.isnan(error).any():
            spread = projected[rows] @ projected[rows].T / variance
            log_fair = np.log(1.0 - outlier_share) + _log_density(error, spread + _IDENTITY)
            if np.log(outlier_share) + _log_density(error, spread + POOR**2 * _IDENTITY) > log_fair:
                variance *= POOR**2
        variances[rows], floors[rows] = variance, variance
    return variances, floors


@kernel
def _log_density(error: Array, covariance: Array) -> float:
    """Computes the log density of a zero-mean Gaussian in three components, its constant left out, nats."""
    return -0.5 * (np.log(np.linalg.det(covariance)) + error @ np.linalg.solve(covariance, error))


def fix_velocity_reference(state: JointState, params: JointParams) -> JointState:
    """Re-references accelerometer velocities to the present rate, so that a center-of-mass jump leaves them unchanged.

    c_s <- c_s + O rho_s, w_ref <- w, C <- 0: for a jump of the mass properties, and never for an increment, after which
    the old center of mass was wrong all along.
    """
    places = params.places
    turn = turning_matrix(state.mean[RATE], state.reference, state.spin)
    mean, root = state.mean.copy(), state.root.copy()
    shift = turn @ state.root[CENTER]
    for package in range(places.accelerometers):
        part = slice(VELOCITY + 3 * package, VELOCITY + 3 * package + 3)
        mean[part] += turn @ (params.accelerometer_positions[package] - mean[CENTER])
        root[part] -= shift
    return state._replace(
        mean=mean, root=compress_root(root, places.thrust), reference=state.mean[RATE].copy(), spin=np.zeros(6)
    )
