r"""Reaction wheels that hold attitude and follow rates, and their unloading by jets.

With wheels of angular momentum h the vehicle turns by I dw/dt = t - dh/dt - w x (I w + h). The wheels are given

    dh/dt = -k I (w_c - w) - w x (I w + h),

w_c the rate that the phase-space controller commands, which holds attitude: so w follows w_c in a time 1/k, and an
error of attitude dies away with k and the hold gain g like an oscillator of w_n^2 = k g. The pseudo-inverse of the
wheels' axes gives the motors' torques, as small as they can be.

Jets unload: their controller sees the rate w + I^-1 h in place of w, at most so much more than w that the wheels can
hold against what it asks for. It fires what takes that off, the wheels turn the vehicle back and lose momentum by it,
and only then is more asked for.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from massprop_drake.maths.autopilot.phase_space import PhaseSpaceParams, commanded_rate
from massprop_drake.maths.linear_algebra import Array


class WheelControlParams(NamedTuple):
    """Parameters of the control law.

    Attributes:
        axes: of the wheels, unit vectors, body axes, shape (n, 3).
        shares: torque of each motor per torque of all, the pseudo-inverse, shape (n, 3).
        inertias: of the wheels about their axes, slug-ft^2 or kg-m^2, shape (n,).
        most: largest torque of each motor, ft-lbf or N-m, shape (n,).
        fastest: largest speed of each, rad/s, infinity: any, shape (n,).
        inertia: of the vehicle with its wheels locked, shape (3, 3).
        rate_gain: k, 1/s.
        unload_above, unload_below: shares of the largest speed between which jets unload, or do not go on to.
        unload_rate: largest rate by which jets are asked for to unload, rad/s.
        settings: of the phase-space controller.
    """

    axes: Array
    shares: Array
    inertias: Array
    most: Array
    fastest: Array
    inertia: Array
    rate_gain: float
    unload_above: float
    unload_below: float
    unload_rate: float
    settings: PhaseSpaceParams


def torque_shares(axes: Array) -> Array:
    """Computes the pseudoinverse that shares a total torque among wheel motors, shape (n, 3).

    Args:
        axes: of the wheels, unit vectors that span space, shape (n, 3).
    """
    inverse: Array = np.asarray(np.linalg.pinv(axes.T), dtype=np.float64)
    return inverse


def wheel_torques(rotation_inputs: tuple[Array, Array, Array], speeds: Array, params: WheelControlParams) -> Array:
    """Computes each motor's torque on its wheel by rate feedback, limited, ft-lbf or N-m, shape (n,).

    Torques beyond what a motor gives are made smaller together, so that their direction stays. A wheel at its largest
    speed is made no faster.

    Args:
        rotation_inputs: hand controllers, -1, 0 or 1, error of attitude, rad, and rate, rad/s, shape (3,) each.
        speeds: of the wheels as they are read, rad/s, shape (n,).
    """
    rotation, error, rate = rotation_inputs
    asked = params.rate_gain * (commanded_rate(rotation, error, params.settings) - rate)
    momentum = params.inertia @ rate + _momentum(speeds, params)
    torques = params.shares @ (-params.inertia @ asked - np.cross(rate, momentum))
    largest = float((np.abs(torques) / params.most).max())
    torques = torques / max(largest, 1.0)
    span = params.inertias / params.settings.period_s
    return np.clip(torques, span * (-params.fastest - speeds), span * (params.fastest - speeds))


def must_unload(is_unloading: bool, speeds: Array, params: WheelControlParams) -> bool:
    """Tests whether jets must unload the wheels' momentum, with hysteresis.

    They begin when a wheel is too fast. They end when no wheel would be, were momentum shared as well as can be: what
    wheels turn against each other no jet takes off.

    Args:
        is_unloading: whether they did until now.
        speeds: of the wheels as they are read, rad/s, shape (n,).
    """
    shared = params.shares @ _momentum(speeds, params) / params.inertias
    needed, used = (float((np.abs(each) / params.fastest).max()) for each in (shared, speeds))
    return needed > params.unload_below and (is_unloading or used > params.unload_above)


def rate_for_jets(rate: Array, is_unloading: bool, speeds: Array, params: WheelControlParams) -> Array:
    """Computes the rate that jets control to zero, biased by excess wheel momentum while unloading, rad/s.

    Args:
        rate: as it is read, rad/s, shape (3,).
        is_unloading: whether jets unload.
        speeds: of the wheels as they are read, rad/s, shape (n,).
    """
    if not is_unloading:
        return rate
    excess = np.linalg.solve(params.inertia, _momentum(speeds, params))
    largest = float(np.abs(excess).max())
    return rate + excess * min(1.0, params.unload_rate / largest if largest > 0.0 else 1.0)


def _momentum(speeds: Array, params: WheelControlParams) -> Array:
    """Computes the wheels' total angular momentum, body axes, shape (3,)."""
    momentum: Array = (params.inertias * speeds) @ params.axes
    return momentum
