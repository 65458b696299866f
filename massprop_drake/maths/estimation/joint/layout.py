r"""Layout of the joint estimator's state and parameters, and of a state as one flat vector.

The mean and the rows of the covariance's root are in this order,

    J (6: xx, yy, zz, yz, xz, xy) | r (3) | mu | w (3) | c_s (3 per accelerometer) | psi (3, with a tracker)
    | z (per component of a disturbance, and per wheel) | p (propellant per tank) | eta, eta' (per mode)
    b (thrust error per jet) | lag error per kind | gyro bias (3 per package)
    | accelerometer bias (3 per package) | p (inertia error per wheel) | errors of the engines (6 per engine)
    | e (flow error per tank) | errors of the jets' mounting (up to 4 per jet, see `maths.vehicle.mounting`)
    | errors of participation, frequency, damping and position (6 per part that moves) | s
    | theta (2, of the ticks)
    | f (force of each slot of failed jets)

with J the inverse inertia about the center of mass, r the center of mass in the vehicle frame, mu = 1/m, w the rate,
c_s the integral of F/m as accelerometer s has gathered it, psi the attitude as `orientation` has it, z as
`disturbance_states` and `wheels` have it, propellant in slug or kg, see `tanks`, and eta as `joint.modes` has it. What
stands from b on are parameters in units of their sigmas, of about unit prior variance, but for f, in lbf or N, and the
engines' errors, see `burns`, which are unscaled. A kind of parameter whose sigma is zero has no place.

Nothing is scaled: the covariance is kept as a root that is made triangular by Householder reflections, and these treat
every row of the root by its own size, so that a change of units changes no digit.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from massprop_drake.maths.arrays import FLAG, NUMBER, Layout
from massprop_drake.maths.estimation.joint.disturbance_states import NO_DISTURBANCE, DisturbanceParams
from massprop_drake.maths.estimation.joint.modes import ERRORS, NO_MODES, ModeParams
from massprop_drake.maths.estimation.joint.tanks import NO_TANKS, TankParams
from massprop_drake.maths.estimation.joint.wheels import NO_WHEELS, WheelParams
from massprop_drake.maths.kernels import kernel
from massprop_drake.maths.linear_algebra import Array
from massprop_drake.maths.vehicle.engine_thrust import N_CHANNELS, N_ERRORS, NO_ENGINES, EngineParams
from massprop_drake.maths.vehicle.mounting import EXACT, Mounting

N_PROPERTIES = 10
INERTIA, CENTER, MASS, RATE, VELOCITY = slice(0, 6), slice(6, 9), 9, slice(10, 13), 13


class Places(NamedTuple):
    """Places of the parts of the state, and their sizes.

    Attributes:
        jets, gyros, accelerometers, trackers, wheels, engines, tanks: how many there are.
        outputs: components that are read.
        attitude, n_attitude: of psi; three elements, or none without a tracker.
        slow, n_slow: of z, first those of a disturbance that is stated, then of one that is not, of the wheels, and of
            the tanks' propellant.
        unstated, n_unstated: of the second of these.
        fill: of that propellant; one element per tank.
        swing, n_swing: of eta of all modes, then of eta'.
        thrust, n_thrust: of b; none or one per jet.
        lag, n_lag: of the lag's errors; none or one per kind of jet.
        gyro_bias, n_gyro_bias: none or three per package.
        acceleration_bias, n_acceleration_bias: none or three per package.
        wheel, n_wheel: of p; none or one per wheel.
        engine, n_engine: of the engines' errors, six of each.
        tank, n_tank: of e; none or one per tank.
        mount, n_mount: of the errors of the jets' mounting.
        moving, n_moving: of the errors of parts that move; none or six per part.
        scale, n_scale: of s; one if b has places, else none.
        ticks, n_ticks: of offset and period error of the ticks, see `ticks`; two, or none: stamps are ticks.
        force, n_force: of the slots of failed jets.
        size: of all of it.
    """

    jets: int
    gyros: int
    accelerometers: int
    trackers: int
    wheels: int
    engines: int
    tanks: int
    outputs: int
    attitude: int
    n_attitude: int
    slow: int
    n_slow: int
    unstated: int
    n_unstated: int
    fill: int
    swing: int
    n_swing: int
    thrust: int
    n_thrust: int
    lag: int
    n_lag: int
    gyro_bias: int
    n_gyro_bias: int
    acceleration_bias: int
    n_acceleration_bias: int
    wheel: int
    n_wheel: int
    engine: int
    n_engine: int
    tank: int
    n_tank: int
    mount: int
    n_mount: int
    moving: int
    n_moving: int
    scale: int
    n_scale: int
    ticks: int
    n_ticks: int
    force: int
    n_force: int
    size: int


class PartCounts(NamedTuple):
    """Numbers of the things that the state has parts for.

    Attributes:
        jets, gyros, accelerometers, trackers: jets, and packages of sensors.
        components: of a disturbance that is stated.
        wheels, engines, tanks: of each.
        unstated: components of a disturbance that nobody states.
        mounts: errors of the jets' mounting.
        modes: of all parts that move.
        parts: those of them whose errors are estimated.
    """

    jets: int
    gyros: int
    accelerometers: int
    trackers: int = 0
    components: int = 0
    wheels: int = 0
    engines: int = 0
    tanks: int = 0
    unstated: int = 0
    mounts: int = 0
    modes: int = 0
    parts: int = 0


def make_places(
    part_counts: tuple[int, ...],
    n_lag: int,
    uncertain: tuple[bool, ...],
    uncertain_thrust: bool,
    n_force: int,
    ticks: int = 0,
) -> Places:
    """Returns the index and size of each quantity in a vehicle's filter state.

    Args:
        part_counts: see `PartCounts`; those left out at the end are zero.
        n_lag: number of kinds of jets whose lag is estimated; 0: none.
        uncertain: whether the gyros and whether the accelerometers have biases to estimate, and whether the wheels'
            inertias and the tanks' flows are uncertain.
        n_force: number of slots for the forces of failed jets.
        ticks: 2 if ticks are estimated, else 0.
    """
    n = PartCounts(*part_counts)
    of_gyros, of_accelerometers, of_wheels, of_tanks = (*uncertain, False, False)[:4]
    sizes = (
        n.jets if uncertain_thrust else 0,
        n_lag,
        3 * n.gyros if of_gyros else 0,
        3 * n.accelerometers if of_accelerometers else 0,
        n.wheels if of_wheels else 0,
        N_ERRORS * n.engines,
        n.tanks if of_tanks else 0,
        n.mounts,
        ERRORS * n.parts,
        1 if uncertain_thrust else 0,
        ticks,
        n_force,
    )
    attitude, n_attitude = VELOCITY + 3 * n.accelerometers, 3 if n.trackers else 0
    slow, n_slow = attitude + n_attitude, n.components + n.unstated + n.wheels + n.tanks
    swing, n_swing = slow + n_slow, 2 * n.modes
    *begins, size = np.cumsum([swing + n_swing, *sizes]).tolist()
    parameters = (number for part in zip(begins, sizes, strict=True) for number in part)
    return Places(
        *(n.jets, n.gyros, n.accelerometers, n.trackers, n.wheels, n.engines, n.tanks),
        3 * (n.gyros + n.accelerometers + n.trackers),
        *(attitude, n_attitude, slow, n_slow, slow + n.components, n.unstated),
        slow + n.components + n.unstated + n.wheels,
        *(swing, n_swing, *parameters, size),
    )


class AttitudeSensors(NamedTuple):
    """Sensors of attitude.

    Attributes:
        variances: of one reading about each axis, rad^2, shape (n_trackers,).
        stamp_variances: of the stamps of these readings, s^2, shape (n_trackers,).
        outliers: share of readings that are poor, shape (n_trackers,).
    """

    variances: Array
    stamp_variances: Array
    outliers: Array


class Rates(NamedTuple):
    """Steps of the filter: one a control period, or one at every time at which anything is read.

    What is laid out for a control period T keeps its meaning in seconds: theory page of the joint filter, "Steps from
    reading to reading".

    Attributes:
        period_s: T where steps are taken as readings come; 0: a step is taken every period.
        steps: steps in a control period, rounded up: by so many memories are longer that count steps.
    """

    period_s: float
    steps: int


EVERY_PERIOD = Rates(0.0, 1)


@kernel
def intervals_per_period(duration_s: float, rates: Rates) -> float:
    """Returns the number of filter steps in a control period, from the interval's length; 1 if one a period."""
    return max(rates.period_s / duration_s, 1.0) if rates.period_s > 0.0 else 1.0


class JointParams(NamedTuple):
    """Parameters of the joint estimator.

    Attributes:
        places: see `Places`.
        wrenches: torque about the vehicle origin and force of each jet at full thrust, shape (n_jets, 6).
        thrusts: magnitudes of these forces, lbf or N, shape (n_jets,).
        flows: propellant flow of each jet at full thrust, slug/s or kg/s, shape (n_jets,).
        time_constants_s: nominal time constant of each jet's lag, zero: none, shape (n_jets,).
        kinds: index of each jet's kind among the lags' errors, integers, shape (n_jets,).
        thrust_sigma: what one unit of a thrust error is, relative.
        lag_sigma: of the error of a kind's time constant, relative.
        gyro_bias_sigma, acceleration_bias_sigma: of the biases, rad/s and ft/s^2 or m/s^2.
        prior_sigma: 1-sigma of what stands from `Places.thrust` on, in these units: 1 but where jets, kinds or
            packages differ; zero for s, theta and f, shape (size - thrust,).
        rate_walk, velocity_walk: 1-sigma of what is added to w and to c in one second, rad/s and ft/s or m/s,
            growing with the root of time.
        repeatability: 1-sigma of each jet's impulse over a sample, relative, white, shape (n_jets,).
        tank_fraction: share of the vehicle's size by which propellant from no tank shifts inertia and center of mass.
        tick_sigma: of offset and period error of the ticks, s, shape (2,).
        arm: size of the vehicle, ft or m: the jets' RMS distance from the center of mass.
        accelerometer_positions: vehicle frame, ft or m, shape (n_accelerometers, 3).
        variances: of one reading of each component, gyros first, trackers last, shape (n_outputs,).
        quanta: step of each component's reading, zero where it dithers itself (see `measurement`), shape (n_outputs,).
        cells: quantum of each component, zero: not quantized, shape (n_outputs,).
        floors: variance of each prediction beyond the state's, see `quantized`, shape (n_outputs,).
        dithered: 1 where each sample is news, 0 where a change of the reading is, shape (n_outputs,).
        trackers: see `AttitudeSensors`.
        disturbance: see `DisturbanceParams`.
        unstated: see `disturbance_states.unstated_unit_effects`, shape (6, n_unstated).
        start: the ten parameters at the start, shape (10,).
        start_root: lower triangular root of their covariance at the start, shape (10, 10).
        increment_sigma: what an increment adds to their 1-sigma, in quadrature, shape (10,).
        nominal: the ten parameters of the nominal vehicle, shape (10,).
        thresholds: NIS above which the covariance is incremented, by the number of components used less one.
        guard_relative: largest sigma over estimate of J_xx, J_yy, J_zz and mu; infinity: not judged, shape (4,).
        guard_center: largest sigma of the center of mass, infinity: not judged, ft or m, shape (3,).
        settled_after: control periods with a jet commanded, from the guard on, until settled.
        second_order: whether b2 (2-118), D (2-121) and the products with thrust errors are taken into account.
        wheels: see `WheelParams`.
        engines: see `EngineParams`.
        rates: see `Rates`.
        tanks: see `TankParams`.
        mounting: see `Mounting`.
        modes: see `ModeParams`.
        compiled: see `whole_joint.Work`; None: nothing is. All but the thresholds is then as when it was compiled.
    """

    places: Places
    wrenches: Array
    thrusts: Array
    flows: Array
    time_constants_s: Array
    kinds: np.ndarray
    thrust_sigma: float
    lag_sigma: float
    gyro_bias_sigma: float
    acceleration_bias_sigma: float
    prior_sigma: Array
    rate_walk: float
    velocity_walk: float
    repeatability: Array
    tank_fraction: float
    tick_sigma: Array
    arm: float
    accelerometer_positions: Array
    variances: Array
    quanta: Array
    cells: Array
    floors: Array
    dithered: Array
    trackers: AttitudeSensors
    disturbance: DisturbanceParams
    start: Array
    start_root: Array
    increment_sigma: Array
    nominal: Array
    thresholds: Array
    guard_relative: Array
    guard_center: Array
    settled_after: float
    second_order: bool
    wheels: WheelParams = NO_WHEELS
    engines: EngineParams = NO_ENGINES
    rates: Rates = EVERY_PERIOD
    tanks: TankParams = NO_TANKS
    unstated: Array = NO_DISTURBANCE.accelerations
    mounting: Mounting = EXACT
    modes: ModeParams = NO_MODES
    compiled: Any = None


def thrust_sigmas(params: JointParams) -> Array:
    """Returns the stated 1-sigma of each jet's thrust, relative, zero where it is exact, shape (n_jets,)."""
    places = params.places
    if places.n_thrust == 0:
        return np.zeros(places.jets)
    return params.thrust_sigma * params.prior_sigma[: places.n_thrust]


class JointState(NamedTuple):
    """All that the joint estimator knows after a sample. Never changed; a cycle makes a new one.

    Attributes:
        mean: the state's estimate, shape (size,).
        root: with root root^T the covariance of the estimate's error; lower triangular if rows from `Places.thrust` on
            are put before the others, shape (size, size).
        level: thrust level of each jet at the end of the interval, shape (n_jets,).
        slope: its derivative by the logarithm of its time constant, shape (n_jets,).
        tick_slope: by offset and period error of the ticks, 1/s, shape (2, n_jets).
        level_std: 1-sigma of each level since its command was not known, shape (n_jets,).
        spin: integral of w w^T dt since the last rebase as xx, yy, zz, yz, xz, xy, rad^2/s, shape (6,).
        reference: rate at the last rebase, rad/s, shape (3,).
        read: last reading of each component, shape (n_outputs,).
        fresh: 1 where that is of the last sample and has not been taken in, shape (n_outputs,).
        slot_jet: index of the jet in each slot of a failure force, -1: empty, shape (n_force,).
        slot_sign: 1: the jet gives more than it is told to, -1: less, shape (n_force,).
        slot_on_top: of a jet that gives more, 1: on top of what it is told to, as a leak; 0: only where it is not told
            to, as a jet that is stuck on, shape (n_force,).
        time_s: of the last sample.
        started: whether a sample has been taken.
        guarded: whether the convergence guard holds.
        firing_count: control periods with a jet commanded since the guard holds.
        lag_open: 1 for each kind of jets whose lag has the wide prior, see `lag_prior`; 0: as stated, shape (n_lag,).
        assumed: speed of each wheel whose readings are not believed, rad/s, then level and angles of each engine whose
            are not, rad, NaN: they are, shape (n_wheels + 3 n_engines,).
        stir, stir_s: level and time constant, s, of what acts that nobody stated, see `disturbance_states`; a level of
            zero: nothing does.
    """

    mean: Array
    root: Array
    level: Array
    slope: Array
    tick_slope: Array
    level_std: Array
    spin: Array
    reference: Array
    read: Array
    fresh: Array
    slot_jet: Array
    slot_sign: Array
    slot_on_top: Array
    time_s: float
    started: bool
    guarded: bool
    firing_count: float
    lag_open: Array
    assumed: Array
    stir: float
    stir_s: float


_STATE = Layout(
    "joint_state",
    mean="size",
    root=("size", "size"),
    level="jets",
    slope="jets",
    tick_slope=(2, "jets"),
    level_std="jets",
    spin=6,
    reference=3,
    read="outputs",
    fresh="outputs",
    slot_jet="forces",
    slot_sign="forces",
    slot_on_top="forces",
    time_s=NUMBER,
    started=FLAG,
    guarded=FLAG,
    firing_count=NUMBER,
    lag_open="lags",
    assumed="assumed",
    stir=NUMBER,
    stir_s=NUMBER,
)


def n_assumed(places: Places) -> int:
    """Returns the number of wheel speeds, engine levels and gimbal angles whose readings may be distrusted."""
    return places.wheels + N_CHANNELS * places.engines


def state_layout(places: Places) -> Layout:
    """Returns the layout of a filter state packed into one flat vector: field names and shapes."""
    counts = {"jets": places.jets, "outputs": places.outputs, "assumed": n_assumed(places)}
    return _STATE.sized(size=places.size, forces=places.n_force, lags=places.n_lag, **counts)


def pack(state: JointState, places: Places) -> Array:
    """Packs a filter state into one flat vector, as a Drake diagram holds it."""
    return state_layout(places).pack(state)


def unpack(vector: Array, places: Places) -> JointState:
    """Unpacks a filter state from a flat vector, the inverse of `pack`; its arrays are views of that."""
    return JointState(*state_layout(places).read(vector))


@kernel
def replace_estimate(state: JointState, mean: Array, root: Array) -> JointState:
    """Returns the filter state with another mean and covariance root."""
    return replace_levels(state, mean, root, state.level, state.tick_slope)


@kernel
def replace_levels(state: JointState, mean: Array, root: Array, level: Array, tick_slope: Array) -> JointState:
    """Returns the filter state with another mean, root, thrust levels and their derivatives by ticks."""
    estimate, guard = (mean, root, level, tick_slope), (state.guarded, state.firing_count)
    return _replace_fields(state, estimate, state.fresh, guard, state.lag_open)


@kernel
def clear_pending(state: JointState) -> JointState:
    """Returns the filter state with no last reading left pending, that is, not yet used by an update."""
    estimate, guard = (state.mean, state.root, state.level, state.tick_slope), (state.guarded, state.firing_count)
    return _replace_fields(state, estimate, np.zeros_like(state.fresh), guard, state.lag_open)


@kernel
def set_guard_status(state: JointState, guarded: bool, firing_count: float) -> JointState:
    """Returns the state with `guarded` (it has converged), and the count of firing periods since, replaced."""
    estimate = state.mean, state.root, state.level, state.tick_slope
    return _replace_fields(state, estimate, state.fresh, (guarded, firing_count), state.lag_open)


@kernel
def widen_lag_prior(state: JointState, mean: Array, root: Array, lag_open: Array) -> JointState:
    """Returns the filter state with another mean, root and flags of which jet kinds have the wide lag prior."""
    estimate, guard = (mean, root, state.level, state.tick_slope), (state.guarded, state.firing_count)
    return _replace_fields(state, estimate, state.fresh, guard, lag_open)


@kernel
def _replace_fields(
    state: JointState,
    estimate: tuple[Array, Array, Array, Array],
    fresh: Array,
    guard: tuple[bool, float],
    lag_open: Array,
) -> JointState:
    """Replaces fields of the filter state, for compiled code, which has no `_replace`."""
    mean, root, level, tick_slope = estimate
    guarded, firing_count = guard
    return JointState(
        mean,
        root,
        level,
        state.slope,
        tick_slope,
        state.level_std,
        state.spin,
        state.reference,
        state.read,
        fresh,
        state.slot_jet,
        state.slot_sign,
        state.slot_on_top,
        state.time_s,
        state.started,
        guarded,
        firing_count,
        lag_open,
        state.assumed,
        state.stir,
        state.stir_s,
    )


@kernel
def is_initialized(state: JointState, params: JointParams) -> bool:
    """Tests whether initialization is complete: converged, then `settled_after` control periods with known impulse."""
    return state.guarded and state.firing_count >= params.settled_after
