r"""Guaranteed intervals of the ten parameters: the values that quantized readings allow, and no others.

A reading c of a quantum q says that the signal lies in [c - q/2, c + q/2]. Linearized about a point, with x the
difference of all unknowns from it, every reading is a constraint l <= a^T x <= h, and

    low_i, high_i = min, max x_i   subject to   l <= A x <= h

are linear programs; no assumption on how rounding errors are distributed enters. The unknowns are the ten parameters,
what is stated with a 1-sigma (thrusts, lags, biases), confined to `SIGMAS` of it, and for each stretch the rate at its
beginning and what each accelerometer shows there. The derivatives are those of the batch regression, with the coupling
of the rates that the model gives, whose own changes are added here. See `docs/theory/hindsight.md`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from massprop_drake.maths.estimation.offline import flight_model, normal_equations
from massprop_drake.maths.estimation.offline.coupled_rates import add_rate_coupling, cross_product_matrices
from massprop_drake.maths.estimation.offline.flight_model import FlightModel, Stretch
from massprop_drake.maths.linear_algebra import Array

SIGMAS = 4.0  # of what is stated, to which it is confined: one of thirty jets is beyond in one of 500 flights
NOISE_SIGMAS = 5.0  # of noise before rounding, by which a cell is widened
_N = 10  # mass properties
_SCALED = [*range(6), 9]  # inverse inertia and 1/m
_FAR = 1e6  # quanta within which starts of stretches are sought
_MARGIN = 1e-4  # quanta: a simulated orbiter's rates are right to 6e-5, since it flies by steps of a sample
_TOLERANCE = 1e-6  # quanta: rounding of a program's solution
_ADDED = 40  # constraints that are added to a program at once, at the most
_LINEARIZATIONS = 6
_ROUNDS = 8  # of the rate with its coupling, at the most
_SMALL = 1e-12  # of the rate: a round that moves it less is the last
_BENT = 10.0  # quanta: largest departure from the linearization at the ends of the intervals
_WIDENINGS = 8  # of cells by departures, at the most
_CLEAR = 0.5  # of how far readings are from their cells: largest departure by which they contradict each other
_STRAIGHT = 1e-5  # quanta: the point amid the extreme ones departs from it by less once linearization is redone
_LEFT = 0.9  # of 1/m: the farthest that it is sought from the point
_NEAR = 0.99  # of its span: a parameter that reaches as far is not bounded by readings

Solve = Callable[[Array, Array, Array, Array], "Array | None"]
"""Minimizes cost^T z, shape (n,), subject to low <= matrix z <= high, shapes (r,), (r, n), (r,); None: infeasible."""


class Constraints(NamedTuple):
    """Linear constraints low <= matrix x <= high.

    Attributes:
        matrix: shape (r, n).
        low, high: shape (r,).
        always: how many of the first rows bound x by themselves.
    """

    matrix: Array
    low: Array
    high: Array
    always: int


class Confined(NamedTuple):
    """Intervals of the parameters that all readings allow.

    Attributes:
        low, high: of each of the ten parameters, NaN where readings do not bound it, shape (10,).
        depth: least distance of a signal from the edge of its cell, where that is largest, quanta; negative: readings
            contradict each other.
        bend: largest departure of the model from its linearization at the ends of the intervals, or else at the point
            closest to all readings, quanta.
    """

    low: Array
    high: Array
    depth: float
    bend: float

    @property
    def is_contradicted(self) -> bool:
        """True if no mass properties explain all quantized readings."""
        return self.bend < -_CLEAR * self.depth


# ----------------------------------------------------------------------------------------- programs


def _scale_unknowns(constraints: Constraints) -> tuple[Constraints, Array]:
    """Scales unknowns, x = root z, to nearly orthogonal constraints on z; returns these, and the root."""
    if not np.isfinite(constraints.matrix).all() or np.isnan(constraints.low).any() or np.isnan(constraints.high).any():
        raise ArithmeticError("the motion cannot be computed about the estimate")
    factor = np.linalg.qr(constraints.matrix, mode="r")
    root = np.linalg.inv(factor) * np.sqrt(constraints.matrix.shape[0])
    return constraints._replace(matrix=constraints.matrix @ root), root


class _RowSearch:
    """Solver of programs with few constraints, which adds those that its solutions violate: a workspace."""

    def __init__(self, constraints: Constraints, solver: Solve):
        self._given, self._solve = constraints, solver
        outmost = (extreme(constraints.matrix, axis=0) for extreme in (np.argmin, np.argmax))
        self._active = np.unique(np.concatenate((np.arange(constraints.always), *outmost)))

    def lowest(self, cost: Array) -> Array | None:
        """Returns the point of least linear cost within all constraints, shape (n,); None: there is none."""
        matrix, low, high, _ = self._given
        size = float(np.abs(cost).max())
        while True:
            rows = self._active
            point = self._solve(cost / size, matrix[rows], low[rows], high[rows])
            if point is None:
                return None
            value = matrix @ point
            over = np.maximum(low - value, value - high)
            over[rows] = 0.0
            worst = np.argsort(over)[-_ADDED:]
            worst = worst[over[worst] > _TOLERANCE]
            if not worst.size:
                return point
            self._active = np.concatenate((rows, worst))


def deepest_point(constraints: Constraints, solver: Solve) -> tuple[Array, float]:
    """Finds the point farthest from all constraints' edges, and its distance; negative: they contradict.

    Args:
        constraints: of r constraints on n unknowns; the first `always` are kept in any case.

    Returns:
        Point, shape (n,), and distance, in the constraints' unit.

    Raises:
        ArithmeticError: when the solver fails, or a constraint is no number.
    """
    (matrix, low, high, always), root = _scale_unknowns(constraints)
    n, ones = matrix.shape[1], np.ones((matrix.shape[0] - always, 1))
    kept, edges = np.hstack((matrix[:always], np.zeros((always, 1)))), matrix[always:]
    without = np.full(ones.shape[0], np.inf)
    widened = Constraints(
        np.vstack((kept, np.eye(n + 1)[n:], np.hstack((edges, -ones)), np.hstack((edges, ones)))),
        np.concatenate((low[:always], [-_FAR], low[always:], -without)),
        np.concatenate((high[:always], [_FAR], without, high[always:])),
        always + 1,
    )
    found = _RowSearch(widened, solver).lowest(-np.eye(n + 1)[n])
    if found is None:
        raise ArithmeticError("the solver finds no point that is closest to all readings")
    return root @ found[:n], float(found[n])


def extreme_points(constraints: Constraints, count: int, solver: Solve) -> Array | None:
    """Finds for each of the first ``count`` unknowns the points where it is least and largest.

    Args:
        constraints: see `deepest_point`.

    Returns:
        Points, shape (count, 2, n); None where no point meets all constraints.
    """
    scaled, root = _scale_unknowns(constraints)
    search = _RowSearch(scaled, solver)
    found = np.empty((count, 2, constraints.matrix.shape[1]))
    for unknown in range(count):
        for side, sign in enumerate((1.0, -1.0)):
            point = search.lowest(sign * root[unknown])
            if point is None:
                return None
            found[unknown, side] = root @ point
    return found


# ----------------------------------------------------------------------------------------- readings


class Cells(NamedTuple):
    """Cells of readings, which confine signals.

    Attributes:
        quanta: of the packages, gyros first; zero: the package is not used, shape (n_packages,).
        noise: 1-sigma before rounding, likewise.
        gyro_biases: 1-sigma of a constant bias of each gyro, shape (n_gyros,).
        spans: of the ten parameters within which they are sought, shape (10,).
    """

    quanta: Array
    noise: Array
    gyro_biases: Array
    spans: Array

    @property
    def halves(self) -> Array:
        """Half widths of the quantizer cells, noise included, quanta, shape (n_packages,)."""
        noise = np.divide(self.noise, self.quanta, out=np.zeros_like(self.noise), where=self.quanta > 0.0)
        return 0.5 + NOISE_SIGMAS * noise + _MARGIN


class _Point(NamedTuple):
    """Point of linearization: the unknowns of the batch regression, and those that it lacks.

    Attributes:
        at: shape (n,).
        rates: at the beginning of each stretch, NaN where not known yet, shape (s, 3).
        biases: of gyros, shape (n_gyros, 3).
    """

    at: Array
    rates: Array
    biases: Array


class _Outputs(NamedTuple):
    """Outputs of packages over a stretch, but for starts of accelerometers and biases of gyros.

    Attributes:
        shown: shape (n_packages, 3, m).
        derivatives: by the unknowns that are reckoned with and the rate at the beginning, (n_packages, 3, u + 3, m).
        rate: at the beginning, shape (3,).
    """

    shown: Array
    derivatives: Array
    rate: Array


def _error_free_readings(
    stretch: Stretch, unknowns: Array, initial_rate: Array, biases: Array, model: FlightModel
) -> _Outputs:
    """Computes error-free readings over a stretch and derivatives; a NaN initial rate is fitted to gyros.

    Coupling is with true rates: biases of gyros, which have unknowns of their own, play no part in it.
    """
    gyros, m, estimated = model.gyros, stretch.time_s.size, flight_model.relevant_unknowns(model)
    of_gyros = flight_model.columns(model).gyro_bias
    unknowns = np.where(np.isin(np.arange(unknowns.size), np.arange(of_gyros.start, of_gyros.stop)), 0.0, unknowns)
    readings, offset, rates = np.zeros_like(stretch.readings), initial_rate, np.zeros((3, m))
    for _ in range(_ROUNDS):  # Newton's, for coupling with the rates that come of it
        readings[:, :gyros] = rates.T[:, None]
        found, motion = normal_equations.residuals(stretch._replace(readings=readings), unknowns, model)
        if np.isnan(initial_rate).any():
            offset = np.nanmean(stretch.readings[:, :gyros] - biases - motion[:3].T[:, None], axis=(0, 1))
        away, lengths_s = motion[:3] + offset[:, None] - rates, np.diff(stretch.time_s)
        step = add_rate_coupling(away[:, None], rates, np.zeros((3, m)), lengths_s, unknowns)[:, 0]  # no wheels
        rates = rates + step
        if np.abs(step).max() <= _SMALL * np.abs(rates).max():
            break
    u = int(estimated.sum())
    shown, derivatives = np.empty((model.variances.size, 3, m)), np.zeros((model.variances.size, 3, u + 3, m))
    for one in found:
        shown[one.package, one.axis] = rates[one.axis] if one.package < gyros else -one.left
        one.derivatives[of_gyros] = 0.0
        derivatives[one.package, one.axis, :u] = one.derivatives[estimated]
    fixed_mean = derivatives[0].copy()  # with the mean of the rate held, as `hindsight` has it
    straight = fixed_mean - fixed_mean[..., :1]
    begun = straight.copy()
    begun[:, u:] = np.eye(3)[:, :, None]
    derivatives[:gyros] = changes = add_rate_coupling(begun, rates, np.zeros((3, m)), np.diff(stretch.time_s), unknowns)
    for package in range(gyros, model.variances.size):
        arm = model.positions[package - gyros] - unknowns[6:9]
        derivatives[package] += _lever_arm_changes(changes - straight, changes - fixed_mean, rates, arm, stretch.time_s)
    return _Outputs(shown, derivatives, offset)


def _refined_outputs(
    stretch: Stretch, unknowns: Array, initial_rate: Array, biases: Array, model: FlightModel
) -> _Outputs:
    """Computes error-free readings and derivatives over a stretch, with two integration steps per interval."""
    m = stretch.time_s.size
    rows = np.arange(2 * m - 1) // 2
    ends = np.minimum(rows + np.arange(2 * m - 1) % 2, m - 1)
    readings = stretch.readings[rows].copy()
    readings[1::2] = np.nan
    twice = stretch._replace(
        time_s=0.5 * (stretch.time_s[rows] + stretch.time_s[ends]),
        readings=readings,
        commands=stretch.commands[rows],
        outside=stretch.outside[rows],
        used_after=0.5 * (stretch.used_after[rows] + stretch.used_after[ends]),
    )
    out = _error_free_readings(twice, unknowns, initial_rate, biases, model._replace(period_s=0.5 * model.period_s))
    return _Outputs(out.shown[..., ::2], out.derivatives[..., ::2], out.rate)


def _lever_arm_changes(rate_gains: Array, rate_changes: Array, rate: Array, arm: Array, time_s: Array) -> Array:
    """Computes changes of an accelerometer's velocity, off the center of mass, by those of the rate, (3, u + 3, m)."""
    lever = -cross_product_matrices(arm)
    slope = np.einsum("ijm,jk->ikm", cross_product_matrices(rate), lever) - cross_product_matrices(lever @ rate)
    result = np.einsum("ij,jum->ium", lever, rate_gains)
    slopes = np.einsum("ijm,jum->ium", slope, rate_changes)
    result[..., 1:] += np.cumsum(0.5 * (slopes[..., 1:] + slopes[..., :-1]) * np.diff(time_s), axis=-1)
    return result


class _CellRows(NamedTuple):
    """Constraints by a component of a package over a stretch."""

    package: int
    matrix: Array  # quanta for each unknown, (r, n)
    left: Array  # what is read less what is shown, quanta, (r,)


class _Linear:
    """Readings of a flight linearized about a point."""

    def __init__(self, stretches: Sequence[Stretch], point: _Point, model: FlightModel, cells: Cells):
        self._stretches, self._model, self._cells = stretches, model, cells
        self._wanted = np.flatnonzero(flight_model.relevant_unknowns(model))
        self._common = self._wanted.size + 3 * model.gyros  # unknowns of all stretches, biases of gyros the last
        self._starts = 3 + 3 * model.positions.shape[0]  # of a stretch: rate, and each component of accelerometers
        thrust = flight_model.columns(model).thrust  # unknown ones of jets that fire
        self._loose = (model.sigma[thrust] > 0.0) & np.any([part.commands.any(axis=0) for part in stretches], axis=0)
        self._parts: list[_CellRows] = []
        self.point = point
        rates = np.empty((len(stretches), 3))
        for number, stretch in enumerate(stretches):
            out = _refined_outputs(stretch, point.at, point.rates[number], point.biases, model)
            rates[number] = out.rate
            self._parts += self._cell_rows(number, out)
        self.point = point._replace(rates=rates)

    def _cell_rows(self, index: int, outputs: _Outputs) -> Iterator[_CellRows]:
        """Yields the linear constraints by the readings of a stretch, one per package and axis."""
        stretch, gyros, u = self._stretches[index], self._model.gyros, self._wanted.size
        own, size = (self._common + count * self._starts for count in (index, len(self._stretches)))
        for package in np.flatnonzero(self._cells.quanta > 0.0).tolist():
            for axis in range(3):
                readings = stretch.readings[:, package, axis]
                rows = np.flatnonzero(~np.isnan(readings))
                matrix, derivatives = np.zeros((rows.size, size)), outputs.derivatives[package, axis][:, rows].T
                matrix[:, :u], matrix[:, own : own + 3] = derivatives[:, :u], derivatives[:, u:]
                matrix[:, (u + 3 * package if package < gyros else own + 3 + 3 * (package - gyros)) + axis] = 1.0
                left = readings[rows] - outputs.shown[package, axis, rows]
                if package < gyros:
                    left -= self.point.biases[package, axis]
                elif rows.size:
                    left -= 0.5 * (left.max() + left.min())
                quantum = self._cells.quanta[package]
                yield _CellRows(package, matrix / quantum, left / quantum)

    @property
    def readings(self) -> int:
        """Number of readings."""
        return sum(part.left.size for part in self._parts)

    @property
    def spans(self) -> Array:
        """Largest difference of each parameter from the point, with mass still positive, shape (10,)."""
        spans = self._cells.spans.copy()
        spans[-1] = min(spans[-1], _LEFT * self.point.at[_N - 1])
        return spans

    def _bounds(self) -> Constraints:
        """Returns the constraints that bound each unknown by itself, in units of its span."""
        cells, model, point, stated = self._cells, self._model, self.point, self._wanted[_N:]
        least = _MARGIN * cells.quanta[: model.gyros]
        biases = np.repeat(np.maximum(SIGMAS * cells.gyro_biases, least), 3)
        starts = np.full(len(self._stretches) * self._starts, _FAR * cells.quanta.max())
        spans = np.concatenate((self.spans, SIGMAS * model.sigma[stated], biases, starts))
        middle = np.zeros(spans.size)
        middle[_N : self._common] = np.concatenate(((model.prior - point.at)[stated], -point.biases.ravel()))
        return Constraints(np.diag(1.0 / spans), middle / spans - 1.0, middle / spans + 1.0, spans.size)

    def constraints(self, widening: Array | float) -> Constraints:
        """Returns all constraints on differences from the point, cells widened by ``widening`` quanta."""
        bounds, halves = self._bounds(), self._cells.halves
        left = np.concatenate([part.left for part in self._parts])
        half = np.concatenate([np.full(part.left.size, halves[part.package]) for part in self._parts]) + widening
        matrix = np.vstack([bounds.matrix, *(part.matrix for part in self._parts)])
        low, high = np.concatenate((bounds.low, left - half)), np.concatenate((bounds.high, left + half))
        return Constraints(matrix, low, high, bounds.always)

    def error(self) -> float:
        """Estimates the integration error of the computed readings, largest of all, quanta.

        Twice as many steps change them by three times what is then still wrong, or more: they are of second order.
        """
        worst, point, quanta = 0.0, self.point, self._cells.quanta
        for stretch, rate in zip(self._stretches, point.rates, strict=True):
            about = stretch, point.at, rate, point.biases, self._model
            fine, coarse = (each(*about).shown for each in (_refined_outputs, _error_free_readings))
            off = np.ptp(fine - coarse, axis=-1)[quanta > 0.0]
            worst = max(worst, float((off / quanta[quanta > 0.0, None]).max()))
        return worst / 3.0

    def move_point(self, difference: Array) -> _Point:
        """Returns the point of linearization moved by a difference of all unknowns, shape (n,).

        Inverse inertia and 1/m times a factor, and thrusts over it, give the same motion: where thrusts are not exact,
        the point moves by the factor along that curve, and not along its tangent.
        """
        (unknowns, rates, biases), loose, u = self.point, self._loose, self._wanted.size
        change, thrust = np.zeros_like(unknowns), flight_model.columns(self._model).thrust
        change[self._wanted] = difference[:u]
        factor = -float(np.mean(change[thrust][loose])) if loose.any() else 0.0
        moved = unknowns + change
        moved[_SCALED] = np.exp(factor) * (moved[_SCALED] - factor * unknowns[_SCALED])
        gains = 1.0 + unknowns[thrust]
        scaled = np.exp(-factor) * (gains + change[thrust] + factor * gains) - 1.0
        moved[thrust] = np.where(loose, scaled, moved[thrust])
        starts = difference[self._common :].reshape(-1, self._starts)[:, :3]
        return _Point(moved, rates + starts, biases + difference[u : self._common].reshape(-1, 3))

    def relinearize(self, difference: Array) -> _Linear:
        """Returns the same readings linearized about the point moved by a difference, shape (n,)."""
        return _Linear(self._stretches, self.move_point(difference), self._model, self._cells)

    def nonlinearity(self, difference: Array) -> Array:
        """Computes every reading's departure from linearity at a difference of the unknowns, quanta."""
        if not flight_model.is_physical(self.move_point(difference).at):
            return np.full(self.readings, np.inf)
        every = []
        for here, there in zip(self._parts, self.relinearize(difference)._parts, strict=True):
            off = here.left - there.left - here.matrix @ difference
            if off.size and here.package >= self._model.gyros:  # an accelerometer may start anywhere
                off -= 0.5 * (off.max() + off.min())
            every.append(np.abs(off))
        return np.concatenate(every)


def _widen_until_linear(linear: _Linear, integration_error: float, solver: Solve) -> tuple[Array | None, float]:
    """Finds the extreme points with cells widened until departures from linearity there fit within.

    Returns:
        Points as `extreme_points` gives them, None where departures grow with the cells; and the largest departure,
        quanta.
    """
    allowed = np.full(linear.readings, _STRAIGHT)
    for _ in range(_WIDENINGS):
        ends = extreme_points(linear.constraints(integration_error + allowed), _N, solver)
        if ends is None:
            return None, np.inf
        departures = np.max([linear.nonlinearity(end) for end in ends.reshape(2 * _N, -1)], axis=0)
        bend = float(departures.max())
        if (departures <= allowed).all():
            return ends, bend
        if bend > _BENT:
            break
        allowed = np.maximum(2.0 * departures, allowed)
    return None, bend


def find_intervals(
    stretches: Sequence[Stretch], initial: Array, model: FlightModel, cells: Cells, solver: Solve
) -> Confined:
    """Finds the interval of each of the ten parameters that all quantized readings of a flight allow.

    The linearization is redone about the point amid the extreme ones, or about the one closest to all readings where
    they contradict each other. Then cells are widened until the model departs from it by less at the extreme points.

    Args:
        stretches: of the flight, at least one.
        initial: all unknowns about which is linearized first; see `flight_model.is_physical`, shape (n,).
        model: see `flight_model.FlightModel`; stamps lie on ticks, and nothing shifts with propellant.

    Raises:
        ArithmeticError: see `deepest_point`.
    """
    made = model._replace(variances=np.ones_like(model.variances), quanta=np.zeros_like(model.quanta))
    point = _Point(initial, np.full((len(stretches), 3), np.nan), np.zeros((model.gyros, 3)))
    linear, unknown = _Linear(stretches, point, made, cells), np.full(_N, np.nan)
    for number in range(_LINEARIZATIONS):
        error = linear.error()
        middle, depth = deepest_point(linear.constraints(error), solver)
        ends = extreme_points(linear.constraints(error), _N, solver) if depth > 0.0 else None
        if ends is not None:
            middle = ends.mean(axis=(0, 1))
        bend = float(linear.nonlinearity(middle).max(initial=0.0))
        if bend == np.inf or (number and bend < (_STRAIGHT if ends is not None else -_CLEAR * depth)):
            break
        linear = linear.relinearize(middle)
    if ends is not None and bend < np.inf:
        ends, bend = _widen_until_linear(linear, error, solver)
    if ends is None:
        return Confined(unknown, unknown, depth, bend)
    reached = np.array([[linear.move_point(end).at[k] for end in pair] for k, pair in enumerate(ends)])
    far = np.abs(ends[range(_N), :, range(_N)]).max(axis=1) > _NEAR * linear.spans
    low, high = np.where(far, np.nan, reached.T)
    return Confined(low, high, depth, bend)
