"""The Cramér-Rao bound: the covariance that the joint estimator's recursion has at the truth.

The same prediction and the same update, with derivatives at the truth, without the terms of second order and without
increments, for the components that the estimator used. Rounding counts as white noise of variance q^2/12, so an
estimator may do a little better. Thrust errors are estimated from the start.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from massprop_drake.maths.estimation.joint.covariance import compressed, updated
from massprop_drake.maths.estimation.joint.cycle import Sample, begun, driven, initial
from massprop_drake.maths.estimation.joint.layout import N_PROPERTIES, RATE, JointParams, JointState
from massprop_drake.maths.estimation.joint.measurement import outputs, rate_read
from massprop_drake.maths.estimation.joint.prediction import Drive, Prediction, predict, propagated
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
    return begun_at(initial(params), sample, mean, params)


def begun_at(state: JointState, sample: Sample, mean: Array, params: JointParams) -> JointState:
    """The bound's state after a sample before which nothing is known of the motion; arguments as `course`."""
    begins = begun(state._replace(mean=mean), sample, params)
    return begins._replace(mean=mean, reference=mean[RATE].copy())


class BoundStep(NamedTuple):
    """Course of errors over an interval, and through the update by its readings.

    Attributes:
        acting: see `Drive`.
        prediction: see `Prediction`.
        jacobian: derivative of the components that are used by the state, shape (k, size).
        half_gain, upper: see `covariance.Update`.
    """

    acting: Drive
    prediction: Prediction
    jacobian: Array
    half_gain: Array
    upper: Array


def step(state: JointState, sample: Sample, mean: Array, used: np.ndarray, params: JointParams) -> JointState:
    """The bound's state after one more sample; arguments as `course`."""
    return course(state, sample, mean, used, params)[0]


def course(
    state: JointState, sample: Sample, mean: Array, used: np.ndarray, params: JointParams
) -> tuple[JointState, BoundStep]:
    """The bound's state after one more sample, and how errors come to it.

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
    counts = np.flatnonzero(used)
    jacobian = outputs(mean, state.reference, spin, params)[1][counts]
    half_gain, upper = np.zeros((root.shape[0], 0)), np.zeros((0, 0))
    if used.any():
        found = updated(root, jacobian @ root, params.variances[counts], np.zeros(counts.shape[0]), first)
        root, half_gain, upper = found.root, found.half_gain, found.upper
    else:
        root = compressed(root, first)
    firing = acting.firing
    after = state._replace(
        mean=mean,
        root=root,
        level=firing.level,
        slope=firing.slope,
        level_std=firing.level_std,
        tick_slope=acting.tick_slope,
        spin=spin,
        time_s=sample.time_s,
    )
    return after, BoundStep(acting, prediction, jacobian, half_gain, upper)


def deviation(state: JointState) -> Array:
    """The least 1-sigma of the ten parameters, shape (10,)."""
    rows = state.root[:N_PROPERTIES]
    result: Array = np.sqrt(np.sum(rows * rows, axis=1))
    return result
