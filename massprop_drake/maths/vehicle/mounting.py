r"""Mounting of the jets: places and directions of their forces, and the errors of these.

A jet's force F at p, off by two small angles and by two lengths across its direction d, is

    d' ~ d + e1 n1 + e2 n2,   p' = p + e3 n1 + e4 n2,   wrench (p' x F', F'),   F' = |F| d' / |d'|,

n1 and n2 normal to d and to each other. Along d a shift makes no difference. What is estimated are the errors in units
of their 1-sigmas, to first order: of .01 rad the second is 5e-5 of the force.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from massprop_drake.maths.kernels import kernel
from massprop_drake.maths.linear_algebra import Array, normals

N_ERRORS = 4


class Mounting(NamedTuple):
    """Errors of the jets' mounting that have a 1-sigma above zero.

    Attributes:
        jets: index of the jet that each belongs to, shape (n,).
        wrenches: torque about the vehicle origin and force by one 1-sigma of each at full thrust, shape (n, 6).
    """

    jets: np.ndarray
    wrenches: Array


EXACT = Mounting(np.zeros(0, dtype=np.intp), np.zeros((0, 6)))


def mounting_errors(wrenches: Array, positions: Array, sigmas: Array) -> Mounting:
    """Lists jets' mounting errors of nonzero 1-sigma: the jet, and the change of wrench by a 1-sigma.

    Args:
        wrenches: torque about the vehicle origin and force of each jet at full thrust, shape (n_jets, 6).
        positions: where they act, vehicle frame, shape (n_jets, 3).
        sigmas: of direction, rad, and of position, ft or m, of each jet, shape (n_jets, 2).
    """
    forces = wrenches[:, 3:]
    sizes = np.linalg.norm(forces, axis=1, keepdims=True)
    across = normals(forces / sizes)
    turned = sizes[:, None] * across  # (n_jets, 2, 3)
    by_direction = np.concatenate((np.cross(positions[:, None], turned), turned), axis=2)
    by_position = np.concatenate((np.cross(across, forces[:, None]), np.zeros_like(across)), axis=2)
    by_errors = np.concatenate((sigmas[:, :1, None] * by_direction, sigmas[:, 1:, None] * by_position), axis=1)
    there = np.repeat(sigmas > 0.0, 2, axis=1).ravel()
    jets = np.repeat(np.arange(len(wrenches)), N_ERRORS)
    return Mounting(jets[there], np.ascontiguousarray(by_errors.reshape(-1, 6)[there]))


@kernel
def displace_wrenches(wrenches: Array, errors: Array, mounting: Mounting) -> Array:
    """Adds mounting errors to jet wrenches, to first order, shape (n_jets, 6).

    Args:
        wrenches: as stated, shape (n_jets, 6).
        errors: in units of their 1-sigmas, shape (n,).
    """
    if errors.shape[0] == 0:
        return wrenches
    result = wrenches.copy()
    for place in range(errors.shape[0]):
        result[mounting.jets[place]] += errors[place] * mounting.wrenches[place]
    return result


def true_mounted_wrenches(wrenches: Array, positions: Array, errors: Array) -> Array:
    """Applies mounting errors to jet wrenches exactly, shape (n_jets, 6 or more).

    Args:
        wrenches: torque about the vehicle origin and force as stated, and anything more, shape (n_jets, 6 or more).
        positions: as stated, vehicle frame, shape (n_jets, 3).
        errors: angles of the force, rad, and shifts of its place, along n1 and n2, shape (n_jets, 4).
    """
    result, forces = wrenches.copy(), wrenches[:, 3:6]
    sizes = np.linalg.norm(forces, axis=1, keepdims=True)
    across = normals(forces / sizes)
    directions = forces / sizes + np.einsum("je,jex->jx", errors[:, :2], across)
    places = positions + np.einsum("je,jex->jx", errors[:, 2:], across)
    result[:, 3:6] = sizes * directions / np.linalg.norm(directions, axis=1, keepdims=True)
    result[:, :3] = np.cross(places, result[:, 3:6])
    return result
