"""One cycle of estimation, defined once: impulses, filter, detector.

    measure   what the commands should have done over the interval, and what the filter measures of it
    judge     what the detector makes of the filter's innovations
    finish    the filter's update, as the detector says

`step` is all three. The systems of a diagram call the same parts one by one; the real-time estimator and the reading
of recorded telemetry call `step` or the parts in turn.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from massprop_drake.maths.arrays import Layout
from massprop_drake.maths.estimation.adaptation import NO_ADAPTATION
from massprop_drake.maths.estimation.detector import NO_KNOWN_FORCE, Detector, Evidence, Judgment, KnownForce
from massprop_drake.maths.estimation.filter import Filter, FilterStep, Groups, Interval, Joint, Told
from massprop_drake.maths.estimation.impulses import Impulses, add_wrench, interval_impulses
from massprop_drake.maths.linear_algebra import Array, has_nonzero, is_covariance
from massprop_drake.maths.mass_properties import MASS_RECIPROCAL, join_ten_parameters
from massprop_drake.maths.vehicle.thrust import LagFactors


class EstimationParams(NamedTuple):
    """Parameters of a cycle.

    Attributes:
        period_s: sample period, s.
        impulse_per_level: torque about the vehicle origin and force of each jet times the period, shape (n_jets, 6).
        lag: of the thrust, as the estimators take it.
        filter, filter_params: the method of estimation.
        detector, detector_params: the method of detection; None: there is none.
        limits: of convergence, see `mass_properties.is_converged`, shape (3,).
    """

    period_s: float
    impulse_per_level: Array
    lag: LagFactors
    filter: Filter
    filter_params: Any
    detector: Detector | None
    detector_params: Any
    limits: Array


class EstimationState(NamedTuple):
    """State of estimation after a cycle: all that the next one needs.

    Attributes:
        command: fraction commanded over the interval before, shape (n_jets,).
        level: thrust level of each jet now, shape (n_jets,).
        filter: see the filter.
        detector: see the detector; None: there is none.
    """

    command: Array
    level: Array
    filter: Any
    detector: Any


class Sample(NamedTuple):
    """Readings at a sample, and the commands to the jets before it.

    Attributes:
        time_s: of the sample, s.
        rates, velocities: readings of the gyro and accelerometer packages, the preferred one first, NaN where
            missing, shape (s, 3) each.
        command: fraction commanded over the interval that ends now, NaN where not known, shape (n_jets,).
        outside_wrench: torque about the vehicle origin and force of known outside forces, mean over that
            interval, shape (6,); None: none.
        stamp_s: when the readings were taken, by the record's clock; None: at `time_s`.
        coming: fraction commanded from now on; None: not known yet.
        tracked: what is read besides, see `Told`; None: nothing.
        onset_s, coming_onset_s: see `Told`.
    """

    time_s: float
    rates: Array
    velocities: Array
    command: Array
    outside_wrench: Array | None = None
    stamp_s: float | None = None
    coming: Array | None = None
    tracked: Array | None = None
    onset_s: Array | None = None
    coming_onset_s: Array | None = None


class Measured(NamedTuple):
    """Outcome of the first part of a cycle.

    Attributes:
        interval: see `filter.Interval`.
        measurement: see the filter.
    """

    interval: Interval
    measurement: Any


class EstimationStep(NamedTuple):
    """Outcome of one whole cycle.

    Attributes:
        state: to go on from.
        interval: see `filter.Interval`.
        filtered: see `filter.FilterStep`.
        judgment: see `detector.Judgment`; None without a detector.
    """

    state: EstimationState
    interval: Interval
    filtered: FilterStep
    judgment: Judgment | None


ESTIMATORS, DETECTOR = "estimators", "detector"  # parts of a cycle
_ROUNDING = 1e-12  # of a level
_DIAGONAL = (0, 1, 2)  # of the inverse inertia, among the ten parameters
_IMPOSSIBLE = 6.0  # sigmas below zero: readings leave a mass or a moment of inertia there once in 1e9 runs
_NOTHING_OUTSIDE = np.zeros(6)
MEMORY = Layout("memory", command="jets", level="jets")  # of the impulse model


def initial_state(params: EstimationParams) -> EstimationState:
    """Returns the estimation's state before the first sample: jets off, filter and detector initial."""
    off = np.zeros(params.impulse_per_level.shape[0])
    detector = None if params.detector is None else params.detector.initial(params.detector_params)
    return EstimationState(off, off, params.filter.initial(params.filter_params), detector)


def measure(state: EstimationState, sample: Sample, params: EstimationParams) -> Measured:
    """Computes the jets' impulses in a sample's interval, and the filter's innovations: a cycle's first part."""
    outside = None if sample.outside_wrench is None else sample.outside_wrench * params.period_s
    impulses = interval_impulses(
        sample.command, state.command, state.level, params.impulse_per_level, params.lag, outside
    )
    known = known_force(state, sample, params)
    if known.acts:
        impulses = add_wrench(impulses, known.wrench, params.period_s)
    interval = Interval(impulses, known, collect_thrust_inputs(sample))
    measurement = params.filter.measure(state.filter, sample.rates, sample.velocities, interval, params.filter_params)
    return Measured(interval, measurement)


def collect_thrust_inputs(sample: Sample) -> Told:
    """Collects commands, times, outside wrench and tracked readings for filters with their own thrust model."""
    stamp_s = sample.time_s if sample.stamp_s is None else sample.stamp_s
    outside = _NOTHING_OUTSIDE if sample.outside_wrench is None else sample.outside_wrench
    onsets_s = sample.onset_s, sample.coming_onset_s
    return Told(sample.time_s, stamp_s, sample.command, sample.coming, outside, sample.tracked, *onsets_s)


def known_force(state: EstimationState, sample: Sample, params: EstimationParams) -> KnownForce:
    """Computes the wrench of declared failed jets' known forces, and the covariances it adds to both increments."""
    if params.detector is None or not has_nonzero(state.detector.variance):
        return NO_KNOWN_FORCE
    predicted = params.filter.predicted(state.filter)
    return params.detector.known_force(state.detector, predicted, sample.command, params.detector_params)


def judge(state: EstimationState, sample: Sample, measured: Measured, params: EstimationParams) -> Judgment:
    """Runs the detector, which must exist, on a sample's innovations; returns its judgment."""
    assert params.detector is not None
    filter_evidence = params.filter.evidence(state.filter, measured.measurement, measured.interval)
    evidence = filter_evidence
    if isinstance(filter_evidence, Joint):
        evidence = make_evidence(sample.time_s, sample.command, measured.interval.impulses, filter_evidence)
    return params.detector.judge(state.detector, evidence, params.detector_params)


def make_evidence(time_s: float, command: Array, impulses: Impulses, innovations: Joint) -> Evidence:
    """Makes the detector's evidence from the filter's innovations, the command and the interval's impulses."""
    return Evidence(time_s, command, impulses.usable, impulses.firing, *innovations)


def finish(
    state: EstimationState, sample: Sample, measured: Measured, judgment: Judgment | None, params: EstimationParams
) -> EstimationStep:
    """Updates the filter as the detector judged the sample; returns the cycle's result with the next state."""
    interval, measurement = measured
    adaptation = NO_ADAPTATION if judgment is None else judgment.adaptation
    filtered = params.filter.finish(state.filter, measurement, interval, adaptation, params.filter_params)
    if judgment is not None and judgment.replacement is not None:
        filtered = params.filter.replaced(filtered, judgment.replacement, params.filter_params)
    if judgment is not None and judgment.published is not None:
        filtered = params.filter.published(filtered, judgment.published, params.filter_params)
    after = EstimationState(
        sample.command, interval.impulses.level, filtered.state, None if judgment is None else judgment.state
    )
    return EstimationStep(after, interval, filtered, judgment)


def _call_directly(_part: str, function: Callable[..., Any], *arguments: Any) -> Any:
    """Calls a function with its arguments: the default of `step`, which does not time the parts of a cycle."""
    return function(*arguments)


def step(
    state: EstimationState, sample: Sample, params: EstimationParams, call: Callable[..., Any] = _call_directly
) -> EstimationStep:
    """Advances filter and detector by one sample: measures, judges and updates.

    Args:
        call: calls a part of it, of `ESTIMATORS` or the `DETECTOR`, with its arguments, and may take the time.

    Raises:
        NotPositiveDefiniteError: when a covariance loses definiteness.
    """
    measured = call(ESTIMATORS, measure, state, sample, params)
    judgment = None if params.detector is None else call(DETECTOR, judge, state, sample, measured, params)
    result: EstimationStep = call(ESTIMATORS, finish, state, sample, measured, judgment, params)
    return result


def estimate_and_covariance(state: EstimationState, params: EstimationParams) -> tuple[Array, Array]:
    """Returns estimate and covariance of the ten parameters in the filter's state, shapes (10,) and (10, 10)."""
    return params.filter.predicted(state.filter), params.filter.covariance(state.filter)


def reported_estimate(result: EstimationStep) -> tuple[Array, Array]:
    """Returns estimate and 1-sigma of the ten parameters after a cycle, NaN if not observed, shape (10,) each."""
    rotation, mass = result.filtered.rotation, result.filtered.mass
    reciprocal, deviation = (math.nan, math.nan) if mass is None else (mass.mass_reciprocal, math.sqrt(mass.variance))
    deviations = join_ten_parameters(rotation.standard_deviation, deviation)
    return join_ten_parameters(rotation.estimate, reciprocal), deviations


def save_state(state: EstimationState, params: EstimationParams) -> Groups:
    """Packs the estimation's state into vectors, by the name of the diagram's system that holds each."""
    memory = MEMORY.sized(jets=state.level.size).pack((state.command, state.level))
    groups = {"impulse_model": memory, **params.filter.saved(state.filter, params.filter_params)}
    if params.detector is not None:
        groups[params.detector.group] = params.detector.pack_state(state.detector, params.detector_params)
    return groups


def restore_state(groups: Groups, params: EstimationParams) -> EstimationState:
    """Makes the estimation's state from vectors: the inverse of `save_state`.

    Raises:
        ValueError: when no run can have left such a state.
    """
    memory = MEMORY.sized(jets=params.impulse_per_level.shape[0]).read(groups["impulse_model"])
    if ((groups["impulse_model"] < 0.0) | (groups["impulse_model"] > 1.0 + _ROUNDING)).any():  # NaN: not known
        raise ValueError("impulse_model: commands and levels must be fractions of 0 to 1")
    detector = None
    if params.detector is not None:
        detector = params.detector.unpack_state(groups[params.detector.group], params.detector_params)
    state = params.filter.restored(groups, params.filter_params)
    initial_variances = params.filter.covariance(params.filter.initial(params.filter_params)).diagonal()
    _require_possible_estimates(params.filter.predicted(state), params.filter.covariance(state), initial_variances)
    return EstimationState(memory.command, memory.level, state, detector)


def _require_possible_estimates(estimate: Array, covariance: Array, initial_variances: Array) -> None:
    """Raises ValueError for ten parameters, or a covariance of them, that no run can leave.

    Args:
        estimate, covariance: shapes (10,) and (10, 10).
        initial_variances: NaN for what is not observed, shape (10,).
    """
    observed = ~np.isnan(initial_variances)
    if not np.isfinite(estimate[observed]).all():
        raise ValueError("estimates must be finite")
    if not is_covariance(covariance[np.ix_(observed, observed)]):
        raise ValueError("the covariance of the estimates must be symmetric and positive semidefinite")
    variances = covariance.diagonal()
    if (variances[initial_variances > 0.0] == 0.0).any():
        raise ValueError(
            "the covariance of the estimates must be positive definite: what is estimated is never certain"
        )
    scales = observed & np.isin(np.arange(estimate.size), (*_DIAGONAL, MASS_RECIPROCAL))
    if (estimate[scales] < -_IMPOSSIBLE * np.sqrt(variances[scales])).any():
        raise ValueError("the inverse inertia's diagonal and 1/m cannot be negative beyond their 1-sigma")
