"""Gimbal control that holds a vehicle's rate at zero while its engines burn."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from massprop_drake.maths.linear_algebra import Array
from massprop_drake.maths.mass_properties import MassProperties
from massprop_drake.maths.vehicle.engine_thrust import N_CHANNELS, N_ERRORS, EngineParams, thrust

_DAMPING = 0.7  # physics: of the loop, so that it settles without swinging
_NO_ERRORS = np.zeros(N_ERRORS)


class GimbalControl(NamedTuple):
    """Engines, body and bandwidth of the control.

    Attributes:
        engines: as stated.
        body: nominal mass properties, by which angles are chosen.
        bandwidth: natural frequency of the loop, rad/s; zero: gimbals go as they are scheduled.
        period_s: sample period, s.
    """

    engines: EngineParams
    body: MassProperties
    bandwidth: float
    period_s: float


def gimbal_jacobian(levels: Array, control: GimbalControl) -> Array:
    """Computes derivatives of the vehicle's angular acceleration by gimbal angles, 1/s^2, shape (3, 2 n).

    Args:
        levels: of the engines, shape (n,).
    """
    columns, body = list[Array](), control.body
    for which, level in enumerate(levels.tolist()):
        given = thrust(which, np.array([[level, 0.0, 0.0]]), _NO_ERRORS, control.engines)
        forces = given.force * given.by_angles[:, 0] * (control.engines.stops[which, 1:, None] > 0.0)
        columns.extend(np.cross(given.place - body.center_of_mass, forces))
    return np.asarray(np.linalg.solve(np.asarray(body.inertia), np.array(columns).T))


def steer_gimbals(scheduled: Array, rate: Array, turned: Array, control: GimbalControl) -> tuple[Array, Array]:
    """Computes engine commands (level, angles), (n, 3), that damp rate and its integral, and that integral.

    Args:
        scheduled: level and two angles of each, rad, shape (n, 3).
        rate: measured, rad/s, shape (3,).
        turned: integral of the rate since any engine burns, rad, shape (3,).
    """
    levels = scheduled[:, 0]
    if control.bandwidth == 0.0 or not levels.any():
        return scheduled, np.zeros(3)
    turned, own = turned + rate * control.period_s, control.bandwidth
    wanted = -own * (2.0 * _DAMPING * rate + own * turned)
    angles = np.linalg.lstsq(gimbal_jacobian(levels, control), wanted, rcond=1e-6)[0]
    commands = scheduled.copy()
    commands[:, 1:] += angles.reshape(-1, N_CHANNELS - 1)
    return commands, turned
