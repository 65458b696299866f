"""One sample for a bank of filters: prediction, and the update with kicks and poor readings as further possibilities.

With some probability something that the model does not have has pushed the vehicle in the interval: a second update,
with the kick's covariance added, stands beside the first. So does a third in which the sample's poses are poor ones,
many times as noisy. All are merged by their moments; the likelihood is that of all.

Where a correction would leave a K that is no body's, K is only considered at that sample (Schmidt), and not corrected:
so it is in the first seconds of a hypothesis that is far from the truth.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from massprop_drake.maths.estimation.pose.layout import Bank, Commands, PoseParams, Readings
from massprop_drake.maths.estimation.pose.measurement import Compared, compared
from massprop_drake.maths.estimation.pose.prediction import Predicted, predicted
from massprop_drake.maths.estimation.pose.turning import rotations, symmetric_matrices
from massprop_drake.maths.linear_algebra import Array, NotPositiveDefiniteError

_LEAST = 0.01  # of the nominal K, below which it is no body's
_TWO_PI = np.log(2.0 * np.pi)


class Cycled(NamedTuple):
    """A bank after a sample.

    Attributes:
        bank: see `Bank`.
        likelihood: logarithm of the density of the readings given those before, nats, shape (n_filters,).
        innovation: shape (n_filters, m).
        nis: of the innovation, without a kick; NaN where nothing was read, shape (n_filters,).
        kicked: probability of a kick, shape (n_filters,).
        of_first: NIS of the first filter, and components that it is of: of attitude and rate, then of place and
            velocity, shape (2, 2).
    """

    bank: Bank
    likelihood: Array
    innovation: Array
    nis: Array
    kicked: Array
    of_first: Array


class _Update(NamedTuple):
    correction: Array
    covariance: Array
    likelihood: Array
    nis: Array


def shifted(bank: Bank, correction: Array, covariance: Array, params: PoseParams) -> Bank:
    """The bank with a correction of what is free, shape (n_filters, n), and another covariance."""
    mean = bank.mean.copy()
    mean[:, params.free] += correction
    turn = mean[:, params.parts.attitude].copy()
    mean[:, params.parts.attitude] = 0.0
    return bank._replace(mean=mean, covariance=covariance, rotation=bank.rotation @ rotations(turn))


def step(bank: Bank, commands: Commands, span_s: tuple[float, float], readings: Readings, params: PoseParams) -> Cycled:
    """A whole cycle.

    Args:
        bank: after the last sample.
        commands: see `Commands`; those given at the sample itself included, as some act at once.
        span_s: time of the last sample and of this one.
        readings: at its end.
        params: see `PoseParams`.

    Raises:
        NotPositiveDefiniteError: when an innovation's covariance loses definiteness, with the time.
    """
    ahead = predicted(bank, commands, *span_s, params)
    beside = compared(ahead.bank, readings, params)
    count = bank.mean.shape[0]
    if beside is None:
        nothing = np.zeros(count)
        return Cycled(ahead.bank, nothing, np.zeros((count, 0)), np.full(count, np.nan), nothing, np.zeros((2, 2)))
    of_first = _by_kind(ahead.bank.covariance[0], beside)
    chance = 1.0 - np.exp(-params.kicks_per_s * (span_s[1] - span_s[0]))
    try:
        mixed = _mixed(ahead, beside, chance, np.ones(params.free.size), params)
        possible = _possible(ahead.bank.mean, mixed.correction, params)
        if not possible.all():
            taken = np.where(possible[:, None] | ~_spin(params), 1.0, 0.0)
            mixed = _mixed(ahead, beside, chance, taken, params)
    except np.linalg.LinAlgError:
        worst = ahead.bank.covariance[np.argmin(np.linalg.eigvalsh(ahead.bank.covariance)[:, 0])]
        raise NotPositiveDefiniteError(worst, "the pose estimator's covariance", span_s[1]) from None
    after = shifted(ahead.bank, mixed.correction, mixed.covariance, params)
    return Cycled(after, mixed.likelihood, beside.innovation, mixed.nis, mixed.kicked, of_first)


class _Mixed(NamedTuple):
    """The updates by all that may have happened, merged; `nis` is that of nothing, `kicked` the share of a kick."""

    correction: Array
    covariance: Array
    likelihood: Array
    nis: Array
    kicked: Array


def _mixed(ahead: Predicted, beside: Compared, chance: float, taken: Array, params: PoseParams) -> _Mixed:
    """See `_Mixed`.

    Args:
        ahead: predicted.
        beside: its readings.
        chance: of a kick.
        taken: 0 for what is only considered, and not corrected, else 1, shape (n_filters, n) or (n,).
        params: see `PoseParams`.
    """
    covariance = ahead.bank.covariance
    poor = params.pose.outliers if beside.poses.any() else 0.0
    ways = [(1.0 - chance - poor, _updated(covariance, beside, taken))]
    if chance > 0.0:
        ways.append((chance, _updated(covariance + ahead.kick @ np.swapaxes(ahead.kick, 1, 2), beside, taken)))
    if poor > 0.0:
        ways.append((poor, _updated(covariance, _noisier(beside, params.pose.outlier_scale), taken)))
    each = np.stack([np.log(weight) + way.likelihood for weight, way in ways])
    total = np.logaddexp.reduce(each)
    share = np.exp(each - total)
    correction = np.einsum("kh,khn->hn", share, np.stack([way.correction for _, way in ways]))
    merged = np.zeros_like(covariance)
    for part, (_, way) in zip(share, ways, strict=True):
        apart = way.correction - correction
        merged += part[:, None, None] * (way.covariance + apart[:, :, None] * apart[:, None, :])
    kicked = share[1] if chance > 0.0 else np.zeros(total.shape[0])
    return _Mixed(correction, merged, total, ways[0][1].nis, kicked)


def _spin(params: PoseParams) -> np.ndarray:
    """Which of what is free is of K, shape (n,)."""
    spin = params.parts.spin
    return (params.free >= spin.start) & (params.free < spin.stop)


def _possible(mean: Array, correction: Array, params: PoseParams) -> np.ndarray:
    """Whether each filter's K would be that of a body: positive definite, shape (n_filters,)."""
    after = mean.copy()
    after[:, params.free] += correction
    spin = symmetric_matrices(after[:, params.parts.spin])
    least = np.linalg.eigvalsh(symmetric_matrices(params.start[params.parts.spin]))[0]
    return np.asarray(np.linalg.eigvalsh(spin)[:, 0] > _LEAST * least)


def _noisier(beside: Compared, scale: float) -> Compared:
    """The same with poses so many times as noisy."""
    grown = np.where(beside.poses, scale, 1.0)
    return beside._replace(variance=beside.variance * grown[:, None] * grown)


def _by_kind(covariance: Array, beside: Compared) -> Array:
    """See `Cycled.of_first`."""
    result = np.zeros((2, 2))
    by, off = beside.jacobian[0], beside.innovation[0]
    expected = by @ covariance @ by.T + beside.variance[0]
    for row, chosen in enumerate((beside.turning, ~beside.turning)):
        if chosen.any():
            result[row] = off[chosen] @ np.linalg.solve(expected[np.ix_(chosen, chosen)], off[chosen]), chosen.sum()
    return result


def _updated(covariance: Array, beside: Compared, taken: Array) -> _Update:
    """The update by Joseph's form, which holds for any gain."""
    by = beside.jacobian
    crossed = covariance @ np.swapaxes(by, 1, 2)
    expected = by @ crossed + beside.variance
    half = np.linalg.cholesky(expected)
    gain = np.swapaxes(np.linalg.solve(expected, np.swapaxes(crossed, 1, 2)), 1, 2)
    gain = gain * taken[..., None]
    left = np.eye(covariance.shape[1]) - gain @ by
    after = left @ covariance @ np.swapaxes(left, 1, 2) + gain @ beside.variance @ np.swapaxes(gain, 1, 2)
    after = 0.5 * (after + np.swapaxes(after, 1, 2))
    whitened = np.linalg.solve(half, beside.innovation[..., None])[..., 0]
    nis = np.sum(whitened**2, axis=1)
    determinant = 2.0 * np.sum(np.log(np.diagonal(half, axis1=1, axis2=2)), axis=1)
    likelihood = -0.5 * (nis + determinant + beside.innovation.shape[1] * _TWO_PI)
    correction = (gain @ beside.innovation[..., None])[..., 0]
    return _Update(correction, after, likelihood, nis)
