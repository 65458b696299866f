"""Prescribed moves of joints: minimum-jerk profiles, and the force by which a drive follows them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from massprop_drake.maths.linear_algebra import Array


class Move(NamedTuple):
    """A move of one joint to a position, along a polynomial of least jerk.

    Attributes:
        start_s, end_s: when, s.
        position: at the end, rad, ft or m.
    """

    start_s: float
    end_s: float
    position: float


class JointReference(NamedTuple):
    """A joint's prescribed position, rate and acceleration."""

    position: float
    rate: float
    acceleration: float


def reference(start: float, moves: Sequence[Move], time_s: float) -> JointReference:
    r"""Prescribed motion at a time: with s = (t - t0) / T, q = q0 + (q1 - q0) (10 s^3 - 15 s^4 + 6 s^5).

    **Source**: Flash and Hogan, 1985.

    Args:
        start: position before the first move.
        moves: in the order of time, without overlap.
        time_s: s.
    """
    position = start
    for move in moves:
        if time_s < move.start_s:
            break
        if time_s < move.end_s:
            span, way = move.end_s - move.start_s, move.position - position
            s = (time_s - move.start_s) / span
            return JointReference(
                position + way * s**3 * (10.0 - 15.0 * s + 6.0 * s * s),
                way / span * 30.0 * s * s * (1.0 - s) ** 2,
                way / span**2 * 60.0 * s * (1.0 - s) * (1.0 - 2.0 * s),
            )
        position = move.position
    return JointReference(position, 0.0, 0.0)


def drive_force(wanted: JointReference, position: float, rate: float, inertia: float, frequency_hz: float) -> float:
    """Generalized force of a critically damped proportional-derivative drive with feedforward.

    Args:
        wanted: see `reference`.
        position, rate: of the joint.
        inertia: effective inertia that the joint moves.
        frequency_hz: natural frequency of the closed loop, Hz.
    """
    w = 2.0 * math.pi * frequency_hz
    error, error_rate = wanted.position - position, wanted.rate - rate
    return inertia * (wanted.acceleration + 2.0 * w * error_rate + w * w * error)


def effective_inertias(inverse_mass_matrix: Array, places: Sequence[int]) -> tuple[float, ...]:
    """Inertia that each joint moves while nothing else holds: 1 / (M^-1)_jj.

    Args:
        inverse_mass_matrix: M^-1, shape (n, n).
        places: of the joints among the generalized velocities.
    """
    return tuple(1.0 / float(inverse_mass_matrix[place, place]) for place in places)
