"""Update by readings that were the last in their cells, before the interval in which they change."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from massprop_drake.maths.estimation.joint.covariance import joseph_update_uncompressed
from massprop_drake.maths.estimation.joint.forcing import estimated_lags
from massprop_drake.maths.estimation.joint.innovation import equivalent_measurements
from massprop_drake.maths.estimation.joint.joint_sample import JointSample
from massprop_drake.maths.estimation.joint.layout import (
    N_PROPERTIES,
    JointParams,
    JointState,
    clear_pending,
    replace_levels,
)
from massprop_drake.maths.estimation.joint.measurement import find_changed, predict_outputs, readings
from massprop_drake.maths.kernels import kernel
from massprop_drake.maths.linear_algebra import Array, sparse_product


class Crossing(NamedTuple):
    """Update of the state before an interval by readings that change in it, each the last one in its cell.

    Attributes:
        rows: U^-T H, zero for readings that did not count, shape (m, size).
        half_gain: G, likewise, shape (size, m); K H = G rows.
        correction: of the mean, shape (size,).
        log_likelihood: of these readings, nats.
    """

    rows: Array
    half_gain: Array
    correction: Array
    log_likelihood: float


@kernel
def update_by_crossings(
    state: JointState, linearization_point: Array, sample: JointSample, floors: Array, params: JointParams
) -> tuple[JointState, Crossing]:
    """Updates the state by unused last readings of components whose quantized value changes in the next sample.

    Args:
        state: after the last sample.
        linearization_point: the ten parameters at which outputs are linearized, shape (10,).
        sample: the next one, whose readings show which have changed.
        floors: see `JointParams.floors`.
    """
    places, m = params.places, state.read.shape[0]
    rows, half_gain = np.zeros((m, places.size)), np.zeros((places.size, m))
    changed = (state.fresh > 0.0) & find_changed(
        readings(sample.rates, sample.velocities, sample.attitudes), state.read, params
    )
    if not changed.any():
        return clear_pending(state), Crossing(rows, half_gain, np.zeros(places.size), 0.0)
    point = state.mean.copy()
    point[:N_PROPERTIES] = linearization_point
    values, jacobian = predict_outputs(point, state.reference, state.spin, params)
    values = values + jacobian @ (state.mean - point)
    indices = np.flatnonzero(changed)
    projected = sparse_product(jacobian[indices], state.root)
    sites = equivalent_measurements(changed, projected, state.read - values, (params.cells, floors))
    update = joseph_update_uncompressed(state.root, projected, sites.variance, sites.innovation)
    whitened = np.linalg.solve(update.upper.T, jacobian[indices])
    for place in range(indices.shape[0]):
        rows[indices[place]], half_gain[:, indices[place]] = whitened[place], update.half_gain[:, place]
    mean = state.mean + update.correction
    level = levels_at_estimates((state.level, state.slope, state.tick_slope), state.mean, mean, params)
    after = clear_pending(replace_levels(state, mean, update.root, level, state.tick_slope))
    return after, Crossing(rows, half_gain, update.correction, sites.log_likelihood.sum())


@kernel
def levels_at_estimates(levels: tuple[Array, Array, Array], mean: Array, new_mean: Array, params: JointParams) -> Array:
    """Corrects jets' thrust levels, to first order, for new estimates of lag and command-clock ticks, shape (n_jets,).

    Args:
        levels: `level`, `slope` and `tick_slope` of a state.
        mean, new_mean: old and new estimates, shape (size,).
    """
    places, (level, slope, tick_slope) = params.places, levels
    if places.n_lag > 0:
        old, _ = estimated_lags(mean, params)
        new, _ = estimated_lags(new_mean, params)
        ratio = np.where(old > 0.0, new / np.where(old > 0.0, old, 1.0), 1.0)
        at_least, at_most = np.minimum(level, 0.0), np.maximum(level, 1.0)  # off its tick, beyond for an interval
        step = np.maximum(np.log(ratio), -1.0)  # a lag that goes takes along no more than the level was off
        level = np.minimum(np.maximum(level + slope * step, at_least), at_most)
    if places.n_ticks > 0 and tick_slope.any():
        ticks = slice(places.ticks, places.ticks + 2)
        moved_s = params.tick_sigma * (new_mean[ticks] - mean[ticks])
        level = level + moved_s @ tick_slope
    return level
