"""Innovation of a cycle: expected readings, the selection of those that count, and their NIS by kind of sensor."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from massprop_drake.maths.estimation.joint.covariance import Update, joseph_update
from massprop_drake.maths.estimation.joint.forcing import Drive
from massprop_drake.maths.estimation.joint.joint_sample import JointSample
from massprop_drake.maths.estimation.joint.layout import CENTER, N_PROPERTIES, RATE, VELOCITY, JointParams, JointState
from massprop_drake.maths.estimation.joint.measurement import (
    add_tracker_variances,
    combine_gyros,
    predict_outputs,
    readings,
    select_counting,
)
from massprop_drake.maths.estimation.joint.prediction import Prediction, predict, propagate_root
from massprop_drake.maths.estimation.joint.quantized import Sites, match_moments
from massprop_drake.maths.estimation.joint.rate_coupling import arm_turning_integrals
from massprop_drake.maths.estimation.joint.unknown import EXPECTED
from massprop_drake.maths.kernels import kernel
from massprop_drake.maths.linear_algebra import Array, sparse_product

_DIGITS = 1e3  # arithmetic: 1-sigmas of readings, of whose square a NIS across so wide directions has ten digits left


class Expected(NamedTuple):
    """Expected readings of a cycle, before it updates.

    Attributes:
        prediction: see `Prediction`.
        root: predicted, with noise, not square, shape (size, k).
        spin: integral of w w^T dt, with the interval's, shape (6,).
        jacobian: H, shape (m, size).
        projected: H times root, shape (m, k).
        innovation: e of all components, NaN where missing, shape (m,).
        used: which components count, shape (m,).
        floors: variance of each prediction beyond the state's, shape (m,).
        variances: of one reading of each component, shape (m,).
    """

    prediction: Prediction
    root: Array
    spin: Array
    jacobian: Array
    projected: Array
    innovation: Array
    used: np.ndarray
    floors: Array
    variances: Array


@kernel
def predict_cycle(state: JointState, forces: Drive, sample: JointSample, params: JointParams) -> Expected:
    """Predicts state, covariance and readings at an interval's end, with the selection of readings used."""
    rate_read = combine_gyros(sample.rates, state.mean, params)
    prediction = predict(state, forces, rate_read, params, (sample.frames, sample.speeds))
    root = propagate_root(state.root, prediction, params)
    properties_and_floors = (prediction.mean[:N_PROPERTIES], prediction_floors(state, params))
    return predict_readings(state, prediction, root, properties_and_floors, sample, params)


@kernel
def predict_readings(
    state: JointState,
    prediction: Prediction,
    root: Array,
    properties_and_floors: tuple[Array, Array],
    sample: JointSample,
    params: JointParams,
) -> Expected:
    """Predicts a sample's readings, innovation and their variances, linearized at given mass properties.

    At the rate that was predicted, its error times that of the center of mass would be taken for an error of this.
    """
    spin = state.spin + prediction.spin
    point = prediction.mean.copy()
    properties, floors = properties_and_floors
    point[:N_PROPERTIES], point[RATE] = properties, prediction.end
    values, jacobian = predict_outputs(point, state.reference, spin, params)
    values = values + jacobian @ (prediction.mean - point)
    projected = sparse_product(jacobian, root)
    reading = readings(sample.rates, sample.velocities, sample.attitudes)
    variances = params.variances
    if params.places.n_attitude > 0:
        variances, floors = add_tracker_variances(reading - values, projected, prediction.end, floors, params)
    used, floors = select_counting(reading, state.read, values, (projected**2).sum(axis=1), floors, params)
    return Expected(prediction, root, spin, jacobian, projected, reading - values, used, floors, variances)


@kernel
def sum_by_sensor_kind(values: Array, used: np.ndarray, default: float, params: JointParams) -> tuple[float, float]:
    """Sums values of the components used over the gyros, and over the accelerometers; `default` where none is used.

    Args:
        values: of each component used, shape (number,).
    """
    places = params.places
    gyros = int(used[: 3 * places.gyros].sum())
    both = int(used[: 3 * (places.gyros + places.accelerometers)].sum())
    of_gyros = values[:gyros].sum() if gyros > 0 else default
    return of_gyros, values[gyros:both].sum() if both > gyros else default


@kernel
def prediction_floors(state: JointState, params: JointParams) -> Array:
    """Returns variances added to those of predicted readings, larger before convergence, shape (m,).

    Until then the second order counts, and no cell is told to a hundredth of a quantum. Passes over the start are
    linearized where its end knows the mass properties to be, and need no such floor.
    """
    return params.floors if state.guarded else params.variances


@kernel
def equivalent_measurements(
    used: np.ndarray, projected: Array, innovation: Array, quanta_and_floors: tuple[Array, Array]
) -> Sites:
    """Makes the Gaussian measurements equivalent to the quantized readings used, from their innovation.

    Args:
        projected: rows of H times the root for the components used, shape (number, k).
        innovation: of all components, shape (m,).
        quanta_and_floors: quanta, and floors, of all components, shape (m,).
    """
    indices, (cells, floors) = np.flatnonzero(used), quanta_and_floors
    return match_moments(innovation[indices], projected @ projected.T, cells[indices], floors[indices])


@kernel
def measurements_at_prediction(expected: Expected, params: JointParams) -> Sites:
    """Makes the Gaussian measurements equivalent to a sample's quantized readings used, at the predicted state."""
    projected = expected.projected[np.flatnonzero(expected.used)]
    return equivalent_measurements(expected.used, projected, expected.innovation, (params.cells, expected.floors))


@kernel
def update_root(expected: Expected, root: Array, params: JointParams) -> tuple[Update, Sites]:
    """Updates root and mean by a sample's readings used; returns the update and its equivalent measurements."""
    projected = sparse_product(expected.jacobian[np.flatnonzero(expected.used)], root)
    sites = equivalent_measurements(expected.used, projected, expected.innovation, (params.cells, expected.floors))
    return joseph_update(root, projected, sites.variance, sites.innovation, params.places.thrust), sites


@kernel
def count_untestable_degrees(
    expected: Expected, forces: Drive, mean: Array, params: JointParams
) -> tuple[float, float, float]:
    """Counts degrees of freedom of gyros and accelerometers, and log likelihood, that jets of unknown command take up.

    Returns:
        Degrees of freedom of the gyros, of the accelerometers given these, and what the log likelihood lacks, nats.
    """
    indices = np.flatnonzero(expected.used)
    if forces.anything.number == 0.0 or indices.shape[0] == 0:
        return 0.0, 0.0, 0.0
    jacobian, places = expected.jacobian[indices], params.places
    directions = forces.anything.spread * forces.anything.basis
    arms = params.accelerometer_positions - mean[CENTER]
    arm_effects = arm_turning_integrals(mean[RATE], expected.prediction.end, arms, expected.prediction.duration_s)[1]
    wide = jacobian[:, RATE] @ directions[:3]
    for package in range(places.accelerometers):
        part = jacobian[:, VELOCITY + 3 * package : VELOCITY + 3 * package + 3]
        wide += part @ (directions[3:] + arm_effects[package] @ directions[:3])
    wide = wide / np.sqrt(expected.variances[indices]).reshape(-1, 1)
    total = _degrees_along(wide)
    number = int(expected.used[: 3 * places.gyros].sum())
    gyros = _degrees_along(np.ascontiguousarray(wide[:number])) if number > 0 else 0.0
    return gyros, max(total - gyros, 0.0), total * (np.log(forces.anything.spread) + EXPECTED)


@kernel
def _degrees_along(effects: Array) -> float:
    """Computes degrees of freedom that free impulse directions take up, from their effects in sigmas of readings."""
    squares = np.linalg.svd(effects)[1] ** 2
    return float((squares / (1.0 + squares)).sum())


@kernel
def reduced_nis(nis: float, degrees: float, spread: float) -> tuple[float, float]:
    """Returns NIS and degrees of freedom; NaN and 0 where hardly any are left, or where wide `spread` costs the digits.

    Readings are compared across directions in which they may be off by `spread` of their own 1-sigmas.
    """
    return (nis, degrees) if (degrees > 0.5 and spread < _DIGITS) or np.isnan(nis) else (np.nan, 0.0)


@kernel
def replace_used_mask(expected: Expected, used: np.ndarray) -> Expected:
    """Returns expected readings with another mask of the components used, shape (m,)."""
    return Expected(
        expected.prediction,
        expected.root,
        expected.spin,
        expected.jacobian,
        expected.projected,
        expected.innovation,
        used,
        expected.floors,
        expected.variances,
    )
