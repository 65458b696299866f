"""One sample for a bank of filters: prediction, and the update with kicks and poor readings as further possibilities.

With some probability something that the model does not have has pushed the vehicle in the interval: a second update,
with the kick's covariance added, stands beside the first. So does a third in which the sample's poses are poor ones,
many times as noisy. All are merged by their moments; the likelihood is that of all. Where a sample looks poor, what
it would be after a kick is kept apart until the next one (`Doubt`). Where less is known than even a poor reading would
show, as in the first samples, each counts as a poor one; how likely it was is still reckoned as for any other, since
filters that differ in what they know are compared by it.

Where a correction would leave a K that is no body's, K is only considered at that sample (Schmidt), and not corrected:
so it is in the first seconds of a hypothesis that is far from the truth.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from massprop_drake.maths.estimation.pose.pose_layout import Commands, PoseBank, PoseParams, PoseReadings
from massprop_drake.maths.estimation.pose.pose_measurement import Compared, compare_readings
from massprop_drake.maths.estimation.pose.pose_prediction import Predicted, predict_bank
from massprop_drake.maths.estimation.pose.turning import rotation_vectors, rotations
from massprop_drake.maths.linear_algebra import Array, NotPositiveDefiniteError
from massprop_drake.maths.mass_properties import ELEMENT

_LEAST = 0.01  # of the nominal K, below which it is no body's
_DOUBTFUL = 0.3  # probability of a poor sample from which on a kick is kept apart
_TINY = 1e-300
_TWO_PI = np.log(2.0 * np.pi)


class PoseCycled(NamedTuple):
    """Bank after a sample.

    Attributes:
        bank: see `PoseBank`.
        likelihood: logarithm of the density of the readings given those before, nats, shape (n_filters,).
        innovation: shape (n_filters, m).
        kicked: probability of a kick, shape (n_filters,).
        of_first: NIS of the first filter, of what has probably happened, and components that it is of: of attitude and
            rate, then of place and velocity, shape (2, 2).
        doubt: what the next sample is to decide; None: nothing.
        whitened: innovations in units of what the bank expects on average, shape (n_filters, m).
    """

    bank: PoseBank
    likelihood: Array
    innovation: Array
    kicked: Array
    of_first: Array
    doubt: Doubt | None = None
    whitened: Array | None = None


class Doubt(NamedTuple):
    """Filters as they would be if readings that look poor were good ones, after a kick.

    A single reading that is off looks the same after both, and the next one tells: until then they are kept apart.

    Attributes:
        bank: see `PoseBank`.
        share: their probability, shape (n_filters,).
    """

    bank: PoseBank
    share: Array


class PoseUpdate(NamedTuple):
    """Update of a bank by readings.

    Attributes:
        correction: of what is free, shape (n_filters, n).
        likelihood: logarithm of the readings' density, shape (n_filters,).
        nis: of the innovation, shape (n_filters,).
        gain: K, shape (n_filters, n, m).
        learned: L of what is taken from the covariance, L K^T + K L^T, shape (n_filters, n, m).
    """

    correction: Array
    likelihood: Array
    nis: Array
    gain: Array
    learned: Array


def apply_correction(bank: PoseBank, correction: Array, covariance: Array, params: PoseParams) -> PoseBank:
    """Adds corrections of the free elements, (n_filters, n), to a bank's state, and replaces its covariance."""
    mean = bank.mean.copy()
    mean[:, params.free] += correction
    turn = mean[:, params.parts.attitude].copy()
    mean[:, params.parts.attitude] = 0.0
    return bank._replace(mean=mean, covariance=covariance, rotation=bank.rotation @ rotations(turn))


def step(
    bank: PoseBank,
    commands: Commands,
    span_s: tuple[float, float],
    readings: PoseReadings,
    params: PoseParams,
    alternative: Doubt | None = None,
) -> PoseCycled:
    """Advances a bank by a sample, and merges filters that took the last outlier for a kick (``alternative``).

    Args:
        bank: after the last sample.
        commands: see `Commands`; those given at the sample itself included, as some act at once.
        span_s: time of the last sample and of this one.
        readings: at its end.
        alternative: of the last sample; None: there is none.

    Raises:
        NotPositiveDefiniteError: when an innovation's covariance loses definiteness, with the time.
    """
    done = _step_without_doubt(bank, commands, span_s, readings, params)
    if alternative is None:
        return done
    other = _step_without_doubt(alternative.bank, commands, span_s, readings, params)
    with np.errstate(divide="ignore"):  # of what is impossible
        total, share = add_weights(
            np.log1p(-alternative.share) + done.likelihood, np.log(alternative.share) + other.likelihood
        )
    of_first = done.of_first + share[0] * (other.of_first - done.of_first)
    kicked = done.kicked + share * (1.0 - done.kicked)
    both = merge_banks(done.bank, other.bank, share, params)
    return done._replace(bank=both, likelihood=total, kicked=kicked, of_first=of_first, doubt=None)


def add_weights(first: Array, second: Array) -> tuple[Array, Array]:
    """Adds probabilities by their logs; returns the log of the sum, and the second's share, 0 if both are zero."""
    total = np.logaddexp(first, second)
    share = np.where(np.isfinite(total), np.exp(second - np.where(np.isfinite(total), total, 0.0)), 0.0)
    return total, share


def merge_banks(first: PoseBank, second: PoseBank, share: Array, params: PoseParams) -> PoseBank:
    """Merges two banks, filter by filter, by moment matching.

    Args:
        first, second: of the same number of filters.
        share: of the other in each, 0 to 1, shape (n_filters,).
    """
    parts, free = params.parts, params.free
    apart = second.mean - first.mean
    apart[:, parts.attitude] = rotation_vectors(np.swapaxes(first.rotation, 1, 2) @ second.rotation)
    moved = share[:, None] * apart
    mean = first.mean + moved
    mean[:, parts.attitude] = 0.0
    spread = apart[:, free]
    covariance = (
        (1.0 - share)[:, None, None] * first.covariance
        + share[:, None, None] * second.covariance
        + (share * (1.0 - share))[:, None, None] * spread[:, :, None] * spread[:, None, :]
    )
    rotation = first.rotation @ rotations(moved[:, parts.attitude])
    return PoseBank(mean, covariance, rotation, second.opens, first.reference, first.turned)


def _step_without_doubt(
    bank: PoseBank, commands: Commands, span_s: tuple[float, float], readings: PoseReadings, params: PoseParams
) -> PoseCycled:
    """Predicts a bank to a sample and updates it, kicks and outliers possible; ``step`` without alternative filters."""
    with np.errstate(all="ignore"):  # a filter that has run off is seen by what it expects
        predicted = predict_bank(bank, commands, *span_s, params)
        compared = compare_readings(predicted.bank, readings, params)
    count = bank.mean.shape[0]
    if compared is None:
        nothing = np.zeros(count)
        return PoseCycled(predicted.bank, nothing, np.zeros((count, 0)), nothing, np.zeros((2, 2)))
    projected = compared.jacobian @ predicted.bank.covariance @ np.swapaxes(compared.jacobian, 1, 2)
    diverged = _find_diverged(predicted.bank, compared, projected, span_s[1])
    if diverged.any():  # what is left of it is the first filter, and no likelihood
        projected = _values_of_first(projected, diverged)
        others = PoseBank(*(_values_of_first(part, diverged) for part in predicted.bank))._replace(opens=bank.opens)
        predicted = predicted._replace(bank=others, kick=_values_of_first(predicted.kick, diverged))
        innovation, jacobian, variance = (_values_of_first(part, diverged) for part in compared[:3])
        compared = compared._replace(innovation=innovation, jacobian=jacobian, variance=variance)
    chance, poor = kick_and_outlier_chances(compared, span_s, params)
    fair, noisy = None, scale_pose_noise(compared, params.pose.outlier_scale) if poor > 0.0 else compared
    uncertain = projected[0].diagonal() > params.pose.tells * compared.variance[0].diagonal()
    if poor > 0.0 and uncertain[compared.poses].any():  # a poor reading looks like a good one
        good, bad = (_gaussian_log_density(projected + case.variance, case.innovation)[1] for case in (compared, noisy))
        fair = np.logaddexp(np.log1p(-poor) + good, np.log(poor) + bad)
        compared, poor = noisy, 0.0
    cases = list_possibilities(predicted, (compared, noisy), (chance, poor))
    updates = possibility_updates(cases, predicted.bank.mean, params)
    logs = np.stack([np.log(case.chance) + update.likelihood for case, update in zip(cases, updates, strict=True)])
    total = np.logaddexp.reduce(logs)
    weights = np.exp(logs - total)
    kicked = weights[1] if chance > 0.0 else np.zeros(count)
    nis = [part * _nis_by_kind(case.shown[0], case.beside) for part, case in zip(weights[:, 0], cases, strict=True)]
    doubt = None
    if chance > 0.0 and poor > 0.0 and weights[2].max() > _DOUBTFUL:
        doubt = Doubt(mix_possibilities(predicted.bank, cases[1:2], updates[1:2], np.ones((1, count)), params), kicked)
        cases, updates, weights = cases[::2], updates[::2], weights[::2] / np.maximum(1.0 - kicked, _TINY)
    after = mix_possibilities(predicted.bank, cases, updates, weights, params)
    total = np.where(diverged, -np.inf, total if fair is None else fair)
    whitened = _whitened_innovations(projected, compared)
    return PoseCycled(after, total, compared.innovation, kicked, np.sum(nis, axis=0), doubt, whitened)


def _find_diverged(bank: PoseBank, compared: Compared, projected: Array, time_s: float) -> np.ndarray:
    """Flags filters whose numbers are not finite or innovation covariance not definite; raises if the first is one.

    A hypothesis that is far from the truth may in its first seconds; the first filter may not.

    Raises:
        NotPositiveDefiniteError: when the first has, with the time.
    """
    expected = projected + compared.variance
    parts = (expected, compared.innovation, bank.mean, bank.covariance)
    finite = np.logical_and.reduce([np.isfinite(part).reshape(projected.shape[0], -1).all(axis=1) for part in parts])
    least = np.linalg.eigvalsh(np.where(finite[:, None, None], expected, np.eye(projected.shape[1])))[:, 0]
    diverged = ~(finite & (least > 0.0))
    if diverged[0]:
        raise NotPositiveDefiniteError(bank.covariance[0], "the pose estimator's covariance", time_s)
    return diverged


def _values_of_first(values: Array, flags: np.ndarray) -> Array:
    """Replaces the values of flagged filters by the first filter's, shape (n_filters, ...)."""
    return np.where(flags.reshape(-1, *(1,) * (values.ndim - 1)), values[:1], values)


class Happened(NamedTuple):
    """Possibility of an interval: as modeled, a kick, or poor readings.

    Attributes:
        chance: its probability.
        kick: root of what a kick adds to the covariance of the state, shape (n_filters, n, 12); None: there was none.
        beside: what the readings are then.
        crossed: covariance of the state with them.
        shown: what the state's covariance shows in them, by way of `crossed`.
    """

    chance: float
    kick: Array | None
    beside: Compared
    crossed: Array
    shown: Array


def kick_and_outlier_chances(
    compared: Compared, span_s: tuple[float, float], params: PoseParams
) -> tuple[float, float]:
    """Computes probabilities of a kick (sudden change of velocity and rate) and of outlying pose readings, if any."""
    kick = 1.0 - np.exp(-params.kicks_per_s * (span_s[1] - span_s[0]))
    return float(kick), params.pose.outliers if compared.poses.any() else 0.0


def list_possibilities(
    predicted: Predicted, good_and_poor: tuple[Compared, Compared], probabilities: tuple[float, float]
) -> list[Happened]:
    """Lists an interval's possibilities (as modeled; a kick; outliers), each with covariances of state and readings.

    Args:
        predicted: the bank before the readings.
        good_and_poor: readings as good ones and as poor ones.
        probabilities: of a kick and of poor readings; zero: it is not among them.
    """
    (good, noisy), (of_kick, of_poor) = good_and_poor, probabilities
    by = np.swapaxes(good.jacobian, 1, 2)
    crossed = predicted.bank.covariance @ by
    cases = [Happened(1.0 - of_kick - of_poor, None, good, crossed, good.jacobian @ crossed)]
    if of_kick > 0.0:
        kick_effect = good.jacobian @ predicted.kick
        back = np.swapaxes(kick_effect, 1, 2)
        kicked = crossed + predicted.kick @ back, cases[0].shown + kick_effect @ back
        cases.append(Happened(of_kick, predicted.kick, good, *kicked))
    if of_poor > 0.0:
        cases.append(cases[0]._replace(chance=of_poor, beside=noisy))
    return cases


def mix_possibilities(
    bank: PoseBank, cases: list[Happened], updates: list[PoseUpdate], weights: Array, params: PoseParams
) -> PoseBank:
    """Mixes the updates by all possibilities by moment matching; returns the bank after the readings.

    Args:
        bank: before the readings.
        cases, updates: what may have, and the update by each, n of them.
        weights: probability of each, shape (n, n_filters).
    """
    each = np.stack([update.correction for update in updates])
    correction = np.einsum("kh,khn->hn", weights, each)
    covariance = bank.covariance
    for part, case in zip(weights[:, :, None, None], cases, strict=True):
        if case.kick is not None:
            covariance = covariance + (part * case.kick) @ np.swapaxes(case.kick, 1, 2)
    apart = np.moveaxis(each - correction, 0, -1)
    left = [part * update.learned for part, update in zip(weights[:, :, None, None], updates, strict=True)]
    left.append(-0.5 * weights.T[:, None, :] * apart)
    taken = np.concatenate(left, axis=2) @ np.swapaxes(
        np.concatenate([*(update.gain for update in updates), apart], axis=2), 1, 2
    )
    return apply_correction(bank, correction, covariance - (taken + np.swapaxes(taken, 1, 2)), params)


def possibility_updates(cases: list[Happened], mean: Array, params: PoseParams) -> list[PoseUpdate]:
    """Computes each possibility's Kalman update; inverse inertia stays in filters where it would turn unphysical."""
    factors = np.ones((mean.shape[0], params.free.size))
    updates = _joseph_updates(cases, factors)
    corrections = np.stack([update.correction for update in updates])
    possible = np.all(_is_spin_physical(mean, corrections, params), axis=0)
    if not possible.all():
        factors = np.where(possible[:, None] | ~_select_spin(params), 1.0, 0.0)
        updates = _joseph_updates(cases, factors)
    return updates


def _select_spin(params: PoseParams) -> np.ndarray:
    """Flags free elements that belong to K (inverse inertia times mass), shape (n,)."""
    spin = params.parts.spin
    return (params.free >= spin.start) & (params.free < spin.stop)


def _is_spin_physical(mean: Array, correction: Array, params: PoseParams) -> np.ndarray:
    """Tests whether a correction leaves K (inverse inertia times mass) positive definite, (k, n_filters)."""
    part, chosen = params.parts.spin, _select_spin(params)
    after = np.repeat(mean[None, :, part], len(correction), axis=0)
    after[..., params.free[chosen] - part.start] += correction[..., chosen]
    start = np.broadcast_to(params.start[part], (1, *after.shape[1:]))
    least = np.linalg.eigvalsh(np.concatenate((after, start))[..., ELEMENT])[..., 0]
    return np.asarray(least[:-1] > _LEAST * least[-1])


def scale_pose_noise(compared: Compared, scale: float) -> Compared:
    """Returns compared readings with the 1-sigma of pose readings multiplied by a factor."""
    grown = np.where(compared.poses, scale, 1.0)
    return compared._replace(variance=compared.variance * grown[:, None] * grown)


def _gaussian_log_density(expected: Array, innovation: Array) -> tuple[Array, Array]:
    """Computes NIS and log density, nats, of innovations by their covariance, shape (n_filters,) each."""
    half = np.linalg.cholesky(expected)
    nis = np.sum(np.linalg.solve(half, innovation[..., None])[..., 0] ** 2, axis=1)
    determinant = 2.0 * np.sum(np.log(np.diagonal(half, axis1=1, axis2=2)), axis=1)
    return nis, -0.5 * (nis + determinant + innovation.shape[1] * _TWO_PI)


def _nis_by_kind(projected: Array, compared: Compared) -> Array:
    """Computes the first filter's NIS and its degrees of freedom by kind of sensor, see `PoseCycled.of_first`."""
    result = np.zeros((2, 2))
    off, expected = compared.innovation[0], projected + compared.variance[0]
    for row, chosen in enumerate((compared.turning, ~compared.turning)):
        if chosen.any():
            result[row] = off[chosen] @ np.linalg.solve(expected[np.ix_(chosen, chosen)], off[chosen]), chosen.sum()
    return result


def _whitened_innovations(projected: Array, compared: Compared) -> Array:
    """Whitens innovations by the covariance that the bank expects on average, shape (n_filters, m)."""
    expected = np.mean(projected + compared.variance, axis=0)
    return np.asarray(np.linalg.solve(np.linalg.cholesky(expected), compared.innovation.T).T, dtype=np.float64)


def _joseph_updates(cases: list[Happened], gain_factors: Array) -> list[PoseUpdate]:
    """Computes each possibility's Kalman update in Joseph form, gains times ``gain_factors``, (n_filters, n).

    It is Joseph's, (1 - K H) P (1 - K H)^T + K R K^T, multiplied out: P - K C^T - C K^T + K S K^T with C = P H^T, which
    are products of few columns, as many as there are readings.
    """
    count = len(cases)
    crossed = np.concatenate([case.crossed for case in cases])
    expected = np.concatenate([case.shown + case.beside.variance for case in cases])
    innovation = np.tile(cases[0].beside.innovation, (count, 1))
    nis, likelihood = _gaussian_log_density(expected, innovation)
    gain = np.swapaxes(np.linalg.solve(expected, np.swapaxes(crossed, 1, 2)), 1, 2)
    gain = gain * np.tile(gain_factors, (count, 1))[..., None]
    learned = crossed - 0.5 * gain @ expected
    correction = (gain @ innovation[..., None])[..., 0]
    parts = (np.split(part, count) for part in (correction, likelihood, nis, gain, learned))
    return [PoseUpdate(*case) for case in zip(*parts, strict=True)]
