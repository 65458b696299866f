"""Prescribed moves of joints: minimum-jerk profiles, and the force by which a drive follows them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from massprop_drake.maths.linear_algebra import Array


class Move(NamedTuple):
    """Move of one joint to a position, along a polynomial of least jerk.

    Attributes:
        start_s, end_s: when, s.
        position: at the end, rad, ft or m.
    """

    start_s: float
    end_s: float
    position: float


class JointReference(NamedTuple):
    """Prescribed position, rate and acceleration of a joint."""

    position: float
    rate: float
    acceleration: float


def joint_reference(initial_position: float, moves: Sequence[Move], time_s: float) -> JointReference:
    r"""Computes a joint's prescribed position, rate and acceleration at a time, from minimum-jerk moves.

    **Source**: Flash and Hogan, 1985.

    Args:
        initial_position: position before the first move.
        moves: in the order of time, without overlap.
    """
    position = initial_position
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


def peak_rate(distance: float, duration_s: float) -> float:
    """Computes the largest rate of a minimum-jerk move, in its middle, rad/s, ft/s or m/s.

    Args:
        distance: from position to position, rad, ft or m.
        duration_s: from start to end, s.
    """
    return 1.875 * abs(distance) / duration_s


def drive_forces(
    references: Sequence[JointReference], positions: Array, rates: Array, inertia: Array, frequency_hz: float
) -> Array:
    """Computes joint forces of critically damped PD drives with feedforward, shape (n,).

    Args:
        references: of each driven joint, see `joint_reference`.
        positions, rates: of them, shape (n,).
        inertia: which they move, see `driven_inertia`, shape (n, n).
        frequency_hz: natural frequency of the closed loop, Hz.
    """
    w, (told, told_rates, told_accelerations) = 2.0 * math.pi * frequency_hz, np.array(references).T
    forces: Array = inertia @ (told_accelerations + 2.0 * w * (told_rates - rates) + w * w * (told - positions))
    return forces


def driven_inertia(mass_matrix: Array, indices: Sequence[int]) -> Array:
    """Computes the inertia matrix that joint drives move, all else free: (S M^-1 S^T)^-1, shape (n, n).

    Args:
        mass_matrix: M, of all generalized velocities.
        indices: of the driven joints among these, which S picks.
    """
    return np.linalg.inv(np.linalg.inv(mass_matrix)[np.ix_(indices, indices)])
