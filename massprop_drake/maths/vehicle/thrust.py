r"""Thrust build-up and tail-off: a first-order lag of each jet's level, in closed form.

A jet's level l (0: no thrust, 1: its full thrust) follows its target u as dl/dt = (u - l) / tau.
Over one sample the target is constant, so with s the time since the sample began

    l(s) = u + (l_0 - u) exp(-s / tau).

A time constant of zero means instantaneous thrust.
"""

from __future__ import annotations

import math
from typing import NamedTuple, TypeVar

import numpy as np

from massprop_drake.maths.kernels import kernel, value_of
from massprop_drake.maths.linear_algebra import Array

_Level = TypeVar("_Level", float, Array)  # of one jet, or of all


class LagFactors(NamedTuple):
    """Factors of the lag over one sample period, arrays of shape (n_jets,).

    Attributes:
        remaining: exp(-T / tau), the share of an initial difference left at the end of the period.
        mean: (tau / T) (1 - exp(-T / tau)), its share on average over the period.
        instantaneous: whether no jet lags at all (a single flag).
    """

    remaining: Array
    mean: Array
    instantaneous: bool


def lag_factors(time_constants_s: Array, period_s: float) -> LagFactors:
    """Computes first-order lag factors: parts of a level's offset left after a period, and on average over it.

    Args:
        time_constants_s: time constant of each jet, s, zero or positive, shape (n_jets,).
    """
    ratio = np.zeros(time_constants_s.shape, dtype=np.result_type(time_constants_s, np.asarray(period_s)))
    lagged = time_constants_s > 0.0
    ratio[lagged] = time_constants_s[lagged] / period_s
    remaining = np.zeros_like(ratio)
    remaining[lagged] = np.exp(-1.0 / ratio[lagged])
    return LagFactors(remaining, ratio * (1.0 - remaining), not lagged.any())


@kernel
def level_after(level: _Level, target: _Level, remaining: _Level) -> _Level:
    """Computes the thrust level after a period with constant target, from ``level`` at its beginning."""
    return target + (level - target) * remaining


@kernel
def mean_level(level: _Level, target: _Level, mean: _Level) -> _Level:
    """Computes the mean thrust level over a period with constant target, from ``level`` at its beginning."""
    return target + (level - target) * mean


def level_at(level: Array, target: Array, time_constants_s: Array, elapsed_s: float) -> Array:
    """Computes thrust levels at a time, s, since a period with constant target began, under the valves' lag."""
    if value_of(elapsed_s) <= 0.0:
        return np.where(time_constants_s > 0.0, level, target)
    return level_after(level, target, lag_factors(time_constants_s, elapsed_s).remaining)


@kernel
def decay_integral(time_constant_s: float, elapsed_s: float) -> float:
    """Computes the integral of exp(-s / tau) from 0 to the elapsed time, s."""
    return -time_constant_s * math.expm1(-elapsed_s / time_constant_s)


def thrust_wrenches(positions: Array, thrusts: Array) -> Array:
    """Computes torque about the vehicle origin and force of each jet at full thrust, shape (n_jets, 6).

    Args:
        positions: of the jets in the vehicle frame, ft or m, shape (n_jets, 3).
        thrusts: force vectors on the vehicle, body axes, lbf or N, shape (n_jets, 3).
    """
    return np.hstack([np.cross(positions, thrusts), thrusts])
