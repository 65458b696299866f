"""Checks of arguments of systems that a user may build alone: a wrong shape gets a message."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from massprop_drake.maths.linear_algebra import Array


def require_vector(name: str, value: ArrayLike, size: int) -> Array:
    """Returns an argument as a finite float vector, shape (size,), or raises ValueError with its name."""
    vector = np.array(value, dtype=float)
    if vector.shape != (size,):
        raise ValueError(f"{name}: must be a vector of {size} numbers, got {_describe_shape(vector)}")
    if not np.isfinite(vector).all():
        raise ValueError(f"{name}: must be finite, got {vector.tolist()}")
    return vector


def require_rows(name: str, value: ArrayLike, size: int) -> Array:
    """Returns an argument as a float matrix, shape (n_jets, size), or raises ValueError with its name."""
    matrix = np.array(value, dtype=float)
    if matrix.ndim != 2 or matrix.shape[1] != size:
        raise ValueError(f"{name}: must be rows of {size} numbers, one for each jet, got {_describe_shape(matrix)}")
    return matrix


def _describe_shape(array: Array) -> str:
    """Describes the shape of an array, or the value of a number, for messages."""
    return f"the number {array:g}" if array.ndim == 0 else f"shape {array.shape}"
