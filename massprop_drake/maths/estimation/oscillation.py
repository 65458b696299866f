r"""A mode inside the vehicle that a flight's residuals show: its frequency, and the walk that would cover it.

Something that moves on a spring, such as sloshing propellant or a hinged panel, is driven by the acceleration u of the
structure, and gives back the force of its spring and damper:

    q'' + 2 zeta w q' + w^2 q = -u,    integral of (2 zeta w q' + w^2 q) dt = -q' - integral of u dt.

The integral of u is what the jets give, and so part of what a fit explains by mass properties. What is left of a rate
or velocity is thus proportional to q', one coefficient for each component of u and each component that is read. These
coefficients, and motion of q from before the stretch, are eliminated; for each w and zeta of a grid the mass properties
and whatever else is reckoned with are fitted once more. All is linear about the fit.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from massprop_drake.maths.estimation.hindsight import Fit, Model, Residuals, Stretch, residuals
from massprop_drake.maths.linear_algebra import Array

_DAMPING = (0.005, 0.02, 0.08)  # ratios that are tried: of slosh in a bare tank, of a panel, of slosh behind baffles
_LEAST_TURNS = 2.0  # of a mode in the longest stretch: slower motion looks like forces that change slowly
_MOST = 0.4  # of the sample frequency
_STEPS_PER_LINE = 2.0  # of the grid in each reciprocal length of the longest stretch
_MOST_STEPS = 400  # a compute budget


class Mode(NamedTuple):
    """The mode that explains residuals best.

    Attributes:
        frequency_hz: undamped, Hz.
        damping: ratio.
        misfit: sum of squares left with it, in units of a reading's variance.
        readings: how many, less what is fitted to each component.
    """

    frequency_hz: float
    damping: float
    misfit: float
    readings: float


class _Part(NamedTuple):
    """A stretch about the fit."""

    time_s: Array  # since its beginning, (m,)
    steps: Array  # of the structure's acceleration at each row, (6, m)
    components: list[Residuals]


def strongest_mode(stretches: Sequence[Stretch], fit: Fit, model: Model) -> Mode | None:
    """The mode that leaves least unexplained; None where it is too slow for the stretches to show that it returns.

    Args:
        stretches: of the flight.
        fit: about which all is taken.
        model: see `hindsight.Model`.
    """
    parts = [_part(stretch, fit.at, model) for stretch in stretches]
    longest_s = max((part.time_s[-1] for part in parts), default=0.0)
    frequencies = _frequencies(longest_s, model.period_s)
    if not frequencies.size:
        return None
    found = [_with_mode(parts, fit, model, *pair) for pair in product(frequencies.tolist(), _DAMPING)]
    best = min(found, key=lambda one: one.misfit)
    return best if best.frequency_hz * longest_s >= _LEAST_TURNS else None


def covering_walk(stretches: Sequence[Stretch], fit: Fit, model: Model) -> tuple[float, float]:
    """The random walks whose increments are as large as those of the residuals, over whatever time.

    Returns:
        Of the rate, rad/s/sqrt(s), and of the velocity, ft/s/sqrt(s) or m/s/sqrt(s), 1-sigma after one second, the
        largest of all components; zero where readings scatter by their noise alone.
    """
    walks = np.zeros(2)
    for stretch in stretches:
        for one in _part(stretch, fit.at, model).components:
            kind = int(one.package >= model.gyros)
            walks[kind] = max(walks[kind], one.scale * _walk(one, stretch.time_s))
    return float(walks[0]), float(walks[1])


def _walk(one: Residuals, time_s: Array) -> float:
    """The walk of a component in units of a reading's 1-sigma, over spans of one row, two, four, up to a quarter."""
    largest, span = 0.0, 1
    while span <= one.rows.size // 4:
        gained = one.left[span:] - one.left[:-span]
        length_s = float(np.mean(time_s[one.rows[span:]] - time_s[one.rows[:-span]]))
        largest = max(largest, (float(np.mean(gained**2)) - 2.0) / length_s)  # two readings' own noise taken off
        span *= 2
    return math.sqrt(largest)


def _frequencies(length_s: float, period_s: float) -> Array:
    """Frequencies that a flight can tell apart, from one turn on, Hz."""
    least, most = 1.0 / max(length_s, period_s), _MOST / period_s
    if least >= most:
        return np.zeros(0)
    count = min(math.ceil((most - least) * length_s * _STEPS_PER_LINE), _MOST_STEPS)
    lines = least + np.arange(count) / (_STEPS_PER_LINE * length_s)
    if lines[-1] < most:  # a long flight: as fine as it can tell below, coarser above
        lines = np.geomspace(least, most, _MOST_STEPS)
    return lines


def _part(stretch: Stretch, at: Array, model: Model) -> _Part:
    components, moved = residuals(stretch, at, model)
    time_s = stretch.time_s - stretch.time_s[0]
    acceleration = np.diff(moved) / np.diff(time_s)
    steps = np.diff(acceleration, prepend=0.0, append=0.0)
    return _Part(time_s, steps, components)


def driven(steps: Array, time_s: Array, frequency_hz: float, damping: float) -> Array:
    """Rates q' of a mode that is at rest before, driven by steps of an acceleration.

    Args:
        steps: of the acceleration at each row, shape (k, m).
        time_s: of the rows, equally spaced, from zero on, shape (m,).
        frequency_hz: undamped, Hz.
        damping: ratio, below one.

    Returns:
        Shape (k, m).
    """
    omega = 2.0 * math.pi * frequency_hz
    damped = omega * math.sqrt(1.0 - damping**2)
    answer = -np.exp(-damping * omega * time_s) * np.sin(damped * time_s) / damped
    size = 2 * time_s.size
    moved: Array = np.fft.irfft(np.fft.rfft(steps, size) * np.fft.rfft(answer, size), size)[:, : time_s.size]
    return moved


def _with_mode(parts: Sequence[_Part], fit: Fit, model: Model, frequency_hz: float, damping: float) -> Mode:
    """What is left once the coefficients of a mode are fitted to every component, and the unknowns once more."""
    free = np.flatnonzero(model.sigma > 0.0)
    sigma = model.sigma[free]
    information = np.eye(free.size)
    vector = (model.prior[free] - fit.at[free]) / sigma
    misfit = readings = 0.0
    for part in parts:
        of_jets = driven(part.steps, part.time_s, frequency_hz, damping)
        columns = np.vstack((of_jets, _ringing(part, frequency_hz, damping)))
        for one in part.components:
            basis = _orthonormal(columns[:, one.rows])
            x = one.derivatives[free] * sigma[:, None]
            along, left = x @ basis.T, one.left @ basis.T
            information += x @ x.T - along @ along.T
            vector += x @ one.left - along @ left
            misfit += float(one.left @ one.left - left @ left)
            readings += one.rows.size - 1 - basis.shape[0]
    gained = vector @ np.linalg.solve(information, vector)
    return Mode(frequency_hz, damping, max(misfit - float(gained), 0.0), max(readings, 1.0))


def _ringing(part: _Part, frequency_hz: float, damping: float) -> Array:
    """Free motion of a mode from before the stretch, two phases, shape (2, m)."""
    omega = 2.0 * math.pi * frequency_hz
    angle = omega * math.sqrt(1.0 - damping**2) * part.time_s
    ringing: Array = np.exp(-damping * omega * part.time_s) * np.array([np.cos(angle), np.sin(angle)])
    return ringing


def _orthonormal(columns: Array) -> Array:
    """An orthonormal basis of functions of the rows, means taken off, shape (k, r)."""
    off = columns - columns.mean(axis=1, keepdims=True)
    size = np.linalg.norm(off, axis=1)
    off = off[size > 1e-12 * size.max(initial=1e-300)]
    left, values, right = np.linalg.svd(off / np.linalg.norm(off, axis=1)[:, None], full_matrices=False)
    del left
    kept: NDArray[np.bool_] = values > 1e-6 * values.max(initial=1.0)
    return np.asarray(right[kept])
