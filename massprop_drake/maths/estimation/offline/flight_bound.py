"""Cramer-Rao bound of a flight, for rounding taken as noise, with what drifts as propellant is used."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from massprop_drake.maths.estimation.joint.layout import N_PROPERTIES
from massprop_drake.maths.estimation.offline.expected_motion import stretch_motion, turning_effects
from massprop_drake.maths.estimation.offline.flight_model import FlightModel, Stretch, relevant_unknowns
from massprop_drake.maths.estimation.offline.motion_derivatives import motion_derivatives
from massprop_drake.maths.estimation.offline.normal_equations import (
    component_batches,
    reading_derivatives,
    sensor_components,
    stretch_equations,
    sum_equations,
)
from massprop_drake.maths.linear_algebra import Array

_ROWS = (32, 16, 8, 4, 2)  # on average of a part of a stretch where inertia and center of mass drift, ever fewer
_ALIKE = 0.03  # by which a bound may change with shorter parts


class _PartInformation(NamedTuple):
    """Information of parts of a stretch on the u estimated unknowns, on ticks, and on initial values of components.

    Each of c components reads what the unknowns have made it gain since its first reading, and what it was then.

    Attributes:
        information: of each part, shape (p, s, s), with s = u + ticks + c.
        gained: derivatives of what each component has gained up to each cut, by the ten parameters, shape
            (p + 1, c, 10).
        variances: of ticks, and of what the first readings tell, shape (s - u,).
    """

    information: Array
    gained: Array
    variances: Array


def _part_information(
    stretch: Stretch, cuts: NDArray[np.int_], unknowns: Array, model: FlightModel
) -> _PartInformation:
    """Computes the information on the unknowns from each part of a stretch between ``cuts``, rows, (p + 1,)."""
    (motion, unknowns), estimated = stretch_motion(stretch, unknowns, model), relevant_unknowns(model)
    effects, design = turning_effects(motion, unknowns, model), motion_derivatives(motion, unknowns, model, estimated)
    components = list(sensor_components(motion, effects, unknowns, model))
    known = np.flatnonzero(estimated[design.kept])
    taken = np.concatenate((known, np.arange(design.kept.size, design.by_rate.shape[0])))
    u, n_ticks = int(estimated.sum()), design.by_rate.shape[0] - design.kept.size
    places = np.concatenate((np.cumsum(estimated)[design.kept[known]] - 1, np.arange(u, u + n_ticks)))
    information = np.zeros((cuts.size - 1, *2 * (u + n_ticks + len(components),)))
    gained, number = np.zeros((cuts.size, len(components), N_PROPERTIES)), 0
    with_cuts = (one._replace(rows=np.concatenate((one.rows, cuts))) for one in components)
    for batch in component_batches(with_cuts, model.gyros):
        derivatives = reading_derivatives(design, batch, effects, unknowns, model)[taken]
        for one, begin in zip(batch.parts, batch.begins.tolist(), strict=True):
            x = derivatives[:, begin : begin + one.rows.size] / math.sqrt(model.variances[one.package])
            x -= x[:, :1]
            own = u + n_ticks + number
            rows, of_rows, of_cuts = one.rows[1 : -cuts.size], x[:, 1 : -cuts.size], x[:, -cuts.size :]
            gained[:, number] = np.where(cuts > one.rows[0], of_cuts[:N_PROPERTIES], 0.0).T
            ends = np.searchsorted(rows, cuts, side="right").tolist()
            for part, (first, last) in zip(information, pairwise(ends), strict=True):
                within = of_rows[:, first:last]
                part[np.ix_(places, places)] += within @ within.T
                part[places, own] = part[own, places] = within.sum(axis=1)
                part[own, own] = last - first
            number += 1
    return _PartInformation(information, gained, np.concatenate((design.own, np.ones(len(components)))))


def _cut_rows(propellant: Array, rows_per_part: int) -> NDArray[np.int_]:
    """Returns rows, (p + 1,), that cut a stretch into parts alike in propellant use plus duration; one without use."""
    last = propellant.shape[0] - 1
    if propellant[-1] <= 0.0 or rows_per_part >= last:
        return np.array([0, last])
    share = propellant / propellant[-1] + np.arange(last + 1) / last
    inner = np.searchsorted(share, np.linspace(0.0, 2.0, -(-last // rows_per_part) + 1)[1:-1])
    return np.unique(np.concatenate(([0], inner, [last])))


def cramer_rao_deviation(
    stretches: Sequence[Stretch],
    unknowns: Array,
    initial_covariance: Array,
    drift: Array,
    model: FlightModel,
    information: Array | None = None,
) -> Array:
    """Computes Cramer-Rao 1-sigmas of the ten parameters, rounding as noise, NaN: not finite, shape (10,).

    What changes with propellant that is used does so half before and half after what each part of a stretch shows, and
    parts are made shorter until it makes no difference.

    Args:
        stretches: of the flight, in order.
        unknowns: all unknowns, about which it is taken, shape (n,); see `possible`.
        initial_covariance: covariance of the ten at the start, shape (10, 10).
        drift: variances that are added to the ten for each unit of propellant, shape (10,).
        model: for what else is reckoned with.
        information: A of all stretches together, where it is known, shape (n, n); else it is found.
    """
    estimated = relevant_unknowns(model)
    root = np.diag(model.sigma[estimated])
    root[:N_PROPERTIES, :N_PROPERTIES] = _covariance_root(initial_covariance)
    if not drift.any():
        if information is None:
            information = sum_equations(
                [stretch_equations(one, unknowns, model, estimated) for one in stretches], model
            ).information
        return _deviation(_add_information(root, information[np.ix_(estimated, estimated)]))
    before = np.zeros(N_PROPERTIES)
    for rows in _ROWS:
        found = _deviation(_root_after_flight(root, stretches, unknowns, drift, model, rows))
        if not (np.abs(found - before) > _ALIKE * found).any():  # NaN stays so
            break
        before = found
    return found


def _deviation(root: Array) -> Array:
    """Computes 1-sigmas of the ten parameters from a root of the covariance, shape (10,)."""
    return np.sqrt(np.sum(root[:N_PROPERTIES] ** 2, axis=1))


def _root_after_flight(
    root: Array, stretches: Sequence[Stretch], unknowns: Array, drift: Array, model: FlightModel, rows_per_part: int
) -> Array:
    """Computes a root of the unknowns' covariance after a flight, stretches cut about every ``rows_per_part`` rows."""
    used_after = stretches[0].used_after[0] if stretches else 0.0
    for stretch in stretches:
        used = stretch.used_after[0] - stretch.used_after
        cuts = _cut_rows(used, rows_per_part)
        root = _add_drift(root, drift * (used_after - stretch.used_after[0]))
        root = _root_after_stretch(root, _part_information(stretch, cuts, unknowns, model), drift, np.diff(used[cuts]))
        used_after = stretch.used_after[-1]
    return root


def _add_information(root: Array, information: Array) -> Array:
    """Updates a covariance's matrix root by an information matrix; NaN throughout where the result is not finite."""
    inner = root.T @ information @ root
    if not np.isfinite(inner).all():
        return np.full_like(root, np.nan)
    values, vectors = np.linalg.eigh(inner)
    return root @ (vectors / np.sqrt(1.0 + np.maximum(values, 0.0)))


def _root_after_stretch(initial_root: Array, parts: _PartInformation, drift: Array, propellant: Array) -> Array:
    """Updates a root of the unknowns' covariance by a stretch: information and drift, part by part."""
    u, size = initial_root.shape[0], parts.information.shape[1]
    root = np.zeros((size, size))
    root[:u, :u], root[range(u, size), range(u, size)] = initial_root, np.sqrt(parts.variances)
    halves = 0.5 * np.concatenate(([0.0], propellant, [0.0]))
    for part, gained, more in zip(parts.information, parts.gained, halves[:-2] + halves[1:-1], strict=False):
        root = _add_information(_add_drift(root, drift * more, gained), part)
    return _add_drift(root[:u], drift * halves[-2])


def _add_drift(root: Array, drift: Array, gains: Array | None = None) -> Array:
    """Adds variances of drift of the ten parameters to a root of a covariance; returns a square root matrix.

    What a component has gained is as it was: from now on it is told from what it would have gained with the parameters
    as they have become.
    """
    ways = np.zeros((root.shape[0], N_PROPERTIES))
    ways[:N_PROPERTIES] = np.diag(np.sqrt(drift))
    if gains is not None:
        ways[root.shape[0] - gains.shape[0] :] = -gains * np.sqrt(drift)
    together = np.hstack((root, ways[:, drift > 0.0]))
    if together.shape[0] == together.shape[1]:
        return together
    return np.asarray(np.linalg.qr(together.T, mode="r")).T


def _covariance_root(matrix: Array) -> Array:
    """Computes a root of a covariance by eigenvalues, negative ones as zero, shape (n, n)."""
    scale = np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    values, vectors = np.linalg.eigh(matrix / np.outer(scale, scale))
    return scale[:, None] * vectors * np.sqrt(np.maximum(values, 0.0))
