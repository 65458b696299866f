"""Impulses on the vehicle over an interval, and their derivatives by the errors of what gives them.

A slot's force f of a failed jet acts for all of T on top of what its jet is told to give (a leak), for the time that
the jet's level leaves, T - L (it is stuck on), or is missing for the time L (it gives less). In the last two cases
the lag of that jet counts for 1 - f/F. Wheels turn the vehicle by what their momentum h changes by, and by what
turning h takes. Known outside forces, engines and wheels are not in the common thrust scale s: they enter by 1 -
sigma_T s.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from massprop_drake.maths.estimation.filters.rate_increments import angular_block
from massprop_drake.maths.estimation.joint.burns import EngineImpulse, engine_impulse, replace_untrusted_levels
from massprop_drake.maths.estimation.joint.joint_sample import JointSample
from massprop_drake.maths.estimation.joint.lagged_impulses import (
    Firing,
    integrate_thrust,
    moments_of,
    replace_firing,
    time_constants,
)
from massprop_drake.maths.estimation.joint.layout import CENTER, INERTIA, MASS, JointParams, JointState
from massprop_drake.maths.estimation.joint.unknown import Directions, unknown_directions
from massprop_drake.maths.estimation.joint.wheels import Spun, wheel_momenta
from massprop_drake.maths.kernels import kernel, take_elements
from massprop_drake.maths.linear_algebra import Array, skew
from massprop_drake.maths.mass_properties import ELEMENT
from massprop_drake.maths.vehicle.mounting import displace_wrenches


class Drive(NamedTuple):
    """Forces and impulses on the vehicle over an interval.

    Attributes:
        firing: see `lagged_impulses.Firing`.
        lag_slope: derivative of the logarithm of each jet's time constant by the error of its kind, shape (n_jets,).
        outside: impulse of known outside forces, angular about the vehicle origin and linear, shape (6,).
        spreads: see `ticks.Timing`.
        by_ticks: derivative of L by offset and period error of the ticks, shape (2, n_jets).
        tick_slope: of the level at the end of the interval, 1/s, likewise.
        anything: directions in which jets whose commands are not known may have given anything, see `Directions`.
        engines: what they give; see `burns.EngineImpulse`.
    """

    firing: Firing
    lag_slope: Array
    outside: Array
    spreads: Array
    by_ticks: Array
    tick_slope: Array
    anything: Directions
    engines: EngineImpulse


@kernel
def compute_forces(state: JointState, sample: JointSample, params: JointParams) -> Drive:
    """Computes the jets' and engines' thrust and known impulses over a sample's interval, with the estimated lag."""
    places, timing = params.places, sample.timing
    constants, lag_slope = estimated_lags(state.mean, params)
    levels = state.level, state.slope, state.level_std
    firing = integrate_thrust(levels, constants, sample.durations_s, sample.commands, timing.edges)
    anything = unknown_directions(state.mean, firing, params)
    burn = replace_untrusted_levels(sample.burn, state.assumed[places.wheels :])
    errors = state.mean[places.engine : places.engine + places.n_engine]
    engines = engine_impulse(burn, errors, firing.duration_s, params.engines)
    if not timing.off or places.n_ticks == 0:
        none = np.zeros_like(state.tick_slope)
        return Drive(firing, lag_slope, sample.outside, timing.spreads, none, none, anything, engines)
    by_ticks, tick_slope = firing.by_level[0] * state.tick_slope, firing.by_level[1] * state.tick_slope
    by_ticks[0] += timing.shares @ firing.by_tick
    by_ticks[1] += (timing.numbers * timing.shares) @ firing.by_tick
    tick_slope[0] += timing.shares @ firing.level_by_tick
    tick_slope[1] += (timing.numbers * timing.shares) @ firing.level_by_tick
    away_s = state.mean[places.ticks : places.ticks + 2] * params.tick_sigma - timing.about_s
    later_s = timing.beyond_s + timing.shares * (away_s[0] + timing.numbers * away_s[1])  # the level is at the estimate
    amount, level = firing.amount + later_s @ firing.by_tick, firing.level + later_s @ firing.level_by_tick
    at_estimate = replace_firing(firing, amount, level)
    return Drive(at_estimate, lag_slope, sample.outside, timing.spreads, by_ticks, tick_slope, anything, engines)


@kernel
def estimated_lags(mean: Array, params: JointParams) -> tuple[Array, Array]:
    """Returns each jet's time constant at the estimate, s, and its logarithm's derivative by lag error."""
    places = params.places
    errors = mean[places.lag : places.lag + places.n_lag]
    return time_constants(params.time_constants_s, params.kinds, params.lag_sigma, errors)


@kernel
def thrust_factors(state: JointState, params: JointParams) -> tuple[Array, Array]:
    """Computes each jet's thrust relative to nominal, and the same less failure forces other than leaks, (n_jets,)."""
    places = params.places
    factor = np.ones(places.jets)
    if places.n_thrust > 0:
        factor = factor + params.thrust_sigma * state.mean[places.thrust : places.thrust + places.n_thrust]
    lagged = factor.copy()
    for slot in range(places.n_force):
        jet = int(state.slot_jet[slot])
        if jet >= 0 and state.slot_on_top[slot] == 0.0:
            lagged[jet] -= state.mean[places.force + slot] / params.thrusts[jet]
    return factor, lagged


@kernel
def wrenches_of(mean: Array, params: JointParams) -> Array:
    """Returns torque about the vehicle origin and force of each jet, mounting as estimated, shape (n_jets, 6)."""
    places = params.places
    return displace_wrenches(params.wrenches, mean[places.mount : places.mount + places.n_mount], params.mounting)


@kernel
def error_rows(state: JointState, forces: Drive, params: JointParams) -> tuple[Array, Array]:
    """Computes derivatives of rate and velocity changes by all errors of the forces in the state, (3, size) each."""
    mean, places, firing = state.mean, params.places, forces.firing
    inverse, reciprocal = take_elements(mean, ELEMENT), mean[MASS]
    rate_rows, velocity_rows = np.zeros((3, places.size)), np.zeros((3, places.size))
    wrenches = wrenches_of(mean, params)
    rate_effect = moments_of(wrenches, mean) @ inverse
    velocity_effect = reciprocal * wrenches[:, 3:]
    _, lagged = thrust_factors(state, params)
    if places.n_thrust > 0:
        columns = slice(places.thrust, places.thrust + places.n_thrust)
        sigma = (params.thrust_sigma * firing.amount).reshape(-1, 1)
        rate_rows[:, columns] = (rate_effect * sigma).T
        velocity_rows[:, columns] = (velocity_effect * sigma).T
        outside = (forces.outside + forces.engines.impulse).reshape(1, 6)
        rate_rows[:, places.scale] = -params.thrust_sigma * (moments_of(outside, mean) @ inverse)[0]
        velocity_rows[:, places.scale] = -params.thrust_sigma * reciprocal * outside[0, 3:]
    if places.n_engine > 0:
        of_known, columns = _known_impulse_scale(mean, params), slice(places.engine, places.engine + places.n_engine)
        rate_rows[:, columns] = of_known * (moments_of(forces.engines.by_errors, mean) @ inverse).T
        velocity_rows[:, columns] = (of_known * reciprocal) * forces.engines.by_errors[:, 3:].T
    if places.n_mount > 0:
        mounting, columns = params.mounting, slice(places.mount, places.mount + places.n_mount)
        impulses = effective_seconds(state, firing, params)[mounting.jets].reshape(-1, 1) * mounting.wrenches
        rate_rows[:, columns] = (moments_of(impulses, mean) @ inverse).T
        velocity_rows[:, columns] = reciprocal * impulses[:, 3:].T
    if places.n_lag > 0:
        weight = firing.amount_slope * forces.lag_slope * lagged
        of_kinds = weight * (np.arange(places.n_lag).reshape(-1, 1) == params.kinds)
        columns = slice(places.lag, places.lag + places.n_lag)
        rate_rows[:, columns] = (of_kinds @ rate_effect).T
        velocity_rows[:, columns] = (of_kinds @ velocity_effect).T
    if places.n_ticks > 0:
        by_ticks = params.tick_sigma.reshape(2, 1) * forces.by_ticks * lagged
        rate_rows[:, places.ticks : places.ticks + 2] = (by_ticks @ rate_effect).T
        velocity_rows[:, places.ticks : places.ticks + 2] = (by_ticks @ velocity_effect).T
    for slot in range(places.n_force):
        jet = int(state.slot_jet[slot])
        if jet >= 0:
            seconds = impulse_per_force(state, slot, firing) / params.thrusts[jet]
            rate_rows[:, places.force + slot] = rate_effect[jet] * seconds
            velocity_rows[:, places.force + slot] = velocity_effect[jet] * seconds
    return rate_rows, velocity_rows


@kernel
def impulse_per_force(state: JointState, slot: int, firing: Firing) -> float:
    """Returns impulse per failure force, s: interval T for a leak, T - L stuck on, -L a loss; L: full-thrust time."""
    amount = float(firing.amount[int(state.slot_jet[slot])])
    if state.slot_on_top[slot] > 0.0:
        return firing.duration_s
    return firing.duration_s - amount if state.slot_sign[slot] > 0.0 else -amount


@kernel
def effective_seconds(state: JointState, firing: Firing, params: JointParams) -> Array:
    """Computes each jet's seconds of full thrust, its thrust error and failure forces included, shape (n_jets,)."""
    factor, _ = thrust_factors(state, params)
    seconds = firing.amount * factor
    for slot in range(params.places.n_force):
        jet = int(state.slot_jet[slot])
        if jet >= 0:
            force = state.mean[params.places.force + slot]
            seconds[jet] += impulse_per_force(state, slot, firing) * force / params.thrusts[jet]
    return seconds


@kernel
def impulse_rows(
    state: JointState, forces: Drive, impulse: tuple[Array, Array], mass_used: float, params: JointParams
) -> tuple[Array, Array]:
    """Computes derivatives, by the state, of the changes of rate and velocity that impulses give, shape (3, size) each.

    Args:
        state: before the interval.
        impulse: linear, and angular about the center of mass, shape (3,) each.
        mass_used: propellant, slug or kg.
    """
    rate_rows, velocity_rows = error_rows(state, forces, params)
    linear, moment = impulse
    rate_rows[:, INERTIA] = angular_block(moment)
    rate_rows[:, CENTER] = take_elements(state.mean, ELEMENT) @ skew(linear)
    velocity_rows[:, MASS] = linear * (1.0 + state.mean[MASS] * mass_used)
    return rate_rows, velocity_rows


@kernel
def _known_impulse_scale(mean: Array, params: JointParams) -> float:
    """Returns 1 - sigma_T s, the factor of engines', wheels' and outside impulses under thrust scale error s."""
    places = params.places
    return 1.0 - params.thrust_sigma * mean[places.scale] if places.n_scale > 0 else 1.0


@kernel
def known_impulse(mean: Array, forces: Drive, speeds: Spun, params: JointParams) -> tuple[Array, Array, float]:
    """Returns impulse of outside forces, engines and wheels, shape (6,); wheel momenta, (2, 3); thrust scale."""
    scale = _known_impulse_scale(mean, params)
    momenta = scale * wheel_momenta(speeds, wheel_factors(mean, params), params.wheels)
    impulse = scale * (forces.outside + forces.engines.impulse)
    impulse[:3] -= momenta[1] - momenta[0]
    return impulse, momenta, scale


@kernel
def wheel_factors(mean: Array, params: JointParams) -> Array:
    """Returns the estimated inertia of each wheel relative to nominal, 1 + sigma p, shape (n_wheels,)."""
    places, factors = params.places, np.ones(params.places.wheels)
    if places.n_wheel > 0:
        factors = factors + params.wheels.sigma * mean[places.wheel : places.wheel + places.n_wheel]
    return factors


@kernel
def add_wheel_errors(rate_rows: Array, mean: Array, wheel_impulses: Array, scale: float, params: JointParams) -> Array:
    """Adds derivatives by errors of wheel inertias and thrust scale to those of the rate's change, (3, size).

    Args:
        wheel_impulses: E_k, shape (n_wheels, 3).
        scale: 1 - sigma_T s.
    """
    if wheel_impulses.shape[0] == 0:
        return rate_rows
    places, result, rate_changes = params.places, rate_rows.copy(), wheel_impulses @ take_elements(mean, ELEMENT)
    if places.n_wheel > 0:
        result[:, places.wheel : places.wheel + places.n_wheel] = (scale * params.wheels.sigma) * rate_changes.T
    if places.n_scale > 0:
        result[:, places.scale] -= params.thrust_sigma * (wheel_factors(mean, params) @ rate_changes)
    return result


@kernel
def thrust_bow_impulses(state: JointState, forces: Drive, params: JointParams) -> Array:
    """Computes the three bow measures (departure from linear growth) of angular impulse about the center of mass."""
    _, lagged = thrust_factors(state, params)
    return moments_of((forces.firing.bow * lagged) @ wrenches_of(state.mean, params), state.mean)
