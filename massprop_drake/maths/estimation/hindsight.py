r"""A flight in hindsight: all its readings explained at once, and what is left over put to the test.

Over a stretch of a record the rate is its value at the beginning and the sum of what jets, coupling and known forces
have added since, the velocity likewise, so that with theta all that may be unknown,

    y_k = y_0 + sum_{i <= k} d_i(theta) + v_k,    v_k: white, noise and rounding, of variance R.

That is a regression, whatever filter has flown. Its columns are the ten parameters, the thrust error of each jet, the
error of the lag of each kind, biases, and what a flight should not have: torques, drag, gains of axes. With those that
the filter reckons with (of prior variance Lambda^-1), the information A = X^T R^-1 X and the score h = X^T R^-1 e

- bound each parameter: the 1-sigma that A and the start leave is the least that any estimator can have;
- test all else (Lagrange's multiplier, or score, test). With the fitted columns marginalized, the score U of a group of
  others has the covariance S if they are zero, so that U^T S^-1 U is chi-square distributed, and S^-1 U is how large
  they are. Errors that are stated with a 1-sigma of s have estimates of variance s^2 + 1/S.

Initial values are eliminated by taking means off. Where stamps are off their ticks, these lie on a line through the
stamps, as far as it is known: its two errors are unknowns of each stretch, and eliminated, too. A reading that has not
moved by a quantum since one was used says nothing new and is left out, as in the joint estimator. Coupling is taken
with the rates as they are read.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import cache
from itertools import accumulate
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from massprop_drake.maths.estimation.joint.impulses import fire
from massprop_drake.maths.estimation.joint.prediction import PARABOLA
from massprop_drake.maths.kernels import chosen, idiom, kernel, listed
from massprop_drake.maths.linear_algebra import Array, crosses, is_positive_definite
from massprop_drake.maths.mass_properties import ELEMENT

_N = 10  # mass properties
_CENTER, _MASS = slice(6, 9), 9
_STEP = 1e-4  # of a prior 1-sigma, for derivatives
_SMALL_RATE = 1e-6  # rad/s, likewise
_PAIRS = ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))
_QUICK = (
    0.01  # of a sample period: a stamp that is so much off moves a reading by its noise where the rate changes fast
)
_MOVED = 2.0  # quanta that a reading moves before it counts although none was expected
_EXACT = 1e-6  # of the period: less is rounding of a stamp
_TICKS = 2  # unknowns of a stretch: when its ticks are, and their period
_PASSES = 8
_SETTLED = 1e-2  # squared sigmas that a pass would still gain
_NEARLY = 100.0  # squared sigmas: a pass that would gain less is the last but one, as a rule


@kernel
def used(expected: Array, read: Array, quantum: float) -> NDArray[np.int_]:
    """Which readings of a component say something new: that are to have moved by a quantum, or have by more.

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


@kernel
def lagging(level: Array, slope: Array, remaining: Array, by_logarithm: Array) -> None:
    """Lets levels lag behind what they tend to.

    Args:
        level: at the beginning, then what each tends to over each interval, which the levels at its end replace, shape
            (m, n_jets).
        slope: their derivatives by the logarithm of the time constant, zero at the beginning, likewise filled in.
        remaining: share of an initial difference that is left at the end, shape (n_jets,).
        by_logarithm: its derivative, shape (n_jets,).
    """
    for k in range(level.shape[0] - 1):
        off = level[k] - level[k + 1]
        level[k + 1] = level[k + 1] + off * remaining
        slope[k + 1] = slope[k] * remaining + off * by_logarithm


def _crossed(left, right):  # type: ignore[no-untyped-def] # compiled alone
    count = max(left.shape[0], right.shape[0])
    result = np.empty((count, 3, left.shape[2]))
    for index in range(count):
        one, other = min(index, left.shape[0] - 1), min(index, right.shape[0] - 1)
        for row in range(left.shape[2]):
            a, b, c = left[one, 0, row], left[one, 1, row], left[one, 2, row]
            x, y, z = right[other, 0, row], right[other, 1, row], right[other, 2, row]
            result[index, 0, row] = b * z - c * y
            result[index, 1, row] = c * x - a * z
            result[index, 2, row] = a * y - b * x
    return result


@idiom(_crossed)
def crossed(left: Array, right: Array) -> Array:
    """The cross products of vectors in columns, shape (..., 3, m); in compiled code (e, 3, m), or (1, 3, m)."""
    a, b, c = left[..., 0, :], left[..., 1, :], left[..., 2, :]
    x, y, z = right[..., 0, :], right[..., 1, :], right[..., 2, :]
    first = b * z - c * y
    result = np.empty((*first.shape[:-1], 3, first.shape[-1]))
    result[..., 0, :], result[..., 1, :], result[..., 2, :] = first, c * x - a * z, a * y - b * x
    return result


@kernel
def _cross_products(left: Array, right: Array) -> Array:
    return crossed(left, right)


class Compute(NamedTuple):
    """The functions that go through a record row by row, or their compiled forms."""

    used: Callable[[Array, Array, float], NDArray[np.int_]] = used
    lagging: Callable[[Array, Array, Array, Array], None] = lagging
    crossed: Callable[[Array, Array], Array] = crossed


def compute(*, compiled: bool) -> Compute:
    """These functions."""
    if not compiled:
        return Compute()
    return Compute(chosen(used, compiled), chosen(lagging, compiled), chosen(_cross_products, compiled))


class Columns(NamedTuple):
    """Where the unknowns stand, a slice each."""

    properties: slice
    thrust: slice
    lag: slice
    gyro_bias: slice
    acceleration_bias: slice
    torque: slice
    drag: slice
    gyro_gain: slice
    accelerometer_gain: slice


class Model(NamedTuple):
    """What is known of the vehicle before a flight.

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


class Stretch(NamedTuple):
    """A part of a record without gaps, of m rows.

    Attributes:
        time_s: stamps, shape (m,).
        readings: of all packages, gyros first, NaN where missing, shape (m, n_packages, 3).
        commands: from each row on, shape (m, n_jets); the last row's is not used.
        before: up to the first row, shape (n_jets,).
        outside: known torque about the vehicle origin and force from each row on, shape (m, 6).
        used_after: propellant that is used from each row to the end of the flight, slug or kg, shape (m,).
    """

    time_s: Array
    readings: Array
    commands: Array
    before: Array
    outside: Array
    used_after: Array


class Normal(NamedTuple):
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

    def plus(self, other: Normal) -> Normal:
        """Both together."""
        return Normal(
            self.information + other.information,
            self.score + other.score,
            self.misfit + other.misfit,
            self.readings + other.readings,
            self.by_package + other.by_package,
            self.quick + other.quick,
            self.quiet + other.quiet,
        )


class Fit(NamedTuple):
    """The readings explained by what is reckoned with.

    Attributes:
        at: estimate of all unknowns, shape (n,).
        normal: about it.
        information: A of each stretch, in order.
        settled: whether the passes have come to an end.
    """

    at: Array
    normal: Normal
    information: tuple[Array, ...]
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


def columns(model: Model) -> Columns:
    """Where the unknowns of a vehicle stand."""
    return _columns(model.prior.shape[0], model.flows.shape[0], model.gyros, model.positions.shape[0])


@cache
def _columns(n_unknown: int, n_jets: int, n_gyros: int, n_accelerometers: int) -> Columns:
    of_gyros, of_accelerometers = 3 * n_gyros, 3 * n_accelerometers
    n_lags = n_unknown - (_N + n_jets + 9 + of_gyros + 2 * of_accelerometers)
    sizes = (_N, n_jets, n_lags, 3, of_accelerometers, 3, 3, of_gyros, of_accelerometers)
    ends = list(accumulate(sizes))
    return Columns(*(slice(end - size, end) for end, size in zip(ends, sizes, strict=True)))


# --------------------------------------------------------------------------------------------- rows


class _Course(NamedTuple):
    """What acted over the intervals of a stretch, by rows; any other jet gave nothing at all."""

    on: NDArray[np.int_]  # the jets that acted, (j,)
    durations_s: Array
    amount: Array  # seconds of full thrust, (m - 1, j)
    by_lag: Array  # its derivative by the time constant
    bow: Array  # see `Firing`, s, (3, m - 1, j)
    late_s: Array  # of each stamp after its tick, (m,)
    level: Array  # at each stamp, (m, j), where one is late


def _course(stretch: Stretch, lag_error: Array, model: Model) -> _Course:
    m = stretch.commands.shape[0]
    intervals = m - 1
    told = (stretch.commands[:intervals] != 0.0).any(axis=0)
    on = np.flatnonzero(told | (stretch.before != 0.0))
    commands = np.ascontiguousarray(stretch.commands[:intervals, on])
    period, late = _ticks(stretch.time_s, model.period_s)
    given, lag_error = model.time_constants_s[on], lag_error[on]
    constants = np.where(given > 0.0, np.maximum(given + lag_error, 0.05 * given), 0.0)
    lagged = constants > 0.0
    remaining = np.exp(-period / np.where(lagged, constants, np.inf)) * lagged
    by_logarithm = remaining * period / np.where(lagged, constants, 1.0)
    level, slope = np.zeros((2, m, on.size))
    level[0], level[1:] = stretch.before[on], commands
    if remaining.any():
        model.compute.lagging(level, slope, remaining, by_logarithm)
    firing = fire(level[:-1], slope[:-1], constants, np.array([period]), commands[None])
    amount, by_lag = firing.amount, firing.amount_slope / np.where(lagged, constants, 1.0)
    if not lagged.all():
        off = level[:-1] - commands
        by_lag = np.where(lagged, by_lag, off)
        amount = amount + np.where(lagged, 0.0, off * lag_error)
    if late.any():
        sided = np.where((late > 0.0)[:, None] & (np.arange(m) < intervals)[:, None], stretch.commands[:, on], level)
        level = np.where(lagged, level, np.nan_to_num(sided))
    return _Course(on, np.full(intervals, period), amount, by_lag, firing.bow, late, level)


def _ticks(time_s: Array, period_s: float) -> tuple[float, Array]:
    """The period at which commands switch, and how late each stamp is: both from a line through the stamps."""
    counts = _counts(time_s.shape[0])
    since = time_s - time_s.mean()
    period = float(counts @ since) / float(counts @ counts)
    if abs(period - period_s) < _EXACT * period_s:
        period = period_s
    late = since - counts * period
    return period, np.where(np.abs(late) < _EXACT * period, 0.0, late)


def _interpolated(readings: Array) -> Array:
    """The mean of the gyros, with what is missing put in between, shape (m, 3)."""
    known = ~np.isnan(readings)
    rate = np.where(known, readings, 0.0).sum(axis=1) / np.maximum(known.sum(axis=1), 1)
    there = np.asarray(known.any(axis=1))
    rows = np.arange(rate.shape[0])
    for axis in range(3):
        if there[:, axis].any() and not there[:, axis].all():
            rate[:, axis] = np.interp(rows, rows[there[:, axis]], rate[there[:, axis], axis])
    return rate


class _Turned(NamedTuple):
    """Dynamic coupling of the rates alone over each interval, see `joint.prediction`, shape (e, 3, m - 1) each."""

    change: Array  # over its length, by the inverse inertia
    rate: Array  # on average
    momentum: Array
    rate_change: Array
    momentum_change: Array
    bow: Array  # mean that coupling itself gives, over the length


def _turned(inverse: Array, rate: Array, compute: Compute) -> _Turned:
    """Of inverse inertias, shape (e, 3, 3), and rates, shape (e, 3, m); either may be one for all."""
    momentum = np.linalg.inv(inverse).transpose(0, 2, 1) @ rate
    start, end, at_start, at_end = rate[..., :-1], rate[..., 1:], momentum[..., :-1], momentum[..., 1:]
    cross = compute.crossed
    return _Turned(
        change=(cross(start, 2.0 * at_start + at_end) + cross(end, at_start + 2.0 * at_end)) / 6.0,
        rate=0.5 * (start + end),
        momentum=0.5 * (at_start + at_end),
        rate_change=end - start,
        momentum_change=at_end - at_start,
        bow=np.diff(cross(rate, momentum)) / 12.0,
    )


class _Sums(NamedTuple):
    """Impulses over the intervals of a stretch, about the vehicle origin, and how rates were."""

    impulse: Array  # (6, m - 1)
    bow: Array  # (3, 6, m - 1)
    late: Array | None  # at each stamp besides, (6, m), where one is late
    rate: Array  # (3, m)
    durations_s: Array
    acting: Array | None  # what jets give at each stamp, (6, m), where one is late


class _Moments(NamedTuple):
    """The same about centers of mass, shape (e, 3, m - 1), of what is late (e, 3, m)."""

    angular: Array
    bows: Array  # (3, e, 3, m - 1)
    late: Array | None  # where nothing is


def _moments(centers: Array, sums: _Sums) -> _Moments:
    """About centers of mass, shape (e, 3)."""

    def about(wrenches: Array) -> Array:
        moment: Array = wrenches[..., :3, :] + crossed(wrenches[..., 3:, :], centers[..., None])
        return moment

    late = None if sums.late is None else about(sums.late)
    return _Moments(about(sums.impulse), about(sums.bow[:, None]), late)


def _bows(moments: _Moments, turned: _Turned, durations_s: Array) -> tuple[Array, Array, Array]:
    """Angular impulses of the bows of the rate, see `joint.prediction`, shape (e, 3, m - 1) each."""
    own = turned.bow * durations_s
    return moments.bows[0] + own, moments.bows[1], moments.bows[2] + PARABOLA * own


def _gathered(inverse: Array, moments: _Moments, turned: _Turned, durations_s: Array, compute: Compute) -> Array:
    """The rate that has been gained since the beginning, shape (e, 3, m), by inverse inertias of shape (e, 3, 3)."""
    bows = _bows(moments, turned, durations_s)
    bowed = [inverse @ bow for bow in bows]
    cross = compute.crossed
    bent = cross(turned.rate, bows[0]) + cross(bowed[0], turned.momentum) + cross(bowed[2], bows[2])
    bent += cross(turned.rate_change, bows[1]) + cross(bowed[1], turned.momentum_change)
    added = inverse @ moments.angular + -durations_s * (inverse @ (turned.change + bent))
    gained = np.zeros((*added.shape[:2], durations_s.size + 1))
    np.cumsum(added, axis=-1, out=gained[..., 1:])
    if moments.late is not None:
        gained += inverse @ moments.late
    return gained


def _turning(whole: Array, bowed: Sequence[Array], durations_s: Array) -> Array:
    """O = [(w - w_0) x] + the integral of [w x]^2, of rates at the rows, shape (3, m), and their bows between.

    Returns:
        Of each row, shape (3, 3, m).
    """
    start, end = whole[:, :-1], whole[:, 1:]
    middle, gained, bow = 0.5 * (start + end), end - start, bowed
    spin = np.zeros((6, whole.shape[1]))
    for k, (i, j) in enumerate(_PAIRS):
        straight = (start[i] * start[j] + end[i] * end[j]) / 3.0 + (start[i] * end[j] + end[i] * start[j]) / 6.0
        bent = middle[i] * bow[0][j] + middle[j] * bow[0][i] + bow[2][i] * bow[2][j]
        bent += gained[i] * bow[1][j] + gained[j] * bow[1][i]
        np.cumsum((straight + bent) * durations_s, out=spin[k, 1:])
    xx, yy, zz, yz, xz, xy = spin
    x, y, z = whole - whole[:, :1]
    rows = [[-(yy + zz), xy - z, xz + y], [xy + z, -(xx + zz), yz - x], [xz - y, yz + x, -(xx + yy)]]
    return np.array(rows)


class _Expected(NamedTuple):
    """What is expected of a stretch at a point."""

    course: _Course
    sums: _Sums
    lightness: Array  # of each interval, (m - 1,)
    moments: _Moments
    turned: _Turned
    rate: Array  # since the beginning, (3, m)
    velocity: Array


def _expected(stretch: Stretch, at: Array, course: _Course, model: Model) -> _Expected:
    places = columns(model)
    wrenches = _wrenches(at, course, model)
    rate = _by_columns(_interpolated(stretch.readings[:, : model.gyros]))
    impulse = wrenches @ course.amount.T + stretch.outside[:-1].T * model.period_s
    resisted = at[places.drag, None] * 0.5 * (rate[:, :-1] + rate[:, 1:])
    impulse[:3] += model.period_s * (at[places.torque, None] - resisted)  # pure torques act about any point
    acting = wrenches @ course.level.T if course.late_s.any() else None
    late = None if acting is None else course.late_s * acting
    sums = _Sums(impulse, wrenches @ course.bow.transpose(0, 2, 1), late, rate, course.durations_s, acting)
    mass = 1.0 / at[_MASS] + stretch.used_after
    lightness = 2.0 / (mass[:-1] + mass[1:])
    velocity = np.zeros_like(sums.rate)
    np.cumsum(sums.impulse[3:] * lightness, axis=-1, out=velocity[:, 1:])
    if late is not None:
        velocity += late[3:] / mass
    inverse, moments = at[:6][ELEMENT][None], _moments(at[None, _CENTER], sums)
    turned = _turned(inverse, (sums.rate - at[places.gyro_bias, None])[None], model.compute)
    gained = _gathered(inverse, moments, turned, sums.durations_s, model.compute)
    return _Expected(course, sums, lightness, moments, turned, gained[0], velocity)


def _wrenches(at: Array, course: _Course, model: Model) -> Array:
    """Of the jets that are on at some time, about the vehicle origin, shape (6, j)."""
    gains = 1.0 + at[columns(model).thrust][course.on]
    wrenches: Array = (gains[:, None] * model.wrenches[course.on]).T
    return wrenches


def _by_columns(rows: Array) -> Array:
    """Rows of a stretch side by side."""
    return np.ascontiguousarray(np.swapaxes(rows, -1, -2))


class _Design(NamedTuple):
    """What derivatives of what is expected are made of; they are made for the rows that say something new alone.

    What a jet gives has the direction of its moment and of its force, so that one sum is enough for three components,
    and likewise what torques and drag give.
    """

    kept: NDArray[np.int_]  # which unknowns have any, (k,)
    place: NDArray[np.int_]  # of each among them, -1: none
    moved: Array  # of the rate by elements 0 to 8 and, where they are kept, gyro biases, (9 or 12, 3, m)
    of_mass: Array  # of the velocity by 1/m, (3, m)
    amount: Array  # of each jet that is kept, since the beginning, s, (m, j)
    lightened: Array  # likewise, each interval's over the mass
    moments: Array  # rate and
    forces: Array  # velocity, with all mass at one, by them, (j, 3)
    lag_rates: Array  # by the lags, (l, 3, m)
    lag_velocities: Array
    turned: Array  # rate by a torque of one over an interval, (3, 3)
    ways: Array  # sum of the rates over the intervals, (3, m)
    ticks: Array  # rate and velocity by the ticks, where any is late, (2, 2, 3, m), else (2, 0, 3, m)


def _design(expected: _Expected, at: Array, model: Model, wanted: NDArray[np.bool_]) -> _Design:
    """Of the unknowns that are wanted, at least; those of a group, but jets and gains, come together."""
    places, course, sums = columns(model), expected.course, expected.sums
    acting = ((course.amount != 0.0) | (course.by_lag != 0.0)).any(axis=0) & wanted[places.thrust][course.on]
    has = wanted.copy()
    for group in (places.properties, places.lag, places.gyro_bias, places.torque, places.drag):
        has[group] = wanted[group].any()
    has[places.properties], has[places.thrust] = True, False
    has[places.thrust][course.on[acting]] = True
    inverse, forces = at[:6][ELEMENT], model.wrenches[course.on, 3:]
    moments = (model.wrenches[course.on, :3] + crosses(forces, at[_CENTER])) @ inverse
    lags = range(places.lag.start, places.lag.stop) if has[places.lag].any() else range(0)
    by_lag = np.zeros((len(lags), 2, 3, expected.rate.shape[1]))
    thrust, light = 1.0 + at[places.thrust][course.on], expected.lightness
    for kind in range(len(lags)):
        each = np.hstack((moments, forces)) * (thrust * (model.kinds[course.on] == kind))[:, None]
        rates, velocities = np.split(each.T @ course.by_lag.T, 2)
        np.cumsum(rates, axis=-1, out=by_lag[kind, 0, :, 1:])
        np.cumsum(velocities * light, axis=-1, out=by_lag[kind, 1, :, 1:])
    amount = course.amount[:, acting]
    return _Design(
        kept=np.flatnonzero(has),
        place=np.where(has, np.cumsum(has) - 1, -1),
        moved=_moved(expected, at, model, biased=bool(has[places.gyro_bias].any())),
        of_mass=_since(sums.impulse[3:] * (light / at[_MASS]) ** 2),
        amount=_since(amount.T).T,
        lightened=_since(amount.T * light).T,
        moments=moments[acting],
        forces=forces[acting],
        lag_rates=by_lag[:, 0],
        lag_velocities=by_lag[:, 1],
        turned=model.period_s * inverse,
        ways=_since(0.5 * (sums.rate[:, :-1] + sums.rate[:, 1:])),
        ticks=_by_ticks(expected, at, model),
    )


def _by_ticks(expected: _Expected, at: Array, model: Model) -> Array:
    """Derivatives of rate and velocity by how early all ticks are, and by how much shorter their period is.

    Until a stamp a jet gives what it gives then for as much longer as its tick is earlier; with a shorter period, less
    in each. Constants make no difference.
    """
    course, acting = expected.course, expected.sums.acting
    if acting is None:
        return np.zeros((2, 0, *expected.rate.shape))
    given = _since(_wrenches(at, course, model) @ course.amount.T / course.durations_s)
    wrenches = np.array([acting, _counts(acting.shape[1]) * acting - given])
    moments = wrenches[:, :3] + crossed(wrenches[:, 3:], at[None, _CENTER, None])
    lightness = np.append(expected.lightness, expected.lightness[-1])
    return np.array([at[:6][ELEMENT] @ moments, wrenches[:, 3:] * lightness])


def _counts(number: int) -> Array:
    """Rows from the middle on."""
    return np.arange(0.5 * (1.0 - number), 0.5 * number)


def _since(gained: Array) -> Array:
    """Sums since the beginning of what is gained over intervals, shape (k, m - 1), at the rows, shape (k, m)."""
    sums = np.zeros((gained.shape[0], gained.shape[1] + 1))
    np.cumsum(gained, axis=-1, out=sums[:, 1:])
    return sums


def _derivatives(
    design: _Design, rows: NDArray[np.int_], turning: Sequence[tuple[int, float]], pulled: int | None, model: Model
) -> Array:
    """Derivatives of a sum of components of the rate, and of a component of the velocity, at some rows.

    Args:
        design: see `_Design`.
        rows: shape (r,).
        turning: components of the rate, and how often each is taken.
        pulled: component of the velocity; None: the rate alone.
        model: see `Model`.

    Returns:
        Shape (k, r); of ticks that are late those by the two last, (k + 2, r).
    """
    places, start = columns(model), design.place
    by_ticks = slice(design.kept.size, design.kept.size + design.ticks.shape[1])
    x, weights = np.zeros((by_ticks.stop, rows.size)), np.zeros(3)
    biases, lags = design.moved.shape[0] > _MASS, design.lag_rates.shape[0] > 0
    for axis, weight in turning:
        weights[axis] = weight
        moved = weight * design.moved[:, axis].take(rows, axis=1)
        x[:_MASS] += moved[:_MASS]
        if biases:
            x[start[places.gyro_bias]] += moved[_MASS:]
        if lags:
            x[start[places.lag]] += weight * design.lag_rates[:, axis].take(rows, axis=1)
        x[by_ticks] += weight * design.ticks[0, :, axis].take(rows, axis=1)
    turned = design.turned @ weights
    if start[places.torque.start] >= 0:
        x[start[places.torque]] = turned[:, None] * rows
    if start[places.drag.start] >= 0:
        x[start[places.drag]] = -turned[:, None] * design.ways[:, rows]
    jets = slice(_N, _N + design.moments.shape[0])
    x[jets] = (design.amount[rows] * (design.moments @ weights)).T
    if pulled is not None:
        x[jets] += (design.lightened[rows] * design.forces[:, pulled]).T
        x[_MASS] = design.of_mass[pulled, rows]
        if lags:
            x[start[places.lag]] += design.lag_velocities[:, pulled].take(rows, axis=1)
        x[by_ticks] += design.ticks[1, :, pulled].take(rows, axis=1)
    return x


def _moved(expected: _Expected, at: Array, model: Model, *, biased: bool) -> Array:
    """Derivatives of the rate gained by the unknowns that it is not linear in: elements 0 to 8, and gyro biases.

    Returns:
        Shape (9, 3, m), (12, 3, m) with biases.
    """
    bias, sums, steps = columns(model).gyro_bias, expected.sums, _STEP * model.sigma[:_MASS]
    inverse, count = at[:6][ELEMENT], 9 if biased else 6
    others = np.tile(inverse, (count, 1, 1))
    others[:6] = (at[:6] + np.diag(steps[:6]))[:, ELEMENT]
    biases = np.tile(at[bias], (count if biased else 1, 1))  # one for all where none is asked for
    biases[6:] += _SMALL_RATE * np.eye(3)[: count - 6]
    turned = _turned(others, sums.rate - biases[:, :, None], model.compute)
    rates = _gathered(others, expected.moments, turned, sums.durations_s, model.compute) - expected.rate
    moments = _moments(at[_CENTER] + np.diag(steps[6:]), sums)
    shifted = _gathered(inverse[None], moments, expected.turned, sums.durations_s, model.compute) - expected.rate
    widths = np.concatenate((steps, np.full(count - 6, _SMALL_RATE)))
    derivatives: Array = np.concatenate((rates[:6], shifted, rates[6:])) / widths[:, None, None]
    return derivatives


class _Component(NamedTuple):
    """A component of a sensor where it says something new, in r rows."""

    package: int
    rows: NDArray[np.int_]  # (r,)
    left: Array  # what is read less what is expected, (r,)
    design: Array  # (k, r)


def _components(
    stretch: Stretch, expected: _Expected, design: _Design, at: Array, model: Model
) -> Iterator[_Component]:
    """Yields every component of which there are two rows, gyros first."""
    places, sums = columns(model), expected.sums
    off = np.mean(sums.rate - expected.rate, axis=1, keepdims=True)
    whole = expected.rate + off - at[places.gyro_bias, None]
    inverse = at[:6][ELEMENT]
    bows = _bows(expected.moments, _turned(inverse[None], whole[None], model.compute), sums.durations_s)
    turn = _turning(whole, [inverse @ bow[0] for bow in bows], sums.durations_s)
    ramp = stretch.time_s - stretch.time_s[0]
    for package in range(stretch.readings.shape[1]):
        number = package - model.gyros
        arm = model.positions[number] - at[_CENTER] if number >= 0 else np.zeros(3)
        shown = expected.rate if number < 0 else expected.velocity + arm @ turn
        for axis in range(3):
            gains = places.gyro_gain.start + 3 * package if number < 0 else places.accelerometer_gain.start + 3 * number
            gain, own = gains + axis, places.acceleration_bias.start + 3 * number + axis
            wanted = shown[axis] * (1.0 + at[gain])
            if number >= 0:
                wanted = wanted + at[own] * ramp
            read = np.ascontiguousarray(stretch.readings[:, package, axis])
            rows = model.compute.used(wanted, read, float(model.quanta[package]))
            if rows.shape[0] < 2:
                continue
            if number < 0:
                x = _derivatives(design, rows, ((axis, 1.0),), None, model)
            else:
                first, second = (axis + 1) % 3, (axis + 2) % 3
                levers = ((first, float(arm[second])), (second, -float(arm[first])))
                x = _derivatives(design, rows, levers, axis, model)
                x[_CENTER] -= turn[axis].take(rows, axis=1)
            if at[gain] != 0.0:
                x *= 1.0 + at[gain]
            if design.place[gain] >= 0:
                x[design.place[gain]] = shown[axis, rows]
            if number >= 0 and design.place[own] >= 0:
                x[design.place[own]] = ramp[rows]
            yield _Component(package, rows, read[rows] - wanted[rows], x)


def normal(stretch: Stretch, at: Array, model: Model, wanted: NDArray[np.bool_] | None = None) -> Normal:
    """The normal equations of a stretch about a point.

    Args:
        stretch: of at least two rows.
        at: all unknowns, shape (n,); the inverse inertia positive definite.
        model: see `Model`.
        wanted: unknowns of which they are to be, shape (n,); None: all. Of others they may be zero.
    """
    return _normal(stretch, at, course_of(stretch, at, model), model, wanted)


def reckoned(model: Model) -> NDArray[np.bool_]:
    """Which unknowns a fit, and what it allows, depend on, shape (n,)."""
    return (model.sigma > 0.0) | (np.arange(model.sigma.size) < _N)


def course_of(stretch: Stretch, at: Array, model: Model) -> _Course:
    """What acted over the intervals of a stretch, which depends on the lag alone; arguments as `normal`."""
    return _course(stretch, at[columns(model).lag][model.kinds], model)


def _normal(
    stretch: Stretch, at: Array, course: _Course, model: Model, wanted: NDArray[np.bool_] | None = None
) -> Normal:
    expected = _expected(stretch, at, course, model)
    squares = np.zeros(expected.rate.shape[1] + 1)
    squares[1:-1] = np.sum((np.diff(expected.rate) / model.period_s) ** 2, axis=0)
    steepness = 0.5 * (squares[:-1] + squares[1:])
    every = np.ones(at.shape[0], dtype=np.bool_)
    design = _design(expected, at, model, every if wanted is None else wanted)
    kept = design.kept
    size = kept.shape[0] + design.ticks.shape[1]
    information, vector = np.zeros((size, size)), np.zeros(size)
    parts: list[_Component] = []
    for package, rows, difference, derivatives in _components(stretch, expected, design, at, model):
        scale = 1.0 / np.sqrt(model.variances[package])
        x, left = derivatives, (difference - difference.mean()) * scale
        x -= x.sum(axis=1, keepdims=True) / rows.shape[0]
        x *= scale
        information += x @ x.T
        vector += x @ left
        parts.append(_Component(package, rows, left, x[kept.shape[0] :]))
    shift = np.zeros(0)
    if size > kept.shape[0]:
        information, vector, shift = _without_ticks(information, vector, course.late_s)
    total = empty(model)
    for package, rows, difference, by_ticks in parts:
        left = difference - shift @ by_ticks if shift.size else difference
        total.by_package[package] += left @ left, rows.shape[0] - 1.0, left[1:] @ left[:-1]
        if package < model.gyros:
            fast = steepness[rows] * (_QUICK * model.period_s) ** 2 > model.variances[package]
            total.quick[:] += left[fast] @ left[fast], fast.sum()
            total.quiet[:] += left[~fast] @ left[~fast], (~fast).sum()
    total.information[np.ix_(kept, kept)] = information
    total.score[kept] = vector
    misfit, count, _ = total.by_package.sum(axis=0).tolist()
    return total._replace(misfit=misfit, readings=count)


def _without_ticks(information: Array, score: Array, late_s: Array) -> tuple[Array, Array, Array]:
    """The normal equations with the ticks eliminated, and what is found of these.

    Args:
        information, score: the ticks last, shapes (k + 2, k + 2) and (k + 2,).
        late_s: of each stamp after its tick by the line, whose errors they make, shape (m,).
    """
    m = late_s.shape[0]
    variance = float(late_s @ late_s) / max(m - _TICKS, 1)
    counts = _counts(m)
    known = np.diag([m / variance, float(counts @ counts) / variance])
    own, cross = information[-_TICKS:, -_TICKS:] + known, information[:-_TICKS, -_TICKS:]
    solved = np.linalg.solve(own, np.column_stack((cross.T, score[-_TICKS:])))
    left = information[:-_TICKS, :-_TICKS] - cross @ solved[:, :-1]
    return left, score[:-_TICKS] - cross @ solved[:, -1], np.asarray(solved[:, -1])


def empty(model: Model) -> Normal:
    """The normal equations of nothing."""
    n = model.prior.shape[0]
    packages = model.variances.shape[0]
    return Normal(np.zeros((n, n)), np.zeros(n), 0.0, 0.0, np.zeros((packages, 3)), np.zeros(2), np.zeros(2))


# ---------------------------------------------------------------------------------------------- fit


def fitted(stretches: Sequence[Stretch], start: Array, model: Model) -> Fit:
    """Explains readings by what is reckoned with, by Gauss and Newton's passes.

    Args:
        stretches: of the flight.
        start: where to begin, shape (n,).
        model: see `Model`.
    """
    at = start.copy()
    free = np.flatnonzero(model.sigma > 0.0)
    sigma, lag = model.sigma[free], columns(model).lag
    told: list[_Course] = []
    told_for, wanted, complete = at, reckoned(model), False
    for number in range(_PASSES):
        complete = complete or number == _PASSES - 1
        if not told or (at[lag] != told_for[lag]).any():
            told, told_for = [course_of(stretch, at, model) for stretch in stretches], at
        each = zip(stretches, told, strict=True)
        parts = [_normal(stretch, at, course, model, None if complete else wanted) for stretch, course in each]
        total = empty(model)
        for part in parts:
            total = total.plus(part)
        scaled = total.information[np.ix_(free, free)] * np.outer(sigma, sigma) + np.eye(free.shape[0])
        right = total.score[free] * sigma + (model.prior[free] - at[free]) / sigma
        step = np.linalg.solve(scaled, right)
        gain, sound = float(step @ right), bool(np.isfinite(step).all())
        if complete and (not sound or gain < _SETTLED):
            return Fit(at, total, tuple(part.information for part in parts), sound)
        complete = not sound or gain < _NEARLY
        if not sound or gain < _SETTLED:
            continue  # it was the last one, but for the unknowns that are only put to the test
        move = np.zeros_like(at)
        move[free] = step * sigma
        while not possible(at + move):
            move *= 0.5
        at = at + move
    return Fit(at, total, tuple(part.information for part in parts), False)


def possible(at: Array) -> bool:
    """Whether the inverse inertia is positive definite and the mass positive."""
    return is_positive_definite(at[:6][ELEMENT]) and bool(at[_MASS] > 0.0)


class Reckoned(NamedTuple):
    """What is reckoned with in tests of other unknowns, which all have it in common.

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


def reckoned_in(fit: Fit, model: Model, besides: NDArray[np.int_] | slice = slice(0)) -> Reckoned:
    """What is reckoned with, but for some unknowns that are put to the test.

    Args:
        fit: see `Fit`.
        model: see `Model`.
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
    fit: Fit,
    group: NDArray[np.int_],
    model: Model,
    stated: float = 0.0,
    clear: float = np.inf,
    common: Reckoned | None = None,
) -> ScoreTest:
    """Tests whether some unknowns are what is stated.

    Args:
        fit: see `Fit`.
        group: their places, in units that are alike, integers, shape (k,).
        model: see `Model`; where they are reckoned with, they are no longer.
        stated: their 1-sigma; zero: that they are zero.
        clear: largest 1-sigma of a combination of them that is tested.
        common: what is reckoned with at all, which it is that serves where they are not.
    """
    total = fit.normal
    if common is None or (model.sigma[group] > 0.0).any():
        common = reckoned_in(fit, model, group)
    cross = total.information[np.ix_(group, common.free)] * common.sigma
    information = total.information[np.ix_(group, group)] - cross @ common.solved[:, group]
    of_group = common.score[group] - cross @ common.solved[:, -1]
    if not (np.isfinite(information).all() and np.isfinite(of_group).all()):
        return ScoreTest(0.0, 0, np.zeros(group.shape[0]), total.misfit)
    values, vectors = np.linalg.eigh(0.5 * (information + information.T))
    known = values > max(1.0 / clear**2, 1e-9 * float(np.max(np.abs(np.diag(total.information))[group], initial=0.0)))
    if not known.any():
        return ScoreTest(0.0, 0, np.zeros(group.shape[0]), total.misfit)
    along = (vectors.T @ of_group)[known] / values[known]
    statistic = float(np.sum(along**2 / (1.0 / values[known] + stated**2)))
    gained = float(np.sum(along**2 * values[known]))
    return ScoreTest(statistic, int(known.sum()), vectors[:, known] @ along, max(total.misfit - gained, 0.0))


def least_deviation(information: Sequence[Array], start: Array, drifts: Sequence[Array], model: Model) -> Array:
    """The least 1-sigma of the ten parameters that a flight allows, shape (10,).

    Args:
        information: A of each stretch in order.
        start: covariance of the ten at the start, shape (10, 10).
        drifts: variances added to the ten after each stretch, shape (10,) each.
        model: for what else is reckoned with.
    """
    free = np.flatnonzero(model.sigma > 0.0)
    free = free[free >= _N]
    kept = np.concatenate((np.arange(_N), free))
    covariance = np.diag(np.concatenate((np.zeros(_N), model.sigma[free] ** 2)))
    covariance[:_N, :_N] = start
    for one, drift in zip(information, drifts, strict=True):
        if not (np.isfinite(one).all() and np.isfinite(covariance).all()):
            return np.full(_N, np.nan)
        scale = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
        root = _root(covariance / np.outer(scale, scale)) * scale[:, None]
        inner = root.T @ one[np.ix_(kept, kept)] @ root
        half = np.linalg.cholesky(inner + np.eye(kept.shape[0]))
        after = np.linalg.solve(half, root.T)
        covariance = after.T @ after
        covariance[range(_N), range(_N)] += drift
    result: Array = np.sqrt(np.diag(covariance)[:_N])
    return result


def _root(matrix: Array) -> Array:
    values, vectors = np.linalg.eigh(matrix)
    root: Array = vectors * np.sqrt(np.maximum(values, 0.0))
    return root
