"""Modes inside the vehicle over a stretch of a record, for regression; equations in `joint.modes`.

Row by row, an interval's changes of rate and velocity with the modes locked, and their derivatives by all unknowns, go
through `joint.swing.swung`; derivatives by eta and eta' are followed from their values at the beginning on.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from massprop_drake.maths.estimation.joint.layout import CENTER, MASS, N_PROPERTIES, RATE
from massprop_drake.maths.estimation.joint.modes import (
    ModeParams,
    Rigid,
    estimated_part_ratios,
    mode_motion,
    mode_sigmas,
)
from massprop_drake.maths.estimation.joint.swing import Moved, SwingParams, Swung, swing_modes
from massprop_drake.maths.linear_algebra import Array, cross
from massprop_drake.maths.mass_properties import ELEMENT


class Locked(NamedTuple):
    """A stretch of m rows with the modes locked.

    Attributes:
        rate, velocity: since the beginning, shape (3, m).
        read: the rate itself, rad/s, shape (3, m).
        linear: impulses over the intervals, shape (3, m - 1).
        lengths_s: of these, shape (m - 1,).
        by_rate, by_velocity: derivatives of both by k unknowns, of which the ten parameters are the first, shape
            (k, 3, m).
    """

    rate: Array
    velocity: Array
    read: Array
    linear: Array
    lengths_s: Array
    by_rate: Array
    by_velocity: Array


class Swings(NamedTuple):
    """A stretch with its modes.

    Attributes:
        rate, velocity: since the beginning, shape (3, m).
        by_rate, by_velocity: derivatives by the unknowns, those of the parts, and eta and eta' at the beginning, shape
            (k + 6 n_parts + 2 n, 3, m).
    """

    rate: Array
    velocity: Array
    by_rate: Array
    by_velocity: Array


Step = Callable[[Array, Moved, Array, tuple[float, Array], float, SwingParams], tuple[Moved, Swung]]


def add_modes(motion: Locked, properties: Array, errors: Array, modes: ModeParams, step: Step = swing_modes) -> Swings:
    """Adds modes, at rest at first, to rate and velocity computed with them locked; returns both, and derivatives.

    Args:
        properties: the ten parameters, shape (10,).
        errors: of the parts in units of their sigmas, shape (6 n_parts,).
        step: `swung`, or its compiled form.
    """
    n, parts, m = modes.frequencies.size, errors.size, motion.rate.shape[1]
    k, own = motion.by_rate.shape[0], N_PROPERTIES + 3
    swing, moving = slice(own, own + 2 * n), slice(own + 2 * n, own + 2 * n + parts)
    params = SwingParams(modes, swing.start, moving.start, parts, -1, 0.0)
    size = moving.stop + max(k - N_PROPERTIES, 0)
    told = np.concatenate((np.arange(N_PROPERTIES), np.arange(moving.stop, size)))[:k]
    others = np.concatenate((told, np.arange(moving.start, moving.stop), np.arange(swing.start, swing.stop)))
    mean, by_modes = np.zeros(size), np.zeros((2 * n, k + parts + 2 * n))
    mean[:N_PROPERTIES], mean[moving] = properties, errors
    by_modes[:, k + parts :] = np.eye(2 * n)
    inverse = properties[ELEMENT]
    gained = (np.diff(each, axis=-1).T for each in (motion.rate, motion.velocity, motion.by_rate, motion.by_velocity))
    of_rate, of_velocity, rate_by, velocity_by = (np.ascontiguousarray(each) for each in gained)
    linear, nothing = np.ascontiguousarray(motion.linear.T), np.zeros(3)
    found = np.zeros((6, 1 + others.size, m))
    for row, length_s in enumerate(motion.lengths_s.tolist()):
        rows = np.zeros((2, 3, size))
        rows[0][:, told], rows[1][:, told] = rate_by[row], velocity_by[row]
        mean[RATE] = motion.read[:, row]
        moved = Moved(of_rate[row], of_velocity[row], rows[0], rows[1])
        felt, modes_then = step(mean, moved, linear[row], (1.0, nothing), length_s, params)
        before, after, (first, last) = motion.read[:, row], motion.read[:, row + 1], modes_then.momenta
        crossed = cross(before, 2.0 * first + last) + cross(after, first + 2.0 * last)
        found[:3, 0, row + 1] = felt.rate - inverse @ crossed * (length_s / 6.0)
        found[3:, 0, row + 1] = felt.velocity
        both = np.vstack((felt.rate_rows, felt.velocity_rows))
        found[:, 1:, row + 1] = both[:, others] + both[:, swing] @ by_modes
        following = modes_then.rows[:, others] + modes_then.rows[:, swing] @ by_modes
        following[:, k + parts :] = modes_then.rows[:, swing] @ by_modes[:, k + parts :]
        found[:, 1 + k + parts :, row + 1] = both[:, swing] @ by_modes[:, k + parts :]
        mean[swing], by_modes = modes_then.after, following
    total = np.cumsum(found, axis=-1)
    by = total[:, 1:].transpose(1, 0, 2)
    return Swings(total[:3, 0], total[3:, 0], by[:, :3].copy(), by[:, 3:].copy())


def can_swing(properties: Array, errors: Array, modes: ModeParams) -> bool:
    """Tests whether the swinging parts leave a positive inertia to the rest of the vehicle.

    Args:
        properties, errors, modes: see `add_modes`.
    """
    if modes.frequencies.size == 0:
        return True
    locked = Rigid(properties[ELEMENT], float(properties[MASS]), properties[CENTER])
    return bool(
        np.linalg.eigvalsh(mode_motion(locked, estimated_part_ratios(errors, modes), 1.0, modes).lightness)[0] > 0.0
    )


def start_variances(modes: ModeParams) -> Array:
    """Computes prior variances of mode states eta and eta' at a stretch's beginning, shape (2 n,)."""
    return np.maximum(mode_sigmas(modes.start, modes), 1e-9) ** 2
