"""Checks of arguments of systems that a user may build alone: a wrong shape gets a message."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from massprop_drake.maths.linear_algebra import Array


def require_vector(name: str, value: ArrayLike, size: int) -> Array:
    """Returns an argument as a finite float vector, shape (size,), or raises ValueError with its name."""
    made = np.array(value, dtype=float)
    if made.shape != (size,):
        raise ValueError(f"{name}: must be a vector of {size} numbers, got {_describe_shape(made)}")
    if not np.isfinite(made).all():
        raise ValueError(f"{name}: must be finite, got {made.tolist()}")
    return made


def require_rows(name: str, value: ArrayLike, size: int) -> Array:
    """Returns an argument as a float matrix, shape (n_jets, size), or raises ValueError with its name."""
    made = np.array(value, dtype=float)
    if made.ndim != 2 or made.shape[1] != size:
        raise ValueError(f"{name}: must be rows of {size} numbers, one for each jet, got {_describe_shape(made)}")
    return made


def _describe_shape(made: Array) -> str:
    return f"the number {made:g}" if made.ndim == 0 else f"shape {made.shape}"
