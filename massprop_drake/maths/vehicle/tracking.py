"""Readings of sensors in a fixed frame of the true vehicle: poses and velocities of points fixed in it."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from massprop_drake.maths import attitude
from massprop_drake.maths.kernels import value_of
from massprop_drake.maths.linear_algebra import Array, cross
from massprop_drake.maths.vehicle.rigid_body import POSITION, QUATERNION, RATE, VELOCITY

N_NOISE = 8  # numbers that a pose takes: of position, of attitude, of the stamp, and whether it is a poor one
POOR = 10.0  # times as noisy
_ROUNDING = 1e-9  # of an interval between readings


class PoseModel(NamedTuple):
    """Sensor of position and attitude.

    Attributes:
        point: that is tracked, vehicle frame, ft or m, shape (3,).
        position_std: of each coordinate; infinity: position is not measured.
        attitude_std: about each axis, rad; infinity: attitude is not measured.
        time_std_s: of the stamps.
        outliers: share of samples that are poor.
        planar: whether x, y and the turn about z alone are noisy, as all else stands still.
        rate_hz, period_s: rate at which it is read, and sample period; infinite: at every sample.
    """

    point: Array
    position_std: float
    attitude_std: float
    time_std_s: float
    outliers: float
    planar: bool
    rate_hz: float = math.inf
    period_s: float = 1.0


def is_due(time_s: float, model: PoseModel) -> bool:
    """Tests whether a pose sensor, with a sample time of its own, is read at a sample's time."""
    if not model.rate_hz * model.period_s < 1.0:
        return True
    sample = round(time_s / model.period_s)
    due, before = (math.floor(k * model.period_s * model.rate_hz + _ROUNDING) for k in (sample, sample - 1))
    return due > before


def read_pose(body: Array, center_of_mass: Array, noise: Array, model: PoseModel) -> Array:
    """Measures a tracked point's position and a quaternion to the fixed frame, NaN: not measured, shape (7,).

    Args:
        body: state, see `rigid_body`, shape (23,).
        center_of_mass: center of mass in the vehicle frame, shape (3,).
        noise: independent standard normal numbers, shape (8,).
    """
    late_s = model.time_std_s * value_of(noise[6])
    poor = POOR if 0.5 * math.erfc(-value_of(noise[7]) / math.sqrt(2.0)) < model.outliers else 1.0
    turned = body[QUATERNION]
    if late_s == 0.0:
        turned = turned / np.sqrt(np.dot(turned, turned))
    else:
        turned = attitude.propagate_attitude(turned, body[RATE], late_s)
    arm = attitude.rotation_matrix(turned) @ (model.point - center_of_mass)
    reading = np.full(7, np.nan, dtype=body.dtype)
    plane = np.array([1.0, 1.0, 0.0]) if model.planar else np.ones(3)
    if math.isfinite(model.position_std):
        moved = body[POSITION] + late_s * body[VELOCITY] + arm
        reading[:3] = moved + poor * model.position_std * plane * noise[:3]
    if math.isfinite(model.attitude_std):
        errors = np.array([value_of(number) for number in noise[3:6]])
        about = poor * model.attitude_std * (1.0 - plane if model.planar else plane) * errors
        reading[3:] = attitude.multiply(turned, attitude.from_rotation_vector(about))
    return reading


def read_velocity(body: Array, center_of_mass: Array, noise: Array, position: Array, noise_std: float) -> Array:
    """Measures the velocity of a body-fixed point in the fixed frame, with noise, shape (3,).

    Args:
        body: state, see `rigid_body`, shape (23,).
        center_of_mass: center of mass in the vehicle frame, shape (3,).
        noise: independent standard normal numbers, shape (3,).
        position: of the point, vehicle frame, shape (3,).
        noise_std: of each component.
    """
    swing = attitude.rotation_matrix(body[QUATERNION]) @ cross(body[RATE], position - center_of_mass)
    moves: Array = body[VELOCITY] + swing + noise_std * noise
    return moves
