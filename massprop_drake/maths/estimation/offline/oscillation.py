r"""Mode inside the vehicle that a flight's residuals show: its frequency, and the walk that would cover it.

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
from collections.abc import Iterator, Sequence
from functools import cache
from itertools import product
from operator import attrgetter
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from massprop_drake.maths.estimation.chi_square import chi_square_limit
from massprop_drake.maths.estimation.offline.flight_model import FlightModel, Stretch
from massprop_drake.maths.estimation.offline.normal_equations import Residuals, accumulating_noise, residuals
from massprop_drake.maths.estimation.offline.regression import FlightFit
from massprop_drake.maths.linear_algebra import Array

_DAMPING = 0.02  # ratio, of slosh in a bare tank or a panel, by which the frequency is found
_DAMPINGS = (0.003, 0.01, 0.02, 0.04, 0.08)  # that are tried then: more is behind baffles
_LEAST_TURNS = 2.0  # of a mode in the longest stretch: slower motion looks like forces that change slowly
_MOST = 0.4  # of the sample frequency
_STEPS_PER_LINE = 2.0  # of the grid in each reciprocal length of the longest stretch
_MOST_STEPS = 300  # a compute budget
_NEIGHBORS = 3  # lines of which a mean is taken, so that chance in one of them does not rule
_RATE = 2e-5  # at which a component's lines exceed what is stated by chance: ten of them, one flight in 5000
_FEWEST = 16  # readings, below which a component shows no line
_FINER = 4  # steps of the grid's own between two of it, about the best


class OscillationMode(NamedTuple):
    """The mode that explains residuals best.

    Attributes:
        frequency_hz: undamped, Hz.
        damping: ratio.
        misfit: sum of squares left with it, in units of a reading's variance.
        readings: how many, less what is fitted to each component.
        change: of the unknowns, with the mode in place of what stood for it, shape (n,).
    """

    frequency_hz: float
    damping: float
    misfit: float
    readings: float
    change: Array


class _Part(NamedTuple):
    """Stretch linearized about the fit."""

    time_s: Array  # since its beginning, (m,)
    steps: Array  # of the structure's acceleration at each row, (6, m)
    components: list[Residuals]


class _Linearized(NamedTuple):
    """All stretches about the fit, and their normal equations in units of the prior."""

    parts: list[_Part]  # with derivatives by what is fitted, each in units of its 1-sigma
    size: int  # n, of all unknowns
    free: NDArray[np.int_]  # those that are fitted, (f,)
    sigma: Array  # 1-sigma of these, (f,)
    information: Array  # (f, f)
    vector: Array  # (f,)
    misfit: float


def strongest_mode(stretches: Sequence[Stretch], fit: FlightFit, model: FlightModel) -> OscillationMode | None:
    """Finds the oscillation whose fit leaves the least misfit; None where stretches are too short to show one.

    Its frequency is found on a grid at one damping, and both more finely about the best.

    Args:
        stretches: of the flight.
        fit: about which all is taken.
    """
    flight = _combine_stretches([_linearize_stretch(stretch, fit.at, model) for stretch in stretches], fit, model)
    longest_s = max((part.time_s[-1] for part in flight.parts), default=0.0)
    frequencies = _frequencies(longest_s, model.period_s)
    if not frequencies.size:
        return None
    misfit = attrgetter("misfit")
    best = min((_fit_mode(flight, one, _DAMPING) for one in frequencies.tolist()), key=misfit)
    place = int(np.searchsorted(frequencies, best.frequency_hz))
    about = frequencies[max(place - 1, 0) : place + 2]
    finer = np.linspace(about[0], about[-1], _FINER * about.size).tolist()
    best = min((best, *(_fit_mode(flight, *pair) for pair in product(finer, _DAMPINGS))), key=misfit)
    return best if best.frequency_hz * longest_s >= _LEAST_TURNS else None


def misfit_of(stretches: Sequence[Stretch], fit: FlightFit, model: FlightModel) -> tuple[float, float]:
    """Computes a fit's sum of squared residuals, in units of their variance, and their number less components."""
    components = [one for stretch in stretches for one in residuals(stretch, fit.at, model)[0]]
    return sum(float(one.left @ one.left) for one in components), sum(one.rows.size - 1.0 for one in components)


def covering_walk(
    stretches: Sequence[Stretch], fit: FlightFit, model: FlightModel, correction: Array
) -> tuple[float, float]:
    """Computes 1-sigmas of random walks of rate and velocity that cover the residuals' spectra, unknowns corrected.

    Args:
        stretches: of the flight.
        fit: about which all is taken.
        correction: of the unknowns, by which residuals change to first order, shape (n,).

    Returns:
        Of the rate, rad/s/sqrt(s), and of the velocity, ft/s/sqrt(s) or m/s/sqrt(s), 1-sigma after one second, the
        largest of all components; zero where readings scatter by their noise alone.
    """
    walks = np.zeros(2)
    for one, lines in _component_spectra(stretches, fit, model, correction):
        kind = int(one.package >= model.gyros)
        above = lines.power > _chance_limit(lines.power.size) * lines.noise
        excess = np.where(above, lines.power - lines.noise, 0.0)
        walks[kind] = max(walks[kind], one.scale * math.sqrt(float(excess.max(initial=0.0))))
    return float(walks[0]), float(walks[1])


def is_covered(stretches: Sequence[Stretch], fit: FlightFit, model: FlightModel) -> bool:
    """Tests whether stated noise, walks and disturbance explain the spectra of residuals, but for chance."""
    every = _component_spectra(stretches, fit, model, np.zeros_like(fit.at))
    return all(bool((lines.power <= _allowed_power(one, lines, fit, model)).all()) for one, lines in every)


def _allowed_power(component: Residuals, lines: Lines, fit: FlightFit, model: FlightModel) -> Array:
    """Computes the largest power that stated noise, walks and disturbance explain, per line, shape (k,).

    A mean of lines of which one has most of the power scatters as that one does: what hardly changes over a flight is
    one number, drawn once.
    """
    noise = accumulating_noise(component.package, component.axis, fit.at, model)
    each = noise.walk + noise.acting * gauss_markov_spectrum(noise.time_constant_s, lines)
    each = each + white_noise_spectrum(lines.intervals, lines.length_s)
    degrees = np.full(each.size, 2.0)
    degrees[0] = 1.0  # of a frequency of zero there is no phase
    expected = _means_of_neighbors(each)
    rounded = np.floor(expected**2 / (_means_of_neighbors(each**2 / degrees) / _NEIGHBORS)).astype(int)
    return expected * np.array([_chance_limit(lines.power.size, component) for component in rounded.tolist()])


def gauss_markov_spectrum(constant_s: float, lines: Lines) -> Array:
    """Computes the power spectrum of a rate whose derivative is a unit-variance Gauss-Markov process.

    Args:
        constant_s: time constant of the process.
        lines: of a component, for how many and how long its intervals are.

    Returns:
        Before means of neighbors are taken, shape (k + 2,).
    """
    lags = np.arange(lines.intervals)
    weights = (1.0 - lags / lines.intervals) * np.exp(-lags * lines.length_s / constant_s) * lines.length_s
    every: Array = 2.0 * np.fft.fft(weights).real - weights[0]
    return every[: lines.intervals // 2 + 1]


def white_noise_spectrum(n_intervals: int, length_s: float) -> Array:
    """Computes the power of increments of unit white noise, before averaging lines, shape (k + 2,)."""
    angles = 2.0 * np.pi * np.arange(n_intervals // 2 + 1) / n_intervals
    return 2.0 * (1.0 - np.cos(angles)) / length_s


class Lines(NamedTuple):
    """Power of the increments of residuals, frequency by frequency, means of neighbors.

    Attributes:
        power: of the residuals, of a walk its variance in one second, shape (k,).
        noise: expected of white noise of one, shape (k,).
        intervals, length_s: how many increments there are, and the time of each.
    """

    power: Array
    noise: Array
    intervals: int
    length_s: float


def increment_spectrum(values: Array, time_s: Array) -> Lines:
    """Computes the power spectrum of increments of residuals, (n,), at times, s, (n,), lines averaged."""
    count = values.size - 1
    length_s = float(time_s[-1] - time_s[0]) / count
    evenly = np.interp(time_s[0] + length_s * np.arange(count + 1), time_s, values)
    power = np.abs(np.fft.rfft(np.diff(evenly))) ** 2 / (count * length_s)
    noise = white_noise_spectrum(count, length_s)
    return Lines(_means_of_neighbors(power), _means_of_neighbors(noise), count, length_s)


def _means_of_neighbors(power: Array) -> Array:
    """Computes moving averages of a few neighboring lines of a power spectrum."""
    return np.convolve(power, np.full(_NEIGHBORS, 1.0 / _NEIGHBORS), "valid")


def _component_spectra(
    stretches: Sequence[Stretch], fit: FlightFit, model: FlightModel, correction: Array
) -> Iterator[tuple[Residuals, Lines]]:
    """Yields residuals, and their increments' spectrum once unknowns are corrected, per component with enough rows."""
    for stretch in stretches:
        for one in residuals(stretch, fit.at, model)[0]:
            if one.rows.size >= _FEWEST:
                yield one, increment_spectrum(one.left - correction @ one.derivatives, stretch.time_s[one.rows])


@cache
def _chance_limit(n_lines: int, degrees: int = 2 * _NEIGHBORS) -> float:
    """Computes the ratio of averaged power to its expectation that chance exceeds at rate `_RATE`."""
    return chi_square_limit(_RATE / n_lines, degrees) / degrees


def _frequencies(length_s: float, period_s: float) -> Array:
    """Returns the grid of frequencies that a record's length and period resolve, Hz; may be empty."""
    least, most = 1.0 / max(length_s, period_s), _MOST / period_s
    if least >= most:
        return np.zeros(0)
    count = min(math.ceil((most - least) * length_s * _STEPS_PER_LINE), _MOST_STEPS)
    lines = least + np.arange(count) / (_STEPS_PER_LINE * length_s)
    if lines[-1] < most:  # a long flight: as fine as it can tell below, coarser above
        lines = np.geomspace(least, most, _MOST_STEPS)
    return lines


def _linearize_stretch(stretch: Stretch, unknowns: Array, model: FlightModel) -> _Part:
    """Computes residuals of a stretch, derivatives, and the steps of its expected acceleration."""
    (components, moved), time_s = residuals(stretch, unknowns, model), stretch.time_s - stretch.time_s[0]
    return _Part(time_s, np.diff(np.diff(moved) / np.diff(time_s), prepend=0.0, append=0.0), components)


def mode_response(steps: Array, time_s: Array, frequency_hz: float, damping: float) -> Array:
    """Computes rates q' of an oscillation, at rest at first, driven by steps of acceleration, shape (k, m).

    Args:
        steps: of the acceleration at each row, shape (k, m).
        time_s: of the rows, equally spaced, from zero on, shape (m,).
        frequency_hz: undamped, Hz.
        damping: ratio, below one.
    """
    omega = 2.0 * math.pi * frequency_hz
    damped = omega * math.sqrt(1.0 - damping**2)
    answer = -np.exp(-damping * omega * time_s) * np.sin(damped * time_s) / damped
    size = 2 * time_s.size
    return np.fft.irfft(np.fft.rfft(steps, size) * np.fft.rfft(answer, size), size)[:, : time_s.size]


def _combine_stretches(parts: list[_Part], fit: FlightFit, model: FlightModel) -> _Linearized:
    """Sums the normal equations of stretches' residuals and of the prior, unknowns in its 1-sigmas."""
    free = np.flatnonzero(model.sigma > 0.0)
    sigma = model.sigma[free]
    information, vector = np.eye(free.size), (model.prior[free] - fit.at[free]) / sigma
    misfit = 0.0
    scaled = []
    for part in parts:
        components = [one._replace(derivatives=one.derivatives[free] * sigma[:, None]) for one in part.components]
        for one in components:
            information += one.derivatives @ one.derivatives.T
            vector += one.derivatives @ one.left
            misfit += float(one.left @ one.left)
        scaled.append(part._replace(components=components))
    return _Linearized(scaled, fit.at.size, free, sigma, information, vector, misfit)


def _fit_mode(flight: _Linearized, frequency_hz: float, damping: float) -> OscillationMode:
    """Fits an oscillation to all components, unknowns fitted again; returns it with the misfit left."""
    information, vector, misfit = flight.information.copy(), flight.vector.copy(), flight.misfit
    readings = 0.0
    for part in flight.parts:
        of_jets = mode_response(part.steps, part.time_s, frequency_hz, damping)
        columns = np.vstack((of_jets, _free_motion(part, frequency_hz, damping)))
        for one in part.components:
            basis = _orthonormal_basis(columns[:, one.rows])
            along = one.derivatives @ basis.T
            left = one.left @ basis.T
            information -= along @ along.T
            vector -= along @ left
            misfit -= float(left @ left)
            readings += one.rows.size - 1 - basis.shape[0]
    step = np.linalg.solve(information, vector)
    change = np.zeros(flight.size)
    change[flight.free] = step * flight.sigma
    return OscillationMode(frequency_hz, damping, max(misfit - float(vector @ step), 0.0), max(readings, 1.0), change)


def _free_motion(part: _Part, frequency_hz: float, damping: float) -> Array:
    """Computes the free decay of an oscillation in two phases, shape (2, m)."""
    omega = 2.0 * math.pi * frequency_hz
    angle = omega * math.sqrt(1.0 - damping**2) * part.time_s
    return np.exp(-damping * omega * part.time_s) * np.array([np.cos(angle), np.sin(angle)])


def _orthonormal_basis(columns: Array) -> Array:
    """Computes an orthonormal basis of rows' span, their means subtracted, shape (k, r)."""
    off = columns - columns.mean(axis=1, keepdims=True)
    size = np.linalg.norm(off, axis=1)
    off = off[size > 1e-12 * size.max(initial=1e-300)]
    off /= np.linalg.norm(off, axis=1)[:, None]
    values, vectors = np.linalg.eigh(off @ off.T)  # few columns, many rows
    kept = values > 1e-10
    return np.asarray((vectors[:, kept] / np.sqrt(values[kept])).T @ off)
