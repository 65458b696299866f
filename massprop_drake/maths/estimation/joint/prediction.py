r"""Prediction of the joint state over one interval, exact in its length, and its linearization.

    w   <- w + h + b2 + g          h = J (a + lambda x r)
    c_s <- c_s + lambda mu + beta_s T
    mu  <- mu + mu^2 sum_j m'_j L_j
    psi <- what the rate turns it to, see `orientation`
    z   <- what is left of it, see `disturbance` and `wheels`, whose accelerations w and c_s get besides
    J, r, p: by what is drawn from tanks, see `tanks`
    eta <- what all this drives modes to, see `joint.modes`, which w and c_s feel in turn

with a and lambda the impulses about the vehicle origin of all jets, the sum of W_j L_j (1 + sigma_T b_j) with L_j the
seconds of full thrust of `impulses`, of the forces of failed jets, of engines, and of known outside forces. While mu
falls, c gathers lambda at its mean over the interval.

*Forces of failed jets.* A slot's force f acts for all of T on top of what its jet is told to give (a leak), for the
time that the jet's level leaves, T - L (it is stuck on), or is missing for the time L (it gives less). In the last two
cases the lag of that jet counts for 1 - f/F.

*Second order.* The product of the errors of J and r has the mean b2 (2-118) and the covariance D (2-121). So have
their products with thrust errors: with N_j the effect of an error of the ten parameters under full thrust of jet j, on
w and c, and g_j = sigma_T L_j, their mean is sum g_j N_j P_xb_j, their covariance sum g_j^2 P_bb N_j P_xx N_j^T.

*Dynamic coupling*, exact for a rate that is linear in time from w0 to w1: with l = J^-1 w,

    g = -T J t,    t = w0 x u0 + w1 x u1,    u0 = (2 l0 + l1)/6,    u1 = (l0 + 2 l1)/6.

Thrust that builds up or tails off bows the rate. With dL, dL' and dL" the angular impulses of the bows' mean, first
moment and root mean square (`impulses`), the mean of w w^T over the interval grows by that of the products with the
line and with each other, so

    t += w_mean x dL + J dL x l_mean + (w1 - w0) x dL' + J dL' x (l1 - l0) + J dL" x dL".

The last is exact where all jets that switch are bowed alike, and close to that otherwise. Coupling itself, whose torque
is close to linear in time, bows the rate to a parabola: dL += (w1 x l1 - w0 x l0) T/12, dL" by (6/5)^1/2 of that.
Coupling counts from when the diagonal of J is known to half its size; before, the most that it can be for any body,
|w|^2 T, is noise on w: else what an open-loop drift does would be taken for what J and r are to explain. w1 is the
predicted rate, coupling included, as the reading less its bias corrects it, axis by axis; where that is missing, as it
is: an equation for w1, which is solved to the last digits, for what is left of it has one sign while a vehicle turns
fast, and gathers. The derivatives follow.

*Turning.* An accelerometer at rho from the center of mass gathers O rho besides, of which `measurement` adds what the
rates say. What these are off by stays in it, and the same error of the rate turns every sample the same way: it is no
noise. So the integral of w x (w x rho) is linearized at w0 and w1, for the same rate that is linear in time,

    D0 = T (G(w0)/3 + G(w1)/6),    D1 = T (G(w1)/3 + G(w0)/6),    G(w) = w rho^T + (w . rho) 1 - 2 rho w^T,

c gathers D0 by the error of w0 and D1 by that of the predicted w1, and D1 times what the linearization's w1 lies off
the predicted one. The error of w1 after its reading, of the variance v, times that of r is noise on c, v tr P_rr.

*Wheels* turn the vehicle by what their momentum h changes by, and by what turning h takes, see `wheels`: a has -(h1 -
h0), and in the coupling l = J^-1 w + h, each of them at its end of the interval.

*The common thrust scale* s (`thrust_scale`) is not seen by what jets do, but known outside forces, engines and wheels
are not scaled with them: they enter by 1 - sigma_T s.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from massprop_drake.maths.estimation.filters.rate_increments import angular_block, second_order_terms
from massprop_drake.maths.estimation.joint.burns import Burn, EngineImpulse, idle, push
from massprop_drake.maths.estimation.joint.burns import believed as believed_of_engines
from massprop_drake.maths.estimation.joint.covariance import semidefinite_root
from massprop_drake.maths.estimation.joint.disturbance_states import (
    DisturbanceParams,
    Wander,
    arriving,
    beside,
    come,
    prolonged,
    slowly,
    wandered,
)
from massprop_drake.maths.estimation.joint.lagged_impulses import (
    Firing,
    effects_of,
    fire,
    moments_of,
    regiven,
    time_constants,
)
from massprop_drake.maths.estimation.joint.layout import (
    CENTER,
    INERTIA,
    MASS,
    N_PROPERTIES,
    RATE,
    VELOCITY,
    JointParams,
    JointState,
)
from massprop_drake.maths.estimation.joint.orientation import STILL, turned
from massprop_drake.maths.estimation.joint.rates import shortened
from massprop_drake.maths.estimation.joint.swing import Moved, SwingParams, Swung, swung, unswung
from massprop_drake.maths.estimation.joint.tanks import TankChange, drawn
from massprop_drake.maths.estimation.joint.ticks import Timing
from massprop_drake.maths.estimation.joint.unknown import Directions, directions, indifferent, spread
from massprop_drake.maths.estimation.joint.wheels import UNSPUN, Spun, believed, exchanged, misread
from massprop_drake.maths.estimation.joint.wheels import momenta as of_wheels
from massprop_drake.maths.kernels import idiom, kernel, numbers, picked
from massprop_drake.maths.linear_algebra import (
    Array,
    cross,
    inverse_positive_definite,
    is_positive_definite,
    skew,
    sparse_product,
)
from massprop_drake.maths.mass_properties import ELEMENT
from massprop_drake.maths.vehicle.mounting import displaced

ALONE = (STILL, UNSPUN)
_IDENTITY = np.eye(3)
_FIRST = CENTER.start  # of the coordinates of the center of mass
_PAIRS = ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))
PARABOLA = 1.2**0.5  # root mean square over mean
_SETTLED = 1e-9  # of the rate at the end, that is left of the equation for it: a hundredth of that is in the coupling
_ROUNDS = 4  # each squares what is left, which is a hundredth of the rate where a vehicle turns by a degree a sample
_FIRES = 1e-6  # of an interval: less thrust has no products that count
_TINY = float(np.finfo(np.float64).tiny)
_MOST_LIGHT = 3.0  # times the nominal 1/m: beyond, an estimate is none, and nothing flows


class Drive(NamedTuple):
    """Forces and impulses on the vehicle over an interval.

    Attributes:
        firing: see `lagged_impulses.Firing`.
        lag_slope: derivative of the logarithm of each jet's time constant by the error of its kind, shape (n_jets,).
        outside: impulse of known outside forces, angular about the vehicle origin and linear, shape (6,).
        spreads: see `Timing`.
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


class RateRead(NamedTuple):
    """Rate that gyros show at the end of an interval.

    Attributes:
        rate: weighted mean of the packages, biases taken off, NaN where none reads, rad/s, shape (3,).
        rows: its derivative by the state: by the biases, shape (3, size).
        variance: of its error, (rad/s)^2, shape (3,).
    """

    rate: Array
    rows: Array
    variance: Array


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


class Coupling(NamedTuple):
    """Dynamic coupling over an interval.

    Attributes:
        change: g, rad/s, shape (3,).
        by_inertia: its derivative by J, shape (3, 6).
        by_start, by_end: by w0 and w1, shape (3, 3).
    """

    change: Array
    by_inertia: Array
    by_start: Array
    by_end: Array


@kernel
def drive(
    state: JointState, durations_s: Array, commands: Array, outside: Array, timing: Timing, params: JointParams
) -> Drive:
    """Computes the drive of an interval, with lag and ticks at their present estimates.

    Args:
        state: before.
        durations_s, commands: the interval's pieces, see `lagged_impulses.fire`.
        outside: impulse of known outside forces, shape (6,).
        timing: see `Timing`.
        params: see `JointParams`.
    """
    constants, lag_slope = lag_of(state.mean, params)
    levels = state.level, state.slope, state.level_std
    firing = fire(levels, constants, durations_s, commands, timing.edges)
    anything = directions(state.mean, firing, params)
    if not timing.off or params.places.n_ticks == 0:
        none = np.zeros_like(state.tick_slope)
        return Drive(firing, lag_slope, outside, timing.spreads, none, none, anything, idle())
    by_ticks, tick_slope = firing.by_level[0] * state.tick_slope, firing.by_level[1] * state.tick_slope
    by_ticks[0] += timing.shares @ firing.by_tick
    by_ticks[1] += (timing.numbers * timing.shares) @ firing.by_tick
    tick_slope[0] += timing.shares @ firing.level_by_tick
    tick_slope[1] += (timing.numbers * timing.shares) @ firing.level_by_tick
    begin = params.places.ticks
    away_s = state.mean[begin : begin + 2] * params.tick_sigma - timing.about_s
    later_s = timing.beyond_s + timing.shares * (away_s[0] + timing.numbers * away_s[1])  # the level is at the estimate
    amount, level = firing.amount + later_s @ firing.by_tick, firing.level + later_s @ firing.level_by_tick
    moved = regiven(firing, amount, level)
    return Drive(moved, lag_slope, outside, timing.spreads, by_ticks, tick_slope, anything, idle())


@kernel
def burning(acting: Drive, burn: Burn, state: JointState, params: JointParams) -> Drive:
    """Adds the engines' impulse to a drive, their errors at the present estimates."""
    places = params.places
    if places.engines == 0:
        return acting
    errors = state.mean[places.engine : places.engine + places.n_engine]
    seen = believed_of_engines(burn, state.assumed[places.wheels :])
    return Drive(
        acting.firing,
        acting.lag_slope,
        acting.outside,
        acting.spreads,
        acting.by_ticks,
        acting.tick_slope,
        acting.anything,
        push(seen, errors, acting.firing.duration_s, params.engines),
    )


@kernel
def lag_of(mean: Array, params: JointParams) -> tuple[Array, Array]:
    """Computes each jet's time constant at the present estimate, and its logarithm's derivative by its kind's error."""
    places = params.places
    errors = mean[places.lag : places.lag + places.n_lag]
    return time_constants(params.time_constants_s, params.kinds, params.lag_sigma, errors)


@kernel
def _thrust_factors(state: JointState, params: JointParams) -> tuple[Array, Array]:
    """Computes 1 + sigma_T b of each jet, and the factor of its lag, shape (n_jets,) each."""
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
    """Computes torque about the vehicle origin and force of each jet, mounted as it is estimated, shape (n_jets, 6)."""
    places = params.places
    return displaced(params.wrenches, mean[places.mount : places.mount + places.n_mount], params.mounting)


@kernel
def error_rows(state: JointState, acting: Drive, params: JointParams) -> tuple[Array, Array]:
    """Computes derivatives of the changes of w and c by the parameters: thrust and lag errors, s, ticks, and forces.

    Args:
        state: where they are taken; shape of both results (3, size), zero for the rest of the state.
        acting: see `Drive`.
        params: see `JointParams`.
    """
    mean, places, firing = state.mean, params.places, acting.firing
    inverse, reciprocal = picked(mean, ELEMENT), mean[MASS]
    rate_rows, velocity_rows = np.zeros((3, places.size)), np.zeros((3, places.size))
    wrenches = wrenches_of(mean, params)
    rate_effect = moments_of(wrenches, mean) @ inverse
    velocity_effect = reciprocal * wrenches[:, 3:]
    _, lagged = _thrust_factors(state, params)
    if places.n_thrust > 0:
        columns = slice(places.thrust, places.thrust + places.n_thrust)
        sigma = (params.thrust_sigma * firing.amount).reshape(-1, 1)
        rate_rows[:, columns] = (rate_effect * sigma).T
        velocity_rows[:, columns] = (velocity_effect * sigma).T
        outside = (acting.outside + acting.engines.impulse).reshape(1, 6)
        rate_rows[:, places.scale] = -params.thrust_sigma * (moments_of(outside, mean) @ inverse)[0]
        velocity_rows[:, places.scale] = -params.thrust_sigma * reciprocal * outside[0, 3:]
    if places.n_engine > 0:
        of_known, columns = _scale_of_known(mean, params), slice(places.engine, places.engine + places.n_engine)
        rate_rows[:, columns] = of_known * (moments_of(acting.engines.by_errors, mean) @ inverse).T
        velocity_rows[:, columns] = (of_known * reciprocal) * acting.engines.by_errors[:, 3:].T
    if places.n_mount > 0:
        each, columns = params.mounting, slice(places.mount, places.mount + places.n_mount)
        given = effective_seconds(state, firing, params)[each.jets].reshape(-1, 1) * each.wrenches
        rate_rows[:, columns] = (moments_of(given, mean) @ inverse).T
        velocity_rows[:, columns] = reciprocal * given[:, 3:].T
    if places.n_lag > 0:
        weight = firing.amount_slope * acting.lag_slope * lagged
        of_kinds = weight * (np.arange(places.n_lag).reshape(-1, 1) == params.kinds)
        columns = slice(places.lag, places.lag + places.n_lag)
        rate_rows[:, columns] = (of_kinds @ rate_effect).T
        velocity_rows[:, columns] = (of_kinds @ velocity_effect).T
    if places.n_ticks > 0:
        by_ticks = params.tick_sigma.reshape(2, 1) * acting.by_ticks * lagged
        rate_rows[:, places.ticks : places.ticks + 2] = (by_ticks @ rate_effect).T
        velocity_rows[:, places.ticks : places.ticks + 2] = (by_ticks @ velocity_effect).T
    for slot in range(places.n_force):
        jet = int(state.slot_jet[slot])
        if jet >= 0:
            seconds = _slot_weight(state, slot, firing) / params.thrusts[jet]
            rate_rows[:, places.force + slot] = rate_effect[jet] * seconds
            velocity_rows[:, places.force + slot] = velocity_effect[jet] * seconds
    return rate_rows, velocity_rows


@kernel
def _slot_weight(state: JointState, slot: int, firing: Firing) -> float:
    """Computes the seconds for which a slot's force acts: T or T - L if the jet gives more than commanded, else -L."""
    amount = float(firing.amount[int(state.slot_jet[slot])])
    if state.slot_on_top[slot] > 0.0:
        return firing.duration_s
    return firing.duration_s - amount if state.slot_sign[slot] > 0.0 else -amount


@kernel
def effective_seconds(state: JointState, firing: Firing, params: JointParams) -> Array:
    """Computes seconds of full thrust of each jet with its thrust error and the forces of failures, shape (n_jets,)."""
    factor, _ = _thrust_factors(state, params)
    seconds = firing.amount * factor
    for slot in range(params.places.n_force):
        jet = int(state.slot_jet[slot])
        if jet >= 0:
            force = state.mean[params.places.force + slot]
            seconds[jet] += _slot_weight(state, slot, firing) * force / params.thrusts[jet]
    return seconds


@kernel
def predict(
    state: JointState, acting: Drive, rate_read: RateRead, params: JointParams, around: tuple[Array, Spun] = ALONE
) -> Prediction:
    """Predicts the state over an interval; readings enter only by the rate in the dynamic coupling.

    Args:
        state: before.
        acting: see `Drive`.
        rate_read: rate at the end of the interval as gyros show it.
        params: see `JointParams`.
        around: frames, see `orientation.turned`, and speeds of the wheels.
    """
    mean, places, duration = state.mean, params.places, acting.firing.duration_s
    speeds = believed(around[1], state.assumed[: places.wheels], duration, params.wheels)
    covariance = state.root[:N_PROPERTIES] @ state.root[:N_PROPERTIES].T
    inverse, reciprocal = picked(mean, ELEMENT), mean[MASS]
    seconds = effective_seconds(state, acting.firing, params)
    known, momenta, scale = _known_impulse(mean, acting, speeds, params)
    impulse = seconds @ wrenches_of(mean, params) + known
    linear, moment = impulse[3:], impulse[:3] + cross(impulse[3:], mean[CENTER])
    flow, from_tanks, tank_rows = _from_tanks(state, acting, seconds, params)

    rate_rows, velocity_rows = _impulse_rows(state, acting, (linear, moment), flow, params)
    own = slice(places.slow, places.slow + places.n_slow)
    wander = prolonged(_acting(state, speeds, scale * inverse, duration, params), places.tanks)
    exchange = exchanged(speeds, mean[RATE], mean[RATE] + inverse @ moment, duration, params.wheels)
    rate_rows = _with_wheels(rate_rows, mean, exchange, scale, params)
    rate_rows[:, own], velocity_rows[:, own] = wander.begun[:3], wander.begun[3:]
    rate_rows, velocity_rows = indifferent(rate_rows, velocity_rows, acting.anything)
    bias, noise = _second_order(state, acting, (linear, exchange), covariance, params)
    bias, noise = bias + slowly(wander, mean[own]), noise + _white_noise(mean, acting, params)
    locked = Moved(
        inverse @ moment + bias[:3] + _while_drawn(from_tanks.change, inverse, moment, linear),
        linear * reciprocal * (1.0 + 0.5 * reciprocal * flow) + bias[3:],
        rate_rows,
        velocity_rows,
    )
    moved, modes, noise, wander = _with_modes(state, locked, linear, (noise, wander), (scale, duration), params)
    (change, velocity_change), (rate_rows, velocity_rows) = moved

    end_rows = rate_rows.copy()
    end_rows[:, RATE] += _IDENTITY
    share, left = _share_of_reading(end_rows @ state.root, noise + come(wander), rate_read)
    coupled, through, end, bowed = _coupled(state, acting, change, (rate_read, share), momenta + modes.momenta, params)
    if coupled or places.wheels + places.n_swing > 0:
        rate_rows = _with_coupling(rate_rows, through, rate_read, share)
        change = change + through.change
    if not coupled:
        noise[:3, :3] += largest_coupling(mean[RATE], end, duration) ** 2 * _IDENTITY

    if params.second_order:
        noise[3:, 3:] += left.max() * np.trace(covariance[CENTER, CENTER]) * _IDENTITY
    apart = turned_by(mean[RATE], end, params.accelerometer_positions - mean[CENTER], duration)
    middle = apart.sum(axis=1) / max(places.accelerometers, 1)
    apart -= middle.reshape(2, 1, 3, 3)
    velocity_rows[:, RATE] += middle[0] + middle[1]
    velocity_rows += middle[1] @ rate_rows
    noise, wander = _through_turning(noise, wander, middle[1])
    gap = mean[RATE] + change - end
    velocity_change = velocity_change + middle[1] @ gap

    after = mean.copy()
    after[RATE] += change
    after = _with_gathered(after, velocity_change, (apart[1], gap), duration, params)
    after[own] *= wander.kept
    after[places.swing : places.swing + places.n_swing] = modes.after
    turned_until = turning(mean[RATE], state.reference, state.spin)
    after = _with_used(after, reciprocal * reciprocal * flow, from_tanks.change, turned_until, params)
    after, attitude = _with_attitude(state, after, acting, (around[0], bowed[0], coupled), params)
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
        + _moving_drift(state, inverse @ moment, linear * reciprocal, duration, params),
        tank_rows=tank_rows,
        turned=turned_until,
        spin=spin_integral(mean[RATE], end, bowed, duration),
        end=end,
        duration_s=duration,
        coupled=coupled,
    )


@kernel
def _from_tanks(
    state: JointState, acting: Drive, seconds: Array, params: JointParams
) -> tuple[float, TankChange, Array]:
    """Computes the propellant used, slug or kg, the changes by drawing it from tanks, and their derivatives.

    Args:
        state: before the interval.
        acting: see `Drive`.
        seconds: see `effective_seconds`.
        params: see `JointParams`.

    Returns:
        All of it; see `tanks.TankChange`; and see `Prediction.tank_rows`.
    """
    mean, places, tanks = state.mean, params.places, params.tanks
    n, flows = places.tanks, seconds * params.flows
    flow = float(seconds @ params.flows) + acting.engines.used
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
    found, by = drawn(mean[:N_PROPERTIES], mean[fill], used, scale, tanks), np.zeros((n, places.size))
    flowing = 1.0 if flows.any() else 0.0
    by_jets = (flowing * factors).reshape(n, 1) * by_jets
    if places.n_thrust > 0:
        columns = slice(places.thrust, places.thrust + places.n_thrust)
        by[:, columns] = by_jets * (params.thrust_sigma * acting.firing.amount)
    if places.n_tank > 0:
        for tank in range(n):
            by[tank, places.tank + tank] = tanks.flow_sigma[tank] * known[tank]
    for slot in range(places.n_force):
        jet = int(state.slot_jet[slot])
        if jet >= 0:
            seconds = _slot_weight(state, slot, acting.firing) / params.thrusts[jet]
            by[:, places.force + slot] = by_jets[:, jet] * seconds
    rows = found.by_used @ by
    rows[:, :N_PROPERTIES] += found.by_state[:, :N_PROPERTIES]
    rows[:, fill] += found.by_state[:, N_PROPERTIES:]
    if places.n_scale > 0:
        rows[N_PROPERTIES:, places.scale] -= params.thrust_sigma * used
    return flow + (used.sum() - known.sum()), found, rows


@kernel
def _while_drawn(change: Array, inverse: Array, moment: Array, linear: Array) -> Array:
    """Computes the change of the rate by propellant drawn up to the middle of an interval, rad/s, shape (3,).

    Args:
        change: of the ten parameters by what is drawn, see `tanks.TankChange`; empty: there are no tanks.
        inverse: J before the interval, shape (3, 3).
        moment: angular impulse about the center of mass, shape (3,).
        linear: impulse, shape (3,).
    """
    if change.shape[0] == 0:
        return np.zeros(3)
    return 0.5 * (picked(change, ELEMENT) @ moment + inverse @ cross(linear, change[CENTER]))


@kernel
def _with_used(after: Array, lighter: float, change: Array, turned: Array, params: JointParams) -> Array:
    """Computes the predicted mean once propellant has been used, shape (size,).

    Args:
        after: the mean without that, shape (size,).
        lighter: change of mu by it.
        change: see `tanks.TankChange`.
        turned: see `Prediction`.
        params: see `JointParams`.
    """
    n, places, result = change.shape[0] - N_PROPERTIES, params.places, after.copy()
    result[MASS] += lighter
    if n <= 0:
        return result
    result[:MASS] += change[:MASS]
    result[places.fill : places.fill + n] += change[N_PROPERTIES:]
    for package in range(places.accelerometers):
        result[VELOCITY + 3 * package : VELOCITY + 3 * package + 3] += turned @ change[CENTER]
    return result


@kernel
def _impulse_rows(
    state: JointState, acting: Drive, impulse: tuple[Array, Array], flow: float, params: JointParams
) -> tuple[Array, Array]:
    """Computes derivatives of the changes of w and c by impulses, shape (3, size) each.

    Args:
        state: before the interval.
        acting: see `Drive`.
        impulse: linear, and angular about the center of mass, shape (3,) each.
        flow: mass that is used, slug or kg.
        params: see `JointParams`.
    """
    rate_rows, velocity_rows = error_rows(state, acting, params)
    linear, moment = impulse
    rate_rows[:, INERTIA] = angular_block(moment)
    rate_rows[:, CENTER] = picked(state.mean, ELEMENT) @ skew(linear)
    velocity_rows[:, MASS] = linear * (1.0 + state.mean[MASS] * flow)
    return rate_rows, velocity_rows


@kernel
def _swing_params(params: JointParams) -> SwingParams:
    """Returns the modes, and their places in the state."""
    places = params.places
    scale = places.scale if places.n_scale > 0 else -1
    return SwingParams(params.modes, places.swing, places.moving, places.n_moving, scale, params.thrust_sigma)


@kernel
def _turning_back(state: JointState, duration_s: float) -> Array:
    """Computes the change of the rate by its own coupling, as far as known, as modes feel it, shape (3,)."""
    if not _knows_inertia(state.mean, state.root[:N_PROPERTIES] @ state.root[:N_PROPERTIES].T):
        return np.zeros(3)
    inverse, rate = picked(state.mean, ELEMENT), state.mean[RATE]
    return inverse @ cross(inverse_positive_definite(inverse, "inverse inertia") @ rate, rate) * duration_s


@kernel
def _with_modes(
    state: JointState,
    moved: Moved,
    linear: Array,
    come_in: tuple[Array, Wander],
    about: tuple[float, float],
    params: JointParams,
) -> tuple[tuple[tuple[Array, Array], tuple[Array, Array]], Swung, Array, Wander]:
    """Adds the modes' effects to the changes of w and c, their derivatives, noise and z; also returns the modes.

    Args:
        state: before the interval.
        moved: without modes.
        linear: impulse, shape (3,).
        come_in: noise, shape (6, 6), and course of z.
        about: 1 - sigma_T s, and the interval, s.
        params: see `JointParams`.
    """
    (noise, wander), (scale, duration_s) = come_in, about
    if params.places.n_swing == 0:
        whole = (moved.rate, moved.velocity), (moved.rate_rows, moved.velocity_rows)
        return whole, unswung(0, params.places.size), noise, wander
    turning_back = _turning_back(state, duration_s)
    felt, modes = swung(state.mean, moved, linear, (scale, turning_back), duration_s, _swing_params(params))
    back = modes.given_back
    with_back = Wander(wander.kept, wander.begun, back @ wander.drawn, wander.along, wander.apart)
    whole = (felt.rate, felt.velocity), (felt.rate_rows, felt.velocity_rows)
    return whole, modes, back @ noise @ back.T, with_back


@kernel
def _scale_of_known(mean: Array, params: JointParams) -> float:
    """Computes 1 - sigma_T s, by which known impulses are smaller in the variables of `thrust_scale`."""
    places = params.places
    return 1.0 - params.thrust_sigma * mean[places.scale] if places.n_scale > 0 else 1.0


@kernel
def _known_impulse(mean: Array, acting: Drive, speeds: Spun, params: JointParams) -> tuple[Array, Array, float]:
    """Computes impulse of outside forces, engines, wheels, shape (6,); h at both ends, shape (2, 3); 1 - sigma_T s."""
    scale = _scale_of_known(mean, params)
    momenta = scale * of_wheels(speeds, wheel_factors(mean, params), params.wheels)
    impulse = scale * (acting.outside + acting.engines.impulse)
    impulse[:3] -= momenta[1] - momenta[0]
    return impulse, momenta, scale


@kernel
def _with_gathered(
    after: Array, change: Array, apart: tuple[Array, Array], duration_s: float, params: JointParams
) -> Array:
    """Computes the predicted mean with the accelerometers' velocity gained over the interval, shape (size,).

    Args:
        after: the mean without that, shape (size,).
        change: of all c_s alike, shape (3,).
        apart: derivative of what each gathers besides by w1, shape (n_accelerometers, 3, 3), and what w1 is off by.
        duration_s: of the interval.
        params: see `JointParams`.
    """
    places, result, (by_end, gap) = params.places, after.copy(), apart
    for package in range(places.accelerometers):
        part = slice(VELOCITY + 3 * package, VELOCITY + 3 * package + 3)
        result[part] += change + by_end[package] @ gap
        if places.n_acceleration_bias > 0:
            begin = places.acceleration_bias + 3 * package
            result[part] += duration_s * params.acceleration_bias_sigma * after[begin : begin + 3]
    return result


@kernel
def _with_attitude(
    state: JointState, after: Array, acting: Drive, over: tuple[Array, Array, bool], params: JointParams
) -> tuple[Array, Array]:
    """Computes the predicted mean with its attitude, shape (size,), and derivatives of that, see `Prediction`.

    Args:
        state: before the interval.
        after: the predicted mean but for its attitude, shape (size,).
        acting: see `Drive`.
        over: frames, see `orientation.turned`; mean of what the rate lies off the line, rad/s, if coupling counts; and
            whether it does.
        params: see `JointParams`.
    """
    if params.places.n_attitude == 0:
        return after, np.zeros((2, 0, 3))
    mean, (frames, bow, coupled) = state.mean, over
    if not coupled:
        bow = (_bows_of_thrust(state, acting, params) @ picked(mean, ELEMENT))[0]
    own = slice(params.places.attitude, params.places.attitude + 3)
    rates, result = np.stack((mean[RATE], after[RATE])), after.copy()
    result[own], by_rates = turned(mean[own], frames, rates, bow, acting.firing.duration_s)
    return result, by_rates


@kernel
def _second_order(
    state: JointState, acting: Drive, pulls: tuple[Array, Array], covariance: Array, params: JointParams
) -> tuple[Array, Array]:
    """Computes mean, shape (6,), and covariance, shape (6, 6), on w and c, of the products of errors.

    Args:
        state: before the interval.
        acting: see `Drive`.
        pulls: linear impulse, shape (3,), and E_k of the wheels, shape (n_wheels, 3).
        covariance: of the ten parameters.
        params: see `JointParams`.
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
    return bias, shortened(acting.firing.duration_s, params.rates) * noise


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
def wheel_factors(mean: Array, params: JointParams) -> Array:
    """Computes 1 + sigma p of each wheel's inertia, shape (n_wheels,)."""
    places, factors = params.places, np.ones(params.places.wheels)
    if places.n_wheel > 0:
        factors = factors + params.wheels.sigma * mean[places.wheel : places.wheel + places.n_wheel]
    return factors


@kernel
def _with_wheels(rows: Array, mean: Array, exchange: Array, scale: float, params: JointParams) -> Array:
    """Adds derivatives of the change of w by errors of the wheels' inertias, and of s by the wheels' impulse.

    Args:
        rows: without that, shape (3, size).
        mean: before the interval, shape (size,).
        exchange: E_k, shape (n_wheels, 3).
        scale: 1 - sigma_T s.
        params: see `JointParams`.
    """
    if exchange.shape[0] == 0:
        return rows
    places, result, turns = params.places, rows.copy(), exchange @ picked(mean, ELEMENT)
    if places.n_wheel > 0:
        result[:, places.wheel : places.wheel + places.n_wheel] = (scale * params.wheels.sigma) * turns.T
    if places.n_scale > 0:
        result[:, places.scale] -= params.thrust_sigma * (wheel_factors(mean, params) @ turns)
    return result


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
    return _products(rows, parameter_effects(state.mean, wrenches), state, covariance)


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
    return _products(rows, parameter_effects(state.mean, wrenches), state, covariance)


@kernel
def _bows_of_thrust(state: JointState, acting: Drive, params: JointParams) -> Array:
    """Computes angular impulses of the bows by thrust that builds up or tails off, see the module, shape (3, 3)."""
    _, lagged = _thrust_factors(state, params)
    return moments_of((acting.firing.bow * lagged) @ wrenches_of(state.mean, params), state.mean)


@kernel
def _coupled(
    state: JointState,
    acting: Drive,
    change: Array,
    read: tuple[RateRead, Array],
    momenta: Array,
    params: JointParams,
) -> tuple[bool, Coupling, Array, Array]:
    """Computes dynamic coupling with the rate as a reading corrects it, by its share; that rate; and its bows.

    Before all these, whether coupling counts: where it does not, only that by the wheels' momentum is in it.

    Args:
        state: before the interval.
        acting: see `Drive`.
        change: of the rate without coupling, rad/s, shape (3,).
        read: see `RateRead`, and its share, shape (3,).
        momenta: h at the start and the end, shape (2, 3).
        params: see `JointParams`.
    """
    mean, duration = state.mean, acting.firing.duration_s
    inverse, start, none = picked(mean, ELEMENT), mean[RATE], np.zeros((3, 3))
    counts = _knows_inertia(mean, state.root[:N_PROPERTIES] @ state.root[:N_PROPERTIES].T)
    if not (counts or params.places.wheels + params.places.n_swing > 0):
        return (
            False,
            Coupling(none[0], np.zeros((3, 6)), none, none),
            _corrected(start + change, read[0], read[1]),
            none,
        )
    inertias = inverse, inverse_positive_definite(inverse, "inverse inertia") if counts else none
    turning = inertias[1], momenta
    of_thrust = _bows_of_thrust(state, acting, params)
    line = start + change
    end = _corrected(line, read[0], read[1])
    bows = of_thrust + bows_of_coupling(turning, start, end, duration)
    found = coupling(inertias, (start, end), momenta, bows, duration)
    for _ in range(_ROUNDS):  # by Newton's method: the rate at the end has the coupling in it
        off = _corrected(line + found.change, read[0], read[1]) - end
        if np.abs(off).max() <= _SETTLED * np.abs(end).max():
            break
        end = end + np.linalg.solve(_IDENTITY - (1.0 - read[1]).reshape(3, 1) * found.by_end, off)
        bows = of_thrust + bows_of_coupling(turning, start, end, duration)
        found = coupling(inertias, (start, end), momenta, bows, duration)
    return counts, found, end, bows @ inverse


@kernel
def _with_coupling(rate_rows: Array, through: Coupling, read: RateRead, share: Array) -> Array:
    """Computes the derivative of the change of w with that by coupling, of which w1 is part and on which it depends."""
    rows, own = rate_rows.copy(), (1.0 - share).reshape(3, 1)
    rows[:, RATE] += through.by_start
    rows[:, INERTIA] += through.by_inertia
    end_rows = own * rows + share.reshape(3, 1) * read.rows
    end_rows[:, RATE] += own * _IDENTITY
    return rows + through.by_end @ np.linalg.solve(_IDENTITY - own * through.by_end, end_rows)


@kernel
def _share_of_reading(half: Array, noise: Array, read: RateRead) -> tuple[Array, Array]:
    """Computes the share by which a reading corrects the predicted rate, and the remaining variance, shape (3,) each.

    Args:
        half: root of the covariance of the predicted rate but for the noise, shape (3, k).
        noise: of the interval, shape (6, 6).
        read: see `RateRead`.
    """
    share, left = np.zeros(3), np.empty(3)
    for axis in range(3):
        variance = half[axis] @ half[axis] + noise[axis, axis]
        if not np.isnan(read.rate[axis]):
            total = variance + read.variance[axis]
            share[axis] = variance / total if total > 0.0 else 1.0
        left[axis] = (1.0 - share[axis]) * variance
    return share, left


@kernel
def _corrected(rate: Array, read: RateRead, share: Array) -> Array:
    """Computes the rate as a reading corrects it."""
    result = rate.copy()
    for axis in range(3):
        if share[axis] > 0.0:
            result[axis] += share[axis] * (read.rate[axis] - rate[axis])
    return result


@kernel
def turned_by(start: Array, end: Array, arms: Array, duration_s: float) -> Array:
    """Computes D0 and D1 of each arm, shape (2, n, 3, 3).

    Args:
        start, end: w0 and w1, rad/s, shape (3,).
        arms: ft or m, shape (n, 3).
        duration_s: of the interval.
    """
    n, rates = arms.shape[0], np.empty((2, 3))  # G is linear in the rate
    rates[0] = (duration_s / 6.0) * (2.0 * start + end)
    rates[1] = (duration_s / 6.0) * (start + 2.0 * end)
    turned = rates.reshape(2, 1, 3, 1) * arms.reshape(1, n, 1, 3)
    turned -= 2.0 * rates.reshape(2, 1, 1, 3) * arms.reshape(1, n, 3, 1)
    turned += (rates @ arms.T).reshape(2, n, 1, 1) * _IDENTITY
    return turned


@kernel
def _through_turning(noise: Array, wander: Wander, by_end: Array) -> tuple[Array, Wander]:
    """Computes noise on w and c, shape (6, 6), and a disturbance's effects, turning of c included."""
    turned = noise.copy()
    turned[3:] += by_end @ noise[:3]
    turned[:, 3:] += turned[:, :3] @ by_end.T
    drawn = wander.drawn.copy()
    drawn[3:] += by_end @ drawn[:3]
    return turned, Wander(wander.kept, wander.begun, drawn, wander.along, wander.apart)


@kernel
def gathered_rows(prediction: Prediction, package: int) -> Array:
    """Computes the derivative of the change of a package's c_s by the state, without its biases, shape (3, size)."""
    by_start, by_end = prediction.apart[0, package], prediction.apart[1, package]
    rows = prediction.velocity_rows + by_end @ prediction.rate_rows
    rows[:, RATE] += by_start + by_end
    return rows


@kernel
def bows_of_coupling(turning: tuple[Array, Array], start: Array, end: Array, duration_s: float) -> Array:
    """Computes angular impulses of the bow of the rate by coupling itself: mean, first moment, root mean square.

    Args:
        turning: inertia about the center of mass, shape (3, 3), and h at the start and the end, shape (2, 3).
        start, end: w0 and w1, rad/s, shape (3,).
        duration_s: T.
    """
    bows, (inertia, momenta) = np.zeros((3, 3)), turning
    at_start, at_end = inertia @ start + momenta[0], inertia @ end + momenta[1]
    bows[0] = (cross(end, at_end) - cross(start, at_start)) * (duration_s / 12.0)
    bows[2] = PARABOLA * bows[0]
    return bows


@kernel
def coupling(
    inertias: tuple[Array, Array], rates: tuple[Array, Array], momenta: Array, bows: Array, duration_s: float
) -> Coupling:
    """Computes the change g of the rate by dynamic coupling, and its derivatives; those of the bows are left out.

    Args:
        inertias: J and its inverse, shape (3, 3) each; zero in its place: h alone is turned.
        rates: w0 and w1, rad/s, shape (3,) each.
        momenta: h at the start and the end, shape (2, 3).
        bows: dL, dL' and dL", angular impulses about the center of mass, shape (3, 3).
        duration_s: T.
    """
    (inverse, inertia), (start, end) = inertias, rates
    own = inertia @ ((2.0 * start + end) / 6.0), inertia @ ((start + 2.0 * end) / 6.0)
    at_start, at_end = inertia @ start + momenta[0], inertia @ end + momenta[1]
    first, second = (2.0 * at_start + at_end) / 6.0, (at_start + 2.0 * at_end) / 6.0
    turn = cross(start, first) + cross(end, second)
    over_start, over_end = skew(start) @ inertia, skew(end) @ inertia
    by_inertia = angular_block(turn) - inverse @ (over_start @ angular_block(own[0]) + over_end @ angular_block(own[1]))
    by_start = inverse @ (over_start / 3.0 + over_end / 6.0 - skew(first))
    by_end = inverse @ (over_start / 6.0 + over_end / 3.0 - skew(second))
    bowed = bows @ inverse
    bent = cross(0.5 * (start + end), bows[0]) + cross(bowed[0], 0.5 * (at_start + at_end))
    bent += cross(end - start, bows[1]) + cross(bowed[1], at_end - at_start) + cross(bowed[2], bows[2])
    through = inverse @ (turn + bent) * -duration_s
    return Coupling(through, -duration_s * by_inertia, -duration_s * by_start, -duration_s * by_end)


@kernel
def largest_coupling(start: Array, end: Array, duration_s: float) -> float:
    """Bounds the change of the rate by dynamic coupling, whatever the inertia: |w|^2 T.

    No principal moment of a body exceeds the sum of the other two, so |J (w x J^-1 w)| <= |w|^2.

    Args:
        start, end: rates, rad/s, shape (3,).
        duration_s: of the interval.
    """
    return max(float(start @ start), float(end @ end)) * duration_s


@kernel
def spin_integral(start: Array, end: Array, bowed: Array, duration_s: float) -> Array:
    """Computes the integral of w w^T dt of a rate that is linear but for a bow, six elements, rad^2/s, shape (6,).

    Args:
        start, end: rates, rad/s, shape (3,).
        bowed: what the rate lies off the line, by mean, first moment and root mean square, rad/s, shape (3, 3).
        duration_s: of the interval.
    """
    result, middle, gained = np.empty(6), 0.5 * (start + end), end - start
    for k, (i, j) in enumerate(_PAIRS):
        straight = (start[i] * start[j] + end[i] * end[j]) / 3.0 + (start[i] * end[j] + end[i] * start[j]) / 6.0
        bent = middle[i] * bowed[0, j] + middle[j] * bowed[0, i] + bowed[2, i] * bowed[2, j]
        bent += gained[i] * bowed[1, j] + gained[j] * bowed[1, i]
        result[k] = duration_s * (straight + bent)
    return result


@kernel
def turning(rate: Array, reference: Array, spin: Array) -> Array:
    """Computes O = [(w - w_ref) x] + C, shape (3, 3).

    Args:
        rate, reference: w and w_ref, rad/s, shape (3,).
        spin: integral of w w^T dt since the last rebase, six elements, shape (6,).
    """
    xx, yy, zz, yz, xz, xy = numbers(spin, 6)
    centripetal = np.array([[-(yy + zz), xy, xz], [xy, -(xx + zz), yz], [xz, yz, -(xx + yy)]])
    return skew(rate - reference) + centripetal


@kernel
def propagated(root: Array, prediction: Prediction, params: JointParams) -> Array:
    """Propagates the covariance's root over the interval, with its noise as more columns, not compressed."""
    places = params.places
    after = root.copy()
    moved = sparse_product(np.vstack((prediction.rate_rows, prediction.velocity_rows)), root)
    after[RATE] += moved[:3]
    common = moved[3:]
    noise = semidefinite_root(prediction.noise)
    drifting = np.flatnonzero(prediction.drift > 0.0)
    slow, come_in = slice(places.slow, places.slow + places.n_slow), arriving(prediction.wander)
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


@kernel
def _knows_inertia(mean: Array, covariance: Array) -> bool:
    """Tests whether J is positive definite and its diagonal known to half its size."""
    for i in range(3):
        if not np.sqrt(covariance[i, i]) < 0.5 * mean[i]:
            return False
    return is_positive_definite(picked(mean, ELEMENT))


@kernel
def _thrust_products(state: JointState, acting: Drive, covariance: Array, params: JointParams) -> tuple[Array, Array]:
    """Computes mean, shape (6,), and covariance, shape (6, 6), of thrust errors times errors of the ten parameters."""
    mean, places = state.mean, params.places
    jets = np.flatnonzero(np.abs(acting.firing.amount) > _FIRES * acting.firing.duration_s)
    shares = params.thrust_sigma * acting.firing.amount[jets]
    effects = parameter_effects(mean, params.wrenches[jets]) * shares.reshape(-1, 1)
    return _products(state.root[places.thrust + jets], effects, state, covariance)


@kernel
def _mounting_products(state: JointState, acting: Drive, covariance: Array, params: JointParams) -> tuple[Array, Array]:
    """Computes mean, shape (6,), and covariance, shape (6, 6), of mounting errors times those of the parameters."""
    seconds = acting.firing.amount[params.mounting.jets]
    there = np.flatnonzero(np.abs(seconds) > _FIRES * acting.firing.duration_s)
    effects = parameter_effects(state.mean, params.mounting.wrenches[there]) * seconds[there].reshape(-1, 1)
    return _products(state.root[params.places.mount + there], effects, state, covariance)


@kernel
def _force_products(state: JointState, firing: Firing, covariance: Array, params: JointParams) -> tuple[Array, Array]:
    """Computes mean, shape (6,), and covariance, shape (6, 6), of failure force errors times those of the parameters.

    A jet that has just failed may give anything: what it does to the rates is then as uncertain as what every jet does.
    """
    slots = np.flatnonzero(state.slot_jet >= 0)
    jets = state.slot_jet[slots].astype(np.intp)
    seconds = np.array([_slot_weight(state, int(slot), firing) for slot in slots]) / params.thrusts[jets]
    effects = parameter_effects(state.mean, params.wrenches[jets]) * seconds.reshape(-1, 1)
    return _products(state.root[params.places.force + slots], effects, state, covariance)


@kernel
def _products(rows: Array, effects: Array, state: JointState, covariance: Array) -> tuple[Array, Array]:
    """Computes mean, shape (6,), and covariance, shape (6, 6), of jet impulse errors times those of the parameters.

    Args:
        rows: of the covariance's root, of what each jet gives, shape (n, size).
        effects: of errors of the parameters under a unit of that, shape (6, n, 10).
        state: before the interval.
        covariance: of the ten parameters.
    """
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
    inverse = picked(mean, ELEMENT)
    moments, forces = moments_of(wrenches, mean), wrenches[:, 3:]
    effects = np.zeros((6, wrenches.shape[0], N_PROPERTIES))
    for row in range(3):
        for column in range(3):
            effects[row, :, ELEMENT[row, column]] = moments[:, column]  # of J m
        effects[row, :, CENTER] = forces @ skew(inverse[row]).T  # of J [F x]
        effects[3 + row, :, MASS] = forces[:, row]
    return effects


@kernel
def _white_noise(mean: Array, acting: Drive, params: JointParams) -> Array:
    """Computes covariance on w and c of walks, impulse scatter, ticks, and unknown commands, shape (6, 6)."""
    noise, firing = spread(acting.anything), acting.firing
    by_chance = (params.repeatability * firing.amount) ** 2
    variance = firing.variance + shortened(firing.duration_s, params.rates) * by_chance
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
def _acting(state: JointState, speeds: Spun, inverse: Array, duration_s: float, params: JointParams) -> Wander:
    """Computes the course of disturbances, stated or not, and of errors of the wheels' readings.

    Args:
        state: before the interval.
        speeds: of the wheels, those that are believed.
        inverse: what an impulse of them turns the vehicle by, shape (3, 3).
        duration_s: of the interval.
        params: see `JointParams`.
    """
    unstated = DisturbanceParams(params.unstated, state.stir_s)
    wander = beside(wandered(params.disturbance, duration_s), wandered(unstated, duration_s, state.stir))
    return misread(wander, speeds, inverse, duration_s * state.mean[RATE], params.wheels)


@kernel
def _moving_drift(state: JointState, turned: Array, pushed: Array, duration_s: float, params: JointParams) -> Array:
    """Computes variances that an unstated disturbance adds to the ten parameters while jets fire, shape (10,).

    What moves inside gives back what jets give to it, later: they turn and push the vehicle now more, now less, by the
    share that what is unstated has in what they give. That share comes anew once in its time constant.

    Args:
        state: see `JointState`.
        turned, pushed: changes of w and c by what acts, shape (3,) each.
        duration_s: of the interval.
        params: see `JointParams`.
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
