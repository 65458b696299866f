"""Kernels of the estimators' systems: from vectors of their ports and states to such vectors.

Each is called by one system of a diagram, with what does not change in a `kernels.Holder`. They pack and unpack; what
they do with it stands in the other files here, in the order of `cycle`. What a filter has measured waits, packed, for
what the detector makes of it.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from massprop_drake.maths.estimation.adaptation import LAYOUT as ADAPTATION
from massprop_drake.maths.estimation.adaptation import NO_ADAPTATION, Adaptation
from massprop_drake.maths.estimation.detector import KNOWN_FORCE, NO_KNOWN_FORCE, STATUS, Evidence, KnownForce, Verdict
from massprop_drake.maths.estimation.detectors import cglr
from massprop_drake.maths.estimation.detectors.cglr import CglrParams, DetectorState
from massprop_drake.maths.estimation.detectors.known_forces import acting_force
from massprop_drake.maths.estimation.filter import JOINT, MASS_REPORT, NOT_MEASURED, ROTATION_REPORT, Joint, empty_joint
from massprop_drake.maths.estimation.filters import mass_filter, rotation_filter, thesis
from massprop_drake.maths.estimation.filters.mass_filter import (
    MassInnovation,
    MassInterval,
    MassParams,
    MassSample,
    MassState,
)
from massprop_drake.maths.estimation.filters.rotation_filter import (
    RotationInnovation,
    RotationInterval,
    RotationMemory,
    RotationParams,
    RotationSample,
    RotationState,
)
from massprop_drake.maths.estimation.filters.thesis import TURNING, Turning
from massprop_drake.maths.estimation.impulses import LAYOUT as IMPULSES
from massprop_drake.maths.estimation.impulses import interval_impulses
from massprop_drake.maths.kernels import fill, kernel, read_bundle
from massprop_drake.maths.linear_algebra import Array
from massprop_drake.maths.mass_properties import N_ROTATION
from massprop_drake.maths.vehicle.thrust import LagFactors

_IMPULSES, _ROTATION_REPORT, _MASS_REPORT = IMPULSES.size, ROTATION_REPORT.size, MASS_REPORT.size
_TURNING, _EVIDENCE, _ADAPTATION, _STATUS = TURNING.sized(jets=0).size, JOINT.size, ADAPTATION.size, STATUS.size
_PREDICTION = TURNING.sized(jets=0).slice("estimate").start
_ROTATION_STATE = thesis.ROTATION_STATE.sized(gyros=0, errors=0).size
_WRENCH, _KNOWN = 6, KNOWN_FORCE.size
_DECLARED = int(Verdict.DECLARED)


# ---------------------------------------------------------------------------------------- impulses


class Lagging(NamedTuple):
    """Parameters that turn commands into impulses; attributes as `cycle.EstimationParams`."""

    impulse_per_level: Array
    lag: LagFactors
    period_s: float


@kernel
def impulses(memory: Array, command: Array, outside_wrench: Array, holder: Any) -> Array:
    """Computes impulses and flags of an interval (8), then jets' mean and last levels, shape (8 + 2 n_jets,).

    Args:
        memory: packed as `cycle.MEMORY`.
        command: see `interval_impulses`.
        outside_wrench: of known outside forces, shape (6,).
        holder: holder of `Lagging`.
    """
    bundle, jets = holder.value, command.size
    interval = interval_impulses(
        command, memory[:jets], memory[jets:], bundle.impulse_per_level, bundle.lag, outside_wrench * bundle.period_s
    )
    row = np.empty(_IMPULSES + 2 * jets)
    angular, linear = interval.angular_impulse, interval.linear_impulse
    fill(row, (angular, linear, interval.usable, interval.firing, interval.mean_level, interval.level))
    return row


# ----------------------------------------------------------------------------------------- filters


class Acted(NamedTuple):
    """Impulses of an interval, packed as `impulses.LAYOUT`; see `Impulses`."""

    angular_impulse: Array
    linear_impulse: Array
    usable: bool
    firing: bool


class Heard(NamedTuple):
    """Templates of the vectors that a filter gets, one of each kind.

    Attributes:
        acted, known, adaptation: see `Acted`, `KnownForce` and `Adaptation`.
    """

    acted: Acted
    known: KnownForce
    adaptation: Adaptation


_THREE, _SQUARE = np.zeros(3), np.zeros((3, 3))
_HEARD = Heard(Acted(_THREE, _THREE, False, False), NO_KNOWN_FORCE, NO_ADAPTATION)


class RotationVector(NamedTuple):
    """State and memory of the rotation filter, packed as `thesis.ROTATION_STATE` where thrust is taken as known."""

    estimate: Array
    covariance: Array
    subtract_coupling: bool
    rates: Array


class Turned(NamedTuple):
    """Prediction of the rotation filter, packed as `thesis.TURNING` where thrust is taken as known."""

    innovation: Array
    innovation_covariance: Array
    increment: Array
    rate: Array
    rate_variance: float
    estimate: Array
    covariance: Array
    cross_covariance: Array


class RotationSeen(NamedTuple):
    """Further data that the rotation filter needs to finish a cycle.

    Attributes:
        noise, angular_impulse, linear_impulse: see `RotationSample`; `acting` is its `firing`.
        information, jacobian, subtract_coupling, nis: see `RotationInnovation`; `spread` is its `noise`.
        learning: whether the filter is to learn of the sample.
        rates: readings of the gyros, shape (s, 3).
    """

    noise: Array
    angular_impulse: Array
    linear_impulse: Array
    acting: bool
    information: Array
    jacobian: Array
    spread: Array
    subtract_coupling: bool
    nis: float
    learning: bool
    rates: Array


class Rotating(NamedTuple):
    """Rotation filter with its templates.

    Attributes:
        params: see `RotationParams`.
        state: at the start.
        turned, seen, heard: of what is packed, each one that is like it.
    """

    params: RotationParams
    state: RotationVector
    turned: Turned
    seen: RotationSeen
    heard: Heard


def make_rotation_filter(params: RotationParams, state: RotationVector) -> Rotating:
    """Bundles the rotation filter's parameters, initial state, and templates of its packed vectors."""
    return Rotating(params, state, _TURNED, _ROTATION_SEEN._replace(rates=state.rates), _HEARD)


_CROSS = np.zeros((3, N_ROTATION))
_TURNED = Turned(_THREE, _SQUARE, _THREE, _THREE, 0.0, np.zeros(N_ROTATION), np.zeros((N_ROTATION, N_ROTATION)), _CROSS)
_ROTATION_SEEN = RotationSeen(_SQUARE, _THREE, _THREE, False, _SQUARE, _CROSS, _SQUARE, False, 0.0, False, np.empty(0))


@kernel
def measure_rotation(state_vector: Array, rates: Array, impulses: Array, known_force: Array, holder: Any) -> Array:
    """Computes the rotation filter's innovation and predictions for a sample, packed as `Turned`, then `RotationSeen`.

    Args:
        state_vector: packed as `thesis.ROTATION_STATE`.
        rates: readings of the gyros, shape (s, 3), of which the first that is there counts.
        impulses: packed as `impulses.LAYOUT`.
        known_force: packed as `detector.KNOWN_FORCE`.
        holder: holder of `Rotating`.

    Raises:
        NotPositiveDefiniteError: when a covariance loses definiteness.
    """
    bundle = holder.value
    before, acted = read_bundle(state_vector, bundle.state), read_bundle(impulses, bundle.heard.acted)
    known = read_bundle(known_force, bundle.heard.known)
    state = RotationState(before.estimate, before.covariance, None)
    acting = acted.firing or bool(known.wrench.any() or known.translation_spread.any())
    angular, linear = acted.angular_impulse, acted.linear_impulse
    interval = RotationInterval(angular, linear, acting, known.rotation_spread, None)
    memory = RotationMemory(before.rates, before.subtract_coupling)
    sample, innovation = rotation_filter.measure_first_usable(state, memory, rates, interval, bundle.params)
    turned = thesis.make_turning(state, sample, innovation)
    row = np.empty(_TURNING + _N_ROTATION_SEEN + rates.size)
    fill(row, (turned.innovation, turned.innovation_covariance, turned.increment, turned.rate, turned.rate_variance))
    fill(row[_PREDICTION:], (turned.estimate, turned.covariance, turned.cross_covariance))
    seen = RotationSeen(
        sample.noise,
        angular,
        linear,
        acting,
        innovation.information,
        innovation.jacobian,
        innovation.noise,
        innovation.subtract_coupling,
        innovation.nis,
        acted.usable and acted.firing,
        rates,
    )
    fill(row[_TURNING:], seen)
    return row


@kernel
def finish_rotation(measurement: Array, adaptation: Array, holder: Any) -> Array:
    """Updates the rotation filter; returns its log row, packed as `ROTATION_REPORT`, then its state.

    Args:
        measurement: result of `measure_rotation`.
        adaptation: packed as `adaptation.LAYOUT`.
        holder: holder of `Rotating`.
    """
    bundle = holder.value
    turned, seen = read_bundle(measurement, bundle.turned), read_bundle(measurement[_TURNING:], bundle.seen)
    sample = RotationSample(
        turned.increment,
        turned.rate,
        seen.noise,
        turned.rate_variance,
        seen.angular_impulse,
        seen.linear_impulse,
        seen.acting,
        None,
    )
    innovation = RotationInnovation(
        turned.innovation,
        turned.innovation_covariance,
        seen.information,
        seen.jacobian,
        seen.spread,
        None,
        seen.subtract_coupling,
        seen.nis,
    )
    todo, state = (
        read_bundle(adaptation, bundle.heard.adaptation),
        RotationState(turned.estimate, turned.covariance, None),
    )
    cycle = rotation_filter.finish_one(state, (sample, innovation), seen.learning, todo, bundle.params)
    after, row = cycle.state, np.empty(_ROTATION_REPORT + _ROTATION_STATE + seen.rates.size)
    fill(row, thesis.rotation_report(innovation, cycle))
    fill(row[_ROTATION_REPORT:], (after.estimate, after.covariance, seen.subtract_coupling, seen.rates))
    return row


class MassVector(NamedTuple):
    """State and memory of the mass filter, packed as `thesis.MASS_STATE` where thrust is taken as known."""

    mass_reciprocal: float
    variance: float
    velocities: Array
    window: Array


class MassSeen(NamedTuple):
    """Data that the mass filter needs to finish a cycle.

    Attributes:
        innovation, information, nis, covariance: see `MassInnovation`; `spread` is its `noise`.
        measured, noise, linear_impulse: see `MassSample`.
        usable, firing: see `Acted`.
        mass_reciprocal, variance, window: before it, see `MassState`.
        velocities: readings of the accelerometers, shape (s, 3).
    """

    innovation: Array
    covariance: Array
    information: Array
    spread: Array
    nis: float
    measured: Array
    noise: Array
    linear_impulse: Array
    usable: bool
    firing: bool
    mass_reciprocal: float
    variance: float
    window: Array
    velocities: Array


class Weighing(NamedTuple):
    """Mass filter with its templates.

    Attributes:
        params: see `MassParams`.
        state: at the start.
        turned, seen, heard: of what is packed, each one that is like it.
    """

    params: MassParams
    state: MassVector
    turned: Turned
    seen: MassSeen
    heard: Heard


def make_mass_filter(params: MassParams, state: MassVector) -> Weighing:
    """Bundles the mass filter's parameters, initial state, and templates of its packed vectors."""
    seen = _MASS_SEEN._replace(window=state.window, velocities=state.velocities)
    return Weighing(params, state, _TURNED, seen, _HEARD)


_MASS_SEEN = MassSeen(
    _THREE, _SQUARE, _SQUARE, _SQUARE, 0.0, _THREE, _SQUARE, _THREE, False, False, 0.0, 0.0, np.empty(0), np.empty(0)
)


def _count_numbers(bundle: tuple[Any, ...]) -> int:
    """Counts the numbers in all arrays of a tuple."""
    return sum(np.size(field) for field in bundle)


# besides readings and the window
_N_ROTATION_SEEN, _N_MASS_SEEN = _count_numbers(_ROTATION_SEEN), _count_numbers(_MASS_SEEN)


@kernel
def measure_mass(
    state_vector: Array, velocities: Array, rotation_prediction: Array, impulses: Array, known_force: Array, holder: Any
) -> Array:
    """Computes the mass filter's innovation; returns both filters', packed as `filter.JOINT`, then `MassSeen`.

    Args:
        state_vector: packed as `thesis.MASS_STATE`.
        velocities: readings of the accelerometers, shape (s, 3), of which the first that is there counts.
        rotation_prediction: of the rotation filter, packed as `Turned`.
        impulses, known_force: as in `measure_rotation`.
        holder: holder of `Weighing`.

    Raises:
        NotPositiveDefiniteError: when a covariance loses definiteness.
    """
    bundle = holder.value
    before, turned = read_bundle(state_vector, bundle.state), read_bundle(rotation_prediction, bundle.turned)
    acted, known = read_bundle(impulses, bundle.heard.acted), read_bundle(known_force, bundle.heard.known)
    state = MassState(before.mass_reciprocal, before.variance, before.window, None)
    turning = Turning(
        turned.innovation,
        turned.innovation_covariance,
        turned.increment,
        turned.rate,
        turned.rate_variance,
        turned.estimate,
        turned.covariance,
        turned.cross_covariance,
        None,
        None,
    )
    interval = MassInterval(acted.linear_impulse, known.translation_spread, None)
    both, rotation = (before.velocities, velocities), thesis.rotation_inputs(turning)
    sample, innovation = mass_filter.measure_first_usable(state, both, interval, rotation, bundle.params)
    row = np.empty(_EVIDENCE + _N_MASS_SEEN + before.window.size + before.velocities.size)
    if acted.usable:
        fill(row, thesis.join_innovations(turning, sample, innovation, state))
    else:
        fill(row, empty_joint())
    seen = MassSeen(
        innovation.innovation,
        innovation.covariance,
        innovation.information,
        innovation.noise,
        innovation.nis,
        sample.measured,
        sample.noise,
        acted.linear_impulse,
        acted.usable,
        acted.firing,
        state.mass_reciprocal,
        state.variance,
        state.window,
        velocities,
    )
    fill(row[_EVIDENCE:], seen)
    return row


@kernel
def finish_mass(measurement: Array, adaptation: Array, holder: Any) -> Array:
    """Updates the mass filter; returns its log row, packed as `MASS_REPORT`, then its state.

    Args:
        measurement: result of `measure_mass`.
        adaptation: packed as `adaptation.LAYOUT`.
        holder: holder of `Weighing`.
    """
    bundle = holder.value
    seen, todo = read_bundle(measurement[_EVIDENCE:], bundle.seen), read_bundle(adaptation, bundle.heard.adaptation)
    sample = MassSample(seen.measured, seen.noise, seen.linear_impulse, None)
    innovation = MassInnovation(seen.innovation, seen.covariance, seen.information, seen.spread, None, seen.nis)
    state = MassState(seen.mass_reciprocal, seen.variance, seen.window, None)
    cycle = mass_filter.finish_one(state, (sample, innovation), (seen.usable, seen.firing), todo, bundle.params)
    after, row = cycle.state, np.empty(_MASS_REPORT + 2 + seen.velocities.size + seen.window.size)
    fill(row, thesis.mass_report(innovation, cycle))
    fill(row[_MASS_REPORT:], (after.mass_reciprocal, after.variance, seen.velocities, after.window))
    return row


# ---------------------------------------------------------------------------------------- detector


class Judging(NamedTuple):
    """Detector with its templates.

    Attributes:
        params: see `CglrParams`.
        state: at the start.
        joint, acted: of vectors that it gets, each one that is like it.
    """

    params: CglrParams
    state: DetectorState
    joint: Joint
    acted: Acted


def make_detector(params: CglrParams) -> Judging:
    """Bundles the CGLR detector's parameters, initial state, and templates of its packed vectors."""
    return Judging(params, cglr.DETECTOR.initial(params), NOT_MEASURED, _HEARD.acted)


@kernel
def known_force(state_vector: Array, predicted_parameters: Array, command: Array, holder: Any) -> Array:
    """Computes wrench and covariances of failed jets' known forces, packed as `detector.KNOWN_FORCE`.

    Args:
        state_vector: packed as `cglr.LAYOUT`.
        predicted_parameters: the ten, shape (10,).
        command: see `known_forces.known_force`.
        holder: holder of `Judging`.
    """
    bundle = holder.value
    row = np.empty(_KNOWN)
    fill(row, acting_force(read_bundle(state_vector, bundle.state), predicted_parameters, command, bundle.params))
    return row


@kernel
def run_detector(
    state_vector: Array, time_s: float, command: Array, impulses: Array, innovations: Array, holder: Any
) -> Array:
    """Runs one cycle of the detector on packed vectors; returns its packed state, adaptation and log values.

    Args:
        state_vector: packed as `cglr.LAYOUT`.
        time_s, command: see `detector.Evidence`.
        impulses: packed as `impulses.LAYOUT`.
        innovations: of both filters, packed as `filter.JOINT`.
        holder: holder of `Judging`.

    Returns:
        One after the other: adaptation, packed as its layout; whether a failure was declared; wrench of known forces
        (6); the state; the fields of `STATUS`; likelihood, magnitude, and known force before the sample and its
        variance, of each jet.

    Raises:
        NotPositiveDefiniteError: when a covariance loses definiteness.
    """
    bundle = holder.value
    state, acted = read_bundle(state_vector, bundle.state), read_bundle(impulses, bundle.acted)
    joint = read_bundle(innovations, bundle.joint)
    evidence = Evidence(
        time_s,
        command,
        acted.usable,
        acted.firing,
        joint.innovation,
        joint.covariance,
        joint.coupled,
        joint.estimate,
        joint.estimate_covariance,
        joint.cross_covariance,
    )
    done = cglr.run_cycle(state, evidence, bundle.params)
    after, jets = done.state, command.size
    row = np.empty(_ADAPTATION + 1 + _WRENCH + state_vector.size + _STATUS + 4 * jets)
    fill(row, done.adaptation)
    begin = _ADAPTATION
    row[begin] = done.finding.event == _DECLARED
    fill(row[begin + 1 :], (after.force @ bundle.params.unit_wrenches,))
    begin += 1 + _WRENCH
    fill(row[begin:], after)
    begin += state_vector.size
    fill(row[begin:], cglr.status_values(done))
    fill(row[begin + _STATUS :], (done.tests.likelihood, done.tests.magnitude, state.force, state.variance))
    return row
