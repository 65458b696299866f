"""Figures of merit of failure detection and estimation over many cases, each with its 95 % interval.

Rates by exact Poisson bounds, shares by the Clopper-Pearson interval, delays as Kaplan-Meier curves of the time to
detection with cases that ended undetected censored.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import stats

Array = NDArray[np.float64]

CONFIDENCE = 0.95


class Figure(NamedTuple):
    """A figure with its 95 % interval.

    Attributes:
        value: the figure itself; NaN where there is nothing to measure it on.
        low, high: bounds of the interval.
        n: what it was measured on: cases, events or hours.
    """

    value: float
    low: float
    high: float
    n: float


_NOTHING = Figure(math.nan, math.nan, math.nan, 0)


def rate(events: int, exposure: float) -> Figure:
    """Events per unit of exposure, with exact Poisson bounds; without events the upper one is 3.0 / exposure.

    The bounds are one-sided where there is no event (so that 'none in T hours' gives the usual 3 / T), two-sided
    otherwise.

    Args:
        events: how many.
        exposure: time or other measure over which they were counted, above zero.
    """
    if not exposure > 0.0:
        return _NOTHING
    if events == 0:
        return Figure(0.0, 0.0, -math.log(1.0 - CONFIDENCE) / exposure, exposure)
    tail = 0.5 * (1.0 - CONFIDENCE)
    low = 0.5 * stats.chi2.ppf(tail, 2 * events)
    high = 0.5 * stats.chi2.ppf(1.0 - tail, 2 * events + 2)
    return Figure(events / exposure, float(low) / exposure, float(high) / exposure, exposure)


def share(successes: int, n: int) -> Figure:
    """A share of n independent cases, with its Clopper-Pearson interval."""
    if n == 0:
        return _NOTHING
    interval = stats.binomtest(successes, n).proportion_ci(CONFIDENCE, method="exact")
    return Figure(successes / n, float(interval.low), float(interval.high), n)


def mean(values: Sequence[float]) -> Figure:
    """A mean, with its interval by Student's t."""
    x = np.asarray(values, dtype=float)
    if x.size < 2:
        return Figure(float(x.mean()), math.nan, math.nan, x.size) if x.size else _NOTHING
    half = stats.t.ppf(0.5 * (1.0 + CONFIDENCE), x.size - 1) * x.std(ddof=1) / math.sqrt(x.size)
    return Figure(float(x.mean()), float(x.mean() - half), float(x.mean() + half), x.size)


class Detections(NamedTuple):
    """A Kaplan-Meier curve of the probability to be found within a time.

    Attributes:
        delay_s: at which the curve steps, ascending, shape (k,).
        found: probability of detection within each delay, shape (k,).
        low, high: 95 % bounds of it, shape (k,).
        n: failures that acted.
        n_found: those of them that were found.
    """

    delay_s: Array
    found: Array
    low: Array
    high: Array
    n: int
    n_found: int

    def at(self, delay_s: float) -> Figure:
        """Probability of detection within a delay."""
        if self.n == 0:
            return _NOTHING
        index = int(np.searchsorted(self.delay_s, delay_s + 1e-9, side="right")) - 1
        if index < 0:
            return Figure(0.0, 0.0, share(0, self.n).high, self.n)
        return Figure(float(self.found[index]), float(self.low[index]), float(self.high[index]), self.n)

    def quantile(self, probability: float) -> float:
        """The delay within which a share of the failures is found; NaN where fewer are."""
        reached = np.flatnonzero(self.found >= probability - 1e-12)
        return float(self.delay_s[reached[0]]) if reached.size else math.nan


def detection_curve(delay_s: Sequence[float], censored_s: Sequence[float]) -> Detections:
    """Delays of what was found, and how long the rest was there without being found.

    Args:
        delay_s: from first effect to declaration, s.
        censored_s: from first effect to the end of the failure or the run, for those never found, s.
    """
    found, left = np.asarray(delay_s, dtype=float), np.asarray(censored_s, dtype=float)
    n = found.size + left.size
    empty = np.empty(0)
    if not found.size:
        return Detections(empty, empty, empty, empty, n, 0)
    curve = stats.ecdf(stats.CensoredData(uncensored=found, right=left)).cdf
    with np.errstate(divide="ignore", invalid="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # Greenwood's formula is 0/0 where all have been found
        interval = curve.confidence_interval(CONFIDENCE, method="log-log")
    steps = np.isin(curve.quantiles, found)
    low = np.nan_to_num(interval.low.probabilities[steps], nan=0.0)
    high = np.nan_to_num(interval.high.probabilities[steps], nan=1.0)
    probabilities = curve.probabilities[steps]
    if not left.size:  # without censoring it is a share of n at each step
        shares = [share(round(p * n), n) for p in probabilities.tolist()]
        low, high = np.array([s.low for s in shares]), np.array([s.high for s in shares])
    return Detections(curve.quantiles[steps], probabilities, low, high, n, found.size)


def in_band(values: Sequence[float], degrees: int) -> Figure:
    """The share of chi-square statistics that lie in the central 95 % of their distribution.

    Args:
        values: of NEES or another statistic that is chi-square for a consistent filter.
        degrees: of freedom.
    """
    x = np.asarray(values, dtype=float)
    low, high = stats.chi2.ppf([0.5 * (1.0 - CONFIDENCE), 0.5 * (1.0 + CONFIDENCE)], degrees)
    return share(int(((x >= low) & (x <= high)).sum()), x.size)


def mean_band(degrees: int, n: int) -> tuple[float, float]:
    """Central 95 % of the mean of n such statistics."""
    low, high = stats.chi2.ppf([0.5 * (1.0 - CONFIDENCE), 0.5 * (1.0 + CONFIDENCE)], degrees * n) / n
    return float(low), float(high)


def smallest_found(sizes: Sequence[float], found: Sequence[bool], wanted: float = 0.9) -> float | None:
    """The size from which failures are found with some probability: logistic regression on the logarithm of size.

    Args:
        sizes: of each failure, above zero.
        found: whether it was found.
        wanted: probability.

    Returns:
        The size; None where the data do not bracket it.
    """
    from scipy.optimize import minimize  # noqa: PLC0415 (slow to load)

    x, y = np.log(np.asarray(sizes, dtype=float)), np.asarray(found, dtype=float)
    if x.size < 8 or np.ptp(x) == 0.0 or y.all() or not y.any():
        return None
    center, scale = x.mean(), x.std()
    z = (x - center) / scale

    def loss(beta: Array) -> float:
        # the small penalty keeps the slope finite where sizes separate found from missed
        eta = beta[0] + beta[1] * z
        return float(np.logaddexp(0.0, eta).sum() - y @ eta + 0.005 * beta[1] ** 2)

    intercept, slope = minimize(loss, np.array([0.0, 1.0])).x
    if slope <= 0.0:
        return None
    size = math.exp(center + scale * (math.log(wanted / (1.0 - wanted)) - intercept) / slope)
    return size if math.exp(x.min()) <= size <= math.exp(x.max()) else None


def rank_correlations(columns: Mapping[str, Sequence[float]], error: Sequence[float]) -> dict[str, float]:
    """Spearman's rank correlation of an error with each draw; draws that do not vary are left out."""
    y = np.asarray(error, dtype=float)
    found = {}
    for name, values in columns.items():
        x = np.asarray(values, dtype=float)
        both = np.isfinite(x) & np.isfinite(y)
        if both.sum() > 2 and np.ptp(x[both]) > 0.0 and np.ptp(y[both]) > 0.0:
            found[name] = float(stats.spearmanr(x[both], y[both]).statistic)
    return found
