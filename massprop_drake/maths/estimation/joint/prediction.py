"""Prediction of the joint state over one interval, exact in its length, and its linearization.

Equations: theory page of the joint filter, "Prediction"; a and lambda are the impulses about the vehicle origin, L_j
the seconds of full thrust. While mu falls, c gathers lambda at its mean over the interval. Impulses stand in
`forcing`, dynamic coupling and turning in `rate_coupling`, noise and drifts in `process_noise`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from massprop_drake.maths.estimation.joint.covariance import semidefinite_root
from massprop_drake.maths.estimation.joint.disturbance_states import (
    Wander,
    append_constant_states,
    disturbance_effect,
    disturbance_noise,
    disturbance_noise_root,
)
from massprop_drake.maths.estimation.joint.forcing import (
    Drive,
    add_wheel_errors,
    effective_seconds,
    impulse_per_force,
    impulse_rows,
    known_impulse,
    thrust_bow_impulses,
    wrenches_of,
)
from massprop_drake.maths.estimation.joint.layout import (
    CENTER,
    MASS,
    N_PROPERTIES,
    RATE,
    VELOCITY,
    JointParams,
    JointState,
)
from massprop_drake.maths.estimation.joint.orientation import STILL, turn_attitude
from massprop_drake.maths.estimation.joint.process_noise import (
    add_lever_arm_noise,
    combine_disturbances,
    propellant_drift,
    second_order_moments,
    unstated_disturbance_drift,
    white_noise,
)
from massprop_drake.maths.estimation.joint.rate_coupling import (
    RateRead,
    add_coupling_derivative,
    arm_turning_integrals,
    coupled_rate,
    known_coupling_change,
    largest_coupling,
    rate_reading_gain,
    spin_integral,
    turning_matrix,
)
from massprop_drake.maths.estimation.joint.swing import Moved, SwingParams, Swung, modes_at_rest, swing_modes
from massprop_drake.maths.estimation.joint.tanks import TankChange, draw_propellant
from massprop_drake.maths.estimation.joint.unknown import remove_directions
from massprop_drake.maths.estimation.joint.wheels import UNSPUN, Spun, remove_untrusted_speeds, wheel_impulses
from massprop_drake.maths.kernels import kernel, take_elements
from massprop_drake.maths.linear_algebra import Array, cross, sparse_product
from massprop_drake.maths.mass_properties import ELEMENT

_IDENTITY = np.eye(3)
_FIRST = CENTER.start  # index of the first coordinate of the center of mass
ALONE = (STILL, UNSPUN)
_MOST_LIGHT = 3.0  # times the nominal 1/m: beyond, an estimate is none, and nothing flows


class Prediction(NamedTuple):
    """State predicted over an interval, and the propagation of errors.

    Attributes:
        mean: predicted, shape (size,).
        rate_rows: derivative of the change of w by the state, shape (3, size).
        velocity_rows: of the change of c_s at the mean position of the accelerometers, whose biases are not in it,
            shape (3, size).
        apart: derivatives by w0 and by w1 of what the turning adds to each c_s beyond that, shape
            (2, n_accelerometers, 3, 3).
        attitude: derivatives by w0 and by w1 of psi, B0 and B1 of `orientation`; none without a tracker, shape
            (2, n_attitude, 3).
        mass_factor: derivative of mu after by mu before.
        noise: covariance added to w and to every c_s alike, but for what z brings, shape (6, 6).
        wander: of z; what comes turns c as `noise` does.
        swung: of the modes.
        drift: variances added to the ten parameters, shape (10,).
        tank_rows: derivative of the change of the ten parameters, and of propellant in tanks, by what is drawn, shape
            (10 + n_tanks, size), or (0, size) without tanks; that of mu by itself is `mass_factor`.
        turned: O until the interval, see `turning`: a shift of r in it does not move what accelerometers have shown.
        spin: integral of w w^T dt over the interval, six elements, rad^2/s, shape (6,).
        end: w1, rad/s, shape (3,).
        duration_s: T.
        coupled: whether dynamic coupling counts.
    """

    mean: Array
    rate_rows: Array
    velocity_rows: Array
    apart: Array
    attitude: Array
    mass_factor: float
    noise: Array
    wander: Wander
    swung: Swung
    drift: Array
    tank_rows: Array
    turned: Array
    spin: Array
    end: Array
    duration_s: float
    coupled: bool


@kernel
def predict(
    state: JointState, forces: Drive, rate_read: RateRead, params: JointParams, motion: tuple[Array, Spun] = ALONE
) -> Prediction:
    """Predicts the filter's mean over an interval, with its derivatives and process noise; no update.

    Args:
        rate_read: rate at the interval's end by the gyros.
        motion: reference attitudes, see `orientation.turn_attitude`, and speeds of the wheels.
    """
    mean, places, duration = state.mean, params.places, forces.firing.duration_s
    speeds = remove_untrusted_speeds(motion[1], state.assumed[: places.wheels], duration, params.wheels)
    covariance = state.root[:N_PROPERTIES] @ state.root[:N_PROPERTIES].T
    inverse, reciprocal = take_elements(mean, ELEMENT), mean[MASS]
    seconds = effective_seconds(state, forces.firing, params)
    known, momenta, scale = known_impulse(mean, forces, speeds, params)
    impulse = seconds @ wrenches_of(mean, params) + known
    linear, moment = impulse[3:], impulse[:3] + cross(impulse[3:], mean[CENTER])
    flow, from_tanks, tank_rows = _draw_from_tanks(state, forces, seconds, params)

    rate_rows, velocity_rows = impulse_rows(state, forces, (linear, moment), flow, params)
    slow = slice(places.slow, places.slow + places.n_slow)
    wander = append_constant_states(
        combine_disturbances(state, speeds, scale * inverse, duration, params), places.tanks
    )
    exchange = wheel_impulses(speeds, mean[RATE], mean[RATE] + inverse @ moment, duration, params.wheels)
    rate_rows = add_wheel_errors(rate_rows, mean, exchange, scale, params)
    rate_rows[:, slow], velocity_rows[:, slow] = wander.begun[:3], wander.begun[3:]
    rate_rows, velocity_rows = remove_directions(rate_rows, velocity_rows, forces.anything)
    bias, noise = second_order_moments(state, forces, (linear, exchange), covariance, params)
    bias, noise = bias + disturbance_effect(wander, mean[slow]), noise + white_noise(mean, forces, params)
    locked = Moved(
        inverse @ moment + bias[:3] + _rate_change_by_draw(from_tanks.change, inverse, moment, linear),
        linear * reciprocal * (1.0 + 0.5 * reciprocal * flow) + bias[3:],
        rate_rows,
        velocity_rows,
    )
    moved, modes, noise, wander = _add_modes(state, locked, linear, (noise, wander), (scale, duration), params)
    (change, velocity_change), (rate_rows, velocity_rows) = moved

    end_rows = rate_rows.copy()
    end_rows[:, RATE] += _IDENTITY
    gain, variance_left = rate_reading_gain(end_rows @ state.root, noise + disturbance_noise(wander), rate_read)
    coupled, coupling_terms, end, bowed = coupled_rate(
        state, forces, change, (rate_read, gain), momenta + modes.momenta, params
    )
    if coupled or places.wheels + places.n_swing > 0:
        rate_rows = add_coupling_derivative(rate_rows, coupling_terms, rate_read, gain)
        change = change + coupling_terms.change
    if not coupled:
        noise[:3, :3] += largest_coupling(mean[RATE], end, duration) ** 2 * _IDENTITY

    if params.second_order:
        noise[3:, 3:] += variance_left.max() * np.trace(covariance[CENTER, CENTER]) * _IDENTITY
    apart = arm_turning_integrals(mean[RATE], end, params.accelerometer_positions - mean[CENTER], duration)
    middle = apart.sum(axis=1) / max(places.accelerometers, 1)
    apart -= middle.reshape(2, 1, 3, 3)
    velocity_rows[:, RATE] += middle[0] + middle[1]
    velocity_rows += middle[1] @ rate_rows
    noise, wander = add_lever_arm_noise(noise, wander, middle[1])
    gap = mean[RATE] + change - end
    velocity_change = velocity_change + middle[1] @ gap

    after = mean.copy()
    after[RATE] += change
    after = _add_velocity_gain(after, velocity_change, (apart[1], gap), duration, params)
    after[slow] *= wander.kept
    after[places.swing : places.swing + places.n_swing] = modes.after
    turned_until = turning_matrix(mean[RATE], state.reference, state.spin)
    after = _mean_after_draw(after, reciprocal * reciprocal * flow, from_tanks.change, turned_until, params)
    after, attitude = _propagate_attitude(state, after, forces, (motion[0], bowed[0], coupled), params)
    return Prediction(
        mean=after,
        rate_rows=rate_rows,
        velocity_rows=velocity_rows,
        apart=apart,
        attitude=attitude,
        mass_factor=1.0 + 2.0 * reciprocal * flow,
        noise=noise,
        wander=wander,
        swung=modes,
        drift=propellant_drift(mean, flow - from_tanks.used.sum(), params.tank_fraction, params.arm)
        + unstated_disturbance_drift(state, inverse @ moment, linear * reciprocal, duration, params),
        tank_rows=tank_rows,
        turned=turned_until,
        spin=spin_integral(mean[RATE], end, bowed, duration),
        end=end,
        duration_s=duration,
        coupled=coupled,
    )


@kernel
def _draw_from_tanks(
    state: JointState, forces: Drive, seconds: Array, params: JointParams
) -> tuple[float, TankChange, Array]:
    """Computes propellant mass used, changes of mass properties and tank fills by its draw, and derivatives."""
    mean, places, tanks = state.mean, params.places, params.tanks
    n, flows = places.tanks, seconds * params.flows
    flow = float(seconds @ params.flows) + forces.engines.used
    if not 0.0 < mean[MASS] < _MOST_LIGHT * params.nominal[MASS]:
        flows, flow = 0.0 * flows, 0.0
    if n == 0:
        none = np.zeros((0, 0))
        return flow, TankChange(np.zeros(0), np.zeros(0), none, none), np.zeros((0, places.size))
    factors, known, by_jets = np.ones(n), tanks.feeds @ flows, tanks.feeds * params.flows
    if places.n_tank > 0:
        factors = factors + tanks.flow_sigma * mean[places.tank : places.tank + n]
    scale = 1.0 + params.thrust_sigma * mean[places.scale] if places.n_scale > 0 else 1.0
    used, fill = factors * known, slice(places.fill, places.fill + n)
    drawn, by_errors = draw_propellant(mean[:N_PROPERTIES], mean[fill], used, scale, tanks), np.zeros((n, places.size))
    flowing = 1.0 if flows.any() else 0.0
    by_jets = (flowing * factors).reshape(n, 1) * by_jets
    if places.n_thrust > 0:
        columns = slice(places.thrust, places.thrust + places.n_thrust)
        by_errors[:, columns] = by_jets * (params.thrust_sigma * forces.firing.amount)
    if places.n_tank > 0:
        for tank in range(n):
            by_errors[tank, places.tank + tank] = tanks.flow_sigma[tank] * known[tank]
    for slot in range(places.n_force):
        jet = int(state.slot_jet[slot])
        if jet >= 0:
            seconds = impulse_per_force(state, slot, forces.firing) / params.thrusts[jet]
            by_errors[:, places.force + slot] = by_jets[:, jet] * seconds
    rows = drawn.by_used @ by_errors
    rows[:, :N_PROPERTIES] += drawn.by_state[:, :N_PROPERTIES]
    rows[:, fill] += drawn.by_state[:, N_PROPERTIES:]
    if places.n_scale > 0:
        rows[N_PROPERTIES:, places.scale] -= params.thrust_sigma * used
    return flow + (used.sum() - known.sum()), drawn, rows


@kernel
def _rate_change_by_draw(property_change: Array, inverse: Array, moment: Array, impulse: Array) -> Array:
    """Computes the extra change of rate as drawn propellant changes inertia and center of mass, rad/s, shape (3,)."""
    if property_change.shape[0] == 0:
        return np.zeros(3)
    return 0.5 * (take_elements(property_change, ELEMENT) @ moment + inverse @ cross(impulse, property_change[CENTER]))


@kernel
def _mean_after_draw(mean: Array, reciprocal_gain: float, change: Array, turning: Array, params: JointParams) -> Array:
    """Returns the predicted mean; mass properties, tank fills and velocities after propellant use, shape (size,)."""
    n, places, result = change.shape[0] - N_PROPERTIES, params.places, mean.copy()
    result[MASS] += reciprocal_gain
    if n <= 0:
        return result
    result[:MASS] += change[:MASS]
    result[places.fill : places.fill + n] += change[N_PROPERTIES:]
    for package in range(places.accelerometers):
        result[VELOCITY + 3 * package : VELOCITY + 3 * package + 3] += turning @ change[CENTER]
    return result


@kernel
def _add_modes(
    state: JointState,
    locked: Moved,
    impulse: Array,
    noise_wander: tuple[Array, Wander],
    scale_time: tuple[float, float],
    params: JointParams,
) -> tuple[tuple[tuple[Array, Array], tuple[Array, Array]], Swung, Array, Wander]:
    """Adds modal motion to changes of rate and velocity, derivatives and noise; returns these and the modes."""
    (noise, wander), (scale, duration_s) = noise_wander, scale_time
    if params.places.n_swing == 0:
        whole = (locked.rate, locked.velocity), (locked.rate_rows, locked.velocity_rows)
        return whole, modes_at_rest(0, params.places.size), noise, wander
    places, turning_back = params.places, known_coupling_change(state, duration_s)
    column = places.scale if places.n_scale > 0 else -1
    swing_params = SwingParams(params.modes, places.swing, places.moving, places.n_moving, column, params.thrust_sigma)
    felt, modes = swing_modes(state.mean, locked, impulse, (scale, turning_back), duration_s, swing_params)
    back = modes.given_back
    with_back = Wander(wander.kept, wander.begun, back @ wander.drawn, wander.along, wander.apart)
    whole = (felt.rate, felt.velocity), (felt.rate_rows, felt.velocity_rows)
    return whole, modes, back @ noise @ back.T, with_back


@kernel
def _add_velocity_gain(
    mean: Array, velocity_change: Array, by_end_and_gap: tuple[Array, Array], duration_s: float, params: JointParams
) -> Array:
    """Returns the predicted mean with each accelerometer's velocity gain over the interval, shape (size,)."""
    places, result, (by_end, gap) = params.places, mean.copy(), by_end_and_gap
    for package in range(places.accelerometers):
        part = slice(VELOCITY + 3 * package, VELOCITY + 3 * package + 3)
        result[part] += velocity_change + by_end[package] @ gap
        if places.n_acceleration_bias > 0:
            begin = places.acceleration_bias + 3 * package
            result[part] += duration_s * params.acceleration_bias_sigma * mean[begin : begin + 3]
    return result


@kernel
def _propagate_attitude(
    state: JointState, predicted: Array, forces: Drive, motion: tuple[Array, Array, bool], params: JointParams
) -> tuple[Array, Array]:
    """Returns the predicted mean with the attitude propagated, shape (size,), and its derivatives by rates."""
    if params.places.n_attitude == 0:
        return predicted, np.zeros((2, 0, 3))
    mean, (frames, bow, coupled) = state.mean, motion
    if not coupled:
        bow = (thrust_bow_impulses(state, forces, params) @ take_elements(mean, ELEMENT))[0]
    attitude = slice(params.places.attitude, params.places.attitude + 3)
    rates, result = np.stack((mean[RATE], predicted[RATE])), predicted.copy()
    result[attitude], by_rates = turn_attitude(mean[attitude], frames, rates, bow, forces.firing.duration_s)
    return result, by_rates


@kernel
def velocity_gain_rows(prediction: Prediction, package: int) -> Array:
    """Computes the derivative of an accelerometer package's velocity gain by the state, shape (3, size)."""
    by_start, by_end = prediction.apart[0, package], prediction.apart[1, package]
    rows = prediction.velocity_rows + by_end @ prediction.rate_rows
    rows[:, RATE] += by_start + by_end
    return rows


@kernel
def propagate_root(root: Array, prediction: Prediction, params: JointParams) -> Array:
    """Propagates the covariance's root over an interval, process noise as more columns, shape (size, k + more)."""
    places = params.places
    after = root.copy()
    changes = sparse_product(np.vstack((prediction.rate_rows, prediction.velocity_rows)), root)
    after[RATE] += changes[:3]
    common = changes[3:]
    noise = semidefinite_root(prediction.noise)
    drifting = np.flatnonzero(prediction.drift > 0.0)
    slow, disturbance = slice(places.slow, places.slow + places.n_slow), disturbance_noise_root(prediction.wander)
    first = 6 + disturbance.shape[1]  # of the columns of what drifts
    columns = np.zeros((places.size, first + drifting.shape[0]))
    columns[RATE, :6], columns[RATE, 6:first] = noise[:3], disturbance[:3]
    if places.n_swing > 0:
        swing, shaken = slice(places.swing, places.swing + places.n_swing), prediction.swung.shaken
        after[swing] = prediction.swung.rows @ root
        columns[swing, :6], columns[swing, 6:first] = shaken @ noise, shaken @ disturbance[:6].copy()
    after[slow] *= prediction.wander.kept.reshape(-1, 1)
    columns[slow, 6:first] = disturbance[6:]
    for package in range(places.accelerometers):
        part = slice(VELOCITY + 3 * package, VELOCITY + 3 * package + 3)
        after[part] += common
        columns[part, :6], columns[part, 6:first] = noise[3:], disturbance[3:6]
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
