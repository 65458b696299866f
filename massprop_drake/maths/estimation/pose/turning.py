"""Rotations and cross products of many vectors at once; the last axis, or the last two, are those of space."""

from __future__ import annotations

import numpy as np

from massprop_drake.maths.linear_algebra import Array
from massprop_drake.maths.mass_properties import ELEMENT

_SMALL = 1e-4  # rad, below which series replace quotients
_EYE = np.eye(3)


def skew_matrices(vectors: Array) -> Array:
    """Computes the cross product matrices [v x] of vectors, shape (..., 3, 3)."""
    result = np.zeros((*vectors.shape, 3))
    x, y, z = vectors[..., 0], vectors[..., 1], vectors[..., 2]
    result[..., 0, 1], result[..., 0, 2] = -z, y
    result[..., 1, 0], result[..., 1, 2] = z, -x
    result[..., 2, 0], result[..., 2, 1] = -y, x
    return result


def rotations(vectors: Array) -> Array:
    """Computes rotation matrices from rotation vectors, rad, shape (..., 3, 3)."""
    angle = np.sqrt(np.sum(vectors**2, axis=-1))[..., None, None]
    safe = np.where(angle < _SMALL, 1.0, angle)
    first = np.where(angle < _SMALL, 1.0 - angle**2 / 6.0, np.sin(safe) / safe)
    second = np.where(angle < _SMALL, 0.5 - angle**2 / 24.0, (1.0 - np.cos(safe)) / safe**2)
    cross = skew_matrices(vectors)
    return _EYE + first * cross + second * (cross @ cross)


def rotation_vectors(matrices: Array) -> Array:
    """Computes rotation vectors, rad, of length 0 to pi, from rotation matrices, shape (..., 3)."""
    trace = np.trace(matrices, axis1=-2, axis2=-1)
    # the quaternion's largest component is divided by, Shepperd's way: sure at half a turn, too
    diagonal = np.diagonal(matrices, axis1=-2, axis2=-1)
    squares = np.concatenate((1.0 + trace[..., None], 1.0 + 2.0 * diagonal - trace[..., None]), axis=-1)
    best = np.argmax(squares, axis=-1)[..., None]
    m = matrices
    odd = np.stack((m[..., 2, 1] - m[..., 1, 2], m[..., 0, 2] - m[..., 2, 0], m[..., 1, 0] - m[..., 0, 1]), axis=-1)
    chosen = np.concatenate((squares[..., :1], odd), axis=-1)
    if best.any():  # some have turned far
        even = np.stack(
            (m[..., 0, 1] + m[..., 1, 0], m[..., 0, 2] + m[..., 2, 0], m[..., 1, 2] + m[..., 2, 1]), axis=-1
        )
        xy, xz, yz = np.moveaxis(even, -1, 0)
        rows = np.stack(
            (
                chosen,
                np.stack((odd[..., 0], squares[..., 1], xy, xz), axis=-1),
                np.stack((odd[..., 1], xy, squares[..., 2], yz), axis=-1),
                np.stack((odd[..., 2], xz, yz, squares[..., 3]), axis=-1),
            ),
            axis=-2,
        )
        chosen = np.take_along_axis(rows, best[..., None], axis=-2)[..., 0, :]
    chosen = chosen / np.sqrt(np.sum(chosen**2, axis=-1, keepdims=True))
    chosen = np.where(chosen[..., :1] < 0.0, -chosen, chosen)
    sine = np.sqrt(np.sum(chosen[..., 1:] ** 2, axis=-1, keepdims=True))
    safe = np.where(sine < _SMALL, 1.0, sine)
    factor = np.where(sine < _SMALL, 2.0 + sine**2 / 3.0, 2.0 * np.arctan2(sine, chosen[..., :1]) / safe)
    return factor * chosen[..., 1:]


def derivative_by_elements(vectors: Array) -> Array:
    """Computes derivatives of S v by the six elements of symmetric S, for each vector v, (..., 3, 6)."""
    result = np.zeros((*vectors.shape, 6))
    for row in range(3):
        for column in range(3):
            result[..., row, ELEMENT[row, column]] += vectors[..., column]
    return result


def matrix_vector_products(matrices: Array, vectors: Array) -> Array:
    """Multiplies the matrices of a stack by the vectors of another, pair by pair, shape (..., 3)."""
    return (matrices @ vectors[..., None])[..., 0]
