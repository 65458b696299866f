"""Propagation of the covariance's root over an interval."""

from __future__ import annotations

import numpy as np

from massprop_drake.maths.estimation.joint.covariance import semidefinite_root
from massprop_drake.maths.estimation.joint.disturbance_states import disturbance_noise_root
from massprop_drake.maths.estimation.joint.layout import CENTER, MASS, N_PROPERTIES, RATE, VELOCITY, JointParams
from massprop_drake.maths.estimation.joint.prediction import Prediction
from massprop_drake.maths.kernels import kernel
from massprop_drake.maths.linear_algebra import Array, sparse_product

_FIRST = CENTER.start  # of the coordinates of the center of mass


@kernel
def velocity_gain_rows(prediction: Prediction, package: int) -> Array:
    """Computes the derivative of the change of a package's c_s by the state, without its biases, shape (3, size)."""
    by_start, by_end = prediction.apart[0, package], prediction.apart[1, package]
    rows = prediction.velocity_rows + by_end @ prediction.rate_rows
    rows[:, RATE] += by_start + by_end
    return rows


@kernel
def propagate_root(root: Array, prediction: Prediction, params: JointParams) -> Array:
    """Propagates the covariance's root over the interval, with its noise as more columns, not compressed."""
    places = params.places
    after = root.copy()
    moved = sparse_product(np.vstack((prediction.rate_rows, prediction.velocity_rows)), root)
    after[RATE] += moved[:3]
    common = moved[3:]
    noise = semidefinite_root(prediction.noise)
    drifting = np.flatnonzero(prediction.drift > 0.0)
    slow, come_in = slice(places.slow, places.slow + places.n_slow), disturbance_noise_root(prediction.wander)
    first = 6 + come_in.shape[1]  # of the columns of what drifts
    columns = np.zeros((places.size, first + drifting.shape[0]))
    columns[RATE, :6], columns[RATE, 6:first] = noise[:3], come_in[:3]
    if places.n_swing > 0:
        own, shaken = slice(places.swing, places.swing + places.n_swing), prediction.swung.shaken
        after[own] = prediction.swung.rows @ root
        columns[own, :6], columns[own, 6:first] = shaken @ noise, shaken @ come_in[:6].copy()
    after[slow] *= prediction.wander.kept.reshape(-1, 1)
    columns[slow, 6:first] = come_in[6:]
    for package in range(places.accelerometers):
        part = slice(VELOCITY + 3 * package, VELOCITY + 3 * package + 3)
        after[part] += common
        columns[part, :6], columns[part, 6:first] = noise[3:], come_in[3:6]
        if places.accelerometers > 1:
            by_start, by_end = prediction.apart[0, package], prediction.apart[1, package]
            after[part] += by_start @ root[RATE] + by_end @ after[RATE]
            columns[part, :first] += by_end @ columns[RATE, :first]
        if places.n_acceleration_bias > 0:
            begin = places.acceleration_bias + 3 * package
            after[part] += prediction.duration_s * params.acceleration_bias_sigma * root[begin : begin + 3]
    if places.n_attitude > 0:
        part = slice(places.attitude, places.attitude + 3)
        by_start, by_end = prediction.attitude[0], prediction.attitude[1]
        after[part] += by_start @ root[RATE] + by_end @ after[RATE]
        columns[part, :first] += by_end @ columns[RATE, :first]
    after[MASS] *= prediction.mass_factor
    if places.tanks > 0:
        by_tanks = sparse_product(prediction.tank_rows, root)
        after[:N_PROPERTIES] += by_tanks[:N_PROPERTIES]
        after[places.fill : places.fill + places.tanks] += by_tanks[N_PROPERTIES:]
        for package in range(places.accelerometers):
            part = slice(VELOCITY + 3 * package, VELOCITY + 3 * package + 3)
            after[part] += prediction.turned @ by_tanks[CENTER]
    for column in range(drifting.shape[0]):
        element = drifting[column]
        sigma = np.sqrt(prediction.drift[element])
        columns[element, first + column] = sigma
        if _FIRST <= element < MASS:
            for package in range(places.accelerometers):
                part = slice(VELOCITY + 3 * package, VELOCITY + 3 * package + 3)
                columns[part, first + column] = prediction.turned[:, element - _FIRST] * sigma
    if not columns.any():
        return after
    return np.hstack((after, columns))
