"""The Cramér-Rao bound: the covariance that the joint estimator's recursion has at the truth.

The same prediction and the same update, with derivatives at the truth, without the terms of second order and without
increments, for the components that the estimator used. Rounding counts as white noise of variance q^2/12, so an
estimator may do a little better. Thrust errors are estimated from the start.
"""

from __future__ import annotations

import numpy as np

from massprop_drake.maths.estimation.joint.covariance import compressed, updated
from massprop_drake.maths.estimation.joint.cycle import Sample, begun, driven, initial
from massprop_drake.maths.estimation.joint.layout import N_PROPERTIES, RATE, JointParams, JointState
from massprop_drake.maths.estimation.joint.measurement import outputs, rate_read
from massprop_drake.maths.estimation.joint.prediction import predict, propagated
from massprop_drake.maths.estimation.joint.ticks import stamped
from massprop_drake.maths.linear_algebra import Array


def true_mean(properties: Array, rate: Array, errors: Array, params: JointParams) -> Array:
    """The state's mean at the truth, shape (size,); what accelerometers have gathered does not matter and is zero.

    Args:
        properties: the ten parameters, shape (10,).
        rate: rad/s, shape (3,).
        errors: parameters from `Places.thrust` on, in units of their sigmas, shape (size - thrust,).
        params: see `JointParams`.
    """
    mean = np.zeros(params.places.size)
    mean[:N_PROPERTIES], mean[RATE], mean[params.places.thrust :] = properties, rate, errors
    return mean


def start(sample: Sample, mean: Array, params: JointParams) -> JointState:
    """The bound's state after the first sample.

    Args:
        sample: the first one; what of it is missing counts.
        mean: the truth then, see `true_mean`.
        params: see `JointParams`.
    """
    state = begun(initial(params)._replace(mean=mean), sample, params)
    return state._replace(mean=mean, reference=mean[RATE].copy())


def step(state: JointState, sample: Sample, mean: Array, used: np.ndarray, params: JointParams) -> JointState:
    """The bound's state after one more sample.

    Args:
        state: after the last one; its mean is the truth then.
        sample: of this interval; of its readings it only counts which are missing.
        mean: the truth at its end, see `true_mean`.
        used: the components that the estimator used, shape (m,).
        params: see `JointParams`.
    """
    at, at_truth = state.mean, params._replace(second_order=False)
    state, _ = stamped(state, sample.timing, at_truth)
    state = state._replace(mean=at)
    acting = driven(state, sample, at_truth)
    read = rate_read(sample.rates, mean, params)
    shown = np.where(np.isnan(read.rate), np.nan, mean[RATE])
    prediction = predict(state, acting, read._replace(rate=shown), at_truth, (sample.frames, sample.speeds))
    root = propagated(state.root, prediction, at_truth)
    spin = state.spin + prediction.spin
    first = params.places.thrust
    if used.any():
        counts = np.flatnonzero(used)
        _, jacobian = outputs(mean, state.reference, spin, params)
        projected = jacobian[counts] @ root
        nothing = np.zeros(counts.shape[0])
        root = updated(root, projected, params.variances[counts], nothing, first).root
    else:
        root = compressed(root, first)
    firing = acting.firing
    return state._replace(
        mean=mean,
        root=root,
        level=firing.level,
        slope=firing.slope,
        level_std=firing.level_std,
        tick_slope=acting.tick_slope,
        spin=spin,
        time_s=sample.time_s,
    )


def deviation(state: JointState) -> Array:
    """The least 1-sigma of the ten parameters, shape (10,)."""
    rows = state.root[:N_PROPERTIES]
    result: Array = np.sqrt(np.sum(rows * rows, axis=1))
    return result
