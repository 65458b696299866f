"""Derivatives of the motion expected over a stretch by all unknowns."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from massprop_drake.maths.estimation.joint.layout import CENTER, MASS, N_PROPERTIES
from massprop_drake.maths.estimation.offline.coupled_rates import (
    CROSS,
    add_rate_coupling,
    cumulative_sums,
    moments_about,
    rate_derivatives,
)
from massprop_drake.maths.estimation.offline.expected_motion import (
    ExpectedMotion,
    TurningEffects,
    acting_wrenches,
    engine_impulses,
    mean_cross_products,
    mounted_wrenches,
    wheel_momentum,
    with_swings,
)
from massprop_drake.maths.estimation.offline.flight_model import FlightModel, columns
from massprop_drake.maths.estimation.offline.swings import start_variances
from massprop_drake.maths.estimation.offline.thrust_course import (
    Lengths,
    RecordedStretch,
    centered_counts,
    common_length,
    weigh_by_length,
)
from massprop_drake.maths.linear_algebra import Array, cross_products
from massprop_drake.maths.mass_properties import ELEMENT

_TICKS = 2  # unknowns of a stretch: when its ticks are, and their period


class MotionDerivatives(NamedTuple):
    """Derivatives of the expected readings of a stretch, at every row.

    Of k unknowns that have any, and after them of ticks that are late and of modes at the beginning, n in all.
    """

    kept: NDArray[np.int_]  # which unknowns, (k,)
    own: Array  # variances of those of the stretch alone, which come after them, (n - k,)
    place: NDArray[np.int_]  # of each among them, -1: none
    by_rate: Array  # of the rate since the beginning, (n, 3, m)
    by_velocity: Array  # likewise, (n, 3, m)
    by_whole: Array  # of the rate with its initial value, (n, 3, m)
    by_center: Array | None = None  # of the center of mass in the middle, (k, 3); None: it is one of the unknowns


def motion_derivatives(
    motion: ExpectedMotion, unknowns: Array, model: FlightModel, selected: NDArray[np.bool_]
) -> MotionDerivatives:
    """Computes derivatives of expected rate and velocity by selected unknowns, then by clock errors and mode states."""
    places, thrust, record, light = columns(model), motion.course, motion.course.read, motion.lightness
    there = selected[places.thrust][record.on]
    if there.any():
        there &= ((thrust.amount != 0.0) | (thrust.by_lag != 0.0)).any(axis=0)
    has = selected.copy()
    steady = places.gyro_bias, places.torque, places.drag, places.momentum
    for group in (places.properties, places.lag, *steady, places.wheel, places.engine, places.mount):
        has[group] = selected[group].any()
    has[places.properties], has[places.thrust], has[places.shift] = True, False, motion.by_shift is not None
    has[places.moving] = True
    has[places.thrust][record.on[there]] = True
    indices, row_of = np.flatnonzero(has), np.where(has, np.cumsum(has) - 1, -1)
    inverse, mounted = unknowns[:6][ELEMENT], mounted_wrenches(unknowns, model)[record.on]
    forces = mounted[:, 3:]
    moments = (mounted[:, :3] + cross_products(forces, unknowns[CENTER])) @ inverse
    ticks, m = _tick_derivatives(motion, unknowns, model), motion.rate.shape[1]
    by_rate, by_velocity = np.zeros((2, indices.size + ticks.shape[1], 3, m))
    by_rate[indices.size :], by_velocity[indices.size :] = ticks
    by_rate[row_of[:MASS]], by_bias = rate_derivatives(motion.gained, record.period_s, unknowns)
    by_velocity[row_of[MASS]] = cumulative_sums(motion.sums.impulse[3:] * (light / unknowns[MASS]) ** 2)
    if has[places.gyro_bias].any():
        by_rate[row_of[places.gyro_bias]] = by_bias
    if has[places.lag].any():
        by_lag = _lag_derivatives(motion, np.hstack((moments, forces)), unknowns, model)
        by_rate[row_of[places.lag]], by_velocity[row_of[places.lag]] = by_lag[:, :3], by_lag[:, 3:]
    if motion.by_shift is not None:
        by_rate[row_of[places.shift]] = motion.by_shift
    amount, jets = thrust.amount[:, there].T, slice(N_PROPERTIES, N_PROPERTIES + int(there.sum()))
    by_rate[jets] = moments[there][:, :, None] * cumulative_sums(amount)[:, None]
    by_velocity[jets] = forces[there][:, :, None] * cumulative_sums(amount * light)[:, None]
    turned = common_length(record.period_s) * inverse  # rate by a torque of one over an interval, or over a second
    ways = cumulative_sums(weigh_by_length(0.5 * (record.rate[:, :-1] + record.rate[:, 1:]), record.period_s))
    if has[places.torque].any():
        lasted = cumulative_sums(weigh_by_length(np.ones(m - 1), record.period_s))
        by_rate[row_of[places.torque]] = turned[:, :, None] * lasted
    if has[places.drag].any():
        by_rate[row_of[places.drag]] = -turned[:, :, None] * ways[:, None]
    for group, by in (
        (places.wheel, wheel_derivatives),
        (places.engine, _engine_derivatives),
        (places.mount, _mounting_derivatives),
    ):
        if has[group].any():
            by_rate[row_of[group]], by_velocity[row_of[group]] = by(motion, unknowns, model)
    if has[places.gyro_bias].any() and record.momenta.size:
        by_rate[row_of[places.gyro_bias]] += _bias_derivatives(
            wheel_momentum(record, unknowns, model), turned, record.period_s
        )
    if has[places.momentum].any():
        by_rate[row_of[places.momentum]] = cross_products(ways.T[:, None], turned.T).transpose(2, 1, 0)
    return _complete_derivatives((by_rate, by_velocity), indices, row_of, motion, unknowns, model)


def _complete_derivatives(
    derivatives: tuple[Array, Array],
    indices: NDArray[np.int_],
    row_of: NDArray[np.int_],
    motion: ExpectedMotion,
    unknowns: Array,
    model: FlightModel,
) -> MotionDerivatives:
    """Puts draining tanks, modes and initial rate into a stretch's derivatives, with variances of its own unknowns."""
    record, places, by_center = motion.course.read, columns(model), None
    if record.through is not None:
        _convert_from_middle(derivatives, indices, motion, unknowns, model)
        by_center = record.through.by[CENTER, indices].T
    own = _tick_variances(record.late_s) if derivatives[0].shape[0] > indices.size else np.zeros(0)
    if model.modes.frequencies.size:
        derivatives = _add_modes(motion, derivatives, row_of[places.moving], unknowns, model)
        own = np.append(own, start_variances(model.modes))
    whole = _add_initial_values(derivatives[0], row_of[places.gyro_bias], record)
    return MotionDerivatives(indices, own, row_of, *derivatives, whole, by_center)


def _add_modes(
    motion: ExpectedMotion,
    derivatives: tuple[Array, Array],
    rows: NDArray[np.int_],
    unknowns: Array,
    model: FlightModel,
) -> tuple[Array, Array]:
    """Adds modes' effects to derivatives of rate and velocity; appends those by initial eta and eta'."""
    swings, k = with_swings(motion, derivatives, unknowns, model), derivatives[0].shape[0]
    own = np.concatenate((np.arange(k), np.arange(k + rows.size, swings.by_rate.shape[0])))
    by_rate, by_velocity = swings.by_rate[own], swings.by_velocity[own]
    parts = slice(k, k + rows.size)
    by_rate[rows], by_velocity[rows] = swings.by_rate[parts], swings.by_velocity[parts]
    return by_rate, by_velocity


def _convert_from_middle(
    derivatives: tuple[Array, Array],
    indices: NDArray[np.int_],
    motion: ExpectedMotion,
    unknowns: Array,
    model: FlightModel,
) -> None:
    """Converts derivatives by parameters at a stretch's middle to those by all unknowns, in place."""
    record, places, k = motion.course.read, columns(model), indices.size
    through = record.through
    assert through is not None
    for each in derivatives:
        own = each[:N_PROPERTIES].copy()
        each[:N_PROPERTIES] = 0.0
        each[:k] += np.tensordot(through.by[:, indices].T, own, 1)
    by_rate, by_velocity = derivatives
    lighter = -motion.sums.impulse[3:] * motion.lightness**2
    moved, _ = rate_derivatives(motion.gained, record.period_s, unknowns)
    for tank, (slope, to_draw) in enumerate(zip(record.by_draw, record.to_draw, strict=True)):
        by_rate[:k] += np.tensordot(through.slopes[tank][:, indices].T, cumulative_sums(np.diff(moved) * to_draw), 1)
        along = np.diff(np.tensordot(slope, moved, 1))
        for place, unknown in enumerate(indices.tolist()):
            if places.thrust.start <= unknown < places.thrust.stop:
                more = through.by_jets[tank, unknown - places.thrust.start]
            elif unknown == places.flow.start + tank:
                more = to_draw / (1.0 + unknowns[unknown])
            else:
                continue
            by_rate[place] += cumulative_sums(along * more)
            by_velocity[place] += cumulative_sums(lighter * more)


def wheel_derivatives(motion: ExpectedMotion, unknowns: Array, model: FlightModel) -> tuple[Array, Array]:
    """Computes derivatives of rate and velocity by the errors of the wheels' inertias, shape (w, 3, m) each."""
    record = motion.course.read
    rate = record.rate - unknowns[columns(model).gyro_bias, None]
    result = np.empty((len(record.momenta), *rate.shape))
    for turned, own in zip(result, record.momenta, strict=True):
        turned[:] = unknowns[:6][ELEMENT] @ cumulative_sums(
            -np.diff(own) - record.period_s * mean_cross_products(rate, own)
        )
    return result, np.zeros_like(result)


def _engine_derivatives(motion: ExpectedMotion, unknowns: Array, model: FlightModel) -> tuple[Array, Array]:
    """Computes derivatives of rate and velocity by the errors of the engines, shape (e, 3, m) each."""
    _, by_errors = engine_impulses(motion.course.read, unknowns, model)
    turned, forces = by_errors[..., :3], by_errors[..., 3:]
    moments = (turned + cross_products(forces.reshape(-1, 3), unknowns[CENTER]).reshape(forces.shape)) @ unknowns[:6][
        ELEMENT
    ]
    by_velocity = forces * motion.lightness[:, None]
    return cumulative_sums(moments.transpose(0, 2, 1)), cumulative_sums(by_velocity.transpose(0, 2, 1))


def _mounting_derivatives(motion: ExpectedMotion, unknowns: Array, model: FlightModel) -> tuple[Array, Array]:
    """Computes derivatives of rate and velocity by the errors of the jets' mounting, shape (e, 3, m) each."""
    thrust, jets, wrenches = motion.course, model.mounting.jets, model.mounting.wrenches
    amounts = np.zeros((model.flows.size, thrust.amount.shape[0]))  # of jets that are on at some time, and of others
    amounts[thrust.read.on] = thrust.amount.T
    given = (1.0 + unknowns[columns(model).thrust][jets])[:, None] * amounts[jets]
    moments = (wrenches[:, :3] + cross_products(wrenches[:, 3:], unknowns[CENTER])) @ unknowns[:6][ELEMENT]
    by_rate = moments[:, :, None] * cumulative_sums(given)[:, None]
    return by_rate, wrenches[:, 3:, None] * cumulative_sums(given * motion.lightness)[:, None]


def _bias_derivatives(momentum: Array, rate_by_torque: Array, lengths_s: Lengths) -> Array:
    """Computes derivatives of rate by gyro biases through the wheels' gyroscopic torque, shape (3, 3, m)."""
    summed = cumulative_sums(weigh_by_length(0.5 * (momentum[:, :-1] + momentum[:, 1:]), lengths_s))
    return np.asarray(np.einsum("ij,kjm->kim", rate_by_torque, np.einsum("jkl,lm->kjm", CROSS, summed)))


def _add_initial_values(by_rate: Array, biases: NDArray[np.int_], record: RecordedStretch) -> Array:
    """Shifts the rate's derivatives such that the mean rate is that of readings less gyro biases."""
    counted = by_rate * record.there
    whole = by_rate - counted.sum(axis=2, keepdims=True) / record.there.sum(axis=1)[:, None]
    for axis, place in enumerate(biases.tolist()):
        if place >= 0:
            whole[place, axis] -= 1.0
    return whole


def centripetal_derivatives(derivatives: MotionDerivatives, rate: Array, arm: Array, period_s: Lengths) -> Array:
    """Computes derivatives of the integral of w x (w x arm) by the unknowns, from those of w, (n, 3, m).

    Args:
        derivatives: with these.
        rate: w, shape (3, m).
        arm: from the center of mass, shape (3,).
        period_s: length of an interval.
    """
    middle, by = (
        0.5 * (rate[:, :-1] + rate[:, 1:]),
        0.5 * (derivatives.by_whole[..., :-1] + derivatives.by_whole[..., 1:]),
    )
    along = np.tensordot(by, arm, (1, 0))  # (n, m - 1)
    each = by * (arm @ middle) + middle * along[:, None]
    each -= 2.0 * arm[:, None] * np.sum(by * middle, axis=1, keepdims=True)
    return cumulative_sums(period_s * each)


def _lag_derivatives(motion: ExpectedMotion, by_impulse: Array, unknowns: Array, model: FlightModel) -> Array:
    """Computes derivatives of the motion by valve lags, (l, 6, m), from those by jets' impulses, (j, 6)."""
    places, course = columns(model), motion.course
    kinds = np.arange(places.lag.stop - places.lag.start)[:, None] == model.kinds[course.read.on]
    thrust = 1.0 + unknowns[places.thrust][course.read.on]
    each = (by_impulse.T * (thrust * kinds)[:, None]).reshape(6 * kinds.shape[0], thrust.size) @ course.by_lag.T
    gained = each.reshape(kinds.shape[0], 6, course.by_lag.shape[0])
    gained[:, 3:] *= motion.lightness
    return cumulative_sums(gained)


def _tick_derivatives(motion: ExpectedMotion, unknowns: Array, model: FlightModel) -> Array:
    """Computes derivatives of rate and velocity by offset and period error of the command clock.

    Until a stamp a jet gives what it gives then for as much longer as its tick is earlier; with a shorter period, less
    in each. Constants make no difference.

    Returns:
        Of shape (2, 2, 3, m) where any stamp is late, else (2, 0, 3, m).
    """
    thrust, acting = motion.course, motion.sums.acting
    if acting is None:
        return np.zeros((2, 0, *motion.rate.shape))
    given = cumulative_sums(
        acting_wrenches(unknowns, thrust, model) @ thrust.amount.T / common_length(thrust.read.period_s)
    )
    wrenches = np.array([acting, centered_counts(acting.shape[1]) * acting - given])
    lightness = np.append(motion.lightness, motion.lightness[-1])
    return np.array([unknowns[:6][ELEMENT] @ moments_about(wrenches, unknowns[CENTER]), wrenches[:, 3:] * lightness])


def add_coupled_derivatives(
    derivatives: MotionDerivatives, effects: TurningEffects, unknowns: Array, model: FlightModel
) -> MotionDerivatives:
    """Adds the coupling of changes of rate to the derivatives; appends those by the mean rate."""
    place, m = derivatives.place[columns(model).gyro_bias], effects.rate.shape[1]
    straight = derivatives.by_rate.copy()
    straight[place[place >= 0]] = 0.0
    begun = np.concatenate((straight - straight[..., :1], np.repeat(np.eye(3)[:, :, None], m, axis=2)))
    lengths_s = np.broadcast_to(effects.period_s, m - 1)
    changes = add_rate_coupling(begun.swapaxes(0, 1), effects.rate, effects.held, lengths_s, unknowns).swapaxes(0, 1)
    by_start = changes[-3:]
    of_mean = np.linalg.inv(by_start.mean(axis=2)).T  # start by the mean of the rate: [i, j] is of component i by j
    by_mean = np.einsum("ij,ikm->jkm", of_mean, by_start)
    whole = changes[:-3] - np.einsum("nj,jkm->nkm", changes[:-3].mean(axis=2), by_mean)
    for axis, at_place in enumerate(place.tolist()):
        if at_place >= 0:
            whole[at_place] = -by_mean[axis]
    whole = np.concatenate((whole, by_mean))
    by_velocity = np.concatenate((derivatives.by_velocity, np.zeros((3, 3, m))))
    return derivatives._replace(by_rate=whole, by_velocity=by_velocity, by_whole=whole)


def _tick_variances(late_s: Array) -> Array:
    """Computes variances of offset and period of the command clock, fitted to stamps, shape (2,)."""
    counts = centered_counts(late_s.shape[0])
    variance = float(late_s @ late_s) / max(late_s.shape[0] - _TICKS, 1)
    return variance / np.array([late_s.shape[0], float(counts @ counts)])
