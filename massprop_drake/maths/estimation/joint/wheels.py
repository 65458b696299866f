"""Reaction wheels, whose momentum is exchanged with the vehicle: a scale that does not depend on thrust.

Equations: theory page of the joint filter, "Reaction wheels" (Hughes, Spacecraft Attitude Dynamics, chapter 3). For
speeds and rates that are linear in time over an interval T, wheel k of inertia J_k is a known angular impulse,

    E_k = -J_k [ (W1 - W0) a_k + T w0 x a_k (2 W0 + W1)/6 + T w1 x a_k (W0 + 2 W1)/6 ].

Errors of read speeds are states z_k that come anew with each reading: nothing gathers. While a speed is not read it
counts as what was read last, and z_k grows by all that the wheel may be accelerated.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from massprop_drake.maths.estimation.joint.disturbance_states import Wander, append_constant_states
from massprop_drake.maths.kernels import kernel, select_where
from massprop_drake.maths.linear_algebra import Array, cross

_ACTS = 4.0  # a probability, in 1-sigmas of a change of speed: errors of readings alone exceed it 6 times in 100 000
_FASTEST = 1e3  # rad/s, physics: no wheel turns faster, so the prior 1-sigma of a speed that was not read


class WheelParams(NamedTuple):
    """The reaction wheels of a vehicle.

    Attributes:
        axes: a_k, unit vectors, vehicle frame, shape (n, 3).
        inertias: J_k, slug-ft^2 or kg-m^2, shape (n,).
        sigma: what one unit of p_k is, relative.
        speed_std: sigma_W of one reading of each speed, rad/s, shape (n,).
        most: largest acceleration of each wheel, rad/s^2, shape (n,).
    """

    axes: Array
    inertias: Array
    sigma: float
    speed_std: Array
    most: Array


NO_WHEELS = WheelParams(np.zeros((0, 3)), np.zeros(0), 0.0, np.zeros(0), np.zeros(0))


class Spun(NamedTuple):
    """Speeds of the wheels over an interval, as they are read.

    Attributes:
        start, end: at its start and end, rad/s, shape (n,).
        kept: 1 where no speed is read at its end, so that the error is still that of the reading before; 0 where one
            is, shape (n,).
        drawn: 1-sigma of what is added to z_k over the interval: 1 of a new reading, shape (n,).
    """

    start: Array
    end: Array
    kept: Array
    drawn: Array


UNSPUN = Spun(np.zeros(0), np.zeros(0), np.zeros(0), np.zeros(0))


@kernel
def interval_wheel_speeds(
    previous: Array, reading: Array, duration_s: float, wheels: WheelParams
) -> tuple[Spun, Array]:
    """Returns wheel speeds at both ends of an interval with their noise, and the last speeds read.

    Args:
        previous: last speeds read, NaN where none was, rad/s, shape (n,).
        reading: at the end of the interval, NaN where missing, rad/s, shape (n,).
    """
    missing = np.isnan(reading)
    last = np.where(missing, previous, reading)
    end = select_where(np.isnan(last), 0.0, last)
    start = np.where(np.isnan(previous), end, previous)  # z_k is as wide as what nobody has read
    drawn = select_where(missing, wheels.most * duration_s / wheels.speed_std, 1.0)
    return Spun(start, end, missing.astype(np.float64), drawn), last


def initial_speed_sigmas(missing: Array, wheels: WheelParams) -> Array:
    """Returns initial 1-sigmas of wheel speed errors, in reading sigmas: 1 if read, huge if missing, shape (n,)."""
    return np.where(missing > 0.0, _FASTEST / wheels.speed_std, 1.0)


@kernel
def remove_untrusted_speeds(speeds: Spun, assumed: Array, duration_s: float, wheels: WheelParams) -> Spun:
    """Returns wheel speeds with distrusted readings replaced by assumed constant speeds, their error growing as noise.

    Args:
        assumed: speed of each wheel, NaN where readings are trusted, rad/s, shape (n,).
    """
    if np.isnan(assumed).all():
        return speeds
    start, end, kept, drawn = speeds.start.copy(), speeds.end.copy(), speeds.kept.copy(), speeds.drawn.copy()
    for k in range(assumed.shape[0]):
        if not np.isnan(assumed[k]):
            start[k], end[k], kept[k] = assumed[k], assumed[k], 1.0
            drawn[k] = wheels.most[k] * duration_s / wheels.speed_std[k]
    return Spun(start, end, kept, drawn)


def largest_wheel_turn(wheel: int, inverse: Array, duration_s: float, wheels: WheelParams) -> float:
    """Returns the largest change of the vehicle's rate by a wheel's motor in an interval, rad/s."""
    turned = inverse @ wheels.axes[wheel] * wheels.inertias[wheel] * wheels.most[wheel]
    return float(np.linalg.norm(turned)) * duration_s


@kernel
def is_any_wheel_driven(speeds: Spun, wheels: WheelParams) -> bool:
    """Tests whether any wheel's speed changes by more than the errors of two readings explain."""
    for k in range(speeds.end.shape[0]):
        if abs(speeds.end[k] - speeds.start[k]) > _ACTS * math.sqrt(2.0) * wheels.speed_std[k]:
            return True
    return False


@kernel
def wheel_momenta(speeds: Spun, factors: Array, wheels: WheelParams) -> Array:
    """Computes the wheels' total angular momentum at an interval's start and end, body axes, shape (2, 3).

    Args:
        factors: 1 + sigma p_k, shape (n,).
    """
    result = np.zeros((2, 3))
    for k in range(factors.shape[0]):
        inertia = factors[k] * wheels.inertias[k]
        result[0] += (inertia * speeds.start[k]) * wheels.axes[k]
        result[1] += (inertia * speeds.end[k]) * wheels.axes[k]
    return result


@kernel
def wheel_impulses(speeds: Spun, start: Array, end: Array, duration_s: float, wheels: WheelParams) -> Array:
    """Computes each wheel's angular impulse on the vehicle over an interval, body axes, shape (n, 3).

    Args:
        start, end: w0 and w1, rad/s, shape (3,).
    """
    result = np.zeros((speeds.end.shape[0], 3))
    for k in range(result.shape[0]):
        first, second, axis = speeds.start[k], speeds.end[k], wheels.axes[k]
        at_start = cross(start, axis) * ((2.0 * first + second) * duration_s / 6.0)
        at_end = cross(end, axis) * ((first + 2.0 * second) * duration_s / 6.0)
        result[k] = -wheels.inertias[k] * ((second - first) * axis + at_start + at_end)
    return result


@kernel
def append_reading_errors(states: Wander, speeds: Spun, inverse: Array, rotation: Array, wheels: WheelParams) -> Wander:
    """Appends wheel speed reading errors, as slow states with decay and noise, to a disturbance.

    Args:
        states: decay, effects and noise of the disturbance alone.
        inverse: J, in the scale of known impulses, shape (3, 3).
        rotation: integral of the rate over the interval, rad, shape (3,).
    """
    n, others = speeds.end.shape[0], states.kept.shape[0]
    if n == 0:
        return states
    longer = append_constant_states(states, n)
    kept, along, begun, drawn = longer.kept, longer.along, longer.begun, longer.drawn
    for k in range(n):
        step = (wheels.inertias[k] * wheels.speed_std[k]) * wheels.axes[k]
        direct, by_turning = inverse @ step, 0.5 * (inverse @ cross(rotation, step))
        stays, comes = speeds.kept[k], speeds.drawn[k]
        kept[others + k], along[others + k] = stays, comes
        begun[:3, others + k] = (stays - 1.0) * direct + (1.0 + stays) * by_turning
        drawn[:3, others + k] = comes * (direct + by_turning)
    return longer
