"""Update and likelihood of quantized readings by the moments of truncated Gaussians.

Equations: theory page of the joint filter, "Readings of a quantizer", with Z, e and v as there. For a narrow cell v
vanishes, and this is the Kalman filter's update. Two bounds keep a Gaussian from being believed beyond its shape: the
floor q/100 covers linearization and arithmetic, and one cell leaves at least half of the variance, or what rounding
taken for uniform noise leaves if that is less.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from massprop_drake.maths.kernels import kernel
from massprop_drake.maths.linear_algebra import Array

FLOOR = 0.01  # of the quantum, 1 sigma: linearization and arithmetic; calibrates the likelihood
DITHER = 0.05  # of the quantum, 1 sigma: noise above which each sample is news, and not only a change of reading
_LEAST_LEFT = 0.5  # of the variance: at a quarter, one flight in 500 becomes sure of what is false
_MOST_LEFT = 1.0 - 1e-9  # of the variance: a cell that says nothing
# Nodes and weights of the quadrature over what of a cell bears probability, exact to rounding.
_NODES, _WEIGHTS = (0.5 * of for of in np.polynomial.legendre.leggauss(24))
_SPENT = 36.0  # nats below a tail's beginning from which on nothing of it is left, to rounding
_ROOT_2 = math.sqrt(2.0)
_LOG_ROOT_2_PI = 0.5 * math.log(2.0 * math.pi)


class Moments(NamedTuple):
    """Moments of a standard normal variable that is known to lie in an interval.

    Attributes:
        log_probability: of the interval, nats.
        mean: e.
        variance: v.
    """

    log_probability: float
    mean: float
    variance: float


class Sites(NamedTuple):
    """Gaussian measurements that stand for quantized readings, in the order in which they were taken in.

    Attributes:
        innovation: each reading's offset from its prediction before all of them, shape (m,).
        variance: of each as a measurement, shape (m,).
        log_likelihood: of each given those before it, nats, shape (m,).
        nis: e^2 of each, shape (m,).
        degrees: 1 - v of each, the expectation of e^2, shape (m,).
    """

    innovation: Array
    variance: Array
    log_likelihood: Array
    nis: Array
    degrees: Array


@kernel
def truncated_moments(lower: float, upper: float) -> Moments:
    """Returns log probability, mean and variance of a standard normal variable truncated to an interval.

    Args:
        lower, upper: bounds, lower < upper.
    """
    if lower + upper < 0.0:
        mirrored = _upper_moments(-upper, -lower)
        return Moments(mirrored.log_probability, -mirrored.mean, mirrored.variance)
    return _upper_moments(lower, upper)


@kernel
def _upper_moments(lower: float, upper: float) -> Moments:
    """Returns moments of N(0, 1) truncated to an interval whose middle is not negative."""
    width = upper - lower
    if not 0.0 < width < math.inf:  # of a filter that has overflowed, or is off by more than arithmetic resolves
        return Moments(math.nan, math.nan, math.nan)
    if lower > 1.0 or width < 1.0:  # a narrow cell or a tail, where differences between the bounds lose digits
        return _moments_by_quadrature(lower, width)
    if lower > 0.0:
        probability = 0.5 * (math.erfc(lower / _ROOT_2) - math.erfc(upper / _ROOT_2))
    else:
        probability = 0.5 * (math.erf(upper / _ROOT_2) - math.erf(lower / _ROOT_2))
    at_lower = math.exp(-0.5 * lower * lower - _LOG_ROOT_2_PI) / probability
    at_upper = math.exp(-0.5 * upper * upper - _LOG_ROOT_2_PI) / probability
    mean = at_lower - at_upper
    variance = 1.0 + lower * at_lower - upper * at_upper - mean * mean
    return Moments(math.log(probability), mean, variance)


@kernel
def _moments_by_quadrature(lower: float, width: float) -> Moments:
    """Returns moments of N(0, 1) truncated to a narrow cell, or a wide one's probable part, by quadrature."""
    if lower > 0.0:
        width = min(width, 2.0 * _SPENT / (lower + math.sqrt(lower * lower + 2.0 * _SPENT)))
    offset = width * (0.5 + _NODES)
    weight = _WEIGHTS * np.exp(-offset * (lower + 0.5 * offset))
    inside = weight.sum()
    mean = float(weight @ offset) / inside
    deviation = offset - mean
    variance = float(weight @ (deviation * deviation)) / inside
    log_probability = math.log(width * inside) - 0.5 * lower * lower - _LOG_ROOT_2_PI
    return Moments(log_probability, lower + mean, variance)


@kernel
def match_moments(errors: Array, covariance: Array, quanta: Array, floors: Array) -> Sites:
    """Converts quantized readings, taken in turn, to Gaussian measurements of equal posterior moments, shape (m,).

    Args:
        errors: readings less their predictions, shape (m,).
        covariance: of the predictions, without the readings' own, shape (m, m).
        quanta: q of each reading, 0: not quantized, shape (m,).
        floors: R0 of each reading, positive, shape (m,).
    """
    m = errors.shape[0]
    innovation, variance, log_likelihood = np.zeros(m), np.zeros(m), np.zeros(m)
    nis, degrees = np.zeros(m), np.zeros(m)
    shift, left = np.zeros(m), covariance.copy()
    for j in range(m):
        known, half = max(left[j, j], 0.0), 0.5 * quanta[j]
        total = known + floors[j]
        sigma = math.sqrt(total)
        error = errors[j] - shift[j]
        if half > 0.0:
            moments = truncated_moments((error - half) / sigma, (error + half) / sigma)
            log_probability, mean, exact = moments.log_probability, moments.mean, moments.variance
        else:
            mean, exact = error / sigma, 0.0
            log_probability = -0.5 * mean * mean - _LOG_ROOT_2_PI - math.log(sigma)
        uniform = quanta[j] ** 2 / 12.0
        least = min(_LEAST_LEFT, uniform / (total + uniform))
        kept = min(max(exact, least), _MOST_LEFT)
        told = 1.0 - kept
        variance[j] = (floors[j] + kept * known) / told
        innovation[j] = shift[j] + mean * sigma / told
        log_likelihood[j], nis[j], degrees[j] = log_probability, mean * mean, 1.0 - exact
        column = left[:, j].copy()
        shift = shift + column * (mean / sigma)
        left = left - np.outer(column, column) * (told / total)
    return Sites(innovation, variance, log_likelihood, nis, degrees)
