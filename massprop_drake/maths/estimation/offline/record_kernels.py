"""Functions of the batch regression that go through a record row by row; they compile."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from massprop_drake.maths.estimation.joint.swing import swing_modes
from massprop_drake.maths.estimation.offline.swings import Step
from massprop_drake.maths.kernels import as_iterable, compile_kernel_if, idiom, kernel
from massprop_drake.maths.linear_algebra import Array

_MOVED = 2.0  # quanta that a reading moves before it counts although none was expected
_NOTHING = 1e-20  # of a level


@kernel
def select_informative(expected: Array, readings: Array, quantum: float) -> NDArray[np.int_]:
    """Returns indices of a component's readings that carry new information: moved by about a quantum.

    Args:
        expected: outputs, shape (m,).
        readings: readings, NaN where missing, shape (m,).
        quantum: zero: all that are not missing.
    """
    there = np.flatnonzero(~np.isnan(readings))
    if quantum == 0.0 or there.size == 0:
        return there
    found, least = [there[0]], _MOVED * quantum
    forward, back = expected[there[0]], readings[there[0]]
    for row, one, other in zip(as_iterable(there), as_iterable(expected[there]), as_iterable(readings[there])):  # noqa: B905 (for numba)
        ahead, off = one - forward, other - back
        if ahead >= quantum or ahead <= -quantum or off >= least or off <= -least:
            found.append(row)
            forward, back = one, other
    return np.array(found)


def _apply_lag_by_row(level, level_slope, remaining, remaining_slope):  # type: ignore[no-untyped-def] # compiled alone
    """Compiled form of `apply_lag`, row by row."""
    for k in range(level.shape[0] - 1):
        for jet in range(level.shape[1]):
            off = level[k, jet] - level[k + 1, jet]
            level[k + 1, jet] = level[k + 1, jet] + off * remaining[jet]
            level_slope[k + 1, jet] = level_slope[k, jet] * remaining[jet] + off * remaining_slope[jet]


@idiom(_apply_lag_by_row)
def apply_lag(level: Array, level_slope: Array, remaining: Array, remaining_slope: Array) -> None:
    """Replaces targets of thrust levels by levels under first-order valve lag, in place, row by row.

    In numpy all rows are gone through at once: to what a row adds itself comes what is left of the rows before, of
    one, then of two, then of four, until nothing is.

    Args:
        level: at the beginning, then what each tends to over each interval, which the levels at its end replace, shape
            (m, n_jets).
        level_slope: their derivatives by the logarithm of the time constant, zero at the beginning, likewise filled in.
        remaining: share of an initial difference that is left at the end, shape (n_jets,).
        remaining_slope: its derivative, shape (n_jets,).
    """
    told = level[1:].copy()
    level[1:] *= 1.0 - remaining
    add_decayed_sums(level, remaining)
    level_slope[1:] = (level[:-1] - told) * remaining_slope
    add_decayed_sums(level_slope, remaining)


def add_decayed_sums(rows: Array, remaining: Array) -> None:
    """Adds to each row, in place, the decayed sum of all rows before; ``remaining``: decay per row."""
    back, left = 1, remaining
    while back < rows.shape[0] and left.max(initial=0.0) > _NOTHING:
        rows[back:] += left * rows[:-back]
        back, left = 2 * back, left * left


@kernel
def lag(level: Array, level_slope: Array, remaining: Array, remaining_slope: Array) -> None:
    """Replaces targets of thrust levels by lagged levels, in place; see `apply_lag`."""
    apply_lag(level, level_slope, remaining, remaining_slope)


class Compute(NamedTuple):
    """Functions that go through a record row by row, or their compiled forms."""

    used: Callable[[Array, Array, float], NDArray[np.int_]] = select_informative
    lag: Callable[[Array, Array, Array, Array], None] = lag
    swing: Step = swing_modes


def choose_kernels(*, compiled: bool) -> Compute:
    """Returns the functions that run through a record row by row, compiled or plain."""
    used, lagged = compile_kernel_if(select_informative, compiled), compile_kernel_if(lag, compiled)
    return Compute(used, lagged, compile_kernel_if(swing_modes, compiled))
