r"""The joint estimator as a filter of the registry: one state for mass properties, rate, velocity and thrust.

The mathematics is in `massprop_drake.maths.estimation.joint`; here are its parameters from what is known of a vehicle,
the interval between two readings, what logs keep of a cycle, and the state as a vector. It makes its own impulses from
the commands, with the lag at its present estimate, so that `Interval.impulses` and the gate in it play no part.

`measure` is the whole cycle. What its detector sees is a `JointEvidence`; the detector may give another state to go
on from, whose estimates are then reported, or one whose estimates are reported while the filter goes on from its own.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from massprop_drake.maths.arrays import Field, Layout
from massprop_drake.maths.estimation.adaptation import Adaptation
from massprop_drake.maths.estimation.chi_square import chi_square_limit
from massprop_drake.maths.estimation.filter import (
    Filter,
    FilterStep,
    Groups,
    Instruments,
    Interval,
    Setup,
    Told,
    replace_estimates,
)
from massprop_drake.maths.estimation.filters.joint_reports import mass_report, rotation_report
from massprop_drake.maths.estimation.filters.kept_joint_states import check_state_rules
from massprop_drake.maths.estimation.joint import beginning, disturbance_states, joint_cycle, ticks
from massprop_drake.maths.estimation.joint import start as starts
from massprop_drake.maths.estimation.joint.burns import EngineSettings, make_burn, shut_engine_settings
from massprop_drake.maths.estimation.joint.guard import knows_rotation
from massprop_drake.maths.estimation.joint.hypotheses import without_increments
from massprop_drake.maths.estimation.joint.joint_cycle import JointEvidence
from massprop_drake.maths.estimation.joint.joint_sample import UNTRACKED, JointSample
from massprop_drake.maths.estimation.joint.lagged_impulses import effects_of
from massprop_drake.maths.estimation.joint.layout import (
    RATE,
    JointParams,
    JointState,
    PartCounts,
    is_initialized,
    make_places,
    pack,
    state_layout,
    unpack,
)
from massprop_drake.maths.estimation.joint.measurement import combine_gyros
from massprop_drake.maths.estimation.joint.orientation import STILL, UNTURNED, shared_attitude
from massprop_drake.maths.estimation.joint.quantized import DITHER, FLOOR
from massprop_drake.maths.estimation.joint.start import Kept, Start
from massprop_drake.maths.estimation.joint.thrust_scale import parameters_with_scale
from massprop_drake.maths.estimation.joint.ticks import CLOCK, Clock, Commanded, Elapsed, Pace
from massprop_drake.maths.estimation.joint.wheels import UNSPUN, interval_wheel_speeds
from massprop_drake.maths.linear_algebra import Array
from massprop_drake.maths.mass_properties import MASS_RECIPROCAL
from massprop_drake.maths.vehicle.engine_thrust import N_CHANNELS, channel_mask
from massprop_drake.maths.vehicle.on_times import Place, command_onsets, level_onsets, split_sample

GROUP = "joint_estimator"  # its part of a saved state
_DITHERED = 0.25  # of a quantum: noise from which on a reading dithers itself
_BETWEEN = 0.01  # probability that a missing command between two equal ones was another
_NO_SETTING = shut_engine_settings(0)  # of no engine

# what is logged of every cycle besides the reports that all filters give
# the NIS in the reports of all filters is that of three components; here it is scaled to that expectation
JOINT_REPORT = Layout(
    "joint_report",
    gyro_components=Field("expected NIS of the gyro components used", component="components"),
    accelerometer_components=Field("expected NIS of the accelerometer components used", component="components"),
    settled=Field("the start is over"),
)


class JointFilterParams(NamedTuple):
    """Parameters of the filter.

    Attributes:
        period_s: sample period, s.
        at_stamps: see `ticks.Pace`.
        opens_at: see `Setup`.
    """

    joint: JointParams
    period_s: float
    at_stamps: bool = False
    opens_at: Place | None = None


class JointFilterState(NamedTuple):
    """State of the filter after a sample.

    Attributes:
        estimate, covariance: what is reported of it: the ten parameters and the covariance of their errors, NaN for
            the mass reciprocal where it is not observed, shapes (10,) and (10, 10).
        start: what is kept of a start that is under way; neither packed nor saved.
        frame: shared attitude, see `joint.orientation`, a quaternion, shape (4,).
        speeds: of the wheels as they have been read last, NaN where none has been, rad/s, shape (n_wheels,).
    """

    joint: JointState
    clock: Clock
    estimate: Array
    covariance: Array
    start: Start = starts.OVER
    frame: Array = UNTURNED
    speeds: Array = UNSPUN.end
    setting: EngineSettings = _NO_SETTING


class JointMeasurement(NamedTuple):
    """Cycle of the filter, before the detector has judged it."""

    state: JointFilterState
    evidence: JointEvidence


def make_params(setup: Setup, options: Any) -> JointFilterParams:
    """Makes the joint filter's parameters from the vehicle's data and the scenario's blocks `joint` and `faults`."""
    block, thrust = options.joint, setup.thrust
    gyros, accelerometers = setup.gyros, setup.accelerometers
    n_jets, n_kinds = thrust.flows.shape[0], thrust.lag_uncertainty.shape[0]
    packages = (gyros.quanta.shape[0], accelerometers.quanta.shape[0], setup.trackers.variances.shape[0])
    modes = setup.modes
    uncertain_parts = modes.sigmas.shape[0] if modes.sigmas.any() else 0
    thrust_sigmas = _override_sigmas(block.thrust_uncertainty, thrust.uncertainty)
    lagging = np.array([bool((thrust.time_constants_s[thrust.kinds == kind] > 0.0).any()) for kind in range(n_kinds)])
    lag_sigmas = np.where(lagging, _override_sigmas(block.lag_uncertainty, thrust.lag_uncertainty), 0.0)
    of_thrust, thrust_prior = _normalize_sigmas(thrust_sigmas)
    of_lag, lag_prior = _normalize_sigmas(lag_sigmas)
    of_gyros, gyro_prior = _normalize_sigmas(np.repeat(gyros.bias_std, 3))
    of_accelerometers, acceleration_prior = _normalize_sigmas(np.repeat(accelerometers.bias_std, 3))
    of_wheels, wheel_prior = _normalize_sigmas(setup.wheel_uncertainty)
    flow_prior = np.ones(setup.tanks.fill.size if setup.tanks.flow_sigma.any() else 0)
    uncertain = tuple(prior.shape[0] > 0 for prior in (gyro_prior, acceleration_prior, wheel_prior, flow_prior))
    detects = options.detector.kind == "hypotheses"
    slots = options.faults.slots if detects else 0  # forces of failed jets, as states
    effects = effects_of(thrust.wrenches, np.ascontiguousarray(setup.nominal))
    unstated = disturbance_states.unstated_unit_effects(effects, packages[1]) if detects else np.zeros((6, 0))
    counts = PartCounts(
        n_jets,
        *packages,
        components=setup.disturbance.accelerations.shape[1],
        wheels=setup.wheels.inertias.size,
        engines=setup.engines.thrusts.size,
        tanks=setup.tanks.fill.size,
        unstated=unstated.shape[1],
        mounts=thrust.mounting.jets.size,
        modes=modes.frequencies.size,
        parts=uncertain_parts,
    )
    of_attitudes = np.repeat(setup.trackers.variances, 3)
    of_trackers = np.zeros_like(of_attitudes)
    places = make_places(counts, lag_prior.shape[0], uncertain, thrust_prior.shape[0] > 0, slots, ticks=2)
    of_parts = (modes.sigmas[:uncertain_parts] > 0.0).astype(np.float64).ravel()
    rest = np.zeros(places.n_scale + places.n_ticks + places.n_force)
    of_others = gyro_prior, acceleration_prior, wheel_prior, setup.engine_sigmas, flow_prior, np.ones(places.n_mount)
    priors = (thrust_prior, lag_prior, *of_others, of_parts, rest)
    variances = np.concatenate((setup.gyro_variances, setup.accelerometer_variances))
    cells = np.repeat(np.concatenate((gyros.quanta, accelerometers.quanta)), 3)
    noises = np.repeat(np.concatenate((gyros.noise_std, accelerometers.noise_std)), 3)
    diagonal, center, reciprocal = setup.limits.tolist()
    steps = setup.rates.steps
    joint = JointParams(
        places=places,
        wrenches=thrust.wrenches,
        thrusts=np.sqrt(np.sum(thrust.wrenches[:, 3:] ** 2, axis=1)),
        flows=thrust.flows,
        time_constants_s=thrust.time_constants_s,
        kinds=thrust.kinds,
        thrust_sigma=of_thrust,
        lag_sigma=of_lag,
        gyro_bias_sigma=of_gyros,
        acceleration_bias_sigma=of_accelerometers,
        prior_sigma=np.concatenate(priors),
        rate_walk=block.rate_walk,
        velocity_walk=block.velocity_walk,
        repeatability=thrust.repeatability,
        tank_fraction=thrust.tank_fraction if block.tank_fraction is None else block.tank_fraction,
        tick_sigma=setup.period_s * np.array([ticks.JITTER, ticks.PERIOD]),
        arm=thrust.arm,
        accelerometer_positions=setup.accelerometer_positions,
        variances=np.concatenate((np.repeat(variances, 3), of_attitudes)),
        quanta=np.append(
            np.repeat(np.concatenate((undithered_quanta(gyros), undithered_quanta(accelerometers))), 3), of_trackers
        ),
        cells=np.append(cells, of_trackers),
        floors=np.append(noises**2 + (FLOOR * cells) ** 2, of_attitudes),
        dithered=np.append((noises > DITHER * cells).astype(np.float64), of_trackers + 1.0),
        trackers=setup.trackers,
        disturbance=setup.disturbance,
        start=setup.estimate,
        start_root=_covariance_root(setup.covariance),
        increment_sigma=setup.widest,
        nominal=np.ascontiguousarray(setup.nominal),
        thresholds=np.array([chi_square_limit(block.increment_rate / steps, 1 + n) for n in range(3 * counts[1])]),
        guard_relative=np.array([diagonal, diagonal, diagonal, reciprocal if counts[2] > 0 else math.inf]),
        guard_center=np.full(3, center),
        settled_after=float(block.settled_after),
        second_order=True,
        wheels=setup.wheels._replace(sigma=of_wheels),
        engines=setup.engines,
        rates=setup.rates,
        tanks=setup.tanks,
        unstated=unstated,
        mounting=thrust.mounting,
        modes=modes,
    )
    if options.execution.compiled:
        from massprop_drake.maths.estimation.whole_joint import with_compiled  # noqa: PLC0415 (only where compiled)

        joint = with_compiled(joint)
    at_stamps = block.switching == "stamps" or setup.rates.period_s > 0.0
    return JointFilterParams(joint, setup.period_s, at_stamps, setup.opens_at)


def _override_sigmas(value: float | None, sigmas: Array) -> Array:
    """Returns stated sigmas, shape (n,), all replaced by one value where the scenario gives it."""
    return sigmas if value is None else np.full_like(sigmas, value)


def _normalize_sigmas(sigmas: Array) -> tuple[float, Array]:
    """Returns the largest sigma, and all divided by it, shape (n,); 0 and shape (0,) where all are zero."""
    largest = float(sigmas.max(initial=0.0))
    return (largest, sigmas / largest) if largest > 0.0 else (0.0, np.empty(0))


def undithered_quanta(packages: Instruments) -> Array:
    """Returns each package's quantum, zero where its noise is large enough to dither the reading, shape (s,)."""
    return np.where(packages.noise_std >= _DITHERED * packages.quanta, 0.0, packages.quanta)


def _covariance_root(covariance: Array) -> Array:
    """Computes the lower triangular root L of a covariance L L^T that may have zeros on its diagonal."""
    sigmas = np.sqrt(np.diag(covariance))
    scale = np.where(sigmas > 0.0, sigmas, 1.0)
    values, vectors = np.linalg.eigh(covariance / np.outer(scale, scale))
    root = scale.reshape(-1, 1) * vectors * np.sqrt(np.maximum(values, 0.0))
    return np.ascontiguousarray(np.asarray(np.linalg.qr(root.T, mode="r")).T)


def initial_state(params: JointFilterParams) -> JointFilterState:
    """Returns the joint filter's state before the first sample."""
    places = params.joint.places
    clock = ticks.start_clock(0.0, np.zeros(places.jets), level_onsets(places.jets))
    unread = np.full(places.wheels, np.nan)
    begun = _make_filter_state(beginning.initial_joint_state(params.joint), clock, params)
    return begun._replace(start=starts.BEGUN, speeds=unread, setting=shut_engine_settings(places.engines))


def _make_filter_state(joint_state: JointState, clock: Clock, params: JointFilterParams) -> JointFilterState:
    """Makes the filter's state, with the ten parameters' estimate and covariance, from joint state and clock."""
    estimate, rows = parameters_with_scale(joint_state, params.joint)
    return _make_state_of_estimate(joint_state, clock, estimate, rows @ rows.T, params)


def _make_state_of_estimate(
    joint_state: JointState, clock: Clock, estimate: Array, covariance: Array, params: JointFilterParams
) -> JointFilterState:
    """Makes the filter's state from its fields; without accelerometers the mass reciprocal is NaN."""
    if params.joint.places.accelerometers == 0:
        estimate[MASS_RECIPROCAL] = np.nan
        covariance[MASS_RECIPROCAL] = np.nan
        covariance[:, MASS_RECIPROCAL] = np.nan
    return JointFilterState(joint_state, clock, estimate, covariance)


def disturbance_estimate(state: JointFilterState, params: JointFilterParams) -> tuple[Array, Array]:
    """Returns estimates of the stated disturbance's components per stated 1-sigma, and 1-sigmas, shape (n,) each."""
    places = params.joint.places
    slow = slice(places.slow, places.unstated)
    return state.joint.mean[slow].copy(), np.sqrt(np.sum(state.joint.root[slow] ** 2, axis=1))


def measure(
    state: JointFilterState, rates: Array, velocities: Array, interval: Interval, params: JointFilterParams
) -> JointMeasurement:
    """Runs a whole cycle of the joint filter, prediction and update, on an interval; `finish` only reports it."""
    assert interval.told is not None  # what is told is all that this filter takes of an interval
    return step(state, rates, velocities, interval.told, params)


def step(
    state: JointFilterState, rates: Array, velocities: Array, commands: Told, params: JointFilterParams
) -> JointMeasurement:
    """Advances the joint filter by the readings of all packages, NaN where missing, shape (s, 3) each.

    Raises:
        NotPositiveDefiniteError: see `joint_cycle.step`.
    """
    before, steady = state.joint, params
    acting = commands.command != 0.0  # or not known
    if state.start.rotation and knows_rotation(before, params.joint, acting):  # what contradicts is for the detector
        steady = params._replace(joint=without_increments(params.joint))
    cycle = _run_cycle(state, (rates, velocities), commands, steady)
    if before.guarded and np.isnan(commands.command).any():
        likely = _fill_missing_commands(state.clock, commands, steady)
        if not np.array_equal(likely.command, commands.command, equal_nan=True):
            other = _run_cycle(state, (rates, velocities), likely, steady)
            cycle = other if _is_likelier(other, cycle) else cycle
    (clock, sample, anew, kept), own, report = cycle
    start, after = starts.advance_start(state.start, before, (own, report), Kept(sample, anew), params.joint)
    report = report._replace(starting=start.under_way, contradicted=start.contradicted, rotation_known=start.rotation)
    evidence = JointEvidence(before, after, report, sample, anew)
    if after.mean is own.mean:
        known = _make_state_of_estimate(after, clock, report.estimate.copy(), report.covariance.copy(), params)
    else:
        known = _make_filter_state(after, clock, params)
    return JointMeasurement(
        known._replace(start=start, frame=sample.frames[1], speeds=kept[0], setting=kept[1]), evidence
    )


def _split_tracked_columns(commands: Told, params: JointParams) -> tuple[Array, Array, Array]:
    """Splits tracked readings into quaternions (n, 4), wheel speeds, rad/s, engine levels and gimbal angles (n, 3)."""
    places, has = params.places, channel_mask(params.engines)
    poses, engines = 7 * places.trackers, int(has.sum())
    read = np.full(poses + places.wheels + engines, np.nan) if commands.tracked is None else commands.tracked
    of_engines, burn = read.size - engines, np.zeros(has.shape)
    burn[has] = read[of_engines:]
    return read[:poses].reshape(-1, 7)[:, 3:], read[of_engines - places.wheels : of_engines], burn


def _measure_attitudes(
    state: JointFilterState, elapsed: Elapsed, readings: tuple[Array, Array], params: JointParams
) -> tuple[Array, Array]:
    """Returns tracker readings, shape (n_trackers, 3), and the reference attitude at both ends, shape (2, 4).

    `readings` are of the gyros, and quaternions of the trackers.
    """
    rates, quaternions = readings
    if params.places.trackers == 0:
        return UNTRACKED, STILL
    before = state.joint.mean[RATE]
    shown = combine_gyros(rates, state.joint.mean, params).rate
    rate, duration_s = 0.5 * (before + np.where(np.isnan(shown), before, shown)), float(elapsed.durations_s.sum())
    after, attitudes = shared_attitude(state.frame, rate, duration_s, quaternions)
    return attitudes, np.stack((state.frame, after))


class Sampled(NamedTuple):
    """Sample as the filter takes it, and the memory with which it goes on.

    Attributes:
        sample: see `cycle.Sample`.
        anew: whether what has been before tells nothing of it.
        kept: last speeds of the wheels, and the engines' setting.
    """

    clock: Clock
    sample: JointSample
    anew: bool
    kept: tuple[Array, EngineSettings]


class Cycle(NamedTuple):
    """Cycle: its sample, the filter's state after it, and its report."""

    taken: Sampled
    state: JointState
    report: joint_cycle.Report


def _run_cycle(
    state: JointFilterState, readings: tuple[np.ndarray, np.ndarray], commands: Told, params: JointFilterParams
) -> Cycle:
    """Runs a cycle of the joint filter on rates and velocities, or restarts the filter after a gap."""
    taken = make_sample(state, readings, commands, params)
    run = joint_cycle.restart if taken.anew else joint_cycle.step
    return Cycle(taken, *run(state.joint, taken.sample, params.joint))


def make_sample(
    state: JointFilterState, readings: tuple[np.ndarray, np.ndarray], commands: Told, params: JointFilterParams
) -> Sampled:
    """Makes the joint filter's sample of commands, rates and velocities, NaN where missing, shape (s, 3) each."""
    pace, before = Pace(params.period_s, params.at_stamps), state.joint
    now = _command_with_onsets(commands.command, commands.onset_s, params)
    if before.started:
        coming = (
            None if commands.coming is None else _command_with_onsets(commands.coming, commands.coming_onset_s, params)
        )
        clock, interval = ticks.measure_interval(state.clock, commands.stamp_s, (now, coming), pace)
        needed = readings[:1] if params.joint.rates.period_s > 0.0 else readings  # others are read at their own times
        read = all((~np.isnan(each)).any(axis=0).all() for each in needed if each.shape[0] > 0)
        if np.isnan(interval.commands).all(axis=1).any() and not read:
            interval, clock = interval._replace(anew=True), clock._replace(lost=True)  # until all are read again
    else:
        clock = ticks.start_clock(commands.stamp_s, *now)
        interval = ticks.Elapsed(
            *split_sample(*now, pace.period_s, (0.0, pace.period_s)), timing=ticks.timing_on_ticks(), anew=False
        )
    duration_s = float(interval.durations_s.sum())
    outside = commands.outside_wrench * duration_s
    attitudes, wheels, engines = _split_tracked_columns(commands, params.joint)
    seen = _measure_attitudes(state, interval, (readings[0], attitudes), params.joint)
    speeds, last = interval_wheel_speeds(state.speeds, wheels, duration_s, params.joint.wheels)
    burn, setting = make_burn(state.setting, engines, duration_s, params.joint.engines)
    acted = interval.durations_s, interval.commands, outside
    sample = JointSample(commands.time_s, *acted, *readings, interval.timing, *seen, speeds, burn)
    return Sampled(clock, sample, interval.anew, (last, setting))


def _command_with_onsets(command: Array, onset_s: Array | None, params: JointFilterParams) -> Commanded:
    """Pairs a command with the onset times of its firings in the interval, s."""
    return Commanded(command, command_onsets(command, onset_s, params.opens_at, params.period_s))


def _fill_missing_commands(clock: Clock, commands: Told, params: JointFilterParams) -> Told:
    """Fills in missing commands with those before and after, for each jet where the two are equal."""
    pace, onset_s = Pace(params.period_s, params.at_stamps), commands.onset_s
    if onset_s is not None and commands.coming_onset_s is not None:
        onset_s = np.where(np.isnan(commands.command), commands.coming_onset_s, onset_s)
    command = ticks.fill_missing_command(clock, commands.stamp_s, (commands.command, commands.coming), pace)
    return commands._replace(command=command, onset_s=onset_s)


def _is_likelier(filled: Cycle, unknown: Cycle) -> bool:
    """Tests whether filled-in commands make a cycle likelier than unknown ones, prior included; never after a gap."""
    if unknown.taken.anew:
        return False
    ahead = filled.report.log_likelihood - unknown.report.log_likelihood
    return ahead > math.log(_BETWEEN / (1.0 - _BETWEEN))


def finish(
    _state: JointFilterState,
    measurement: JointMeasurement,
    _interval: Interval,
    _adaptation: Adaptation,
    params: JointFilterParams,
) -> FilterStep:
    """Makes the filter step of a cycle: state, rotation and mass log rows; mass None without accelerometers."""
    after, report = measurement.state, measurement.evidence.report
    gyros = 3 * params.joint.places.gyros
    rotation = rotation_report(after.estimate, after.covariance, report, gyros)
    own = JOINT_REPORT.make(
        gyro_components=report.gyro_degrees,
        accelerometer_components=report.accelerometer_degrees,
        settled=_initialized_flag(after, params),
    )
    if params.joint.places.accelerometers == 0:
        return FilterStep(after, rotation, None, own)
    accelerometers = 3 * params.joint.places.accelerometers
    mass = mass_report(after.estimate, after.covariance, report, gyros, accelerometers)
    return FilterStep(after, rotation, mass, own)


def replace_state(step: FilterStep, joint_state: JointState, params: JointFilterParams) -> FilterStep:
    """Returns a filter step with state and reported estimates replaced; its innovations stay."""
    before = step.state
    kept = {"frame": before.frame, "speeds": before.speeds, "setting": before.setting}
    after = _make_filter_state(joint_state, before.clock, params)._replace(**kept)
    if step.state.start.under_way and not joint_state.guarded:  # it begins anew with what has been found
        after = after._replace(start=starts.BEGUN_KNOWN if step.state.start.rotation else starts.BEGUN)
    return replace_estimates(step, after.estimate, after.covariance)._replace(
        state=after, own=step.own._replace(settled=_initialized_flag(after, params))
    )


def publish_state(step: FilterStep, joint_state: JointState, params: JointFilterParams) -> FilterStep:
    """Returns a filter step that reports another state's estimates; the filter keeps its own state."""
    other = _make_filter_state(joint_state, step.state.clock, params)
    return replace_estimates(step, other.estimate, other.covariance)._replace(known=(other.estimate, other.covariance))


def _initialized_flag(state: JointFilterState, params: JointFilterParams) -> float:
    """Returns 1.0 if the filter's initialization is complete, else 0.0."""
    return float(is_initialized(state.joint, params.joint))


def pack_filter_state(state: JointFilterState, params: JointFilterParams) -> Array:
    """Packs the joint filter's state into one vector."""
    places = params.joint.places
    frame = state.frame if places.trackers > 0 else state.frame[:0]
    clock = CLOCK.sized(jets=places.jets).pack(state.clock)
    setting = np.ravel(np.stack(state.setting))
    return np.concatenate((pack(state.joint, places), clock, frame, state.speeds, setting))


def save_state(state: JointFilterState, params: JointFilterParams) -> Groups:
    """Maps the name of the diagram's system that holds the joint filter's state to the state's vector."""
    return {GROUP: pack_filter_state(state, params)}


def restore_state(groups: Groups, params: JointFilterParams) -> JointFilterState:
    """Unpacks the joint filter's state: the inverse of `save_state`.

    Raises:
        ValueError: when the state holds what the filter cannot leave.
    """
    vector, places = groups[GROUP], params.joint.places
    size, clocks = state_layout(places).size, CLOCK.sized(jets=places.jets)
    clock, rest = Clock(*clocks.read(vector[size : size + clocks.size])), vector[size + clocks.size :]
    ends = rest.size - 3 * N_CHANNELS * places.engines
    frame, speeds, setting = np.split(rest, [ends - places.wheels, ends])
    of_engines = EngineSettings(*setting.reshape(3, places.engines, N_CHANNELS))
    state = _make_filter_state(unpack(vector[:size], places), clock, params)._replace(speeds=speeds, setting=of_engines)
    state = state._replace(frame=frame) if places.trackers > 0 else state
    for broken, message in check_state_rules(state.joint, clock, state.frame, places):
        if broken:
            raise ValueError(f"{GROUP}: {message}")
    return state


FILTER = Filter(
    params=make_params,
    initial=initial_state,
    predicted=lambda state: state.estimate,
    measure=measure,
    evidence=lambda _state, measurement, _interval: measurement.evidence,
    finish=finish,
    covariance=lambda state: state.covariance,
    saved=save_state,
    restored=restore_state,
    replaced=replace_state,
    published=publish_state,
    report=JOINT_REPORT,
)
