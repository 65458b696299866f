"""Cycle linearized at another estimate, for smoothing passes over a start and over a fault."""

from __future__ import annotations

from massprop_drake.maths.estimation.joint.covariance import empty_update
from massprop_drake.maths.estimation.joint.crossing import levels_at_estimates, update_by_crossings
from massprop_drake.maths.estimation.joint.forcing import Drive
from massprop_drake.maths.estimation.joint.innovation import (
    count_untestable_degrees,
    measurements_at_prediction,
    predict_readings,
    sum_by_sensor_kind,
    update_root,
)
from massprop_drake.maths.estimation.joint.joint_cycle import Course, estimate_forces, update_state
from massprop_drake.maths.estimation.joint.joint_sample import JointSample
from massprop_drake.maths.estimation.joint.lag_prior import switch_lag_priors
from massprop_drake.maths.estimation.joint.layout import (
    MASS,
    N_PROPERTIES,
    RATE,
    VELOCITY,
    JointParams,
    JointState,
    replace_estimate,
    replace_levels,
)
from massprop_drake.maths.estimation.joint.measurement import combine_gyros
from massprop_drake.maths.estimation.joint.prediction import Prediction, predict, propagate_root, velocity_gain_rows
from massprop_drake.maths.estimation.joint.tanks import draw_propellant
from massprop_drake.maths.estimation.joint.thrust_scale import separate_scale
from massprop_drake.maths.estimation.joint.ticks import update_by_stamp
from massprop_drake.maths.kernels import kernel
from massprop_drake.maths.linear_algebra import Array


@kernel
def repeat_start_cycle(
    state: JointState, sample: JointSample, linearization_point: Array, params: JointParams
) -> tuple[JointState, float, float]:
    """Repeats a cycle linearized at another estimate, lag priors switched; returns state, NIS, its expectation.

    Args:
        state: after the last sample, not guarded.
        linearization_point: a state's estimate, shape (size,).
    """
    after, course, _ = run_relinearized(state, sample, linearization_point, params)
    after, _ = switch_lag_priors(after, params)
    return after, course.nis, course.degrees


@kernel
def run_relinearized(
    state: JointState, sample: JointSample, linearization_point: Array, params: JointParams
) -> tuple[JointState, Course, tuple[float, float]]:
    """Advances the filter by a sample, linearized at another estimate; returns state, cycle results, gyro NIS.

    Args:
        state: after the last sample, not guarded.
        linearization_point: a state's estimate, shape (size,).
    """
    state, crossing = update_by_crossings(
        state, _parameters_at_propellant(linearization_point, state.mean, params), sample, params.floors, params
    )
    state, stamp = update_by_stamp(state, sample.timing, params)
    mean = _linearization_estimate(state.mean, linearization_point, params)
    forces = estimate_forces(replace_estimate(state, mean, state.root), sample, params)
    state = separate_scale(state, forces.firing.amount, params)
    point = replace_estimate(state, mean, state.root.copy())
    point.root[:N_PROPERTIES] = 0.0  # nothing of second order is left
    base = predict(point, forces, combine_gyros(sample.rates, mean, params), params, (sample.frames, sample.speeds))
    offset = state.mean - mean
    mean = base.mean + offset
    swing = slice(params.places.swing, params.places.swing + params.places.n_swing)
    mean[swing] = base.mean[swing] + base.swung.rows @ offset
    mean[RATE] += base.rate_rows @ offset
    for package in range(params.places.accelerometers):
        part = slice(VELOCITY + 3 * package, VELOCITY + 3 * package + 3)
        mean[part] += velocity_gain_rows(base, package) @ offset
    if params.places.n_attitude > 0:
        part = slice(params.places.attitude, params.places.attitude + 3)
        mean[part] += base.attitude[0] @ offset[RATE] + base.attitude[1] @ (offset[RATE] + base.rate_rows @ offset)
    if params.places.tanks > 0:
        more = base.tank_rows @ offset
        mean[:N_PROPERTIES] += more[:N_PROPERTIES]
        mean[params.places.fill : params.places.fill + params.places.tanks] += more[N_PROPERTIES:]
    prediction = Prediction(
        mean,
        base.rate_rows,
        base.velocity_rows,
        base.apart,
        base.attitude,
        base.mass_factor,
        base.noise,
        base.wander,
        base.swung,
        base.drift,
        base.tank_rows,
        base.turned,
        base.spin,
        base.end,
        base.duration_s,
        base.coupled,
    )
    root = propagate_root(state.root, prediction, params)
    properties = _parameters_at_propellant(linearization_point, prediction.mean, params)
    expected = predict_readings(state, prediction, root, (properties, params.floors), sample, params)
    if expected.used.any():
        update, sites = update_root(expected, root, params)
    else:
        update, sites = empty_update(root), measurements_at_prediction(expected, params)
    after = update_state(state, sample, forces, expected, update, params)
    level = _levels_after_cycle(state, after, forces, params)
    after = replace_levels(after, after.mean, after.root, level, forces.tick_slope)
    untestable = count_untestable_degrees(expected, forces, point.mean, params)
    nis, degrees = float(sites.nis.sum()), max(float(sites.degrees.sum()) - untestable[0] - untestable[1], 0.0)
    log_likelihood = crossing.log_likelihood + float(sites.log_likelihood.sum()) + untestable[2]
    gyro_nis, _ = sum_by_sensor_kind(sites.nis, expected.used, 0.0, params)
    gyro_degrees, _ = sum_by_sensor_kind(sites.degrees, expected.used, 0.0, params)
    course = Course(crossing, stamp, forces, expected, update, nis, degrees, log_likelihood)
    return after, course, (gyro_nis, max(gyro_degrees - untestable[0], 0.0))


@kernel
def _levels_after_cycle(before: JointState, after: JointState, forces: Drive, params: JointParams) -> Array:
    """Returns jets' thrust levels after a cycle; lags as linearized, command times as estimated, shape (n_jets,)."""
    places, mean = params.places, before.mean.copy()
    lags = slice(places.lag, places.lag + places.n_lag)
    mean[lags] = after.mean[lags]
    return levels_at_estimates((forces.firing.level, forces.firing.slope, forces.tick_slope), mean, after.mean, params)


@kernel
def _parameters_at_propellant(estimate: Array, mean: Array, params: JointParams) -> Array:
    """Returns an estimate's ten mass parameters, moved to the propellant in the tanks of another mean, shape (10,)."""
    places, result = params.places, estimate[:N_PROPERTIES].copy()
    if places.tanks > 0:
        fill = slice(places.fill, places.fill + places.tanks)
        used = estimate[fill] - mean[fill]
        result[:MASS] += draw_propellant(result, estimate[fill], used, 1.0, params.tanks).change[:MASS]
        result[MASS] /= 1.0 - result[MASS] * used.sum()
    return result


@kernel
def _linearization_estimate(mean: Array, linearization_point: Array, params: JointParams) -> Array:
    """Returns a mean with the linearization point's mass properties, lags, forces, gyro biases, and rate to match."""
    places = params.places
    result = mean.copy()
    result[:N_PROPERTIES] = _parameters_at_propellant(linearization_point, mean, params)
    slots = slice(places.force, places.force + places.n_force)
    result[slots] = linearization_point[slots]
    lags = slice(places.lag, places.lag + places.n_lag)
    result[lags] = linearization_point[lags]
    moving = slice(places.moving, places.moving + places.n_moving)
    result[moving] = linearization_point[moving]
    if places.n_gyro_bias > 0:
        biases = slice(places.gyro_bias, places.gyro_bias + places.n_gyro_bias)
        result[biases] = linearization_point[biases]
        for package in range(places.gyros):
            begin = places.gyro_bias + 3 * package
            own = slice(begin, begin + 3)
            result[RATE] += params.gyro_bias_sigma / places.gyros * (mean[own] - linearization_point[own])
    return result
