r"""Flow through valves between two moments, commands acting late and through a first-order lag.

A command that holds from t_i to t_(i+1) acts from t_i + d, or t_i + d + delta where it opens the valve, to
t_(i+1) + d. With L(t) = 1 - e^(-t/tau) and its integrals S and SS, zero before zero,

    J  = integral of the level l(t) over the interval = sum u_i [S(t1 - on) - S(t0 - on) - S(t1 - off) + S(t0 - off)]
    JJ = integral of (t1 - t) l(t)                    = likewise with SS(t1 - .) - SS(t0 - .) - (t1 - t0) S(t0 - .)

J is what velocity gathers of a unit of acceleration, JJ what position does. Derivatives by d, ln tau and delta are
exact.

J is straight in d only until an edge leaves the interval, and then does not go with it at all. Where d is not known to
a fraction of the interval, it is taken as what is linear on average over what is known of d (statistical
linearization, by three nodes of Gauss and Hermite), and what is left of it is noise.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from massprop_drake.maths.estimation.pose.pose_layout import Commands
from massprop_drake.maths.linear_algebra import Array

_INSTANT_S = 1e-9  # a lag below this is none
_OVER = 40.0  # lags after which a command is over, to the last bit
_SURE = 0.02  # of the interval: a delay that is known to that is linear enough
_NODES, _WEIGHTS = np.sqrt(3.0) * np.array([-1.0, 0.0, 1.0]), np.array([1.0, 4.0, 1.0]) / 6.0


class OpeningTimes(NamedTuple):
    """Timing of valves after their commands, of each jet, shape (n_filters, n_jets) each.

    Attributes:
        delay_s: d.
        lag_s: tau.
        opening_s: delta; negative: pulses are longer than commanded.
    """

    delay_s: Array
    lag_s: Array
    opening_s: Array


class Openings(NamedTuple):
    """Integrals of the jets' thrust over an interval, s of full thrust and s^2, shape (n_filters, n_jets) each.

    Attributes:
        once, twice: J and JJ.
        once_by, twice_by: their derivatives by d, ln tau and delta, shape (3, n_filters, n_jets).
        variance: of J where commands are not known, s^2.
        begins: whether a pulse begins in the interval.
        unsure: of J what is not linear in the delay, at several delays, each times the root of its probability,
            shape (n_nodes, n_filters, n_jets); empty: nothing.
    """

    once: Array
    twice: Array
    once_by: Array
    twice_by: Array
    variance: Array
    begins: np.ndarray
    unsure: Array


class _StepIntegrals(NamedTuple):
    """Integrals L, S and SS, and the derivatives of S and SS by ln tau."""

    level: Array
    once: Array
    twice: Array
    once_by: Array
    twice_by: Array


def _step_response_integrals(since_s: Array, lag_s: Array) -> _StepIntegrals:
    """Computes a first-order lag's step response, its single and double integrals, and derivatives by ln tau."""
    time_s = np.maximum(since_s, 0.0)
    left = np.exp(-time_s / lag_s)
    level = 1.0 - left
    once = time_s - lag_s * level
    twice = 0.5 * time_s**2 - lag_s * once
    once_by = lag_s * (time_s / lag_s * left - level)
    twice_by = -lag_s * once - lag_s * once_by
    return _StepIntegrals(level, once, twice, once_by, twice_by)


def average_openings(
    commands: Commands, span_s: tuple[float, float], timing: OpeningTimes, delay_std_s: Array
) -> Openings:
    """Computes single and double time integrals of jets' relative thrust, averaged over an uncertain command delay.

    Args:
        span_s: begin and end of the interval.
        delay_std_s: 1-sigma of the delays, shape (n_filters, n_jets).
    """
    latest_s = float(timing.delay_s.max() + _NODES[-1] * delay_std_s.max() + _OVER * timing.lag_s.max())
    commands = _commands_since(commands, span_s[0] - latest_s)
    if not (delay_std_s > _SURE * (span_s[1] - span_s[0])).any():
        return openings_between(commands, *span_s, timing)
    count, nodes = delay_std_s.shape[0], _NODES.size
    spread = np.concatenate([timing.delay_s + node * delay_std_s for node in _NODES])
    others = (np.tile(part, (nodes, 1)) for part in timing[1:])
    every = openings_between(commands, *span_s, OpeningTimes(spread, *others))
    stacked = [part.reshape(*part.shape[:-2], nodes, count, -1) for part in every[:5]]
    once, twice, once_by, twice_by, variance = (np.tensordot(_WEIGHTS, part, (0, part.ndim - 3)) for part in stacked)
    begins = every.begins.reshape(nodes, count, -1)[nodes // 2]
    known = delay_std_s > 0.0
    over = np.where(known, delay_std_s, 1.0)
    for mean, part in ((once_by, stacked[0]), (twice_by, stacked[1])):
        mean[0] = np.where(known, np.tensordot(_WEIGHTS * _NODES, part, 1) / over, mean[0])
    straight = once + _NODES[:, None, None] * (delay_std_s * once_by[0])
    unsure = np.sqrt(_WEIGHTS)[:, None, None] * (stacked[0] - straight)
    return Openings(once, twice, once_by, twice_by, variance, begins, unsure)


def _commands_since(commands: Commands, time_s: float) -> Commands:
    """Returns the commands that hold after a time, s, with the one before them."""
    first = max(int(np.searchsorted(commands.time_s[1:], time_s)) - 1, 0)
    return Commands(commands.time_s[first:], commands.levels[first:])


def openings_between(commands: Commands, begin_s: float, end_s: float, timing: OpeningTimes) -> Openings:
    """Computes single and double time integrals of jets' relative thrust, and derivatives by the valves' timing.

    Where a command is not known, the jet is taken to have been half open, with the variance of anything between
    closed and open.

    Args:
        commands: see `Commands`; what they said before the first row is taken for nothing.
        begin_s, end_s: of the interval.
    """
    unknown = np.isnan(commands.levels)
    levels = np.where(unknown, 0.5, commands.levels)
    previous_levels = np.vstack((np.zeros_like(levels[:1]), levels[:-1]))
    opens = (levels > 0.0) & (previous_levels == 0.0)
    ends = np.append(commands.time_s[1:], np.inf)
    delay, lag = timing.delay_s[:, None], np.maximum(timing.lag_s, _INSTANT_S)[:, None]
    off = ends[:, None] + delay
    opening_delay = np.where(opens, timing.opening_s[:, None], 0.0)
    on = np.minimum(commands.time_s[:, None] + delay + opening_delay, off)
    clipped = commands.time_s[:, None] + delay + opening_delay >= off
    duration = end_s - begin_s

    def edge_integrals(edge: Array) -> tuple[Array, Array, Array, Array, Array, Array]:
        """Integrates the lagged response to a unit step at an edge once and twice; then derivatives by edge, ln tau."""
        at_end, at_begin = _step_response_integrals(end_s - edge, lag), _step_response_integrals(begin_s - edge, lag)
        once = at_end.once - at_begin.once
        twice = at_end.twice - at_begin.twice - duration * at_begin.once
        by_edge = at_begin.level - at_end.level
        twice_by_edge = at_begin.once - at_end.once + duration * at_begin.level
        once_by = at_end.once_by - at_begin.once_by
        twice_by = at_end.twice_by - at_begin.twice_by - duration * at_begin.once_by
        return once, twice, by_edge, twice_by_edge, once_by, twice_by

    begun, ended = edge_integrals(on), edge_integrals(off)
    once, twice, delay_once, delay_twice, lag_once, lag_twice = (
        np.sum(levels * (a - b), axis=1) for a, b in zip(begun, ended, strict=True)
    )
    moves = opens & ~clipped
    late_once, late_twice = (np.sum(np.where(moves, levels * part, 0.0), axis=1) for part in begun[2:4])
    variance = np.sum(np.where(unknown, (begun[0] - ended[0]) ** 2 / 12.0, 0.0), axis=1)
    return Openings(
        once,
        twice,
        np.stack((delay_once, lag_once, late_once)),
        np.stack((delay_twice, lag_twice, late_twice)),
        variance,
        np.any(moves & (on > begin_s) & (on <= end_s), axis=1),
        np.zeros((0, *once.shape)),
    )
