"""An uncommanded torque and force that change slowly, as states of the joint estimator.

Equations: theory page of the joint filter, "Disturbance". With x = T/T_d and k = exp(-x), over an interval T

    var e_1 = T_d^2 (2 x - 3 + 4 k - k^2),    cov(e_1, e_2) = T_d (1 - k)^2,    var e_2 = 1 - k^2

for the integral of z and for z itself (Brown and Hwang, Introduction to Random Signals and Applied Kalman Filtering).
What acts is an acceleration: errors of the mass properties do not multiply it, and it says nothing of these.

*Unstated* components, one about and along each axis, have the unit of what all jets give together
(`unstated_unit_effects`). They are zero but for a hypothesis that something acts which nobody stated, of a level L and
a time constant of its own.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from massprop_drake.maths.kernels import kernel
from massprop_drake.maths.linear_algebra import Array

_SHORT = 0.01  # of the time constant: arithmetic, below it the variance of the integral loses digits but by its series


class DisturbanceParams(NamedTuple):
    """Disturbance that a vehicle states.

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
def integral_variance(x: float) -> float:
    """Computes the variance of a Gauss-Markov disturbance's integral over x time constants, units of T_d^2."""
    if x < _SHORT:
        return x**3 * (2.0 / 3.0 + x * (-0.5 + x * (7.0 / 30.0 - x / 12.0)))
    lost = -math.expm1(-x)
    return 2.0 * x - 2.0 * lost - lost * lost


def unstated_unit_effects(effects: Array, accelerometers: int) -> Array:
    """Returns accelerations by a unit of unstated disturbance per axis: root sum square of all jets', shape (6, n).

    Args:
        effects: change of w and c per second by each jet at full thrust, shape (n_jets, 6).
        accelerometers: number of packages.
    """
    together = np.sqrt(np.sum(effects**2, axis=0))
    return np.diag(together)[:, : 6 if accelerometers else 3].copy()


@kernel
def discretize_disturbance(disturbance: DisturbanceParams, duration_s: float, level: float = 1.0) -> Wander:
    """Discretizes a Gauss-Markov disturbance over an interval: decay, effects on rate and velocity, and noise.

    Args:
        duration_s: T, positive.
        level: 1-sigma of each component in its unit.
    """
    constant, a = disturbance.time_constant_s, disturbance.accelerations
    x = duration_s / constant
    lost = -math.expm1(-x)
    drawn = math.sqrt(integral_variance(x))
    along = lost * lost / drawn
    apart = level * math.sqrt(max(lost * (2.0 - lost) - along * along, 0.0))
    drawn, along = level * drawn, level * along
    ones = np.ones(a.shape[1])
    return Wander((1.0 - lost) * ones, a * (constant * lost), a * (constant * drawn), along * ones, apart * ones)


@kernel
def join_slow_states(first: Wander, second: Wander) -> Wander:
    """Concatenates decay, effects and noise of two sets of slowly changing states."""
    return Wander(
        np.concatenate((first.kept, second.kept)),
        np.hstack((first.begun, second.begun)),
        np.hstack((first.drawn, second.drawn)),
        np.concatenate((first.along, second.along)),
        np.concatenate((first.apart, second.apart)),
    )


@kernel
def append_constant_states(slow_states: Wander, n: int) -> Wander:
    """Appends n constant components, without effect on rate and velocity, to slowly changing states."""
    return join_slow_states(
        slow_states, Wander(np.ones(n), np.zeros((6, n)), np.zeros((6, n)), np.zeros(n), np.zeros(n))
    )


@kernel
def disturbance_effect(disturbance: Wander, value: Array) -> Array:
    """Computes the change of rate and velocity by a disturbance of given value at an interval's start, shape (6,)."""
    change = np.zeros(6)
    for component in range(value.shape[0]):
        change += disturbance.begun[:, component] * value[component]
    return change


@kernel
def disturbance_noise_root(disturbance: Wander) -> Array:
    """Computes a root of a disturbance's noise covariance of rate, velocity, z, shape (6 + n, 2 n_moving)."""
    moving = np.flatnonzero(disturbance.along + disturbance.apart > 0.0)
    n = moving.shape[0]
    columns = np.zeros((6 + disturbance.drawn.shape[1], 2 * n))
    for column in range(n):
        component = moving[column]
        columns[:6, column] = disturbance.drawn[:, component]
        columns[6 + component, column] = disturbance.along[component]
        columns[6 + component, n + column] = disturbance.apart[component]
    return columns


@kernel
def disturbance_noise(disturbance: Wander) -> Array:
    """Computes the covariance that a disturbance's noise adds to rate and velocity in an interval, shape (6, 6)."""
    covariance = np.zeros((6, 6))
    for component in range(disturbance.drawn.shape[1]):
        column = disturbance.drawn[:, component]
        covariance += np.outer(column, column)
    return covariance
