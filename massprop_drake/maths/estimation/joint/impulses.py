r"""How long each jet gave its full thrust over an interval, with lag, and the derivatives of it.

A level l follows its command u as dl/dt = (u - l)/tau. Over a piece of length h with a constant command, with d = l - u
at its start, e = exp(-h/tau) and k = (tau/h)(1 - e),

    integral of l       L  = h (u + d k)
    integral of L       m  = h^2 (u/2 + d (tau/h)(1 - k))
    level at the end    l <- u + d e

and their derivatives by ln tau, with the level's own l', e' = e h/tau and k' = k - e,

    L' = h (d k' + l' k),    l' <- l' e + d e'.

An interval is as many pieces as the commands that share in it: where a time stamp is off its tick, the piece before
the tick still has the command before. The *bow* of an interval of length T is the mean of what the level has given so
far, less its share if it gave all evenly, m/T - L/2, in seconds: that much the rate is off a straight line on average.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from massprop_drake.maths.kernels import kernel
from massprop_drake.maths.linear_algebra import Array

UNKNOWN_LEVEL_VARIANCE = 0.25  # of a level that is 0 or 1 and nobody knows which


class Firing(NamedTuple):
    """What the jets did over an interval.

    Attributes:
        duration_s: length of the interval, T.
        amount: L of each jet, s, shape (n_jets,).
        amount_slope: its derivative by ln tau, s, shape (n_jets,).
        bow: m/T - L/2 of each jet, s, shape (n_jets,).
        variance: of L where the command is not known, s^2, shape (n_jets,).
        level, slope: at the end of the interval, shape (n_jets,) each.
        commanded: whether any jet was commanded, or may have been.
    """

    duration_s: float
    amount: Array
    amount_slope: Array
    bow: Array
    variance: Array
    level: Array
    slope: Array
    commanded: bool


@kernel
def fire(level: Array, slope: Array, time_constants_s: Array, durations_s: Array, commands: Array) -> Firing:
    """What the jets do over an interval that consists of pieces with constant commands.

    Args:
        level: at the start of the interval, shape (n_jets,).
        slope: its derivative by ln tau, shape (n_jets,).
        time_constants_s: of each jet, zero: no lag, shape (n_jets,).
        durations_s: of the pieces, s, positive, shape (n_pieces,).
        commands: fraction commanded in each, NaN where not known, shape (n_pieces, n_jets).
    """
    n_jets = level.shape[0]
    amount, amount_slope, moment = np.zeros(n_jets), np.zeros(n_jets), np.zeros(n_jets)
    variance = np.zeros(n_jets)
    total = 0.0
    commanded = False
    for piece in range(durations_s.shape[0]):
        h = durations_s[piece]
        unknown = np.isnan(commands[piece])
        u = np.where(unknown, 0.5, commands[piece])
        commanded = commanded or bool(np.any(u > 0.0))
        ratio = time_constants_s / h
        lagged = ratio > 0.0
        remaining = np.exp(-1.0 / np.where(lagged, ratio, 1.0)) * lagged
        mean = ratio * (1.0 - remaining)
        d = level - u
        moment += h * amount + h * h * (0.5 * u + d * ratio * (1.0 - mean))
        amount += h * (u + d * mean)
        amount_slope += h * (d * (mean - remaining) + slope * mean)
        remaining_slope = remaining / np.where(lagged, ratio, 1.0)
        slope = slope * remaining + d * remaining_slope
        level = u + d * remaining
        variance += UNKNOWN_LEVEL_VARIANCE * h * h * unknown
        total += h
    return Firing(total, amount, amount_slope, moment / total - 0.5 * amount, variance, level, slope, commanded)


def pieces(start_s: float, end_s: float, ticks_s: Array, commands: Array) -> tuple[Array, Array]:
    """The pieces of an interval in which the command is constant.

    Args:
        start_s, end_s: of the interval.
        ticks_s: when each command began to act, ascending, the first not after the start, shape (n,).
        commands: which then acted until the next tick, shape (n, n_jets).

    Returns:
        Durations, shape (n_pieces,), and commands, shape (n_pieces, n_jets).
    """
    first = max(int(np.searchsorted(ticks_s, start_s, side="right")) - 1, 0)
    last = max(int(np.searchsorted(ticks_s, end_s, side="left")), first + 1)
    edges = np.empty(last - first + 1)
    edges[0], edges[-1] = start_s, end_s
    edges[1:-1] = ticks_s[first + 1 : last]
    return np.diff(edges), commands[first:last]


@kernel
def time_constants(nominal_s: Array, kinds: np.ndarray, sigma: float, errors: Array) -> tuple[Array, Array]:
    """Each jet's time constant at the estimated error of its kind, and the derivative of its logarithm by that error.

    The time constant is tau_0 max(1 + sigma p, 0.05), linear in p.

    Args:
        nominal_s: tau_0 of each jet, shape (n_jets,).
        kinds: index of each jet's error, shape (n_jets,).
        sigma: relative 1-sigma of a time constant.
        errors: p of each kind, shape (n_kinds,); none: the nominal ones are taken as known.
    """
    if errors.shape[0] == 0:
        return nominal_s, np.zeros_like(nominal_s)
    factor = np.maximum(1.0 + sigma * errors, 0.05)[kinds]
    return nominal_s * factor, sigma / factor
