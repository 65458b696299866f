"""The Cramér-Rao bound: the covariance that the joint estimator's recursion has at the truth.

The same prediction and the same update, with derivatives at the truth, without the terms of second order and without
increments, for the components that the estimator used. Rounding counts as white noise of variance q^2/12, so an
estimator may do a little better. Thrust errors are estimated from the start.

What constants that the recursion does not estimate would do to its innovations is the information about them, see
`advance_force_effects`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from massprop_drake.maths.estimation.joint.covariance import compress_root, joseph_update
from massprop_drake.maths.estimation.joint.forcing import Drive, error_rows
from massprop_drake.maths.estimation.joint.joint_cycle import estimate_forces
from massprop_drake.maths.estimation.joint.joint_sample import JointSample
from massprop_drake.maths.estimation.joint.layout import CENTER, RATE, VELOCITY, JointParams, JointState
from massprop_drake.maths.estimation.joint.measurement import combine_gyros, predict_outputs
from massprop_drake.maths.estimation.joint.prediction import Prediction, predict, propagate_root
from massprop_drake.maths.estimation.joint.rate_coupling import arm_turning_integrals
from massprop_drake.maths.estimation.joint.ticks import update_by_stamp
from massprop_drake.maths.linear_algebra import Array


class IntervalEnd(NamedTuple):
    """End of an interval before its readings are taken in.

    Attributes:
        acting: see `Drive`.
        prediction: see `Prediction`.
        mean: the truth, shape (size,).
        root: of the covariance, with its noise as more columns, shape (size, k).
        spin: see `JointState`.
    """

    acting: Drive
    prediction: Prediction
    mean: Array
    root: Array
    spin: Array


class BoundStep(NamedTuple):
    """Propagation of errors over an interval, and through the update by its readings.

    Attributes:
        end: see `IntervalEnd`.
        jacobian: derivative of the components that are used by the state, shape (k, size).
        half_gain, upper: see `covariance.Update`.
    """

    end: IntervalEnd
    jacobian: Array
    half_gain: Array
    upper: Array


def predict_interval_end(
    state: JointState, sample: JointSample, truth: Array | None, params: JointParams, filter_root: Array | None = None
) -> IntervalEnd:
    """Predicts the true state and the bound's covariance root at an interval's end, before its readings are used.

    Args:
        state: before it; its mean is the truth then.
        sample: of it; of its readings it only counts which are missing.
        truth: true state at its end, shape (size,); None: as predicted.
        filter_root: root of the filter's covariance, the products of whose errors then count as noise.
    """
    at, at_truth = state.mean, params._replace(second_order=False)
    stamped_too, _ = update_by_stamp(state, sample.timing, at_truth)
    before = stamped_too._replace(mean=at)
    forces = estimate_forces(before, sample, at_truth)
    read, around = combine_gyros(sample.rates, at, params), (sample.frames, sample.speeds)
    read = read._replace(
        rate=np.full(3, np.nan) if truth is None else np.where(np.isnan(read.rate), np.nan, truth[RATE])
    )
    prediction = predict(before, forces, read, at_truth, around)
    if filter_root is not None:
        prediction = prediction._replace(
            noise=predict(before._replace(root=filter_root), forces, read, params, around).noise
        )
    root = propagate_root(before.root, prediction, at_truth)
    there = prediction.mean if truth is None else truth
    return IntervalEnd(forces, prediction, there, root, state.spin + prediction.spin)


def update_bound(
    state: JointState, end: IntervalEnd, time_s: float, used_and_noise: tuple[np.ndarray, Array], params: JointParams
) -> tuple[JointState, BoundStep]:
    """Updates the Cramér-Rao bound by an interval's readings; returns state and propagation of errors.

    Args:
        state: before the interval.
        used_and_noise: which components are used, and variances of all, shape (m,) each.
    """
    (used, variances), root, first = used_and_noise, end.root, params.places.thrust
    counts = np.flatnonzero(used)
    jacobian = predict_outputs(end.mean, state.reference, end.spin, params)[1][counts]
    half_gain, upper = np.zeros((root.shape[0], 0)), np.zeros((0, 0))
    if used.any():
        update = joseph_update(root, jacobian @ root, variances[counts], np.zeros(counts.shape[0]), first)
        root, half_gain, upper = update.root, update.half_gain, update.upper
    else:
        root = compress_root(root, first)
    firing = end.acting.firing
    after = state._replace(
        mean=end.mean,
        root=root,
        level=firing.level,
        slope=firing.slope,
        level_std=firing.level_std,
        tick_slope=end.acting.tick_slope,
        spin=end.spin,
        time_s=time_s,
    )
    return after, BoundStep(end, jacobian, half_gain, upper)


def advance_force_effects(
    effects: tuple[Array, Array], state: JointState, step: BoundStep, first_column: int, params: JointParams
) -> tuple[Array, Array]:
    """Propagates state errors by unit leaks and losses of jets over an interval, and adds the information on these.

    The forces are a leak of each jet, all the time, then a loss of each, while it fires.

    Args:
        effects: errors and information before the interval.
        state: before the interval.
        first_column: of these forces.
    """
    carried, shown = effects
    carried = propagate_root(carried, step.end.prediction, params)[:, : carried.shape[1]]
    carried[:, first_column : first_column + 2 * params.places.jets] += _unit_force_effects(state, step.end, params)
    if step.upper.shape[0] > 0:
        whitened = np.linalg.solve(step.upper.T, step.jacobian @ carried)
        carried = carried - step.half_gain @ whitened
        shown = shown + whitened.T @ whitened
    return carried, shown


def _unit_force_effects(state: JointState, end: IntervalEnd, params: JointParams) -> Array:
    """Computes changes of rate and velocities by a unit of each leak or loss over an interval, shape (size, f)."""
    prediction, places = end.prediction, params.places
    jets, on_top = np.tile(np.arange(places.jets, dtype=np.float64), 2), np.repeat((1.0, 0.0), places.jets)
    n = jets.size
    slot_params = params._replace(places=places._replace(n_force=n, size=places.force + n))  # a slot for each
    mean = np.append(state.mean[: places.force], np.zeros(n))
    slots = state._replace(mean=mean, slot_jet=jets, slot_sign=2.0 * on_top - 1.0, slot_on_top=on_top)
    rate_rows, velocity_rows = (rows[:, places.force :] for rows in error_rows(slots, end.acting, slot_params))
    result = np.zeros((places.size, n))
    result[RATE] = rate_rows
    arms = params.accelerometer_positions - state.mean[CENTER]
    by_end = arm_turning_integrals(state.mean[RATE], prediction.end, arms, prediction.duration_s)[1]
    for package in range(places.accelerometers):
        part = slice(VELOCITY + 3 * package, VELOCITY + 3 * package + 3)
        result[part] = velocity_rows + by_end[package] @ rate_rows
    return result
