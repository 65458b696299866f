r"""Attitude among the joint estimator's states, and its change over an interval.

    R = exp([psi x]) R_s,    y = log(R_read R_s^T) = psi + noise,

with R from body to fixed frame, psi in fixed axes, and R_s the attitude that gyros integrate from the last reading of
a tracker on, the same for every hypothesis (`shared_attitude`). So psi is small, has no error of its own to be reset,
and a tracker reads it as an accelerometer reads what it has gathered. With w(t) linear from w0 to w1 but for a bow,

    psi <- log(exp([psi x]) R_s exp([W x]) R_s'^T),    W = T (w0 + w1)/2 + (mean of the bow) T + T^2/12 w0 x w1,
    error of psi <- error of psi + B0 (error of w0) + B1 (error of w1),

with B0 and B1 the integrals of R (1 - t/T) and of R t/T, to first order in the turn of the interval, to which each is
T/2 times R after its mean turn, T (w0/3 + (w1 - w0)/12) and T (2 w0/3 + (w1 - w0)/4). In fixed axes an error of the
attitude turns no further.
"""

from __future__ import annotations

import math

import numpy as np

from massprop_drake.maths.attitude import (
    conjugate,
    from_rotation_vector,
    multiply,
    propagate_attitude,
    rotation_matrix,
    to_rotation_vector,
)
from massprop_drake.maths.kernels import kernel
from massprop_drake.maths.linear_algebra import Array, cross

UNTURNED = np.array([1.0, 0.0, 0.0, 0.0])
STILL = np.stack((UNTURNED, UNTURNED))  # shared attitude before and after an interval


@kernel
def turn_attitude(psi: Array, attitudes: Array, rates: Array, offset: Array, duration_s: float) -> tuple[Array, Array]:
    """Propagates the attitude error psi, relative to a reference, over an interval; returns it, derivatives by rates.

    Args:
        psi: before, rad, shape (3,).
        attitudes: reference attitude before and after, quaternions, shape (2, 4).
        rates: w0 and w1, rad/s, body axes, shape (2, 3).
        offset: mean of what the rate lies off the line, rad/s, shape (3,).
    """
    start = multiply(from_rotation_vector(psi), attitudes[0])
    turn = duration_s * (0.5 * (rates[0] + rates[1]) + offset) + duration_s**2 / 12.0 * cross(rates[0], rates[1])
    end = multiply(start, from_rotation_vector(turn))
    by_rates = np.empty((2, 3, 3))
    for point in range(2):
        mean = (point + 1.0) / 3.0 * rates[0] + (2.0 * point + 1.0) / 12.0 * (rates[1] - rates[0])
        mean_attitude = multiply(start, from_rotation_vector(duration_s * mean))
        by_rates[point] = 0.5 * duration_s * rotation_matrix(mean_attitude)
    return to_rotation_vector(multiply(end, conjugate(attitudes[1]))), by_rates


@kernel
def shared_attitude(reference: Array, rate: Array, duration_s: float, quaternions: Array) -> tuple[Array, Array]:
    """Propagates the reference attitude by gyros, or sets it to a tracker's; returns it, trackers' rotations off it.

    Args:
        reference: attitude before, shape (4,).
        rate: by the gyros, rad/s, shape (3,).
        quaternions: readings of trackers, NaN where missing, shape (n, 4).
    """
    after, relative = propagate_attitude(reference, rate, duration_s), np.full((quaternions.shape[0], 3), np.nan)
    first = True
    for tracker in range(quaternions.shape[0]):
        if np.isnan(quaternions[tracker]).any():
            continue
        unit = quaternions[tracker] / math.sqrt(float(np.dot(quaternions[tracker], quaternions[tracker])))
        if first:
            after, first = unit, False
        relative[tracker] = to_rotation_vector(multiply(unit, conjugate(after)))
    return after, relative
