r"""Rate that impulses and dynamic coupling give, with the rates in coupling taken as known, and its derivatives."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from massprop_drake.maths.estimation.joint.layout import CENTER
from massprop_drake.maths.estimation.joint.rate_coupling import PARABOLA
from massprop_drake.maths.estimation.offline.thrust_course import Lengths, common_length
from massprop_drake.maths.linear_algebra import Array, cross_products
from massprop_drake.maths.mass_properties import ELEMENT

CROSS = np.zeros((3, 3, 3))  # component i of a cross b is CROSS[i, j, k] a_j b_k
CROSS[[0, 1, 2], [1, 2, 0], [2, 0, 1]], CROSS[[0, 1, 2], [2, 0, 1], [1, 2, 0]] = 1.0, -1.0
_ELEMENTS = np.array([1.0 * (element == ELEMENT) for element in range(6)])  # (6, 3, 3)


class MeanRates(NamedTuple):
    """Rates over intervals, at their middles, and their gain, shape (3, m - 1) each, and the mean of w w^T."""

    middle: Array
    gained: Array
    square: Array  # (3, 3, m - 1)


def mean_rates(rate: Array) -> MeanRates:
    """Computes interval means, changes and mean products w w^T of rates at the rows, shape (3, m)."""
    middle, squares = 0.5 * (rate[:, :-1] + rate[:, 1:]), rate[:, None] * rate
    mean = (squares[..., :-1] + squares[..., 1:] + 4.0 * (middle[:, None] * middle)) / 6.0
    return MeanRates(middle, np.diff(rate), mean)


class ImpulseSums(NamedTuple):
    """Impulses over the intervals of a stretch, about the vehicle origin."""

    impulse: Array  # (6, m - 1)
    bow: Array  # (3, 6, m - 1)
    late: Array | None  # at each stamp besides, (6, m), where one is late
    acting: Array | None  # what jets give at each stamp, (6, m), where one is late


def moments_about(wrenches: Array, center: Array) -> Array:
    """Computes torques about a center of mass, (..., 3, n), from wrenches about the origin, (..., 6, n)."""
    return wrenches[..., :3, :] + np.tensordot(center, CROSS, 1) @ wrenches[..., 3:, :]


def impulse_moments(
    impulses: ImpulseSums, rate: Array, wheel_momentum: Array, period_s: Lengths, unknowns: Array
) -> Array:
    """Computes how angular impulse departs from linear growth within intervals, coupling included, (3, 3, m - 1).

    Args:
        rate: at the rows, shape (3, m).
        wheel_momentum: angular momentum of the wheels, likewise.
        period_s: length of an interval.
        unknowns: all unknowns, shape (n,).
    """
    momentum = np.linalg.inv(unknowns[:6][ELEMENT]) @ rate + wheel_momentum
    coupled = np.diff(cross_products(rate.T, momentum.T).T) * (period_s / 12.0)
    bows = moments_about(impulses.bow, unknowns[CENTER])
    bows[0] += coupled
    bows[2] += PARABOLA * coupled
    return bows


class _Coupling(NamedTuple):
    """Dynamic coupling, by inverse inertias, as it multiplies products of rates and bows, see `GainedRate`.

    Attributes:
        straight: of the rates by themselves, shape (..., 3, 3, 3).
        bent: of the rates with the bows.
        bowed: of the bows by themselves.
    """

    straight: Array
    bent: Array
    bowed: Array


def _coupling(inverse: Array) -> _Coupling:
    """Computes the matrices of dynamic coupling from an inverse inertia, shape (3, 3)."""
    straight = CROSS @ np.linalg.inv(inverse)
    return _Coupling(straight, CROSS + straight.transpose(0, 2, 1) @ inverse, inverse @ CROSS)


def _coupling_derivatives(inverse_changes: Array, inverse: Array, coupling: _Coupling) -> _Coupling:
    """Computes derivatives of the coupling matrices by changes of the inverse inertia, shape (e, 3, 3)."""
    inertia = np.linalg.inv(inverse)
    straight = CROSS @ (-inertia @ inverse_changes @ inertia)[:, None]
    directions = inverse_changes[:, None]
    bent = straight.transpose(0, 1, 3, 2) @ inverse + coupling.straight.transpose(0, 2, 1) @ directions
    return _Coupling(straight, bent, directions @ CROSS)


# Sums since the beginning, of which the rate and its derivatives are made: the angular impulse, less coupling; products
# of rates, of rates and bows, of bows; forces, and products of rates or bows and the bows of forces; rates and bows.
_PULLED, _PRODUCTS, _SHIFTING, _BIASING = slice(0, 3), slice(3, 30), slice(30, 51), slice(51, 57)


class GainedRate(NamedTuple):
    """Terms of the rate gained since the beginning; the rates and bows in its coupling are taken as known.

    Attributes:
        sums: see above, shape (57, m).
        coupling: see `_Coupling`.
        rate: shape (3, m).
    """

    sums: Array
    coupling: _Coupling
    rate: Array


def gained_rate(impulses: ImpulseSums, means: MeanRates, bows: Array, period_s: Lengths, unknowns: Array) -> GainedRate:
    """Computes the change of rate in a stretch, coupling by given rates and ``bows`` (from `impulse_moments`)."""
    inverse, n = unknowns[:6][ELEMENT], means.middle.shape[1]
    coupling = _coupling(inverse)
    result = np.zeros((_BIASING.stop, n + 1))
    each = result[:, 1:]
    each[_PULLED] = moments_about(impulses.impulse, unknowns[CENTER])
    products = each[_PRODUCTS].reshape(3, 3, 3, n)
    products[0] = means.square
    products[1] = means.middle[:, None] * bows[0] + means.gained[:, None] * bows[1]
    products[2] = bows[2][:, None] * bows[2]
    force, by_force = each[_SHIFTING][:3], each[_SHIFTING][3:].reshape(2, 3, 3, n)
    force[:] = impulses.impulse[3:]
    by_force[0] = means.middle[:, None] * impulses.bow[0, 3:] + means.gained[:, None] * impulses.bow[1, 3:]
    by_force[1] = bows[2][:, None] * impulses.bow[2, 3:]
    each[_BIASING][:3], each[_BIASING][3:] = means.middle, bows[0]
    if isinstance(period_s, np.ndarray):
        for part in (each[_PRODUCTS], each[_SHIFTING][3:], each[_BIASING]):
            part[:] = part * period_s
    np.cumsum(result, axis=-1, out=result)
    if impulses.late is not None:
        result[_PULLED] += moments_about(impulses.late, unknowns[CENTER])
        result[_SHIFTING][:3] += impulses.late[3:]
    result[_PULLED] -= common_length(period_s) * (_flatten_coupling(coupling) @ result[_PRODUCTS])
    return GainedRate(result, coupling, inverse @ result[_PULLED])


def _flatten_coupling(coupling: _Coupling) -> Array:
    """Reshapes the coupling matrices to one that multiplies all products of rates, shape (..., 3, 27)."""
    return np.concatenate([part.reshape(*part.shape[:-2], 9) for part in coupling], axis=-1)


def rate_derivatives(rate_terms: GainedRate, period_s: Lengths, unknowns: Array) -> tuple[Array, Array]:
    """Computes derivatives of the change of rate by inverse inertia, center of mass and gyro biases.

    What the bow that coupling itself gives changes by is left out: it is a small part of a small part.

    Returns:
        By elements 0 to 8, shape (9, 3, m), and by gyro biases, shape (3, 3, m).
    """
    inverse, (straight, bent, bowed), sums = unknowns[:6][ELEMENT], rate_terms.coupling, rate_terms.sums
    coupled = -common_length(period_s) * inverse
    of_element = _flatten_coupling(_coupling_derivatives(_ELEMENTS, inverse, rate_terms.coupling))
    by_elements = np.concatenate((_ELEMENTS, coupled @ of_element), axis=-1)
    both, ways = bowed + bowed.transpose(0, 2, 1), CROSS[:, None]
    by_bows = [(part @ ways).reshape(3, 3, 9) for part in (bent, both)]
    by_center = np.concatenate((inverse @ CROSS, *(coupled @ part for part in by_bows)), axis=-1)
    of_rate = straight.transpose(1, 0, 2) + straight.transpose(2, 0, 1)
    by_bias = -coupled @ np.concatenate((of_rate, bent.transpose(1, 0, 2)), axis=-1)
    m = sums.shape[1]
    moved = np.empty((9, 3, m))
    np.matmul(by_elements.reshape(18, 30), sums[:30], out=moved[:6].reshape(18, m))
    np.matmul(by_center.reshape(9, 21), sums[_SHIFTING], out=moved[6:].reshape(9, m))
    return moved, (by_bias.reshape(9, 6) @ sums[_BIASING]).reshape(3, 3, m)


def turning_products(rate: Array, means: MeanRates, rate_moments: Array, period_s: Lengths) -> Array:
    """Computes [(w - w_0) x] + integral of [w x]^2, by which lever arms enter velocities, shape (3, 3, m)."""
    crossed = means.middle[:, None] * rate_moments[0] + means.gained[:, None] * rate_moments[1]
    square = np.zeros((3, 3, rate.shape[1]))
    each = means.square + crossed + crossed.transpose(1, 0, 2) + rate_moments[2][:, None] * rate_moments[2]
    np.cumsum(each * period_s, axis=-1, out=square[..., 1:])
    turning = square - (CROSS.reshape(9, 3) @ (rate - rate[:, :1])).reshape(square.shape)
    turning[range(3), range(3)] -= np.trace(square)
    return np.asarray(turning)


def cumulative_sums(changes: Array) -> Array:
    """Sums changes over intervals, (..., m - 1), from the first row to each row, shape (..., m)."""
    sums = np.zeros((*changes.shape[:-1], changes.shape[-1] + 1))
    np.cumsum(changes, axis=-1, out=sums[..., 1:])
    return sums


def cross_product_matrices(vectors: Array) -> Array:
    """Computes the cross product matrix [v x] of vectors, shape (3, 3, m) from (3, m)."""
    return np.asarray(np.tensordot(CROSS, vectors, ((1,), (0,))))


def add_rate_coupling(uncoupled: Array, rate: Array, wheel_momentum: Array, lengths_s: Array, unknowns: Array) -> Array:
    """Adds gyroscopic coupling to rate changes G: D = G + integral(I^-1 ([(I w + h) x] - [w x] I) D), (3, c, m).

    Args:
        uncoupled: G, the changes with the rates in coupling held, shape (3, c, m).
        rate: w, shape (3, m).
        wheel_momentum: h, angular momentum of the wheels, shape (3, m).
        lengths_s: of the intervals, shape (m - 1,).
        unknowns: all unknowns, for the inverse inertia.
    """
    inverse = unknowns[:6][ELEMENT]
    inertia, half = np.linalg.inv(inverse), 0.5 * lengths_s[:, None, None]
    crossed = cross_product_matrices(inertia @ rate + wheel_momentum) - np.einsum(
        "ijm,jk->ikm", cross_product_matrices(rate), inertia
    )
    coupling = np.einsum("ij,jkm->mik", inverse, crossed)
    onward = np.linalg.inv(np.eye(3) - half * coupling[1:])  # by trapezoids
    before, gained = onward @ (np.eye(3) + half * coupling[:-1]), onward @ np.moveaxis(np.diff(uncoupled), -1, 0)
    result, now = np.empty((uncoupled.shape[2], *uncoupled.shape[:2])), uncoupled[:, :, 0]
    result[0] = now
    for row in range(uncoupled.shape[2] - 1):
        now = before[row] @ now + gained[row]
        result[row + 1] = now
    return np.ascontiguousarray(np.moveaxis(result, 0, -1))
