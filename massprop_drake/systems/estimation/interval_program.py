"""Linear programs of guaranteed intervals, by Drake's MathematicalProgram and the simplex solver Clp."""

from __future__ import annotations

import numpy as np
from pydrake.solvers import ClpSolver, MathematicalProgram

from massprop_drake.maths.linear_algebra import Array


def solve_linear_program(cost: Array, matrix: Array, low: Array, high: Array) -> Array | None:
    """Minimizes a linear cost under linear constraints; returns the unknowns, or None.

    Args:
        cost: of each unknown, shape (n,).
        matrix: of the constraints, with elements of the order of one: tolerances are absolute, shape (r, n).
        low, high: between which its product with the unknowns lies, infinite where it is open, shape (r,).

    Returns:
        The unknowns, shape (n,); None where the constraints contradict each other, or the solver gives up.

    Raises:
        ValueError: when a number is not finite that must be.
    """
    if not (np.isfinite(cost).all() and np.isfinite(matrix).all()) or np.isnan(low).any() or np.isnan(high).any():
        raise ValueError("intervals: a constraint or a cost is not a finite number")
    program = MathematicalProgram()
    unknowns = program.NewContinuousVariables(cost.size, "x")
    program.AddLinearConstraint(matrix, low, high, unknowns)
    program.AddLinearCost(cost, 0.0, unknowns)
    result = ClpSolver().Solve(program, None, None)
    return np.asarray(result.get_x_val()) if result.is_success() else None
