"""Kernels of the vehicle's systems: from vectors of their ports and states to such vectors.

Each is called by one system of a diagram, with what does not change in a `kernels.Holder`. They pack and unpack; what
they do with it stands in the other files here.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from massprop_drake.maths.kernels import fill, kernel
from massprop_drake.maths.linear_algebra import Array
from massprop_drake.maths.vehicle import reaction_jets, rigid_body, true_failures
from massprop_drake.maths.vehicle.reaction_jets import JetThrusts
from massprop_drake.maths.vehicle.rigid_body import N_WRENCH, ORIGIN_VELOCITY, RATE, SPIN_INTEGRAL
from massprop_drake.maths.vehicle.sensing import (
    PackageErrors,
    limit_to_range,
    point_velocity,
    quantize,
    read_with_memory,
    read_without_memory,
)
from massprop_drake.maths.vehicle.true_failures import FailureTable


class Sensing(NamedTuple):
    """Package of sensors.

    Attributes:
        errors: see `PackageErrors`.
        gathers: whether it is one of integrating accelerometers; else of rate gyros.
        position: vehicle frame, ft or m, shape (3,); of no meaning to gyros.
    """

    errors: PackageErrors
    gathers: bool
    position: Array


@kernel
def _signal(body: Array, sensing: Sensing) -> Array:
    """Computes the true rate or velocity that a package measures, shape (3,), from the body state."""
    if sensing.gathers:
        return point_velocity(body[ORIGIN_VELOCITY], body[RATE], body[SPIN_INTEGRAL], sensing.position)
    return body[RATE]


@kernel
def exact_reading(body: Array, holder: Any) -> Array:
    """Computes the reading of a package that only quantizes and limits, shape (3,).

    Args:
        body: see `rigid_body`, shape (23,).
        holder: holder of `Sensing`.
    """
    sensing = holder.value
    errors = sensing.errors
    return limit_to_range(quantize(_signal(body, sensing), errors.quantum, errors.phase), errors.limit)


@kernel
def reading(body: Array, noise: Array, vibration: Array, holder: Any) -> Array:
    """Computes the reading of a package without memory, shape (3,), from the body state.

    Args:
        body, holder: as in `exact_reading`.
        noise: standard normal, shape (6,).
        vibration: vibration in the reading, shape (3,), or empty.
    """
    sensing = holder.value
    return read_without_memory(_signal(body, sensing), noise, vibration, sensing.errors)


@kernel
def remembered_reading(body: Array, memory: Array, noise: Array, vibration: Array, holder: Any) -> Array:
    """Computes a reading (3) of a package with memory, then that memory, in one vector; see `reading`.

    Args:
        memory: see `sensing.sense`.
    """
    sensing = holder.value
    row = np.empty(3 + memory.size, dtype=memory.dtype)
    row[:3], row[3:] = read_with_memory(_signal(body, sensing), memory, noise, vibration, sensing.errors)
    return row


class Jets(NamedTuple):
    """True jets of a vehicle.

    Attributes:
        thrusters: see `JetThrusts`.
        failures: what they deliver in place of what they are told.
        period_s: sample period, s.
    """

    thrusters: JetThrusts
    failures: FailureTable
    period_s: float


@kernel
def failed_target(command: Array, closed: Array, begins_s: float, strikes: NDArray[np.bool_], holder: Any) -> Array:
    """Computes each jet's target level over a sample, failures and closed manifolds applied, shape (n_jets,).

    Args:
        command: fraction commanded over it, shape (n_jets,).
        closed: 1 for each jet whose manifold is closed over it, shape (n_jets,); empty: none can be.
        begins_s: when the sample does, s.
        strikes: see `true_failures.draw_strikes`.
        holder: holder of `Jets`.
    """
    jets = holder.value
    level = true_failures.apply_failures(command, begins_s, jets.period_s, strikes, jets.failures)
    return level * (1.0 - closed) if closed.size else level


@kernel
def forces_and_profile(level: Array, target: Array, holder: Any) -> Array:
    """Computes each jet's mean force, then the wrench profile row by row, in one vector.

    Args:
        level, target: levels now, and what they tend to, shape (n_jets,) each.
        holder: holder of `Jets`.
    """
    thrusters = holder.value.thrusters
    profile = reaction_jets.wrench_profile(level, target, thrusters)
    row = np.empty(level.size + profile.size, dtype=target.dtype)
    fill(row, (reaction_jets.mean_force(level, target, thrusters), profile))
    return row


class Motion(NamedTuple):
    """Parameters of a step of the body.

    Attributes:
        constants_s: time constants of the profile's dying parts, s, shape (n,).
        duration_s: s.
        pieces: the most that a step has.
    """

    constants_s: Array
    duration_s: float
    pieces: int = 1


@kernel
def step_body(body: Array, profile: Array, wheels: Array, constants: Any, holder: Any) -> Array:
    """Computes the body state after a sample under a wrench profile and wheels, shape (23,).

    Args:
        body: before it.
        profile: of the wrench, row by row; of a step of pieces, of each its length and this.
        wheels: their angular momentum and its derivative, see `rigid_body.add_wheel_momentum`, shape (6,); empty: none.
        constants: holder of `rigid_body.Body`.
        holder: holder of `Motion`.

    Raises:
        OutOfMassError, SpunUpError: see `rigid_body.step`.
    """
    motion, moved = holder.value, constants.value
    if wheels.size > 0:
        moved = rigid_body.add_wheel_momentum(moved, wheels, 0.0)
    if motion.pieces == 1:
        rows = profile.reshape((-1, N_WRENCH))
        return rigid_body.step(body, rows[0], rows[1:], motion.constants_s, motion.duration_s, moved)
    parts, since_s = profile.reshape((motion.pieces, -1)), 0.0
    for piece in range(motion.pieces):
        if parts[piece, 0] > 0.0:
            if wheels.size > 0:
                moved = rigid_body.add_wheel_momentum(moved, wheels, since_s)
            rows = parts[piece, 1:].reshape((-1, N_WRENCH))
            body = rigid_body.step(body, rows[0], rows[1:], motion.constants_s, parts[piece, 0], moved)
            since_s += parts[piece, 0]
    return body
