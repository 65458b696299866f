r"""Batch regression of a flight: all readings explained at once, and tests of what is left over.

Over a stretch of a record the rate is its value at the beginning and the sum of what jets, coupling and known forces
have added since, the velocity likewise, so that with theta all that may be unknown,

    y_k = y_0 + sum_{i <= k} d_i(theta) + v_k,    v_k: white, noise and rounding, of variance R.

That is a regression, whatever filter has flown. Its columns are the ten parameters, the thrust error of each jet, the
error of the lag of each kind, biases, and what a flight should not have: torques, drag, wheels, gains of axes.
With those that the filter reckons with (of prior variance Lambda^-1), the information A = X^T R^-1 X and the score
h = X^T R^-1 e

- bound each parameter: the 1-sigma that A and the start leave is the least for rounding taken as noise;
- test all else (Lagrange's multiplier, or score, test). With the fitted columns marginalized, the score U of a group of
  others has the covariance S if they are zero, so that U^T S^-1 U is chi-square distributed, and S^-1 U is how large
  they are. Errors that are stated with a 1-sigma of s have estimates of variance s^2 + 1/S.

Initial values are eliminated by taking means off. Where stamps are off their ticks, these lie on a line through the
stamps, as far as it is known: its two errors are unknowns of each stretch, and eliminated, too. A reading that has not
moved by a quantum since one was used says nothing new and is left out, as in the joint estimator. What jets draw from
tanks is known: about the middle of each stretch the ten parameters are those at the end with as much more propellant,
and within it they go along a straight line. Noise that gathers,
of walks and of a disturbance, is made white by `whitening`. Coupling is taken with the rates as they are read, and
without such noise in the last passes of a fit with those that come of it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from functools import cache, reduce
from itertools import accumulate, pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from massprop_drake.maths.estimation.joint.burns import pushes
from massprop_drake.maths.estimation.joint.disturbance_states import NO_DISTURBANCE, DisturbanceParams
from massprop_drake.maths.estimation.joint.lagged_impulses import LEAST_LAG, Lingering, fire, lingering
from massprop_drake.maths.estimation.joint.modes import ERRORS, NO_MODES, ModeParams
from massprop_drake.maths.estimation.joint.rate_coupling import PARABOLA
from massprop_drake.maths.estimation.joint.swing import swung
from massprop_drake.maths.estimation.joint.tanks import NO_TANKS, TankParams
from massprop_drake.maths.estimation.joint.wheels import NO_WHEELS, WheelParams
from massprop_drake.maths.estimation.swings import Locked, Step, Swings, can_swing, of_start, with_modes
from massprop_drake.maths.estimation.whitening import Gathering, Whitener, whitener
from massprop_drake.maths.kernels import chosen, idiom, kernel, listed
from massprop_drake.maths.linear_algebra import Array, crosses, is_positive_definite
from massprop_drake.maths.mass_properties import ELEMENT
from massprop_drake.maths.vehicle.engine_thrust import N_CHANNELS, N_ERRORS, NO_ENGINES, EngineParams
from massprop_drake.maths.vehicle.mounting import EXACT, Mounting, displaced
from massprop_drake.maths.vehicle.on_times import pieces, within

_N = 10  # mass properties
_CENTER, _MASS = slice(6, 9), 9
_QUICK = (
    0.01  # of a sample period: a stamp that is so much off moves a reading by its noise where the rate changes fast
)
_MOVED = 2.0  # quanta that a reading moves before it counts although none was expected
_EXACT = 1e-6  # of the period: less is rounding of a stamp
_NOTHING = 1e-20  # of a level
_TOGETHER = 4096  # readings whose derivatives are made at once, but for those of one component
_TICKS = 2  # unknowns of a stretch: when its ticks are, and their period
_CROSS = np.zeros((3, 3, 3))  # component i of a cross b is _CROSS[i, j, k] a_j b_k
_CROSS[[0, 1, 2], [1, 2, 0], [2, 0, 1]], _CROSS[[0, 1, 2], [2, 0, 1], [1, 2, 0]] = 1.0, -1.0
_ELEMENTS = np.array([1.0 * (element == ELEMENT) for element in range(6)])  # (6, 3, 3)
_ROWS = (32, 16, 8, 4, 2)  # on average of a part of a stretch where inertia and center of mass drift, ever fewer
_ALIKE = 0.03  # by which a bound may change with shorter parts
_PASSES = 8
_SETTLED = 1e-2  # squared sigmas that a pass would still gain
_ROUNDS = 12  # of Newton's, for coupling with the rates that come of it
_SMALL = 1e-12  # of a rate: these have settled
_TOLD = 10.0  # times the stated torque that accelerometers are taken to feel: as good as unknown, a hundredth is left
_STRAYED = 10.0  # arithmetic: times the fastest reading, from which on rates that follow from a model are none
_DIGITS = 1e3  # arithmetic: of a mean that is solved for, three digits at the least
_NEARLY = 100.0  # squared sigmas: a pass that would gain less is the last but one, as a rule


@kernel
def used(expected: Array, read: Array, quantum: float) -> NDArray[np.int_]:
    """Selects the readings of a component that carry new information: those expected to move, or moved, by a quantum.

    Args:
        expected: outputs, shape (m,).
        read: readings, NaN where missing, shape (m,).
        quantum: zero: all that are not missing.
    """
    there = np.flatnonzero(~np.isnan(read))
    if quantum == 0.0 or there.size == 0:
        return there
    found, least = [there[0]], _MOVED * quantum
    forward, back = expected[there[0]], read[there[0]]
    for row, one, other in zip(listed(there), listed(expected[there]), listed(read[there])):  # noqa: B905 (for numba)
        ahead, off = one - forward, other - back
        if ahead >= quantum or ahead <= -quantum or off >= least or off <= -least:
            found.append(row)
            forward, back = one, other
    return np.array(found)


def _lagged(level, slope, remaining, by_logarithm):  # type: ignore[no-untyped-def] # compiled alone
    for k in range(level.shape[0] - 1):
        for jet in range(level.shape[1]):
            off = level[k, jet] - level[k + 1, jet]
            level[k + 1, jet] = level[k + 1, jet] + off * remaining[jet]
            slope[k + 1, jet] = slope[k, jet] * remaining[jet] + off * by_logarithm[jet]


@idiom(_lagged)
def lagged(level: Array, slope: Array, remaining: Array, by_logarithm: Array) -> None:
    """Applies the jets' first-order lag to the levels that they tend to.

    In numpy all rows are gone through at once: to what a row adds itself comes what is left of the rows before, of
    one, then of two, then of four, until nothing is.

    Args:
        level: at the beginning, then what each tends to over each interval, which the levels at its end replace, shape
            (m, n_jets).
        slope: their derivatives by the logarithm of the time constant, zero at the beginning, likewise filled in.
        remaining: share of an initial difference that is left at the end, shape (n_jets,).
        by_logarithm: its derivative, shape (n_jets,).
    """
    told = level[1:].copy()
    level[1:] *= 1.0 - remaining
    _summed(level, remaining)
    slope[1:] = (level[:-1] - told) * by_logarithm
    _summed(slope, remaining)


def _summed(rows: Array, remaining: Array) -> None:
    """Adds to each row the decayed sum of the rows before; the share that remains per row has shape (n_jets,)."""
    back, left = 1, remaining
    while back < rows.shape[0] and left.max(initial=0.0) > _NOTHING:
        rows[back:] += left * rows[:-back]
        back, left = 2 * back, left * left


@kernel
def lag(level: Array, slope: Array, remaining: Array, by_logarithm: Array) -> None:
    """Applies the lag, see `lagged`."""
    lagged(level, slope, remaining, by_logarithm)


class Compute(NamedTuple):
    """Functions that go through a record row by row, or their compiled forms."""

    used: Callable[[Array, Array, float], NDArray[np.int_]] = used
    lag: Callable[[Array, Array, Array, Array], None] = lag
    swing: Step = swung


def compute(*, compiled: bool) -> Compute:
    """Returns the row-by-row functions, compiled or not."""
    return Compute(chosen(used, compiled), chosen(lag, compiled), chosen(swung, compiled)) if compiled else Compute()


class Columns(NamedTuple):
    """Places of the unknowns, a slice each."""

    properties: slice
    thrust: slice
    lag: slice
    gyro_bias: slice
    acceleration_bias: slice
    torque: slice
    drag: slice
    momentum: slice  # of wheels that turn steadily
    gyro_gain: slice
    accelerometer_gain: slice
    wheel: slice  # errors of the wheels' inertias, relative
    engine: slice  # errors of the engines, see `maths.vehicle.engine_thrust`
    mount: slice  # errors of the jets' mounting, in 1-sigmas, see `maths.vehicle.mounting`
    moving: slice  # errors of the parts that move inside, in units of their sigmas
    fill: slice  # errors of the propellant in tanks at the beginning, slug or kg
    flow: slice  # errors of the flow out of each, relative
    shift: slice  # of elements 0 to 8, for each unit of propellant from no tank that is still to be used


class FlightModel(NamedTuple):
    """Model of the vehicle before a flight.

    Attributes:
        period_s: between two ticks.
        wrenches: torque about the vehicle origin and force of each jet at full thrust, shape (n_jets, 6).
        flows: of propellant, slug/s or kg/s, shape (n_jets,).
        time_constants_s: of each jet's lag, zero: none, shape (n_jets,).
        kinds: index of each jet's kind, shape (n_jets,).
        positions: of the accelerometers, vehicle frame, shape (n_accelerometers, 3).
        variances: of a reading, by package, gyros first, shape (n_packages,).
        quanta: likewise, zero where noise dithers a reading.
        gyros: how many of the packages are gyros.
        prior: mean of all unknowns, shape (n,).
        sigma: their 1-sigma; zero: not reckoned with, shape (n,).
        compute: see `Compute`.
        at_stamps: whether commands switch at the stamps, and not at regular ticks; None: not asked, at these.
        walks: of the rate and of the velocity by unmodeled torques and forces, 1-sigma after one second.
        disturbance: see `joint.disturbance`.
        wheels: see `WheelParams`; what errors of their speeds make of the rate is in the gyros' variances.
        engines: see `maths.vehicle.engine_thrust.EngineParams`.
        tanks: see `TankParams`.
        mounting: see `maths.vehicle.mounting.Mounting`.
        modes: of parts that move inside, see `ModeParams`.
        followed: whether coupling is with the rates that come of it, in place of those that are read.
        own_times: whether rows come whenever anything is read, and intervals are as long as they are.
    """

    period_s: float
    wrenches: Array
    flows: Array
    time_constants_s: Array
    kinds: NDArray[np.int_]
    positions: Array
    variances: Array
    quanta: Array
    gyros: int
    prior: Array
    sigma: Array
    compute: Compute = Compute()
    at_stamps: bool | None = None
    walks: tuple[float, float] = (0.0, 0.0)
    disturbance: DisturbanceParams = NO_DISTURBANCE
    wheels: WheelParams = NO_WHEELS
    engines: EngineParams = NO_ENGINES
    tanks: TankParams = NO_TANKS
    mounting: Mounting = EXACT
    modes: ModeParams = NO_MODES
    followed: bool = False
    own_times: bool = False


def gathers(model: FlightModel) -> bool:
    """Tests whether noise accumulates in rates or velocities, by walks or by a disturbance."""
    return any(model.walks) or bool(model.disturbance.accelerations.any())


class Stretch(NamedTuple):
    """A part of a record without gaps, of m rows.

    Attributes:
        time_s: stamps, shape (m,).
        readings: of all packages, gyros first, NaN where missing, shape (m, n_packages, 3).
        commands: from each row on, shape (m, n_jets); the last row's is not used.
        before: the same of rows before, of which the first had been commanded for long, shape (b, n_jets), b > 0.
        outside: known torque about the vehicle origin and force from each row on, shape (m, 6).
        used_after: propellant that is used from each row to the end of the flight, slug or kg, shape (m,).
        onsets_s, before_onsets_s: of these commands, see `maths.vehicle.on_times`, shapes (m, n_jets) and (b, n_jets);
            None: jets switch with samples.
        speeds: of the wheels, NaN where not read, rad/s, shape (m, n_wheels); None: there are none.
        burns: level and angles of the engines at the start, middle and end of each interval, see
            `joint.burns.Burn`, shape (m, n_engines, 3, 3); None: there are none.
        seconds: of full thrust that each jet was commanded from the beginning of the record to each row, and from there
            to the end, s, shape (m, 2, n_jets); None: there are no tanks.
    """

    time_s: Array
    readings: Array
    commands: Array
    before: Array
    outside: Array
    used_after: Array
    onsets_s: Array | None = None
    before_onsets_s: Array | None = None
    speeds: Array | None = None
    burns: Array | None = None
    seconds: Array | None = None


class NormalEquations(NamedTuple):
    """The normal equations of some readings about a point.

    Attributes:
        information: A, shape (n, n).
        score: h, shape (n,).
        misfit: sum of the squared residuals over R.
        readings: how many, less the initial values.
        by_package: misfit and count of each package, and the sum of its residuals times the next, shape
            (n_packages, 3).
        quick, quiet: misfit and count of gyro readings where the rate changes fast, and where it does not, shape (2,).
    """

    information: Array
    score: Array
    misfit: float
    readings: float
    by_package: Array
    quick: Array
    quiet: Array

    @property
    def is_finite(self) -> bool:
        """True if the equations could be computed at the point."""
        return bool(np.isfinite(self.information).all() and np.isfinite(self.score).all())

    @property
    def per_reading(self) -> float:
        """Unexplained rest per reading, in units of its variance."""
        return self.misfit / max(self.readings, 1.0)

    def plus(self, other: NormalEquations) -> NormalEquations:
        """Adds the equations of other readings."""
        return NormalEquations(
            self.information + other.information,
            self.score + other.score,
            self.misfit + other.misfit,
            self.readings + other.readings,
            self.by_package + other.by_package,
            self.quick + other.quick,
            self.quiet + other.quiet,
        )


class FlightFit(NamedTuple):
    """Fit of the readings by the unknowns that are estimated.

    Attributes:
        at: estimate of all unknowns, shape (n,).
        normal: about it.
        settled: whether the passes have come to an end.
    """

    at: Array
    normal: NormalEquations
    settled: bool


class ScoreTest(NamedTuple):
    """A test of some unknowns.

    Attributes:
        statistic: chi-square distributed if they are what is stated.
        degrees: of freedom.
        size: estimate of each, shape (k,).
        least: smallest sum of squares that is left once they are explained.
    """

    statistic: float
    degrees: int
    size: Array
    least: float


def columns(model: FlightModel) -> Columns:
    """Returns the places of a vehicle's unknowns."""
    counts = model.flows.size, model.positions.shape[0], model.wheels.inertias.size
    sizes = model.engines.thrusts.size, model.mounting.jets.size, model.modes.sigmas.shape[0], model.tanks.fill.size
    return _columns(model.prior.shape[0], model.gyros, counts, sizes)


@cache
def _columns(n_unknown: int, n_gyros: int, counts: tuple[int, int, int], of_others: tuple[int, ...]) -> Columns:
    (n_jets, n_accelerometers, n_wheels), (n_engines, n_mounts, n_parts, n_tanks) = counts, of_others
    of_gyros, of_accelerometers = 3 * n_gyros, 3 * n_accelerometers
    others = n_wheels, N_ERRORS * n_engines, n_mounts, ERRORS * n_parts, n_tanks, n_tanks, _MASS
    n_lags = n_unknown - (_N + n_jets + 12 + of_gyros + 2 * of_accelerometers + sum(others))
    sizes = (_N, n_jets, n_lags, 3, of_accelerometers, 3, 3, 3, of_gyros, of_accelerometers, *others)
    ends = list(accumulate(sizes))
    return Columns(*(slice(end - size, end) for end, size in zip(ends, sizes, strict=True)))


# --------------------------------------------------------------------------------------------- rows


Lengths = float | Array  # of all intervals, or of each, s


def _weighed(each: Array, lengths_s: Lengths) -> Array:
    """Multiplies the terms of a sum over intervals by their lengths where these differ; else the sum is multiplied."""
    return each * lengths_s if isinstance(lengths_s, np.ndarray) else each


def _common(lengths_s: Lengths) -> float:
    """Returns the factor of sums of `_weighed`."""
    return 1.0 if isinstance(lengths_s, np.ndarray) else lengths_s


class _ReadRecord(NamedTuple):
    """Data of a stretch that do not depend on the unknowns."""

    stretch: Stretch
    period_s: Lengths  # of the ticks; of rows at times of their own lengths of the intervals, (m - 1,)
    late_s: Array  # of each stamp after its tick, (m,)
    lengths_s: Array  # from each switching to the next, (m - 1,)
    on: NDArray[np.int_]  # the jets that acted, (j,)
    commands: Array  # of these, (m - 1, j)
    rate: Array  # (3, m), straight where none is read; zero about an axis of which none ever is
    there: NDArray[np.bool_]  # whether it is read, or zero, (3, m)
    known: NDArray[np.bool_]  # whether any gyro has read the axis, (3,)
    to_use: Array  # propellant from no tank that is still to be used, in the middle of each interval, (m - 1,)
    readings: Array  # (n_packages, 3, m)
    momenta: Array  # of each wheel, by its speeds as read and its inertia as stated, straight where none is, (w, 3, m)
    to_draw: Array  # from each tank, beyond the middle of the stretch, in the middle of each interval, (n, m - 1)
    by_draw: Array  # derivatives of elements 0 to 8 by that, about the middle, (n, 9)
    shifts: Array  # of elements 0 to 8 by what is drawn, from those of the middle, (9, m - 1)
    through: _Through | None = None  # None: without tanks


def _read(stretch: Stretch, model: FlightModel) -> _ReadRecord:
    told = (stretch.commands[:-1] != 0.0).any(axis=0)
    on = np.flatnonzero(told | (stretch.before != 0.0).any(axis=0))
    rates = _by_columns(stretch.readings[:, : model.gyros].swapaxes(0, 1))
    there = np.asarray(~np.isnan(rates).all(axis=0))
    known = np.asarray(there.any(axis=1))
    there[~known] = True
    rate = _put_in(_mean(rates), there, _places_of(stretch, model))
    readings = np.ascontiguousarray(stretch.readings.transpose(1, 2, 0))
    period, late = _ticks(stretch.time_s, model.period_s)
    lengths = np.full(late.shape[0] - 1, period)
    if model.at_stamps:
        lengths, late = np.diff(stretch.time_s), np.zeros_like(late)
    drawn, momenta = _drawn(stretch, model), _momenta(stretch, model)
    left = stretch.used_after - drawn.sum(axis=0)
    to_use, to_draw = 0.5 * (left[:-1] + left[1:]), 0.5 * (drawn[:, :-1] + drawn[:, 1:])
    none = np.zeros((drawn.shape[0], _MASS)), np.zeros((_MASS, to_use.size))
    of_tanks = to_draw - drawn[:, drawn.shape[1] // 2, None], *none
    commands, each = stretch.commands[:-1, on], lengths if model.own_times else period
    seen = stretch, each, late, lengths, on, commands, rate, there, known, to_use, readings, momenta
    return _ReadRecord(*seen, *of_tanks)


def _drawn(stretch: Stretch, model: FlightModel) -> Array:
    """Computes the propellant drawn from each tank from each row to the end of the flight, as stated, shape (n, m)."""
    if stretch.seconds is None or not model.tanks.fill.size:
        return np.zeros((0, stretch.time_s.size))
    return np.asarray((model.tanks.feeds * model.flows) @ stretch.seconds[:, 1].T)


def _standing(at: Array, seconds: Array, model: FlightModel, more: Array | None = None) -> Array:
    """Computes the ten parameters at some times of a flight, see `vehicle.depletion`, shape (..., 10).

    Args:
        at: all unknowns, of the end, shape (n,).
        seconds: of full thrust of each jet until then, and from then to the end, shape (..., 2, n_jets).
        model: see `FlightModel`.
        more: further propellant that is still to be drawn from each tank, shape (n_tanks,).
    """
    places, tanks = columns(model), model.tanks
    flows = (tanks.feeds * model.flows) * (1.0 + at[places.flow])[:, None]
    both = (seconds * (1.0 + at[places.thrust])) @ flows.T
    left, coming = np.maximum(tanks.fill + at[places.fill] - both.sum(axis=-2), 0.0), both[..., 1, :]
    coming = coming if more is None else coming + more
    inertia, center, mass = np.linalg.inv(at[:6][ELEMENT]), at[_CENTER], np.full(coming.shape[:-1], 1.0 / at[_MASS])
    for tank, column in enumerate(tanks.columns):
        q = coming[..., tank]
        arm = tanks.outlets[tank] + column * (left[..., tank] + 0.5 * q)[..., None] - center
        whole = mass + q
        spread = tanks.spreads[tank] + (q * q / 12.0)[..., None, None] * _about(column)
        inertia = inertia + (q * mass / whole)[..., None, None] * _about(arm) + q[..., None, None] * spread
        center, mass = center + (q / whole)[..., None] * arm, whole
    inverse = np.linalg.inv(inertia)[..., _ROWS_OF, _COLUMNS_OF]
    return np.concatenate((inverse, center, (1.0 / mass)[..., None]), axis=-1)


_ROWS_OF, _COLUMNS_OF = np.array([0, 1, 2, 1, 0, 0]), np.array([0, 1, 2, 2, 2, 1])  # of six elements


def _about(arm: Array) -> Array:
    """Computes |a|^2 1 - a a^T of vectors, shape (..., 3, 3)."""
    squares = np.sum(arm * arm, axis=-1)[..., None, None]
    return np.asarray(squares * np.eye(3) - arm[..., :, None] * arm[..., None, :])


_STEP = 1e-4  # arithmetic, relative: of central differences, which have half the digits


class _Through(NamedTuple):
    """Derivatives of the parameters in the middle of a stretch by the unknowns.

    Attributes:
        by: derivative of the ten parameters there by all unknowns, shape (10, n).
        slopes: derivatives of `_Read.by_draw` by these, shape (n_tanks, 9, n).
        by_jets: derivative of `_Read.to_draw` by the thrust error of each jet, shape (n_tanks, n_jets, m - 1).
    """

    by: Array
    slopes: Array
    by_jets: Array


def _about_middle(course: _Course, at: Array, model: FlightModel) -> tuple[_Course, Array]:
    """Expands a stretch and all unknowns about its middle; without tanks both stay.

    Args:
        course: of the stretch.
        at: all unknowns, of the end of the flight, shape (n,).
        model: see `FlightModel`.
    """
    read = course.read
    stretch, n = read.stretch, model.tanks.fill.size
    if stretch.seconds is None or n == 0:
        return course, at
    places, row, given_s = columns(model), stretch.time_s.size // 2, stretch.seconds.copy()
    to_come_s = course.level * model.time_constants_s[read.on]  # what thrust that lags has still to give
    given_s[:, 0, read.on] -= to_come_s
    given_s[:, 1, read.on] += to_come_s
    seconds, middle = given_s[row], at.copy()
    middle[:_N] = _standing(at, seconds, model)
    size = np.zeros(at.size)
    size[:6], size[_CENTER], size[_MASS] = np.abs(at[:6]).max(), 1.0, at[_MASS]
    size[places.thrust], size[places.flow], size[places.fill] = 1.0, 1.0, model.tanks.capacities
    by, slopes = np.zeros((_N, at.size)), np.zeros((n, _MASS, at.size))
    for unknown in np.flatnonzero(size).tolist():
        step = np.zeros(at.size)
        step[unknown] = _STEP * size[unknown]
        ahead, back = (_standing(at + way * step, seconds, model) for way in (1.0, -1.0))
        by[:, unknown] = (ahead - back) / (2.0 * step[unknown])
        wide = np.sqrt(_STEP) * step / _STEP  # of a difference of differences
        further, nearer = (_slopes(at + way * wide, seconds, model) for way in (1.0, -1.0))
        slopes[:, :, unknown] = (further - nearer) / (2.0 * wide[unknown])
    within_s = 0.5 * (given_s[:-1] + given_s[1:])
    after_s, shifts = within_s[:, 1] - seconds[1], (_standing(at, within_s, model) - middle[:_N])[:, :_MASS].T
    by_jets = (model.tanks.feeds * model.flows * (1.0 + at[places.flow])[:, None])[:, :, None] * after_s.T
    to_draw = np.einsum("kjm,j->km", by_jets, 1.0 + at[places.thrust])
    given = np.einsum("kj,j->j", model.tanks.feeds * (1.0 + at[places.flow])[:, None], 1.0 + at[places.thrust])
    drawn = (given_s[:, 1] - seconds[1]) @ (given * model.flows)
    cut = stretch._replace(used_after=stretch.used_after - _drawn(stretch, model).sum(axis=0) + drawn)
    through = _Through(by, slopes, by_jets)
    of_tanks = {"to_draw": to_draw, "by_draw": _slopes(at, seconds, model), "shifts": shifts, "through": through}
    return course._replace(read=read._replace(stretch=cut, **of_tanks)), middle


def _slopes(at: Array, seconds: Array, model: FlightModel) -> Array:
    """Computes derivatives of elements 0 to 8 by propellant still to be drawn from each tank, (n_tanks, 9)."""
    slopes = np.empty((model.tanks.fill.size, _MASS))
    for tank, capacity in enumerate(model.tanks.capacities.tolist()):
        more = np.zeros(slopes.shape[0])
        more[tank] = _STEP * capacity
        ahead, back = (_standing(at, seconds, model, way * more) for way in (1.0, -1.0))
        slopes[tank] = (ahead - back)[:_MASS] / (2.0 * more[tank])
    return slopes


def _places_of(stretch: Stretch, model: FlightModel) -> Array:
    """Returns the places of the rows along a straight line, shape (m,)."""
    return stretch.time_s if model.own_times else np.arange(stretch.time_s.size, dtype=np.float64)


def _momenta(stretch: Stretch, model: FlightModel) -> Array:
    """Computes J_k W_k a_k of each wheel at the rows, shape (w, 3, m); zero for wheels that are never read."""
    wheels = model.wheels
    if stretch.speeds is None:
        return np.zeros((0, 3, stretch.time_s.size))
    read = np.asarray(~np.isnan(stretch.speeds.T))
    read[~read.any(axis=1)] = True
    speeds = np.nan_to_num(_put_in(stretch.speeds.T, read, _places_of(stretch, model)))
    return np.asarray((wheels.inertias[:, None] * wheels.axes)[:, :, None] * speeds[:, None])


class _Course(NamedTuple):
    """Course of the jets' thrust over a stretch, by rows; jets that are not listed gave none."""

    read: _ReadRecord
    amount: Array  # seconds of full thrust, (m - 1, j)
    by_lag: Array  # its derivative by the time constant
    lacking: Array  # how far each level is off at the beginning, (m - 1, j): times
    shape: Array  # it is the bow, see `Firing`, s, (3, j), or by interval (3, m - 1, j)
    level: Array  # at each stamp, (m, j), where one is late
    bent: Array | None  # bow besides, of jets that open or close within a sample, s, (3, m - 1, j)


def _course(read: _ReadRecord, lag_error: Array, model: FlightModel) -> _Course:
    on, commands, period, late = read.on, read.commands, read.period_s, read.late_s
    m = late.shape[0]
    given, lag_error = model.time_constants_s[on], lag_error[on]
    constants = np.where(given > 0.0, np.maximum(given + lag_error, LEAST_LAG * given), 0.0)
    each = period[:, None] if isinstance(period, np.ndarray) else period
    lagged, left = constants > 0.0, lingering(constants / each)
    before = read.stretch.before[:, on]
    level = np.concatenate((before, commands))
    slope, pulses = np.zeros_like(level), _pulses(read, constants, left, model.period_s if model.own_times else period)
    if pulses is not None:
        level = level + pulses.tends
    if lagged.any() and isinstance(period, np.ndarray):
        _lag_by_each(level, slope, left)
    elif lagged.any():
        model.compute.lag(level, slope, left.remaining, left.by_logarithm)
    if pulses is not None:
        slope += pulses.slope
    level, slope = level[-m:], slope[-m:]
    off = level[:-1] - commands
    amount = read.lengths_s[:, None] * commands + off * (each * left.mean)
    share = each / np.where(lagged, constants, 1.0)
    by_lag = off * (share * (left.mean - left.remaining)) + slope[:-1] * (share * left.mean)
    if pulses is not None:
        amount = amount + pulses.amount
        by_lag = by_lag + pulses.by_logarithm / np.where(lagged, constants, 1.0)
    if not lagged.all():
        lost = level[:-1] - level[1:]
        by_lag = np.where(lagged, by_lag, lost)
        amount = amount + np.where(lagged, 0.0, lost * lag_error)
    if late.any():
        told = read.stretch.commands[:, on]
        sided = np.where((late > 0.0)[:, None] & (np.arange(m) < m - 1)[:, None], told, level)
        level = np.where(lagged, level, np.nan_to_num(sided))
    bent = None if pulses is None else pulses.bow
    return _Course(read, amount, by_lag, off, each * left.bow, level, bent)


def _lag_by_each(level: Array, slope: Array, left: Lingering) -> None:
    """Applies `lagged` over intervals of different lengths; before the stretch they are as long as its first.

    Args:
        level, slope: see there, shape (b + m - 1, j).
        left: shares by interval, shape (m - 1, j) each.
    """
    since = level.shape[0] - left.remaining.shape[0]
    for row in range(1, level.shape[0]):
        of = max(row - since, 0)
        off = level[row - 1] - level[row]
        level[row] += off * left.remaining[of]
        slope[row] = slope[row - 1] * left.remaining[of] + off * left.by_logarithm[of]


class _Pulses(NamedTuple):
    """Corrections for jets that open or close within samples, to commands that are levels.

    The lag is linear: what a sample begins with dies away beside what its command does to jets that were shut. So
    impulses and bows differ by those of shut jets, and levels go on as if another level had been commanded.
    """

    tends: Array  # what that level is above the command, (b + m - 1, j)
    slope: Array  # what derivatives of levels by ln tau are besides, likewise
    amount: Array  # of impulses, s, (m - 1, j)
    by_logarithm: Array  # derivative of these by ln tau
    bow: Array  # see `Firing`, s, (3, m - 1, j)


def _pulses(read: _ReadRecord, constants: Array, left: Lingering, period_s: Lengths) -> _Pulses | None:
    """Computes the corrections of a stretch, see `_Pulses`; None: all jets switch with samples.

    Args:
        read: what the stretch shows.
        constants: time constant of each jet, s, shape (j,).
        left: what these leave over an interval.
        period_s: of control.
    """
    stretch, on = read.stretch, read.on
    if stretch.onsets_s is None or stretch.before_onsets_s is None:
        return None
    commands = np.concatenate((stretch.before[:, on], read.commands))
    onsets_s = np.concatenate((stretch.before_onsets_s[:, on], stretch.onsets_s[:-1, on]))
    rows = np.flatnonzero(within(commands, onsets_s).any(axis=1)).tolist()
    if not rows:
        return None
    tends, late, amount, by_logarithm = (np.zeros_like(commands) for _ in range(4))
    bow, shut, no_ticks = np.zeros((3, *commands.shape)), np.zeros((3, on.size)), np.zeros((0, 2))
    since, alike = stretch.before.shape[0], not isinstance(read.period_s, np.ndarray)
    remaining, by_tau = (each if alike else each[np.maximum(np.arange(-since, len(each)), 0)] for each in left[:2])
    for row in rows:
        length_s = float(period_s if alike else read.lengths_s[max(row - since, 0)])
        own = pieces(commands[row], onsets_s[row], float(period_s), (0.0, length_s))
        pulse = fire((shut[0], shut[1], shut[2]), constants, *own, no_ticks)
        whole = np.array([length_s]), commands[row : row + 1]
        kept, slower = (remaining, by_tau) if alike else (remaining[row], by_tau[row])
        level = fire((shut[0], shut[1], shut[2]), constants, *whole, no_ticks)
        tends[row] = (pulse.level - level.level) / (1.0 - kept)
        late[row] = pulse.slope - level.slope + tends[row] * slower
        amount[row] = pulse.amount - level.amount
        by_logarithm[row] = pulse.amount_slope - level.amount_slope
        bow[:, row] = pulse.bow - level.bow
    late[0] = 0.0
    if alike:
        _summed(late, left.remaining)
    else:
        for row in range(1, late.shape[0]):
            late[row] += late[row - 1] * remaining[row]
    return _Pulses(tends, late, amount[since:], by_logarithm[since:], bow[:, since:])


def _ticks(time_s: Array, period_s: float) -> tuple[float, Array]:
    """Computes the period at which commands switch, and each stamp's lateness: both from a line through the stamps."""
    counts = _counts(time_s.shape[0])
    since = time_s - time_s.mean()
    period = float(counts @ since) / float(counts @ counts)
    if abs(period - period_s) < _EXACT * period_s:
        period = period_s
    late = since - counts * period
    return period, np.where(np.abs(late) < _EXACT * period, 0.0, late)


def off_ticks(stretch: Stretch, model: FlightModel) -> bool:
    """Tests whether stamps of a stretch are off their ticks."""
    return not model.own_times and bool(_ticks(stretch.time_s, model.period_s)[1].any())


def _mean(rates: Array) -> Array:
    """Computes the mean of the gyros that read, shape (3, m), of shape (n_gyros, 3, m); zero where none does."""
    known = ~np.isnan(rates)
    mean: Array = np.where(known, rates, 0.0).sum(axis=0) / np.maximum(known.sum(axis=0), 1)
    return mean


def _put_in(rate: Array, there: NDArray[np.bool_], rows: Array) -> Array:
    """Interpolates rates, shape (k, m), linearly over the places of rows where none is read."""
    rate = rate.copy()
    for axis in np.flatnonzero(~there.all(axis=1)).tolist():
        rate[axis] = np.interp(rows, rows[there[axis]], rate[axis, there[axis]])
    return rate


def _outer(left: Array, right: Array) -> Array:
    """Computes the products of each component with each, shape (3, 3, n), of vectors in columns, shape (3, n) each."""
    return np.asarray(left[:, None] * right)


class _Moving(NamedTuple):
    """Rates over intervals, at their middles, and their gain, shape (3, m - 1) each, and the mean of w w^T."""

    middle: Array
    gained: Array
    square: Array  # (3, 3, m - 1)


def _moving(rate: Array) -> _Moving:
    """Computes middles, gains and mean products of rates at the rows, shape (3, m), that are linear in between."""
    middle, squares = 0.5 * (rate[:, :-1] + rate[:, 1:]), _outer(rate, rate)
    mean = (squares[..., :-1] + squares[..., 1:] + 4.0 * _outer(middle, middle)) / 6.0
    return _Moving(middle, np.diff(rate), mean)


class _Sums(NamedTuple):
    """Impulses over the intervals of a stretch, about the vehicle origin."""

    impulse: Array  # (6, m - 1)
    bow: Array  # (3, 6, m - 1)
    late: Array | None  # at each stamp besides, (6, m), where one is late
    acting: Array | None  # what jets give at each stamp, (6, m), where one is late


def _moments(wrenches: Array, center: Array) -> Array:
    """Computes torques about a center of mass, shape (..., 3, n), of wrenches about the origin, shape (..., 6, n)."""
    moments: Array = wrenches[..., :3, :] + np.tensordot(center, _CROSS, 1) @ wrenches[..., 3:, :]
    return moments


def _bows(sums: _Sums, rate: Array, held: Array, period_s: Lengths, at: Array) -> Array:
    """Computes angular impulses of the bows of a rate, that by its own coupling included, see `joint.prediction`.

    Args:
        sums: see `_Sums`.
        rate: at the rows, shape (3, m).
        held: angular momentum of the wheels, likewise.
        period_s: length of an interval.
        at: all unknowns, shape (n,).

    Returns:
        Of shape (3, 3, m - 1).
    """
    momentum = np.linalg.inv(at[:6][ELEMENT]) @ rate + held
    own = np.diff(crosses(rate.T, momentum.T).T) * (period_s / 12.0)
    bows = _moments(sums.bow, at[_CENTER])
    bows[0] += own
    bows[2] += PARABOLA * own
    return bows


class _Coupling(NamedTuple):
    """Dynamic coupling, by inverse inertias, as it multiplies products of rates and bows, see `_Gained`.

    Attributes:
        straight: of the rates by themselves, shape (..., 3, 3, 3).
        bent: of the rates with the bows.
        bowed: of the bows by themselves.
    """

    straight: Array
    bent: Array
    bowed: Array


def _coupling(inverse: Array) -> _Coupling:
    straight = _CROSS @ np.linalg.inv(inverse)
    return _Coupling(straight, _CROSS + straight.transpose(0, 2, 1) @ inverse, inverse @ _CROSS)


def _coupling_by(elements: Array, inverse: Array, coupling: _Coupling) -> _Coupling:
    """Computes derivatives of the coupling by the inverse inertia in some directions, shape (e, 3, 3)."""
    inertia = np.linalg.inv(inverse)
    straight = _CROSS @ (-inertia @ elements @ inertia)[:, None]
    ways = elements[:, None]
    bent = straight.transpose(0, 1, 3, 2) @ inverse + coupling.straight.transpose(0, 2, 1) @ ways
    return _Coupling(straight, bent, ways @ _CROSS)


# Sums since the beginning, of which the rate and its derivatives are made: the angular impulse, less coupling; products
# of rates, of rates and bows, of bows; forces, and products of rates or bows and the bows of forces; rates and bows.
_PULLED, _PRODUCTS, _SHIFTING, _BIASING = slice(0, 3), slice(3, 30), slice(30, 51), slice(51, 57)


class _Gained(NamedTuple):
    """Terms of the rate gained since the beginning; the rates and bows in its coupling are taken as known.

    Attributes:
        sums: see above, shape (57, m).
        coupling: see `_Coupling`.
        rate: shape (3, m).
    """

    sums: Array
    coupling: _Coupling
    rate: Array


def _gained(sums: _Sums, moving: _Moving, bows: Array, period_s: Lengths, at: Array) -> _Gained:
    inverse, n = at[:6][ELEMENT], moving.middle.shape[1]
    coupling = _coupling(inverse)
    result = np.zeros((_BIASING.stop, n + 1))
    each = result[:, 1:]
    each[_PULLED] = _moments(sums.impulse, at[_CENTER])
    products = each[_PRODUCTS].reshape(3, 3, 3, n)
    products[0] = moving.square
    products[1] = _outer(moving.middle, bows[0]) + _outer(moving.gained, bows[1])
    products[2] = _outer(bows[2], bows[2])
    force, by_force = each[_SHIFTING][:3], each[_SHIFTING][3:].reshape(2, 3, 3, n)
    force[:] = sums.impulse[3:]
    by_force[0] = _outer(moving.middle, sums.bow[0, 3:]) + _outer(moving.gained, sums.bow[1, 3:])
    by_force[1] = _outer(bows[2], sums.bow[2, 3:])
    each[_BIASING][:3], each[_BIASING][3:] = moving.middle, bows[0]
    if isinstance(period_s, np.ndarray):
        for part in (each[_PRODUCTS], each[_SHIFTING][3:], each[_BIASING]):
            part[:] = part * period_s
    np.cumsum(result, axis=-1, out=result)
    if sums.late is not None:
        result[_PULLED] += _moments(sums.late, at[_CENTER])
        result[_SHIFTING][:3] += sums.late[3:]
    result[_PULLED] -= _common(period_s) * (_flat(coupling) @ result[_PRODUCTS])
    return _Gained(result, coupling, inverse @ result[_PULLED])


def _flat(coupling: _Coupling) -> Array:
    """Arranges a coupling as it multiplies all products, shape (..., 3, 27)."""
    return np.concatenate([part.reshape(*part.shape[:-2], 9) for part in coupling], axis=-1)


def _moved(gained: _Gained, period_s: Lengths, at: Array) -> tuple[Array, Array]:
    """Computes derivatives of the rate gained by the unknowns that it is not linear in.

    What the bow that coupling itself gives changes by is left out: it is a small part of a small part.

    Returns:
        By elements 0 to 8, shape (9, 3, m), and by gyro biases, shape (3, 3, m).
    """
    inverse, (straight, bent, bowed), sums = at[:6][ELEMENT], gained.coupling, gained.sums
    coupled = -_common(period_s) * inverse
    of_element = _flat(_coupling_by(_ELEMENTS, inverse, gained.coupling))
    by_elements = np.concatenate((_ELEMENTS, coupled @ of_element), axis=-1)
    both, ways = bowed + bowed.transpose(0, 2, 1), _CROSS[:, None]
    by_bows = [(part @ ways).reshape(3, 3, 9) for part in (bent, both)]
    by_center = np.concatenate((inverse @ _CROSS, *(coupled @ part for part in by_bows)), axis=-1)
    of_rate = straight.transpose(1, 0, 2) + straight.transpose(2, 0, 1)
    by_bias = -coupled @ np.concatenate((of_rate, bent.transpose(1, 0, 2)), axis=-1)
    m = sums.shape[1]
    moved = np.empty((9, 3, m))
    np.matmul(by_elements.reshape(18, 30), sums[:30], out=moved[:6].reshape(18, m))
    np.matmul(by_center.reshape(9, 21), sums[_SHIFTING], out=moved[6:].reshape(9, m))
    return moved, (by_bias.reshape(9, 6) @ sums[_BIASING]).reshape(3, 3, m)


def _turning(whole: Array, moving: _Moving, bowed: Array, period_s: Lengths) -> Array:
    """Computes O = [(w - w_0) x] + the integral of [w x]^2, of rates at the rows, shape (3, m), and their bows between.

    Returns:
        Of each row, shape (3, 3, m).
    """
    crossed = _outer(moving.middle, bowed[0]) + _outer(moving.gained, bowed[1])
    square = np.zeros((3, 3, whole.shape[1]))
    each = moving.square + crossed + crossed.transpose(1, 0, 2) + _outer(bowed[2], bowed[2])
    np.cumsum(each * period_s, axis=-1, out=square[..., 1:])
    turning = square - (_CROSS.reshape(9, 3) @ (whole - whole[:, :1])).reshape(square.shape)
    turning[range(3), range(3)] -= np.trace(square)
    return np.asarray(turning)


class _Expected(NamedTuple):
    """Expected readings of a stretch at a point."""

    course: _Course
    sums: _Sums
    lightness: Array  # of each interval, (m - 1,)
    gained: _Gained
    velocity: Array  # since the beginning, (3, m)
    by_shift: Array | None  # derivatives of the rate by `Columns.shift`, (9, 3, m), where that is reckoned with
    locked: tuple[Array, Array]  # rate and velocity with the modes locked, (3, m) each

    @property
    def rate(self) -> Array:
        """Rate since the beginning, shape (3, m)."""
        return self.gained.rate


def _expected(at: Array, course: _Course, model: FlightModel) -> _Expected:
    places, read = columns(model), course.read
    wrenches, rate, stretch = _wrenches(at, course, model), read.rate, read.stretch
    impulse = wrenches @ course.amount.T + stretch.outside[:-1].T * read.lengths_s
    impulse += _impulses(read, at, model)[0].T
    middle = 0.5 * (rate[:, :-1] + rate[:, 1:])
    turned = np.tensordot(at[places.momentum], _CROSS, 1).T @ middle  # momentum of wheels crossed with the rate
    unknown = at[places.torque, None] - at[places.drag, None] * middle + turned
    impulse[:3] += (read.period_s if model.own_times else model.period_s) * unknown  # pure torques act about any point
    impulse[:3] -= np.diff(_held(read, at, model))
    acting = wrenches @ course.level.T if read.late_s.any() else None
    late = None if acting is None else read.late_s * acting
    if model.own_times:
        bow = wrenches @ (course.shape * course.lacking).swapaxes(1, 2)
    else:
        bow = (wrenches * course.shape[:, None]).reshape(18, read.on.size) @ course.lacking.T
        bow = bow.reshape(3, 6, impulse.shape[1])
    if course.bent is not None:
        bow = bow + np.einsum("ij,kmj->kim", wrenches, course.bent)
    sums = _Sums(impulse, bow, late, acting)
    mass = 1.0 / at[_MASS] + stretch.used_after
    lightness = 2.0 / (mass[:-1] + mass[1:])
    velocity = _since(sums.impulse[3:] * lightness)
    if late is not None:
        velocity += late[3:] / mass
    gained = _gained_from(rate, sums, read, at, model)
    if not read.there.all():  # jets fire in between: what they give is no straight line, what is left over is
        left = _put_in(rate - gained.rate, read.there, _places_of(stretch, model))
        gained = _gained_from(gained.rate + left, sums, read, at, model)
    by_shift = None
    if model.sigma[places.shift].any():
        later = _since(np.diff(gained.sums) * read.to_use)
        by_shift, _ = _moved(gained._replace(sums=later), read.period_s, at)
        gained = gained._replace(rate=gained.rate + np.tensordot(at[places.shift], by_shift, 1))
    if read.through is not None:
        moved, _ = _moved(gained, read.period_s, at)
        shift, turn = read.shifts[_CENTER].T, read.shifts[:6][ELEMENT]
        each = np.einsum("eim,em->im", np.diff(moved), read.shifts)
        each += np.einsum("ijm,jm->im", turn, crosses(sums.impulse[3:].T, shift).T)  # of both at once
        gained = gained._replace(rate=gained.rate + _since(each))
    expected = _Expected(course, sums, lightness, gained, velocity, by_shift, (gained.rate, velocity))
    if model.modes.frequencies.size == 0:
        return expected
    nothing = np.zeros((0, *velocity.shape))
    swings = _swings(expected, (nothing, nothing), at, model)
    return expected._replace(gained=gained._replace(rate=swings.rate), velocity=swings.velocity)


def _swings(expected: _Expected, derivatives: tuple[Array, Array], at: Array, model: FlightModel) -> Swings:
    """Computes a stretch with its modes, and derivatives of rate and velocity by k unknowns, shape (k, 3, m) each."""
    read, places = expected.course.read, columns(model)
    rate = read.rate - at[places.gyro_bias, None]
    locked = Locked(*expected.locked, rate, expected.sums.impulse[3:], read.lengths_s, *derivatives)
    return with_modes(locked, at[:_N], at[places.moving], model.modes, model.compute.swing)


def _gained_from(rate: Array, sums: _Sums, read: _ReadRecord, at: Array, model: FlightModel) -> _Gained:
    """Computes `_gained` with the coupling of rates at the rows as they are read, shape (3, m)."""
    rate, held = rate - at[columns(model).gyro_bias, None], _held(read, at, model)
    bows = _bows(sums, rate, held, read.period_s, at)
    if read.momenta.size:  # what turning the wheels' momentum takes, with the bow of the rate
        bent = crosses((at[:6][ELEMENT] @ bows[0]).T, 0.5 * (held[:, :-1] + held[:, 1:]).T).T
        impulse = sums.impulse.copy()
        impulse[:3] -= read.period_s * (_crossed(rate, held) + bent)
        sums = sums._replace(impulse=impulse)
    return _gained(sums, _moving(rate), bows, read.period_s, at)


def _held(read: _ReadRecord, at: Array, model: FlightModel) -> Array:
    """Computes the angular momentum of the wheels at the rows, shape (3, m)."""
    return np.tensordot(1.0 + at[columns(model).wheel], read.momenta, 1)


def _crossed(rate: Array, momentum: Array) -> Array:
    """Computes means over the intervals of w x h, both linear in between, shape (3, m - 1)."""
    (w0, w1), (h0, h1) = ((each[:, :-1].T, each[:, 1:].T) for each in (rate, momentum))
    return ((2.0 * crosses(w0, h0) + crosses(w0, h1) + crosses(w1, h0) + 2.0 * crosses(w1, h1)) / 6.0).T


def _wrenches(at: Array, course: _Course, model: FlightModel) -> Array:
    """Computes wrenches about the vehicle origin of the jets that ever act in the stretch, shape (6, j)."""
    gains = 1.0 + at[columns(model).thrust][course.read.on]
    wrenches: Array = (gains[:, None] * _mounted(at, model)[course.read.on]).T
    return wrenches


def _mounted(at: Array, model: FlightModel) -> Array:
    """Computes wrenches of all jets at full thrust, with their mounting as assumed, shape (n_jets, 6)."""
    return displaced(model.wrenches, at[columns(model).mount], model.mounting)


def _by_columns(rows: Array) -> Array:
    """Puts the rows of a stretch side by side."""
    return np.ascontiguousarray(np.swapaxes(rows, -1, -2))


class _Design(NamedTuple):
    """Derivatives of the expected readings of a stretch, at every row.

    Of k unknowns that have any, and after them of ticks that are late and of modes at the beginning, n in all.
    """

    kept: NDArray[np.int_]  # which unknowns, (k,)
    own: Array  # variances of those of the stretch alone, which come after them, (n - k,)
    place: NDArray[np.int_]  # of each among them, -1: none
    by_rate: Array  # of the rate since the beginning, (n, 3, m)
    by_velocity: Array  # likewise, (n, 3, m)
    by_whole: Array  # of the rate with its initial value, (n, 3, m)
    by_center: Array | None = None  # of the center of mass in the middle, (k, 3); None: it is one of the unknowns


def _design(expected: _Expected, at: Array, model: FlightModel, wanted: NDArray[np.bool_]) -> _Design:
    """Computes derivatives by at least the wanted unknowns; those of a group, but jets and gains, come together."""
    places, course, read, light = columns(model), expected.course, expected.course.read, expected.lightness
    there = wanted[places.thrust][read.on]
    if there.any():
        there &= ((course.amount != 0.0) | (course.by_lag != 0.0)).any(axis=0)
    has = wanted.copy()
    steady = places.gyro_bias, places.torque, places.drag, places.momentum
    for group in (places.properties, places.lag, *steady, places.wheel, places.engine, places.mount):
        has[group] = wanted[group].any()
    has[places.properties], has[places.thrust], has[places.shift] = True, False, expected.by_shift is not None
    has[places.moving] = True
    has[places.thrust][read.on[there]] = True
    kept, place = np.flatnonzero(has), np.where(has, np.cumsum(has) - 1, -1)
    inverse, mounted = at[:6][ELEMENT], _mounted(at, model)[read.on]
    forces = mounted[:, 3:]
    moments = (mounted[:, :3] + crosses(forces, at[_CENTER])) @ inverse
    ticks, m = _by_ticks(expected, at, model), expected.rate.shape[1]
    by_rate, by_velocity = np.zeros((2, kept.size + ticks.shape[1], 3, m))
    by_rate[kept.size :], by_velocity[kept.size :] = ticks
    by_rate[place[:_MASS]], by_bias = _moved(expected.gained, read.period_s, at)
    by_velocity[place[_MASS]] = _by_mass(expected, at)
    if has[places.gyro_bias].any():
        by_rate[place[places.gyro_bias]] = by_bias
    if has[places.lag].any():
        by_lag = _by_lag(expected, np.hstack((moments, forces)), at, model)
        by_rate[place[places.lag]], by_velocity[place[places.lag]] = by_lag[:, :3], by_lag[:, 3:]
    if expected.by_shift is not None:
        by_rate[place[places.shift]] = expected.by_shift
    amount, jets = course.amount[:, there].T, slice(_N, _N + int(there.sum()))
    by_rate[jets] = moments[there][:, :, None] * _since(amount)[:, None]
    by_velocity[jets] = forces[there][:, :, None] * _since(amount * light)[:, None]
    turned = _common(read.period_s) * inverse  # rate by a torque of one over an interval, or over a second
    ways = _since(_weighed(0.5 * (read.rate[:, :-1] + read.rate[:, 1:]), read.period_s))
    if has[places.torque].any():
        lasted = _since(_weighed(np.ones(m - 1), read.period_s))
        by_rate[place[places.torque]] = turned[:, :, None] * lasted
    if has[places.drag].any():
        by_rate[place[places.drag]] = -turned[:, :, None] * ways[:, None]
    for group, by in ((places.wheel, _by_wheels), (places.engine, _by_engines), (places.mount, _by_mounting)):
        if has[group].any():
            by_rate[place[group]], by_velocity[place[group]] = by(expected, at, model)
    if has[places.gyro_bias].any() and read.momenta.size:
        by_rate[place[places.gyro_bias]] += _by_bias_of(_held(read, at, model), turned, read.period_s)
    if has[places.momentum].any():
        by_rate[place[places.momentum]] = crosses(ways.T[:, None], turned.T).transpose(2, 1, 0)
    return _of_stretch((by_rate, by_velocity), kept, place, expected, at, model)


def _of_stretch(
    found: tuple[Array, Array],
    kept: NDArray[np.int_],
    place: NDArray[np.int_],
    expected: _Expected,
    at: Array,
    model: FlightModel,
) -> _Design:
    """Computes the design of a stretch, tanks and modes included.

    Args:
        found: derivatives of rate and velocity without these, shape (n, 3, m) each.
        kept, place: see `_Design`.
        expected: see `_Expected`.
        at: all unknowns, shape (n,).
        model: see `FlightModel`.
    """
    read, places, by_center = expected.course.read, columns(model), None
    if read.through is not None:
        _from_middle(found, kept, expected, at, model)
        by_center = read.through.by[_CENTER, kept].T
    own = _of_ticks(read.late_s) if found[0].shape[0] > kept.size else np.zeros(0)
    if model.modes.frequencies.size:
        found = _with_modes(expected, found, place[places.moving], at, model)
        own = np.append(own, of_start(model.modes))
    whole = _with_initial(found[0], place[places.gyro_bias], read)
    return _Design(kept, own, place, *found, whole, by_center)


def _with_modes(
    expected: _Expected, locked: tuple[Array, Array], moving: NDArray[np.int_], at: Array, model: FlightModel
) -> tuple[Array, Array]:
    """Adds the effects of modes to derivatives of rate and velocity, those by eta and eta' at the beginning last.

    Args:
        expected: see `_Expected`.
        locked: derivatives of rate and velocity with the modes locked, shape (k, 3, m) each.
        moving: places of the errors of the parts among them, shape (p,).
        at: all unknowns, shape (n,).
        model: see `FlightModel`.
    """
    swings, k = _swings(expected, locked, at, model), locked[0].shape[0]
    own = np.concatenate((np.arange(k), np.arange(k + moving.size, swings.by_rate.shape[0])))
    by_rate, by_velocity = swings.by_rate[own], swings.by_velocity[own]
    parts = slice(k, k + moving.size)
    by_rate[moving], by_velocity[moving] = swings.by_rate[parts], swings.by_velocity[parts]
    return by_rate, by_velocity


def _from_middle(
    found: tuple[Array, Array], kept: NDArray[np.int_], expected: _Expected, at: Array, model: FlightModel
) -> None:
    """Turns derivatives by the ten parameters in the middle of a stretch into those by all unknowns, in place.

    Args:
        found: of rate and velocity, shape (n, 3, m) each.
        kept: unknowns of the first k of these, the ten parameters first.
        expected: see `_Expected`.
        at: all unknowns about the middle, shape (n,).
        model: see `FlightModel`.
    """
    read, places, k = expected.course.read, columns(model), kept.size
    through = read.through
    assert through is not None
    for each in found:
        own = each[:_N].copy()
        each[:_N] = 0.0
        each[:k] += np.tensordot(through.by[:, kept].T, own, 1)
    by_rate, by_velocity = found
    lighter = -expected.sums.impulse[3:] * expected.lightness**2
    moved, _ = _moved(expected.gained, read.period_s, at)
    for tank, (slope, to_draw) in enumerate(zip(read.by_draw, read.to_draw, strict=True)):
        by_rate[:k] += np.tensordot(through.slopes[tank][:, kept].T, _since(np.diff(moved) * to_draw), 1)
        along = np.diff(np.tensordot(slope, moved, 1))
        for place, unknown in enumerate(kept.tolist()):
            if places.thrust.start <= unknown < places.thrust.stop:
                more = through.by_jets[tank, unknown - places.thrust.start]
            elif unknown == places.flow.start + tank:
                more = to_draw / (1.0 + at[unknown])
            else:
                continue
            by_rate[place] += _since(along * more)
            by_velocity[place] += _since(lighter * more)


def _by_wheels(expected: _Expected, at: Array, model: FlightModel) -> tuple[Array, Array]:
    """Computes derivatives of rate and velocity by the errors of the wheels' inertias, shape (w, 3, m) each."""
    read = expected.course.read
    rate = read.rate - at[columns(model).gyro_bias, None]
    result = np.empty((len(read.momenta), *rate.shape))
    for turned, own in zip(result, read.momenta, strict=True):
        turned[:] = at[:6][ELEMENT] @ _since(-np.diff(own) - read.period_s * _crossed(rate, own))
    return result, np.zeros_like(result)


def _by_engines(expected: _Expected, at: Array, model: FlightModel) -> tuple[Array, Array]:
    """Computes derivatives of rate and velocity by the errors of the engines, shape (e, 3, m) each."""
    _, by_errors = _impulses(expected.course.read, at, model)
    turned, forces = by_errors[..., :3], by_errors[..., 3:]
    moments = (turned + crosses(forces.reshape(-1, 3), at[_CENTER]).reshape(forces.shape)) @ at[:6][ELEMENT]
    by_velocity = forces * expected.lightness[:, None]
    return _since(moments.transpose(0, 2, 1)), _since(by_velocity.transpose(0, 2, 1))


def _by_mounting(expected: _Expected, at: Array, model: FlightModel) -> tuple[Array, Array]:
    """Computes derivatives of rate and velocity by the errors of the jets' mounting, shape (e, 3, m) each."""
    course, jets, wrenches = expected.course, model.mounting.jets, model.mounting.wrenches
    amounts = np.zeros((model.flows.size, course.amount.shape[0]))  # of jets that are on at some time, and of others
    amounts[course.read.on] = course.amount.T
    given = (1.0 + at[columns(model).thrust][jets])[:, None] * amounts[jets]
    moments = (wrenches[:, :3] + crosses(wrenches[:, 3:], at[_CENTER])) @ at[:6][ELEMENT]
    by_rate = moments[:, :, None] * _since(given)[:, None]
    return by_rate, wrenches[:, 3:, None] * _since(given * expected.lightness)[:, None]


def _impulses(read: _ReadRecord, at: Array, model: FlightModel) -> tuple[Array, Array]:
    """Computes impulses of the engines, shape (m - 1, 6), and their derivatives by the errors, shape (e, m - 1, 6)."""
    errors, rows, lengths = at[columns(model).engine], read.stretch.time_s.size - 1, read.lengths_s[:, None]
    impulse, by_errors = np.zeros((rows, 6)), np.zeros((errors.size, rows, 6))
    burns = np.zeros((rows + 1, 0, 3, N_CHANNELS)) if read.stretch.burns is None else read.stretch.burns
    for which in range(burns.shape[1]):
        own, points = slice(N_ERRORS * which, N_ERRORS * (which + 1)), burns[:-1, which].reshape(-1, N_CHANNELS)
        given, by, _, _ = pushes(which, points, errors[own], 1.0, model.engines)
        impulse += lengths * given
        by_errors[own] = lengths * by
    return impulse, by_errors


def _by_bias_of(held: Array, turned: Array, lengths_s: Lengths) -> Array:
    """Computes derivatives of the rate by gyro biases, through the torque that turns the wheels' momentum.

    Args:
        held: momentum of the wheels at the rows, shape (3, m).
        turned: rate by a torque of one over an interval, or over a second, shape (3, 3).
        lengths_s: of the intervals.
    """
    summed = _since(_weighed(0.5 * (held[:, :-1] + held[:, 1:]), lengths_s))
    return np.asarray(np.einsum("ij,kjm->kim", turned, np.einsum("jkl,lm->kjm", _CROSS, summed)))


def _with_initial(by_rate: Array, biases: NDArray[np.int_], read: _ReadRecord) -> Array:
    """Adds initial values to the rate's derivatives: their mean is the readings', less biases, see `_fixed`."""
    counted = by_rate * read.there
    whole = by_rate - counted.sum(axis=2, keepdims=True) / read.there.sum(axis=1)[:, None]
    for axis, place in enumerate(biases.tolist()):
        if place >= 0:
            whole[place, axis] -= 1.0
    return whole


def _bent(design: _Design, rate: Array, arm: Array, period_s: Lengths) -> Array:
    """Computes derivatives of the integral of w x (w x arm) by those of the rate w, shape (n, 3, m).

    Args:
        design: with these.
        rate: w, shape (3, m).
        arm: from the center of mass, shape (3,).
        period_s: length of an interval.
    """
    middle, by = 0.5 * (rate[:, :-1] + rate[:, 1:]), 0.5 * (design.by_whole[..., :-1] + design.by_whole[..., 1:])
    along = np.tensordot(by, arm, (1, 0))  # (n, m - 1)
    each = by * (arm @ middle) + middle * along[:, None]
    each -= 2.0 * arm[:, None] * np.sum(by * middle, axis=1, keepdims=True)
    return _since(period_s * each)


def _by_mass(expected: _Expected, at: Array) -> Array:
    """Computes derivatives of the velocity by 1/m, shape (3, m)."""
    return _since(expected.sums.impulse[3:] * (expected.lightness / at[_MASS]) ** 2)


def _by_lag(expected: _Expected, pulls: Array, at: Array, model: FlightModel) -> Array:
    """Computes derivatives of rate and velocity by the lags; ``pulls``: those by the jets' impulses, shape (j, 6).

    Returns:
        Of each lag, shape (l, 6, m).
    """
    places, course = columns(model), expected.course
    kinds = np.arange(places.lag.stop - places.lag.start)[:, None] == model.kinds[course.read.on]
    thrust = 1.0 + at[places.thrust][course.read.on]
    each = (pulls.T * (thrust * kinds)[:, None]).reshape(6 * kinds.shape[0], thrust.size) @ course.by_lag.T
    gained = each.reshape(kinds.shape[0], 6, course.by_lag.shape[0])
    gained[:, 3:] *= expected.lightness
    return _since(gained)


def _by_ticks(expected: _Expected, at: Array, model: FlightModel) -> Array:
    """Computes derivatives of rate and velocity by the offset and the period error of all ticks.

    Until a stamp a jet gives what it gives then for as much longer as its tick is earlier; with a shorter period, less
    in each. Constants make no difference.

    Returns:
        Of shape (2, 2, 3, m) where any stamp is late, else (2, 0, 3, m).
    """
    course, acting = expected.course, expected.sums.acting
    if acting is None:
        return np.zeros((2, 0, *expected.rate.shape))
    given = _since(_wrenches(at, course, model) @ course.amount.T / _common(course.read.period_s))
    wrenches = np.array([acting, _counts(acting.shape[1]) * acting - given])
    lightness = np.append(expected.lightness, expected.lightness[-1])
    return np.array([at[:6][ELEMENT] @ _moments(wrenches, at[_CENTER]), wrenches[:, 3:] * lightness])


def _counts(number: int) -> Array:
    """Numbers the rows from the middle on."""
    return np.arange(0.5 * (1.0 - number), 0.5 * number)


def _since(gained: Array) -> Array:
    """Sums gains over intervals, shape (..., m - 1), from the beginning to each row, shape (..., m)."""
    sums = np.zeros((*gained.shape[:-1], gained.shape[-1] + 1))
    np.cumsum(gained, axis=-1, out=sums[..., 1:])
    return sums


def crossing(vectors: Array) -> Array:
    """Computes matrices of the cross products of vectors, shape (3, 3, m) of (3, m)."""
    return np.asarray(np.tensordot(_CROSS, vectors, ((1,), (0,))))


def coupled(straight: Array, rate: Array, held: Array, lengths_s: Array, at: Array) -> Array:
    """Adds the coupling of a rate's changes: D = G + integral of I^-1 ([(I w + h) x] - [w x] I) D.

    Args:
        straight: G, the changes with the rates in coupling held, shape (3, c, m).
        rate: w, shape (3, m).
        held: h, angular momentum of the wheels, shape (3, m).
        lengths_s: of the intervals, shape (m - 1,).
        at: all unknowns, for the inverse inertia.
    """
    inverse = at[:6][ELEMENT]
    inertia, half = np.linalg.inv(inverse), 0.5 * lengths_s[:, None, None]
    crossed = crossing(inertia @ rate + held) - np.einsum("ijm,jk->ikm", crossing(rate), inertia)
    coupling = np.einsum("ij,jkm->mik", inverse, crossed)
    onward = np.linalg.inv(np.eye(3) - half * coupling[1:])  # by trapezoids
    before, gained = onward @ (np.eye(3) + half * coupling[:-1]), onward @ np.moveaxis(np.diff(straight), -1, 0)
    result, now = np.empty((straight.shape[2], *straight.shape[:2])), straight[:, :, 0]
    result[0] = now
    for row in range(straight.shape[2] - 1):
        now = before[row] @ now + gained[row]
        result[row + 1] = now
    return np.ascontiguousarray(np.moveaxis(result, 0, -1))


class _Component(NamedTuple):
    """Component of a sensor in the r rows that carry new information."""

    package: int
    axis: int
    rows: NDArray[np.int_]  # (r,)
    shown: Array  # at every row, without what is wrong with the sensor, (m,)
    left: Array  # what is read less what is expected, (r,)


_Held = dict[tuple[int, int], NDArray[np.int_]]  # rows of each component, by package and axis


class _Fixed(NamedTuple):
    """Effects of rotation on accelerometers, and times since the beginning."""

    turn: Array  # see `_turning`, (3, 3, m)
    rate: Array  # with its initial value, (3, m)
    held: Array  # angular momentum of the wheels, (3, m)
    period_s: Lengths  # of the intervals
    since_s: Array  # (m,)
    later: Array | None  # turn with each interval's part times the propellant that is still to be used, see `_Expected`
    drawn: Array | None  # what accelerometers show by the center of mass that moves as tanks are emptied, (3, m)


def _fixed(expected: _Expected, at: Array, model: FlightModel) -> _Fixed:
    read, rate = expected.course.read, expected.rate
    off = np.where(read.there, read.rate - rate, 0.0).sum(axis=1, keepdims=True) / read.there.sum(axis=1, keepdims=True)
    whole = rate + off - at[columns(model).gyro_bias, None]
    held = _held(read, at, model)
    bowed = at[:6][ELEMENT] @ _bows(expected.sums, whole, held, read.period_s, at)
    since_s = read.stretch.time_s - read.stretch.time_s[0]
    turn = _turning(whole, _moving(whole), bowed, read.period_s)
    later = None if expected.by_shift is None else _since(np.diff(turn) * read.to_use)
    shifts = read.shifts[_CENTER]
    drawn = None if read.through is None else _since(np.einsum("icm,cm->im", np.diff(turn), shifts))
    return _Fixed(turn, whole, held, read.period_s, since_s, later, drawn)


def _own(package: int, model: FlightModel) -> tuple[slice, slice]:
    """Returns the places of a package's gains, and of its biases; a gyro has none of its own."""
    places, number = columns(model), package - model.gyros
    if number < 0:
        return slice(places.gyro_gain.start + 3 * package, places.gyro_gain.start + 3 * package + 3), slice(0)
    gains, biases = (begin + 3 * number for begin in (places.accelerometer_gain.start, places.acceleration_bias.start))
    return slice(gains, gains + 3), slice(biases, biases + 3)


def _components(
    expected: _Expected, fixed: _Fixed, at: Array, model: FlightModel, held: _Held | None = None
) -> Iterator[_Component]:
    """Yields every component of which there are two rows, gyros first; rows that are held are taken, others noted."""
    read, held = expected.course.read, {} if held is None else held
    for package in range(read.readings.shape[0]):
        (gains, biases), number = _own(package, model), package - model.gyros
        shown = expected.rate
        if number >= 0:
            shown = expected.velocity + (model.positions[number] - at[_CENTER]) @ fixed.turn
            if fixed.later is not None:
                shown = shown - at[columns(model).shift][_CENTER] @ fixed.later
            if fixed.drawn is not None:
                shown = shown - fixed.drawn
        wanted = shown * (1.0 + at[gains])[:, None]
        if number >= 0:
            wanted += at[biases][:, None] * fixed.since_s
        for axis in range(3):
            readings = read.readings[package, axis]
            rows = held.get((package, axis))
            if rows is None:
                rows = held[package, axis] = model.compute.used(wanted[axis], readings, float(model.quanta[package]))
            if rows.shape[0] >= 2:
                left = readings[rows] - wanted[axis, rows]
                yield _Component(package, axis, rows, shown[axis], left)


class _Batch(NamedTuple):
    """Components of gyros, or of accelerometers, one after the other, of r rows in all."""

    parts: Sequence[_Component]
    counts: NDArray[np.int_]  # of rows of each
    begins: NDArray[np.int_]  # where each begins
    rows: NDArray[np.int_]  # (r,)

    def each(self, values: Sequence[float] | Array) -> Array:
        """Repeats a value of each component, shape (..., c), for all of its rows, shape (..., r)."""
        return np.repeat(values, self.counts, axis=-1)

    def without_means(self, x: Array) -> Array:
        """Subtracts the mean over each component, shape (..., r)."""
        x -= self.each(np.add.reduceat(x, self.begins, axis=-1) / self.counts)
        return x

    def whitened(self, x: Array, whiteners: Sequence[Whitener]) -> Array:
        """Whitens each component's readings, or anything linear in them, initial values eliminated, shape (..., r)."""
        for begin, count, one in zip(self.begins.tolist(), self.counts.tolist(), whiteners, strict=True):
            x[..., begin : begin + count] = one(x[..., begin : begin + count])
        return x


def _batch(parts: Sequence[_Component]) -> _Batch:
    counts = np.array([part.rows.size for part in parts])
    return _Batch(parts, counts, np.cumsum(counts) - counts, np.concatenate([part.rows for part in parts]))


def _batches(parts: Iterator[_Component], gyros: int) -> Iterator[_Batch]:
    """Yields components that are processed at once."""
    waiting: list[_Component] = []
    for part in parts:
        count = sum(other.rows.size for other in waiting) + part.rows.size
        if waiting and (count > _TOGETHER or (waiting[0].package < gyros) != (part.package < gyros)):
            yield _batch(waiting)
            waiting = []
        waiting.append(part)
    if waiting:
        yield _batch(waiting)


def _derivatives(design: _Design, batch: _Batch, fixed: _Fixed, at: Array, model: FlightModel) -> Array:
    """Computes derivatives of the expected components, shape (n, r); those by ticks that are late are the last."""
    places, place = columns(model), design.place
    x = np.empty((design.by_rate.shape[0], batch.rows.size))
    turns, package = design.by_rate, -1
    for part, begin in zip(batch.parts, batch.begins.tolist(), strict=True):
        rows = slice(begin, begin + part.rows.size)
        if part.package >= model.gyros and part.package != package:
            package, arm = part.package, model.positions[part.package - model.gyros] - at[_CENTER]
            turns = design.by_velocity + _bent(design, fixed.rate, arm, fixed.period_s)
            turns += np.tensordot(design.by_rate, _CROSS @ arm, (1, 1)).swapaxes(1, 2)  # the rate crossed with the arm
        x[:, rows] = turns[:, part.axis].take(part.rows, axis=1)
        if part.package >= model.gyros:
            turned = fixed.turn[part.axis][:, part.rows]
            if design.by_center is None:
                x[_CENTER, rows] -= turned
            else:
                x[: design.kept.size, rows] -= design.by_center @ turned
            if fixed.later is not None:
                x[place[places.shift][_CENTER], rows] -= fixed.later[part.axis][:, part.rows]
    _add_own(x, place, batch, fixed, at, model)
    return x


def _add_own(x: Array, place: NDArray[np.int_], batch: _Batch, fixed: _Fixed, at: Array, model: FlightModel) -> None:
    """Applies the gain of each component, and fills in the derivatives by it and by its bias."""
    of_gains, of_biases = zip(*(_own(part.package, model) for part in batch.parts), strict=True)
    gains = [gain.start + part.axis for gain, part in zip(of_gains, batch.parts, strict=True)]
    if at[gains].any():
        x *= batch.each(1.0 + at[gains])
    for part, begin, gain, bias in zip(batch.parts, batch.begins.tolist(), gains, of_biases, strict=True):
        rows = slice(begin, begin + part.rows.size)
        if place[gain] >= 0:
            x[place[gain], rows] = part.shown[part.rows]
        if part.package >= model.gyros and place[bias.start] >= 0:
            x[place[bias.start + part.axis], rows] = fixed.since_s[part.rows]


def normal(stretch: Stretch, at: Array, model: FlightModel, wanted: NDArray[np.bool_] | None = None) -> NormalEquations:
    """Computes the normal equations of a stretch about a point.

    Args:
        stretch: of at least two rows.
        at: all unknowns, shape (n,); the inverse inertia positive definite.
        model: see `FlightModel`.
        wanted: unknowns of which they are to be, shape (n,); None: all. Of others they may be zero.
    """
    return _normal(at, _course_at(_read(stretch, model), at, model), model, wanted)


def reckoned(model: FlightModel) -> NDArray[np.bool_]:
    """Selects the unknowns that a fit, and the variances it allows for, depend on, shape (n,)."""
    return (model.sigma > 0.0) | (np.arange(model.sigma.size) < _N)


def _course_at(read: _ReadRecord, at: Array, model: FlightModel) -> _Course:
    """Computes the course of the jets' thrust over a stretch, which depends on the lag alone."""
    return _course(read, at[columns(model).lag][model.kinds], model)


def _normal(
    at: Array, course: _Course, model: FlightModel, wanted: NDArray[np.bool_] | None = None, held: _Held | None = None
) -> NormalEquations:
    course, at = _about_middle(course, at, model)
    expected, followed = _expected(at, course, model), model.followed and bool(course.read.known.all())
    if followed:
        expected = _followed(expected, at, model)
    fixed, every = _fixed(expected, at, model), np.ones(at.shape[0], dtype=np.bool_)
    design = _design(expected, at, model, every if wanted is None else wanted)
    own = design.own
    if followed:
        design = _with_coupling(design, fixed, at, model)
    kept, size = design.kept, design.by_rate.shape[0]
    information, vector = np.zeros((size, size)), np.zeros(size)
    parts: list[tuple[_Batch, Array, Array]] = []
    for batch in _batches(_components(expected, fixed, at, model, held), model.gyros):
        scale = batch.each(1.0 / np.sqrt(model.variances[[part.package for part in batch.parts]]))
        left = np.concatenate([part.left for part in batch.parts]) * scale
        x = _derivatives(design, batch, fixed, at, model) * scale
        if gathers(model):
            whiteners = [_whitener(part, fixed, at, model) for part in batch.parts]
            left, x = batch.whitened(left, whiteners), batch.whitened(x, whiteners)
        else:
            left, x = batch.without_means(left), batch.without_means(x)
        information += x @ x.T
        vector += x @ left
        parts.append((batch, left, x[kept.shape[0] :]))
    if followed:
        told = np.zeros(3)
        for one in (one for batch, _, _ in parts for one in batch.parts if one.package < model.gyros):
            told[one.axis] += one.rows.size / model.variances[one.package]
        own = np.append(own, 1.0 / np.maximum(told, 1e-300))
    shift = np.zeros(0)
    if size > kept.shape[0]:
        information, vector, shift = _without_own(information, vector, own)
    total = empty(model)
    fast = _fast(expected, model)
    for batch, difference, by_own in parts:
        _tally(total, batch, difference - shift @ by_own if shift.size else difference, fast, model)
    total.information[np.ix_(kept, kept)] = information
    total.score[kept] = vector
    misfit, count, _ = total.by_package.sum(axis=0).tolist()
    return total._replace(misfit=misfit + float(shift @ (shift / own)) if shift.size else misfit, readings=count)


def gathering(package: int, axis: int, at: Array, model: FlightModel) -> Gathering:
    """Returns the noise that accumulates in a component of a sensor, by the stated walks and disturbance.

    Components are made white each by itself. The torque that a disturbance gives is in gyros and accelerometers alike:
    as evidence of a torque it must not count twice, and gyros tell it better.

    Args:
        package, axis: of the component.
        at: all unknowns, for the center of mass, shape (n,).
        model: see `FlightModel`.
    """
    turning, pushing = model.disturbance.accelerations[:3], model.disturbance.accelerations[3:]
    (of_rate, of_velocity), number = model.walks, package - model.gyros
    walk, acting = of_rate**2, turning[axis]
    if number >= 0:
        by_rate = (_CROSS @ (model.positions[number] - at[_CENTER]))[axis]  # derivative of the velocity by the rate
        walk, acting = (
            of_velocity**2 + of_rate**2 * float(by_rate @ by_rate),
            pushing[axis] + _TOLD * (by_rate @ turning),
        )
    variance = float(model.variances[package])
    return Gathering(walk / variance, float(acting @ acting) / variance, model.disturbance.time_constant_s)


def _whitener(one: _Component, fixed: _Fixed, at: Array, model: FlightModel) -> Whitener:
    """Makes the whitener of a component; noise common to n packages counts n times for each."""
    noise = gathering(one.package, one.axis, at, model)
    packages = model.gyros if one.package < model.gyros else model.positions.shape[0]
    common = noise._replace(walk=packages * noise.walk, acting=packages * noise.acting)
    return whitener(fixed.since_s[one.rows], common)


def _followed(expected: _Expected, at: Array, model: FlightModel) -> _Expected:
    """Computes the expected readings with the coupling of the rates that result, whose mean is that of the readings.

    With properties so wrong that these rates run away from the readings it is that of the readings, as given.
    """
    first, by_readings = expected.course.read, expected
    farthest = _STRAYED * np.abs(first.rate).max()
    bias, course, ones = at[columns(model).gyro_bias, None], first.rate, np.eye(3)[:, :, None]
    counts, lengths_s = first.there.sum(axis=1), np.broadcast_to(first.period_s, course.shape[1] - 1)
    held = _held(first, at, model)
    for _ in range(_ROUNDS):  # Newton's
        gained = expected.rate
        straight = (gained - gained[:, :1]) - (course - course[:, :1])
        start = np.repeat(ones, course.shape[1], axis=2)
        both = coupled(np.concatenate((straight[:, None], start), axis=1), course - bias, held, lengths_s, at)
        alone, by_start = both[:, 0], both[:, 1:]
        mean = np.where(first.there, first.rate - course - alone, 0.0).sum(axis=1) / counts
        by_mean = np.where(first.there[:, None], by_start, 0.0).sum(axis=2) / counts[:, None]
        if not np.abs(by_start).max() * _DIGITS < 1.0 / np.finfo(float).eps:
            return by_readings
        step = alone + np.einsum("ijm,j->im", by_start, np.linalg.solve(by_mean, mean))
        course = course + step
        if not np.abs(course).max() <= farthest:
            return by_readings
        read = first._replace(rate=course, there=np.ones_like(first.there))
        expected = _expected(at, expected.course._replace(read=read), model)
        if np.abs(step).max() <= _SMALL * np.abs(course).max():
            break
    return expected


def _with_coupling(design: _Design, fixed: _Fixed, at: Array, model: FlightModel) -> _Design:
    """Adds the coupling to derivatives of the rate, and appends those by the rate at the beginning."""
    place, m = design.place[columns(model).gyro_bias], fixed.rate.shape[1]
    straight = design.by_rate.copy()
    straight[place[place >= 0]] = 0.0
    begun = np.concatenate((straight - straight[..., :1], np.repeat(np.eye(3)[:, :, None], m, axis=2)))
    lengths_s = np.broadcast_to(fixed.period_s, m - 1)
    changes = coupled(begun.swapaxes(0, 1), fixed.rate, fixed.held, lengths_s, at).swapaxes(0, 1)
    by_start = changes[-3:]
    of_mean = np.linalg.inv(by_start.mean(axis=2)).T  # start by the mean of the rate: [i, j] is of component i by j
    by_mean = np.einsum("ij,ikm->jkm", of_mean, by_start)
    whole = changes[:-3] - np.einsum("nj,jkm->nkm", changes[:-3].mean(axis=2), by_mean)
    for axis, at_place in enumerate(place.tolist()):
        if at_place >= 0:
            whole[at_place] = -by_mean[axis]
    whole = np.concatenate((whole, by_mean))
    by_velocity = np.concatenate((design.by_velocity, np.zeros((3, 3, m))))
    return design._replace(by_rate=whole, by_velocity=by_velocity, by_whole=whole)


class Residuals(NamedTuple):
    """Residuals of one component of a sensor over a stretch, in units of a reading's 1-sigma.

    Attributes:
        package, axis: of the component.
        rows: that say something new, shape (r,).
        left: reading less what is expected, mean taken off, shape (r,).
        derivatives: of what is expected by all unknowns, likewise, shape (n, r).
        scale: 1-sigma of a reading, rad/s, ft/s or m/s.
    """

    package: int
    axis: int
    rows: NDArray[np.int_]
    left: Array
    derivatives: Array
    scale: float


def residuals(stretch: Stretch, at: Array, model: FlightModel) -> tuple[list[Residuals], Array]:
    """Computes residuals about a point, and the motion that is expected there.

    Args:
        stretch: of at least two rows.
        at: all unknowns, shape (n,); see `possible`.
        model: see `FlightModel`.

    Returns:
        Of every component with two rows at least; then rate and velocity that jets and coupling have given since the
        beginning, shape (6, m).
    """
    course, at = _about_middle(_course_at(_read(stretch, model), at, model), at, model)
    expected = _expected(at, course, model)
    fixed, design = _fixed(expected, at, model), _design(expected, at, model, reckoned(model))
    found = []
    for part in _components(expected, fixed, at, model):
        batch, scale = _batch([part]), float(np.sqrt(model.variances[part.package]))
        x = np.zeros((at.shape[0], part.rows.size))
        x[design.kept] = batch.without_means(_derivatives(design, batch, fixed, at, model))[: design.kept.size]
        left = batch.without_means(part.left.copy())
        found.append(Residuals(part.package, part.axis, part.rows, left / scale, x / scale, scale))
    return found, np.concatenate((expected.rate, expected.velocity))


def unexplained(stretches: Sequence[Stretch], model: FlightModel) -> tuple[float, float]:
    """Computes the largest angular momentum and impulse that no jets explain, whatever their thrusts and the inertia.

    Args:
        stretches: of the flight, of at least two rows.
        model: see `FlightModel`; momentum and impulse are by its mass properties.

    Returns:
        In ft-lbf-s or N-m-s, and in lbf-s or N-s; zero where nothing is read.
    """
    turned, pushed = list[Array](), list[Array]()
    for stretch in stretches:
        course = _course_at(_read(stretch, model), model.prior, model)
        course, at = _about_middle(course, model.prior, model)
        expected, read = _expected(at, course, model), course.read
        moving, n_jets = _moving(read.rate), model.flows.size
        by_jets = np.zeros((n_jets, read.late_s.size))
        by_jets[read.on] = _since(expected.course.amount.T)
        products = _since(moving.square[np.triu_indices(3)])
        wheels = _by_wheels(expected, at, model)[0].sum(axis=0)
        engines = _since(_impulses(read, at, model)[0].T) if model.engines.thrusts.size else by_jets[:0]
        turned.append(_without_mean(np.vstack((by_jets, engines, products, read.rate - wheels))).T)
        pushed += _pushed(expected, moving, model)
    inertia, mass = np.linalg.inv(model.prior[:6][ELEMENT]), 1.0 / model.prior[_MASS]
    rates = _left_over(turned, 3)
    momentum = float(np.linalg.norm(rates @ inertia, axis=1).max(initial=0.0))
    return momentum, mass * float(np.abs(_left_over(pushed, 1)).max(initial=0.0))


def _pushed(expected: _Expected, moving: _Moving, model: FlightModel) -> list[Array]:
    """Returns accelerometer velocities by component, freed of the turning that gyros read, and their possible causes.

    Returns:
        For each component with two readings at least, means taken off: derivatives by the center of mass, by the thrust
        of each jet, and by each bias, and what is read; shape (r, k + 1).
    """
    read, n_jets = expected.course.read, model.flows.size
    turn = _turning(read.rate, moving, np.zeros_like(moving.square), read.period_s)
    given = _since((expected.course.amount * expected.lightness[:, None]).T)
    since_s, found = read.stretch.time_s - read.stretch.time_s[0], []
    impulses, _ = _impulses(read, model.prior, model)
    burnt = _since((impulses[:, 3:] * expected.lightness[:, None]).T)
    for package in range(model.gyros, read.readings.shape[0]):
        arm, number = model.positions[package - model.gyros] - model.prior[_CENTER], package - model.gyros
        for axis in range(3):
            there = np.flatnonzero(~np.isnan(read.readings[package, axis]))
            if there.size < 2:
                continue
            own = np.zeros((3 + n_jets + 3 * model.positions.shape[0] + 2, there.size))
            own[:3] = -turn[:, axis, there]
            own[3 + read.on] = model.wrenches[read.on, 3 + axis, None] * given[:, there]
            own[3 + n_jets + 3 * number + axis] = since_s[there]
            own[-2] = burnt[axis, there]
            own[-1] = read.readings[package, axis, there] - arm @ turn[:, axis, there]
            found.append(_without_mean(own).T)
    return found


def _without_mean(rows: Array) -> Array:
    """Subtracts the mean of each row, shape (k, n)."""
    result: Array = rows - rows.mean(axis=1, keepdims=True)
    return result


def _left_over(parts: Sequence[Array], outputs: int) -> Array:
    """Computes residuals of the last columns once the others are fitted to them, shape (n, outputs)."""
    if not parts:
        return np.zeros((0, outputs))
    together = np.vstack(parts)
    design, wanted = together[:, :-outputs], together[:, -outputs:]
    size = np.maximum(np.linalg.norm(design, axis=0), 1e-300)
    result: Array = wanted - design / size @ np.linalg.lstsq(design / size, wanted, rcond=None)[0]
    return result


def _fast(expected: _Expected, model: FlightModel) -> Array:
    """Computes the variance of the rate at each row by the error of its stamp, shape (m,)."""
    squares = np.zeros(expected.rate.shape[1] + 1)
    length_s = expected.course.read.period_s if model.own_times else model.period_s
    squares[1:-1] = np.sum((np.diff(expected.rate) / length_s) ** 2, axis=0)
    variance: Array = 0.5 * (squares[:-1] + squares[1:]) * (_QUICK * model.period_s) ** 2
    return variance


def _tally(total: NormalEquations, batch: _Batch, left: Array, fast: Array, model: FlightModel) -> None:
    """Adds up the residuals of components, shape (r,), by packages, and of gyros by how fast the rate changes."""
    squares, serial = left * left, np.zeros_like(left)
    serial[:-1] = left[:-1] * left[1:]
    serial[batch.begins + batch.counts - 1] = 0.0
    misfits, along = (np.add.reduceat(each, batch.begins) for each in (squares, serial))
    packages = [part.package for part in batch.parts]
    np.add.at(total.by_package, packages, np.column_stack((misfits, batch.counts - 1.0, along)))
    if packages[0] < model.gyros:
        quick = fast[batch.rows] > batch.each(model.variances[packages])
        total.quick[:] += squares[quick].sum(), quick.sum()
        total.quiet[:] += squares[~quick].sum(), (~quick).sum()


def _without_own(information: Array, score: Array, variances: Array) -> tuple[Array, Array, Array]:
    """Eliminates the unknowns of the stretch alone from the normal equations, and estimates these.

    Args:
        information, score: these unknowns last, shapes (k + o, k + o) and (k + o,).
        variances: of them before the flight, shape (o,).
    """
    n = variances.size
    own, cross = information[-n:, -n:] + np.diag(1.0 / variances), information[:-n, -n:]
    solved = np.linalg.solve(own, np.column_stack((cross.T, score[-n:])))
    left = information[:-n, :-n] - cross @ solved[:, :-1]
    return left, score[:-n] - cross @ solved[:, -1], np.asarray(solved[:, -1])


def _of_ticks(late_s: Array) -> Array:
    """Computes variances of the ticks' offset and period, by a line through the stamps, shape (2,)."""
    counts = _counts(late_s.shape[0])
    variance = float(late_s @ late_s) / max(late_s.shape[0] - _TICKS, 1)
    return variance / np.array([late_s.shape[0], float(counts @ counts)])


def empty(model: FlightModel) -> NormalEquations:
    """Returns the normal equations of no readings."""
    n = model.prior.shape[0]
    packages = model.variances.shape[0]
    return NormalEquations(np.zeros((n, n)), np.zeros(n), 0.0, 0.0, np.zeros((packages, 3)), np.zeros(2), np.zeros(2))


def _together(parts: Sequence[NormalEquations], model: FlightModel) -> NormalEquations:
    return reduce(NormalEquations.plus, parts) if parts else empty(model)


# ---------------------------------------------------------------------------------------------- fit


def fitted(stretches: Sequence[Stretch], start: Array, model: FlightModel) -> FlightFit:
    """Fits the unknowns to the readings by Gauss-Newton iterations.

    What begins far from the truth may go farther with every pass: where they do not settle, the point of those gone
    through that leaves least unexplained is taken.

    Args:
        stretches: of the flight.
        start: where to begin, shape (n,).
        model: see `FlightModel`.
    """
    alone = gathers(model)  # what gathers is in the rates that are read, and in no others
    fit = _fitted(stretches, start, model, last=alone)
    return fit if alone or not fit.settled else _fitted(stretches, fit.at, model._replace(followed=True))


def _fitted(stretches: Sequence[Stretch], start: Array, model: FlightModel, *, last: bool = True) -> FlightFit:
    """Iterates until the fit settles; where others follow, unknowns that are only tested are left out.

    Once they are near, the readings that count stay the same: else each pass may choose those that the next does not.
    """
    at = best = start.copy()
    least = np.inf
    free = np.flatnonzero(model.sigma > 0.0)
    sigma, lag = model.sigma[free], columns(model).lag
    read = [_read(stretch, model) for stretch in stretches]
    told: list[_Course] = []
    told_for, wanted, complete, near = at, reckoned(model), False, False
    held = list[_Held]()
    for number in range(_PASSES):
        complete = last and (complete or number == _PASSES - 1)
        if not told or (at[lag] != told_for[lag]).any():
            told, told_for = [_course_at(one, at, model) for one in read], at
        held = held if near else [{} for _ in read]
        parts = [
            _normal(at, course, model, None if complete else wanted, rows)
            for course, rows in zip(told, held, strict=True)
        ]
        total = _together(parts, model)
        if total.per_reading < least:
            least, best = total.per_reading, at
        scaled = total.information[np.ix_(free, free)] * np.outer(sigma, sigma) + np.eye(free.shape[0])
        right = total.score[free] * sigma + (model.prior[free] - at[free]) / sigma
        step = np.linalg.solve(scaled, right)
        gain, sound = float(step @ right), bool(np.isfinite(step).all())
        if not sound:
            break
        if gain < _SETTLED and (complete or not last):
            return FlightFit(at, total, True)
        complete = gain < _NEARLY
        near = near or complete
        if gain < _SETTLED:
            continue  # it was the last one, but for the unknowns that are only put to the test
        move = np.zeros_like(at)
        move[free] = step * sigma
        while not (possible(at + move) and _leaves_swinging(at + move, model)):
            move *= 0.5
        at = at + move
    parts = [_normal(best, _course_at(one, best, model), model, None) for one in read]
    total = _together(parts, model)
    return FlightFit(best, total, False)


def possible(at: Array) -> bool:
    """Tests whether the inverse inertia is positive definite and the mass positive."""
    return is_positive_definite(at[:6][ELEMENT]) and bool(at[_MASS] > 0.0)


def _leaves_swinging(at: Array, model: FlightModel) -> bool:
    """Tests whether modes swing: those that have more than all of the inertia run away."""
    return can_swing(at[:_N], at[columns(model).moving], model.modes)


class Reckoned(NamedTuple):
    """Unknowns that are estimated in tests of others, which all have them in common.

    Attributes:
        free: places of what is reckoned with, shape (f,).
        sigma: their 1-sigma, shape (f,).
        score: h with what is known before the flight taken for the origin, shape (n,).
        solved: (A + 1)^-1 of these, in units of their 1-sigma, times their information with every unknown, and their
            score, shape (f, n + 1).
    """

    free: NDArray[np.int_]
    sigma: Array
    score: Array
    solved: Array


def reckoned_in(fit: FlightFit, model: FlightModel, besides: NDArray[np.int_] | slice = slice(0)) -> Reckoned:
    """Collects the estimated unknowns, but for some that are tested.

    Args:
        fit: see `FlightFit`.
        model: see `FlightModel`.
        besides: places of those unknowns.
    """
    total, others = fit.normal, model.sigma > 0.0
    others[besides] = False
    free = np.flatnonzero(others)
    sigma = model.sigma[free]
    off = np.zeros_like(fit.at)
    off[free] = fit.at[free] - model.prior[free]
    off[besides] = fit.at[besides]
    vector = total.score + total.information @ off
    inner = total.information[np.ix_(free, free)] * np.outer(sigma, sigma) + np.eye(free.shape[0])
    right = np.column_stack((total.information[free], vector[free])) * sigma[:, None]
    return Reckoned(free, sigma, vector, np.asarray(np.linalg.solve(inner, right), dtype=np.float64))


def score(
    fit: FlightFit,
    group: NDArray[np.int_],
    model: FlightModel,
    stated: float = 0.0,
    clear: float = np.inf,
    common: Reckoned | None = None,
) -> ScoreTest:
    """Tests whether some unknowns have their stated values.

    Args:
        fit: see `FlightFit`.
        group: their places, in units that are alike, integers, shape (k,).
        model: see `FlightModel`; where they are reckoned with, they are no longer.
        stated: their 1-sigma; zero: that they are zero.
        clear: largest 1-sigma of a combination of them that is tested.
        common: what is reckoned with at all, which it is that serves where they are not.
    """
    total, size = fit.normal, np.zeros(group.shape[0])
    if common is None or (model.sigma[group] > 0.0).any():
        common = reckoned_in(fit, model, group)
    shown = total.information[group, group] != 0.0  # of others nothing is known
    there = group[shown]
    cross = total.information[np.ix_(there, common.free)] * common.sigma
    information = total.information[np.ix_(there, there)] - cross @ common.solved[:, there]
    of_group = common.score[there] - cross @ common.solved[:, -1]
    if not (np.isfinite(information).all() and np.isfinite(of_group).all()):
        return ScoreTest(0.0, 0, size, total.misfit)
    values, vectors = np.linalg.eigh(0.5 * (information + information.T))
    known = values > max(1.0 / clear**2, 1e-9 * float(np.max(np.abs(total.information[there, there]), initial=0.0)))
    if not known.any():
        return ScoreTest(0.0, 0, size, total.misfit)
    along = (vectors.T @ of_group)[known] / values[known]
    statistic = float(np.sum(along**2 / (1.0 / values[known] + stated**2)))
    gained = float(np.sum(along**2 * values[known]))
    size[shown] = vectors[:, known] @ along
    return ScoreTest(statistic, int(known.sum()), size, max(total.misfit - gained, 0.0))


# ---------------------------------------------------------------------------------------------- scale

_SPANS = (1, 4, 16, 64)  # rows over which gains are compared: the shortest over which enough of them are clear
_CLEAR = 7.0  # 1-sigma of a reading, two quanta and more, that jets must give over a span
_FEWEST = 10  # spans whose median is told


def gain_ratios(stretches: Sequence[Stretch], at: Array, model: FlightModel) -> Array:
    """Computes medians of what each package's readings gained, over what jets alone would have given them.

    Args:
        stretches: of the flight.
        at: all unknowns, shape (n,); see `possible`.
        model: see `FlightModel`.

    Returns:
        NaN where readings tell too little, shape (n_packages,).
    """
    pairs = [list(_gains(stretch, at, model)) for stretch in stretches]
    found = np.full(model.variances.shape[0], np.nan)
    for package, variance in enumerate(model.variances.tolist()):
        for span in _SPANS:
            gained = [_over(*own[package], span) for own in pairs]
            read, given = (
                (np.concatenate(part) for part in zip(*gained, strict=True)) if gained else np.zeros((2, 0, 3))
            )
            size = np.sum(given**2, axis=1)
            clear = size > _CLEAR**2 * variance
            if clear.sum() >= _FEWEST:
                found[package] = np.median(np.sum(read[clear] * given[clear], axis=1) / size[clear])
                break
    return found


def _gains(stretch: Stretch, at: Array, model: FlightModel) -> Iterator[tuple[Array, Array]]:
    """Yields each package's readings, and the part that jets alone explain, where it reads, shape (m, 3) each."""
    course, at = _about_middle(_course_at(_read(stretch, model), at, model), at, model)
    expected, read = _expected(at, course, model), course.read
    impulse = expected.sums.impulse
    turned = at[:6][ELEMENT] @ _moments(impulse, at[_CENTER])
    for package, readings in enumerate(read.readings):
        given = turned
        if package >= model.gyros:
            arm = model.positions[package - model.gyros] - at[_CENTER]
            given = impulse[3:] * expected.lightness + crosses(turned.T, np.broadcast_to(arm, turned.T.shape)).T
        there = ~np.isnan(readings).any(axis=0)
        yield readings[:, there].T, _since(given)[:, there].T


def _over(read: Array, given: Array, span: int) -> tuple[Array, Array]:
    """Computes gains over spans of so many rows, by both, shape (s, 3) each."""
    return np.diff(read[::span], axis=0), np.diff(given[::span], axis=0)


# ---------------------------------------------------------------------------------------------- bound


class _Shown(NamedTuple):
    """Information of parts of a stretch on the u estimated unknowns, on ticks, and on initial values of components.

    Each of c components reads what the unknowns have made it gain since its first reading, and what it was then.

    Attributes:
        information: of each part, shape (p, s, s), with s = u + ticks + c.
        gained: derivatives of what each component has gained up to each cut, by the ten parameters, shape
            (p + 1, c, 10).
        variances: of ticks, and of what the first readings tell, shape (s - u,).
    """

    information: Array
    gained: Array
    variances: Array


def _shown(stretch: Stretch, cuts: NDArray[np.int_], at: Array, model: FlightModel) -> _Shown:
    """Computes the information of parts of a stretch between some rows, shape (p + 1,), about a point; unit noise."""
    course, at = _about_middle(_course_at(_read(stretch, model), at, model), at, model)
    expected, wanted = _expected(at, course, model), reckoned(model)
    fixed, design = _fixed(expected, at, model), _design(expected, at, model, wanted)
    components = list(_components(expected, fixed, at, model))
    known = np.flatnonzero(wanted[design.kept])
    taken = np.concatenate((known, np.arange(design.kept.size, design.by_rate.shape[0])))
    u, n_ticks = int(wanted.sum()), design.by_rate.shape[0] - design.kept.size
    places = np.concatenate((np.cumsum(wanted)[design.kept[known]] - 1, np.arange(u, u + n_ticks)))
    information = np.zeros((cuts.size - 1, *2 * (u + n_ticks + len(components),)))
    gained, number = np.zeros((cuts.size, len(components), _N)), 0
    with_cuts = (one._replace(rows=np.concatenate((one.rows, cuts))) for one in components)
    for batch in _batches(with_cuts, model.gyros):
        derivatives = _derivatives(design, batch, fixed, at, model)[taken]
        for one, begin in zip(batch.parts, batch.begins.tolist(), strict=True):
            x = derivatives[:, begin : begin + one.rows.size] / math.sqrt(model.variances[one.package])
            x -= x[:, :1]
            own = u + n_ticks + number
            rows, of_rows, of_cuts = one.rows[1 : -cuts.size], x[:, 1 : -cuts.size], x[:, -cuts.size :]
            gained[:, number] = np.where(cuts > one.rows[0], of_cuts[:_N], 0.0).T
            ends = np.searchsorted(rows, cuts, side="right").tolist()
            for part, (first, last) in zip(information, pairwise(ends), strict=True):
                within = of_rows[:, first:last]
                part[np.ix_(places, places)] += within @ within.T
                part[places, own] = part[own, places] = within.sum(axis=1)
                part[own, own] = last - first
            number += 1
    return _Shown(information, gained, np.concatenate((design.own, np.ones(len(components)))))


def _cuts(used: Array, rows: int) -> NDArray[np.int_]:
    """Returns rows that cut a stretch into parts of similar propellant use and duration.

    Args:
        used: propellant since its beginning, shape (m,).
        rows: of a part, on average.
    """
    last = used.shape[0] - 1
    if used[-1] <= 0.0 or rows >= last:
        return np.array([0, last])
    share = used / used[-1] + np.arange(last + 1) / last
    inner = np.searchsorted(share, np.linspace(0.0, 2.0, -(-last // rows) + 1)[1:-1])
    return np.unique(np.concatenate(([0], inner, [last])))


def least_deviation(
    stretches: Sequence[Stretch],
    at: Array,
    start: Array,
    drift: Array,
    model: FlightModel,
    information: Array | None = None,
) -> Array:
    """Computes least 1-sigmas of the ten parameters, rounding taken as noise, NaN where unknown, shape (10,).

    What changes with propellant that is used does so half before and half after what each part of a stretch shows, and
    parts are made shorter until it makes no difference.

    Args:
        stretches: of the flight, in order.
        at: all unknowns, about which it is taken, shape (n,); see `possible`.
        start: covariance of the ten at the start, shape (10, 10).
        drift: variances that are added to the ten for each unit of propellant, shape (10,).
        model: for what else is reckoned with.
        information: A of all stretches together, where it is known, shape (n, n); else it is found.
    """
    wanted = reckoned(model)
    root = np.diag(model.sigma[wanted])
    root[:_N, :_N] = _root(start)
    if not drift.any():
        if information is None:
            information = _together([normal(one, at, model, wanted) for one in stretches], model).information
        return _deviation(_informed(root, information[np.ix_(wanted, wanted)]))
    before = np.zeros(_N)
    for rows in _ROWS:
        found = _deviation(_drifting(root, stretches, at, drift, model, rows))
        if not (np.abs(found - before) > _ALIKE * found).any():  # NaN stays so
            break
        before = found
    return found


def _deviation(root: Array) -> Array:
    """Computes the 1-sigma of the ten parameters, shape (10,)."""
    result: Array = np.sqrt(np.sum(root[:_N] ** 2, axis=1))
    return result


def _drifting(
    root: Array, stretches: Sequence[Stretch], at: Array, drift: Array, model: FlightModel, rows: int
) -> Array:
    """Computes a root of the unknowns' covariance after a flight from one before it, by parts of so many rows."""
    used_after = stretches[0].used_after[0] if stretches else 0.0
    for stretch in stretches:
        used = stretch.used_after[0] - stretch.used_after
        cuts = _cuts(used, rows)
        root = _drifted(root, drift * (used_after - stretch.used_after[0]))
        root = _learned(root, _shown(stretch, cuts, at, model), drift, np.diff(used[cuts]))
        used_after = stretch.used_after[-1]
    return root


def _informed(root: Array, information: Array) -> Array:
    """Computes a root of a covariance with further information, NaN where that is not finite."""
    inner = root.T @ information @ root
    if not np.isfinite(inner).all():
        return np.full_like(root, np.nan)
    values, vectors = np.linalg.eigh(inner)
    informed: Array = root @ (vectors / np.sqrt(1.0 + np.maximum(values, 0.0)))
    return informed


def _learned(before: Array, shown: _Shown, drift: Array, used: Array) -> Array:
    """Computes a root of the unknowns' covariance after a stretch from one before it.

    Args:
        before: shape (u, u).
        shown: see `_Shown`.
        drift: see `least_deviation`.
        used: propellant in each part, shape (p,).
    """
    u, size = before.shape[0], shown.information.shape[1]
    root = np.zeros((size, size))
    root[:u, :u], root[range(u, size), range(u, size)] = before, np.sqrt(shown.variances)
    halves = 0.5 * np.concatenate(([0.0], used, [0.0]))
    for part, gained, more in zip(shown.information, shown.gained, halves[:-2] + halves[1:-1], strict=False):
        root = _informed(_drifted(root, drift * more, gained), part)
    return _drifted(root[:u], drift * halves[-2])


def _drifted(root: Array, drift: Array, gained: Array | None = None) -> Array:
    """Returns a root with drift of the ten parameters added, square.

    What a component has gained is as it was: from now on it is told from what it would have gained with the parameters
    as they have become.

    Args:
        root: of shape (k, l).
        drift: variances, shape (10,).
        gained: of the components, the last rows, shape (c, 10).
    """
    ways = np.zeros((root.shape[0], _N))
    ways[:_N] = np.diag(np.sqrt(drift))
    if gained is not None:
        ways[root.shape[0] - gained.shape[0] :] = -gained * np.sqrt(drift)
    together = np.hstack((root, ways[:, drift > 0.0]))
    if together.shape[0] == together.shape[1]:
        return together
    return np.asarray(np.linalg.qr(together.T, mode="r")).T


def _root(matrix: Array) -> Array:
    scale = np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    values, vectors = np.linalg.eigh(matrix / np.outer(scale, scale))
    root: Array = scale[:, None] * vectors * np.sqrt(np.maximum(values, 0.0))
    return root
