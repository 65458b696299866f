r"""A torque and a force that nobody commands and that change slowly, as states of the joint estimator.

Each of the n components that the vehicle states is a first-order Gauss-Markov process z_i of unit variance, with a
common time constant T_d, and a_i the acceleration that one sigma of it gives the nominal vehicle, angular and linear:
d(w, c)/dt = sum a_i z_i, the torque about the center of mass. With x = T/T_d and k = exp(-x), over an interval T

    z <- k z + e_2,    integral of z = T_d (1 - k) z + e_1,

    var e_1 = T_d^2 (2 x - 3 + 4 k - k^2),    cov(e_1, e_2) = T_d (1 - k)^2,    var e_2 = 1 - k^2

(Brown and Hwang, Introduction to Random Signals and Applied Kalman Filtering). What acts is an acceleration and no
torque: errors of the mass properties do not multiply it, and it says nothing of these.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from massprop_drake.maths.kernels import kernel
from massprop_drake.maths.linear_algebra import Array

_SHORT = 0.01  # of the time constant: arithmetic, below it the variance of the integral loses digits but by its series


class DisturbanceParams(NamedTuple):
    """The disturbance that a vehicle states.

    Attributes:
        accelerations: a_i, change of w and c in one second by one sigma of each component, shape (6, n).
        time_constant_s: T_d.
    """

    accelerations: Array
    time_constant_s: float


NO_DISTURBANCE = DisturbanceParams(np.zeros((6, 0)), 1.0)  # of no component, so that T_d, s, plays no part


class Wander(NamedTuple):
    """Course of a disturbance over an interval.

    Attributes:
        kept: k of each component, shape (n,).
        begun: change of w and c by z at the beginning, shape (6, n).
        drawn: change of w and c by one sigma of what comes in the interval, shape (6, n).
        along: what that one sigma changes z by, shape (n,).
        apart: 1-sigma of what changes z besides, shape (n,).
    """

    kept: Array
    begun: Array
    drawn: Array
    along: Array
    apart: Array


@kernel
def gathered_variance(x: float) -> float:
    """Variance of e_1 in units of T_d^2, of an interval of x time constants."""
    if x < _SHORT:
        return x**3 * (2.0 / 3.0 + x * (-0.5 + x * (7.0 / 30.0 - x / 12.0)))
    lost = -math.expm1(-x)
    return 2.0 * x - 2.0 * lost - lost * lost


@kernel
def wandered(disturbance: DisturbanceParams, duration_s: float) -> Wander:
    """Course of a disturbance over an interval.

    Args:
        disturbance: see `DisturbanceParams`.
        duration_s: T, positive.
    """
    constant, a = disturbance.time_constant_s, disturbance.accelerations
    x = duration_s / constant
    lost = -math.expm1(-x)
    drawn = math.sqrt(gathered_variance(x))
    along = lost * lost / drawn
    apart = math.sqrt(max(lost * (2.0 - lost) - along * along, 0.0))
    each = np.ones(a.shape[1])
    return Wander((1.0 - lost) * each, a * (constant * lost), a * (constant * drawn), along * each, apart * each)


@kernel
def slowly(wander: Wander, value: Array) -> Array:
    """Change of w and c by a disturbance of some value at the beginning, shape (6,)."""
    change = np.zeros(6)
    for component in range(value.shape[0]):
        change += wander.begun[:, component] * value[component]
    return change


@kernel
def arriving(wander: Wander) -> Array:
    """Root of the covariance of w, c and z by what comes of a disturbance in an interval, shape (6 + n, 2 n)."""
    n = wander.drawn.shape[1]
    columns = np.zeros((6 + n, 2 * n))
    columns[:6, :n] = wander.drawn
    for component in range(n):
        columns[6 + component, component] = wander.along[component]
        columns[6 + component, n + component] = wander.apart[component]
    return columns


@kernel
def come(wander: Wander) -> Array:
    """Covariance of w and c by what comes of a disturbance in an interval, shape (6, 6)."""
    covariance = np.zeros((6, 6))
    for component in range(wander.drawn.shape[1]):
        column = wander.drawn[:, component]
        covariance += np.outer(column, column)
    return covariance
