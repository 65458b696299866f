"""A whole cycle of the thesis's filters and the CGLR as one kernel: the parts of `cycle` in the same order.

What a cycle keeps stays within a `kernels.Holder`, and what is logged of it goes straight into rows, so that compiled
code meets Python once a cycle, or once for all rows of a record that are read together.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from massprop_drake.maths.estimation.adaptation import Adaptation, passive_adaptation
from massprop_drake.maths.estimation.cycle import EstimationParams, EstimationState
from massprop_drake.maths.estimation.detector import STATUS, Evidence, KnownForce, Verdict
from massprop_drake.maths.estimation.detectors import cglr
from massprop_drake.maths.estimation.detectors.cglr import CglrParams, DetectorState
from massprop_drake.maths.estimation.detectors.known_forces import acting_force
from massprop_drake.maths.estimation.filter import empty_joint
from massprop_drake.maths.estimation.filters import mass_filter, rotation_filter, thesis
from massprop_drake.maths.estimation.filters.mass_filter import MassInterval, MassParams
from massprop_drake.maths.estimation.filters.rotation_filter import RotationInterval, RotationMemory, RotationParams
from massprop_drake.maths.estimation.filters.thesis import ThesisState
from massprop_drake.maths.estimation.impulses import add_wrench, interval_impulses
from massprop_drake.maths.kernels import fill, kernel
from massprop_drake.maths.linear_algebra import Array, has_nonzero
from massprop_drake.maths.mass_properties import join_ten_parameters
from massprop_drake.maths.vehicle.thrust import LagFactors

_EVENT, _DECLARED = STATUS.slice("detector_event").start, float(Verdict.DECLARED)
_OF_JETS = STATUS.size  # where the part with an element per jet begins in what is logged of the detector


class WholeParams(NamedTuple):
    """Parameters of a whole cycle.

    Attributes:
        period_s, impulse_per_level, lag: see `cycle.EstimationParams`.
        rotation, mass: of the filters.
        detector: see `CglrParams`; None: there is none.
    """

    period_s: float
    impulse_per_level: Array
    lag: LagFactors
    rotation: RotationParams
    mass: MassParams
    detector: CglrParams | None


class ThesisRows(NamedTuple):
    """Log rows, one per cycle, as the layouts of the same names have them; one row of no cycle is empty."""

    impulses: Array
    rotation_report: Array
    mass_report: Array
    detector_report: Array


class Samples(NamedTuple):
    """Samples one after the other, see `cycle.Sample`.

    Attributes:
        time_s: shape (n,).
        rates, velocities: shape (n, s, 3) each.
        commands: over the interval that ends, shape (n, n_jets).
        outside: known torque about the vehicle origin and force, mean over that interval, shape (n, 6).
    """

    time_s: Array
    rates: Array
    velocities: Array
    commands: Array
    outside: Array


def allocate_sample(gyros: int, accelerometers: int, n_jets: int) -> Samples:
    """Allocates a block of one sample, zeros, for a number of gyros, accelerometers and jets."""
    velocities = np.zeros((1, accelerometers, 3))
    return Samples(np.zeros(1), np.zeros((1, gyros, 3)), velocities, np.zeros((1, n_jets)), np.zeros((1, 6)))


class ThesisAsked(NamedTuple):
    """Requests of the detector to the autopilot and the jets, written in place; zeros without one.

    Attributes:
        declared: 1 when a failure was declared in the last cycle, shape (1,).
        force, removed, closed: see `detector.Detector`, shape (n_jets,) each.
    """

    declared: Array
    force: Array
    removed: Array
    closed: Array


def empty_requests(n_jets: int) -> ThesisAsked:
    """Allocates the detector's requests as zeros, to be written in place."""
    return ThesisAsked(np.zeros(1), np.zeros(n_jets), np.zeros(n_jets), np.zeros(n_jets))


class ThesisBlock(NamedTuple):
    """Rows that cycles go through one after the other.

    Attributes:
        samples: one a row.
        rows: to be filled in.
        asked: after the last cycle.
    """

    samples: Samples
    rows: ThesisRows
    asked: ThesisAsked


def covers(params: EstimationParams) -> bool:
    """Tests whether the compiled kernel can run cycles with given filters, sensor packages and detector."""
    filter_params = params.filter_params
    return (
        params.filter is thesis.FILTER
        and filter_params.mass is not None
        and rotation_filter.uses_one_package(filter_params.rotation)
        and mass_filter.uses_one_package(filter_params.mass)
        and filter_params.thrust_errors is None
        and (params.detector is None or params.detector is cglr.DETECTOR)
    )


def kernel_params(params: EstimationParams) -> WholeParams:
    """Makes the compiled kernel's parameters from those of an estimation that it covers."""
    filter_params = params.filter_params
    return WholeParams(
        params.period_s,
        params.impulse_per_level,
        params.lag,
        filter_params.rotation,
        filter_params.mass,
        params.detector_params,
    )


@kernel
def advance(state_holder: Any, block_holder: Any, row_range: NDArray[np.int_], params_holder: Any) -> None:
    """Runs cycles of filters and detector over rows; writes their log rows, and the requests after the last.

    Args:
        state_holder: of the state, see `cycle.EstimationState`.
        block_holder: of a `ThesisBlock`.
        row_range: the row that is being made, and that before which to stop, shape (2,).
        params_holder: of `WholeParams`.

    Raises:
        NotPositiveDefiniteError: when a covariance loses definiteness.
    """
    state, block, params = state_holder.value, block_holder.value, params_holder.value
    while row_range[0] < row_range[1]:
        state = step_cycle(state, block.samples, row_range[0], (block.rows, row_range[0]), params)
        state_holder.value = state
        row_range[0] += 1
    _write_requests(block.asked, state.detector, block.rows.detector_report, row_range[0] - 1)


@kernel
def run_cycle(state: EstimationState, block: ThesisBlock, row: int, params: WholeParams) -> EstimationState:
    """Runs a cycle on one row; writes its log row and the detector's requests, and returns the state.

    Raises:
        NotPositiveDefiniteError: when a covariance loses definiteness.
    """
    after = step_cycle(state, block.samples, row, (block.rows, row), params)
    _write_requests(block.asked, after.detector, block.rows.detector_report, row)
    return after


@kernel
def step_cycle(
    state: EstimationState, samples: Samples, sample_index: int, log_target: tuple[ThesisRows, int], params: WholeParams
) -> EstimationState:
    """Runs a cycle of both filters and the detector on a sample; writes its log rows, returns the state."""
    filters, command = state.filter, samples.commands[sample_index].copy()  # rows may be written to again
    rates, velocities = samples.rates[sample_index].copy(), samples.velocities[sample_index].copy()
    # measure
    outside = samples.outside[sample_index] * params.period_s
    impulses = interval_impulses(command, state.command, state.level, params.impulse_per_level, params.lag, outside)
    acts, known = _known_force(state.detector, filters, command, params.detector)
    if acts:
        impulses = add_wrench(impulses, known.wrench, params.period_s)
    angular, linear = impulses.angular_impulse, impulses.linear_impulse
    acting = impulses.firing or acts
    interval = RotationInterval(angular, linear, acting, known.rotation_spread, None)
    turned, turning = rotation_filter.measure_first_usable(
        filters.rotation, filters.memory, rates, interval, params.rotation
    )
    told = thesis.make_turning(filters.rotation, turned, turning)
    pushed, both = MassInterval(linear, known.translation_spread, None), (filters.velocities, velocities)
    moved, moving = mass_filter.measure_first_usable(
        filters.mass, both, pushed, thesis.rotation_inputs(told), params.mass
    )
    # judge
    joint = _evidence(impulses.usable, told, moved, moving, filters.mass)
    evidence = Evidence(
        samples.time_s[sample_index],
        command,
        impulses.usable,
        impulses.firing,
        joint.innovation,
        joint.covariance,
        joint.coupled,
        joint.estimate,
        joint.estimate_covariance,
        joint.cross_covariance,
    )
    rows, row = log_target
    detector, adaptation = _run_detector(state.detector, evidence, rows.detector_report, row, params.detector)
    # finish
    usable, firing = impulses.usable, impulses.firing
    learning = usable and firing
    rotation = rotation_filter.finish_one(filters.rotation, (turned, turning), learning, adaptation, params.rotation)
    mass = mass_filter.finish_one(filters.mass, (moved, moving), (usable, firing), adaptation, params.mass)
    fill(rows.impulses[row], (angular, linear, impulses.usable, impulses.firing))
    fill(rows.rotation_report[row], thesis.rotation_report(turning, rotation))
    fill(rows.mass_report[row], thesis.mass_report(moving, mass))
    memory = RotationMemory(rates, turning.subtract_coupling)
    after = ThesisState(rotation.state, memory, mass.state, velocities)
    return EstimationState(command, impulses.level, after, detector)


@kernel
def _evidence(usable: bool, rotation: Any, mass_sample: Any, mass_innovation: Any, mass_state: Any) -> Any:
    """Returns both filters' joined innovations; NaN and zeros where the sample is not usable."""
    if usable:
        return thesis.join_innovations(rotation, mass_sample, mass_innovation, mass_state)
    return empty_joint()


@kernel
def _known_force(state: Any, filters: Any, command: Array, params: CglrParams | None) -> tuple[bool, KnownForce]:
    """Computes the wrench of failed jets' known forces, with the covariances it adds, and whether there is any."""
    if params is None:
        return False, _no_force()
    return _acting_known_force(state, filters, command, params)


@kernel
def _no_force() -> KnownForce:
    """Makes a known force of zero wrench and covariances."""
    return KnownForce(np.zeros(6), np.zeros((3, 3)), np.zeros((3, 3)))


@kernel
def _acting_known_force(
    state: DetectorState, filters: Any, command: Array, params: CglrParams
) -> tuple[bool, KnownForce]:
    """Computes the effect of known forces that a detector holds; returns whether there is any, and the effect."""
    if not has_nonzero(state.variance):
        return False, _no_force()
    predicted = join_ten_parameters(filters.rotation.estimate, filters.mass.mass_reciprocal)
    known = acting_force(state, predicted, command, params)
    return has_nonzero(known.wrench) or has_nonzero(known.translation_spread.ravel()), known


@kernel
def _run_detector(
    state: Any, evidence: Evidence, rows: Array, row: int, params: CglrParams | None
) -> tuple[Any, Adaptation]:
    """Runs the detector, if any; writes its log row, and returns its state and the filters' adaptation."""
    if params is None:
        return state, passive_adaptation(0, False)
    done = cglr.run_cycle(state, evidence, params)
    fill(rows[row], cglr.status_values(done))
    fill(rows[row, _OF_JETS:], (done.tests.likelihood, done.tests.magnitude, state.force, state.variance))
    return done.state, done.adaptation


@kernel
def _write_requests(requests: ThesisAsked, state: DetectorState | None, rows: Array, last_row: int) -> None:
    """Writes the detector's requests in place: failure declared, known forces, jets removed and closed."""
    if state is None:
        return
    requests.declared[0] = rows[last_row, _EVENT] == _DECLARED
    requests.force[:] = state.force
    requests.removed[:] = state.removed
    requests.closed[:] = state.closed
