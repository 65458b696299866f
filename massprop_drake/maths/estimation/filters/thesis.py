"""The thesis's pair of filters: one of inverse inertia and center of mass, and one of the mass reciprocal.

The rotation filter (`rotation_filter`) goes first; the mass filter (`mass_filter`) takes rotation out of its
increments with what the rotation filter measured and predicted. In a diagram they are two systems; the rules of
their cycle stand here, once.

Source: D. R. Levy, MIT S.M. thesis, 1983, chapters 2 and 3.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from massprop_drake.maths.arrays import FLAG, NUMBER, Layout
from massprop_drake.maths.estimation.adaptation import Adaptation
from massprop_drake.maths.estimation.filter import (
    NOT_MEASURED,
    Filter,
    FilterStep,
    Groups,
    Interval,
    Joint,
    MassReport,
    RotationReport,
    Setup,
)
from massprop_drake.maths.estimation.filters import mass_filter, rotation_filter
from massprop_drake.maths.estimation.filters.mass_filter import (
    Compensation,
    MassCycle,
    MassInnovation,
    MassInterval,
    MassMeasurement,
    MassParams,
    MassSample,
    MassState,
    Rotation,
)
from massprop_drake.maths.estimation.filters.mass_jump import empty_window, jump_threshold
from massprop_drake.maths.estimation.filters.rotation_filter import (
    RotationCoupling,
    RotationCycle,
    RotationInnovation,
    RotationInterval,
    RotationMeasurement,
    RotationMemory,
    RotationParams,
    RotationSample,
    RotationState,
)
from massprop_drake.maths.estimation.redundancy import Rule
from massprop_drake.maths.kernels import kernel
from massprop_drake.maths.linear_algebra import Array, deviations
from massprop_drake.maths.mass_properties import N_ROTATION, join_ten_parameters

_ROUNDING = 1e-6  # by so much a part of a variance may exceed it
_CENTER = slice(6, 9)  # of the rotational state
_NO_ACCELEROMETER = np.empty((0, 3))


class ThesisParams(NamedTuple):
    """Parameters of both filters.

    Attributes:
        mass: see `MassParams`; None without accelerometer.
        estimate, covariance: of the ten parameters at the start, shapes (10,) and (10, 10).
        thrust_errors: see `filter.Setup`.
    """

    rotation: RotationParams
    mass: MassParams | None
    estimate: Array
    covariance: Array
    thrust_errors: Array | None


class ThesisState(NamedTuple):
    """State and memory of both filters.

    Attributes:
        mass: see `MassState`; None without accelerometer.
        velocities: readings of the accelerometers at the sample before, shape (a, 3).
    """

    rotation: RotationState
    memory: RotationMemory
    mass: MassState | None
    velocities: Array


class Turning(NamedTuple):
    """Measurement of the rotation filter for a sample, before it is judged.

    Attributes:
        innovation, innovation_covariance: e, rad/s, shape (3,), and Y, shape (3, 3).
        increment, rate: measured rate increment and mean rate, rad/s, shape (3,) each; NaN where missing.
        rate_variance: of the increment's error per component, rad^2/s^2.
        estimate, covariance: predicted, shapes (9,) and (9, 9).
        cross_covariance: of the innovation with the error of the prediction (true minus predicted), shape (3, 9).
        effects: of one sigma of each jet's thrust error on the innovation, shape (3, n_jets); None, or zero, where
            none bears on the sample.
        sensitivity: see `RotationState`; None where thrust is taken as known.
    """

    innovation: Array
    innovation_covariance: Array
    increment: Array
    rate: Array
    rate_variance: float
    estimate: Array
    covariance: Array
    cross_covariance: Array
    effects: Array | None
    sensitivity: Array | None


TURNING = Layout(
    "turning",
    innovation=3,
    innovation_covariance=(3, 3),
    increment=3,
    rate=3,
    rate_variance=NUMBER,
    estimate=N_ROTATION,
    covariance=(N_ROTATION, N_ROTATION),
    cross_covariance=(3, N_ROTATION),
    effects=(3, "jets"),
    sensitivity=(N_ROTATION, "jets"),
)
ROTATION_STATE = Layout(
    "rotation_state",
    estimate=N_ROTATION,
    covariance=(N_ROTATION, N_ROTATION),
    subtract_coupling=FLAG,
    rates=("gyros", 3),
    sensitivity=(N_ROTATION, "errors"),
)
MASS_STATE = Layout(
    "mass_state",
    mass_reciprocal=NUMBER,
    variance=NUMBER,
    velocities=("accelerometers", 3),
    window=("window", 3),
    sensitivity="errors",
)
_INSENSITIVE = np.empty((N_ROTATION, 0))


class ThesisMeasurement(NamedTuple):
    """A sample as both filters measured it.

    Attributes:
        turning: see `rotation_filter.measure`.
        told: what the rotation filter says of it to the mass filter and the detector.
        moving: see `mass_filter.measure`; None without accelerometer.
        rates, velocities: the readings, shape (s, 3) each.
    """

    turning: RotationMeasurement
    told: Turning
    moving: MassMeasurement | None
    rates: Array
    velocities: Array


def rotation_interval(interval: Interval, thrust_errors: Array | None) -> RotationInterval:
    """Makes the rotation filter's inputs of an interval: impulses, extra noise and scaled thrust errors."""
    impulses, known, _ = interval
    return RotationInterval(
        impulses.angular_impulse,
        impulses.linear_impulse,
        impulses.firing or known.acts,
        known.rotation_spread if known.acts else None,
        None if thrust_errors is None else impulses.mean_level[:, None] * thrust_errors,
    )


def mass_interval(interval: Interval, linear_errors: Array | None) -> MassInterval:
    """Makes the mass filter's inputs of an interval; `linear_errors` are of forces alone, shape (3, n_jets)."""
    impulses, known, _ = interval
    return MassInterval(
        impulses.linear_impulse,
        known.translation_spread if known.acts else None,
        None if linear_errors is None else linear_errors * impulses.mean_level,
    )


def is_learning(interval: Interval) -> bool:
    """Tests whether the rotation filter updates: a usable interval with commanded firing, not a known force alone."""
    return interval.impulses.usable and interval.impulses.firing


def rotation_memory(measurement: RotationMeasurement, rates: Array) -> RotationMemory:
    """Makes the rotation filter's memory of a sample: the rates, and whether coupling is subtracted next."""
    return RotationMemory(rates, measurement.innovation.subtract_coupling)


def linear_errors(thrust_errors: Array | None) -> Array | None:
    """Returns the force part of thrust errors, shape (3, n_jets), from their wrenches, shape (n_jets, 6)."""
    return None if thrust_errors is None else thrust_errors[:, 3:].T


@kernel
def make_turning(state: RotationState, sample: RotationSample, innovation: RotationInnovation) -> Turning:
    """Collects the parts of the rotation filter's measurement that the mass filter and the detector need."""
    return Turning(
        innovation.innovation,
        innovation.covariance,
        sample.increment,
        sample.rate,
        sample.gyro_variance,
        state.estimate,
        state.covariance,
        _cross_covariance(innovation.jacobian, state.covariance, state.sensitivity, innovation.effects),
        innovation.effects,
        state.sensitivity,
    )


@kernel
def _cross_covariance(jacobian: Array, covariance: Array, sensitivity: Array | None, effects: Array | None) -> Array:
    """Computes the covariance of rotation innovation and state prediction error, shape (3, 9)."""
    if effects is None or sensitivity is None:
        shared: Array = np.dot(jacobian, covariance)
        return shared
    return jacobian @ rotation_filter.independent_covariance(covariance, sensitivity) + effects @ sensitivity.T


@kernel
def rotation_inputs(rotation: Turning) -> Rotation:
    """Collects the mass filter's inputs from the rotation filter; the center of mass is the prediction (3-40)."""
    return Rotation(
        rotation.increment,
        rotation.rate,
        rotation.rate_variance,
        rotation.estimate[_CENTER],
        rotation.covariance[_CENTER, _CENTER],
    )


@kernel
def join_innovations(
    rotation: Turning, mass_sample: MassSample, mass_innovation: MassInnovation, mass_state: MassState
) -> Joint:
    """Joins both filters' innovations with their covariance and predictions, translation first."""
    impulse = mass_sample.linear_impulse
    covariance = np.zeros((6, 6))
    covariance[:3, :3] = mass_innovation.covariance
    covariance[3:, 3:] = rotation.innovation_covariance
    coupled = _add_coupling(covariance, shared_covariance(mass_innovation.effects, rotation.effects))
    parameters = joint_covariance(rotation.covariance, mass_state.variance)
    cross = np.zeros((6, N_ROTATION + 1))
    cross[3:, :N_ROTATION] = rotation.cross_covariance
    cross[:3, N_ROTATION] = impulse * mass_filter.independent_variance(mass_state.variance, mass_state.sensitivity)
    _add_error_coupling(
        (parameters, cross), rotation.sensitivity, mass_state.sensitivity, mass_innovation.effects, rotation.effects
    )
    return Joint(
        np.concatenate((mass_innovation.innovation, rotation.innovation)),
        covariance,
        coupled,
        join_ten_parameters(rotation.estimate, mass_state.mass_reciprocal),
        parameters,
        cross,
    )


@kernel
def _add_coupling(covariance: Array, coupling: Array | None) -> bool:
    """Writes a cross-covariance, shape (3, 3), into the joint covariance; returns False for None."""
    if coupling is None:
        return False
    covariance[:3, 3:] = coupling
    covariance[3:, :3] = coupling.T
    return True


@kernel
def _add_error_coupling(
    covariances: tuple[Array, Array],
    rotation_sensitivity: Array | None,
    translation_sensitivity: Array | None,
    translation_effects: Array | None,
    rotation_effects: Array | None,
) -> None:
    """Adds the filters' cross-covariances by thrust errors to the covariances of a `Joint`, in place.

    Args:
        covariances: of the parameters, and of innovations with them.
    """
    if rotation_sensitivity is None or translation_sensitivity is None:
        return
    parameters, cross = covariances
    parameters[:N_ROTATION, N_ROTATION] = rotation_sensitivity @ translation_sensitivity
    parameters[N_ROTATION, :N_ROTATION] = parameters[:N_ROTATION, N_ROTATION]
    if translation_effects is not None:
        cross[:3, :N_ROTATION] = translation_effects @ rotation_sensitivity.T
        cross[:3, N_ROTATION] += translation_effects @ translation_sensitivity
    if rotation_effects is not None:
        cross[3:, N_ROTATION] = rotation_effects @ translation_sensitivity


@kernel
def joint_covariance(rotation_covariance: Array, mass_variance: float) -> Array:
    """Joins the rotation covariance and the variance of 1/m, uncorrelated, into shape (10, 10)."""
    covariance = np.zeros((N_ROTATION + 1, N_ROTATION + 1))
    covariance[:N_ROTATION, :N_ROTATION] = rotation_covariance
    covariance[N_ROTATION, N_ROTATION] = mass_variance
    return covariance


@kernel
def shared_covariance(translation_effects: Array | None, rotation_effects: Array | None) -> Array | None:
    """Computes the covariance of translation and rotation innovations by thrust errors, (3, 3), or None.

    None where none is considered, or none bears on the sample.

    Args:
        translation_effects, rotation_effects: what one sigma of each jet's thrust error does to them, shape
            (3, n_jets) each.
    """
    if translation_effects is None or rotation_effects is None:
        return None
    if not rotation_effects.any():
        return None
    return translation_effects @ rotation_effects.T


@kernel
def rotation_report(innovation: RotationInnovation, cycle: RotationCycle) -> RotationReport:
    """Makes the rotation filter's log row of a cycle: estimate, 1-sigma, innovation, NIS and flags."""
    state = cycle.state
    return RotationReport(
        state.estimate,
        deviations(state.covariance),
        innovation.innovation,
        deviations(innovation.covariance),
        innovation.nis,
        cycle.used,
        cycle.jumped,
        innovation.subtract_coupling,
    )


@kernel
def mass_report(innovation: MassInnovation, cycle: MassCycle) -> MassReport:
    """Makes the mass filter's log row of a cycle: 1/m, its variance, innovation, NIS and flags."""
    state, deviation = cycle.state, deviations(innovation.covariance)
    return MassReport(
        state.mass_reciprocal,
        state.variance,
        innovation.innovation,
        deviation,
        innovation.nis,
        cycle.used,
        cycle.jumped,
    )


def make_params(setup: Setup, options: Any) -> ThesisParams:
    """Makes both filters' parameters from a scenario's blocks `rotation`, `mass` and `sensors.combine`."""
    rotation, mass, combine = options.rotation, options.mass, options.sensors.combine
    jump_std = rotation.jump_std_fraction * np.sqrt(setup.covariance.diagonal()[:N_ROTATION])
    turning = RotationParams(
        period_s=setup.period_s,
        gyro_variances=setup.gyro_variances,
        rule=Rule[combine.gyros.upper()],
        second_order=rotation.filter != "extended",
        bias=rotation.filter != "second_order_without_bias",
        curvature=rotation.filter != "second_order_without_covariance",
        coupling=RotationCoupling[rotation.coupling.upper()],
        coupling_limit=rotation.coupling_limit,
        jump_threshold=rotation.jump_threshold if rotation.jump == "covariance_increment" else math.inf,
        jump_covariance=np.diag(jump_std**2),
        process_noise=np.diag(np.square(rotation.process_noise_std)),
        disturbance_covariance=rotation.disturbance_std**2 * np.eye(3),
        largest_turn=rotation.largest_turn,
    )
    moving = None
    if setup.accelerometer_variances.size:
        window = mass.jump_window if mass.jump == "glr" else 1
        never = mass.jump == "none"
        moving = MassParams(
            period_s=setup.period_s,
            positions=setup.accelerometer_positions,
            variances=setup.accelerometer_variances,
            rule=Rule[combine.accelerometers.upper()],
            correlated=combine.correlated,
            compensation=Compensation[mass.compensation.upper()],
            compensation_covariance=mass.compensation_covariance,
            process_noise=mass.process_noise_std**2,
            jump_variance=float(setup.nominal[N_ROTATION] ** 2),
            jump_threshold=math.inf if never else jump_threshold(mass.jump_false_alarm_rate, window),
            jump_window=window,
            small_gain=mass.jump == "single_sample_thesis",
            disturbance_covariance=mass.disturbance_std**2 * np.eye(3),
        )
    return ThesisParams(turning, moving, setup.estimate, setup.covariance, setup.thrust_errors)


def initial_state(params: ThesisParams) -> ThesisState:
    """Returns the initial state of both filters, before any reading."""
    estimate, covariance, n_errors = params.estimate, params.covariance, _count_thrust_errors(params)
    turning = rotation_start(estimate[:N_ROTATION], covariance[:N_ROTATION, :N_ROTATION], params.rotation, n_errors)
    if params.mass is None:
        return ThesisState(*turning, None, _NO_ACCELEROMETER)
    reciprocal, variance = float(estimate[N_ROTATION]), float(covariance[N_ROTATION, N_ROTATION])
    return ThesisState(*turning, *mass_start(reciprocal, variance, params.mass, n_errors))


def rotation_start(
    estimate: Array, covariance: Array, params: RotationParams, n_errors: int
) -> tuple[RotationState, RotationMemory]:
    """Returns the initial state of the rotation filter, and its memory without readings.

    Args:
        n_errors: number of jets whose thrust errors are considered.
    """
    sensitivity = np.zeros((N_ROTATION, n_errors)) if n_errors else None
    readings = np.full((params.gyro_variances.size, 3), np.nan)
    return RotationState(estimate, np.ascontiguousarray(covariance), sensitivity), RotationMemory(readings, False)


def mass_start(mass_reciprocal: float, variance: float, params: MassParams, n_errors: int) -> tuple[MassState, Array]:
    """Returns the mass filter's initial state, and readings of NaN, shape (s, 3); `n_errors` as in `rotation_start`."""
    sensitivity = np.zeros(n_errors) if n_errors else None
    readings = np.full((params.variances.size, 3), np.nan)
    return MassState(mass_reciprocal, variance, empty_window(params.jump_window), sensitivity), readings


def predicted_parameters(state: ThesisState) -> Array:
    """Returns the predicted ten parameters, NaN for the mass reciprocal where it is not observed, shape (10,)."""
    return join_ten_parameters(state.rotation.estimate, math.nan if state.mass is None else state.mass.mass_reciprocal)


def measure(
    state: ThesisState, rates: Array, velocities: Array, interval: Interval, params: ThesisParams
) -> ThesisMeasurement:
    """Makes the rotation and mass filters' samples of a cycle and their innovations, without an update."""
    errors = params.thrust_errors
    turn = rotation_interval(interval, errors)
    turning = rotation_filter.measure(state.rotation, state.memory, rates, turn, params.rotation)
    told, moving = make_turning(state.rotation, turning.sample, turning.innovation), None
    if state.mass is not None and params.mass is not None:
        move = mass_interval(interval, linear_errors(errors))
        moving = mass_filter.measure(state.mass, state.velocities, velocities, move, rotation_inputs(told), params.mass)
    return ThesisMeasurement(turning, told, moving, rates, velocities)


def evidence(state: ThesisState, measurement: ThesisMeasurement, interval: Interval) -> Joint:
    """Returns both filters' joined innovations for the detector; `NOT_MEASURED` where it would not test."""
    if not interval.impulses.usable or measurement.moving is None or state.mass is None:
        return NOT_MEASURED
    moving = measurement.moving
    return join_innovations(measurement.told, moving.sample, moving.innovation, state.mass)


def finish(
    state: ThesisState, measurement: ThesisMeasurement, interval: Interval, adaptation: Adaptation, params: ThesisParams
) -> FilterStep:
    """Updates both filters by their measurements and the adaptation; returns states and log rows."""
    impulses, learning = interval.impulses, is_learning(interval)
    turned = rotation_filter.finish(state.rotation, measurement.turning, learning, adaptation, params.rotation)
    memory = rotation_memory(measurement.turning, measurement.rates)
    report = rotation_report(measurement.turning.innovation, turned)
    moving = measurement.moving
    if moving is None or state.mass is None or params.mass is None:
        return FilterStep(ThesisState(turned.state, memory, None, state.velocities), report, None)
    weighed = mass_filter.finish(state.mass, moving, impulses.usable, impulses.firing, adaptation, params.mass)
    return FilterStep(
        ThesisState(turned.state, memory, weighed.state, measurement.velocities),
        report,
        mass_report(moving.innovation, weighed),
    )


def parameter_covariance(state: ThesisState) -> Array:
    """Returns the covariance of the ten parameters, NaN for an unobserved mass reciprocal, shape (10, 10)."""
    return joint_covariance(state.rotation.covariance, math.nan if state.mass is None else state.mass.variance)


def rotation_layout(params: RotationParams, n_errors: int) -> Layout:
    """Makes the layout of the rotation filter's state and memory as a vector; `n_errors` as in `rotation_start`."""
    return ROTATION_STATE.sized(gyros=params.gyro_variances.size, errors=n_errors)


def mass_layout(params: MassParams, n_errors: int) -> Layout:
    """Makes the layout of the mass filter's state and readings as a vector; `n_errors` as in `rotation_start`."""
    return MASS_STATE.sized(accelerometers=params.variances.size, window=params.jump_window, errors=n_errors)


def _count_thrust_errors(params: ThesisParams) -> int:
    """Returns the number of jets whose thrust errors are considered: all or none."""
    return 0 if params.thrust_errors is None else params.thrust_errors.shape[0]


def pack_rotation(state: RotationState, memory: RotationMemory, layout: Layout) -> Array:
    """Packs the rotation filter's state and memory (rates, coupling flag) into a vector."""
    sensitivity = _INSENSITIVE if state.sensitivity is None else state.sensitivity
    return layout.pack((state.estimate, state.covariance, memory.subtract_coupling, memory.rates, sensitivity))


def unpack_rotation(vector: Array, layout: Layout) -> tuple[RotationState, RotationMemory]:
    """Unpacks the vector of `pack_rotation`; the result has views of it."""
    estimate, covariance, subtract_coupling, rates, sensitivity = layout.read(vector)
    state = RotationState(estimate, covariance, sensitivity if sensitivity.size else None)
    return state, RotationMemory(rates, subtract_coupling)


def pack_mass(state: MassState, velocities: Array, layout: Layout) -> Array:
    """Packs the mass filter's state and its last velocity readings into a vector."""
    sensitivity = _INSENSITIVE[0] if state.sensitivity is None else state.sensitivity
    return layout.pack((state.mass_reciprocal, state.variance, velocities, state.window, sensitivity))


def unpack_mass(vector: Array, layout: Layout) -> tuple[MassState, Array]:
    """Unpacks the vector of `pack_mass`: the mass filter's state and velocity readings, views of the vector."""
    mass_reciprocal, variance, velocities, window, sensitivity = layout.read(vector)
    return MassState(mass_reciprocal, variance, window, sensitivity if sensitivity.size else None), velocities


def save_state(state: ThesisState, params: ThesisParams) -> Groups:
    """Maps each system of the diagram that holds a filter's state to the state's vector."""
    n_errors = _count_thrust_errors(params)
    layout = rotation_layout(params.rotation, n_errors)
    groups = {"rotation_estimator": pack_rotation(state.rotation, state.memory, layout)}
    if state.mass is not None and params.mass is not None:
        layout = mass_layout(params.mass, n_errors)
        groups["mass_estimator"] = pack_mass(state.mass, state.velocities, layout)
    return groups


def restore_state(groups: Groups, params: ThesisParams) -> ThesisState:
    """Makes both filters' states from vectors: the inverse of `save_state`.

    Raises:
        ValueError: when the state holds what no filter leaves.
    """
    n_errors = _count_thrust_errors(params)
    rotation, memory = unpack_rotation(groups["rotation_estimator"], rotation_layout(params.rotation, n_errors))
    _require_finite("rotation_estimator", rotation)
    if rotation.sensitivity is not None:
        _require_within("rotation_estimator", rotation.sensitivity, rotation.covariance.diagonal())
    if params.mass is None:
        return ThesisState(rotation, memory, None, _NO_ACCELEROMETER)
    mass, velocities = unpack_mass(groups["mass_estimator"], mass_layout(params.mass, n_errors))
    _require_finite("mass_estimator", mass)
    if mass.sensitivity is not None:
        _require_within("mass_estimator", mass.sensitivity[None, :], np.array([mass.variance]))
    return ThesisState(rotation, memory, mass, velocities)


def _require_finite(name: str, state: RotationState | MassState) -> None:
    """Raises ValueError where a filter's state has values that are not finite."""
    if not all(np.isfinite(part).all() for part in state if part is not None):
        raise ValueError(f"{name}: only readings may be missing")


def _require_within(name: str, sensitivity: Array, variance: Array) -> None:
    """Raises ValueError where thrust errors account for more than an estimate's whole variance."""
    if ((sensitivity**2).sum(axis=1) > variance * (1.0 + _ROUNDING)).any():
        raise ValueError(f"{name}: thrust errors must be a part of the variances")


FILTER = Filter(
    params=make_params,
    initial=initial_state,
    predicted=predicted_parameters,
    measure=measure,
    evidence=evidence,
    finish=finish,
    covariance=parameter_covariance,
    saved=save_state,
    restored=restore_state,
)
