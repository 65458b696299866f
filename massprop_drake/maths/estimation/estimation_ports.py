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
def impulses(memory: Array, command: Array, outside: Array, held: Any) -> Array:
    """Computes impulses and flags of an interval (8), then jets' mean and last levels, shape (8 + 2 n_jets,).

    Args:
        memory: packed as `cycle.MEMORY`.
        command: see `interval_impulses`.
        outside: wrench of known outside forces, shape (6,).
        held: holder of `Lagging`.
    """
    given, jets = held.value, command.size
    done = interval_impulses(
        command, memory[:jets], memory[jets:], given.impulse_per_level, given.lag, outside * given.period_s
    )
    row = np.empty(_IMPULSES + 2 * jets)
    angular, linear = done.angular_impulse, done.linear_impulse
    fill(row, (angular, linear, done.usable, done.firing, done.mean_level, done.level))
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
def measure_rotation(vector: Array, rates: Array, told: Array, force: Array, held: Any) -> Array:
    """Computes a sample's rotation innovation and predictions, packed as `Turned`, then `RotationSeen`.

    Args:
        vector: state, packed as `thesis.ROTATION_STATE`.
        rates: readings of the gyros, shape (s, 3), of which the first that is there counts.
        told: impulses, packed as `impulses.LAYOUT`.
        force: that is known, packed as `detector.KNOWN_FORCE`.
        held: holder of `Rotating`.

    Raises:
        NotPositiveDefiniteError: when a covariance loses definiteness.
    """
    given = held.value
    before, acted = read_bundle(vector, given.state), read_bundle(told, given.heard.acted)
    known = read_bundle(force, given.heard.known)
    state = RotationState(before.estimate, before.covariance, None)
    acting = acted.firing or bool(known.wrench.any() or known.translation_spread.any())
    angular, linear = acted.angular_impulse, acted.linear_impulse
    interval = RotationInterval(angular, linear, acting, known.rotation_spread, None)
    memory = RotationMemory(before.rates, before.subtract_coupling)
    sample, innovation = rotation_filter.measure_one(state, memory, rates, interval, given.params)
    said = thesis.make_turning(state, sample, innovation)
    row = np.empty(_TURNING + _N_ROTATION_SEEN + rates.size)
    fill(row, (said.innovation, said.innovation_covariance, said.increment, said.rate, said.rate_variance))
    fill(row[_PREDICTION:], (said.estimate, said.covariance, said.cross_covariance))
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
def finish_rotation(measured: Array, adaptation: Array, held: Any) -> Array:
    """Updates the rotation filter; returns its log row, packed as `ROTATION_REPORT`, then its state.

    Args:
        measured: what `measure_rotation` gave.
        adaptation: packed as `adaptation.LAYOUT`.
        held: holder of `Rotating`.
    """
    given = held.value
    said, seen = read_bundle(measured, given.turned), read_bundle(measured[_TURNING:], given.seen)
    sample = RotationSample(
        said.increment,
        said.rate,
        seen.noise,
        said.rate_variance,
        seen.angular_impulse,
        seen.linear_impulse,
        seen.acting,
        None,
    )
    innovation = RotationInnovation(
        said.innovation,
        said.innovation_covariance,
        seen.information,
        seen.jacobian,
        seen.spread,
        None,
        seen.subtract_coupling,
        seen.nis,
    )
    todo, state = read_bundle(adaptation, given.heard.adaptation), RotationState(said.estimate, said.covariance, None)
    cycle = rotation_filter.finish_one(state, (sample, innovation), seen.learning, todo, given.params)
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
def measure_mass(vector: Array, velocities: Array, turned: Array, told: Array, force: Array, held: Any) -> Array:
    """Computes both filters' innovations for the detector, packed as `filter.JOINT`, then `MassSeen`.

    Args:
        vector: state, packed as `thesis.MASS_STATE`.
        velocities: readings of the accelerometers, shape (s, 3), of which the first that is there counts.
        turned: what the rotation filter says, packed as `Turned`.
        told, force: as in `measure_rotation`.
        held: holder of `Weighing`.

    Raises:
        NotPositiveDefiniteError: when a covariance loses definiteness.
    """
    given = held.value
    before, said = read_bundle(vector, given.state), read_bundle(turned, given.turned)
    acted, known = read_bundle(told, given.heard.acted), read_bundle(force, given.heard.known)
    state = MassState(before.mass_reciprocal, before.variance, before.window, None)
    turning = Turning(
        said.innovation,
        said.innovation_covariance,
        said.increment,
        said.rate,
        said.rate_variance,
        said.estimate,
        said.covariance,
        said.cross_covariance,
        None,
        None,
    )
    interval = MassInterval(acted.linear_impulse, known.translation_spread, None)
    both, rotation = (before.velocities, velocities), thesis.rotation_inputs(turning)
    sample, innovation = mass_filter.measure_one(state, both, interval, rotation, given.params)
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
def finish_mass(measured: Array, adaptation: Array, held: Any) -> Array:
    """Updates the mass filter; returns its log row, packed as `MASS_REPORT`, then its state.

    Args:
        measured: what `measure_mass` gave.
        adaptation: packed as `adaptation.LAYOUT`.
        held: holder of `Weighing`.
    """
    given = held.value
    seen, todo = read_bundle(measured[_EVIDENCE:], given.seen), read_bundle(adaptation, given.heard.adaptation)
    sample = MassSample(seen.measured, seen.noise, seen.linear_impulse, None)
    innovation = MassInnovation(seen.innovation, seen.covariance, seen.information, seen.spread, None, seen.nis)
    state = MassState(seen.mass_reciprocal, seen.variance, seen.window, None)
    cycle = mass_filter.finish_one(state, (sample, innovation), (seen.usable, seen.firing), todo, given.params)
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
def known_force(vector: Array, predicted: Array, command: Array, held: Any) -> Array:
    """Computes wrench and covariances of failed jets' known forces, packed as `detector.KNOWN_FORCE`.

    Args:
        vector: state, packed as `cglr.LAYOUT`.
        predicted: the ten parameters, shape (10,).
        command: see `known_forces.known_force`.
        held: holder of `Judging`.
    """
    given = held.value
    row = np.empty(_KNOWN)
    fill(row, acting_force(read_bundle(vector, given.state), predicted, command, given.params))
    return row


@kernel
def run_detector(vector: Array, time_s: float, command: Array, told: Array, seen: Array, held: Any) -> Array:
    """Runs one cycle of the detector on packed vectors; returns its packed state, adaptation and log values.

    Args:
        vector: state, packed as `cglr.LAYOUT`.
        time_s, command: see `detector.Evidence`.
        told: impulses, packed as `impulses.LAYOUT`.
        seen: by the filters, packed as `filter.JOINT`.
        held: holder of `Judging`.

    Returns:
        One after the other: adaptation, packed as its layout; whether a failure was declared; wrench of known forces
        (6); the state; the fields of `STATUS`; likelihood, magnitude, and known force before the sample and its
        variance, of each jet.

    Raises:
        NotPositiveDefiniteError: when a covariance loses definiteness.
    """
    given = held.value
    state, acted = read_bundle(vector, given.state), read_bundle(told, given.acted)
    joint = read_bundle(seen, given.joint)
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
    done = cglr.run_cycle(state, evidence, given.params)
    after, jets = done.state, command.size
    row = np.empty(_ADAPTATION + 1 + _WRENCH + vector.size + _STATUS + 4 * jets)
    fill(row, done.adaptation)
    begin = _ADAPTATION
    row[begin] = done.finding.event == _DECLARED
    fill(row[begin + 1 :], (after.force @ given.params.unit_wrenches,))
    begin += 1 + _WRENCH
    fill(row[begin:], after)
    begin += vector.size
    fill(row[begin:], cglr.status_values(done))
    fill(row[begin + _STATUS :], (done.tests.likelihood, done.tests.magnitude, state.force, state.variance))
    return row
