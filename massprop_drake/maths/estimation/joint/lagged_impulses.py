"""Time of full thrust of each jet over an interval, with lag, and its derivatives.

Equations: theory page of the joint filter, "What a jet gives"; with d = l - u at the start of a piece of length h, e
= exp(-h/tau) and k = (tau/h)(1 - e), the integral of L over the piece is h^2 (u/2 + d (tau/h)(1 - k)). An interval is
as many pieces as the commands that share in it.

The *bow* of a jet over an interval of length T is what it has given so far, p(t), less its share if it gave all of L
evenly. It is known by its mean, by its first moment about the middle, and by its root mean square with the sign of
the mean,

    m0/T - L/2,    m1/T^2 - m0/2T - L/12,    (m2/T - 2 L m1/T^2 + L^2/3)^1/2

with m0, m1, m2 the integrals of p, p t, p^2. Over a single piece, p is L t/T and h d times a function of x = t/h
alone, whose integral with 1, x and itself are E0 - k/2, E1 - E0/2 - k/12 and E2 - 2 k E1 + k^2/3, with E0, E1, E2
those of E = (tau/h)(1 - exp(-x h/tau)), of E x and of E^2.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from massprop_drake.maths.estimation.joint.layout import CENTER, MASS
from massprop_drake.maths.kernels import kernel, select_where, take_elements
from massprop_drake.maths.linear_algebra import Array, skew
from massprop_drake.maths.mass_properties import ELEMENT

UNKNOWN_LEVEL = 0.5  # mean and 1-sigma of a level that is 0 or 1 and nobody knows which
_SETTLED = 1e-5  # of an interval: an opening that no reading shows
LEAST_LAG = 1e-4  # of a stated time constant: with so little of it thrust is instantaneous


class Firing(NamedTuple):
    """Thrust of the jets over an interval.

    Attributes:
        duration_s: length of the interval, T.
        amount: L of each jet, s, shape (n_jets,).
        amount_slope: its derivative by ln tau, s, shape (n_jets,).
        bow: of each jet, the departure of its impulse from linear growth: mean, first moment, root mean square, s,
            shape (3, n_jets).
        unknown: whether L may be anything, since the command is not known in a part of the interval, or was not before
            and the lag has not settled yet, shape (n_jets,).
        variance: of L by the level at the start of the interval, s^2, shape (n_jets,).
        level, slope, level_std: at the end of the interval, shape (n_jets,) each.
        by_level: derivative of L and of the level at the end by that at the start, s and 1, shape (2, n_jets).
        by_tick: derivative of L by when each of the interval's ticks was, shape (n_ticks, n_jets).
        level_by_tick: of the level at the end, 1/s, likewise.
        commanded: whether any jet was commanded, or may have been.
    """

    duration_s: float
    amount: Array
    amount_slope: Array
    bow: Array
    unknown: np.ndarray
    variance: Array
    level: Array
    slope: Array
    level_std: Array
    by_level: Array
    by_tick: Array
    level_by_tick: Array
    commanded: bool


@kernel
def replace_firing(firing: Firing, seconds: Array, level: Array) -> Firing:
    """Returns the jets' thrust over an interval with other seconds of full thrust, and levels at its end."""
    return Firing(
        firing.duration_s,
        seconds,
        firing.amount_slope,
        firing.bow,
        firing.unknown,
        firing.variance,
        level,
        firing.slope,
        firing.level_std,
        firing.by_level,
        firing.by_tick,
        firing.level_by_tick,
        firing.commanded,
    )


@kernel
def moments_of(wrenches: Array, mean: Array) -> Array:
    """Computes the torque about the estimated center of mass of each wrench about the vehicle origin, shape (n, 3)."""
    return wrenches[:, :3] + wrenches[:, 3:] @ skew(mean[CENTER])


@kernel
def effects_of(wrenches: Array, mean: Array) -> Array:
    """Computes the change of rate and velocity by each wrench about the vehicle origin over a second, shape (n, 6)."""
    return np.hstack((moments_of(wrenches, mean) @ take_elements(mean, ELEMENT), mean[MASS] * wrenches[:, 3:]))


@kernel
def integrate_thrust(
    levels: tuple[Array, Array, Array], time_constants_s: Array, durations_s: Array, commands: Array, edges: Array
) -> Firing:
    """Computes the jets' seconds of full thrust, levels and derivatives over an interval of constant-command pieces.

    Args:
        levels: at the start of the interval, their derivatives by ln tau, and their 1-sigma, shape (n_jets,) each.
        time_constants_s: of each jet, zero: no lag, shape (n_jets,).
        durations_s: of the pieces, s, positive, shape (n_pieces,).
        commands: fraction commanded in each, NaN where not known, shape (n_pieces, n_jets).
        edges: derivative of each duration by when the ticks were that the pieces go with, shape (n_pieces, n_ticks);
            none: these are known, and what depends on them is zero, shape (0, n_ticks).
    """
    level, slope, level_std = levels
    seconds, seconds_slope, deviation = np.zeros(level.shape), np.zeros(level.shape), np.zeros(level.shape)
    anything = np.zeros(level.shape, dtype=np.bool_)
    moments = np.zeros((3,) + level.shape)  # noqa: RUF005 (for numba)
    ticks = edges.shape[1]
    by_level, by_tick, level_by_tick = _rows_like(level, 2), _rows_like(level, ticks), _rows_like(level, ticks)
    by_level[1] = 1.0
    total = 0.0
    commanded = False
    for piece in range(durations_s.shape[0]):
        h = durations_s[piece]
        unknown = np.isnan(commands[piece])
        u = select_where(unknown, UNKNOWN_LEVEL, commands[piece])
        commanded = commanded or bool(np.any(u > 0.0))
        ratio = time_constants_s / h
        lagged = ratio > 0.0
        remaining = np.exp(-1.0 / select_where(lagged, ratio, 1.0)) * lagged
        mean = ratio * (1.0 - remaining)
        d = level - u
        integrals = _decay_integrals(ratio, mean)
        if durations_s.shape[0] == 1:
            moments = _bow_of_piece(h * d, integrals, mean)
        else:
            moments += _moments_of_piece(total, h, (seconds, u, d), integrals)
        seconds += h * (u + d * mean)
        seconds_slope += h * (d * (mean - remaining) + slope * mean)
        remaining_slope = remaining / select_where(lagged, ratio, 1.0)
        slope = slope * remaining + d * remaining_slope
        level = u + d * remaining
        if edges.shape[0] > 0:
            longer = edges[piece].reshape(-1, 1)
            by_level[0] += h * mean * by_level[1]
            by_level[1] *= remaining
            by_tick += h * mean * level_by_tick + longer * level
            level_by_tick = remaining * level_by_tick - longer * (d * remaining_slope / h)
        anything = anything | unknown
        deviation += h * mean * level_std
        level_std = select_where(unknown, UNKNOWN_LEVEL, level_std * remaining)
        total += h
    bow = moments if durations_s.shape[0] == 1 else _bow_of_interval(moments, seconds, total)
    return Firing(
        total,
        seconds,
        seconds_slope,
        bow,
        anything | (deviation > _SETTLED * total),
        deviation**2,
        level,
        slope,
        level_std,
        by_level,
        by_tick,
        level_by_tick,
        commanded,
    )


@kernel
def _rows_like(level: Array, count: int) -> Array:
    """Returns an array of zeros with a given number of rows, each of the shape of a level."""
    return np.zeros((count,) + level.shape)  # noqa: RUF005 (for numba)


class Lingering(NamedTuple):
    """Decay of a level's initial deviation over an interval with a constant command, by the lag.

    Attributes:
        remaining: share at its end, e, shape (n_jets,).
        by_logarithm: its derivative by ln tau, e'.
        mean: share on average, k.
        bow: of each jet that was off by 1, over the interval's length, see `Firing`, shape (3, n_jets).
    """

    remaining: Array
    by_logarithm: Array
    mean: Array
    bow: Array


def initial_level_decay(lag_ratio: Array) -> Lingering:
    """Computes how a thrust level's deviation from a constant command decays over an interval, from tau / interval."""
    lagged = lag_ratio > 0.0
    remaining = np.exp(-1.0 / select_where(lagged, lag_ratio, 1.0)) * lagged
    mean = lag_ratio * (1.0 - remaining)
    bow = _bow_of_piece(np.ones_like(lag_ratio), _decay_integrals(lag_ratio, mean), mean)
    return Lingering(remaining, remaining / select_where(lagged, lag_ratio, 1.0), mean, bow)


@kernel
def _decay_integrals(lag_ratio: Array, mean_decay: Array) -> tuple[Array, Array, Array]:
    """Computes integrals of E, E x, E^2 (E: lag transient, see module) from tau/h and mean decay k, (n_jets,) each."""
    rest = lag_ratio * (1.0 - mean_decay)
    return rest, lag_ratio * (0.5 - mean_decay + rest), lag_ratio * (rest - 0.5 * mean_decay * mean_decay)


@kernel
def _bow_of_piece(deviation: Array, integrals: tuple[Array, Array, Array], mean_decay: Array) -> Array:
    """Computes each jet's bow (departure of impulse from linear growth) under a constant command, shape (3, n_jets)."""
    plain, by_time, square = integrals
    bow = np.empty((3,) + deviation.shape)  # noqa: RUF005 (for numba)
    bow[0] = deviation * (plain - 0.5 * mean_decay)
    bow[1] = deviation * (by_time - 0.5 * plain - mean_decay / 12.0)
    bow[2] = deviation * np.sqrt(np.maximum(square - mean_decay * (2.0 * by_time - mean_decay / 3.0), 0.0))
    return bow


@kernel
def _moments_of_piece(
    begin_s: float, length_s: float, start_values: tuple[Array, Array, Array], integrals: tuple[Array, Array, Array]
) -> Array:
    """Computes integrals over a piece of each jet's impulse p, of p t and of p^2, shape (3, n_jets)."""
    before, u, d = start_values
    plain, by_time, square = integrals
    first = before + length_s * (0.5 * u + d * plain)
    result = np.empty((3, before.shape[0]))
    result[0] = length_s * first
    result[1] = length_s * (begin_s * first + length_s * (0.5 * before + length_s * (u / 3.0 + d * by_time)))
    result[2] = length_s * (
        before * (2.0 * first - before) + length_s * length_s * (u * (u / 3.0 + 2.0 * d * by_time) + d * d * square)
    )
    return result


@kernel
def _bow_of_interval(moments: Array, seconds: Array, duration_s: float) -> Array:
    """Computes each jet's bow (departure of impulse from linear growth) from its impulse's moments, (3, n_jets)."""
    bow = np.empty_like(moments)
    bow[0] = moments[0] / duration_s - 0.5 * seconds
    bow[1] = (moments[1] / duration_s - 0.5 * moments[0]) / duration_s - seconds / 12.0
    square = (moments[2] - 2.0 * seconds * moments[1] / duration_s) / duration_s + seconds * seconds / 3.0
    bow[2] = np.sqrt(np.maximum(square, 0.0)) * np.sign(bow[0])
    return bow


@kernel
def time_constants(nominal_s: Array, kinds: np.ndarray, sigma: float, errors: Array) -> tuple[Array, Array]:
    """Returns each jet's lag time constant, s, at its kind's error p, and its logarithm's derivative by p.

    The time constant is tau_0 max(1 + sigma p, `LEAST_LAG`), linear in p.

    Args:
        nominal_s: tau_0 of each jet, shape (n_jets,).
        kinds: index of each jet's error, shape (n_jets,).
        sigma: relative 1-sigma of a time constant.
        errors: p of each kind, shape (n_kinds,); none: the nominal ones are taken as known.
    """
    if errors.shape[0] == 0:
        return nominal_s, np.zeros_like(nominal_s)
    factor = np.maximum(1.0 + sigma * errors, LEAST_LAG)[kinds]
    return nominal_s * factor, sigma / factor
