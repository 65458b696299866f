r"""Linear program of jet selection, by Drake's MathematicalProgram and the simplex solver Clp.

    minimize  sum_j c_j t_j   subject to   A t = b,   0 <= t <= limit          (1-1) to (1-4)

A holds the activity vectors, b the request [dw; dv], c the mass flows. A basic solution has at most
six on-times strictly between their bounds. The program is built once and its data changed.

Clp works with fixed absolute tolerances, so every row of A and b is divided by the row's largest
element, and b and the on-times by the largest element of b; unscaled answers are wrong in the third
digit.

A request that cannot be met is relaxed, by the same solver, and the result says so:

1. as much of dv as can be had with all of dw: the largest s in [0, 1] with A t = [dw; s dv];
2. where even dw is out of reach: the closest request, by the weighted sum of absolute differences of
   the scaled rows, rotation counting ten times as much as translation.

Each is followed by the program above for the least propellant that gives as much.
"""

from __future__ import annotations

import math
from enum import IntEnum
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from pydrake.solvers import ClpSolver, MathematicalProgram, MathematicalProgramResult

from massprop_drake.maths.linear_algebra import Array

RATE, VELOCITY = slice(0, 3), slice(3, 6)  # parts of a request
_ROTATION_WEIGHT = 10.0
_TINY = 1e-9  # share of a relaxed request given up so that rounding cannot make it infeasible again


class Outcome(IntEnum):
    """Outcome of a request."""

    EXACT = 0  # met in full
    REDUCED = 1  # all of the rate change, part of the velocity change
    CLOSEST = 2  # the closest that can be reached


class Selection(NamedTuple):
    """Answer of jet selection.

    Attributes:
        on_times_s: of each jet, s, shape (n_jets,).
        propellant: mass used, slug or kg.
        outcome: whether the request was met.
        reached: the request that these on-times give, rad/s and ft/s or m/s, shape (6,).
    """

    on_times_s: Array
    propellant: float
    outcome: Outcome
    reached: Array


class _Program(NamedTuple):
    """A program, and its constraints whose numbers change."""

    program: MathematicalProgram
    rows: Any
    box: Any


def _make_program(upper_limits: Array, cost: Array) -> _Program:
    """Makes a linear program: least cost, six equality rows, and variables from zero to their limits.

    Args:
        upper_limits: of each variable, shape (n,).
        cost: of each, shape (n,).
    """
    n, program = upper_limits.size, MathematicalProgram()
    t = program.NewContinuousVariables(n, "t")
    rows = program.AddLinearEqualityConstraint(np.ones((6, n)), np.zeros(6), t).evaluator()
    box = program.AddBoundingBoxConstraint(np.zeros(n), upper_limits, t).evaluator()
    program.AddLinearCost(cost, 0.0, t)
    return _Program(program, rows, box)


class JetSelectionProgram:
    """Chooser of on-times of least propellant for a six-dimensional rate-change request: a workspace.

    Every call sets all numbers that the solver reads, or finds them as they are to be, and the solver begins each time
    anew: an answer depends on the arguments alone. It is not for several threads at once.

    Args:
        mass_flows: propellant each jet uses at full thrust, slug/s or kg/s, positive, shape (n_jets,).
    """

    def __init__(self, mass_flows: Array):
        self._cost = np.array(mass_flows, dtype=float)
        if not (np.all(np.isfinite(self._cost)) and np.all(self._cost > 0.0)):
            raise ValueError(f"mass flows must be positive and finite, got {self._cost}")
        n = self._n = self._cost.size
        self._least = np.zeros(n)  # on-time of each jet
        self._solver = ClpSolver()
        self._checked: tuple[Array | None, Array | None] = None, None  # activity and limits, if both are read-only
        self._scaled_activity: Array | None = None  # the activity vectors whose scaled rows are kept
        self._rows = self._sizes = np.empty(0)
        self._exact_rows: Array | None = None  # the scaled rows that the first program holds
        self.solves = 0  # programs solved so far, for statistics

        self._exact_program = _make_program(np.full(n, np.inf), self._cost / self._cost.max())

    @cached_property
    def _reduced_program(self) -> _Program:
        """Linear program for on-times and fraction s of the velocity change, for a request that cannot be met."""
        return _make_program(np.ones(self._n + 1), -np.eye(self._n + 1)[self._n])

    @cached_property
    def _closest_program(self) -> _Program:
        """Linear program for on-times, shortfall and excess of each row, where even the rate change cannot be met."""
        weights = np.array([_ROTATION_WEIGHT] * 3 + [1.0] * 3)
        cost = np.concatenate([np.zeros(self._n), weights, weights])
        return _make_program(np.full(self._n + 12, np.inf), cost)

    def solve(self, activity: Array, request: Array, limits_s: Array) -> Selection:
        """Solves for least-propellant on-times of a request; read-only arrays of the last call are not checked again.

        Args:
            activity: activity vectors as columns, shape (6, n_jets).
            request: [dw; dv], rad/s and ft/s or m/s, shape (6,).
            limits_s: largest on-time of each jet, s; zero takes a jet out, shape (n_jets,).

        Raises:
            ValueError: when a shape is wrong or a number is not finite (limits may be infinite).
            ArithmeticError: when the solver finds nothing even for a relaxed request.
        """
        self._check_arguments(activity, request, limits_s)
        on_times = self._least_propellant(request, limits_s)
        outcome = Outcome.EXACT
        if on_times is None:
            outcome = Outcome.REDUCED
            relaxed = self._reduce_request(request, limits_s)
            if relaxed is None:
                outcome = Outcome.CLOSEST
                relaxed = self._closest_request(activity, request, limits_s)
            target, within_reach = relaxed
            # at the very edge of what can be reached rounding may leave no room to save propellant
            saving = self._least_propellant(target, limits_s)
            on_times = within_reach if saving is None else saving
        return Selection(on_times, float(self._cost @ on_times), outcome, activity @ on_times)

    def reach(self, activity: Array, row: int, sign: float, limits_s: Array, *, alone: bool = False) -> float:
        """Computes the largest change of one request element by jets, other rotations (`alone`: all others) at zero.

        Args:
            activity: activity vectors as columns, shape (6, n_jets).
            row: 0 to 2 rotation about x, y, z; 3 to 5 translation along them.
            sign: +1 or -1.
            limits_s: largest on-time of each jet, s, finite; zero takes a jet out, shape (n_jets,).
            alone: hold the other translations at zero, too; else they are left free.

        Returns:
            The change, rad/s or ft/s or m/s, zero or positive.
        """
        bound = np.zeros(6)
        self._check_arguments(activity, bound, limits_s)
        bound[row] = sign * float(np.abs(activity[row]) @ limits_s)
        if bound[row] == 0.0:
            return 0.0
        fixed_rows = [*range(6)] if alone else [*range(3), *([row] if row > 2 else [])]
        row_sizes = _row_sizes(activity[fixed_rows])
        rows, (target, scale) = activity[fixed_rows] / row_sizes[:, None], _scale_request(bound[fixed_rows], row_sizes)
        column = np.where(target != 0.0, -target, 0.0)
        missing = 6 - len(fixed_rows)
        self._reduced_program.rows.UpdateCoefficients(
            np.vstack([np.column_stack([rows, column]), np.zeros((missing, self._n + 1))]), np.zeros(6)
        )
        self._reduced_program.box.set_bounds(np.zeros(self._n + 1), np.append(limits_s / scale, 1.0))
        result = self._solve(self._reduced_program.program)
        fraction = 0.0 if result is None else float(result.get_x_val()[-1])
        return max(fraction, 0.0) * abs(float(bound[row]))

    def _scale_activity(self, activity: Array) -> None:
        """Stores activity rows scaled to a largest element of 1, unless they are those of the last call.

        Raises:
            ValueError: when an activity vector is not finite.
        """
        if self._scaled_activity is not None and self._scaled_activity.tobytes() == activity.tobytes():
            return
        if not np.isfinite(activity).all():
            raise ValueError(f"activity vectors must be finite, got {activity}")
        self._scaled_activity, self._sizes = activity.copy(), _row_sizes(activity)
        self._rows = activity / self._sizes[:, None]

    def _scale_request_rows(self, request: Array) -> tuple[Array, Array, float]:
        """Returns activity rows and request, scaled to a largest element of 1, and the scale of on-times."""
        return self._rows, *_scale_request(request, self._sizes)

    def _check_arguments(self, activity: Array, request: Array, limits_s: Array) -> None:
        """Raises ValueError for a wrong shape or value; scales activity vectors that are new."""
        if request.shape != (6,):
            raise ValueError(f"request must have shape (6,), got {request.shape}")
        if not all(map(math.isfinite, request.tolist())):
            raise ValueError(f"a request must be finite, got {request}")
        checked_activity, checked_limits_s = self._checked
        if activity is checked_activity and limits_s is checked_limits_s:
            return
        for name, array, shape in (("activity", activity, (6, self._n)), ("limits_s", limits_s, (self._n,))):
            if array.shape != shape:
                raise ValueError(f"{name} must have shape {shape}, got {array.shape}")
        self._scale_activity(activity)
        if not np.minimum.reduce(limits_s) >= 0.0:  # NaN fails too
            raise ValueError(f"limits_s must be zero or positive, got {limits_s}")
        constant = not (activity.flags.writeable or limits_s.flags.writeable)
        self._checked = (activity, limits_s) if constant else (None, None)

    def _least_propellant(self, request: Array, limits_s: Array) -> Array | None:
        """Computes on-times of least propellant, s, shape (n_jets,); None where they cannot meet the request."""
        rows, target, scale = self._scale_request_rows(request)
        if scale == 0.0:
            return np.zeros(self._n)
        if self._exact_rows is rows:
            self._exact_program.rows.set_bounds(target, target)
        else:
            self._exact_program.rows.UpdateCoefficients(rows, target)
            self._exact_rows = rows
        self._exact_program.box.set_bounds(self._least, limits_s / scale)
        result = self._solve(self._exact_program.program)
        if result is None:
            return None
        return _limit_on_times(result.get_x_val() * scale, limits_s)

    def _reduce_request(self, request: Array, limits_s: Array) -> tuple[Array, Array] | None:
        """Computes the request [dw; s dv] of largest s, and its on-times, s; None where dw cannot be met."""
        rows, target, scale = self._scale_request_rows(request)
        column = np.concatenate([np.zeros(3), -target[VELOCITY]])
        self._reduced_program.rows.UpdateCoefficients(
            np.column_stack([rows, column]), np.concatenate([target[RATE], np.zeros(3)])
        )
        self._reduced_program.box.set_bounds(np.zeros(self._n + 1), np.append(limits_s / scale, 1.0))
        result = self._solve(self._reduced_program.program)
        if result is None:
            return None
        solution = result.get_x_val()
        fraction = float(solution[-1]) * (1.0 - _TINY)
        on_times = _limit_on_times(solution[:-1] * scale, limits_s)
        return np.concatenate([request[RATE], fraction * request[VELOCITY]]), on_times

    def _closest_request(self, activity: Array, request: Array, limits_s: Array) -> tuple[Array, Array]:
        """Computes the attainable request closest to a request, shape (6,), and its on-times, s, shape (n_jets,)."""
        rows, target, scale = self._scale_request_rows(request)
        self._closest_program.rows.UpdateCoefficients(np.hstack([rows, np.eye(6), -np.eye(6)]), target)
        limits = np.concatenate([limits_s / scale, np.full(12, np.inf)])
        self._closest_program.box.set_bounds(np.zeros(self._n + 12), limits)
        result = self._solve(self._closest_program.program)
        if result is None:
            raise ArithmeticError(f"jet selection: the solver finds no on-times close to the request {request}")
        on_times = _limit_on_times(result.get_x_val()[: self._n] * scale, limits_s)
        return activity @ on_times, on_times

    def _solve(self, program: MathematicalProgram) -> MathematicalProgramResult | None:
        """Solves a linear program and returns its result; None where it is infeasible, or Clp gives up."""
        self.solves += 1
        result = self._solver.Solve(program, None, None)
        return result if result.is_success() else None


def _row_sizes(activity: Array) -> Array:
    """Computes the largest magnitude in each row of activity vectors, 1 for a row of zeros, shape (6,)."""
    sizes: Array = np.abs(activity).max(axis=1)
    sizes[sizes == 0.0] = 1.0
    return sizes


def _scale_request(request: Array, row_sizes: Array) -> tuple[Array, float]:
    """Divides a request by row sizes, then by its largest element; returns it and that scale of on-times."""
    target = request / row_sizes
    scale = max(map(abs, target.tolist()))
    return target / scale if scale > 0.0 else target, scale


def _limit_on_times(on_times_s: Array, limits_s: Array) -> Array:
    """Clips on-times to between zero and their limits, s."""
    return np.minimum(np.maximum(on_times_s, 0.0), limits_s)
