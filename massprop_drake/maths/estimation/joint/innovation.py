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
def predict_cycle(state: JointState, acting: Drive, sample: JointSample, params: JointParams) -> Expected:
    """Predicts state, covariance and readings at an interval's end, with the selection of readings used."""
    read = combine_gyros(sample.rates, state.mean, params)
    prediction = predict(state, acting, read, params, (sample.frames, sample.speeds))
    root = propagate_root(state.root, prediction, params)
    about = (prediction.mean[:N_PROPERTIES], prediction_floors(state, params))
    return predict_readings(state, prediction, root, about, sample, params)


@kernel
def predict_readings(
    state: JointState,
    prediction: Prediction,
    root: Array,
    about: tuple[Array, Array],
    sample: JointSample,
    params: JointParams,
) -> Expected:
    """Predicts a sample's readings, innovation and their variances, linearized at given mass properties.

    At the rate that was predicted, its error times that of the center of mass would be taken for an error of this.
    """
    spin = state.spin + prediction.spin
    there = prediction.mean.copy()
    properties, least = about
    there[:N_PROPERTIES], there[RATE] = properties, prediction.end
    values, jacobian = predict_outputs(there, state.reference, spin, params)
    values = values + jacobian @ (prediction.mean - there)
    projected = sparse_product(jacobian, root)
    read = readings(sample.rates, sample.velocities, sample.attitudes)
    variances = params.variances
    if params.places.n_attitude > 0:
        variances, least = add_tracker_variances(read - values, projected, prediction.end, least, params)
    counts, least = select_counting(read, state.read, values, (projected**2).sum(axis=1), least, params)
    return Expected(prediction, root, spin, jacobian, projected, read - values, counts, least, variances)


@kernel
def sum_by_sensor_kind(values: Array, used: np.ndarray, nothing: float, params: JointParams) -> tuple[float, float]:
    """Sums values over the gyros' components used, and over the accelerometers', one sum each.

    Args:
        values: of each that counts, shape (number,).
        used: which components count, shape (m,).
        nothing: in place of a sum of none.
    """
    places = params.places
    gyros = int(used[: 3 * places.gyros].sum())
    both = int(used[: 3 * (places.gyros + places.accelerometers)].sum())
    of_gyros = values[:gyros].sum() if gyros > 0 else nothing
    return of_gyros, values[gyros:both].sum() if both > gyros else nothing


@kernel
def prediction_floors(state: JointState, params: JointParams) -> Array:
    """Returns variances added to those of predicted readings, that of rounding before convergence, shape (m,).

    Until then the second order counts, and no cell is told to a hundredth of a quantum. Passes over the start are
    linearized where its end knows the mass properties to be, and need no such floor.
    """
    return params.floors if state.guarded else params.variances


@kernel
def make_sites(used: np.ndarray, projected: Array, innovation: Array, given: tuple[Array, Array]) -> Sites:
    """Makes the Gaussian measurements equivalent to the quantized readings used, from their innovation.

    Args:
        used: which components count, shape (m,).
        projected: their rows of H times the root, shape (number, k).
        innovation: of all components, shape (m,).
        given: quanta, and floors, of all components, shape (m,).
    """
    counts, (cells, least) = np.flatnonzero(used), given
    return match_moments(innovation[counts], projected @ projected.T, cells[counts], least[counts])


@kernel
def make_expected_sites(expected: Expected, params: JointParams) -> Sites:
    """Makes the Gaussian measurements equivalent to a sample's quantized readings used, at their prediction."""
    projected = expected.projected[np.flatnonzero(expected.used)]
    return make_sites(expected.used, projected, expected.innovation, (params.cells, expected.floors))


@kernel
def update_root(expected: Expected, root: Array, params: JointParams) -> tuple[Update, Sites]:
    """Updates a covariance's root by a sample's readings used; returns update and equivalent measurements."""
    projected = sparse_product(expected.jacobian[np.flatnonzero(expected.used)], root)
    told = make_sites(expected.used, projected, expected.innovation, (params.cells, expected.floors))
    return joseph_update(root, projected, told.variance, told.innovation, params.places.thrust), told


@kernel
def count_reopened_degrees(
    expected: Expected, acting: Drive, mean: Array, params: JointParams
) -> tuple[float, float, float]:
    """Counts degrees of freedom of readings that only show impulses of jets of unknown command.

    Args:
        mean: before the interval, where it is linearized, shape (size,).

    Returns:
        Degrees of freedom of the gyros, of the accelerometers given these, and what the log likelihood lacks, nats.
    """
    counts = np.flatnonzero(expected.used)
    if acting.anything.number == 0.0 or counts.shape[0] == 0:
        return 0.0, 0.0, 0.0
    jacobian, places = expected.jacobian[counts], params.places
    opened = acting.anything.spread * acting.anything.basis
    arms = params.accelerometer_positions - mean[CENTER]
    turned = arm_turning_integrals(mean[RATE], expected.prediction.end, arms, expected.prediction.duration_s)[1]
    wide = jacobian[:, RATE] @ opened[:3]
    for package in range(places.accelerometers):
        part = jacobian[:, VELOCITY + 3 * package : VELOCITY + 3 * package + 3]
        wide += part @ (opened[3:] + turned[package] @ opened[:3])
    wide = wide / np.sqrt(expected.variances[counts]).reshape(-1, 1)
    every = _degrees_along(wide)
    number = int(expected.used[: 3 * places.gyros].sum())
    gyros = _degrees_along(np.ascontiguousarray(wide[:number])) if number > 0 else 0.0
    return gyros, max(every - gyros, 0.0), every * (np.log(acting.anything.spread) + EXPECTED)


@kernel
def _degrees_along(wide: Array) -> float:
    """Computes the number of degrees of freedom that directions absorb, from their effects in sigmas of readings."""
    squares = np.linalg.svd(wide)[1] ** 2
    return float((squares / (1.0 + squares)).sum())


@kernel
def reduced_nis(nis: float, degrees: float, spread: float) -> tuple[float, float]:
    """Returns a NIS and its expectation, or NaN and 0: too few degrees of freedom, or digits lost by spread.

    Readings are compared across directions in which they may be off by `spread` of their own 1-sigmas.
    """
    return (nis, degrees) if (degrees > 0.5 and spread < _DIGITS) or np.isnan(nis) else (np.nan, 0.0)


@kernel
def replace_counting(expected: Expected, used: np.ndarray) -> Expected:
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
