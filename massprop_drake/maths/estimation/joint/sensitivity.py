r"""Propagation of an unmodeled error through the joint estimator: the cycle, linearized, kept as a `Link`.

If what the filter leaves out has put it off by x before an interval and acts on (w, c) by b over it, it is off by

    x- = Phi x + b,    its innovation by H x-,    and after the update by x = x- - K H x-,

with the filter's own Phi, H and K; where stamps are off their ticks, x is corrected for the stamp before that alike.
So one run of the filter is enough for any number of hypotheses about what it leaves out (Willsky and Jones 1976,
Friedland 1969): each is a column x, and the innovations that it would have had are e - H x- f for a force f. This is
exact but for products of x with what the filter learns from it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from massprop_drake.maths.arrays import NUMBER, Layout
from massprop_drake.maths.estimation.joint.crossing import Crossing
from massprop_drake.maths.estimation.joint.disturbance_states import Wander, disturbance_noise_root
from massprop_drake.maths.estimation.joint.joint_cycle import Course, Report
from massprop_drake.maths.estimation.joint.joint_sample import JointSample
from massprop_drake.maths.estimation.joint.lagged_impulses import effects_of
from massprop_drake.maths.estimation.joint.layout import MASS, RATE, VELOCITY, JointParams, JointState, Places
from massprop_drake.maths.estimation.joint.measurement import readings
from massprop_drake.maths.estimation.joint.swing import Swung
from massprop_drake.maths.estimation.joint.ticks import Stamped
from massprop_drake.maths.kernels import kernel
from massprop_drake.maths.linear_algebra import Array


class Link(NamedTuple):
    """Linearized cycle of the filter.

    Attributes:
        rate_rows, velocity_rows, attitude, mass_factor, duration_s: see `prediction.Prediction`.
        noise: covariance added to w, c and z, shape (6 + n_slow, 6 + n_slow).
        kept: see `disturbance_states.Wander`.
        swing_rows, shaken: rows and shaken of `swing.Swung`.
        bias_seconds: derivative of the change of c by the accelerometer's bias.
        jacobian: H, shape (m, size).
        gain: K, zero for components that did not count, shape (size, m).
        innovation: e, NaN where missing, shape (m,).
        covariance: of the innovation of all components, rounding taken as noise, shape (m, m).
        used: 1 for components that counted, shape (m,).
        nis, degrees, log_likelihood: see `joint_cycle.Report`.
        correction: of the mean by the update, shape (size,).
        effects: change of w and c per second of each jet's unit force, shape (n_jets, 6).
        amount: seconds of full thrust of each jet, shape (n_jets,).
        read: all readings, NaN where missing, shape (m,).
        crossing_rows, crossing_half_gain, crossing_correction: see `crossing.Crossing`.
        stamp_row, stamp_gain, stamp_correction, ticks_kept: see `ticks.Stamped`; of the stamp, before the interval.
    """

    rate_rows: Array
    velocity_rows: Array
    attitude: Array
    mass_factor: float
    duration_s: float
    noise: Array
    kept: Array
    swing_rows: Array
    shaken: Array
    bias_seconds: float
    jacobian: Array
    gain: Array
    innovation: Array
    covariance: Array
    used: Array
    nis: float
    degrees: float
    log_likelihood: float
    correction: Array
    effects: Array
    amount: Array
    read: Array
    crossing_rows: Array
    crossing_half_gain: Array
    crossing_correction: Array
    stamp_row: Array
    stamp_gain: Array
    stamp_correction: Array
    ticks_kept: float


LINK = Layout(
    "link",
    rate_rows=(3, "size"),
    velocity_rows=(3, "size"),
    attitude=(2, "attitude", 3),
    mass_factor=NUMBER,
    duration_s=NUMBER,
    noise=("disturbed", "disturbed"),
    kept="slow",
    swing_rows=("swing", "size"),
    shaken=("swing", 6),
    bias_seconds=NUMBER,
    jacobian=("outputs", "size"),
    gain=("size", "outputs"),
    innovation="outputs",
    covariance=("outputs", "outputs"),
    used="outputs",
    nis=NUMBER,
    degrees=NUMBER,
    log_likelihood=NUMBER,
    correction="size",
    effects=("jets", 6),
    amount="jets",
    read="outputs",
    crossing_rows=("outputs", "size"),
    crossing_half_gain=("size", "outputs"),
    crossing_correction="size",
    stamp_row="size",
    stamp_gain="size",
    stamp_correction="size",
    ticks_kept=NUMBER,
)


class Traces(NamedTuple):
    """Quantities of a cycle that a link is made of.

    Attributes:
        mean: of the state before the cycle, shape (size,).
        rate_rows, velocity_rows, attitude, mass_factor, noise, wander, swung, duration_s: see `prediction.Prediction`.
        jacobian, projected, innovation, used, variances: see `innovation.Expected`.
        upper, half_gain, correction: see `covariance.Update`; empty, or zero, where no component counted.
        amount: see `Link`.
        read: see `Link`.
        crossing: see `crossing.Crossing`.
        stamp: see `ticks.Stamped`.
        nis, degrees, log_likelihood: see `joint_cycle.Report`.
    """

    mean: Array
    rate_rows: Array
    velocity_rows: Array
    attitude: Array
    mass_factor: float
    noise: Array
    wander: Wander
    swung: Swung
    duration_s: float
    jacobian: Array
    projected: Array
    innovation: Array
    used: np.ndarray
    variances: Array
    upper: Array
    half_gain: Array
    correction: Array
    amount: Array
    read: Array
    crossing: Crossing
    stamp: Stamped
    nis: float
    degrees: float
    log_likelihood: float


@kernel
def collect_cycle_terms(mean: Array, course: Course, sample: JointSample) -> Traces:
    """Collects a filter cycle's derivatives, noise, gain and readings, which `linearize_terms` takes.

    Args:
        mean: of the state before the cycle, shape (size,).
    """
    expected, update = course.expected, course.update
    prediction = expected.prediction
    return Traces(
        mean,
        prediction.rate_rows,
        prediction.velocity_rows,
        prediction.attitude,
        prediction.mass_factor,
        prediction.noise,
        prediction.wander,
        prediction.swung,
        prediction.duration_s,
        expected.jacobian,
        expected.projected,
        expected.innovation,
        expected.used,
        expected.variances,
        update.upper,
        update.half_gain,
        update.correction,
        course.acting.firing.amount,
        readings(sample.rates, sample.velocities, sample.attitudes),
        course.crossing,
        course.stamp,
        course.nis,
        course.degrees,
        course.log_likelihood,
    )


def linearize_cycle(before: JointState, report: Report, sample: JointSample, params: JointParams) -> Link:
    """Returns a cycle linearized for error propagation, from the state before it, its report and sample."""
    assert report.course is not None, "the first sample is no cycle"
    return linearize_terms(collect_cycle_terms(before.mean, report.course, sample), params)


@kernel
def linearize_terms(terms: Traces, params: JointParams) -> Link:
    """Returns a cycle linearized for error propagation, from its derivatives, noise, gain and readings."""
    gain = np.zeros((terms.mean.shape[0], terms.projected.shape[0]))
    counts = np.flatnonzero(terms.used)
    if counts.shape[0] > 0:
        columns = np.linalg.solve(terms.upper, terms.half_gain.T)
        for place in range(counts.shape[0]):
            gain[:, counts[place]] = columns[place]
    return Link(
        rate_rows=terms.rate_rows,
        velocity_rows=terms.velocity_rows,
        attitude=terms.attitude,
        mass_factor=terms.mass_factor,
        duration_s=terms.duration_s,
        noise=_interval_noise(terms, params.places),
        kept=terms.wander.kept,
        swing_rows=terms.swung.rows,
        shaken=terms.swung.shaken,
        bias_seconds=terms.duration_s * params.acceleration_bias_sigma,
        jacobian=terms.jacobian,
        gain=gain,
        innovation=terms.innovation,
        covariance=terms.projected @ terms.projected.T + np.diag(terms.variances),
        used=terms.used.astype(np.float64),
        nis=terms.nis,
        degrees=terms.degrees,
        log_likelihood=terms.log_likelihood,
        correction=terms.correction,
        effects=_jet_effects(terms, params) / params.thrusts.reshape(-1, 1),
        amount=terms.amount,
        read=terms.read,
        crossing_rows=terms.crossing.rows,
        crossing_half_gain=terms.crossing.half_gain,
        crossing_correction=terms.crossing.correction,
        stamp_row=terms.stamp.row,
        stamp_gain=terms.stamp.gain,
        stamp_correction=terms.stamp.correction,
        ticks_kept=terms.stamp.kept,
    )


@kernel
def _jet_effects(terms: Traces, params: JointParams) -> Array:
    """Computes rate and velocity change per second of each jet at full thrust, with modes, shape (n_jets, 6)."""
    effects = effects_of(params.wrenches, terms.mean)
    return effects @ terms.swung.given_back.T if params.places.n_swing > 0 else effects


@kernel
def _interval_noise(terms: Traces, places: Places) -> Array:
    """Computes process noise covariance of rate, velocity, slow states z over an interval, shape (d, d)."""
    if places.n_slow == 0:
        return terms.noise
    columns = disturbance_noise_root(terms.wander)
    noise = columns @ columns.T
    noise[:6, :6] += terms.noise
    return noise


def propagate_crossings(errors: Array, interval: Link, places: Places) -> Array:
    """Propagates errors through updates by pending readings and by the stamp, before prediction, shape (size, h).

    Args:
        errors: errors before that, shape (size, h).
    """
    if interval.crossing_half_gain.any():
        errors = errors - interval.crossing_half_gain @ (interval.crossing_rows @ errors)
    if not interval.stamp_row.any():
        return errors
    kept = errors.copy()
    kept[places.ticks : places.ticks + places.n_ticks] *= interval.ticks_kept
    result: Array = kept - np.outer(interval.stamp_gain, interval.stamp_row @ kept)
    return result


@kernel
def propagate_to_update(columns: Array, forcing: Array, interval: Link, places: Places) -> Array:
    """Propagates state errors over an interval, with rate and velocity forcing, up to the update, shape (size, h).

    Args:
        columns: errors before the interval, shape (size, h).
        forcing: what acts on w and c over it, shape (6, h).
    """
    after = columns.copy()
    after[RATE] += interval.rate_rows @ columns + forcing[:3]
    common = interval.velocity_rows @ columns + forcing[3:]
    for package in range(places.accelerometers):
        part = slice(VELOCITY + 3 * package, VELOCITY + 3 * package + 3)
        after[part] += common
        if places.n_acceleration_bias > 0:
            begin = places.acceleration_bias + 3 * package
            after[part] += interval.bias_seconds * columns[begin : begin + 3]
    if places.n_attitude > 0:
        by_start, by_end = interval.attitude[0], interval.attitude[1]
        after[places.attitude : places.attitude + 3] += by_start @ np.ascontiguousarray(
            columns[RATE]
        ) + by_end @ np.ascontiguousarray(after[RATE])
    after[places.slow : places.slow + places.n_slow] *= interval.kept.reshape(-1, 1)
    if places.n_swing > 0:
        after[places.swing : places.swing + places.n_swing] = interval.swing_rows @ columns + interval.shaken @ forcing
    after[MASS] *= interval.mass_factor
    return after


def propagate_update(columns: Array, innovation_change: Array, interval: Link) -> Array:
    """Propagates columns of errors through the measurement update: less gain times change of the innovation.

    Args:
        columns: errors before it, shape (size, h).
        innovation_change: by these errors, shape (m, h).
    """
    result: Array = columns - interval.gain @ innovation_change
    return result


def unit_force_errors(interval: Link, places: Places) -> Array:
    """Computes state errors by each jet's unit force acting for an interval, shape (size, n_jets)."""
    return impulse_columns(interval.duration_s * interval.effects.T, interval, places)


def impulse_columns(changes: Array, interval: Link, places: Places) -> Array:
    """Computes state errors at an interval's end by changes of rate and velocity at its start, shape (size, n).

    Args:
        changes: rad/s and ft/s or m/s, shape (6, n).
    """
    result = np.zeros((places.size, changes.shape[1]))
    result[RATE] = changes[:3]
    for package in range(places.accelerometers):
        part = slice(VELOCITY + 3 * package, VELOCITY + 3 * package + 3)
        result[part] = changes[3:]
    if places.n_attitude > 0:
        result[places.attitude : places.attitude + 3] = -interval.attitude[0] @ changes[:3]
    result[places.swing : places.swing + places.n_swing] = interval.shaken @ changes
    return result
