r"""Noise over an interval: walks, scatter of impulses, ticks, propellant, disturbances, and products of errors.

*Second order.* The product of the errors of J and r has the mean b2 (2-118) and the covariance D (2-121). So have
their products with thrust errors: with N_j the effect of an error of the ten parameters under full thrust of jet j, on
w and c, and g_j = sigma_T L_j, their mean is sum g_j N_j P_xb_j, their covariance sum g_j^2 P_bb N_j P_xx N_j^T.
"""

from __future__ import annotations

import numpy as np

from massprop_drake.maths.estimation.filters.rate_increments import second_order_terms
from massprop_drake.maths.estimation.joint.burns import EngineImpulse
from massprop_drake.maths.estimation.joint.disturbance_states import (
    DisturbanceParams,
    Wander,
    discretize_disturbance,
    join_slow_states,
)
from massprop_drake.maths.estimation.joint.forcing import Drive, impulse_per_force, wheel_factors
from massprop_drake.maths.estimation.joint.lagged_impulses import Firing, effects_of, moments_of
from massprop_drake.maths.estimation.joint.layout import (
    CENTER,
    MASS,
    N_PROPERTIES,
    RATE,
    JointParams,
    JointState,
    intervals_per_period,
)
from massprop_drake.maths.estimation.joint.unknown import unknown_impulse_covariance
from massprop_drake.maths.estimation.joint.wheels import Spun, append_reading_errors
from massprop_drake.maths.kernels import idiom, kernel, take_elements
from massprop_drake.maths.linear_algebra import Array, skew
from massprop_drake.maths.mass_properties import ELEMENT

_TINY = float(np.finfo(np.float64).tiny)  # smallest normal double: no division by zero
_FIRES = 1e-6  # seconds per second of an interval: less thrust has no products that count, compute budget
_IDENTITY = np.eye(3)
_PAIRS = ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))


@kernel
def add_lever_arm_noise(noise: Array, disturbance: Wander, velocity_by_rate: Array) -> tuple[Array, Wander]:
    """Adds rate noise times lever arms to velocity noise, shape (6, 6), and to the effects of disturbances."""
    turned = noise.copy()
    turned[3:] += velocity_by_rate @ noise[:3]
    turned[:, 3:] += turned[:, :3] @ velocity_by_rate.T
    drawn = disturbance.drawn.copy()
    drawn[3:] += velocity_by_rate @ drawn[:3]
    return turned, Wander(disturbance.kept, disturbance.begun, drawn, disturbance.along, disturbance.apart)


@kernel
def white_noise(mean: Array, forces: Drive, params: JointParams) -> Array:
    """Computes process noise of rate, velocity: walks, scatter of impulses and command times, unknown jets, (6, 6)."""
    noise, firing = unknown_impulse_covariance(forces.anything), forces.firing
    by_chance = (params.repeatability * firing.amount) ** 2
    variance = firing.variance + intervals_per_period(firing.duration_s, params.rates) * by_chance
    if variance.any():
        effects = effects_of(params.wrenches, mean)
        noise += (effects * variance.reshape(-1, 1)).T @ effects
    if forces.spreads.any():
        seconds = firing.by_tick * np.sqrt(forces.spreads).reshape(-1, 1)
        late = effects_of(seconds @ params.wrenches, mean)
        noise += late.T @ late
    if params.places.engines > 0:
        unsteady = effects_of(forces.engines.noise, mean)
        noise += unsteady.T @ unsteady
    noise[:3, :3] += params.rate_walk**2 * firing.duration_s * _IDENTITY
    noise[3:, 3:] += params.velocity_walk**2 * firing.duration_s * _IDENTITY
    return noise


@kernel
def propellant_drift(properties: Array, used_mass: float, tank_fraction: float, arm: float) -> Array:
    """Computes variances added to the ten mass parameters, as the place of used propellant is unknown, shape (10,).

    Args:
        properties: the ten parameters, shape (10,) or more.
        used_mass: slug or kg.
        tank_fraction, arm: see `JointParams`.
    """
    mass_share = properties[MASS] * used_mass
    if mass_share > 0.0 and tank_fraction > 0.0:
        return _relative_drift(properties, 0.01 * tank_fraction**2 * mass_share, arm)
    return np.zeros(N_PROPERTIES)


@kernel
def combine_disturbances(
    state: JointState, speeds: Spun, inverse: Array, duration_s: float, params: JointParams
) -> Wander:
    """Computes decay, effects and noise of disturbances and of wheel speed reading errors over an interval.

    Args:
        inverse: what an impulse of them turns the vehicle by, shape (3, 3).
    """
    unstated = DisturbanceParams(params.unstated, state.stir_s)
    combined = join_slow_states(
        discretize_disturbance(params.disturbance, duration_s), discretize_disturbance(unstated, duration_s, state.stir)
    )
    return append_reading_errors(combined, speeds, inverse, duration_s * state.mean[RATE], params.wheels)


@kernel
def unstated_disturbance_drift(
    state: JointState, rate_change: Array, velocity_change: Array, duration_s: float, params: JointParams
) -> Array:
    """Computes variances added to the ten mass parameters, during firing, by a disturbance nobody stated, shape (10,).

    What moves inside gives back what jets give to it, later: they turn and push the vehicle now more, now less, by the
    share that what is unstated has in what they give. That share comes anew once in its time constant.

    Args:
        rate_change, velocity_change: by all that acts, shape (3,) each.
    """
    drift = np.zeros(N_PROPERTIES)
    if state.stir == 0.0 or not (rate_change.any() or velocity_change.any()):
        return drift
    walked = 2.0 * duration_s / state.stir_s * (state.stir * duration_s) ** 2
    minimum = duration_s**2 / params.places.jets  # what fires is a jet at the least
    angular, linear = np.sum(params.unstated[:3] ** 2), np.sum(params.unstated[3:] ** 2)
    by_turning = walked * angular / max(np.sum(rate_change**2), minimum * angular)
    if linear == 0.0:
        return _relative_drift(state.mean, by_turning, 0.0)
    by_pushing = walked * linear / max(np.sum(velocity_change**2), minimum * linear)
    drift = _relative_drift(state.mean, by_turning, np.sqrt(by_pushing / by_turning) * params.arm)
    drift[MASS] = by_pushing * state.mean[MASS] ** 2
    return drift


@kernel
def _relative_drift(properties: Array, relative_variance: float, arm: float) -> Array:
    """Computes variances of inverse inertia and center of mass from one relative variance, shape (10,)."""
    drift = np.zeros(N_PROPERTIES)
    for k, (i, j) in enumerate(_PAIRS):
        drift[k] = relative_variance * abs(properties[i] * properties[j])
    drift[CENTER] = relative_variance * arm**2
    return drift


@kernel
def second_order_moments(
    state: JointState, forces: Drive, impulses: tuple[Array, Array], covariance: Array, params: JointParams
) -> tuple[Array, Array]:
    """Computes second-order mean and noise of rate and velocity, from products of parameter errors, (6,), (6, 6).

    Args:
        impulses: linear, shape (3,), and E_k of the wheels, shape (n_wheels, 3).
        covariance: of the ten parameters.
    """
    bias, noise = np.zeros(6), np.zeros((6, 6))
    (linear, exchange), places = impulses, params.places
    if params.second_order:
        bias[:3], noise[:3, :3] = second_order_terms(covariance[:9, :9], linear)
        if places.n_thrust > 0:
            bias, noise = _add_moments(bias, noise, _thrust_products(state, forces, covariance, params))
        if places.n_mount > 0:
            bias, noise = _add_moments(bias, noise, _mounting_products(state, forces, covariance, params))
        if exchange.shape[0] > 0:
            bias, noise = _add_moments(bias, noise, _wheel_products(state, exchange, covariance, params))
        if places.engines > 0:
            bias, noise = _add_moments(bias, noise, _engine_products(state, forces.engines, covariance, params))
        if forces.anything.number > 0.0:
            noise += _unknown_thrust_products(state.mean, forces.firing, covariance, params)
        if (state.slot_jet >= 0).any():
            bias, noise = _add_moments(bias, noise, _force_products(state, forces.firing, covariance, params))
    return bias, intervals_per_period(forces.firing.duration_s, params.rates) * noise


@kernel
def _add_moments(bias: Array, noise: Array, added: tuple[Array, Array]) -> tuple[Array, Array]:
    """Adds mean and covariance of further independent error products to a mean and covariance."""
    return bias + added[0], noise + added[1]


@kernel
def _unknown_thrust_products(mean: Array, firing: Firing, covariance: Array, params: JointParams) -> Array:
    """Computes second-order noise of rate, velocity: unknown jets' on-times times parameter errors, shape (6, 6).

    An opening is as well shown as the inertia is known, and lies between none and all of the interval.
    """
    error = 0.0
    for i in range(3):
        error = max(error, np.sqrt(covariance[i, i]) / max(abs(mean[i]), _TINY))
    effects = parameter_effects(mean, params.wrenches[np.flatnonzero(firing.unknown)])
    flat = effects.reshape(6, -1) * (min(error, 1.0) * firing.duration_s) ** 2
    return _multiply_stack(effects, covariance).reshape(6, -1) @ flat.T


@kernel
def _wheel_products(state: JointState, impulses: Array, covariance: Array, params: JointParams) -> tuple[Array, Array]:
    """Computes second-order mean, noise of rate, velocity: wheel errors times mass-parameter errors, (6,), (6, 6)."""
    places, n = params.places, impulses.shape[0]
    wrenches, rows = np.zeros((n + 1, 6)), np.zeros((n + 1, state.root.shape[1]))
    wrenches[:n, :3] = impulses
    wrenches[n, :3] = wheel_factors(state.mean, params) @ impulses
    if places.n_wheel > 0:
        rows[:n] = params.wheels.sigma * state.root[places.wheel : places.wheel + places.n_wheel]
    rows[n] = _scale_error_row(state, params)
    return _impulse_products(rows, parameter_effects(state.mean, wrenches), state, covariance)


@kernel
def _engine_products(
    state: JointState, engine_impulse: EngineImpulse, covariance: Array, params: JointParams
) -> tuple[Array, Array]:
    """Computes second-order mean, noise of rate, velocity: engine errors times mass-parameter errors, (6,), (6, 6)."""
    places, n = params.places, params.places.n_engine
    wrenches, rows = np.zeros((n + 1, 6)), np.zeros((n + 1, state.root.shape[1]))
    wrenches[:n], wrenches[n] = engine_impulse.by_errors, engine_impulse.impulse
    rows[:n] = state.root[places.engine : places.engine + n]
    rows[n] = _scale_error_row(state, params)
    return _impulse_products(rows, parameter_effects(state.mean, wrenches), state, covariance)


@kernel
def _scale_error_row(state: JointState, params: JointParams) -> Array:
    """Returns the covariance root's row of known impulses' relative error, due to the thrust scale, shape (k,)."""
    if params.places.n_scale > 0:
        return -params.thrust_sigma * state.root[params.places.scale]
    return np.zeros(state.root.shape[1])


@kernel
def _thrust_products(state: JointState, forces: Drive, covariance: Array, params: JointParams) -> tuple[Array, Array]:
    """Computes second-order mean, noise of rate, velocity: thrust errors times mass-parameter errors, (6,), (6, 6)."""
    mean, places = state.mean, params.places
    jets = np.flatnonzero(np.abs(forces.firing.amount) > _FIRES * forces.firing.duration_s)
    shares = params.thrust_sigma * forces.firing.amount[jets]
    effects = parameter_effects(mean, params.wrenches[jets]) * shares.reshape(-1, 1)
    return _impulse_products(state.root[places.thrust + jets], effects, state, covariance)


@kernel
def _mounting_products(state: JointState, forces: Drive, covariance: Array, params: JointParams) -> tuple[Array, Array]:
    """Computes second-order mean, noise of rate, velocity: jet mounting times mass-parameter errors, (6,), (6, 6)."""
    seconds = forces.firing.amount[params.mounting.jets]
    there = np.flatnonzero(np.abs(seconds) > _FIRES * forces.firing.duration_s)
    effects = parameter_effects(state.mean, params.mounting.wrenches[there]) * seconds[there].reshape(-1, 1)
    return _impulse_products(state.root[params.places.mount + there], effects, state, covariance)


@kernel
def _force_products(state: JointState, firing: Firing, covariance: Array, params: JointParams) -> tuple[Array, Array]:
    """Computes second-order mean, noise of rate, velocity: failed jets' force errors times mass-parameter errors.

    A jet that has just failed may give anything: what it does to the rates is then as uncertain as what every jet does.
    """
    slots = np.flatnonzero(state.slot_jet >= 0)
    jets = state.slot_jet[slots].astype(np.intp)
    seconds = np.array([impulse_per_force(state, int(slot), firing) for slot in slots]) / params.thrusts[jets]
    effects = parameter_effects(state.mean, params.wrenches[jets]) * seconds.reshape(-1, 1)
    return _impulse_products(state.root[params.places.force + slots], effects, state, covariance)


@kernel
def _impulse_products(impulse_root: Array, effects: Array, state: JointState, covariance: Array) -> tuple[Array, Array]:
    """Computes second-order mean, noise of rate, velocity: impulse errors times mass-parameter errors, (6,), (6, 6)."""
    crossed = state.root[:N_PROPERTIES] @ impulse_root.T
    flat = effects.reshape(6, -1)
    product_mean = flat @ np.ascontiguousarray(crossed.T).ravel()
    variances = np.sum(impulse_root * impulse_root, axis=1).reshape(-1, 1)
    return product_mean, (variances * _multiply_stack(effects, covariance)).reshape(6, -1) @ flat.T


def _multiply_flattened(effects, covariance):  # type: ignore[no-untyped-def] # compiled alone
    """Compiled form of `_multiply_stack`."""
    return (effects.reshape(-1, covariance.shape[0]) @ covariance).reshape(effects.shape)


@idiom(_multiply_flattened)
def _multiply_stack(effects: Array, covariance: Array) -> Array:
    """Multiplies each matrix of a stack by one covariance, from the right."""
    return effects @ covariance


@kernel
def parameter_effects(mean: Array, wrenches: Array) -> Array:
    """Computes derivatives of rate, velocity by the ten mass parameters, per second of wrenches, shape (6, n, 10)."""
    inverse = take_elements(mean, ELEMENT)
    moments, forces = moments_of(wrenches, mean), wrenches[:, 3:]
    effects = np.zeros((6, wrenches.shape[0], N_PROPERTIES))
    for row in range(3):
        for column in range(3):
            effects[row, :, ELEMENT[row, column]] = moments[:, column]  # of J m
        effects[row, :, CENTER] = forces @ skew(inverse[row]).T  # of J [F x]
        effects[3 + row, :, MASS] = forces[:, row]
    return effects
