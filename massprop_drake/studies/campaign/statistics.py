"""Statistics of failure detection and estimation over many cases, each with its 95 % interval.

Rates by exact Poisson bounds, shares by the Clopper-Pearson interval, delays as Kaplan-Meier curves of the time to
detection with cases that ended undetected censored, sizes by logistic regression. What several values of one case
have in common is allowed for: cases are independent, parameters and failures of one case are not.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import special, stats

Array = NDArray[np.float64]

CONFIDENCE = 0.95
_TAIL = 0.5 * (1.0 - CONFIDENCE)
_FEWEST_SIZES = 8  # failures that a curve over their size is fitted to
_ONE_SIZE = math.log(1.01)  # sizes that differ by less are one
_HOPELESS = 1e6  # loss of a curve that has nothing to do with what was found
_RESAMPLES = 200  # of a bootstrap
_FAR = 10.0  # times the largest size, and part of the smallest one, beyond which a bound is none


class Figure(NamedTuple):
    """A figure with its 95 % interval.

    Attributes:
        value: the figure itself; NaN where there is nothing to measure it on.
        low, high: bounds of the interval; NaN where there is none, infinite where it is open.
        n: what it was measured on: cases, events or hours.
    """

    value: float
    low: float
    high: float
    n: float


_NOTHING = Figure(math.nan, math.nan, math.nan, 0)


def rate(events: int, exposure: float) -> Figure:
    """Computes events per unit of exposure, with exact Poisson bounds; without events the upper is 3.0 / exposure.

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
    low = 0.5 * stats.chi2.ppf(_TAIL, 2 * events)
    high = 0.5 * stats.chi2.ppf(1.0 - _TAIL, 2 * events + 2)
    return Figure(events / exposure, float(low) / exposure, float(high) / exposure, exposure)


def share(successes: int, n: int) -> Figure:
    """Computes a share of n independent cases, with its Clopper-Pearson interval."""
    if n == 0:
        return _NOTHING
    low, high = _clopper_pearson(np.array([float(successes)]), n)
    return Figure(successes / n, float(low[0]), float(high[0]), n)


def _clopper_pearson(successes: Array, n: float) -> tuple[Array, Array]:
    """Computes 95 % bounds of shares of n, shape (k,) each; successes and n need not be whole numbers."""
    missed = n - successes
    inner = successes > 0.0
    low = np.where(inner, stats.beta.ppf(_TAIL, np.where(inner, successes, 1.0), missed + 1.0), 0.0)
    inner = missed > 0.0
    high = np.where(inner, stats.beta.ppf(1.0 - _TAIL, successes + 1.0, np.where(inner, missed, 1.0)), 1.0)
    return low, high


def clustered_share(successes: Sequence[int], sizes: Sequence[int]) -> Figure:
    """Computes a share over clusters of dependent values, such as the ten parameters of each case.

    With one value in each it is `share`. Otherwise the Clopper-Pearson interval is that of as many independent values
    as have the variance that the clusters show (Korn and Graubard 1998); where all or none succeed, which shows
    nothing of it, a cluster counts as one value.

    Args:
        successes: in each cluster.
        sizes: number of values in each cluster; empty ones do not count.
    """
    m = np.asarray(sizes, dtype=float)
    hits, m = np.asarray(successes, dtype=float)[m > 0], m[m > 0]
    clusters, n = m.size, float(m.sum())
    if clusters == 0 or m.max() == 1.0:
        return share(int(hits.sum()), int(n))
    p = float(hits.sum()) / n
    effective = float(clusters)
    if 0.0 < p < 1.0 and clusters > 1:
        variance = clusters / (clusters - 1.0) * float(((hits - p * m) ** 2).sum()) / n**2
        few = float(stats.t.ppf(1.0 - _TAIL, n - 1.0) / stats.t.ppf(1.0 - _TAIL, clusters - 1.0)) ** 2
        effective = n if variance == 0.0 else min(n, p * (1.0 - p) / variance * few)
    low, high = _clopper_pearson(np.array([p * effective]), effective)
    return Figure(p, float(low[0]), float(high[0]), n)


def mean(values: Sequence[float]) -> Figure:
    """Computes a mean, with its interval by Student's t."""
    x = np.asarray(values, dtype=float)
    if x.size < 2:
        return Figure(float(x.mean()), math.nan, math.nan, x.size) if x.size else _NOTHING
    half = stats.t.ppf(1.0 - _TAIL, x.size - 1) * x.std(ddof=1) / math.sqrt(x.size)
    return Figure(float(x.mean()), float(x.mean() - half), float(x.mean() + half), x.size)


def median(values: Sequence[float]) -> Figure:
    """Computes a median, with its interval by order statistics; open for less than six values."""
    x = np.sort(np.asarray(values, dtype=float))
    n = x.size
    if n == 0:
        return _NOTHING
    outside = int(stats.binom.ppf(_TAIL, n, 0.5))  # P(at most this many) >= tail, so one fewer may lie outside
    low, high = (float(x[outside - 1]), float(x[n - outside])) if outside > 0 else (-math.inf, math.inf)
    return Figure(float(np.median(x)), low, high, n)


# ------------------------------------------------------------------------------------------- delays


class Detections(NamedTuple):
    """Kaplan-Meier curve of the probability of detection within a time.

    Attributes:
        delay_s: at which the curve steps, ascending, shape (k,).
        found: probability of detection within each delay, shape (k,).
        low, high: 95 % bounds of it, shape (k,).
        n: failures that acted.
        n_found: those of them that were found.
        followed_s: the longest time for which one was there, found or not; beyond it nothing is known.
    """

    delay_s: Array
    found: Array
    low: Array
    high: Array
    n: int
    n_found: int
    followed_s: float

    def at(self, delay_s: float) -> Figure:
        """Returns the probability of detection within a delay.

        Its value is NaN for a delay for which no failure was followed; the lower bound then is the last one known.
        """
        if self.n == 0:
            return _NOTHING
        index = int(np.searchsorted(self.delay_s, delay_s + _SAME_S, side="right")) - 1
        value = float(self.found[index]) if index >= 0 else 0.0
        low, high = (float(self.low[index]), float(self.high[index])) if index >= 0 else (0.0, share(0, self.n).high)
        if delay_s > self.followed_s + _SAME_S and value < 1.0:
            return Figure(math.nan, low, 1.0, self.n)
        return Figure(value, low, high, self.n)

    def quantile(self, probability: float) -> Figure:
        """Returns the delay within which a share of the failures is found; NaN where fewer are.

        The interval holds the delays at which the band around the curve holds that share; it is open where the band's
        lower edge stays below.
        """
        value, low, high = (
            _first_crossing(self.delay_s, edge, probability) for edge in (self.found, self.high, self.low)
        )
        return Figure(value, low, math.inf if math.isnan(high) and not math.isnan(value) else high, self.n)


_SAME_S = 1e-9  # times that differ by less are equal


def _first_crossing(x: Array, curve: Array, level: float) -> float:
    """Returns the first of x at which a rising curve reaches a level; NaN where it does not."""
    reached = np.flatnonzero(curve >= level - 1e-12)
    return float(x[reached[0]]) if reached.size else math.nan


def detection_curve(delay_s: Sequence[float], censored_s: Sequence[float]) -> Detections:
    """Computes the probability of detection over delay (Kaplan-Meier), durations without detection censored.

    As long as nothing has been censored the curve is a share of all, with its Clopper-Pearson interval; from then on
    the interval is that of Greenwood's variance of log(-log), and the lower bound stays where it was once all that
    is left has been found.

    Args:
        delay_s: from first effect to declaration, s.
        censored_s: from first effect to the end of the run, for those never found, s.
    """
    found, censored = np.asarray(delay_s, dtype=float), np.asarray(censored_s, dtype=float)
    n = found.size + censored.size
    followed = float(max(found.max(initial=0.0), censored.max(initial=0.0)))
    if not found.size:
        return Detections(np.empty(0), np.empty(0), np.empty(0), np.empty(0), n, 0, followed)
    curve = stats.ecdf(stats.CensoredData(uncensored=found, right=censored)).cdf
    steps = np.isin(curve.quantiles, found)
    delays, probabilities = curve.quantiles[steps], curve.probabilities[steps]
    exact = delays <= censored.min(initial=math.inf)
    low, high = _clopper_pearson(np.round(probabilities * n), n)
    if not exact.all():
        with np.errstate(divide="ignore", invalid="ignore"), warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # Greenwood's formula is 0/0 where all have been found
            interval = curve.confidence_interval(CONFIDENCE, method="log-log")
        low[~exact] = interval.low.probabilities[steps][~exact]
        high[~exact] = np.nan_to_num(interval.high.probabilities[steps][~exact], nan=1.0)
        last = np.maximum.accumulate(np.where(np.isnan(low), 0, np.arange(low.size)))
        low = np.nan_to_num(low[last], nan=0.0)
    return Detections(delays, probabilities, low, high, n, found.size, followed)


# ------------------------------------------------------------------------------------- consistency


def share_in_band(values: Sequence[float], degrees: int) -> Figure:
    """Computes the share of chi-square statistics that lie in the central 95 % of their distribution.

    Args:
        values: of NEES or another statistic that is chi-square for a consistent filter.
        degrees: of freedom.
    """
    x = np.asarray(values, dtype=float)
    low, high = mean_band(degrees, 1)
    return share(int(((x >= low) & (x <= high)).sum()), x.size)


def mean_band(degrees: int, n: int) -> tuple[float, float]:
    """Returns both ends of the central 95 % of the mean of n independent chi-square values."""
    low, high = stats.chi2.ppf([_TAIL, 1.0 - _TAIL], degrees * n) / n
    return float(low), float(high)


# -------------------------------------------------------------------------------------------- sizes


class SizeCurve(NamedTuple):
    """Probability that a failure is found, over the logarithm of its size: 1 / (1 + exp(-(a + b ln(size)))).

    Attributes:
        intercept, slope: a and b.
        covariance: of both, shape (2, 2).
        smallest, largest: size of those that it was fitted to.
        n: number of failures.
        size_90: the size that is found with probability 0.9; NaN where it lies beyond the largest or the smallest.
    """

    intercept: float
    slope: float
    covariance: Array
    smallest: float
    largest: float
    n: int
    size_90: Figure

    @property
    def finds_all(self) -> bool:
        """True if failures of all sizes are found with probability 0.9 or more."""
        return math.isnan(self.size_90.value) and self.intercept + self.slope * math.log(self.largest) > math.log(9.0)

    def at(self, sizes: Array) -> tuple[Array, Array, Array]:
        """Computes the probability of detection of some sizes, and its 95 % bounds, shape (k,) each."""
        terms = np.stack([np.ones(sizes.size), np.log(sizes)])
        eta = np.array([self.intercept, self.slope]) @ terms
        half = stats.norm.ppf(1.0 - _TAIL) * np.sqrt(np.einsum("ik,ij,jk->k", terms, self.covariance, terms))
        low, middle, high = (special.expit(x) for x in (eta - half, eta, eta + half))
        return middle, low, high


def size_curve(sizes: Sequence[float], detected: Sequence[bool], probability: float = 0.9) -> SizeCurve | None:
    """Fits the probability of detection as a logistic function of log failure size; None where it cannot be.

    Logistic regression with Jeffreys's prior (Firth 1993), which is finite where sizes separate found from missed;
    the interval of the size found with a probability is by the profile likelihood, as for the sizes a90/95 of
    nondestructive evaluation.

    Args:
        sizes: of each failure, above zero.
        detected: whether it was found.
        probability: with which `size_90` is found.

    Returns:
        The curve; None for less than eight failures, for sizes within 1 % of each other, and where all or none were
        found, or smaller ones more often.
    """
    from scipy.optimize import minimize  # noqa: PLC0415 (slow to load)

    x, y = np.log(np.asarray(sizes, dtype=float)), np.asarray(detected, dtype=float)
    if x.size < _FEWEST_SIZES or np.ptp(x) < _ONE_SIZE or y.all() or not y.any():
        return None
    center, scale = float(x.mean()), float(x.std())
    z = (x - center) / scale

    def loss(beta: Array) -> float:
        """Computes the penalized loss of intercept and slope."""
        return _penalized_loss(beta[0], beta[1], z, y)

    best = minimize(loss, np.array([0.0, 1.0]), method="Nelder-Mead", options={"xatol": 1e-8, "fatol": 1e-10})
    intercept, slope = best.x
    if slope <= 0.0:
        return None
    to_sizes = np.array([[1.0, -center / scale], [0.0, 1.0 / scale]])
    covariance = to_sizes @ np.linalg.inv(_information(intercept, slope, z)) @ to_sizes.T
    size = _size_at_probability(z, y, (intercept, slope), probability, math.log(_FAR) / scale)
    value, low, high = (math.exp(center + scale * edge) for edge in (size.value, size.low, size.high))
    smallest, largest = math.exp(x.min()), math.exp(x.max())
    size_90 = Figure(value if smallest <= value <= largest else math.nan, low, high, x.size)
    a, b = to_sizes @ np.array([intercept, slope])
    return SizeCurve(float(a), float(b), covariance, smallest, largest, x.size, size_90)


def _information(intercept: float, slope: float, z: Array) -> Array:
    """Computes the Fisher information of a logistic curve's intercept and slope at sizes z, shape (2, 2)."""
    p = special.expit(intercept + slope * z)
    weight = p * (1.0 - p)
    return np.array([[weight.sum(), weight @ z], [weight @ z, weight @ z**2]])


def _penalized_loss(intercept: float, slope: float, z: Array, y: Array) -> float:
    """Computes the negative log likelihood of a logistic curve, at sizes z and outcomes y, with Jeffreys's prior."""
    eta = intercept + slope * z
    information = _information(intercept, slope, z)
    determinant = float(information[0, 0] * information[1, 1] - information[0, 1] ** 2)
    if not determinant > 0.0:
        return math.inf
    return float(np.logaddexp(0.0, eta).sum() - y @ eta) - 0.5 * math.log(determinant)


def _size_at_probability(
    z: Array, y: Array, coefficients: tuple[float, float], probability: float, reach: float
) -> Figure:
    """Computes the standardized size z detected with a probability, with its profile-likelihood interval.

    A bound that lies farther from all sizes than `reach` is infinite.
    """
    from scipy.optimize import brentq, minimize_scalar  # noqa: PLC0415 (slow to load)

    intercept, slope = coefficients
    level = math.log(probability / (1.0 - probability))
    value = (level - intercept) / slope
    allowed = _penalized_loss(intercept, slope, z, y) + 0.5 * stats.chi2.ppf(CONFIDENCE, 1)
    steep_bounds = (math.log(1e-3 * slope), math.log(10.0 * slope + 10.0))

    def excess(size: float) -> float:
        """Computes by how much the best curve through a size exceeds the loss that the interval allows."""

        def loss(logarithm: float) -> float:
            """Computes the loss of the curve through the size, by the logarithm of its slope."""
            steep = math.exp(logarithm)
            return min(_penalized_loss(level - steep * size, steep, z, y), _HOPELESS)  # a search needs numbers

        best = minimize_scalar(loss, bounds=steep_bounds, method="bounded", options={"xatol": 1e-4})
        return float(best.fun) - allowed

    def bound(limit: float, default: float) -> float:
        """Finds where the loss reaches what the interval allows, from the estimate to a limit."""
        return float(brentq(excess, *sorted((value, limit)), xtol=1e-4)) if excess(limit) > 0.0 else default

    return Figure(
        value, bound(min(value, z.min()) - reach, -math.inf), bound(max(value, z.max()) + reach, math.inf), z.size
    )


def shares_by_size(
    sizes: Sequence[float], detected: Sequence[bool], max_bins: int = 8
) -> list[tuple[float, float, Figure]]:
    """Returns bins of failure size, each with lower edge, upper edge and the share of failures found in it.

    Few sizes have a bin each; many are put into bins that are equally wide in the logarithm.
    """
    x, y = np.asarray(sizes, dtype=float), np.asarray(detected, dtype=bool)
    distinct = np.unique(x)
    if distinct.size <= max_bins:
        groups = [(float(size), float(size), x == size) for size in distinct]
    else:
        edges = np.geomspace(distinct[0], distinct[-1], max_bins + 1)
        place = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, max_bins - 1)
        groups = [(float(edges[bin]), float(edges[bin + 1]), place == bin) for bin in range(max_bins)]
    return [(low, high, share(int(y[inside].sum()), int(inside.sum()))) for low, high, inside in groups if inside.any()]


# -------------------------------------------------------------------------------------- sensitivity


def rank_correlation(x: Sequence[float], y: Sequence[float]) -> Figure:
    """Computes Spearman's rank correlation, with Bonett and Wright's interval (2000); NaN for constant values."""
    a, b = np.asarray(x, dtype=float), np.asarray(y, dtype=float)
    both = np.isfinite(a) & np.isfinite(b)
    a, b, n = a[both], b[both], int(both.sum())
    if n < 4 or np.ptp(a) == 0.0 or np.ptp(b) == 0.0:
        return Figure(math.nan, math.nan, math.nan, n)
    r = float(stats.spearmanr(a, b).statistic)
    if abs(r) >= 1.0 - 1e-12:
        return Figure(r, r, r, n)
    half = stats.norm.ppf(1.0 - _TAIL) * math.sqrt((1.0 + 0.5 * r * r) / (n - 3))
    return Figure(r, math.tanh(math.atanh(r) - half), math.tanh(math.atanh(r) + half), n)


class SobolIndices(NamedTuple):
    """Shares of the variance of some outputs that are due to each draw.

    Attributes:
        first: alone, by output and draw.
        total: alone and with others, by output and draw.
    """

    first: list[list[Figure]]
    total: list[list[Figure]]


def sobol_indices(values: Array, n_draws: int) -> SobolIndices:
    """Computes first-order and total Sobol indices (Saltelli 2010), with bootstrapped intervals.

    Args:
        values: of some outputs, shape (outputs, n (draws + 2)): the n points A, the n points B, and A with each draw
            in turn from B; n a power of two.
        n_draws: how many quantities are drawn.
    """
    outputs = values.shape[0]
    n = values.shape[1] // (n_draws + 2)
    parts = values.reshape(outputs, n_draws + 2, n)
    a, b, mixed = parts[:, 0], parts[:, 1], np.moveaxis(parts[:, 2:], 1, 0)

    def indices(rows: NDArray[np.int64]) -> Array:
        """Computes first-order and total indices from some of the points, shape (2, outputs, draws)."""
        chosen = {"f_A": a[:, rows], "f_B": b[:, rows], "f_AB": mixed[..., rows]}
        result = stats.sobol_indices(func=chosen, n=n)
        return np.array([np.reshape(part, (outputs, n_draws)) for part in (result.first_order, result.total_order)])

    values_found = indices(np.arange(n))
    generator = np.random.default_rng(0)
    resampled = np.array([indices(generator.integers(0, n, n)) for _ in range(_RESAMPLES)])
    low, high = np.quantile(resampled, [_TAIL, 1.0 - _TAIL], axis=0)
    bounds = np.stack([values_found, low, high], axis=-1).tolist()
    first, total = ([[Figure(a, b, c, n) for a, b, c in by_draw] for by_draw in order] for order in bounds)
    return SobolIndices(first, total)


# ------------------------------------------------------------------------------------------- pairs


class Paired(NamedTuple):
    """Difference between two sets of the same cases.

    Attributes:
        difference: second less first, with its interval.
        up, down: number of pairs in which the second is larger, and in which it is smaller.
        p: probability of so unequal a split, or a more unequal one, were both alike; NaN without unequal pairs.
    """

    difference: Figure
    up: int
    down: int
    p: float


def _sign_test_p_value(up: int, down: int) -> float:
    """Returns the two-sided p-value of the sign test; NaN without any difference."""
    return float(stats.binomtest(up, up + down).pvalue) if up + down else math.nan


def paired_share(first: Sequence[bool], second: Sequence[bool]) -> Paired:
    """Computes the paired difference of two shares, with Tango's interval (1998) and McNemar's exact p-value."""
    a, b = np.asarray(first, dtype=bool), np.asarray(second, dtype=bool)
    up, down, n = int((b & ~a).sum()), int((a & ~b).sum()), a.size
    if n == 0:
        return Paired(_NOTHING, 0, 0, math.nan)
    low, high = (_tango_bound(up, down, n, side) for side in (-1.0, 1.0))
    return Paired(Figure((up - down) / n, low, high, n), up, down, _sign_test_p_value(up, down))


def _tango_bound(up: int, down: int, n: int, side: float) -> float:
    """Computes the lower (side -1) or upper (+1) bound of the difference of two paired shares."""
    from scipy.optimize import brentq  # noqa: PLC0415 (slow to load)

    z = float(stats.norm.ppf(1.0 - _TAIL))

    def excess(difference: float) -> float:
        """Computes the squared score minus its limit at a difference of shares."""
        # `other` is the likeliest share of pairs that are down, given the difference
        linear = -up - down + (2.0 * n - up + down) * difference
        constant = -down * difference * (1.0 - difference)
        other = (math.sqrt(max(0.0, linear**2 - 8.0 * n * constant)) - linear) / (4.0 * n)
        variance = n * (2.0 * other + difference * (1.0 - difference))
        gap = up - down - n * difference
        return gap * gap - z * z * variance

    begin = (up - down) / n + 1e-9 * side  # at the difference itself nothing is left over, and nothing is allowed
    if begin * side >= 1.0 or excess(side) <= 0.0:
        return side
    return float(brentq(excess, begin, side, xtol=1e-12))


def paired_median(differences: Sequence[float]) -> Paired:
    """Computes the median of paired differences, with its order-statistics interval and sign test's p-value."""
    d = np.asarray(differences, dtype=float)
    up, down = int((d > 0.0).sum()), int((d < 0.0).sum())
    return Paired(median(differences), up, down, _sign_test_p_value(up, down))


def paired_mean(differences: Sequence[float], scale: float = 1.0) -> Paired:
    """Computes the mean of paired differences, with its BCa bootstrap interval and sign test's p-value.

    Args:
        differences: of each pair.
        scale: that mean and interval are multiplied by.
    """
    d = np.asarray(differences, dtype=float)
    up, down = int((d > 0.0).sum()), int((d < 0.0).sum())
    if d.size < 2 or np.ptp(d) == 0.0:
        value = scale * float(d.mean()) if d.size else math.nan
        return Paired(Figure(value, math.nan, math.nan, d.size), up, down, _sign_test_p_value(up, down))
    result = stats.bootstrap([d], np.mean, confidence_level=CONFIDENCE, rng=np.random.default_rng(0))
    low, high = (scale * float(bound) for bound in result.confidence_interval)
    return Paired(Figure(scale * float(d.mean()), low, high, d.size), up, down, _sign_test_p_value(up, down))
