"""One cycle of the joint estimator: from a state and a sample to the next state.

Order: update by pending readings that have just changed; forces, with the lag estimated before
(`forcing.compute_forces`); prediction; the components that count; while the start lasts and the gyros contradict the
prediction, lags are no longer taken as stated if that explains it, else the covariance is incremented, and the
prediction made again; update; the prior of lags; the guard. A hypothesis is the same with another state: one with a
force in a slot, or rebased and with a larger covariance.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from massprop_drake.maths.estimation.joint.beginning import begin_from_readings
from massprop_drake.maths.estimation.joint.covariance import Update, compress_root, empty_update
from massprop_drake.maths.estimation.joint.crossing import Crossing, levels_at_estimates, update_by_crossings
from massprop_drake.maths.estimation.joint.forcing import Drive, compute_forces
from massprop_drake.maths.estimation.joint.guard import update_guard
from massprop_drake.maths.estimation.joint.innovation import (
    Expected,
    count_untestable_degrees,
    measurements_at_prediction,
    predict_cycle,
    prediction_floors,
    reduced_nis,
    replace_used_mask,
    sum_by_sensor_kind,
    update_root,
)
from massprop_drake.maths.estimation.joint.joint_sample import JointSample, has_outside_impulse
from massprop_drake.maths.estimation.joint.lag_prior import switch_lag_priors
from massprop_drake.maths.estimation.joint.layout import N_PROPERTIES, RATE, JointParams, JointState, replace_estimate
from massprop_drake.maths.estimation.joint.measurement import combine_gyros, predict_outputs, readings
from massprop_drake.maths.estimation.joint.prediction import predict
from massprop_drake.maths.estimation.joint.thrust_scale import parameters_with_scale, separate_scale
from massprop_drake.maths.estimation.joint.ticks import Stamped, update_by_stamp
from massprop_drake.maths.estimation.joint.unknown import firing_shown_by_readings
from massprop_drake.maths.kernels import kernel
from massprop_drake.maths.linear_algebra import Array, NotPositiveDefiniteError

_WHAT = "the joint estimator's covariance"
OWN_CHOICE = np.zeros(0, dtype=np.bool_)  # of the readings that count


class Course(NamedTuple):
    """Course of a cycle: what a detector needs to propagate errors through it.

    Attributes:
        crossing: see `Crossing`.
        stamp: see `ticks.Stamped`.
        acting: see `Drive`.
        expected: see `Expected`; after an increment, if there was one.
        update: `covariance.empty_update` where no component counted.
        nis, degrees, log_likelihood: see `Report`.
    """

    crossing: Crossing
    stamp: Stamped
    acting: Drive
    expected: Expected
    update: Update
    nis: float
    degrees: float
    log_likelihood: float


class Report(NamedTuple):
    """Report of a cycle.

    Attributes:
        estimate: of the ten parameters, shape (10,).
        covariance: of their errors, shape (10, 10).
        innovation: of all components, before any increment, NaN where missing, shape (m,).
        innovation_std: 1-sigma of each, by the covariance before any increment, shape (m,).
        used: which components counted, shape (m,).
        nis, degrees: sum over those that counted, and its expectation, see `quantized.Sites`.
        log_likelihood: of all readings that the cycle has taken in, with what another prior of a lag makes of those
            before, nats.
        gyro_nis, accelerometer_nis: of the components of either kind that counted, of accelerometers given the gyros,
            before any increment; NaN where none did.
        gyro_degrees, accelerometer_degrees: their expectations; zero where none did.
        incremented: whether the covariance was incremented.
        coupled: whether dynamic coupling counted.
        course: see `Course`; None at the first sample.
        starting, contradicted: whether a start is kept to be gone over again, and whether it has just ended since that
            does not explain the readings, see `start`.
        rotation_known: whether hypotheses may be judged by the rates before all has converged, see `start`.
    """

    estimate: Array
    covariance: Array
    innovation: Array
    innovation_std: Array
    used: np.ndarray
    nis: float
    degrees: float
    log_likelihood: float
    gyro_nis: float
    accelerometer_nis: float
    gyro_degrees: float
    accelerometer_degrees: float
    incremented: bool
    coupled: bool
    course: Course | None
    starting: bool = False
    contradicted: bool = False
    rotation_known: bool = False


class JointEvidence(NamedTuple):
    """Evidence of a cycle of the joint filter for a detector.

    Attributes:
        before, after: states before and after it.
        report: see `Report`.
        sample: what the cycle got.
        anew: whether rate and velocity began anew, so that nothing was tested.
    """

    before: JointState
    after: JointState
    report: Report
    sample: JointSample
    anew: bool


def step(
    state: JointState, sample: JointSample, params: JointParams, used_mask: np.ndarray = OWN_CHOICE
) -> tuple[JointState, Report]:
    """Advances the joint filter by one sample: initialization, or prediction and update; returns state and report.

    Args:
        state: after the last sample.
        used_mask: see `run_cycle`.

    Raises:
        NotPositiveDefiniteError: when the covariance or the estimate overflow, or the readings are too precise for
            what is known of them to be told from them, with the time.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        try:
            if not state.started:
                after, report = _step_first(state, sample, params)
            elif params.compiled is None:
                after, report = run_cycle(state, sample, params.thresholds, used_mask, params)
            else:
                after, report = params.compiled.run_cycle(state, sample, params.thresholds, used_mask)
        except NotPositiveDefiniteError as error:
            raise error.at(sample.time_s, "the joint estimator") from None
        except np.linalg.LinAlgError:
            raise NotPositiveDefiniteError(state.root @ state.root.T, _WHAT, sample.time_s) from None
        if not (np.all(np.isfinite(after.mean)) and np.all(np.isfinite(after.root))):
            raise NotPositiveDefiniteError(after.root @ after.root.T, _WHAT, sample.time_s)
    return after, report


def _step_first(state: JointState, sample: JointSample, params: JointParams) -> tuple[JointState, Report]:
    """Initializes the state from the first sample's readings; returns it and a report without tests."""
    after = begin_from_readings(state, sample, params)
    n_outputs = after.read.shape[0]
    estimate, rows = parameters_with_scale(after, params)
    nothing, unused = np.full(n_outputs, np.nan), np.zeros(n_outputs, dtype=np.bool_)
    return after, Report(
        estimate, rows @ rows.T, nothing, nothing, unused, 0.0, 0.0, 0.0, np.nan, np.nan, 0.0, 0.0, False, False, None
    )


def restart(state: JointState, sample: JointSample, params: JointParams) -> tuple[JointState, Report]:
    """Advances over an interval of unknown motion: rate and velocity reset to readings; returns state, report.

    What else is known stays; thrust follows the commands as far as they are known.

    Args:
        state: after the last sample, `started`.
    """
    state, _ = update_by_stamp(state, sample.timing, params)
    forces = estimate_forces(state, sample, params)
    firing = forces.firing
    initial = state._replace(
        level=firing.level, slope=firing.slope, tick_slope=forces.tick_slope, level_std=firing.level_std
    )
    return _step_first(initial, sample, params)


@kernel
def estimate_forces(state: JointState, sample: JointSample, params: JointParams) -> Drive:
    """Computes forces and impulses over an interval; thrust of jets with unknown command comes from the readings."""
    forces = compute_forces(state, sample, params)
    if forces.anything.number == 0.0:
        return forces
    rate_read = combine_gyros(sample.rates, state.mean, params)
    prediction = predict(state, forces, rate_read, params, (sample.frames, sample.speeds))
    point = prediction.mean.copy()
    point[RATE] = prediction.end
    values, _ = predict_outputs(point, state.reference, state.spin + prediction.spin, params)
    error, begin = np.zeros(6), 3 * params.places.gyros
    error[:3] = rate_read.rate - prediction.mean[RATE]
    for axis in range(3):
        present = 0
        for package in range(params.places.accelerometers):
            if not np.isnan(sample.velocities[package, axis]):
                present += 1
                error[3 + axis] += sample.velocities[package, axis] - values[begin + 3 * package + axis]
        error[3 + axis] = error[3 + axis] / present if present > 0 else np.nan
    return Drive(
        firing_shown_by_readings(error, state.mean, forces.firing, forces.anything, params),
        forces.lag_slope,
        forces.outside,
        forces.spreads,
        forces.by_ticks,
        forces.tick_slope,
        forces.anything,
        forces.engines,
    )


@kernel
def run_cycle(
    state: JointState, sample: JointSample, thresholds: Array, used_mask: np.ndarray, params: JointParams
) -> tuple[JointState, Report]:
    """Advances the joint filter by a sample after the first: prediction, covariance inflation if due, update, tests.

    Args:
        state: after the last sample.
        thresholds: in place of those of the parameters.
        used_mask: readings that count unless missing, the same for all hypotheses, shape (m,); or `OWN_CHOICE`.
    """
    floors = prediction_floors(state, params)
    state, crossing = update_by_crossings(state, state.mean[:N_PROPERTIES], sample, floors, params)
    state, stamp = update_by_stamp(state, sample.timing, params)
    forces = estimate_forces(state, sample, params)
    state, firing = separate_scale(state, forces.firing.amount, params), forces.firing
    commanded = firing.commanded or has_outside_impulse(sample, params)
    expected = predict_cycle(state, forces, sample, params)
    if used_mask.size > 0:
        expected = replace_used_mask(expected, used_mask & ~np.isnan(expected.innovation))
    innovation, incremented, lag_gain = expected.innovation, False, 0.0
    deviation = np.sqrt((expected.projected**2).sum(axis=1) + expected.variances)
    sites = measurements_at_prediction(expected, params)
    gyro_nis, accelerometer_nis = sum_by_sensor_kind(sites.nis, expected.used, np.nan, params)
    gyro_degrees, accelerometer_degrees = sum_by_sensor_kind(sites.degrees, expected.used, 0.0, params)
    untestable = count_untestable_degrees(expected, forces, state.mean, params)
    if forces.anything.number > 0.0:
        spread = forces.anything.spread
        gyro_nis, gyro_degrees = reduced_nis(gyro_nis, gyro_degrees - untestable[0], spread)
        accelerometer_degrees -= untestable[1]
        accelerometer_nis, accelerometer_degrees = reduced_nis(accelerometer_nis, accelerometer_degrees, spread)
    if commanded and not state.guarded:
        count = int(expected.used[: 3 * params.places.gyros].sum())
        if count > 0 and gyro_nis > thresholds[count - 1]:
            opened, more = switch_lag_priors(state, params, np.inf)
            given = estimate_forces(opened, sample, params)
            wider = replace_used_mask(predict_cycle(opened, given, sample, params), expected.used)
            nis, _ = sum_by_sensor_kind(measurements_at_prediction(wider, params).nis, wider.used, np.nan, params)
            if nis <= thresholds[count - 1]:  # a lag that is not as stated explains it
                state, forces, expected, lag_gain = opened, given, wider, more
            else:
                incremented = True
                state = replace_estimate(state, state.mean, incremented_root(state.root, params))
                expected = replace_used_mask(predict_cycle(state, forces, sample, params), expected.used)

    update = empty_update(expected.root)
    if expected.used.any():
        update, sites = update_root(expected, expected.root, params)
    after = update_state(state, sample, forces, expected, update, params)
    if state.guarded:  # before, second orders may be taken for what a lag does
        after, lag_gain = switch_lag_priors(after, params)
    after = update_guard(after, commanded, params)
    estimate, rows = parameters_with_scale(after, params)
    nis, degrees = float(sites.nis.sum()), max(float(sites.degrees.sum()) - untestable[0] - untestable[1], 0.0)
    log_likelihood = crossing.log_likelihood + float(sites.log_likelihood.sum()) + untestable[2] + lag_gain
    report = Report(
        estimate,
        rows @ rows.T,
        innovation,
        deviation,
        expected.used,
        nis,
        degrees,
        log_likelihood,
        gyro_nis,
        accelerometer_nis,
        gyro_degrees,
        accelerometer_degrees,
        incremented,
        expected.prediction.coupled,
        Course(crossing, stamp, forces, expected, update, nis, degrees, log_likelihood),
        False,
        False,
        False,
    )
    return after, report


@kernel
def update_state(
    state: JointState, sample: JointSample, forces: Drive, expected: Expected, update: Update, params: JointParams
) -> JointState:
    """Returns the state after a cycle: corrected mean and root, thrust levels, readings; convergence flag unchanged.

    Args:
        update: of no meaning where no component counted.
    """
    mean, root, firing = expected.prediction.mean, update.root, forces.firing
    if expected.used.any():
        mean = mean + update.correction
    elif root.shape[1] > root.shape[0]:
        root = compress_root(root, params.places.thrust)
    reading = readings(sample.rates, sample.velocities, sample.attitudes)
    present = ~np.isnan(reading)
    return JointState(
        mean,
        root,
        levels_at_estimates((firing.level, firing.slope, forces.tick_slope), state.mean, mean, params),
        firing.slope,
        forces.tick_slope,
        firing.level_std,
        expected.spin,
        state.reference,
        np.where(present, reading, state.read),
        np.where(present & ~expected.used, 1.0, 0.0),
        state.slot_jet,
        state.slot_sign,
        state.slot_on_top,
        sample.time_s,
        state.started,
        state.guarded,
        state.firing_count,
        state.lag_open,
        state.assumed,
        state.stir,
        state.stir_s,
    )


@kernel
def incremented_root(root: Array, params: JointParams) -> Array:
    """Returns a root with the start's uncertainty of the ten mass parameters appended, shape (size, k + 10)."""
    columns = np.zeros((root.shape[0], N_PROPERTIES))
    for element in range(N_PROPERTIES):
        columns[element, element] = params.increment_sigma[element]
    return np.hstack((root, columns))
