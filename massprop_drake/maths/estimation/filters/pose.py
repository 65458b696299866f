"""The estimator in a fixed frame as a filter of the registry: its command history, its saved state and its log rows.

The mathematics is in `massprop_drake.maths.estimation.pose`. With a detector the filter carries the bank of
hypotheses, of which the first is its own estimate, and the detector judges them.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from massprop_drake.maths.arrays import Field, Layout
from massprop_drake.maths.attitude import from_rotation_vector, rotation_matrix
from massprop_drake.maths.estimation.adaptation import Adaptation
from massprop_drake.maths.estimation.filter import (
    Filter,
    FilterStep,
    Groups,
    Interval,
    MassReport,
    RotationReport,
    Setup,
    Told,
    replace_estimates,
)
from massprop_drake.maths.estimation.pose import delays, keeping, pose_hypotheses, pose_start
from massprop_drake.maths.estimation.pose.outcome import estimated_properties
from massprop_drake.maths.estimation.pose.pose_cycle import PoseCycled
from massprop_drake.maths.estimation.pose.pose_hypotheses import Tried
from massprop_drake.maths.estimation.pose.pose_layout import PUSHED, Commands, PoseBank, PoseParams, PoseReadings
from massprop_drake.maths.estimation.pose.setting import known_parameters
from massprop_drake.maths.estimation.pose.setting import make_params as params_of
from massprop_drake.maths.estimation.pose.turning import rotation_vectors
from massprop_drake.maths.linear_algebra import Array, has_nonzero
from massprop_drake.maths.mass_properties import MASS_RECIPROCAL
from massprop_drake.maths.vehicle.on_times import Place, command_onsets, split_sample

GROUP = "pose_estimator"  # its part of a saved state
_ROUNDING = 1e-9  # of the largest variance, by which one may seem negative
_TURNED = 1e-6  # by which a rotation's axes may be off after many products

# what is logged of every cycle besides what all filters log
POSE_REPORT = Layout(
    "pose_report",
    kick=Field("probability that something has pushed the vehicle that the model does not have", component="kick"),
    command_delay=Field("how long after its command a jet of the first kind begins to act", "s", "delay"),
    command_delay_std=Field("1-sigma of it", "s", "std"),
    position_estimate=3,
    velocity_estimate=3,
    attitude_estimate=4,
    rate_estimate=3,
    thrust_factor="jets",
    thrust_factor_std="jets",
    drag_rate=2,
    drag_rate_std=2,
    heading_turn=2,
    heading_turn_std=2,
)


class PoseFilterParams(NamedTuple):
    """Parameters of the filter.

    Attributes:
        known: which of the ten parameters have no sigma, shape (10,).
        nominal: the ten nominal parameters, which these have, shape (10,).
        hypotheses: whether the filter carries those of a detector.
        poses, velocities: numbers of sensors in a fixed frame.
        period_s: sample period, s.
        opens_at: see `Setup`.
    """

    pose: PoseParams
    known: np.ndarray
    nominal: Array
    hypotheses: bool
    poses: int
    velocities: int
    period_s: float
    opens_at: Place | None


class PoseFilterState(NamedTuple):
    """State of the filter after a sample.

    Attributes:
        tried: see `pose_hypotheses.Tried`; without a detector of one filter.
        commands: see `Commands`; as far back as they still act.
        time_s: of the sample, by the record's clock.
        started: whether anything has been read that a filter can begin with.
        estimate, covariance: what is reported of it, NaN for what has no sigma, shapes (10,) and (10, 10).
    """

    tried: Tried
    commands: Commands
    time_s: float
    started: bool
    estimate: Array
    covariance: Array


class PoseEvidence(NamedTuple):
    """Evidence of a cycle of this filter for a detector.

    Attributes:
        time_s: of the sample, by the record's clock.
        cycle_s: by that of the cycles.
        tested: whether anything was read that bears on jets.
    """

    tried: Tried
    time_s: float
    cycle_s: float
    tested: bool


class PoseMeasurement(NamedTuple):
    """Cycle of the filter, before the detector has judged it."""

    state: PoseFilterState
    done: PoseCycled | None
    told: Told


def make_params(setup: Setup, options: Any) -> PoseFilterParams:
    """Makes the pose filter's parameters from the vehicle's data and the scenario's block."""
    assert setup.tracking is not None, "made for a vehicle that is followed in a fixed frame"
    detects = options.detector.kind != "off"
    return PoseFilterParams(
        params_of(setup, setup.tracking, hypotheses=detects),
        known_parameters(setup.tracking),
        setup.nominal,
        detects,
        setup.tracking.position_stds.size,
        setup.tracking.velocity_stds.size,
        period_s=setup.period_s,
        opens_at=setup.opens_at,
    )


def initial_state(params: PoseFilterParams) -> PoseFilterState:
    """Returns the pose filter's state before the first sample, not yet started."""
    pose = params.pose
    jets = pose.pushes.shape[0]
    bank = PoseBank(
        pose.start[None], pose.covariance[None], np.eye(3)[None], np.array([-1]), np.zeros((1, 3)), np.zeros((1, 3, 3))
    )
    tried = pose_hypotheses.make_single_filter(bank, np.zeros(1 + 2 * jets), 0.0)
    commands = Commands(np.zeros(0), np.zeros((0, jets)))
    return _update_estimate(PoseFilterState(tried, commands, 0.0, False, np.zeros(10), np.zeros((10, 10))), params)


def _update_estimate(state: PoseFilterState, params: PoseFilterParams) -> PoseFilterState:
    """Returns the state with its ten parameters and covariance recomputed, NaN variance for known ones."""
    bank, jets = delays.merge_delays(state.tried, params.pose), params.pose.pushes.shape[0]
    healthy = state.tried.known[:jets] == 0.0
    estimate, covariance = estimated_properties(bank.mean[0], bank.covariance[0], healthy, params.pose)
    estimate[params.known] = params.nominal[params.known]
    covariance[params.known] = np.nan
    covariance[:, params.known] = np.nan
    return state._replace(estimate=estimate, covariance=covariance)


def measure(
    state: PoseFilterState, rates: Array, velocities: Array, interval: Interval, params: PoseFilterParams
) -> PoseMeasurement:
    """Runs a whole cycle of all hypotheses, prediction and update, or initializes; `finish` only reports it."""
    assert interval.told is not None  # what is told is all that this filter takes of an interval
    told, pose = interval.told, params.pose
    readings = collect_readings(told.tracked, rates, velocities, params)
    now_s = told.stamp_s
    if not state.started:
        if not pose_start.can_initialize(readings, pose):
            return PoseMeasurement(state._replace(time_s=now_s), None, told)
        first = pose_start.initialize_bank(readings, pose)
        tried = _make_first_filters(first, now_s, params)
        none = Commands(np.zeros(0), state.commands.levels)
        commands = _add_command(none, now_s, (told.coming, told.coming_onset_s), params)
        begun = _update_estimate(PoseFilterState(tried, commands, now_s, True, *state[4:]), params)
        return PoseMeasurement(begun, None, told)
    kept = _add_command(state.commands, state.time_s, (told.command, told.onset_s), params)
    acting = _add_command(kept, now_s, (told.coming, told.coming_onset_s), params)
    if has_nonzero(told.outside_wrench):
        acting = acting._replace(outside=told.outside_wrench)
    tried, done = delays.advance_over_delays(state.tried, acting, (state.time_s, now_s), readings, pose)
    commands = _drop_expired_commands(acting, now_s - pose.longest_s)
    after = _update_estimate(PoseFilterState(tried, commands, now_s, True, *state[4:]), params)
    return PoseMeasurement(after, done, told)


def _make_first_filters(initial_bank: PoseBank, now_s: float, params: PoseFilterParams) -> Tried:
    """Makes the filters at the first sample: one for each command delay, and for each fault hypothesis if asked."""
    none, banks = np.zeros(1 + 2 * params.pose.pushes.shape[0]), delays.split_by_delay(initial_bank, params.pose)
    if params.hypotheses:
        tried = [pose_hypotheses.begin_hypotheses(bank, now_s, params.pose) for bank in banks]
    else:
        tried = [pose_hypotheses.make_single_filter(bank, none, now_s) for bank in banks]
    return delays.join_delays(tried, params.pose)


def collect_readings(tracked: Array | None, rates: Array, velocities: Array, params: PoseFilterParams) -> PoseReadings:
    """Splits tracked readings into positions, attitudes and velocities, and joins rates and accelerometers.

    Args:
        rates, velocities: of gyros and accelerometers, shapes (n_gyros, 3) and (n_accelerometers, 3).
    """
    row = np.full(7 * params.poses + 3 * params.velocities, np.nan) if tracked is None else tracked
    poses = row[: 7 * params.poses].reshape(-1, 7)
    sensors, rotations = params.pose.pose, np.full((params.poses, 3, 3), np.nan)
    positions = np.where(np.isfinite(sensors.position_variances)[:, None], poses[:, :3], np.nan)
    for place in np.flatnonzero(np.isfinite(sensors.attitude_variances)):
        if np.isfinite(poses[place, 3:]).all():
            rotations[place] = rotation_matrix(poses[place, 3:] / np.sqrt(poses[place, 3:] @ poses[place, 3:]))
    return PoseReadings(positions, rotations, row[7 * params.poses :].reshape(-1, 3), rates, velocities)


def _add_command(
    commands: Commands, time_s: float, command_and_onsets: tuple[Array | None, Array | None], params: PoseFilterParams
) -> Commands:
    """Replaces a command history from a time on by the command given then; levels that do not change add no entry.

    Args:
        commands: the history; entries from that time on are dropped.
        time_s: when they are given.
        command_and_onsets: command, None: nothing is said, and its onsets, None: they are not told.
    """
    command, onset_s = command_and_onsets
    until = int(np.searchsorted(commands.time_s, time_s))
    commands = Commands(commands.time_s[:until], commands.levels[:until])
    if command is None:
        return commands
    onset_s = command_onsets(command, onset_s, params.opens_at, params.period_s)
    lengths_s, levels = split_sample(command, onset_s, params.period_s, (0.0, params.period_s))
    times_s = time_s + np.append(0.0, np.cumsum(lengths_s[:-1]))
    if commands.time_s.size and np.array_equal(commands.levels[-1], levels[0], equal_nan=True):
        times_s, levels = times_s[1:], levels[1:]
    return Commands(np.append(commands.time_s, times_s), np.vstack((commands.levels, levels)))


def _drop_expired_commands(commands: Commands, start_s: float) -> Commands:
    """Returns the command history from the command in force at a time on."""
    begin = max(int(np.searchsorted(commands.time_s, start_s, side="right")) - 1, 0)
    return Commands(commands.time_s[begin:], commands.levels[begin:])


def evidence(_state: PoseFilterState | None, measurement: PoseMeasurement, _interval: Interval | None) -> PoseEvidence:
    """Makes the detector's evidence of a cycle: hypotheses, times, and whether there were readings."""
    state, told = measurement.state, measurement.told
    done = measurement.done
    return PoseEvidence(state.tried, state.time_s, told.time_s, done is not None and done.innovation.size > 0)


def finish(
    _state: PoseFilterState,
    measurement: PoseMeasurement,
    _interval: Interval | None,
    _adaptation: Adaptation,
    params: PoseFilterParams,
) -> FilterStep:
    """Makes the filter step of a cycle: its state, and its rotation, mass and pose log rows."""
    state, done, nothing = measurement.state, measurement.done, np.full(3, np.nan)
    (turning, n_turning), (moving, n_moving) = np.zeros((2, 2)) if done is None else done.of_first
    deviation = np.sqrt(state.covariance.diagonal())
    rotation = RotationReport(
        estimate=state.estimate[:9],
        standard_deviation=deviation[:9],
        rotation_innovation=nothing,
        rotation_innovation_std=nothing,
        rotation_nis=3.0 * turning / n_turning if n_turning else math.nan,
        rotation_used=bool(n_turning),
        rotation_jump=False,
        coupling_subtracted=not params.pose.planar,
    )
    mass = MassReport(
        mass_reciprocal=float(state.estimate[MASS_RECIPROCAL]),
        variance=float(state.covariance[MASS_RECIPROCAL, MASS_RECIPROCAL]),
        mass_innovation=nothing,
        mass_innovation_std=nothing,
        mass_nis=3.0 * moving / n_moving if n_moving else math.nan,
        mass_used=bool(n_moving),
        mass_jump=False,
    )
    return FilterStep(state, rotation, mass, _make_report_row(state, done, params))


def _make_report_row(state: PoseFilterState, cycle: PoseCycled | None, params: PoseFilterParams) -> Any:
    """Makes the log row `POSE_REPORT`: pose, rates, thrust factors, command delay and drag."""
    pose, bank = params.pose, delays.merge_delays(state.tried, params.pose)
    jets = pose.pushes.shape[0]
    deviation = np.zeros(pose.parts.size)
    deviation[pose.free] = np.sqrt(bank.covariance[0].diagonal())
    return POSE_REPORT.make(
        kick=0.0 if cycle is None else float(cycle.kicked[0]),
        command_delay=float(bank.mean[0, pose.parts.delay.start]),
        command_delay_std=float(deviation[pose.parts.delay.start]),
        position_estimate=bank.mean[0, pose.parts.position],
        velocity_estimate=bank.mean[0, pose.parts.velocity],
        attitude_estimate=from_rotation_vector(rotation_vectors(bank.rotation[:1])[0]),
        rate_estimate=bank.mean[0, pose.parts.rate],
        thrust_factor=bank.mean[0, :jets],
        thrust_factor_std=deviation[:jets],
        drag_rate=bank.mean[0, pose.parts.drag],
        drag_rate_std=deviation[pose.parts.drag],
        heading_turn=bank.mean[0, pose.parts.tilt],
        heading_turn_std=deviation[pose.parts.tilt],
    )


def replace_state(step: FilterStep, hypotheses: Tried, params: PoseFilterParams) -> FilterStep:
    """Returns a filter step with hypotheses and reported estimates replaced by the detector's."""
    state = _update_estimate(step.state._replace(tried=hypotheses), params)
    return replace_estimates(step, state.estimate, state.covariance)._replace(state=state)


def publish_state(step: FilterStep, hypotheses: Tried, params: PoseFilterParams) -> FilterStep:
    """Returns a filter step that reports other hypotheses' estimates; the filter keeps its own state."""
    other = _update_estimate(step.state._replace(tried=hypotheses), params)
    return replace_estimates(step, other.estimate, other.covariance)._replace(known=(other.estimate, other.covariance))


def _make_saved_layout(params: PoseFilterParams) -> Layout:
    """Makes the layout of the saved vector's first part: the first filter and the command in force."""
    pose = params.pose
    jets, size, free = pose.pushes.shape[0], pose.parts.size, pose.free.size
    return Layout(
        GROUP,
        mean=size,
        covariance=(free, free),
        rotation=(3, 3),
        opens=1,
        reference=3,
        turned=(3, 3),
        known=1 + 2 * jets,
        level=jets,
        time_s=1,
        started=1,
    )  # and then `keeping.pack_hypotheses`


def save_state(state: PoseFilterState, params: PoseFilterParams) -> Groups:
    """Packs the pose filter's state: first filter and command in force; then command history and hypotheses."""
    bank = state.tried.bank
    level = state.commands.levels[-1] if state.commands.levels.size else np.zeros(params.pose.pushes.shape[0])
    parts = [bank.mean[0], bank.covariance[0], bank.rotation[0], bank.opens[:1].astype(float), bank.reference[0]]
    parts += [bank.turned[0], state.tried.known, level, np.array([state.time_s]), np.array([float(state.started)])]
    if state.started:
        parts.append(keeping.pack_hypotheses(state.tried, state.commands))
    return {GROUP: np.concatenate([np.ravel(part) for part in parts])}


def restore_state(groups: Groups, params: PoseFilterParams) -> PoseFilterState:
    """Unpacks the pose filter's state: the inverse of `save_state`.

    Raises:
        ValueError: when the state holds what the filter cannot leave.
    """
    layout = _make_saved_layout(params)
    read, more = layout.read(groups[GROUP][: layout.size]), groups[GROUP][layout.size :]
    jets = params.pose.pushes.shape[0]
    finite = (part for name, part in zip(layout, read, strict=True) if name != "level")
    if not all(np.isfinite(part).all() for part in finite):
        raise ValueError(f"{GROUP}: only commands may be missing")
    if not (np.isin(read.known, (0.0, 1.0)).all() and read.opens[0] in range(PUSHED, jets)):
        raise ValueError(f"{GROUP}: known must be 0 or 1, and opens a jet's index")
    _require_valid_state(read)
    mean, covariance, rotation = (part[None].copy() for part in (read.mean, read.covariance, read.rotation))
    reference, turned = read.reference[None].copy(), read.turned[None].copy()
    bank = PoseBank(mean, covariance, rotation, read.opens.astype(int), reference, turned)
    time_s, begun = float(read.time_s[0]), bool(read.started[0])
    tried = pose_hypotheses.make_single_filter(bank, read.known.copy(), time_s)
    commands = Commands(np.zeros(0), np.zeros((0, jets)))
    if begun:
        try:
            tried, commands = keeping.unpack_hypotheses(more, params.pose)
        except ValueError as error:
            raise ValueError(f"{GROUP}: {error}") from None
        first = (tried.bank.mean[0], tried.bank.covariance[0], tried.known)
        if not all(map(np.array_equal, first, (read.mean, read.covariance, read.known))):
            raise ValueError(f"{GROUP}: the first hypothesis must be the filter's own")
    return _update_estimate(PoseFilterState(tried, commands, time_s, begun, np.zeros(10), np.zeros((10, 10))), params)


def _require_valid_state(saved: Any) -> None:
    """Raises ValueError for a saved state with an impossible covariance, rotation, command or flag."""
    spread = np.linalg.eigvalsh(saved.covariance)
    if not np.array_equal(saved.covariance, saved.covariance.T) or spread[0] < -_ROUNDING * spread[-1]:
        raise ValueError(f"{GROUP}: the covariance must be symmetric, and no variance negative")
    if np.abs(saved.rotation @ saved.rotation.T - np.eye(3)).max() > _TURNED or np.linalg.det(saved.rotation) < 0.0:
        raise ValueError(f"{GROUP}: rotation must be a rotation matrix")
    if ((saved.level < 0.0) | (saved.level > 1.0)).any():
        raise ValueError(f"{GROUP}: commands must be fractions of 0 to 1")
    if saved.started[0] not in (0.0, 1.0):
        raise ValueError(f"{GROUP}: started must be 0 or 1")


FILTER = Filter(
    params=make_params,
    initial=initial_state,
    predicted=lambda state: state.estimate,
    measure=measure,
    evidence=evidence,
    finish=finish,
    covariance=lambda state: state.covariance,
    saved=save_state,
    restored=restore_state,
    replaced=replace_state,
    published=publish_state,
    report=POSE_REPORT,
    growing=GROUP,
)
