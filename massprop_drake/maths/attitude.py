r"""Attitude of the body in the inertial frame: unit quaternions, scalar first.

``quaternion`` is q_NB = (w, x, y, z): it takes body components to inertial ones, v_N = R(q) v_B,
and obeys dq/dt = 1/2 q (0, w_NB_B) with the angular velocity in body axes.
"""

from __future__ import annotations

import math

import numpy as np

from massprop_drake.maths.kernels import kernel, numbers
from massprop_drake.maths.linear_algebra import Array


@kernel
def rotation_matrix(quaternion: Array) -> Array:
    """Computes the rotation matrix R_NB of a unit quaternion q_NB, shape (3, 3)."""
    w, x, y, z = numbers(quaternion, 4)
    return np.array(
        [
            [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
            [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
            [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
        ]
    )


@kernel
def multiply(left: Array, right: Array) -> Array:
    """Computes the product left * right of two quaternions, q_AC = q_AB q_BC, shape (4,)."""
    a, b, c, d = numbers(left, 4)
    w, x, y, z = numbers(right, 4)
    return np.array(
        [
            a * w - b * x - c * y - d * z,
            a * x + b * w + c * z - d * y,
            a * y - b * z + c * w + d * x,
            a * z + b * y - c * x + d * w,
        ]
    )


@kernel
def conjugate(quaternion: Array) -> Array:
    """Computes the inverse of a unit quaternion, its conjugate, shape (4,)."""
    w, x, y, z = numbers(quaternion, 4)
    return np.array([w, -x, -y, -z])


@kernel
def from_rotation_vector(vector: Array) -> Array:
    """Computes the unit quaternion of a rotation vector (axis times angle, rad), shape (4,)."""
    x, y, z = numbers(vector, 3)
    angle = math.sqrt(x * x + y * y + z * z)
    # sin(angle / 2) / angle, with its series where the quotient would lose digits
    factor = 0.5 - angle * angle / 48.0 if angle < 1e-4 else math.sin(0.5 * angle) / angle
    return np.array([math.cos(0.5 * angle), factor * x, factor * y, factor * z])


@kernel
def to_rotation_vector(quaternion: Array) -> Array:
    """Computes the rotation vector, rad, shape (3,), of a unit quaternion; its angle is within 0 to pi."""
    w, x, y, z = numbers(quaternion, 4)
    if w < 0.0:
        w, x, y, z = -w, -x, -y, -z
    sine = math.sqrt(x * x + y * y + z * z)
    # angle / sin(angle / 2), with its limit where the quotient would lose digits
    factor = 2.0 / w if sine < 1e-8 else 2.0 * math.atan2(sine, w) / sine
    return np.array([factor * x, factor * y, factor * z])


@kernel
def propagate_attitude(quaternion: Array, rate: Array, duration_s: float) -> Array:
    """Propagates an attitude quaternion at a constant body rate, rad/s, for a time; normalizes it.

    With the mean of the two rates that bound a sample this is the strapdown integration of a rate
    gyro, correct to second order in the sample period.
    """
    turned = multiply(quaternion, from_rotation_vector(rate * duration_s))
    return turned / math.sqrt(float(np.dot(turned, turned)))
