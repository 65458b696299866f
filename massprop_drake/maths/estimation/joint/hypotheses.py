r"""Hypothesis of one event: the joint filter's own cycle from another state, and its likelihood of the readings.

    jets    from the onset on each has a force in a slot, prior N(0, T^2) about what is known of it; since nobody knows
            when in its interval it began, P += g g^T, g = 0.6 f x (interval) x (effect of a unit force), f the
            most that it may be; and once more in the second interval, 0.17 of that: it builds up with a lag
            One that drifts has P += w^2 for it in every further interval, w = 3 % of full thrust a second
    jump    rebased, the ten parameters uncertain again, see `jump_sigma`, s one of `JUMP_SHARES`; guard and settling
            begin anew; in its own interval jets may have given otherwise by that share
    lies    one component is not read from the onset on, until it fits again
    speed   the speed of a wheel is not believed from the onset on, for good: what it is off by turns with the vehicle
    turn    the attitude that a tracker reads is another from the onset on, as by another star that it takes for its own
    wander  something acts which nobody stated, and changes slowly: see `disturbance_states`, one of `STIRS`
    engine  level or angle of an engine stays where it was at the onset, and its thrust or that angle is anything

*Log-likelihood*: the sum of ln Z over the readings that its own filter takes in (`quantized`), so that what a filter
learns from a reading and what it is worth for it are one number. A reading that lies is one of 4e4 steps, each as
likely, or as likely as not what it was before: a sensor that stands still. One that does so for a second would else
cost more than a jump of all that is known of the vehicle explains.
"""

from __future__ import annotations

import math
from enum import IntEnum
from typing import NamedTuple

import numpy as np

from massprop_drake.maths.estimation.joint.covariance import compress_root, semidefinite_root
from massprop_drake.maths.estimation.joint.crossing import update_by_crossings
from massprop_drake.maths.estimation.joint.forcing import estimated_lags
from massprop_drake.maths.estimation.joint.guard import reset_guard
from massprop_drake.maths.estimation.joint.innovation import prediction_floors
from massprop_drake.maths.estimation.joint.joint_cycle import Report, step
from massprop_drake.maths.estimation.joint.joint_sample import JointSample
from massprop_drake.maths.estimation.joint.layout import (
    CENTER,
    MASS,
    N_PROPERTIES,
    RATE,
    JointParams,
    JointState,
    Places,
)
from massprop_drake.maths.estimation.joint.measurement import fix_velocity_reference, readings
from massprop_drake.maths.estimation.joint.process_noise import parameter_effects
from massprop_drake.maths.estimation.joint.sensitivity import Link, impulse_columns, unit_force_errors
from massprop_drake.maths.estimation.joint.unknown import reading_sigmas
from massprop_drake.maths.linear_algebra import Array
from massprop_drake.maths.mass_properties import ELEMENT
from massprop_drake.maths.vehicle.engine_thrust import N_CHANNELS, N_ERRORS

# probability: 1-sigma of something unstated that acts, in what all jets give, and its time constant, s: propellant that
# sloshes, or drag and what vents
STIRS = tuple((10.0 ** (-0.5 * step), constant_s) for step in range(8) for constant_s in (10.0, 100.0))
_FIRING_S = 3.0  # seconds: T_f, over which jets and what is unstated are taken for each other
JUMP_SHARES = (0.3, 0.06)  # of the vehicle's mass (1 sigma): a payload, large or small
DRIFT = 0.03  # of full thrust a second, 1 sigma: by so much the force of a jet changes that weakens or opens slowly
KICK = 0.6  # 1-sigma of an onset's place, in intervals between onsets: uniform over two has 0.58
SHARES = (1.0, 0.17)  # of it in the first interval and in the second: a lag of a fifth of an interval takes that much
_MOVED = 0.5  # steps by which a reading has moved that does not stand still
BOW = 0.1  # of an impulse at an unknown time, 1 sigma: the angle that it turns by beyond what a steady one does
UNTIMED = 1.0 / np.sqrt(12.0)  # of an interval, 1 sigma: when an impulse at an unknown time is given
_LEFT = 1e-6  # of a force that builds up: less is not felt
_RANGE = 4e4  # steps that a sensor's range has
_STILL = 2.0  # a lie is as likely as not the same as the one before
TURNED = 0.3  # rad, a prior 1-sigma: other stars taken for its own turn what a tracker reads; within linearization
STUCK_THRUST = 1.0  # a prior 1-sigma, relative: of the thrust of an engine that gives anything
STUCK_SHARE = 0.5  # of a gimbal's stop, a prior 1-sigma: the angle of one that stays anywhere
_LIES = 5.0  # sigmas off: a reading that does not fit


class Kind(IntEnum):
    """Kind of cause that a hypothesis assumes."""

    NOTHING = 0
    JETS = 1
    JUMP = 2
    LIES = 3
    UNKNOWN = 4  # something pushes as jets could, or has ceased to
    SPEED = 5
    TURN = 6
    ENGINE = 7
    WANDER = 8


class Cause(NamedTuple):
    """Cause that a hypothesis assumes.

    Attributes:
        kind: see `Kind`.
        jets: indices of the jets that have failed.
        signs: 1: that jet gives more than it is told to, -1: less.
        on_top: 1: it gives that on top of what it is told to, as a leak; 0: as a jet that is stuck.
        component: index of the reading that lies, else -1; that of a wheel's speed comes after those of all others,
            after the wheels that of a tracker's attitude as a whole, and then level and angles of each engine. Of
            something unstated its index in `STIRS`.
    """

    kind: Kind
    jets: tuple[int, ...] = ()
    signs: tuple[int, ...] = ()
    on_top: tuple[int, ...] = ()
    component: int = -1

    @property
    def failures(self) -> frozenset[tuple[int, int]]:
        """Failed jets as pairs (jet, sign), sign 1: gives more than commanded, -1: less."""
        return frozenset(zip(self.jets, self.signs, strict=True))

    @property
    def part(self) -> tuple[Kind, int]:
        """Kind and component of a cause other than jets; component -1 for an unstated disturbance."""
        return self.kind, -1 if self.kind == Kind.WANDER else self.component

    @property
    def key(self) -> frozenset[tuple[int, int]] | tuple[Kind, int]:
        """Key that distinguishes causes; a leaking jet and the same jet stuck on have the same."""
        return self.failures or self.part


class Score(NamedTuple):
    """Score of a hypothesis: how well it explains the readings.

    Attributes:
        likelihood: sum of ln Z, nats.
        nis, degrees: sums of those of its cycles, see `joint_cycle.Report`.
        gyro_nis, gyro_degrees: those of the gyros alone.
    """

    likelihood: float
    nis: float
    degrees: float
    gyro_nis: float = 0.0
    gyro_degrees: float = 0.0

    def plus(self, score: Score) -> Score:
        """Returns the sum of two scores: log likelihood, NIS and degrees of freedom."""
        return Score(*(whole + more for whole, more in zip(self, score, strict=True)))

    def without(self, score: Score) -> Score:
        """Returns the difference of two scores: log likelihood, NIS and degrees of freedom."""
        return Score(*(whole - less for whole, less in zip(self, score, strict=True)))

    @property
    def excess(self) -> float:
        """Expected log likelihood of the readings less that found, (NIS - degrees) / 2, nats."""
        return 0.5 * (self.nis - self.degrees)

    @property
    def misfit(self) -> float:
        """NIS less its expectation, in standard deviations of chi-square."""
        return (self.nis - self.degrees) / max(np.sqrt(2.0 * self.degrees), 1.0)


NO_SCORE = Score(0.0, 0.0, 0.0)


class Runner(NamedTuple):
    """Filter that takes an event for true.

    Attributes:
        cause: see `Cause`.
        onset: cycle after which it holds.
        kicks: 1-sigma of the impulse of each failed jet in the first and in the second interval, in intervals of
            force, lbf or N.
        cycle: the last one done.
        state: after it.
        score: sum over all cycles since the common origin.
        lying: whether its reading does not fit yet.
        share: see `apply_cause`.
        lie: last false reading; NaN: none yet.
        expected: see `apply_cause`.
    """

    cause: Cause
    onset: int
    kicks: tuple[tuple[float, ...], ...]
    cycle: int
    state: JointState
    score: Score
    lying: bool = False
    share: float = JUMP_SHARES[0]
    lie: float = np.nan
    expected: tuple[tuple[float, float], ...] = ()

    @property
    def age(self) -> int:
        """Number of cycles since the onset of the hypothesis."""
        return self.cycle - self.onset


def false_reading_cost(component: int, params: JointParams, change_since: float = np.inf) -> float:
    """Computes the cost of taking a reading for false, nats: uniform over the sensor's range, or repeating the last.

    Args:
        component: its index.
        change_since: from the false reading before; a sensor that stands still repeats it, another has its whole range.
    """
    spread = max(params.quanta[component], np.sqrt(12.0 * params.variances[component]))
    alternatives = _STILL if abs(change_since) <= _MOVED * params.quanta[component] else _RANGE
    return float(np.log(alternatives * spread / (params.cells[component] or 1.0)))


def stronger_disturbances(state: JointState, params: JointParams) -> list[int]:
    """Returns indices in `STIRS` (disturbance levels) of levels above the state's, or equal and no slower."""
    now = (state.stir, -state.stir_s)
    return [at for at, (level, seconds) in enumerate(STIRS) if params.places.n_unstated and (level, -seconds) >= now]


def unstated_disturbance_sigmas(level: float, params: JointParams) -> tuple[float, float]:
    """Computes 1-sigma torque and force per axis of an unstated disturbance of given level, RMS over the axes.

    Returns:
        Torque and force, ft-lbf and lbf, or N-m and N; NaN in place of a force without an accelerometer.
    """
    accelerations, nominal = level * params.unstated, params.nominal
    torques = np.linalg.solve(nominal[:6][ELEMENT], accelerations[:3])
    forces = accelerations[3:] / nominal[MASS]
    torque, force = (math.sqrt(np.sum(part**2) / 3.0) for part in (torques, forces))
    return torque, force if params.places.accelerometers else math.nan


def failure_slot(state: JointState, jet: int, sign: int) -> int:
    """Returns the index of the state's slot for a jet's failure: its own, else the first free, -1: none."""
    existing = np.flatnonzero((state.slot_jet == jet) & (state.slot_sign == sign))
    free = np.flatnonzero(state.slot_jet < 0)
    return int(existing[0]) if existing.shape[0] else int(free[0]) if free.shape[0] else -1


def jump_sigma(params: JointParams, mass_share: float) -> Array:
    """Computes the 1-sigma that a payload of a given share of the mass adds to the ten mass parameters, shape (10,).

    A payload of some share of the vehicle's mass, as far from the center of mass as the jets are: that much of the
    uncertainty of a start from zero, but of the center of mass the share of that distance, equally in every direction;
    and of the mass always the largest share, since a heavy payload near the center of mass shifts little else.

    Args:
        mass_share: of the mass, 1 sigma.
    """
    sigma = mass_share * params.increment_sigma
    sigma[CENTER] = mass_share * params.arm / np.sqrt(3.0)
    sigma[MASS] = JUMP_SHARES[0] * params.increment_sigma[MASS]
    return sigma


def jump_variances(params: JointParams) -> Array:
    """Computes the ten parameters' variances by a mass jump of each of `JUMP_SHARES`, relative to the first."""
    sigmas = np.array([jump_sigma(params, mass_share) for mass_share in JUMP_SHARES])
    result: Array = (sigmas / sigmas[0]) ** 2
    return result


def apply_cause(
    state: JointState,
    fault: Cause,
    params: JointParams,
    jump_share: float = JUMP_SHARES[0],
    force_priors: tuple[tuple[float, float], ...] = (),
) -> JointState:
    """Adds a fault's prior uncertainty to the state at its onset: of jets, jump, attitude, engine or disturbance.

    Args:
        jump_share: see `jump_sigma`; of a disturbance that acts already, 1: it jumps, 0: it does not.
        force_priors: mean and 1-sigma of the change of each jet's force; none: zero and its thrust, lbf or N.
    """
    places, size = params.places, state.root.shape[0]
    if fault.kind == Kind.JUMP:
        columns = np.zeros((size, N_PROPERTIES))
        np.fill_diagonal(columns, jump_sigma(params, jump_share))
        return reset_guard(_add_uncertainty(fix_velocity_reference(state, params), columns, params))
    if fault.kind == Kind.TURN:
        return _add_uncertainty(state, TURNED * np.eye(size)[:, places.attitude : places.attitude + 3], params)
    if fault.kind == Kind.WANDER:
        level, constant_s = STIRS[fault.component]
        jumps = float(state.stir == 0.0 or jump_share > 0.0)  # else it only changes faster from now on
        columns = jumps * level * np.eye(size)[:, places.unstated : places.unstated + places.n_unstated]
        return _add_uncertainty(state, columns, params)._replace(stir=level, stir_s=constant_s)
    if fault.kind == Kind.ENGINE:
        engine, channel = divmod(fault.component - first_engine_index(places), N_CHANNELS)
        columns, first_error = np.zeros((size, 1)), places.engine + N_ERRORS * engine
        if channel == 0:
            columns[first_error : first_error + 2] = STUCK_THRUST
        else:
            columns[first_error + 1 + channel] = STUCK_SHARE * params.engines.stops[engine, channel]
        return _add_uncertainty(state, columns, params)
    if fault.kind != Kind.JETS:
        return state
    mean, columns = state.mean.copy(), np.zeros((size, len(fault.jets)))
    slot_jet, slot_sign, slot_on_top = state.slot_jet.copy(), state.slot_sign.copy(), state.slot_on_top.copy()
    for index, (jet, sign, on_top) in enumerate(zip(fault.jets, fault.signs, fault.on_top, strict=True)):
        slot = failure_slot(state._replace(slot_jet=slot_jet, slot_sign=slot_sign), jet, sign)
        slot_jet[slot], slot_sign[slot], slot_on_top[slot] = jet, sign, on_top
        change, sigma = force_priors[index] if force_priors else (0.0, params.thrusts[jet])
        mean[places.force + slot] += change
        columns[places.force + slot, index] = sigma
    failed = state._replace(mean=mean, slot_jet=slot_jet, slot_sign=slot_sign, slot_on_top=slot_on_top)
    return _add_uncertainty(failed, columns, params)


def _add_uncertainty(state: JointState, columns: Array, params: JointParams) -> JointState:
    """Returns the state with independent errors added to its covariance, one column of 1-sigmas each."""
    return state._replace(root=compress_root(np.hstack((state.root, columns)), params.places.thrust))


def add_failure_impulses(
    state: JointState, fault: Cause, force_sigmas: Array, interval: Link, params: JointParams
) -> JointState:
    """Adds the uncertain impulses of failed jets in their onset interval to the state's covariance.

    Products with errors of the parameters count as noise.

    Args:
        force_sigmas: of each failed jet, lbf or N.
    """
    places, jets = params.places, list(fault.jets)
    impulses = unit_force_errors(interval, places)[:, jets] * force_sigmas
    products = np.zeros((6, 6))
    if params.second_order:
        relative_impulse = (force_sigmas * interval.duration_s / params.thrusts[jets]).reshape(-1, 1)
        effects = parameter_effects(state.mean, params.wrenches[jets]) * relative_impulse
        uncertain = (effects @ state.root[:N_PROPERTIES]).reshape(6, -1)
        products = semidefinite_root(uncertain @ uncertain.T)
    bowed = np.zeros((state.root.shape[0], 3))
    turns = np.zeros((state.root.shape[0], places.n_attitude))
    changed = np.sqrt(np.sum(impulses[RATE] ** 2))
    bowed[RATE] = BOW * interval.duration_s * np.linalg.norm(state.mean[RATE]) * changed * np.eye(3)
    attitude = slice(places.attitude, places.attitude + places.n_attitude)
    turns[attitude] = UNTIMED * interval.duration_s * changed * np.eye(places.n_attitude)
    columns = np.hstack((impulses, impulse_columns(products, interval, places), bowed, turns))
    return _add_uncertainty(state, columns, params)


def add_disturbance_drift(state: JointState, old_level: float, duration_s: float, params: JointParams) -> JointState:
    """Inflates the mass parameters' covariance for an unstated disturbance that acted before it was recognized.

    Over a firing that is as white noise of 2 T_f T (L a)^2 in each sample, beside that of two readings.

    Args:
        old_level: assumed until now, in place of the state's L.
    """
    unit = np.sum(params.unstated**2, axis=1) * _FIRING_S * duration_s / reading_sigmas(params) ** 2
    noise, old_noise = (1.0 + level**2 * np.max(unit) for level in (state.stir, old_level))
    root = state.root.copy()
    root[:N_PROPERTIES] *= np.sqrt(max(noise / old_noise, 1.0))
    return state._replace(root=compress_root(root, params.places.thrust))


def _add_jump_time_noise(state: JointState, mass_share: float, interval: Link, params: JointParams) -> JointState:
    """Adds the uncertain effect of jets that fire in a mass jump's interval, at an unknown time, to the covariance."""
    fired = np.flatnonzero(interval.amount > 0.0)
    if fired.shape[0] == 0:
        return state
    mean_forces = mass_share * params.thrusts[fired] * interval.amount[fired] / interval.duration_s
    return _add_uncertainty(state, unit_force_errors(interval, params.places)[:, fired] * mean_forces, params)


def extra_impulse_sigmas(hypothesis: Runner, duration_s: float, params: JointParams) -> Array | None:
    """Returns 1-sigma of each failed jet's onset impulse in the next interval, as force, lbf or N; None once decayed.

    After the second interval it decays by exp(-interval / tau) in each, tau as it is estimated.
    """
    known = len(hypothesis.kicks)
    if hypothesis.age < 0 or known == 0:
        return None
    if hypothesis.age < known:
        return np.array(hypothesis.kicks[hypothesis.age])
    lag = estimated_lags(hypothesis.state.mean, params)[0][list(hypothesis.cause.jets)]
    left = np.exp(-duration_s * (hypothesis.age - known + 1) / np.where(lag > 0.0, lag, 1e-3 * duration_s))
    return np.array(hypothesis.kicks[-1]) * left if left.max() > _LEFT else None


def add_force_noise(state: JointState, slot_noise: np.ndarray, params: JointParams) -> JointState:
    """Returns the state with forces of intermittent jets redrawn from N(f, T^2), and of drifting ones diffused.

    Args:
        slot_noise: 1 for the slot of an intermittent jet; of a drifting one the 1-sigma of its change in an interval,
            relative to its thrust; shape (n_force,).
    """
    slots = np.flatnonzero(slot_noise)
    if slots.shape[0] == 0:
        return state
    rows = params.places.force + slots
    root, columns = state.root.copy(), np.zeros((state.root.shape[0], slots.shape[0]))
    root[rows[slot_noise[slots] == 1.0]] = 0.0
    columns[rows, np.arange(slots.shape[0])] = slot_noise[slots] * params.thrusts[state.slot_jet[slots].astype(np.intp)]
    return _add_uncertainty(state._replace(root=root), columns, params)


def add_push_impulse(state: JointState, push: float, interval: Link, params: JointParams) -> JointState:
    """Returns the state with the covariance of an unknown impulse in an interval added, independent of earlier ones.

    Args:
        push: its 1-sigma, in units of every jet's full thrust; zero: none.
    """
    if push == 0.0:
        return state
    return _add_uncertainty(state, unit_force_errors(interval, params.places) * (push * params.thrusts), params)


def without_increments(params: JointParams) -> JointParams:
    """Returns parameters with covariance inflation disabled, whose timing would blur the comparison."""
    return params._replace(thresholds=np.full_like(params.thresholds, np.inf))


def _mask_component(sample: JointSample, component: int) -> JointSample:
    """Returns a sample with one component of its readings set to NaN, as missing."""
    parts = sample.rates, sample.velocities, sample.attitudes
    reading = readings(*parts)
    if component < reading.size:
        reading[component] = np.nan
    ends = np.cumsum([part.size for part in parts])
    rates, velocities, attitudes, _ = (part.reshape(-1, 3) for part in np.split(reading, ends))
    return sample._replace(rates=rates, velocities=velocities, attitudes=attitudes)


def _is_inconsistent(report: Report, component: int, params: JointParams) -> bool:
    """Tests whether a reading is missing or more than five standard deviations off its prediction."""
    course = report.course
    assert course is not None, "the first sample fits"
    half = course.expected.projected[component]
    deviation = np.sqrt(half @ half + params.variances[component])
    return not bool(abs(course.expected.innovation[component]) <= _LIES * deviation)


def prepare_cycle(
    hypothesis: Runner, sample: JointSample, interval: Link, slot_noise: np.ndarray, push: float, params: JointParams
) -> tuple[JointState, float]:
    """Returns a hypothesis's state before prediction, fault applied, and log likelihood of pending readings."""
    state, crossing = update_by_crossings(
        hypothesis.state,
        hypothesis.state.mean[:N_PROPERTIES],
        sample,
        prediction_floors(hypothesis.state, params),
        params,
    )
    if hypothesis.age == 0:
        state = apply_cause(state, hypothesis.cause, params, hypothesis.share, hypothesis.expected)
        if hypothesis.cause.kind in (Kind.SPEED, Kind.ENGINE):
            state = state._replace(assumed=_hold_untrusted(state.assumed, hypothesis.cause, sample, params))
        if hypothesis.cause.kind == Kind.WANDER:
            state = add_disturbance_drift(state, hypothesis.state.stir, interval.duration_s, params)
        if hypothesis.cause.kind == Kind.JUMP:
            state = _add_jump_time_noise(state, hypothesis.share, interval, params)
    force_sigmas = extra_impulse_sigmas(hypothesis, interval.duration_s, params)
    if force_sigmas is not None:
        state = add_failure_impulses(state, hypothesis.cause, force_sigmas, interval, params)
    return add_push_impulse(add_force_noise(state, slot_noise, params), push, interval, params), crossing.log_likelihood


def _hold_untrusted(assumed: Array, fault: Cause, sample: JointSample, params: JointParams) -> Array:
    """Returns assumed wheel speeds and engine settings, the faulty one held at its reading at the interval's start."""
    assumed, places = assumed.copy(), params.places
    if fault.kind == Kind.SPEED:
        wheel = fault.component - places.outputs
        assumed[wheel] = sample.speeds.start[wheel]
        return assumed
    place = fault.component - first_engine_index(places)
    engine, channel = divmod(place, N_CHANNELS)
    assumed[places.wheels + place] = sample.burn.points[engine, 0, channel]
    return assumed


def first_engine_index(places: Places) -> int:
    """Returns the `Cause` component of the first engine's level, after readings, wheels and trackers."""
    return places.outputs + places.wheels + places.trackers


def run_hypothesis_cycle(
    hypothesis: Runner, sample: JointSample, interval: Link, slot_noise: np.ndarray, push: float, params: JointParams
) -> Runner:
    """Advances a hypothesis by one cycle of its filter; returns it with new state and score.

    Args:
        hypothesis: before; it opens when its onset is the last cycle done.
        interval: the cycle, linearized by any filter that is near.
        slot_noise, push: see `add_force_noise` and `add_push_impulse`.
        params: without increments.
    """
    state, likelihood = prepare_cycle(hypothesis, sample, interval, slot_noise, push, params)
    after, report = step(state, sample, params)
    lying, lie, component = hypothesis.lying, hypothesis.lie, hypothesis.cause.component
    score = hypothesis.score.plus(Score(likelihood, 0.0, 0.0))
    if lying and hypothesis.cycle >= hypothesis.onset:
        lying = _is_inconsistent(report, component, params)
        if lying:
            if report.used[component]:
                cost = false_reading_cost(component, params, interval.read[component] - lie)
                score = score._replace(likelihood=score.likelihood - cost)
            after, report = step(state, _mask_component(sample, component), params)
            lie = float(interval.read[component])
    return hypothesis._replace(
        cycle=hypothesis.cycle + 1, state=after, score=score.plus(cycle_score(report)), lying=lying, lie=lie
    )


def cycle_score(report: Report) -> Score:
    """Returns log likelihood, NIS and degrees of freedom that a cycle adds to a hypothesis's score."""
    of_gyros = (report.gyro_nis, report.gyro_degrees) if report.gyro_degrees > 0.0 else (0.0, 0.0)
    return Score(report.log_likelihood, report.nis, report.degrees, *of_gyros)


def known_forces(state: JointState, params: JointParams) -> Array:
    """Returns each jet's estimated failure forces, lbf or N, zero if none: gains, then losses, shape (2 n_jets,)."""
    result = np.zeros(2 * params.places.jets)
    for slot in np.flatnonzero(state.slot_jet >= 0):
        column = int(state.slot_jet[slot]) + (params.places.jets if state.slot_sign[slot] < 0.0 else 0)
        result[column] = max(state.mean[params.places.force + slot], np.finfo(np.float64).tiny)
    return result
