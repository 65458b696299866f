r"""Mean and covariance of the products of errors, which a linear prediction leaves out.

*Second order.* The product of the errors of J and r has the mean b2 (2-118) and the covariance D (2-121). So have
their products with thrust errors: with N_j the effect of an error of the ten parameters under full thrust of jet j, on
w and c, and g_j = sigma_T L_j, their mean is sum g_j N_j P_xb_j, their covariance sum g_j^2 P_bb N_j P_xx N_j^T.
"""

from __future__ import annotations

import numpy as np

from massprop_drake.maths.estimation.filters.rate_increments import second_order_terms
from massprop_drake.maths.estimation.joint.burns import EngineImpulse
from massprop_drake.maths.estimation.joint.forcing import Drive, slot_weight, wheel_factors
from massprop_drake.maths.estimation.joint.lagged_impulses import Firing, moments_of
from massprop_drake.maths.estimation.joint.layout import CENTER, MASS, N_PROPERTIES, JointParams, JointState
from massprop_drake.maths.estimation.joint.rates import intervals_per_period
from massprop_drake.maths.kernels import idiom, kernel, take_elements
from massprop_drake.maths.linear_algebra import Array, skew
from massprop_drake.maths.mass_properties import ELEMENT

_TINY = float(np.finfo(np.float64).tiny)
_FIRES = 1e-6  # of an interval: less thrust has no products that count


@kernel
def second_order_moments(
    state: JointState, acting: Drive, pulls: tuple[Array, Array], covariance: Array, params: JointParams
) -> tuple[Array, Array]:
    """Computes mean, shape (6,), and covariance, shape (6, 6), on w and c, of the products of errors.

    Args:
        state: before the interval.
        pulls: linear impulse, shape (3,), and E_k of the wheels, shape (n_wheels, 3).
        covariance: of the ten parameters.
    """
    bias, noise = np.zeros(6), np.zeros((6, 6))
    linear, exchange = pulls
    if params.second_order:
        bias[:3], noise[:3, :3] = second_order_terms(covariance[:9, :9], linear)
        if params.places.n_thrust > 0:
            product_mean, product_noise = _thrust_products(state, acting, covariance, params)
            bias += product_mean
            noise += product_noise
        if params.places.n_mount > 0:
            product_mean, product_noise = _mounting_products(state, acting, covariance, params)
            bias += product_mean
            noise += product_noise
        if exchange.shape[0] > 0:
            product_mean, product_noise = _wheel_products(state, exchange, covariance, params)
            bias += product_mean
            noise += product_noise
        if params.places.engines > 0:
            product_mean, product_noise = _engine_products(state, acting.engines, covariance, params)
            bias += product_mean
            noise += product_noise
        if acting.anything.number > 0.0:
            noise += _opening_products(state.mean, acting.firing, covariance, params)
        if (state.slot_jet >= 0).any():
            product_mean, product_noise = _force_products(state, acting.firing, covariance, params)
            bias += product_mean
            noise += product_noise
    return bias, intervals_per_period(acting.firing.duration_s, params.rates) * noise


@kernel
def _opening_products(mean: Array, firing: Firing, covariance: Array, params: JointParams) -> Array:
    """Computes covariance on w and c, shape (6, 6), of openings that readings show times the ten parameters' errors.

    An opening is as well shown as the inertia is known, and lies between none and all of the interval.
    """
    error = 0.0
    for i in range(3):
        error = max(error, np.sqrt(covariance[i, i]) / max(abs(mean[i]), _TINY))
    effects = parameter_effects(mean, params.wrenches[np.flatnonzero(firing.unknown)])
    flat = effects.reshape(6, -1) * (min(error, 1.0) * firing.duration_s) ** 2
    return _each_times(effects, covariance).reshape(6, -1) @ flat.T


@kernel
def _wheel_products(state: JointState, exchange: Array, covariance: Array, params: JointParams) -> tuple[Array, Array]:
    """Computes mean, shape (6,), and covariance, shape (6, 6), of wheel errors times errors of the ten parameters.

    They are off by the errors of their inertias, and in the scale of thrust by its error.
    """
    places, n = params.places, exchange.shape[0]
    wrenches, rows = np.zeros((n + 1, 6)), np.zeros((n + 1, state.root.shape[1]))
    wrenches[:n, :3] = exchange
    wrenches[n, :3] = wheel_factors(state.mean, params) @ exchange
    if places.n_wheel > 0:
        rows[:n] = params.wheels.sigma * state.root[places.wheel : places.wheel + places.n_wheel]
    if places.n_scale > 0:
        rows[n] = -params.thrust_sigma * state.root[places.scale]
    return _jet_products(rows, parameter_effects(state.mean, wrenches), state, covariance)


@kernel
def _engine_products(
    state: JointState, pushed: EngineImpulse, covariance: Array, params: JointParams
) -> tuple[Array, Array]:
    """Computes mean, shape (6,), and covariance, shape (6, 6), of engine errors times errors of the ten parameters.

    They are off by their own errors, and in the scale of the jets' thrust by its error.
    """
    places, n = params.places, params.places.n_engine
    wrenches, rows = np.zeros((n + 1, 6)), np.zeros((n + 1, state.root.shape[1]))
    wrenches[:n], wrenches[n] = pushed.by_errors, pushed.impulse
    rows[:n] = state.root[places.engine : places.engine + n]
    if places.n_scale > 0:
        rows[n] = -params.thrust_sigma * state.root[places.scale]
    return _jet_products(rows, parameter_effects(state.mean, wrenches), state, covariance)


@kernel
def _thrust_products(state: JointState, acting: Drive, covariance: Array, params: JointParams) -> tuple[Array, Array]:
    """Computes mean, shape (6,), and covariance, shape (6, 6), of thrust errors times errors of the ten parameters."""
    mean, places = state.mean, params.places
    jets = np.flatnonzero(np.abs(acting.firing.amount) > _FIRES * acting.firing.duration_s)
    shares = params.thrust_sigma * acting.firing.amount[jets]
    effects = parameter_effects(mean, params.wrenches[jets]) * shares.reshape(-1, 1)
    return _jet_products(state.root[places.thrust + jets], effects, state, covariance)


@kernel
def _mounting_products(state: JointState, acting: Drive, covariance: Array, params: JointParams) -> tuple[Array, Array]:
    """Computes mean, shape (6,), and covariance, shape (6, 6), of mounting errors times those of the parameters."""
    seconds = acting.firing.amount[params.mounting.jets]
    there = np.flatnonzero(np.abs(seconds) > _FIRES * acting.firing.duration_s)
    effects = parameter_effects(state.mean, params.mounting.wrenches[there]) * seconds[there].reshape(-1, 1)
    return _jet_products(state.root[params.places.mount + there], effects, state, covariance)


@kernel
def _force_products(state: JointState, firing: Firing, covariance: Array, params: JointParams) -> tuple[Array, Array]:
    """Computes mean, shape (6,), and covariance, shape (6, 6), of failure force errors times those of the parameters.

    A jet that has just failed may give anything: what it does to the rates is then as uncertain as what every jet does.
    """
    slots = np.flatnonzero(state.slot_jet >= 0)
    jets = state.slot_jet[slots].astype(np.intp)
    seconds = np.array([slot_weight(state, int(slot), firing) for slot in slots]) / params.thrusts[jets]
    effects = parameter_effects(state.mean, params.wrenches[jets]) * seconds.reshape(-1, 1)
    return _jet_products(state.root[params.places.force + slots], effects, state, covariance)


@kernel
def _jet_products(rows: Array, effects: Array, state: JointState, covariance: Array) -> tuple[Array, Array]:
    """Computes mean, shape (6,), and covariance, shape (6, 6), of jet impulse errors times those of the parameters."""
    crossed = state.root[:N_PROPERTIES] @ rows.T
    flat = effects.reshape(6, -1)
    product_mean = flat @ np.ascontiguousarray(crossed.T).ravel()
    variances = np.sum(rows * rows, axis=1).reshape(-1, 1)
    return product_mean, (variances * _each_times(effects, covariance)).reshape(6, -1) @ flat.T


def _flat_times(effects, covariance):  # type: ignore[no-untyped-def] # compiled alone
    return (effects.reshape(-1, covariance.shape[0]) @ covariance).reshape(effects.shape)


@idiom(_flat_times)
def _each_times(effects: Array, covariance: Array) -> Array:
    """Multiplies each matrix of a stack by another one."""
    return effects @ covariance


@kernel
def parameter_effects(mean: Array, wrenches: Array) -> Array:
    """Computes N_j, effect of the ten parameters' errors on w and c under wrenches for a second, shape (6, n, 10)."""
    inverse = take_elements(mean, ELEMENT)
    moments, forces = moments_of(wrenches, mean), wrenches[:, 3:]
    effects = np.zeros((6, wrenches.shape[0], N_PROPERTIES))
    for row in range(3):
        for column in range(3):
            effects[row, :, ELEMENT[row, column]] = moments[:, column]  # of J m
        effects[row, :, CENTER] = forces @ skew(inverse[row]).T  # of J [F x]
        effects[3 + row, :, MASS] = forces[:, row]
    return effects
