"""White noise and drifts over an interval: walks, scatter of impulses, ticks, propellant, disturbances."""

from __future__ import annotations

import numpy as np

from massprop_drake.maths.estimation.joint.disturbance_states import (
    DisturbanceParams,
    Wander,
    disturbance_course,
    join_courses,
)
from massprop_drake.maths.estimation.joint.forcing import Drive
from massprop_drake.maths.estimation.joint.lagged_impulses import effects_of
from massprop_drake.maths.estimation.joint.layout import CENTER, MASS, N_PROPERTIES, RATE, JointParams, JointState
from massprop_drake.maths.estimation.joint.rates import intervals_per_period
from massprop_drake.maths.estimation.joint.unknown import reopening_covariance
from massprop_drake.maths.estimation.joint.wheels import Spun, append_reading_errors
from massprop_drake.maths.kernels import kernel
from massprop_drake.maths.linear_algebra import Array

_IDENTITY = np.eye(3)
_PAIRS = ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))


@kernel
def noise_through_turning(noise: Array, wander: Wander, by_end: Array) -> tuple[Array, Wander]:
    """Computes noise on w and c, shape (6, 6), and a disturbance's effects, turning of c included."""
    turned = noise.copy()
    turned[3:] += by_end @ noise[:3]
    turned[:, 3:] += turned[:, :3] @ by_end.T
    drawn = wander.drawn.copy()
    drawn[3:] += by_end @ drawn[:3]
    return turned, Wander(wander.kept, wander.begun, drawn, wander.along, wander.apart)


@kernel
def white_noise(mean: Array, acting: Drive, params: JointParams) -> Array:
    """Computes covariance on w and c of walks, impulse scatter, ticks, and unknown commands, shape (6, 6)."""
    noise, firing = reopening_covariance(acting.anything), acting.firing
    by_chance = (params.repeatability * firing.amount) ** 2
    variance = firing.variance + intervals_per_period(firing.duration_s, params.rates) * by_chance
    if variance.any():
        effects = effects_of(params.wrenches, mean)
        noise += (effects * variance.reshape(-1, 1)).T @ effects
    if acting.spreads.any():
        seconds = firing.by_tick * np.sqrt(acting.spreads).reshape(-1, 1)
        late = effects_of(seconds @ params.wrenches, mean)
        noise += late.T @ late
    if params.places.engines > 0:
        unsteady = effects_of(acting.engines.noise, mean)
        noise += unsteady.T @ unsteady
    noise[:3, :3] += params.rate_walk**2 * firing.duration_s * _IDENTITY
    noise[3:, 3:] += params.velocity_walk**2 * firing.duration_s * _IDENTITY
    return noise


@kernel
def propellant_drift(properties: Array, used: float, tank_fraction: float, arm: float) -> Array:
    """Computes variances that used propellant adds to inertia and center of mass, shape (10,).

    Args:
        properties: the ten parameters, shape (10,) or more.
        used: mass of it, slug or kg.
        tank_fraction, arm: see `JointParams`.
    """
    share = properties[MASS] * used
    if share > 0.0 and tank_fraction > 0.0:
        return _relative_drift(properties, 0.01 * tank_fraction**2 * share, arm)
    return np.zeros(N_PROPERTIES)


@kernel
def combine_disturbances(
    state: JointState, speeds: Spun, inverse: Array, duration_s: float, params: JointParams
) -> Wander:
    """Computes the course of disturbances, stated or not, and of errors of the wheels' readings.

    Args:
        state: before the interval.
        speeds: of the wheels, those that are believed.
        inverse: what an impulse of them turns the vehicle by, shape (3, 3).
        duration_s: of the interval.
    """
    unstated = DisturbanceParams(params.unstated, state.stir_s)
    wander = join_courses(
        disturbance_course(params.disturbance, duration_s), disturbance_course(unstated, duration_s, state.stir)
    )
    return append_reading_errors(wander, speeds, inverse, duration_s * state.mean[RATE], params.wheels)


@kernel
def moving_drift(state: JointState, turned: Array, pushed: Array, duration_s: float, params: JointParams) -> Array:
    """Computes variances that an unstated disturbance adds to the ten parameters while jets fire, shape (10,).

    What moves inside gives back what jets give to it, later: they turn and push the vehicle now more, now less, by the
    share that what is unstated has in what they give. That share comes anew once in its time constant.

    Args:
        turned, pushed: changes of w and c by what acts, shape (3,) each.
        duration_s: of the interval.
    """
    drift = np.zeros(N_PROPERTIES)
    if state.stir == 0.0 or not (turned.any() or pushed.any()):
        return drift
    walked = 2.0 * duration_s / state.stir_s * (state.stir * duration_s) ** 2
    least = duration_s**2 / params.places.jets  # what fires is a jet at the least
    angular, linear = np.sum(params.unstated[:3] ** 2), np.sum(params.unstated[3:] ** 2)
    by_turning = walked * angular / max(np.sum(turned**2), least * angular)
    if linear == 0.0:
        return _relative_drift(state.mean, by_turning, 0.0)
    by_pushing = walked * linear / max(np.sum(pushed**2), least * linear)
    drift = _relative_drift(state.mean, by_turning, np.sqrt(by_pushing / by_turning) * params.arm)
    drift[MASS] = by_pushing * state.mean[MASS] ** 2
    return drift


@kernel
def _relative_drift(properties: Array, each: float, arm: float) -> Array:
    """Computes variances of inertia and center of mass from a relative variance, shape (10,)."""
    drift = np.zeros(N_PROPERTIES)
    for k, (i, j) in enumerate(_PAIRS):
        drift[k] = each * abs(properties[i] * properties[j])
    drift[CENTER] = each * arm**2
    return drift
