"""The Cramér-Rao bound of a flight by the recursion of `joint.bound`, for tests to compare with."""

from __future__ import annotations

import numpy as np

from massprop_drake.maths.estimation.joint.beginning import begin_from_readings, initial_joint_state
from massprop_drake.maths.estimation.joint.bound import predict_interval_end, update_bound
from massprop_drake.maths.estimation.joint.joint_sample import JointSample
from massprop_drake.maths.estimation.joint.layout import N_PROPERTIES, RATE, JointParams, JointState
from massprop_drake.maths.linear_algebra import Array


def true_mean(properties: Array, rate: Array, errors: Array, params: JointParams) -> Array:
    """Returns the state's mean at the truth, shape (size,); velocities that accelerometers have gathered are zero.

    `errors` are those of the parameters from `Places.thrust` on, in units of their sigmas.
    """
    mean = np.zeros(params.places.size)
    mean[:N_PROPERTIES], mean[RATE], mean[params.places.thrust :] = properties, rate, errors
    return mean


def start(sample: JointSample, mean: Array, params: JointParams) -> JointState:
    """Returns the bound's state after the first sample, of which counts what is missing; `mean` is the truth then."""
    begins = begin_from_readings(initial_joint_state(params)._replace(mean=mean), sample, params)
    return begins._replace(mean=mean, reference=mean[RATE].copy())


def step(state: JointState, sample: JointSample, mean: Array, used: np.ndarray, params: JointParams) -> JointState:
    """Computes the bound's state after one more sample, of whose readings counts which are missing.

    `mean` is the truth at its end, `used` the components that the estimator used, shape (m,).
    """
    end = predict_interval_end(state, sample, mean, params)
    return update_bound(state, end, sample.time_s, (used, params.variances), params)[0]


def deviation(state: JointState) -> Array:
    """Computes the least 1-sigma of the ten parameters, shape (10,)."""
    rows = state.root[:N_PROPERTIES]
    return np.sqrt(np.sum(rows * rows, axis=1))
